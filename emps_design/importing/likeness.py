"""What a gap between the command of a law and the recorded one looks like: the simplest change that makes it small.

Every change that a logger or a person makes to a record is tried on the command of the law, or the law is run on the
record with that change taken back. The first that leaves little of the gap is named. Nothing is mended.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from emps_design.importing.increments import odd_increments, step_of
from emps_design.importing.replay import Replay, commands

EXPLAINS = 0.15  # of the power of the gap, and of the command, that may be left
FEW = 0.05  # of the samples: a gap that so few hold is theirs alone
HALF_A_STEP = 0.5  # that rounding leaves at most
MOST_LATE = 64  # samples
CORNERS_HZ = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0)
TRIED = 20_000  # samples on which the law is run again
PIECES, SAME_GAIN = 16, 0.02  # of a record, in which the gain may differ; by which it has to
EVERY = range(2, 9)  # samples, of which one in so many may be another's
OTHERS = 0.01  # of the gap's power in such samples, that the others may have
SMOOTH = 0.02  # of the gap, that it changes by from sample to sample: no noise
TOGETHER = 0.5  # correlation of the command with that of the law, from which on it is not of elsewhere


def likeness(replay: Replay, unit: str) -> str:
    """Say what the gap of ``replay`` looks like; ``unit`` is that of the command.

    >>> from emps_design.importing.replay import run_law
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> likeness(run_law(axis, replace(record, q=record.q_ref, q_ref=record.q)), "V")
    'q and q_ref are exchanged'
    """
    for words in _looks(replay, unit):
        if words:
            return words
    used, gap = replay.used, replay.gap[replay.used]
    if np.median(np.abs(np.diff(gap))) < SMOOTH * np.sqrt(np.mean(gap**2)):
        most = f"{np.max(np.abs(gap)):.3g} {unit}".rstrip()
        return f"up to {most} is added to what the law gives, or the command is another controller's or another axis's"
    if not np.corrcoef(replay.record.u[used], replay.wanted[used])[0, 1] > TOGETHER:
        return "the command follows this law nowhere: it is another controller's or another axis's"
    return "the record is damaged, or the command is another controller's (emps-design law says whose)"


def _looks(replay: Replay, unit: str) -> Iterator[str]:
    """What is found, simplest first; "" for what is not."""
    record, used, gap = replay.record, replay.used, replay.gap
    yield odd_increments(record)
    step, left = step_of(record.u), float(np.sqrt(np.mean(gap[used] ** 2)))
    if left < HALF_A_STEP * step:
        yield f"the command is recorded in steps of {step:.4g} {unit}".rstrip()
    u, wanted = record.u[used], replay.wanted[used]
    gain = float(u @ wanted) / float(wanted @ wanted) if np.any(wanted) else 1.0
    if _left(replay, gain * replay.wanted) < EXPLAINS:
        yield f"the command is {gain:.3g} times what the law gives"
    if replay.law.follows == "position" and record.q_ref_recorded:
        exchanged = replace(record, q=record.q_ref, q_ref=record.q)
        left_by = _left(replay, commands(replay.law, exchanged, replay.limit))
        yield "q and q_ref are exchanged" if left_by < EXPLAINS else ""
    yield _late(replay)
    yield _command_low_passed(replay)
    yield _few(replay, unit)
    yield _gain_from(replay)
    for every in EVERY:
        least, *_, most = sorted(float(np.sum(gap[phase::every] ** 2)) for phase in range(every))
        if least < OTHERS * most:
            yield f"it is another signal's in some of every {every} samples"
    yield _position_low_passed(replay)


def _left(replay: Replay, command: np.ndarray, where: np.ndarray | None = None) -> float:
    """What ``command`` (n,) leaves of the recorded one, as a share of what that of the law leaves, or of all of it."""
    here = replay.used if where is None else replay.used & where
    u = replay.record.u[here]
    own = min(float(np.sum(replay.gap[here] ** 2)), float(np.sum(u**2)))
    return float(np.sum((u - command[here]) ** 2)) / own if own else 1.0


def _few(replay: Replay, unit: str) -> str:
    """Whether a few samples hold the gap."""
    record, power = replay.record, replay.gap**2
    order = np.argsort(-power)[: max(1, int(FEW * replay.used.sum()))]
    share = np.cumsum(power[order]) / float(power.sum())
    if share[-1] < 1.0 - EXPLAINS:
        return ""
    count, k = 1 + int(np.searchsorted(share, 1.0 - EXPLAINS)), int(order[0])
    if count > 1:
        return f"{count} samples are far from what the law gives"
    value = f"{record.u[k]:.4g} {unit}".rstrip()
    return f"one sample, {value} at {record.t[k]:.4g} s, is far from what the law gives"


def _late(replay: Replay) -> str:
    """Whether the recorded command is that of the law some samples later, or earlier."""
    used = replay.used
    u, wanted = (np.where(used, x - x[used].mean(), 0.0) for x in (replay.record.u, replay.wanted))
    late = max(range(-MOST_LATE, MOST_LATE + 1), key=lambda shift: float(u @ np.roll(wanted, shift)))
    if not late or _left(replay, np.roll(replay.wanted, late)) > EXPLAINS:
        return ""
    way, many = "later" if late > 0 else "earlier", "s" if abs(late) > 1 else ""
    return f"the command is recorded {abs(late)} sample{many} {way} than reference and position"


def _gain_from(replay: Replay) -> str:
    """Whether the command is a multiple of that of the law in a part of the record."""
    record, used, wanted = replay.record, replay.used, replay.wanted
    edges = np.linspace(0, len(record), PIECES + 1).astype(int)
    gains, left = np.ones(PIECES), np.zeros(PIECES)
    for i, (start, stop) in enumerate(pairwise(edges.tolist())):
        own = used[start:stop]
        u, w = record.u[start:stop][own], wanted[start:stop][own]
        gains[i] = float(u @ w) / float(w @ w) if np.any(w) else 1.0
        left[i] = float(np.sum((u - gains[i] * w) ** 2))
    left[int(np.argmax(left))] = 0.0  # the piece in which the gain changes
    off = np.flatnonzero(np.abs(gains - 1.0) > SAME_GAIN)
    power = min(float(np.sum(replay.gap**2)), float(np.sum(record.u[used] ** 2)))
    if not off.size or off.size == PIECES or left.sum() > EXPLAINS * power:
        return ""
    since = record.t[edges[off[0]]]
    return f"from about {since:.3g} s on the command is {np.median(gains[off]):.3g} times what the law gives"


def _command_low_passed(replay: Replay) -> str:
    """Whether the command is recorded behind a low-pass of first order."""
    from scipy.signal import lfilter

    left = {}
    for corner in CORNERS_HZ:
        keep = _kept(corner, replay.record.period)
        left[corner] = _left(replay, lfilter([1.0 - keep], [1.0, -keep], replay.wanted))
    corner = min(left, key=lambda one: left[one])
    return f"the command is recorded behind a low-pass of about {corner:g} Hz" if left[corner] < EXPLAINS else ""


def _position_low_passed(replay: Replay) -> str:
    """Whether the position is recorded behind a low-pass of first order."""
    from scipy.signal import lfilter

    short = replay.record.until(TRIED)
    inside, tried = np.arange(len(replay.record)) < len(short), np.zeros(len(replay.record))
    left = {}
    for corner in CORNERS_HZ:
        keep = _kept(corner, short.period)
        before, _ = lfilter([1.0, -keep], [1.0 - keep], short.q, zi=[-keep / (1.0 - keep) * short.q[0]])
        tried[: len(short)] = commands(replay.law, replace(short, q=before), replay.limit)
        left[corner] = _left(replay, tried, inside)
    corner = min(left, key=lambda one: left[one])
    return f"the position is recorded behind a low-pass of about {corner:g} Hz" if left[corner] < EXPLAINS else ""


def _kept(corner: float, period: float) -> float:
    """What a low-pass with a ``corner`` [Hz] keeps over a ``period`` [s]."""
    return float(np.exp(-2.0 * np.pi * corner * period))
