"""Filter chains: from a record to equally filtered motion and force. Three chains, each described in its text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.effects import Motion
from emps_design.errors import InputError, RecordError
from emps_design.identification.filters import (
    DECIMATION,
    REACH,
    SLOW,
    at_rest,
    away_from,
    central_difference,
    decimate,
    decimated_rows,
    held_force,
    known,
    low_pass,
    median_of_three,
    motion,
    share_of_nyquist,
)
from emps_design.identification.inverse_model import Filtered, chosen_cutoff
from emps_design.records import Record

REPORT_CUTOFF = 100.0  # Hz, five times the 20 Hz band of interest of the 2019 report
REPORT_DROPPED = 49  # first samples, spoilt by the ends of filter and differences
FEWEST_ROWS = 160  # away from rest, eight in a period of the cut-off, for a regression that leaves rest out
LONG = 1_000_000  # samples: longer records keep as few rows as possible


def report_chain(record: Record, force_gain: float, cutoff_hz: float | None = None) -> Filtered:
    """The chain of the 2019 report, which its tables were computed with.

    Position low-passed at 100 Hz (4th order, forwards and backwards), central differences twice, first 49 samples
    dropped, columns and raw force decimated by 10. The hold is not modelled: it acts as half a sample of delay.
    """
    if cutoff_hz is None:
        if 0.5 / record.period <= REPORT_CUTOFF:
            raise InputError(
                f"{record.name}: sampled at {1 / record.period:g} Hz, the report's low-pass of {REPORT_CUTOFF:g} Hz "
                f"needs more than {2 * REPORT_CUTOFF:g} Hz; use `filter='hold'`, or give `cutoff`"
            )
        cutoff_hz = REPORT_CUTOFF
    force = _decimated(record.u, force_gain)
    q, v, a = np.empty((3, len(record)))  # one block, as in motion()
    q[:] = low_pass(record.q, cutoff_hz, record.period)
    v[:] = central_difference(q, record.period)
    a[:] = central_difference(v, record.period)
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
        raise InputError("cut-off: the paper's chain has none, its low-pass is the decimation's; use `filter='hold'`")
    force = _decimated(median_of_three(record.u), force_gain)
    v = median_of_three(np.diff(record.q, prepend=record.q[0]) / record.period)
    a = median_of_three(central_difference(v, record.period))
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
    kept_motion = Motion(record.t[kept], q, v, a, np.zeros(len(q)), record.period, force_gain=force_gain)
    rows = decimated_rows(len(q))
    band = 0.8 * 0.5 / (DECIMATION * record.period)
    band = band if cutoff_hz is None else min(cutoff_hz, band)
    return Filtered(
        chain=chain,
        motion=kept_motion,
        t=kept_motion.t[rows],
        force=force,
        f_ext=f_ext,
        reduce=decimate,
        used=np.ones(len(force), dtype=bool),
        away=away_from(at_rest(record), band, record.period)[kept][rows],
        period=DECIMATION * record.period,
        cutoff_hz=cutoff_hz,
        band_hz=band,
        text=text,
    )


def hold_chain(
    record: Record, force_gain: float, cutoff_hz: float | None = None, fewest_rows: int = FEWEST_ROWS
) -> Filtered:
    """This package's chain: the hold modelled, the same zero-phase low-pass on motion and force, then decimation.

    Rows near rest are left out, for friction at rest is any force up to the break-away force. So are the ends of a
    record that accelerate there, for the filters of motion and force extrapolate differently.
    ``cutoff_hz`` [Hz] defaults to :func:`emps_design.identification.inverse_model.chosen_cutoff` of the record.
    Raises :class:`RecordError` where fewer than ``fewest_rows`` are left.
    """
    if cutoff_hz is None:
        cutoff_hz = chosen_cutoff(record)
    # Two samples per period of four times the cut-off, above which under 2e-5 of the amplitude is left. Of three times
    # the cut-off in long records, to save memory: under 2e-4.
    often = 4.0 if len(record) <= LONG else 3.0
    factor = max(1, int(1.0 / (often * share_of_nyquist(cutoff_hz, record.period))))
    edge = int(1.0 / (cutoff_hz * record.period))
    rows = slice(edge, len(record) - edge, factor)

    def reduce(column: np.ndarray) -> np.ndarray:
        return column[rows]

    force = reduce(held_force(record, force_gain, cutoff_hz)).copy()
    f_ext = None if record.f_ext is None else reduce(low_pass(record.f_ext, cutoff_hz, record.period)).copy()
    filtered_motion = replace(motion(record, cutoff_hz), force_gain=force_gain)
    used = reduce(away_from(at_rest(record), cutoff_hz, record.period) & known(record, filtered_motion.a, cutoff_hz))
    if int(used.sum()) < fewest_rows:
        raise RecordError(
            f"{record.name}: {int(used.sum())} rows away from rest at a cut-off of {cutoff_hz:g} Hz, expected at least "
            f"{fewest_rows}; record longer strokes"
        )
    return Filtered(
        chain="hold",
        motion=filtered_motion,
        t=reduce(record.t),
        force=force,
        f_ext=f_ext,
        reduce=reduce,
        used=used,
        away=used,
        period=factor * record.period,
        cutoff_hz=cutoff_hz,
        band_hz=cutoff_hz,
        text=f"Butterworth order 4 at {cutoff_hz:g} Hz, forwards and backwards, on motion and held force alike; second "
        f"difference; one sample in {factor}; left out: slower than {100 * SLOW:g} % of the largest velocity, or "
        f"{1e3 * REACH / cutoff_hz:.0f} ms from such a moment",
    )


DEFAULT_CHAIN = "hold"
CHAINS: dict[str, Callable[..., Filtered]] = {"hold": hold_chain, "report": report_chain, "paper": paper_chain}
