"""A second search where a first one leaves structure: what acts beside an unknown force."""

from __future__ import annotations

from dataclasses import replace

from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.beam_search import search
from emps_design.discrepancy.search.calibration import calibrate
from emps_design.discrepancy.search.outcome import Outcome


def search_beside(outcome: Outcome, start: Hypothesis) -> Outcome:
    """Search again from ``start``, the baseline of ``outcome`` where an unknown force explains nothing.

    As any smooth function of the state it could follow most friction too; what happens at an instant, drifts, delays or
    repeats along the travel it cannot. A curve of any shape is one of them, and is not looked for.
    """
    first = outcome.calibration
    library = tuple(effect for effect in first.preparation.library if not effect.general and not effect.element)
    preparation = replace(first.preparation, start=start, library=library)
    return search(calibrate(preparation, start, first.floor, 0, 0, _silent), _silent)


def _silent(stage: str, done: float) -> None:
    """Nothing is told: this is part of the confirmation."""
