"""Loops of different rates: exact poles, and margins that are what their name says when the loop is changed by them."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis
from emps_design.control.margins import periodic_margins, periodic_response
from emps_design.control.sampled import axis_loop, close, nested_loops, position_loop
from emps_design.errors import AxisError, InputError
from emps_design.laws import law_of
from emps_design.laws.linear import linear_law
from emps_design.machines import machine
from tests.studies import quick

T = 1e-3
FILTERS = [
    {"kind": "lowpass", "frequency": 250.0},
    {"kind": "notch", "frequency": 110.0, "damping": 0.5, "depth": 0.2},
]
AHEAD = {"velocity": 1.0, "acceleration": 2.0, "coulomb": 0.3}


def axis_with(every=4, form="pi", gain=1.0, delay=0.0, **more) -> Axis:
    controller = {
        "kind": "cascade",
        "position": {"kp": 30.0 * more.pop("position_gain", 1.0), "every": every},
        "velocity": {"kp": 300.0, "ti": 0.05, "form": form},
        "feedforward": AHEAD,
        "filters": FILTERS,
        **more,
    }
    controller = {key: value for key, value in controller.items() if value is not None}
    table = {**machine("emps2018").to_dict(), "controller": controller}
    table["drive"]["force_gain"] *= gain
    late = [{"kind": "actuator_delay", "delay": delay}] if delay else []
    return Axis.from_dict({**table, "effects": late})


CASES = pytest.mark.parametrize(("every", "form"), [(1, "pi"), (1, "ip"), (2, "pi"), (4, "pi"), (5, "ip")])


@CASES
def test_the_position_loop_closed_again_has_the_poles_of_the_whole(every, form):
    axis = axis_with(every, form)
    plant, law = sample_axis(axis), linear_law(law_of(axis.replace(controller={"feedforward": {}}), T), T)
    A, b, c = position_loop(plant, law)
    closed, whole = np.linalg.eigvals(A - np.outer(b, c)), close(plant, law).poles
    for pole in whole[np.abs(whole) > 1e-3]:
        assert np.abs(closed - pole).min() < 1e-6


@CASES
def test_margins_are_what_brings_the_loop_to_its_limit(every, form):
    """Each margin is spent on the axis itself: the loop then has a pole on the unit circle."""
    loops = {loop.name: loop for loop in nested_loops(axis_with(every, form))}
    assert [loop.broken for loop in loops.values()] == ["plant input", "position error", "plant input"]
    position, whole = loops["position loop"].margins, loops["whole loop"].margins
    assert position.period == pytest.approx(every * T)

    def radius(**changed):
        return axis_loop(axis_with(every, form, **changed)).radius

    assert radius(position_gain=position.gain_margin) == pytest.approx(1.0, abs=1e-6)
    assert radius(gain=whole.gain_margin) == pytest.approx(1.0, abs=1e-6)
    assert radius(delay=whole.delay_margin) == pytest.approx(1.0, abs=1e-5)
    inside = [
        radius(position_gain=0.95 * position.gain_margin),
        radius(gain=0.95 * whole.gain_margin),
        radius(delay=0.95 * whole.delay_margin),
    ]
    assert max(inside) < 1.0
    velocity = loops["velocity loop"].margins
    assert radius(gain=velocity.gain_margin, position=None, feedforward=None) == pytest.approx(1.0, abs=1e-6)
    assert radius(delay=velocity.delay_margin, position=None, feedforward=None) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    ("kp", "ti", "samples"), quick([(60.0, 0.1, 61), (40.0, 0.1, 80), (10.0, 0.2, 336)], 1, "slower loops")
)
def test_the_delay_margin_of_a_slow_loop_is_exact_too(kp, ti, samples):
    """Far beyond the delays that are tried one by one."""
    axis = axis_with(position_gain=1.0 / 30.0, velocity={"kp": kp, "ti": ti}, filters=None)
    found = {loop.name: loop.margins for loop in nested_loops(axis)}["whole loop"].delay_margin
    assert found == pytest.approx(samples * T, abs=T)
    plant, law = sample_axis(axis), linear_law(law_of(axis, T), T, 1.0)

    def radius(delay):
        return np.abs(close(plant.delayed(delay), law, plant_input=True).poles).max()

    assert radius(found - 0.1 * T) < 1.0 < radius(found + 0.1 * T)


def test_a_loop_of_one_rate_may_be_taken_for_a_periodic_one():
    axis = axis_with(1)
    plain = {loop.name: loop.margins for loop in nested_loops(axis)}["whole loop"]
    loop = axis_loop(axis)
    twice = [np.stack([matrix] * 2) for matrix in loop.opened]
    found = periodic_margins(*twice, T, lambda delay: 1.0)
    assert found.phase_margin_deg == pytest.approx(plain.phase_margin_deg, rel=1e-6)
    assert found.gain_margin == pytest.approx(plain.gain_margin, rel=1e-6)
    assert found.gain_reduction_margin == pytest.approx(plain.gain_reduction_margin or np.nan, rel=1e-6, nan_ok=True)
    assert found.delay_margin == pytest.approx(plain.delay_margin, rel=0.02)  # as nothing came of the delays tried
    w = np.array([2.0, 50.0, 900.0])
    one = loop.A, loop.B[:, 0], loop.C[1], np.array(loop.D[1, 0])
    doubled = [np.stack([part] * 2) for part in one]
    np.testing.assert_allclose(periodic_response(*doubled, w * T), loop.response(w, by="reference"), rtol=1e-8)


@pytest.mark.parametrize("every", [1, 4])
def test_poles_lifted_form_and_samples_tell_one_story(every):
    """The closed loop by samples, by cycles, and in the simulation of the axis without dry friction."""
    from emps_design.simulation import Plant

    axis = axis_with(every, feedforward={"velocity": 1.0, "acceleration": 2.0}).replace(
        mechanics={"coulomb": 0.0, "offset": 0.0}, drive={"voltage_limit": 1e9}, sampling={"encoder_resolution": 0.0}
    )
    loop = axis_loop(axis)
    assert loop.cycle == every
    assert loop.stable
    n = 60 * every
    q_ref = 1e-3 * (1.0 - np.cos(0.05 * np.arange(n)))
    inputs = np.zeros((n, len(loop.inputs)))
    inputs[:, 0] = q_ref
    v, _, _, u = loop.simulate(inputs).T
    run = Plant.of(axis).closed_loop(q_ref)
    np.testing.assert_allclose(u, run.u, atol=1e-7 * np.abs(run.u).max())
    np.testing.assert_allclose(v, run.v, atol=1e-7 * np.abs(run.v).max())
    system = loop.to_ss()
    assert system.dt == pytest.approx(every * T)
    state, outputs = np.zeros(system.nstates), []
    for row in inputs.reshape(n // every, -1):
        outputs.append(system.C @ state + system.D @ row)
        state = system.A @ state + system.B @ row
    np.testing.assert_allclose(np.reshape(outputs, (n, 4))[:, 3], u, atol=1e-9 * np.abs(u).max())
    np.testing.assert_allclose(np.sort(np.abs(system.poles())), np.sort(np.abs(loop.poles)), atol=1e-9)


@pytest.mark.parametrize("every", [1, 4])
def test_the_simulation_confirms_the_verdict(every):
    """A tenth below and above the largest stable gain of the position loop, the swing after a push falls and grows."""
    from emps_design.simulation import Plant

    limit = {loop.name: loop for loop in nested_loops(axis_with(every))}["position loop"].margins.gain_margin
    swing = {}
    for share in (0.9, 1.1):
        axis = axis_with(every, position_gain=share * limit).replace(
            mechanics={"coulomb": 0.0}, drive={"voltage_limit": 1e9}, sampling={"encoder_resolution": 0.0}
        )
        q = Plant.of(axis).closed_loop(np.zeros(3000), disturbance=np.where(np.arange(3000) < 5, 10.0, 0.0)).q
        swing[share] = np.abs(q[2000:]).max() / np.abs(q[200:1000]).max()
        assert axis_loop(axis).stable == (share < 1.0)
    assert swing[0.9] < 0.9 < 1.1 < swing[1.1]


def test_an_unstable_loop_has_no_margins():
    loops = {loop.name: loop.margins for loop in nested_loops(axis_with(4, position_gain=100.0))}
    assert loops["velocity loop"].stable
    assert not loops["whole loop"].stable
    assert loops["whole loop"].phase_margin_deg is None is loops["position loop"].gain_margin


def test_one_loop_is_told_once_and_no_controller_is_refused():
    alone = nested_loops(axis_with(position=None, feedforward=None))
    assert [loop.to_dict()["name"] for loop in alone] == ["velocity loop"]
    assert [loop.name for loop in nested_loops(machine("emps2019"))] == ["whole loop"]
    with pytest.raises(AxisError, match=r"controller\.kind: found 'none'"):
        nested_loops(machine("emps2018"))


def test_what_a_loop_of_different_rates_has_not_is_told():
    loop = axis_loop(axis_with(4))
    with pytest.raises(InputError, match=r"loop gain: found loops of different rates, periodic with 4 samples"):
        loop.loop_gain(np.array([1.0]))
    with pytest.raises(InputError, match="transfer function: found loops of different rates"):
        loop.to_tf()
    with pytest.raises(AxisError, match="law: found loops of different rates"):
        linear_law(law_of(axis_with(4), T), T).to_ss(T)
    assert linear_law(law_of(axis_with(1), T), T).to_ss(T).nstates > 0
