"""What an import took for what: columns, units, ranges, clock, encoder; and the table that would say so in the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from emps_design.axis import Axis, record_toml
from emps_design.records import Record
from emps_design.records.columns import plain_title, unit_of
from emps_design.records.layout import MAPPED, NAMED, RECOGNISED, Assignment
from emps_design.records.mapping import KEYS, Column

FEW_STEPS = 20.5  # of an encoder: increments that are still told apart
SMALLEST = (20, 5, 0)  # which of the smallest increments may be one step: a few may have been disturbed
ON_GRID = 0.1  # of a step, that increments are off whole ones on average where there is an encoder
ALIKE = 1.25  # times

HEADINGS = ("column in the file", "unit", "is", "lowest", "highest", "unit", "found")
_HOW = {MAPPED: "mapped", NAMED: "by its name", RECOGNISED: "by its title"}


@dataclass(frozen=True)
class Account:
    """An imported ``record`` beside the ``axis`` that it was read for."""

    record: Record
    axis: Axis

    @property
    def encoder_step(self) -> float | None:
        """The step that the position moves in [m or rad], None where it shows none."""
        return step_seen(self.record)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader did, what it noticed, and an encoder that is not the one of the axis file."""
        seen, known = self.encoder_step, self.axis.sampling.encoder_resolution
        if seen is None or not known or 1.0 / ALIKE < seen / known < ALIKE:
            return self.record.warnings
        unit, factor = self.axis.units.display(known, "m")
        text = f"q: moves in steps of {factor * seen:.4g} {unit}, the axis file says {factor * known:.4g} {unit}"
        return (*self.record.warnings, text)

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """One row of words per column, under ``HEADINGS``; positions in the unit in which people read them."""
        return [self._row(self._column(one)) for one in self.record.assigned]

    @property
    def table(self) -> str:
        """The ``[record]`` table that says which column is what, "" where the file needs none.

        What the axis file maps stays in it unchanged, a column that this file does not have too.
        """
        assigned = self.record.assigned
        if all(one.how == NAMED for one in assigned):
            return ""
        there = {one.name for one in assigned}
        absent = {name: column for name, column in self.axis.record.named.items() if name not in there}
        return record_table(assigned, absent, self.axis.record.accept)

    def to_dict(self) -> dict[str, Any]:
        """Columns, clock, encoder and notes as plain data."""
        record, units = self.record, self.axis.units
        measured = record.measured
        step = np.diff(record.t[:2] if measured is None else measured["t"])
        return {
            **record.to_dict(),
            "columns": [self._column(one) for one in record.assigned],
            "axis": self.axis.name,
            "sampling": {
                "period": record.period,
                "axis_period": self.axis.sampling.period,
                "resampled": measured is not None,
                "shortest_step": float(step.min()),
                "longest_step": float(step.max()),
            },
            "encoder_step": {
                "seen": self.encoder_step,
                "axis": self.axis.sampling.encoder_resolution,
                "unit": units.unit("m"),
            },
            "record_table": self.table,
            "recognised": any(one.how == RECOGNISED for one in record.assigned),
            "warnings": list(self.notes),
        }

    def _row(self, column: dict[str, Any]) -> tuple[str, ...]:
        unit, factor = column["unit"], 1.0
        if column["name"] in ("q", "q_ref"):
            unit, factor = self.axis.units.display(max(abs(column["lowest"]), abs(column["highest"])), "m")
        ends = (f"{factor * column[end] or 0.0:.6g}" for end in ("lowest", "highest"))
        return (column["title"], column["unit_in_file"], column["name"], *ends, unit, _HOW[column["how"]])

    def _column(self, one: Assignment) -> dict[str, Any]:
        values = self.record.t if one.name == "t" else self.record.columns[one.name]
        return {
            "name": one.name,
            "title": one.title,
            "key": KEYS.get(one.name, one.name),
            "how": one.how,
            "unit_in_file": one.unit,
            "factor": one.factor,
            "unit": unit_of(one.name, self.axis.units),
            "lowest": float(values.min()),
            "highest": float(values.max()),
        }


def step_seen(record: Record) -> float | None:
    """The step of the encoder [m or rad] that the position of ``record``, where it has one itself, moves in."""
    if record.assigned and all(one.name != "q" for one in record.assigned):
        return None
    return encoder_step(record.q if record.measured is None else record.measured["q"])


def encoder_step(q: np.ndarray) -> float | None:
    """The step of which every increment of ``q`` is a multiple, None where there is none.

    >>> import numpy as np
    >>> t = np.arange(4000) / 1000
    >>> round(encoder_step(np.round(np.sin(t) / 1e-4) * 1e-4), 9), encoder_step(np.sin(t))
    (0.0001, None)
    """
    increments = np.abs(np.diff(q))
    largest = float(increments.max(initial=0.0))
    increments = increments[increments > 1e-9 * largest]
    if increments.size < 50:
        return None
    increments.sort()
    found = (_grid(increments, float(increments[place])) for place in SMALLEST)
    return next((step for step in found if step is not None), None)


def _grid(increments: np.ndarray, step: float) -> float | None:
    """The ``step``, made exact, of which the smaller ``increments`` are multiples; None where they are none of it."""
    for _ in range(2):
        few = increments[increments < FEW_STEPS * step]
        steps = np.round(few / step)
        if np.mean(np.abs(few / step - steps)) > ON_GRID or not np.any(steps):
            return None
        step = float(np.sum(few * steps) / np.sum(steps**2))
    return step


def record_table(
    assigned: Sequence[Assignment], absent: Mapping[str, Column] = MappingProxyType({}), accept: Sequence[str] = ()
) -> str:
    """The ``[record]`` table of an axis file for columns ``assigned``, ``absent`` ones by name, doubts to ``accept``.

    What an axis file says of a column stands there unchanged; of any other, its title and its unit.
    """
    entries = {one.name: _entry(one) for one in assigned if one.name in KEYS}
    entries |= {name: _written(column) for name, column in absent.items()}
    return record_toml({KEYS[name]: entry for name, entry in entries.items()} | ({"accept": accept} if accept else {}))


def _entry(one: Assignment) -> dict[str, Any]:
    """What ``[record]`` has to say of one column; a command in the unit of the axis needs no unit."""
    if one.entry is not None:
        return _written(one.entry)
    own = one.name == "enable" or (one.name == "u" and one.factor == 1.0)
    bracketed = one.title.rstrip().endswith(("]", ")"))
    return {"column": plain_title(one.title)[0] if bracketed else one.title.strip()} | (
        {"unit": one.unit} if one.unit and not own else {}
    )


def _written(column: Column) -> dict[str, Any]:
    """``column`` as an axis file has it, what is as by default left out."""
    return column.model_dump(exclude_none=True, exclude_defaults=True)
