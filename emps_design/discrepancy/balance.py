"""The balance of forces along the measured motion: measured force, model force, and the residual.

Nothing is simulated, so the control loop need not be known and cannot be unstable. The model is the inverse dynamic
model (5) of ``identify`` with its cut-off: mass, friction and further terms, fitted where the axis moves.

A term is named if held-out strokes need it in addition to all other terms. The test is that of ``identify``, which
proposes the terms: the term at least halves the error on held-out strokes, significantly, and by more than a small
part of the force. Two checks follow: the share of the term that held-out strokes confirm, and the effects that fit as
well.

The logged command may be shifted in time against the motion. A drive holds a command over the period after its sample.
A log slower than the drive's loop has samples of both signals, so the mean over a period is half a sample closer, and
either signal may be logged a sample late. The shift used is the one with the smallest residual of a force model along
the motion, away from rests and reversals. A shift below two samples cannot be separated from a delay of the drive.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.unknown_force import MissingForce
from emps_design.effects import Effect
from emps_design.effects.terms import BENT, TERMS
from emps_design.identification.chains import Filtered, chosen_cutoff, filter_record
from emps_design.identification.excitation import goes_one_way
from emps_design.identification.identify import identify_by_least_squares
from emps_design.identification.inverse_model import regression
from emps_design.identification.model import ONE_WAY, Model
from emps_design.identification.proposals import FEWEST_STROKES, POWERS, RESISTS, Strokes, proposed_terms, solved
from emps_design.identification.result import BY_LEAST_SQUARES, NO_TERMS, Identification, IdentificationRequest
from emps_design.messages import Message, warning
from emps_design.observer import with_acting_command
from emps_design.quantities import inside
from emps_design.records import Record

SYMMETRIC = "symmetric"


class CommandLag(NamedTuple):
    """Delay of the logged command against the motion in ``samples`` (negative: early), and its standard deviation.

    If the delay is not significant, ``samples`` is 0 and ``std`` is the remaining uncertainty.
    """

    samples: float
    std: float


def command_lag(record: Record, axis: Axis, friction: str, cutoff: float) -> CommandLag:
    """Delay of the command of ``record`` against its motion.

    The delay minimises the residual below ``cutoff`` [Hz] of a model with mass, ``friction``, all terms possible on
    ``axis`` and nonlinear viscous friction. It is 0 if the minimum lies at ``rules.CLOCK_RANGE`` or is not significant.

    >>> t = np.arange(4000) * 0.01
    >>> q = np.sin(t) + 0.3 * np.sin(2.7 * t)
    >>> u = 3.0 * np.gradient(np.gradient(q, t), t) + 4.0 * np.gradient(q, t) + 2.0 * np.sign(np.gradient(q, t))
    >>> late = Record(t=t, q_ref=q, q=q, u=np.roll(u, 1), period=0.01)
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(drive={"force_gain": 1.0}, sampling={"period": 0.01})
    >>> command_lag(late, axis, "symmetric", 5.0).samples
    1.5
    """
    terms = [term for term in TERMS if axis.units.motion in TERMS[term].motions and term != BENT]
    farthest, step = rules.CLOCK_RANGE, rules.CLOCK_STEP
    whole = range(-farthest - 1, farthest + 2)
    strokes = [
        Strokes(filter_record(with_shifted_command(record, shift), axis, "hold", cutoff), friction) for shift in whole
    ]
    if strokes[0].count < FEWEST_STROKES:
        return CommandLag(0.0, rules.HALF)
    # Filter and regression are linear, so residuals between two shifts are interpolated like the command.
    root = int(np.argmin(np.abs(np.subtract(POWERS, 0.5))))  # one exponent is enough for all nonlinear friction
    residuals = np.array([shifted.residual(terms, [shifted.bent[:, root]]) for shifted in strokes])
    shifts = np.round(step * np.arange(-round(farthest / step), round(farthest / step) + 1), 6)
    places = np.minimum(np.floor(shifts).astype(int), farthest - 1)
    parts = [residuals[place + farthest : place + farthest + 4] for place in places]
    errors = (
        np.array(
            [interpolation_weights(shift - n) @ part for shift, n, part in zip(shifts, places, parts, strict=True)]
        )
        ** 2
    )
    total, best = errors.sum(axis=1), int(np.argmin(errors.sum(axis=1)))
    noise = float(total[best]) / errors.shape[1]  # the spacing of the rows is the resolution of the filter
    points = [best - 2, best, best + 2]  # of a parabola through the sums of squares
    if points[0] < 0 or points[2] >= len(shifts):
        return CommandLag(0.0, rules.HALF)
    curvature = float(np.array([1.0, -2.0, 1.0]) @ total[points]) / (2.0 * (2.0 * step) ** 2)
    std = float(np.clip(np.sqrt(noise / max(curvature, 1e-300)), 0.5 * step, rules.HALF))
    significant = total[len(shifts) // 2] - total[best] > rules.SURE**2 * noise
    return CommandLag(float(shifts[best]) if significant else 0.0, std if significant else rules.HALF)


def with_shifted_command(record: Record, samples: float) -> Record:
    """``record`` with its command shifted ``samples`` earlier, by cubic interpolation.

    >>> ramp = np.arange(6.0)
    >>> with_shifted_command(Record(t=ramp, q_ref=ramp, q=ramp, u=ramp, period=1.0), 0.5).u[1:4].tolist()
    [1.5, 2.5, 3.5]
    """
    if samples == 0.0:
        return record
    whole, places = math.floor(samples), np.arange(len(record))
    neighbours = [record.u[np.clip(places + whole + offset, 0, len(record) - 1)] for offset in (-1, 0, 1, 2)]
    return replace(record, u=interpolation_weights(samples - whole) @ np.array(neighbours))


def interpolation_weights(share: float) -> np.ndarray:
    """Weights (4,) of the samples at -1, 0, 1 and 2 for cubic (Lagrange) interpolation at ``share`` of a sample.

    Linear interpolation would attenuate fast motion, and with it the inertia, by 10 %.

    >>> interpolation_weights(0.5).tolist()
    [-0.0625, 0.5625, 0.5625, -0.0625]
    """
    x = share
    return np.array(
        [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ]
    )


@dataclass(frozen=True)
class FittedModel:
    """A model fitted to a balance: ``model`` with its solution ``value`` (p,), mass and friction not negative.

    ``identification`` has the standard deviations; ``held`` are the names of the parameters held at zero because they
    would have been negative; ``clock_effects`` is the change of each parameter by one standard deviation of the clock.
    """

    identification: Identification
    model: Model
    value: np.ndarray
    held: tuple[str, ...]
    clock_effects: Mapping[str, float]

    @classmethod
    def of(cls, identification: Identification, beside: Sequence[Filtered]) -> FittedModel:
        """The model of ``identification``, solved again within bounds if a mass or friction is negative.

        ``beside`` are the filtered records with the command one standard deviation of its clock earlier and later.
        """
        W, Y, model = identification.series["columns"], identification.series["measured"], identification.fitted
        if model.friction != ONE_WAY and len(model.names) != W.shape[1]:
            model = replace(model, friction=ONE_WAY)
        free, resists = solved(W, Y), sum(name in RESISTS for name in model.names)
        held = tuple(name for name, value in zip(model.names[:resists], free, strict=False) if value < 0.0)
        value = solved(W, Y, resists)
        ends = [model.natural(solved(*regression(rows, model), resists)) for rows in beside]
        moves = {name: 0.5 * abs(ends[1][name] - ends[0][name]) for name in model.names}
        return cls(identification, model, value, held, moves)

    @property
    def parameters(self) -> dict[str, float]:
        """The fitted parameters by name."""
        return self.model.natural(self.value)

    @property
    def determined(self) -> dict[str, float]:
        """The parameters that the record determines."""
        return {name: x for name, x in self.parameters.items() if self.identification.parameters[name].determined}

    def determines(self, term: str) -> bool:
        """Whether the record determines every parameter of ``term``."""
        return all(self.identification.parameters[quantity.name].determined for quantity in TERMS[term].quantities)

    def deviation(self, name: str) -> float:
        """Standard deviation of the parameter ``name``, from its 95 % interval and the uncertainty of the clock.

        For a parameter held at zero, from the part of the interval above zero; 0 without an interval.
        """
        ends = self.identification.parameters[name].interval_95
        if ends is None:
            return 0.0
        half = max(ends[1], 0.0) if name in self.held else 0.5 * (ends[1] - ends[0])
        return float(np.hypot(half / rules.NORMAL, self.clock_effects[name]))


@dataclass(frozen=True)
class Balance:
    """A ``record`` of an ``axis``, its command shifted by the delay of ``clock``, low-passed at ``cutoff`` [Hz].

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> balance = Balance.of(synthetic_record(axis, laps=1), axis)
    >>> fitted = balance.fitted()
    >>> round(fitted.parameters["mass"]), round(float(np.std(balance.residual(fitted)[balance.filtered.used])), 1)
    (95, 0.3)
    """

    record: Record
    axis: Axis
    friction: str
    clock: CommandLag
    cutoff: float

    @classmethod
    def of(cls, record: Record, axis: Axis, template: Balance | None = None) -> Balance:
        """The balance of ``record``; friction model, cut-off and clock from ``template``, or chosen from the record."""
        axis = axis.supplied_by(record)
        if template is None:
            friction = ONE_WAY if goes_one_way(record) else SYMMETRIC
            cutoff = chosen_cutoff(with_acting_command(axis, record)[0])
            clock = command_lag(record, axis, friction, cutoff)
        else:
            friction, cutoff, clock = template.friction, template.cutoff, template.clock
        return cls(record, axis, friction, clock, cutoff)

    @cached_property
    def aligned(self) -> Record:
        """The record with its command shifted to the motion."""
        return with_shifted_command(self.record, self.clock.samples)

    @cached_property
    def filtered(self) -> Filtered:
        """The aligned record after the filters of ``identify``."""
        return filter_record(self.aligned, self.axis, "hold", self.cutoff)

    @cached_property
    def strokes(self) -> Strokes:
        """The strokes of the record, for predictions of each stroke from the others."""
        return Strokes(self.filtered, self.friction, bounded=True)

    def fitted(self, terms: Sequence[str] = ()) -> FittedModel:
        """Least-squares fit with ``terms``; raises as :func:`~emps_design.identification.identify` does."""
        request = IdentificationRequest(SYMMETRIC, BY_LEAST_SQUARES, cutoff=self.cutoff, with_=tuple(terms) or NO_TERMS)
        identification = identify_by_least_squares(self.aligned, self.axis, request, aligned=True)
        return FittedModel.of(identification, self._beside)

    @cached_property
    def _beside(self) -> list[Filtered]:
        """The filtered record with the command a standard deviation of its clock earlier and later."""
        ends = [self.clock.samples + side * self.clock.std for side in (-1.0, 1.0)]
        return [filter_record(with_shifted_command(self.record, end), self.axis, "hold", self.cutoff) for end in ends]

    def force(self, fitted: FittedModel) -> np.ndarray:
        """Model force (rows,) [N] along the motion."""
        return regression(self.filtered, fitted.model)[0] @ fitted.value

    def residual(self, fitted: FittedModel) -> np.ndarray:
        """Measured minus model force (rows,) [N], 0 in unused rows."""
        return regression(self.filtered, fitted.model)[1] - self.force(fitted)

    def along(self, rows: np.ndarray) -> np.ndarray:
        """A signal (rows,) at the samples (n,) of the record, interpolated linearly."""
        return np.interp(self.record.t, self.filtered.t, rows)

    @cached_property
    def used(self) -> np.ndarray:
        """The used samples (n,) bool."""
        inside = (self.record.t >= self.filtered.t[0]) & (self.record.t <= self.filtered.t[-1])
        return inside & (self.along(self.filtered.used.astype(float)) > 0.999)

    def missing(self, fitted: FittedModel) -> MissingForce:
        """The missing force of a model at the samples of the record."""
        moving = replace(self.filtered.motion, tau=self.along(self.force(fitted)), voltage=self.record.u)
        return MissingForce(moving, self.along(self.residual(fitted)), self.used)


def terms_of(axis: Axis, effects: Mapping[str, Effect]) -> dict[str, str]:
    """The terms possible on ``axis``, each with the name of its effect in ``effects``.

    >>> from emps_design.effects import known_effects
    >>> from emps_design.machines import machine
    >>> terms_of(machine("emps2019"), known_effects())["bent-viscous"]
    'nonlinear_viscous_friction'
    """
    return {
        term: name
        for term, described in TERMS.items()
        for name, effect in effects.items()
        if axis.units.motion in described.motions and term in effect.estimation.identified_by
    }


@dataclass(frozen=True)
class NamedEffect:
    """A named ``effect`` with its ``parameters`` and their standard deviations ``std``, by name.

    ``force`` (rows,) [N] is its force along the motion; ``without`` is the model fitted without it. ``chance`` is the
    p-value of the errors on strokes; ``confirmed`` is the share that held-out strokes confirm, with its standard
    deviation; ``equivalents`` are effects that fit as well.
    """

    effect: Effect
    parameters: Mapping[str, float]
    std: Mapping[str, float]
    force: np.ndarray
    without: FittedModel
    chance: float
    confirmed: Mapping[str, float] | None
    equivalents: tuple[str, ...]


@dataclass(frozen=True)
class CandidateTerm:
    """A candidate term: ``error`` [N rms] on held-out strokes with it, and the ratio ``times`` of the error without."""

    effect: Effect
    error: float
    times: float
    accepted: bool


def select_terms(
    balance: Balance, terms: Mapping[str, str], library: Mapping[str, Effect]
) -> tuple[tuple[str, ...], list[Message]]:
    """The ``terms`` that the record needs, the most important first, and messages about rejected terms.

    A term is rejected if another effect of the ``library`` predicts the held-out strokes better in its place.
    """
    if balance.strokes.count < FEWEST_STROKES:
        return (), []
    proposed = proposed_terms(balance.aligned, balance.axis, balance.friction, balance.cutoff)
    candidates = [term for term in proposed if term in terms]
    strokes, errors_without, remarks = balance.strokes, {}, list[Message]()
    whole = strokes.errors(candidates)
    for term in candidates:
        rest, effect = [other for other in candidates if other != term], library[terms[term]]
        better = [
            library[name].label
            for name, error in _rivals(balance, effect, rest, library).items()
            if strokes.ask_for(error, whole)
        ]
        if better:
            text = (
                f"{inside(effect.label)} would explain much of the residual and {inside(' or '.join(better))} more, "
                f"but a balance of {balance.axis.units.word('forces')} cannot estimate its parameters: neither is named"
            )
            remarks.append(warning("rival-without-numbers", text, effect=effect.name))
        else:
            errors_without[term] = float(strokes.errors(rest).sum())
    return tuple(sorted(errors_without, key=lambda term: -errors_without[term])), remarks


Shares = Mapping[str, Mapping[str, float] | None]  # of each term, the share that held-out data confirm


def term_shares(balance: Balance, terms: Sequence[str], other: Balance | None) -> Shares:
    """Share of each of ``terms`` confirmed by the strokes of ``other``, or by those of ``balance`` held out in turn.

    None if the strokes do not excite the term.
    """
    judged, known = (balance.strokes, None) if other is None else (other.strokes, balance.strokes)
    whole = judged.left(terms, known=known)
    return {
        term: confirmed_share(judged, whole, judged.left([other for other in terms if other != term], known=known))
        for term in terms
    }


def confirmed_share(strokes: Strokes, whole: np.ndarray, without: np.ndarray) -> dict[str, float] | None:
    """Share of a term that ``strokes`` confirm, from the errors (rows,) ``without`` it and with it, ``whole``.

    Regression of the error without the term on the difference of both, with the standard deviation between strokes;
    None if they hardly differ.
    """
    difference = without - whole
    products, squares = strokes.by_stroke(difference * without), strokes.by_stroke(difference**2)
    if squares.sum() < rules.SLIGHT**2 * float(np.sum(whole**2)):
        return None
    share = float(products.sum() / squares.sum())
    return {"share": share, "std": float(np.linalg.norm(products - share * squares) / squares.sum())}


def refuted_terms(confirmed: Shares) -> tuple[str, ...]:
    """The terms whose confirmed share differs significantly from 1."""

    def differs(share: Mapping[str, float]) -> bool:
        return abs(share["share"] - 1.0) > max(rules.SOME, rules.SURE * share["std"])

    return tuple(term for term, share in confirmed.items() if share is not None and differs(share))


def named_effects(
    balance: Balance, fitted: FittedModel, terms: Mapping[str, str], library: Mapping[str, Effect], shares: Shares
) -> tuple[NamedEffect, ...]:
    """The effects to name in the model ``fitted``: those of the terms in ``shares``."""
    findings, strokes = [], balance.strokes
    whole = strokes.errors(tuple(shares))
    for term, confirmed in shares.items():
        effect, rest = library[terms[term]], [other for other in shares if other != term]
        without, parameters = strokes.errors(rest), effect.estimation.identified_by[term](fitted.parameters)
        findings.append(
            NamedEffect(
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
    return tuple(findings)


def equivalents(
    balance: Balance,
    effect: Effect,
    rest: Sequence[str],
    library: Mapping[str, Effect],
    whole: np.ndarray,
    without: np.ndarray,
) -> tuple[str, ...]:
    """Effects of the ``library`` that explain the strokes as well as ``effect``, in addition to the terms ``rest``.

    ``whole`` and ``without`` (strokes,) are the errors with and without the effect; an equivalent closes nearly all of
    the difference.
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
    """Errors (strokes,) with each confusable effect in the place of ``effect``, in addition to the terms ``rest``.

    Each effect has its best shape; general curves are excluded, because they can imitate any effect.
    """
    strokes, errors = balance.strokes, {}
    for name, rival in library.items():
        if rival.confusable(effect) and rival.regressor is not None and not rival.search.general:
            tried = [strokes.by_stroke(strokes.left(rest, columns) ** 2) for columns in _columns(balance, rival)]
            if tried:
                errors[name] = min(tried, key=lambda error: float(error.sum()))
    return errors


