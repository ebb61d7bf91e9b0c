"""The columns of a record: their names, what each measures, and what a title in a file says of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from emps_design.errors import InputError, RecordError
from emps_design.units import Units, is_unit, spelled

# The contract's names, and the names of the EMPS data set.
NAMES = {"t": "t", "qg": "q_ref", "q_ref": "q_ref", "qm": "q", "q": "q", "vir": "u", "u": "u"}
OPTIONAL = ("f_ext", "velocity_reference", "velocity", "supply", "enable", "excitation", "bridged")
NAMES |= {name: name for name in OPTIONAL}
# name -> what it measures, one of the columns that units are known of; a switch has none
QUANTITIES = {
    "t": "time",
    "q_ref": "position",
    "q": "position",
    "u": "command",
    "f_ext": "force",
    "velocity_reference": "velocity",
    "velocity": "velocity",
    "supply": "supply",
    "enable": "switch",
    "excitation": "command",
    "bridged": "switch",
}
_BASE = {"time": "s", "position": "m", "velocity": "m/s", "force": "N", "command": "V", "supply": "volt", "switch": ""}
RECORD = "emps_design_record"  # a member of an archive that this package wrote: its columns need no mapping
# Units that may end a title without brackets: those that are surely one, and letters that may stand for something else.
TAILS = ("ms", "us", "mm", "um", "nm", "cm", "deg", "rad", "mrad", "rev", "rpm", "mA", "mV", "kN", "N m")
LETTERS = ("s", "m", "A", "V", "N")
PLAIN = Units()  # of a record that no axis file describes
_CONTRACT = re.compile(r"\s*(?P<name>\w+)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\)|/\s*(?P<slash>\w+))?\s*")
_BRACKETED = re.compile(r"\s*(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))\s*")
_BEHIND_A_STROKE = re.compile(
    r"\s*(?P<name>[^/\[\]()]*[^/\[\]()\s])\s*/\s*(?P<unit>[^/\s\[\]()]+(?:/[^/\s\[\]()]+)?)\s*"
)


@dataclass(frozen=True)
class Title:
    """A column's title in the file, the name it stands for ("" where the record has no such column), and its unit."""

    text: str
    name: str
    unit: str = ""
    factor: float = 1.0  # what one unit of the file is in units of the library


def unit_of(name: str, units: Units) -> str:
    """The unit of a record's column called ``name``.

    >>> unit_of("q", Units("rotary", "current", "A")), unit_of("u", Units("rotary", "current", "A"))
    ('rad', 'A')
    """
    return units.unit(_BASE[QUANTITIES[name]])


def factor_of(unit: str, name: str, units: Units) -> float | None:
    """What one ``unit`` of a file is in the unit of a record's column, or None for a unit of something else."""
    try:
        return units.factor(unit, QUANTITIES[name]) if QUANTITIES[name] != "switch" else None
    except InputError:
        return None


def read_title(text: str, source: str, units: Units = PLAIN) -> Title:
    """Split a title such as ``q [mm]``, ``u (V)`` or ``t/ms``; raises :class:`RecordError` on an unknown unit.

    >>> read_title("qm [mm]", "a.csv")
    Title(text='qm [mm]', name='q', unit='mm', factor=0.001)
    >>> read_title("temperature", "a.csv").name
    ''
    """
    match = _CONTRACT.fullmatch(text)
    name = NAMES.get(match["name"].lower(), "") if match else ""
    if not name or match is None:
        return Title(text.strip(), "")
    unit = spelled(match["square"] or match["round"] or match["slash"] or "")
    try:
        factor = units.factor(unit, QUANTITIES[name]) if unit and QUANTITIES[name] != "switch" else 1.0
    except InputError as error:
        raise RecordError(f"{source}: column {text.strip()!r}: {error}") from error
    return Title(text.strip(), name, unit, factor)


def plain_title(text: str) -> tuple[str, str]:
    """Return a title without the unit in brackets or behind a stroke, and that unit, or "" where it has none.

    >>> plain_title("Lageistwert [mm]"), plain_title("pos_deg"), plain_title("Torque (act) (Nm)")
    (('Lageistwert', 'mm'), ('pos_deg', ''), ('Torque (act)', 'Nm'))
    >>> plain_title("Time/ms"), plain_title("speed / (r/min)"), plain_title("speed m/s"), plain_title("on/off")
    (('Time', 'ms'), ('speed', 'r/min'), ('speed m/s', ''), ('on/off', ''))
    """
    match = _BRACKETED.fullmatch(text)
    if match is not None and match["name"]:
        return match["name"].rstrip("/ ") or match["name"], (match["square"] or match["round"] or "").strip()
    match = _BEHIND_A_STROKE.fullmatch(text)
    if match is None or not spelled(match["unit"]) or not is_unit(match["unit"]):
        return text.strip(), ""
    part_of_it = is_unit(f"{match['name'].split()[-1]}/{match['unit']}")
    return (text.strip(), "") if part_of_it else (match["name"], match["unit"])


def title_unit(text: str) -> tuple[str, str]:
    """Return a title without its unit, and the unit: the bracketed one, or what stands after a last underscore.

    >>> title_unit("Lage [mm]"), title_unit("pos_deg"), title_unit("cmd_A"), title_unit("act_pos"), title_unit("state")
    (('Lage', 'mm'), ('pos', 'deg'), ('cmd', 'A'), ('act_pos', ''), ('state', ''))
    """
    plain, bracketed = plain_title(text)
    if bracketed:
        return plain, spelled(bracketed)
    head, _, tail = plain.rpartition("_")
    return (head, spelled(tail)) if head and spelled(tail) in (*TAILS, *LETTERS) else (plain, "")


def column_titles(name: str, count: int) -> list[str]:
    """The titles of ``count`` columns of a matrix called ``name``, which has none itself.

    >>> column_titles("data", 3)
    ['data:0', 'data:1', 'data:2']
    """
    return [f"{name}:{k}" for k in range(count)]


def listed(titles: Sequence[str]) -> str:
    """The ``titles`` of a file, as a message lists them."""
    return ", ".join(_shorten(text) for text in titles[:12]) or "none"


def _shorten(text: str) -> str:
    text = " ".join(text.split())
    text = text if len(text) <= 20 else text[:17] + "..."
    return f"'{text}'" if " " in text else text
