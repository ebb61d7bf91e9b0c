"""What a record says about its own experiment: the instrument, its period, and where the carriage runs steadily.

The instrument is what moves the loop from outside: the ``excitation`` that was added to the controller's output, else
the increments of the reference. Dry friction is a constant only while the carriage runs one way, so reversals and rests
in what is used are counted.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from emps_design.errors import RecordError
from emps_design.frequency_response.quantisation import encoder_step
from emps_design.frequency_response.steps import Step, steps_of
from emps_design.records import Record
from emps_design.stretches import stretches

EXCITATION, REFERENCE, COMMAND = INSTRUMENTS = ("excitation", "reference", "command")
SAME = 1e-3  # share of its power by which one period may differ from the next
STEADY = 2e-3  # share of the highest speed by which a reference may differ a period later
SHORTEST = 8  # samples of a period
FEWEST = 64  # samples of a stretch
CORRELATED = 0.4  # of two periods in a row at least half is the same again one period later
CANDIDATES = 100  # lags that are looked at
LOOKED_AT = 1 << 20  # samples in which the period of a long record shows, or it has none


@dataclass(frozen=True, eq=False)
class Signals:
    """Instrument, command and position increments of one record, (n,) each, and the stretches that can be used.

    ``r`` instrument, ``u`` command [V], ``dq`` increments [m]; ``repeats`` is the period of the instrument in samples,
    0 where it has none; ``stretches`` holds first and last sample (excluded) of each, ``steps`` of a stepped sine.
    """

    name: str
    kind: str
    r: np.ndarray
    u: np.ndarray
    dq: np.ndarray
    period: float
    repeats: int
    stretches: tuple[tuple[int, int], ...]
    bias: np.ndarray = field(repr=False)
    steps: tuple[Step, ...] = ()

    @cached_property
    def step(self) -> float:
        """The step of the encoder [m] that the increments show; 0 for none."""
        return encoder_step(self.dq)

    @property
    def used(self) -> np.ndarray:
        """Which samples are in a stretch (n,)."""
        used = np.zeros(self.r.size, dtype=bool)
        for start, stop in self.stretches:
            used[start:stop] = True
        return used


def signals_of(record: Record, instrument: str = "") -> Signals:
    """Find the instrument of ``record``, its period and the stretches in which the reference runs steadily.

    ``instrument`` is ``excitation``, ``reference`` or ``command``, by default the first of the first two that the
    record has. The command is none, since feedback is in it: it gives the ratio of spectra. Stretches in which the
    motor is switched off throughout are left out, and what is in a gap. Raises :class:`RecordError` where there is no
    instrument, and where the motor is off in all stretches, or gaps are everywhere.
    """
    excitation, bias = record.excitation, _reference_increments(record)
    if not instrument:
        instrument = EXCITATION if excitation is not None and np.ptp(excitation) > 0.0 else REFERENCE
    if instrument == EXCITATION:
        if excitation is None:
            raise RecordError(f"{record.name}: found no column excitation, expected what was added to the command")
        r = excitation
    else:
        r = record.u if instrument == COMMAND else bias
    if np.ptp(r) == 0.0:
        raise RecordError(
            f"{record.name}: found a reference that stands still or runs evenly and no excitation, expected one of "
            "them to move the loop: without it noise and feedback cannot be told from the plant"
        )
    dq = np.diff(record.q, prepend=record.q[:1])
    steps = steps_of(r) if instrument != COMMAND else ()
    repeats = 0
    if instrument != COMMAND and not steps:
        repeats = _repeats(r, bias if instrument == EXCITATION else None)
    runs = [(one.start, one.stop) for one in steps] or _stretches(r, bias, repeats, instrument)
    if repeats and not runs:  # once on each pass: nothing is periodic in that
        repeats, runs = 0, _stretches(r, bias, 0, instrument)
    if len(record.pieces) > 1:
        runs, steps = _within(runs, steps, record.pieces, 2 * repeats or FEWEST)
        if not runs:
            raise RecordError(
                f"{record.name}: found no stretch between its gaps that is long enough for the {instrument}, expected "
                f"{'two whole periods' if repeats or steps else f'{FEWEST} samples'}"
            )
    if record.enable is not None:
        on = [bool(np.any(record.enable[start:stop])) for start, stop in runs]
        if runs and not any(on):
            raise RecordError(
                f"{record.name}: found enable 0 wherever the {instrument} could be used, expected the motor switched on"
            )
        runs = [run for run, one in zip(runs, on, strict=True) if one]
        steps = tuple(step for step in steps if (step.start, step.stop) in runs)
    return Signals(
        record.name,
        instrument,
        r,
        record.u,
        dq,
        record.period,
        repeats,
        tuple(runs),
        bias,
        steps,
    )


def _reference_increments(record: Record) -> np.ndarray:
    """What the reference moves by in each period (n,) [m], 0 where the record has none."""
    if record.q_ref_recorded:
        return np.diff(record.q_ref, prepend=record.q_ref[:1])
    if record.velocity_reference is not None:
        return record.velocity_reference * record.period
    return np.zeros(len(record))


def _repeats(r: np.ndarray, bias: np.ndarray | None) -> int:
    """Period of ``r`` in samples, the shortest that holds over at least two of them somewhere; 0 for none."""
    from scipy.fft import irfft, next_fast_len, rfft
    from scipy.signal import find_peaks

    active = np.flatnonzero(np.abs(r - np.median(r)) > 0.0)
    if active.size < 2 * SHORTEST:
        return 0
    part = r[active[0] : active[-1] + 1][:LOOKED_AT]
    # A reference runs on, and speeds up evenly: what repeats shows in its jerk.
    part = np.diff(part, 2) if bias is None else part - np.mean(part)
    size_of = np.abs(part)
    usual = float(np.median(size_of[size_of > 1e-6 * np.max(size_of)]))
    limited = np.clip(part, -6.0 * usual, 6.0 * usual)  # a jerk here and there is no period
    size = next_fast_len(2 * part.size, real=True)
    spectrum = rfft(limited, size)
    correlation = irfft(spectrum.real**2 + spectrum.imag**2, size)[: part.size]
    overlap = np.arange(part.size, 0, -1) / part.size
    even = correlation[overlap > 0.1] / correlation[0] / overlap[overlap > 0.1]
    peaks = find_peaks(even, height=CORRELATED)[0]
    return next((int(lag) for lag in peaks[peaks >= SHORTEST][:CANDIDATES] if _holds(limited, int(lag))), 0)


def _holds(part: np.ndarray, lag: int) -> bool:
    """Whether ``part`` repeats after ``lag`` samples over at least one whole period."""
    gap = (part[lag:] - part[:-lag]) ** 2
    power = 0.5 * (part[lag:] ** 2 + part[:-lag] ** 2)
    if gap.size < lag:
        return False
    total = np.concatenate([[0.0], np.cumsum(gap)]), np.concatenate([[0.0], np.cumsum(power)])
    window = [one[lag:] - one[:-lag] for one in total]
    good = (window[1] > 0.25 * np.max(window[1])) & (window[0] <= SAME * window[1])
    return bool(np.any(good))


def _stretches(r: np.ndarray, bias: np.ndarray, repeats: int, kind: str) -> list[tuple[int, int]]:
    """Runs in which the reference runs evenly and the instrument repeats, or is at work where it never repeats."""
    fastest = float(np.max(np.abs(bias)))
    if kind == COMMAND:
        return [(0, r.size)]
    if repeats:
        good = np.abs(r[repeats:] - r[:-repeats]) <= 0.05 * np.sqrt(np.mean(r**2))
        good &= np.abs(bias[repeats:] - bias[:-repeats]) <= STEADY * fastest + 1e-15
        busy = np.concatenate([[0.0], np.cumsum((r - np.median(r)) ** 2)])
        power = busy[repeats:] - busy[:-repeats]
        good &= power[: good.size] > 0.1 * np.max(power)
        runs = [(start, stop + repeats) for start, stop in stretches(good) if stop - start >= repeats // 2]
        return [(start, stop) for start, stop in runs if stop - start >= 2 * repeats]
    active = np.flatnonzero(np.abs(r - np.median(r)) > 0.0)
    first, last = int(active[0]), int(active[-1]) + 1
    if kind == EXCITATION and fastest > 0.0:
        even = np.abs(np.diff(bias[first:last], prepend=bias[first])) <= 1e-3 * STEADY * fastest + 1e-15
        even &= np.abs(bias[first:last]) > 0.0
        runs = [(first + a, first + b) for a, b in stretches(even) if b - a >= FEWEST]
        if sum(b - a for a, b in runs) > 0.3 * (last - first):
            return runs
    return [(first, last)]


def _within(
    runs: list[tuple[int, int]], steps: tuple[Step, ...], pieces: list[tuple[int, int]], shortest: int
) -> tuple[list[tuple[int, int]], tuple[Step, ...]]:
    """What of ``runs``, or of the ``steps`` that they are, lies within ``pieces`` and is not too short [samples].

    The first increment of a piece but the first comes out of a gap.

    >>> _within([(0, 50), (60, 90)], (), [(0, 20), (30, 80)], 19)
    ([(0, 20), (31, 50), (60, 80)], ())
    """
    of_steps = [2 * step.samples for step in steps] or [shortest] * len(runs)
    cut = [
        (place, max(a, start + (start > 0)), min(b, stop))
        for place, (a, b) in enumerate(runs)
        for start, stop in pieces
    ]
    long = [(place, a, b) for place, a, b in cut if b - a >= of_steps[place]]
    return [(a, b) for _, a, b in long], tuple(replace(steps[i], start=a, stop=b) for i, a, b in long if steps)


def motion(signals: Signals) -> dict[str, float]:
    """Reversals and the share of time at rest in what is used of a record, and its mean speed [m/s].

    The velocity is that over as many samples as the carriage takes, at its mean speed, for eight steps of the encoder.
    """
    steps = np.abs(signals.dq[signals.dq != 0.0])
    step = float(np.min(steps)) if steps.size else 0.0
    reversals = rests = count = 0
    speed = 0.0
    for start, stop in signals.stretches:
        moved = signals.dq[start:stop]
        typical = float(np.mean(np.abs(moved)))
        window = int(min(max(1, np.ceil(8.0 * step / typical if typical > 0.0 else 1)), max(1, moved.size // 4)))
        blocks = moved[: moved.size // window * window].reshape(-1, window).sum(axis=1)
        signs = np.sign(blocks[blocks != 0.0])
        reversals += int(np.count_nonzero(np.diff(signs)))
        still = np.abs(blocks) < 0.02 * typical * window
        rests += window * sum(b - a for a, b in stretches(still) if (b - a) * window >= 5)
        count += moved.size
        speed += float(np.sum(np.abs(moved)))
    return {
        "reversals": reversals,
        "rest_share": rests / count,
        "mean_speed": speed / count / signals.period,
        "seconds": count * signals.period,
    }
