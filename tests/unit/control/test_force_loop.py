"""The force loop: closed-form limits, sampled limits, the sign, and the paper's own reading."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from emps_design.cli.app import run
from emps_design.control.force import design_force_loop, largest_force_gain
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.gains import IP, PI, PI_WITH_REFERENCE_FILTER
from emps_design.errors import InputError
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine
from emps_design.paper import written as y
from emps_design.paper.loops import derive_force_loop

LOOP = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)


def test_wall_limits_in_closed_form():
    w0, z, K_v = LOOP.omega_0v, LOOP.z_v, LOOP.K_v
    wall = 1e5
    assert largest_force_gain(w0, z, K_v, environment=wall, on_carriage=False) == pytest.approx(2 * z * w0 / wall)
    expected = 2 * z * w0 * (1 + wall / K_v) / wall
    assert largest_force_gain(w0, z, K_v, environment=wall) == pytest.approx(expected)
    # 2 z w0 = w_v tan(phi_v)
    assert 2 * z * w0 == pytest.approx(100.0 * np.tan(np.radians(60.0)))


def test_closed_form_is_the_derived_one():
    by_title = {step.title: step.equation.rhs for step in derive_force_loop()}
    numbers = {y.omega_0v: LOOP.omega_0v, y.z_v: LOOP.z_v, y.K_v: LOOP.K_v, y.K_env: 3e4}
    derived = float(by_title["Largest gain against a wall"].subs(numbers))
    assert largest_force_gain(LOOP.omega_0v, LOOP.z_v, LOOP.K_v, environment=3e4) == pytest.approx(derived)


def test_viscous_hand_has_a_limit_in_the_sampled_loop_only():
    design = design_force_loop(LOOP, 0.01, hand=100.0)
    assert design.k_e1_max_continuous is None
    assert 0.01 < design.k_e1_max_sampled < 1.0
    assert not design_force_loop(LOOP, 1.001 * design.k_e1_max_sampled, hand=100.0).stable


@settings(max_examples=25, deadline=None)
@given(
    hand=st.sampled_from([0.0, 20.0, 300.0]),
    wall=st.sampled_from([0.0, 3e3, 2e5]),
    on_carriage=st.booleans(),
    sensor_delay=st.integers(0, 3),
    structure=st.sampled_from([IP, PI, PI_WITH_REFERENCE_FILTER]),
    filters=st.sampled_from([(), (Filter(kind="lowpass", frequency=150.0),)]),
)
def test_limits_are_where_the_poles_cross(hand, wall, on_carriage, sensor_delay, structure, filters):
    if hand + wall == 0.0:
        return
    around = replace(LOOP, structure=structure, filters=filters)
    design = design_force_loop(around, 1e-3, hand, wall, sensor_delay, on_carriage)
    limit = design.k_e1_max_sampled
    assert np.abs(design.sampled_loop(limit).poles[0]) == pytest.approx(1.0, abs=1e-9)
    assert not design.sampled_loop(1.0001 * limit).stable
    if design.stable and design.margins.gain_margin is not None:
        assert 1e-3 * design.margins.gain_margin == pytest.approx(limit, rel=1e-6)
    continuous = design.k_e1_max_continuous
    if continuous is not None:
        inside = design_force_loop(around, 0.999 * continuous, hand, wall, 0, on_carriage)
        outside = design_force_loop(around, 1.001 * continuous, hand, wall, 0, on_carriage)
        assert inside.continuous_poles.real.max() < 0.0 < outside.continuous_poles.real.max()


def test_the_zero_of_pi_moves_the_limit_as_the_cubic_says():
    """Gains for a wall next to which a hand rests: the limit is where the cubic's roots reach the axis, or nowhere."""
    for zero, hand, wall in ((0.0, 0.0, 1e5), (1e-4, 5.0, 1e5), (5e-3, 0.0, 1e5), (1e-3, 5.0, 1e6)):
        limit = largest_force_gain(141.0, 0.1, 2e6, hand, wall, True, zero)
        tried = np.geomspace(1e-7, 1e3, 4000) if limit is None else limit * np.array([0.5, 0.999, 1.001])
        stable = []
        for k in tried:
            ahead = k * zero + 1.0 / 2e6
            cubic = [141.0**-2, 0.2 / 141.0 + hand * ahead, 1.0 + k * hand + wall * ahead, k * wall]
            stable.append(np.roots(cubic).real.max() < 0.0)
        assert stable == ([True] * 4000 if limit is None else [True, True, False]), (zero, hand, wall)


def test_pi_behind_its_filter_is_ip_to_the_operator():
    ip, filtered = (
        design_force_loop(replace(LOOP, structure=one), 0.01, environment=1e4) for one in (IP, PI_WITH_REFERENCE_FILTER)
    )
    assert filtered.poles == pytest.approx(ip.poles)
    assert (filtered.k_e1_max_continuous, filtered.apparent_mass) == (ip.k_e1_max_continuous, ip.apparent_mass)
    hurried = design_force_loop(replace(LOOP, structure=PI), 0.01, environment=1e4)
    assert hurried.k_e1_max_continuous is None
    assert hurried.k_e1_max_sampled > ip.k_e1_max_sampled


def test_a_late_sensor_costs_gain():
    limits = [design_force_loop(LOOP, 1e-3, environment=1e4, sensor_delay=n).k_e1_max_sampled for n in range(4)]
    assert all(later < sooner for sooner, later in pairwise(limits))
    assert limits[1] < LOOP.omega_0v * 2 * LOOP.z_v / 1e4


