"""A law with a narrow notch around a measured plant: its margins are those of the same loop around the model."""

import numpy as np
import pytest

from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.gains import PI
from emps_design.frequency_response import FrequencyResponse, measured_margins
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine
from tests.unit.frequency_response.cases import exact

F = np.geomspace(1.0, 399.0, 120)


@pytest.mark.parametrize(("frequency", "damping", "depth"), [(12.0, 0.01, 0.1), (13.0, 0.02, 0.01), (0.7, 0.01, 0.1)])
def test_a_narrow_notch_is_not_between_the_lines(frequency, damping, depth):
    axis = machine("emps2018")
    notch = Filter(kind="notch", frequency=frequency, damping=damping, depth=depth)
    design = VelocityLoopDesign(axis, 400.0, 0.08, {}, structure=PI, filters=(notch,))
    found = measured_margins(FrequencyResponse.of(F, exact(axis, F), name="exact"), design.loop_axis)
    true = design.sampled.margins
    for name in ("phase_margin_deg", "delay_margin", "disk_margin"):
        assert found.values[name] == pytest.approx(getattr(true, name), rel=0.02), name
