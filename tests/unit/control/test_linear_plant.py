"""Effects in the linear plant: each by the slope of its hooks, whatever its name."""

import math

import numpy as np
import pytest

from emps_design.control.discretisation import sample_axis
from emps_design.control.linear_plant import linear_plant
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.effects import EFFECTS
from emps_design.errors import InputError
from emps_design.machines import machine

IDEAL = machine("emps2018").replace(drive={"current_time_constant": 0.0})


def with_effect(axis, kind, **parameters):
    return axis.replace(effects=[{"kind": kind, **parameters}])


def test_lag_effect_is_the_current_loop():
    w = np.geomspace(1.0, 3000.0, 20)
    found = sample_axis(with_effect(IDEAL, "actuator_lag", time_constant=0.5e-3)).response(w)
    expected = sample_axis(machine("emps2018")).response(w)
    assert found == pytest.approx(expected, rel=1e-6)


def test_delay_effect_is_a_computation_delay():
    axis = with_effect(machine("emps2018"), "actuator_delay", delay=1e-3)
    found = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=60.0)
    assert found.sampled.margins.phase_margin_deg == pytest.approx(27.6, abs=0.05)
    half = with_effect(machine("emps2018"), "actuator_delay", delay=0.5e-3)
    between = design_velocity_loop(half, crossover=100.0, phase_margin_deg=60.0).sampled.margins.phase_margin_deg
    assert between == pytest.approx(0.5 * (39.18 + 27.62), abs=0.2)


def test_quadrants_of_friction():
    two = machine("emps2018-two-quadrant")
    assert linear_plant(two, 0.1).viscous == pytest.approx(474.9727)
    assert linear_plant(two, -0.1).viscous == pytest.approx(563.8568)


def test_two_masses_resonate_where_they_should():
    axis = with_effect(IDEAL, "flexible_coupling", frequency=40.0, damping=0.05, share=0.4)
    plant = linear_plant(axis.replace(mechanics={"viscous": 0.0}))
    assert plant.mass == pytest.approx(0.6 * 115.7315)
    resonance = np.max(np.abs(np.linalg.eigvals(plant.A)))
    assert resonance == pytest.approx(2 * math.pi * 40.0, rel=1e-9)


def test_spring_keeps_the_position_among_the_states():
    plant = sample_axis(with_effect(IDEAL, "elastic_force", stiffness=2e3, rest_position=0.0))
    assert 0 in plant.acting
    assert 0 not in sample_axis(IDEAL).acting
    # at low frequency the spring holds the carriage: velocity/voltage = s G/K
    w = 0.05
    expected = 1j * w * 35.15 / 2e3
    assert complex(plant.response(np.array(w))) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("crossover", [40.0, 100.0, 150.0])
def test_a_ripple_is_no_spring(crossover):
    """Along the travel its slope averages out: the design is that without it, and says what it is instead."""
    ripple = with_effect(machine("emps2018"), "position_ripple", amplitude=3.0, phase=0.5, period=2.5e-3)
    found = design_velocity_loop(ripple, crossover=crossover).to_dict()
    plain = design_velocity_loop(machine("emps2018"), crossover=crossover).to_dict()
    for key in ("value", "peak_voltage_per_unit", "window"):
        assert found["largest_velocity_step"][key] == pytest.approx(plain["largest_velocity_step"][key], rel=1e-9)
    assert found["sampled"]["phase_margin_deg"] == pytest.approx(plain["sampled"]["phase_margin_deg"], abs=1e-9)
    assert any("40 Hz at 0.1 m/s" in text and "+-3 N, not a spring" in text for text in found["warnings"])


def test_slow_motion_over_a_steep_ripple_is_looked_at():
    """2 pi 300 N / 1 mm: in slow motion a spring of 1.9e6 N/m, as stiff as the loop itself."""
    ripple = with_effect(machine("emps2018"), "position_ripple", amplitude=300.0, phase=0.5, period=1e-3)
    assert linear_plant(ripple).steepest == pytest.approx(6e5 * math.pi, rel=2e-3)
    said = design_velocity_loop(ripple, crossover=100.0).warnings
    assert any("in slow motion" in text and "has only" in text and "of phase margin" in text for text in said)
    steeper = with_effect(machine("emps2018"), "position_ripple", amplitude=3000.0, phase=0.5, period=1e-3)
    assert any(
        "in slow motion" in text and "unstable" in text for text in design_velocity_loop(steeper, 100.0).warnings
    )


def test_a_spring_is_judged_while_the_loop_moves():
    """A spring asks for more as the carriage travels; a step is watched until the loop's own motion has died away."""
    from scipy.signal import dlsim, dlti

    axis = with_effect(IDEAL, "elastic_force", stiffness=50.0, rest_position=0.0)
    found = design_velocity_loop(axis, crossover=100.0)
    loop, step = found.sampled.loop, found.to_dict()["largest_velocity_step"]
    count = round(step["window"] / axis.sampling.period)
    system = dlti(loop.A, loop.B, loop.C, loop.D, dt=1e-3)
    inputs = np.zeros((count, 3))
    inputs[:, 0] = 1.0  # the reference; the last output is the voltage
    voltage = dlsim(system, inputs)[1][:, -1]
    assert step["peak_voltage_per_unit"] == pytest.approx(np.max(np.abs(voltage)), rel=1e-9)
    assert step["window"] < 0.5


