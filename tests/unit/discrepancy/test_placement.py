"""A force is placed where it is, and noise is placed nowhere more often than stated."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.discrepancy import rules
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.placement import placed
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import split
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

DRAWS = 60
# Noise of 0.4 N that lasts some 20 samples: nearly all of it below 40 Hz.
NOISE = Whitening(np.array([1.0, -1.6, 0.65]), 0.05)


@pytest.fixture(scope="module")
def strokes():
    """Motion and halves of a lap."""
    axis = machine("emps2019")
    record = synthetic_record(axis, laps=1)
    problem = Problem(axis, (record,), (split(record),), NOISE)
    return Hypothesis(problem, Candidate(axis.mechanics.array())).run(0), problem.splits[0]


def drawn(run, seed: int) -> np.ndarray:
    """Noise along the motion."""
    return NOISE.undo(np.random.default_rng(seed).standard_normal(run.q.size))


def test_noise_is_placed_as_seldom_as_stated(strokes):
    run, halves = strokes
    placements = [placed(drawn(run, seed), run, halves, NOISE, 0.0) for seed in range(DRAWS)]
    false, stated = sum(bool(found.passed) for found in placements), rules.FALSE_REGIONS
    assert np.mean([found.proposed for found in placements]) > 3
    assert false <= DRAWS * stated + 2 * np.sqrt(DRAWS * stated)


@pytest.mark.parametrize("over", ["speed", "position", "time"])
def test_a_local_force_is_placed_where_it_is(strokes, over):
    run, halves = strokes
    x = {"speed": np.abs(run.v), "position": run.q, "time": run.t}[over]
    low, high = x.min() + np.array([0.5, 0.7]) * np.ptp(x)
    true = (x > low) & (x < high)
    regions = []
    for seed in range(6):
        found = placed(drawn(run, seed) + 1.0 * true, run, halves, NOISE, 0.1)
        assert found.shows(over, (low, high))
        regions += [region for region in found.passed if region.over == over]
    cell = np.ptp(x) / rules.CELLS if over != "time" else 1.0
    false = [r for r in regions if r.interval[1] < low - cell or r.interval[0] > high + cell]
    assert len(false) <= rules.FALSE_REGIONS * len(regions)


def test_a_force_too_small_to_count_is_placed_nowhere(strokes):
    run, halves = strokes
    small = 0.1 * np.sign(run.v)
    assert placed(small, run, halves, replace(NOISE, std=1e-4), 0.05).passed
    assert not placed(small, run, halves, replace(NOISE, std=1e-4), 0.15).passed
