"""What a record says about its own experiment: the instrument, its period, and where the carriage runs steadily.

The instrument is what moves the loop from outside: the ``excitation`` that was added to the controller's output, else
the increments of the reference. Dry friction is a constant only while the carriage runs one way, so reversals and rests
in what is used are counted.

What the steps of the encoder add to a spectrum, and how much of that repeats with a periodic excitation.

The encoder says x + e(x), e a sawtooth of one step d, of variance d^2/12. Under a periodic excitation the carriage is,
a period later, where it was, further by an advance a. The m-th harmonic of the sawtooth, of a power that goes with
1/m^2, has then turned by m a/d: its share of P periods that repeats is (sin(pi P x)/(P sin(pi x)))^2 with x = m a/d.
At an advance of whole steps all of e repeats: it falls on the excited lines, and the lines between, which tell the
noise, know nothing of it. Source: W. R. Bennett, Bell System Technical Journal 27, 1948 (the spectrum of e).

The steps of a stepped sine, from the instrument alone: runs of a single sine, with pauses between them.

The instrument is free of noise, so the frequency of each run is known to many digits, and with it the number of samples
after which the sine repeats.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from emps_design.errors import RecordError
from emps_design.records import Record
from emps_design.stretches import stretches

HARMONICS = 64  # of the sawtooth
OFFSETS = 16  # of the carriage within a step, over which is averaged
NEAR = 9  # neighbouring lines over which the powers are averaged
WHOLE_STEPS = 0.05  # of a step, by which an increment may miss whole steps
MOST = 0.01  # share of the increments that may miss them by more
CANDIDATE_STEPS = 24  # distances between increments that are tried as the step
MOST_INCREMENTS = 1 << 16  # increments
CLEAR = 10.0  # times the power of steps that all repeat, from which on a line is motion
TINY = 1e-3  # share of the noise below which quantisation is not looked at

ACTIVE = 1e-4  # of the largest change from sample to sample, what counts as one
HOLE = 16  # samples without change inside a run: the extremes of a slow sine
SHORTEST_RUN = 32  # samples of a run
PURE = 1e-3  # share of its power by which a run may differ from a sine
EVEN = 1e-2  # share of its amplitude by which a sine may differ a block later
WHOLE_PERIODS = 1e-5  # of a period, by which a block may miss whole periods
SETTLING = 5  # one of so many parts of a step is for the loop to settle in
FEWEST_LINES = 4  # different lines, or one
MOST_OF_A_RUN = 1 << 16  # samples that tell whether a run is a sine

EXCITATION, REFERENCE, COMMAND = INSTRUMENTS = ("excitation", "reference", "command")
SAME = 1e-3  # share of its power by which one period may differ from the next
STEADY = 2e-3  # share of the highest speed by which a reference may differ a period later
SHORTEST = 8  # samples of a period
FEWEST = 64  # samples of a stretch
CORRELATED = 0.4  # of two periods in a row at least half is the same again one period later
CANDIDATES = 100  # lags that are looked at
LOOKED_AT = 1 << 20  # samples in which the period of a long record shows, or it has none


def repeated_share(advance: np.ndarray | float, periods: int) -> np.ndarray:
    """The share of the quantisation's power that repeats in ``periods``, at an ``advance`` (...) in steps by period.

    >>> repeated_share(np.array([17.0, 17.5, 17.618]), 4).round(2).tolist()
    [1.0, 0.25, 0.1]
    """
    m = np.arange(1, HARMONICS + 1)
    turn = np.asarray(advance)[..., None] * m
    turn = turn - np.rint(turn)
    same = (np.sinc(periods * turn) / np.sinc(turn)) ** 2
    return np.sum(same / m**2, axis=-1) / np.sum(1.0 / m**2)


def encoder_step(dq: np.ndarray) -> float:
    """The step [m] that all increments ``dq`` (n,) are whole numbers of, 0 where there is none.

    >>> steps = np.random.default_rng(0).integers(-40, 40, 200)
    >>> round(encoder_step(2.5e-6 * steps + 1e-12) * 1e6, 6), encoder_step(np.sin(np.arange(99.0)))
    (2.5, 0.0)
    """
    some = dq[:: -(-dq.size // MOST_INCREMENTS)]
    away = some - np.quantile(some, 0.5, method="nearest")
    values = np.unique(away)
    gaps = np.unique(np.diff(values))
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(away), initial=0.0)]
    if not gaps.size:
        return 0.0
    tried = np.unique(np.quantile(gaps, np.linspace(0.0, 1.0, CANDIDATE_STEPS), method="nearest"))[::-1]
    for step in map(float, tried):
        for most in (2.0, 8.0, 32.0, 128.0, np.inf):  # a step that is not quite right is told from few of them first
            near = away[np.abs(away) < most * step]
            whole = np.rint(near / step)
            if np.any(whole):
                step = float(whole @ near / (whole @ whole))
        whole = np.rint(away / step)
        if np.mean(whole != 0.0) > MOST > np.mean(np.abs(away / step - whole) > WHOLE_STEPS):
            return abs(step)
    return 0.0


def quantised(
    dq: np.ndarray, periods: int, at: np.ndarray, excited: np.ndarray, noise: np.ndarray, step: float
) -> tuple[np.ndarray, float]:
    """What repeated quantisation adds to the power (m,) of the spectrum of increments ``dq`` (n,) at the lines ``at``,
    beyond the ``noise`` (m,) between them, and the power that repeats over what would by chance.

    The motion is built of the ``excited`` (m,) lines, of what the mean position of each period says, and of noise like
    that between the lines; it is rounded to steps at several places within one, and the spectra of what rounding adds
    are averaged. Spectra are sums over the samples, over their number.
    """
    from scipy.fft import irfft, rfft

    size = dq.size
    turn = np.abs(1.0 - np.exp(-2j * np.pi * np.arange(size // 2 + 1) / size)) ** 2
    white = step**2 / 12.0 / size * turn[at]
    if step == 0.0 or periods * np.max(white / np.maximum(noise, 1e-300)) < TINY:
        return np.zeros(at.size), 1.0
    spectrum = rfft(dq) / size
    between = np.ones(turn.size, dtype=bool)
    between[:: at[0]] = False  # the first line is the base period's
    kept, seen = np.zeros(turn.size, complex), at[excited & (np.abs(spectrum[at]) ** 2 > CLEAR * periods * white)]
    kept[seen] = spectrum[seen] / (1.0 - np.exp(-2j * np.pi * seen / size))
    position, moved = np.cumsum(dq), irfft(kept * size, size)
    moved += _drift(position - moved, periods)
    unsure = step * np.sqrt(_unsure((position - moved) / step, periods) / (12.0 * size))
    random, power, levels = np.random.default_rng(0), np.zeros(turn.size), np.zeros(OFFSETS)
    for i in range(OFFSETS):
        noisy = unsure * np.exp(2j * np.pi * random.random(turn.size))
        x = (moved + irfft(noisy * size, size)) / step + i / OFFSETS
        rounded = np.abs(rfft(np.rint(x) - x)) ** 2 * 12.0 / size  # over what is white
        power += rounded / OFFSETS
        levels[i] = np.mean(rounded[at[excited]])
    off = _mean_of(np.where(between, power, 0.0), NEAR * periods)[at] * periods / (periods - 1.0)
    on = power[at]
    for alike in (excited, ~excited):  # what is odd answers odd lines with odd ones
        on[alike] = _mean_of(on[alike], NEAR) if np.any(alike) else on[alike]
    # Where the carriage is within a step nobody knows. Rounding is odd, or even, about two places each: the worst is
    # as far above the mean as the second harmonic says.
    worst = 1.0 + 2.0 * float(np.abs(np.fft.rfft(levels)[2])) / float(np.sum(levels))
    return worst * np.maximum(on - off, 0.0) * white, float(np.mean(on[excited]))


def _unsure(left: np.ndarray, periods: int) -> np.ndarray:
    """The power (n // 2 + 1,) over that of white steps of the noise in ``left`` (n,), by which periods differ.

    It is what stands clearly above the steps and spreads the carriage over them, so that less of these repeats. Of the
    differences from one period to the next the median is taken, since the last often has the end of the excitation in
    it.
    """
    from scipy.fft import rfft

    gaps = np.diff(rfft(left.reshape(periods, -1), axis=1), axis=0)
    power = 0.5 * np.abs(gaps) ** 2 * 12.0 * periods / left.size
    usual = np.median(power, axis=0) / np.log(2.0) if periods > 3 else np.mean(power, axis=0)
    level = _mean_of(usual, NEAR)
    above = np.where(level > 1.0 + 4.0 / np.sqrt(NEAR * (periods - 1)), level - 1.0, 0.0)
    found = np.interp(np.arange(left.size // 2 + 1), np.arange(above.size) * periods, above)
    found[:periods] = 0.0  # which the means of the periods have
    return found


def _drift(position: np.ndarray, periods: int) -> np.ndarray:
    """The straight lines (n,) through the mean ``position`` (n,) of each period, which excitation has no part in."""
    samples = position.size // periods
    middle = (np.arange(periods) + 0.5) * samples - 0.5
    means = position.reshape(periods, samples).mean(axis=1)
    k = np.arange(position.size)
    slope = np.diff(means) / samples
    found = np.interp(k, middle, means)
    found[k < middle[0]] += slope[0] * (k[k < middle[0]] - middle[0])
    found[k > middle[-1]] += slope[-1] * (k[k > middle[-1]] - middle[-1])
    return found


def _mean_of(power: np.ndarray, lines: int) -> np.ndarray:
    """``power`` (n,) averaged over so many neighbouring ``lines``."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(power, lines | 1, mode="reflect"))


@dataclass(frozen=True)
class Step:
    """Samples from ``start`` to ``stop`` (excluded) hold a sine that makes ``turns`` periods in every ``samples``."""

    start: int
    stop: int
    turns: int
    samples: int


def steps_of(r: np.ndarray) -> tuple[Step, ...]:
    """The steps in the instrument ``r`` (n,); none where there are two or three lines, or most of it is no sine.

    One line is a step of an experiment with one record for each.

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
    found, others = [], 0
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        step = _step(r, first, last) if last - first >= SHORTEST_RUN else None
        if step is not None:
            found.append(step)
        else:
            others += last - first
        if others > MOST_OF_A_RUN and not found:
            return ()
    different = {round(step.turns / step.samples, 9) for step in found}
    stepped = sum(step.stop - step.start for step in found)
    return tuple(found) if (len(different) >= FEWEST_LINES or len(different) == 1) and stepped > others else ()


def _step(r: np.ndarray, first: int, last: int) -> Step | None:
    """The even part of the run from ``first`` to ``last``; None where it is no sine of two periods or more."""
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
    """Periods by sample of a ``sine`` (n,) on a constant, by least squares; None where it is none.

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
    left = sine - np.column_stack([np.cos(w * k), np.sin(w * k), np.ones(k.size)]) @ fit
    return w / (2.0 * np.pi) if np.var(left) < PURE * np.var(sine) else None


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
