"""Forces and masses that jump in time: a period in which none does is one slide, one in which some do is stepped."""

import numpy as np
import pytest

from emps_design.machines import machine
from emps_design.simulation import Plant
from emps_design.simulation.kernels import motion
from emps_design.simulation.plant import Inputs

VOLTS = np.repeat(np.random.default_rng(3).uniform(-3.0, 3.0, 60), 7)
PULSES = {"kind": "external_force", "amplitude": 12.0}
JUMPS = {
    "with the samples": {**PULSES, "start": 0.05, "duration": 0.02, "every": 0.03},
    "between samples": {**PULSES, "start": 0.05021, "duration": 0.0117, "every": 0.0204},
    "in every period": {**PULSES, "start": 0.05021, "duration": 1e-3, "every": 1.37e-3},
    "just behind a sample": {**PULSES, "start": 0.05 + 3e-10, "duration": 0.02, "every": 0.03},
    "of the mass": {"kind": "mass_change", "change": 0.3, "time": 0.0703},
}
OTHERS = {
    "alone": [],
    "friction": [{"kind": "stribeck_friction", "excess": 9.0, "stribeck_velocity": 0.01, "exponent": 2.0}],
    "lag": [{"kind": "actuator_lag", "time_constant": 1e-5}],
    "contact": [{"kind": "presliding_friction", "stiffness": 1e6}],
}


@pytest.mark.parametrize("lag", [0.0, 5e-4])
@pytest.mark.parametrize("others", OTHERS)
@pytest.mark.parametrize("jumps", JUMPS)
def test_slides_between_jumps_are_where_steps_lead(jumps, others, lag):
    effects = [*OTHERS[others], JUMPS[jumps]]
    plant = Plant.of(machine("emps2019").replace(effects=effects, drive={"current_time_constant": lag}))
    run, tight = plant.open_loop(VOLTS), plant.open_loop(VOLTS, tolerance=1e-4)
    stepped = plant.open_loop(VOLTS, tolerance=1e-4, energy=True)  # an energy balance is taken step by step
    assert np.ptp(stepped.position) > 3e-4
    assert len(run.events) == len(tight.events) == len(stepped.events) > 5
    assert np.abs(run.position - stepped.position).max() < 2e-9
    assert np.abs(tight.position - stepped.position).max() < 1e-11


@pytest.mark.parametrize("stiffness", [1e6, 1e8])
@pytest.mark.parametrize("others", ["alone", "friction"])
def test_a_contact_beside_a_coupling_slides_alike_in_loose_and_tight_steps(others, stiffness):
    coupling = {"kind": "flexible_coupling", "frequency": 60.0, "damping": 0.05, "share": 0.4}
    contact = {"kind": "presliding_friction", "stiffness": stiffness}
    plant = Plant.of(machine("emps2019").replace(effects=[*OTHERS[others], coupling, contact]))
    run, loose, tight = (plant.open_loop(VOLTS, tolerance=tolerance) for tolerance in (1.0, 1e5, 1e-3))
    assert np.ptp(tight.position) > 3e-4
    assert np.abs(run.position - tight.position).max() < 2e-9
    assert np.abs(loose.position - tight.position).max() < 2e-6


@pytest.mark.parametrize("others", ["alone", "friction"])
def test_jumps_leave_the_periods_between_them_to_slides(others):
    plant = Plant.of(machine("emps2019").replace(effects=[*OTHERS[others], JUMPS["with the samples"]]))
    assert plant.prepared(Inputs(*plant.numbers(), 10, 1e-3, 0.0)).settings[motion.SLIDES] == 2.0
