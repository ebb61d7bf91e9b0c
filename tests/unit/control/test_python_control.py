"""Where python-control has an object for it there is one: plant, law, loop gain, closed loop, admittance."""

import control
import numpy as np
import pytest

from emps_design.control.discretisation import sample_axis
from emps_design.control.impedance.law import FrictionModel, impedance_law
from emps_design.control.impedance.passivity import Clock, sampled_loop
from emps_design.control.linear_plant import linear_plant
from emps_design.control.sampled import axis_loop, close
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.errors import InputError
from emps_design.laws import law_of
from emps_design.laws.linear import linear_law
from emps_design.machines import machine

W = np.array([2.0, 30.0, 200.0, 900.0])
CONTROLLERS = [
    {"kind": "position_pd", "kp": 30.0, "kv": 240.0},
    {"kind": "ip_velocity", "k_v1": 400.0, "t_v": 0.02},
    {"kind": "impedance", "mass": 60.0, "damping": 150.0},
]


def axis_with(controller, delay=0, effects=()):
    return machine("emps2018").replace(
        controller={**controller, "velocity_estimator": "two_tap"},
        sampling={"computation_delay": delay},
        effects=list(effects),
    )


def at(system, w, output=0, by=0):
    return np.asarray(control.frequency_response(system, w).complex).reshape(system.noutputs, system.ninputs, -1)[
        output, by
    ]


LATE = [{"kind": "actuator_delay", "delay": 4e-4}]


@pytest.mark.parametrize("controller", CONTROLLERS, ids=lambda c: c["kind"])
@pytest.mark.parametrize(("delay", "effects"), [(0, ()), (2, ()), (1, LATE)])
def test_plant_and_law_in_series_are_the_loop_gain(controller, delay, effects):
    axis = axis_with(controller, delay, effects)
    plant, law = sample_axis(axis), linear_law(law_of(axis, 1e-3), 1e-3)
    broken = -at(plant.to_ss(), W) * at(law.to_ss(1e-3), W, by=1)
    loop = axis_loop(axis)
    np.testing.assert_allclose(loop.loop_gain(W), broken, rtol=1e-6)
    np.testing.assert_allclose(at(loop.loop_gain_to_ss(), W), broken, rtol=1e-6)
    np.testing.assert_allclose(at(loop.to_ss(), W, 3, loop.inputs.index("voltage")), -broken / (1 + broken), rtol=1e-6)


def test_the_plant_without_a_hold_is_the_continuous_one():
    axis = axis_with(CONTROLLERS[0])
    s = 1j * W
    expected = 35.15 / (0.5e-3 * s + 1.0) / (115.7315 * s + 474.9727)
    np.testing.assert_allclose(at(linear_plant(axis).to_ss(), W, 1), expected, rtol=1e-9)
    np.testing.assert_allclose(at(sample_axis(axis).to_tf(), W), sample_axis(axis).response(W), rtol=1e-8)


def test_admittance_and_poles():
    axis = machine("emps2018")
    law = impedance_law(axis, 50.0, 100.0)
    loop = sampled_loop(law, FrictionModel.of(axis), Clock.of(axis))
    np.testing.assert_allclose(at(loop.to_tf(), W), loop.admittance(W), rtol=1e-6)
    np.testing.assert_allclose(np.sort_complex(loop.to_ss().poles()), np.sort_complex(loop.poles), atol=1e-9)


def test_the_velocity_loop_keeps_its_transfer_function():
    sampled = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0).sampled
    np.testing.assert_allclose(at(sampled.transfer_function(), W), sampled.plant_input_response(W), rtol=1e-9)
    np.testing.assert_allclose(sampled.loop.loop_gain(W), sampled.plant_input_response(W), rtol=1e-9)


def test_a_loop_without_the_plant_input_has_no_loop_gain():
    axis = axis_with(CONTROLLERS[2])
    loop = close(sample_axis(axis), linear_law(law_of(axis, 1e-3), 1e-3))
    with pytest.raises(InputError, match="plant input: the loop was closed without it"):
        loop.loop_gain(W)
