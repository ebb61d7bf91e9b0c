"""A position that jumps: it wraps, is set anew, has a bad sample, or some are lost. No axis moves like that."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.layout import Assignment

BESIDE = np.array([-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6])  # increments it is held against, but a jump back
BACK = 0.1  # of a jump, within which another takes it back
FASTER = 5.0  # times as large as those: what hits a stop is not, and a sample that was lost is twice as large
ROUGHER = 100.0  # times what an increment commonly differs from those next to it
OF_STROKE = 1e-3
PART, STRETCHES = 50_000, 10  # samples at a time, which copies no long record; of so many it is told what is usual
LOST = 1.5  # times as far as in the samples beside: one that is missing makes two
DUST = 1e-9  # of the stroke
LEAP = 100.0  # times what one sample in a thousand changes in its step


def unwrap(named: dict[str, np.ndarray], assigned: Iterable[Assignment]) -> None:
    """Let a position and a reference that are ``assigned`` with a modulo go on where they begin anew, side by side.

    >>> from emps_design.records.mapping import Column
    >>> angle = Assignment("q", "angle", "deg", 1.0, "mapped", Column(column="angle", modulo=360.0))
    >>> named = {"q": np.array([358.0, 359.0, 0.0, 1.0])}
    >>> unwrap(named, [angle])
    >>> named["q"].tolist()
    [358.0, 359.0, 360.0, 361.0]
    """
    spans = {
        one.name: one.entry.modulo * abs(one.factor)
        for one in assigned
        if one.entry is not None and one.entry.modulo is not None
    }
    for name, span in spans.items():
        named[name][:] = np.unwrap(named[name], period=span)
    for name, span in spans.items():
        beside = named.get("q" if name == "q_ref" else "q_ref", named[name])
        named[name] += span * np.round((beside[0] - named[name][0]) / span)


def no_jump(q: np.ndarray, t: np.ndarray, unit: str, source: str) -> None:
    """Raise :class:`RecordError` where the position ``q`` (n,) [``unit``] jumps between two samples; ``t`` (n,) [s]."""
    turns = np.concatenate([np.abs(np.diff(part, 2)) for part in _samples_of(q)])
    turns = turns[turns > 0.0]
    floor = max(ROUGHER * float(np.median(turns)) if turns.size else 0.0, OF_STROKE * float(np.ptp(q)))
    for start in range(0, q.size, PART):
        increments = np.abs(np.diff(q[start : start + PART + 1]))
        fast = start + np.flatnonzero(increments > floor)
        own = q[fast + 1] - q[fast]
        places = fast[:, None] + BESIDE
        inside = (places >= 0) & (places < q.size - 1)
        places = np.where(inside, places, 0)
        others = q[places + 1] - q[places]
        beside = inside & (np.abs(others + own[:, None]) > BACK * np.abs(own[:, None]))
        most = np.where(beside, np.abs(others), 0.0).max(axis=1)
        jumps = beside.any(axis=1) & (np.abs(own) > FASTER * most)
        if jumps.any():
            first = int(np.argmax(jumps))
            raise RecordError(
                f"{source}: column q, at {t[fast[first]]:.6g} s: found a jump by {own[first]:.4g} {unit} in one "
                "sample, expected motion; a position that wraps needs its modulo in [record], a bad sample or a "
                "position that was set anew is to be cut off"
            )


def nothing_lost(q: np.ndarray, q_ref: np.ndarray, t: np.ndarray, unit: str, source: str) -> None:
    """Raise :class:`RecordError` where position and reference [``unit``] leap ahead at one time: samples are lost."""
    place, size = _leap(q)
    other_place, other = _leap(q_ref)
    if min(size, other) > LEAP and abs(place - other_place) <= 1:
        raise RecordError(
            f"{source}: columns q and q_ref, at {t[place]:.6g} s: found both jump, q by {q[place + 1] - q[place]:.4g} "
            f"{unit}, expected motion; samples are missing there"
        )


def _leap(values: np.ndarray) -> tuple[int, float]:
    """Where the motion leaps ahead most, and in times of what one increment in a thousand changes by."""
    away = np.concatenate([_away(np.diff(part)) for part in _samples_of(values)])
    more = away[away > DUST * np.ptp(values)]  # a quantile of an axis that mostly rests is nothing but rounding
    usual = max(float(np.quantile(away, 0.999)), float(np.median(more)) if more.size else 0.0)
    best, place = 0.0, 0
    for start in range(0, values.size, PART):
        increments = np.diff(values[start : start + PART + 3])
        if increments.size < 3:
            break
        before, now, after = increments[:-2], increments[1:-1], increments[2:]
        away = _away(increments)
        # Against its motion a position wraps; one that starts or stops at speed leaps past one neighbour alone.
        away[(now * (before + after) < 0.0) | (np.abs(now) < LOST * np.maximum(np.abs(before), np.abs(after)))] = 0.0
        k = int(np.argmax(away))
        if away[k] > best:
            best, place = float(away[k]), start + k + 1
    return place, best / usual if usual > 0.0 else 0.0


def _away(increments: np.ndarray) -> np.ndarray:
    """By how much each of the increments (n,) but the outer ones differs from the mean of its neighbours."""
    return np.abs(increments[1:-1] - 0.5 * (increments[:-2] + increments[2:]))


def _samples_of(values: np.ndarray) -> list[np.ndarray]:
    """Stretches all over a long column, which tell what is usual without a copy of it."""
    step = max(PART, values.size // STRETCHES)
    return [values[start : start + PART] for start in range(0, values.size - 3, step)]
