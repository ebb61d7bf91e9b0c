"""Options that several commands share, declared once.

A frequency may be written as 30Hz or 370rad/s, a ratio as 6dB; a plain number is in the unit of the option. The design
commands share the specification of the velocity loop, numbers that replace those of the axis, structure and filters,
the position loop around it, and the range of loads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from emps_design.axis import Axis
from emps_design.commands.destinations import AXIS
from emps_design.control.velocity.gains import FILTER_TEXTS, NO_FILTER, Structure, filter_from_text, own_structure
from emps_design.errors import InputError
from emps_design.files import write_text
from emps_design.inputs import axis_argument
from emps_design.laws.estimators import NUMBERS
from emps_design.request import HERTZ as HERTZ, RAD_S as RAD_S, RATIO as RATIO, Request, option

if TYPE_CHECKING:
    from emps_design.control.position import PositionLoopDesign
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.velocity.load_range import LoadRange


def _ends(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError as error:
        raise InputError(f"found {text!r}, expected LOW:HIGH, two numbers") from error
    return low, high


RANGE: dict[str, Any] = {"parse": _ends, "metavar": "LOW:HIGH", "typed": str | None}


def estimator_from_text(text: str) -> Any:
    """A velocity estimator as in an axis file, from a name or ``kind:number``; the axis checks it.

    >>> estimator_from_text("slope:4"), estimator_from_text("two_tap"), estimator_from_text("filtered:300")
    ({'kind': 'slope', 'points': 4}, 'two_tap', {'kind': 'filtered', 'frequency': 300.0})
    """
    kind, colon, number = text.partition(":")
    if not colon or kind not in NUMBERS:
        return text
    try:
        return {"kind": kind, NUMBERS[kind]: int(number) if kind == "slope" else float(number)}
    except ValueError as error:
        what = "whole number" if kind == "slope" else "number"
        raise InputError(f"found {text!r}, expected a {what} after {kind}:") from error


def write_axis(path: Path, axis: Axis) -> str:
    """Write ``axis`` as TOML to ``path``, completely or not at all, and return the path as text."""
    write_text(path, axis.to_toml())
    return str(path)


@dataclass(frozen=True)
class LoadRangeRequest(Request):
    """The range of loads for which the gains must hold."""

    inertia_range: tuple[float, float] | None = option(None, "range of factors on the inertia", **RANGE)
    compliance_range: tuple[float, float] | None = option(
        None, "range of factors on the compliance of a coupling", **RANGE
    )
    delay_range: tuple[float, float] | None = option(None, "range of additional delay [s]", **RANGE)

    @property
    def load_range(self) -> LoadRange | None:
        """The range, None if the request has none."""
        from emps_design.control.velocity.load_range import LoadRange

        ends = {"inertia": self.inertia_range, "compliance": self.compliance_range, "delay": self.delay_range}
        ranges = {name: span for name, span in ends.items() if span is not None}
        return LoadRange(**ranges) if ranges else None


@dataclass(frozen=True)
class VelocityLoopRequest(Request):
    """The specification of a velocity loop, and numbers that replace those of its axis."""

    axis: Axis = axis_argument("emps2018")
    crossover: float | None = option(None, "crossover w_v of T_vo [rad/s, or e.g. 30Hz]", unit="rad/s", **RAD_S)
    bandwidth: float | None = option(None, "closed-loop -3 dB of T_vc [rad/s, or e.g. 30Hz]", unit="rad/s", **RAD_S)
    phase_margin_deg: float = option(60.0, "phase margin phi_v [deg]", unit="deg", flags=("--phase-margin",))
    structure: str | None = option(
        None, "ip or pi: proportional action on the measured velocity or on the error [default: the axis's]"
    )
    reference_filter: bool = option(False, "with pi: reference filter 1/(1 + t_v s)")
    filters: tuple[Any, ...] = option(
        (),
        f"command filter instead of the axis's, repeatable: {FILTER_TEXTS}",
        flags=("--filter",),
        metavar="FILTER",
        typed=list[str],
        parse=filter_from_text,
    )
    out: Path | None = option(None, "write the axis file with this controller, if it is stable", writes=AXIS)
    velocity: float = option(0.1, "velocity at which the effects of the axis are linearised [m/s]", unit="m/s")
    mass: float | None = option(None, "mass instead of the axis's [kg]")
    viscous: float | None = option(None, "viscous friction instead of the axis's [N/(m/s)]")
    force_gain: float | None = option(None, "force gain instead of the axis's [N/V]")
    current_time_constant: float | None = option(None, "current loop instead of the axis's [s]")
    period: float | None = option(None, "sampling period instead of the axis's [s]")
    computation_delay: int | None = option(None, "delay instead of the axis's [samples]")
    velocity_estimator: Any = option(
        None,
        "instead of the axis's: two_tap, backward, slope:POINTS, filtered:HZ or tracking:RAD/S",
        typed=str | None,
        parse=estimator_from_text,
    )

    @property
    def more_numbers(self) -> dict[str, dict[str, Any]]:
        """Further numbers that replace those of the axis, by table of the axis file."""
        return {}

    @cached_property
    def machine(self) -> Axis:
        """The axis with the numbers of the request."""
        tables: dict[str, dict[str, Any]] = {
            "mechanics": {"mass": self.mass, "viscous": self.viscous},
            "drive": {"force_gain": self.force_gain, "current_time_constant": self.current_time_constant},
            "sampling": {"period": self.period, "computation_delay": self.computation_delay},
            "controller": {"velocity_estimator": self.velocity_estimator},
        }
        more = self.more_numbers
        replaced = {
            name: {key: value for key, value in (table | more.get(name, {})).items() if value is not None}
            for name, table in tables.items()
        }
        return self.axis.replace(**{name: table for name, table in replaced.items() if table})

    @property
    def loop_structure(self) -> Structure:
        """The structure of the request, or that of the controller of the axis."""

        structure = own_structure(self.machine, self.structure)
        if structure.form == "ip":
            self.refuse(["reference_filter"], "requires `structure='pi'`; ip has no zero to cancel")
        return replace(structure, reference_filter=self.reference_filter)

    @property
    def loop_filters(self) -> tuple[Any, ...] | None:
        """The filters of the request in order; None for those of the axis."""
        if not self.filters:
            return None
        return () if self.filters == (NO_FILTER,) else self.filters


@dataclass(frozen=True)
class PositionLoopRequest(Request):
    """A position loop around a velocity loop."""

    position_overshoot: float | None = option(None, "add a position loop: kp for this step overshoot [%]")
    position_bandwidth: float | None = option(
        None, "or kp for this closed-loop -3 dB bandwidth [rad/s, or e.g. 10Hz]", unit="rad/s", **RAD_S
    )
    position_stiffness: float | None = option(None, "or kp for this stiffness against a force step [N/m]", unit="N/m")
    position_kp: float | None = option(None, "or kp itself [1/s]", unit="1/s")
    position_every: int | None = option(
        None, "run the position loop every n-th sample [default: the axis's, or 1]", limits=(1, 1000)
    )

    @property
    def _position_specification(self) -> dict[str, float]:
        """The specifications of the position loop that are set, by name without ``position_``."""
        names = ("overshoot", "bandwidth", "stiffness", "kp")
        values = {name: getattr(self, f"position_{name}") for name in names}
        return {name: value for name, value in values.items() if value is not None}

    def check_position_loop(self) -> None:
        """Raise :class:`InputError` if ``position_every`` is set without a specification of the position loop."""
        if not self._position_specification:
            one_of = "`position_overshoot`, `position_bandwidth`, `position_stiffness` or `position_kp`"
            self.refuse(["position_every"], f"requires {one_of}")

    def position_loop(self, design: VelocityLoopDesign) -> PositionLoopDesign | None:
        """The position loop around ``design``; None if the request specifies none."""
        specification = self._position_specification
        if not specification:
            return None
        if len(specification) > 1:
            names = "overshoot, bandwidth, stiffness, kp"
            raise InputError(f"position loop: found {' and '.join(specification)}, expected one of {names}")
        from emps_design.control.position import design_position_loop

        ((name, value),) = specification.items()
        every = self.position_every
        if every is None:
            every = (design.axis.controller.position or {}).get("every", 1)
        return design_position_loop(design, name, value, every)
