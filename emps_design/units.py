"""Units of records and of an axis. No other part of the package depends on them.

The package computes in SI and uses the names of a linear axis with a voltage command: a mass in kg, a force in N, a
position in m, a command in V. :class:`Units` translates to another axis: an inertia in kg m^2, a torque in N m, an
angle in rad, a current in A.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from emps_design.errors import InputError
from emps_design.quantities import check_magnitude, display_unit

MOTIONS = ("linear", "rotary")
TURN = 5.0  # rad: the default travel of a rotary axis per metre of a linear one, 1.2 rad for 0.24 m
COMMANDS = {"voltage": "V", "current": "A", "torque": "N m", "force": "N", "duty": ""}  # with their units
COUNTS = "counts"  # of an encoder or a converter: needs a scale

_VOLTAGES = {"V": 1.0, "mV": 1e-3, "kV": 1e3}
_CURRENTS = {"A": 1.0, "mA": 1e-3}
_FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
_TORQUES = {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3}
_SHARES = {"": 1.0, "%": 0.01}
_ELECTRICAL = {"voltage": _VOLTAGES, "current": _CURRENTS, "torque": _TORQUES, "force": _FORCES, "duty": _SHARES}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_RPM, _DEG, _REV = 2.0 * math.pi / 60.0, math.pi / 180.0, 2.0 * math.pi
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": 0.0254}
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": _DEG, "rev": _REV}
_SPEEDS = {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6, "m/min": 1.0 / 60.0, "mm/min": 1e-3 / 60.0}
_ANGULAR_SPEEDS = {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEG, "rpm": _RPM, "rev/s": _REV}
# Units of a record's columns and their factors to SI, by motion.
_MECHANICAL = {
    "linear": {"position": _LENGTHS, "velocity": _SPEEDS, "force": _FORCES},
    "rotary": {"position": _ANGLES, "velocity": _ANGULAR_SPEEDS, "force": _TORQUES},
}

_KNOWN = {COUNTS}.union(
    _TIMES, *_ELECTRICAL.values(), *(units for columns in _MECHANICAL.values() for units in columns.values())
)
# other spellings, in lower case and without a plural s
_SPELLINGS = {
    "°": "deg", "degree": "deg", "grad": "deg", "°/s": "deg/s", "dps": "deg/s", "radian": "rad", "turn": "rev",
    "turn/s": "rev/s", "sec": "s", "second": "s", "msec": "ms", "usec": "us", "percent": "%", "pct": "%", "inch": "in",
    "count": COUNTS, "inc": COUNTS, "1/min": "rpm", "u/min": "rpm", "min-1": "rpm", "min^-1": "rpm", "rev/min": "rpm",
    "r/min": "rpm", "tr/min": "rpm", "min⁻¹": "rpm", "1": "", "-": "", "none": "", "volt": "V", "ampere": "A",
    "amp": "A", "newton": "N",
}  # fmt: skip

# words of a linear axis -> of a rotary one
_ROTARY_WORDS = {
    "mass": "inertia", "masses": "inertias", "force": "torque", "forces": "torques", "carriage": "load",
    "newton": "newton metre", "newtons": "newton metres", "metre": "radian", "metres": "radians",
}  # fmt: skip
_COMMAND_WORDS = {"current": "current", "torque": "torque command", "force": "force command", "duty": "duty"}
_COMMAND_NAMES = {"V": "volt", "A": "ampere", "N m": "newton metre", "N": "newton", "%": "per cent", "": "unit"}

# Units of the linear axis as they occur in a text, longest first; "volt" is a voltage on every axis.
_PREFIXED = {"nm": 1e-9, "µm": 1e-6, "um": 1e-6, "mm": 1e-3, "mV": 1e-3, "kV": 1e3, "mN": 1e-3, "kN": 1e3}
_UNIT = (
    r"(?:\(m/s\)/N|[NV]/\(m/s(?:\^2)?\)|N/\(m/s\)\^2|[µun]?m/s(?:\^[23])?|mm/s(?:\^2)?|N m(?:/A)?|N/(?:[µum]?m|V|s)|N s"
    r"|kg m\^2|kg|[mk]?[NV]|[nµum]?m|1/m)(?![\w^(%]|/[\w(]| m\b)"
)
_TAKE_A_PREFIX = ("V", "A")  # the command units that allow a prefix
_BRACKETS = re.compile(r"\[([^\[\]]*)\]")


def spelled(unit: str) -> str:
    """Return ``unit`` in the spelling of this package, or unchanged if it is unknown.

    >>> spelled("µm"), spelled("Nm"), spelled("N.m"), spelled("°"), spelled("1/min"), spelled("r/min"), spelled("sec")
    ('um', 'N m', 'N m', 'deg', 'rpm', 'rpm', 's')
    """
    text = " ".join(str(unit).split()).replace("µ", "u").replace("μ", "u")
    text = re.sub(r"^([mk]?)N *[.·*]? *m$", r"\1N m", text)
    if text in _KNOWN:
        return text
    word = text.lower()
    word = word.removesuffix("s") if len(word) > 3 and "/" not in word else word
    word = _SPELLINGS.get(word, word if len(word) > 2 else text)  # NM is no nanometre
    return word if word in _KNOWN else text


def is_unit(text: str) -> bool:
    """Whether ``text`` is a unit of a record's column, or a mark such as - for no unit.

    >>> is_unit("r/min"), is_unit("Nm"), is_unit("-"), is_unit("Torque")
    (True, True, True, False)
    """
    return spelled(text) in _KNOWN


@dataclass(frozen=True)
class Units:
    """The units of one axis, from its ``motion``, the kind of its ``command`` and its ``command_unit``.

    >>> joint = Units("rotary", "current", "A")
    >>> joint.unit("kg"), joint.unit("N/(m/s)"), joint.unit("V/(m/s)"), joint.unit("N/V"), joint.unit("(m/s)/N")
    ('kg m^2', 'N m/(rad/s)', 'A/(rad/s)', 'N m/A', '(rad/s)/(N m)')
    >>> joint.label("motor force [N]"), joint.label("voltage limit [V]"), joint.label("position [m]")
    ('motor torque [N m]', 'current limit [A]', 'angle [rad]')
    >>> Units(command="torque", command_unit="%").unit("N/V")
    'N/%'
    """

    motion: str = "linear"
    command: str = "voltage"
    command_unit: str = "V"

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Units:
        """The units of an axis given as plain data, which may be invalid.

        >>> Units.of({"motion": "rotary", "drive": {"command": "current"}})
        Units(motion='rotary', command='current', command_unit='A')
        """
        drive = table.get("drive")
        drive = drive if isinstance(drive, Mapping) else {}
        command = drive["command"] if str(drive.get("command")) in COMMANDS else "voltage"
        unit = drive.get("command_unit")
        return cls(
            "rotary" if table.get("motion") == "rotary" else "linear",
            command,
            spelled(unit) if isinstance(unit, str) else COMMANDS[command],
        )

    @property
    def rotary(self) -> bool:
        """Whether the axis is rotary."""
        return self.motion == "rotary"

    @property
    def farthest(self) -> float:
        """Largest position [m or rad] and speed [m/s or rad/s] of a bounded motion; a rotary axis may turn far.

        >>> Units().farthest, Units("rotary").farthest
        (1000.0, 1000000.0)
        """
        return 1e6 if self.rotary else 1e3

    @property
    def plain(self) -> bool:
        """Whether no translation is needed: a linear axis with a voltage command in V."""
        return not self.rotary and self.command == "voltage" and self.command_unit == "V"

    def unit(self, base: str) -> str:
        """This axis's unit for ``base``, a unit of the linear axis with a voltage command.

        ``volt`` is a voltage on every axis, and so is the V of a force gain where the command is a duty.
        """
        if self.plain:
            return base.replace("volt", "V")
        if base in ("V", "N m/A"):  # the second is the motor's and independent of the axis
            return self.command_unit if base == "V" else base
        if self.command == "duty" and base == "N/V":
            base = "N/volt"

        def translate(match: re.Match[str]) -> str:
            unit = self._token(match[3])
            unit = f"{match[2]}{unit}" if unit else "1"
            return f"{match[1]}({unit})" if match[1] and " " in unit else f"{match[1]}{unit}"

        return re.sub(r"(/?)\b([nµumk]?)(N m|kg m\^2|kg|N|V|m|volt)\b", translate, base)

    def _token(self, token: str) -> str:
        if token == "volt":
            return "V"
        if token == "V":
            return self.command_unit
        return {"kg": "kg m^2", "N": "N m", "m": "rad"}.get(token, token) if self.rotary else token

    def words(self, text: str) -> str:
        """``text`` in this axis's words for mass, force, carriage and voltage; names of files and keys do not change.

        >>> Units("rotary", "torque", "%").words("Mass and voltage, mechanics.mass"), Units().words("mass")
        ('Inertia and torque command, mechanics.mass', 'mass')
        """
        table = self._table
        if not table:
            return text

        def translate(match: re.Match[str]) -> str:
            word = table[match[0].lower()]
            return word.capitalize() if match[0][0].isupper() else word

        return self._words.sub(translate, text)

    @cached_property
    def _words(self) -> re.Pattern[str]:
        return re.compile(rf"(?<![\w.\x60/=-])({'|'.join(self._table)})(?![\w\x60/(=]|\.\w|-\w+=)", re.IGNORECASE)

    @cached_property
    def _table(self) -> dict[str, str]:
        table = dict(_ROTARY_WORDS) if self.rotary else {}
        if self.command != "voltage":
            word, name = _COMMAND_WORDS[self.command], _COMMAND_NAMES.get(self.command_unit, self.command_unit)
            plural = word if self.command == "duty" else f"{word}s"
            table |= {"voltage": word, "voltages": plural, "volt": name, "volts": f"{name}s"}
        return table

    def label(self, text: str) -> str:
        """``text`` in this axis's words and, in brackets, this axis's units: for plot axes, titles and headings.

        >>> Units(command="duty", command_unit="").label("voltage margin to the limit [V]")  # a duty has no unit
        'duty margin to the limit'
        """
        if self.plain:
            return text
        text = _BRACKETS.sub(lambda match: f"[{self._leading(match[1]).strip()}]", text).replace(" []", "")
        if self.rotary:
            text = re.sub(r"\b([Pp])osition(?=[^\[\]]{0,20}\[)", lambda m: "Angle" if m[1] == "P" else "angle", text)
        return self.words(text)

    def _leading(self, text: str) -> str:
        """``text`` with its leading unit, if any, in this axis's unit."""
        return re.sub(rf"^({_UNIT})(?=$|[ ,])", lambda match: self._with_prefix(match[1]), text)

    def _with_prefix(self, base: str) -> str:
        """The unit for ``base``, with a prefix as a factor where this axis's unit cannot take it."""
        prefixed = base[:2] in _PREFIXED and base[1] == "V" and self.command_unit not in _TAKE_A_PREFIX
        return f"{_PREFIXED[base[:2]]:g} {self.command_unit}" if prefixed else self.unit(base)

    def quantity(self, value: float, base: str, spec: str | Callable[[float], str] = ".4g") -> str:
        """``value`` [SI] as text, with this axis's unit for ``base``, which may have a prefix, such as mm or mV.

        A speed of a rotary axis is also given in rpm. ``spec`` is a format specification or a formatting function.

        >>> joint = Units("rotary", "current", "A")
        >>> joint.quantity(1.2, "N"), joint.quantity(0.012, "mm/s"), joint.quantity(1.5, "m/s", ".3g")
        ('1.2 N m', '0.6875 deg/s', '1.5 rad/s (14.3 rpm)')
        >>> Units().quantity(0.012, "mm/s"), Units(command="torque", command_unit="%").quantity(0.0123, "mV")
        ('12 mm/s', '0.0123 %')
        """
        prefix = _PREFIXED.get(base.partition("/")[0], 1.0)
        unit, factor = self.read(base)

        def text(number: float) -> str:
            return spec(number) if callable(spec) else format(number, spec)

        shown = f"{text(value / prefix * factor)} {unit}".rstrip()
        with_rpm = self.rotary and base == "m/s" and abs(value) >= 0.1
        return f"{shown} ({text(value / _RPM)} rpm)" if with_rpm else shown

    def word(self, name: str) -> str:
        """This axis's word for ``name``, a word of the linear axis with a voltage command.

        >>> Units("rotary", "current", "A").word("force"), Units().word("voltage")
        ('torque', 'voltage')
        """
        return self._table.get(name, name)

    def read(self, base: str) -> tuple[str, float]:
        """This axis's display unit for ``base``, which may have a prefix, and the factor from SI with that prefix.

        >>> Units("rotary").read("mm"), Units("rotary").read("N"), Units().read("mm")
        (('deg', 0.057295779513082325), ('N m', 1.0), ('mm', 1.0))
        """
        head, slash, rest = base.partition("/")
        if self.rotary and head == "mm" and rest in ("", "s"):
            return f"deg{slash}{rest}", 1e-3 / _DEG
        if head in _PREFIXED and head[1] == "V" and self.command_unit not in _TAKE_A_PREFIX:
            return self.command_unit, _PREFIXED[head]
        return self.unit(base), 1.0

    def check(self, name: str, value: float, base: str, positive: bool = False) -> float:
        """:func:`~emps_design.quantities.check_magnitude` in this axis's unit for ``base``."""
        return check_magnitude(name, value, self.unit(base), positive)

    def display(self, size: float, base: str) -> tuple[str, float]:
        """The display unit for ``size`` [SI], and the factor to it; ``base`` may be this axis's unit already.

        >>> Units("rotary").display(0.5, "m"), Units("rotary").display(3e-6, "m"), Units().display(0.25, "m")
        (('deg', 57.29577951308232), ('µrad', 1000000.0), ('mm', 1000.0))
        """
        if self.rotary and base in ("m", "rad"):
            return ("µrad", 1e6) if 0.0 < abs(size) < 1e-4 else ("deg", 1.0 / _DEG)
        return display_unit(size, self.unit(base))

    def readable(self, size: float, base: str) -> tuple[str, float]:
        """A readable unit for ``size`` [SI of ``base``] on this axis, and the factor to it.

        >>> joint = Units("rotary", "current", "A")
        >>> joint.readable(0.0123, "V"), Units().readable(0.0123, "V"), joint.readable(2e-3, "s")
        (('mA', 1000.0), ('mV', 1000.0), ('ms', 1000.0))
        >>> joint.readable(0.25, "m")[0], joint.readable(12.0, "N")
        ('deg', ('N m', 1.0))
        """
        name, factor = display_unit(size, base)
        unit, more = self.read(name)
        return unit, factor * more

    def factor(self, unit: str, column: str, scale: float | None = None) -> float:
        """Factor from ``unit`` to SI, or for a command to the command unit of this axis.

        ``column`` is time, position, velocity, force, command or supply. ``scale`` multiplies the factor; counts need
        one. Raises :class:`InputError` for a unit of another quantity.

        >>> joint = Units("rotary", "current", "A")
        >>> joint.factor("mA", "command"), joint.factor("rpm", "velocity"), joint.factor("counts", "position", 1e-6)
        (0.001, 0.10471975511965977, 1e-06)
        >>> joint.factor("mm", "position")
        Traceback (most recent call last):
            ...
        emps_design.errors.InputError: rotary position: found unit 'mm', expected rad, mrad, urad, deg, rev or counts
        """
        unit_name = spelled(unit)
        factor = 1.0 if scale is None else float(scale)
        if not math.isfinite(factor) or factor == 0.0:
            raise InputError(f"{column}: found scale {factor:g}, expected a finite number other than 0")
        if unit_name == COUNTS and column != "time":
            if scale is None:
                raise InputError(f"{column}: found unit {unit!r} without a scale, expected the scale of one count")
            return factor
        known = self._known(column)
        if unit_name in known:
            return factor * known[unit_name]
        *most, last = [name or "none" for name in known] + ([COUNTS] if column != "time" else [])
        expected = f"{', '.join(most)} or {last}" if most else last
        motion = f"{self.motion} " if column in _MECHANICAL[self.motion] else ""
        raise InputError(f"{motion}{column}: found unit {unit!r}, expected {expected}")

    def command_in(self, unit: str) -> float | None:
        """Factor from this axis's command unit to ``unit``; None if it is unknown, such as for % of rated.

        >>> Units(command="current", command_unit="mA").command_in("A"), Units(command="current").command_in("V")
        (0.001, None)
        """
        family = _ELECTRICAL[self.command]
        return family[self.command_unit] / family[unit] if {unit, self.command_unit} <= family.keys() else None

    def _known(self, column: str) -> dict[str, float]:
        """The units of a ``column`` and their factors to SI, or to the command unit of the axis."""
        if column == "time":
            return _TIMES
        if column == "supply":
            return _VOLTAGES
        if column == "command":
            family = _ELECTRICAL[self.command]
            if self.command_unit not in family:  # % of an unknown rated value
                return {self.command_unit: 1.0}
            return {name: factor / family[self.command_unit] for name, factor in family.items()}
        return _MECHANICAL[self.motion][column]


LINEAR = Units()  # a linear axis with a voltage command, the convention of the library


def check_command_unit(command: str, unit: str) -> str:
    """Return ``unit`` in the spelling of this package, or raise :class:`InputError` if it is no unit of ``command``.

    >>> check_command_unit("torque", "Nm"), check_command_unit("current", "% of rated")
    ('N m', '% of rated')
    >>> check_command_unit("current", "V")
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: command_unit: found 'V', a unit of voltage, expected one of current, such as A, or %
    """
    written = spelled(unit)
    if not written.isprintable() or len(written) > 20:
        raise InputError(f"command_unit: found {unit!r}, expected a unit of at most 20 characters on one line")
    if command == "duty":
        if written:
            raise InputError(f"command_unit: found {unit!r}, expected none: a duty is a ratio to the supply, at most 1")
        return written
    kinds = [kind for kind, known in _ELECTRICAL.items() if written in known and kind != "duty"]
    if not written or (kinds and command not in kinds):
        of = f", a unit of {kinds[0]}" if kinds else ""
        raise InputError(
            f"command_unit: found {unit!r}{of}, expected one of {command}, such as {COMMANDS[command]}, or %"
        )
    return written
