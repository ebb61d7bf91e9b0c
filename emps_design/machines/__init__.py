"""Embedded machines: one TOML file each, which names the source of its numbers."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

from emps_design.axis import Axis
from emps_design.errors import AxisError, nearest_name


def machine_names() -> tuple[str, ...]:
    """Names of the embedded machines."""
    return tuple(sorted(p.name.removesuffix(".toml") for p in files(__package__).iterdir() if p.name.endswith(".toml")))


def machine(name: str) -> Axis:
    """Return the embedded machine called ``name``.

    >>> machine("emps2018").mechanics.viscous
    474.9727
    """
    if name not in machine_names():
        raise AxisError(
            f"axis: found {name!r}, expected a TOML file or one of {', '.join(machine_names())}"
            f"{nearest_name(name, machine_names())}"
        )
    return Axis.from_toml((files(__package__) / f"{name}.toml").read_text(encoding="utf-8"), name)


def load_axis(name_or_path: str | Path) -> Axis:
    """Return an embedded machine by name, or the axis of a TOML file."""
    name = str(name_or_path)
    if name in machine_names() or (re.fullmatch(r"[\w-]{1,100}", name) and not Path(name).exists()):
        return machine(name)
    return Axis.load(name)
