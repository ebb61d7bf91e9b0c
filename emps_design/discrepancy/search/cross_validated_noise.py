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
from emps_design.discrepancy.model.missing_force import SLOWEST, since_reversal
from emps_design.discrepancy.search.starts import screen, tangent
from emps_design.effects import Effect
from emps_design.errors import SimulationError

RIDGES = tuple(10.0**power for power in range(-9, 1))  # of the mean square of a column; the best on strokes not seen
MOST_SAMPLES = 60_000  # of whole strokes, evenly taken where there are more
DEGREE = 4  # of the polynomials in position and in speed
FADING_TIMES = (0.02, 0.06, 0.2, 0.6)  # s since a reversal
FADING_WAYS = (1e-4, 5e-4, 2e-3, 1e-2)  # m since a reversal
MEMORIES = (0.03, 0.1, 0.3, 1.0, 3.0)  # s


def unpredicted(fitted: Fit, library: tuple[Effect, ...]) -> tuple[np.ndarray, ...]:
    """Force [N] of the used samples that the other strokes do not predict of each, one array per record.

    ``fitted`` is the baseline, judged without whitening: its innovations are forces.
    """
    problem = fitted.problem
    rows = _evenly(problem.strokes("used"))
    kept = np.concatenate([np.arange(stroke.start, stroke.stop) for stroke in rows])
    base = fitted.residual("used")[kept]
    states = tuple(smooth_of_state(run.q, problem.period) for run in fitted.runs())
    columns = [tangent(fitted, "used").basis[kept], problem.gather(states, "used")[kept]]
    for start in (start for found in screen(fitted, library, tangent(fitted)) for start in found):
        try:
            columns.append((start.hypothesis.residual("used")[kept] - base)[:, None])
        except SimulationError:
            continue
    design = np.column_stack(columns)
    size = np.linalg.norm(design, axis=0)
    edges = np.cumsum([0, *(stroke.stop - stroke.start for stroke in rows)])
    strokes = [slice(start, stop) for start, stop in pairwise(edges)]
    left = _left_by_others(design[:, size > 0] / size[size > 0], base, strokes)
    records = np.cumsum([split.used.sum() for split in problem.splits])
    return tuple(part for part in np.split(left, np.searchsorted(kept, records[:-1])) if part.size)


def _evenly(strokes: list[slice]) -> list[slice]:
    """Every so many of ``strokes``, so that the regression of a long record stays small."""
    samples = sum(stroke.stop - stroke.start for stroke in strokes)
    return strokes[:: max(1, -(-samples // MOST_SAMPLES))]


def smooth_of_state(q: np.ndarray, period: float) -> np.ndarray:
    """Smooth functions (n, k) of position ``q`` (n,) [m], velocity, and what came before: no physics assumed.

    A surface over position and velocity for each direction, what fades with the time and the way since a reversal, and
    fading memories of velocity, of direction, and of motion at all.
    """
    from numpy.polynomial.chebyshev import chebvander
    from scipy.signal import lfilter

    v = np.gradient(q, period)
    direction, speed = np.tanh(v / SLOWEST), np.abs(v) / np.abs(v).max()
    surface = (
        chebvander(2 * (q - q.min()) / np.ptp(q) - 1, DEGREE)[:, :, None] * chebvander(2 * speed - 1, DEGREE)[:, None]
    )
    surface = surface.reshape(q.size, -1)
    since = since_reversal(v)
    way = np.cumsum(np.abs(v)) * period
    way -= way[np.arange(q.size) - since]
    fading = [np.exp(-since * period / time) * direction for time in FADING_TIMES]
    fading += [np.exp(-way / distance) * direction for distance in FADING_WAYS]
    for time in MEMORIES:
        share = period / time
        faded = lfilter([share], [1.0, share - 1.0], np.column_stack([v, direction, np.abs(direction)]), axis=0)
        fading += [faded[:, 0], faded[:, 1], faded[:, 2] * direction]
    return np.column_stack([surface * (direction > 0)[:, None], surface * (direction <= 0)[:, None], *fading])


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
