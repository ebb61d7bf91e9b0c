"""What a column's title says in plain words, English or German: actual and set position, torque command, time ...

A title is taken for something only where it says what is measured *and*, where there are two of it, whether it is the
set or the actual value. What was taken for what is always told.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from emps_design.records.columns import QUANTITIES, factor_of, title_unit
from emps_design.units import Units

_WORDS = re.compile(r"[A-Z]?[a-zäöüß]+|[A-Z]+(?![a-zäöü])|\d+")
# Compound words of German are looked into; words of English are whole.
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


def words(title: str) -> str:
    """The words of a title in small letters, its unit left out.

    >>> words("Axis1.ActPos [mm]"), words("PositionActualValue"), words("Lage-Istwert")
    ('axis 1 act pos', 'position actual value', 'lage istwert')
    """
    return " ".join(word.lower() for word in _WORDS.findall(title_unit(title)[0].replace("_", " ")))


def meanings(titles: Sequence[str], units: Units) -> dict[str, list[str]]:
    """The titles that may be each column of a record; the plainest only, and none where none says it.

    >>> found = meanings(["Zeit [ms]", "Lageistwert [mm]", "Lagesollwert [mm]", "Status"], Units())
    >>> {name: titles for name, titles in found.items() if titles}
    {'t': ['Zeit [ms]'], 'q_ref': ['Lagesollwert [mm]'], 'q': ['Lageistwert [mm]']}
    """

    def measures(title: str, name: str) -> bool:
        return factor_of(title_unit(title)[1], name, units) is not None

    def those(*patterns: str, but: str = "", name: str = "") -> list[str]:
        found = []
        for title in titles:
            text = words(title)
            if re.search(_NOT, text) or (but and re.search(but, text)):
                continue
            if all(re.search(pattern, text) for pattern in patterns) and (
                not name or measures(title, name) or not title_unit(title)[1]
            ):
                found.append(title)
        return found

    def alone(pattern: str, name: str) -> list[str]:
        return [title for title in titles if re.fullmatch(pattern, words(title)) and measures(title, name)]

    drive = rf"{_SENSOR}|{_SUPPLY}"
    found: dict[str, list[str]] = {
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
    return {name: found.get(name, []) for name in QUANTITIES}


def _first(*ways: Callable[[], list[str]]) -> list[str]:
    """What the first way finds that finds anything."""
    return next((found for way in ways if (found := way())), [])
