"""Control laws: the library of the package, one file each, and laws added by the user.

A user's law is a file with a ``LAW`` like those in the library. Register it with :func:`load_file`, or name it in the
environment variable ``EMPS_DESIGN_LAWS=path1.py:path2.py`` (``;`` between paths on Windows) before importing the
package. The file is imported, so its code runs. An axis file selects the law with ``controller.kind``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, Protocol, cast, get_args

import numpy as np
from pydantic import Field, ValidationError, create_model, model_serializer, model_validator
from pydantic.fields import FieldInfo

from emps_design.errors import AxisError
from emps_design.laws.estimators import BACKWARD as BACKWARD, TWO_TAP as TWO_TAP
from emps_design.laws.law import (
    FromRecord as FromRecord,
    Gain as Gain,
    Law as Law,
    LawKind as LawKind,
    LawTable as LawTable,
    PlantTables,
    velocity_in_words as velocity_in_words,
)
from emps_design.laws.library import LAWS as LAWS
from emps_design.registry import Registry
from emps_design.tables import (
    AxisTable as AxisTable,
    Finite as Finite,
    NonNegative as NonNegative,
    Positive as Positive,
    parameter as parameter,
    unit_of as unit_of,
)

VARIABLE = "EMPS_DESIGN_LAWS"  # environment variable with the files of a user's laws
NONE = "none"  # the kind of an unknown controller
REGISTRY: Registry[LawKind[PlantTables]] = Registry("law", LawKind, LAWS, VARIABLE, "controller")

known_laws, get_law = REGISTRY.known, REGISTRY.get
register, load_file = REGISTRY.register, REGISTRY.load_file


class Controller(AxisTable):
    """The control law: its ``kind`` and the ``parameters`` of its table.

    A parameter reads as an attribute, None if absent: ``axis.controller.kp``; an inner table is a dict.
    """

    kind: str = Field(NONE, description="the law: position_pd, ip_velocity, impedance, cascade, p or none")
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
        parameters = checked_parameters(kind, {k: v for k, v in table.items() if k != "kind"})
        return {"kind": kind, "parameters": parameters}

    @model_serializer
    def _flat_table(self) -> dict[str, Any]:
        return {"kind": self.kind, **self.parameters}

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and name in fields_of():
            return self.parameters.get(name)
        raise AttributeError(f"controller: found {name!r}, expected one of kind, {', '.join(fields_of())}")


class ControlledAxis(PlantTables, Protocol):
    """The tables of the plant, and the controller that closes the loop around it."""

    @property
    def name(self) -> str:
        """The name of the axis."""

    @property
    def controller(self) -> Controller:
        """The law and its parameters."""


def law_of(axis: ControlledAxis, period: float, columns: Mapping[str, Any] | None = None) -> Law:
    """The law of the controller of ``axis``, at a sampling ``period`` [s].

    ``columns`` of a record are the source of recorded gains, a number or an array (n,) each.
    Raises :class:`AxisError` if the controller is ``none``, so that there is no loop, or if a column is missing.

    >>> from emps_design.machines import machine
    >>> law_of(machine("emps2019"), 1e-3).kernel.__name__
    'position_pd'
    """
    kind = axis.controller.kind
    if kind == NONE:
        *most, last = known_laws()
        raise AxisError(
            f"{axis.name}: controller.kind: found {kind!r}, expected {', '.join(most)} or {last} to close a loop; "
            "the command law identifies the one that made a record"
        )
    law, parameters, recorded = get_law(kind), _parameters_of_kind(axis), recorded_gains(axis)
    if not recorded:
        return law.law(law.table(**parameters), axis, period)
    rows, sample = np.unique(_gain_rows(recorded, columns or {}), axis=0, return_inverse=True)
    row_laws = []
    for row in rows.tolist():
        try:
            values = {**parameters, **dict(zip(recorded, row, strict=True))}
            row_laws.append(law.law(law.table(**values), axis, period))
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            name, source = problem["loc"][0], recorded[str(problem["loc"][0])]
            raise AxisError(
                f"controller.{name}: found {problem['input']:g} from column {source['record']!r} of the record times "
                f"{source['scale']:g}; {problem['msg']}"
            ) from error
    if len(row_laws) == 1:
        return row_laws[0]
    return replace(
        row_laws[0], gains=np.array([row_law.gains for row_law in row_laws])[sample.ravel()], state_feedback=False
    )


def recorded_gains(axis: ControlledAxis) -> dict[str, dict[str, Any]]:
    """The gains of the law of ``axis`` that come from a record, each with its ``record`` (a column) and ``scale``.

    >>> from emps_design.machines import machine
    >>> kp = {"record": "kp", "scale": 2.0}
    >>> recorded_gains(machine("emps2019").replace(controller={"kind": "p", "kp": kp}))
    {'kp': {'record': 'kp', 'scale': 2.0}}
    """
    parameters = {} if axis.controller.kind == NONE else _parameters_of_kind(axis)
    return {name: source for name, source in parameters.items() if isinstance(source, dict) and "record" in source}


def table_of(axis: ControlledAxis) -> LawTable:
    """The parameters of the law of ``axis``, without those stored there for other kinds."""
    return get_law(axis.controller.kind).table(**_parameters_of_kind(axis))


def _parameters_of_kind(axis: ControlledAxis) -> dict[str, Any]:
    parameters = axis.controller.parameters
    return {name: parameters[name] for name in get_law(axis.controller.kind).table.model_fields if name in parameters}


def _gain_rows(sources: Mapping[str, Any], columns: Mapping[str, Any]) -> np.ndarray:
    """Gains from a record (n or 1, number of ``sources``): a row for each sample, or one for all."""
    gains = []
    for name, source in sources.items():
        if source["record"] not in columns:
            raise AxisError(
                f"controller.{name}: is taken from column {source['record']!r} of a record, found "
                f"{', '.join(columns) or 'no record'}; expected a record with that column, or a number"
            )
        try:
            gains.append(source["scale"] * np.atleast_1d(np.asarray(columns[source["record"]], dtype=float)))
        except (TypeError, ValueError) as error:
            raise AxisError(
                f"controller.{name}: column {source['record']!r} of the record has no numbers ({error})"
            ) from error
    return np.column_stack(np.broadcast_arrays(*gains))


def checked_parameters(kind: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Check the ``parameters`` of a law of ``kind`` and return them with its defaults, in the order of the laws.

    A ``[controller]`` table may also have parameters of other kinds, which are preserved for a change of kind. Raises
    pydantic's ``ValidationError`` for unknown or impossible parameters, :class:`AxisError` for missing ones.
    """
    law = None if kind == NONE else get_law(kind)
    parameters = {name: value for name, value in parameters.items() if value is not None or name not in fields_of(kind)}
    missing = [name for name in law.needs if name not in parameters] if law else []
    if missing:
        raise AxisError(f"kind {kind!r} needs {', '.join(missing)}")
    checked = _table(kind, tuple(known_laws().values())).model_validate(parameters)
    values = checked.model_dump(exclude_none=True)
    return {name: values[name] for name in fields_of(kind) if name in values}


