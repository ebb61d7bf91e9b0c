"""The synthetic record: a reference that keeps its promises, and noise of the level it names."""

import numpy as np
import pytest

from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.simulation.synthetic import FORCE_NOISE, synthetic_record, trapezoid_laps

PERIOD = 1e-3


@pytest.mark.parametrize("stroke", [0.24, 0.02])
def test_the_reference_keeps_speed_acceleration_and_stroke(stroke):
    q_ref = trapezoid_laps(PERIOD, stroke=stroke, speed=0.2, acceleration=1.0, laps=2)
    v = np.diff(q_ref) / PERIOD
    assert q_ref.min() == pytest.approx(0.0, abs=1e-12)
    assert q_ref.max() == pytest.approx(stroke)
    assert np.abs(v).max() <= 0.2 + 1e-9
    assert np.abs(np.diff(v)).max() / PERIOD <= 1.0 + 1e-6
    lap = q_ref.size // 2
    assert np.array_equal(q_ref[:lap], q_ref[lap:])


def test_three_speeds_both_ways():
    v = np.diff(trapezoid_laps(PERIOD, laps=1)) / PERIOD
    for speed in (0.2, 0.1, 0.05):
        for sign in (1, -1):
            assert np.count_nonzero(np.isclose(v, sign * speed, rtol=1e-6)) > 500


@pytest.mark.parametrize("name", ["period", "stroke", "speed", "acceleration", "laps"])
def test_impossible_laps(name):
    values = {"period": PERIOD, "stroke": 0.24, "speed": 0.2, "acceleration": 1.0, "laps": 1}
    with pytest.raises(InputError, match=f"{name}: found 0, expected a positive number"):
        trapezoid_laps(**{**values, name: 0})


def test_same_seed_same_bits():
    axis = machine("emps2019")
    first, again, other = (synthetic_record(axis, seed=seed, laps=1, stroke=0.1) for seed in (3, 3, 4))
    assert np.array_equal(first.u, again.u)
    assert not np.array_equal(first.u, other.u)


def test_the_noise_has_the_level_it_names():
    axis = machine("emps2019")
    one, two = (synthetic_record(axis, seed=seed, laps=2) for seed in (1, 2))
    difference = axis.drive.force_gain * (one.u - two.u) / np.sqrt(2)
    # Force noise seen through the closed loop, and 4 mV of voltage noise: within a third of their sum of squares.
    expected = np.hypot(FORCE_NOISE, 0.004 * axis.drive.force_gain)
    assert np.sqrt(np.mean(difference**2)) == pytest.approx(expected, rel=0.33)


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_the_noise_is_of_the_size_of_the_axis(scale):
    """The same motion of an axis with other forces: its records differ by as much of its own force."""
    axis = machine("emps2019")
    mechanics = {key: scale * value for key, value in axis.to_dict()["mechanics"].items()}
    drive = {"force_gain": scale * axis.drive.force_gain}
    records = [
        [synthetic_record(one, seed=seed, laps=1).u for seed in (1, 2)]
        for one in (axis, axis.replace(mechanics=mechanics, drive=drive))
    ]
    own, other = (float(np.std(a - b)) for a, b in records)
    assert other == pytest.approx(own, rel=0.5)


def test_an_axis_that_follows_no_position():
    with pytest.raises(InputError, match="axis emps2018: found controller 'none', expected 'position_pd'"):
        synthetic_record(machine("emps2018"))
