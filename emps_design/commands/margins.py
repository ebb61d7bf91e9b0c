"""What the controller in the axis file achieves: crossover, margins, bandwidth and damping of each loop and of all."""

from __future__ import annotations

from dataclasses import dataclass

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.options import LoadRangeRequest
from emps_design.inputs import axis_argument
from emps_design.request import option


@dataclass(frozen=True)
class MarginsRequest(LoadRangeRequest):
    """What ``margins`` takes: the axis with its controller, and the machines to hold on."""

    axis: Axis = axis_argument("emps2019")
    mismatch: float | None = option(None, "relative error of the parameters to hold under too", unit="")
    velocity: float = option(0.1, "where the effects of the axis are linearised [m/s]", unit="m/s")


def answer(request: MarginsRequest) -> Reply:
    """The margins of every loop of the controller, and the worst of them on every machine."""
    from emps_design.control.controller import controller_margins

    margins = controller_margins(request.axis, request.mismatch, request.load_range, request.velocity)
    return Reply(margins.to_dict(), margins.view(), request.axis.units, margins.reason)