def _columns(balance: Balance, effect: Effect) -> Iterator[list[np.ndarray]]:
    """The columns of ``effect`` along the motion, for every plausible combination of its starting shapes."""
    assert effect.regressor is not None
    shapes, motion = [p for p in effect.parameters if not p.linear], balance.filtered.motion
    size = {p.name: p.scale for p in effect.parameters if p.linear}
    for values in itertools.product(*(p.starts or (p.scale,) for p in shapes)):
        shape = {p.name: value for p, value in zip(shapes, values, strict=True)}
        if effect.search.plausible is None or effect.search.plausible(size | shape, motion):
            columns = effect.regressor(motion, shape, balance.axis.mechanics.array())
            yield list(balance.strokes.rows(columns.T).T)


def candidate_terms(
    balance: Balance, terms: Mapping[str, str], selected: Sequence[str], library: Mapping[str, Effect]
) -> list[CandidateTerm]:
    """The candidates, best first: each of ``terms`` in addition to those ``selected``."""
    if balance.strokes.count < FEWEST_STROKES:
        return []
    rows = []
    for term, name in terms.items():
        whole, without = (
            [*selected, *([] if term in selected else [term])],
            [other for other in selected if other != term],
        )
        error, more = (float(np.sqrt(np.mean(balance.strokes.left(model) ** 2))) for model in (whole, without))
        rows.append(CandidateTerm(library[name], error, more / max(error, 1e-300), term in selected))
    return sorted(rows, key=lambda row: -row.times)


