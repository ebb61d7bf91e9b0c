"""The controller as code: C99, Structured Text, units of FMI 3.0 or JSON, with the vectors that prove it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from emps_design.cli.options import HERTZ, AsJson, AxisArgument, Force, refuse_ignored
from emps_design.cli.output import load_axis, print_json, print_warnings, say
from emps_design.commands.destinations import ARCHIVE, AXIS, CODE, JSON, TABLE, check_folder, make_folder

MAX_BYTES = 1_000_000  # of a compensation
KINDS = {".toml": AXIS, ".csv": TABLE, ".json": JSON, ".fmu": ARCHIVE}  # any other file is code


def command(
    context: typer.Context,
    axis: AxisArgument,
    target: Annotated[str, typer.Option("--to", help="c, st, fmu or json")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder for the code, made where there is none")],
    compensation: Annotated[
        Path | None, typer.Option(metavar="FILE", help="compensation.json of 'compensate --out': fed forward beside it")
    ] = None,
    observer: Annotated[
        float | None,
        typer.Option(**HERTZ, help="the on-line force observer with this low-pass [Hz], in place of the controller"),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    from emps_design.codegen import export_controller, export_observer
    from emps_design.codegen.targets import OPERATIONS, origin_of

    if observer is not None:
        refuse_ignored(context, ["compensation"], "goes without --observer")
    check_folder(out, {}, (axis, compensation), force)
    feedforward = None if compensation is None else _read(compensation)
    machine = load_axis(axis)
    origin = origin_of(Path(axis).name, Path(axis).read_bytes()) if Path(axis).is_file() else ""
    if observer is not None:
        exported = export_observer(machine, target, observer, origin)
    else:
        exported = export_controller(machine, target, feedforward, origin)
    kinds = {name: KINDS.get(Path(name).suffix, CODE) for name in exported.files}
    check_folder(out, kinds, (axis, compensation), force)
    make_folder(out)
    exported.write(out)
    document = {"out": str(out), **exported.to_dict()}
    if as_json:
        print_json(document)
    else:
        say(f"{out}: {', '.join(exported.files)}")
        vectors = document["vectors"]
        say(f"{vectors['rows']} vectors of the law {document['law']}, axis {document['axis']}")
        say("one step: " + ", ".join(f"{n} {OPERATIONS[kind]}" for kind, n in document["operations"].items()))
        drives = document["drives"]
        if drives:
            side = "motor's" if drives[0]["side"] == "motor" else "axis's own"
            say(f"the same gains by the names of common drives, on the {side} side:")
        for row in drives:
            say(f"{row['family']}: {row['parameter']} = {row['value']:.6g} {row['unit']} ({row['gain']})")
    print_warnings(document["warnings"])


def _read(path: Path) -> dict[str, Any]:
    """Read the JSON document of a compensation; the library checks its content."""
    from emps_design.errors import InputError
    from emps_design.files import read_bytes

    expected = "expected the compensation.json of 'compensate --out'"
    try:
        document = json.loads(read_bytes(path, MAX_BYTES, expected))
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON, {expected}") from error
    if not isinstance(document, dict):
        raise InputError(f"{path}: found {type(document).__name__}, {expected}")
    return document
