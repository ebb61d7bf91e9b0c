"""What in a record its own controller, or without one its own motion, contradicts: looked at once, as it is read."""

from __future__ import annotations

from dataclasses import replace

from emps_design.axis import Axis
from emps_design.importing.controller import check_controller
from emps_design.importing.increments import odd_increments
from emps_design.importing.motion import check_motion
from emps_design.importing.replay import can_replay
from emps_design.records import Record

MEANS = "what is found from this record may be wrong by more than it says"


def with_contradictions(axis: Axis, record: Record) -> Record:
    """Return ``record`` with what contradicts it among its ``warnings``, and alone in ``contradictions``.

    Where the axis file has the law of the controller and the record what it followed, the law decides alone; else what
    no drive does. A record with an excitation that was added to the command is taken at its word.
    """
    if record.excitation is not None:
        return record
    said = check_controller(axis, record) if can_replay(axis, record) else None
    if said is None:
        found = check_motion(axis, record)
    else:
        found = [text for text in (said or odd_increments(record),) if text]
    if not found:
        return record
    texts = tuple(f"{text}; {MEANS}" for text in found)
    return replace(record, warnings=(*record.warnings, *texts), contradictions=texts)
