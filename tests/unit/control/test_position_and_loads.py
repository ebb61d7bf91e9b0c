"""The position loop for what is wanted of it, and a velocity loop over a range of loads, against simulation."""

import json

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.control.discretisation import sample_axis
from emps_design.control.position import design_position_loop
from emps_design.control.sampled import axis_loop
from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop
from emps_design.control.velocity.gains import PI
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.control.velocity.load_range import LoadRange, loaded, margins_over_range
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.control.verdict import sampled_step
from emps_design.errors import InputError, SpecificationError
from emps_design.machines import machine
from emps_design.simulation import Plant

AXIS = machine("emps2018")
INNER = design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=60.0, structure=PI)
COUPLING = {"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.6}


@pytest.mark.parametrize(("wanted", "value"), [("overshoot", 5.0), ("bandwidth", 40.0), ("stiffness", 1.5e6)])
@pytest.mark.parametrize("every", [1, 4])
def test_the_position_loop_has_what_was_wanted(wanted, value, every):
    found = design_position_loop(INNER, wanted, value, every)
    assert found.stable
    assert found.axis().controller.position == {"kp": found.kp, "every": every}
    has = {"overshoot": found.overshoot_percent, "bandwidth": found.bandwidth, "stiffness": found.stiffness}
    assert has[wanted] == pytest.approx(value, rel=2e-3)


def test_overshoot_in_the_simulated_drive():
    """Without dry friction and far from the limit the nonlinear simulation does what the linear loop says."""
    found = design_position_loop(INNER, "overshoot", 6.0, 4)
    free = found.axis().replace(mechanics={"coulomb": 0.0, "offset": 0.0})
    reference = np.full(600, 1e-4)
    reference[0] = 0.0
    q = Plant.of(free).closed_loop(reference, quantise=False).q
    assert 100.0 * (q.max() / 1e-4 - 1.0) == pytest.approx(6.0, abs=0.3)


def test_following_errors_are_those_of_a_ramp():
    found = design_position_loop(INNER, "bandwidth", 40.0, 2)
    errors = found.following_errors()
    assert errors["none"]["velocity"] == pytest.approx(1.0 / found.kp, rel=2e-2)  # less what the hold of 2 samples adds
    assert abs(errors["velocity"]["velocity"]) < 1e-6
    assert abs(errors["velocity and acceleration"]["jerk"]) < abs(errors["velocity"]["jerk"])
    loop = axis_loop(found.axis())
    inputs = np.zeros((3000, len(loop.inputs)))
    inputs[:, loop.inputs.index("reference")] = loop.period * np.arange(1, 3001)
    position = np.cumsum(loop.simulate(inputs)[:, 1]) * loop.period
    behind = inputs[1:, loop.inputs.index("reference")] - position[:-1]
    assert behind[-100:].mean() == pytest.approx(errors["none"]["velocity"], rel=2e-2)


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        (("speed", 1.0), InputError, "found 'speed', expected one of overshoot"),
        (("bandwidth", -1.0), InputError, "found bandwidth -1 rad/s, expected a positive number"),
        (("stiffness", 1e12), SpecificationError, "no gain gives the stiffness"),
    ],
)
def test_what_cannot_be_had(arguments, kind, message):
    with pytest.raises(kind, match=message):
        design_position_loop(INNER, *arguments)
    unstable = design_velocity_loop(AXIS, crossover=900.0)
    with pytest.raises(SpecificationError, match="the inner velocity loop is unstable"):
        design_position_loop(unstable, "overshoot", 1.0)


def test_a_load_of_five_times_the_inertia():
    """What is stated for both ends of 1:5 is what the loops there have."""
    design = design_velocity_loop(AXIS, crossover=60.0, phase_margin_deg=50.0, structure=PI)
    study = margins_over_range(design, LoadRange(inertia=(1.0, 5.0)))
    assert [round(point["inertia"], 3) for point in study["points"]] == [1.0, 2.236, 5.0]
    one = study["one"]
    for point in study["points"]:
        plant_axis = loaded(AXIS, point["inertia"], 1.0)
        own = SampledVelocityLoop(design_velocity_loop(plant_axis, 60.0).sampled.plant, design.k_v1, design.t_v, PI)
        assert own.margins.phase_margin_deg == pytest.approx(point["phase_margin_deg"])
        held = SampledVelocityLoop(own.plant, one["k_v1"], one["t_v"], PI).margins
        assert held.phase_margin_deg >= 50.0 - 1e-4
        assert held.crossover >= one["slowest_crossover"] * (1.0 - 1e-6)
        late = SampledVelocityLoop(own.plant.delayed(0.99 * held.delay_margin), one["k_v1"], one["t_v"], PI)
        assert late.stable
    assert "one pair of gains meets the margins" in study["text"]
    fast = design_velocity_loop(AXIS, crossover=150.0, phase_margin_deg=50.0, structure=PI)
    assert "schedule the gains with the inertia" in margins_over_range(fast, LoadRange(inertia=(1.0, 5.0)))["text"]


