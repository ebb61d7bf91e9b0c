"""Sizes of numbers that a design can work with: beyond them squares overflow and every answer would be nonsense."""

from __future__ import annotations

from emps_design.axis import Axis
from emps_design.errors import InputError

SMALLEST, LARGEST = 1e-12, 1e12


def check_scale(name: str, value: float, unit: str) -> None:
    """Refuse a ``value`` that is neither 0 nor of a size between 1e-12 and 1e12 of its SI unit.

    >>> check_scale("mass", 95.1, "kg")
    >>> check_scale("mass", 1e300, "kg")
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: mass: found 1e+300 kg, expected a size between 1e-12 and 1e+12 kg
    """
    if value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
        raise InputError(f"{name}: found {value:g} {unit}, expected a size between {SMALLEST:g} and {LARGEST:g} {unit}")


def check_axis_scale(axis: Axis) -> None:
    """Refuse an ``axis`` with a number no machine has; :class:`InputError` names it.

    >>> from emps_design.machines import machine
    >>> check_axis_scale(machine("emps2018"))
    """
    for table in ("mechanics", "drive", "sampling"):
        part = getattr(axis, table)
        for name, field in type(part).model_fields.items():
            value = getattr(part, name)
            if isinstance(value, float):
                check_scale(f"{axis.name}: {table}.{name}", value, dict(field.json_schema_extra or {}).get("unit", ""))
