"""What the tables of an axis file's controller are made of: numbers with bounds, units and words, tables within."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]


def parameter(description: str, unit: str, default: Any = ...) -> Any:
    """A field of a law's table: what it is, its unit, and its default (none: it has to be given)."""
    return Field(default, description=description, json_schema_extra={"unit": unit})


def unit_of(field: FieldInfo | None) -> str:
    """The unit of a field of a table, "" where it has none."""
    extra = field.json_schema_extra if field else None
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


class Group(BaseModel):
    """A table inside the ``[controller]`` table: parameters that belong together, as those of one loop."""

    model_config = ConfigDict(extra="forbid", frozen=True)
