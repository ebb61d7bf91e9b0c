"""What in a record its own controller, or without one its own motion, contradicts: looked at once, as it is read."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from emps_design.axis import Axis
from emps_design.importing.controller import check_controller
from emps_design.importing.increments import odd_increments
from emps_design.importing.motion import check_motion
from emps_design.importing.replay import can_replay
from emps_design.records import Record

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
