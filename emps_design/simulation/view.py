"""What the result of a scenario shows: its numbers, a line each, in readable units of the axis."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from emps_design.units import Units
from emps_design.view import Cell, Line, Table, View

# Keys of a document that have no line: they are in the title, said elsewhere, or for the JSON alone.
NO_LINE = (
    "run",
    "study",
    "law",
    "task",
    "units",
    "warnings",
    "scenario",
    "axis",
    "effort",
    "headline",
    "reason",
    "worst_loop",
)


def scenario_view(document: dict[str, Any], units: Units) -> View:
    """The headline of the ``document`` of a scenario, where it has one, and a table of its numbers.

    >>> breakaway = {"scenario": "breakaway", "axis": "joint", "forward": 0.0123, "units": {"forward": "N m"}}
    >>> scenario_view(breakaway, Units("rotary"))[0].rows
    [('forward', '0.0123', 'N m')]
    """
    headline = [Line(document["headline"])] if "headline" in document else []
    rows = list(_rows(document, document.get("units", {}), units))
    title = f"{document['scenario']}, axis {document['axis']}"
    return (*headline, Table(("quantity", "value", "unit"), rows, title))


def _rows(
    document: dict[str, Any], unit_of: dict[str, str], units: Units, inside: tuple[str, ...] = ()
) -> Iterator[tuple[str, Cell, str]]:
    """Name, value and unit of each number; ``unit_of`` has a unit by the name of a quantity, or of a group of them."""
    for key, value in document.items():
        path = (*inside, key)
        if key in NO_LINE:
            continue
        if isinstance(value, dict):
            yield from _rows(value, unit_of, units, path)
        elif value != []:
            base = next((unit_of[name] for name in path if name in unit_of), "")
            yield units.words(" ".join(path).replace("_", " ")), *_shown(value, base, units)


def _shown(value: Any, base: str, units: Units) -> tuple[Cell, str]:
    """``value`` [``base``] as a cell, and its unit."""
    if isinstance(value, float) and math.isfinite(value):
        unit, factor = units.display(value, base)
        return f"{factor * value:.6g}", unit
    if value is None or isinstance(value, float):
        return None, ""
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value), ""
