"""Which controller made a record: structure and gains from reference, position and command alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from emps_design.commands.destinations import CONTROLLER, OVERWRITE, check_out

if TYPE_CHECKING:
    from emps_design.identification.controller import LawEstimate


def command(
    records: list[Path] = typer.Argument(
        ..., metavar="RECORD...", help="One or several records of one controller: .mat, .csv, .npz, or drives' exports."
    ),
    axis: str = typer.Option(
        "emps2019", "--axis", help="TOML file or embedded machine: how its records are read. [controller] is not."
    ),
    out: Path | None = typer.Option(None, "--out", help="Write the [controller] table to this TOML file."),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    from emps_design.axis import Axis
    from emps_design.cli.output import (
        LOOKING,
        add_advice,
        load_axis,
        print_json,
        print_warnings,
        progress_bar,
        say_advice,
    )
    from emps_design.errors import InputError
    from emps_design.files import write_text
    from emps_design.identification.controller import identify_law
    from emps_design.importing import import_record
    from emps_design.laws import NONE

    check_out(out, CONTROLLER, (axis, *records), force)
    loaded = load_axis(axis)
    loaded = Axis.from_dict({**loaded.to_dict(), "controller": {"kind": NONE}}, loaded.name)
    read = [import_record(record, loaded) for record in records]
    with progress_bar() as progress:
        progress(LOOKING, 0.0)
        estimate = identify_law(read, loaded.drive.command_unit)
    if out is not None and estimate.controller is None:
        raise InputError(f"{estimate.record}: {estimate.reason}; {out} is not written")
    if out is not None:
        write_text(out, estimate.to_toml())
    document = add_advice(estimate.to_dict(), axis, records)
    if as_json:
        print_json(document)
    else:
        _show(estimate)
    print_warnings(estimate.warnings)
    if not as_json:
        say_advice(document)


def _show(estimate: LawEstimate) -> None:
    from rich import box
    from rich.table import Table

    from emps_design.cli.output import new_console, say

    console = new_console()
    console.print(estimate.verdict, style="bold", end="")
    console.print(f"  {estimate.reason}" if estimate.reason else "", highlight=False)
    if estimate.controller is not None:
        say()
        say(estimate.to_toml())
        table = Table(box=box.SIMPLE, pad_edge=False)
        for heading in ("number", "value", "std", "std [%]"):
            table.add_column(heading, justify="left" if heading == "number" else "right", no_wrap=True)
        for name, value, std in estimate.numbers:
            percent = f"{abs(100 * std / value):.2g}" if value else ""
            table.add_row(name, f"{value:.7g}", f"{std:.2g}", percent)
        console.print(table)
    elif estimate.closest is not None:
        say(f"the closest law, which is not the machine's: {estimate.closest_in_words}")
    if estimate.residual_rms is not None and estimate.residual_share is not None:
        rms = f"{estimate.residual_rms:.4g} {estimate.command_unit}".rstrip()
        share = 100 * estimate.residual_share
        own = f"; the record allows {estimate.allowed_rms:.4g}" if estimate.allowed_rms is not None else ""
        console.print(f"leaves {rms} rms, {share:.3g} % of the command's deviation{own}", highlight=False)
    for note in estimate.notes:
        console.print(note, highlight=False)
    if len(estimate.tried) > 1:
        table = Table(box=box.SIMPLE, pad_edge=False, title="tried")
        table.add_column("structure", overflow="fold")
        for heading in (f"left, whitened [{estimate.command_unit}]", "criterion", "apart [std]"):
            table.add_column(heading, justify="right", no_wrap=True)
        for candidate in estimate.tried:
            apart = f"{candidate['apart']:.1f}"
            table.add_row(
                candidate["terms"], f"{candidate['residual_rms']:.4g}", f"{candidate['criterion']:+.1f}", apart
            )
        console.print(table)
