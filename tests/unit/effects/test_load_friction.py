"""Friction on the load side of a coupling: where it acts at a steady speed, at rest, and what becomes of the energy."""

from math import pi

import numpy as np
import pytest

from emps_design.effects import get_effect
from emps_design.effects.effect import CHECK_BASELINE
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.simulation import Plant

KINDS = {"flexible_coupling": {}, "backlash": {"gap": 2e-4}}
MASS, VISCOUS, COULOMB, _ = CHECK_BASELINE


def numbers(kind, share=1.0):
    return {**KINDS[kind], "frequency": 40.0, "damping": 0.05, "share": 0.5, "load_friction": share}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("v", [0.1, -0.1])
def test_at_a_steady_speed_the_coupling_is_wound_by_the_friction_of_the_load(kind, v):
    effect, b = get_effect(kind), np.array(CHECK_BASELINE)
    friction = 0.6 * (VISCOUS * v + COULOMB * np.sign(v))
    twist = friction / (0.25 * MASS * (2.0 * pi * 40.0) ** 2) + 0.5 * np.sign(v) * KINDS[kind].get("gap", 0.0)
    dx, p, x = np.zeros(2), effect.values(numbers(kind, 0.6)), (twist, v)
    effect.rate(0.0, v, 0.0, 0.0, x, p, b, COULOMB, dx)
    np.testing.assert_allclose(dx, 0.0, atol=1e-6)
    # Force, dry friction and the baseline's: in all what there was.
    assert effect.contribution(numbers(kind, 0.6), b, v=v, x=x) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_motor_without_friction_swings_against_a_load_that_its_friction_holds(kind):
    """On the load, half as much force as would move it: the rest of the mass swings on the spring, the load stays."""
    bare = {**numbers(kind), "damping": 0.0, **({"gap": 0.0} if kind == "backlash" else {})}
    axis = machine("emps2019").replace(
        mechanics={"mass": 100.0, "viscous": 0.0, "coulomb": 20.0, "offset": 0.0},
        effects=[{"kind": kind, **bare}],
        sampling={"encoder_resolution": 0.0},
    )
    force, stiffness = 5.0, 25.0 * (80.0 * pi) ** 2  # twice the force in the spring at most
    run = Plant.of(axis).open_loop(np.full(60, force / axis.drive.gain))
    swing = force / stiffness * (1.0 - np.cos(np.sqrt(stiffness / 50.0) * run.t))
    np.testing.assert_allclose(run.position, swing, atol=0.03 * np.ptp(swing))


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_with_other_parameters_is_that_of_the_axis_with_them(kind):
    """What the stepper sums once for a run, friction and mass that the load takes over, follows the run's numbers."""
    axis = machine("emps2019")
    bare, rubbing = (axis.replace(effects=[{"kind": kind, **numbers(kind, share)}]) for share in (0.0, 0.6))
    u = np.repeat(np.random.default_rng(6).uniform(-4, 4, 12), 25)
    given = [get_effect(kind).values(numbers(kind, 0.6))]
    run, same = Plant.of(bare).open_loop(u, parameters=given), Plant.of(rubbing).open_loop(u)
    np.testing.assert_array_equal(run.position, same.position)
    assert np.abs(run.position - Plant.of(bare).open_loop(u).position).max() > 1e-5


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.3, 1.0])
def test_the_balance_of_energy_closes_and_friction_takes_it(kind, share):
    axis = machine("emps2019").replace(effects=[{"kind": kind, **numbers(kind, share)}])
    u = np.repeat(np.random.default_rng(5).uniform(-4, 4, 12), 25)
    energy = Plant.of(axis).open_loop(u, v0=0.1, energy=True).energy
    scale = 1e-6 * (1.0 + abs(energy["motor"]) + abs(energy["friction"]))
    assert abs(energy["residual"]) < scale
    assert energy["friction"] + energy["effects"] < 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_linear_plant_has_the_friction_where_it_is(kind):
    """Static gain from force to speed is that of the whole friction, wherever it acts."""
    from emps_design.control.linear_plant import linear_plant

    axis = machine("emps2019").replace(effects=[{"kind": kind, **numbers(kind, 0.7)}])
    plant = linear_plant(axis)
    a, b = plant.A[1:, 1:], plant.B[1:]  # without the position, which has no rest
    assert -np.linalg.solve(a, b)[0] == pytest.approx(axis.drive.gain / axis.mechanics.viscous, rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("given", [{"frequency": 0.3}, {"frequency": 900.0}, {"share": 0.99}, {"damping": 2.0}])
def test_a_file_may_say_more_than_a_search_looks_at(kind, given):
    effect = get_effect(kind)
    bounds = {p.name: (p.lower, p.upper) for p in effect.parameters}
    ((name, value),) = given.items()
    assert effect.values({**numbers(kind), **given})[[*bounds].index(name)] == value
    assert (bounds["frequency"], bounds["damping"], bounds["share"]) == ((5.0, 400.0), (0.0, 1.0), (0.01, 0.95))
    assert not bounds[name][0] <= value <= bounds[name][1]


@pytest.mark.parametrize("frequency", [0.0, 0.05, 3e4, np.inf])
def test_what_no_machine_has_is_refused(frequency):
    with pytest.raises(InputError, match="frequency: found"):
        get_effect("flexible_coupling").values({**numbers("flexible_coupling"), "frequency": frequency})
