"""What the motor's back-EMF brakes counts as viscous friction wherever gains are derived from the axis."""

import numpy as np
import pytest

from emps_design.control.impedance.law import impedance_law
from emps_design.control.impedance.passivity import Clock, sampled_loop
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.gains import sweep_velocity_loop
from emps_design.errors import SpecificationError
from emps_design.frequency_response.experiment import _steady_command
from emps_design.laws.law import FrictionModel
from emps_design.machines import machine

PLAIN = machine("emps2018")
BRAKED = PLAIN.replace(drive={"back_emf": 10.0})
BRAKING = BRAKED.drive.braking
STIFFER = PLAIN.replace(mechanics={"viscous": PLAIN.mechanics.viscous + BRAKING})  # the same, written as friction


@pytest.mark.parametrize(
    "asked", [{"crossover": 100.0, "phase_margin_deg": 60.0}, {"bandwidth": 150.0, "phase_margin_deg": 55.0}]
)
def test_gains_are_those_of_the_friction_that_brakes_as_much(asked):
    ours, same = design_velocity_loop(BRAKED, **asked), design_velocity_loop(STIFFER, **asked)
    assert 0.5 * PLAIN.mechanics.viscous < BRAKING
    assert (ours.k_v1, ours.t_v, ours.bandwidth) == (same.k_v1, same.t_v, same.bandwidth)
    assert ours.k_v1 != design_velocity_loop(PLAIN, **asked).k_v1
    for one in ("velocity_error", "plant_input"):
        assert getattr(ours, one) == getattr(same, one)
    for one in ("velocity_error_loop", "plant_input_loop", "closed_loop"):
        assert np.allclose(
            getattr(ours, one)().frequency_response(50.0)[0], getattr(same, one)().frequency_response(50.0)[0]
        )
    assert ours.feasible_phase_margin_deg == same.feasible_phase_margin_deg
    assert not any("friction slope" in text for text in ours.warnings)


def test_a_fast_sampled_loop_reaches_what_the_gains_were_derived_for():
    fast = BRAKED.replace(sampling={"period": 1e-5, "computation_delay": 0}, drive={"current_time_constant": 0.0})
    design = design_velocity_loop(fast, crossover=30.0, phase_margin_deg=60.0)
    assert design.sampled.bandwidth == pytest.approx(design.bandwidth, rel=0.01)


def test_sweeps_and_what_cannot_be_met_see_it_too():
    asked = np.array([40.0, 100.0]), np.array([60.0, 60.0])
    ours, same = (sweep_velocity_loop(axis, *asked) for axis in (BRAKED, STIFFER))
    assert np.array_equal(ours.k_v1, same.k_v1)
    told = []
    for axis in (BRAKED, STIFFER):
        with pytest.raises(SpecificationError) as raised:
            design_velocity_loop(axis, crossover=1e-3, phase_margin_deg=60.0)
        told.append(str(raised.value))
    assert told[0] == told[1]


def test_the_impedance_law_compensates_it():
    law = impedance_law(BRAKED, 50.0, 100.0)
    assert law.estimate == FrictionModel.of(STIFFER)
    axes = BRAKED, STIFFER
    ours, same = (sampled_loop(law, FrictionModel.of(axis), Clock.of(axis)).radius for axis in axes)
    assert ours == same < 1.0


def test_passes_of_an_experiment_take_it():
    assert _steady_command(BRAKED, 0.1) == pytest.approx(_steady_command(STIFFER, 0.1))
    assert _steady_command(BRAKED, 0.1) > _steady_command(PLAIN, 0.1)
