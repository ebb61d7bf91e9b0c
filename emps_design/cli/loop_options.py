"""Options that say what the gains of a velocity loop act in, what is around it, and which loads it has to hold for."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from emps_design.cli.design_options import within
from emps_design.cli.frequency import RAD_S, RATIO
from emps_design.cli.ignored import refuse_ignored
from emps_design.errors import InputError
from emps_design.quantities import read_frequency

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.control.position import PositionLoopDesign
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.velocity.load_range import LoadRange
    from emps_design.control.velocity.structure import Structure

NOTCH = {"damping": 0.5, "depth": 0.1}  # where only its frequency is given
EXPECTED = "lowpass:350Hz, notch:48Hz, notch:48Hz:DAMPING:DEPTH or none"

StructureOption = Annotated[
    str | None, typer.Option(help="ip or pi: proportional to the measured velocity or to the error [the axis's]")
]
ReferenceFilter = Annotated[bool, typer.Option("--reference-filter", help="with pi: 1/(1 + t_v s) before the loop")]
Filters = Annotated[
    list[str] | None,
    typer.Option("--filter", metavar="FILTER", help=f"instead of the axis's, again for more: {EXPECTED}"),
]
SensitivityPeakBelow = Annotated[
    float | None,
    typer.Option(**RATIO, help="with --frf: limit of max|S| below the first antiresonance [ratio, or such as 6dB]"),
]
SensitivityPeakAbove = Annotated[
    float | None, typer.Option(**RATIO, help="and its limit above [ratio, or such as 6dB]")
]


PositionOvershoot = Annotated[
    float | None, typer.Option(help="a position loop around it: kp for this overshoot of a step [%]")
]
PositionBandwidth = Annotated[
    float | None,
    typer.Option(**RAD_S, callback=within("rad/s"), help="or for this closed-loop -3 dB [rad/s, or such as 10Hz]"),
]
PositionStiffness = Annotated[
    float | None, typer.Option(callback=within("N/m"), help="or for this step of force over displacement [N/m]")
]
PositionKp = Annotated[float | None, typer.Option(callback=within("1/s"), help="or this kp itself [1/s]")]
PositionEvery = Annotated[
    int | None, typer.Option(min=1, max=1000, help="the position loop runs in every n-th sample [the axis's, or 1]")
]
InertiaRange = Annotated[str | None, typer.Option(metavar="LOW:HIGH", help="factors of the inertia to hold over")]
ComplianceRange = Annotated[
    str | None, typer.Option(metavar="LOW:HIGH", help="factors of the compliance of a coupling to hold over")
]
DelayRange = Annotated[str | None, typer.Option(metavar="LOW:HIGH", help="delay on top to hold over [s]")]


def position_loop_asked_for(
    design: VelocityLoopDesign,
    overshoot: float | None,
    bandwidth: float | None,
    stiffness: float | None,
    kp: float | None,
    every: int | None,
) -> PositionLoopDesign | None:
    """The position loop around ``design`` that the command line asks for, None where it asks for none."""
    wanted = {"overshoot": overshoot, "bandwidth": bandwidth, "stiffness": stiffness, "kp": kp}
    given = {name: value for name, value in wanted.items() if value is not None}
    if not given:
        return None
    if len(given) > 1:
        raise InputError(f"position loop: found {' and '.join(given)}, expected one of {', '.join(wanted)}")
    from emps_design.control.position import design_position_loop

    own = (design.axis.controller.position or {}).get("every", 1)
    ((name, value),) = given.items()
    return design_position_loop(design, name, value, own if every is None else every)


def load_range_asked_for(inertia: str | None, compliance: str | None, delay: str | None) -> LoadRange | None:
    """The range of loads of the command line, None where it has none."""
    from emps_design.control.velocity.load_range import LoadRange

    texts = {"inertia": inertia, "compliance": compliance, "delay": delay}
    given = {name: _ends(name, text) for name, text in texts.items() if text is not None}
    return LoadRange(**given) if given else None


def _ends(name: str, text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError as error:
        raise InputError(f"--{name}-range: found {text!r}, expected LOW:HIGH, two numbers") from error
    return low, high


def structure_asked_for(context: typer.Context, axis: Axis, form: str | None, reference_filter: bool) -> Structure:
    """The structure that the command line asks for, or the one of the controller of ``axis``."""
    from emps_design.control.velocity.structure import Structure, own_structure

    found = own_structure(axis, None if form is None else Structure(form))
    if found.form == "ip":
        refuse_ignored(context, ["reference_filter"], "goes with --structure pi; ip has no zero to take away")
    return replace(found, reference_filter=reference_filter)


def filters_asked_for(texts: list[str] | None) -> tuple[Any, ...] | None:
    """The filters of the command line in their order; None where there are none there.

    >>> filters_asked_for(["lowpass:350Hz", "notch:48Hz:0.6:0.2"])[1].depth
    0.2
    >>> filters_asked_for(["none"])
    ()
    """
    if not texts:
        return None
    return () if texts == ["none"] else tuple(map(_filter, texts))


def _filter(text: str) -> Any:
    from pydantic import ValidationError

    from emps_design.laws.library.cascade import Filter

    kind, *numbers = text.split(":")
    if kind not in ("lowpass", "notch") or not numbers or len(numbers) not in ((1,) if kind == "lowpass" else (1, 3)):
        raise InputError(f"--filter: found {text!r}, expected {EXPECTED}")
    frequency, *shape = numbers
    try:
        more = dict(zip(NOTCH, map(float, shape), strict=True)) if shape else NOTCH if kind == "notch" else {}
        return Filter(kind=kind, frequency=read_frequency(frequency, "Hz"), **more)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        name = ".".join(map(str, problem["loc"]))
        raise InputError(f"--filter {text}: {name}: found {problem['input']}, {problem['msg'].lower()}") from error
    except ValueError as error:
        raise InputError(f"--filter: found {text!r}, expected {EXPECTED}") from error
