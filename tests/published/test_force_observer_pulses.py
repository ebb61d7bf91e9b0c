"""A 178 N square wave behind the back of the real machine's drive, observed with parameters of another record."""

import numpy as np
import pytest

from emps_design.identification import identify
from emps_design.identification.observation import observe, with_known_push
from emps_design.records import read_record

VOLTS_PER_PULSE = 1.0139  # V for a unit of pulses_N, regressed from the record itself


@pytest.fixture(scope="module")
def observation(emps_data):
    axis = identify(read_record(emps_data / "DATA_EMPS.mat")).to_axis()
    pulses = read_record(emps_data / "DATA_EMPS_PULSES.mat")
    wave = np.ravel(np.asarray(pulses.extra["pulses_N"], dtype=float))
    return observe(with_known_push(pulses, VOLTS_PER_PULSE * wave, axis.drive.force_gain), axis)


@pytest.mark.parametrize(
    ("method", "away", "delay"), [("offline", 4.0, 1e-3), ("online", 3.0, 9e-3), ("kalman", 3.0, 10e-3)]
)
def test_pulses_are_seen(observation, method, away, delay):
    result = observation.methods[method]
    assert result.steps.edges == 49
    assert abs(result.steps.plateau_error_percent) < 1.0
    assert result.steps.rms_error_away_from_edges < away
    assert abs(result.steps.delay) < delay


def test_break_away_sets_the_smallest_force(observation):
    """The paper's finding: what can be seen is limited by static friction, not by the sensor chain."""
    for result in observation.methods.values():
        assert result.smallest.bound == "break_away"
        assert result.smallest.bounds["noise"] < result.smallest.value
