"""Is what was identified possible, is it like the axis, and if not, what probably happened."""

from __future__ import annotations

import math
from collections.abc import Mapping

from emps_design.axis import Axis

FAR = {"mass": 3.0, "viscous": 10.0, "coulomb": 10.0}  # times the axis's value, or a part of it
POWER = 0.15  # decades by which a power of ten may be missed
# What a wrong unit of a column does to mass, viscous and Coulomb friction, in powers of its factor.
UNITS = {
    "u (or the force gain)": (1, 1, 1),
    "q (and q_ref)": (-1, -1, 0),
    "t": (2, 1, 0),
}
SOUGHT = tuple(FAR)


def implausible(values: Mapping[str, float], axis: Axis) -> list[str]:
    """One line for what cannot be, or is far from ``axis``, and what it looks like; nothing for a plausible result.

    ``values`` are identified parameters by name, SI; of two directions the mean counts.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019")
    >>> implausible({"mass": 95.0, "viscous": 200.0, "coulomb": 20.0}, axis)
    []
    >>> implausible({"mass": -95.0, "viscous": -200.0, "coulomb": -20.0}, axis)[0].split(": ")[0]
    'no axis has mass -95 kg, viscous friction -200 N/(m/s), Coulomb friction -20 N'
    >>> implausible({"mass": 0.095, "viscous": 0.2, "coulomb": 20.0}, axis)[0].split("; ")[1]
    'this is what q (and q_ref) in another unit gives, 1000 times too large: look at the unit of that column'
    """
    found = {name: value for name in SOUGHT if (value := _mean(values, name)) is not None}
    negative = [name for name, value in found.items() if value < 0]
    if negative:
        return [f"no axis has {_listed(found, negative)}: {_why_negative(found, negative)}"]
    own = {name: float(getattr(axis.mechanics, name)) for name in found}
    shares = {name: value / own[name] for name, value in found.items() if own[name] > 0 and value > 0}
    far = [name for name, share in shares.items() if not 1.0 / FAR[name] < share < FAR[name]]
    if not far:
        return []
    beside = ", ".join(f"{_one(name, found[name])} where {axis.name} says {own[name]:.4g}" for name in far)
    unit = _unit(shares)
    if unit is None:
        why = "another machine or payload, a wrong force gain, or a wrong unit: look at force_gain and the columns"
    else:
        column, factor = unit
        size = f"{factor:g} times too large" if factor > 1 else f"{1 / factor:g} times too small"
        why = f"this is what {column} in another unit gives, {size}: look at the unit of that column"
    return [f"far from the axis: {beside}; {why}"]


def _mean(values: Mapping[str, float], name: str) -> float | None:
    own = [values[key] for key in (name, f"{name}_positive", f"{name}_negative") if key in values]
    own = [value for value in own if math.isfinite(value)]
    return sum(own) / len(own) if own else None


def _why_negative(found: Mapping[str, float], negative: list[str]) -> str:
    if "mass" in negative and all(found[name] < 0 for name in found):
        return "the sign of u is probably flipped against q; turn one of the two columns round"
    if "mass" in negative:
        return "u and q probably do not belong together: look at the sign of u, the columns and their clock"
    return "the record hardly determines it, or friction falls with speed: diagnose says more"


def _unit(shares: Mapping[str, float]) -> tuple[str, float] | None:
    """The column, and the factor by which it is too large, that explains ``shares`` of the axis's values."""
    if len(shares) < len(SOUGHT):
        return None
    decades = [math.log10(shares[name]) for name in SOUGHT]
    for column, powers in UNITS.items():
        exponent = round(sum(d * p for d, p in zip(decades, powers, strict=True)) / sum(p * p for p in powers))
        misses = [abs(d - p * exponent) for d, p in zip(decades, powers, strict=True)]
        # Friction may differ a little from what the file says; the mass may not.
        if exponent and misses[0] < POWER and max(misses) < 2 * POWER:
            return column, 10.0**exponent
    return None


def _listed(found: Mapping[str, float], names: list[str]) -> str:
    return ", ".join(_one(name, found[name]) for name in names)


def _one(name: str, value: float) -> str:
    word = {"mass": "mass", "viscous": "viscous friction", "coulomb": "Coulomb friction"}[name]
    unit = {"mass": "kg", "viscous": "N/(m/s)", "coulomb": "N"}[name]
    return f"{word} {value:.4g} {unit}"
