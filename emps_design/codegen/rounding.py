"""Running error of single precision: a kernel run on numbers that carry a bound of what their rounding has done.

A number has its ``value`` in double precision and a ``bound`` of the distance to what single precision makes of it.
Each operation adds half a unit in the last place of its own result (functions of ``math``: one whole). A comparison
that falls within the bounds may fall the other way in single precision: from there on nothing is bounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

HALF_UNIT = 2.0**-24  # relative, of one operation in single precision
TINY = 2.0**-149  # absolute, where a result underflows


class Rounded:
    """``value`` and the ``bound`` of its distance to single precision; ``doubts`` collects open comparisons.

    >>> x = Rounded(0.1, 1e-9, [])
    >>> (x - x).value, 2e-9 <= (x - x).bound < 2.1e-9
    (0.0, True)
    """

    __slots__ = ("bound", "doubts", "value")

    def __init__(self, value: float, bound: float, doubts: list[int]):
        self.value, self.bound, self.doubts = value, bound, doubts

    def _other(self, other: Any) -> Rounded:
        return other if isinstance(other, Rounded) else constant(float(other), self.doubts)

    def _made(self, value: float, bound: float, units: float = 1.0) -> Rounded:
        return Rounded(value, bound + units * HALF_UNIT * (abs(value) + bound) + TINY, self.doubts)

    def __add__(self, other: Any) -> Rounded:
        other = self._other(other)
        if (self.value == 0.0 and self.bound == 0.0) or (other.value == 0.0 and other.bound == 0.0):
            return Rounded(self.value + other.value, self.bound + other.bound, self.doubts)  # nothing is rounded
        made = self._made(self.value + other.value, self.bound + other.bound)
        if made.value == 0.0 and self.bound == 0.0 and other.bound == 0.0:
            return Rounded(0.0, 0.0, self.doubts)
        return made

    def __sub__(self, other: Any) -> Rounded:
        return self + (-self._other(other))

    def __rsub__(self, other: Any) -> Rounded:
        return self._other(other) + (-self)

    def __mul__(self, other: Any) -> Rounded:
        other = self._other(other)
        bound = abs(self.value) * other.bound + abs(other.value) * self.bound + self.bound * other.bound
        value = self.value * other.value
        if value == 0.0 and bound == 0.0:
            return Rounded(0.0, 0.0, self.doubts)
        return self._made(value, bound)

    def __truediv__(self, other: Any) -> Rounded:
        other = self._other(other)
        least = abs(other.value) - other.bound
        if not least > 0.0:
            return Rounded(self.value / other.value if other.value else math.nan, math.inf, self.doubts)
        value = self.value / other.value
        return self._made(value, (self.bound + abs(value) * other.bound) / least)

    def __rtruediv__(self, other: Any) -> Rounded:
        return self._other(other) / self

    def __pow__(self, exponent: Any) -> Rounded:
        if isinstance(exponent, int):
            result = self
            for _ in range(exponent - 1):
                result = result * self
            return result
        return power(self, exponent)

    def __rpow__(self, base: Any) -> Rounded:
        return power(self._other(base), self)

    def __neg__(self) -> Rounded:
        return Rounded(-self.value, self.bound, self.doubts)

    def __abs__(self) -> Rounded:
        return Rounded(abs(self.value), self.bound, self.doubts)

    def __float__(self) -> float:
        raise TypeError("a bound would be lost")

    def __int__(self) -> int:
        if int(self.value - self.bound) != int(self.value + self.bound):
            self.doubts.append(1)
        return int(self.value)

    def _apart(self, other: Any) -> float:
        """The difference of the values; a doubt where the bounds leave its sign open."""
        other = self._other(other)
        difference, bound = self.value - other.value, self.bound + other.bound
        if bound > 0.0 and abs(difference) <= bound:
            self.doubts.append(1)
        return difference

    def __lt__(self, other: Any) -> bool:
        return self._apart(other) < 0.0

    def __le__(self, other: Any) -> bool:
        return self._apart(other) <= 0.0

    def __gt__(self, other: Any) -> bool:
        return self._apart(other) > 0.0

    def __ge__(self, other: Any) -> bool:
        return self._apart(other) >= 0.0

    def __eq__(self, other: object) -> bool:
        return self._apart(other) == 0.0

    def __ne__(self, other: object) -> bool:
        return self._apart(other) != 0.0

    __hash__ = None  # type: ignore[assignment]
    __radd__, __rmul__ = __add__, __mul__


def constant(value: float, doubts: list[int]) -> Rounded:
    """A constant of the program, rounded once."""
    with np.errstate(over="ignore"):
        return Rounded(value, abs(float(np.float32(value)) - value), doubts)


def power(base: Rounded, exponent: Any) -> Rounded:
    """``base ** exponent`` by the slopes at its edges; unbounded where the base may be negative."""
    exponent = base._other(exponent)
    low, high = base.value - base.bound, base.value + base.bound
    if base.value == 0.0 and base.bound == 0.0:
        return Rounded(base.value**exponent.value, 0.0, base.doubts)
    if not low > 0.0:
        return Rounded(base.value**exponent.value if base.value > 0.0 else math.nan, math.inf, base.doubts)
    ends = [x ** (exponent.value + d) for x in (low, high) for d in (-exponent.bound, exponent.bound)]
    value = base.value**exponent.value
    return base._made(value, max(abs(end - value) for end in ends), units=2.0)


def _by_slope(function: Callable[[float], float], slope: Callable[[float, float], float]) -> Callable[[Any], Any]:
    """``function`` of a rounded number, ``slope`` the largest over an interval."""

    def applied(x: Any) -> Any:
        if not isinstance(x, Rounded):
            return function(x)
        bound = x.bound * slope(x.value - x.bound, x.value + x.bound) if x.bound else 0.0
        return x._made(function(x.value), bound, units=2.0)

    return applied


def _root_slope(low: float, high: float) -> float:
    return 0.5 / math.sqrt(low) if low > 0.0 else math.inf


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": _by_slope(math.sin, lambda low, high: 1.0),
    "cos": _by_slope(math.cos, lambda low, high: 1.0),
    "exp": _by_slope(math.exp, lambda low, high: math.exp(high)),
    "sqrt": _by_slope(math.sqrt, _root_slope),
    "atan": _by_slope(math.atan, lambda low, high: 1.0),
    "log": _by_slope(math.log, lambda low, high: 1.0 / low if low > 0.0 else math.inf),
    "fabs": abs,
    "pow": lambda base, exponent: base**exponent,
}


def smallest(*numbers: Any) -> Any:
    """``min`` of rounded numbers, whose bound holds whichever of them is taken."""
    return _extreme(min, numbers)


def largest(*numbers: Any) -> Any:
    """``max`` of rounded numbers."""
    return _extreme(max, numbers)


def _extreme(choose: Callable[..., Any], numbers: tuple[Any, ...]) -> Any:
    kept = next((one for one in numbers if isinstance(one, Rounded)), None)
    if kept is None:
        return choose(numbers)
    sides = [kept._other(one) for one in numbers]
    value = choose(side.value for side in sides)
    low, high = choose(side.value - side.bound for side in sides), choose(side.value + side.bound for side in sides)
    return Rounded(value, max(value - low, high - value), kept.doubts)


def on_rounded(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function`` with the functions it uses, its file's own and those of ``math``, able to take rounded numbers."""
    assert isinstance(function, FunctionType)
    space = {**function.__globals__, "min": smallest, "max": largest}
    for name in function.__code__.co_names:
        found = function.__globals__.get(name)
        if isinstance(found, ModuleType) and found is math:
            space[name] = SimpleNamespace(**{**vars(math), **FUNCTIONS})
        elif isinstance(found, FunctionType):
            space[name] = on_rounded(found)
        elif getattr(found, "__module__", "") == "math" and getattr(found, "__name__", "") in FUNCTIONS:
            space[name] = FUNCTIONS[found.__name__]
    return FunctionType(function.__code__, space, function.__name__, function.__defaults__, function.__closure__)
