"""A law whose poles are stable may still not run on its encoder: the headline and a warning say so."""

import pytest

from emps_design.comanipulation.assessment import SWINGS, assess_impedance
from emps_design.machines import machine
from tests.studies import quick

JOINT = {
    "motion": "rotary",
    "mechanics": {"mass": 2.5e-4, "viscous": 3e-4, "coulomb": 0.012, "offset": 0.002},
    "drive": {"command": "current", "command_unit": "mA", "force_gain": 1.1e-4, "command_limit": 4000.0},
    "controller": {"kind": "none"},
    "effects": [],
}


@pytest.mark.usefixtures("few_estimates")
@pytest.mark.parametrize(("step", "runs"), quick([(1e-9, True), (6.283e-4, False)], 1, "a long run"))
def test_the_encoder_decides_where_the_poles_do_not(step, runs):
    axis = machine("emps2019").replace(**JOINT, sampling={"period": 2.5e-4, "encoder_resolution": step})
    found = assess_impedance(axis, 1e-4, 1e-3, None, 2000.0).to_dict()
    assert found["sampled"]["stable"]
    assert (found["sampled"]["simulated"] != "unstable") == runs
    said = any("simulated load keeps oscillating" in text for text in found["warnings"])
    assert said == (found["sampled"]["simulated"] in SWINGS)
