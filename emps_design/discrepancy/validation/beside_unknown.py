"""Effects that stand beside an unknown force, found by a second search and confirmed like any other.

The force is of one kind, with which and few effects next to nothing is left, or any function of the state. Where smooth
functions of the state explain nothing, neither does most friction; what is left there of an instant, a drift, a delay
or a line along the travel has no unknown force to share with, and its numbers are not bent by one.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.checks.preparation import HeldOut
from emps_design.discrepancy.model.fit import Fit, evaluate, fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.model.state import beside_state
from emps_design.discrepancy.model.unknown_force import KINDS, Columns, beside_kind, with_kind
from emps_design.discrepancy.search.acceptance import force_rms
from emps_design.discrepancy.search.beside_unknown import search_beside
from emps_design.discrepancy.search.outcome import Outcome
from emps_design.discrepancy.validation.confirmation import claims_on, standing
from emps_design.discrepancy.validation.evidence import Asked
from emps_design.discrepancy.validation.holdout import adapted
from emps_design.discrepancy.validation.rivals import alike_in_company
from emps_design.errors import SimulationError


@dataclass(frozen=True)
class Beside:
    """A fit judged beside an unknown force, how much of its effects the confirming data ask for, their equivalents.

    ``kind`` of ``KINDS`` is what the force is like; empty where it may be any function of the state. ``left`` [N] is
    the rms that the two leave, on training or confirming records, whichever is more.
    """

    found: Fit
    asked: list[Asked]
    equivalents: dict[str, list[str]]
    kind: str = ""
    left: float = np.inf

    @property
    def names(self) -> list[str]:
        """Names of the effects, without what is known from the controller's law."""
        return [one.name for one in self.asked]


def found_beside_state(outcome: Outcome, data: HeldOut) -> Beside | None:
    """What a second search finds beside the state and the confirming ``data`` ask for there; None where nothing."""
    return _found(outcome, beside_state(outcome.calibration.baseline), beside_state(_known_on(data, outcome)), data)


def found_beside_kind(outcome: Outcome, data: HeldOut) -> Beside | None:
    """What is found beside an unknown force of one kind, maybe nothing, where the two leave next to nothing; else None.

    Of training and confirming records alike, as much as of a gap without anything unknown.
    """
    baseline, known = outcome.calibration.baseline, _known_on(data, outcome)
    kind = _kind_beside(baseline)
    if kind is None:
        return None
    name, columns, start = kind
    with suppress(SimulationError):
        begin, there = (with_kind(one, columns) for one in _on_both(start, known, data))
        beside = _found(outcome, begin, there, data) or Beside(fit(begin), [], {})
        after = [evaluate(with_kind(one, columns)) for one in _on_both(beside.found, there, data)]
        if all(map(_complete, (outcome.path[0], known), after)):
            return replace(beside, kind=name, left=max(map(force_rms, after)))
    return None


def _kind_beside(baseline: Fit) -> tuple[str, Columns, Fit] | None:
    """The kind of force beside which ``baseline`` leaves least, its columns and that fit; None where there is none.

    With more columns where these leave clearly less: else they would only take the part of something known.
    """
    fits = [(name, columns, one) for name, (columns, *_) in KINDS.items() for one in _fitted_beside(baseline, columns)]
    if not fits:
        return None
    name, columns, best = min(fits, key=lambda found: found[2].cost)
    for finer in KINDS[name][1:]:
        for one in _fitted_beside(baseline, finer):
            if _excess(one) < rules.SHARPER * _excess(best):
                columns, best = finer, one
    return (name, columns, best) if _excess(best) <= (1.0 - rules.OF_A_KIND) * _excess(baseline) else None


def _fitted_beside(baseline: Fit, columns: Columns) -> list[Fit]:
    """``baseline`` fitted beside an unknown force; nothing where it does not run with one."""
    with suppress(SimulationError):
        return [fit(beside_kind(baseline, columns))]
    return []


def _on_both(found: Fit, there: Hypothesis, data: HeldOut) -> tuple[Hypothesis, Hypothesis]:
    """``found`` on its records, and on the confirming ``data`` as they are judged ``there``."""
    return found, there.with_model(adapted(data, found.model, found.model))


def _known_on(data: HeldOut, outcome: Outcome) -> Hypothesis:
    """The model that the search began with, on the confirming ``data``."""
    return Hypothesis(data.problem, outcome.path[0].model.only(0))


def _found(outcome: Outcome, start: Hypothesis, there: Hypothesis, data: HeldOut) -> Beside | None:
    """What a second search finds from ``start``, beside an unknown force, and the confirming ``data`` ask for.

    ``there`` is beside the force on those data. None where nothing is found or asked for.
    """
    known = outcome.path[0].model
    again = search_beside(outcome, start)
    if again.best.model.names == known.names:
        return None
    data = replace(data, problem=there.problem)
    found, _ = standing(data, again.calibration.judge.refitted(again.best))
    if found.model.names == known.names:
        return None
    return Beside(found, claims_on(data, found), alike_in_company(again, found))


def _complete(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether ``after`` leaves nothing but noise, or next to nothing of the gap of ``before``."""
    noise = (rules.STRUCTURED - 1.0) * before.problem.samples("used")
    return _excess(after) <= max(noise, (1.0 - rules.COMPLETE) * _excess(before))


def _excess(hypothesis: Hypothesis) -> float:
    """Whitened cost over that of noise alone."""
    return float(np.sum(np.square(hypothesis.residual("used")))) - hypothesis.problem.samples("used")


def joined(stands: Fit, beside: Beside, data: HeldOut) -> tuple[Fit, list[Asked]]:
    """``stands`` with the effects of ``beside`` as they were found, all else fitted again and asked for.

    Without those of ``stands`` that the confirming ``data`` do not ask for in this company.
    """
    own = stands.model.without_named([name for name in beside.names if name in stands.model.names])
    fitted = _fitted_around(stands.with_model(own), beside)
    asked = claims_on(data, fitted)
    gone = [one.name for one in asked if one.name in own.names and not one.stands]
    if gone:
        fitted = _fitted_around(stands.with_model(own.without_named(gone)), beside)
        asked = claims_on(data, fitted)
    return fitted, [one for one in asked if one.name in own.names]


def _fitted_around(start: Hypothesis, beside: Beside) -> Fit:
    """``start`` fitted with the effects of ``beside`` added, whose numbers and deviations stay.

    From its own baseline and from that of ``beside``: where all that stood was withdrawn, friction may be gone.
    """
    model, theirs = start.model, beside.found.model
    places = {}
    for name in beside.names:
        index = theirs.names.index(name)
        places[index] = len(model.effects)
        model = model.with_effect(theirs.effects[index], theirs.values[index])
    begins = (model, replace(model, baseline=theirs.baseline))
    free = [tuple(slot for slot in begin.slots() if slot.effect < len(start.model.effects)) for begin in begins]
    fits = side_by_side(fit, [(start.with_model(b), "used", own) for b, own in zip(begins, free, strict=True)])
    fitted = min(fits, key=lambda f: f.cost)
    own = fitted.slots
    moved = [(i, replace(s, effect=places[s.effect])) for i, s in enumerate(beside.found.slots) if s.effect in places]
    rows = np.array([i for i, _ in moved], dtype=int)
    covariance = np.zeros((len(own) + rows.size,) * 2)
    covariance[: len(own), : len(own)] = fitted.covariance
    covariance[len(own) :, len(own) :] = beside.found.covariance[np.ix_(rows, rows)]
    return evaluate(fitted, (*own, *(slot for _, slot in moved)), covariance)
