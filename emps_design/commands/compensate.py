"""Design a feed-forward from the model, and test it on the nonlinear machine with wrong parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import AXIS, JSON, make_folder
from emps_design.errors import InputError
from emps_design.files import write_text, write_together
from emps_design.inputs import axis_argument
from emps_design.request import Request, option

if TYPE_CHECKING:
    import numpy as np

    from emps_design.compensation import Compensation

FILES = {"axis.toml": AXIS, "compensation.json": JSON}
# The options that each scenario uses.
SCENARIOS = {
    "laps": ("stroke", "speed", "acceleration"),
    "half-ramp": ("speed",),
    "multi-sine": ("stroke",),
    "reference": ("reference",),
}


def read_positions(path: str | Path, axis: Axis) -> Any:
    """The reference (n,) in the file at ``path``, sampled with the period of ``axis``."""
    from emps_design.simulation.synthetic import read_reference

    return read_reference(Path(path), axis.sampling.period, axis.units)[0]


@dataclass(frozen=True)
class CompensateRequest(Request):
    """Options of ``compensate``: the axis, the reference motion, and the errors of the model."""

    axis: Axis = axis_argument("emps2019")
    scenario: str = option("", "motion of the axis [default: laps, or the reference]", choices=("", *SCENARIOS))
    reference: Any = option(
        None, "reference to follow: columns t, q_ref (.csv, .npz)", typed=Path | None, read=read_positions
    )
    stroke: float = option(0.24, "stroke of laps and multi-sine [m]")
    speed: float = option(0.2, "largest speed of laps and half-ramp [m/s]")
    acceleration: float = option(1.0, "acceleration of laps [m/s^2]")
    mismatch: float = option(0.02, "relative error of the parameters")
    phase: float = option(10.0, "error of a phase [deg]")
    out: Path | None = option(None, "folder for the axis with its compensation", metavar="DIR", writes=FILES)

    def __post_init__(self) -> None:
        super().__post_init__()
        unused = {name for options in SCENARIOS.values() for name in options} - {*SCENARIOS[self.motion]}
        self.refuse(sorted(unused), f"not used by the {self.motion} scenario")
        if self.motion == "reference" and self.reference is None:
            raise InputError("`scenario='reference'`: found no reference, expected `reference` FILE")

    @property
    def motion(self) -> str:
        """The scenario: by default ``reference`` if the request has one, else ``laps``."""
        return self.scenario or ("laps" if self.reference is None else "reference")

    @property
    def positions(self) -> np.ndarray:
        """The reference (n,) [m]."""
        from emps_design.simulation.synthetic import half_ramp_program, multi_sine, trapezoid_laps

        period = self.axis.sampling.period
        if self.reference is not None:
            return self.reference
        if self.motion == "half-ramp":
            return half_ramp_program(period, (self.speed, 0.5 * self.speed, 0.25 * self.speed))
        if self.motion == "multi-sine":
            return multi_sine(period, amplitude=0.5 * self.stroke)
        return trapezoid_laps(period, self.stroke, self.speed, self.acceleration, laps=1)


def answer(request: CompensateRequest) -> Reply:
    """The feed-forward, term by term, with the tracking error for exact and for wrong parameters."""
    from emps_design.compensation import compensate

    compensation = compensate(request.axis, request.positions, request.mismatch, request.phase)
    document = {"scenario": request.motion, **compensation.to_dict()}
    write = None if request.out is None else partial(_write, request.out, compensation)
    return Reply(document, compensation.view(), request.axis.units, warnings=compensation.warnings, write=write)


def _write(out: Path, compensation: Compensation, document: str) -> str:
    """Write the axis and the JSON ``document`` into the folder ``out``."""

    make_folder(out)
    with write_together(out) as aside:
        write_text(aside / "axis.toml", compensation.axis.to_toml(comments=True))
        write_text(aside / "compensation.json", document)
    return str(out)
