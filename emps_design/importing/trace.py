"""What a trace tells of its axis before there is an axis file: columns, units, period, encoder, limit."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from emps_design.axis import record_toml
from emps_design.errors import RecordError
from emps_design.importing.account import record_table, step_seen
from emps_design.records import Record, read_record
from emps_design.records.columns import NAMES, plain_title, title_unit
from emps_design.records.layout import NAMED, Assignment, Layout
from emps_design.records.mapping import KEYS, Column, ColumnMap
from emps_design.records.readers import read_titles
from emps_design.records.recognise import meanings, words
from emps_design.units import COMMANDS, MOTIONS, Units

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
