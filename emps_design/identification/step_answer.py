"""How an observer answers the steps of a force that is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

NEAR_AN_EDGE = 0.1  # s, on both sides


@dataclass(frozen=True)
class Steps:
    """How a method answers the steps of a known force.

    ``delay`` [s] to half of the step and ``rise_time`` [s] from 10 to 90 %, of the mean answer to all edges;
    ``plateau`` [N] the mean observed height away from edges, ``plateau_error_percent`` against the true one.
    """

    edges: int
    delay: float | None
    rise_time: float | None
    plateau: float
    plateau_error_percent: float
    rms_error_away_from_edges: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return dict(self.__dict__)


def step_answer(force: np.ndarray, truth: np.ndarray, period: float, inner: slice | np.ndarray) -> Steps | None:
    """Answer of ``force`` (n,) [N] to the steps of a square wave ``truth`` (n,) [N]; None where that has no steps.

    ``inner`` are the samples that count: away from edges some must be at either height.

    >>> truth = 10.0 * (np.arange(4000) // 500 % 2)
    >>> found = step_answer(np.roll(truth, 3), truth, 1e-3, slice(250, 3750))
    >>> found.edges, round(found.delay, 4), round(found.plateau, 1)
    (7, 0.0025, 10.0)
    """
    change = np.diff(truth)
    height = float(np.ptp(truth))
    edges = np.flatnonzero(np.abs(change) > 0.5 * height) + 1 if height > 0 else np.zeros(0, int)
    reach = int(NEAR_AN_EDGE / period)
    if edges.size < 2 or np.mean(np.abs(change) > 1e-9 * height) > 0.01:
        return None
    near = np.ones(len(truth), dtype=bool)
    near[inner] = False
    for edge in edges:
        near[max(0, edge - reach) : edge + reach] = True
    high = truth > truth.min() + 0.5 * height
    above, below = force[high & ~near], force[~high & ~near]
    if not above.size or not below.size:
        return None
    plateau = float(above.mean() - below.mean())
    edges = edges[(edges > reach) & (edges < len(truth) - reach)]
    answers = [np.sign(change[e - 1]) * (force[e - reach : e + reach] - force[e - reach]) for e in edges]
    answers = [answer for answer in answers if np.all(np.isfinite(answer))]
    crossing = dict.fromkeys((0.1, 0.5, 0.9), float("nan"))
    if answers:
        mean = np.mean(answers, axis=0)
        share = mean / float(np.mean(mean[-reach // 4 :]))
        crossing = {level: _first_crossing(share, level) for level in crossing}
    complete = bool(np.all(np.isfinite(list(crossing.values()))))
    return Steps(
        edges=int(edges.size),
        delay=float(period * (crossing[0.5] - reach)) if complete else None,
        rise_time=float(period * (crossing[0.9] - crossing[0.1])) if complete else None,
        plateau=plateau,
        plateau_error_percent=100.0 * (plateau / height - 1.0),
        rms_error_away_from_edges=float(np.sqrt(np.mean((force - truth)[~near] ** 2))),
    )


def _first_crossing(share: np.ndarray, level: float) -> float:
    """Index, between samples, at which ``share`` last comes from below ``level`` to above it for good; NaN: never."""
    below = np.flatnonzero(share < level)
    if not below.size or below[-1] + 1 >= len(share):
        return float("nan")
    i = int(below[-1])
    return i + (level - share[i]) / (share[i + 1] - share[i])
