"""The controller that made a record, found in it, where the axis says of none."""

from __future__ import annotations

from emps_design.axis import Axis
from emps_design.identification.controller import identify_law
from emps_design.records import Record


def with_own_law(record: Record, axis: Axis) -> tuple[Axis | None, str]:
    """The ``axis`` with the controller that made ``record``, None where the record does not tell it, and a note on it.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> bare = axis.replace(controller={"kind": "none", "kp": 1.0, "kv": 1.0})
    >>> found, said = with_own_law(synthetic_record(axis, laps=1, stroke=0.03), bare)
    >>> found.controller.kind, round(found.controller.kp)
    ('position_pd', 160)
    """
    found = identify_law(record, axis.drive.command_unit)
    if found.controller is None:
        return None, f"{axis.name} has no controller, and the record tells of none: {found.reason}"
    with_law = Axis.from_dict({**axis.to_dict(), "controller": found.controller}, axis.name)
    return with_law, f"{axis.name} has no controller; the one of the record was used ({found.in_words}), law writes it"
