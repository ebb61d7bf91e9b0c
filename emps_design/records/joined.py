"""Several records as one, with a bridge between each two that takes no part: for what only all together tell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.clock import same_period
from emps_design.records.columns import OPTIONAL
from emps_design.records.record import Record

BRIDGE = 1.0  # s from one record to the next


def joined(records: Sequence[Record], rotary: bool = False) -> Record:
    """Join ``records`` of one axis; a ``rotary`` one goes on in the turn in which the record before ended.

    Position and reference cross a bridge smoothly, at the speed of either end. Columns that one record lacks are left
    out. Raises :class:`RecordError` for records of different sampling periods.

    >>> ramp = np.arange(100.0) / 100
    >>> both = joined([Record.from_arrays(0.01, q, q, np.sin(ramp), name="a") for q in (ramp, -ramp)])
    >>> len(both), int(both.bridged.sum()), both.name
    (300, 100, 'a + a')
    """
    first, *others = records
    for one in others:
        if not same_period(one.period, first.period):
            raise RecordError(
                f"{one.name}: found a sampling period of {1e3 * one.period:g} ms, expected {1e3 * first.period:g} ms "
                f"of {first.name}; join records of one drive"
            )
    names = [name for name in OPTIONAL if name != "bridged" and all(getattr(one, name) is not None for one in records)]
    bridge = max(2, round(BRIDGE / first.period))
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("q_ref", "q", "u", "bridged", *names)}
    last = 0.0
    for index, one in enumerate(records):
        turn = 2.0 * math.pi * round((last - one.q[0]) / (2.0 * math.pi)) if rotary and index else 0.0
        own = {name: getattr(one, name) for name in names} | {"q_ref": one.q_ref + turn, "q": one.q + turn, "u": one.u}
        own["bridged"] = np.zeros(len(one)) if one.bridged is None else one.bridged
        for name, values in own.items():
            if index:
                between = np.ones(bridge) if name == "bridged" else _between(columns[name][-1], values, bridge)
                columns[name].append(between)
            columns[name].append(values)
        last = float(own["q"][-1])
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    absent = dict.fromkeys(set(OPTIONAL) - set(whole), None)
    return replace(
        first,
        t=np.arange(whole["q"].size) * first.period,
        name=" + ".join(one.name for one in records),
        sha256="",
        extra={key: value for key, value in first.extra.items() if np.size(value) == 1},
        warnings=tuple(f"{one.name}: {text}" for one in records for text in one.warnings),
        contradictions=tuple(f"{one.name}: {text}" for one in records for text in one.contradictions),
        q_ref_recorded=all(one.q_ref_recorded for one in records),
        measured=None,
        **{**whole, **absent},  # type: ignore[arg-type]
    )


def _between(before: np.ndarray, after: np.ndarray, count: int) -> np.ndarray:
    """A cubic over ``count`` samples from the end of ``before`` to the start of ``after``, at the slope of either."""
    x = np.arange(1, count + 1) / (count + 1)
    start, stop = float(before[-1]), float(after[0])
    first, last = (count + 1) * float(before[-1] - before[-2]), (count + 1) * float(after[1] - after[0])
    rise = x * x * (3.0 - 2.0 * x)
    return start + (stop - start) * rise + first * x * (1.0 - x) ** 2 - last * x * x * (1.0 - x)
