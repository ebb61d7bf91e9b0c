"""Identify the controller that made a record: structure and gains, from reference, position and command only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import CONTROLLER
from emps_design.errors import InputError
from emps_design.files import write_text
from emps_design.inputs import read_axis, read_record
from emps_design.laws import NONE
from emps_design.progress import LOOKING
from emps_design.records import Record
from emps_design.request import Request, option


def read_bare_axis(name_or_path: str | Path, axis: Axis | None = None) -> Axis:
    """The embedded machine or axis file of that name, without its controller."""
    loaded = read_axis(name_or_path)
    return Axis.from_dict({**loaded.to_dict(), "controller": {"kind": NONE}}, loaded.name)


@dataclass(frozen=True)
class LawRequest(Request):
    """Options of ``law``: records of one controller, and the axis for reading them."""

    records: tuple[Record, ...] = option(
        ...,
        "one or several records of the same controller: .mat, .csv, .npz, or drives' exports",
        argument=True,
        metavar="RECORD...",
        typed=list[Path],
        read=read_record,
    )
    axis: Axis = option(
        "emps2019",
        "TOML file or embedded machine, for reading the records; its [controller] is ignored",
        typed=str,
        read=read_bare_axis,
    )
    out: Path | None = option(None, "write the [controller] table to this TOML file", writes=CONTROLLER)


def answer(request: LawRequest) -> Reply:
    """The controller with standard deviations of its gains, or the reason why it is not identified."""
    from emps_design.identification.controller import identify_law

    request.progress(LOOKING, 0.0)
    units = request.axis.units
    estimate = identify_law(request.records, units)
    if request.out is not None:
        if estimate.controller is None:
            raise InputError(f"{estimate.record}: {estimate.reason}; {request.out} is not written")
        write_text(request.out, estimate.to_toml())
    return Reply(estimate.to_dict(), estimate.view(), units)
