"""The impedance law M_a, B without a force sensor: as derived and as printed, sampled, and under mismatch."""

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
    """What ``impedance`` takes: the law, and the errors of its estimates to try."""

    axis: Axis = axis_argument("emps2018")
    mass: float | None = option(None, "apparent mass M_a [kg]; default the axis's controller's", unit="kg")
    damping: float | None = option(None, "apparent damping B [N/(m/s)]; default likewise", unit="N/(m/s)")
    mismatch: float | None = option(None, "relative error of the estimates, such as 0.02", unit="")
    filter: float | None = option(
        None,
        "low-pass of acceleration and current [rad/s, or such as 80Hz], inf: none; default that of the axis's "
        "controller, else 0.5/period",
        unit="rad/s",
        **RAD_S,
    )
    unfiltered_current: bool = option(False, "filter the acceleration alone")
    stiffness: float = option(0.0, "apparent stiffness K [N/m] about 0", unit="N/m")
    coulomb_factor: float = option(1.0, "factor on the Coulomb compensation", unit="")
    force_sensor: bool = option(False, "(28) with a measured force")
    two_quadrant: bool = option(False, "let friction err apart in either direction")
    plants: int = option(200, "Monte-Carlo plants beside the corners", limits=(0, 1_000_000))
    seed: int = option(0, "seed of the Monte-Carlo", limits=(0, None))
    workers: int = option(1, "threads; the numbers do not depend on it", limits=(1, 256))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mismatch is None:
            self.refuse(["two_quadrant", "plants", "seed", "workers"], "goes with `mismatch`")
        if self.force_sensor:
            self.refuse(["unfiltered_current"], "goes without `force_sensor`; (28) takes no current")


def answer(request: ImpedanceRequest) -> Reply:
    """The verdict on the law, what the operator feels, and what the plants within the mismatch do."""
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


def _required(name: str, what: str, requested: float | None, own: float | None) -> float:
    value = own if requested is None else requested
    if value is None:
        raise InputError(f"`{name}`: found none, expected {what}, here or in the axis's impedance controller")
    return value
