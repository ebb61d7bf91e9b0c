"""Assess the impedance law M_a, B without a force sensor: derived and as printed, sampled, and under mismatch."""

from __future__ import annotations

import math
from dataclasses import dataclass

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.options import RAD_S
from emps_design.errors import InputError
from emps_design.inputs import axis_argument
from emps_design.request import Request, option


@dataclass(frozen=True)
class ImpedanceRequest(Request):
    """Options of ``impedance``: the law, and the errors of its estimates."""

    axis: Axis = axis_argument("emps2018")
    mass: float | None = option(None, "apparent mass M_a [kg]; default: of the axis's controller", unit="kg")
    damping: float | None = option(
        None, "apparent damping B [N/(m/s)]; default: of the axis's controller", unit="N/(m/s)"
    )
    mismatch: float | None = option(None, "relative error of the estimates, such as 0.02", unit="")
    filter: float | None = option(
        None,
        "low-pass of acceleration and current [rad/s, or e.g. 80Hz], inf: none; default: of the axis's controller, "
        "else 0.5/period",
        unit="rad/s",
        **RAD_S,
    )
    unfiltered_current: bool = option(False, "filter only the acceleration, not the current")
    stiffness: float = option(0.0, "apparent stiffness K [N/m] about 0", unit="N/m")
    coulomb_factor: float = option(1.0, "factor on the Coulomb compensation", unit="")
    force_sensor: bool = option(False, "law (28), which uses a measured force")
    two_quadrant: bool = option(False, "independent friction errors for each direction")
    plants: int = option(200, "Monte-Carlo plants in addition to the corners", limits=(0, 1_000_000))
    seed: int = option(0, "seed of the Monte-Carlo plants", limits=(0, None))
    workers: int = option(1, "number of threads; no influence on the results", limits=(1, 256))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mismatch is None:
            self.refuse(["two_quadrant", "plants", "seed", "workers"], "requires `mismatch`")
        if self.force_sensor:
            self.refuse(["unfiltered_current"], "cannot be combined with `force_sensor`; (28) does not use the current")


def answer(request: ImpedanceRequest) -> Reply:
    """The verdict on the law, the impedance at the operator's hand, and the behaviour of plants within the mismatch."""
    from emps_design.comanipulation.assessment import assess_impedance

    axis, unit = request.axis, request.axis.units.unit
    assessment = assess_impedance(
        axis,
        _required("mass", f"M_a [{unit('kg')}]", request.mass, axis.controller.mass),
        _required("damping", f"B [{unit('N/(m/s)')}]", request.damping, axis.controller.damping),
        request.mismatch,
        request.filter,
        plants=request.plants,
        seed=request.seed,
        two_quadrant=request.two_quadrant or None,
        workers=request.workers,
        progress=request.progress,
        current_filter=math.inf if request.unfiltered_current else None,
        stiffness=request.stiffness,
        coulomb_factor=request.coulomb_factor,
        force_sensor=request.force_sensor,
    )
    return Reply(assessment.to_dict(), assessment.view(), axis.units, assessment.reason)


def _required(name: str, what: str, requested: float | None, default: float | None) -> float:
    value = default if requested is None else requested
    if value is None:
        raise InputError(f"`{name}`: found none, expected {what}, here or in the axis's impedance controller")
    return value
