"""Smooth functions of the state of the axis, with no physics assumed: what an unknown force may depend on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.discrepancy.model.missing_force import SLOWEST, since_reversal
from emps_design.discrepancy.model.problem import Hypothesis

DEGREE = 4  # of the polynomials in position and in speed
FADING_TIMES = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)  # s, of a memory: if it lasts a stroke it is a spring
RESTING_TIME = 0.04  # s, in which a contact ages at rest
FADING_WAYS = (1e-4, 5e-4, 2e-3, 1e-2)  # m since a reversal


def beside_state(hypothesis: Hypothesis) -> Hypothesis:
    """The same model, judged by what no smooth function of the state that it simulates could follow."""
    return Hypothesis(replace(hypothesis.problem, states=states_of(hypothesis)), hypothesis.model)


def states_of(hypothesis: Hypothesis) -> tuple[np.ndarray, ...]:
    """:func:`smooth_of_state` along the motion that ``hypothesis`` simulates, one array (n, k) per record."""
    return tuple(smooth_of_state(run.q, hypothesis.problem.period) for run in hypothesis.runs())


def smooth_of_state(q: np.ndarray, period: float) -> np.ndarray:
    """Smooth functions (n, k) of position ``q`` (n,) [m], velocity, and what came before: no physics assumed.

    A surface over position and velocity for each direction, and what friction may remember.
    """
    from numpy.polynomial.chebyshev import chebvander

    v = np.gradient(q, period)
    direction, speed = np.tanh(v / SLOWEST), np.abs(v) / np.abs(v).max()
    surface = along(q, DEGREE)[:, :, None] * chebvander(2 * speed - 1, DEGREE)[:, None]
    surface = surface.reshape(q.size, -1)
    remembered, count = (memories(q, period), faded(v, period)), surface.shape[1]
    functions = np.empty((q.size, 2 * count + sum(part.shape[1] for part in remembered)))
    np.multiply(surface, (direction > 0)[:, None], out=functions[:, :count])
    np.multiply(surface, (direction <= 0)[:, None], out=functions[:, count : 2 * count])
    np.concatenate(remembered, axis=1, out=functions[:, 2 * count :])
    return functions


def along(q: np.ndarray, degree: int) -> np.ndarray:
    """Polynomials in position ``q`` (n,) [m], (n, ``degree`` + 1)."""
    from numpy.polynomial.chebyshev import chebvander

    return chebvander(2 * (q - q.min()) / np.ptp(q) - 1, degree)


def slopes_along(q: np.ndarray, degree: int) -> np.ndarray:
    """Derivatives [1/m] of the polynomials of :func:`along` with respect to ``q``."""
    from numpy.polynomial.chebyshev import chebder

    return along(q, degree - 1) @ chebder(np.eye(degree + 1), scl=2 / np.ptp(q))


def memories(q: np.ndarray, period: float) -> np.ndarray:
    """What friction may remember of the motion ``q`` (n,) [m] before, (n, k).

    How long it rested, the way since a reversal, and fading memories of direction, and of motion at all.
    """
    v = np.gradient(q, period)
    direction = np.tanh(v / SLOWEST)
    way = np.cumsum(np.abs(v)) * period
    way -= way[np.arange(q.size) - since_reversal(v)]
    fading = np.exp(-way[:, None] / FADING_WAYS)
    along_it = np.column_stack([rested(v, period), fading, faded(np.abs(direction), period)])
    return np.column_stack([along_it * direction[:, None], faded(direction, period)])


def faded(signal: np.ndarray, period: float) -> np.ndarray:
    """Fading memories (n, k) of a ``signal`` (n,), one for each of ``FADING_TIMES``."""
    from scipy.signal import lfilter

    shares = [period / time for time in FADING_TIMES]
    return np.column_stack([lfilter([share], [1.0, share - 1.0], signal) for share in shares])


def rested(v: np.ndarray, period: float) -> np.ndarray:
    """How far a contact has aged, 0 to 1, (n, k) along a velocity ``v`` (n,) [m/s]: at rest it does, sliding undoes it.

    At rest within ``RESTING_TIME``, in sliding within each of ``FADING_TIMES``; aged in full at first.

    >>> v = np.concatenate([np.zeros(3), np.ones(640), np.zeros(1000)])
    >>> rested(v, 1e-3)[[2, 642, -1], -1].round(3).tolist()
    [1.0, 0.368, 1.0]
    """
    slides, times = np.abs(v) > 0.5 * SLOWEST, np.array(FADING_TIMES)
    states, now, begin = np.empty((v.size, times.size)), np.ones(times.size), 0
    for end in np.append(np.flatnonzero(np.diff(slides)) + 1, v.size):
        aim, own = (0.0, times) if slides[begin] else (1.0, RESTING_TIME)
        states[begin:end] = aim + (now - aim) * np.exp(-period * np.arange(1, end - begin + 1)[:, None] / own)
        now, begin = states[end - 1], end
    return states
