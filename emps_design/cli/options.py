"""Options that several commands share, and the checks of them.

A frequency may be written as 30Hz or 370rad/s, a ratio as 6dB; a bare number is in the option's own unit.
An option that the command would ignore in combination with the others is refused.
The design commands share the specification of the velocity loop, numbers that replace those of the axis, the structure
and filters of the loop, the position loop around it, and the range of loads that the gains have to hold for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from emps_design.axis import Axis
from emps_design.cli.output import check_option
from emps_design.commands.destinations import OVERWRITE
from emps_design.errors import InputError
from emps_design.files import write_text
from emps_design.laws.estimators import NUMBERS
from emps_design.quantities import read_frequency, read_ratio

if TYPE_CHECKING:
    from emps_design.control.position import PositionLoopDesign
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.velocity.gains import Structure
    from emps_design.control.velocity.load_range import LoadRange


def _read(read: Callable[[str], float], metavar: str) -> dict[str, Any]:
    def parse(text: str) -> float:
        try:
            return read(text)
        except InputError as error:  # click would drop the text of a ValueError
            raise typer.BadParameter(str(error)) from error

    return {"parser": parse, "metavar": metavar}


# Arguments of an option that is a frequency: typer.Option(**RAD_S, help="... [rad/s, or such as 30Hz]").
RAD_S, HERTZ = (_read(partial(read_frequency, unit=unit), "FREQUENCY") for unit in ("rad/s", "Hz"))
RATIO = _read(read_ratio, "RATIO")


def refuse_ignored(context: typer.Context, options: Iterable[str], why: str) -> None:
    """Raise :class:`InputError` with ``why`` if one of ``options`` (parameter names) is on the command line."""
    flags = {option.name: max(option.opts, key=len) for option in context.command.params}
    ignored = [name for name in options if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"]
    if ignored:
        raise InputError(f"{', '.join(flags[name] for name in ignored)}: {why}")


def refuse_force(context: typer.Context, *outputs: object) -> None:
    """Refuse ``--force`` if all of ``outputs`` are None."""
    if all(output is None for output in outputs):
        refuse_ignored(context, ["force"], "goes with a file to write; there is none to overwrite")


def within(unit: str) -> Any:
    """Return the ``callback`` of an option in ``unit``: it refuses a number outside the plausible range of the unit."""

    def check(option: typer.CallbackParam, value: float | None) -> float | None:
        name = f"--{(option.name or '').replace('_', '-')}"
        return value if value is None else check_option(name, value, unit)

    return check


AxisArgument = Annotated[str, typer.Argument(help="TOML file or embedded machine")]
Crossover = Annotated[
    float | None, typer.Option(**RAD_S, callback=within("rad/s"), help="crossover w_v of T_vo [rad/s, or such as 30Hz]")
]
Bandwidth = Annotated[
    float | None,
    typer.Option(**RAD_S, callback=within("rad/s"), help="closed-loop -3 dB of T_vc [rad/s, or such as 30Hz]"),
]
PhaseMargin = Annotated[float, typer.Option(callback=within("deg"), help="phase margin phi_v [deg]")]
Velocity = Annotated[
    float, typer.Option(callback=within("m/s"), help="where the effects of the axis are linearised [m/s]")
]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON document on standard output")]
Force = Annotated[bool, typer.Option("--force", help=OVERWRITE)]
Out = Annotated[Path | None, typer.Option(help="write the axis file that runs this design, where it is stable")]

Mass = Annotated[float | None, typer.Option(help="instead of the axis's [kg]")]
Viscous = Annotated[float | None, typer.Option(help="instead of the axis's [N/(m/s)]")]
Coulomb = Annotated[float | None, typer.Option(help="instead of the axis's [N]")]
ForceGain = Annotated[float | None, typer.Option(help="instead of the axis's [N/V]")]
VoltageLimit = Annotated[
    float | None,
    typer.Option("--voltage-limit", "--command-limit", help="instead of the axis's [V, or the command's unit]"),
]
CurrentTimeConstant = Annotated[float | None, typer.Option(help="instead of the axis's [s]")]
Period = Annotated[float | None, typer.Option(help="instead of the axis's [s]")]
EncoderResolution = Annotated[float | None, typer.Option(help="instead of the axis's [m]")]
ComputationDelay = Annotated[int | None, typer.Option(help="instead of the axis's [samples]")]
Estimator = Annotated[str | None, typer.Option(help="two_tap, backward, slope:POINTS, filtered:HZ or tracking:RAD/S")]


def estimator_from_text(text: str | None) -> Any:
    """Return a velocity estimator as in an axis file from a name or ``kind:number``; the axis checks it.

    >>> estimator_from_text("slope:4"), estimator_from_text("two_tap"), estimator_from_text("filtered:300")
    ({'kind': 'slope', 'points': 4}, 'two_tap', {'kind': 'filtered', 'frequency': 300.0})
    """
    kind, colon, number = (text or "").partition(":")
    if not colon or kind not in NUMBERS:
        return text
    try:
        return {"kind": kind, NUMBERS[kind]: int(number) if kind == "slope" else float(number)}
    except ValueError as error:
        what = "whole number" if kind == "slope" else "number"
        raise InputError(f"--velocity-estimator: found {text!r}, expected a {what} after {kind}:") from error


def with_numbers(axis: Axis, **tables: dict[str, Any]) -> Axis:
    """Return ``axis`` with the numbers of the command line (those not None), checked like those of a file.

    ``force_gain`` replaces the product of current gain, reduction and torque constant.

    >>> from emps_design.machines import machine
    >>> with_numbers(machine("emps2018"), mechanics={"mass": 90.0, "viscous": None}).mechanics.viscous
    474.9727
    """
    document = axis.to_dict()
    for name, table in tables.items():
        replacements = {key: value for key, value in table.items() if value is not None}
        if "force_gain" in replacements:
            for key in ("current_gain", "reduction", "torque_constant"):
                document["drive"].pop(key, None)
        document[name] = {**document.get(name, {}), **replacements}
    return Axis.from_dict(document, axis.name)


def write_axis(path: Path, axis: Axis) -> str:
    """Write ``axis`` as TOML to ``path``, whole or not at all, and return the path as text."""
    write_text(path, axis.to_toml())
    return str(path)


NOTCH = {"damping": 0.5, "depth": 0.1}  # defaults of a notch with a frequency alone
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


def position_loop_from_options(
    design: VelocityLoopDesign,
    overshoot: float | None,
    bandwidth: float | None,
    stiffness: float | None,
    kp: float | None,
    every: int | None,
) -> PositionLoopDesign | None:
    """Return the position loop around ``design`` that the command line specifies, or None."""
    options = {"overshoot": overshoot, "bandwidth": bandwidth, "stiffness": stiffness, "kp": kp}
    requested = {name: value for name, value in options.items() if value is not None}
    if not requested:
        return None
    if len(requested) > 1:
        raise InputError(f"position loop: found {' and '.join(requested)}, expected one of {', '.join(options)}")
    from emps_design.control.position import design_position_loop

    own = (design.axis.controller.position or {}).get("every", 1)
    ((name, value),) = requested.items()
    return design_position_loop(design, name, value, own if every is None else every)


def load_range_from_options(inertia: str | None, compliance: str | None, delay: str | None) -> LoadRange | None:
    """Return the range of loads that the command line specifies, or None."""
    from emps_design.control.velocity.load_range import LoadRange

    texts = {"inertia": inertia, "compliance": compliance, "delay": delay}
    ranges = {name: _ends(name, text) for name, text in texts.items() if text is not None}
    return LoadRange(**ranges) if ranges else None


def _ends(name: str, text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError as error:
        raise InputError(f"--{name}-range: found {text!r}, expected LOW:HIGH, two numbers") from error
    return low, high


def structure_from_options(context: typer.Context, axis: Axis, form: str | None, reference_filter: bool) -> Structure:
    """Return the structure that the command line specifies, or that of the controller of ``axis``."""
    from emps_design.control.velocity.gains import Structure, own_structure

    structure = own_structure(axis, None if form is None else Structure(form))
    if structure.form == "ip":
        refuse_ignored(context, ["reference_filter"], "goes with --structure pi; ip has no zero to take away")
    return replace(structure, reference_filter=reference_filter)


def filters_from_options(texts: list[str] | None) -> tuple[Any, ...] | None:
    """Return the filters of the command line in their order, or None if it has none.

    >>> filters_from_options(["lowpass:350Hz", "notch:48Hz:0.6:0.2"])[1].depth
    0.2
    >>> filters_from_options(["none"])
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
