"""A lag of the motor force behind that of the current loop: a known function of time, however short, and no state."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from emps_design.machines import machine
from emps_design.simulation import Plant
from emps_design.simulation.kernels.friction_period import BREAKAWAY
from emps_design.simulation.plant import Inputs

VOLTS = np.repeat(np.random.default_rng(3).uniform(-3.0, 3.0, 60), 7)


def with_lags(first, second, *others, **mechanics):
    effects = [{"kind": "actuator_lag", "time_constant": second}, *others]
    changed = {"drive": {"current_time_constant": first}, "mechanics": mechanics, "effects": effects}
    return machine("emps2018").replace(**changed)


def behind(t, first, second, start, command):
    """Force behind both lags ``t`` seconds after the ``command`` changed; ``start``: what was behind each."""
    A = np.array([[-1.0 / first, 0.0], [1.0 / second, -1.0 / second]])
    return command + expm(A * t) @ (np.array(start) - command)


@pytest.mark.parametrize(("first", "second"), [(5e-4, 1e-5), (1e-5, 5e-3), (1e-3, 1e-3), (1e-3, (1.0 - 1e-7) * 1e-3)])
def test_without_friction_it_is_the_matrix_exponential(first, second):
    axis = with_lags(first, second, coulomb=0.0)
    b, period, gain = axis.mechanics, axis.sampling.period, axis.drive.gain
    A = np.zeros((5, 5))  # of position, velocity, force behind the first, behind both, command
    A[0, 1], A[1, 1], A[1, 3] = 1.0, -b.viscous / b.mass, 1.0 / b.mass
    A[2, [2, 4]], A[3, [3, 2]] = [-1.0 / first, 1.0 / first], [-1.0 / second, 1.0 / second]
    over, z, expected = expm(A * period), np.zeros(5), []
    for volts in VOLTS:
        expected.append(z[0])
        z[4] = gain * volts
        z = over @ z
    run = Plant.of(axis).open_loop(VOLTS)
    assert np.ptp(expected) > 1e-3
    assert np.abs(run.position - expected).max() < 2e-11


@pytest.mark.parametrize("energy", [False, True])
def test_a_lag_is_no_state(energy):
    plant, b = Plant.of(with_lags(5e-4, 1e-5)), machine("emps2018").mechanics.array()
    ready = plant.prepared(Inputs(b, np.array([1e-5]), 10, 1e-3, 0.0, energy=energy))
    assert ready.y.size == (6 if energy else 2)


OTHERS = {
    "none": (),
    "load": ({"kind": "load_dependent_friction", "share": 0.1, "motor_side": 0.5},),
    "contact": ({"kind": "presliding_friction", "stiffness": 1e6},),
    "coupling": ({"kind": "flexible_coupling", "frequency": 35.0, "damping": 0.05, "share": 0.4},),
    "back-EMF": ({"kind": "back_emf_braking", "braking": 300.0},),
    "delay": ({"kind": "actuator_delay", "delay": 3.7e-4},),
}


@pytest.mark.parametrize("others", OTHERS)
@pytest.mark.parametrize("method", ["ordinary", "energy"])
def test_which_of_two_lags_is_the_current_loops_does_not_matter(others, method):
    runs = [
        Plant.of(with_lags(*lags, *OTHERS[others])).open_loop(VOLTS, energy=method == "energy")
        for lags in ((5e-4, 1e-5), (1e-5, 5e-4))
    ]
    assert len(runs[0].events) == len(runs[1].events) > 5
    assert np.abs(runs[0].position - runs[1].position).max() < 2e-11


@pytest.mark.parametrize("second", [1e-5, 2e-3])
@pytest.mark.parametrize("others", ["none", "contact", "coupling", "delay"])
def test_it_is_where_a_state_of_its_own_is_stepped_to(others, second):
    axis = with_lags(5e-4, second, *OTHERS[others])
    effects = [(one.effect, one.effect.values(one.parameters)) for one in axis.effects]
    stepped = Plant(
        axis, [(replace(effect, solver=replace(effect.solver, lag=None)), values) for effect, values in effects]
    )
    assert stepped.states_at[-1] == Plant.of(axis).states_at[-1] + 1
    run, tight = Plant.of(axis).open_loop(VOLTS), stepped.open_loop(VOLTS, tolerance=1e-2)
    assert len(run.events) == len(tight.events) > 5
    assert np.abs(run.position - tight.position).max() < 2e-11


@pytest.mark.parametrize(("first", "second"), [(3e-3, 2e-3), (5e-4, 4e-3), (2e-3, 2e-3)])
@pytest.mark.parametrize("others", ["none", "coupling"])
def test_friction_that_holds_is_asked_where_the_force_is_largest(first, second, others):
    """Behind two lags the force still grows after the command has turned: it breaks the carriage away and falls."""
    period, gain = 10e-3, machine("emps2018").drive.gain
    start = behind(period, first, second, (0.0, 0.0), gain)
    times = np.linspace(0.0, period, 2001)
    forces = np.array([behind(t, first, second, start, -gain)[1] for t in times])
    top = forces.argmax()
    assert 0 < top < 2000
    level = 0.5 * (forces[0] + forces[top])
    axis = with_lags(first, second, *OTHERS[others], coulomb=level).replace(sampling={"period": period})
    run = Plant.of(axis).open_loop(np.array([1.0, -1.0, -1.0]))
    leaves = brentq(lambda t: behind(t, first, second, start, -gain)[1] - level, 0.0, times[top])
    assert run.events[0, 1] == BREAKAWAY
    assert run.events[0, 0] == pytest.approx(period + leaves, abs=1e-9)
