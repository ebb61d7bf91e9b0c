"""Names and units of the columns of a record: what a file may call them, and what they become."""

from __future__ import annotations

import re
from dataclasses import dataclass

from emps_design.errors import RecordError

# The contract's names, and the names of the EMPS data set.
NAMES = {"t": "t", "qg": "q_ref", "q_ref": "q_ref", "qm": "q", "q": "q", "vir": "u", "u": "u", "f_ext": "f_ext"}
REQUIRED = ("t", "q_ref", "q", "u")
UNITS = {"t": "s", "q_ref": "m", "q": "m", "u": "V", "f_ext": "N"}
FACTORS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "V": {"V": 1.0, "mV": 1e-3, "kV": 1e3},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
}
_TITLE = re.compile(r"\s*(?P<name>\w+)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\)|/\s*(?P<slash>\w+))?\s*")


@dataclass(frozen=True)
class Title:
    """A column's title in the file, the name it stands for ("" where the record has no such column), and its unit."""

    text: str
    name: str
    unit: str = ""

    @property
    def factor(self) -> float:
        """What one unit of the file is in SI units."""
        return FACTORS[UNITS[self.name]][self.unit] if self.unit else 1.0


def read_title(text: str, source: str) -> Title:
    """Split a title such as ``q [mm]``, ``u (V)`` or ``t/ms``; raises :class:`RecordError` on an unknown unit.

    >>> read_title("qm [mm]", "a.csv")
    Title(text='qm [mm]', name='q', unit='mm')
    >>> read_title("temperature", "a.csv").name
    ''
    """
    match = _TITLE.fullmatch(text)
    name = NAMES.get(match["name"].lower(), "") if match else ""
    if not name or match is None:
        return Title(text.strip(), "")
    unit = (match["square"] or match["round"] or match["slash"] or "").strip().replace("µ", "u").replace("μ", "u")
    known = FACTORS[UNITS[name]]
    if unit and unit not in known:
        raise RecordError(
            f"{source}: column {text.strip()!r}: unknown unit {unit!r}, expected one of {', '.join(known)}"
        )
    return Title(text.strip(), name, unit)


def read_titles(texts: list[str], source: str) -> list[Title]:
    """Titles of a whole file; raises :class:`RecordError` where two claim one name, or a needed one is missing."""
    titles = [read_title(text, source) for text in texts]
    taken: dict[str, str] = {}
    for title in titles:
        if title.name in taken:
            raise RecordError(
                f"{source}: columns {taken[title.name]!r} and {title.text!r} both stand for {title.name}; keep one"
            )
        if title.name:
            taken[title.name] = title.text
    missing = [name for name in REQUIRED if name not in taken]
    if missing:
        found = ", ".join(_shorten(text) for text in texts[:12]) or "none"
        raise RecordError(
            f"{source}: missing column {', '.join(missing)}; found {found}; expected t [s], q_ref [m], q [m], u [V] "
            "(or the EMPS names t, qg, qm, vir)"
        )
    return titles


def _shorten(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 20 else text[:17] + "..."
