"""What drives a closed-loop simulation along a record: all that the record says of the drive besides its answer."""

from __future__ import annotations

from typing import Any

from emps_design.axis import Axis
from emps_design.laws import NONE, law_of
from emps_design.records import Record


def driven_by(axis: Axis, record: Record) -> dict[str, Any]:
    """Keywords of :meth:`Plant.closed_loop` with which the simulation of ``record`` starts and is driven as it was.

    The law of ``axis``, with the gains that the record gives; what it follows, a recorded velocity reference where it
    follows a velocity; the measured external force, what was added to the controller's output, the supply of a duty and
    where the motor was switched off. Without a
    controller there is no law among them.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> sorted(driven_by(axis, synthetic_record(axis, laps=1)))
    ['disturbance', 'enable', 'law', 'q0', 'q_ref', 'reference', 'supply', 'voltage_noise']
    """
    how = {
        "q_ref": record.q_ref,
        "q0": float(record.q[0]),
        "disturbance": record.f_ext,
        "voltage_noise": record.excitation,
        "supply": record.supply,
        "enable": record.enable,
    }
    if axis.controller.kind == NONE:
        return how
    law = law_of(axis, record.period, record.extra)
    return {**how, "law": law, "reference": law.followed(record)}
