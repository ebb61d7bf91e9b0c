"""The axis: the description of one machine, as a TOML file and as a Python object.

Its tables are mechanics, drive, sampling, controller, record and effects. An error in an axis file is reported in one
line, in the units of the axis.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from emps_design.errors import AxisError, InputError, nearest_name, one_line
from emps_design.files import read_bytes
from emps_design.laws import NONE, Controller, field_at, fields_of, fields_within, leaves
from emps_design.laws.estimators import NAME, TABLE
from emps_design.laws.law import NUMBER, RECORDED
from emps_design.records import Record
from emps_design.records.layout import Column, ColumnMap
from emps_design.tables import (
    BASELINE as BASELINE,
    FACTORS,
    NO_LIMIT as NO_LIMIT,
    AxisEffect,
    AxisTable,
    Drive,
    Mechanics,
    Sampling,
    unit_of,
)
from emps_design.units import Units
from emps_design.view import Table, View, Viewed

MAX_BYTES = 1_000_000  # of an axis file
NEW_LINE = "\n"
LIMIT = {"voltage_limit", "command_limit"}  # two keys for the same number of a drive

TABLES: dict[str, type[AxisTable]] = {
    "mechanics": Mechanics,
    "drive": Drive,
    "sampling": Sampling,
    "controller": Controller,
}


def fields_in(table: str, kind: str = NONE) -> dict[str, FieldInfo]:
    """The fields of a ``table`` of the axis file by key; ``kind`` is that of the controller. Empty if unknown.

    >>> list(fields_in("controller.velocity", "cascade"))
    ['kp', 'ti', 'form']
    """
    table, *path = table.split(".")
    if table == "controller":
        if path:
            return fields_within(field_at(kind, path))
        return {"kind": Controller.model_fields["kind"], **fields_of(kind)}
    fields = TABLES[table].model_fields if table in TABLES and not path else {}
    return {**fields, "voltage_limit": fields["command_limit"]} if table == "drive" and fields else dict(fields)


def field_in(path: Sequence[str], kind: str = NONE) -> FieldInfo | None:
    """The field at a ``path`` of keys, which begins with its table; None for an unknown key."""
    *table, key = path
    return fields_in(".".join(table), kind).get(key)


def first_line(error: ValidationError, table: Any, tables: list[str]) -> str:
    """The first problem of a pydantic error in ``table`` as ``place: found ..., expected ...``, unknown keys first.

    ``tables`` are the top-level keys of an axis file.
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
        of_record = (ColumnMap if len(path) == 2 else Column).model_fields if path[0] == "record" else {}
        known = list(of_record or fields_in(".".join(path[:-1]), kind) or tables)
        return f"{place}: unknown key{nearest_name(path[-1], known)} (known: {', '.join(known)})"
    if problem["type"] == "value_error":
        text = problem["msg"].removeprefix("Value error, ").removeprefix("effects: ")
        if not path:  # an error of the whole axis names its place itself
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
    shown = repr(problem["input"])
    number = isinstance(problem["input"], int | float) and not isinstance(problem["input"], bool)
    shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
    return f"{place}: found {shown}{f' {unit}' if unit and number else ''}, expected {expected}"


def _expected(kind: str, context: dict[str, Any], message: str, unit: str) -> str:
    """The expected value of a field, in an engineer's words rather than pydantic's."""
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


def _printable(name: str) -> str:
    """Return ``name``, or raise ValueError for control characters, since names are printed on terminals and pages."""
    if not name.isprintable():
        raise ValueError(f"found {one_line(name)!r}, expected text on one line without control characters")
    return name


