"""What an import took for what: columns, units, ranges, clock, encoder; and the table that would say so in the file.

What a trace tells of its axis before there is an axis file: columns, units, period, encoder, limit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from emps_design.axis import Axis, record_toml
from emps_design.errors import RecordError
from emps_design.records import Record, read_record
from emps_design.records.columns import NAMES, meanings, plain_title, title_unit, unit_of, words
from emps_design.records.layout import KEYS, MAPPED, NAMED, RECOGNISED, Assignment, Column, ColumnMap, Layout
from emps_design.records.readers import read_titles
from emps_design.units import COMMANDS, MOTIONS, Units

FEW_STEPS = 20.5  # of an encoder: increments that are still told apart
SMALLEST = (20, 5, 0)  # which of the smallest increments may be one step: a few may have been disturbed
ON_GRID = 0.1  # of a step, that increments are off whole ones on average where there is an encoder
ALIKE = 1.25  # times

HEADINGS = ("column in the file", "unit", "is", "lowest", "highest", "unit", "found")
_HOW = {MAPPED: "mapped", NAMED: "by its name", RECOGNISED: "by its title"}

# What a command is, by the unit in its title, or by its words where that is a share of the rated value.
_BY_UNIT = {"V": "voltage", "mV": "voltage", "A": "current", "mA": "current", "N m": "torque", "mN m": "torque"}
_BY_UNIT |= {"N": "force", "kN": "force"}
_TURNING = {"deg", "rad", "mrad", "rev", "rpm", "rad/s", "deg/s", "rev/s"}
_MOTION = _TURNING | {"m", "mm", "um", "m/s", "mm/s", "m/min"}
_BY_WORD = {
    "current": r"\b(current|iq)\b|strom",
    "torque": r"\btorque\b|moment",
    "force": r"\bforce\b|kraft",
    "duty": r"\b(duty|pwm)\b",
}
# The unit that is likely where a title has none, by motion: what a drive writes by default.
USUAL = {
    "linear": {"q": "m", "q_ref": "m", "velocity": "m/s"},
    "rotary": {"q": "rad", "q_ref": "rad", "velocity": "rpm"},
}
NEW = "\n"
PLATEAU = 1e-6  # of the largest command: samples this near it sit at a limit
FEWEST_AT_LIMIT = 20


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


@dataclass(frozen=True)
class Trace:
    """A file of ``titles``, the ``units`` that they tell, and its ``record``, or the ``reason`` why there is none.

    ``guessed`` are the columns [by name in a record] of which the title says what they are but no unit: the record was
    read with those of :data:`USUAL`, which its period and its command do not depend on.
    """

    path: Path
    titles: tuple[str, ...]
    units: Units
    record: Record | None = None
    reason: str = ""
    guessed: tuple[str, ...] = ()

    @property
    def encoder_step(self) -> float | None:
        """The step of the encoder [m or rad] where the position shows one."""
        return None if "q" in self.guessed else None if self.record is None else step_seen(self.record)

    @property
    def limit(self) -> float | None:
        """The command at which the drive stops [command unit], where many samples sit at it."""
        if self.record is None:
            return None
        u = np.abs(self.record.u)
        largest = float(u.max())
        at_limit = np.count_nonzero(u >= largest * (1.0 - PLATEAU))
        return largest if at_limit >= FEWEST_AT_LIMIT else None


def read_trace(path: str | Path) -> Trace:
    """Read what the file at ``path`` tells by itself; raises :class:`RecordError` where it is no trace at all."""
    titles = read_titles(path)
    units = _units(titles)
    layout = Layout(units, period=math.inf, resample=True, reference_needed=False)
    whole = Trace(Path(path), tuple(titles), units)
    try:
        return replace(whole, record=read_record(path, layout=layout))
    except RecordError as error:
        reason = str(error)
    guesses = {
        name: Column(column=found[0], unit=USUAL[units.motion][name])
        for name, found in meanings(titles, units).items()
        if name in USUAL[units.motion] and len(found) == 1 and not title_unit(found[0])[1]
    }
    if guesses:
        columns = ColumnMap(**{KEYS[name]: column for name, column in guesses.items()})
        with suppress(RecordError):
            record = read_record(path, layout=replace(layout, columns=columns))
            return replace(whole, record=record, reason=reason, guessed=tuple(guesses))
    return replace(whole, reason=reason)


def axis_text(trace: Trace, controller: str = "") -> str:
    """The axis file that ``trace`` tells, the rest commented out; ``controller`` is that table, where it is known."""
    units, record, step = trace.units, trace.record, trace.encoder_step
    unit, name = units.unit, re.sub(r"[^\w-]+", "_", trace.path.stem) or "axis"
    moves = "inertia" if units.rotary else "mass"
    largest = float(np.max(np.abs(record.u))) if record else 0.0
    seen = f"the largest command seen is {largest:.4g}" if record else "the largest command"
    limit = trace.limit or float(f"{1.5 * largest:.1g}") or 10.0
    way = "gear" if units.rotary else "gear and screw"
    own_unit = units.command_unit != COMMANDS[units.command]
    waits = "A line with # in front waits for your number: fill it in and take the # away."
    lines = [
        (f"# Written from {trace.path.name}. {waits}", ""),
        (f'name = "{name}"', ""),
        (f'motion = "{units.motion}"', "or rotary" if not units.rotary else "or linear"),
        (f"{NEW}[mechanics]", "on the load side; a guess will do to begin with: identify finds them"),
        ("# mass = 10.0", f"{unit('kg')}, {moves}"),
        ("# viscous = 100.0", f"{unit('N/(m/s)')}, viscous friction"),
        ("# coulomb = 20.0", f"{unit('N')}, Coulomb friction"),
        (f"{NEW}[drive]", ""),
        (f'command = "{units.command}"', "what the command column is: voltage, current, torque, force or duty"),
        *([(f'command_unit = "{units.command_unit}"', "")] if own_unit else []),
        ("# force_gain = 1.0", f"{unit('N/V')}, on the load side: rated {units.words('force')}, {way}"),
        (f"{'' if trace.limit else '# '}command_limit = {limit:.6g}", f"{units.command_unit}, {seen}"),
        (f"{NEW}[sampling]", ""),
        (f"period = {record.period!r}" if record else "# period = 0.001", "s"),
        (f"{'' if step else '# '}encoder_resolution = {step or 1e-6:.4g}", f"{unit('m')}, one step on the load side"),
    ]
    text = "\n".join(f"{line:<{32 + line.count(NEW)}} # {remark}" if remark else line for line, remark in lines)
    return f"{text}\n\n{controller or NO_LAW}\n{_columns(trace)}"


NO_LAW = '[controller]\nkind = "none"                    # or what the drive runs: cascade, p, position_pd ...\n'


def _columns(trace: Trace) -> str:
    """The ``[record]`` table, or why none is needed; what is not certain waits behind a #."""
    named = {one.name for one in trace.record.assigned if one.how == NAMED} if trace.record else set()
    if trace.record is not None and not trace.guessed:
        if len(named) == len(trace.record.assigned):
            return "# The columns have the names of a record: no [record] table is needed.\n"
        return record_table(trace.record.assigned)
    reason = trace.reason.replace(str(trace.path), trace.path.name)
    lines = [f"# {reason}", f"# columns of the file: {', '.join(trace.titles[:40])}", "[record]"]
    usual = {"t": "s", "u": trace.units.command_unit} | USUAL[trace.units.motion]
    for name, found in _understood(trace).items():
        title = found[0] if found else ""
        unit = title_unit(title)[1]
        if len(found) == 1 and (unit or name == "u"):
            lines.append(_line(record_table((Assignment(name, title, unit),))))
        else:
            others = f"  # or {' or '.join(map(repr, found[1:]))}" if found[1:] else ""
            lines.append(
                f"# {_line(record_toml({KEYS[name]: {'column': title, 'unit': unit or usual[name]}}))}{others}"
            )
    return "\n".join(lines) + "\n"


