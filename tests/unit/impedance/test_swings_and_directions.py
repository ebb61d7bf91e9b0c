"""What the poles do not tell: laws that swing for ever, axes that sink, two directions of motion that differ."""

import numpy as np
import pytest

from emps_design.comanipulation.assessment import SWINGS, assess_impedance
from emps_design.comanipulation.run import run_task
from emps_design.comanipulation.study import mismatch_study
from emps_design.comanipulation.task import fitted_task
from emps_design.control.impedance.law import FrictionModel, impedance_law
from emps_design.control.impedance.passivity import Clock, contact_map, largest_wall, passivity, sampled_loop
from emps_design.control.impedance.robustness import creep_speed, sinking_force, smallest_mass, verdict
from emps_design.machines import machine
from tests.studies import quick

pytestmark = pytest.mark.usefixtures("no_walls")
AXIS = machine("emps2018")
JOINT = AXIS.replace(
    motion="rotary",
    mechanics={"mass": 0.8, "viscous": 3.0, "coulomb": 2.0, "offset": 0.0},
    drive={"command": "current", "command_unit": "mA", "force_gain": 0.008, "command_limit": 8000.0},
    sampling={"encoder_resolution": 1e-5},
)
HANGING = AXIS.replace(mechanics={"mass": 40.0, "viscous": 150.0, "coulomb": 12.0, "offset": 60.0})
# A pole of modulus 1.004 for motion to -, of 0.98 to +.
ONE_WAY = AXIS.replace(
    mechanics={"mass": 60.0, "viscous": 450.0, "coulomb": 15.0, "offset": 0.0},
    effects=[{"kind": "asymmetric_viscous_friction", "viscous_difference": -400.0}],
)
COUPLED = AXIS.replace(effects=[{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.3}])


def swings(axis, law, mismatch):
    """Whether one of 30 plants drawn does, by the whole axis, guided and let go."""
    study = mismatch_study(axis, law, mismatch, 30, seed=1, task=fitted_task(axis, law))
    return study.to_dict()["bounded_share"] < 1.0


@pytest.mark.parametrize(("axis", "mass", "damping"), [(AXIS, 2.0, 100.0), (JOINT, 0.05, 0.5)], ids=("slide", "joint"))
@pytest.mark.parametrize("mismatch", quick([None, 0.02], 1, "under a mismatch"))
def test_a_law_that_is_proposed_or_called_safe_does_not_swing(axis, mass, damping, mismatch):
    found = assess_impedance(axis, mass, damping, mismatch, plants=0)
    assert not found.stable
    nearest, safe = found.nearest, found.to_dict()["smallest_safe_mass"]
    proposed = impedance_law(axis, nearest["mass"], nearest["damping"], nearest["filter"])
    assert not swings(axis, proposed, mismatch or 1e-3)
    assert not swings(axis, impedance_law(axis, safe, damping), mismatch or 1e-3)
    # The poles alone would allow lighter ones.
    plant, clock = FrictionModel.of(axis), Clock.of(axis)
    law = impedance_law(axis, 1.05 * smallest_mass(found.law, plant, clock, mismatch or 0.0), damping)
    assert law.mass < safe
    assert sampled_loop(law, plant, clock).stable
    assert swings(axis, law, mismatch or 1e-3)


def test_a_law_that_swings_though_its_poles_are_stable_gets_one_that_does_not():
    found = assess_impedance(AXIS, 6.98, 100.0, None, 163.6)
    assert found.poles_stable
    assert not found.stable
    assert found.simulated in SWINGS
    document = found.to_dict()
    other = document["nearest"]
    law = impedance_law(AXIS, other["mass"], other["damping"], other["filter"])
    assert run_task(AXIS, law, fitted_task(AXIS, law)).verdict not in SWINGS
    (said,) = (text for text in document["warnings"] if "keeps oscillating" in text)
    assert f"nearest stable: mass {other['mass']:.4g} kg" in said


