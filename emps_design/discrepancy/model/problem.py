"""The records to explain, their noise, and the whitened closed-loop residual of a candidate model."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy.model.candidate import Candidate, Slot
from emps_design.discrepancy.model.following import drive
from emps_design.discrepancy.model.partition import Split
from emps_design.errors import SimulationError
from emps_design.records import Record
from emps_design.simulation import Plant

LOOSE = 1e5  # times the integrator's tolerance: force within 1e-3 N, a thousandth of any noise here, four times faster
STEP = 1e-3  # finite difference of a sensitivity, in scales of the number
NUDGE = 2e-4  # finite difference, in scales of the parameter
BOLDEST = 0.5  # largest step of a fit, in scales of the parameter: a period must not jump over its neighbours
CLUSTER = 500  # samples that structure in a residual spans, for the deviations of what was fitted
WORST = 1e12  # cost of a model that cannot be simulated: finite, so that a fit steps back from it


@dataclass(frozen=True)
class Whitening:
    """Autoregressive model of the force noise: ``coefficients`` (p + 1,), first 1; the innovation's ``std`` [N]."""

    coefficients: np.ndarray
    std: float

    def apply(self, residual: np.ndarray) -> np.ndarray:
        """Innovations of ``residual`` (n,) [N] in units of their standard deviation."""
        from scipy.signal import lfilter

        return lfilter(self.coefficients, (1.0,), residual) / self.std

    def undo(self, innovations: np.ndarray) -> np.ndarray:
        """Force noise (n,) [N] that :meth:`apply` makes into ``innovations`` (n,)."""
        from scipy.signal import lfilter

        return self.std * lfilter((1.0,), self.coefficients, innovations)


