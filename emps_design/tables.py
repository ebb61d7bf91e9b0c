"""The tables of an axis file that describe the machine: mechanics, drive, sampling and effects.

Every number has bounds, a unit and a description. Sign convention: ``G_tau u = M qdd + F_v qd + F_c sign(qd) + offset``
(load side, SI).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer, model_validator
from pydantic.fields import FieldInfo

from emps_design.effects import Effect, Parameter, get_effect
from emps_design.errors import AxisError
from emps_design.units import COMMANDS, check_command_unit

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]

FACTORS = "current_gain", "reduction", "torque_constant"  # whose product is the force gain
NO_LIMIT = 1e8  # largest command where the limit is unknown: accepted in every unit

# The parameters of the baseline, :class:`Mechanics`, by their names in identification and diagnosis; an axis file calls
# the constant force ``offset``. Bounds and scales are those of a fit on an ordinary linear axis.
BASELINE = (
    Parameter("mass", "M", "kg", lower=1e-6, text="load-side equivalent mass", scale=1.0),
    Parameter("viscous", "F_v", "N/(m/s)", lower=0.0, text="viscous friction", scale=10.0),
    Parameter("coulomb", "F_c", "N", lower=0.0, text="Coulomb friction", scale=1.0),
    Parameter("constant_force", "F_0", "N", text="constant force", scale=1.0),
)


def parameter(description: str, unit: str, default: Any = ...) -> Any:
    """A field of a law's table with description, unit and default; without a default it is required."""
    return Field(default, description=description, json_schema_extra={"unit": unit})


def unit_of(field: FieldInfo | None) -> str:
    """The unit of a field of a table, "" where it has none."""
    extra = field.json_schema_extra if field else None
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


