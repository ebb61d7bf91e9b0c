"""Kinds of unknown force, each with few free numbers: what an axis may have that no effect of the library describes.

A smooth function of the state could be nearly anything, and takes most friction with it. An unknown force of one kind
leaves alone what is of another kind, so that effects are found beside it. What it does to the motor force is that of
the closed loop: a column is simulated as a force on the carriage, and not taken for its own answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.model.state import along, memories

DEGREE = 6  # of the polynomials in position
PUSH = 0.1  # of the force that a model leaves: rms of a column when its answer is simulated


def inertia(q: np.ndarray, period: float) -> np.ndarray:
    """An inertia that varies along the travel, as of a crank: functions of position times acceleration and speed^2."""
    v, shapes = np.gradient(q, period), along(q, DEGREE)
    return np.column_stack([shapes * np.gradient(v, period)[:, None], shapes * (v * v)[:, None]])


def damping(q: np.ndarray, period: float) -> np.ndarray:
    """Friction in proportion to velocity that varies along the travel, for each direction by itself."""
    v, shapes = np.gradient(q, period)[:, None], along(q, DEGREE)
    return np.column_stack([shapes * np.maximum(v, 0.0), shapes * np.minimum(v, 0.0)])


KINDS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "an inertia that varies along the travel": inertia,
    "viscous friction that varies along the travel": damping,
    "friction that remembers the motion before": memories,
}


def beside_kind(hypothesis: Hypothesis, kind: str) -> Hypothesis:
    """The same model, judged by what no unknown force of a ``kind`` of ``KINDS`` could do beside it.

    Raises :class:`SimulationError` where the model does not run with a force as large as the one that it leaves.
    """
    problem = hypothesis.problem
    states = [KINDS[kind](run.q, problem.period) for run in hypothesis.runs()]
    whole = hypothesis.residuals()
    size = [
        PUSH * np.std(left) / np.maximum(np.std(one, axis=0), 1e-30) for left, one in zip(whole, states, strict=True)
    ]
    columns = []
    for place in range(states[0].shape[1]):
        pushes = [one[:, place] * much[place] for one, much in zip(states, size, strict=True)]
        columns.append([a - b for a, b in zip(whole, hypothesis.residuals(pushes), strict=True)])
    answers = tuple(np.column_stack(record) for record in zip(*columns, strict=True))
    return Hypothesis(replace(problem, states=answers), hypothesis.model)
