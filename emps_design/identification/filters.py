"""Zero-phase filters and differences, the hold of the drive, rests and encoder noise.

The drive holds u[k] over [t_k, t_k + T). Averaged with the triangle of width 2T around t_k, the motor force is
(u[k] + u[k-1])/2 and the acceleration the second difference of the position, both exactly; the ``hold`` chain
regresses one on the other. A regression of u[k] on the motion at t_k has half a sample of delay instead.
A drive that is faster than its record does not hold u[k] so long: between samples the command is then a smooth curve,
whose average is (u[k-1] + 10 u[k] + u[k+1])/12 up to the fourth derivative (B. Numerov, 1924).

Rests and encoder noise are found from the position alone. Friction at rest is any force up to the break-away force, so
rows near a rest do not determine friction. A low cut-off would smooth short stops away, so rests are sought in a
velocity that is filtered only as much as the encoder noise requires.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from emps_design.effects import Motion
from emps_design.errors import InputError
from emps_design.records import Record

DECIMATION = 10
ORDERS = {"butterworth": 4, "chebyshev": 8}
BLOCK = 200_000  # samples that are filtered at a time

SLOW = 0.01  # of the largest velocity: below it friction may be that of rest
HIGHEST = 0.2  # of the sampling frequency: highest cut-off that is chosen
REACH = 1.5  # periods of the cut-off over which a low-pass smears a jump
FAR = 3.0  # periods of the cut-off over which it smears extrapolated samples
ACCELERATES = 0.1  # of the rms acceleration: above it an end of the record accelerates
BLOCKS = 50  # blocks, of whose noise estimates the median counts
MOVING = 0.1  # of a block's samples that differ from the one before: least share of a block that counts


def low_pass(signal: np.ndarray, cutoff_hz: float, period: float) -> np.ndarray:
    """Run a Butterworth low-pass of order 4 forwards and backwards: zero phase, twice the attenuation.

    ``signal`` (n,), ``cutoff_hz`` [Hz] below the Nyquist frequency, ``period`` [s]. Returns (n,). The two passes
    leave half the amplitude at the cut-off. Raises :class:`InputError` for an impossible cut-off.

    >>> t = np.arange(2000) * 1e-3
    >>> slow = low_pass(np.sin(2 * np.pi * 2 * t) + np.sin(2 * np.pi * 200 * t), 20.0, 1e-3)
    >>> bool(np.abs(slow - np.sin(2 * np.pi * 2 * t))[200:-200].max() < 1e-3)
    True
    """
    share = share_of_nyquist(cutoff_hz, period)
    return _forwards_and_backwards(_design("butterworth", share), signal, share)


class _Design(NamedTuple):
    """A low-pass of this ``order`` as second-order ``sections``, and its steady state for a ``constant`` of 1."""

    order: int
    sections: np.ndarray
    constant: np.ndarray


# Cached: designing a filter and its steady state takes as long as filtering ten thousand samples.
@lru_cache(maxsize=64)
def _design(kind: str, share: float) -> _Design:
    """The filter with cut-off ``share`` of the Nyquist frequency."""
    order = ORDERS[kind]
    sections = (
        scipy.signal.butter(order, share, output="sos")
        if kind == "butterworth"
        else scipy.signal.cheby1(order, 0.05, share, output="sos")
    )
    return _Design(order, sections, scipy.signal.sosfilt_zi(sections))


def share_of_nyquist(cutoff_hz: float, period: float) -> float:
    """Cut-off over the Nyquist frequency; :class:`InputError` for one [Hz] that does not lie below it.

    >>> share_of_nyquist(50.0, 1e-3)
    0.1
    """
    nyquist = 0.5 / period
    if not 0 < cutoff_hz < nyquist:
        raise InputError(
            f"cut-off: found {cutoff_hz:g} Hz, expected between 0 and the Nyquist frequency {nyquist:g} Hz"
        )
    return cutoff_hz / nyquist


def decimate(signal: np.ndarray, factor: int = DECIMATION) -> np.ndarray:
    """Zero-phase low-pass of ``signal`` at 0.8 of the new Nyquist frequency; keeps one sample in ``factor``.

    Chebyshev type I of order 8 with 0.05 dB ripple, forwards and backwards; the last sample is always kept, as in the
    routine of the 2019 report (its tables depend on it). Its static gain is -0.1 dB, so all columns of a regression
    shrink alike by 1.1 %. Returns (ceil(n / factor),).

    >>> decimate(np.ones(101), 10).size
    11
    """
    if factor == 1:
        return signal
    share = 0.8 / factor
    rows = decimated_rows(len(signal), factor)
    return _forwards_and_backwards(_design("chebyshev", share), signal, share, rows)


def decimated_rows(n: int, factor: int = DECIMATION) -> slice:
    """The samples that :func:`decimate` keeps of ``n``.

    >>> np.arange(25)[decimated_rows(25, 10)].tolist()
    [4, 14, 24]
    """
    return slice((n - 1) % factor, None, factor)


def motion(record: Record, cutoff_hz: float) -> Motion:
    """Position, velocity and acceleration (n,) of ``record``, zero-phase low-passed at ``cutoff_hz`` [Hz].

    Velocity is the central, acceleration the second difference (see the module's text on the hold). ``tau`` is zero;
    :func:`emps_design.identification.model.with_predicted_force` sets it to a model's force.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> record = synthetic_record(machine("emps2019"), laps=1)
    >>> smooth = motion(record, 50.0)
    >>> smooth.v.shape == record.q.shape, round(float(abs(smooth.v).max()), 1)
    (True, 0.2)
    """

    def smooth(signal: np.ndarray) -> np.ndarray:
        return low_pass(signal, cutoff_hz, record.period)

    # One block for all three, which is freed as a whole once W is computed.
    q, v, a = np.empty((3, len(record)))
    q[:] = smooth(record.q)
    v[:] = central_difference(q, record.period)
    a[:] = _second_difference(q, record.period)
    return Motion(
        t=record.t,
        q=q,
        v=v,
        a=a,
        tau=np.broadcast_to(0.0, len(q)),  # takes no memory
        period=record.period,
        smooth=smooth,
    )


def held_force(record: Record, force_gain: float, cutoff_hz: float) -> np.ndarray:
    """Motor force (n,) [N] around t_k, G_tau times the mean of the voltage there, low-passed like the motion."""
    mean = mean_of_held if record.held else mean_of_sampled
    force = low_pass(mean(record.u), cutoff_hz, record.period)
    force *= force_gain
    return force


def mean_of_held(u: np.ndarray) -> np.ndarray:
    """Mean around t_k of a signal held over [t_k, t_k + T): (u[k] + u[k-1])/2.

    >>> mean_of_held(np.array([0.0, 2.0, 2.0])).tolist()
    [0.0, 1.0, 2.0]
    """
    mean = np.array(u, dtype=float)
    mean[1:] += u[:-1]
    mean[1:] *= 0.5
    return mean


def mean_of_sampled(u: np.ndarray) -> np.ndarray:
    """Mean around t_k of a smooth curve through the samples: (u[k-1] + 10 u[k] + u[k+1])/12.

    >>> mean_of_sampled(np.array([0.0, 12.0, 0.0, 0.0])).tolist()
    [0.0, 10.0, 1.0, 0.0]
    """
    mean = np.array(u, dtype=float)
    mean[1:-1] = (u[:-2] + 10.0 * u[1:-1] + u[2:]) / 12.0
    return mean


def median_of_three(signal: np.ndarray) -> np.ndarray:
    """Running median of three samples, the ends padded with zeros as medfilt1 does.

    >>> median_of_three(np.array([1.0, 9.0, 2.0, 3.0])).tolist()
    [1.0, 2.0, 3.0, 2.0]
    """
    padded = np.concatenate([[0.0], signal, [0.0]])
    before, after = padded[:-2], padded[2:]
    median = np.maximum(before, signal)
    np.minimum(median, after, out=median)
    return np.maximum(np.minimum(before, signal), median, out=median)


# Both differences work in place on the returned array, to save memory with long records.
def central_difference(signal: np.ndarray, period: float) -> np.ndarray:
    """Slope of ``signal`` (n,) by central differences, one-sided at the ends, (n,) [unit of signal per s].

    >>> central_difference(np.array([0.0, 1.0, 4.0]), 1.0).tolist()
    [1.0, 2.0, 3.0]
    """
    slope = np.empty_like(signal)
    np.subtract(signal[2:], signal[:-2], out=slope[1:-1])
    slope[1:-1] /= 2.0 * period
    slope[0], slope[-1] = (signal[1] - signal[0]) / period, (signal[-1] - signal[-2]) / period
    return slope


def _second_difference(q: np.ndarray, period: float) -> np.ndarray:
    second = np.empty_like(q)
    inner = second[1:-1]
    np.multiply(q[1:-1], -2.0, out=inner)
    inner += q[2:]
    inner += q[:-2]
    inner /= period**2
    second[0], second[-1] = second[1], second[-2]
    return second


def _forwards_and_backwards(design: _Design, signal: np.ndarray, share: float, rows: slice = slice(None)) -> np.ndarray:
    """Zero-phase filter of a ``design`` with cut-off ``share`` of the Nyquist frequency; only ``rows``.

    Long signals are filtered in blocks, to save memory. They overlap so far that the response to samples outside a
    block is below rounding.
    """
    n, reach = len(signal), int(200.0 / share)
    if n <= 3 * design.order:
        raise InputError(
            f"record: found {n} samples, expected more than {3 * design.order} for a filter of order {design.order}"
        )
    if n <= BLOCK + 2 * reach:
        return _zero_phase(design, signal)[rows].copy()
    wanted = range(n)[rows]
    smooth, filled = np.empty(len(wanted)), 0
    for start in range(0, n, BLOCK):
        low, stop = max(0, start - reach), min(n, start + BLOCK)
        part = _zero_phase(design, signal[low : min(n, stop + reach)])
        first = wanted.start - low + -(-max(0, start - wanted.start) // wanted.step) * wanted.step
        kept = part[first : stop - low : wanted.step]
        smooth[filled : filled + len(kept)] = kept
        filled += len(kept)
    return smooth


def _zero_phase(design: _Design, signal: np.ndarray) -> np.ndarray:
    """Bit-identical to scipy's ``sosfiltfilt``, for second-order sections whose steady state is known."""
    padding = 3 * design.order
    before, after = 2.0 * signal[0] - signal[padding:0:-1], 2.0 * signal[-1] - signal[-2 : -2 - padding : -1]
    signal = np.concatenate([before, signal, after])
    for _ in range(2):
        signal = scipy.signal.sosfilt(design.sections, signal, zi=design.constant * signal[0])[0][::-1]
    return signal[padding:-padding]


def encoder_variance(record: Record) -> float:
    """Variance [m^2] of the encoder's white noise with its rounding: 1/70 of that of the position's fourth difference.

    Only blocks with motion count, for an axis at rest shows no steps; at least the rounding of the finest step.

    >>> t = np.arange(20000) * 1e-3
    >>> q = 0.1 * np.sin(t) + 2e-6 * np.random.default_rng(0).standard_normal(20000)
    >>> round(1e6 * encoder_variance(Record(t=t, q_ref=q, q=q, u=q, period=1e-3)) ** 0.5, 1)
    2.0
    """
    step = np.abs(np.diff(record.q))
    fourth, moves = _means(np.diff(record.q, 4) ** 2), _means(step[3:] > 0.0)
    moving = fourth[moves > MOVING]
    finest = float(np.min(step, initial=np.inf, where=step > 0.0))
    rounding = finest**2 / 12.0 if np.isfinite(finest) else 0.0
    return max(float(np.median(moving)) / 70.0 if moving.size else 0.0, rounding)


def _means(signal: np.ndarray) -> np.ndarray:
    """Means of ``signal`` (n,) over successive blocks of equal length, at most :data:`BLOCKS` of them."""
    size, longer = divmod(len(signal), BLOCKS)
    first, rest = signal[: longer * (size + 1)], signal[longer * (size + 1) :]
    parts = first.reshape(longer, size + 1), rest.reshape(-1, size) if size else rest.reshape(0, 1)
    return np.concatenate([np.mean(part, axis=1) for part in parts])


def at_rest(record: Record) -> np.ndarray:
    """Mask (n,) of the samples where the carriage reverses, is slower than 1 % of top speed, or was not recorded."""
    top = HIGHEST / record.period
    rough = central_difference(low_pass(record.q, top, record.period), record.period)
    slow = SLOW * float(np.quantile(np.abs(rough), 0.999))
    # White noise of variance s^2 causes the variance 2 s^2 T (2 pi)^2 f^3 / 3 of the velocity below f.
    density = max(2.0 * encoder_variance(record) * record.period, 1e-300)
    quiet = (3.0 * (slow / 3.0) ** 2 / ((2.0 * np.pi) ** 2 * density)) ** (1.0 / 3.0)
    v = rough
    if quiet < top:
        quiet = max(quiet, 10.0 / record.duration)
        v = central_difference(low_pass(record.q, quiet, record.period), record.period)
    rest = (v < slow) & (v > -slow)
    rest[1:] |= (v[1:] > 0) != (v[:-1] > 0)  # a reversal may happen between two samples
    return rest | record.in_gap


def known(record: Record, a: np.ndarray, cutoff_hz: float) -> np.ndarray:
    """Mask (n,) of the samples where a filter of ``cutoff_hz`` [Hz] uses no extrapolated signal.

    Extrapolated are gaps, and what lies beyond an end at which the axis accelerates (``a`` (n,)), for no reflection
    continues that. Unlike at a jump of friction all of the force is wrong there, which the filter smears further.
    """
    n = len(record)
    made_up = record.in_gap
    inside = min(int(1.0 / (cutoff_hz * record.period)), n - 1)  # where the reflection leaves the acceleration alone
    felt = ACCELERATES * float(np.sqrt(np.mean(a**2)))
    made_up[0] |= abs(a[inside]) > felt
    made_up[-1] |= abs(a[-1 - inside]) > felt
    return away_from(made_up, cutoff_hz * REACH / FAR, record.period)


def away_from(rest: np.ndarray, cutoff_hz: float, period: float) -> np.ndarray:
    """Mask (n,) of the samples at least 1.5 periods of the cut-off [Hz] from any ``rest`` (n,), which surely slide.

    A zero-phase filter smears a jump of friction that far to both sides.

    >>> away_from(np.array([False, False, True, False, False, False]), 1.5, 1.0).tolist()
    [True, False, False, False, True, True]
    """
    reach, n = int(REACH / (cutoff_hz * period)), len(rest)
    # Cumulative count of rests, so that those within reach are a difference.
    before = np.zeros(n + 2 * reach + 1, dtype=np.int32)
    np.cumsum(rest, out=before[reach + 1 : reach + n + 1])
    before[reach + n + 1 :] = before[reach + n]
    return before[2 * reach + 1 :] == before[:n]
