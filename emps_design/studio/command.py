"""Design interactively in a browser window, served on 127.0.0.1 only; Ctrl-C ends it."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.errors import InputError
from emps_design.inputs import axis_argument, read_record
from emps_design.request import Request, option
from emps_design.view import Line


@dataclass(frozen=True)
class StudioRequest(Request):
    """Options of ``studio``: the axis and the record to open, and the port."""

    axis: Axis = axis_argument("emps2018")
    record: Any = option(None, "record to open: .mat, .csv or .npz", typed=Path | None, read=read_record)
    port: int = option(0, "port on 127.0.0.1; 0: any free port", limits=(0, 65535))


def answer(request: StudioRequest) -> Reply:
    """The address of the studio, which is served after it is printed."""
    if find_spec("panel") is None:
        raise InputError(
            "studio: panel is not installed, expected the extra studio: pip install -e '.[studio]' in the clone"
        )
    from emps_design.studio.app import serve

    try:
        address, wait = serve(request.axis, request.record, request.port)
    except OSError as error:
        where = f"127.0.0.1:{request.port}"
        raise InputError(f"`port`: cannot listen on {where}, {error.strerror}; choose another port or 0") from error

    def until_interrupted() -> None:
        wait()
        raise KeyboardInterrupt  # the server handles Ctrl-C itself and returns

    view = (Line(f"emps-design studio: {address} (Ctrl-C ends it)", "code"),)
    return Reply({"address": address}, view, request.axis.units, then=until_interrupted)
