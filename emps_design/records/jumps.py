"""A position that jumps: it wraps, is set anew, has a bad sample, or some are lost. No axis moves like that."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.layout import Assignment

BESIDE = (-6, -5, -4, -3, -2, 2, 3, 4, 5, 6)  # increments it is held against; the next one is that of a jump back
FASTER = 5.0  # times as large as those: what hits a stop is not, and a sample that was lost is twice as large
ROUGHER = 100.0  # times what an increment commonly differs from those next to it
OF_STROKE = 1e-3
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
    increments = np.diff(q)
    turns = np.diff(increments)
    common = float(np.median(np.abs(turns[turns != 0.0]))) if np.any(turns) else 0.0
    size = np.abs(increments)
    floor = max(ROUGHER * common, OF_STROKE * float(np.ptp(q)))
    for k in np.flatnonzero(size > floor):  # few, but for a motion that a mistaken unit makes fast
        beside = [size[k + away] for away in BESIDE if 0 <= k + away < size.size]
        if size[k] > FASTER * max(beside):
            raise RecordError(
                f"{source}: column q, at {t[k]:.6g} s: found a jump by {increments[k]:.4g} {unit} in one sample, "
                "expected motion; a position that wraps needs its modulo in [record], a bad sample or a position that "
                "was set anew is to be cut off"
            )


def nothing_lost(q: np.ndarray, q_ref: np.ndarray, t: np.ndarray, unit: str, source: str) -> None:
    """Raise :class:`RecordError` where position and reference [``unit``] leap ahead at one time: samples are lost."""
    place, size, by = _leap(q)
    other_place, other, _ = _leap(q_ref)
    if min(size, other) > LEAP and abs(place - other_place) <= 1:
        raise RecordError(
            f"{source}: columns q and q_ref, at {t[place]:.6g} s: found both jump, q by {by:.4g} {unit}, expected "
            "motion; samples are missing there"
        )


def _leap(values: np.ndarray) -> tuple[int, float, float]:
    """Where the motion leaps ahead most, in times of what one increment in a thousand changes by, and by how much."""
    increments = np.diff(values)
    beside = 0.5 * (increments[2:] + increments[:-2])
    away = np.abs(increments[1:-1] - beside)
    usual = float(np.quantile(away, 0.999))
    away[increments[1:-1] * beside < 0.0] = 0.0  # against it a position wraps
    place = int(np.argmax(away))
    return place + 1, float(away[place]) / usual if usual > 0.0 else 0.0, float(increments[place + 1])
