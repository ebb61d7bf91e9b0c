"""Energy: the balance closes, and friction never makes any."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from emps_design.machines import machine
from emps_design.simulation import Hand, Plant, Wall
from tests.physics.cases import CASES, OUTSIDE, axis_with, voltage

DISSIPATIVE = {  # effects whose force can only take energy, with parameters between these
    "stribeck_friction": {"excess": (0, 20), "stribeck_velocity": (1e-3, 0.1), "exponent": (1, 2)},
    "load_dependent_friction": {"share": (0, 0.5)},
    "position_dependent_friction": {"amplitude": (0, 30), "phase": (-3, 3), "length": (0.02, 1)},
    "presliding_friction": {"stiffness": (1e4, 1e6)},
    "maxwell_slip_friction": {"share": (0, 1), "travel": (1e-4, 2e-2)},
    "flexible_coupling": {"frequency": (10, 200), "damping": (0, 0.5), "share": (0.05, 0.8)},
    "backlash": {"gap": (0, 1e-3), "frequency": (10, 150), "damping": (0, 0.3), "share": (0.05, 0.8)},
    "end_stop": {"stiffness": (1e3, 1e5), "position": (1e-3, 0.01), "side": (1, 1)},
}


@st.composite
def machines(draw):
    mechanics = {
        "mass": draw(st.floats(1.0, 300.0)),
        "viscous": draw(st.floats(0.0, 800.0)),
        "coulomb": draw(st.floats(0.0, 60.0)),
        "offset": draw(st.floats(-10.0, 10.0)),
    }
    names = draw(st.lists(st.sampled_from(sorted(DISSIPATIVE)), max_size=3, unique=True))
    if "backlash" in names:  # two loads would leave no mass on the encoder's side
        names = [name for name in names if name != "flexible_coupling"]
    if "presliding_friction" in names:  # its level must stay above zero, or the bent contact is wiped out
        names = [name for name in names if name != "position_dependent_friction"]
        mechanics["coulomb"] += 5.0
    effects = [
        {"kind": name, **{p: draw(st.floats(low, high)) for p, (low, high) in DISSIPATIVE[name].items()}}
        for name in names
    ]
    period = draw(st.sampled_from([1e-3, 2e-3]))
    sampling = {"period": period, "encoder_resolution": 0.0}
    return machine("emps2019").replace(mechanics=mechanics, effects=effects, sampling=sampling)


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(machines(), st.integers(0, 2**32 - 1), st.floats(-0.3, 0.3))
def test_friction_never_makes_energy(axis, seed, v0):
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-4, 4, 12), 25)
    run = Plant.of(axis).open_loop(u, v0=v0, energy=True)
    energy, scale = run.energy, 1e-6 * (1.0 + abs(run.energy["motor"]) + abs(run.energy["friction"]))
    assert abs(energy["residual"]) < scale
    assert energy["friction"] <= scale
    assert energy["effects"] <= scale  # they store nothing at the start, so they cannot return more than they took


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(machines(), st.floats(-0.3, 0.3))
def test_without_drive_the_carriage_only_slows_down(axis, v0):
    rigid = [e for e in axis.effects if not e.effect.states and e.kind not in ("end_stop",)]
    axis = axis.replace(mechanics={"offset": 0.0}, effects=rigid)
    speed = np.abs(Plant.of(axis).open_loop(np.zeros(400), v0=v0).v)
    assert (np.diff(speed) <= 1e-12).all()


@pytest.mark.parametrize("name", [name for name in CASES if name not in (*OUTSIDE, "mass_change")])
def test_balance_closes(name):
    run = Plant.of(axis_with(name)).open_loop(voltage(), energy=True)
    assert abs(run.energy["residual"]) < 1e-7
    assert run.energy["friction"] < -0.1


def test_energy_of_the_core_in_closed_form():
    axis = machine("emps2019").replace(mechanics={"viscous": 0.0, "offset": 0.0})
    run = Plant.of(axis).open_loop(np.zeros(500), v0=0.05, energy=True)
    kinetic = 0.5 * axis.mechanics.mass * 0.05**2
    assert run.energy["friction"] == pytest.approx(-kinetic, rel=1e-9)
    assert run.energy["kinetic"] == pytest.approx(-kinetic, rel=1e-9)
    assert run.energy["friction"] == pytest.approx(-axis.mechanics.coulomb * run.position[-1], rel=1e-9)


def test_hand_and_wall():
    plant = Plant.of(machine("emps2019")).touched_by(Hand(1.0, 20.0, 2000.0), Wall(0.01, 1e5, 0.5))
    intention = 0.05 * np.sin(2 * np.pi * np.arange(2000) * 1e-3)
    run = plant.open_loop(np.zeros(2000), intention=intention, energy=True)
    assert 0.01 < run.position.max() < 0.02
    assert abs(run.energy["residual"]) < 1e-7
    at_rest = (run.v == 0) & (np.abs(np.gradient(run.v)) == 0) & (run.position < 0.0099)
    expected = 2000.0 * (intention - run.position) + 20.0 * np.diff(intention, append=intention[-1]) / 1e-3
    np.testing.assert_allclose(run.f_ext[at_rest][:-1], expected[at_rest][:-1], atol=0.1)
