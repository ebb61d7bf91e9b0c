"""The margins of an impedance law at the plant input, where a force gain that is off, a delay or a slow drive acts.

The law cancels friction and part of the mass by what it believes of them, so a force gain above the one it believes is
over-compensation: its gain margin is often reached at rest, where the apparent damping vanishes.
"""

from __future__ import annotations

from emps_design.axis import Axis
from emps_design.control.impedance.law import ImpedanceLaw, law_for
from emps_design.control.loop.nested import PLANT_INPUT, WHOLE, NestedLoop, at_plant_input
from emps_design.control.plant.discretisation import sample_axis
from emps_design.control.velocity.sensitivity import corners as corners_of
from emps_design.laws.friction_model import FrictionModel
from emps_design.laws.linear import linear_law

SPEED = 0.1  # m/s, of the slide in which effects are linearised


def impedance_loops(axis: Axis, law: ImpedanceLaw, mismatch: float = 0.0) -> tuple[NestedLoop, ...]:
    """Return the loop of ``law`` on ``axis`` in every direction, and with estimates off to the corners of ``mismatch``.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> for damping in (100.0, 300.0):
    ...     print(round(impedance_loops(axis, impedance_law(axis, 50.0, damping))[0].margins.gain_margin, 2))
    1.27
    1.77
    """
    plant = FrictionModel.of(axis)
    corners = corners_of({"mass": mismatch, "viscous": mismatch}) if mismatch else []  # what a slide depends on
    period, found = axis.sampling.period, []
    for direction in plant.directions:
        sampled = sample_axis(axis, direction * SPEED)
        for errors in ({}, *corners):
            form = linear_law(law_for(axis, law.with_errors(errors), period), period, float(direction))
            found.append(NestedLoop(WHOLE, PLANT_INPUT, at_plant_input(sampled, form), errors))
    return tuple(found)
