"""The studio's numbers on machines unlike the demo: what it starts with can be designed, moved, and saved."""

import numpy as np
import pytest

pytest.importorskip("panel", reason="the extra 'studio' is not installed")

from emps_design.axis import NO_LIMIT, Axis
from emps_design.machines import machine, machine_names
from emps_design.studio.design_view import DesignView
from emps_design.studio.files_view import velocity_design
from emps_design.studio.motion_view import DESIGN, move
from emps_design.studio.plots import feasible, reachable_frequencies
from emps_design.studio.ranges import CHOICES, choices_of, requirements, sizes
from emps_design.studio.state import State, differences_in_words


def axis(name, mechanics, drive, period, **more):
    table = dict(zip(("mass", "viscous", "coulomb"), mechanics, strict=True))
    sampling = {"period": period, "encoder_resolution": 1e-6}
    return Axis.from_dict({"name": name, "mechanics": table, "drive": drive, "sampling": sampling, **more})


CURRENT = {"command": "current", "force_gain": 9.2, "command_limit": 10.3, "current_time_constant": 1e-3}
TORQUE = {"command": "torque", "force_gain": 1.0, "command_limit": 0.5}
DUTY = {"command": "duty", "force_gain": 0.0963, "supply": 5.0, "back_emf": 0.387}
FORCE = {"command": "force", "force_gain": 1.0, "command_limit": 4e4, "current_time_constant": 0.02}
PERCENT = {"command": "torque", "command_unit": "%", "force_gain": 15.08, "command_limit": 146.0}
UNLIKE = {
    "joint": axis("joint", (1.15, 8.1, 7.2), CURRENT, 1e-3, motion="rotary"),
    "5 g m^2": axis("wrist", (0.005, 0.004, 0.013), TORQUE, 1e-3, motion="rotary"),
    "duty": axis("horn", (0.0067, 0.004, 0.013), DUTY, 1e-3, motion="rotary"),
    "30 t": axis("portal", (3e4, 1.5e4, 2e3), FORCE, 0.01),
    "4 kHz": axis("screw", (62.0, 310.0, 48.0), PERCENT, 2.5e-4),
    "no limit, no friction": axis("air", (8.0, 0.0, 0.0), {"command": "force", "force_gain": 1.0}, 1e-4),
}


@pytest.mark.parametrize("name", UNLIKE)
def test_the_first_numbers_are_of_the_axis(name):
    one = UNLIKE[name]
    state, mechanics = State.of(one), one.mechanics
    assert State.from_toml(state.to_toml()) == state
    assert 0.2 < state.mass / mechanics.mass < 1.0
    assert 0.2 < state.damping / state.mass / 2.0 < 5.0  # 0.5 s of the hand's own time
    assert velocity_design(state).sampled.margins.stable
    low, high = reachable_frequencies(state)
    assert low <= state.frequency <= high
    assert not feasible(state).empty
    if one.drive.command_limit < NO_LIMIT:
        motor = one.drive.gain * one.drive.command_limit
        assert mechanics.coulomb < state.push < motor
    found = move(state, None, None, lambda *at: None).runs[DESIGN].to_dict()
    assert found["saturated_share"] == 0.0
    assert found["tracking_error"]["rms"] < 0.1 * state.stroke


def test_ranges_end_on_round_numbers_and_hold_what_they_start_with():
    for one in UNLIKE.values():
        for name, choice in choices_of(one).items():
            assert choice.holds(choice.first) or name in ("period_ms", "current_ms")
            assert float(f"{choice.upper:.2g}") == choice.upper or not choice.size
        assert all(np.isfinite(size) and size > 0.0 for size in sizes(one).values())
    assert sizes(machine("emps2018")).keys() >= {choice.size for choice in CHOICES.values()} - {""}


def test_a_knob_turns_over_the_range_of_its_axis():
    view = DesignView(State.of(machine("emps2018")), {"emps2018": machine("emps2018")}, lambda state: None)
    view.turn("mass", 60.0)
    view.add_axis(UNLIKE["joint"])
    slider = view.knobs["mass"].slider
    assert (slider.start, slider.value, slider.end, slider.step) == (0.01, 0.5, 2.0, 0.01)
    assert view.knobs["wall"].field.step == 0.01
    view.turn("mass", 60.0)
    assert "mass: found 60.0, expected 0.01 to 2" in view.message.object
    view.add_axis(UNLIKE["30 t"])
    frequency = choices_of(UNLIKE["30 t"])["frequency"]
    assert (view.plane.plot.x_range.start, view.plane.plot.x_range.end) == (frequency.lower, frequency.upper)
    assert view.knobs["period_ms"].slider.end == 50.0


