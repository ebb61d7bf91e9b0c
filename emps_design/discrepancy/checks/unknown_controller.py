"""Records whose controller is not known: command and motion on one clock, at the rate of what they tell.

Nothing is computed from sample to sample where no law is, so the sampling rate is not the machine's but the log's. What
lies beyond the band in which the encoder tells an acceleration from its noise is left out, command and motion alike;
and a command that was logged up to a sample and a half beside the motion is put back: no record can tell that from a
drive that is late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy.checks.preparation import BESIDE
from emps_design.discrepancy.checks.requirements import check_clock
from emps_design.discrepancy.model.bands import CUTOFF_HZ, FASTEST, cutoff, told_up_to
from emps_design.identification.filters import held, low_pass, motion
from emps_design.laws import NONE
from emps_design.observer import motor_share
from emps_design.records import Record
from emps_design.records.columns import OPTIONAL

STEP = 0.1  # samples, by which it is moved
SAID = 0.5  # samples, from which on that is said
HELD = ("f_ext", "supply", "excitation")  # signals that are a mean over a period, as a command is
SWITCHED = ("enable", "bridged")


def with_known_command(
    records: Sequence[Record], axis: Axis, holdout: Record | None = None
) -> tuple[tuple[Record, ...], Record | None, Axis, tuple[str, ...]]:
    """``records`` and ``holdout`` as they are compared, the ``axis`` at their period, and what was done, in words.

    All as they are where the controller is known, but for the words.
    """
    everything = [*records, *([] if holdout is None else [holdout])]
    resolution, notes = axis.sampling.encoder_resolution, []
    for record in everything:
        check_clock(record, axis)
    if axis.controller.kind == NONE:
        told = max(told_up_to(record, resolution) for record in everything)
        period = axis.sampling.period
        every = max(1, int(FASTEST / (period * told)))
        late = _beside(everything, axis, told)
        if abs(late) >= SAID:
            notes.append(
                f"The command was logged {abs(late):.2g} samples {'after' if late > 0 else 'before'} what the motion "
                "answers to, and is moved by that: less than two samples tell a drive's delay from none of the log's"
            )
        waits = axis.sampling.computation_delay
        everything = [_at_rate(_moved(record, late - waits), every) for record in everything]
        axis = axis.replace(sampling={"period": every * period, "computation_delay": 0})
    highest = cutoff(axis.sampling.period)
    if highest < CUTOFF_HZ:
        notes.append(f"Nothing above {highest:.2g} Hz can be told")
    kept = everything if holdout is None else everything[:-1]
    return tuple(kept), None if holdout is None else everything[-1], axis, tuple(notes)


def _beside(records: Sequence[Record], axis: Axis, highest: float) -> float:
    """By how many samples the command of ``records`` comes after what the motion answers to, 0 where that is not told.

    Where mass and frictions explain most of it, and a shaft's weight, in the band up to ``highest`` [Hz].
    """
    shifts = STEP * np.arange(-round(BESIDE / STEP), round(BESIDE / STEP) + 1)
    left = np.zeros(shifts.size)
    for record in records:
        seen = motion(record, highest)
        columns = [seen.a, seen.v, np.tanh(seen.v / (0.01 * np.abs(seen.v).max())), np.ones(len(record)), seen.q]
        columns += [np.sin(seen.q), np.cos(seen.q)]
        basis = np.linalg.qr(np.column_stack(columns))[0]
        share = motor_share(axis, record)
        for place, shift in enumerate(shifts):
            force = low_pass(held(share * _moved(record, shift).u), highest, record.period)
            rest = force - basis @ (basis.T @ force)
            left[place] += float(rest @ rest)
    best = int(np.argmin(left))
    return float(shifts[best]) if 0 < best < shifts.size - 1 else 0.0


def _moved(record: Record, samples: float) -> Record:
    """``record`` with its command ``samples`` earlier."""
    if samples == 0.0:
        return record
    places = np.arange(len(record), dtype=float)
    return replace(record, u=np.interp(places + samples, places, record.u))


def _at_rate(record: Record, every: int) -> Record:
    """``record`` with one sample of ``every``, without what is too fast for that; its motion stands for a reference."""
    period, count = every * record.period, len(record) // every

    def mean(signal: np.ndarray) -> np.ndarray:
        return slow(signal)[: every * count].reshape(count, every).mean(axis=1)

    def slow(signal: np.ndarray) -> np.ndarray:
        return low_pass(signal, FASTEST / period, record.period) if every > 1 else signal

    def at_rate(name: str, signal: np.ndarray | None) -> np.ndarray | None:
        if signal is None:
            return None
        if name in SWITCHED:
            return signal[: every * count].reshape(count, every).max(axis=1)
        return mean(signal) if name in HELD else slow(signal)[: every * count : every]

    q = slow(record.q)[: every * count : every]
    optional: Any = {name: at_rate(name, getattr(record, name)) for name in OPTIONAL}
    way = low_pass(q, FASTEST / period, period)
    u = mean(record.u)
    return replace(
        record,
        t=period * np.arange(count),
        q_ref=way,
        q=q,
        u=u,
        period=period,
        measured=None,
        q_ref_recorded=False,
        **optional,
    )
