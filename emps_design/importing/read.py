"""Read a record of an axis, whatever its drive writes.

What in a record its own controller, or without one its own motion, contradicts: looked at once, as it is read.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from emps_design.axis import Axis
from emps_design.importing.controller import can_replay, check_controller
from emps_design.importing.motion import check_motion, odd_increments
from emps_design.importing.sanity import check_against
from emps_design.laws import NONE
from emps_design.records import MAX_BYTES, MAX_BYTES_TO_CUT, Record, read_record, record_from_bytes
from emps_design.records.layout import Layout

BLOCK = 500_000  # samples that are looked at together: an hour's would need more memory than all else
MEANS = "what is found from this record may be wrong by more than it says"


def with_contradictions(axis: Axis, record: Record) -> Record:
    """Return ``record`` with what contradicts it among its ``warnings``, and alone in ``contradictions``.

    Where the axis file has the law of the controller and the record what it followed, the law decides alone; else what
    no drive does. A record with an excitation that was added to the command is taken at its word.
    """
    if record.excitation is not None:
        return record
    blocks = -(-len(record) // BLOCK)
    edges = [len(record) * i // blocks for i in range(blocks + 1)]
    found: list[str] = []
    for start, stop in pairwise(edges):
        found = _found(axis, record if blocks == 1 else record.part(start, stop, record.name))
        if found:
            break
    if not found:
        return record
    if blocks > 1:  # times of a part begin with it
        found = [f"in the part from {record.t[start]:.6g} s on, {text}" for text in found]
    texts = tuple(f"{text}; {MEANS}" for text in found)
    return replace(record, warnings=(*record.warnings, *texts), contradictions=texts)


def _found(axis: Axis, record: Record) -> list[str]:
    said = check_controller(axis, record) if can_replay(axis, record) else None
    if said is None:
        return check_motion(axis, record)
    return [text for text in (said or odd_increments(record),) if text]


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
