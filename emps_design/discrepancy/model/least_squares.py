"""Least squares over the free numbers of a candidate model, within their bounds, and how certain they are."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.candidate import Candidate, Slot
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.errors import SimulationError

NUDGE = 2e-4  # finite difference, in magnitudes of the number
COARSE = 5e-3  # the same where the fine one finds no way down and structure is left: play that bounces is rough
BOLDEST = 0.5  # largest step of a fit, in magnitudes of the number: a period must not jump over its neighbours
TRIALS = 6  # of one step, with more and more damping
DAMPING = (1e-7, 1e6)  # least and most
GOES_ON = 0.1  # of the cost: a step that gains more is followed by one with the Jacobian that it corrects
CONVERGED = (1e-4, 0.1)  # gain of a step, as a share of the cost and absolute, below which a descent ends
CLUSTER = 500  # samples that structure in a residual spans, for the deviations of what was fitted
WORST = 1e12  # cost of a model that cannot be simulated: finite, so that a fit steps back from it


@dataclass(frozen=True)
class Descent:
    """Where a descent ended: the model, its sum of squares, and the covariance of the free numbers."""

    model: Candidate
    cost: float
    covariance: np.ndarray


@dataclass(frozen=True)
class Scaled:
    """The free numbers ``slots`` of ``start`` in units of their magnitudes, and the ``residual`` of a model."""

    start: Candidate
    slots: tuple[Slot, ...]
    residual: Callable[[Candidate], np.ndarray]

    @cached_property
    def magnitude(self) -> np.ndarray:
        """The magnitude of every number."""
        return np.array([s.magnitude for s in self.slots])

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The lower and the upper ones."""
        lower, upper = np.array([(s.quantity.lower, s.quantity.upper) for s in self.slots]).reshape(-1, 2).T
        return lower / self.magnitude, upper / self.magnitude

    @property
    def begin(self) -> np.ndarray:
        """The numbers that ``start`` has."""
        return self.start.vector(self.slots) / self.magnitude

    def at(self, x: np.ndarray) -> Candidate:
        """The model with the numbers ``x``."""
        return self.start.with_vector(self.slots, x * self.magnitude)

    def attempt(self, x: np.ndarray) -> np.ndarray | None:
        """The residual with the numbers ``x``, None where the model cannot be simulated."""
        try:
            return self.residual(self.at(x))
        except SimulationError:
            return None

    def unscaled(self, covariance: np.ndarray) -> np.ndarray:
        """``covariance`` (k, k) in the units of the numbers."""
        return covariance * np.outer(self.magnitude, self.magnitude)


def descend(
    start: Candidate, slots: tuple[Slot, ...], residual: Callable[[Candidate], np.ndarray], steps: int
) -> Descent:
    """Minimise the sum of squares of ``residual`` over ``slots`` by Levenberg-Marquardt; bounds hold at every step.

    A model that cannot be simulated counts as infinitely bad: the descent steps back from it. As long as a step gains
    much, the next one takes the Jacobian that the step itself corrects (Broyden's rank one); a descent ends on one that
    was computed. It takes as many simulations as ``steps`` steps with computed ones would.
    """
    free = Scaled(start, slots, residual)
    (lower, upper), attempt, x = free.bounds, free.attempt, free.begin
    try:
        current = residual(start)
    except SimulationError:
        return Descent(start, WORST, np.zeros((len(slots),) * 2))
    if not slots:
        return Descent(start, float(current @ current), np.zeros((0, 0)))
    model, damping, nudge, jacobian = start, 1e-3, NUDGE, np.zeros((current.size, len(slots)))
    simulations = steps * (len(slots) + 1)
    while simulations > 0:
        nudges = np.where(x + nudge <= upper, nudge, -nudge)
        shifted = side_by_side(attempt, [(moved,) for moved in x + np.diag(nudges)])
        for k, (reached, step) in enumerate(zip(shifted, nudges, strict=True)):
            jacobian[:, k] = 0.0 if reached is None else (reached - current) / step
        simulations -= len(slots)
        first, secant, most = float(current @ current), jacobian.copy(), TRIALS
        while most and simulations > 0:
            cost, trials, most = float(current @ current), most, 0
            for trial, tried in itertools.islice(_moves(secant, current, x, lower, upper, damping), trials):
                reached, simulations = attempt(trial), simulations - 1
                if reached is None or float(reached @ reached) >= cost:
                    damping = min(tried * 10, DAMPING[1])
                    continue
                moved, change = trial - x, reached - current
                model, x, current = free.at(trial), trial, reached
                damping = max(tried / 10, DAMPING[0])
                if float(current @ current) < (1 - GOES_ON) * cost:
                    secant += np.outer(change - secant @ moved, moved / (moved @ moved))
                    most = 1
                break
        gain = first - float(current @ current)
        if gain == 0.0 and nudge == NUDGE and first > rules.STRUCTURED * current.size:
            damping, nudge = 1e-3, COARSE
        elif gain < CONVERGED[0] * first + CONVERGED[1]:
            break
    return Descent(model, float(current @ current), free.unscaled(covariance_of(jacobian, current)))


def _moves(
    jacobian: np.ndarray, left: np.ndarray, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, damping: float
) -> Iterator[tuple[np.ndarray, float]]:
    """Where to go from ``x`` (k,) within its bounds, and the damping of that step: each more damped than the last."""
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ left
    while True:
        free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)))
        lhs = normal[np.ix_(free, free)] + damping * np.diag(np.diag(normal)[free] + 1e-9)
        move = np.zeros_like(x)
        move[free] = -np.linalg.lstsq(lhs, gradient[free], rcond=None)[0]
        yield np.clip(x + np.clip(move, -BOLDEST, BOLDEST), lower, upper), damping
        damping = min(damping * 10, DAMPING[1])


def covariance_of(jacobian: np.ndarray, left: np.ndarray) -> np.ndarray:
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
