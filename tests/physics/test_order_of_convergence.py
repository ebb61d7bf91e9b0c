"""The order each method declares, measured: halve the step, and the error falls by 2 to the power of it."""

import numpy as np
import pytest

from emps_design.simulation import Plant
from emps_design.simulation.kernels import motion, smooth_period
from tests.physics.cases import axis_with


def measured_order(axis, steps, duration=0.24, speed=0.2):
    """Slope of log error over log step, one step a period, while the carriage slides under a constant voltage."""
    errors = []
    tight = Plant.of(axis.replace(sampling={"period": duration / 4})).open_loop(
        np.full(5, 1.5), v0=speed, tolerance=1e-5, method="general"
    )
    for n in steps:
        plant = Plant.of(axis.replace(sampling={"period": duration / n}))
        run = plant.open_loop(np.full(n + 1, 1.5), v0=speed, tolerance=1e9, method="general")
        assert not len(run.events)
        errors.append(abs(run.v[-1] - tight.v[-1]))
    assert min(errors) > 1e-13  # above rounding, or the slope says nothing
    return np.polyfit(np.log(1.0 / np.array(steps)), np.log(errors), 1)[0]


def test_runge_kutta_has_the_order_it_declares():
    order = measured_order(axis_with("flexible_coupling"), [96, 120, 160, 200, 240])
    assert order == pytest.approx(motion.ORDER, abs=0.4)


def test_sliding_has_the_order_it_declares():
    order = measured_order(axis_with("nonlinear_viscous_friction", "elastic_force"), [48, 64, 96, 128])
    assert order == pytest.approx(smooth_period.ORDER, abs=0.3)


@pytest.mark.parametrize("name", ["stribeck_friction", "flexible_coupling", "presliding_friction", "backlash"])
def test_a_tighter_tolerance_comes_closer(name):
    from tests.physics.cases import voltage

    plant, u = Plant.of(axis_with(name)), voltage(1.0)
    tight = plant.open_loop(u, tolerance=1e-4).position
    errors = [np.abs(plant.open_loop(u, tolerance=t).position - tight).max() for t in (1e4, 1e2, 1.0)]
    assert errors[0] > errors[2]
    assert errors[2] < 5e-10
