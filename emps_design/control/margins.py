"""The frequency response of linear systems and the margins of loops, of one or of thousands at once.

A system ``x[k+1] = A x[k] + b u[k], y[k] = c x[k] + d u[k]``, and a continuous one likewise, has the transfer function
``c (z I - A)^-1 b + d``. Arrays with leading axes are as many systems.

The poles decide stability: an unstable loop has no margins, and every caller checks that first. The phase margin is the
additional phase *lag* that moves the response to -1 at a crossover, the smallest over all crossovers; the delay margin
is the smallest ratio of that lag to its frequency. The gain margin is the smallest factor above one that moves the
response to -1, frequency 0 and the Nyquist frequency included; the gain reduction margin is the largest such factor
below one (an unstable plant needs a least gain).

A loop of different rates is periodic and lifted to the rate at which it repeats. The matrices of the samples of a cycle
are stacked along the first axis: ``x[k+1] = A[j] x[k] + B[j] w[k]`` with j = k modulo the length of the cycle. From
cycle to cycle the state is multiplied by the monodromy matrix ``A[-1] ... A[1] A[0]``, whose eigenvalues are the exact
poles (Bittanti, Colaneri, Periodic Systems, 2009); its margins are those of the poles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from emps_design.view import Table, View, Viewed

KEYS = (
    "phase_margin_deg",
    "crossover",
    "delay_margin",
    "gain_margin",
    "gain_margin_frequency",
    "gain_reduction_margin",
)
# Signals of a loop broken at the plant input, as python-control names them.
LOOP_NAMES: dict[str, Any] = {"inputs": ["plant_input"], "outputs": ["command"], "name": "loop_gain"}
HERTZ = 2.0 * math.pi  # rad/s
# label, key, unit and factor of a row of margins
Row = tuple[str, str, str, float]
MARGINS: tuple[Row, ...] = (
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("crossover", "crossover", "rad/s", 1.0),
    ("", "crossover", "Hz", 1.0 / HERTZ),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("", "delay_margin_samples", "samples", 1.0),
    ("gain margin", "gain_margin", "ratio", 1.0),
    ("", "gain_margin_db", "dB", 1.0),
    ("least stable gain", "gain_reduction_margin", "ratio", 1.0),
    ("disk margin", "disk_margin", "", 1.0),
)
LOWEST = "lowest_crossover"  # rad/s, key in arrays: the first crossover, which may not have the smallest phase margin
AT_REST = 1e-3  # ratio of imaginary to real part below which a loop below 0 dB at the lowest frequency counts as real
NO_LAG = 1e-6  # rad, rounding error of the lag of a loop at the limit of stability
MOST_GAIN = 1e4  # a larger gain margin counts as unbounded
_NEAR = 30.0  # samples; up to this delay the search has steps of a tenth of a sample
_TURNS, _FACTORS = np.radians(np.arange(1.0, 181.0)), np.geomspace(1.0, MOST_GAIN, 241)[1:]

MARGINAL = 1e-9  # a pole this close to the unit circle counts as on it, so that rounding errors decide no verdict
AT_ONCE = 100_000  # systems solved together
ROUNDING = 32.0 * np.finfo(float).eps  # relative error of a coefficient
Response = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Margins(Viewed):
    """Margins of one loop; None where a margin is unbounded, or where the closed loop is unstable.

    ``phase_margin_deg`` [deg], ``crossover`` [rad/s] (where that margin is smallest), ``delay_margin`` [s],
    ``gain_margin`` [ratio], ``gain_margin_frequency`` [rad/s], ``gain_reduction_margin`` [ratio], ``period`` [s] of a
    sampled loop (None: continuous), ``disk_margin`` see :func:`disk_margin`.

    >>> margins = Margins(stable=True, delay_margin=2e-3, gain_margin=10.0, period=1e-3)
    >>> margins.delay_margin_samples, margins.gain_margin_db
    (2.0, 20.0)
    """

    stable: bool
    phase_margin_deg: float | None = None
    crossover: float | None = None
    delay_margin: float | None = None
    gain_margin: float | None = None
    gain_margin_frequency: float | None = None
    gain_reduction_margin: float | None = None
    period: float | None = None
    disk_margin: float | None = None

    @property
    def delay_margin_samples(self) -> float | None:
        """Delay margin in sampling periods."""
        return None if self.delay_margin is None or self.period is None else self.delay_margin / self.period

    @property
    def gain_margin_db(self) -> float | None:
        """Gain margin in decibels."""
        return None if self.gain_margin is None else 20.0 * math.log10(self.gain_margin)

    def to_dict(self) -> dict[str, Any]:
        """Plain data with SI units, angles in degrees."""
        document = {**asdict(self), "gain_margin_db": self.gain_margin_db}
        if document.pop("period") is not None:
            document["delay_margin_samples"] = self.delay_margin_samples
        else:
            del document["disk_margin"]  # of sampled loops only
        return document

    def view(self) -> View:
        """A table of the margins under the verdict, stable or UNSTABLE."""
        document = self.to_dict()
        rows = [
            (label, None if document[key] is None else scale * document[key], unit)
            for label, key, unit, scale in MARGINS
            if key in document and (key != "gain_reduction_margin" or document[key] is not None)
        ]
        title, missing = ("stable", "unbounded") if self.stable else ("UNSTABLE", "undefined")
        return (Table(("", "value", "unit"), rows, title, missing=missing),)


def margin_arrays(
    response: Response,
    count: int,
    frequencies: np.ndarray,
    nyquist: float | None = None,
    delayed: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """Return the margins of ``count`` loops as arrays, NaN where a margin is unbounded.

    ``response(w, rows)`` is the open loop of the loops with indices ``rows`` at ``w`` [rad/s]; both broadcast.
    ``frequencies`` [rad/s], ascending, bracket the crossings, which are then refined to 1e-12; if a loop is below 0 dB
    at the first, :func:`further_down` extends them. ``nyquist`` [rad/s] is that of sampled loops, where the response is
    real and may be -1. ``delayed(w, rows, delay)`` is the open loop with an additional ``delay`` [s], arrays (n,); it
    makes the delay margin exact between whole samples too. Keys: those of ``KEYS``, and ``LOWEST``.

    >>> arrays = margin_arrays(lambda w, rows: 1.0 / (1j * w * (1.0 + 0.1j * w) ** 2), 1, np.geomspace(0.1, 100, 50))
    >>> round(float(arrays["gain_margin"][0]), 6), round(float(arrays["gain_margin_frequency"][0]), 6)
    (20.0, 10.0)
    """
    rows = np.arange(count)[:, None]
    loop = response(frequencies[None, :], rows)
    inside = loop.real**2 + loop.imag**2 < 1.0
    if np.any(inside[:, 0]):
        frequencies = further_down(frequencies)
        loop = response(frequencies[None, :], rows)
        inside = loop.real**2 + loop.imag**2 < 1.0
    margins = {key: np.full(count, np.nan) for key in (*KEYS, LOWEST)}

    where, place = np.nonzero(inside[:, 1:] != inside[:, :-1])
    if where.size:
        w = _refine(
            lambda w, which: np.log(np.abs(response(w, where[which]))),
            frequencies[place],
            frequencies[place + 1],
        )
        lag = np.mod(np.angle(response(w, where)) + np.pi, 2.0 * np.pi)
        lag[lag > 2.0 * np.pi - NO_LAG] = 0.0
        _keep_smallest(where, lag, {"phase_margin_deg": np.degrees(lag), "crossover": w}, margins)
        _keep_smallest(where, w, {LOWEST: w}, margins)
        delay = lag / w
        if delayed is not None and nyquist is not None:
            delay = _exact_delay(delayed, where, w, delay, nyquist)
        _keep_smallest(where, delay, {"delay_margin": delay}, margins)

    crossing = (loop.imag[:, 1:] < 0.0) != (loop.imag[:, :-1] < 0.0)
    # A sign change of the imaginary part on the positive side is not a crossing of the negative real axis.
    crossing &= (loop.real[:, 1:] < 0.0) | (loop.real[:, :-1] < 0.0)
    where, place = np.nonzero(crossing)
    if where.size:
        w = _refine(lambda w, which: _sine(response(w, where[which])), frequencies[place], frequencies[place + 1])
        _keep_gains(response(w, where).real, where, w, margins)
    below = np.flatnonzero(inside[:, 0] & (np.abs(loop[:, 0].imag) < AT_REST * np.abs(loop[:, 0].real)))
    if below.size:  # no integral action: at frequency 0 the response is real and may be -1
        _keep_gains(loop[below, 0].real, below, np.full(below.size, frequencies[0]), margins)
    if nyquist is not None:
        everything = np.arange(count)
        at_nyquist = np.full(count, nyquist)
        _keep_gains(response(at_nyquist, everything).real, everything, at_nyquist, margins)
    return margins


def loop_margins(
    response: Callable[[np.ndarray], np.ndarray],
    frequencies: np.ndarray,
    stable: bool,
    period: float | None = None,
    delayed: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Margins:
    """Return the margins of one loop; ``stable`` says whether its closed-loop poles are stable.

    ``response(w)`` is the open loop at ``w`` [rad/s]; ``frequencies`` [rad/s] ascending; ``period`` [s] of a sampled
    loop; ``delayed(w, delay)`` as for :func:`margin_arrays`. An unstable loop has no margins, since its frequency
    response does not show a distance to instability.

    >>> loop_margins(lambda w: 2.0 / (1j * w), np.geomspace(0.1, 10, 20), stable=True).crossover
    2.0
    """
    if not stable:
        return Margins(stable=False, period=period)
    nyquist = None if period is None else math.pi / period
    later = None if delayed is None else lambda w, rows, delay: delayed(w, delay)
    if abs(response(frequencies[:1])[0]) < 1.0:
        frequencies = further_down(frequencies)
    arrays = margin_arrays(lambda w, rows: response(w), 1, frequencies, nyquist, later)
    value = {key: None if math.isnan(arrays[key][0]) else float(arrays[key][0]) for key in KEYS}
    disk = disk_margin(response, frequencies if nyquist is None else np.append(frequencies, nyquist))
    return Margins(stable=True, period=period, disk_margin=disk, **value)


def further_down(frequencies: np.ndarray) -> np.ndarray:
    """Return ``frequencies`` (n,) [rad/s] extended downwards by five decades, for a slow loop.

    >>> further_down(np.array([1.0, 2.0]))[[0, -2, -1]].round(9).tolist()
    [1e-05, 1.0, 2.0]
    """
    low = frequencies[0]
    return np.concatenate([np.geomspace(1e-5 * low, low, 100, endpoint=False), frequencies])


def disk_margin(response: Callable[[np.ndarray], np.ndarray], frequencies: np.ndarray) -> float:
    """Return a = 1/max|S - 1/2| of the open loop ``response(w)`` with S = 1/(1 + L); ``frequencies`` [rad/s] bracket.

    A factor (1 + d/2)/(1 - d/2) with complex |d| < a leaves the loop stable: gain from (2 - a)/(2 + a) to its inverse,
    or phase up to 2 atan(a/2) (P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems 40(5), 2020).

    >>> round(disk_margin(lambda w: 1.0 / (1j * w * (1.0 + 1j * w)), np.geomspace(0.01, 100, 60)), 4)
    0.8944
    """
    w, largest = frequencies, 0.0
    for _ in range(5):
        sizes = disk_size(response(w))
        at = int(np.argmax(sizes))
        largest = max(largest, float(sizes[at]))
        w = np.geomspace(w[max(at - 1, 0)], w[min(at + 1, w.size - 1)], 33)
    return 1.0 / largest


def disk_size(loop: np.ndarray) -> np.ndarray:
    """Return |S - 1/2| of the open ``loop`` at any frequencies, S = 1/(1 + L): the largest is 1/a of the disk margin a.

    >>> disk_size(np.array([1.0 + 0.0j, 1.0j])).round(12).tolist()
    [0.0, 0.5]
    """
    return np.abs(1.0 / (1.0 + loop) - 0.5)


def _exact_delay(
    delayed: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    rows: np.ndarray,
    w: np.ndarray,
    delay: np.ndarray,
    nyquist: float,
) -> np.ndarray:
    """Delays [s] at which the loops ``rows`` reach -1, from their crossovers ``w`` and lag over frequency ``delay``.

    Newton's method for the logarithm of minus the loop, in the logarithm of frequency and in samples of delay. If it
    does not converge, ``delay`` is returned, which is exact for whole samples.
    """
    period, small = math.pi / nyquist, 1e-6
    x, y, slopes = np.log(w), delay / period, np.zeros((2, w.size), dtype=complex)

    def gap(which: np.ndarray, dx: float = 0.0, dy: float = 0.0) -> np.ndarray:
        return np.log(-delayed(np.exp(x[which] + dx), rows[which], (y[which] + dy) * period))

    active = np.arange(w.size)
    residual = gap(active)
    for turn in range(60):
        if turn % 10 == 0:  # slopes are updated every ten steps
            slopes[:, active] = [(gap(active, *by) - residual[active]) / small for by in ((small, 0.0), (0.0, small))]
        by_x, by_y, now = slopes[0, active], slopes[1, active], residual[active]
        determinant = by_x.real * by_y.imag - by_x.imag * by_y.real
        with np.errstate(divide="ignore", invalid="ignore"):
            step_x = (now.imag * by_y.real - now.real * by_y.imag) / determinant
            step_y = (now.real * by_x.imag - now.imag * by_x.real) / determinant
        x[active] = np.minimum(x[active] + np.clip(np.nan_to_num(step_x), -0.2, 0.2), math.log(nyquist))
        y[active] = np.maximum(y[active] + np.clip(np.nan_to_num(step_y), -0.3, 0.3), 1e-9)
        residual[active] = gap(active)
        active = active[np.abs(residual[active]) > 1e-12]
        if not active.size:
            break
    return np.where(np.abs(residual) < 1e-9, y * period, delay)


def _sine(value: np.ndarray) -> np.ndarray:
    """Sine of the phase: zero on the real axis and at a zero of the loop, and free of the magnitude's range."""
    size = np.abs(value)
    return np.divide(value.imag, size, out=np.zeros_like(size), where=size > 0.0)


