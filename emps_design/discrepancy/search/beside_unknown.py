"""A second search where a first one leaves structure: what acts beside an unknown force."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit, evaluate, fit
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.model.unknown_force import KINDS, Columns, beside_kind, with_kind
from emps_design.discrepancy.search.beam_search import search
from emps_design.discrepancy.search.calibration import Calibration, calibrate
from emps_design.discrepancy.search.outcome import OfAKind, Outcome
from emps_design.errors import SimulationError

STARTS = 2  # models of the path beside which a kind of force is looked for


def search_beside(calibration: Calibration, start: Hypothesis) -> Outcome:
    """Search again from ``start``, the baseline of ``calibration`` where an unknown force explains nothing.

    As any smooth function of the state it could follow most friction too; what happens at an instant, drifts, delays or
    repeats along the travel it cannot. A curve of any shape is one of them, and is not looked for.
    """
    first = calibration.preparation
    library = tuple(effect for effect in first.library if not effect.general and not effect.element)
    preparation = replace(first, start=start, library=library)
    return search(calibrate(preparation, start, calibration.floor, 0, 0, _silent), _silent)


def of_a_kind(calibration: Calibration, path: Sequence[Fit]) -> OfAKind | None:
    """An unknown force of one kind, and what is found beside it, where the two leave next to nothing.

    Looked for beside the first of the models of ``path``, the baseline, and beside the second: a motor at its limit
    hides of which kind the rest is. None where there is no such force, or where there are no data to confirm it. An
    interrupt goes on to the search that asks.
    """
    if calibration.preparation.held_out is None:
        return None
    found = (_explained(calibration, start) for start in path[:STARTS])
    return next((force for force in found if force is not None), None)


def _explained(calibration: Calibration, start: Fit) -> OfAKind | None:
    """The force that leaves least beside ``start``, with what a search beside it finds; None where more is left."""
    best = _kind_beside(start)
    if best is None:
        return None
    kind, columns, beside = best
    with suppress(SimulationError):
        again = search_beside(calibration, Hypothesis(beside.problem, calibration.baseline.model))
        if again.interrupted:
            raise KeyboardInterrupt
        found = again.calibration.judge.refitted(again.best)
        if next_to_nothing(start, evaluate(with_kind(found, columns))):
            return OfAKind(kind, columns, start, again, found)
    return None


def next_to_nothing(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether ``after`` leaves nothing but noise, or next to nothing of the gap of ``before``."""
    return only_noise(after, rules.STRUCTURED) or _excess(after) <= (1.0 - rules.COMPLETE) * _excess(before)


def only_noise(hypothesis: Hypothesis, most: float) -> bool:
    """Whether ``hypothesis`` leaves no more than ``most`` times the whitened cost of noise."""
    return _excess(hypothesis) <= (most - 1.0) * hypothesis.problem.samples("used")


def _kind_beside(start: Fit) -> tuple[str, Columns, Fit] | None:
    """The kind of force beside which ``start`` leaves least, its columns and that fit; None where there is none.

    With more columns where these leave clearly less: else they would only take the part of something known.
    """
    fits = [(name, columns, one) for name, (columns, *_) in KINDS.items() for one in _fitted_beside(start, columns)]
    if not fits:
        return None
    name, columns, best = min(fits, key=lambda found: found[2].cost)
    for finer in KINDS[name][1:]:
        for one in _fitted_beside(start, finer):
            if _excess(one) < rules.SHARPER * _excess(best):
                columns, best = finer, one
    return (name, columns, best) if _excess(best) <= (1.0 - rules.OF_A_KIND) * _excess(start) else None


def _fitted_beside(start: Fit, columns: Columns) -> list[Fit]:
    """``start`` fitted beside an unknown force in the loop; nothing where it does not run with one."""
    with suppress(SimulationError):
        return [fit(with_kind(fit(beside_kind(start, columns)), columns))]
    return []


def _excess(hypothesis: Hypothesis) -> float:
    """Whitened cost over that of noise alone."""
    return float(np.sum(np.square(hypothesis.residual("used")))) - hypothesis.problem.samples("used")


def _silent(stage: str, done: float) -> None:
    """Nothing is told: this is part of a search, or of the confirmation."""
