"""The axis: mechanics, drive, sampling, controller and the effects found so far; TOML in and out.

Sign convention: ``G_tau u = M qdd + F_v qd + F_c sign(qd) + offset`` (load side, SI).
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_serializer, model_validator
from pydantic.fields import FieldInfo

from emps_design.effects import Effect, get_effect
from emps_design.errors import AxisError, InputError, nearest_name, one_line
from emps_design.files import read_bytes
from emps_design.laws import NONE, Finite, NonNegative, Positive, fields_of, known_laws, parameters_of, unit_of
from emps_design.notebook import table
from emps_design.quantities import check_magnitude
from emps_design.records.mapping import Column, ColumnMap

MAX_BYTES = 1_000_000  # of an axis file


def _printable(name: str) -> str:
    """A name goes to terminals and pages: no line breaks, nor anything else that is not seen."""
    if not name.isprintable():
        raise ValueError(f"found {one_line(name)!r}, expected text on one line without control characters")
    return name


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="after")
    def _possible(self) -> _Table:
        for name, field in type(self).model_fields.items():
            _check_magnitude(name, getattr(self, name), field)
        return self


def _check_magnitude(name: str, value: Any, field: FieldInfo) -> None:
    """Refuse a number that no machine has; ``field`` says in which unit it is, and whether it has to be positive."""
    if isinstance(value, float) and field.json_schema_extra:
        positive = "gt=0" in repr((field.annotation, field.metadata))  # pydantic nests it where None is allowed too
        check_magnitude(name, value, unit_of(field), positive)


class Mechanics(_Table):
    """Load-side mechanics of the baseline inverse dynamic model, equation (2)."""

    mass: Positive = Field(description="load-side equivalent mass M", json_schema_extra={"unit": "kg"})
    viscous: NonNegative = Field(description="viscous friction F_v", json_schema_extra={"unit": "N/(m/s)"})
    coulomb: NonNegative = Field(description="Coulomb friction F_c", json_schema_extra={"unit": "N"})
    offset: Finite = Field(0.0, description="constant force", json_schema_extra={"unit": "N"})

    def array(self) -> np.ndarray:
        """Mass, viscous, coulomb, offset as the array ``b`` of the kernels [kg, N/(m/s), N, N]."""
        return np.array([self.mass, self.viscous, self.coulomb, self.offset])


class Drive(_Table):
    """The drive chain, equation (1): force = G_tau u, with G_tau given or as G_i r k_t of a data sheet."""

    force_gain: Positive = Field(description="G_tau = G_i r k_t", json_schema_extra={"unit": "N/V"})
    current_gain: Positive | None = Field(None, description="G_i", json_schema_extra={"unit": "A/V"})
    reduction: Positive | None = Field(None, description="r", json_schema_extra={"unit": "rad/m"})
    torque_constant: Positive | None = Field(None, description="k_t", json_schema_extra={"unit": "N m/A"})
    voltage_limit: Positive = Field(10.0, description="largest voltage", json_schema_extra={"unit": "V"})
    current_time_constant: NonNegative = Field(
        0.0, description="time constant of the current loop, 0: ideal", json_schema_extra={"unit": "s"}
    )

    @model_validator(mode="before")
    @classmethod
    def _force_gain_from_data_sheet(cls, table: Any) -> Any:
        names = ("current_gain", "reduction", "torque_constant")
        if isinstance(table, dict) and any(name in table for name in names):
            if any(name not in table for name in names):
                raise ValueError(f"give all of {', '.join(names)}, or force_gain alone")
            try:
                product = math.prod(float(table[name]) for name in names)
            except (TypeError, ValueError) as error:
                raise ValueError(f"{', '.join(names)}: expected three numbers") from error
            given = table.get("force_gain", product)
            if isinstance(given, (int, float)) and abs(given - product) > 1e-6 * abs(product):
                raise ValueError(
                    f"force_gain {given:g} N/V is not current_gain x reduction x torque_constant = {product:g} N/V"
                )
            table = {**table, "force_gain": given}
        return table


class Sampling(_Table):
    """Clock and encoder."""

    period: Positive = Field(description="sampling period", json_schema_extra={"unit": "s"})
    encoder_resolution: NonNegative = Field(
        0.0, description="one step of the encoder on the load side, 0: exact", json_schema_extra={"unit": "m"}
    )
    computation_delay: Annotated[int, Field(ge=0, le=1000, strict=True)] = Field(
        0, description="whole samples between measurement and voltage", json_schema_extra={"unit": "samples"}
    )


class Controller(_Table):
    """The law that makes the voltage: its kind, and its parameters as the law's own table has them.

    A parameter reads as an attribute, None where it is not given: ``axis.controller.kp``.
    """

    kind: str = Field(NONE, description="the law: position_pd, ip_velocity, impedance or none")
    parameters: dict[str, Any]

    @model_validator(mode="before")
    @classmethod
    def _from_flat_table(cls, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        kind = table.get("kind", NONE)
        kinds = [*known_laws(), NONE]
        if kind not in kinds:
            expected = f"{', '.join(map(repr, kinds[:-1]))} or {NONE!r}"
            problem = {"type": "literal_error", "loc": ("kind",), "input": kind, "ctx": {"expected": expected}}
            raise ValidationError.from_exception_data("Controller", [cast(Any, problem)])
        parameters = parameters_of(kind, {k: v for k, v in table.items() if k != "kind"})
        fields = fields_of(kind)
        for name, value in parameters.items():
            _check_magnitude(name, value, fields[name])
        return {"kind": kind, "parameters": parameters}

    @model_serializer
    def _flat_table(self) -> dict[str, Any]:
        return {"kind": self.kind, **self.parameters}

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and name in fields_of():
            return self.parameters.get(name)
        raise AttributeError(f"controller: found {name!r}, expected one of kind, {', '.join(fields_of())}")


class AxisEffect(_Table):
    """One effect of an axis: its kind and its parameters, written as an ``[[effects]]`` table."""

    kind: str
    parameters: dict[str, Finite]

    @model_validator(mode="before")
    @classmethod
    def _from_flat_table(cls, table: Any) -> Any:
        if isinstance(table, dict) and "parameters" not in table:
            kind = {"kind": table["kind"]} if "kind" in table else {}
            return {**kind, "parameters": {k: v for k, v in table.items() if k != "kind"}}
        return table

    @model_validator(mode="after")
    def _known(self) -> AxisEffect:
        self.effect.values(self.parameters)
        return self

    @property
    def effect(self) -> Effect:
        """The physics behind ``kind``."""
        return get_effect(self.kind)


class Axis(_Table):
    """Everything that is known about one machine.

    >>> axis = Axis(name="small", mechanics={"mass": 10, "viscous": 20, "coulomb": 1}, drive={"force_gain": 5},
    ...             sampling={"period": 1e-3})
    >>> axis.mechanics.mass, axis.drive.voltage_limit
    (10.0, 10.0)
    >>> Axis.from_toml(axis.to_toml()) == axis
    True
    """

    name: Annotated[str, AfterValidator(_printable)] = "axis"
    mechanics: Mechanics
    drive: Drive
    sampling: Sampling
    controller: Controller = Field(default_factory=lambda: Controller.model_validate({}))
    record: ColumnMap = Field(default_factory=ColumnMap)
    effects: tuple[AxisEffect, ...] = ()

    @classmethod
    def from_toml(cls, text: str, source: str = "axis") -> Axis:
        """Read an axis from TOML ``text``; ``source`` names it in messages. Raises :class:`AxisError`."""
        try:
            table = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # a TOMLDecodeError, or what tomllib lets through
            raise AxisError(f"{source}: not TOML, {' '.join(str(error).split())}") from error
        return cls.from_dict(table, source)

    @classmethod
    def from_dict(cls, table: dict[str, Any], source: str = "axis") -> Axis:
        """Build an axis from plain data; raises :class:`AxisError` naming the place and what was found."""
        try:
            return cls.model_validate(table)
        except ValidationError as error:
            raise AxisError(f"{source}: {_first_line(error)}") from error

    @classmethod
    def load(cls, path: str | Path) -> Axis:
        """Read an axis file; raises :class:`AxisError` in one line naming file, place, found and expected."""
        return cls.from_toml(_text(Path(path)), str(path))

    def to_dict(self) -> dict[str, Any]:
        """Plain data in the shape of the TOML file, unset keys left out."""
        table = self.model_dump(exclude_none=True)
        effects = [{"kind": e.kind, **e.parameters} for e in self.effects]
        table.pop("effects")
        columns = self.record.model_dump(exclude_none=True, exclude_defaults=True)
        table.pop("record")
        return {**table, **({"record": columns} if columns else {}), **({"effects": effects} if effects else {})}

    def to_toml(self, comments: bool = False) -> str:
        """The axis as a TOML document that :meth:`from_toml` reads back unchanged; ``comments`` explain each key."""
        import tomli_w

        tables = self.to_dict()
        columns = tables.pop("record", {})
        text = tomli_w.dumps(tables)
        if columns:
            text += "\n[record]\n" + "".join(f"{key} = {_inline(column)}\n" for key, column in columns.items())
        return _commented(text) if comments else text

    def replace(self, **tables: Any) -> Axis:
        """Return a copy in which whole tables, or single keys of a table given as a dict, are replaced.

        >>> from emps_design.machines import machine
        >>> machine("emps2019").replace(mechanics={"mass": 100.0}).mechanics.mass
        100.0
        """
        data = self.to_dict()
        for key, value in tables.items():
            if isinstance(value, BaseModel):
                value = value.model_dump(exclude_none=True)
            elif isinstance(value, dict) and isinstance(data.get(key), dict):
                value = {**data[key], **value}
            elif key == "effects":
                value = [{"kind": e.kind, **e.parameters} if isinstance(e, AxisEffect) else e for e in value]
            data[key] = value
        return Axis.from_dict(data, self.name)

    def _repr_html_(self) -> str:
        rows = [
            (name, key, value, unit_of(field))
            for name in TABLES
            for key, field in _fields(name, self.controller.kind).items()
            if (value := getattr(getattr(self, name), key)) is not None
        ]
        rows += [
            (effect.kind, parameter.name, effect.parameters[parameter.name], parameter.unit)
            for effect in self.effects
            for parameter in effect.effect.parameters
        ]
        return table(self.name, rows, ("table", "key", "value", "unit"))


def _inline(table: dict[str, Any]) -> str:
    """``table`` on one line of TOML."""
    import tomli_w

    return f"{{ {', '.join(tomli_w.dumps(table).splitlines())} }}"


def _commented(text: str) -> str:
    """``text`` with what a key is, and its unit, behind each line that sets one."""
    lines, table = [], ""
    kind = tomllib.loads(text).get("controller", {}).get("kind", NONE)
    for line in text.splitlines():
        table = line.strip("[]") if line.startswith("[") else table
        field = _fields(table, kind).get(line.partition(" = ")[0])
        unit = f" [{unit_of(field)}]" if unit_of(field) else ""
        lines.append(f"{line:<36}  # {field.description}{unit}" if field and field.description else line)
    return "\n".join(lines) + "\n"


def _text(path: Path) -> str:
    expected = "expected a TOML axis file"
    try:
        return read_bytes(path, MAX_BYTES, expected).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise AxisError(f"{path}: not UTF-8 text; {expected}") from error
    except InputError as error:
        raise AxisError(str(error)) from error


TABLES: dict[str, type[_Table]] = {
    "mechanics": Mechanics,
    "drive": Drive,
    "sampling": Sampling,
    "controller": Controller,
}


def _fields(table: str, kind: str = NONE) -> dict[str, FieldInfo]:
    """The keys of a ``table`` of the axis file, in that of the controller those of every law; none for another name."""
    if table == "controller":
        return {"kind": Controller.model_fields["kind"], **fields_of(kind)}
    return TABLES[table].model_fields if table in TABLES else {}


def _first_line(error: ValidationError) -> str:
    """The first problem of a pydantic error as ``place: found ..., expected ...``; a wrong key comes first."""
    problems = error.errors(include_url=False)
    problem = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    path = [str(part) for part in problem["loc"]]
    if path[:1] == ["effects"]:  # an effect's table is flat in the file
        path = [part for part in path if part != "parameters"]
    place = ".".join(path) or "axis"
    if problem["type"] == "extra_forbidden":
        inner = ColumnMap if len(path) == 2 else Column
        known = list(inner.model_fields if path[0] == "record" else _fields(path[0]) if len(path) == 2 else {})
        known = known or list(Axis.model_fields)
        return f"{place}: unknown key{nearest_name(path[-1], known)} (known: {', '.join(known)})"
    if problem["type"] == "value_error":
        text = problem["msg"].removeprefix("Value error, ").removeprefix("effects: ")
        return f"{place}{'.' if _is_field(path, text.partition(':')[0]) else ': '}{text}"
    field = _fields(path[0]).get(path[1]) if len(path) == 2 else None
    unit = unit_of(field)
    expected = _expected(problem["type"], problem.get("ctx", {}), problem["msg"], f" [{unit}]" if unit else "")
    if problem["type"] == "missing":
        if len(path) == 1:
            expected = f"a table [{place}]"
        elif field is not None:
            expected = f"a number{f' [{unit}]' if unit else ''}: {field.description}"
        return f"{place}: missing, expected {expected}"
    found = repr(problem["input"])
    number = isinstance(problem["input"], int | float) and not isinstance(problem["input"], bool)
    found = found if len(found) <= 60 else f"{found[:57]}..."
    return f"{place}: found {found}{f' {unit}' if unit and number else ''}, expected {expected}"


def _is_field(path: list[str], name: str) -> bool:
    """Whether ``name`` is a key of the table at ``path``."""
    return len(path) == 1 and (
        name in fields_of() if path == ["controller"] else path[0] in TABLES and name in TABLES[path[0]].model_fields
    )


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
        "tuple_type": "[[effects]] tables",
    }
    bounds = {"greater_than": "greater than", "greater_than_equal": "of at least", "less_than_equal": "of at most"}
    if kind in bounds:
        return f"a number {bounds[kind]} {next(iter(context.values())):g}{unit}"
    if kind == "literal_error":
        return str(context["expected"])
    return words.get(kind, message)
