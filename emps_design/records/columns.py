"""The columns of a record: names, quantities, and the meaning of the titles in a file.

Titles are recognised by their words, English or German: actual and set position, torque command, time ... A title must
name the quantity *and*, where there are two of it, whether it is the set or the actual value. Notes on the record say
which columns were recognised.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from emps_design.errors import InputError, RecordError
from emps_design.units import Units, is_unit, spelled

# The contract's names, and the names of the EMPS data set.
NAMES = {"t": "t", "qg": "q_ref", "q_ref": "q_ref", "qm": "q", "q": "q", "vir": "u", "u": "u"}
OPTIONAL = ("f_ext", "velocity_reference", "velocity", "supply", "enable", "excitation", "bridged")
NAMES |= {name: name for name in OPTIONAL}
# name -> quantity, which has units; a switch has none
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
# Units that may end a title without brackets: unambiguous ones, and letters that may mean something else.
TAILS = ("ms", "us", "mm", "um", "nm", "cm", "deg", "rad", "mrad", "rev", "rpm", "mA", "mV", "kN", "N m")
LETTERS = ("s", "m", "A", "V", "N")
PLAIN = Units()  # of a record that no axis file describes
_CONTRACT = re.compile(r"\s*(?P<name>\w+)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\)|/\s*(?P<slash>\w+))?\s*")
_BRACKETED = re.compile(r"\s*(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))\s*")
_BEHIND_A_STROKE = re.compile(
    r"\s*(?P<name>[^/\[\]()]*[^/\[\]()\s])\s*/\s*(?P<unit>[^/\s\[\]()]+(?:/[^/\s\[\]()]+)?)\s*"
)

_WORDS = re.compile(r"[A-Z]?[a-zäöüß]+|[A-Z]+(?![a-zäöü])|\d+")
# German compounds are searched for parts; English words are whole.
_SET = r"\b(set|setpoint|ref|reference|cmd|command|commanded|target|demand|desired|nominal)\b|soll"
_ACTUAL = r"\b(act|actual|meas|measured|feedback|fb|fbk|encoder|enc|ist)\b|istwert|\bist|ist\b"
_POSITION = r"\b(pos|position|angle)\b|^q$|lage|position|winkel"
_VELOCITY = r"\b(vel|velo|velocity|speed|omega)\b|geschwindigkeit|drehzahl"
_FORCE = r"\b(torque|force|current|iq|voltage|duty|pwm)\b|moment|strom|kraft|spannung"
_SENSOR = r"\b(external|ext|sensor|loadcell)\b|extern|sensor|messdose"
_SUPPLY = r"\b(supply|bus|dc ?link|dclink|battery)\b|zwischenkreis|versorgung"
_NOT = (
    r"\b(error|following|lag|limit|max|min|status|state|temp|temperature|deviation|diff|raw|offset|power|acc|"
    r"acceleration|jerk|mode|window)\b|abweichung|schlepp|fehler|grenz|differenz|beschleunigung|temperatur"
)


@dataclass(frozen=True)
class Title:
    """A column's title in the file, its name in a record ("" for no such column), and its unit."""

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
    """Factor from ``unit`` of a file to the unit of a record's column; None for a unit of another quantity."""
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
    """Return a title without its unit in brackets or after a slash, and that unit, "" for none.

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
    """Return a title without its unit, and the unit: the bracketed one, or a suffix after the last underscore.

    >>> title_unit("Lage [mm]"), title_unit("pos_deg"), title_unit("cmd_A"), title_unit("act_pos"), title_unit("state")
    (('Lage', 'mm'), ('pos', 'deg'), ('cmd', 'A'), ('act_pos', ''), ('state', ''))
    """
    plain, bracketed = plain_title(text)
    if bracketed:
        return plain, spelled(bracketed)
    head, _, tail = plain.rpartition("_")
    return (head, spelled(tail)) if head and spelled(tail) in (*TAILS, *LETTERS) else (plain, "")


def column_titles(name: str, count: int) -> list[str]:
    """Titles for the ``count`` columns of a matrix called ``name``.

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


def words(title: str) -> str:
    """The words of a title in lower case, without its unit.

    >>> words("Axis1.ActPos [mm]"), words("PositionActualValue"), words("Lage-Istwert")
    ('axis 1 act pos', 'position actual value', 'lage istwert')
    """
    return " ".join(word.lower() for word in _WORDS.findall(title_unit(title)[0].replace("_", " ")))


def meanings(titles: Sequence[str], units: Units) -> dict[str, list[str]]:
    """The titles that may be each column of a record, by name: of several only the clearest.

    >>> candidates = meanings(["Zeit [ms]", "Lageistwert [mm]", "Lagesollwert [mm]", "Status"], Units())
    >>> {name: titles for name, titles in candidates.items() if titles}
    {'t': ['Zeit [ms]'], 'q_ref': ['Lagesollwert [mm]'], 'q': ['Lageistwert [mm]']}
    """

    def measures(title: str, name: str) -> bool:
        return factor_of(title_unit(title)[1], name, units) is not None

    def those(*patterns: str, but: str = "", name: str = "") -> list[str]:
        matches = []
        for title in titles:
            text = words(title)
            if re.search(_NOT, text) or (but and re.search(but, text)):
                continue
            if all(re.search(pattern, text) for pattern in patterns) and (
                not name or measures(title, name) or not title_unit(title)[1]
            ):
                matches.append(title)
        return matches

    def alone(pattern: str, name: str) -> list[str]:
        return [title for title in titles if re.fullmatch(pattern, words(title)) and measures(title, name)]

    drive = rf"{_SENSOR}|{_SUPPLY}"
    candidates: dict[str, list[str]] = {
        "t": _first(lambda: alone(r"t|time|zeit|timestamp|zeitstempel", "t"), lambda: those(r"^(time|zeit|t)\b")),
        "q_ref": _first(
            lambda: those(_SET, _POSITION, but=_VELOCITY, name="q"),
            lambda: alone(r"set|setpoint|ref|reference|target|sollwert", "q"),
        ),
        "q": _first(
            lambda: those(_ACTUAL, _POSITION, but=f"{_VELOCITY}|{_SET}", name="q"),
            lambda: those(_POSITION, but=f"{_VELOCITY}|{_SET}", name="q"),
            lambda: those(r"^(x|theta|phi)$", name="q"),
        ),
        "u": _first(
            lambda: those(_SET, _FORCE, but=drive),
            lambda: those(_FORCE, but=f"{_ACTUAL}|{drive}"),
            lambda: those(_FORCE, but=drive),
            lambda: alone(r"cmd|command|stellgröße|u", "u"),
            lambda: alone(r"i|tau", "u"),  # a current, a torque, by the letter and the unit
        ),
        "velocity_reference": those(_SET, _VELOCITY, name="velocity"),
        "velocity": _first(
            lambda: those(_VELOCITY, but=_SET, name="velocity"), lambda: those(r"^(v|w|dq|qd)$", name="velocity")
        ),
        "f_ext": those(_SENSOR, _FORCE, name="f_ext"),
        "supply": those(_SUPPLY, r"volt|spannung", name="supply"),
    }
    return {name: candidates.get(name, []) for name in QUANTITIES}


def _first(*ways: Callable[[], list[str]]) -> list[str]:
    """The titles of the first of ``ways`` with any; none if all are empty."""
    return next((titles for way in ways if (titles := way())), [])