def fields_of(kind: str = NONE) -> dict[str, FieldInfo]:
    """Every parameter that a ``[controller]`` table may have, by name; if several laws share a name, that of ``kind``.

    >>> fields_of()["kp"].json_schema_extra["unit"]
    '1/s'
    """
    laws = known_laws()
    fields = {name: field for law in reversed(laws.values()) for name, field in law.table.model_fields.items()}
    fields |= laws[kind].table.model_fields if kind in laws else {}
    order = dict.fromkeys(name for law in laws.values() for name in law.table.model_fields)
    shared = LawTable.model_fields
    return {name: fields[name] for name in [n for n in order if n not in shared] + list(shared)}


def field_at(kind: str, path: Sequence[str]) -> FieldInfo | None:
    """The field at a ``path`` of keys of the ``[controller]`` table, inner tables included; None if there is none.

    >>> field_at("cascade", ["velocity", "ti"]).json_schema_extra["unit"]
    's'
    """
    fields, field = fields_of(kind), None
    for key in path:
        if not key.isdigit():  # a place in a list
            field = fields.get(key)
            fields = fields_within(field)
    return field


def fields_within(field: FieldInfo | None) -> dict[str, FieldInfo]:
    """The keys of the table in a ``field``, or of each in a list of tables; none for a number."""
    group = _group(field.annotation) if field else None
    return group.model_fields if group else {}


def leaves(parameters: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every value of a ``[controller]`` table with the path of keys to it, inner tables and lists included.

    >>> list(leaves({"kp": 2.0, "filters": [{"frequency": 350.0}]}))
    [(('kp',), 2.0), (('filters', '0', 'frequency'), 350.0)]
    """
    if not isinstance(parameters, dict | list | tuple):
        yield path, parameters
        return
    inner = parameters.items() if isinstance(parameters, dict) else enumerate(parameters)
    for key, value in inner:
        yield from leaves(value, (*path, str(key)))


def _group(annotation: Any) -> type[AxisTable] | None:
    """The table, or the table in a list, that a field has by its ``annotation``; None if it has none."""
    if isinstance(annotation, type) and issubclass(annotation, AxisTable):
        return annotation
    return next(filter(None, map(_group, get_args(annotation))), None)


@lru_cache(maxsize=64)
def _table(kind: str, laws: tuple[LawKind[PlantTables], ...]) -> type[LawTable]:
    """The table of ``kind`` with the parameters of the other ``laws`` as optional fields."""
    base = next((law.table for law in laws if law.name == kind), LawTable)
    more: dict[str, Any] = {}
    for name, field in fields_of(kind).items():
        if name not in base.model_fields:
            candidates = [law.table.model_fields[name] for law in laws if name in law.table.model_fields]
            field = next(filter(_from_record, candidates), field)  # the widest type, so that any entry is preserved
            optional = copy(field)
            optional.default = None
            constrained: Any = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
            optional.metadata = []
            more[name] = (constrained | None, optional)
    return create_model("Controller", __base__=base, **more)


def _from_record(field: FieldInfo) -> bool:
    """Whether the value of ``field`` may come from a record."""
    return any(FromRecord in (member, *get_args(member)) for member in get_args(field.annotation))


REGISTRY.load_environment()
