"""The controller of a record, identified from the record, for an axis without one."""

from __future__ import annotations

from emps_design.axis import Axis
from emps_design.identification.controller import identify_law
from emps_design.messages import Message, warning
from emps_design.records import Record


def with_own_law(record: Record, axis: Axis) -> tuple[Axis | None, Message]:
    """The ``axis`` with the controller identified from ``record``, None where there is none, and a message on it.

    >>> import numpy as np
    >>> from emps_design.machines import machine
    >>> ramp, n = np.linspace(0.0, 0.1, 500), np.arange(500.0)
    >>> driven_by_something_else = Record.from_arrays(1e-3, ramp, ramp, np.sin(n**2))
    >>> with_own_law(driven_by_something_else, machine("emps2019"))[0] is None
    True
    """
    law = identify_law(record, axis.units)
    if law.controller is None:
        text = f"{axis.name} has no controller, and none is identified from the record: {law.reason}"
        return None, warning("no-law", text)
    with_law = Axis.from_dict({**axis.to_dict(), "controller": law.controller}, axis.name)
    text = f"{axis.name} has no controller; the one of the record was used ({law.in_words}); law writes it"
    return with_law, warning("law-of-the-record", text)
