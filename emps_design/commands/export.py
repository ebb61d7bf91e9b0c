"""Write the controller as C99, Structured Text, FMI 3.0 units or JSON, with test vectors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from emps_design import codegen
from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import ARCHIVE, AXIS, CODE, JSON, TABLE, check_folder, make_folder
from emps_design.errors import InputError
from emps_design.files import read_json
from emps_design.inputs import axis_argument
from emps_design.request import HERTZ, Request, option
from emps_design.view import Line

MAX_BYTES = 1_000_000  # of a compensation
KINDS = {".toml": AXIS, ".csv": TABLE, ".json": JSON, ".fmu": ARCHIVE}  # any other file is code


@dataclass(frozen=True)
class ExportRequest(Request):
    """Options of ``export``: the axis, the target, the folder, and a feed-forward or an observer to export."""

    axis: Axis = axis_argument(...)
    target: str = option(..., "c, st, fmu or json", flags=("--to",))
    out: Path = option(..., "folder for the code, created if missing", metavar="DIR")
    compensation: Path | None = option(
        None, "compensation.json of 'compensate --out': adds its feed-forward", metavar="FILE"
    )
    observer: float | None = option(
        None, "export the on-line force observer with this low-pass [Hz] instead of the controller", **HERTZ
    )
    overwrites: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.observer is not None:
            self.refuse(["compensation"], "cannot be combined with `observer`")

    def check_folder(self, kinds: dict[str, str]) -> None:
        """Raise :class:`InputError` if the folder cannot be created or a file of it is not of its kind in ``kinds``."""
        check_folder(self.out, kinds, (self.sources.get("axis"), self.compensation), self.overwrite)


def answer(request: ExportRequest) -> Reply:
    """The files of the target, written into the folder, and a summary of their content."""
    request.check_folder({})
    exported = _exported(request)
    request.check_folder({name: KINDS.get(Path(name).suffix, CODE) for name in exported.files})
    make_folder(request.out)
    exported.write(request.out)
    document = {"out": str(request.out), **exported.to_dict()}
    view = (Line(f"{request.out}: {', '.join(exported.files)}"), *exported.view())
    return Reply(document, view, request.axis.units, warnings=tuple(document["warnings"]))


def _exported(request: ExportRequest) -> codegen.Exported:
    from emps_design.codegen.targets import origin_of

    feedforward = None if request.compensation is None else _read(request.compensation)
    file = Path(request.sources.get("axis", ""))
    origin = origin_of(file.name, file.read_bytes()) if file.is_file() else ""
    if request.observer is not None:
        return codegen.export_observer(request.axis, request.target, request.observer, origin)
    return codegen.export_controller(request.axis, request.target, feedforward, origin)


def _read(path: Path) -> dict[str, Any]:
    """Read the JSON document of a compensation; the library checks its content."""
    expected = "expected the compensation.json of 'compensate --out'"
    document = read_json(path, MAX_BYTES, expected)
    if not isinstance(document, dict):
        raise InputError(f"{path}: found {type(document).__name__}, {expected}")
    return document
