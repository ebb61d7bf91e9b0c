"""The steps of a stepped sine, from the instrument alone: runs of a single sine, with pauses between them.

The instrument is free of noise, so the frequency of each run is known to many digits, and with it the number of samples
after which the sine repeats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ACTIVE = 1e-4  # of the largest change from sample to sample, what counts as one
HOLE = 16  # samples without change inside a run: the extremes of a slow sine
SHORTEST = 32  # samples of a run
SAME = 1e-3  # share of its power by which a run may differ from a sine
EVEN = 1e-2  # share of its amplitude by which a sine may differ a block later
WHOLE = 1e-5  # of a period, by which a block may miss whole periods
SETTLING = 5  # one of so many parts of a step is for the loop to settle in
FEWEST = 4  # different lines, or one
LOOKED_AT = 1 << 16  # samples that tell whether a run is a sine


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
    if active.size < SHORTEST:
        return ()
    breaks = np.flatnonzero(np.diff(active) > HOLE)
    firsts, lasts = active[np.concatenate([[0], breaks + 1])], active[np.concatenate([breaks, [active.size - 1]])] + 1
    found, others = [], 0
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        step = _step(r, first, last) if last - first >= SHORTEST else None
        if step is not None:
            found.append(step)
        else:
            others += last - first
        if others > LOOKED_AT and not found:
            return ()
    different = {round(step.turns / step.samples, 9) for step in found}
    stepped = sum(step.stop - step.start for step in found)
    return tuple(found) if (len(different) >= FEWEST or len(different) == 1) and stepped > others else ()


def _step(r: np.ndarray, first: int, last: int) -> Step | None:
    """The even part of the run from ``first`` to ``last``; None where it is no sine of two periods or more."""
    fifth = (last - first) // 5
    middle = r[first + fifth : last - fifth][:LOOKED_AT]
    frequency = _frequency(middle)
    if frequency is None or frequency * middle.size < 2.0:
        return None
    lags = np.arange(8, max(9, (last - first) // 3))
    missed = np.abs(lags * frequency - np.rint(lags * frequency)) + (lags * frequency < 0.5)
    good = np.flatnonzero(missed < WHOLE)
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
    return w / (2.0 * np.pi) if np.var(left) < SAME * np.var(sine) else None
