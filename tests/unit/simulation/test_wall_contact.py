"""A push into a wall: the simulation and the poles of the loop in contact say the same."""

import numpy as np
import pytest

from emps_design.comanipulation.wall import push_into_wall
from emps_design.control.impedance.law import FrictionModel, impedance_law
from emps_design.control.impedance.passivity import Clock, Environment, sampled_loop
from emps_design.errors import InputError
from emps_design.machines import machine

AXIS = machine("emps2018")


@pytest.mark.parametrize("filter", [100.0, 2000.0])
@pytest.mark.parametrize("stiffness", [1e3, 5e4, 2e5])
def test_it_bounces_for_ever_where_the_poles_are_unstable(filter, stiffness):
    law = impedance_law(AXIS, 50.0, 100.0, filter)
    contact = Environment(stiffness=stiffness)
    stable = sampled_loop(law, FrictionModel.of(AXIS), Clock.of(AXIS), environment=contact).stable
    found = push_into_wall(AXIS, law, stiffness)
    assert (found.verdict == "at rest") == stable
    assert (found.verdict == "bouncing") == (not stable)


def test_at_rest_the_wall_carries_the_push_but_for_friction():
    found = push_into_wall(AXIS, impedance_law(AXIS, 50.0, 100.0), 1e4)
    held = np.searchsorted(found.t, found.release) - 1
    assert found.verdict == "at rest"
    assert abs(found.push[held] + found.wall_force[held]) < 17.4 + 20.9  # Coulomb friction of both directions, N
    depth = found.q - found.position
    assert np.allclose(found.wall_force, -1e4 * np.maximum(depth, 0.0), atol=5.0)
    assert found.peak_force > 40.0
    assert found.to_dict()["peak_force"] == found.peak_force


def test_a_push_below_the_friction_does_not_reach_it():
    found = push_into_wall(AXIS, impedance_law(AXIS, 50.0, 100.0), 1e4, force=5.0)
    assert found.verdict == "not reached"
    assert found.peak_force == 0.0
    assert found.swings is None


def test_an_unstable_law_is_a_verdict_with_a_reason():
    found = push_into_wall(AXIS, impedance_law(AXIS, 5.0, 100.0), 1e4)
    assert found.verdict == "unstable"
    assert "unstable" in found.reason
    assert found.peak_force is None


def test_no_push_is_refused():
    with pytest.raises(InputError, match="force: found 0 N, expected more than 0 N"):
        push_into_wall(AXIS, impedance_law(AXIS, 50.0, 100.0), 1e4, force=0.0)
