"""Closed forms (6) to (9): numbers of the paper's design, and the symbols they were derived as."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import signal

from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop
from emps_design.control.velocity.gains import (
    MINUS_3_DB,
    canonical_form,
    crossover_of_bandwidth,
    feasible_phase_margin,
    second_order_bandwidth,
    velocity_gains,
)
from emps_design.control.velocity.specification import check_specification
from emps_design.control.verdict import second_order_step
from emps_design.errors import InputError, SpecificationError
from emps_design.machines import machine
from emps_design.paper import written as y
from emps_design.paper.loops import derive_velocity_loop

MASS, VISCOUS, FORCE_GAIN = 115.7315, 474.9727, 35.15


def test_the_papers_design():
    k_v1, t_v = velocity_gains(MASS, VISCOUS, FORCE_GAIN, 100.0, 60.0)
    assert k_v1 == pytest.approx(556.766, abs=5e-4)
    assert t_v == pytest.approx(8.45505e-3, abs=5e-9)
    design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    assert design.omega_0v == pytest.approx(141.42, abs=5e-3)
    assert design.z_v == pytest.approx(0.61237, abs=5e-6)
    assert design.bandwidth == pytest.approx(159.90, abs=6e-3)
    assert design.K_v == pytest.approx(2.31e6, rel=5e-3)
    assert design.crossover == pytest.approx(100.0)
    assert design.phase_margin_deg == pytest.approx(60.0)


def test_margins_at_the_plant_input():
    design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    assert design.plant_input.phase_margin_deg == pytest.approx(60.2, abs=0.05)
    assert design.plant_input.crossover == pytest.approx(197.0, abs=0.5)
    assert design.plant_input.delay_margin == pytest.approx(5.33e-3, abs=5e-6)
    steep = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=80.0)
    assert steep.plant_input.phase_margin_deg == pytest.approx(80.3, abs=0.05)
    assert steep.plant_input.crossover == pytest.approx(572.0, abs=0.5)
    assert steep.plant_input.delay_margin == pytest.approx(2.45e-3, abs=5e-6)
    # more phase margin asked for, less delay margin had
    assert steep.plant_input.delay_margin < design.plant_input.delay_margin


def test_half_power_is_not_minus_3_db():
    w0, z = canonical_form(100.0, 60.0)
    half_power = w0 * math.sqrt(1 - 2 * z**2 + math.sqrt((1 - 2 * z**2) ** 2 + 1))
    assert half_power == pytest.approx(160.05, abs=5e-3)
    assert second_order_bandwidth(w0, z) == pytest.approx(159.90, abs=6e-3)


def test_numbers_equal_the_derived_symbols():
    steps = derive_velocity_loop()

    def right_side(number, name):
        """The derived right-hand side of the step with that equation number and left-hand symbol."""
        return next(s for s in steps if s.number == number and s.equation.lhs == name).equation.rhs

    numbers = {
        y.M_1: MASS, y.F_v1: VISCOUS, y.G_tau: FORCE_GAIN, y.omega_v: 130.0, y.phi_v: math.radians(47.0),
    }  # fmt: skip
    k_v1, t_v = velocity_gains(MASS, VISCOUS, FORCE_GAIN, 130.0, 47.0)
    assert float(right_side("7", y.k_v1).subs(numbers)) == pytest.approx(k_v1, rel=1e-12)
    assert float(right_side("7", y.t_v).subs(numbers)) == pytest.approx(t_v, rel=1e-12)
    design = design_velocity_loop(machine("emps2018"), crossover=130.0, phase_margin_deg=47.0)
    gains = {**numbers, y.k_v1: k_v1, y.t_v: t_v}
    assert float(right_side("9", y.omega_0v).subs(gains)) == pytest.approx(design.omega_0v, rel=1e-12)
    assert float(right_side("9", y.z_v).subs({**gains, y.omega_0v: design.omega_0v})) == pytest.approx(
        design.z_v, rel=1e-12
    )
    at = {**gains, y.s: 77.0j}
    assert complex(right_side("6", y.T_vo).subs(at)) == pytest.approx(complex(design.velocity_error_loop()(77j)))
    assert complex(right_side("8", y.T_vc).subs(at)) == pytest.approx(complex(design.closed_loop()(77j)))
    by_title = {step.title: step.equation.rhs for step in steps}
    plant_input = by_title["Loop broken at the plant input"].subs(at)
    assert complex(plant_input) == pytest.approx(complex(design.plant_input_loop()(77j)))
    form = {y.omega_0v: design.omega_0v, y.z_v: design.z_v}
    assert float(by_title["Bandwidth of the closed loop"].subs(form)) == pytest.approx(design.bandwidth, rel=1e-12)
    of_specification = by_title["What T_vc depends on: damping ratio"].subs(numbers)
    assert float(of_specification) == pytest.approx(canonical_form(130.0, 47.0)[1], rel=1e-12)


@settings(max_examples=40, deadline=None)
@given(
    mass=st.floats(0.1, 1e4),
    viscous=st.floats(0.0, 1e4),
    gain=st.floats(0.1, 1e3),
    crossover=st.floats(1.0, 1e3),
    share=st.floats(0.01, 0.99),
)
def test_gains_put_the_crossover_where_asked(mass, viscous, gain, crossover, share):
    low, high = feasible_phase_margin(mass, viscous, crossover)
    phase = low + share * (high - low)
    k_v1, t_v = velocity_gains(mass, viscous, gain, crossover, phase)
    axis = machine("emps2018").replace(mechanics={"mass": mass, "viscous": viscous}, drive={"force_gain": gain})
    design = VelocityLoopDesign(axis, k_v1, t_v, {})
    assert design.crossover == pytest.approx(crossover, rel=1e-6)
    assert design.phase_margin_deg == pytest.approx(phase, rel=1e-6)
    w0, z = canonical_form(crossover, phase)
    assert design.omega_0v == pytest.approx(w0, rel=1e-9)
    assert design.z_v == pytest.approx(z, rel=1e-6)
    assert 2 * z * w0 == pytest.approx(crossover * math.tan(math.radians(phase)), rel=1e-9)
    assert crossover_of_bandwidth(second_order_bandwidth(w0, z), phase) == pytest.approx(crossover, rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(scale=st.floats(1e-3, 1e3), speed=st.floats(0.1, 10.0), phase=st.floats(10.0, 85.0))
def test_scaling(scale, speed, phase):
    """A gain error of G_tau scales mass and friction and leaves the design; a faster clock and plant scale time."""
    k_v1, t_v = velocity_gains(MASS, VISCOUS, FORCE_GAIN, 100.0, phase)
    same = velocity_gains(scale * MASS, scale * VISCOUS, scale * FORCE_GAIN, 100.0, phase)
    assert same == pytest.approx((k_v1, t_v), rel=1e-9)
    faster = velocity_gains(MASS, speed * VISCOUS, FORCE_GAIN, speed * 100.0, phase)
    assert faster == pytest.approx((speed * k_v1, t_v / speed), rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(w0=st.floats(0.1, 1e4), z=st.floats(0.01, 20.0))
def test_bandwidth_is_where_the_magnitude_is_minus_3_db(w0, z):
    s = 1j * second_order_bandwidth(w0, z) / w0
    assert abs(1 / (1 + 2 * z * s + s * s)) == pytest.approx(MINUS_3_DB, rel=1e-9)


def test_margins_agree_with_python_control():
    import control

    design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    for loop, margins in (
        (design.velocity_error_loop(), design.velocity_error),
        (design.plant_input_loop(), design.plant_input),
    ):
        _, phase, _, crossover = control.margin(loop)
        assert phase == pytest.approx(margins.phase_margin_deg, rel=1e-9)
        assert crossover == pytest.approx(margins.crossover, rel=1e-9)
    assert control.poles(design.closed_loop()).real.max() < 0


@pytest.mark.parametrize(("phase", "limit"), [(0.0, "lower"), (-10.0, "lower"), (2.0, "lower"), (90.0, "upper")])
def test_infeasible_phase_margin_says_which_limit_binds(phase, limit):
    with pytest.raises(SpecificationError, match=f"the {limit} limit binds") as caught:
        design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=phase)
    nearest = dict(caught.value.nearest)
    nearest.pop("or", None)
    assert design_velocity_loop(machine("emps2018"), **nearest).sampled.stable


def test_infeasible_gains_of_the_plain_function():
    with pytest.raises(SpecificationError, match="expected more than 2.35 and less than 90 deg"):
        velocity_gains(MASS, VISCOUS, FORCE_GAIN, 100.0, 1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, None, 60.0), "found neither of crossover and bandwidth"),
        ((1.0, 1.0, 60.0), "found both of crossover and bandwidth"),
        ((-1.0, None, 60.0), "crossover: found -1 rad/s, expected a positive number"),
        ((None, math.inf, 60.0), "bandwidth: found inf rad/s"),
        ((1.0, None, math.nan), "phase margin: found nan deg"),
    ],
)
def test_specifications_that_cannot_be_meant(arguments, message):
    with pytest.raises(InputError, match=message):
        check_specification(*arguments)


@pytest.mark.parametrize("z", [0.3, 0.999, 1.001, 1.9])
def test_a_step_of_any_damping_is_that_of_its_poles(z):
    t = np.linspace(0.0, 100.0, 4001)
    _, expected = signal.lti([0.7, 1.0], [1.0, 2.0 * z, 1.0]).step(T=t)
    np.testing.assert_allclose(second_order_step(1.0, z, t, zero=0.7), expected, atol=1e-7)


def test_a_strongly_damped_step_does_not_overflow():
    """The cosine of an imaginary argument would, long before the step is over."""
    slow = 2.0 * 40.0  # s, the slow pole's time constant is 2 z
    assert second_order_step(1.0, 40.0, np.array([slow, 20.0 * slow])) == pytest.approx(
        [1.0 - math.exp(-1.0), 1.0], abs=1e-3
    )
