"""The inverse model of the tests against the simulation, quadrants, friction curve."""

import numpy as np
import pytest

from emps_design.errors import InputError
from emps_design.laws.law import FrictionModel
from emps_design.machines import machine
from emps_design.simulation import Plant
from tests.inverse_model import inverse_force, plant_force, steady_friction

PLANT = {
    "asymmetric_viscous_friction": {"viscous_difference": -40.0},
    "nonlinear_viscous_friction": {"amount": 5.0, "exponent": 2.0},
    "stribeck_friction": {"excess": 8.0, "stribeck_velocity": 0.1, "exponent": 1.4},
    "load_dependent_friction": {"share": 0.3},
    "position_dependent_friction": {"amplitude": 5.0, "phase": 0.4, "length": 0.13},
    "position_ripple": {"amplitude": 4.0, "phase": 0.6, "period": 0.01},
    "mass_change": {"change": 0.15, "time": 0.5},
    "external_force": {"amplitude": 20.0, "start": 0.3, "duration": 0.2, "every": 0.0},
    "presliding_friction": {"stiffness": 1e5},
    "flexible_coupling": {"frequency": 35.0, "damping": 0.05, "share": 0.4},
    "actuator_lag": {"time_constant": 3e-3},
    "actuator_delay": {"delay": 4e-3},
    "actuator_deadzone": {"width": 0.2},
}


def motion(count=1200, period=1e-3):
    """A smooth motion between 0 and 0.1 m that starts at rest: q, v, a, t."""
    t = np.arange(count) * period
    w = 2 * np.pi * 0.9
    return 0.05 * (1 - np.cos(w * t)), 0.05 * w * np.sin(w * t), 0.05 * w**2 * np.cos(w * t), t


def left_by(axis, run):
    """Inverse force less what the run's motor gave around each sample, as its drive holds u [N] (n,)."""
    used = 0.5 * (run.force + np.append(run.force[:1], run.force[:-1]))
    return inverse_force(axis, run.position, run.v, np.gradient(run.v, run.period), run.t) - used


@pytest.mark.parametrize("name", PLANT)
def test_the_inverse_force_is_what_the_closed_loop_needed(name):
    axis = machine("emps2019").replace(effects=[{"kind": name, **PLANT[name]}], sampling={"encoder_resolution": 0.0})
    run = Plant.of(axis).closed_loop(motion()[0])
    reversals = run.t[np.flatnonzero(np.diff(np.sign(run.v)))]
    # At a reversal friction that jumps has no mean over a period; friction that bends has one.
    margin = 0.0 if axis.effects[0].effect.takes_dry else 0.05
    away = (run.t > 0.1) & np.all(np.abs(run.t[:, None] - reversals) >= margin, axis=1)
    left, without = np.abs(left_by(axis, run))[away], np.abs(left_by(axis.replace(effects=[]), run))[away]
    assert np.quantile(left, 0.97) < 0.05  # the rest are samples around a jump
    assert np.quantile(without, 0.97) > 20 * np.quantile(left, 0.97)


def test_a_sum_of_effects_is_the_sum_of_their_forces():
    names = ("asymmetric_viscous_friction", "stribeck_friction", "position_ripple")
    bare, now = machine("emps2019"), motion(50)
    base = plant_force(bare, *now)
    parts = [plant_force(bare.replace(effects=[{"kind": n, **PLANT[n]}]), *now) - base for n in names]
    whole = plant_force(bare.replace(effects=[{"kind": n, **PLANT[n]} for n in names]), *now) - base
    np.testing.assert_allclose(whole, np.sum(parts, axis=0), atol=1e-9)


def test_load_dependent_friction_is_solved_for_itself():
    axis = machine("emps2019").replace(effects=[{"kind": "load_dependent_friction", "share": 0.5}])
    q, v, a, t = np.array([[0.0, 0.0], [0.1, -0.1], [2.0, 2.0], [0.0, 1.0]])
    m = axis.mechanics
    rest = m.mass * a + m.viscous * v + m.coulomb * np.sign(v)  # tau - offset = rest + 0.5 sign(v) |tau - offset|
    expected = rest / (1 - 0.5 * np.sign(v) * np.sign(rest)) + m.offset
    np.testing.assert_allclose(plant_force(axis, q, v, a, t), expected, rtol=1e-9)


def test_a_level_never_turns_friction_into_drive():
    axis = machine("emps2019").replace(
        effects=[{"kind": "position_dependent_friction", "amplitude": 500.0, "phase": -np.pi / 2, "length": 1.0}]
    )
    m = axis.mechanics
    assert steady_friction(axis, np.array([0.1]))[0] == pytest.approx(m.viscous * 0.1 + m.offset)


def test_current_loop_of_the_axis_is_undone_like_a_lag():
    q, v, a, t = motion(300)
    ideal = machine("emps2019")
    lag = ideal.replace(effects=[{"kind": "actuator_lag", "time_constant": 2e-3}])
    loop = ideal.replace(drive={"current_time_constant": 2e-3})
    np.testing.assert_allclose(inverse_force(loop, q, v, a, t), inverse_force(lag, q, v, a, t), atol=1e-9)


def test_saturated_force_is_the_nearest_that_acts():
    axis = machine("emps2019").replace(effects=[{"kind": "actuator_saturation", "limit": 2.0}])
    q, v, a, t = np.array([[0.0], [0.1], [10.0], [0.0]])
    assert inverse_force(axis, q, v, a, t)[0] == pytest.approx(2.0 * axis.drive.force_gain, rel=2e-3)


def test_quadrants_of_the_paper_and_of_an_unsymmetric_axis():
    speeds = np.array([0.1, 0.2])
    for name, quadrants in (
        ("emps2018-two-quadrant", (474.9727, 563.8568, 17.3811, 11.5846)),
        ("emps2019", (203.5034, 203.5034, 20.3935 - 3.1648, 20.3935 + 3.1648)),
    ):
        axis = machine(name)
        model = FrictionModel.of(axis)
        assert model.array()[1:] == pytest.approx(quadrants)
        forth, back = steady_friction(axis, speeds), steady_friction(axis, -speeds)
        np.testing.assert_allclose(forth, model.viscous_positive * speeds + model.coulomb_positive, rtol=1e-12)
        np.testing.assert_allclose(back, -model.viscous_negative * speeds - model.coulomb_negative, rtol=1e-12)


def test_motion_of_different_lengths_is_refused():
    with pytest.raises(InputError, match=r"motion: found shapes \(2,\), \(1,\)"):
        plant_force(machine("emps2019"), np.zeros(2), np.zeros(1), np.zeros(1), np.zeros(1))
