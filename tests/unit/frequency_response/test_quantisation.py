"""The encoder's steps in a spectrum: the step is found, and what repeats of it is what a rounded motion has."""

import numpy as np
import pytest

from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.response import BAND
from emps_design.frequency_response.signals import quantised, repeated_share
from emps_design.records.record import quantisation_step, step_before_rounding
from tests.unit.frequency_response.cases import exact, experiment, multi_sine, two_mass

SAMPLES, PERIODS = 1000, 4
LINES = np.arange(3, 200, 2)


def motion(advance, steps, rng):
    """A multi-sine of ``steps`` on a motion of ``advance`` steps a period, (n,) in steps."""
    wave = steps * multi_sine(SAMPLES, LINES, rng)
    return np.tile(wave, PERIODS) + advance / SAMPLES * np.arange(PERIODS * SAMPLES) + rng.uniform()


@pytest.mark.parametrize("form", ["%.15g", "%.9g", "%.7g"])
@pytest.mark.parametrize("step", [1e-5, 6.283e-4, 2.0**-20])
def test_the_step_is_found_whatever_digits_a_file_has(step, form):
    rng = np.random.default_rng(1)
    q = step * np.rint(motion(9000.3, 40.0, rng))
    written = np.array([float(form % value) for value in q])
    assert quantisation_step(np.diff(written, prepend=written[:1])) == pytest.approx(step, rel=1e-3)


def test_no_step_where_there_is_none():
    rng = np.random.default_rng(2)
    assert quantisation_step(np.diff(motion(9000.3, 40.0, rng), prepend=0.0)) == 0.0
    assert quantisation_step(1e-4 + 3e-7 * rng.standard_normal(5000)) == 0.0
    assert quantisation_step(np.full(100, 0.1)) == 0.0
    assert quantisation_step(np.zeros(100)) == 0.0
    noise = 1e-5 * rng.standard_normal(5000)
    assert quantisation_step(np.diff(np.sin(np.arange(5000) / 1000) + noise)) == 0.0


@pytest.mark.parametrize("levels", [[0.0, 1.0], [-1.0, 0.0, 1.0]])
def test_levels_with_noise_are_no_steps(levels):
    """A relay's command or two constant speeds: few levels, evenly spaced as levels are, and each with its noise."""
    rng = np.random.default_rng(4)
    clusters = rng.choice(levels, 3000) + 3e-3 * rng.standard_normal(3000)
    assert quantisation_step(clusters) == 0.0
    assert quantisation_step(rng.choice(levels, 3000)) == 1.0


def test_slow_motion_in_single_precision_has_the_encoders_step():
    q = 1.5e-3 * np.rint(np.cumsum(np.full(20_000, 0.31)))
    assert quantisation_step(np.diff(q.astype(np.float32).astype(float))) == pytest.approx(1.5e-3, rel=1e-3)


@pytest.mark.parametrize("ratio", [3.3, 8.797, 31.416])
def test_the_step_is_the_encoders_and_not_that_of_the_digits_of_a_file(ratio):
    """Of steps that are no multiple of the last digit, the digits alone are a step of all increments."""
    step = ratio * 1e-5
    for seed in range(5):
        rng = np.random.default_rng([31, seed])
        q = step * np.rint(motion(9000.3, 40.0, rng) + rng.uniform())
        assert step_before_rounding(np.diff(q.round(5))) == pytest.approx(step, rel=5e-3)
        # Without an encoder behind them the digits are the step.
        smooth = step * motion(9000.3, 40.0, rng)
        assert step_before_rounding(np.diff(smooth.round(5))) == pytest.approx(1e-5, rel=1e-6)
        assert step_before_rounding(np.diff(q)) == pytest.approx(step, rel=1e-6)
        assert step_before_rounding(np.diff(smooth)) == 0.0


@pytest.mark.parametrize(("advance", "least", "most"), [(10_000.0, 3.0, 4.6), (9618.4, 0.2, 1.0), (9000.5, 0.7, 1.7)])
def test_what_repeats_is_what_a_rounded_motion_has(advance, least, most):
    """Over the power of white steps: if all of it repeats in four periods, four times that.

    What is told is that of the worst place within a step, twice the mean at most.
    """
    actual, told, chance = [], [], []
    for seed in range(12):
        x = motion(advance, 30.0, np.random.default_rng(seed))
        q, size = np.rint(x), x.size
        at = PERIODS * np.arange(1, 300)
        excited = np.isin(at // PERIODS, LINES)
        between = np.ones(size // 2 + 1, bool)
        between[::PERIODS] = False
        spectrum = np.abs(np.fft.rfft(q - x)) ** 2 * 12.0 / size
        actual.append(np.mean(spectrum[at[excited]]) - np.mean(spectrum[between]))
        white = np.abs(1.0 - np.exp(-2j * np.pi * at / size)) ** 2 / 12.0 / size
        found, by_chance = quantised(np.diff(q, prepend=q[:1] - 10.0), PERIODS, at, excited, white, 1.0)
        told.append(np.mean((found / white)[excited]))
        chance.append(by_chance)
    assert np.mean(actual) - 0.3 < np.mean(told) < 2.0 * max(np.mean(actual), 0.0) + 0.3
    assert least < np.mean(chance) < most


def test_whole_steps_repeat_and_the_golden_share_of_one_does_not():
    assert repeated_share(np.array([7.0, 7.001]), 4) == pytest.approx([1.0, 1.0], abs=0.01)
    for periods in (2, 4, 8, 30):
        assert repeated_share(9618.382, periods) < 0.6 / periods


def test_steps_that_repeat_are_in_the_deviations_and_are_told():
    """5 cm/s are whole steps in each sample: the lines between know nothing of what falls on the others."""
    axis, inside = two_mass().replace(sampling={"encoder_resolution": 5e-7}), []
    for seed in (1, 3):
        found = estimate_response(experiment(axis, seed, volts=1.0, newtons=0.2), axis)
        error = np.abs(found.response.response / exact(axis, found.response.frequency) - 1.0)
        inside.append(np.mean(error <= BAND * found.response.std))
        assert any("the quantisation error repeats with the excitation" in warning for warning in found.warnings)
    assert min(inside) >= 0.9


def test_steps_that_do_not_repeat_are_not_told():
    axis = two_mass().replace(sampling={"encoder_resolution": 2e-7})
    found = estimate_response(experiment(axis, 1, volts=1.0, newtons=0.2, speed=0.0499618), axis)
    assert not any("the quantisation error repeats" in warning for warning in found.warnings)
