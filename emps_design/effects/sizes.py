"""Starting values and bounds of an effect, scaled to an axis: those of the library hold for an ordinary linear axis.

A backlash of 0.1 mm is plausible on a stroke of 0.25 m, one of 1 mrad on an axis that turns by 2 rad. So every starting
value and bound with a length, a speed, a force or a command in its unit is scaled by the ratio of the sizes of both
axes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from emps_design.effects.effect import Effect, Parameter

# The ordinary axis of the library, by unit: stroke, top speed, largest motor force and command.
ORDINARY = {"m": 0.25, "m/s": 0.15, "N": 200.0, "V": 5.0}
ALIKE = 3.0  # up to this ratio an axis counts as an ordinary one
TURN = 2.0 * np.pi  # rad (or m), longest stroke that counts: a shaft repeats itself after one turn


def sizes(q: np.ndarray, u: np.ndarray, period: float, force_gain: float) -> dict[str, float]:
    """Size of an axis relative to the ordinary one, by unit, from ``q`` (n,) [m] and ``u`` (n,) [V] of a record.

    1 if it is similar. The speed is a mean over 1 % of the record, because of the resolution of the encoder.

    >>> t = np.arange(0.0, 10.0, 1e-3)
    >>> sizes(0.125 * np.sin(t), 5.0 * np.cos(t), 1e-3, 40.0)
    {'m': 1.0, 'm/s': 1.0, 'N': 1.0, 'V': 1.0}
    """
    most = float(np.abs(u).max(initial=0.0))
    return {
        "m": stroke_size(q),
        "m/s": speed_size(np.diff(q) / period),
        "N": _relative_size(most * force_gain, "N"),
        "V": _relative_size(most, "V"),
    }


def stroke_size(q: np.ndarray) -> float:
    """Stroke of ``q`` (n,) [m or rad] relative to the ordinary one, 1 if it is similar.

    >>> stroke_size(np.array([0.0, 0.24])), stroke_size(np.array([-1.0, 1.0])), stroke_size(np.array([0.0, 200.0]))
    (1.0, 8.0, 25.132741228718345)
    """
    return _relative_size(min(float(np.ptp(q)), TURN), "m")


def speed_size(v: np.ndarray) -> float:
    """Speed of the axis with velocities ``v`` (n,) [m/s or rad/s] over that of an ordinary axis; 1 where similar.

    >>> t = np.arange(0.0, 10.0, 1e-3)
    >>> speed_size(0.1 * np.sin(t)), round(speed_size(75.0 * np.sin(t)))
    (1.0, 500)
    """
    span, path = max(1, v.size // 100), np.cumsum(v)
    return _relative_size(float(np.abs(path[span:] - path[:-span]).max(initial=0.0)) / span, "m/s")


def _relative_size(size: float, unit: str) -> float:
    ratio = size / ORDINARY[unit]
    return ratio if ratio > 0.0 and not 1 / ALIKE <= ratio <= ALIKE else 1.0


def sized(effect: Effect, factors: Mapping[str, float]) -> Effect:
    """The ``effect`` with starts, bounds and typical sizes of its parameters scaled by the ``factors`` of their units.

    >>> from emps_design.effects import get_effect
    >>> small = get_effect("backlash")
    >>> large = sized(small, {"m": 10.0, "N": 1.0, "m/s": 1.0, "V": 1.0})
    >>> small.parameters[0].starts, large.parameters[0].starts, large.parameters[1] == small.parameters[1]
    ((5e-05, 0.0001, 0.0002), (0.0005, 0.001, 0.002), True)
    """
    if all(factor == 1.0 for factor in factors.values()):
        return effect
    return replace(effect, parameters=tuple(sized_parameter(parameter, factors) for parameter in effect.parameters))


def sized_parameter(parameter: Parameter, factors: Mapping[str, float]) -> Parameter:
    """The ``parameter`` with starts, bounds and typical size scaled by the factor of its unit."""
    factor = _factor(parameter.unit, factors)
    if factor == 1.0 or parameter.discrete:
        return parameter
    return replace(
        parameter,
        lower=factor * parameter.lower,
        upper=factor * parameter.upper,
        starts=tuple(factor * start for start in parameter.starts),
        scale=factor * parameter.scale,
    )


def _factor(unit: str, factors: Mapping[str, float]) -> float:
    """The factor of a unit such as N/m or N/(m/s): that of the numerator over that of the denominator.

    >>> _factor("N/(m/s)", {"N": 6.0, "m/s": 2.0, "m": 5.0}), _factor("Hz", {"N": 6.0})
    (3.0, 1.0)
    """
    if unit in factors:
        return factors[unit]
    above, _, below = unit.partition("/")
    below = re.sub(r"[()]", "", below)
    return factors.get(above, 1.0) / factors.get(below, 1.0)
