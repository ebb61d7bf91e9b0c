"""What a trace tells of its axis before there is an axis file: columns, units, period, encoder, limit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from emps_design.errors import RecordError
from emps_design.importing.account import record_table, step_seen
from emps_design.records import Record, read_record
from emps_design.records.columns import NAMES, title_unit
from emps_design.records.layout import NAMED, Assignment, Layout
from emps_design.records.mapping import KEYS
from emps_design.records.readers import read_titles
from emps_design.records.recognise import meanings, words
from emps_design.units import COMMANDS, Units

# What a command is, by the unit in its title, or by its words where that is a share of the rated value.
_BY_UNIT = {"V": "voltage", "mV": "voltage", "A": "current", "mA": "current", "N m": "torque", "mN m": "torque"}
_BY_UNIT |= {"N": "force", "kN": "force"}
_BY_WORD = {
    "current": r"\b(current|iq)\b|strom",
    "torque": r"\btorque\b|moment",
    "force": r"\bforce\b|kraft",
    "duty": r"\b(duty|pwm)\b",
}
NEW = "\n"
PLATEAU = 1e-6  # of the largest command: samples this near it sit at a limit
FEWEST_AT_LIMIT = 20


@dataclass(frozen=True)
class Trace:
    """A file of ``titles``, the ``units`` that they tell, and its ``record``, or the ``reason`` why there is none."""

    path: Path
    titles: tuple[str, ...]
    units: Units
    record: Record | None = None
    reason: str = ""

    @property
    def encoder_step(self) -> float | None:
        """The step of the encoder [m or rad] where the position shows one."""
        return None if self.record is None else step_seen(self.record)

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
    try:
        layout = Layout(units, period=math.inf, resample=True, reference_needed=False)
        record = read_record(path, layout=layout)
    except RecordError as error:
        return Trace(Path(path), tuple(titles), units, reason=str(error))
    return Trace(Path(path), tuple(titles), units, record)


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
    """The ``[record]`` table, or why none is needed."""
    if trace.record is None:
        return _to_choose(trace)
    if all(one.how == NAMED for one in trace.record.assigned):
        return "# The columns have the names of a record: no [record] table is needed.\n"
    return record_table(trace.record.assigned)


def _units(titles: list[str]) -> Units:
    """Motion and command as the titles have them: a line and a voltage where they say nothing."""

    def named(name: str, motion: str) -> list[str]:
        plain = [title for title in titles if NAMES.get(title_unit(title)[0].lower()) == name]
        return plain or meanings(titles, Units(motion))[name]

    positions = [title_unit(title)[1] for title in named("q", "rotary") + named("q_ref", "rotary")]
    motion = "rotary" if any(one in ("deg", "rad", "mrad", "rev") for one in positions) else "linear"
    commands = named("u", motion)
    for kind, unit in COMMANDS.items():
        commands = commands or meanings(titles, Units(motion, kind, unit))["u"]
    command = next(iter(commands), "")
    unit = title_unit(command)[1]
    unit = "%" if "%" in unit else unit  # of what, or of how many, is for [record] to say
    by_word = next((kind for kind, pattern in _BY_WORD.items() if re.search(pattern, words(command))), "voltage")
    kind = _BY_UNIT.get(unit, by_word)
    if kind == "duty":
        return Units(motion, kind, "")
    return Units(motion, kind, unit if unit in ("%", *_BY_UNIT) else COMMANDS[kind])


def _to_choose(trace: Trace) -> str:
    """The ``[record]`` table with what is understood, and the rest to be chosen from the titles of the file."""
    understood = {name: found[0] for name, found in meanings(trace.titles, trace.units).items() if len(found) == 1}
    reason = trace.reason.replace(str(trace.path), trace.path.name)
    lines = [f"# {reason}", f"# columns of the file: {', '.join(trace.titles[:40])}", "[record]"]
    for name in ("t", "q", "q_ref", "u"):
        if name in understood:
            title, unit = understood[name], title_unit(understood[name])[1]
            lines += record_table((Assignment(name, title, unit),)).splitlines()[1:]
        else:
            lines.append(f'# {KEYS[name]} = {{ column = "", unit = "{trace.units.unit(_SHOWN[name])}" }}')
    return "\n".join(lines) + "\n"


_SHOWN = {"t": "s", "q": "m", "q_ref": "m", "u": "V"}
