"""The main job on the embedded machine, no file needed: simulate a record, identify, gains, force loop, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from emps_design.commands.destinations import ARCHIVE, OVERWRITE, PAGE, check_out

if TYPE_CHECKING:
    from emps_design.report.assemble import Report

MACHINE = "emps2019"
CROSSOVER, PHASE_MARGIN = 100.0, 60.0  # rad/s, deg


def command(
    out: Path = typer.Option(Path("emps-design-demo.html"), "--out", help="HTML report; the record goes beside it."),
    seed: int = typer.Option(0, "--seed", min=0, help="Seed of the noise in the record."),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """The main job on the embedded machine, no file needed: simulate a record, identify, gains, force loop, report."""
    from emps_design.cli.output import print_json, print_warnings, progress_bar, say
    from emps_design.errors import InputError
    from emps_design.files import write_text
    from emps_design.machines import machine
    from emps_design.report.assemble import assemble_report, usual_force_loop
    from emps_design.simulation.synthetic import synthetic_record

    axis = machine(MACHINE)
    k_e1, wall = usual_force_loop(axis)
    check_out(out, PAGE, (), force)
    record_file = out.with_suffix(".npz")
    if out.suffix == record_file.suffix:
        raise InputError(f"--out: found {out.name!r}, expected a name for a page; the record takes that one")
    check_out(record_file, ARCHIVE, (), force)
    with progress_bar() as progress:
        progress("simulating a record of the machine", 0.0)
        synthetic_record(axis, seed=seed).save(record_file)
        report = assemble_report(
            record=record_file,
            crossover=CROSSOVER,
            phase_margin_deg=PHASE_MARGIN,
            k_e1=k_e1,
            environment=wall,
            progress=progress,
        )
        write_text(out, report.page.html())
    truth = dict(zip(("mass", "viscous", "coulomb", "constant_force"), map(float, axis.mechanics.array()), strict=True))
    document = {"machine": MACHINE, "seed": seed, "truth": truth, "record": str(record_file), "out": str(out)}
    if as_json:
        print_json({**document, **report.to_dict()})
    else:
        _show(report, truth, record_file)
    print_warnings(report.warnings)
    if not as_json:
        say(f"\nThe report, with all figures: {out.resolve()}")


def _show(report: Report, truth: dict[str, float], record_file: Path) -> None:
    from rich.table import Table

    from emps_design.cli.output import new_console, say

    velocity, force, identification = report.results.velocity, report.results.force, report.identifications[0]
    assert force is not None
    console = new_console()
    say(f"1. A record of {MACHINE}, simulated: {record_file}")
    table = Table(title="2. Identified from the record", title_justify="left")
    for heading in ("parameter", "simulated with", "found", "std", "unit"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for name, estimate in identification.parameters.items():
        table.add_row(
            name, f"{truth[name]:.4f}", f"{estimate.value:.4f}", f"{estimate.std:.4f}", estimate.quantity.unit
        )
    console.print(table)
    design = velocity.to_dict()
    plant_input, sampled = design["plant_input"], design["sampled"]
    say(
        f"3. Velocity loop for a crossover of {CROSSOVER:g} rad/s and a phase margin of {PHASE_MARGIN:g} deg:\n"
        f"   k_v1 = {design['k_v1']:.2f} V/(m/s), t_v = {1e3 * design['t_v']:.3f} ms; closed-loop bandwidth "
        f"{design['bandwidth']:.1f} rad/s\n"
        f"   at the plant input: phase margin {plant_input['phase_margin_deg']:.1f} deg, delay margin "
        f"{1e3 * plant_input['delay_margin']:.2f} ms\n"
        f"   sampled every {1e3 * velocity.axis.sampling.period:g} ms: "
        + (f"stable, phase margin {sampled['phase_margin_deg']:.1f} deg" if sampled["stable"] else "unstable")
    )
    largest = force.to_dict()["k_e1_max"]["sampled"]
    say(
        f"4. Force loop with k_e1 = {force.k_e1:g} (m/s)/N: {'stable' if force.worst.margins.stable else 'unstable'}; "
        f"largest k_e1 for the sampled loop {'unbounded' if largest is None else f'{largest:.4g} (m/s)/N'}"
    )