def test_a_stop_just_touched_is_left():
    """At a corner the flatter side counts: the axis works away from the stop, not half in it."""
    plant = linear_plant(with_effect(IDEAL, "end_stop", stiffness=1e4, position=0.0, side=-1.0))
    assert plant.A[1, 0] == 0.0
    inside = linear_plant(with_effect(IDEAL, "end_stop", stiffness=1e4, position=0.05, side=-1.0))
    assert inside.A[1, 0] == pytest.approx(-1e4 / plant.mass)


@pytest.mark.parametrize(
    ("kind", "parameters", "limit"),
    [("actuator_saturation", {"limit": 3.0}, 3.0), ("actuator_deadzone", {"width": 0.4}, 10.0)],
)
def test_an_actuator_counts_at_the_command_that_the_motion_takes(kind, parameters, limit):
    axis = with_effect(IDEAL, kind, **parameters)
    assert pytest.approx(linear_plant(IDEAL).B, rel=1e-6) == linear_plant(axis).B
    frictionless = axis.replace(mechanics={"viscous": 0.0, "coulomb": 0.0, "offset": 0.0})
    assert pytest.approx(linear_plant(IDEAL).B, rel=1e-6) == linear_plant(frictionless).B
    step = design_velocity_loop(axis, crossover=100.0).to_dict()["largest_velocity_step"]
    dry = step["dry_friction_voltage"] + parameters.get("width", 0.0)
    assert step["value"] * step["peak_voltage_per_unit"] == pytest.approx(limit - dry, rel=1e-6)


def test_an_actuator_too_weak_for_the_motion_is_said():
    axis = with_effect(IDEAL, "actuator_saturation", limit=0.05)
    assert pytest.approx(linear_plant(IDEAL).B, rel=1e-6) == linear_plant(axis).B
    assert any("needs 1.85 V, but at most 0.05 V act" in text for text in linear_plant(axis).warnings)
    with pytest.raises(InputError, match="with actuator_deadzone the voltage has no effect"):
        linear_plant(with_effect(IDEAL, "actuator_deadzone", width=10.0))


def test_no_mass_left_on_the_encoders_side_is_refused():
    coupling = {"kind": "flexible_coupling", "frequency": 50.0, "damping": 0.0, "share": 0.5}
    with pytest.raises(InputError, match="flexible_coupling and flexible_coupling leave 0 kg on the encoder side"):
        linear_plant(IDEAL.replace(effects=[coupling, coupling]))


@pytest.mark.parametrize("kind", ["elastic_force", "end_stop"])
def test_the_nearest_pair_is_found_on_a_spring(kind):
    """A force over position leaves a root on z = 1 that no velocity shows; it is no instability."""
    parameters = {"stiffness": 2e3, "rest_position": 0.0}
    if kind == "end_stop":
        parameters = {"stiffness": 2e3, "position": 0.05, "side": -1.0}
    axis = with_effect(machine("emps2018"), kind, **parameters)
    design = design_velocity_loop(axis, crossover=400.0)
    assert not design.sampled.stable
    assert design_velocity_loop(axis, **design.nearest_stable).sampled.stable


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_every_effect_takes_part_or_is_named(effect):
    """No effect breaks a design; what its slope cannot show is said by name."""
    values = {}
    for p in effect.parameters:
        low = p.lower if math.isfinite(p.lower) else -1.0
        high = p.upper if math.isfinite(p.upper) else 1.0
        values[p.name] = p.starts[0] if p.starts else min(max(0.1, low), high)
    axis = IDEAL.replace(motion=effect.motion or "linear", effects=[{"kind": effect.name, **values}])
    plant = linear_plant(axis)
    assert np.all(np.isfinite(plant.A))
    design = design_velocity_loop(axis, crossover=60.0, phase_margin_deg=60.0)
    assert np.all(np.isfinite(design.sampled.poles))
    if effect.solver.guard is not None or effect.solver.jump_time is not None or effect.command is not None:
        assert any(warning.startswith(effect.name) for warning in design.warnings)


def test_effects_are_announced_beside_the_closed_form():
    design = design_velocity_loop(machine("emps2018-two-quadrant"), crossover=100.0, phase_margin_deg=60.0)
    assert any("friction slope of 475 N/(m/s)" in warning for warning in design.warnings)


def test_the_other_direction_is_looked_at():
    """A drive that brakes less one way: the slope of friction is negative there, and the design says so."""
    axis = machine("emps2018").replace(
        effects=[{"kind": "asymmetric_viscous_friction", "viscous_difference": 5000.0}],
        sampling={"computation_delay": 2},
    )
    design = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=60.0)
    assert design.sampled.stable
    said = [warning for warning in design.warnings if "-0.1 m/s" in warning]
    assert said
    assert ("has only" in said[0] and "of phase margin" in said[0]) or "unstable" in said[0]


def test_a_notebook_shows_the_verdict_first():
    html = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)._repr_html_()
    assert html.startswith('<p class="good">emps2018: sampled velocity loop, IP, is stable</p>\n<table>')
    assert "556.766" in html


def test_a_motion_that_takes_more_than_the_limit_is_told_by_a_name():
    said = linear_plant(machine("emps2018"), velocity=-1.0).warnings
    assert said[0].startswith("limit of the command: steady motion at -1 m/s needs -14 V, but at most -10 V act")
