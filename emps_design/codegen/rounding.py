"""Rounding of single precision: a kernel run on numbers that carry a bound of their rounding error.

A number has its ``value`` in double precision and, for each rounding so far, the share of that rounding in its distance
from the number of single precision; the sum of their sizes bounds the distance. Each operation adds half a unit in the
last place of its result (functions of ``math``: a whole one), terms of second order included. A comparison within the
bounds may fall the other way in single precision: :func:`every_way` follows both. :func:`on_rounded` gives a kernel the
functions of ``math``, ``min`` and ``max`` for such numbers.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

HALF_UNIT = 2.0**-24  # relative, of one operation in single precision
TINY = 2.0**-149  # absolute, where a result underflows
LARGEST = 2.0**127  # below the overflow of single precision
MOST_WAYS = 64  # through one step
NONE = np.zeros(0)  # shares of an exact number


@dataclass
class Roundings:
    """Roundings so far: their ``count``, whether there is no bound (``open``), and the ways ``taken`` at comparisons.

    ``taken`` has one entry for each comparison that single precision may decide otherwise: index and number of ways.
    """

    count: int = 0
    open: bool = False
    taken: list[tuple[int, int]] = field(default_factory=list)
    place: int = 0

    def either(self, *ways: Any) -> Any:
        """The one of ``ways`` for this run; in the first run the one of double precision, which stands first."""
        if self.place == len(self.taken):
            self.taken.append((0, len(ways)))
        self.place += 1
        return ways[self.taken[self.place - 1][0]]

    def advance(self) -> bool:
        """Prepare the next run with another combination of ways; False where there is none left."""
        self.place = 0
        while self.taken:
            way, ways = self.taken.pop()
            if way + 1 < ways:
                self.taken.append((way + 1, ways))
                return True
        return False

    def exact(self, value: float) -> Rounded:
        """A number that is exact in single precision."""
        return Rounded(value, NONE, self, 0.0)

    def constant(self, value: float) -> Rounded:
        """A constant of the program, rounded once.

        >>> Roundings().constant(0.1).bound == abs(float(np.float32(0.1)) - 0.1)
        True
        """
        return self.within(value, _rounding_error(value))

    def within(self, value: float, own: float) -> Rounded:
        """A number whose value in single precision is at most ``own`` away, by an independent rounding."""
        return self.rounded(value, NONE, 0.0, own)

    def rounded(self, value: float, shares: np.ndarray, bound: float, own: float) -> Rounded:
        """A number with ``shares`` of the roundings before, ``bound`` in all, and one more of size ``own``."""
        if own == 0.0:
            return Rounded(value, shares, self, bound)
        self.count += 1
        more = np.zeros(self.count)
        more[: shares.size] = shares
        more[-1] = own
        return Rounded(value, more, self, bound + own)


@lru_cache(maxsize=10_000)
def _rounding_error(value: float) -> float:
    """Rounding error of a constant of the program."""
    with np.errstate(over="ignore"):
        return abs(float(np.float32(value)) - value)


class Rounded:
    """A ``value`` with its ``shares`` (r,) of the roundings before, whose sizes sum up to ``bound``.

    >>> x = Roundings().constant(0.1)
    >>> (x + x).bound > x.bound > (x - x).bound == 0.0
    True
    """

    __slots__ = ("bound", "positive", "roundings", "shares", "value")

    def __init__(self, value: float, shares: np.ndarray, roundings: Roundings, bound: float):
        self.value, self.shares, self.roundings, self.bound = value, shares, roundings, bound
        self.positive = value >= bound  # or 0, in single precision too

    def other(self, number: Any) -> Rounded:
        """``number`` as a rounded number of the same run."""
        return number if isinstance(number, Rounded) else self.roundings.constant(float(number))

    def _result(self, value: float, shares: np.ndarray, more: float = 0.0, units: float = 1.0) -> Rounded:
        before = _size(shares)
        bound = before + more
        if not abs(value) + bound < LARGEST:
            self.roundings.open = True
        if value == 0.0 and bound == 0.0:
            return self.roundings.exact(value)
        return self.roundings.rounded(value, shares, before, more + units * HALF_UNIT * (abs(value) + bound) + TINY)

    def __add__(self, other: Any) -> Rounded:
        other = self.other(other)
        shares = _sum(self.shares, other.shares)
        if 0.0 in (self.value, other.value) and 0.0 in (self.bound, other.bound):
            return Rounded(self.value + other.value, shares, self.roundings, _size(shares))  # nothing is rounded
        return self._result(self.value + other.value, shares)

    def __sub__(self, other: Any) -> Rounded:
        return self + (-self.other(other))

    def __rsub__(self, other: Any) -> Rounded:
        return self.other(other) + (-self)

    def __mul__(self, other: Any) -> Rounded:
        other = self.other(other)
        shares = _sum(other.value * self.shares, self.value * other.shares)
        made = self._result(self.value * other.value, shares, self.bound * other.bound)
        made.positive |= self.positive and other.positive
        return made

    def __truediv__(self, other: Any) -> Rounded:
        other = self.other(other)
        least = abs(other.value) - other.bound
        if not least > 0.0:
            self.roundings.open = True
            return self.roundings.exact(self.value / other.value if other.value else math.nan)
        value = self.value / other.value
        shares = _sum(self.shares / other.value, -value / other.value * other.shares)
        made = self._result(value, shares, _size(shares) * other.bound / least)
        made.positive |= self.positive and other.positive
        return made

    def __rtruediv__(self, other: Any) -> Rounded:
        return self.other(other) / self

    def __pow__(self, exponent: Any) -> Rounded:
        if isinstance(exponent, int):
            return math.prod([self] * (exponent - 1), start=self)
        return power(self, self.other(exponent))

    def __rpow__(self, base: Any) -> Rounded:
        return power(self.other(base), self)

    def __neg__(self) -> Rounded:
        return Rounded(-self.value, -self.shares, self.roundings, self.bound)

    def __abs__(self) -> Rounded:
        if abs(self.value) >= self.bound:
            return -self if self.value < 0.0 else self
        made = self.roundings.within(abs(self.value), self.bound)
        made.positive = True
        return made

    def __float__(self) -> float:
        raise TypeError("a bound would be lost")

    def __int__(self) -> int:
        low, value, high = (int(edge) for edge in (self.value - self.bound, self.value, self.value + self.bound))
        if high - low > 1:
            self.roundings.open = True
        return value if low == high else self.roundings.either(value, low + high - value)

    def compared(self, other: Any, holds: Callable[[float, float], bool]) -> bool:
        """Whether the difference ``holds`` against 0: either way where the roundings may turn its sign."""
        other = self.other(other)
        difference, bound = self.value - other.value, _size(_sum(self.shares, -other.shares))
        nominal = holds(difference, 0.0)
        return self.roundings.either(nominal, not nominal) if bound > 0.0 and abs(difference) <= bound else nominal

    def __lt__(self, other: Any) -> bool:
        return self.compared(other, operator.lt)

    def __le__(self, other: Any) -> bool:
        return self.compared(other, operator.le)

    def __gt__(self, other: Any) -> bool:
        return self.compared(other, operator.gt)

    def __ge__(self, other: Any) -> bool:
        return self.compared(other, operator.ge)

    def __eq__(self, other: object) -> bool:
        return self.compared(other, operator.eq)

    def __ne__(self, other: object) -> bool:
        return self.compared(other, operator.ne)

    __hash__ = None  # type: ignore[assignment]
    __radd__, __rmul__ = __add__, __mul__


def _size(shares: np.ndarray) -> float:
    return float(np.add.reduce(np.abs(shares)))


def _sum(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    longer, shorter = (first, second) if first.size >= second.size else (second, first)
    total = longer.copy()
    total[: shorter.size] += shorter
    return total


def power(base: Rounded, exponent: Rounded) -> Rounded:
    """``base ** exponent``, bounded by its values at the ends of the intervals; open where the base may be negative."""
    low, high = base.value - base.bound, base.value + base.bound
    if base.value == 0.0 and base.bound == 0.0:
        return base.roundings.exact(base.value**exponent.value)
    if not low > 0.0 and not (base.positive and exponent.value > exponent.bound):
        base.roundings.open = True
        return base.roundings.exact(max(base.value, 0.0) ** exponent.value if exponent.value > 0.0 else math.nan)
    value = base.value**exponent.value
    ends = [max(x, 0.0) ** (exponent.value + d) for x in (low, high) for d in (-exponent.bound, exponent.bound)]
    return base._result(value, NONE, max(abs(end - value) for end in ends), units=2.0)


def every_way(run: Callable[[], Sequence[Any]], now: Roundings) -> tuple[list[Rounded], bool]:
    """Numbers that ``run`` returns on the way of double precision, and whether single precision may take another.

    A share of its own bounds the distance of each number to those of all other ways. The ways share the roundings
    before; those within a way belong to it alone.
    """
    before, more, now.taken, now.place = now.count, dict[int, float](), [], 0
    first = [number if isinstance(number, Rounded) else now.constant(float(number)) for number in run()]
    after, several = now.count, bool(now.taken)
    for _ in range(MOST_WAYS):
        if now.open or not now.advance():
            break
        now.count = before
        try:
            others = [first[0].other(number) for number in run()]
        except IndexError:
            continue  # an impossible way: no kernel reads beyond its arrays
        except (ArithmeticError, ValueError):
            now.open = True  # undefined on a way that double precision does not take
            break
        for i, (number, other) in enumerate(zip(first, others, strict=True)):
            apart = _sum(other.shares[:before], -number.shares[:before])
            own = abs(other.value - number.value) + _size(apart) + _size(other.shares[before:])
            more[i] = max(more.get(i, 0.0), own)
    else:
        now.open = True
    now.count = after
    return [
        now.rounded(number.value, number.shares, number.bound, more.get(i, 0.0)) for i, number in enumerate(first)
    ], several


def _by_slope(
    function: Callable[[float], float], slope: Callable[[float, float], float], range_: float = math.inf
) -> Callable[[Any], Any]:
    """``function`` of a rounded number, ``slope`` its largest slope over an interval, ``range_`` its total range."""

    def applied(x: Any) -> Any:
        if not isinstance(x, Rounded):
            return function(x)
        more = min(x.bound * slope(x.value - x.bound, x.value + x.bound), range_) if x.bound else 0.0
        if not more < math.inf:
            x.roundings.open, more = True, 0.0
        return x._result(function(x.value), np.zeros(0), more, units=2.0)

    return applied


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": _by_slope(math.sin, lambda low, high: 1.0, 2.0),
    "cos": _by_slope(math.cos, lambda low, high: 1.0, 2.0),
    "exp": _by_slope(math.exp, lambda low, high: math.exp(high)),
    "sqrt": _by_slope(math.sqrt, lambda low, high: 0.5 / math.sqrt(low) if low > 0.0 else math.inf),
    "atan": _by_slope(math.atan, lambda low, high: 1.0, math.pi),
    "log": _by_slope(math.log, lambda low, high: 1.0 / low if low > 0.0 else math.inf),
    "fabs": abs,
    "pow": lambda base, exponent: base ** float(exponent) if isinstance(exponent, int) else base**exponent,
}


def smallest(*numbers: Any) -> Any:
    """``min`` of rounded numbers, with a bound for whichever of them single precision takes."""
    return _extreme(min, numbers)


def largest(*numbers: Any) -> Any:
    """``max`` of rounded numbers."""
    return _extreme(max, numbers)


def _extreme(choose: Callable[..., Any], numbers: tuple[Any, ...]) -> Any:
    kept = next((number for number in numbers if isinstance(number, Rounded)), None)
    if kept is None:
        return choose(numbers)
    sides = [kept.other(number) for number in numbers]
    taken = choose(sides, key=lambda side: side.value)
    if all(abs(side.value - taken.value) > side.bound + taken.bound for side in sides if side is not taken):
        return taken
    low, high = choose(side.value - side.bound for side in sides), choose(side.value + side.bound for side in sides)
    return kept.roundings.within(taken.value, max(taken.value - low, high - taken.value))


def on_rounded(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function`` for rounded numbers, with the functions of its file and of ``math`` that it calls."""
    assert isinstance(function, FunctionType)
    space = {**function.__globals__, "min": smallest, "max": largest}
    for name in function.__code__.co_names:
        referent = function.__globals__.get(name)
        if isinstance(referent, ModuleType) and referent is math:
            space[name] = SimpleNamespace(**{**vars(math), **FUNCTIONS})
        elif isinstance(referent, FunctionType):
            space[name] = on_rounded(referent)
        elif getattr(referent, "__module__", "") == "math":
            space[name] = FUNCTIONS[getattr(referent, "__name__", "")]
    return FunctionType(function.__code__, space, function.__name__, function.__defaults__, function.__closure__)
