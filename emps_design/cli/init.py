"""A folder to start from: a commented axis file, synthetic records, and what to do with them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import typer

from emps_design.commands.destinations import ANYTHING, ARCHIVE, AXIS, TABLE, check_folder, make_folder

# `puzzle.npz` has a ripple that `axis.toml` lacks: its force [N] on an axis like emps2019, its period [m or rad].
AMPLITUDE, PERIOD = 2.0, {"linear": 0.0025, "rotary": 2.0 * math.pi / 500}

STARTER = """# Start here

`axis.toml` describes the machine and its controller; every key says what it is, in SI units. `record.npz` and
`record.csv` are one simulated run of it (columns t [s], q_ref [m], q [m], u [V]). Put your numbers into the axis file,
your measurement in the place of the record, and ask:

    emps-design identify record.npz --axis axis.toml          the parameters, with standard deviations
    emps-design gains axis.toml --crossover 100 --phase-margin 60   velocity-loop gains and margins
    emps-design report axis.toml --record record.npz --crossover 100 --out report.html
    emps-design diagnose puzzle.npz --axis axis.toml --out found    where simulation and data disagree, and why

`puzzle.npz` is a run of the same machine with something in it that `axis.toml` does not know of.

A .csv may use ; , or tab, a decimal comma, and titles with a unit such as `q [mm]`. Every command explains itself with
`--help` and prints JSON with `--json`.
"""

FILES = {"axis.toml": AXIS, "record.npz": ARCHIVE, "record.csv": TABLE, "puzzle.npz": ARCHIVE, "README.md": ANYTHING}


def command(
    directory: Path | None = typer.Argument(None, metavar="DIR", help="Folder to make or to fill."),
    trace: Path | None = typer.Option(
        None, "--from", metavar="TRACE", help="Write the axis file that this export of a drive tells, into DIR or here."
    ),
    machine: str | None = typer.Option(None, "--machine", help="Embedded machine or axis file to copy: emps2019."),
    seed: int | None = typer.Option(None, "--seed", min=0, help="Seed of the noise in the record: 0."),
    force: bool = typer.Option(False, "--force", help="Overwrite files of the same names."),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """A folder to start from: a commented axis file, synthetic records, and what to do with them."""
    from emps_design.cli.output import load_axis, print_json, say
    from emps_design.effects.sizes import sizes
    from emps_design.errors import InputError
    from emps_design.files import write_text, write_together
    from emps_design.simulation.synthetic import synthetic_record

    if trace is not None:
        if machine is not None or seed is not None:
            raise InputError("--from: found --machine or --seed beside it, expected the trace alone")
        _from_trace(trace, directory or Path("."), force, as_json)
        return
    if directory is None:
        raise typer.BadParameter("found no folder, expected DIR, or --from TRACE")
    machine, seed = machine or "emps2019", seed or 0
    check_folder(directory, FILES, (machine,), force=True)
    taken = [name for name in FILES if (directory / name).exists()]
    if taken and not force:
        raise InputError(f"{directory}: {', '.join(taken)} exist already; choose another folder, or give --force")
    axis = load_axis(machine)
    record = synthetic_record(axis, seed=seed)
    amplitude = AMPLITUDE * sizes(record.q, record.u, record.period, axis.drive.gain)["N"]
    ripple = {"kind": "position_ripple", "amplitude": amplitude, "period": PERIOD[axis.motion], "phase": 0.5}
    puzzle = synthetic_record(axis.replace(effects=[*axis.effects, ripple]), seed=seed + 1)
    make_folder(directory, parents=True)
    with write_together(directory) as aside:
        write_text(aside / "axis.toml", axis.to_toml(comments=True))
        record.save(aside / "record.npz")
        record.save(aside / "record.csv")
        puzzle.save(aside / "puzzle.npz")
        write_text(aside / "README.md", STARTER)
    if as_json:
        print_json({"directory": str(directory), "files": list(FILES), "record": record.to_dict(), "seed": seed})
    else:
        say(f"{directory}: {', '.join(FILES)}\nNext: read {directory / 'README.md'}")


def _from_trace(trace: Path, directory: Path, force: bool, as_json: bool) -> None:
    """Write ``directory``/axis.toml with what can be read from ``trace``, and list the keys that the user fills in."""
    from emps_design.cli.output import LOOKING, print_json, print_warnings, progress_bar, say
    from emps_design.errors import InputError
    from emps_design.files import write_text
    from emps_design.identification.controller import TOLD, identify_law
    from emps_design.importing.account import axis_text, read_trace

    check_folder(directory, {"axis.toml": AXIS}, (trace,), force=True)
    path = directory / "axis.toml"
    if path.exists() and not force:
        raise InputError(f"{directory}: axis.toml exists already; choose another folder, or give --force")
    export = read_trace(trace)
    law = None
    if export.record is not None and not export.guessed:
        with progress_bar() as progress:
            progress(LOOKING, 0.0)
            law = identify_law(export.record, export.units.command_unit)
    text = axis_text(export, law.to_toml() if law is not None and law.verdict == TOLD else "")
    make_folder(directory, parents=True)
    write_text(path, text)
    to_fill_in = re.findall(r"^# (\w+) = ", text, re.MULTILINE)
    record = export.record
    warnings = [export.reason] if export.reason else []
    warnings += [] if record is None else record.warnings
    if as_json:
        print_json(
            {
                "directory": str(directory),
                "files": ["axis.toml"],
                "record": None if record is None else record.to_dict(),
                "encoder_step": export.encoder_step,
                "command_limit": export.limit,
                "law": law,
                "to_fill_in": to_fill_in,
                "warnings": warnings,
            }
        )
    else:
        if law is not None:
            say(f"Controller: {law.verdict}{f', {law.reason}' if law.reason else ''}")
        say(f"{path}: fill in {', '.join(to_fill_in)}")
        say(f"Then: emps-design import {trace} --axis {path} --out record.npz")
    print_warnings(warnings)
