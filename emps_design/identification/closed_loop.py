"""A record simulated again: closed loop, from its reference, with the parameters of a model."""

from __future__ import annotations

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import RecordError, SimulationError
from emps_design.identification.known import identified_effects, known_part
from emps_design.identification.model import Model
from emps_design.identification.plausibility import implausible
from emps_design.records import Record
from emps_design.simulation import Plant, Run
from emps_design.simulation.driven import driven_by


def simulate(record: Record, axis: Axis, model: Model, value: np.ndarray, quantise: bool = False) -> Run:
    """Closed-loop run of ``record`` from its reference and measured external force with the solution ``value`` (p,).

    The encoder is exact, or that of ``axis`` with ``quantise``. Raises :class:`RecordError` for ``value`` that no
    simulation starts from, and where the controller of ``axis`` did not make the record.
    """
    p = model.natural(value)
    mechanics = dict(zip(("mass", "viscous", "coulomb", "offset"), model.baseline(p).tolist(), strict=True))
    found = {**mechanics, "viscous": p.get("viscous", mechanics["viscous"])}
    for name in ("mass", "viscous", "coulomb"):
        if not found[name] > 0:
            why = implausible(p, axis) or [
                "the record does not determine it: record several constant speeds in both directions, with "
                "acceleration between them"
            ]
            raise RecordError(
                f"{record.name}: {name} came out as {found[name]:.4g}, and no simulation starts from that; {why[0]}"
            )
    effects = [*identified_effects(model, p), *known_part(axis, model).effects]
    machine = axis.replace(mechanics=mechanics, effects=effects, sampling={"period": record.period})
    try:
        return Plant.of(machine).closed_loop(**driven_by(machine, record), quantise=quantise)
    except SimulationError as error:
        raise RecordError(
            f"{record.name}: no simulation with the controller of {axis.name} at {1 / record.period:g} Hz ({error}), "
            "so the record was made with another one; put its controller into the axis, or use `identify`"
        ) from error
