"""The controller as code for a drive: C99, Structured Text or JSON, with the vectors that prove it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from emps_design.cli.design_options import AsJson, AxisArgument, Force
from emps_design.cli.destinations import AXIS, CODE, JSON, TABLE, check_folder
from emps_design.cli.output import print_json, say

KINDS = {".toml": AXIS, ".csv": TABLE, ".json": JSON}  # what else is code


def command(
    axis: AxisArgument,
    target: Annotated[str, typer.Option("--to", help="c, st or json")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder for the code, made where there is none")],
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    from emps_design.codegen import export_controller
    from emps_design.errors import InputError
    from emps_design.machines import load_axis

    check_folder(out, {}, (axis,), force)
    exported = export_controller(load_axis(axis), target)
    check_folder(out, {name: KINDS.get(Path(name).suffix, CODE) for name in exported.files}, (axis,), force)
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be made, {error.strerror}; expected a folder to write to") from error
    exported.write(out)
    document = {"out": str(out), **exported.to_dict()}
    if as_json:
        print_json(document)
    else:
        say(f"{out}: {', '.join(exported.files)}")
        vectors = document["vectors"]
        say(f"{vectors['rows']} vectors of the law {document['law']}, axis {document['axis']}")
