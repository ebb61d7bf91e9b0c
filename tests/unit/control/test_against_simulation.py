"""The linear loops against the simulation, which shares no code with them: without dry friction they agree."""

import numpy as np
import pytest

from emps_design.control.force import design_force_loop
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.errors import SimulationError
from emps_design.machines import machine
from emps_design.simulation import Hand, Plant

SMOOTH = machine("emps2018").replace(mechanics={"coulomb": 0.0, "offset": 0.0}, drive={"command_limit": 1e4})


def simulated(axis, controller, reference, surroundings=(), v0=0.0):
    plant = Plant.of(axis.replace(controller=controller))
    if surroundings:
        plant = plant.touched_by(*surroundings)
    return plant.closed_loop(np.zeros(reference.size), reference=reference, quantise=False, v0=v0)


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(
    "effects",
    [
        [],
        [{"kind": "actuator_delay", "delay": 0.4e-3}],
        [{"kind": "flexible_coupling", "frequency": 60.0, "damping": 0.05, "share": 0.3}],
    ],
    ids=["rigid", "delayed", "flexible"],
)
def test_step_of_the_velocity_reference(delay, effects):
    axis = SMOOTH.replace(sampling={"computation_delay": delay}, effects=effects)
    design = design_velocity_loop(axis, crossover=60.0, phase_margin_deg=60.0)
    assert design.sampled.stable
    run = simulated(axis, design.controller_table(), np.full(200, 0.01))
    _, velocity, voltage = design.sampled.step_response(200)
    np.testing.assert_allclose(run.u, 0.01 * voltage, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(run.v, 0.01 * velocity, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("phase", "delay", "stable"), [(80.0, 0, True), (80.0, 1, False), (60.0, 1, True)])
def test_the_verdict_is_what_the_simulation_does(phase, delay, stable):
    axis = SMOOTH.replace(sampling={"computation_delay": delay})
    design = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=phase)
    assert design.sampled.stable is stable
    reference = np.concatenate([np.full(20, 1e-3), np.zeros(480)])
    try:
        swing = np.abs(simulated(axis, design.controller_table(), reference).v)
    except SimulationError:
        assert not stable
        return
    assert bool(np.max(swing[-50:]) < 1e-3 * np.max(swing[:50])) == stable


@pytest.mark.parametrize(("hand", "wall"), [(0.0, 1e5), (100.0, 0.0), (30.0, 2e4)])
@pytest.mark.parametrize("share", [0.95, 1.05])
def test_force_loop_limit_is_the_simulation_s(hand, wall, share):
    """A bilateral spring and damper at the carriage, its force measured: it rings down below the limit, up above."""
    loop = design_velocity_loop(SMOOTH, crossover=100.0, phase_margin_deg=60.0)
    design = design_force_loop(loop, 1e-3, hand=hand, environment=wall)
    controller = {**loop.controller_table(), "k_e1": share * design.k_e1_max_sampled}
    still = np.zeros(3000)
    plant = Plant.of(SMOOTH.replace(controller=controller)).touched_by(Hand(damping=hand, stiffness=wall))
    try:
        run = plant.closed_loop(still, reference=still, intention=still, quantise=False, v0=1e-3)
    except SimulationError:
        assert share > 1.0
        return
    early, late = np.max(np.abs(run.v[200:600])), np.max(np.abs(run.v[-400:]))
    assert bool(late < early) == (share < 1.0)
