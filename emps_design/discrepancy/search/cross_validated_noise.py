"""Noise where no reference repeats: what a stroke does that a regression on the other strokes does not predict.

The changes that all starts of all effects make in the force, those of the baseline's own numbers, and smooth functions
of the simulated state and its past are the columns of one ridge regression. It is fitted without one stroke and judged
on that stroke, in turn, so that no noise is explained by having been seen. What is left holds the noise, and the
structure that none of this follows: far less than the residual of the baseline alone.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from emps_design.discrepancy.model.fit import Fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import of_unit_length
from emps_design.discrepancy.model.state import states_of
from emps_design.discrepancy.search.starts import Start, screen, tangent
from emps_design.effects import Effect
from emps_design.errors import SimulationError

RIDGES = tuple(10.0**power for power in range(-9, 1))  # of the mean square of a column; the best on strokes not seen
MOST_SAMPLES = 60_000  # of whole strokes, evenly taken where there are more


def unpredicted(fitted: Fit, library: tuple[Effect, ...]) -> tuple[np.ndarray, ...]:
    """Force [N] of the used samples that the other strokes do not predict of each, one array per record.

    ``fitted`` is the baseline, judged without whitening: its innovations are forces.
    """
    problem = fitted.problem
    rows = _evenly(problem.strokes("used"))
    kept = np.concatenate([np.arange(stroke.start, stroke.stop) for stroke in rows])
    adjusted = tangent(fitted, "used")
    base = adjusted.whole[kept]

    def change(start: Start) -> np.ndarray:
        try:
            return of_unit_length((start.hypothesis.residual("used")[kept] - base)[:, None])
        except SimulationError:
            return np.empty((base.size, 0))

    columns = [of_unit_length(one) for one in (adjusted.basis[kept], problem.gather(states_of(fitted), "used")[kept])]
    screened = screen(fitted, library, tangent(fitted))
    design = np.column_stack(columns + side_by_side(change, [(start,) for found in screened for start in found]))
    edges = np.cumsum([0, *(stroke.stop - stroke.start for stroke in rows)])
    strokes = [slice(start, stop) for start, stop in pairwise(edges)]
    left = _left_by_others(design, base, strokes)
    records = np.cumsum([split.used.sum() for split in problem.splits])
    return tuple(part for part in np.split(left, np.searchsorted(kept, records[:-1])) if part.size)


def _evenly(strokes: list[slice]) -> list[slice]:
    """Every so many of ``strokes``, so that the regression of a long record stays small."""
    samples = sum(stroke.stop - stroke.start for stroke in strokes)
    return strokes[:: max(1, -(-samples // MOST_SAMPLES))]


def _left_by_others(columns: np.ndarray, force: np.ndarray, strokes: list[slice]) -> np.ndarray:
    """``force`` (n,) less what ``columns`` (n, k) predict of each stroke from all others."""
    squares = [columns[s].T @ columns[s] for s in strokes]
    products = [columns[s].T @ force[s] for s in strokes]
    square, product = np.sum(squares, axis=0), np.sum(products, axis=0)
    trials = []
    for ridge in RIDGES:
        keep = ridge * np.trace(square) / len(square) * np.eye(len(square))
        left = [
            force[s] - columns[s] @ np.linalg.solve(square - own + keep, product - along)
            for s, own, along in zip(strokes, squares, products, strict=True)
        ]
        trials.append(np.concatenate(left))
    return min(trials, key=lambda left: float(left @ left))
