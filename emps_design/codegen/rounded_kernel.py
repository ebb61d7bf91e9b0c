"""Kernels on rounded numbers: functions of ``math``, ``min`` and ``max`` that know what rounding does to them."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from emps_design.codegen.rounding import Rounded


def _by_slope(
    function: Callable[[float], float], slope: Callable[[float, float], float], range_: float = math.inf
) -> Callable[[Any], Any]:
    """``function`` of a rounded number, ``slope`` the largest over an interval, ``range_`` from least to largest."""

    def applied(x: Any) -> Any:
        if not isinstance(x, Rounded):
            return function(x)
        more = min(x.bound * slope(x.value - x.bound, x.value + x.bound), range_) if x.bound else 0.0
        if not more < math.inf:
            x.roundings.open, more = True, 0.0
        return x._made(function(x.value), np.zeros(0), more, units=2.0)

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
    """``min`` of rounded numbers, right whichever of them single precision takes."""
    return _extreme(min, numbers)


def largest(*numbers: Any) -> Any:
    """``max`` of rounded numbers."""
    return _extreme(max, numbers)


def _extreme(choose: Callable[..., Any], numbers: tuple[Any, ...]) -> Any:
    kept = next((one for one in numbers if isinstance(one, Rounded)), None)
    if kept is None:
        return choose(numbers)
    sides = [kept.other(one) for one in numbers]
    taken = choose(sides, key=lambda side: side.value)
    if all(abs(side.value - taken.value) > side.bound + taken.bound for side in sides if side is not taken):
        return taken
    low, high = choose(side.value - side.bound for side in sides), choose(side.value + side.bound for side in sides)
    return kept.roundings.within(taken.value, max(taken.value - low, high - taken.value))


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
        elif getattr(found, "__module__", "") == "math":
            space[name] = FUNCTIONS[getattr(found, "__name__", "")]
    return FunctionType(function.__code__, space, function.__name__, function.__defaults__, function.__closure__)