def _keep_smallest(
    where: np.ndarray, key: np.ndarray, values: dict[str, np.ndarray], margins: dict[str, np.ndarray]
) -> None:
    """Write into ``margins`` the ``values`` at the smallest ``key`` of every loop in ``where``."""
    order = np.argsort(-key, kind="stable")  # the smallest is written last
    for name, value in values.items():
        margins[name][where[order]] = value[order]


def _keep_gains(value: np.ndarray, where: np.ndarray, w: np.ndarray, margins: dict[str, np.ndarray]) -> None:
    """Update the gain margins from real values of the loops ``where`` at ``w`` [rad/s], if they are smaller."""
    more = (value < 0.0) & (value > -1.0)
    factor, rows, at = -1.0 / value[more], where[more], w[more]
    nearer = ~(factor >= margins["gain_margin"][rows])  # NaN: none yet
    values = {"gain_margin": factor[nearer], "gain_margin_frequency": at[nearer]}
    _keep_smallest(rows[nearer], factor[nearer], values, margins)
    less = value < -1.0
    factor, rows = -1.0 / value[less], where[less]
    nearer = ~(factor <= margins["gain_reduction_margin"][rows])
    _keep_smallest(rows[nearer], -factor[nearer], {"gain_reduction_margin": factor[nearer]}, margins)


