"""Control laws: the package's own library, one file each, and those that a user adds.

A user's own law is a file with a ``LAW`` like those here. :func:`load_file` registers it, and so does naming it in the
environment, ``EMPS_DESIGN_LAWS=path1.py:path2.py`` (``;`` between paths on Windows), when the package is imported. It
is a plain import: the file's code runs. An axis file then asks for it with ``controller.kind`` and its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import lru_cache
from typing import Annotated, Any

from pydantic import create_model
from pydantic.fields import FieldInfo

from emps_design.errors import AxisError
from emps_design.laws.law import (
    Finite,
    Law,
    LawKind,
    LawTable,
    NonNegative,
    Positive,
    parameter,
    unit_of,
    velocity_in_words,
)
from emps_design.laws.library import LAWS
from emps_design.registry import Registry

VARIABLE = "EMPS_DESIGN_LAWS"  # environment variable with the files of a user's own laws
NONE = "none"  # the kind of a controller that is not known
REGISTRY: Registry[LawKind] = Registry("law", LawKind, LAWS, VARIABLE, "controller")

known_laws, get_law = REGISTRY.known, REGISTRY.get
register, load_file = REGISTRY.register, REGISTRY.load_file


def law_of(axis: Any, period: float) -> Law:
    """The law an :class:`~emps_design.axis.Axis` asks for, at a sampling ``period`` [s].

    Raises :class:`AxisError` where the controller is ``none``, which has no law to close a loop with.

    >>> from emps_design.machines import machine
    >>> law_of(machine("emps2019"), 1e-3).kernel.__name__
    'position_pd'
    """
    kind = axis.controller.kind
    if kind == NONE:
        *most, last = known_laws()
        raise AxisError(
            f"controller.kind: found {kind!r}, expected {', '.join(most)} or {last} to close a loop; "
            "give closed_loop(law=...) or simulate open_loop"
        )
    law = get_law(kind)
    own = {
        name: axis.controller.parameters[name] for name in law.table.model_fields if name in axis.controller.parameters
    }
    return law.law(law.table(**own), axis, period)


def parameters_of(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Check the numbers ``given`` to a law of ``kind`` and return them with its defaults, in the order of the laws.

    A ``[controller]`` table may hold parameters of other kinds too, which wait there for their own. Raises pydantic's
    ``ValidationError`` for what is unknown or out of bounds, :class:`AxisError` for what is missing.
    """
    law = None if kind == NONE else get_law(kind)
    given = {name: value for name, value in given.items() if value is not None or name not in fields_of(kind)}
    missing = [name for name in law.needs if name not in given] if law else []
    if missing:
        raise AxisError(f"kind {kind!r} needs {', '.join(missing)}")
    checked = _table(kind, tuple(known_laws().values())).model_validate(given)
    values = checked.model_dump(exclude_none=True)
    return {name: values[name] for name in fields_of(kind) if name in values}


def fields_of(kind: str = NONE) -> dict[str, FieldInfo]:
    """Every parameter that a ``[controller]`` table may hold, by name; ``kind`` says whose meaning counts.

    >>> fields_of()["kp"].json_schema_extra["unit"]
    '1/s'
    """
    laws = known_laws()
    fields = {name: field for law in reversed(laws.values()) for name, field in law.table.model_fields.items()}
    fields |= laws[kind].table.model_fields if kind in laws else {}
    order = dict.fromkeys(name for law in laws.values() for name in law.table.model_fields)
    shared = LawTable.model_fields
    return {name: fields[name] for name in [n for n in order if n not in shared] + list(shared)}


@lru_cache(maxsize=64)
def _table(kind: str, laws: tuple[LawKind, ...]) -> type[LawTable]:
    """The table of ``kind`` with what the other ``laws`` have as well, none of it needed."""
    base = next((law.table for law in laws if law.name == kind), LawTable)
    more: dict[str, Any] = {}
    for name, field in fields_of(kind).items():
        if name not in base.model_fields:
            optional = copy(field)
            optional.default = None
            constrained: Any = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
            optional.metadata = []
            more[name] = (constrained | None, optional)
    return create_model("Controller", __base__=base, **more)


REGISTRY.load_environment()

__all__ = [
    "LAWS",
    "NONE",
    "REGISTRY",
    "VARIABLE",
    "Finite",
    "Law",
    "LawKind",
    "LawTable",
    "NonNegative",
    "Positive",
    "fields_of",
    "get_law",
    "known_laws",
    "law_of",
    "load_file",
    "parameter",
    "parameters_of",
    "register",
    "unit_of",
    "velocity_in_words",
]
