"""Hold periods on one matrix a piece, alone and beside smooth forces, against small Runge-Kutta steps."""

import numpy as np
import pytest

from emps_design.effects import get_effect
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.simulation import Plant
from emps_design.simulation.kernels.motion import LINEAR
from emps_design.simulation.plant import Inputs
from emps_design.simulation.synthetic import trapezoid_laps

LAG = {"kind": "actuator_lag", "time_constant": 0.25e-3}
SLOPES = {"kind": "asymmetric_viscous_friction", "viscous_difference": -40.0}
COUPLING = {"kind": "flexible_coupling", "frequency": 35.0, "damping": 0.05, "share": 0.4}
PLAY = {"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4}
STRIBECK = {"kind": "stribeck_friction", "excess": 10.0, "stribeck_velocity": 0.02, "exponent": 1.0}
RIPPLE = {"kind": "position_ripple", "amplitude": 5.0, "period": 0.02, "phase": 0.3}
LOADED = {"kind": "load_dependent_friction", "share": 0.1}
HEAVIER = {"kind": "mass_change", "change": 0.2, "time": 0.7003}
PUSHED = {"kind": "external_force", "amplitude": 8.0, "start": 0.5003, "duration": 0.4001, "every": 0.0}
BESIDE = [
    (STRIBECK,),
    (RIPPLE, PUSHED),
    (LOADED,),
    (HEAVIER, STRIBECK),
    (STRIBECK, RIPPLE, LAG),
    (LOADED, HEAVIER, RIPPLE),
]
REFERENCE = trapezoid_laps(1e-3, stroke=0.1, speed=0.2, laps=1)
VOLTS = np.repeat(np.random.default_rng(3).uniform(-3.0, 3.0, 60), 37)


def plant_with(frequency, damping, share, *others, load_friction=0.0):
    coupling = {"frequency": frequency, "damping": damping, "share": share, "load_friction": load_friction}
    effects = [{"kind": "flexible_coupling", **coupling}, *others]
    return Plant.of(machine("emps2019").replace(effects=effects))


@pytest.mark.parametrize("frequency", [5.0, 35.0, 400.0])
@pytest.mark.parametrize(("damping", "share"), [(0.0, 0.9), (0.05, 0.4), (1.0, 0.05)])
@pytest.mark.parametrize("others", [(), (LAG,), (SLOPES, {**LAG, "time_constant": 1e-5})], ids=["alone", "lag", "both"])
def test_one_matrix_is_where_small_steps_lead(frequency, damping, share, others):
    plant = plant_with(frequency, damping, share, *others)
    run, tight = (plant.open_loop(VOLTS, method=method, tolerance=1e-4) for method in ("linear", "general"))
    assert len(run.events) == len(tight.events) > 20
    assert np.abs(run.position - tight.position).max() < 1e-12
    np.testing.assert_array_equal(run.position, plant.open_loop(VOLTS, tolerance=1e-4).position)


@pytest.mark.parametrize("seed", [9, 25, 51, 85])
def test_a_velocity_that_dips_to_zero_and_back_is_seen(seed):
    """A slow drive at a third of the resonance's period: the load stops the carriage between two ends of a part."""
    plant, u = plant_with(90.0, 0.02, 0.7), np.repeat(np.random.default_rng(seed).uniform(-1.5, 1.5, 40), 9)
    run, tight = (plant.open_loop(u, period=4e-3, method=one, tolerance=1e-4) for one in ("linear", "general"))
    assert len(run.events) == len(tight.events)
    assert np.abs(run.position - tight.position).max() < 1e-11


def test_friction_on_the_load_is_stepped():
    rubbing = plant_with(35.0, 0.05, 0.4, load_friction=0.3)
    with pytest.raises(InputError, match="expected one of auto, general for this axis"):
        rubbing.open_loop(VOLTS, method="linear")
    given = [get_effect("flexible_coupling").values({"frequency": 35.0, "damping": 0.05, "share": 0.4})]
    same = rubbing.open_loop(VOLTS, parameters=given, method="linear")
    np.testing.assert_array_equal(same.position, plant_with(35.0, 0.05, 0.4).open_loop(VOLTS).position)


def plant_with_play(gap, frequency, damping, share, *others):
    play = {"gap": gap, "frequency": frequency, "damping": damping, "share": share}
    return Plant.of(machine("emps2019").replace(effects=[{"kind": "backlash", **play}, *others]))


def follow(plant, **more):
    """In closed loop, where the encoder's steps do not make two runs of the same bounces part."""
    return plant.closed_loop(REFERENCE, quantise=False, **more)


@pytest.mark.parametrize(("frequency", "damping", "share"), [(10.0, 0.0, 0.8), (60.0, 0.15, 0.4), (400.0, 0.5, 0.05)])
@pytest.mark.parametrize("others", [(), (LAG, SLOPES)], ids=["alone", "lag and slopes"])
def test_play_is_solved_in_pieces(frequency, damping, share, others):
    plant = plant_with_play(1e-4, frequency, damping, share, *others)
    run, tight = (follow(plant, method=method, tolerance=1e-4) for method in ("linear", "general"))
    assert len(tight.events) > 20
    assert np.abs(run.position - tight.position).max() < 1e-13


@pytest.mark.parametrize("seed", range(8))
def test_a_load_that_touches_between_two_ends_of_a_part_is_seen(seed):
    plant, u = plant_with_play(2e-6, 70.0, 0.3, 0.5), np.random.default_rng(seed).uniform(0.5, 4.0, 60).repeat(5)
    run, tight = (plant.open_loop(u, period=2e-3, method=one, tolerance=1e-4) for one in ("linear", "general"))
    assert np.abs(run.position - tight.position).max() < 1e-13


def test_without_a_gap_play_is_a_coupling():
    without, coupled = plant_with_play(0.0, 35.0, 0.05, 0.4), plant_with(35.0, 0.05, 0.4)
    assert np.abs(without.open_loop(VOLTS).position - coupled.open_loop(VOLTS).position).max() < 1e-11


@pytest.mark.parametrize("first", [COUPLING, PLAY], ids=["coupling", "play"])
@pytest.mark.parametrize("others", BESIDE, ids=[" and ".join(one["kind"] for one in others) for others in BESIDE])
def test_smooth_forces_beside_are_within_the_tolerance(first, others):
    """A hundredth of what an encoder of 1 um tells, and less with a tighter tolerance."""
    plant = Plant.of(machine("emps2019").replace(effects=[first, *others]))
    tight = follow(plant, tolerance=1e-5)
    off = [np.abs(follow(plant, tolerance=one).position - tight.position).max() for one in (1.0, 1e-2)]
    assert off[0] < 1e-8
    assert off[1] < max(0.3 * off[0], 2e-11)


def test_a_force_that_sees_the_command_behind_a_lag_is_stepped():
    """What it sees fades, and is no parabola of time."""
    ideal, lagged = (Plant.of(machine("emps2019").replace(effects=[PLAY, LOADED, *more])) for more in ((), (LAG,)))
    assert [one.prepared(Inputs(*one.numbers(), 1, 1e-3, 0.0)).settings[LINEAR] for one in (ideal, lagged)] == [3, 0]
