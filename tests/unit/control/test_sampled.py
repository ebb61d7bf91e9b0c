"""The loop as implemented: FACTS of the sampled design, discretisation against scipy, margins against poles."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from hypothesis import given, settings, strategies as st

from emps_design.control.discretisation import expm, sample_axis, sample_plant
from emps_design.control.linear_plant import linear_plant
from emps_design.control.margins import loop_margins
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.errors import InputError
from emps_design.machines import machine

PAPER = machine("emps2018")


def design(phase=60.0, crossover=100.0, **sampling):
    axis = PAPER.replace(sampling=sampling) if sampling else PAPER
    return design_velocity_loop(axis, crossover=crossover, phase_margin_deg=phase)


def test_sampling_takes_phase():
    assert design().sampled.margins.phase_margin_deg == pytest.approx(39.2, abs=0.05)
    late = design(computation_delay=1).sampled.margins
    assert late.phase_margin_deg == pytest.approx(27.6, abs=0.05)
    assert late.delay_margin_samples == pytest.approx(design().sampled.margins.delay_margin_samples - 1.0, abs=1e-9)


def test_the_steep_design_is_unstable_with_one_more_sample():
    assert design(phase=80.0).sampled.stable
    unstable = design(phase=80.0, computation_delay=1)
    assert not unstable.sampled.stable
    assert np.abs(unstable.sampled.poles[0]) > 1.0
    assert unstable.sampled.margins.phase_margin_deg is None
    assert unstable.sampled.bandwidth is None
    assert any("unstable" in warning for warning in unstable.warnings)
    nearest = dict(unstable.nearest_stable)
    nearest.pop("or", None)
    assert design_velocity_loop(unstable.axis, **nearest).sampled.stable


def test_exponential_and_hold_agree_with_scipy():
    rng = np.random.default_rng(1)
    for scale in (1e-6, 1.0, 30.0):
        matrix = scale * rng.normal(size=(5, 5))
        assert expm(matrix) == pytest.approx(scipy.linalg.expm(matrix), rel=1e-10, abs=1e-300)
    linear = linear_plant(PAPER)
    plant = sample_plant(linear, 1e-3)
    A, B, *_ = scipy.signal.cont2discrete((linear.A, linear.B[:, None], np.eye(3), np.zeros((3, 1))), 1e-3)
    assert plant.Phi == pytest.approx(A, rel=1e-12, abs=1e-15)
    np.testing.assert_allclose(plant.G0, B[:, 0], rtol=1e-12)
    assert not plant.G1.any()


@pytest.mark.parametrize("fraction", [0.3, 1.0, 1.7])
def test_a_fractional_delay_is_the_plant_under_a_shifted_hold(fraction):
    """Ten sub-samples a period: the delayed plant is the undelayed one whose input steps come later."""
    linear = linear_plant(PAPER)
    delayed = type(linear)(**{**vars(linear), "delay": fraction * 1e-3})
    plant, fine = sample_plant(delayed, 1e-3), sample_plant(linear, 1e-4)
    rng = np.random.default_rng(2)
    u = rng.normal(size=30)
    coarse, dense = np.zeros(3), np.zeros(3)
    shift = round(10 * fraction)
    for k in range(30):
        held = u[k - plant.delay] if k >= plant.delay else 0.0
        before = u[k - plant.delay - 1] if k > plant.delay else 0.0
        coarse = plant.Phi @ coarse + plant.G0 * held + plant.G1 * before
        for j in range(10):
            place = (10 * k + j - shift) // 10
            dense = fine.Phi @ dense + fine.G0 * (u[place] if place >= 0 else 0.0)
    assert coarse == pytest.approx(dense, rel=1e-9)


def test_polynomials_are_the_response_of_the_state_space():
    axis = PAPER.replace(sampling={"computation_delay": 2})
    slope = {"kind": "slope", "points": 4}
    for estimator, weights in (("two_tap", [0.5, 0.5]), ("backward", [1.0]), (slope, [0.3, 0.4, 0.3])):
        plant = sample_axis(axis.replace(controller={"velocity_estimator": estimator}))
        w = np.array([3.0, 80.0, 900.0, 3000.0])
        z = np.exp(1j * w * plant.period)
        q = np.array([plant.C @ np.linalg.solve(x * np.eye(3) - plant.Phi, plant.G0) * x**-2 for x in z])
        estimate = sum(weight * z**-i for i, weight in enumerate(weights))
        expected = q * (1 - 1 / z) * estimate / plant.period
        assert plant.response(w) == pytest.approx(expected, rel=1e-9)


def test_closed_loop_steps_like_the_difference_equation():
    """Run the equations as they would be typed into a drive; the matrix has to give the same voltages."""
    loop = design(computation_delay=1).sampled
    plant, T = loop.plant, loop.plant.period
    _, velocity, voltage = loop.step_response(60)
    x, q1, q2, integral, waiting = np.zeros(3), 0.0, 0.0, 0.0, 0.0
    for k in range(60):
        q = plant.C @ x
        v = (q - q2) / (2 * T)
        integral += T / loop.t_v * (1.0 - v)
        u = loop.k_v1 * (integral - v)
        assert voltage[k] == pytest.approx(u, rel=1e-9, abs=1e-9)
        assert velocity[k] == pytest.approx(x[1], rel=1e-9, abs=1e-12)
        x = plant.Phi @ x + plant.G0 * waiting
        waiting, q2, q1 = u, q1, q


def test_margins_agree_with_python_control_where_it_is_right():
    import control

    loop = design().sampled
    gain, phase, w_phase, w_gain = control.margin(loop.transfer_function())
    margins = loop.margins
    assert phase == pytest.approx(margins.phase_margin_deg, rel=1e-6)
    assert w_gain == pytest.approx(margins.crossover, rel=1e-6)
    assert gain == pytest.approx(margins.gain_margin, rel=1e-6)
    assert w_phase == pytest.approx(margins.gain_margin_frequency, rel=1e-6)


def test_gain_margin_at_the_nyquist_frequency():
    """L = 0.0199/(z - 0.99): only the response at the Nyquist frequency, -0.01, tells the limit of 100."""
    T, gain, pole = 1e-3, 0.0199, 0.99

    def response(w):
        return gain / (np.exp(1j * w * T) - pole)

    margins = loop_margins(response, np.geomspace(0.01, math.pi / T * (1 - 1e-9), 400), stable=True, period=T)
    assert margins.gain_margin == pytest.approx(100.0, rel=1e-9)
    assert margins.gain_margin_frequency == pytest.approx(math.pi / T)
    # the closed-loop pole is pole - factor * gain: at -1 for the factor 100
    assert pole - margins.gain_margin * gain == pytest.approx(-1.0, abs=1e-9)


def test_a_plant_that_runs_away_needs_a_least_gain():
    """Friction that falls with speed makes the plant unstable: the loop bears less gain only down to a limit."""
    axis = PAPER.replace(
        mechanics={"viscous": 0.0}, effects=[{"kind": "asymmetric_viscous_friction", "viscous_difference": -3000.0}]
    )
    loop = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=60.0).sampled
    assert loop.plant.linear.viscous == pytest.approx(-3000.0)
    assert loop.stable
    factor = loop.margins.gain_reduction_margin
    assert 0.0 < factor < 1.0
    assert SampledVelocityLoop(loop.plant, 1.0001 * factor * loop.k_v1, loop.t_v).stable
    assert not SampledVelocityLoop(loop.plant, 0.9999 * factor * loop.k_v1, loop.t_v).stable
    assert design().sampled.margins.gain_reduction_margin is None


def test_unstable_loop_has_no_margins():
    assert (
        loop_margins(lambda w: 2.0 / (1j * w), np.geomspace(0.1, 10, 20), stable=False).to_dict()["phase_margin_deg"]
        is None
    )


@settings(max_examples=25, deadline=None)
@given(
    crossover=st.floats(20.0, 220.0),
    phase=st.floats(20.0, 78.0),
    lag=st.sampled_from([0.0, 0.3e-3, 2e-3]),
    delay=st.integers(0, 2),
    estimator=st.sampled_from(["two_tap", "backward"]),
)
def test_margins_are_where_the_poles_leave_the_circle(crossover, phase, lag, delay, estimator):
    axis = PAPER.replace(
        drive={"current_time_constant": lag},
        sampling={"computation_delay": delay},
        controller={"velocity_estimator": estimator},
    )
    loop = design_velocity_loop(axis, crossover=crossover, phase_margin_deg=phase).sampled
    margins = loop.margins
    if not loop.stable:
        assert margins.phase_margin_deg is None
        return
    if margins.gain_margin is not None:
        for factor, stable in ((0.9999, True), (1.0001, False)):
            scaled = SampledVelocityLoop(loop.plant, loop.k_v1 * margins.gain_margin * factor, loop.t_v)
            assert scaled.stable is stable
    whole = math.floor(margins.delay_margin_samples + 1e-9)
    if abs(margins.delay_margin_samples - whole) > 1e-6 and margins.delay_margin_samples - whole < 1 - 1e-6:
        for samples, stable in ((whole, True), (whole + 1, False)):
            later = replace(loop.plant, delay=loop.plant.delay + samples)
            assert replace(loop, plant=later).stable is stable


def test_bandwidth_of_the_sampled_loop():
    loop = design().sampled
    assert abs(loop.closed_loop_response(np.array(loop.bandwidth))) == pytest.approx(10 ** (-3 / 20), rel=1e-9)


def test_no_slope_at_zero_velocity():
    with pytest.raises(InputError, match="velocity: found 0 m/s"):
        linear_plant(PAPER, 0.0)


def test_a_period_that_the_plant_outgrows():
    axis = machine("emps2018-two-quadrant").replace(mechanics={"viscous": 0.0}, sampling={"period": 1000.0})
    with pytest.raises(InputError, match="period: found 1000 s, in which the unstable plant grows"):
        sample_axis(axis)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            {"mechanics": {"mass": 1e300}},
            r"emps2018: mechanics.mass: found 1e\+300 kg, expected a magnitude of at most",
        ),
        ({"sampling": {"period": 1e-300}}, "emps2018: sampling.period: found 1e-300 s"),
    ],
)
def test_numbers_no_machine_has(tables, message):
    with pytest.raises(InputError, match=message):
        design_velocity_loop(PAPER.replace(**tables), crossover=100.0, phase_margin_deg=60.0)


def test_sampled_becomes_continuous_with_a_short_period():
    axis = PAPER.replace(drive={"current_time_constant": 0.0}, sampling={"period": 1e-6})
    fast = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=60.0)
    assert fast.sampled.margins.phase_margin_deg == pytest.approx(fast.plant_input.phase_margin_deg, abs=0.05)
    assert fast.sampled.bandwidth == pytest.approx(fast.bandwidth, rel=1e-3)


def longest_delay(loop: SampledVelocityLoop, step: float = 0.02) -> float:
    """Samples of delay that the loop bears, by adding more and more of it until the poles leave the circle."""

    def stable(samples: float) -> bool:
        return replace(loop, plant=loop.plant.delayed(samples * loop.plant.period)).stable

    low = next(step * i for i in range(500) if not stable(step * (i + 1)))
    high = low + step
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def test_delay_margin_of_a_fast_loop_is_a_fraction_of_a_sample():
    """The phase alone says 0.1252 samples; a delay between samples changes the magnitude too."""
    axis = PAPER.replace(
        mechanics={"mass": 1.0, "viscous": 1.0, "coulomb": 0.0},
        drive={"force_gain": 1.0, "current_time_constant": 0.0},
        controller={"velocity_estimator": "backward"},
    )
    loop = design_velocity_loop(axis, crossover=300.0, phase_margin_deg=76.0).sampled
    assert loop.margins.delay_margin_samples == pytest.approx(0.1111, abs=5e-5)
    assert loop.margins.delay_margin_samples == pytest.approx(longest_delay(loop), abs=1e-7)
    alone = math.radians(loop.margins.phase_margin_deg) / loop.margins.crossover / 1e-3
    assert alone == pytest.approx(0.1252, abs=5e-5)


@settings(max_examples=15, deadline=None)
@given(
    crossover=st.floats(60.0, 350.0),
    phase=st.floats(30.0, 85.0),
    lag=st.sampled_from([0.0, 0.3e-3, 1.5e-3]),
    late=st.sampled_from([0.0, 0.4e-3, 1.3e-3]),
    estimator=st.sampled_from(["two_tap", "backward"]),
)
def test_delay_margins_are_exact_between_samples(crossover, phase, lag, late, estimator):
    axis = PAPER.replace(
        drive={"current_time_constant": lag},
        controller={"velocity_estimator": estimator},
        effects=[{"kind": "actuator_delay", "delay": late}] if late else [],
    )
    loop = design_velocity_loop(axis, crossover=crossover, phase_margin_deg=phase).sampled
    if loop.stable and loop.margins.delay_margin_samples < 8.0:
        assert loop.margins.delay_margin_samples == pytest.approx(longest_delay(loop), abs=2e-6)
