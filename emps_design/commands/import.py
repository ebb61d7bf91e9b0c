"""Read a drive's export by the [record] table of an axis, and show what each column stands for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import ARCHIVE, PAGE, PICTURES, TABLE
from emps_design.errors import InputError
from emps_design.files import write_aside, write_text
from emps_design.inputs import axis_option
from emps_design.request import Request, option
from emps_design.view import Line

if TYPE_CHECKING:
    from emps_design.importing.account import Account


def read_window(text: str) -> tuple[float, float]:
    """Start and end [s] from ``A:B``, either of which may be missing.

    >>> read_window("1:3.2"), read_window(":3")
    ((1.0, 3.2), (0.0, 3.0))
    """
    try:
        start, _, stop = text.partition(":")
        window = float(start or 0.0), float(stop or "inf")
    except ValueError as error:
        raise InputError(f"found {text!r}, expected A:B [s], such as 0:3.2") from error
    if not window[0] < window[1]:
        raise InputError(f"found {text!r}, expected A:B [s] with A before B")
    return window


@dataclass(frozen=True)
class ImportRequest(Request):
    """Options of ``import``: the drive's export, the axis with the [record] table, and the output files."""

    file: Path = option(..., "the drive's export: .csv, .txt, .tsv, .npz or .mat", argument=True, metavar="FILE")
    axis: Axis = axis_option("TOML file or embedded machine; without a [record] table the column titles decide")
    out: Path | None = option(
        None, "write the record, in SI units: .npz or .csv", writes={".npz": ARCHIVE, ".csv": TABLE}
    )
    plot: Path | None = option(
        None, "plot the record to this file: .png, .svg, .pdf or .html", writes={**PICTURES, ".html": PAGE}
    )
    window: tuple[float, float] | None = option(
        None,
        "only the part from A to B [s], in the file's time",
        flags=("--time",),
        metavar="A:B",
        typed=str | None,
        parse=read_window,
    )


def answer(request: ImportRequest) -> Reply:
    """The account of the import; the record is written and plotted to the files of the request, if any."""
    from emps_design.importing import import_record
    from emps_design.importing.account import Account

    record = import_record(request.file, request.axis, window=request.window)
    account = Account(record, request.axis)
    view = account.view()
    if request.out is not None:
        record.save(request.out)
        view += (Line(f"record: {request.out}"),)
    if request.plot is not None:
        _draw(request.plot, account)
    out = None if request.out is None else str(request.out)
    document = account.to_dict() | {"file": str(request.file), "out": out}
    return Reply(document, view, request.axis.units, warnings=account.notes)


def _draw(path: Path, account: Account) -> None:
    from emps_design.report.record import import_page, record_figure
    from emps_design.report.style import draw

    if path.suffix == ".html":
        write_text(path, import_page(account).html())
        return
    with write_aside(path) as aside:
        draw(record_figure(account.record, account.axis.units), aside, path.suffix[1:])
