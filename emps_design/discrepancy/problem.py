"""The records to explain, their noise, and the whitened closed-loop residual of a candidate model."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy.candidate import Candidate, Slot
from emps_design.discrepancy.split import START_UP, Split
from emps_design.errors import SimulationError
from emps_design.records import Record
from emps_design.simulation import Plant

LOOSE = 1e5  # times the integrator's tolerance: force within 1e-3 N, a thousandth of any noise here, four times faster
BOLDEST = 0.5  # largest step of a fit, in scales of the parameter: a period must not jump over its neighbours
WORST = 1e12  # cost of a model that cannot be simulated: finite, so that a fit steps back from it


@dataclass(frozen=True)
class Whitening:
    """Autoregressive model of the force residual: ``coefficients`` (p + 1,), first 1, and the innovation's ``std`` [N]."""

    coefficients: np.ndarray
    std: float

    def apply(self, residual: np.ndarray) -> np.ndarray:
        """Innovations of ``residual`` (n,) [N] in units of their standard deviation."""
        from scipy.signal import lfilter

        return lfilter(self.coefficients, (1.0,), residual) / self.std


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

    def plant(self, model: Candidate) -> Plant:
        """The compiled plant with the effects of ``model``, made once a set."""
        if model.names not in self.plants:
            self.plants[model.names] = Plant.of(model.to_axis(self.axis))
        return self.plants[model.names]

    def runs(self, model: Candidate) -> tuple[Any, ...]:
        """Closed-loop simulations from ``q_ref`` alone, one a record."""
        plant = self.plant(model)
        return tuple(
            plant.closed_loop(
                r.q_ref,
                baseline=model.baseline,
                parameters=model.parameters(i),
                q0=float(r.q[0]),
                quantise=False,
                tolerance=LOOSE,
            )
            for i, r in enumerate(self.records)
        )

    def residuals(self, model: Candidate) -> tuple[np.ndarray, ...]:
        """Measured minus simulated motor force [N], one array (n,) a record."""
        gain = self.axis.drive.force_gain
        return tuple(gain * r.u - run.force for r, run in zip(self.records, self.runs(model), strict=True))

    def whitened(self, model: Candidate) -> tuple[np.ndarray, ...]:
        """Innovations of :meth:`residuals` in units of the noise."""
        return tuple(self.whitening.apply(r) for r in self.residuals(model))

    def masks(self, part: str) -> tuple[np.ndarray, ...]:
        """Boolean samples of ``part``: "fit", "select" or "used"."""
        return tuple(getattr(s, part) for s in self.splits)

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


def fit(problem: Problem, start: Candidate, part: str = "fit", frozen: bool = False, steps: int = 12) -> Fit:
    """Fit ``start`` to the closed-loop force by Levenberg-Marquardt on the samples of ``part``.

    ``frozen`` frees only what belongs to a record (used on confirming data). Bounds hold at every step.
    """
    masks = problem.masks(part)
    slots = start.slots(frozen)

    def residual(model: Candidate) -> np.ndarray | None:
        try:
            return np.concatenate([w[m] for w, m in zip(problem.whitened(model), masks, strict=True)])
        except SimulationError:
            return None

    scale = np.array([s.scale for s in slots])
    lower = np.array([s.quantity.lower for s in slots]) / scale
    upper = np.array([s.quantity.upper for s in slots]) / scale
    model, x = start, start.vector(slots) / scale
    current = residual(model)
    if current is None:
        return Fit(start, slots, np.zeros((len(slots),) * 2), (), WORST, WORST)
    damping, jacobian = 1e-3, np.zeros((current.size, len(slots)))
    for _ in range(steps if slots else 0):
        for k in range(len(slots)):
            step = 1e-3 if x[k] + 1e-3 <= upper[k] else -1e-3
            moved = x.copy()
            moved[k] += step
            shifted = residual(model.with_vector(slots, moved * scale))
            jacobian[:, k] = 0.0 if shifted is None else (shifted - current) / step
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ current
        cost, improved = float(current @ current), False
        for _ in range(6):
            held = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
            free = ~held
            lhs = normal[np.ix_(free, free)] + damping * np.diag(np.diag(normal)[free] + 1e-9)
            move = np.zeros_like(x)
            move[free] = -np.linalg.lstsq(lhs, gradient[free], rcond=None)[0]
            trial_x = np.clip(x + np.clip(move, -BOLDEST, BOLDEST), lower, upper)
            trial = model.with_vector(slots, trial_x * scale)
            trial_residual = residual(trial)
            if trial_residual is not None and float(trial_residual @ trial_residual) < cost:
                gain = cost - float(trial_residual @ trial_residual)
                model, x, current, improved = trial, trial_x, trial_residual, True
                damping = max(damping / 10, 1e-7)
                break
            damping = min(damping * 10, 1e6)
        if not improved or gain < 1e-4 * cost + 0.1:
            break
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True) * np.outer(scale, scale)
    return evaluate(problem, model, slots, covariance)


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


def whitening_of(residuals: tuple[np.ndarray, ...], order: int = 24) -> Whitening:
    """Autoregressive model of ``residuals`` by the Yule-Walker equations, start-up left out."""
    from scipy.linalg import solve_toeplitz

    lags = np.zeros(order + 1)
    total = 0
    for residual in residuals:
        r = residual[START_UP:] - residual[START_UP:].mean()
        lags += [float(r[: r.size - k] @ r[k:]) for k in range(order + 1)]
        total += r.size
    lags /= total
    lags[0] *= 1 + 1e-9
    a = solve_toeplitz(lags[:-1], lags[1:])
    variance = lags[0] - float(a @ lags[1:])
    return Whitening(np.concatenate(([1.0], -a)), float(np.sqrt(max(variance, 1e-12))))