def test_an_axis_that_friction_does_not_hold_sinks_and_no_coulomb_factor_helps(no_walls):
    assert sinking_force(FrictionModel.of(HANGING)) == 48.0
    assert sinking_force(FrictionModel.of(AXIS)) == 0.0
    found = assess_impedance(HANGING, 20.0, 50.0, 0.02, plants=10).to_dict()
    assert found["mismatch"]["coulomb_factor_without_creep"] is None
    assert found["sampled"]["simulated"] == "creeping"
    assert any(
        "exceeds dry friction by 48 N" in text and "hold the axis at rest: it sinks" in text
        for text in found["warnings"]
    )
    assert any("no Coulomb factor prevents it" in text for text in found["warnings"])


@pytest.mark.parametrize("factor", [1.0, 0.9804])
def test_a_carriage_that_turned_and_goes_on_is_not_at_rest(factor):
    """It goes up, turns and sinks: what it tends to is read from how it sinks."""
    law = impedance_law(HANGING, 20.0, 50.0, coulomb_factor=factor)
    run = run_task(HANGING, law, fitted_task(HANGING, law))
    assert run.v[-1] < -1e-4
    assert run.verdict == "creeping"
    assert run.measures.tends_to[0] == pytest.approx(-np.mean(run.v[-1000:]), rel=0.2)


@pytest.mark.study("long runs")
def test_a_creep_that_has_settled_does_not_grow():
    """What is left of its change after two minutes is rounding."""
    study = mismatch_study(AXIS, impedance_law(AXIS, 50.0, 100.0), 0.2, 60)
    plants = [study.plant(i) for i in range(60)]
    assert {"creeping", "dead_band"} == {one["verdict"] for one in plants}


def test_a_stiffness_ends_every_drift(no_walls):
    law, plant = impedance_law(AXIS, 50.0, 100.0, stiffness=200.0), FrictionModel.of(AXIS)
    over = law.with_errors({"mass": 0.02, "viscous": 0.02, "coulomb": 0.02})
    free = impedance_law(AXIS, 50.0, 100.0).with_errors({"coulomb": 0.02})
    assert creep_speed(over, plant) == 0.0 < creep_speed(free, plant)
    assert verdict(over, plant, Clock.of(AXIS)) == "stable"
    run = run_task(AXIS, over, fitted_task(AXIS, law))
    assert run.v[-1] == 0.0
    found = assess_impedance(AXIS, 50.0, 100.0, 0.02, plants=10, stiffness=200.0).to_dict()
    assert not any("creep" in text for text in found["warnings"])


def test_the_worse_direction_of_motion_counts():
    found = assess_impedance(ONE_WAY, 5.0, 50.0, None, 100.0)
    document, plant, clock = found.to_dict(), found.plant, found.clock
    radii = [sampled_loop(found.law, plant, clock, direction).radius for direction in (1, -1)]
    assert radii[0] < 0.99 < 1.004 < radii[1]
    assert not document["sampled"]["stable"]
    assert max(np.abs(document["sampled"]["poles"])) == pytest.approx(radii[1])
    assert document["passivity"] is document["largest_wall_stiffness"] is None
    assert f"a pole of modulus {radii[1]:.5g}" in found.reason
    # A stable law: contact in either direction alone, by axes whose friction is that of one.
    law = impedance_law(ONE_WAY, 20.0, 50.0, 100.0)
    each = []
    for viscous in plant.viscous:
        alike = FrictionModel(plant.mass, viscous, viscous, *plant.coulomb[:1], *plant.coulomb[:1])
        one = impedance_law(ONE_WAY.replace(mechanics={"viscous": viscous}, effects=[]), 20.0, 50.0, 100.0)
        each.append((largest_wall(one, alike, clock), passivity(one, alike, clock)))
    walls = [wall for wall, _ in each]
    assert walls[0] != walls[1]
    assert largest_wall(law, plant, clock) == min(walls)
    assert passivity(law, plant, clock).sampled == all(one.sampled for _, one in each)
    stiffness = np.array([0.5, 2.0]) * min(walls)
    assert contact_map(law, plant, clock, stiffness, np.zeros(1)).stable.tolist() == [[True, False]]


@pytest.mark.study("the nearest law that works on two masses")
def test_an_unstable_loop_has_no_wall_and_no_passivity():
    document = assess_impedance(COUPLED, 50.0, 100.0).to_dict()
    assert not document["sampled"]["stable"]
    assert document["passivity"] is document["largest_wall_stiffness"] is None
    assert any("the loop is unstable without contact" in text for text in document["warnings"])
