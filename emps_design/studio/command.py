"""The same, interactive, in a browser window served on 127.0.0.1 only; Ctrl-C ends it."""

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
    """What ``studio`` takes: the axis and the record that it opens with, and where it is served."""

    axis: Axis = axis_argument("emps2018")
    record: Any = option(None, "record to open: .mat, .csv or .npz", typed=Path | None, read=read_record)
    port: int = option(0, "port on 127.0.0.1; 0 takes a free one", limits=(0, 65535))


def answer(request: StudioRequest) -> Reply:
    """The address of the studio, which is served after it is printed."""
    if find_spec("panel") is None:
        raise InputError(
            "studio: found no panel in this environment, expected the extra: pip install -e '.[studio]' in the clone"
        )
    from emps_design.studio.app import serve

    try:
        address, wait = serve(request.axis, request.record, request.port)
    except OSError as error:
        where = f"127.0.0.1:{request.port}"
        raise InputError(f"`port`: cannot listen on {where}, {error.strerror}; choose another or 0") from error

    def until_interrupted() -> None:
        wait()
        raise KeyboardInterrupt  # the server handles Ctrl-C itself, and nothing else ends it

    view = (Line(f"emps-design studio: {address} (Ctrl-C ends it)", "code"),)
    return Reply({"address": address}, view, request.axis.units, then=until_interrupted)