@pytest.mark.parametrize("at", ["", "velocity-error"])
@pytest.mark.parametrize("name", ["emps2018", "emps2019"])
def test_the_crossover_of_a_range_is_where_it_was_asked(name, at):
    """IP stands at the velocity error: gains that reach 60 rad/s at the plant input alone have far less there."""
    axis = machine(name)
    asked = {"crossover": 60.0, "phase_margin_deg": 60.0}
    design = retune_velocity_loop(axis, at=at, **asked) if at else design_velocity_loop(axis, **asked)
    study = margins_over_range(design, LoadRange(inertia=(1.0, 3.0)))
    one = study["one"]
    assert study["at"] == "velocity-error"
    assert "one pair of gains meets the margins" in study["text"]
    assert "at the velocity error" in study["text"]
    for point in study["points"]:
        end = loaded(axis, point["inertia"], 1.0)
        had = VelocityLoopDesign(end, design.k_v1, design.t_v, {}).sampled
        assert had.velocity_error.phase_margin_deg == pytest.approx(point["phase_margin_deg"])
        assert had.velocity_error.crossover == pytest.approx(point["crossover"])
        assert had.margins.gain_margin == pytest.approx(point["plant_input"]["gain_margin"])
        held = VelocityLoopDesign(end, one["k_v1"], one["t_v"], {})
        assert held.crossover > 60.0  # of the continuous T_vo as well
        assert held.sampled.velocity_error.crossover >= one["slowest_crossover"] * (1.0 - 1e-6)
        assert held.sampled.velocity_error.phase_margin_deg >= 60.0 - 1e-4
        assert held.sampled.margins.gain_margin >= 2.0
        assert sampled_step(held).rise_time < 1.5 * sampled_step(design).rise_time


def test_a_bandwidth_retuned_is_held_against_the_crossover_it_has_there():
    design = retune_velocity_loop(AXIS, bandwidth=50.0, phase_margin_deg=50.0)
    study = margins_over_range(design, LoadRange(inertia=(1.0, 1.0)))
    assert study["at"] == "plant-input"
    assert study["points"][0]["crossover"] == pytest.approx(design.sampled.margins.crossover)
    slow = LoadRange(inertia=(1.0, 20.0))
    assert (
        f"a crossover of {design.sampled.margins.crossover:.4g} rad/s at the plant input"
        in (margins_over_range(design, slow)["text"])
    )


def test_compliance_and_delay_of_a_coupling():
    axis = AXIS.replace(effects=[COUPLING])
    soft = loaded(axis, 1.0, 4.0).effects[0].parameters
    assert soft["frequency"] == pytest.approx(24.0)
    assert soft["damping"] == pytest.approx(0.04)  # the damper is as it was
    design = design_velocity_loop(axis, crossover=20.0)
    study = margins_over_range(design, LoadRange(compliance=(0.5, 2.0), delay=(0.0, 1e-3)))
    assert len(study["points"]) == 9
    least = min(point["phase_margin_deg"] for point in study["points"])
    assert study["worst"]["phase_margin_deg"] == least
    with pytest.raises(InputError, match="found one for a rigid axis"):
        loaded(AXIS, 1.0, 2.0)
    with pytest.raises(InputError, match="expected more than 0.4, the share of the inertia before the coupling"):
        loaded(axis, 0.3, 1.0)
    with pytest.raises(InputError, match="range of inertia: found 2 to 1"):
        LoadRange(inertia=(2.0, 1.0))


