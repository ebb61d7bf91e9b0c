"""A second search where a first one leaves structure: what acts beside an unknown function of the state."""

from __future__ import annotations

from dataclasses import replace

from emps_design.discrepancy.model.state import beside_state
from emps_design.discrepancy.search.beam_search import search
from emps_design.discrepancy.search.calibration import calibrate
from emps_design.discrepancy.search.outcome import Outcome


def search_beside_state(outcome: Outcome) -> Outcome:
    """Search again from the baseline of ``outcome``, where smooth functions of the state explain nothing.

    They could follow most of an unknown force, and most friction too; what happens at an instant, drifts, delays or
    repeats along the travel they cannot. A curve of any shape is one of them, and is not looked for.
    """
    first = outcome.calibration
    library = tuple(effect for effect in first.preparation.library if not effect.general and not effect.element)
    start = beside_state(first.baseline)
    preparation = replace(first.preparation, start=start, library=library)
    return search(calibrate(preparation, start, first.floor, 0, 0, _silent), _silent)


def _silent(stage: str, done: float) -> None:
    """Nothing is told: this is part of the confirmation."""
