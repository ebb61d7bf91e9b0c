"""The ``[record]`` table of an axis file: which column of a drive's export is what."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator

# What an import refuses because it cannot be of the axis, unless its table accepts it.
Doubt = Literal[
    "sampling-period",
    "opposed-reference",
    "reference-scale",
    "rough-position",
    "exchanged-command",
    "exchanged-reference",
    "command-limit",
    "opposed-command",
    "force-scale",
    "inertia-scale",
]
DOUBTS: tuple[Doubt, ...] = get_args(Doubt)
LONGEST_DELAY = 0.1  # s; what is recorded later than that was not recorded with the rest


class Column(BaseModel):
    """One column: its title with or without the bracketed unit, its unit, what it is multiplied by, and its delay."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: Annotated[str, Field(min_length=1)] = Field(description="its title in the file")
    unit: str | None = Field(None, description="its unit, by default what the title says")
    scale: Annotated[float, Field(allow_inf_nan=False)] | None = Field(
        None, description="what its numbers are multiplied by"
    )
    sign: Literal[1, -1] = Field(1, description="-1 where the file counts the other way")
    delay: Annotated[float, Field(ge=-LONGEST_DELAY, le=LONGEST_DELAY, allow_inf_nan=False)] = Field(
        0.0, description="how much later than it acts it is recorded, in s"
    )
    modulo: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = Field(
        None, description="where a position begins anew, as its numbers count: 360 of an angle in deg"
    )


class ColumnMap(BaseModel):
    """The table itself: columns of a record, and which doubts of an import are overruled (``accept``).

    >>> ColumnMap.model_validate({"position": {"column": "Lageistwert", "unit": "mm"}}).named["q"].unit
    'mm'
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    time: Column | None = None
    position: Column | None = None
    reference: Column | None = None
    velocity_reference: Column | None = None
    command: Column | None = None
    velocity: Column | None = None
    external_force: Column | None = None
    excitation: Column | None = None
    supply: Column | None = None
    enable: Column | None = None
    accept: tuple[Doubt, ...] = ()

    @model_validator(mode="after")
    def _time_is_the_clock(self) -> ColumnMap:
        if self.time is not None and self.time.delay:
            raise ValueError(f"time: found delay {self.time.delay:g}, expected it of the columns that are late")
        for name, column in self.named.items():
            if column.modulo is not None and name not in ("q", "q_ref"):
                raise ValueError(f"{KEYS[name]}: found modulo {column.modulo:g}, expected it of position and reference")
        return self

    @property
    def named(self) -> dict[str, Column]:
        """The columns that are mapped, by their names in a record."""
        mapped = {name: getattr(self, key) for name, key in KEYS.items()}
        return {name: column for name, column in mapped.items() if column is not None}


# name of a record's column -> key of the table, in the order of the table
_IN_A_RECORD = "t q q_ref velocity_reference u velocity f_ext excitation supply enable"
KEYS = dict(zip(_IN_A_RECORD.split(), (key for key in ColumnMap.model_fields if key != "accept"), strict=True))
