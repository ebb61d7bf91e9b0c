"""Make a folder to start from: a commented axis file, synthetic records, and a guide to the next commands."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import ANYTHING, ARCHIVE, AXIS, TABLE, check_folder, make_folder
from emps_design.errors import InputError
from emps_design.files import write_text, write_together
from emps_design.inputs import axis_option
from emps_design.messages import warning
from emps_design.progress import LOOKING
from emps_design.request import Request, option
from emps_design.view import Line

if TYPE_CHECKING:
    from emps_design.identification.controller import LawEstimate
    from emps_design.importing.account import Trace

# Ripple in `puzzle.npz` that `axis.toml` lacks: force [N] for an axis of the size of emps2019, and period [m or rad].
AMPLITUDE, PERIOD = 2.0, {"linear": 0.0025, "rotary": 2.0 * math.pi / 500}

STARTER = """# Start here

`axis.toml` describes the machine and its controller; a comment explains each key, in SI units. `record.npz` and
`record.csv` hold the same simulated run (columns t [s], q_ref [m], q [m], u [V]). Enter your numbers in the axis file,
replace the record by your measurement, and run:

    emps-design identify record.npz --axis axis.toml          the parameters, with standard deviations
    emps-design gains axis.toml --crossover 100 --phase-margin 60   velocity-loop gains and margins
    emps-design report axis.toml --record record.npz --crossover 100 --out report.html
    emps-design diagnose puzzle.npz --axis axis.toml --out found    where simulation and data disagree, and why

`puzzle.npz` is a run of the same machine with an effect that `axis.toml` lacks.

A .csv may use ; , or tab, a decimal comma, and titles with a unit such as `q [mm]`. `--help` explains a command, and
`--json` prints its result as JSON.
"""

AXIS_FILE = "axis.toml"
FILES = {AXIS_FILE: AXIS, "record.npz": ARCHIVE, "record.csv": TABLE, "puzzle.npz": ARCHIVE, "README.md": ANYTHING}


@dataclass(frozen=True)
class InitRequest(Request):
    """Options of ``init``: a folder, and a machine to copy or a trace to read."""

    directory: Path | None = option(None, "folder to create or to fill", argument=True, metavar="DIR")
    trace: Path | None = option(
        None,
        "make an axis file from this export of a drive, in DIR or here",
        flags=("--from",),
        metavar="TRACE",
    )
    machine: Axis = axis_option("embedded machine or axis file to copy")
    seed: int = option(0, "seed of the noise in the record", limits=(0, None))
    overwrites: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.trace is not None:
            self.refuse(["machine", "seed"], "cannot be combined with `trace`; the trace alone describes the axis")
        elif self.directory is None:
            raise InputError("found no folder, expected DIR, or `trace` TRACE")

    def folder(self, files: dict[str, str], source: str | Path | None) -> Path:
        """The output folder; raises :class:`InputError` if ``files`` (name to kind) must not be overwritten."""
        folder = self.directory or Path(".")
        check_folder(folder, files, (source,), force=True)
        existing = [name for name in files if (folder / name).exists()]
        if existing and not self.overwrite:
            exist = f"{', '.join(existing)} exist{'s' if len(existing) == 1 else ''}"
            raise InputError(f"{folder}: {exist} already; choose another folder, or give `overwrite`")
        return folder


def answer(request: InitRequest) -> Reply:
    """The folder with its files, or the axis file made from a trace."""
    if request.trace is not None:
        return _from_trace(request, request.trace)
    from emps_design.effects.sizes import sizes
    from emps_design.simulation.synthetic import synthetic_record

    axis, seed = request.machine, request.seed
    folder = request.folder(FILES, request.sources.get("machine"))
    record = synthetic_record(axis, seed=seed)
    amplitude = AMPLITUDE * sizes(record.q, record.u, record.period, axis.drive.gain)["N"]
    ripple = {"kind": "position_ripple", "amplitude": amplitude, "period": PERIOD[axis.motion], "phase": 0.5}
    puzzle = synthetic_record(axis.replace(effects=[*axis.effects, ripple]), seed=seed + 1)
    make_folder(folder, parents=True)
    with write_together(folder) as aside:
        write_text(aside / AXIS_FILE, axis.to_toml(comments=True))
        record.save(aside / "record.npz")
        record.save(aside / "record.csv")
        puzzle.save(aside / "puzzle.npz")
        write_text(aside / "README.md", STARTER)
    document = {"directory": str(folder), "files": list(FILES), "record": record.to_dict(), "seed": seed}
    view = (Line(f"{folder}: {', '.join(FILES)}"), Line(f"Next: read {folder / 'README.md'}"))
    return Reply(document, view, axis.units)


def _from_trace(request: InitRequest, path: Path) -> Reply:
    """The axis file with everything that the trace gives, and the keys that the user must fill in."""
    from emps_design.identification.controller import TOLD
    from emps_design.importing.account import axis_text, read_trace

    folder = request.folder({AXIS_FILE: AXIS}, path)
    export = read_trace(path)
    law = _law(request, export)
    text = axis_text(export, law.to_toml() if law is not None and law.verdict == TOLD else "")
    make_folder(folder, parents=True)
    write_text(folder / AXIS_FILE, text)
    to_fill_in = re.findall(r"^# (\w+) = ", text, re.MULTILINE)
    record = export.record
    warnings = [warning("trace-not-read", export.reason)] if export.reason else []
    warnings += [] if record is None else record.warnings
    document = {
        "directory": str(folder),
        "files": [AXIS_FILE],
        "record": None if record is None else record.to_dict(),
        "encoder_step": export.encoder_step,
        "command_limit": export.limit,
        "law": None if law is None else law.to_dict(),
        "to_fill_in": to_fill_in,
        "warnings": warnings,
    }
    controller = [] if law is None else [f"Controller: {law.verdict}{f', {law.reason}' if law.reason else ''}"]
    axis_file = folder / AXIS_FILE
    view = (
        *map(Line, controller),
        Line(f"{axis_file}: fill in {', '.join(to_fill_in)}"),
        Line(f"Then: emps-design import {path} --axis {axis_file} --out record.npz"),
    )
    return Reply(document, view, export.units, warnings=tuple(warnings))


def _law(request: InitRequest, export: Trace) -> LawEstimate | None:
    """The controller that made the trace; None if reading the trace took guesses."""
    from emps_design.identification.controller import identify_law

    if export.record is None or export.guessed:
        return None
    request.progress(LOOKING, 0.0)
    return identify_law(export.record, export.units)
