"""Noise where no reference repeats: what a stroke does that a regression on the other strokes does not predict.

The changes that the baseline's own numbers make in the force are the columns of a ridge regression; the changes that
the starts of an effect make, and smooth functions of the simulated state and its past, join it where that pays. It is
fitted without one stroke and judged on that stroke, in turn, so that no noise is explained by having been seen. What is
left holds the noise, and the structure that none of this follows: far less than the residual of the baseline alone.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import of_unit_length
from emps_design.discrepancy.model.state import states_of
from emps_design.discrepancy.search.starts import Start, screen, tangent
from emps_design.effects import Effect
from emps_design.errors import SimulationError

RIDGES = tuple(10.0**power for power in range(-9, 1))  # of the mean square of a column; the best on strokes not seen
MOST_SAMPLES, MOST_STROKES = 60_000, 100  # of whole strokes, evenly taken where there are more


def unpredicted(fitted: Fit, library: tuple[Effect, ...]) -> tuple[np.ndarray, ...]:
    """Force [N] of the used samples that the other strokes do not predict of each, one array per record.

    ``fitted`` is the baseline, judged without whitening: its innovations are forces.
    """
    problem = fitted.problem
    rows = _evenly(problem.strokes("used"))
    kept = np.concatenate([np.arange(stroke.start, stroke.stop) for stroke in rows])
    adjusted = tangent(fitted, "used")
    base = adjusted.whole[kept]

    def changes(found: list[Start]) -> np.ndarray:
        columns = [np.empty((base.size, 0))]
        for start in found:
            with suppress(SimulationError):
                columns.append(of_unit_length((start.hypothesis.residual("used")[kept] - base)[:, None]))
        return np.column_stack(columns)

    def smooth() -> np.ndarray:
        return of_unit_length(problem.gather(states_of(fitted), "used")[kept])

    screened = screen(fitted, library, tangent(fitted))
    groups = side_by_side(lambda group: group(), [(smooth,), *((partial(changes, found),) for found in screened)])
    edges = np.cumsum([0, *(stroke.stop - stroke.start for stroke in rows)])
    strokes = [slice(start, stop) for start, stop in pairwise(edges)]
    left = _left_by_others(of_unit_length(adjusted.basis[kept]), groups, base, strokes)
    records = np.cumsum([split.used.sum() for split in problem.splits])
    return tuple(part for part in np.split(left, np.searchsorted(kept, records[:-1])) if part.size)


def _evenly(strokes: list[slice]) -> list[slice]:
    """Every so many of ``strokes``, so that the regression of a long record stays small."""
    samples = sum(stroke.stop - stroke.start for stroke in strokes)
    return strokes[:: max(1, -(-samples // MOST_SAMPLES), -(-len(strokes) // MOST_STROKES))]


def _left_by_others(known: np.ndarray, groups: list[np.ndarray], force: np.ndarray, strokes: list[slice]) -> np.ndarray:
    """``force`` (n,) less what columns predict of each stroke from all others.

    The columns (n, k) are those ``known`` and of the ``groups``, one after the other, the one that leaves least, as
    long as it shows that what was left was no noise.
    """
    regression = _Regression([known, *groups], force, strokes)
    edges = np.cumsum([0, known.shape[1], *(group.shape[1] for group in groups)])
    own, *others = (np.arange(start, stop) for start, stop in pairwise(edges))
    best = regression.best(own)
    while others:
        trials = side_by_side(regression.best, [(np.concatenate([best.columns, other]),) for other in others])
        place = int(np.argmin([trial.squares for trial in trials]))
        if trials[place].squares > rules.FINER**2 * best.squares:
            break
        best = trials[place]
        del others[place]
    return regression.left(best)


class _Predictor(NamedTuple):
    """Some ``columns``, by place, with the ``ridge`` that leaves the least ``squares`` of strokes not seen."""

    columns: np.ndarray
    ridge: float
    squares: float


class _Regression:
    """Of a force (n,) on ``groups`` of columns (n, k), fitted without each of the strokes and judged on it.

    By sums of products along each stroke.
    """

    def __init__(self, groups: list[np.ndarray], force: np.ndarray, strokes: list[slice]) -> None:
        self.groups, self.force, self.strokes = groups, force, strokes
        sums = side_by_side(self._sums, [(stroke,) for stroke in strokes])
        self.squares, self.products = (np.array(one) for one in zip(*sums, strict=True))
        self.power = float(force @ force)

    def best(self, columns: np.ndarray) -> _Predictor:
        """``columns`` with the best of the ridges."""
        own, along = self.squares[:, columns[:, None], columns], self.products[:, columns]
        costs = []
        for ridge in RIDGES:
            x = self._coefficients(own, along, ridge)
            costs.append(self.power + float(np.einsum("si,sij,sj", x, own, x) - 2.0 * np.sum(x * along)))
        least = int(np.argmin(costs))
        return _Predictor(columns, RIDGES[least], costs[least])

    def left(self, found: _Predictor) -> np.ndarray:
        """Force (n,) [N] that ``found`` does not predict."""
        own, along = self.squares[:, found.columns[:, None], found.columns], self.products[:, found.columns]
        coefficients = self._coefficients(own, along, found.ridge)

        def along_one(stroke: slice, x: np.ndarray) -> np.ndarray:
            return self.force[stroke] - self._columns(stroke)[:, found.columns] @ x

        return np.concatenate(side_by_side(along_one, zip(self.strokes, coefficients, strict=True)))

    def _columns(self, stroke: slice) -> np.ndarray:
        """All columns along one stroke."""
        return np.column_stack([group[stroke] for group in self.groups])

    def _sums(self, stroke: slice) -> tuple[np.ndarray, np.ndarray]:
        """Squares (k, k) of the columns along one stroke, and their products (k,) with the force."""
        columns = self._columns(stroke)
        return columns.T @ columns, columns.T @ self.force[stroke]

    @staticmethod
    def _coefficients(own: np.ndarray, along: np.ndarray, ridge: float) -> np.ndarray:
        """Those fitted to all strokes but one, (strokes, k)."""
        square = own.sum(axis=0)
        keep = ridge * np.trace(square) / len(square) * np.eye(len(square))
        return np.linalg.solve(square - own + keep, (along.sum(axis=0) - along)[:, :, None])[:, :, 0]
