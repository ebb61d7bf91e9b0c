"""What is wrong with an axis, in one line and in the axis's own units."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from emps_design.axis.tables import field_in, fields_in
from emps_design.errors import nearest_name
from emps_design.laws import NONE, unit_of
from emps_design.laws.estimators import NAME, TABLE
from emps_design.laws.law import NUMBER, RECORDED
from emps_design.records.mapping import Column, ColumnMap
from emps_design.units import Units


def first_line(error: ValidationError, table: Any, tables: list[str]) -> str:
    """The first problem of a pydantic error in ``table`` as ``place: found ..., expected ...``; a wrong key first.

    ``tables`` are the keys that an axis file has.
    """
    units = Units.of(table) if isinstance(table, dict) else Units()
    controller = table.get("controller") if isinstance(table, dict) else None
    kind = str(controller.get("kind", NONE)) if isinstance(controller, dict) else NONE
    problems = error.errors(include_url=False)
    problem = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    path = [str(part) for part in problem["loc"] if part not in (NUMBER, RECORDED, NAME, TABLE)]
    if path[:1] == ["effects"]:  # an effect's table is flat in the file
        path = [part for part in path if part != "parameters"]
    if path == ["drive", "command_limit"] and "voltage_limit" in table["drive"]:
        path[-1] = "voltage_limit"
    place = ".".join(path) or "axis"
    if problem["type"] == "extra_forbidden":
        mapped = (ColumnMap if len(path) == 2 else Column).model_fields if path[0] == "record" else {}
        known = list(mapped or fields_in(".".join(path[:-1]), kind) or tables)
        return f"{place}: unknown key{nearest_name(path[-1], known)} (known: {', '.join(known)})"
    if problem["type"] == "value_error":
        text = problem["msg"].removeprefix("Value error, ").removeprefix("effects: ")
        if not path:  # the whole axis; the text has the place
            return text
        is_key = field_in([*path, *text.partition(":")[0].split(".")], kind) is not None
        return f"{place}{'.' if is_key else ': '}{text}"
    field = field_in(path, kind) if path else None
    unit = units.unit(unit_of(field))
    expected = _expected(problem["type"], problem.get("ctx", {}), problem["msg"], f" [{unit}]" if unit else "")
    if problem["type"] == "missing":
        if len(path) == 1:
            expected = f"a table [{place}]"
        elif field is not None:
            expected = f"a number{f' [{unit}]' if unit else ''}: {units.words(str(field.description))}"
        return f"{place}: missing, expected {expected}"
    found = repr(problem["input"])
    number = isinstance(problem["input"], int | float) and not isinstance(problem["input"], bool)
    found = found if len(found) <= 60 else f"{found[:57]}..."
    return f"{place}: found {found}{f' {unit}' if unit and number else ''}, expected {expected}"


def _expected(kind: str, context: dict[str, Any], message: str, unit: str) -> str:
    """What a field wants, in the words of an engineer rather than of the validator."""
    words = {
        "float_type": f"a number{unit}",
        "int_type": f"a whole number{unit}",
        "int_from_float": f"a whole number{unit}",
        "finite_number": f"a finite number{unit}",
        "string_type": "text in quotes",
        "missing": "text in quotes",
        "model_type": "a table",
        "dict_type": "a table",
        "tuple_type": "a list of tables",
    }
    bounds = {"greater_than": "greater than", "greater_than_equal": "of at least", "less_than_equal": "of at most"}
    if kind in bounds:
        return f"a number {bounds[kind]} {next(iter(context.values())):g}{unit}"
    if kind == "literal_error":
        return str(context["expected"])
    return words.get(kind, message)
