"""Observe the external force of a record, off-line and on-line."""

from __future__ import annotations

from pathlib import Path

import typer


def command(
    record: Path = typer.Argument(..., metavar="RECORD", help="Record file: .mat, .csv or .npz."),
    axis: str = typer.Option("emps2019", "--axis", help="TOML file or embedded machine with identified parameters."),
    cutoff: float = typer.Option(20.0, "--cutoff", help="Low-pass of the on-line observer [Hz]; Kalman: twice that."),
    offline_cutoff: float = typer.Option(60.0, "--offline-cutoff", help="Zero-phase low-pass off-line [Hz]."),
    out: Path | None = typer.Option(None, "--out", help="Write the observed forces to this .csv file."),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """Observe the external force of a record, off-line and on-line."""
    import sys

    from emps_design.cli.output import print_json
    from emps_design.identification.observation import observe
    from emps_design.machines import load_axis
    from emps_design.records import read_record

    found = observe(read_record(record), load_axis(axis), cutoff_hz=cutoff, offline_cutoff_hz=offline_cutoff)
    if out is not None:
        _write(out, found)
    if as_json:
        print_json(found)
    else:
        _show(found)
    for warning in found.warnings:
        print(f"emps-design: {warning}", file=sys.stderr)


def _write(out: Path, found) -> None:
    import numpy as np

    from emps_design.files import write_text

    names = ["t [s]", *(f"{name} [N]" for name in found.methods)]
    rows = np.column_stack([found.t, *(result.force for result in found.methods.values())])
    lines = [",".join(names), *(",".join(f"{value:.6f}" for value in row) for row in rows)]
    write_text(out, "\n".join(lines) + "\n")


def _show(found) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(title=f"External force of {found.record}, axis {found.axis}", box=box.SIMPLE)
    table.add_column("method")
    for heading in ("rms error [N]", "away from edges [N]", "delay [ms]", "rise [ms]", "plateau", "smallest [N]"):
        table.add_column(heading, justify="right")
    for name, result in found.methods.items():
        steps = result.steps
        rise = steps.rise_time if steps is not None else None
        table.add_row(
            name,
            "" if result.rms_error is None else f"{result.rms_error:.2f}",
            "" if steps is None else f"{steps.rms_error_away_from_edges:.2f}",
            f"{1e3 * result.delay:.2f}",
            "" if rise is None else f"{1e3 * rise:.1f}",
            "" if steps is None else f"{steps.plateau_error_percent:+.2f} %",
            f"{result.smallest.value:.1f}",
        )
    console.print(table)
    for name, result in found.methods.items():
        bounds = ", ".join(
            f"{bound.replace('_', '-')} {value:.2f} N" for bound, value in result.smallest.bounds.items()
        )
        console.print(
            f"{name}: smallest force {result.smallest.value:.2f} N, set by {result.smallest.bound} ({bounds})"
        )
