"""From a record to motion and force that were filtered alike: three chains, each says what it does to the signals.

The drive holds u[k] over [t_k, t_k + T). Averaged with the triangle of width 2T around t_k, the motor force is
(u[k] + u[k-1])/2 and the acceleration the second difference of the position, both exactly; the ``hold`` chain
regresses one on the other. A regression of u[k] on the motion at t_k sees half a sample of delay instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from emps_design.effects import Motion
from emps_design.errors import InputError, RecordError
from emps_design.records import Record

REPORT_CUTOFF = 100.0  # Hz, five times the 20 Hz band of interest of the 2019 report
REPORT_DROPPED = 49  # first samples, spoilt by the ends of filter and differences
DECIMATION = 10
BLOCK = 200_000  # samples that are filtered at a time
REST_VELOCITY = 2e-3  # m/s, below it friction may be that of rest
FEWEST_ROWS = 400  # away from rest, for a regression that leaves rest out
REACH = 1.5  # periods of the cut-off over which the low-pass spreads a jump


@dataclass(frozen=True)
class Filtered:
    """A record after its chain of filters.

    ``motion`` has one row a sample of the record that was kept (None once W is made of it), and ``reduce`` brings such
    a column to the rate of the regression. At that rate are ``t`` [s], ``force`` [N] and ``f_ext`` [N], which rows are
    ``used``, and which lie ``away`` from rest; ``period`` [s] is the time between two rows. ``cutoff_hz`` [Hz] is the
    low-pass of the position (None: the chain has none), ``band_hz`` [Hz] what the regression sees.
    """

    chain: str
    motion: Motion | None = field(repr=False)
    t: np.ndarray = field(repr=False)
    force: np.ndarray
    f_ext: np.ndarray | None
    reduce: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    used: np.ndarray = field(repr=False)
    away: np.ndarray = field(repr=False)
    period: float
    cutoff_hz: float | None
    band_hz: float
    decimation: int
    text: str


def low_pass(signal: np.ndarray, cutoff_hz: float, period: float, order: int = 4) -> np.ndarray:
    """Run a Butterworth low-pass forwards and backwards: no phase, twice the attenuation.

    ``signal`` (n,), ``cutoff_hz`` [Hz] below the Nyquist frequency, ``period`` [s]. Returns (n,). The two passes
    leave half the amplitude at the cut-off. Raises :class:`InputError` for a cut-off that cannot be.

    >>> t = np.arange(2000) * 1e-3
    >>> slow = low_pass(np.sin(2 * np.pi * 2 * t) + np.sin(2 * np.pi * 200 * t), 20.0, 1e-3)
    >>> bool(np.abs(slow - np.sin(2 * np.pi * 2 * t))[200:-200].max() < 1e-3)
    True
    """
    from scipy.signal import butter

    nyquist = 0.5 / period
    if not 0 < cutoff_hz < nyquist:
        raise InputError(
            f"cut-off: found {cutoff_hz:g} Hz, expected between 0 and the Nyquist frequency {nyquist:g} Hz"
        )
    share = cutoff_hz / nyquist
    return _forwards_and_backwards(butter(order, share, output="sos"), signal, _padding(order, len(signal)), share)


def decimate(signal: np.ndarray, factor: int = DECIMATION) -> np.ndarray:
    """Low-pass ``signal`` without phase at 0.8 of the new Nyquist frequency and keep one sample in ``factor``.

    Chebyshev type I of order 8 with 0.05 dB ripple, forwards and backwards; the last sample is among those kept, as
    in the routine that the 2019 report used (its tables depend on it). At rest its gain is -0.1 dB, so all columns of a
    regression shrink alike by 1.1 %. Returns (ceil(n / factor),).

    >>> decimate(np.ones(101), 10).size
    11
    """
    from scipy.signal import cheby1

    if factor == 1:
        return signal
    share = 0.8 / factor
    sections = cheby1(8, 0.05, share, output="sos")
    rows = decimated_rows(len(signal), factor)
    return _forwards_and_backwards(sections, signal, _padding(8, len(signal)), share, rows)


def decimated_rows(n: int, factor: int = DECIMATION) -> slice:
    """The samples that :func:`decimate` keeps of ``n``.

    >>> np.arange(25)[decimated_rows(25, 10)].tolist()
    [4, 14, 24]
    """
    return slice((n - 1) % factor, None, factor)


def motion(record: Record, cutoff_hz: float) -> Motion:
    """Position, velocity and acceleration of ``record``, zero-phase low-passed at ``cutoff_hz`` [Hz], full length.

    Velocity is the central, acceleration the second difference (see the module's text on the hold). ``tau`` is zero:
    :func:`emps_design.identification.inverse_model.with_predicted_force` fills in a model's.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.practice import practice_record
    >>> record = practice_record(machine("emps2019"), laps=1)
    >>> seen = motion(record, 50.0)
    >>> seen.v.shape == record.q.shape, round(float(abs(seen.v).max()), 1)
    (True, 0.2)
    """

    def smooth(signal: np.ndarray) -> np.ndarray:
        return low_pass(signal, cutoff_hz, record.period)

    q = smooth(record.q)
    return Motion(
        t=record.t,
        q=q,
        v=_central_difference(q, record.period),
        a=_second_difference(q, record.period),
        tau=np.zeros_like(q),
        period=record.period,
        smooth=smooth,
    )


def held_force(record: Record, force_gain: float, cutoff_hz: float) -> np.ndarray:
    """Motor force around t_k of a voltage that is held, G_tau (u[k] + u[k-1])/2, low-passed like the motion [N]."""
    return low_pass(force_gain * held(record.u), cutoff_hz, record.period)


def held(u: np.ndarray) -> np.ndarray:
    """Mean around t_k of a signal held over [t_k, t_k + T): (u[k] + u[k-1])/2.

    >>> held(np.array([0.0, 2.0, 2.0])).tolist()
    [0.0, 1.0, 2.0]
    """
    mean = np.array(u, dtype=float)
    mean[1:] = 0.5 * (mean[1:] + u[:-1])
    return mean


def report_chain(record: Record, force_gain: float, cutoff_hz: float | None = None) -> Filtered:
    """The chain of the 2019 report: what its tables were made with.

    Position low-passed at 100 Hz (4th order, forwards and backwards), central differences twice, first 49 samples
    dropped, columns and raw force decimated by 10. It sees the hold as half a sample of delay.
    """
    cutoff_hz = cutoff_hz or REPORT_CUTOFF
    force = _decimated(record.u, force_gain)
    q = low_pass(record.q, cutoff_hz, record.period)
    v = _central_difference(q, record.period)
    a = _central_difference(v, record.period)
    return _decimating(
        "report",
        record,
        (q, v, a),
        force_gain,
        force,
        None if record.f_ext is None else _decimated(record.f_ext),
        cutoff_hz,
        f"position: Butterworth order 4 at {cutoff_hz:g} Hz, forwards and backwards; central differences; "
        f"first {REPORT_DROPPED} samples dropped; all columns decimated by {DECIMATION}",
    )


def paper_chain(record: Record, force_gain: float, cutoff_hz: float | None = None) -> Filtered:
    """The chain of the 2018 paper, section III-A: medfilt1, decimate, backward and central differences.

    Velocity is the backward difference of the measured position, acceleration the central difference of the filtered
    velocity; a median of three, then decimation by 10 (the paper does not give its factor). ``cutoff_hz`` is refused:
    the chain's low-pass is the decimation's.
    """
    if cutoff_hz is not None:
        raise InputError("cut-off: the paper's chain has none, its low-pass is the decimation's; use --filter hold")
    force = _decimated(median_of_three(record.u), force_gain)
    v = median_of_three(np.diff(record.q, prepend=record.q[0]) / record.period)
    a = median_of_three(_central_difference(v, record.period))
    return _decimating(
        "paper",
        record,
        (median_of_three(record.q), v, a),
        force_gain,
        force,
        None if record.f_ext is None else _decimated(median_of_three(record.f_ext)),
        None,
        f"backward difference, median of 3, central difference of that velocity, decimated by {DECIMATION}",
    )


def _decimated(signal: np.ndarray, gain: float = 1.0) -> np.ndarray:
    return gain * decimate(signal[REPORT_DROPPED:])


def _decimating(
    chain: str,
    record: Record,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    force_gain: float,
    force: np.ndarray,
    f_ext: np.ndarray | None,
    cutoff_hz: float | None,
    text: str,
) -> Filtered:
    """The chains that drop the first samples and decimate every column."""
    kept = slice(REPORT_DROPPED, None)
    q, v, a = (signal[kept] for signal in motion)
    seen = Motion(record.t[kept], q, v, a, np.zeros(len(q)), record.period, force_gain=force_gain)
    rows = decimated_rows(len(q))
    band = 0.8 * 0.5 / (DECIMATION * record.period)
    band = band if cutoff_hz is None else min(cutoff_hz, band)
    return Filtered(
        chain=chain,
        motion=seen,
        t=seen.t[rows],
        force=force,
        f_ext=f_ext,
        reduce=decimate,
        used=np.ones(len(force), dtype=bool),
        away=sliding(seen, band)[rows],
        period=DECIMATION * record.period,
        cutoff_hz=cutoff_hz,
        band_hz=band,
        decimation=DECIMATION,
        text=text,
    )


def hold_chain(record: Record, force_gain: float, cutoff_hz: float | None = None) -> Filtered:
    """This package's chain: the hold modelled, one zero-phase low-pass on motion and force, decimation without more.

    Rows near rest are left out (see :func:`sliding`): friction at rest is any force up to the break-away.
    ``cutoff_hz`` [Hz] defaults to the one :func:`emps_design.identification.cutoff.chosen_cutoff` finds in the data.
    """
    if cutoff_hz is None:
        from emps_design.identification.cutoff import chosen_cutoff

        cutoff_hz = chosen_cutoff(record).cutoff_hz
    # One sample per half period of four times the cut-off: what is left above it is under 1e-5 of the amplitude.
    factor = max(1, int(0.125 / (cutoff_hz * record.period)))
    edge = int(1.0 / (cutoff_hz * record.period))
    rows = slice(edge, len(record) - edge, factor)

    def reduce(column: np.ndarray) -> np.ndarray:
        return column[rows]

    force = reduce(held_force(record, force_gain, cutoff_hz)).copy()
    f_ext = None if record.f_ext is None else reduce(low_pass(record.f_ext, cutoff_hz, record.period)).copy()
    seen = replace(motion(record, cutoff_hz), force_gain=force_gain)
    used = reduce(sliding(seen, cutoff_hz))
    if int(used.sum()) < FEWEST_ROWS:
        raise RecordError(
            f"{record.name}: {int(used.sum())} rows away from rest at a cut-off of {cutoff_hz:g} Hz, expected at least "
            f"{FEWEST_ROWS}; record longer strokes above {1e3 * REST_VELOCITY:g} mm/s, or use --filter report"
        )
    return Filtered(
        chain="hold",
        motion=seen,
        t=reduce(record.t),
        force=force,
        f_ext=f_ext,
        reduce=reduce,
        used=used,
        away=used,
        period=factor * record.period,
        cutoff_hz=cutoff_hz,
        band_hz=cutoff_hz,
        decimation=factor,
        text=f"Butterworth order 4 at {cutoff_hz:g} Hz, forwards and backwards, on motion and held force alike; second "
        f"difference; one sample in {factor}; left out: slower than {1e3 * REST_VELOCITY:g} mm/s, or "
        f"{1e3 * REACH / cutoff_hz:.0f} ms from such a moment",
    )


def sliding(motion: Motion, cutoff_hz: float) -> np.ndarray:
    """Where the carriage slides for certain: shape (n,) of bool.

    False where it is slower than 2 mm/s, and within 1.5 periods of the cut-off [Hz] of such a moment: a zero-phase
    filter spreads the jump of friction at a reversal that far to both sides.
    """
    slow = (motion.v < REST_VELOCITY) & (motion.v > -REST_VELOCITY)
    reach, n = int(REACH / (cutoff_hz * motion.period)), len(slow)
    # Slow samples before each moment, so that those within reach are a difference.
    before = np.zeros(n + 2 * reach + 1, dtype=np.int32)
    np.cumsum(slow, out=before[reach + 1 : reach + n + 1])
    before[reach + n + 1 :] = before[reach + n]
    return before[2 * reach + 1 :] == before[:n]


CHAINS: dict[str, Callable[..., Filtered]] = {"report": report_chain, "paper": paper_chain, "hold": hold_chain}


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


# Both differences work in the array that they return: a long record's is not there twice.
def _central_difference(signal: np.ndarray, period: float) -> np.ndarray:
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


def _forwards_and_backwards(
    sections: np.ndarray, signal: np.ndarray, padding: int, share: float, rows: slice = slice(None)
) -> np.ndarray:
    """Zero-phase filter of second-order ``sections`` with cut-off ``share`` of the Nyquist frequency; only ``rows``.

    Long signals go through in blocks, which saves memory; they overlap by so much that the answer of the filter to what
    lies outside has fallen below rounding.
    """
    from scipy.signal import sosfiltfilt

    n, reach = len(signal), int(200.0 / share)
    if n <= BLOCK + 2 * reach:
        return sosfiltfilt(sections, signal, padlen=padding)[rows].copy()
    wanted = range(n)[rows]
    smooth, filled = np.empty(len(wanted)), 0
    for start in range(0, n, BLOCK):
        low, stop = max(0, start - reach), min(n, start + BLOCK)
        part = sosfiltfilt(sections, signal[low : min(n, stop + reach)], padlen=padding)
        first = wanted.start - low + -(-max(0, start - wanted.start) // wanted.step) * wanted.step
        kept = part[first : stop - low : wanted.step]
        smooth[filled : filled + len(kept)] = kept
        filled += len(kept)
    return smooth


def _padding(order: int, n: int) -> int:
    if n <= 3 * order:
        raise InputError(f"record: found {n} samples, expected more than {3 * order} for a filter of order {order}")
    return 3 * order
