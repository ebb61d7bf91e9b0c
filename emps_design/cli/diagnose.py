"""Where simulation and data disagree, which physical effect is missing, and the model with it."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from emps_design.cli.interrupts import PartialDiagnosis, on_interrupt
from emps_design.cli.options import refuse_force
from emps_design.cli.output import (
    add_advice,
    json_text,
    load_axis,
    new_console,
    print_json,
    print_warnings,
    progress_bar,
    say_advice,
)
from emps_design.commands.destinations import AXIS, JSON, OVERWRITE, PAGE, TABLE, check_folder, make_folder
from emps_design.errors import InputError, one_line
from emps_design.files import write_aside, write_text, write_together
from emps_design.quantities import rounded, share_asked

if TYPE_CHECKING:
    from emps_design.records import Record

FILES = {
    "model.toml": AXIS,
    "diagnosis.json": JSON,
    "holdout_prediction.csv": TABLE,
    "experiment.csv": TABLE,
    "closest_model.toml": AXIS,
    "report.html": PAGE,
}


def command(
    context: typer.Context,
    records: Annotated[list[Path], typer.Argument(metavar="RECORD...", help="records of one axis (.mat, .csv, .npz)")],
    axis: Annotated[str, typer.Option(help="axis file or embedded machine")] = "emps2019",
    holdout: Annotated[
        Path | None, typer.Option(help="a record to confirm on, opened once, at the end; by default a part of RECORD")
    ] = None,
    fit_time: Annotated[str | None, typer.Option(metavar="A:B", help="fit on this interval only [s]")] = None,
    confirm_time: Annotated[str | None, typer.Option(metavar="C:D", help="confirm on this interval [s]")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="folder for model, report, prediction")] = None,
    seed: Annotated[int, typer.Option(min=0, help="seed of the healthy reference")] = 0,
    healthy_runs: Annotated[
        int,
        typer.Option(
            min=0, max=100_000, help="calibrate on so many simulated records, searched like this one (199: minutes)"
        ),
    ] = 0,
    closest_model: Annotated[
        bool, typer.Option("--closest-model", help="also look for the model that follows most closely, cause or not")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help=OVERWRITE)] = False,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON document on standard output")] = False,
) -> None:
    from emps_design.discrepancy import diagnose
    from emps_design.importing import import_record

    refuse_force(context, out)
    check_folder(out, FILES, (axis, *records, holdout), force)
    if holdout is not None and confirm_time is not None:
        raise InputError("give --holdout or --confirm-time, not both")
    machine = load_axis(axis)
    read = [import_record(path, machine) for path in records]
    held_out = None if holdout is None else import_record(holdout, machine)
    _check_same_records(out, read, force)
    partial = PartialDiagnosis(out)
    with progress_bar() as bar, on_interrupt(partial.write):
        diagnosis = diagnose(
            read,
            machine,
            holdout=held_out,
            fit_time=_window(fit_time, "--fit-time"),
            confirm_time=_window(confirm_time, "--confirm-time"),
            seed=seed,
            searches=healthy_runs,
            progress=partial.track(bar),
            searched=partial.keep_model,
            closest=closest_model,
        )
    if out is not None:
        diagnosis = diagnosis.with_file("model.toml")
    document = add_advice(diagnosis.to_dict(), axis, records)
    if out is not None:
        _write(diagnosis, document, out, axis)
    if as_json:
        print_json(document)
    else:
        _show(document, out)
    print_warnings(document["warnings"])
    if not as_json:
        say_advice(document)


def _window(text: str | None, option: str) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        start, stop = (float(part) for part in text.split(":"))
    except ValueError as error:
        raise InputError(f"{option}: found {text!r}, expected START:STOP in seconds, such as 0:18.7") from error
    if not start < stop:
        raise InputError(f"{option}: found {text!r}, expected a start before the stop")
    return start, stop


def _check_same_records(out: Path | None, records: Sequence[Record], force: bool) -> None:
    """Refuse, without ``force``, to replace a diagnosis in ``out`` that was made of other records than ``records``."""
    path = None if out is None else out / "diagnosis.json"
    if path is None or force or not path.is_file() or not path.stat().st_size:
        return
    try:
        existing = json.loads(path.read_text(encoding="utf-8"))
        trained = {entry["sha256"]: entry["name"] for entry in existing["records"] if entry["role"] == "train"}
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"--out: {path} is no diagnosis that can be read, expected one of the same records or none; choose another "
            "folder, or give --force"
        ) from error
    others = [name for sha256, name in trained.items() if sha256 not in {record.sha256 for record in records}]
    if others:
        raise InputError(
            f"--out: {out} holds the diagnosis of {', '.join(others)}, expected one of the same records or none; "
            "choose another folder, or give --force"
        )


def _write(diagnosis: Any, document: dict[str, Any], out: Path, axis: str) -> None:
    """Write all files of the diagnosis into ``out``, or none if one fails."""
    from emps_design.discrepancy.closest import FILE as CLOSEST_FILE
    from emps_design.discrepancy.experiment import FILE
    from emps_design.report.diagnosis import diagnosis_page

    make_folder(out)
    trace, closest_axis = diagnosis.trace, diagnosis.closest and diagnosis.closest.axis
    with write_together(out) as aside:
        whose = f"numbers that belong to one record (phases, times) are those of {trace.name}"
        head = f"# {one_line(axis)}, extended by emps-design diagnose; {whose}\n"
        write_text(aside / "model.toml", head + diagnosis.axis.to_toml())
        write_text(aside / "diagnosis.json", f"{json_text(document)}\n")
        columns = (trace.t, trace.measured, trace.baseline, trace.extended)
        _table(aside / "holdout_prediction.csv", ("t", "force_measured", "force_baseline", "force_extended"), columns)
        if diagnosis.experiment is not None and diagnosis.experiment.q_ref is not None:
            experiment = diagnosis.experiment
            _table(aside / experiment.file, ("t", "q_ref"), (experiment.t, experiment.q_ref))
        if closest_axis is not None:
            describes = f"# {one_line(axis)}, described by emps-design diagnose as closely as it could; {whose}\n"
            write_text(aside / CLOSEST_FILE, describes + closest_axis.to_toml())
        write_text(aside / "report.html", diagnosis_page(diagnosis).html())
    if diagnosis.experiment is None or diagnosis.experiment.q_ref is None:
        (out / FILE).unlink(missing_ok=True)  # of a diagnosis before this one
    if closest_axis is None:
        (out / CLOSEST_FILE).unlink(missing_ok=True)


def _table(path: Path, titles: Sequence[str], columns: Sequence[Any]) -> None:
    with write_aside(path) as aside, aside.open("w", newline="") as handle:
        rows = csv.writer(handle)
        rows.writerow(titles)
        rows.writerows([f"{value:.9g}" for value in row] for row in zip(*columns, strict=True))


def _share(confirmed: dict[str, float] | None) -> str:
    """The share of an effect that the held-out record confirms, with its deviation; "-" without one."""
    return share_asked(confirmed["share"], confirmed["std"]) if confirmed else "-"


def _show(document: dict[str, Any], out: Path | None) -> None:
    from rich.table import Column, Table

    console = new_console()
    console.print(document["verdict"], style="bold", end="  ")
    console.print(document["sentence"], highlight=False)
    if document["findings"]:
        any_confirmed = any(finding["confirmed"] for finding in document["findings"])
        gaps = [Column(head, no_wrap=True) for head in ("gap before [N]", "after [N]")]  # a unit stays in one line
        table = Table("effect", "or", "where", *gaps, "confirmed" if any_confirmed else "p")
        for finding in document["findings"]:
            table.add_row(
                finding["label"],
                ", ".join(finding["equivalents"]) or "-",
                finding["where"]["text"],
                rounded(finding["gap_before"], 3),
                rounded(finding["gap_after"], 3),
                _share(finding["confirmed"]) if any_confirmed else f"{finding['p_value']:.3f}",
            )
        console.print(table, width=min(80, console.width))
    if document.get("experiment"):
        console.print(f"Next experiment: {document['experiment']['text']}", highlight=False)
    closest = document.get("closest")
    if closest:
        console.print(f"Closest model: {closest['text']}", highlight=False)
    for remedy in document["remedies"]:
        console.print(f"Remedy: {remedy}", highlight=False)
    if out is not None:
        reference = (document["experiment"] or {}).get("file")
        more = [name for name in (reference, (closest or {}).get("model_file")) if name]
        written = ["model.toml", "diagnosis.json", "holdout_prediction.csv", *more]
        console.print(f"Written: {out}/report.html, {', '.join(written)}")
        if reference:
            try_it = f"emps-design simulate {out}/model.toml --reference {out}/{reference}"
            console.print(f"Try the experiment first: {try_it}", highlight=False, soft_wrap=True)
