"""Which terms have a name: those that strokes which take no part ask for, each beside all the others.

The test is the one of ``identify``, which proposes them: the error of held-out strokes at least halved, not by chance,
and more than a small part of the force. What passes it is looked at once more: how much of it the held-out strokes ask
for, and whether another effect of the library would do as well in its place.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.along_motion.balance import Balance, Fitted
from emps_design.effects import Effect
from emps_design.effects.terms import BENT
from emps_design.identification.proposals import FEWEST_STROKES, Strokes, proposed_terms
from emps_design.quantities import inside


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
