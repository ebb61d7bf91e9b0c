"""A way down where the cost is rough: Gauss-Newton on linear surfaces through a neighbourhood, bursts counting little.

Where play bounces, every impact depends on the last digit of every number: the cost has dent beside dent, and at the
truth, where noise moves the impacts as well, it is no less than in many of them. Over a neighbourhood the mean is
smooth. A few samples, at impacts that come early or late, would still be most of a sum of squares: beyond a burst they
count as the logarithm does (Cauchy's loss).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.candidate import Candidate, Slot
from emps_design.discrepancy.model.least_squares import WORST, Descent, Scaled, covariance_of
from emps_design.discrepancy.model.parallel import side_by_side

ROUNDS = 30  # surfaces, one after the other
CHANGED = 2.0  # times the cost: as much a number alone changes the residual at the edge of the first neighbourhood
SOUGHT = 4  # times that edge is corrected before the first surface
CLOSER = 0.6  # of the neighbourhood is the next one where a surface led no further, and at least
OFTEN = 4  # times in so many rounds
FAR = 4.0  # neighbourhoods that a step may lead away
ASTRAY = 1.5  # times the least cost, beyond which a step is taken back, and the neighbourhood was too large by far
FURTHER = 1e-3  # of the least cost less, and a surface has led further
IN_VAIN = 5  # surfaces one after the other that led no further, though not astray: there is nothing more to find
RIDGE = 1e-3  # of the diagonal
ALIKE = 4.0  # times the deviation of the costs on a surface, up to which a place is as good as the best


def bounded(innovations: np.ndarray) -> np.ndarray:
    """Numbers whose sum of squares is Cauchy's loss of ``innovations``: beyond a burst it grows as the logarithm.

    >>> bounded(np.array([0.0, 0.5, -100.0])).round(3).tolist()
    [0.0, 0.499, -12.241]
    """
    size = rules.BURST
    return np.asarray(np.sign(innovations) * size * np.sqrt(np.log1p((innovations / size) ** 2)))


def descend_rough(start: Candidate, slots: tuple[Slot, ...], residual: Callable[[Candidate], np.ndarray]) -> Descent:
    """Minimise the sum of squares of ``residual`` over ``slots`` by surfaces; returns the least that was met.

    A surface goes through two places on each of as many random directions, at right angles to each other, as there are
    numbers: each moves all numbers at once. Its slopes give the next place. What cannot be simulated makes the
    neighbourhood smaller. A number is as sure as the last surface says, and as the places agree whose cost is the least
    one but for the roughness of the last neighbourhood. The same start takes the same directions.
    """
    random, free = np.random.default_rng(0), Scaled(start, slots, residual)
    been: list[tuple[float, np.ndarray]] = []

    def visit(places: np.ndarray) -> list[np.ndarray] | None:
        met = side_by_side(free.attempt, [(place,) for place in places])
        been.extend((float(m @ m), place) for m, place in zip(met, places, strict=True) if m is not None)
        return None if any(m is None for m in met) else met

    def least() -> tuple[float, np.ndarray]:
        return min(been, key=lambda one: one[0])

    x = free.begin
    first = visit(x[None])
    covariance, rough = np.zeros((x.size, x.size)), 0.0
    if first is None or not slots:
        return Descent(start, been[0][0] if been else WORST, covariance)
    reach, vain = _reach(free.attempt, x, first[0]), 0
    for number in range(ROUNDS):
        directions = np.linalg.qr(random.standard_normal((x.size, x.size)))[0] * np.sqrt(x.size) * reach
        met = visit(np.clip(np.concatenate([x + directions, x - directions]), *free.bounds))
        if met is None:
            reach = reach * CLOSER
            continue
        ahead, behind = np.split(np.array(met), 2)
        jacobian = (ahead - behind).T @ directions / (2 * x.size * reach**2)
        middle = np.mean(met, axis=0)
        covariance, rough = covariance_of(jacobian, middle), float(np.std([m @ m for m in met]))
        normal = jacobian.T @ jacobian
        move = -np.linalg.lstsq(normal + RIDGE * np.diag(np.diag(normal)), jacobian.T @ middle, rcond=None)[0]
        moved = np.clip(x + np.clip(move, -FAR * reach, FAR * reach), *free.bounds)
        before, reached = least()[0], visit(moved[None])
        astray = reached is None or been[-1][0] > ASTRAY * least()[0]
        x = least()[1] if astray else moved
        vain = 0 if least()[0] < (1 - FURTHER) * before else vain + (not astray)
        if vain == IN_VAIN:
            break
        if astray:
            reach = reach * CLOSER**2
        elif np.all(np.abs(move) < reach) or number % OFTEN == OFTEN - 1:
            reach = reach * CLOSER
    cost, best = least()
    alike = np.array([place for found, place in been if found <= cost + ALIKE * rough])
    covariance = covariance + np.cov(alike.T, bias=True).reshape(covariance.shape)
    return Descent(free.at(best), cost, free.unscaled(covariance))


def _reach(attempt: Callable[[np.ndarray], np.ndarray | None], x: np.ndarray, first: np.ndarray) -> np.ndarray:
    """How far each number of ``x`` (k,) alone goes until the residual differs from ``first`` by a share of its cost."""
    reach, wanted = np.full(x.size, 1e-3), CHANGED * float(first @ first)
    for _ in range(SOUGHT):
        met = side_by_side(attempt, [(moved,) for moved in x + np.diag(reach)])
        changed = [np.inf if left is None else float(np.sum((left - first) ** 2)) for left in met]
        reach = reach * np.clip(np.sqrt(wanted / np.maximum(changed, 1e-300)), 0.1, 10.0)
    return reach