def _line(table: str) -> str:
    """The one key of a ``[record]`` table."""
    return table.split("\n")[1]


def _understood(trace: Trace) -> dict[str, list[str]]:
    """The titles that may be each column that a record needs and that has not the name of one."""
    named = {NAMES.get(plain_title(title)[0].lower(), "") for title in trace.titles}
    found = {name: titles for name, titles in meanings(trace.titles, trace.units).items() if name not in named}
    moves = ("velocity",) if found.get("velocity") and not found.get("q") else ("q",)
    return {name: found[name] for name in ("t", *moves, "q_ref", "u") if name in found}


def _units(titles: list[str]) -> Units:
    """Motion and command as the titles have them: where they say nothing a voltage, and a line unless of a motor."""

    def named(name: str, motion: str) -> list[str]:
        plain = [title for title in titles if NAMES.get(title_unit(title)[0].lower()) == name]
        return plain or meanings(titles, Units(motion))[name]

    commands = named("u", "linear")
    for kind, unit in COMMANDS.items():
        commands = commands or meanings(titles, Units("linear", kind, unit))["u"]
    command = next(iter(commands), "")
    unit = title_unit(command)[1]
    unit = "%" if "%" in unit else unit  # of what, or of how many, is for [record] to say
    by_word = next((kind for kind, pattern in _BY_WORD.items() if re.search(pattern, words(command))), "voltage")
    kind = _BY_UNIT.get(unit, by_word)
    moving = [one for name in ("q", "q_ref", "velocity") for motion in MOTIONS for one in named(name, motion)]
    told = {title_unit(title)[1] for title in moving} & _MOTION
    motor = any(re.search(r"\bmotor\b|drehzahl", words(title)) for title in moving)
    motion = "rotary" if told & _TURNING or (motor and not told) else "linear"
    if kind == "duty":
        return Units(motion, kind, "")
    return Units(motion, kind, unit if unit in ("%", *_BY_UNIT) else COMMANDS[kind])
