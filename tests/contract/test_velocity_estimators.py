"""Velocity estimators with a number: axis file there and back, a line for a bad one, what a loop makes of them."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.control.controller import controller_margins
from emps_design.control.discretisation import sample_axis
from emps_design.control.impedance.robustness import drift_threshold
from emps_design.control.sampled import OUTPUTS, axis_loop
from emps_design.control.velocity.design import design_velocity_loop, difference_equation
from emps_design.control.velocity.gains import IP
from emps_design.control.velocity.sampled import LaggedVelocityLoop
from emps_design.errors import AxisError
from emps_design.laws import get_law, law_of
from emps_design.laws.estimators import NAMED, polynomials
from emps_design.machines import machine
from emps_design.simulation import Plant
from tests.contract.test_laws import ESTIMATED, axis_with

T = 1e-3
EVERY = pytest.mark.parametrize("estimator", ESTIMATED.values(), ids=ESTIMATED)


def with_estimator(estimator, kind="cascade") -> Axis:
    return axis_with(get_law(kind), velocity_estimator=estimator)


@EVERY
def test_axis_file_there_and_back(estimator):
    axis = with_estimator(estimator)
    assert axis.controller.velocity_estimator == estimator
    assert Axis.from_toml(axis.to_toml()) == axis
    assert Axis.from_toml(axis.to_toml(comments=True)) == axis


TABLES = 'two_tap, backward, { kind = "slope", points = n }'


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ("two-tap", f": found 'two-tap', expected {TABLES}"),
        (3, f": found 3, expected {TABLES}"),
        ({"kind": "slope"}, ".points: found None, expected a number: slope has points"),
        ({"kind": "slope", "points": 1}, ".points: found 1 samples, expected a number of at least 2"),
        ({"kind": "slope", "points": 4.0}, ".points: found 4.0 samples, expected a whole number"),
        ({"kind": "slope", "points": 65}, ".points: found 65 samples, expected a number of at most 64"),
        ({"kind": "filtered", "points": 4}, ".points: found 4, expected no points of filtered"),
        ({"kind": "filtered", "frequency": 0.0}, ".frequency: found 0.0 Hz, expected a number greater than 0"),
        ({"kind": "pll", "bandwidth": 9.0}, ".kind: found 'pll', expected 'slope', 'filtered' or 'tracking'"),
        ({"kind": "tracking", "bandwidth": 9.0, "gain": 2.0}, ".gain: unknown key"),
        ({"kind": "tracking", "bandwidth": 1e12}, ".bandwidth: found 1e+12 rad/s, expected a magnitude"),
    ],
)
def test_a_bad_estimator_is_told_in_one_line(given, line):
    with pytest.raises(AxisError) as caught:
        with_estimator(given)
    assert f"controller.velocity_estimator{line}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_slopes_of_two_and_three_points_are_the_named_estimators():
    for points, name in ((2, "backward"), (3, "two_tap")):
        b, a = polynomials({"kind": "slope", "points": points}, T)
        assert b == pytest.approx(NAMED[name])
        assert a == (1.0,) + (0.0,) * (points - 2)
        axis, named = with_estimator({"kind": "slope", "points": points}), with_estimator(name)
        q_ref = 0.05 * (1 - np.cos(9 * np.arange(300) * T))
        found = Plant.of(axis).closed_loop(q_ref).u
        np.testing.assert_allclose(found, Plant.of(named).closed_loop(q_ref).u, rtol=1e-9, atol=1e-9)


@EVERY
def test_no_run_computes_another_estimator_in_its_place(estimator):
    """A run of position_pd, which is fused for the named ones, has the commands of the kernel."""
    axis = with_estimator(estimator, "position_pd")
    run = Plant.of(axis).closed_loop(0.05 * (1 - np.cos(9 * np.arange(400) * T)))
    law = law_of(axis, T)
    assert not law.state_feedback
    limit = axis.drive.command_limit
    np.testing.assert_allclose(run.u, np.clip(law.commands(run.q_ref, run.q, limit), -limit, limit), atol=1e-9)


@EVERY
def test_the_sampled_loop_steps_like_the_simulation(estimator):
    """A step of the reference around a slide, without dry friction: the closed loop has the voltages of the run."""
    axis = with_estimator(estimator).replace(
        mechanics={"coulomb": 0.0, "offset": 0.0}, sampling={"encoder_resolution": 0.0}, drive={"command_limit": 1e6}
    )
    axis = axis.replace(controller={"feedforward": {"velocity": 0.5}})
    reference = np.where(np.arange(200) < 3, 0.0, 1e-3)
    w = np.zeros((200, 3))
    w[:, 0] = reference
    linear = axis_loop(axis).simulate(w)[:, OUTPUTS.index("voltage")]
    run = Plant.of(axis).closed_loop(reference, method="general")
    np.testing.assert_allclose(linear, run.u, atol=1e-6 * np.abs(run.u).max())


@EVERY
def test_the_margins_have_its_lag(estimator):
    """Sampled and continuous: the crossover's phase is that of backward differences less what the estimator turns."""
    axes = [
        machine("emps2018").replace(controller={"kind": "ip_velocity", "k_v1": 500.0, "t_v": 1e3, **more})
        for more in ({"velocity_estimator": "backward"}, {"velocity_estimator": estimator})
    ]
    plain, own = (controller_margins(axis).loops["velocity"] for axis in axes)
    w = own.margins.crossover
    b, a = polynomials(estimator, T)
    E = np.polyval(b[::-1], np.exp(-1j * w * T)) / np.polyval(a[::-1], np.exp(-1j * w * T))
    responses = [sample_axis(axis).response(np.array([w]))[0] for axis in axes]
    assert responses[1] == pytest.approx(E * responses[0], rel=1e-9)
    assert own.margins.phase_margin_deg < plain.margins.phase_margin_deg - 5.0
    s = 1j * own.continuous.margins.crossover
    limit = {"filtered": lambda w0: w0 / (s + w0), "tracking": lambda w0: (w0 / (s + w0)) ** 2, "slope": lambda n: 1.0}
    number = {"filtered": 2 * np.pi * 60.0, "tracking": 400.0, "slope": 4}[estimator["kind"]]
    lag = np.angle(limit[estimator["kind"]](number), deg=True)
    rigid = axes[1].replace(controller={"velocity_estimator": "backward"})
    without, with_it = (LaggedVelocityLoop.of(axis, 0.1, 500.0, 1e3, IP, ()) for axis in (rigid, axes[1]))
    phase = [np.angle(one.plant_response(np.array([s.imag]))[0], deg=True) for one in (without, with_it)]
    assert phase[1] - phase[0] == pytest.approx(lag, abs=1e-9)
    response = with_it.plant_input_response(np.array([s.imag]))[0]
    assert abs(response) == pytest.approx(1.0, rel=1e-3)
    assert 180.0 + np.angle(response, deg=True) == pytest.approx(own.continuous.margins.phase_margin_deg, abs=0.1)


def test_a_design_names_the_lag_that_its_closed_forms_leave_out():
    axis = machine("emps2018").replace(controller={"velocity_estimator": ESTIMATED["filtered"]})
    design = design_velocity_loop(axis, crossover=60.0, phase_margin_deg=60.0)
    assert "the velocity estimate (difference filtered at 60 Hz)" in design.left_out
    table = design.controller_table()
    assert table["velocity_estimator"] == ESTIMATED["filtered"]
    assert difference_equation(axis, design.k_v1, design.t_v).to_dict()["velocity_estimator"] == ESTIMATED["filtered"]
    plain = design_velocity_loop(machine("emps2018"), crossover=60.0, phase_margin_deg=60.0)
    assert design.with_lags.velocity_error.phase_margin_deg < plain.with_lags.velocity_error.phase_margin_deg - 4.0


def test_a_creep_ends_where_the_estimate_forgets_it():
    assert drift_threshold(T, 3e-6, {"kind": "slope", "points": 4}) == pytest.approx(1e-3)
    assert drift_threshold(T, 3e-6, ESTIMATED["filtered"]) == 1e-6
