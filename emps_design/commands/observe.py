"""Observe the external force of a record, off-line and on-line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from emps_design import identification
from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import TABLE
from emps_design.commands.options import HERTZ
from emps_design.errors import InputError
from emps_design.files import write_aside
from emps_design.inputs import axis_option, read_record
from emps_design.progress import no_progress
from emps_design.records import Record
from emps_design.request import Request, option

LONG = 200_000  # samples above which a progress bar is shown; also the number of rows written at once


@dataclass(frozen=True)
class ObserveRequest(Request):
    """Options of ``observe``: a record, the identified axis, and the cut-offs of the observers."""

    record: Record = option(
        ..., "record file: .mat, .csv or .npz", argument=True, metavar="RECORD", typed=Path, read=read_record
    )
    axis: Axis = axis_option("TOML file or embedded machine with identified parameters")
    cutoff: float | None = option(
        None,
        "low-pass of the on-line observer [Hz, or e.g. 120rad/s], twice that for Kalman; default 20 Hz, less if the "
        "sampling is slow",
        **HERTZ,
    )
    offline_cutoff: float | None = option(
        None,
        "zero-phase low-pass off-line [Hz, or e.g. 370rad/s]; default 60 Hz, less if the sampling is slow",
        **HERTZ,
    )
    injected: str | None = option(
        None,
        "known voltage added to the controller's output: a column of the record times VOLTS; it is subtracted from u, "
        "and its force is the true external force",
        metavar="COLUMN:VOLTS",
    )
    out: Path | None = option(
        None, "write the observed forces to this .csv file; a cell without a value is empty", writes=TABLE
    )


def answer(request: ObserveRequest) -> Reply:
    """The external force by every method, its errors against a known force, and the smallest observable force."""
    record, axis = request.record, request.axis
    if request.injected is not None:
        voltage = _voltage(request.injected, record)
        record = identification.with_known_push(record, voltage, axis.supplied_by(record).drive.gain)
    observation = identification.observe(
        record,
        axis,
        cutoff_hz=request.cutoff,
        offline_cutoff_hz=request.offline_cutoff,
        progress=request.progress if len(record) >= LONG else no_progress,
    )
    if request.out is not None:
        _write(request.out, observation)
    return Reply(observation.to_dict(), observation.view(), axis.units, warnings=observation.warnings)


def _voltage(injected: str, record: Record) -> np.ndarray:
    """The voltage (n,) [V] of ``COLUMN:VOLTS``."""
    name, _, factor = injected.rpartition(":")
    column = np.ravel(np.asarray(record.extra.get(name, ())))
    if column.dtype.kind not in "buif" or column.size != len(record):
        columns = [key for key, values in record.extra.items() if np.size(values) == len(record)]
        raise InputError(
            f"`injected`: found {injected!r}, expected COLUMN:VOLTS with an additional column of {record.name}: "
            f"{', '.join(columns) or 'it has none'}"
        )
    try:
        volts = float(factor)
    except ValueError:
        raise InputError(f"`injected`: found {factor!r} for VOLTS, expected a number") from None
    return volts * column


def _write(out: Path, observation: identification.Observation) -> None:
    """Write time and observed forces as a table."""
    unit = observation.units.unit("N")
    names = ["t [s]", *(f"{name} [{unit}]" for name in observation.methods)]
    columns = [observation.t, *(result.force for result in observation.methods.values())]
    with write_aside(out) as aside, aside.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for start in range(0, len(observation.t), LONG):
            rows = zip(*(column[start : start + LONG].tolist() for column in columns), strict=True)
            file.writelines(",".join("" if x != x else f"{x:.9g}" for x in row) + "\n" for row in rows)
