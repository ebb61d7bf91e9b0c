"""The whole design as one self-contained page: specification against achieved, loops, force loop, record."""

from __future__ import annotations

from pathlib import Path

import typer

from emps_design.cli.options import RAD_S, AsJson, Bandwidth, Crossover, Force, PhaseMargin, refuse_ignored, within
from emps_design.commands.destinations import PAGE, check_named_out


def command(
    context: typer.Context,
    axis: str | None = typer.Argument(
        None, help="TOML file or embedded machine; default emps2018, emps2019 with a record"
    ),
    record: Path | None = typer.Option(None, "--record", help="record to identify: .mat, .csv or .npz"),
    out: Path = typer.Option(..., "--out", help="HTML file to write"),
    crossover: Crossover = None,
    bandwidth: Bandwidth = None,
    phase_margin: PhaseMargin = 60.0,
    retune: bool = typer.Option(False, "--retune", help="meet the specification in the sampled loop"),
    design_on: str | None = typer.Option(
        None, "--design-on", help="record: design on what the record gives; axis: on the axis as it is"
    ),
    model: str = typer.Option("symmetric", "--model", help="friction model for the design: symmetric or asymmetric"),
    record_filter: str | None = typer.Option(
        None, "--record-filter", help="filter of the identification: hold (default), report or paper"
    ),
    k_e1: float | None = typer.Option(
        None, "--k-e1", callback=within("(m/s)/N"), help="force gain [(m/s)/N]: adds the force loop"
    ),
    hand: float | None = typer.Option(
        None, "--hand", callback=within("N/(m/s)"), help="viscous hand [N/(m/s)]: adds the force loop"
    ),
    environment: float | None = typer.Option(
        None, "--environment", callback=within("N/m"), help="stiffness of the wall [N/m]: adds the force loop"
    ),
    mass: float | None = typer.Option(
        None, "--mass", callback=within("kg"), help="apparent mass M_a [kg]: adds the impedance law"
    ),
    damping: float | None = typer.Option(
        None, "--damping", callback=within("N/(m/s)"), help="apparent damping B [N/(m/s)], with --mass"
    ),
    filter: float | None = typer.Option(
        None,
        "--filter",
        **RAD_S,
        callback=within("rad/s"),
        help="filter of the impedance law [rad/s, or such as 80Hz]",
    ),
    mismatch: float = typer.Option(
        0.02, "--mismatch", callback=within(""), help="error of the impedance law's estimates"
    ),
    frf: Path | None = typer.Option(None, "--frf", help="measured response of 'frf' to show beside the model"),
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """The whole design as one self-contained page: specification against achieved, loops, force loop, record."""
    from emps_design.cli.output import load_axis, print_json, progress_bar, say, say_advice, set_units, tell
    from emps_design.errors import UnstableError
    from emps_design.files import write_aside
    from emps_design.report.assemble import assemble_report, has_impedance_law
    from emps_design.units import Units

    loaded = None if axis is None else load_axis(axis)
    if loaded is None:
        set_units(Units())
    if record is None:
        refuse_ignored(context, ["design_on", "model", "record_filter"], "goes with --record")
    if mass is None and damping is None and not (loaded is not None and has_impedance_law(loaded)):
        refuse_ignored(context, ["filter", "mismatch"], "goes with the impedance law: --mass and --damping")
    if crossover is None and bandwidth is None:
        crossover = 100.0
    check_named_out(out, {".html": PAGE, ".htm": PAGE}, (axis, record, frf), force)
    with write_aside(out) as aside, progress_bar() as progress:
        report = assemble_report(
            axis,
            record,
            crossover=crossover,
            bandwidth=bandwidth,
            phase_margin_deg=phase_margin,
            design_on=design_on,
            model=model,
            chain=record_filter,
            k_e1=k_e1,
            hand=hand,
            environment=environment,
            mass=mass,
            damping=damping,
            filter=filter,
            mismatch=mismatch,
            retune=retune,
            frf=frf,
            progress=progress,
        )
        aside.write_text(report.page.html(), encoding="utf-8")
    document = {"out": str(out), **report.to_dict()}
    if as_json:
        print_json(document)
    else:
        say(out)
    for warning in report.warnings:
        tell(warning)
    if not as_json:
        say_advice(document)
    if report.reason:
        tell(f"{report.reason}; the page says so first")
        raise typer.Exit(UnstableError.exit_code)
