"""Searches beside an unknown force: of one kind, or any function of the state."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit, fit
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.model.unknown_force import KINDS, Kind, beside_kind, with_kind
from emps_design.discrepancy.search.beam_search import A_FEW, begun, finished, until_interrupted, with_before
from emps_design.discrepancy.search.calibration import Calibration, calibrate
from emps_design.discrepancy.search.outcome import OfAKind, Outcome
from emps_design.errors import SimulationError
from emps_design.progress import Progress, untold

STARTS = 2  # models of the path beside which a kind of force is looked for
IN_TURN = 3  # times that a force in the loop and the numbers beside it are fitted


def search_or_kind(calibration: Calibration, progress: Progress, before: Outcome | None = None) -> Outcome:
    """A search, stopped at an unknown force of one kind that explains what a few effects leave.

    What a search found ``before``, under other noise, is tried as well, beside such a force too.

    Looked for where there are data to confirm it, beside the baseline and beside the effect found first: a motor at its
    limit, or a stop, hides of which kind the rest is.
    """
    outcome, found = begun(calibration, progress, A_FEW), list[OfAKind]()

    def look(path: list[Fit]) -> None:
        progress("whether it is an unknown force of one kind", 0.6)
        found.extend(_of_a_kind(calibration, path, before.of_a_kind if before else None))

    confirmed = calibration.preparation.held_out is not None
    if confirmed and not outcome.interrupted and calibration.judge.leaves_structure(outcome.best):
        outcome = replace(until_interrupted(outcome, look), of_a_kind=found[0] if found else None)
    model = None if before is None else before.best.model
    return finished(outcome, progress, model) if outcome.of_a_kind is None else outcome


def past_the_kind(outcome: Outcome, progress: Progress) -> Outcome:
    """A search that was stopped at an unknown force, gone on with unless the force is plain: that ends it early."""
    return finished(outcome, progress) if outcome.stopped else outcome


def search_beside(calibration: Calibration, start: Hypothesis) -> Outcome:
    """Search again from ``start``, the baseline of ``calibration`` where an unknown force explains nothing.

    As any smooth function of the state it could follow most friction too; what happens at an instant, drifts, delays or
    repeats along the travel it cannot. A curve of any shape is one of them, and is not looked for.
    """
    return _finished_beside(_begun_beside(calibration, start))


def _begun_beside(calibration: Calibration, start: Hypothesis) -> Outcome:
    """The search beside an unknown force up to as many effects as it takes pains with."""
    first = calibration.preparation
    library = tuple(effect for effect in first.library if not effect.general and not effect.element)
    preparation = replace(first, start=start, library=library)
    return begun(calibrate(preparation, start, calibration.floor, 0, 0, untold), untold, rules.CREDIBLE)


def _finished_beside(outcome: Outcome) -> Outcome:
    """The search beside an unknown force to its end: more effects than it takes pains with would stand in for it."""
    return finished(outcome, untold, most=rules.CREDIBLE)


def _of_a_kind(calibration: Calibration, path: list[Fit], before: OfAKind | None) -> list[OfAKind]:
    """The first kind of force that leaves next to nothing beside a start of ``path`` and what is found beside it.

    Or what was found beside one ``before``, where that leaves less. Else nothing, and nothing either where the effects
    of ``path`` alone leave less; a search that leaves structure beside the force is not gone on with. An interrupt goes
    on to the search that asks.
    """
    for kind, start, beside in _kinds_beside(path[:STARTS]):
        with suppress(SimulationError):
            problem = in_turn(beside, kind)[-1].problem
            again = _begun_beside(calibration, Hypothesis(problem, calibration.baseline.model))
            if before is not None and not again.interrupted:
                again = with_before(again, before.found.model)
            if not again.calibration.judge.leaves_structure(again.best):
                again = _finished_beside(again)
            if again.interrupted:
                raise KeyboardInterrupt
            found = in_turn(again.calibration.judge.refitted(again.best), kind)[-1]
            if next_to_nothing(start, found) and found.excess() < path[-1].excess():
                return [OfAKind(kind, start, again, found)]
    return []


def in_turn(fitted: Fit, kind: Kind) -> list[Fit]:
    """Fits of the model of ``fitted`` to all that may be used, each with the force in the loop that the last one left.

    Raises :class:`SimulationError` where the model does not run with it.
    """
    fits = []
    for _ in range(IN_TURN):
        fitted = fit(with_kind(fitted, kind), "used")
        fits.append(fitted)
    return fits


def acting(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """``hypothesis`` with an unknown force in the loop, found again with that. Raises as :func:`in_turn`."""
    for _ in range(IN_TURN):
        hypothesis = with_kind(hypothesis, kind)
    return hypothesis


def next_to_nothing(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether ``after`` leaves nothing but noise, or next to nothing of the gap of ``before``."""
    return only_noise(after, rules.STRUCTURED) or after.excess() <= (1.0 - rules.COMPLETE) * before.excess()


def only_noise(hypothesis: Hypothesis, most: float) -> bool:
    """Whether ``hypothesis`` leaves no more than ``most`` times the whitened cost of noise."""
    return hypothesis.excess() <= (most - 1.0) * hypothesis.problem.samples("used")


def _kinds_beside(starts: list[Fit]) -> list[tuple[Kind, Fit, Fit]]:
    """The kinds of force that are a good part of what one of ``starts`` leaves, that start, and the fit beside them.

    The one that leaves least first, after those that are part of it; beside a later start only what leaves clearly less
    than all others, as it may itself stand in for the force.
    """
    found = []
    for place, start in enumerate(starts):
        for related in KINDS:
            fits = [(kind, start, one) for degrees in related for kind, one in _of_few_columns(start, degrees)]
            good = [one for one in fits if one[-1].excess() <= (1.0 - rules.OF_A_KIND) * start.excess()]
            if good:
                found.append((min(one.cost for *_, one in good) / rules.SHARPER**place, good))
    return [one for _, good in sorted(found, key=lambda ranked: ranked[0]) for one in good]


def _of_few_columns(start: Fit, degrees: tuple[Kind, ...]) -> list[tuple[Kind, Fit]]:
    """The first of ``degrees`` beside which ``start`` runs, and the fit; none where there is none.

    With more columns where these leave clearly less: else they would only take the part of something known.
    """
    fits = [(kind, one) for kind in degrees for one in _fitted_beside(start, kind)]
    best = fits[:1]
    for kind, one in fits[1:]:
        if one.excess() < rules.SHARPER * best[0][1].excess():
            best = [(kind, one)]
    return best


def _fitted_beside(start: Fit, kind: Kind) -> list[Fit]:
    """``start`` fitted beside an unknown force in the loop; nothing where it does not run with one."""
    with suppress(SimulationError):
        return [fit(with_kind(fit(beside_kind(start, kind)), kind))]
    return []
