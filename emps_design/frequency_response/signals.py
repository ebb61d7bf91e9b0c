"""Signals of a frequency-response record: the instrument, its period, its steps, and the stretches at steady speed.

The instrument excites the loop from outside: the ``excitation`` that was added to the controller's output, else the
increments of the reference. Dry friction is constant only while the carriage runs one way, so reversals and rests in
the stretches are counted.

Quantisation. The encoder reads x + e(x), e a sawtooth of one step d with variance d^2/12. Under a periodic excitation
the carriage advances by a distance a in each period. The m-th harmonic of the sawtooth, with power proportional to
1/m^2, then turns by m a/d: its share that repeats in P periods is (sin(pi P x)/(P sin(pi x)))^2 with x = m a/d. At an
advance of whole steps all of e repeats: it falls on the excited lines, and the lines between, from which the noise is
estimated, do not show it. Source: W. R. Bennett, Bell System Technical Journal 27, 1948 (the spectrum of e).

Stepped sine. Its steps are runs of a single sine in the instrument, with pauses between them. The instrument is free of
noise, so the frequency of each run, and the number of samples after which it repeats, are exact to many digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from emps_design.errors import RecordError
from emps_design.records import Record
from emps_design.records.record import step_before_rounding
from emps_design.stretches import stretches

HARMONICS = 64  # of the sawtooth
OFFSETS = 16  # positions of the carriage within a step that are averaged
NEAR = 9  # neighbouring lines over which the powers are averaged
CLEAR = 10.0  # times the power of steps that all repeat, above which a line is motion
TINY = 1e-3  # share of the noise below which quantisation is neglected

ACTIVE = 1e-4  # of the largest change from sample to sample, above which the instrument is active
HOLE = 16  # samples without change inside a run: the extremes of a slow sine
SHORTEST_RUN = 32  # samples of a run
PURE = 1e-3  # share of its power by which a run may differ from a sine
EVEN = 1e-2  # share of its amplitude by which a sine may differ a block later
WHOLE_PERIODS = 1e-5  # of a period, by which a block may miss whole periods
SETTLING = 5  # the first of so many parts of a step is for the loop to settle
FEWEST_LINES = 4  # different lines, or one
MOST_OF_A_RUN = 1 << 16  # samples of a run that are tested for a sine
NARROW, BESIDE = 1e-3, 4  # of the strongest line, power of one that counts; bins on either side that belong to it

EXCITATION, REFERENCE, COMMAND = INSTRUMENTS = ("excitation", "reference", "command")
SAME = 1e-3  # share of its power by which one period may differ from the next
STEADY = 2e-3  # share of the highest speed by which a reference may differ a period later
SHORTEST = 8  # samples of a period
FEWEST = 64  # samples of a stretch
CORRELATED = 0.4  # least correlation at the period: of two periods, half of the samples have a partner
CANDIDATES = 100  # lags that are tried
LOOKED_AT = 1 << 20  # samples in which a period is sought


def repeated_share(advance: np.ndarray | float, periods: int) -> np.ndarray:
    """Share (...) of the quantisation power that repeats over ``periods``, at an ``advance`` (...) [steps per period].

    >>> repeated_share(np.array([17.0, 17.5, 17.618]), 4).round(2).tolist()
    [1.0, 0.25, 0.1]
    """
    m = np.arange(1, HARMONICS + 1)
    turn = np.asarray(advance)[..., None] * m
    turn = turn - np.rint(turn)
    same = (np.sinc(periods * turn) / np.sinc(turn)) ** 2
    return np.sum(same / m**2, axis=-1) / np.sum(1.0 / m**2)


def quantised(
    dq: np.ndarray, periods: int, at: np.ndarray, excited: np.ndarray, noise: np.ndarray, step: float
) -> tuple[np.ndarray, float]:
    """Power (m,) that repeated quantisation adds to the spectrum of increments ``dq`` (n,) at the lines ``at``, beyond
    the ``noise`` (m,) between them, and the ratio of the power that repeats to what would repeat by chance.

    The motion is reconstructed from the ``excited`` (m,) lines, the mean position of each period, and noise like that
    between the lines. It is rounded to steps at several offsets, and the spectra of the rounding errors are averaged.
    Spectra are normalised by the number of samples.
    """
    size = dq.size
    turn = np.abs(1.0 - np.exp(-2j * np.pi * np.arange(size // 2 + 1) / size)) ** 2
    white = step**2 / 12.0 / size * turn[at]
    if step == 0.0 or periods * np.max(white / np.maximum(noise, 1e-300)) < TINY:
        return np.zeros(at.size), 1.0
    spectrum = scipy.fft.rfft(dq) / size
    between = np.ones(turn.size, dtype=bool)
    between[:: at[0]] = False  # the first line is the base period's
    kept, clear = np.zeros(turn.size, complex), at[excited & (np.abs(spectrum[at]) ** 2 > CLEAR * periods * white)]
    kept[clear] = spectrum[clear] / (1.0 - np.exp(-2j * np.pi * clear / size))
    position, moved = np.cumsum(dq), scipy.fft.irfft(kept * size, size)
    moved += _drift(position - moved, periods)
    spread = step * np.sqrt(_noise_power((position - moved) / step, periods) / (12.0 * size))
    random, power, levels = np.random.default_rng(0), np.zeros(turn.size), np.zeros(OFFSETS)
    for i in range(OFFSETS):
        noisy = spread * np.exp(2j * np.pi * random.random(turn.size))
        x = (moved + scipy.fft.irfft(noisy * size, size)) / step + i / OFFSETS
        rounded = np.abs(scipy.fft.rfft(np.rint(x) - x)) ** 2 * 12.0 / size  # over what is white
        power += rounded / OFFSETS
        levels[i] = np.mean(rounded[at[excited]])
    off = _moving_average(np.where(between, power, 0.0), NEAR * periods)[at] * periods / (periods - 1.0)
    on = power[at]
    for alike in (excited, ~excited):  # what is odd answers odd lines with odd ones
        on[alike] = _moving_average(on[alike], NEAR) if np.any(alike) else on[alike]
    # The offset of the carriage within a step is unknown. Rounding is odd, or even, about two offsets each, so the
    # second harmonic over the offsets gives the excess of the worst one over the mean.
    worst = 1.0 + 2.0 * float(np.abs(np.fft.rfft(levels)[2])) / float(np.sum(levels))
    return worst * np.maximum(on - off, 0.0) * white, float(np.mean(on[excited]))


def _noise_power(residual: np.ndarray, periods: int) -> np.ndarray:
    """Power (n // 2 + 1,) of the noise in ``residual`` (n,) over that of white quantisation, from how periods differ.

    Only noise clearly above the quantisation counts: it spreads the carriage over the steps, so that less of them
    repeats. The median of the differences between successive periods is taken, since the last period often contains
    the end of the excitation.
    """
    gaps = np.diff(scipy.fft.rfft(residual.reshape(periods, -1), axis=1), axis=0)
    power = 0.5 * np.abs(gaps) ** 2 * 12.0 * periods / residual.size
    usual = np.median(power, axis=0) / np.log(2.0) if periods > 3 else np.mean(power, axis=0)
    level = _moving_average(usual, NEAR)
    above = np.where(level > 1.0 + 4.0 / np.sqrt(NEAR * (periods - 1)), level - 1.0, 0.0)
    by_line = np.interp(np.arange(residual.size // 2 + 1), np.arange(above.size) * periods, above)
    by_line[:periods] = 0.0  # the means of the periods hold these
    return by_line


def _drift(position: np.ndarray, periods: int) -> np.ndarray:
    """Straight lines (n,) through the mean ``position`` (n,) of each period, without the excitation."""
    samples = position.size // periods
    middle = (np.arange(periods) + 0.5) * samples - 0.5
    means = position.reshape(periods, samples).mean(axis=1)
    k = np.arange(position.size)
    slope = np.diff(means) / samples
    drift = np.interp(k, middle, means)
    drift[k < middle[0]] += slope[0] * (k[k < middle[0]] - middle[0])
    drift[k > middle[-1]] += slope[-1] * (k[k > middle[-1]] - middle[-1])
    return drift


def _moving_average(power: np.ndarray, lines: int) -> np.ndarray:
    """``power`` (n,) averaged over so many neighbouring ``lines``."""
    return np.asarray(scipy.ndimage.uniform_filter1d(power, lines | 1, mode="reflect"))


@dataclass(frozen=True)
class Step:
    """A sine from sample ``start`` to ``stop`` (excluded), with ``turns`` periods in every ``samples``."""

    start: int
    stop: int
    turns: int
    samples: int


def steps_of(r: np.ndarray) -> tuple[Step, ...]:
    """The steps in the instrument ``r`` (n,); none where most of it is no sine, or with two or three different lines.

    A single line is accepted, for experiments with one record per line.

    >>> (one,) = steps_of(np.sin(0.02 * np.pi * np.arange(1000)))
    >>> one.turns / one.samples
    0.01
    """
    change = np.abs(np.diff(r, prepend=r[:1]))
    active = np.flatnonzero(change > ACTIVE * np.max(change))
    if active.size < SHORTEST_RUN:
        return ()
    breaks = np.flatnonzero(np.diff(active) > HOLE)
    firsts, lasts = active[np.concatenate([[0], breaks + 1])], active[np.concatenate([breaks, [active.size - 1]])] + 1
    steps, others = [], 0
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        step = _step(r, first, last) if last - first >= SHORTEST_RUN else None
        if step is not None:
            steps.append(step)
        else:
            others += last - first
        if others > MOST_OF_A_RUN and not steps:
            return ()
    different = {round(step.turns / step.samples, 9) for step in steps}
    stepped = sum(step.stop - step.start for step in steps)
    return tuple(steps) if (len(different) >= FEWEST_LINES or len(different) == 1) and stepped > others else ()


def _step(r: np.ndarray, first: int, last: int) -> Step | None:
    """The steady part of the run from ``first`` to ``last``; None where it is no sine of two periods or more."""
    fifth = (last - first) // 5
    middle = r[first + fifth : last - fifth][:MOST_OF_A_RUN]
    frequency = _frequency(middle)
    if frequency is None or frequency * middle.size < 2.0:
        return None
    lags = np.arange(8, max(9, (last - first) // 3))
    missed = np.abs(lags * frequency - np.rint(lags * frequency)) + (lags * frequency < 0.5)
    good = np.flatnonzero(missed < WHOLE_PERIODS)
    samples = int(lags[good[0] if good.size else np.argmin(missed)])
    amplitude = float(np.sqrt(2.0) * np.std(middle))
    uneven = np.flatnonzero(np.abs(r[first + samples : last] - r[first : last - samples]) > EVEN * amplitude)
    edges = np.concatenate([[-1], uneven, [last - first - samples]])
    widest = int(np.argmax(np.diff(edges)))
    start, stop = first + int(edges[widest]) + 1, first + int(edges[widest + 1]) + samples
    start += (stop - start) // SETTLING
    if stop - start < 2 * samples:
        return None
    return Step(start, stop, round(samples * frequency), samples)


def _frequency(sine: np.ndarray) -> float | None:
    """Frequency [periods per sample] of a ``sine`` (n,) plus a constant, by least squares; None where it is no sine.

    >>> round(_frequency(0.3 + np.sin(0.7 * np.arange(200.0))) * 2.0 * np.pi, 9)
    0.7
    """
    if np.ptp(sine) == 0.0:
        return None
    k = np.arange(sine.size) - 0.5 * (sine.size - 1)
    spectrum = np.abs(np.fft.rfft((sine - np.mean(sine)) * np.hanning(sine.size)))
    w = 2.0 * np.pi * int(np.argmax(spectrum)) / sine.size
    for _ in range(8):
        c, s = np.cos(w * k), np.sin(w * k)
        fit = np.linalg.lstsq(np.column_stack([c, s, np.ones(k.size)]), sine, rcond=None)[0]
        slope = k * (fit[1] * c - fit[0] * s)
        rows = np.column_stack([c, s, np.ones(k.size), slope])
        w += float(np.linalg.lstsq(rows, sine, rcond=None)[0][3])
        if not 0.0 < w < np.pi:
            return None
    residual = sine - np.column_stack([np.cos(w * k), np.sin(w * k), np.ones(k.size)]) @ fit
    return w / (2.0 * np.pi) if np.var(residual) < PURE * np.var(sine) else None


@dataclass(frozen=True, eq=False)
class Signals:
    """Instrument, command and position increments of one record, (n,) each, and its usable stretches.

    ``r`` instrument, ``u`` command [V], ``dq`` increments [m], ``bias`` increments of the reference [m]; ``repeats`` is
    the period of the instrument in samples, 0 for none; ``stretches`` holds first and last sample (excluded) of each,
    ``steps`` those of a stepped sine.
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
        return step_before_rounding(self.dq)

    @property
    def few_lines(self) -> int:
        """Number of lines that hold nearly all power of the instrument, 0 where it is more than a few.

        >>> t = np.arange(5000.0)
        >>> lines = np.sin(0.0113 * t) + np.sin(0.2117 * t)
        >>> silent = np.zeros(t.size)
        >>> Signals("r", EXCITATION, lines, silent, silent, 1e-3, 0, ((0, 5000),), silent).few_lines
        2
        """
        start, stop = max(self.stretches, key=lambda run: run[1] - run[0])
        r = self.r[start:stop]
        power = np.abs(scipy.fft.rfft((r - np.mean(r)) * np.hanning(r.size))) ** 2
        clear = stretches(power > NARROW * np.max(power))
        inside = sum(float(np.sum(power[max(a - BESIDE, 0) : b + BESIDE])) for a, b in clear)
        return len(clear) if len(clear) < FEWEST_LINES and inside > (1.0 - PURE) * np.sum(power) else 0

    @property
    def used(self) -> np.ndarray:
        """Mask (n,) of the samples in a stretch."""
        used = np.zeros(self.r.size, dtype=bool)
        for start, stop in self.stretches:
            used[start:stop] = True
        return used


def signals_of(record: Record, instrument: str = "") -> Signals:
    """Find the instrument of ``record``, its period and the stretches in which the reference runs steadily.

    ``instrument`` is ``excitation``, ``reference`` or ``command``; by default the excitation, if the record has one,
    else the reference. The command contains feedback and is no instrument in closed loop: it gives the ratio of
    spectra. Gaps are left out, and stretches with the motor switched off throughout. Raises :class:`RecordError`
    without an instrument, or where no stretch is left.
    """
    excitation, bias = record.excitation, _reference_increments(record)
    if not instrument:
        instrument = EXCITATION if excitation is not None and np.ptp(excitation) > 0.0 else REFERENCE
    if instrument == EXCITATION:
        if excitation is None:
            raise RecordError(f"{record.name}: found no column excitation, expected the signal added to the command")
        r = excitation
    else:
        r = record.u if instrument == COMMAND else bias
    if np.ptp(r) == 0.0:
        raise RecordError(
            f"{record.name}: found no excitation and a reference at rest or at constant speed, expected one of them to "
            "excite the loop: without it noise and feedback cannot be separated from the plant; for a record made in "
            "open loop the command is the excitation, `instrument='command'`"
        )
    dq = np.diff(record.q, prepend=record.q[:1])
    steps = steps_of(r) if instrument != COMMAND else ()
    repeats, runs = 0, [(step.start, step.stop) for step in steps]
    if instrument != COMMAND and not steps:
        for lag in _periods_of(r, bias if instrument == EXCITATION else None):
            if runs := _stretches(r, bias, lag, instrument):
                repeats = lag
                break
    runs = runs or _stretches(r, bias, 0, instrument)  # without a period, or one from pass to pass only
    if len(record.pieces) > 1:
        runs, steps = _runs_within(runs, steps, record.pieces, 2 * repeats or FEWEST)
        if not runs:
            raise RecordError(
                f"{record.name}: found no stretch between its gaps that is long enough for the {instrument}, expected "
                f"{'two whole periods' if repeats or steps else f'{FEWEST} samples'}"
            )
    if record.enable is not None:
        powered = [bool(np.any(record.enable[start:stop])) for start, stop in runs]
        if runs and not any(powered):
            raise RecordError(
                f"{record.name}: found enable 0 wherever the {instrument} could be used, expected the motor switched on"
            )
        runs = [run for run, on in zip(runs, powered, strict=True) if on]
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
    """Increments of the reference (n,) [m], 0 where the record has none."""
    if record.q_ref_recorded:
        return np.diff(record.q_ref, prepend=record.q_ref[:1])
    if record.velocity_reference is not None:
        return record.velocity_reference * record.period
    return np.zeros(len(record))


def _periods_of(r: np.ndarray, bias: np.ndarray | None) -> Iterator[int]:
    """Periods [samples] with which at least two of ``r`` in a row agree, the shortest first.

    The jerk of a reference may repeat earlier than its slow lines do.
    """
    active = np.flatnonzero(np.abs(r - np.median(r)) > 0.0)
    if active.size < 2 * SHORTEST:
        return
    part = r[active[0] : active[-1] + 1][:LOOKED_AT]
    # A reference advances, and accelerates evenly: its jerk shows what repeats.
    part = np.diff(part, 2) if bias is None else part - np.mean(part)
    size_of = np.abs(part)
    usual = float(np.median(size_of[size_of > 1e-6 * np.max(size_of)]))
    limited = np.clip(part, -6.0 * usual, 6.0 * usual)  # single peaks of jerk are no period
    size = scipy.fft.next_fast_len(2 * part.size, real=True)
    spectrum = scipy.fft.rfft(limited, size)
    correlation = scipy.fft.irfft(spectrum.real**2 + spectrum.imag**2, size)[: part.size]
    overlap = np.arange(part.size, 0, -1) / part.size
    even = correlation[overlap > 0.1] / correlation[0] / overlap[overlap > 0.1]
    peaks = scipy.signal.find_peaks(even, height=CORRELATED)[0]
    for lag in peaks[peaks >= SHORTEST][:CANDIDATES].tolist():
        if _repeats_after(limited, lag):
            yield lag


def _repeats_after(part: np.ndarray, lag: int) -> bool:
    """Whether ``part`` repeats after ``lag`` samples over at least one whole period."""
    gap = (part[lag:] - part[:-lag]) ** 2
    power = 0.5 * (part[lag:] ** 2 + part[:-lag] ** 2)
    if gap.size < lag:
        return False
    total = np.concatenate([[0.0], np.cumsum(gap)]), np.concatenate([[0.0], np.cumsum(power)])
    window = [sums[lag:] - sums[:-lag] for sums in total]
    good = (window[1] > 0.25 * np.max(window[1])) & (window[0] <= SAME * window[1])
    return bool(np.any(good))


def _stretches(r: np.ndarray, bias: np.ndarray, repeats: int, kind: str) -> list[tuple[int, int]]:
    """Runs at steady reference speed in which the instrument repeats, or, without a period, is active."""
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


def _runs_within(
    runs: list[tuple[int, int]], steps: tuple[Step, ...], pieces: list[tuple[int, int]], shortest: int
) -> tuple[list[tuple[int, int]], tuple[Step, ...]]:
    """The parts of ``runs``, or of ``steps``, within ``pieces`` and of at least ``shortest`` samples, or two blocks.

    The first increment of every piece but the first spans a gap and is left out.

    >>> _runs_within([(0, 50), (60, 90)], (), [(0, 20), (30, 80)], 19)
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
    """Reversals, share of time at rest, mean speed [m/s] and duration [s] of the stretches.

    The velocity is averaged over the samples that eight encoder steps take at the mean speed.
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
