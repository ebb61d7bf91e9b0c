"""A loop that repeats after some samples, as one of different rates does: lifted to the rate at which it repeats.

Matrices of the samples of a cycle stand along the first axis: ``x[k+1] = A[j] x[k] + B[j] w[k]`` with j = k modulo the
length of the cycle. From cycle to cycle the state moves by the monodromy ``A[-1] ... A[1] A[0]``, whose eigenvalues are
the exact poles (Bittanti, Colaneri, Periodic Systems, 2009).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from emps_design.control.loop.margins import Margins

MOST_GAIN = 1e4  # above this a gain margin is unbounded
_NEAR = 30.0  # samples of delay up to which every tenth of one is tried
_TURNS, _FACTORS = np.radians(np.arange(1.0, 181.0)), np.geomspace(1.0, MOST_GAIN, 241)[1:]


def monodromy(A: np.ndarray) -> np.ndarray:
    """The product ``A[-1] ... A[0]`` (..., n, n) of the matrices (cycle, ..., n, n).

    >>> monodromy(np.array([[[0.5]], [[3.0]]])).tolist()
    [[1.5]]
    """
    product = A[0]
    for one in A[1:]:
        product = one @ product
    return product


def lifted(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One step for a whole cycle, with inputs and outputs of all its samples end to end.

    (c, n, n), (c, n, i), (c, o, n), (c, o, i) -> (n, n), (n, c i), (c o, n), (c o, c i).
    """
    cycle, size, count = B.shape
    state, driven = np.eye(size), np.zeros((size, cycle * count))
    outputs, through = [], []
    for j in range(cycle):
        own = slice(j * count, (j + 1) * count)
        outputs.append(C[j] @ state)
        heard = C[j] @ driven
        heard[:, own] += D[j]
        through.append(heard)
        state, driven = A[j] @ state, A[j] @ driven
        driven[:, own] += B[j]
    return state, driven, np.concatenate(outputs), np.concatenate(through)


def response(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """What comes out at the frequency that goes in (f,), the mean over a cycle; ``angle`` (f,) [rad] by sample.

    (c, n, n), (c, n), (c, n), (c,), (f,) -> (f,). Other frequencies come out too, the aliases of it.
    """
    cycle, size = b.shape
    turn = np.exp(1j * angle)[:, None, None]
    forth = turn ** np.arange(cycle + 1)[:, None, None, None]  # what goes in, sample by sample
    driven = np.zeros((angle.size, size, 1), dtype=complex)
    for j in range(cycle):
        driven = A[j] @ driven + b[j][:, None] * forth[j]
    x = np.linalg.solve(forth[cycle] * np.eye(size) - monodromy(A), driven)
    total = np.zeros((angle.size, 1, 1), dtype=complex)
    for j in range(cycle):
        total += (c[j][None] @ x + d[j] * forth[j]) / forth[j]
        x = A[j] @ x + b[j][:, None] * forth[j]
    return total.ravel() / cycle


def margins(
    opened: np.ndarray, column: np.ndarray, row: np.ndarray, period: float, delayed: Callable[[float], float] | None
) -> Margins:
    """Margins at one place of a periodic loop, from the poles of the loop closed with a factor there.

    ``opened`` (c, n, n), ``column`` (c, n) and ``row`` (c, n) are the loop broken at that place; ``period`` [s] of a
    sample. A factor exp(-j phi) that brings a pole to the unit circle is the phase margin, a real one the gain margin;
    ``delayed(delay)`` is the largest modulus of the poles with a ``delay`` [s] more at that place; without it there is
    no delay margin.
    """

    def radii(factors: np.ndarray) -> np.ndarray:
        return monodromy_radii(opened, column, row, factors)

    if radii(np.ones(1))[0] > 1.0 + 1e-9:
        return Margins(stable=False, period=period)
    phase = _first(lambda turns: radii(np.exp(-1j * turns)), 0.0, _TURNS)
    gain = _first(radii, 1.0, _FACTORS)
    less = _first(lambda factors: radii(1.0 / factors), 1.0, _FACTORS)
    delay = None
    if phase is not None and delayed is not None:
        each = np.vectorize(delayed, otypes=[float])
        near = _first(each, 0.0, period * np.arange(0.1, _NEAR, 0.1), at_once=1)
        delay = near if near is not None else _late_delay(opened, column, row, period)
    return Margins(
        stable=True,
        phase_margin_deg=None if phase is None else math.degrees(phase),
        delay_margin=delay,
        gain_margin=gain,
        gain_reduction_margin=None if less is None else 1.0 / less,
        period=period,
    )


def _late_delay(opened: np.ndarray, column: np.ndarray, row: np.ndarray, period: float) -> float | None:
    """The least delay [s] of whole cycles, and parts of one, that brings a pole to the unit circle.

    A delay of m cycles turns all that comes back in a cycle alike, by m theta at a pole exp(j theta): where the loop
    closed with exp(-j phi) has that pole, the least delay is phi / theta cycles. Between whole cycles the formula is
    good far above the length of one, where the loop is slow.
    """
    from scipy.optimize import brentq

    def poles(turn: float) -> np.ndarray:
        closed = opened + np.exp(-1j * turn) * column[..., :, None] * row[..., None, :]
        return np.linalg.eigvals(monodromy(closed))

    def out(turn: float) -> int:
        return int(np.sum(np.abs(poles(turn)) > 1.0 + 1e-9))

    around = np.linspace(0.0, 2.0 * math.pi, 721)
    counts = [out(turn) for turn in around]
    delays = []
    for i in np.flatnonzero(np.diff(counts)):
        between = 0.5 * (counts[i] + counts[i + 1])
        turn = brentq(lambda turn, between=between: out(turn) - between, around[i], around[i + 1])
        found = poles(turn)
        angle = float(np.angle(found[np.argmin(np.abs(np.abs(found) - 1.0))]))
        if angle > 0.0:
            delays.append(turn / angle * len(opened) * period)
    return min(delays, default=None)


def monodromy_radii(opened: np.ndarray, column: np.ndarray, row: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Largest moduli (m,) of the poles of the loop closed with each of ``factors`` (m,) where it is broken."""
    added = column[..., :, None] * row[..., None, :]
    closed = opened[:, None] + factors[:, None, None] * added[:, None]
    return np.abs(np.linalg.eigvals(monodromy(closed))).max(axis=-1)


def _first(radii: Callable[[np.ndarray], np.ndarray], low: float, tried: np.ndarray, at_once: int = 20) -> float | None:
    """The first number above ``low`` at which a pole leaves the unit circle, None up to the last one ``tried``.

    ``radii`` has the largest modulus of the poles at each of several numbers; it is asked for so many ``at_once``.
    """
    from scipy.optimize import brentq

    def beyond(number: float) -> float:
        return float(radii(np.array([number]))[0]) - (1.0 + 1e-9)

    for start in range(0, tried.size, at_once):
        out = np.flatnonzero(radii(tried[start : start + at_once]) > 1.0 + 1e-9)
        if out.size:
            place = start + int(out[0])
            low, high = float(tried[place - 1]) if place else low, float(tried[place])
            return brentq(beyond, low, high, xtol=1e-15 * high, rtol=1e-14)
    return None