@dataclass(frozen=True)
class Problem:
    """Records of one axis and what is needed to judge a model of them.

    The encoder is taken as exact inside a fit, so that the residual is a smooth function of the parameters; its
    quantisation is part of the noise.
    """

    axis: Axis
    records: tuple[Record, ...]
    splits: tuple[Split, ...]
    whitening: Whitening
    plants: dict[tuple[str, ...], Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def period(self) -> float:
        """Sampling period [s], one for all records."""
        return self.records[0].period

    def plant(self, model: Candidate) -> Plant:
        """The compiled plant with the effects of ``model``, made once a set."""
        if model.names not in self.plants:
            self.plants[model.names] = Plant.of(model.to_axis(self.axis))
        return self.plants[model.names]

    def runs(self, model: Candidate) -> tuple[Any, ...]:
        """Closed-loop simulations from ``q_ref`` alone (of the recorded motion without a controller), one a record."""
        return tuple(self.run(model, record) for record in range(len(self.records)))

    def run(self, model: Candidate, record: int, disturbance: np.ndarray | None = None) -> Any:
        """Simulation of one record, by its number, with a ``disturbance`` (n,) [N] of the carriage."""
        how = drive(self.axis, self.records[record])
        if disturbance is not None:
            how["disturbance"] = disturbance + (0.0 if how["disturbance"] is None else how["disturbance"])
        return self.plant(model).closed_loop(
            **how,
            baseline=model.baseline,
            parameters=model.parameters(record),
            quantise=False,
            tolerance=LOOSE,
        )

    def residuals(self, model: Candidate) -> tuple[np.ndarray, ...]:
        """Measured minus simulated motor force [N], one array (n,) a record."""
        gain = self.axis.drive.force_gain
        return tuple(gain * r.u - run.force for r, run in zip(self.records, self.runs(model), strict=True))

    def whitened(self, model: Candidate) -> tuple[np.ndarray, ...]:
        """Innovations of :meth:`residuals` in units of the noise."""
        return tuple(self.whitening.apply(r) for r in self.residuals(model))

    def only(self, record: int) -> Problem:
        """One of the records, by its number, as a problem of its own; its models are :meth:`Candidate.only`."""
        return replace(self, records=(self.records[record],), splits=(self.splits[record],))

    def masks(self, part: str) -> tuple[np.ndarray, ...]:
        """Boolean samples of ``part``: "fit", "select" or "used"."""
        return tuple(getattr(s, part) for s in self.splits)

    def left(self, model: Candidate) -> tuple[np.ndarray, ...]:
        """What ``model`` leaves of the force [N] of the used samples, one array (n_used,) a record."""
        return tuple(r[mask] for r, mask in zip(self.residuals(model), self.masks("used"), strict=True))

    def strokes(self, part: str) -> list[slice]:
        """The strokes of all records as pieces of the samples of ``part``, gathered in one vector."""
        edges, before = {0}, 0
        for split, mask in zip(self.splits, self.masks(part), strict=True):
            seen = np.concatenate(([0], np.cumsum(mask)))
            edges.update(before + int(seen[stop]) for _, stop in split.strokes)
            before += int(seen[-1])
            edges.add(before)
        return [slice(start, stop) for start, stop in itertools.pairwise(sorted(edges))]

    def samples(self, part: str) -> int:
        """Number of samples of ``part``: the whitened cost that noise alone leaves."""
        return int(sum(mask.sum() for mask in self.masks(part)))

    def with_whitening(self, whitening: Whitening) -> Problem:
        """The same records judged with other noise."""
        return replace(self, whitening=whitening)


@dataclass(frozen=True)
class Fit:
    """A fitted model: its whitened residuals, and the covariance (k, k) of the numbers in ``slots``."""

    model: Candidate
    slots: tuple[Slot, ...]
    covariance: np.ndarray
    innovations: tuple[np.ndarray, ...]
    cost_fit: float
    cost_select: float

    @property
    def cost(self) -> float:
        """Sum of squared innovations over fitting and selecting samples."""
        return self.cost_fit + self.cost_select

    def std(self, effect: int, place: int, record: int = 0) -> float:
        """Standard deviation of one number; 0 where it was not free."""
        for i, slot in enumerate(self.slots):
            if slot.effect == effect and slot.place == place and slot.record in (None, record):
                return float(np.sqrt(max(self.covariance[i, i], 0.0)))
        return 0.0


def fit(
    problem: Problem, start: Candidate, part: str = "fit", slots: tuple[Slot, ...] | None = None, steps: int = 12
) -> Fit:
    """Fit ``start`` to the closed-loop force on the samples of ``part``; ``slots`` (default: all) says what is free."""
    slots = start.slots() if slots is None else slots
    found = descend(start, slots, lambda model: gather(problem, problem.whitened(model), part), steps)
    return evaluate(problem, found.model, slots, found.covariance)


@dataclass(frozen=True)
class Descent:
    """Where a descent ended: the model, its sum of squares, and the covariance of the free numbers."""

    model: Candidate
    cost: float
    covariance: np.ndarray


def descend(
    start: Candidate, slots: tuple[Slot, ...], residual: Callable[[Candidate], np.ndarray], steps: int
) -> Descent:
    """Minimise the sum of squares of ``residual`` over ``slots`` by Levenberg-Marquardt; bounds hold at every step.

    A model that cannot be simulated counts as infinitely bad: the descent steps back from it.
    """

    def attempt(model: Candidate) -> np.ndarray | None:
        try:
            return residual(model)
        except SimulationError:
            return None

    scale = np.array([s.scale for s in slots])
    lower = np.array([s.quantity.lower for s in slots]) / scale
    upper = np.array([s.quantity.upper for s in slots]) / scale
    model, x = start, start.vector(slots) / scale
    current = attempt(model)
    if current is None or not slots:
        cost = WORST if current is None else float(current @ current)
        return Descent(start, cost, np.zeros((len(slots),) * 2))
    damping, jacobian = 1e-3, np.zeros((current.size, len(slots)))
    for _ in range(steps):
        for k in range(len(slots)):
            step = NUDGE if x[k] + NUDGE <= upper[k] else -NUDGE
            moved = x.copy()
            moved[k] += step
            shifted = attempt(model.with_vector(slots, moved * scale))
            jacobian[:, k] = 0.0 if shifted is None else (shifted - current) / step
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ current
        cost, gain = float(current @ current), 0.0
        for _ in range(6):
            free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)))
            lhs = normal[np.ix_(free, free)] + damping * np.diag(np.diag(normal)[free] + 1e-9)
            move = np.zeros_like(x)
            move[free] = -np.linalg.lstsq(lhs, gradient[free], rcond=None)[0]
            trial_x = np.clip(x + np.clip(move, -BOLDEST, BOLDEST), lower, upper)
            trial = model.with_vector(slots, trial_x * scale)
            reached = attempt(trial)
            if reached is not None and float(reached @ reached) < cost:
                gain = cost - float(reached @ reached)
                model, x, current = trial, trial_x, reached
                damping = max(damping / 10, 1e-7)
                break
            damping = min(damping * 10, 1e6)
        if gain < 1e-4 * cost + 0.1:
            break
    covariance = _covariance(jacobian, current) * np.outer(scale, scale)
    return Descent(model, float(current @ current), covariance)


