"""The stiffest wall of a light rotary axis: far below a newton metre per radian, and still the true limit."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.control.impedance.law import FrictionModel, impedance_law
from emps_design.control.impedance.passivity import Clock, Environment, contact_map, largest_wall, sampled_loop
from emps_design.machines import machine
from tests.unit.unlike_axes import JOINT

SMALL = Axis.from_dict(
    {
        "name": "small",
        "motion": "rotary",
        "mechanics": {"mass": 2e-4, "viscous": 1e-4, "coulomb": 0.01},
        "drive": {"command": "duty", "force_gain": 0.05, "supply": 24.0, "back_emf": 0.06, "command_limit": 1.0},
        "sampling": {"period": 1e-3, "encoder_resolution": 1.5e-3, "computation_delay": 1},
    }
)


def law_of(axis, mass, damping):
    return impedance_law(axis, mass, damping, None), FrictionModel.of(axis), Clock.of(axis)


def stable_at(law, plant, clock, stiffness) -> bool:
    return sampled_loop(law, plant, clock, environment=Environment(stiffness=float(stiffness))).stable


@pytest.mark.parametrize(("axis", "mass", "damping"), [(JOINT, 1e-3, 2e-3), (SMALL, 1e-4, 2e-4)])
def test_the_stiffest_wall_of_a_light_axis_is_a_true_limit(axis, mass, damping):
    law, plant, clock = law_of(axis, mass, damping)
    wall = largest_wall(law, plant, clock)
    assert 0.0 < wall < 1.0
    assert stable_at(law, plant, clock, 0.99 * wall)
    assert not stable_at(law, plant, clock, 1.02 * wall)
    assert all(stable_at(law, plant, clock, softer) for softer in np.geomspace(1e-5, 0.99, 40) * wall)
    shaky, *rest = law_of(axis, 1e-3 * mass, 1e-3 * damping)
    assert not stable_at(shaky, *rest, 0.0)
    assert largest_wall(shaky, *rest) == 0.0  # as for a heavy axis


def test_the_walls_of_the_map_are_sized_to_the_axis():
    found = contact_map(*law_of(machine("emps2018"), 50.0, 100.0))
    np.testing.assert_allclose(found.stiffness, [0.0, *np.geomspace(10.0, 1e7, 30)])
    np.testing.assert_allclose(found.damping, [0.0, *np.geomspace(1.0, 1e4, 20)])
    law, plant, clock = law_of(JOINT, 1e-3, 2e-3)
    light = contact_map(law, plant, clock)
    undamped = light.radius[0, 1:] < 1.0
    assert undamped.any()
    assert not undamped.all()
    wall = largest_wall(law, plant, clock)
    assert light.stiffness[1] < wall < light.stiffness[-1]
