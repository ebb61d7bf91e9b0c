"""Show where simulation and data disagree, find the missing physical effect, and add it to the model."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import AXIS, JSON, PAGE, TABLE, make_folder
from emps_design.discrepancy.request import DiagnosisRequest
from emps_design.errors import EmpsError, InputError, one_line
from emps_design.files import write_aside, write_text, write_together
from emps_design.inputs import axis_option
from emps_design.interrupts import interrupted, on_interrupt
from emps_design.progress import Progress
from emps_design.request import option
from emps_design.view import Line

if TYPE_CHECKING:
    from emps_design.discrepancy import Diagnosis

FILES = {
    "model.toml": AXIS,
    "diagnosis.json": JSON,
    "holdout_prediction.csv": TABLE,
    "experiment.csv": TABLE,
    "closest_model.toml": AXIS,
    "report.html": PAGE,
}
PARTIAL = "emps-design/partial-diagnosis/1"  # schema of what an interrupted diagnosis writes


@dataclass(frozen=True)
class DiagnoseRequest(DiagnosisRequest):
    """Options of ``diagnose``: those of the function, and the folder for its files."""

    axis: Axis = axis_option("axis file or embedded machine")
    out: Path | None = option(None, "folder for model, report, prediction", metavar="DIR", writes=FILES)

    @property
    def axis_name(self) -> str:
        """The name or path of the axis, as the user wrote it."""
        return one_line(self.sources.get("axis", self.axis.name))


def check_same_records(out: Path, hashes: set[str]) -> None:
    """Raise :class:`InputError` if ``out`` has a diagnosis of records other than those with the ``hashes``."""
    path = out / "diagnosis.json"
    if not path.is_file() or not path.stat().st_size:
        return
    expected = "expected one of the same records or none; choose another folder, or give `overwrite`"
    try:
        existing = json.loads(path.read_text(encoding="utf-8"))
        trained = {entry["sha256"]: entry["name"] for entry in existing["records"] if entry["role"] == "train"}
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"`out`: {path} is not a readable diagnosis, {expected}") from error
    others = [name for sha256, name in trained.items() if sha256 not in hashes]
    if others:
        raise InputError(f"`out`: {out} holds the diagnosis of {', '.join(others)}, {expected}")


def answer(request: DiagnoseRequest) -> Reply:
    """The diagnosis; if interrupted, the folder does not change and the partial result is written next to it."""
    from emps_design.discrepancy import diagnose

    if request.out is not None and not request.overwrite:
        check_same_records(request.out, {record.sha256 for record in request.records})
    partial_result = PartialDiagnosis(request.out)
    tracked = replace(request, progress=partial_result.track(request.progress), searched=partial_result.keep_model)
    with on_interrupt(partial_result.write):
        diagnosis = diagnose(tracked)
    units = request.axis.units
    if request.out is None:
        document = diagnosis.to_dict()
        return Reply(document, diagnosis.view(), units, warnings=tuple(document["warnings"]))
    diagnosis = diagnosis.with_file("model.toml")
    document = diagnosis.to_dict()
    view = (*diagnosis.view(), *_written(document, request.out))
    write = partial(_write, diagnosis, request.out, request.axis_name)
    return Reply(document, view, units, warnings=tuple(document["warnings"]), write=write)


def _written(document: dict[str, Any], out: Path) -> list[Line]:
    """The files in the folder ``out``, and the command that simulates the experiment."""
    reference = (document["experiment"] or {}).get("file")
    closest = (document.get("closest") or {}).get("model_file")
    files = ("model.toml", "diagnosis.json", "holdout_prediction.csv", reference, closest)
    lines = [Line(f"Written: {out}/report.html, {', '.join(filter(None, files))}", "code")]
    if reference:
        command = f"emps-design simulate {out}/model.toml --reference {out}/{reference}"
        lines.append(Line(f"Simulate the experiment first: {command}", "code"))
    return lines


def _write(diagnosis: Diagnosis, out: Path, axis_name: str, document: str) -> None:
    """Write all files of the diagnosis into ``out``, or none if one fails; ``document`` is the text of its JSON."""
    from emps_design.discrepancy.closest import FILE as CLOSEST_FILE
    from emps_design.discrepancy.experiment import FILE
    from emps_design.report.diagnosis import diagnosis_page

    make_folder(out)
    trace, experiment = diagnosis.trace, diagnosis.experiment
    reference = None if experiment is None else experiment.q_ref
    closest = None if diagnosis.closest is None else diagnosis.closest.axis
    with write_together(out) as aside:
        per_record = f"values that belong to one record (phases, times) are those of {trace.name}"
        head = f"# {axis_name}, extended by emps-design diagnose; {per_record}\n"
        write_text(aside / "model.toml", head + diagnosis.axis.to_toml())
        write_text(aside / "diagnosis.json", document)
        columns = (trace.t, trace.measured, trace.baseline, trace.extended)
        _table(aside / "holdout_prediction.csv", ("t", "force_measured", "force_baseline", "force_extended"), columns)
        if experiment is not None and reference is not None:
            _table(aside / FILE, ("t", "q_ref"), (experiment.t, reference))
        if closest is not None:
            head = f"# {axis_name}, the closest description that emps-design diagnose found; {per_record}\n"
            write_text(aside / CLOSEST_FILE, head + closest.to_toml())
        write_text(aside / "report.html", diagnosis_page(diagnosis).html())
    if reference is None:
        (out / FILE).unlink(missing_ok=True)  # the file of an earlier diagnosis
    if closest is None:
        (out / CLOSEST_FILE).unlink(missing_ok=True)


def _table(path: Path, titles: Sequence[str], columns: Sequence[Any]) -> None:
    with write_aside(path) as aside, aside.open("w", newline="") as handle:
        rows = csv.writer(handle)
        rows.writerow(titles)
        rows.writerows([f"{value:.9g}" for value in row] for row in zip(*columns, strict=True))


class PartialDiagnosis:
    """State of a running diagnosis for the folder ``out``; :meth:`write` saves it in the folder ``out.partial``."""

    def __init__(self, out: Path | None):
        named = out is None or out.name not in ("", "..")
        self.folder = None if out is None else Path(f"{out if named else os.path.abspath(out)}.partial")
        self.stage, self.share = "reading", 0.0
        self.axis: Axis | None = None

    def track(self, progress: Progress) -> Progress:
        """Return a progress callback that updates ``progress`` and this state, and raises after an interrupt.

        Otherwise the search would ignore the interrupt and conclude from its present state.
        """

        def report(stage: str, share: float) -> None:
            self.stage, self.share = stage, share
            progress(stage, share)
            self._stop()

        return report

    def keep_model(self, axis: Axis) -> None:
        """Store the model at the end of the search."""
        self.axis = axis
        self._stop()

    def write(self) -> str:
        """Write the state and return a sentence with the folder, "" if there is none."""
        if self.folder is None:
            return ""
        document = {
            "schema": PARTIAL,
            "interrupted": True,
            "stage": self.stage,
            "share": self.share,
            "effects": [] if self.axis is None else [effect.kind for effect in self.axis.effects],
            "model_file": None if self.axis is None else "model.toml",
            "text": "The diagnosis was interrupted at this stage; nothing was confirmed, and more may be missing.",
        }
        try:
            self.folder.mkdir(exist_ok=True)
            with write_together(self.folder) as aside:
                write_text(aside / "partial.json", f"{json.dumps(document, indent=1)}\n")
                if self.axis is not None:
                    head = f"# from an interrupted diagnosis: {self.stage}\n"
                    write_text(aside / "model.toml", head + self.axis.to_toml())
        except (EmpsError, OSError) as error:
            return f"the partial result could not be written: {error}"
        return f"the partial result is in {self.folder}"

    def _stop(self) -> None:
        if interrupted.is_set():
            raise KeyboardInterrupt
