"""Hold periods of a linear axis on one matrix, against Runge-Kutta steps at a tight tolerance."""

import numpy as np
import pytest

from emps_design.effects import get_effect
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.simulation import Plant

LAG = {"kind": "actuator_lag", "time_constant": 0.25e-3}
SLOPES = {"kind": "asymmetric_viscous_friction", "viscous_difference": -40.0}
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
