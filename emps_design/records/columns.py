"""The columns of a record: their names, what each measures, and what a title in a file says of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from emps_design.errors import RecordError
from emps_design.records.file_units import factors, spelled

# The contract's names, and the names of the EMPS data set.
NAMES = {"t": "t", "qg": "q_ref", "q_ref": "q_ref", "qm": "q", "q": "q", "vir": "u", "u": "u"}
OPTIONAL = ("f_ext", "velocity_reference", "velocity", "supply", "enable", "excitation")
NAMES |= {name: name for name in OPTIONAL}
QUANTITIES = {
    "t": "time",
    "q_ref": "position",
    "q": "position",
    "u": "command",
    "f_ext": "force",
    "velocity_reference": "velocity",
    "velocity": "velocity",
    "supply": "voltage",
    "enable": "switch",
    "excitation": "command",
}
RECORD = "emps_design_record"  # a member of an archive that this package wrote: its columns need no mapping
_CONTRACT = re.compile(r"\s*(?P<name>\w+)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\)|/\s*(?P<slash>\w+))?\s*")
_BRACKETED = re.compile(r"\s*(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))\s*")


@dataclass(frozen=True)
class Title:
    """A column's title in the file, the name it stands for ("" where the record has no such column), and its unit."""

    text: str
    name: str
    unit: str = ""
    factor: float = 1.0  # what one unit of the file is in units of the library


def read_title(text: str, source: str, motion: str = "linear", command_unit: str = "V") -> Title:
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
    known = factors(QUANTITIES[name], motion, command_unit)
    if unit and unit not in known:
        raise RecordError(
            f"{source}: column {text.strip()!r}: unknown unit {unit!r}, expected one of {', '.join(known)}"
        )
    return Title(text.strip(), name, unit, known[unit] if unit else 1.0)


def plain_title(text: str) -> tuple[str, str]:
    """Return a title without its bracketed unit, and that unit, or "" where it has none.

    >>> plain_title("Lageistwert [mm]"), plain_title("pos_deg"), plain_title("Torque (act) (Nm)")
    (('Lageistwert', 'mm'), ('pos_deg', ''), ('Torque (act)', 'Nm'))
    """
    match = _BRACKETED.fullmatch(text)
    if match is None or not match["name"]:
        return text.strip(), ""
    return match["name"], (match["square"] or match["round"] or "").strip()


def listed(titles: Sequence[str]) -> str:
    """The ``titles`` of a file, as a message lists them."""
    return ", ".join(_shorten(text) for text in titles[:12]) or "none"


def _shorten(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 20 else text[:17] + "..."
