"""Margins of the controller in an axis file against closed forms, and against gains of a design."""

import math

import pytest

from emps_design.axis import Axis
from emps_design.control.controller import controller_margins
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.load_range import LoadRange
from emps_design.errors import AxisError
from emps_design.machines import machine


def servo(controller, lag=0.0, period=1e-3, mass=0.74944, viscous=10.556):
    return Axis(
        mechanics={"mass": mass, "viscous": viscous, "coulomb": 0.0},
        drive={"force_gain": 1.0, "current_time_constant": lag},
        sampling={"period": period},
        controller=controller,
    )


def test_a_proportional_servo_is_the_textbook_second_order_loop():
    """kp/(s (m s + b)): w0 = sqrt(kp/m), z = b/(2 sqrt(kp m)); the hold takes half a sample of phase."""
    found = controller_margins(servo({"kind": "p", "kp": 250.0})).loops
    assert found["velocity"] is None
    whole = found["whole"]
    assert whole.continuous.natural_frequency == pytest.approx(math.sqrt(250.0 / 0.74944), rel=1e-8)
    assert whole.continuous.damping == pytest.approx(10.556 / (2.0 * math.sqrt(250.0 * 0.74944)), rel=1e-7)
    z = whole.continuous.damping
    phase = math.degrees(math.atan(2.0 * z / math.sqrt(math.sqrt(1.0 + 4.0 * z**4) - 2.0 * z**2)))
    assert whole.continuous.margins.phase_margin_deg == pytest.approx(phase, abs=1e-6)
    assert whole.continuous.margins.gain_margin is None
    lost = math.degrees(0.5e-3 * whole.margins.crossover)
    assert whole.margins.phase_margin_deg == pytest.approx(phase - lost, abs=1e-2)
    assert found["position"].margins.phase_margin_deg == pytest.approx(whole.margins.phase_margin_deg)


def test_every_lag_of_the_axis_is_in_the_continuous_loop():
    """(2.618 s + 1)(0.382 s + 1) = s^2 + 3 s + 1, so with k_v1 = 1, t_v = 0.5 T_vo is 2/(s (s + 1)(s + 2))."""
    axis = servo({"kind": "ip_velocity", "k_v1": 1.0, "t_v": 0.5}, 0.3819660112501051, 0.05, 2.618033988749895, 1.0)
    error = controller_margins(axis).loops["velocity"].continuous.velocity_error
    assert error.crossover == pytest.approx(0.7494, abs=1e-4)
    assert error.phase_margin_deg == pytest.approx(32.61, abs=0.01)
    assert error.gain_margin == pytest.approx(3.0, rel=1e-6)


def test_a_design_that_was_written_has_the_margins_of_the_design():
    design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    found = controller_margins(design.axis.replace(controller=design.controller_table())).loops["velocity"]
    sampled = design.sampled
    assert found.margins.phase_margin_deg == pytest.approx(sampled.margins.phase_margin_deg, rel=1e-6)
    assert found.velocity_error.phase_margin_deg == pytest.approx(sampled.velocity_error.phase_margin_deg, rel=1e-6)
    assert found.bandwidth == pytest.approx(sampled.bandwidth, rel=1e-6)
    assert found.continuous.velocity_error.phase_margin_deg == pytest.approx(
        design.with_lags.velocity_error.phase_margin_deg, abs=1e-4
    )


def test_the_worst_machine_of_a_range_decides():
    found = controller_margins(machine("emps2019"), load=LoadRange(inertia=(1.0, 3.0)))
    assert found.stable
    assert (found.worst.name, dict(found.worst.where)) == ("whole loop", {"inertia": 3.0})
    assert found.worst.margins.phase_margin_deg < found.loops["whole"].margins.phase_margin_deg


def test_an_axis_without_a_controller_is_refused():
    with pytest.raises(AxisError, match="to close a loop"):
        controller_margins(machine("emps2018"))


def test_the_view_says_a_crossover_in_hertz_and_a_delay_in_samples():
    margins = controller_margins(machine("emps2019").replace(sampling={"period": 5e-4}))
    _, _, sampled, continuous = margins.view()
    rows = {(row[0], row[-1]): row[-2] for row in sampled.rows}
    whole = margins.loops["whole"].margins
    assert rows["", "Hz"] == f"{whole.crossover / (2.0 * math.pi):.4g}"
    assert rows["", "samples"] == f"{whole.delay_margin / 5e-4:.4g}"
    assert "samples" not in {row[-1] for row in continuous.rows}
