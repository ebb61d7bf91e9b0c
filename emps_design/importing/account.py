"""Account of an import: columns, units, ranges, clock, encoder, and the ``[record]`` table for the axis file.

Without an axis file, :func:`read_trace` reads columns, units, period, encoder and command limit from a trace.
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
from emps_design.messages import Message, warning
from emps_design.records import Record, read_record
from emps_design.records.columns import NAMES, meanings, plain_title, title_unit, unit_of, words
from emps_design.records.layout import KEYS, MAPPED, NAMED, RECOGNISED, Assignment, Column, ColumnMap, Layout
from emps_design.records.readers import read_titles
from emps_design.units import COMMANDS, MOTIONS, Units
from emps_design.view import Line, Table, View, Viewed, sparkline

ALIKE = 1.25  # largest ratio of the measured encoder step to that of the axis file, or its inverse

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
# The usual unit where a title has none, by motion: the default of most drives.
USUAL = {
    "linear": {"q": "m", "q_ref": "m", "velocity": "m/s"},
    "rotary": {"q": "rad", "q_ref": "rad", "velocity": "rpm"},
}
NEW = "\n"
PLATEAU = 1e-6  # of the largest command: samples this close to it are at a limit
FEWEST_AT_LIMIT = 20


@dataclass(frozen=True)
class Account(Viewed):
    """An imported ``record`` beside the ``axis`` that it was read for."""

    record: Record
    axis: Axis

    @property
    def encoder_step(self) -> float | None:
        """Encoder step of the recorded position [m or rad], None where it has none."""
        return self.record.encoder_step

    @property
    def notes(self) -> tuple[Message, ...]:
        """Warnings of the reader, and of an encoder step that differs from the axis file."""
        step, known = self.encoder_step, self.axis.sampling.encoder_resolution
        if step is None or not known or 1.0 / ALIKE < step / known < ALIKE:
            return self.record.warnings
        unit, factor = self.axis.units.display(known, "m")
        text = f"q: moves in steps of {factor * step:.4g} {unit}, the axis file says {factor * known:.4g} {unit}"
        return (*self.record.warnings, warning("other-encoder-step", text, column="q", step=step, known=known))

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """One row of words per column, under ``HEADINGS``; positions in a readable unit."""
        return [self._row(self._column(assignment)) for assignment in self.record.assigned]

    @property
    def table(self) -> str:
        """The ``[record]`` table that maps the columns, "" where the file needs none.

        Entries of the axis file stay unchanged, also those of columns that this file lacks.
        """
        assigned = self.record.assigned
        if all(assignment.how == NAMED for assignment in assigned):
            return ""
        there = {assignment.name for assignment in assigned}
        absent = {name: column for name, column in self.axis.record.named.items() if name not in there}
        return record_table(assigned, absent, self.axis.record.accept)

    def view(self) -> View:
        """What each column was taken for, clock and encoder, the main signals, and the table for the axis file."""
        record, units, resampled = self.record, self.axis.units, self.record.measured is not None
        own = " (the axis has this period)" if record.period == self.axis.sampling.period else ""
        view: list[Line | Table] = [
            Table(HEADINGS, self.rows, f"{record.name}, read for {self.axis.name}", ("unit", "is", "found")),
            Line(
                f"{len(record)} samples of {1e3 * record.period:.6g} ms{own}, {record.duration:.6g} s"
                f"{', resampled' if resampled else ''}"
            ),
        ]
        step = self.encoder_step
        if step is not None:
            unit, factor = units.display(step, "m")
            view.append(Line(f"encoder step seen in q: {factor * step:.4g} {unit}"))
        signals = [name for name in ("q_ref", "q", "u") if name in record.columns]
        view += [Line(f"{name:>6} {sparkline(record.columns[name])}", "code") for name in signals]
        if self.recognised:
            view += [Line(""), Line("Recognised titles; put this into the axis file:"), Line("")]
            view += [Line(line, "code") for line in self.table.rstrip(NEW).split(NEW)]
        return tuple(view)

    @property
    def recognised(self) -> bool:
        """Whether a column was understood by its title, not by the axis file or its name."""
        return any(assignment.how == RECOGNISED for assignment in self.record.assigned)

    def to_dict(self) -> dict[str, Any]:
        """Columns, clock, encoder and notes as plain data."""
        record, units = self.record, self.axis.units
        measured = record.measured
        step = np.diff(record.t[:2] if measured is None else measured["t"])
        return {
            **record.to_dict(),
            "columns": [self._column(assignment) for assignment in record.assigned],
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
            "recognised": self.recognised,
            "warnings": list(self.notes),
        }

    def _row(self, column: dict[str, Any]) -> tuple[str, ...]:
        unit, factor = column["unit"], 1.0
        if column["name"] in ("q", "q_ref"):
            unit, factor = self.axis.units.display(max(abs(column["lowest"]), abs(column["highest"])), "m")
        ends = (f"{factor * column[end] or 0.0:.6g}" for end in ("lowest", "highest"))
        return (column["title"], column["unit_in_file"], column["name"], *ends, unit, _HOW[column["how"]])

    def _column(self, assignment: Assignment) -> dict[str, Any]:
        values = self.record.t if assignment.name == "t" else self.record.columns[assignment.name]
        return {
            "name": assignment.name,
            "title": assignment.title,
            "key": KEYS.get(assignment.name, assignment.name),
            "how": assignment.how,
            "unit_in_file": assignment.unit,
            "factor": assignment.factor,
            "unit": unit_of(assignment.name, self.axis.units),
            "lowest": float(values.min()),
            "highest": float(values.max()),
        }


def record_table(
    assigned: Sequence[Assignment], absent: Mapping[str, Column] = MappingProxyType({}), accept: Sequence[str] = ()
) -> str:
    """The ``[record]`` table of an axis file for columns ``assigned``, ``absent`` ones by name, doubts to ``accept``.

    Entries of the axis file stay unchanged; other columns get their title and unit.
    """
    entries = {assignment.name: _entry(assignment) for assignment in assigned if assignment.name in KEYS}
    entries |= {name: _written(column) for name, column in absent.items()}
    return record_toml({KEYS[name]: entry for name, entry in entries.items()} | ({"accept": accept} if accept else {}))


def _entry(assignment: Assignment) -> dict[str, Any]:
    """The entry of one column in ``[record]``; a command in the unit of the axis needs no unit."""
    if assignment.entry is not None:
        return _written(assignment.entry)
    own = assignment.name == "enable" or (assignment.name == "u" and assignment.factor == 1.0)
    bracketed = assignment.title.rstrip().endswith(("]", ")"))
    return {"column": plain_title(assignment.title)[0] if bracketed else assignment.title.strip()} | (
        {"unit": assignment.unit} if assignment.unit and not own else {}
    )


def _written(column: Column) -> dict[str, Any]:
    """``column`` as in an axis file, without defaults."""
    return column.model_dump(exclude_none=True, exclude_defaults=True)


@dataclass(frozen=True)
class Trace:
    """A file of ``titles`` with the ``units`` of these, and its ``record``, or the ``reason`` why it cannot be read.

    ``guessed`` are the columns, by name in a record, whose title has no unit: the record was read with the units of
    :data:`USUAL`, which affect neither period nor command.
    """

    path: Path
    titles: tuple[str, ...]
    units: Units
    record: Record | None = None
    reason: str = ""
    guessed: tuple[str, ...] = ()

    @property
    def encoder_step(self) -> float | None:
        """Encoder step [m or rad] of the position, None without one or where its unit is a guess."""
        return None if self.record is None or "q" in self.guessed else self.record.encoder_step

    @property
    def limit(self) -> float | None:
        """The command limit [command unit], where many samples are at the largest command; else None."""
        if self.record is None:
            return None
        u = np.abs(self.record.u)
        largest = float(u.max())
        at_limit = np.count_nonzero(u >= largest * (1.0 - PLATEAU))
        return largest if at_limit >= FEWEST_AT_LIMIT else None


def read_trace(path: str | Path) -> Trace:
    """Read the trace at ``path`` without an axis file; raises :class:`RecordError` where it is no trace."""
    titles = read_titles(path)
    units = _units(titles)
    layout = Layout(units, period=math.inf, reference_needed=False)
    whole = Trace(Path(path), tuple(titles), units)
    try:
        return replace(whole, record=read_record(path, layout=layout))
    except RecordError as error:
        reason = str(error)
    guesses = {
        name: Column(column=matches[0], unit=USUAL[units.motion][name])
        for name, matches in meanings(titles, units).items()
        if name in USUAL[units.motion] and len(matches) == 1 and not title_unit(matches[0])[1]
    }
    if guesses:
        columns = ColumnMap(**{KEYS[name]: column for name, column in guesses.items()})
        with suppress(RecordError):
            record = read_record(path, layout=replace(layout, columns=columns))
            return replace(whole, record=record, reason=reason, guessed=tuple(guesses))
    return replace(whole, reason=reason)


def axis_text(trace: Trace, controller: str = "") -> str:
    """An axis file with what ``trace`` determines, the rest commented out; ``controller`` is that table, if known."""
    units, record, step = trace.units, trace.record, trace.encoder_step
    unit, name = units.unit, re.sub(r"[^\w-]+", "_", trace.path.stem) or "axis"
    moves = "inertia" if units.rotary else "mass"
    largest = float(np.max(np.abs(record.u))) if record else 0.0
    largest_remark = f"the largest recorded command is {largest:.4g}" if record else "the largest command"
    limit = trace.limit or float(f"{1.5 * largest:.1g}") or 10.0
    way = "gear" if units.rotary else "gear and screw"
    own_unit = units.command_unit != COMMANDS[units.command]
    waits = "Lines that begin with # need your value: enter it and remove the #."
    lines = [
        (f"# Written from {trace.path.name}. {waits}", ""),
        (f'name = "{name}"', ""),
        (f'motion = "{units.motion}"', "or rotary" if not units.rotary else "or linear"),
        (f"{NEW}[mechanics]", "on the load side; an estimate is enough at first: identify finds them"),
        ("# mass = 10.0", f"{unit('kg')}, {moves}"),
        ("# viscous = 100.0", f"{unit('N/(m/s)')}, viscous friction"),
        ("# coulomb = 20.0", f"{unit('N')}, Coulomb friction"),
        (f"{NEW}[drive]", ""),
        (f'command = "{units.command}"', "quantity of the command column: voltage, current, torque, force or duty"),
        *([(f'command_unit = "{units.command_unit}"', "")] if own_unit else []),
        ("# force_gain = 1.0", f"{unit('N/V')}, on the load side: rated {units.words('force')}, {way}"),
        (f"{'' if trace.limit else '# '}command_limit = {limit:.6g}", f"{units.command_unit}, {largest_remark}"),
        (f"{NEW}[sampling]", ""),
        (f"period = {record.period!r}" if record else "# period = 0.001", "s"),
        (f"{'' if step else '# '}encoder_resolution = {step or 1e-6:.4g}", f"{unit('m')}, one step on the load side"),
    ]
    text = "\n".join(f"{line:<{32 + line.count(NEW)}} # {remark}" if remark else line for line, remark in lines)
    return f"{text}\n\n{controller or NO_LAW}\n{_columns(trace)}"


NO_LAW = '[controller]\nkind = "none"                    # or what the drive runs: cascade, p, position_pd ...\n'


def _columns(trace: Trace) -> str:
    """The ``[record]`` table, or a remark that none is needed; uncertain lines are commented out."""
    named = (
        {assignment.name for assignment in trace.record.assigned if assignment.how == NAMED} if trace.record else set()
    )
    if trace.record is not None and not trace.guessed:
        if len(named) == len(trace.record.assigned):
            return "# The columns have the names of a record: no [record] table is needed.\n"
        return record_table(trace.record.assigned)
    reason = trace.reason.replace(str(trace.path), trace.path.name)
    lines = [f"# {reason}", f"# columns of the file: {', '.join(trace.titles[:40])}", "[record]"]
    usual = {"t": "s", "u": trace.units.command_unit} | USUAL[trace.units.motion]
    for name, matches in _needed_columns(trace).items():
        title = matches[0] if matches else ""
        unit = title_unit(title)[1]
        if len(matches) == 1 and (unit or name == "u"):
            lines.append(_line(record_table((Assignment(name, title, unit),))))
        else:
            others = f"  # or {' or '.join(map(repr, matches[1:]))}" if matches[1:] else ""
            lines.append(
                f"# {_line(record_toml({KEYS[name]: {'column': title, 'unit': unit or usual[name]}}))}{others}"
            )
    return "\n".join(lines) + "\n"


def _line(table: str) -> str:
    """The one key of a ``[record]`` table."""
    return table.split("\n")[1]


def _needed_columns(trace: Trace) -> dict[str, list[str]]:
    """Possible titles by name for each column that a record needs and no title names."""
    named = {NAMES.get(plain_title(title)[0].lower(), "") for title in trace.titles}
    matches = {name: titles for name, titles in meanings(trace.titles, trace.units).items() if name not in named}
    moves = ("velocity",) if matches.get("velocity") and not matches.get("q") else ("q",)
    return {name: matches[name] for name in ("t", *moves, "q_ref", "u") if name in matches}


def _units(titles: list[str]) -> Units:
    """Motion and command from the titles; by default a voltage, and linear motion unless a title names a motor."""

    def named(name: str, motion: str) -> list[str]:
        plain = [title for title in titles if NAMES.get(title_unit(title)[0].lower()) == name]
        return plain or meanings(titles, Units(motion))[name]

    commands = named("u", "linear")
    for kind, unit in COMMANDS.items():
        commands = commands or meanings(titles, Units("linear", kind, unit))["u"]
    command = next(iter(commands), "")
    unit = title_unit(command)[1]
    unit = "%" if "%" in unit else unit  # the rated value is for [record] to say
    by_word = next((kind for kind, pattern in _BY_WORD.items() if re.search(pattern, words(command))), "voltage")
    kind = _BY_UNIT.get(unit, by_word)
    moving = [title for name in ("q", "q_ref", "velocity") for motion in MOTIONS for title in named(name, motion)]
    title_units = {title_unit(title)[1] for title in moving} & _MOTION
    motor = any(re.search(r"\bmotor\b|drehzahl", words(title)) for title in moving)
    motion = "rotary" if title_units & _TURNING or (motor and not title_units) else "linear"
    if kind == "duty":
        return Units(motion, kind, "")
    return Units(motion, kind, unit if unit in ("%", *_BY_UNIT) else COMMANDS[kind])
