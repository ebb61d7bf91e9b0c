"""Read a drive's export as the [record] table of an axis says, and say what was taken for what."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from emps_design.commands.destinations import ARCHIVE, OVERWRITE, PAGE, PICTURES, TABLE, check_named_out

if TYPE_CHECKING:
    from emps_design.importing.account import Account

OUT = {".npz": ARCHIVE, ".csv": TABLE}
DRAWN = {**PICTURES, ".html": PAGE}


def command(
    file: Path = typer.Argument(..., metavar="FILE", help="What the drive wrote: .csv, .txt, .tsv, .npz or .mat."),
    axis: str = typer.Option(
        "emps2019", "--axis", help="TOML file with a [record] table, or embedded machine; without one titles are read."
    ),
    out: Path | None = typer.Option(None, "--out", help="Write the record, in SI units: .npz or .csv."),
    plot: Path | None = typer.Option(None, "--plot", help="Draw it into this file: .png, .svg, .pdf or .html."),
    window: str | None = typer.Option(None, "--time", metavar="A:B", help="Only from A to B [s] of the file's time."),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """Read a drive's export as the [record] table of an axis says, and say what was taken for what."""
    from emps_design.cli.output import load_axis, print_json, print_warnings
    from emps_design.importing import import_record
    from emps_design.importing.account import Account

    for option, path, kinds in (("--out", out, OUT), ("--plot", plot, DRAWN)):
        check_named_out(path, kinds, (axis, file), force, option)
    loaded = load_axis(axis)
    account = Account(import_record(file, loaded, resample=True, window=_window(window)), loaded)
    if out is not None:
        account.record.save(out)
    if plot is not None:
        _draw(plot, account)
    document = account.to_dict() | {"file": str(file), "out": None if out is None else str(out)}
    if as_json:
        print_json(document)
    else:
        _show(account, document)
    print_warnings(document["warnings"])


def _window(text: str | None) -> tuple[float, float] | None:
    from emps_design.errors import InputError

    if text is None:
        return None
    try:
        start, _, stop = text.partition(":")
        window = float(start or 0.0), float(stop or "inf")
    except ValueError as error:
        raise InputError(f"--time: found {text!r}, expected A:B [s], such as 0:3.2") from error
    if not window[0] < window[1]:
        raise InputError(f"--time: found {text!r}, expected A:B [s] with A before B")
    return window


def _draw(path: Path, account: Account) -> None:
    from emps_design.files import write_aside, write_text
    from emps_design.report.record import import_page, record_figure
    from emps_design.report.style import draw

    if path.suffix == ".html":
        write_text(path, import_page(account).html())
        return
    with write_aside(path) as aside:
        draw(record_figure(account.record, account.axis.units), aside, path.suffix[1:])


def _show(account: Account, document: dict[str, Any]) -> None:
    import sys

    from rich import box
    from rich.table import Table
    from rich.text import Text

    from emps_design.cli.output import new_console, say, show, sparkline
    from emps_design.errors import printable
    from emps_design.importing.account import HEADINGS

    record, units = account.record, account.axis.units
    console = new_console()
    table = Table(title=f"{document['file']}, read for {account.axis.name}", box=box.SIMPLE, pad_edge=False)
    for heading in HEADINGS:
        table.add_column(heading, justify="right" if heading in ("lowest", "highest") else "left")
    for title, *row in account.rows:
        table.add_row(Text(printable(title)), *row)  # as the file has it, in whatever words
    console.print(table)
    sampling, step = document["sampling"], document["encoder_step"]
    own = record.period == sampling["axis_period"]
    say(
        f"{len(record)} samples of {1e3 * record.period:.6g} ms{' (the axis has this period)' if own else ''}, "
        f"{record.duration:.6g} s{', resampled' if sampling['resampled'] else ''}"
    )
    if step["seen"] is not None:
        unit, factor = units.display(step["seen"], "m")
        say(f"encoder step seen in q: {factor * step['seen']:.4g} {unit}")
    encoding = sys.stdout.encoding or "ascii"
    for name in ("q_ref", "q", "u"):
        if name in record.columns:
            say(f"{name:>6} {sparkline(record.columns[name], encoding=encoding)}")
    if document["recognised"]:
        say("\nTitles were understood; put this into the axis file:\n")
        show(document["record_table"])
    if document["out"]:
        say(f"record: {document['out']}")