class Axis(Viewed, AxisTable):
    """The description of one machine; see the module's opening for its tables.

    >>> axis = Axis(name="small", mechanics={"mass": 10, "viscous": 20, "coulomb": 1}, drive={"force_gain": 5},
    ...             sampling={"period": 1e-3})
    >>> axis.mechanics.mass, axis.drive.command_limit, axis.units.unit("kg")
    (10.0, 10.0, 'kg')
    >>> Axis.from_toml(axis.to_toml()) == axis
    True
    """

    name: Annotated[str, AfterValidator(_printable)] = "axis"
    motion: Literal["linear", "rotary"] = Field(
        "linear", description="rotary: an inertia for the mass, a torque for a force, an angle for a position"
    )
    mechanics: Mechanics
    drive: Drive
    sampling: Sampling
    controller: Controller = Field(default_factory=lambda: Controller.model_validate({}))
    record: ColumnMap = Field(default_factory=ColumnMap)
    effects: tuple[AxisEffect, ...] = ()

    @model_validator(mode="after")
    def _check_physics(self) -> Axis:
        """Raise ValueError for impossible numbers and effects, in the units of the axis."""
        for name in TABLES:
            for path, value in leaves(getattr(self, name).model_dump(exclude_none=True), (name,)):
                field = field_in(path, self.controller.kind) if isinstance(value, float) else None
                if field is not None:
                    # pydantic nests the bound where None is allowed
                    positive = "gt=0" in repr((field.annotation, field.metadata))
                    self.units.check(".".join(path), value, unit_of(field), positive)
        for place, effect in enumerate(self.effects):
            if not effect.effect.acts_on(self.motion):
                raise ValueError(
                    f"effects.{place}.kind: found {effect.kind!r} on a {self.motion} axis, expected an effect of "
                    f"such an axis; {effect.kind} needs motion = {effect.effect.motion!r}"
                )
        drive = self.drive
        if drive.current_gain and drive.reduction and drive.torque_constant:
            product = drive.current_gain * drive.reduction * drive.torque_constant
            if abs(drive.force_gain - product) > 1e-6 * abs(product):
                unit = self.units.unit("N/V")
                raise ValueError(
                    f"drive: force_gain {drive.force_gain:g} {unit} is not current_gain x reduction x torque_constant "
                    f"= {product:g} {unit}"
                )
        return self

    @property
    def damping(self) -> float:
        """Viscous friction plus braking by the back-EMF [N/(m/s)]: the damping in a loop around the drive."""
        return self.mechanics.viscous + self.drive.braking

    @property
    def units(self) -> Units:
        """The units of this axis, for reading and writing its numbers."""
        return Units(self.motion, self.drive.command, self.drive.command_unit)

    def supplied_by(self, *records: Record) -> Axis:
        """This axis with the mean supply voltage of the ``records``, if its command is a duty and it has no supply."""
        columns = [record.supply for record in records if record.supply is not None]
        if self.drive.command != "duty" or self.drive.supply is not None or not columns:
            return self
        return self.replace(drive={"supply": float(np.mean(np.concatenate(columns)))})

    @classmethod
    def from_toml(cls, text: str, source: str = "axis") -> Axis:
        """Read an axis from TOML ``text``; ``source`` names it in messages. Raises :class:`AxisError`."""
        try:
            table = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # a TOMLDecodeError, or an error inside tomllib
            raise AxisError(f"{source}: not TOML, {' '.join(str(error).split())}") from error
        return cls.from_dict(table, source)

    @classmethod
    def from_dict(cls, table: dict[str, Any], source: str = "axis") -> Axis:
        """Build an axis from plain data; raises :class:`AxisError` naming the place and what was found."""
        try:
            return cls.model_validate(table)
        except ValidationError as error:
            raise AxisError(f"{source}: {first_line(error, table, list(cls.model_fields))}") from error

    @classmethod
    def load(cls, path: str | Path) -> Axis:
        """Read an axis file; raises :class:`AxisError` in one line naming file, place, found and expected."""
        return cls.from_toml(_read_text(Path(path)), str(path))

    def to_dict(self) -> dict[str, Any]:
        """Plain data in the shape of the TOML file, without unset keys."""
        table = self.model_dump(exclude_none=True)
        effects = [{"kind": e.kind, **e.parameters} for e in self.effects]
        table.pop("effects")
        columns = self.record.model_dump(exclude_none=True, exclude_defaults=True)
        table.pop("record")
        if self.motion == "linear":
            table.pop("motion")
        return {**table, **({"record": columns} if columns else {}), **({"effects": effects} if effects else {})}

    def to_toml(self, comments: bool = False) -> str:
        """The axis as a TOML document that :meth:`from_toml` reads back unchanged; ``comments`` explain each key."""
        import tomli_w

        tables = self.to_dict()
        columns = tables.pop("record", {})
        text = tomli_w.dumps(tables)
        if columns:
            text += f"\n{record_toml(columns)}"
        return self._with_comments(text) if comments else text

    def replace(self, **tables: Any) -> Axis:
        """Return a copy with other tables; a dict replaces single keys of a table.

        >>> from emps_design.machines import machine
        >>> machine("emps2019").replace(mechanics={"mass": 100.0}).mechanics.mass
        100.0
        """
        current = {"effects": [], **self.to_dict()}
        data = dict(current)
        for key, value in tables.items():
            if isinstance(value, BaseModel):
                value = value.model_dump(exclude_none=True)
            elif isinstance(value, dict) and isinstance(data.get(key), dict):
                dropped = LIMIT if value.keys() & LIMIT else set()  # one number under two names
                dropped = {*dropped, *FACTORS} if "force_gain" in value else dropped
                value = {**{k: v for k, v in data[key].items() if k not in dropped}, **value}
            elif key == "effects":
                value = [{"kind": e.kind, **e.parameters} if isinstance(e, AxisEffect) else e for e in value]
            data[key] = value
        unchanged = repr(data) == repr(current)  # == would take True for 1.0, and fails on arrays
        return self if unchanged else Axis.from_dict(data, self.name)

    def view(self) -> View:
        """Every key of the axis file with its value and unit."""
        kind, unit = self.controller.kind, self.units.unit
        rows = [
            (".".join((name, *path)), _format_value(value), unit(unit_of(field_in((name, *path), kind))))
            for name in TABLES
            for path, value in leaves(getattr(self, name).model_dump(exclude_none=True))
        ]
        rows += [
            (f"{effect.kind}.{parameter.name}", _format_value(effect.parameters[parameter.name]), unit(parameter.unit))
            for effect in self.effects
            for parameter in effect.effect.parameters
        ]
        return (Table(("key", "value", "unit"), rows, self.name),)

    def _with_comments(self, text: str) -> str:
        """``text`` with the description and the unit as a comment after each line that sets a key."""
        lines, table = [], ""
        for line in text.splitlines():
            table = line.strip("[]") if line.startswith("[") else table
            field = field_in((table, line.partition(" = ")[0]), self.controller.kind)
            if field is None or not field.description:
                lines.append(line)
                continue
            unit = self.units.unit(unit_of(field))
            lines.append(f"{line:<36}  # {self.units.words(field.description)}{f' [{unit}]' if unit else ''}")
        return "\n".join(lines) + "\n"


