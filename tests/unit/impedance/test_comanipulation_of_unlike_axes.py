"""The co-manipulation scenario on axes unlike the paper's: the law taken, the travel, and what its fit is worth."""

import json

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.comanipulation.scenario import run_comanipulation, usual_law
from emps_design.comanipulation.task import fitted_task, guided_task
from emps_design.control.impedance.law import impedance_law
from emps_design.machines import machine

JOINT = Axis.from_dict(
    {
        "name": "joint",
        "motion": "rotary",
        "mechanics": {"mass": 0.8, "viscous": 3.0, "coulomb": 2.0},
        "drive": {"command": "current", "command_unit": "mA", "force_gain": 0.008, "command_limit": 8000.0,
                  "current_time_constant": 0.4e-3},
        "sampling": {"period": 1e-3, "encoder_resolution": 1e-5},
    }
)  # fmt: skip
LIGHT = Axis.from_dict(
    {
        "name": "light",
        "mechanics": {"mass": 0.3, "viscous": 2.0, "coulomb": 0.8},
        "drive": {"command": "current", "force_gain": 12.0, "command_limit": 3.0, "current_time_constant": 0.1e-3},
        "sampling": {"period": 0.125e-3, "encoder_resolution": 1e-7, "computation_delay": 1},
    }
)

BELT = machine("emps2018").replace(
    mechanics={"mass": 25.0, "viscous": 60.0, "coulomb": 8.0, "offset": 0.0},
    drive={"force_gain": 20.0, "command_limit": 24.0, "current_time_constant": 0.5e-3},
    sampling={"encoder_resolution": 2e-5},
)


@pytest.mark.parametrize(("axis", "travel"), [(JOINT, 0.6), (machine("emps2018"), 0.12)], ids=["joint", "emps2018"])
def test_a_rotary_axis_is_guided_over_as_much_as_the_studio_moves_it(axis, travel):
    """The wish is two sines whose peaks do not meet: it stays within the travel and fills most of it."""
    task = fitted_task(axis, impedance_law(axis, 0.5 * axis.mechanics.mass, 0.5 * axis.mechanics.mass))
    assert 0.85 * travel < np.nanmax(np.abs(task.wish)) <= travel


def test_the_apparent_inertia_of_a_joint_is_fitted_in_motion():
    """Over 0.12 rad most of the torque was that of breaking away: 0.277 kg m^2 with r2 = 0.64 for an exact 0.4."""
    found = run_comanipulation(JOINT, 0.0, plants=0, mass=0.4, damping=0.5).to_dict()
    assert found["transparency"]["apparent_mass"] == pytest.approx(0.4, rel=0.03)
    assert found["transparency"]["r2"] > 0.95
    assert not any("poor fit" in warning for warning in found["warnings"])


def test_friction_that_has_to_be_broken_away_is_no_mass():
    """Most of the force of a light carriage: 0.125 kg for an exact 0.15, r2 = 0.89, by the acceleration of samples."""
    found = run_comanipulation(LIGHT, 0.0, plants=0, mass=0.15, damping=0.5).to_dict()
    assert found["transparency"]["apparent_mass"] == pytest.approx(0.15, rel=0.02)
    assert found["transparency"]["apparent_damping"] == pytest.approx(0.5, rel=0.02)
    assert not any("poor fit" in warning for warning in found["warnings"])


def test_a_poor_fit_is_said_to_be_one():
    """A spring that the law does not know of is neither mass nor damping."""
    spring = {"kind": "elastic_force", "stiffness": 2000.0, "rest_position": 0.0}
    axis = machine("emps2018").replace(effects=[spring])
    found = run_comanipulation(axis, 0.0, plants=0, mass=50.0, damping=100.0).to_dict()
    assert found["transparency"]["r2"] < 0.95
    (said,) = (warning for warning in found["warnings"] if "poor fit to the force of this motion" in warning)
    assert "friction" not in said


@pytest.mark.parametrize(
    ("axis", "mass", "damping"),
    [
        (BELT, 15.0, 60.0),
        (machine("emps2018").replace(sampling={"encoder_resolution": 5e-6}), 50.0, 100.0),
        (machine("emps2018").replace(sampling={"encoder_resolution": 1e-5}), 50.0, 100.0),
    ],
    ids=("20 um", "5 um", "10 um"),
)
def test_an_ordinary_encoder_does_not_hide_the_mass(axis, mass, damping):
    """8.0 kg of 15, 39 and 24.5 of 50 by the acceleration of single samples."""
    felt = run_comanipulation(axis, 0.0, plants=0, mass=mass, damping=damping).to_dict()["transparency"]
    assert felt["apparent_mass"] == pytest.approx(mass, rel=0.06)
    assert felt["apparent_damping"] == pytest.approx(damping, rel=0.15)
    assert felt["r2"] > 0.999


def test_the_usual_law_is_sized_by_the_mass():
    assert usual_law(machine("emps2018")) == usual_law(machine("emps2019")) == (50.0, 100.0)
    for axis in (LIGHT, JOINT, machine("emps2018").replace(mechanics={"mass": 3000.0})):
        assert 0.2 < usual_law(axis)[0] / axis.mechanics.mass < 0.8, axis.name


def test_the_text_names_the_law_and_what_was_taken(capsys, tmp_path):
    path = tmp_path / "light.toml"
    path.write_text(LIGHT.to_toml(), encoding="utf-8")
    asked = ["simulate", str(path), "--scenario", "comanipulation", "--plants", "0", "--mismatch", "0"]
    assert run([*asked, "--mass", "0.15", "--damping", "0.5"]) == 0
    out, err = capsys.readouterr()
    rows = {line[:32].strip(): line[32:].split() for line in out.splitlines()}
    assert rows["asked apparent mass"] == ["0.15", "kg"]
    assert rows["asked apparent damping"] == ["0.5", "N/(m/s)"]
    assert "not given" not in err
    assert run([*asked, "--damping", "0.5", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["asked"] == {"apparent_mass": 0.1, "apparent_damping": 0.5}
    assert "M_a = 0.1 kg: default of the paper's experiments, in proportion to the mass" in err


def test_a_task_of_a_given_length_moves_a_joint_as_far():
    found = run_comanipulation(JOINT, 0.0, plants=0, mass=0.4, damping=0.5, duration=4.0).study.task
    assert np.nanmax(np.abs(found.wish)) > 4.0 * np.nanmax(np.abs(guided_task(1e-3, 4.0).wish))
