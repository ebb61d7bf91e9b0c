"""Feed-forward of what the model knows, tried on the nonlinear machine with wrong parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from emps_design.cli.options import AsJson, AxisArgument, Force, refuse_force, refuse_ignored
from emps_design.cli.output import (
    add_advice,
    json_text,
    load_axis,
    new_console,
    print_json,
    print_warnings,
    say,
    say_advice,
)
from emps_design.commands.destinations import AXIS, JSON, check_folder, make_folder

FILES = {"axis.toml": AXIS, "compensation.json": JSON}
# The options that each scenario uses.
SCENARIOS = {
    "laps": ("stroke", "speed", "acceleration"),
    "half-ramp": ("speed",),
    "multi-sine": ("stroke",),
    "reference": ("reference",),
}


def command(
    context: typer.Context,
    axis: AxisArgument = "emps2019",
    scenario: Annotated[str, typer.Option(help="laps, half-ramp, multi-sine or reference")] = "",
    reference: Annotated[Path | None, typer.Option(help="reference to follow: columns t, q_ref (.csv, .npz)")] = None,
    stroke: Annotated[float, typer.Option(help="of laps and multi-sine [m]")] = 0.24,
    speed: Annotated[float, typer.Option(help="highest of laps and half-ramp [m/s]")] = 0.2,
    acceleration: Annotated[float, typer.Option(help="of laps [m/s^2]")] = 1.0,
    mismatch: Annotated[float, typer.Option(help="relative error of the parameters")] = 0.02,
    phase: Annotated[float, typer.Option(help="error of a phase [deg]")] = 10.0,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="folder for the axis with its compensation")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    from emps_design.compensation import compensate
    from emps_design.errors import InputError, nearest_name

    check_folder(out, FILES, (axis, reference), force)
    scenario = scenario or ("reference" if reference else "laps")
    if scenario not in SCENARIOS:
        nearest = nearest_name(scenario, tuple(SCENARIOS))
        raise InputError(f"--scenario: found {scenario!r}, expected one of {', '.join(SCENARIOS)}{nearest}")
    refuse_force(context, out)
    unread = {name for options in SCENARIOS.values() for name in options} - {*SCENARIOS[scenario]}
    refuse_ignored(context, sorted(unread), f"goes with another scenario than {scenario}")
    if scenario == "reference" and reference is None:
        raise InputError("--scenario reference: found no reference, expected --reference FILE")
    machine = load_axis(axis)
    q_ref = _reference(machine, scenario, reference, stroke, speed, acceleration)
    compensation = compensate(machine, q_ref, mismatch, phase)
    document = add_advice({"scenario": scenario, **compensation.to_dict()}, axis)
    if out is not None:
        document["out"] = _write(out, compensation, document)
    if as_json:
        print_json(document)
    else:
        _show(document)
    print_warnings(document["warnings"])
    if not as_json:
        say_advice(document)


def _reference(axis: Any, scenario: str, path: Path | None, stroke: float, speed: float, acceleration: float) -> Any:
    from emps_design.simulation import scenarios
    from emps_design.simulation.synthetic import trapezoid_laps

    period = axis.sampling.period
    if path is not None:
        return scenarios.read_reference(path, period, axis.units)[0]
    if scenario == "half-ramp":
        return scenarios.half_ramp_program(period, (speed, 0.5 * speed, 0.25 * speed))
    if scenario == "multi-sine":
        return scenarios.multi_sine(period, amplitude=0.5 * stroke)
    return trapezoid_laps(period, stroke, speed, acceleration, laps=1)


def _write(out: Path, compensation: Any, document: dict[str, Any]) -> str:
    from emps_design.files import write_text, write_together

    make_folder(out)
    with write_together(out) as aside:
        write_text(aside / "axis.toml", compensation.axis.to_toml(comments=True))
        write_text(aside / "compensation.json", f"{json_text(document)}\n")
    return str(out)


def _show(document: dict[str, Any]) -> None:
    from rich import box
    from rich.table import Table

    unit, rms = document["units"]["tracking_rms"], document["tracking_rms"]
    table = Table(title=f"tracking error, rms [{unit}], axis {document['axis']}", box=box.SIMPLE)
    for head in ("term", "alone", "all but it", "all, it wrong", ""):
        table.add_column(head, justify="left" if head in ("term", "") else "right")
    for term in document["terms"]:
        numbers = (f"{term[key]:.4g}" if term[key] is not None else "" for key in ("alone", "left_out", "worst"))
        table.add_row(term["name"].replace("_", " "), *numbers, "" if term["kept"] else "left out")
    new_console().print(table)
    assumed = document["assumed"]
    say(f"without feed-forward {rms['without']:.4g}, with inertia, friction and constant force {rms['baseline']:.4g},")
    say(f"with all that is kept {rms['with']:.4g}, and {rms['worst']:.4g} {unit} with every parameter wrong by")
    say(f"{100 * assumed['mismatch']:g} %, phases by {assumed['phase_deg']:g} deg, each the way that does more harm.")
    if "law" in assumed:
        say(f"{assumed['law'].capitalize()}.")
    for cure in document["feedback"]:
        say(cure["advice"])