def _refine(function: Callable[[np.ndarray, np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Roots in the brackets [low, high] by the Illinois rule in the logarithm of the frequency, all at once."""
    everything = np.arange(low.size)
    a, b = np.log(low), np.log(high)
    fa, fb = function(low, everything), function(high, everything)
    root = np.where(np.abs(fa) < np.abs(fb), a, b)
    active = everything[(fa != 0.0) & (fb != 0.0)]
    for _ in range(60):
        if not active.size:
            break
        c = b[active] - fb[active] * (b[active] - a[active]) / (fb[active] - fa[active])
        fc = function(np.exp(c), active)
        root[active] = c
        other = np.sign(fc) == np.sign(fb[active])
        # The value at an unchanged end is halved, so that both ends move.
        a_next = np.where(other, a[active], b[active])
        fa_next = np.where(other, 0.5 * fa[active], fb[active])
        moved = np.abs(c - b[active])
        a[active], fa[active], b[active], fb[active] = a_next, fa_next, c, fc
        active = active[(np.abs(fc) > 1e-13) & (moved > 1e-13)]
    return np.exp(root)


def bisect(past: Callable[[float], bool], low: float, high: float, apart: float) -> tuple[float, float]:
    """Return a bracket [low, high], bisected at geometric means until ``high`` is at most ``apart`` times ``low``.

    ``past`` holds at ``high`` and not at ``low``.

    >>> round(bisect(lambda x: x * x > 2.0, 1.0, 2.0, 1.0 + 1e-9)[0], 6)
    1.414214
    """
    while high > low * apart:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if past(middle) else (middle, high)
    return low, high


def transfer(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: Any, z: np.ndarray) -> np.ndarray:
    """Return ``c (z I - A)^-1 b + d`` at ``z`` of any shape: (..., n, n), (..., n), (..., n), (...) -> (..., *z.shape).

    >>> delay = transfer(np.zeros((1, 1)), np.ones(1), np.ones(1), 0.0, np.array([1j, -1.0]))
    >>> bool(np.allclose(delay, [-1j, -1.0]))
    True
    """
    return transfers(A, b, c[None], np.asarray(d)[None], z)[0]


def transfers(A: np.ndarray, b: np.ndarray, C: np.ndarray, D: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return :func:`transfer` for each of several ``C`` (o, ..., n) and ``D`` (o, ...), from systems solved once."""
    if A.ndim == 3 and len(A) > 1:
        alike = _rank_one(A, b)
        if alike is not None:
            return _rank_one_transfers(A[0], b[0], *alike, C, D, z)
        if len(A) * z.size > AT_ONCE:  # split to limit memory
            half = len(A) // 2
            pieces = [transfers(A[i], b[i], C[:, i], D[:, i], z) for i in (slice(half), slice(half, None))]
            return np.concatenate(pieces, axis=1)
    states = _solved(A, b[..., None], z)[..., 0]
    responses = np.sum(C[..., None, :] * states, axis=-1) + D[..., None]
    return responses.reshape((*responses.shape[:-1], *z.shape))


def _solved(A: np.ndarray, columns: np.ndarray, z: np.ndarray) -> np.ndarray:
    """``(z I - A)^-1 columns`` (..., z.size, n, columns)."""
    return np.linalg.solve(z.reshape(-1, 1, 1) * np.eye(A.shape[-1]) - A[..., None, :, :], columns[..., None, :, :])


def _rank_one(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a column (n,) and shares (m, n + 1) with each ``[A b]`` the first plus column times shares; else None.

    This holds for loops around one plant with laws of one output that differ in the gains of that output.
    """
    tables = np.concatenate([A, b[..., None]], axis=-1)
    apart = tables - tables[0]
    system, row, place = np.unravel_index(np.argmax(np.abs(apart)), apart.shape)
    column = apart[system, :, place]
    if column[row] == 0.0:
        return column, apart[:, row]
    shares = apart[:, row] / column[row]
    residual = np.abs(apart - column[:, None] * shares[:, None, :])
    return (column, shares) if np.all(residual <= ROUNDING * (np.abs(tables) + np.abs(tables[0]))) else None


def _rank_one_transfers(A: Any, b: Any, column: Any, shares: Any, C: Any, D: Any, z: np.ndarray) -> np.ndarray:
    """Transfer functions of systems that are :func:`_rank_one`, by the Sherman-Morrison formula."""
    first, moved = np.moveaxis(_solved(A, np.column_stack([b, column]), z), -1, 0)
    rows = shares[:, :-1]
    back = (shares[:, -1:] + rows @ first.T) / (1.0 - rows @ moved.T)
    responses = np.stack([c @ first.T + (c @ moved.T) * back + d[..., None] for c, d in zip(C, D, strict=True)])
    return responses.reshape(*responses.shape[:-1], *z.shape)


def monodromy(A: np.ndarray) -> np.ndarray:
    """The product ``A[-1] ... A[0]`` (..., n, n) of the matrices (cycle, ..., n, n).

    >>> monodromy(np.array([[[0.5]], [[3.0]]])).tolist()
    [[1.5]]
    """
    product = A[0]
    for matrix in A[1:]:
        product = matrix @ product
    return product


def lifted(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return one step for a whole cycle, with the inputs and outputs of all its samples concatenated.

    (c, n, n), (c, n, i), (c, o, n), (c, o, i) -> (n, n), (n, c i), (c o, n), (c o, c i).
    """
    cycle, size, count = B.shape
    state, driven = np.eye(size), np.zeros((size, cycle * count))
    outputs, through = [], []
    for j in range(cycle):
        own = slice(j * count, (j + 1) * count)
        outputs.append(C[j] @ state)
        feedthrough = C[j] @ driven
        feedthrough[:, own] += D[j]
        through.append(feedthrough)
        state, driven = A[j] @ state, A[j] @ driven
        driven[:, own] += B[j]
    return state, driven, np.concatenate(outputs), np.concatenate(through)


def periodic_response(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the response of a periodic system at the input frequency, the mean over a cycle.

    (c, n, n), (c, n), (c, n), (c,), ``angle`` (f,) [rad] per sample -> (f,). Aliases in the output are not included.
    """
    cycle, size = b.shape
    rotation = np.exp(1j * angle)[:, None, None]
    inputs = rotation ** np.arange(cycle + 1)[:, None, None, None]  # by sample
    driven = np.zeros((angle.size, size, 1), dtype=complex)
    for j in range(cycle):
        driven = A[j] @ driven + b[j][:, None] * inputs[j]
    x = np.linalg.solve(inputs[cycle] * np.eye(size) - monodromy(A), driven)
    total = np.zeros((angle.size, 1, 1), dtype=complex)
    for j in range(cycle):
        total += (c[j][None] @ x + d[j] * inputs[j]) / inputs[j]
        x = A[j] @ x + b[j][:, None] * inputs[j]
    return total.ravel() / cycle


def periodic_margins(
    opened: np.ndarray, column: np.ndarray, row: np.ndarray, period: float, delayed: Callable[[float], float] | None
) -> Margins:
    """Return the margins at one place of a periodic loop, from the poles of the loop closed with a factor there.

    ``opened`` (c, n, n), ``column`` (c, n) and ``row`` (c, n) are the loop broken at that place; ``period`` [s] of a
    sample. The factor exp(-j phi) that moves a pole to the unit circle gives the phase margin, a real factor the gain
    margin. ``delayed(delay)`` is the largest modulus of the poles with an additional ``delay`` [s] at that place; None
    for no delay margin.
    """

    added = column[..., :, None] * row[..., None, :]

    def radii(factors: np.ndarray) -> np.ndarray:
        closed = opened[:, None] + factors[:, None, None] * added[:, None]
        return np.abs(np.linalg.eigvals(monodromy(closed))).max(axis=-1)

    if radii(np.ones(1))[0] > 1.0 + MARGINAL:
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
    """Return the least delay [s] that moves a pole to the unit circle, for delays much longer than a cycle.

    A delay of m cycles shifts the phase of the loop by m theta at a pole exp(j theta): if the loop closed with
    exp(-j phi) has that pole, the least delay is phi / theta cycles. Between whole cycles the formula is a good
    approximation for slow loops.
    """
    from scipy.optimize import brentq

    def poles(turn: float) -> np.ndarray:
        closed = opened + np.exp(-1j * turn) * column[..., :, None] * row[..., None, :]
        return np.linalg.eigvals(monodromy(closed))

    def out(turn: float) -> int:
        return int(np.sum(np.abs(poles(turn)) > 1.0 + MARGINAL))

    around = np.linspace(0.0, 2.0 * math.pi, 721)
    counts = [out(turn) for turn in around]
    delays = []
    for i in np.flatnonzero(np.diff(counts)):
        between = 0.5 * (counts[i] + counts[i + 1])
        turn = brentq(lambda turn, between=between: out(turn) - between, around[i], around[i + 1])
        z = poles(turn)
        angle = float(np.angle(z[np.argmin(np.abs(np.abs(z) - 1.0))]))
        if angle > 0.0:
            delays.append(turn / angle * len(opened) * period)
    return min(delays, default=None)


def _first(radii: Callable[[np.ndarray], np.ndarray], low: float, grid: np.ndarray, at_once: int = 20) -> float | None:
    """Return the first number above ``low`` at which a pole leaves the unit circle; None if none up to the end does.

    ``radii(numbers)`` is the largest modulus of the poles at each; it gets ``at_once`` numbers of ``grid`` at a time.
    """
    from scipy.optimize import brentq

    def beyond(number: float) -> float:
        return float(radii(np.array([number]))[0]) - (1.0 + MARGINAL)

    for start in range(0, grid.size, at_once):
        out = np.flatnonzero(radii(grid[start : start + at_once]) > 1.0 + MARGINAL)
        if out.size:
            place = start + int(out[0])
            low, high = float(grid[place - 1]) if place else low, float(grid[place])
            return brentq(beyond, low, high, xtol=1e-15 * high, rtol=1e-14)
    return None
