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
from emps_design.discrepancy.model.unknown_force import Kind
from emps_design.discrepancy.search.acceptance import force_rms
from emps_design.discrepancy.search.beside_force import acting, in_turn, next_to_nothing, only_noise, search_beside
from emps_design.discrepancy.search.outcome import Outcome
from emps_design.discrepancy.validation.confirmation import claims_on, standing
from emps_design.discrepancy.validation.evidence import Asked
from emps_design.discrepancy.validation.holdout import adapted
from emps_design.discrepancy.validation.rivals import alike_in_company
from emps_design.discrepancy.validation.robust import robust, widened
from emps_design.errors import SimulationError


@dataclass(frozen=True)
class Beside:
    """A fit judged beside an unknown force, how much of its effects the confirming data ask for, their equivalents.

    ``kind`` of ``KINDS`` is what the force is like; empty where it may be any function of the state. ``left`` [N] is
    the rms that the two leave, on training or confirming records, whichever is more; ``is_all`` whether that is nothing
    but noise on both, of so much that nothing else is to be said of the records.
    """

    found: Fit
    asked: list[Asked]
    equivalents: dict[str, list[str]]
    kind: str = ""
    left: float = np.inf
    is_all: bool = False

    @property
    def names(self) -> list[str]:
        """Names of the effects, without what is known from the controller's law."""
        return [one.name for one in self.asked]

    @property
    def is_an_answer(self) -> bool:
        """Whether it has effects to name, or nothing else is to be said: the records need no other model."""
        return bool(self.names) or self.is_all


def found_beside_kind(outcome: Outcome, data: HeldOut) -> Beside | None:
    """What the search found beside an unknown force of one kind, maybe nothing; None where there is no such force.

    Where the two leave next to nothing of the confirming ``data`` either, with the force fitted anew there.
    """
    force = outcome.of_a_kind
    if force is None:
        return None
    known = _known_on(data, outcome)
    before = (force.start, _on(data, known, force.start))
    with suppress(SimulationError):
        given = force.kind.beside_given()
        there = acting(_on(data, known, force.found), given)
        beside = _standing(force.outcome, force.found, there, data)
        start = beside.found if beside.names else force.outcome.path[0]
        beside = replace(beside, found=_in_the_loop(start, force.kind))
        after = (beside.found, evaluate(acting(_on(data, there, beside.found), given)))
        if all(map(next_to_nothing, before, after)):
            is_all = force.is_plain and all(only_noise(one, rules.AT_FLOOR) for one in after)
            return replace(beside, kind=force.kind.name, left=max(map(force_rms, after)), is_all=is_all)
    return None


def _in_the_loop(found: Fit, kind: Kind) -> Fit:
    """``found`` with its numbers and the force that acts fitted in turn; no number is known better than it moved."""
    fits = in_turn(found, kind)
    last = robust(fits[-1])
    return evaluate(last, last.slots, widened(last.covariance, [one.model.vector(last.slots) for one in fits]))


def found_beside_state(outcome: Outcome, data: HeldOut) -> Beside | None:
    """What a second search finds beside the state and the confirming ``data`` ask for there; None where nothing."""
    again = search_beside(outcome.calibration, beside_state(outcome.calibration.baseline))
    if again.best.model.names == outcome.path[0].model.names:
        return None
    found = again.calibration.judge.refitted(again.best)
    beside = _standing(again, found, beside_state(_known_on(data, outcome)), data)
    return beside if beside.names else None


def _known_on(data: HeldOut, outcome: Outcome) -> Hypothesis:
    """The model that the search began with, on the confirming ``data``."""
    return Hypothesis(data.problem, outcome.path[0].model.only(0))


def _on(data: HeldOut, there: Hypothesis, found: Fit) -> Hypothesis:
    """The model of ``found`` on the confirming ``data`` as they are judged ``there``."""
    return there.with_model(adapted(data, found.model, found.model))


def _standing(again: Outcome, found: Fit, there: Hypothesis, data: HeldOut) -> Beside:
    """What the confirming ``data`` ask for of what the search ``again`` ``found``, beside the force as it is ``there``.

    Empty where that is nothing.
    """
    data = replace(data, problem=there.problem)
    stands, _ = standing(data, found)
    return Beside(stands, claims_on(data, stands), alike_in_company(again, stands))


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
