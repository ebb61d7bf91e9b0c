"""Increments of a position that no motion has: rows written twice, a value that is held, samples that are missing.

A position is two integrals of a force, so from one sample to the next its increment changes little. One that is 0 in
full motion, or twice those beside it, was made by what wrote the record.
"""

from __future__ import annotations

import numpy as np

from emps_design.importing.account import encoder_step
from emps_design.records import Record

BESIDE = 4  # increments on either side that say what is usual
WIDE = 16  # samples on either side over which an axis moves, whatever was held meanwhile
FEWEST_STEPS = 6.0  # of the encoder in an increment, for one that is 0 or twice as large to say something
FULL = 0.9  # of the mean increment: next to one that is 0, the motion is full
TWICE = (1.6, 4.5)  # times those beside it
STEADY = 0.25  # of the usual increment, within which those beside it are alike
ROUGH, QUIET = 8.0, 0.4  # times what this share of the increments changes less by
FEWEST, SOME = 5, 2e-3  # samples, and of all samples, that stand still or are missing


def step_of(values: np.ndarray) -> float:
    """The step that ``values`` (n,) move in, 0 where there is none."""
    return encoder_step(values) or 0.0


def held(q: np.ndarray) -> np.ndarray:
    """Samples (n,) bool at which the position ``q`` (n,) stands still although the axis runs.

    >>> q = np.arange(200.0) ** 2
    >>> q[100] = q[99]
    >>> np.flatnonzero(held(q)).tolist()
    [100]
    """
    d = np.diff(q)
    # Runs of increments of 0, and the increments before and behind each.
    ends = np.flatnonzero(np.diff(d == 0.0, prepend=False, append=False))
    first, behind = ends[::2], ends[1::2]
    inner = (first > 0) & (behind < d.size) & (behind - first <= WIDE)
    first, behind = first[inner], behind[inner]
    mean = _mean(q)[(first + behind - 1) // 2]
    beside = np.minimum(d[first - 1] * np.sign(mean), d[behind] * np.sign(mean))
    size = np.abs(mean)
    odd = (size > FEWEST_STEPS * _smallest(d)) & (beside > FULL * size)
    change = np.zeros(q.size + 1)
    np.add.at(change, first[odd] + 1, 1.0)
    np.add.at(change, behind[odd] + 1, -1.0)
    return np.cumsum(change)[:-1] > 0.5


def lost(q: np.ndarray) -> np.ndarray:
    """Samples (n,) bool before which some are missing: the increment is a multiple of those beside it.

    >>> q = np.delete(np.arange(200.0) ** 2 + 1e4, 100)
    >>> np.flatnonzero(lost(q)).tolist()
    [100]
    """
    d = np.diff(q)
    if d.size <= 2 * BESIDE:
        return np.zeros(q.size, bool)
    padded = np.pad(d, BESIDE, mode="edge")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1), axis=1)
    changes = np.abs(np.diff(d))
    rough = float(np.quantile(changes, QUIET))  # where every fifth is missing, half of them are large
    big = np.abs(usual) > max(FEWEST_STEPS * _smallest(d), ROUGH * rough)
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.where(big, d / usual, 1.0)
    alike = np.abs(times - 1.0) < STEADY
    beside = np.r_[False, alike[:-1]] & np.r_[alike[1:], False]
    return np.r_[False, (times > TWICE[0]) & (times < TWICE[1]) & beside]


def odd_increments(record: Record) -> str:
    """What is odd about the increments of position and reference of ``record``, in words; "" where nothing is.

    >>> t, sweep = 1e-3, np.arange(2000.0) ** 2 / 1e7
    >>> odd_increments(Record.from_arrays(t, sweep, sweep, np.sin(1e3 * sweep)))
    ''
    >>> less = np.delete(sweep, slice(9, None, 10))
    >>> odd_increments(Record.from_arrays(t, less, less, np.sin(1e3 * less)))
    'q leaps ahead at 11 % of the samples: others are missing there, and time was numbered anew'
    """
    q, reference = record.q, record.q_ref
    stands, leaps = {"q": held(q)}, {"q": lost(q)}
    if record.q_ref_recorded and np.ptp(reference):
        # A reference may well be given in fewer steps than it is recorded; all else then goes on.
        again = (np.diff(q, prepend=np.nan) == 0.0) & (np.diff(record.u, prepend=np.nan) == 0.0)
        stands["q_ref"], leaps["q_ref"] = held(reference) & again, lost(reference)
    for found_in, words in (
        (stands, "{0} stands still at {1} in full motion: values are held, or rows repeated"),
        (leaps, "{0} leaps ahead at {1}: others are missing there, and time was numbered anew"),
    ):
        for name, found in found_in.items():
            if np.count_nonzero(found) > max(FEWEST, SOME * q.size):
                return words.format(name, f"{100 * np.mean(found):.2g} % of the samples")
    return ""


def _mean(q: np.ndarray) -> np.ndarray:
    """The mean increment (n - 1,) over a wide part around each."""
    n = q.size - 1
    low, high = np.clip(np.arange(n) - WIDE, 0, n), np.clip(np.arange(n) + WIDE + 1, 0, n)
    return (q[high] - q[low]) / np.maximum(high - low, 1)


def _smallest(d: np.ndarray) -> float:
    """About the smallest step of the increments ``d``."""
    sizes = np.abs(d[d != 0.0])
    return float(np.quantile(sizes, 0.001)) if sizes.size else 0.0
