"""What a gap between the command of a law and the recorded one looks like: the simplest change that makes it small.

Every change that a logger or a person makes to a record is tried on the command of the law, or the law is run on the
record with that change taken back. The first that leaves little of the gap is named. Nothing is mended.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from emps_design.importing.increments import odd_increments, step_of

if TYPE_CHECKING:
    from emps_design.importing.controller import Replay

EXPLAINS = 0.15  # of the gap's power, that may be left
FEW = 0.05  # of the samples: a gap that so few hold is theirs alone
MOST_LATE = 64  # samples
CORNERS_HZ = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0)
TRIED = 20_000  # samples on which the law is run again
PIECES = 16  # of a record, in which the gain may differ
SMOOTH = 0.02  # of the gap, that it changes by from sample to sample: no noise
EVERY = range(2, 9)  # samples, of which one in so many may be another's


def likeness(replay: Replay, unit: str) -> str:
    """What the gap of ``replay`` looks like, in words."""
    for words in _looks(replay, unit):
        if words:
            return words
    gap, changes = replay.gap[replay.used], np.diff(replay.gap[replay.used])
    if np.median(np.abs(changes)) < SMOOTH * np.sqrt(np.mean(gap**2)):
        return f"up to {np.max(np.abs(gap)):.3g} {unit} is added to what the law gives, or the law is another one (`law` says which)"
    together = float(np.corrcoef(replay.record.u[replay.used], replay.wanted[replay.used])[0, 1])
    if not together > 0.5:
        return "it follows this law nowhere: it is of another controller or of another axis (`law` says of which)"
    return "the controller does something beside its law, or it is another one (`law` says which), or the record is damaged"


def _looks(replay: Replay, unit: str) -> Iterator[str]:
    record, used, gap = replay.record, replay.used, replay.gap
    u, wanted = record.u[used], replay.wanted[used]
    power = float(gap @ gap)

    def explained(command: np.ndarray, where: np.ndarray = used) -> bool:
        here = where & used
        own = min(float(np.sum(gap[here] ** 2)), float(np.sum(record.u[here] ** 2)))
        return float(np.sum((record.u - command)[here] ** 2)) < EXPLAINS * own

    yield odd_increments(record.q)
    order = np.argsort(-(gap**2))[: max(1, int(FEW * used.sum()))]
    if float(np.sum(gap[order] ** 2)) > (1.0 - EXPLAINS) * power:
        count = 1 + int(np.searchsorted(np.cumsum(gap[order] ** 2), (1.0 - EXPLAINS) * power))
        k = int(order[0])
        one = f"one sample, {record.u[k]:.4g} {unit} at {record.t[k]:.4g} s, is" if count == 1 else f"{count} samples are"
        yield f"{one} far outside of what the law gives"
    step = step_of(record.u)
    if step and np.mean(np.abs(gap[used]) < 0.6 * step) > 0.95:
        yield f"the command is recorded in steps of {step:.4g} {unit}"
    gain = float(u @ wanted) / float(wanted @ wanted) if np.any(wanted) else 1.0
    if explained(gain * replay.wanted):
        yield f"the command is {gain:.3g} times what the law gives"
    yield _exchanged(replay, explained)
    late = _late(replay)
    if late and explained(_shifted(replay.wanted, late)):
        way = "later" if late > 0 else "earlier"
        yield f"the command is recorded {abs(late)} sample{'s' if abs(late) > 1 else ''} {way} than the position"
    yield from _gains_in_parts(replay, explained)
    for every in EVERY:
        powers = [float(np.sum(gap[phase::every] ** 2)) for phase in range(every)]
        if min(powers) < 0.01 * max(powers) and sorted(powers)[-2] < 0.05 * max(powers) or (every == 2 and min(powers) < 0.01 * max(powers)):
            yield f"only one sample in {every} differs: they are of another signal"
    yield from _low_passed(replay, explained)


def _exchanged(replay, explained) -> str:
    from emps_design.importing.controller import commands

    record = replay.record
    if replay.law.follows != "position" or not record.q_ref_recorded:
        return ""
    other = commands(replay.law, replace(record, q=record.q_ref, q_ref=record.q), replay.limit)
    return "q and q_ref are exchanged" if explained(other) else ""


def _late(replay) -> int:
    """By how many samples the recorded command follows that of the law."""
    u, wanted = replay.record.u, replay.wanted
    u, wanted = np.where(replay.used, u - u[replay.used].mean(), 0.0), np.where(replay.used, wanted - wanted[replay.used].mean(), 0.0)
    shifts = list(range(-MOST_LATE, MOST_LATE + 1))
    return max(shifts, key=lambda late: float(u @ np.roll(wanted, late)))


def _shifted(values: np.ndarray, late: int) -> np.ndarray:
    return np.roll(values, late)


def _gains_in_parts(replay, explained) -> Iterator[str]:
    record, used, wanted = replay.record, replay.used, replay.wanted
    edges = np.linspace(0, len(record), PIECES + 1).astype(int)
    gains = []
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        own = used[start:stop]
        u, w = record.u[start:stop][own], wanted[start:stop][own]
        gains.append(float(u @ w) / float(w @ w) if np.any(w) else 1.0)
    scaled = wanted * np.repeat(gains, np.diff(edges))
    # The piece in which the gain changes is explained by no gain.
    left = [float(np.sum((record.u - scaled)[a:b][used[a:b]] ** 2)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    scaled = np.where(np.repeat(left == np.max(left), np.diff(edges)), record.u, scaled)
    if explained(scaled):
        off = [i for i, gain in enumerate(gains) if abs(gain - 1.0) > 0.02]
        if off:
            yield (
                f"from about {record.t[edges[off[0]]]:.3g} s the command is {np.median([gains[i] for i in off]):.3g} times what the law gives"
            )


def _low_passed(replay, explained) -> Iterator[str]:
    from scipy.signal import lfilter

    from emps_design.importing.controller import commands

    record = replay.record
    w = 2.0 * np.pi * record.period
    for corner in CORNERS_HZ:
        keep = float(np.exp(-w * corner))
        passed = lfilter([1.0 - keep], [1.0, -keep], replay.wanted)
        if explained(passed):
            yield f"the command is recorded behind a low-pass of about {corner:g} Hz"
    short = record.until(TRIED)
    inside = np.arange(len(record)) < len(short)
    for corner in CORNERS_HZ:
        keep = float(np.exp(-w * corner))
        q = lfilter([1.0, -keep], [1.0 - keep], short.q, zi=[-keep / (1.0 - keep) * short.q[0]])[0]
        tried = np.zeros(len(record))
        tried[: len(short)] = commands(replay.law, replace(short, q=q), replay.limit)
        if explained(tried, inside):
            yield f"the position is recorded behind a low-pass of about {corner:g} Hz"
