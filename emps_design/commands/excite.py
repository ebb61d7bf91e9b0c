"""Design the experiment that measures a frequency response on a moving carriage: multi-sine or stepped sine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import TABLE
from emps_design.frequency_response.waves import ExcitationRequest
from emps_design.inputs import axis_argument
from emps_design.request import Request, option
from emps_design.view import Line


@dataclass(frozen=True)
class StrokeRequest(Request):
    """The available travel."""

    stroke: float = option(..., "available travel [m]")


@dataclass(frozen=True)
class ExciteRequest(ExcitationRequest, StrokeRequest):
    """Options of ``excite``: the axis with its controller, the limits and the excitation."""

    axis: Axis = axis_argument("emps2019", "TOML file or embedded machine, with its controller")
    speed_limit: float | None = option(None, "largest speed [m/s]")
    force_limit: float | None = option(None, "largest force [N]; default: at the command limit")
    jerk_limit: float | None = option(None, "largest jerk of the excitation [m/s^3]")
    out: Path | None = option(None, "write reference and excitation to this .csv file", writes=TABLE)


def answer(request: ExciteRequest) -> Reply:
    """The experiment, written to the output file of the request, if any."""
    from emps_design.frequency_response import Limits, design_experiment

    limits = Limits(request.stroke, request.speed_limit, request.force_limit, request.jerk_limit)
    experiment = design_experiment(request.axis, limits, request)
    view = experiment.view()
    if request.out is not None:
        experiment.save(request.out)
        view += (Line(f"reference and excitation: {request.out}"),)
    return Reply(experiment.to_dict(), view, request.axis.units, warnings=experiment.warnings)