def test_the_command(capsys, tmp_path):
    line = "gains --crossover 60 --structure pi --position-overshoot 2 --position-every 4 --inertia-range 1:2"
    assert run([*line.split(), "--json", "--out", str(tmp_path / "out.toml")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["position_loop"]["overshoot_percent"] == pytest.approx(2.0, abs=0.02)
    assert [one["name"] for one in found["position_loop"]["loops"]] == ["velocity loop", "position loop", "whole loop"]
    assert len(found["load_range"]["points"]) == 3
    assert run(["gains", str(tmp_path / "out.toml"), "--crossover", "60"]) == 0
    assert run(["gains", "--crossover", "60", "--structure", "pi", "--position-bandwidth", "10"]) == 0
    assert "Following error" in capsys.readouterr().out
    assert run(["gains", "--crossover", "60", "--inertia-range", "5"]) == 2
    assert "--inertia-range: found '5', expected LOW:HIGH" in capsys.readouterr().err
    assert run(["gains", "--crossover", "60", "--position-overshoot", "5", "--position-bandwidth", "9"]) == 2
    assert "found overshoot and bandwidth, expected one of" in capsys.readouterr().err


def test_a_design_written_to_a_file_keeps_the_drives_feed_forward(tmp_path):
    ahead = {"velocity": 0.9, "acceleration": 2.5, "coulomb": 1.0}
    drive = {"kind": "cascade", "position": {"kp": 9.0}, "velocity": {"kp": 99.0, "ti": 0.1}, "feedforward": ahead}
    (tmp_path / "drive.toml").write_text(AXIS.replace(controller=drive).to_toml())
    line = ["gains", str(tmp_path / "drive.toml"), "--crossover", "60", "--position-overshoot", "2"]
    assert run([*line, "--out", str(tmp_path / "better.toml")]) == 0
    own = Axis.from_toml((tmp_path / "better.toml").read_text()).controller
    assert own.feedforward == ahead
    assert own.position["kp"] > 9.0
    assert own.velocity["kp"] > 99.0


def test_the_feed_forward_of_the_acceleration_moves_the_load_too():
    axis = AXIS.replace(effects=[COUPLING])
    inner = design_velocity_loop(axis, crossover=40.0, phase_margin_deg=50.0, structure=PI)
    ahead = design_position_loop(inner, "bandwidth", 10.0).feedforwards["velocity and acceleration"]
    assert ahead["acceleration"] * axis.drive.gain == pytest.approx(axis.mechanics.mass)


def test_more_delay_than_an_axis_may_have_is_refused():
    with pytest.raises(InputError, match="found up to 100000 s, 1e.08 samples, expected at most 1000 samples, 1 s"):
        margins_over_range(INNER, LoadRange(delay=(0.0, 1e5)))


def test_a_crossing_behind_the_resonance_makes_no_loop_faster():
    """The lowest crossings by brute force: the loop's least phase margin is at another, behind its resonance."""
    gantry = AXIS.replace(
        mechanics={"mass": 2000.0, "viscous": 800.0},
        drive={"force_gain": 400.0, "current_time_constant": 0.002},
        sampling={"period": 5e-3, "computation_delay": 1},
        effects=[{**COUPLING, "frequency": 6.0}],
    )
    design = design_velocity_loop(gantry, crossover=12.0, phase_margin_deg=60.0, structure=PI)
    study = margins_over_range(design, LoadRange(inertia=(0.7, 1.6)))
    assert "a crossover of 12 rad/s at the plant input is not feasible over the range" in study["text"]
    alone = {entry["inertia"]: entry["gains"] for entry in study["schedule"]}
    assert min(gains["slowest_crossover"] for gains in alone.values()) >= 0.99 * study["one"]["slowest_crossover"]
    w, crossings = np.geomspace(0.1, 300.0, 30_000), {}
    for inertia, own in alone.items():
        plant = sample_axis(loaded(gantry, inertia, 1.0))
        for name, gains in (("own", own), ("one", study["one"])):
            size = np.abs(SampledVelocityLoop(plant, gains["k_v1"], gains["t_v"], PI).plant_input_response(w))
            crossings[name, inertia] = w[np.argmax(size < 1.0)]
        assert own["slowest_crossover"] == pytest.approx(crossings["own", inertia], rel=1e-3)
    assert study["one"]["slowest_crossover"] == pytest.approx(
        min(crossings["one", inertia] for inertia in alone), rel=1e-3
    )