def _covariance(jacobian: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Covariance (k, k) of a least-squares fit that leaves ``left`` (n,), in standard deviations of the noise.

    Where the model leaves structure its numbers are less sure than noise alone would make them: by its size, and, as
    structure goes on for a while and pulls at the numbers, by how far the pull differs from piece to piece of the
    record (the sandwich of Huber and White, pieces as clusters). The larger of the two holds for each number.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    covariance = inverse * max(1.0, float(left @ left) / left.size)
    starts = np.arange(0, left.size, CLUSTER)
    pulls = np.add.reduceat(jacobian * left[:, None], starts, axis=0)
    pulls -= pulls.mean(axis=0)
    spread = inverse @ (pulls.T @ pulls) @ inverse
    wider = np.sqrt(np.maximum(1.0, np.diag(spread) / np.maximum(np.diag(covariance), 1e-300)))
    return covariance * np.outer(wider, wider)


def gather(problem: Problem, signals: tuple[np.ndarray, ...], part: str) -> np.ndarray:
    """The samples of ``part`` of one signal a record, in one vector."""
    return np.concatenate([signal[mask] for signal, mask in zip(signals, problem.masks(part), strict=True)])


def sensitivities(problem: Problem, fitted: Fit, slots: tuple[Slot, ...], part: str) -> np.ndarray:
    """What ``STEP`` scales of each number in ``slots`` change in the whitened residual on ``part``, (n, k)."""
    model, base = fitted.model, gather(problem, fitted.innovations, part)
    x, columns = model.vector(slots), []
    for k, slot in enumerate(slots):
        moved = x.copy()
        moved[k] += STEP * slot.scale * (1 if x[k] + STEP * slot.scale <= slot.quantity.upper else -1)
        columns.append(gather(problem, problem.whitened(model.with_vector(slots, moved)), part) - base)
    return np.column_stack(columns)


def evaluate(
    problem: Problem, model: Candidate, slots: tuple[Slot, ...] = (), covariance: np.ndarray | None = None
) -> Fit:
    """Judge ``model`` as it is on the fitting and on the selecting samples."""
    try:
        innovations = problem.whitened(model)
    except SimulationError:
        return Fit(model, slots, np.zeros((len(slots),) * 2), (), WORST, WORST)
    costs = [
        sum(float(w[m] @ w[m]) for w, m in zip(innovations, problem.masks(part), strict=True))
        for part in ("fit", "select")
    ]
    return Fit(model, slots, np.zeros((len(slots),) * 2) if covariance is None else covariance, innovations, *costs)


ORDER = 24  # of the autoregressive model of the noise


def yule_walker(lags: np.ndarray) -> Whitening:
    """Autoregressive model of noise with autocovariance ``lags`` (order + 1,) [N^2]."""
    from scipy.linalg import solve_toeplitz

    lags = lags * np.concatenate(([1 + 1e-9], np.ones(lags.size - 1)))
    a = solve_toeplitz(lags[:-1], lags[1:])
    variance = lags[0] - float(a @ lags[1:])
    return Whitening(np.concatenate(([1.0], -a)), float(np.sqrt(max(variance, 1e-12))))
