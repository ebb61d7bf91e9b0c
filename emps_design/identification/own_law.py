"""The controller that made a record, found in it, where the axis says of none."""

from __future__ import annotations

from emps_design.axis import Axis
from emps_design.identification.controller import identify_law
from emps_design.records import Record


def with_own_law(record: Record, axis: Axis) -> tuple[Axis | None, str]:
    """The ``axis`` with the controller that made ``record``, None where the record does not tell it, and a note on it.

    >>> import numpy as np
    >>> from emps_design.machines import machine
    >>> ramp, n = np.linspace(0.0, 0.1, 500), np.arange(500.0)
    >>> driven_by_something_else = Record.from_arrays(1e-3, ramp, ramp, np.sin(n**2))
    >>> with_own_law(driven_by_something_else, machine("emps2019"))[0] is None
    True
    """
    found = identify_law(record, axis.drive.command_unit)
    if found.controller is None:
        return None, f"{axis.name} has no controller, and the record tells of none: {found.reason}"
    with_law = Axis.from_dict({**axis.to_dict(), "controller": found.controller}, axis.name)
    return with_law, f"{axis.name} has no controller; the one of the record was used ({found.in_words}), law writes it"
