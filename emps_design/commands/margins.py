"""Compute crossover, margins, bandwidth and damping of each loop of the controller in the axis file."""

from __future__ import annotations

from dataclasses import dataclass

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.options import LoadRangeRequest
from emps_design.inputs import axis_argument
from emps_design.request import option


@dataclass(frozen=True)
class MarginsRequest(LoadRangeRequest):
    """Options of ``margins``: the axis with its controller, and the range of plants."""

    axis: Axis = axis_argument("emps2019")
    mismatch: float | None = option(None, "relative error of the parameters, such as 0.02", unit="")
    velocity: float = option(0.1, "velocity at which the effects of the axis are linearised [m/s]", unit="m/s")


def answer(request: MarginsRequest) -> Reply:
    """The margins of every loop of the controller, and their worst values over the range of plants."""
    from emps_design.control.controller import controller_margins

    margins = controller_margins(request.axis, request.mismatch, request.load_range, request.velocity)
    return Reply(margins.to_dict(), margins.view(), request.axis.units, margins.reason)
