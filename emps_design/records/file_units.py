"""Units in which a file may give what the columns of a record measure."""

from __future__ import annotations

import math

# unit inside -> unit of a file -> factor
_FACTORS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "m/min": 1 / 60, "mm/min": 1e-3 / 60},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180, "rev/s": 2 * math.pi, "rpm": 2 * math.pi / 60},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "N m": {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3, "N cm": 1e-2},
    "V": {"V": 1.0, "mV": 1e-3, "kV": 1e3},
    "A": {"A": 1.0, "mA": 1e-3},
    "": {},
}
_INSIDE = {
    "linear": {"time": "s", "position": "m", "velocity": "m/s", "force": "N", "voltage": "V", "switch": ""},
    "rotary": {"time": "s", "position": "rad", "velocity": "rad/s", "force": "N m", "voltage": "V", "switch": ""},
}
_SPELLINGS = {"°": "deg", "°/s": "deg/s", "Nm": "N m", "mNm": "mN m", "Ncm": "N cm", "sec": "s", "msec": "ms"}
_SPELLINGS |= {
    "1/min": "rpm",
    "U/min": "rpm",
    "min-1": "rpm",
    "r/min": "rpm",
    "rot": "rev",
    "U": "rev",
    "inc": "counts",
}


def inside(quantity: str, motion: str, command_unit: str) -> str:
    """The unit of a quantity in a record.

    >>> inside("position", "rotary", "A"), inside("command", "rotary", "A")
    ('rad', 'A')
    """
    return command_unit if quantity == "command" else _INSIDE[motion][quantity]


def factors(quantity: str, motion: str, command_unit: str) -> dict[str, float]:
    """What each unit of a file is in the unit inside.

    >>> factors("force", "linear", "V")
    {'N': 1.0, 'mN': 0.001, 'kN': 1000.0}
    """
    unit = inside(quantity, motion, command_unit)
    return _FACTORS.get(unit, {unit: 1.0})


def spelled(unit: str) -> str:
    """One spelling of a unit.

    >>> spelled(" µs "), spelled("Nm"), spelled("°")
    ('us', 'N m', 'deg')
    """
    unit = unit.strip().replace("µ", "u").replace("μ", "u")
    return _SPELLINGS.get(unit, unit)
