"""Physical quantities: name, symbol, SI unit and bounds; reading and rounding of numbers."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from emps_design.errors import InputError

# Smallest positive and largest magnitude by unit, decades beyond those of real machines: a number outside them has the
# wrong unit.
LIMITS: dict[str, tuple[float, float]] = {
    "kg": (1e-9, 1e7),
    "N": (1e-9, 1e8),
    "N/m": (1e-9, 1e12),
    "N/(m/s)": (1e-9, 1e9),
    "kg m^2": (1e-12, 1e7),
    "N m": (1e-12, 1e8),
    "N m/rad": (1e-12, 1e12),
    "N m/(rad/s)": (1e-12, 1e9),
    "rad": (1e-12, 1e6),
    "N/V": (1e-9, 1e8),
    "A/V": (1e-6, 1e6),
    "rad/m": (1e-6, 1e8),
    "N m/A": (1e-9, 1e6),
    "V": (1e-6, 1e10),
    "A": (1e-6, 1e10),
    "%": (1e-6, 1e10),
    "V/(m/s)": (1e-9, 1e12),
    "(m/s)/N": (1e-12, 1e6),
    "(rad/s)/(N m)": (1e-12, 1e6),
    "N/s": (1e-6, 1e9),
    "s": (1e-9, 1e5),
    "m": (1e-15, 1e5),
    "m/s": (1e-9, 1e4),
    "1/s": (1e-6, 1e9),
    "rad/s": (1e-6, 1e9),
    "Hz": (1e-6, 1e9),
    "": (0.0, 1e6),
}
ANY_OTHER = (1e-15, 1e15)
PEOPLE = ("Stribeck", "Maxwell")  # names that keep their capital inside a sentence


def check_magnitude(name: str, value: float, unit: str, positive: bool = False) -> float:
    """Return ``value`` [``unit``], or raise :class:`InputError` outside the magnitudes of :data:`LIMITS`.

    The lower limit applies to ``positive`` quantities only. Infinite values and NaN are not checked.

    >>> check_magnitude("mass", 95.1, "kg", positive=True)
    95.1
    >>> check_magnitude("mass", 1e308, "kg")
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: mass: found 1e+308 kg, expected a magnitude of at most 1e+07 kg; check its unit
    """
    smallest, largest = LIMITS.get(unit, ANY_OTHER)
    spelled = f" {unit}" if unit else ""
    if math.isfinite(value) and abs(value) > largest:
        expected = f"of at most {largest:g}{spelled}"
    elif positive and 0.0 < value < smallest:
        expected = f"of at least {smallest:g}{spelled}"
    else:
        return value
    raise InputError(f"{name}: found {value:g}{spelled}, expected a magnitude {expected}; check its unit")


@dataclass(frozen=True)
class Quantity:
    """Name, symbol (LaTeX without dollars), SI unit and closed bounds of a number.

    >>> mass = Quantity("mass", "M", "kg", lower=0.0, text="load-side equivalent mass")
    >>> mass.check(95.1)
    95.1
    """

    name: str
    symbol: str
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    text: str = ""

    def check(self, value: float) -> float:
        """Return ``value`` [``unit``] as a float, or raise :class:`InputError` outside the bounds or not finite."""
        number = float(value)
        if not math.isfinite(number) or not self.lower <= number <= self.upper:
            unit = f" {self.unit}" if self.unit else ""
            raise InputError(
                f"{self.name}: found {number:g}{unit}, expected a number in [{self.lower:g}, {self.upper:g}]{unit}"
            )
        return check_magnitude(self.name, number, self.unit)


# unit of a frequency -> rad/s
_FREQUENCIES = {"": 1.0, "rad/s": 1.0, "1/s": 1.0, "hz": 2.0 * math.pi, "khz": 2000.0 * math.pi}


def read_frequency(text: str | float, unit: str = "rad/s") -> float:
    """Return the frequency in ``text``, in ``unit`` ("rad/s" or "Hz"); a number without a unit is in ``unit``.

    Raises :class:`InputError` for any other text; the number itself is not checked.

    >>> round(read_frequency("30Hz"), 4), read_frequency("188.5"), read_frequency("188.5 rad/s")
    (188.4956, 188.5, 188.5)
    >>> round(read_frequency("377rad/s", "Hz"), 3)
    60.001
    """
    written = str(text).strip()
    match = re.fullmatch(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|nan))\s*([a-zA-Z/1]*)", written)
    written_unit = (match[2].lower() or unit.lower()) if match else "?"
    if match is None or written_unit not in _FREQUENCIES:
        raise InputError(f"frequency: found {written!r}, expected a number in {unit}, or one such as 30Hz")
    if written_unit == unit.lower():
        return float(match[1])
    return float(match[1]) * _FREQUENCIES[written_unit] / _FREQUENCIES[unit.lower()]


def read_ratio(text: str | float) -> float:
    """Return the positive ratio in ``text``: a plain number, or decibels such as 6dB.

    Raises :class:`InputError` for any other text.

    >>> read_ratio("2"), round(read_ratio("6dB"), 4)
    (2.0, 1.9953)
    """
    written = str(text).strip()
    match = re.fullmatch(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(db)?", written, re.IGNORECASE)
    value = float(match[1]) if match else 0.0
    if match and match[2]:
        value = 10.0 ** (min(value, 200.0) / 20.0)
    if value <= 0.0:
        raise InputError(f"ratio: found {written!r}, expected a positive number, or one such as 6dB")
    return check_magnitude("ratio", value, "")


# unit of the library -> (below this size, display unit, factor), smallest first
_SMALL = {
    "s": ((1e-4, "µs", 1e6), (1.0, "ms", 1e3)),
    "m": ((1e-7, "nm", 1e9), (1e-4, "µm", 1e6), (1.0, "mm", 1e3)),
    "m/s": ((1e-4, "µm/s", 1e6), (1.0, "mm/s", 1e3)),
    "V": ((1.0, "mV", 1e3),),
}


def display_unit(size: float, unit: str) -> tuple[str, float]:
    """Return the display unit for ``size`` [``unit``], and the factor to it.

    >>> display_unit(5e-8, "m"), display_unit(0.25, "m"), display_unit(12.0, "N")
    (('nm', 1000000000.0), ('mm', 1000.0), ('N', 1.0))
    """
    for limit, small, factor in _SMALL.get(unit, ()):
        if 0 < abs(size) < limit:
            return small, factor
    return unit, 1.0


def share_asked(share: float, std: float) -> str:
    """The share of an effect that a record asks for, to a hundredth; a deviation is shown as at least 0.01.

    >>> share_asked(0.974, 0.102), share_asked(1.003, 0.002)
    ('0.97 +- 0.10', '1.00 +- 0.01')
    """
    return f"{share:.2f} +- {max(std, 0.01):.2f}"


def rounded(value: float, places: int = 2) -> str:
    """``value`` with ``places`` decimals; a small value has ``places`` significant digits instead.

    >>> rounded(12.3456), rounded(0.4), rounded(0.00213), rounded(0.0)
    ('12.35', '0.40', '0.0021', '0.00')
    """
    small = 0.0 < abs(value) < 10.0 ** (1 - places)
    return f"{value:.{places}g}" if small else f"{value:.{places}f}"


def decimals(size: float) -> int:
    """Number of decimals for a value of about ``size``: 4, below 0.1 as many as give 4 significant digits.

    >>> decimals(96.2), decimals(0.5), decimals(0.00025), decimals(0.0)
    (4, 4, 7, 4)
    """
    return 4 if not 0.0 < abs(size) < 0.1 else 3 - math.floor(math.log10(abs(size)))


def one_two_five(ratio: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten.

    >>> [one_two_five(ratio) for ratio in (0.82, 1.5, 0.0101, 26.0)]
    [1.0, 2.0, 0.01, 20.0]
    """
    power = 10.0 ** math.floor(math.log10(ratio))
    nearest = min((1.0, 2.0, 5.0, 10.0), key=lambda digit: abs(math.log(ratio / power / digit)))
    return float(f"{nearest * power:.12g}")


def inside(label: str) -> str:
    """``label`` for use inside a sentence: in lower case, unless it begins with the name of a person.

    >>> inside("Position ripple"), inside("Stribeck friction"), inside("Back-EMF braking")
    ('position ripple', 'Stribeck friction', 'back-EMF braking')
    """
    return label if label.startswith(PEOPLE) else label[:1].lower() + label[1:]
