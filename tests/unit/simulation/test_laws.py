"""Control laws as difference equations, anti-windup, force loop, delay, noise, limits."""

import numpy as np
import pytest

from emps_design.errors import AxisError, InputError, SimulationError
from emps_design.laws import Law, law_of
from emps_design.laws.library.ip_velocity import ip_velocity
from emps_design.machines import machine
from emps_design.simulation import Hand, Plant

AXIS = machine("emps2019")
IP = AXIS.replace(controller={"kind": "ip_velocity", "kp": None, "kv": None, "k_v1": 400.0, "t_v": 0.02})


def ramp(speed=0.05, n=2000):
    return speed * np.arange(n) * 1e-3


def test_position_pd_is_the_law_of_the_data_set():
    run = Plant.of(AXIS).closed_loop(0.02 * np.sin(np.arange(1000) / 100) ** 2)
    kp, kv = AXIS.controller.kp, AXIS.controller.kv
    q = np.concatenate([[run.q[0]] * 2, run.q])
    filtered = 0.5 * (q[1:] + q[:-1])
    u = kp * kv * (run.q_ref - run.q) - kv * np.diff(filtered) / 1e-3
    np.testing.assert_allclose(run.u, np.clip(u, -10.0, 10.0), atol=1e-9)


def test_encoder_reads_whole_steps():
    run = Plant.of(AXIS).closed_loop(ramp())
    steps = run.q / AXIS.sampling.encoder_resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(run.q - run.position).max() <= 0.5 * AXIS.sampling.encoder_resolution * (1 + 1e-9)


def test_ip_velocity_is_its_difference_equation():
    run = Plant.of(IP).closed_loop(ramp(), quantise=False)
    law = law_of(IP, 1e-3)
    v = np.concatenate([[0.0], [run.q[1] - run.q[0]], run.q[2:] - run.q[:-2]]) / 2e-3
    reference = np.diff(run.q_ref, prepend=run.q_ref[0]) / 1e-3
    integral = np.cumsum(law.gains[1] * (reference - v))
    np.testing.assert_allclose(run.u, integral - 400.0 * v, atol=1e-9)
    assert run.v[-1] == pytest.approx(0.05, rel=1e-3)


def test_backward_estimator_takes_the_last_two_samples():
    axis = AXIS.replace(controller={"velocity_estimator": "backward"})
    run = Plant.of(axis).closed_loop(ramp(n=300), quantise=False)
    v = np.diff(run.q, prepend=run.q[0]) / 1e-3
    kp, kv = axis.controller.kp, axis.controller.kv
    expected = np.clip(kp * kv * (run.q_ref - run.q) - kv * v, -10.0, 10.0)
    np.testing.assert_allclose(run.u, expected, atol=1e-9)


def test_anti_windup_leaves_the_limit_at_once():
    """Held back by a force beyond the limit for a second, then let go: no overshoot to speak of."""
    axis = IP.replace(drive={"command_limit": 3.0})
    n = 4000
    push = np.where((np.arange(n) > 500) & (np.arange(n) < 1500), -150.0, 0.0)
    run = Plant.of(axis).closed_loop(ramp(n=n), disturbance=push)
    assert np.abs(run.u).max() == 3.0
    wound = np.zeros(8)
    volts = [ip_velocity(k, 0.05, 0.0, 0.0, 3.0, law_of(axis, 1e-3).gains, wound) for k in range(5000)]
    assert volts[-1] == 3.0
    assert abs(wound[2]) <= 3.0 + 1e-12
    assert run.v[1500:].max() < 0.5
    assert run.v[-1] == pytest.approx(0.05, rel=1e-2)


def test_force_loop_follows_the_hand():
    """k_e1 f_ext is the velocity the axis is asked for: the carriage yields with k_c = 1/k_e1."""
    axis = IP.replace(controller={"k_e1": 0.002})
    push = np.full(3000, 20.0)
    run = Plant.of(axis).closed_loop(np.zeros(3000), disturbance=push)
    assert run.v[-1] == pytest.approx(0.002 * 20.0, rel=1e-3)


def test_hand_on_the_force_loop_takes_the_carriage_along():
    axis = IP.replace(controller={"k_e1": 0.01})
    intention = 0.05 * (1 - np.cos(2 * np.pi * 0.5 * np.arange(3000) * 1e-3))
    run = Plant.of(axis).touched_by(Hand(0.5, 20.0, 400.0)).closed_loop(np.zeros(3000), intention=intention)
    assert np.abs(run.position - intention).max() < 0.04
    assert np.ptp(run.position) > 0.05


def test_computation_delay_shifts_whole_samples():
    q_ref = ramp(n=300)
    delayed = Plant.of(AXIS.replace(sampling={"computation_delay": 3})).closed_loop(q_ref)
    assert not delayed.position[:4].any()
    plant = Plant.of(AXIS)
    again = plant.open_loop(np.concatenate([np.zeros(3), delayed.u[:-3]]))
    np.testing.assert_allclose(again.position, delayed.position, atol=1e-13)