class AxisTable(BaseModel):
    """A table of an axis file, which refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Mechanics(AxisTable):
    """Load-side mechanics of the baseline inverse dynamic model, equation (2)."""

    mass: Positive = Field(description="load-side equivalent mass M", json_schema_extra={"unit": "kg"})
    viscous: NonNegative = Field(description="viscous friction F_v", json_schema_extra={"unit": "N/(m/s)"})
    coulomb: NonNegative = Field(description="Coulomb friction F_c", json_schema_extra={"unit": "N"})
    offset: Finite = Field(0.0, description="constant force", json_schema_extra={"unit": "N"})

    def array(self) -> np.ndarray:
        """Mass, viscous, coulomb, constant force as the array ``b`` of the kernels [kg, N/(m/s), N, N]."""
        return np.array([self.mass, self.viscous, self.coulomb, self.offset])

    @property
    def parameters(self) -> dict[str, float]:
        """The same numbers by the names of :data:`BASELINE`."""
        return {parameter.name: x for parameter, x in zip(BASELINE, self.array().tolist(), strict=True)}

    @classmethod
    def table(cls, b: Sequence[float] | np.ndarray) -> dict[str, float]:
        """The ``[mechanics]`` table of an axis file with the numbers ``b`` (4,) of :meth:`array`.

        >>> Mechanics.table([95.0, 200.0, 20.0, -3.0])
        {'mass': 95.0, 'viscous': 200.0, 'coulomb': 20.0, 'offset': -3.0}
        """
        return dict(zip(cls.model_fields, map(float, b), strict=True))


class Drive(AxisTable):
    """The drive chain, equation (1): force = G_tau u, with G_tau given or as G_i r k_t of a data sheet.

    The command u, as recorded, is a voltage that sets the current, the current itself, a torque or force, or the duty
    of a motor without a current loop. Quantities with a command are in ``command_unit``.
    """

    command: Literal["voltage", "current", "torque", "force", "duty"] = Field(
        "voltage", description="kind of command in the records"
    )
    command_unit: str = Field("V", description="unit of the command")
    force_gain: Positive = Field(description="G_tau = G_i r k_t", json_schema_extra={"unit": "N/V"})
    current_gain: Positive | None = Field(None, description="G_i", json_schema_extra={"unit": "A/V"})
    reduction: Positive | None = Field(None, description="r", json_schema_extra={"unit": "rad/m"})
    torque_constant: Positive | None = Field(None, description="k_t", json_schema_extra={"unit": "N m/A"})
    command_limit: Positive = Field(10.0, description="largest voltage", json_schema_extra={"unit": "V"})
    current_time_constant: NonNegative = Field(
        0.0, description="time constant of the current loop, 0: ideal", json_schema_extra={"unit": "s"}
    )
    back_emf: NonNegative = Field(
        0.0, description="back-EMF of a motor without a current loop", json_schema_extra={"unit": "volt/(m/s)"}
    )
    supply: Positive | None = Field(
        None, description="supply voltage for a duty, if not recorded", json_schema_extra={"unit": "volt"}
    )

    @model_validator(mode="before")
    @classmethod
    def _normalise(cls, table: Any) -> Any:
        """Complete the table: the force gain from a data sheet, the command's unit, and ``command_limit``."""
        if not isinstance(table, dict):
            return table
        table, command = _force_gain_from_data_sheet(table), table.get("command", "voltage")
        if command not in COMMANDS:
            return table
        unit = table.get("command_unit", COMMANDS[command])
        if isinstance(unit, str):
            table["command_unit"] = check_command_unit(command, unit)
        limits = [table[key] for key in ("voltage_limit", "command_limit") if key in table]
        if command != "voltage" and table.pop("voltage_limit", None) is not None:
            raise ValueError(f"voltage_limit: found with a {command} command, expected command_limit")
        if len(limits) == 2 and limits[0] != limits[1]:
            raise ValueError(
                f"voltage_limit: found {limits[0]!r} and command_limit {limits[1]!r}, expected only one of them"
            )
        table.pop("voltage_limit", None)
        table.setdefault("command_limit", *limits[:1] or ({"voltage": 10.0, "duty": 1.0}.get(command, NO_LIMIT),))
        if command != "duty" and table.get("supply") is not None:
            raise ValueError(f"supply: found with a {command} command, expected only with a duty command")
        if command not in ("voltage", "duty") and table.get("back_emf"):
            raise ValueError(
                f"back_emf: found with a {command} command, expected only with a voltage or duty command: the drive's "
                "inner loop compensates the back-EMF"
            )
        return table

    @property
    def gain(self) -> float:
        """Force per unit of the command [N/V, N per command unit]: G_tau, for a duty times the supply.

        Raises :class:`AxisError` for a duty without a supply.
        """
        if self.command != "duty":
            return self.force_gain
        if self.supply is None:
            raise AxisError(
                "drive.supply: missing, expected the supply voltage of the duty, or a record with a column that is "
                "mapped to it"
            )
        return self.force_gain * self.supply

    @property
    def braking(self) -> float:
        """Braking force of the back-EMF per velocity [N/(m/s)]; 0 behind a current loop."""
        return self.force_gain * self.back_emf

    @model_serializer(mode="wrap")
    def _serialise(self, table: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The table without defaults; the limit of a voltage command is ``voltage_limit``."""
        defaults = {"command": "voltage", "command_unit": COMMANDS[self.command], "back_emf": 0.0}
        return {
            "voltage_limit" if key == "command_limit" and self.command == "voltage" else key: value
            for key, value in table(self).items()
            if key not in defaults or value != defaults[key]
        }


def _force_gain_from_data_sheet(table: dict[str, Any]) -> dict[str, Any]:
    """A copy of a drive's table; the force gain defaults to G_i r k_t if the table has the three factors."""
    if not any(name in table for name in FACTORS):
        return dict(table)
    if any(name not in table for name in FACTORS):
        raise ValueError(f"give all of {', '.join(FACTORS)}, or force_gain alone")
    try:
        return {"force_gain": math.prod(float(table[name]) for name in FACTORS), **table}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{', '.join(FACTORS)}: expected three numbers") from error


class Sampling(AxisTable):
    """Clock and encoder."""

    period: Positive = Field(description="sampling period", json_schema_extra={"unit": "s"})
    encoder_resolution: NonNegative = Field(
        0.0, description="encoder step on the load side, 0: exact", json_schema_extra={"unit": "m"}
    )
    computation_delay: Annotated[int, Field(ge=0, le=1000, strict=True)] = Field(
        0, description="whole samples from measurement to voltage", json_schema_extra={"unit": "samples"}
    )


class AxisEffect(AxisTable):
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
    def _check_parameters(self) -> AxisEffect:
        self.effect.values(self.parameters)
        self.parameters.update(self.effect.completed(self.parameters))
        return self

    @property
    def effect(self) -> Effect:
        """The physics behind ``kind``."""
        return get_effect(self.kind)
