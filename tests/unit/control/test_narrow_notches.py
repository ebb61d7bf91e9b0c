"""Margins of loops with narrow notches, at every place where they are told, against a grid that misses nothing."""

import numpy as np
import pytest

from emps_design.control.margins import loop_margins
from emps_design.control.sampled import axis_loop, nested_loops
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.gains import PI
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.errors import SpecificationError
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine

AXIS = machine("emps2018")


def notch(frequency=12.0, damping=0.01, depth=0.1):
    return Filter(kind="notch", frequency=frequency, damping=damping, depth=depth)


def design(one):
    return VelocityLoopDesign(AXIS, 400.0, 0.08, {}, structure=PI, filters=(one,))


def least_phase(response, centre):
    """Least phase margin [deg] by brute force: so many frequencies everywhere, and as many about the ``centre``."""
    about = centre * (1.0 + np.outer([-1.0, 1.0], np.geomspace(1e-6, 0.5, 20_000))).ravel()
    w = np.sort(np.concatenate([np.geomspace(1.0, 3000.0, 40_000), about]))
    L = response(w)
    crossing = np.flatnonzero((np.abs(L[1:]) < 1.0) != (np.abs(L[:-1]) < 1.0))
    return float(np.degrees(np.mod(np.angle(L[crossing]) + np.pi, 2.0 * np.pi)).min())


@pytest.mark.parametrize("one", [notch(), notch(12.0, 0.002, 0.0), notch(13.0, 0.02, 0.01), notch(14.0, 0.005, 0.5)])
def test_no_crossing_beside_a_narrow_notch_is_missed(one):
    found, period = design(one), AXIS.sampling.period
    centre = 2.0 / period * np.arctan(np.pi * one.frequency * period)
    true = least_phase(found.sampled.plant_input_response, centre)
    assert found.sampled.margins.phase_margin_deg == pytest.approx(true, abs=0.2)
    assert nested_loops(found.loop_axis)[-1].margins.phase_margin_deg == pytest.approx(true, abs=0.2)


def test_a_position_loop_around_a_velocity_loop_with_a_narrow_notch():
    cascade = design(notch()).loop_axis.controller.model_dump(exclude_none=True) | {
        "position": {"kp": 20.0, "every": 1}
    }
    axis = AXIS.replace(controller=cascade)
    inner, outer, whole = nested_loops(axis)
    assert outer.margins.stable
    assert inner.margins.phase_margin_deg == pytest.approx(design(notch()).sampled.margins.phase_margin_deg, rel=1e-5)
    assert whole.margins.phase_margin_deg == pytest.approx(least_phase(axis_loop(axis).loop_gain, 75.4), abs=0.2)


def test_retune_promises_no_margin_that_a_narrow_notch_takes():
    with pytest.raises(SpecificationError, match="another crossing has less phase margin") as refused:
        retune_velocity_loop(AXIS, crossover=100.0, filters=(notch(),))
    works = refused.value.nearest
    found = retune_velocity_loop(AXIS, **works, filters=(notch(),))
    assert least_phase(found.sampled.plant_input_response, 75.4) == pytest.approx(works["phase_margin_deg"], abs=0.2)


def test_a_loop_that_is_zero_where_it_turns_real_has_its_margins():
    """At 1 rad/s the loop passes through 0, which is where a search for its crossing of the real axis lands."""
    margins = loop_margins(lambda w: (w - 1.0) * (1.0 + 0.5j) / (1j * w) ** 4, np.array([0.25, 4.0, 64.0]), stable=True)
    assert margins.gain_margin is None
