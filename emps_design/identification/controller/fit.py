"""Least squares of one structure: linear gains and the integral time inside, the filters' numbers outside.

The regressors of a record are compressed once to a triangle (QR), on which every structure is tried without touching
the samples again. The filters' numbers are found by Gauss and Newton: their derivatives are further columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from emps_design.identification.controller.estimators import STEP, at_step, sought
from emps_design.identification.controller.filters import Filter, derivatives, filtered, moved
from emps_design.identification.controller.regressors import COLUMNS, Signals, Timing, regressors
from emps_design.identification.controller.structures import Structure

SCAN, FINE_SCAN = 41, 21  # integral rates tried, from one that does nothing on to a third of the sampling frequency
NEAR = 1.5  # times the last integral rate, while filters move
ROUNDS = 30  # of Gauss and Newton, at most
LARGEST = 0.5  # change of a filter's number in one round
SHORTER, SHORTEST = 0.3, 1e-3  # share of a step that is tried where the whole one gained nothing
CONVERGED = 1e-9  # of the cost
RANK = 1e-10  # of the largest singular value: columns that are smaller tell nothing


@dataclass(frozen=True)
class Fit:
    """A structure with its numbers: integral rate ``wi`` [1/s], ``linear`` coefficients, ``filters``; ``cost`` is the
    sum of squares that is left of ``samples``."""

    structure: Structure
    timing: Timing
    filters: tuple[Filter, ...]
    wi: float
    linear: np.ndarray
    cost: float
    samples: int

    @property
    def size(self) -> int:
        """How many numbers were fitted."""
        own = sum(len(f.numbers) for f in self.filters)
        own += self.structure.velocity and sought(self.timing.velocity_estimator)
        return self.structure.size + own

    @property
    def criterion(self) -> float:
        """Bayesian information criterion."""
        n = self.samples
        return n * float(np.log(self.cost / n)) + self.size * float(np.log(n)) + self.timing.surprise

    @property
    def stabilising(self) -> bool:
        """Whether it feeds back with the sign of a controller."""
        return bool(self.structure.stabilising(self.linear))

    @property
    def gain(self) -> float:
        """Gain of the velocity loop, 0 where there is none."""
        part = dict(zip(self.structure.linear, self.linear, strict=True))
        return float(part.get("following", 0.0) + part.get("damping", 0.0))

    @property
    def position_rate(self) -> float:
        """Gain of the position loop [1/s], 0 where it or the velocity loop is missing."""
        part = dict(zip(self.structure.linear, self.linear, strict=True))
        return float(part.get("position", 0.0)) / self.gain if self.gain else 0.0

    @property
    def beta(self) -> np.ndarray:
        """Coefficients of the regressors, (len(COLUMNS),)."""
        return self.structure.combination(self.wi) @ self.linear


@dataclass(frozen=True)
class Compressed:
    """Regressors, filter derivatives and command of one record, as a triangle of as many rows."""

    table: np.ndarray  # (rows, len(COLUMNS)), each column over its norm
    norms: np.ndarray
    slopes: np.ndarray  # (rows, n_numbers)
    target: np.ndarray
    rest: float  # sum of squares that no column reaches
    samples: int


def compress(signals: Signals, columns: np.ndarray, slopes: np.ndarray | None = None) -> Compressed:
    """Take ``columns`` (n, len(COLUMNS)) behind the filters, and ``slopes`` (n, n_numbers), to a triangle."""
    slopes = np.zeros((len(signals), 0)) if slopes is None else slopes
    stacked = signals.counted(np.column_stack([columns, slopes, signals.command]))
    norms = np.linalg.norm(stacked, axis=0)
    norms[norms == 0.0] = 1.0
    triangle = np.asarray(np.linalg.qr(stacked / norms, mode="r"))
    width = len(COLUMNS)
    target = triangle[:, -1] * norms[-1]
    table = triangle[:-1]
    return Compressed(
        table[:, :width], norms[:width], table[:, width:-1] * norms[width:-1], target[:-1],
        float(target[-1] ** 2), int(signals.used.sum()),
    )  # fmt: skip


def solve(
    c: Compressed, structure: Structure, period: float, within: tuple[float, float] | None = None
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Best integral rate ``within`` bounds [1/s], linear coefficients, steps of the filters' numbers, squares left."""
    table = c.table * c.norms

    def scaled(wi: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns = table @ structure.combination(wi)
        slopes = np.broadcast_to(c.slopes, (*columns.shape[:-1], c.slopes.shape[1]))
        columns = np.concatenate([columns, slopes], axis=-1)
        scale = np.linalg.norm(columns, axis=-2)
        scale[scale == 0.0] = 1.0
        return columns / scale[..., None, :], scale

    def at(wi: float) -> tuple[float, np.ndarray, np.ndarray]:
        columns, scale = scaled(wi)
        found = np.linalg.lstsq(columns, c.target, rcond=RANK)[0]
        left, found = c.target - columns @ found, found / scale
        width = len(found) - c.slopes.shape[1]
        return float(left @ left) + c.rest, found[:width], found[width:]

    def left_by(rates: np.ndarray) -> np.ndarray:
        """Squares (k,) that each of the ``rates`` leaves, but for the rest; all of them in one decomposition."""
        sides, sizes, _ = np.linalg.svd(scaled(rates)[0], full_matrices=False)
        reached = (sides.swapaxes(1, 2) @ c.target) * (sizes > RANK * sizes[:, :1])
        return np.sum((c.target - (sides @ reached[..., None])[..., 0]) ** 2, axis=1)

    if not structure.form:
        cost, linear, steps = at(0.0)
        return 0.0, linear, steps, cost
    low, high = within or (1e-3 / (c.samples * period), 0.3 / period)
    # Twice, for a position loop and an integral of nearly one rate may change places: two minima side by side.
    for count in (SCAN, FINE_SCAN) if within is None else (FINE_SCAN,):
        tried = np.geomspace(low, high, count)
        best = int(np.argmin(left_by(tried)))
        low, high = tried[max(best - 1, 0)], tried[min(best + 1, count - 1)]
    found = minimize_scalar(
        lambda x: at(np.exp(x))[0], bounds=(np.log(low), np.log(high)), method="bounded", options={"xatol": 1e-9}
    )
    wi = float(np.exp(found.x))
    cost, linear, steps = at(wi)
    return wi, linear, steps, cost


def fit(
    signals: Signals,
    start: Fit,
    limited: np.ndarray | None = None,
    within: tuple[float, float] | None = None,
) -> Fit:
    """Fit the structure of ``start``, from its filters on; the integral rate ``within`` bounds [1/s].

    ``limited`` (n,) says in which samples the limit acts, so that the integral part stands still.
    """
    period = signals.period
    best: Fit | None = None
    trial, timing, move, share = start.filters, start.timing, np.zeros(0), 1.0
    raw = regressors(signals, timing, limited)
    for _ in range(ROUNDS):
        columns = filtered(trial, raw, period)
        compressed = compress(signals, columns)
        wi, linear, _, cost = solve(compressed, start.structure, period, within)
        now = Fit(start.structure, timing, trial, wi, linear, cost, compressed.samples)
        if best is not None and not now.cost < best.cost:
            share *= SHORTER
            if share < SHORTEST or now.cost - best.cost < CONVERGED * best.cost:
                break
            trial, timing = all_moved(best.filters, best.timing, share * move, period)
            raw = regressors(signals, timing, limited)
            continue
        gained = np.inf if best is None else best.cost - now.cost
        best, share = now, 1.0
        if not (trial or sought(timing.velocity_estimator)) or gained < CONVERGED * now.cost:
            break
        slopes = derivatives(trial, raw @ now.beta, period)
        slopes = np.column_stack([slopes, *estimator_slope(signals, now, limited)])
        near = within or (wi / NEAR, wi * NEAR)
        move = np.clip(solve(compress(signals, columns, slopes), start.structure, period, near)[2], -LARGEST, LARGEST)
        trial, timing = all_moved(trial, timing, move, period)
        raw = regressors(signals, timing, limited) if timing != now.timing else raw
    assert best is not None
    return best


def estimator_slope(signals: Signals, found: Fit, limited: np.ndarray | None) -> list[np.ndarray]:
    """How the command (n,) changes with the logarithm of the estimator's number; none where it has none to seek."""
    estimator, period = found.timing.velocity_estimator, signals.period
    if not (found.structure.velocity and sought(estimator)):
        return []
    ends = []
    for step in (STEP, -STEP):
        timing = replace(found.timing, velocity_estimator=at_step(estimator, step, period))
        ends.append(regressors(signals, timing, limited) @ found.beta)
    return [filtered(found.filters, (ends[0] - ends[1]) / (2.0 * STEP), period)]


def all_moved(
    filters: tuple[Filter, ...], timing: Timing, steps: np.ndarray, period: float
) -> tuple[tuple[Filter, ...], Timing]:
    """Filters and estimator with their numbers changed by ``steps``, the estimator's the last, if it is sought."""
    count = sum(len(one.numbers) for one in filters)
    if steps.size > count:
        estimator = at_step(timing.velocity_estimator, float(steps[count]), period)
        timing = replace(timing, velocity_estimator=estimator)
    return moved(filters, steps, period), timing
