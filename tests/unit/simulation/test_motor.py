"""A motor without a current loop: back-EMF, a supply that a duty is a share of, a winding that may be open."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis
from emps_design.control.linear_plant import linear_plant
from emps_design.errors import AxisError
from emps_design.identification import identify
from emps_design.identification.closed_loop import identify_by_output_error
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.run import Run
from emps_design.simulation.scenarios import replay
from tests.inverse_model import inverse_force

T, SUPPLY = 2e-3, 12.0
ARM = {
    "name": "arm",
    "motion": "rotary",
    "mechanics": {"mass": 0.02, "viscous": 0.01, "coulomb": 0.02, "offset": 0.005},
    "drive": {"command": "duty", "force_gain": 0.1, "command_limit": 1.0, "back_emf": 0.4, "supply": SUPPLY},
    "sampling": {"period": T},
    "controller": {"kind": "p", "kp": 1.5},
}


def arm(**drive) -> Axis:
    return Axis.from_dict({**ARM, "drive": {**ARM["drive"], **drive}})


def program(n=4000):
    t = np.arange(n) * T
    return 0.9 * np.sin(2.1 * t) * np.sin(0.37 * t) + 0.3 * np.sin(5.0 * t)


def test_back_emf_is_viscous_friction_of_a_motor_that_is_on():
    """Constant supply: the same motion as with a gain of supply times force gain, and the braking as friction."""
    run = Plant.of(arm()).closed_loop(program())
    plain = Axis.from_dict(
        {
            **ARM,
            "mechanics": {**ARM["mechanics"], "viscous": 0.01 + 0.1 * 0.4},
            "drive": {"command": "current", "force_gain": 0.1 * SUPPLY, "command_limit": 1.0},
        }
    )
    other = Plant.of(plain).closed_loop(program())
    np.testing.assert_allclose(run.position, other.position, atol=1e-12)
    np.testing.assert_allclose(run.force, other.force, atol=1e-10)
    with_effect = {"effects": [{"kind": "gravity", "torque": 0.2, "angle": 0.1}]}  # steps, not closed forms
    first, second = (Plant.of(axis.replace(**with_effect)).closed_loop(program()).position for axis in (arm(), plain))
    np.testing.assert_allclose(first, second, atol=1e-8)


@pytest.mark.parametrize("gravity", [0.0, 0.2])
def test_against_small_steps(gravity):
    """Supply that sags and a winding that opens for a while, against semi-implicit steps of 10 us."""
    n = 1500
    q_ref, supply = program(n), SUPPLY * (1.0 + 0.1 * np.sin(np.arange(n) / 90.0))
    enable = np.where((np.arange(n) > 500) & (np.arange(n) < 800), 0.0, 1.0)
    axis = arm()
    if gravity:
        axis = axis.replace(effects=[{"kind": "gravity", "torque": gravity, "angle": 0.3}])
    run = Plant.of(axis).closed_loop(q_ref, supply=supply, enable=enable)
    q, v, found, h = q_ref[0], 0.0, np.empty(n), 1e-5
    mass, viscous, coulomb, offset = axis.mechanics.array()
    for k in range(n):
        found[k] = q
        duty = np.clip(1.5 * (q_ref[k] - q), -1.0, 1.0)
        for _ in range(round(T / h)):
            force = enable[k] * 0.1 * (duty * supply[k] - 0.4 * v) - viscous * v - offset - gravity * np.sin(q + 0.3)
            moved = v + h * force / mass
            dry = h * coulomb / mass
            v = np.sign(moved) * max(0.0, abs(moved) - dry)
            q += h * v
    np.testing.assert_allclose(run.position, found, atol=2e-3 * np.ptp(found))
    assert np.ptp(found) > 0.5
    np.testing.assert_allclose(run.force, 0.1 * supply * enable * run.u)


def test_load_dependent_friction_sees_what_the_winding_carries():
    """Steady turning: friction grows with the torque after the back-EMF, which friction alone needs."""
    axis = arm().replace(
        mechanics={"offset": 0.0},
        effects=[{"kind": "load_dependent_friction", "share": 0.2}],
        controller={"kind": "none"},
    )
    v = Plant.of(axis).open_loop(np.full(6000, 0.8)).v[-1]
    torque = 0.1 * (0.8 * SUPPLY - 0.4 * v)
    assert torque == pytest.approx((0.02 + 0.01 * v) / (1.0 - 0.2), rel=1e-6)


def test_a_lag_found_in_a_record_is_that_of_the_current_loop_in_simulation_and_design():
    """What a winding brakes acts at once, and what friction feels of the motor is behind the lag, whoever names it."""
    load = {"kind": "load_dependent_friction", "share": 0.2}
    lag = {"kind": "actuator_lag", "time_constant": 0.02}
    first, second = arm(current_time_constant=0.02).replace(effects=[load]), arm().replace(effects=[load, lag])
    runs = [Plant.of(axis).closed_loop(program()).position for axis in (first, second)]
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-9)
    w = np.geomspace(0.1, 500.0, 30)
    responses = [sample_axis(axis).response(w) for axis in (first, second)]
    np.testing.assert_allclose(responses[0], responses[1], rtol=1e-6)


def test_a_load_that_turns_a_motor_without_current_loads_the_gear_too():
    """Friction in motor and input stage is what the gear then carries, a share of which it adds."""
    load = {"kind": "load_dependent_friction", "share": 0.5, "motor_side": 1.0}
    axis = arm().replace(mechanics={"offset": 0.0}, effects=[load], controller={"kind": "none"})
    run = Plant.of(axis).open_loop(np.full(200, 1.0), v0=3.0, enable=np.zeros(200))
    mass, viscous, coulomb, _ = axis.mechanics.array()
    level, rate = coulomb / viscous, 1.5 * viscous / mass
    np.testing.assert_allclose(run.v, (3.0 + level) * np.exp(-rate * run.t) - level, rtol=1e-6)


@pytest.mark.parametrize(("direction", "share"), [(1.0, 1.0 - 0.4), (-1.0, 1.0 + 0.4)])
def test_a_weight_leaves_up_and_down_at_the_efficiency_of_that_direction(direction, share):
    """The force of the motor grows, or falls, past what the gear passes on to hold the weight."""
    spring = {"kind": "elastic_force", "stiffness": 100.0, "rest_position": -1.0}  # a weight of 100 N at 0
    load = {"kind": "load_dependent_friction", "share": 0.4, "motor_side": 1.0}
    axis = machine("emps2019").replace(
        mechanics={"coulomb": 20.0, "offset": 0.0}, effects=[spring, load], sampling={"period": 1e-3}
    )
    expected = direction * 20.0 + 100.0 / share  # of the motor: up 20 + 100 / 0.6, down -20 + 100 / 1.4
    force = expected + direction * np.linspace(-5.0, 5.0, 2001)
    run = Plant.of(axis).open_loop(force / axis.drive.gain)
    leaves = np.flatnonzero(run.v)[0]
    assert np.sign(run.v[leaves]) == direction
    assert force[leaves] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("others", [[], ["gravity"], ["gravity", "load_dependent_friction"]], ids=len)
def test_the_effect_is_the_back_emf_of_the_axis_file(others):
    """Wherever the number stands: with a supply that sags, a winding that opens, and friction that sees the torque."""
    kinds = {"gravity": {"torque": 0.2, "angle": 0.1}, "load_dependent_friction": {"share": 0.2, "motor_side": 1.0}}
    rest = [{"kind": kind, **kinds[kind]} for kind in others]
    q_ref = program(1500)
    k = np.arange(q_ref.size)
    signals = {"supply": SUPPLY * (1.0 + 0.1 * np.sin(k / 90.0)), "enable": np.where((k > 500) & (k < 800), 0.0, 1.0)}
    effect = arm(back_emf=0.0).replace(effects=[{"kind": "back_emf_braking", "braking": 0.1 * 0.4}, *rest])
    in_file = arm().replace(effects=rest)
    for some in (signals, {}):
        one, other = (Plant.of(axis).closed_loop(q_ref, **some) for axis in (effect, in_file))
        np.testing.assert_allclose(one.position, other.position, atol=1e-8)
    friction = effect.replace(mechanics={"viscous": 0.01 + 0.1 * 0.4}, effects=rest)
    moved = Plant.of(friction).closed_loop(q_ref, **signals).position
    assert np.abs(moved - one.position).max() > 1e-3
    assert linear_plant(effect).A[1] == pytest.approx(linear_plant(in_file).A[1])


def test_an_open_winding_takes_nothing_and_gives_nothing():
    axis = arm().replace(mechanics={"coulomb": 0.0, "offset": 0.0}, controller={"kind": "none"})
    run = Plant.of(axis).open_loop(np.full(200, 1.0), v0=3.0, enable=np.zeros(200))
    np.testing.assert_allclose(run.v, 3.0 * np.exp(-0.01 / 0.02 * run.t), rtol=1e-9)
    assert not run.force.any()


def test_the_energy_balance_closes_with_a_back_emf():
    axis = arm().replace(effects=[{"kind": "gravity", "torque": 0.2, "angle": 0.1}])
    energy = Plant.of(axis).closed_loop(program(1000), energy=True).energy
    assert abs(energy["residual"]) < 1e-6 * max(abs(value) for value in energy.values())


def recorded(seed=1) -> Record:
    random, n = np.random.default_rng(seed), 4000
    supply = SUPPLY * (1.0 + 0.05 * np.sin(np.arange(n) / 300.0))
    run = Plant.of(arm()).closed_loop(program(n), supply=supply)
    u = run.u + 1e-4 * random.standard_normal(n)
    return Record.from_arrays(T, run.q_ref, run.q, u, supply=supply, name="arm")


def test_identification_takes_the_back_emf_off():
    record, bare = recorded(), arm(supply=None)
    for found in (identify(record, bare, estimator="ls"), identify_by_output_error(record, bare)):
        for name, true in (("mass", 0.02), ("viscous", 0.01), ("coulomb", 0.02)):
            assert found.parameters[name].value == pytest.approx(true, rel=0.03), name
    assert bare.supplied_by(record).drive.supply == pytest.approx(SUPPLY, rel=0.02)
    assert arm(supply=9.0).supplied_by(record).drive.supply == 9.0


def test_a_replay_has_the_supply_of_its_record():
    found = replay(arm(supply=None), recorded())
    assert found.to_dict()["mean_absolute_error"]["position"] < 1e-3
    assert found.to_dict()["relative_error_percent"]["force"] < 2.0


def test_a_run_with_a_changing_supply_is_saved_whole(tmp_path):
    run = Plant.of(arm()).closed_loop(program(300), supply=np.linspace(11.0, 13.0, 300))
    run.save(tmp_path / "run.npz")
    np.testing.assert_array_equal(Run.load(tmp_path / "run.npz").force, run.force)


def test_models_know_the_back_emf():
    axis = arm()
    assert linear_plant(axis).A[1, 1] == pytest.approx(-(0.01 + 0.04) / 0.02)
    needed = inverse_force(axis, *np.array([[0.0], [2.0], [0.0], [0.0]]))
    assert needed[0] == pytest.approx(0.01 * 2.0 + 0.02 + 0.005 + 0.04 * 2.0)


def test_a_duty_without_a_supply_is_told():
    bare = arm(supply=None)
    with pytest.raises(AxisError, match=r"drive\.supply: missing, expected the supply voltage of the duty"):
        Plant.of(bare).closed_loop(program(50))
    assert Axis.from_toml(arm().to_toml(comments=True)) == arm()
    with pytest.raises(AxisError, match=r"drive\.supply: found with a voltage command"):
        machine("emps2019").replace(drive={"supply": 5.0})