def test_limit_with_a_long_delay_is_where_the_poles_cross():
    """Beyond a hundred samples of delay the limit comes from the response; the poles, slower, agree."""
    slow = machine("emps2018").replace(sampling={"computation_delay": 110})
    loop = design_velocity_loop(slow, crossover=3.0, phase_margin_deg=70.0)
    design = design_force_loop(loop, 1e-5, environment=1e4, sensor_delay=5)
    limit = design.k_e1_max_sampled
    assert design.sampled_loop(0.999 * limit).stable
    assert not design.sampled_loop(1.001 * limit).stable


def test_the_sign_pushed_by_a_hand_the_carriage_moves_along():
    """A constant force r = tau_ref ends at the velocity k_e1 r when nothing but the sensor answers (k_h small)."""
    design = design_force_loop(LOOP, 0.01, hand=1e-6)
    loop = design.sampled_loop()
    assert at_last(loop) == pytest.approx(0.01, rel=1e-6)
    # against a passive hand of 100 N/(m/s) it is k_e1/(1 + k_e1 k_h): negative feedback
    loop = design_force_loop(LOOP, 0.01, hand=100.0, on_carriage=False).sampled_loop()
    assert at_last(loop) == pytest.approx(0.01 / (1 + 0.01 * 100.0), rel=1e-9)


def at_last(loop):
    """Velocity [m/s] that the loop ends at for each newton the force reference is above zero: k_e1 as a velocity."""
    return 0.01 * loop.response(np.array([0.0]), "velocity", "reference")[0].real


def test_the_papers_reading():
    design = design_force_loop(LOOP, 0.01, environment=1e4)
    reading = design.paper_reading
    open_loop = design.open_loop()
    assert open_loop.dcgain() == pytest.approx(1.0)
    assert reading["poles"][0] == [0.0, 0.0]
    closed = (open_loop / (1 - open_loop)).minreal(1e-6)
    assert sorted(closed.poles().real) == pytest.approx(sorted(re for re, _ in reading["poles"]), abs=1e-3)


def test_a_notebook_shows_the_verdict_first():
    html = design_force_loop(LOOP, 0.02, environment=1e4)._repr_html_()
    assert html.startswith('<p class="bad" role="alert">emps2018: sampled force loop, ')
    assert html.split("</p>")[0].endswith(" is UNSTABLE")
    assert "0.017395" in html


def test_an_unstable_loop_has_no_margins_in_words_either(capsys):
    assert run(["force", "emps2018", "--k-e1", "0.1", "--environment", "1e4"]) == 4
    out = capsys.readouterr().out
    assert "margins of the sampled force loop: undefined, the loop is unstable" in out
    assert "no crossover" not in out
    html = design_force_loop(LOOP, 0.1, environment=1e4)._repr_html_()
    assert "margins of the sampled force loop: undefined, the loop is unstable" in html


BENT = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.3}]
LATE = [{"kind": "actuator_delay", "delay": 1e-3}]


@pytest.mark.parametrize(
    ("effects", "filters", "said"),
    [
        (BENT, (), "the closed form assumes one rigid mass of 115.7 kg; the sampled loop has the resonance at 48"),
        (LATE, (), "the closed form neglects the effects of the axis"),
        ([], (Filter(kind="lowpass", frequency=100.0),), "the closed forms neglect filters"),
    ],
)
def test_what_the_closed_form_leaves_out_is_said(effects, filters, said):
    """The limit in closed form is that of mass and viscous friction alone, the sampled one has everything."""
    bare = design_force_loop(LOOP, 0.01, environment=1e4)
    loop = design_velocity_loop(machine("emps2018").replace(effects=effects), crossover=100.0, filters=filters)
    design = design_force_loop(loop, 0.01, environment=1e4)
    assert design.k_e1_max_continuous == pytest.approx(bare.k_e1_max_continuous)
    assert design.k_e1_max_sampled < 0.9 * bare.k_e1_max_sampled
    assert any(said in warning for warning in design.warnings)
    assert not any("closed form" in warning for warning in bare.warnings)


def test_no_operator_no_loop():
    design = design_force_loop(LOOP, 0.01)
    assert design.stable
    assert design.k_e1_max_sampled is None
    assert any("no operator" in warning for warning in design.warnings)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"k_e1": 0.0}, r"k_e1: found 0 \(m/s\)/N, expected a positive number"),
        ({"k_e1": -1.0}, "k_e1: found -1"),
        ({"k_e1": 1.0, "hand": -1.0}, "hand: found -1"),
        ({"k_e1": 1.0, "environment": float("nan")}, "environment: found nan"),
        ({"k_e1": 1.0, "sensor_delay": -1}, "sensor delay: found -1"),
    ],
)
def test_numbers_that_cannot_be_meant(arguments, message):
    with pytest.raises(InputError, match=message):
        design_force_loop(LOOP, **arguments)


@pytest.mark.parametrize("wall", [1e3, 1e4, 3.7e5])
def test_a_wall_without_friction_has_margins_though_there_is_no_response_at_its_resonance(wall):
    ideal = machine("emps2018").replace(mechanics={"viscous": 0.0}, drive={"current_time_constant": 0.0})
    design = design_force_loop(design_velocity_loop(ideal, crossover=100.0), 1e-4, environment=wall)
    assert design.margins.gain_margin == pytest.approx(design.k_e1_max_sampled / 1e-4, rel=1e-6)
