"""Read a record of an axis from the formats of drives, and check it against its controller or its motion."""

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

BLOCK = 500_000  # samples that are checked together, to save memory
MEANS = "what is found from this record may be wrong by more than it says"


def with_contradictions(axis: Axis, record: Record) -> Record:
    """Return ``record`` with its contradictions in ``contradictions`` and among its ``warnings``.

    Where the law of the controller can run on the record, the law decides alone; otherwise its motion does
    (:mod:`.motion`). A record with an excitation is not checked.
    """
    if record.excitation is not None:
        return record
    blocks = -(-len(record) // BLOCK)
    edges = [len(record) * i // blocks for i in range(blocks + 1)]
    messages: list[str] = []
    for start, stop in pairwise(edges):
        messages = _contradictions(axis, record if blocks == 1 else record.part(start, stop, record.name))
        if messages:
            break
    if not messages:
        return record
    if blocks > 1:  # times of a part begin with it
        messages = [f"in the part from {record.t[start]:.6g} s on, {text}" for text in messages]
    texts = tuple(f"{text}; {MEANS}" for text in messages)
    return replace(record, warnings=(*record.warnings, *texts), contradictions=texts)


def _contradictions(axis: Axis, record: Record) -> list[str]:
    message = check_controller(axis, record) if can_replay(axis, record) else None
    if message is None:
        return check_motion(axis, record)
    return [text for text in (message or odd_increments(record),) if text]


def import_record(
    path: str | Path,
    axis: Axis,
    max_bytes: int | None = None,
    resample: bool = False,
    window: tuple[float, float] | None = None,
) -> Record:
    """Read the record at ``path`` by the ``[record]`` table of ``axis``, in SI units and the command unit of the axis.

    Without a table, columns are recognised by their names or titles. Irregular time of an export, and with ``resample``
    of any record, is resampled to the period of the axis. The ``warnings`` of the record say what was changed,
    ``assigned`` which column is which. ``window`` [s] reads a part of the file's time. Raises :class:`RecordError`, a
    message of one line, where a column is uncertain or the numbers cannot be of this axis.
    """
    layout = replace(layout_of(axis), resample=resample, window=window)
    if max_bytes is None:
        max_bytes = MAX_BYTES if window is None else MAX_BYTES_TO_CUT
    return with_contradictions(axis, check_against(axis, read_record(path, max_bytes, layout), str(path)))


def import_bytes(content: bytes, name: str, axis: Axis, max_bytes: int = MAX_BYTES) -> Record:
    """Read the ``content`` of a file called ``name`` as :func:`import_record` does.

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
    """The layout of a record of ``axis``."""
    return Layout(
        units=axis.units,
        columns=axis.record,
        period=axis.sampling.period,
        reference_needed=axis.controller.kind != NONE,
        limit=float(axis.drive.command_limit),
    )