def test_delays_of_both_kinds_are_the_same_for_whole_samples():
    effect = [{"kind": "actuator_delay", "delay": 3e-3}]
    q_ref = ramp(n=300)
    whole = Plant.of(AXIS.replace(sampling={"computation_delay": 3})).closed_loop(q_ref, quantise=False)
    physical = Plant.of(AXIS.replace(effects=effect)).closed_loop(q_ref, quantise=False)
    np.testing.assert_allclose(physical.position, whole.position, atol=1e-13)


def test_noise_is_part_of_the_recorded_voltage():
    noise = 0.01 * np.random.default_rng(0).standard_normal(500)
    q_ref = ramp(n=500)
    with_noise = Plant.of(AXIS).closed_loop(q_ref, voltage_noise=noise)
    again = Plant.of(AXIS).open_loop(with_noise.u)
    np.testing.assert_allclose(again.position, with_noise.position, atol=1e-13)


def own_law(k, reference, q, f_ext, limit, gains, memory):
    memory[0] += gains[0] * (reference - q)
    return memory[0] + gains[1] * (reference - q)


def test_a_law_of_ones_own():
    run = Plant.of(AXIS).closed_loop(np.full(3000, 1e-3), q0=0.0, law=Law(own_law, np.array([20.0, 3e4]), 1))
    assert run.q[-1] == pytest.approx(1e-3, abs=3e-4)


def test_a_controller_is_needed_to_close_a_loop():
    with pytest.raises(AxisError, match=r"emps2019: controller.kind: found 'none', .*; the command law identifies"):
        Plant.of(AXIS.replace(controller={"kind": "none"})).closed_loop(ramp())


@pytest.mark.parametrize(
    "effects", [[], [{"kind": "stribeck_friction", "excess": 5.0, "stribeck_velocity": 0.01, "exponent": 1.0}]]
)
def test_an_unstable_loop_is_an_error_with_time_state_and_effect(effects):
    axis = AXIS.replace(controller={"kv": 8000.0}, effects=effects)
    with pytest.raises(SimulationError, match="the loop is unstable: the voltage has swung") as caught:
        Plant.of(axis).closed_loop(ramp())
    assert 0 < caught.value.time < 1
    assert len(caught.value.state) == 2
    assert caught.value.effect == ("stribeck_friction" if effects else "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"q_ref": np.array([0.0, np.nan])}, "q_ref: sample 1 is nan"),
        ({"q_ref": np.zeros((2, 2))}, r"q_ref: found shape \(2, 2\)"),
        ({"q_ref": np.zeros(5), "baseline": [-1, 0, 0, 0]}, "baseline: found"),
        ({"q_ref": np.zeros(5), "baseline": [np.nan, 0, 0, 0]}, "baseline: found"),
        ({"q_ref": np.zeros(5), "disturbance": np.zeros(4)}, "disturbance: found shape"),
        ({"q_ref": np.zeros(5), "parameters": [np.zeros(3)]}, "parameters: found"),
        ({"q_ref": np.zeros(5), "method": "magic"}, "method: found 'magic'"),
        ({"q_ref": np.zeros(5), "intention": np.zeros(5)}, "intention: found 0 hands"),
        ({"q_ref": np.zeros(5), "period": -1.0}, "period: found -1"),
        ({"q_ref": np.zeros(5), "q0": np.inf}, "q0, v0: found inf m"),
    ],
)
def test_what_cannot_be_meant_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Plant.of(AXIS).closed_loop(**arguments)


def test_no_mass_left_is_an_error():
    effects = [
        {"kind": "flexible_coupling", "frequency": 40.0, "damping": 0.1, "share": 0.6},
        {"kind": "backlash", "gap": 1e-4, "frequency": 40.0, "damping": 0.1, "share": 0.6},
    ]
    with pytest.raises(SimulationError, match="leave no mass on the encoder's side"):
        Plant.of(AXIS.replace(effects=effects)).closed_loop(ramp())


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"voltage_noise": np.zeros(4000)},
        {"effects": [{"kind": "flexible_coupling", "frequency": 40.0, "damping": 0.1, "share": 0.3}]},
        {"effects": [{"kind": "stribeck_friction", "excess": 1.0, "stribeck_velocity": 0.1, "exponent": 1.0}]},
    ],
)
def test_a_shaft_turns_as_far_as_it_likes(options):
    shaft = AXIS.replace(motion="rotary", mechanics={"viscous": 0.1}, effects=options.pop("effects", []))
    turned = 400.0 * np.arange(4000) * 1e-3  # rad
    run = Plant.of(shaft).closed_loop(turned, v0=400.0, **options)
    assert run.position[-1] > 1100.0


def test_motion_without_bounds_is_an_error():
    axis = AXIS.replace(mechanics={"viscous": 0.0, "coulomb": 0.0, "mass": 1e-3})
    with pytest.raises(SimulationError, match="the motion is unbounded"):
        Plant.of(axis).open_loop(np.full(5000, 10.0))