def _deviations(effect: Effect, term: str, fitted: FittedModel) -> dict[str, float]:
    """Standard deviations of the effect's parameters, propagated from the identified ones by finite differences."""
    numbers = fitted.parameters
    square = dict.fromkeys(effect.estimation.identified_by[term](numbers), 0.0)
    for name, value in numbers.items():
        std = fitted.deviation(name)
        ends = [effect.estimation.identified_by[term]({**numbers, name: value + side * std}) for side in (0.5, -0.5)]
        for parameter in square:
            square[parameter] += (ends[0][parameter] - ends[1][parameter]) ** 2
    return {parameter: float(np.sqrt(total)) for parameter, total in square.items()}


def _force(balance: Balance, effect: Effect, term: str, parameters: Mapping[str, float]) -> np.ndarray:
    """Force (rows,) [N] of the effect along the motion; of nonlinear friction the part that no linear friction fits."""
    assert effect.regressor is not None
    motion = balance.filtered.motion
    shape = {name: parameters[name] for name in effect.shape}
    force = effect.regressor(motion, shape, balance.axis.mechanics.array()) @ effect.coefficients(parameters)
    force = balance.filtered.reduce(force)
    if term == BENT:
        used = balance.filtered.used
        lines = np.column_stack([balance.filtered.reduce(signal) for signal in (motion.v, np.sign(motion.v))])
        force = force - lines @ np.linalg.lstsq(lines[used], force[used], rcond=None)[0]
    return np.asarray(force * balance.filtered.used)
