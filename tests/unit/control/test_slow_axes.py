"""Slow loops at fast clocks: a step is followed as far as the loop needs, however many samples that takes."""

import numpy as np
import pytest

from emps_design.control.discretisation import sample_axis
from emps_design.control.margins import loop_margins
from emps_design.control.position import design_position_loop
from emps_design.control.sampled import axis_loop
from emps_design.control.velocity.design import command_in_a_step, design_velocity_loop, largest_velocity_step
from emps_design.control.velocity.gains import IP, PI, PI_WITH_REFERENCE_FILTER
from emps_design.control.velocity.limits import limits, reach, retune_velocity_loop
from emps_design.control.velocity.sampled import (
    EVERY,
    SampledVelocityLoop,
    step_answer,
    sweep_sampled_margins,
    sweep_stability,
)
from emps_design.control.verdict import step_responses
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine

FAST_CLOCK = 6.25e-5
SLOW = machine("emps2018").replace(mechanics={"mass": 2000.0, "viscous": 500.0}, sampling={"period": FAST_CLOCK})
COUPLING = {"kind": "flexible_coupling", "frequency": 3.0, "damping": 0.02, "share": 0.4}


def cascade(every):
    return machine("emps2018").replace(
        controller={"kind": "cascade", "position": {"kp": 9.0, "every": every}, "velocity": {"kp": 300.0, "ti": 0.05}}
    )


@pytest.mark.parametrize("every", [1, 3, 100])
@pytest.mark.parametrize("by", ["reference", "force"])
def test_the_answer_is_that_of_the_loop_gone_through_sample_by_sample(every, by):
    loop, samples = axis_loop(cascade(every)), EVERY + 15_000
    inputs = np.zeros((samples, len(loop.inputs)))
    inputs[:, loop.inputs.index(by)] = 1.0
    true = loop.simulate(inputs)
    k, found, position = step_answer(loop, by, samples)
    np.testing.assert_allclose(found, true[k], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(position, (np.cumsum(true[:, 1]) * loop.period)[k], rtol=1e-8, atol=1e-9)
    assert np.array_equal(k[:EVERY], np.arange(EVERY))
    assert k[-1] > 0.98 * samples


@pytest.mark.parametrize("structure", [IP, PI, PI_WITH_REFERENCE_FILTER])
def test_the_step_of_a_loop_a_million_samples_slow_is_that_of_the_continuous_loop(structure):
    continuous, sampled = step_responses(design_velocity_loop(SLOW, crossover=0.5, structure=structure))
    assert sampled.t[-1] / FAST_CLOCK > 5 * EVERY
    assert sampled.overshoot_percent == pytest.approx(continuous.overshoot_percent, abs=0.05)
    assert sampled.settling_time == pytest.approx(continuous.settling_time, rel=0.01)
    assert sampled.rise_time == pytest.approx(continuous.rise_time, rel=0.01)


def test_the_position_loop_of_a_slow_axis_overshoots_as_asked():
    inner = design_velocity_loop(SLOW, crossover=1.0, phase_margin_deg=60.0)
    found = design_position_loop(inner, "overshoot", 10.0)
    slower = design_position_loop(
        design_velocity_loop(SLOW.replace(sampling={"period": 1e-3}), crossover=1.0, phase_margin_deg=60.0),
        "overshoot",
        10.0,
    )
    assert found.kp == pytest.approx(slower.kp, rel=0.01)  # of a clock at which 8 s are few samples
    assert 40.0 < found.nested[-1].margins.phase_margin_deg < 60.0


def test_the_voltage_of_a_slow_axis_is_sought_until_its_peak():
    for crossover in (0.5, 3.0):
        coarse, fine = (SLOW.replace(sampling={"period": period}) for period in (2e-3, FAST_CLOCK))
        loops = [(axis, design_velocity_loop(axis, crossover=crossover).sampled) for axis in (coarse, fine)]
        steps = [largest_velocity_step(*one)["value"] for one in loops]
        commands = [command_in_a_step(*one, 0.1) for one in loops]
        assert steps[1] == pytest.approx(steps[0], rel=0.02)
        assert commands[1] == pytest.approx(commands[0], rel=0.02)


def test_a_limit_that_binds_at_the_slowest_loop_looked_at_binds_already_below():
    plant = sample_axis(SLOW)
    said = limits(SLOW, plant, reach(plant, 60.0), 60.0, IP, 1.0)["binding"]
    assert "m/s exceeds the limit, from below" in said


def test_a_loop_on_the_border_has_no_phase_margin():
    """Rounding may put its response just beyond -1, which is no margin of a full turn."""
    found = loop_margins(lambda w: -np.exp(-1e-9j) / w, np.geomspace(0.1, 10.0, 30), stable=True)
    assert found.phase_margin_deg == 0.0


@pytest.mark.parametrize("crossover", [0.4, 0.1, 0.01])
def test_a_loop_slower_than_the_grid_begins_has_margins(crossover):
    design = design_velocity_loop(SLOW.replace(mechanics={"viscous": 5.0}), crossover=crossover, phase_margin_deg=60.0)
    true, found = design.plant_input, design.sampled
    assert found.margins.phase_margin_deg == pytest.approx(true.phase_margin_deg, abs=0.1)
    assert found.margins.crossover == pytest.approx(true.crossover, rel=1e-3)
    assert found.velocity_error.phase_margin_deg == pytest.approx(60.0, abs=0.1)
    assert found.margins.disk_margin == pytest.approx(1.1, abs=0.1)
    assert found.bandwidth == pytest.approx(design.bandwidth, rel=1e-2)
    swept = sweep_sampled_margins(found.plant, np.array([design.k_v1]), np.array([design.t_v]))
    assert swept["phase_margin_deg"][0] == pytest.approx(true.phase_margin_deg, abs=0.1)


@pytest.mark.parametrize(
    "effects", [[], [{"kind": "flexible_coupling", "frequency": 3.0, "damping": 0.02, "share": 0.4}]]
)
@pytest.mark.parametrize("filters", [(), (Filter(kind="lowpass", frequency=50.0),)])
def test_the_stability_of_many_slow_loops_is_that_of_their_poles(effects, filters):
    plant = sample_axis(SLOW.replace(effects=effects), filters=filters)
    w = np.geomspace(1e-3, 1e3, 13)
    k_v1, t_v = np.concatenate([30.0 * w, 900.0 * w]), np.concatenate([2.0 / w, 0.5 / w])
    loops = [SampledVelocityLoop(plant, *map(float, one)) for one in zip(k_v1, t_v, strict=True)]
    found = sweep_stability(plant, k_v1, t_v)
    assert found.tolist() == [loop.stable for loop in loops]
    assert found[:6].all()
    assert not found.all()


def test_a_slow_bandwidth_can_be_retuned():
    design = retune_velocity_loop(SLOW.replace(mechanics={"viscous": 5.0}), bandwidth=0.16, phase_margin_deg=60.0)
    assert design.sampled.bandwidth == pytest.approx(0.16, rel=1e-6)
    assert design.sampled.margins.phase_margin_deg == pytest.approx(60.0, abs=1e-3)
