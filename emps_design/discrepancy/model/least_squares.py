"""Least squares over the free numbers of a candidate model, within their bounds, and how certain they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.candidate import Candidate, Slot
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.errors import SimulationError

NUDGE = 2e-4  # finite difference, in magnitudes of the number
COARSE = 5e-3  # the same where the fine one finds no way down and structure is left: play that bounces is rough
BOLDEST = 0.5  # largest step of a fit, in magnitudes of the number: a period must not jump over its neighbours
TRIALS = 6  # of one step, with more and more damping
CONVERGED = (1e-4, 0.1)  # gain of a step, as a share of the cost and absolute, below which a descent ends
CLUSTER = 500  # samples that structure in a residual spans, for the deviations of what was fitted
WORST = 1e12  # cost of a model that cannot be simulated: finite, so that a fit steps back from it


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

    def attempt(x: np.ndarray) -> np.ndarray | None:
        try:
            return residual(start.with_vector(slots, x * magnitude))
        except SimulationError:
            return None

    magnitude = np.array([s.magnitude for s in slots])
    lower = np.array([s.quantity.lower for s in slots]) / magnitude
    upper = np.array([s.quantity.upper for s in slots]) / magnitude
    x = start.vector(slots) / magnitude
    try:
        current = residual(start)
    except SimulationError:
        return Descent(start, WORST, np.zeros((len(slots),) * 2))
    if not slots:
        return Descent(start, float(current @ current), np.zeros((0, 0)))
    model, damping, nudge, jacobian = start, 1e-3, NUDGE, np.zeros((current.size, len(slots)))
    for _ in range(steps):
        nudges = np.where(x + nudge <= upper, nudge, -nudge)
        shifted = side_by_side(attempt, [(moved,) for moved in x + np.diag(nudges)])
        for k, (reached, step) in enumerate(zip(shifted, nudges, strict=True)):
            jacobian[:, k] = 0.0 if reached is None else (reached - current) / step
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ current
        cost, gain = float(current @ current), 0.0
        for _ in range(TRIALS):
            free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)))
            lhs = normal[np.ix_(free, free)] + damping * np.diag(np.diag(normal)[free] + 1e-9)
            move = np.zeros_like(x)
            move[free] = -np.linalg.lstsq(lhs, gradient[free], rcond=None)[0]
            trial = np.clip(x + np.clip(move, -BOLDEST, BOLDEST), lower, upper)
            reached = attempt(trial)
            if reached is not None and float(reached @ reached) < cost:
                gain = cost - float(reached @ reached)
                model, x, current = start.with_vector(slots, trial * magnitude), trial, reached
                damping = max(damping / 10, 1e-7)
                break
            damping = min(damping * 10, 1e6)
        if gain == 0.0 and nudge == NUDGE and cost > rules.STRUCTURED * current.size:
            damping, nudge = 1e-3, COARSE
        elif gain < CONVERGED[0] * cost + CONVERGED[1]:
            break
    return Descent(model, float(current @ current), _covariance(jacobian, current) * np.outer(magnitude, magnitude))


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