def _format_value(value: Any) -> str:
    """A value of an axis file as text: yes or no, or five significant digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def record_toml(columns: Mapping[str, Mapping[str, Any] | Sequence[str]]) -> str:
    """The ``[record]`` table of an axis file, with one line for each of the ``columns``.

    >>> print(record_toml({"position": {"column": "Pos", "scale": 1e-6}, "accept": ("rough-position",)}), end="")
    [record]
    position = { column = "Pos", scale = 1e-06 }
    accept = ["rough-position"]
    """
    import tomli_w

    def inline(entry: Mapping[str, Any] | Sequence[str]) -> str:
        if not isinstance(entry, Mapping):
            return json.dumps(list(entry))
        # Not splitlines: a title may contain other line separators of Unicode.
        return f"{{ {', '.join(tomli_w.dumps(entry).strip(NEW_LINE).split(NEW_LINE))} }}"

    return "[record]\n" + "".join(f"{key} = {inline(entry)}\n" for key, entry in columns.items())


def _read_text(path: Path) -> str:
    expected = "expected a TOML axis file"
    try:
        return read_bytes(path, MAX_BYTES, expected).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise AxisError(f"{path}: not UTF-8 text; {expected}") from error
    except InputError as error:
        raise AxisError(str(error)) from error
