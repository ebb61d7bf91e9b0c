"""Read a record of an axis, whatever its drive writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from emps_design.axis import Axis
from emps_design.importing.contradictions import with_contradictions
from emps_design.importing.sanity import check_against
from emps_design.laws import NONE
from emps_design.records import MAX_BYTES, MAX_BYTES_TO_CUT, Record, read_record, record_from_bytes
from emps_design.records.layout import Layout


def import_record(
    path: str | Path,
    axis: Axis,
    max_bytes: int | None = None,
    resample: bool = False,
    window: tuple[float, float] | None = None,
) -> Record:
    """Read the record at ``path`` as the ``[record]`` table of ``axis`` says, in SI units (commands: the axis's own).

    Without a table, columns have the names of the contract or titles that say what they are. Irregular time of an
    export, and with ``resample`` of any record, is put on the period of the axis. What was done stands in the record's
    ``warnings``, and which column was taken for what in ``assigned``. Raises :class:`RecordError` in one line where it
    is not certain, or where the numbers cannot be of this axis. ``window`` takes a part [s] of the file's time alone.
    """
    layout = replace(layout_of(axis), resample=resample, window=window)
    if max_bytes is None:
        max_bytes = MAX_BYTES if window is None else MAX_BYTES_TO_CUT
    return with_contradictions(axis, check_against(axis, read_record(path, max_bytes, layout), str(path)))


def import_bytes(content: bytes, name: str, axis: Axis, max_bytes: int = MAX_BYTES) -> Record:
    """Read the ``content`` of a file called ``name`` in the same way.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(record={"position": {"column": "Lageistwert", "unit": "mm"}})
    >>> rows = "\\n".join(f"{k / 1000:.3f};{k};{k / 1000:.3f};1,{k:02d}".replace(".", ",") for k in range(60))
    >>> record = import_bytes(f"t;Lageistwert [mm];q_ref;u\\n{rows}".encode(), "trace.csv", axis)
    >>> round(float(record.q[-1]), 6), record.assigned[2].title
    (0.059, 'Lageistwert [mm]')
    """
    read = record_from_bytes(content, name, None, max_bytes, layout_of(axis))
    return with_contradictions(axis, check_against(axis, read, name))


def layout_of(axis: Axis) -> Layout:
    """What a reader has to know of ``axis``."""
    return Layout(
        units=axis.units,
        columns=axis.record,
        period=axis.sampling.period,
        reference_needed=axis.controller.kind != NONE,
        limit=float(axis.drive.command_limit),
    )
