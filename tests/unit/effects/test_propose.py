"""Starting points that effects propose from what a model leaves."""

import dataclasses

import numpy as np
import pytest

from emps_design.effects import EFFECTS, Motion, get_effect
from emps_design.effects.effect import CHECK_BASELINE

B = np.array(CHECK_BASELINE)


def still(count=24000, period=1e-3):
    t = np.arange(count) * period
    w = 2 * np.pi * 0.31
    q, v, a = 0.1 * (1 - np.cos(w * t)), 0.1 * w * np.sin(w * t), 0.1 * w**2 * np.cos(w * t)
    return Motion(t, q, v, a, B[0] * a + B[1] * v, period, 0.05 * a)


@pytest.mark.parametrize("blanked", [0, 50])
@pytest.mark.parametrize(
    "true",
    [
        {"amplitude": 0.9, "frequency": 0.59, "duty": 0.5, "start": 1.5968},
        {"amplitude": -0.6, "frequency": 0.7, "duty": 0.3, "start": 0.8},
        {"amplitude": 5.07, "frequency": 1.0, "duty": 0.5, "start": 0.344},
    ],
)
def test_a_wave_in_the_law_is_read_to_a_sample(true, blanked):
    effect, motion = get_effect("controller_disturbance"), still()
    p = effect.values(true)
    wave = np.array([effect.command(0.0, 0.0, t, 0.0, (), p, B) for t in motion.t])
    gap = wave + 4e-3 * np.random.default_rng(1).standard_normal(wave.size)
    gap[:blanked] = 0.0
    found = effect.search.propose(motion, gap, B, np.ones(gap.size, bool))[0]
    seen = np.array([effect.command(0.0, 0.0, t, 0.0, (), effect.values(found), B) for t in motion.t])
    assert found["amplitude"] == pytest.approx(true["amplitude"], rel=1e-3)
    assert found["frequency"] == pytest.approx(true["frequency"], rel=1e-4)
    assert np.mean(np.abs(seen - wave)[blanked:] > 0.1 * abs(true["amplitude"])) < 0.003


@pytest.mark.parametrize("effect", [e for e in EFFECTS if e.search.propose is not None], ids=lambda effect: effect.name)
def test_proposals_are_parameters_within_bounds(effect):
    motion = still()
    noise = np.random.default_rng(2).standard_normal(motion.t.size)
    known = {p.name: p for p in effect.parameters}
    for residual in (noise, np.zeros_like(noise), 3.0 * np.sin(2 * np.pi * motion.q / 0.02) + noise):
        for table in effect.search.propose(motion, residual, B, np.abs(motion.v) > 1e-3):
            assert set(table) <= set(known)
            missing = [name for name, p in known.items() if name not in table and not p.linear]
            assert not missing
            assert all(np.isfinite(value) for value in table.values())


@pytest.mark.parametrize("name", ["position_ripple", "friction_ripple", "encoder_error"])
def test_periods_are_sought_in_proportion_to_the_stroke(name):
    """The same motion ten times as far: the same periods, ten times as long."""
    effect, small = get_effect(name), still(4000)
    large = dataclasses.replace(small, q=12 * small.q, v=12 * small.v, a=12 * small.a)
    small = dataclasses.replace(small, q=1.2 * small.q, v=1.2 * small.v, a=1.2 * small.a)
    force = np.random.default_rng(3).standard_normal(small.t.size)
    near, far = (
        [p["period"] for p in effect.search.propose(m, force, B, np.abs(small.v) > 1e-3)] for m in (small, large)
    )
    assert far == pytest.approx([10 * period for period in near], rel=0.1)


def test_the_cogging_of_a_shaft_that_turns_on_and_on():
    """8 turns, 72 poles: searched down to a share of a turn, neither of half a millimetre nor of the whole way."""
    t = np.arange(24000) * 1e-3
    v = 2.0 + np.sin(0.7 * t)
    q = np.cumsum(v) * 1e-3
    turning = Motion(t, q, v, np.gradient(v, 1e-3), v, 1e-3, v)
    force = np.sin(72 * q) + 0.3 * np.random.default_rng(4).standard_normal(t.size)
    found = get_effect("position_ripple").search.propose(turning, force, B, np.ones(t.size, bool))
    assert found[0]["period"] == pytest.approx(2 * np.pi / 72, rel=5e-3)


@pytest.mark.parametrize(("swings", "told"), [(2.0, False), (0.5, True)])
def test_a_periodic_disturbance_is_told_from_the_motion_of_a_machine_that_swings(swings, told):
    """A force at the frequency at which the machine is swung to and fro would pass for its inertia."""
    t = np.arange(12_000) * 1e-3
    q, rate = 0.1 * np.sin(2 * np.pi * swings * t), 2 * np.pi * swings
    v, a = 0.1 * rate * np.cos(rate * t), -(rate**2) * q
    motion = Motion(t, q, v, a, v, 1e-3)
    disturbance = {"amplitude": 1.0, "phase": 0.0, "frequency": 2.0}
    assert get_effect("periodic_disturbance").search.plausible(disturbance, motion) is told
    turning = Motion(t, 5.0 * t + q, 5.0 + v, a, v, 1e-3)  # which the disturbance itself may swing
    assert get_effect("periodic_disturbance").search.plausible(disturbance, turning)
