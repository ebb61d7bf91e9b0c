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
from emps_design.discrepancy.model.unknown_force import KINDS, beside_kind
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

    ``kind`` of ``KINDS`` is what the force is like; empty where it may be any function of the state.
    """

    found: Fit
    asked: list[Asked]
    equivalents: dict[str, list[str]]
    kind: str = ""

    @property
    def names(self) -> list[str]:
        """Names of the effects, without what is known from the controller's law."""
        return [one.name for one in self.asked]


def found_beside_state(outcome: Outcome, data: HeldOut) -> Beside | None:
    """What a second search finds beside the state and the confirming ``data`` ask for there; None where nothing."""
    return _found(outcome, beside_state(outcome.calibration.baseline), beside_state(_known_on(data, outcome)), data)


def found_beside_kind(outcome: Outcome, data: HeldOut) -> Beside | None:
    """What is found beside an unknown force of one kind where the two leave next to nothing; None where nothing is.

    Of training and confirming records alike, as much as of a gap without anything unknown.
    """
    baseline = outcome.calibration.baseline
    ranked = []
    for kind in KINDS:
        with suppress(SimulationError):
            start = beside_kind(baseline, kind)
            ranked.append((fit(start).cost, kind, start))
    if not ranked:
        return None
    left, kind, start = min(ranked, key=lambda one: one[0])
    if left > baseline.cost - rules.OF_A_KIND * (baseline.cost - baseline.problem.samples("used")):
        return None
    with suppress(SimulationError):
        there = beside_kind(_known_on(data, outcome), kind)
        found = _found(outcome, start, there, data)
        if found is not None and _complete(outcome, data, found, there):
            return replace(found, kind=kind)
    return None


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


def _complete(outcome: Outcome, data: HeldOut, found: Beside, there: Hypothesis) -> bool:
    """Whether ``found`` and the unknown force leave nothing but noise, or next to nothing of the gap, everywhere."""
    model = found.found.model
    both = there.with_model(adapted(data, model, model))
    for before, after in ((outcome.path[0], found.found), (_known_on(data, outcome), both)):
        least = before.problem.samples("used")
        gap, left = (float(np.sum(np.square(one.residual("used")))) - least for one in (before, after))
        if left > max((rules.STRUCTURED - 1.0) * least, (1.0 - rules.COMPLETE) * gap):
            return False
    return True


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
