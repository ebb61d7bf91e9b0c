"""Options that the design commands share: the specification, and numbers instead of the axis's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from emps_design.axis import Axis
from emps_design.cli.destinations import OVERWRITE
from emps_design.cli.frequency import RAD_S
from emps_design.cli.wording import check_option
from emps_design.errors import InputError
from emps_design.files import write_text
from emps_design.laws.estimators import NUMBERS


def within(unit: str) -> Any:
    """The ``callback`` of an option in ``unit``: refuses, in one line, a number that no machine has."""

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


def estimator_given(text: str | None) -> Any:
    """A velocity estimator as an axis file has it, from a name or ``kind:number``; checked with the axis.

    >>> estimator_given("slope:4"), estimator_given("two_tap"), estimator_given("filtered:300")
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
    """Return the axis with the numbers given on the command line (those not None), checked like a file's.

    A force gain of one's own takes the place of the data sheet's product.

    >>> from emps_design.machines import machine
    >>> with_numbers(machine("emps2018"), mechanics={"mass": 90.0, "viscous": None}).mechanics.viscous
    474.9727
    """
    document = axis.to_dict()
    for name, table in tables.items():
        given = {key: value for key, value in table.items() if value is not None}
        if "force_gain" in given:
            for key in ("current_gain", "reduction", "torque_constant"):
                document["drive"].pop(key, None)
        document[name] = {**document.get(name, {}), **given}
    return Axis.from_dict(document, axis.name)


def write_axis(path: Path, axis: Axis) -> str:
    """Write ``axis`` as TOML to ``path``, whole or not at all, and return the path for the document."""
    write_text(path, axis.to_toml())
    return str(path)