NUMBERS = sorted(CHOICES.keys() - {"period_ms", "computation_delay", "current_ms"})


@pytest.mark.parametrize("name", ["30 t", "4 kHz", "no limit, no friction"])
def test_another_axis_moves_no_specification(name):
    before = State.of(machine("emps2018"))
    after = before.with_axis(UNLIKE[name])
    assert after.axis == UNLIKE[name]
    assert {one: getattr(after, one) for one in NUMBERS} == {one: getattr(before, one) for one in NUMBERS}
    assert all(choice.holds(getattr(after, one)) for one, choice in after.choices.items())
    assert State.from_toml(after.to_toml()) == after
    chosen = before.changed(structure="PI", position_kp=33.0, filters=[{"kind": "lowpass", "frequency": 90.0}])
    moved = chosen.with_axis(UNLIKE[name])
    assert (moved.structure, moved.position_kp, moved.filters) == (chosen.structure, 33.0, chosen.filters)


def test_numbers_in_other_units_start_anew_and_the_others_stay():
    joint, before = UNLIKE["joint"], State.of(machine("emps2018")).changed(frequency=80.0, mass=60.0)
    after = before.with_axis(joint)
    assert (after.frequency, after.phase_margin_deg, after.filter) == (80.0, 60.0, 500.0)
    assert (after.mass, after.wall, after.stroke) == tuple(
        getattr(State.of(joint), one) for one in ("mass", "wall", "stroke")
    )
    assert (
        differences_in_words(before, after)
        == "Changed with joint: current loop 1 ms. Numbers in other units were reset."
    )


PI = {"kind": "cascade", "velocity": {"kp": 300.0, "ti": 0.03}}
LATE = {"period": 1e-3, "computation_delay": 2, "encoder_resolution": 1e-6}
STARTS = {
    **UNLIKE,
    **{name: machine(name) for name in machine_names()},
    "PI": machine("emps2018").replace(controller=PI),
    "late": machine("emps2018").replace(sampling=LATE, drive={"current_time_constant": 3e-3}),
    "16 kHz": axis("cell", (0.02, 0.1, 0.05), FORCE | {"command_limit": 5.0, "current_time_constant": 5e-5}, 6.25e-5),
    "flexible": machine("emps2018").replace(
        effects=[{"kind": "flexible_coupling", "frequency": 45.0, "damping": 0.03, "share": 0.3}]
    ),
}


@pytest.mark.parametrize("name", STARTS)
def test_a_start_meets_its_own_requirements(name):
    state = State.of(STARTS[name])
    design = velocity_design(state)
    assert requirements(design, state.required_phase_deg, state.required_overshoot_percent).met
    assert not design.refused
    assert design.sampled.margins.gain_margin >= 2.0


def test_a_specification_that_another_axis_cannot_have_stays_and_the_nearest_is_named():
    view = DesignView(State.of(machine("emps2018")), {"emps2018": machine("emps2018")}, lambda state: None)
    view.turn("frequency", 300.0)
    margin = view.state.phase_margin_deg
    view.add_axis(UNLIKE["30 t"])
    assert (view.state.frequency, view.state.phase_margin_deg) == (300.0, margin)
    assert view.knobs["frequency"].field.value == "300"
    assert 'class="message bad"' in view.message.object
    assert "The nearest feasible frequency is" in view.message.object
    view.reset.clicks += 1
    assert view.state == State.of(UNLIKE["30 t"])
    assert 'class="message note"' in view.message.object


def test_a_faster_clock_moves_the_ranges_and_no_specification():
    slow = State.of(machine("emps2018")).changed(frequency=10.0, filter=2500.0)
    fast = slow.changed(period_ms=0.15, current_ms=0.0)
    choice = choices_of(fast.axis)["frequency"]
    assert (choice.lower, choice.upper, fast.frequency, fast.filter) == (50.0, 6000.0, 10.0, 2500.0)
    assert (fast.choices["frequency"].lower, fast.choices["frequency"].upper) == (10.0, 6000.0)
    assert State.from_toml(fast.to_toml()) == fast
