"""The forces of a record along its measured motion: what acts, what a model makes of it, and what that leaves.

Nothing is simulated, so that no loop has to be known and none can be unstable; what is compared is the inverse dynamic
model (5) of ``identify``, at its cut-off, away from rests. A model is one of its models: mass and friction, and terms
beside them.

Which terms have a name: those that strokes which take no part ask for, each beside all the others.

The test is the one of ``identify``, which proposes them: the error of held-out strokes at least halved, not by chance,
and more than a small part of the force. What passes it is looked at once more: how much of it the held-out strokes ask
for, and whether another effect of the library would do as well in its place.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.unknown_force import MissingForce
from emps_design.effects import Effect
from emps_design.effects.terms import BENT, TERMS
from emps_design.identification.command_clock import CommandLag, logged_beside, moved
from emps_design.identification.excitation import goes_one_way
from emps_design.identification.identify import identify_by_least_squares
from emps_design.identification.inverse_model import Filtered, chosen_cutoff, regression
from emps_design.identification.model import ONE_WAY, Model
from emps_design.identification.problem import acting, filter_record
from emps_design.identification.proposals import FEWEST_STROKES, RESISTS, Strokes, proposed_terms, solved
from emps_design.identification.result import BY_LEAST_SQUARES, NO_TERMS, Identification, Request
from emps_design.quantities import inside
from emps_design.records import Record

SYMMETRIC = "symmetric"
NORMAL = 1.96  # deviations to either side that are an interval of 95 %


@dataclass(frozen=True)
class Fitted:
    """A model fitted to a balance: ``model`` around its solution ``value`` (p,), none of what resists below nothing.

    ``found`` is the identification, with the deviations; ``parameters`` the numbers by name, ``held`` the names of
    those that would have been below nothing; ``moves`` what the deviation of the command's clock does to each.
    """

    found: Identification
    model: Model
    value: np.ndarray
    held: tuple[str, ...]
    moves: Mapping[str, float]

    @classmethod
    def of(cls, found: Identification, beside: Sequence[Filtered]) -> Fitted:
        """The model of an identification, solved again within bounds where a number is below nothing.

        ``beside`` are the two rows of forces at the ends of what the command's clock leaves open.
        """
        W, Y, model = found.series["columns"], found.series["measured"], found.fitted
        if model.friction != ONE_WAY and len(model.names) != W.shape[1]:
            model = replace(model, friction=ONE_WAY)
        free, resists = solved(W, Y), sum(name in RESISTS for name in model.names)
        held = tuple(name for name, value in zip(model.names[:resists], free, strict=False) if value < 0.0)
        value = solved(W, Y, resists)
        ends = [model.natural(solved(*regression(one, model), resists)) for one in beside]
        moves = {name: 0.5 * abs(ends[1][name] - ends[0][name]) for name in model.names}
        return cls(found, model, value, held, moves)

    @property
    def parameters(self) -> dict[str, float]:
        """The numbers of the fit by name."""
        return self.model.natural(self.value)

    @property
    def determined(self) -> dict[str, float]:
        """Those of them that the record determines."""
        return {name: x for name, x in self.parameters.items() if self.found.parameters[name].determined}

    def tells(self, term: str) -> bool:
        """Whether the record determines every number of ``term``."""
        return all(self.found.parameters[quantity.name].determined for quantity in TERMS[term].quantities)

    def deviation(self, name: str) -> float:
        """Standard deviation of the number ``name``: twice as much to either side is its 95 % interval, clock and all.

        Of one that is held at nothing, what its interval has above nothing; 0 where it has none.
        """
        ends = self.found.parameters[name].interval_95
        if ends is None:
            return 0.0
        half = max(ends[1], 0.0) if name in self.held else 0.5 * (ends[1] - ends[0])
        return float(np.hypot(half / NORMAL, self.moves[name]))


@dataclass(frozen=True)
class Balance:
    """A ``record`` of an ``axis`` along its motion, its command moved as its ``clock`` says, below ``cutoff`` [Hz].

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> balance = Balance.of(synthetic_record(axis, laps=1), axis)
    >>> fitted = balance.fitted()
    >>> round(fitted.parameters["mass"]), round(float(np.std(balance.left(fitted)[balance.filtered.used])), 1)
    (95, 0.3)
    """

    record: Record
    axis: Axis
    friction: str
    clock: CommandLag
    cutoff: float

    @classmethod
    def of(cls, record: Record, axis: Axis, alike: Balance | None = None) -> Balance:
        """The balance of ``record``, filtered and moved as one ``alike``, or as it asks for itself."""
        axis = axis.supplied_by(record)
        if alike is None:
            friction = ONE_WAY if goes_one_way(record) else SYMMETRIC
            cutoff = chosen_cutoff(acting(record, axis))
            clock = logged_beside(record, axis, friction, cutoff)
        else:
            friction, cutoff, clock = alike.friction, alike.cutoff, alike.clock
        return cls(record, axis, friction, clock, cutoff)

    @cached_property
    def moved(self) -> Record:
        """The record with its command where the motion answers to it."""
        return moved(self.record, self.clock.samples)

    @cached_property
    def filtered(self) -> Filtered:
        """That record behind the filters of ``identify``."""
        return filter_record(self.moved, self.axis, "hold", self.cutoff)

    @cached_property
    def strokes(self) -> Strokes:
        """The strokes of the record, each to be predicted from others."""
        return Strokes(self.filtered, self.friction, bounded=True)

    def fitted(self, terms: Sequence[str] = ()) -> Fitted:
        """The model with ``terms`` that leaves least; raises as :func:`~emps_design.identification.identify` does."""
        asked = Request(SYMMETRIC, BY_LEAST_SQUARES, cutoff=self.cutoff, with_=tuple(terms) or NO_TERMS)
        return Fitted.of(identify_by_least_squares(self.moved, self.axis, asked), self._beside)

    @cached_property
    def _beside(self) -> list[Filtered]:
        """The same forces with the command a deviation of its clock to either side."""
        ends = [self.clock.samples + side * self.clock.std for side in (-1.0, 1.0)]
        return [filter_record(moved(self.record, end), self.axis, "hold", self.cutoff) for end in ends]

    def force(self, fitted: Fitted) -> np.ndarray:
        """The force (rows,) [N] that a model asks for along the motion."""
        return regression(self.filtered, fitted.model)[0] @ fitted.value

    def left(self, fitted: Fitted) -> np.ndarray:
        """What a model leaves (rows,) [N] of the force that acts, 0 in rows that take no part."""
        return regression(self.filtered, fitted.model)[1] - self.force(fitted)

    def along(self, rows: np.ndarray) -> np.ndarray:
        """A signal (rows,) at the samples (n,) of the record: straight between the rows, which resolve it."""
        return np.interp(self.record.t, self.filtered.t, rows)

    @cached_property
    def used(self) -> np.ndarray:
        """The samples (n,) bool that take part."""
        inside = (self.record.t >= self.filtered.t[0]) & (self.record.t <= self.filtered.t[-1])
        return inside & (self.along(self.filtered.used.astype(float)) > 0.999)

    def missing(self, fitted: Fitted) -> MissingForce:
        """What a model misses at the samples of the record."""
        moving = replace(self.filtered.motion, tau=self.along(self.force(fitted)), voltage=self.record.u)
        return MissingForce(moving, self.along(self.left(fitted)), self.used)


def terms_of(axis: Axis, effects: Mapping[str, Effect]) -> dict[str, str]:
    """The terms that may be named on ``axis``, and the one of ``effects`` by name that each is.

    >>> from emps_design.effects import known_effects
    >>> from emps_design.machines import machine
    >>> terms_of(machine("emps2019"), known_effects())["bent-viscous"]
    'nonlinear_viscous_friction'
    """
    return {
        term: name
        for term, described in TERMS.items()
        for name, effect in effects.items()
        if axis.units.motion in described.motions and term in effect.identified_by
    }


@dataclass(frozen=True)
class Named:
    """An ``effect`` that is named, with ``parameters`` and ``std`` by name.

    ``force`` (rows,) [N] is what it adds along the motion; ``without`` the model fitted without it. ``chance`` is the
    probability that strokes differ so; ``confirmed`` the share of it that held-out strokes ask for, with its deviation;
    ``equivalents`` are the effects that would do as well.
    """

    effect: Effect
    parameters: Mapping[str, float]
    std: Mapping[str, float]
    force: np.ndarray
    without: Fitted
    chance: float
    confirmed: Mapping[str, float] | None
    equivalents: tuple[str, ...]


@dataclass(frozen=True)
class Tried:
    """A term that was looked for: error of held-out strokes [N rms] with it, and how many ``times`` more without."""

    effect: Effect
    error: float
    times: float
    accepted: bool


def asked_for(
    balance: Balance, terms: Mapping[str, str], library: Mapping[str, Effect]
) -> tuple[tuple[str, ...], list[str]]:
    """Those of ``terms`` that the record asks for, what it loses most without first, and what to say of others.

    None in whose place the strokes ask for another effect of the ``library``: it would stand in for that.
    """
    if balance.strokes.count < FEWEST_STROKES:
        return (), []
    proposed = proposed_terms(balance.moved, balance.axis, balance.friction, balance.cutoff)
    asked = [term for term in proposed if term in terms]
    strokes, lost, said = balance.strokes, {}, []
    whole = strokes.errors(asked)
    for term in asked:
        rest, effect = [one for one in asked if one != term], library[terms[term]]
        better = [
            library[name].label
            for name, error in _rivals(balance, effect, rest, library).items()
            if strokes.ask_for(error, whole)
        ]
        if better:
            said.append(
                f"{inside(effect.label)} would explain much, and {inside(' or '.join(better))} in its place more, of "
                "which a balance of forces finds no numbers: neither is named"
            )
        else:
            lost[term] = float(strokes.errors(rest).sum())
    return tuple(sorted(lost, key=lambda term: -lost[term])), said


Shares = Mapping[str, Mapping[str, float] | None]  # of each term, what data that took no part ask for


def shares(balance: Balance, terms: Sequence[str], other: Balance | None) -> Shares:
    """How much of each of ``terms`` the strokes of ``other`` ask for, or those of ``balance``, each in turn.

    None where they do not exercise it.
    """
    judged, known = (balance.strokes, None) if other is None else (other.strokes, balance.strokes)
    whole = judged.left(terms, known=known)
    return {
        term: share_asked(judged, whole, judged.left([one for one in terms if one != term], known=known))
        for term in terms
    }


def share_asked(strokes: Strokes, whole: np.ndarray, without: np.ndarray) -> dict[str, float] | None:
    """How much ``strokes`` ask for of what turns the errors ``without`` (rows,) of their prediction into ``whole``.

    The regression of the one error on what the two differ by, with the deviation that strokes by themselves tell; None
    where they hardly differ.
    """
    adds = without - whole
    wanted, size = strokes.by_stroke(adds * without), strokes.by_stroke(adds**2)
    if size.sum() < rules.EXERCISED**2 * float(np.sum(whole**2)):
        return None
    share = float(wanted.sum() / size.sum())
    return {"share": share, "std": float(np.linalg.norm(wanted - share * size) / size.sum())}


def refuted(asked: Shares) -> tuple[str, ...]:
    """The terms of which clearly another amount is asked for than all."""

    def apart(told: Mapping[str, float]) -> bool:
        return abs(told["share"] - 1.0) > max(rules.ASKED_APART, rules.SURE * told["std"])

    return tuple(term for term, told in asked.items() if told is not None and apart(told))


def named(
    balance: Balance, fitted: Fitted, terms: Mapping[str, str], library: Mapping[str, Effect], asked: Shares
) -> tuple[Named, ...]:
    """What is named of the model ``fitted``: those of ``terms`` that are ``asked`` for, with what is known of each."""
    found, strokes = [], balance.strokes
    whole = strokes.errors(tuple(asked))
    for term, confirmed in asked.items():
        effect, rest = library[terms[term]], [one for one in asked if one != term]
        without, parameters = strokes.errors(rest), effect.identified_by[term](fitted.parameters)
        found.append(
            Named(
                effect,
                parameters,
                _deviations(effect, term, fitted),
                _force(balance, effect, term, parameters),
                balance.fitted(rest),
                strokes.chance(whole, without),
                confirmed,
                equivalents(balance, effect, rest, library, whole, without),
            )
        )
    return tuple(found)


def equivalents(
    balance: Balance,
    effect: Effect,
    rest: Sequence[str],
    library: Mapping[str, Effect],
    whole: np.ndarray,
    without: np.ndarray,
) -> tuple[str, ...]:
    """Effects of the ``library`` in whose place the strokes would not ask for ``effect``, beside ``rest``.

    ``whole`` and ``without`` (strokes,) are the errors with the effect and without it; of what lies between them an
    equivalent takes nearly all.
    """
    most = float(whole.sum()) + rules.EQUIVALENT * float(without.sum() - whole.sum())
    rivals = _rivals(balance, effect, rest, library)
    return tuple(
        name
        for name, error in rivals.items()
        if float(error.sum()) <= most and not balance.strokes.ask_for(whole, error)
    )


def _rivals(
    balance: Balance, effect: Effect, rest: Sequence[str], library: Mapping[str, Effect]
) -> dict[str, np.ndarray]:
    """The errors (strokes,) with each effect in the place of ``effect`` that is known to be confused with it.

    Beside ``rest``, each in its best shape; of curves of any shape none, which could stand in for anything.
    """
    strokes, found = balance.strokes, {}
    for name, rival in library.items():
        if rival.confusable(effect) and rival.regressor is not None and not rival.general:
            tried = [strokes.by_stroke(strokes.left(rest, columns) ** 2) for columns in _columns(balance, rival)]
            if tried:
                found[name] = min(tried, key=lambda error: float(error.sum()))
    return found


def _columns(balance: Balance, effect: Effect) -> Iterator[list[np.ndarray]]:
    """The columns of an ``effect`` along the motion, with every combination of its first shapes that is plausible."""
    assert effect.regressor is not None
    shapes, motion = [p for p in effect.parameters if not p.linear], balance.filtered.motion
    size = {p.name: p.scale for p in effect.parameters if p.linear}
    for values in itertools.product(*(p.starts or (p.scale,) for p in shapes)):
        shape = {p.name: value for p, value in zip(shapes, values, strict=True)}
        if effect.plausible is None or effect.plausible(size | shape, motion):
            columns = effect.regressor(motion, shape, balance.axis.mechanics.array())
            yield list(balance.strokes.rows(columns.T).T)


def tried(
    balance: Balance, terms: Mapping[str, str], asked: Sequence[str], library: Mapping[str, Effect]
) -> list[Tried]:
    """What was looked for, the best first: each of ``terms`` beside those that were ``asked`` for."""
    if balance.strokes.count < FEWEST_STROKES:
        return []
    rows = []
    for term, name in terms.items():
        whole, without = [*asked, *([] if term in asked else [term])], [one for one in asked if one != term]
        error, more = (float(np.sqrt(np.mean(balance.strokes.left(model) ** 2))) for model in (whole, without))
        rows.append(Tried(library[name], error, more / max(error, 1e-300), term in asked))
    return sorted(rows, key=lambda row: -row.times)


def _deviations(effect: Effect, term: str, fitted: Fitted) -> dict[str, float]:
    """Standard deviations of the effect's numbers, by the derivatives after those that were identified."""
    numbers = fitted.parameters
    square = dict.fromkeys(effect.identified_by[term](numbers), 0.0)
    for name, value in numbers.items():
        std = fitted.deviation(name)
        ends = [effect.identified_by[term]({**numbers, name: value + side * std}) for side in (0.5, -0.5)]
        for own in square:
            square[own] += (ends[0][own] - ends[1][own]) ** 2
    return {own: float(np.sqrt(total)) for own, total in square.items()}


def _force(balance: Balance, effect: Effect, term: str, parameters: Mapping[str, float]) -> np.ndarray:
    """What the effect adds (rows,) [N] along the motion: of a bent friction, what no straight line has."""
    assert effect.regressor is not None
    motion = balance.filtered.motion
    shape = {name: parameters[name] for name in effect.shape}
    force = effect.regressor(motion, shape, balance.axis.mechanics.array()) @ effect.coefficients(parameters)
    force = balance.filtered.reduce(force)
    if term == BENT:
        used = balance.filtered.used
        lines = np.column_stack([balance.filtered.reduce(one) for one in (motion.v, np.sign(motion.v))])
        force = force - lines @ np.linalg.lstsq(lines[used], force[used], rcond=None)[0]
    return np.asarray(force * balance.filtered.used)
