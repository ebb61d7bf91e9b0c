"""The request of a report, with the same names in Python, on the command line and in the studio."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from emps_design.axis import Axis
from emps_design.errors import InputError
from emps_design.inputs import read_axis
from emps_design.laws import NONE, get_law
from emps_design.request import RAD_S, Request, option

MODELS = ("symmetric", "asymmetric")  # of friction


@dataclass(frozen=True)
class ReportRequest(Request):
    """An axis, a record of it, and the loops to design: velocity loop, force loop, impedance law.

    Record and measured response stay files here: the page names every input with its SHA-256.
    """

    axis: Axis | None = option(
        None,
        "TOML file or embedded machine; default emps2018, emps2019 with a record",
        argument=True,
        typed=str | None,
        read=read_axis,
    )
    record: Any = option(None, "record to identify: .mat, .csv or .npz", typed=Path | None)
    crossover: float | None = option(None, "crossover w_v of T_vo [rad/s, or e.g. 30Hz]", unit="rad/s", **RAD_S)
    bandwidth: float | None = option(None, "closed-loop -3 dB of T_vc [rad/s, or e.g. 30Hz]", unit="rad/s", **RAD_S)
    phase_margin_deg: float = option(60.0, "phase margin phi_v [deg]", unit="deg", flags=("--phase-margin",))
    retune: bool = option(False, "meet the specification in the sampled loop")
    design_on: str | None = option(
        None,
        "record: design on what the record gives; axis: on the axis as it is",
        choices=("record", "axis"),
        typed=str | None,
    )
    model: str = option("symmetric", "friction model for the design", choices=MODELS)
    record_filter: str | None = option(
        None,
        "filter of the identification: hold (default), report or paper",
        choices=("hold", "report", "paper"),
        typed=str | None,
    )
    k_e1: float | None = option(None, "force gain [(m/s)/N]: adds the force loop", unit="(m/s)/N")
    hand: float | None = option(None, "viscous hand [N/(m/s)]: adds the force loop", unit="N/(m/s)")
    environment: float | None = option(None, "stiffness of the wall [N/m]: adds the force loop", unit="N/m")
    mass: float | None = option(None, "apparent mass M_a [kg]: adds the impedance law", unit="kg")
    damping: float | None = option(None, "apparent damping B [N/(m/s)], with a mass", unit="N/(m/s)")
    filter: float | None = option(None, "filter of the impedance law [rad/s, or e.g. 80Hz]", unit="rad/s", **RAD_S)
    mismatch: float = option(0.02, "error of the impedance law's estimates", unit="")
    frf: Path | None = option(None, "measured response of 'frf' to show beside the model")
    structure: Any = option(None, "a Structure of the velocity loop; default the axis's", hidden=True)
    filters: Any = option(None, "filters of the command of the velocity loop; default the axis's", hidden=True)
    record_axis: Axis | None = option(None, "axis that made the record, where it is another", hidden=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.record is None:
            if self.design_on == "record":
                raise InputError("`design_on`: found 'record' without a record; give one with `record`")
            self.refuse(["design_on", "model", "record_filter"], "requires `record`")
        if (self.mass is None) != (self.damping is None):
            raise InputError("impedance law: found one of mass and damping, expected both [kg, N/(m/s)] or neither")
        if self.apparent is None:
            self.refuse(["filter", "mismatch"], "requires the impedance law: `mass` and `damping`")

    @cached_property
    def machine(self) -> Axis:
        """The axis, or the embedded machine that is the default."""
        return read_axis(self.default_name) if self.axis is None else self.axis

    @property
    def default_name(self) -> str:
        """The embedded machine that stands for no axis."""
        return "emps2018" if self.record is None else "emps2019"

    @property
    def base(self) -> str:
        """What the design is on: "record" or "axis"."""
        return self.design_on or ("record" if self.axis is None and self.record is not None else "axis")

    @property
    def apparent(self) -> tuple[float, float] | None:
        """Mass [kg] and damping [N/(m/s)] of the impedance law, those of the axis's controller if none are asked for.

        None without an impedance law.
        """
        if self.mass is not None and self.damping is not None:
            return self.mass, self.damping
        controller = None if self.axis is None else self.axis.controller
        if controller is None or controller.kind == NONE or not get_law(controller.kind).apparent:
            return None
        return controller.mass, controller.damping
