"""Experiments keep their limits on the nonlinear machine, and give what they promise."""

import json
import re

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli.app import run as command
from emps_design.errors import InputError, UnstableError
from emps_design.frequency_response import Limits, design_experiment, estimate_response, read_response
from emps_design.frequency_response.response import BAND
from emps_design.frequency_response.signals import repeated_share
from emps_design.machines import machine
from emps_design.simulation import Plant
from tests.unit.frequency_response.cases import exact, run, two_mass

LIGHT = {
    "mechanics": {"mass": 0.8, "viscous": 2.0, "coulomb": 0.5, "offset": 0.0},
    "drive": {"force_gain": 2.0},
    "sampling": {"period": 5e-4, "encoder_resolution": 1e-7},
    "controller": {"kind": "cascade", "position": {"kp": 40.0}, "velocity": {"kp": 40.0, "ti": 0.02}},
    "effects": [],
}


def noisy(axis, found, newtons, seed=1):
    """The record of an experiment under white force noise."""
    force = newtons * np.random.default_rng(seed).standard_normal(found.q_ref.size)
    return run(axis, found.q_ref, found.excitation, force)


@pytest.mark.parametrize("axis", [two_mass(), machine("emps2019").replace(**LIGHT)], ids=["two masses", "light"])
def test_limits_are_kept_and_deviations_come_as_expected(axis):
    limits = Limits(stroke=0.4, speed=0.2, force=0.8 * axis.drive.force_gain * axis.drive.command_limit)
    newtons = 0.004 * axis.mechanics.mass
    found = design_experiment(axis, limits, 0.05, low=3.0, high=150.0, resolution=1.0, passes=4, noise=newtons)
    simulated = Plant.of(axis).closed_loop(found.q_ref, voltage_noise=found.excitation)
    busy = found.excitation != 0.0
    assert np.min(np.abs(simulated.v[busy])) > 0.1 * found.speed
    assert np.max(np.abs(simulated.v)) < 1.05 * found.peaks["velocity"] <= 0.2
    assert np.ptp(simulated.position) < 0.4
    assert np.max(np.abs(simulated.force)) < limits.force
    assert np.max(np.abs(simulated.u[busy])) == pytest.approx(found.peaks["command"], rel=0.1)
    estimate = estimate_response(noisy(axis, found, newtons), axis)
    expected = np.interp(estimate.response.frequency, found.frequency, found.std)
    assert np.median(estimate.response.std / expected) == pytest.approx(1.0, abs=0.25)
    error = np.abs(estimate.response.response / exact(axis, estimate.response.frequency) - 1.0)
    assert np.mean(error <= BAND * estimate.response.std) >= 0.9
    assert estimate.warnings == () or all("left out" in warning for warning in estimate.warnings)


SERVO = {
    "motion": "rotary",
    "mechanics": {"mass": 2.5e-4, "viscous": 3e-4, "coulomb": 0.012, "offset": 0.002},
    "drive": {"command": "current", "command_unit": "mA", "force_gain": 1.1e-4, "command_limit": 4000.0},
    "sampling": {"period": 2.5e-4, "encoder_resolution": 6.283e-4},
    "controller": {
        "kind": "cascade",
        "position": {"kp": 38.8, "every": 4},
        "velocity": {"kp": 200.0, "ti": 0.019},
        "filters": [{"kind": "lowpass", "frequency": 600.0}],
        "velocity_estimator": "backward",
    },
}
ROTARY = {"axis": SERVO, "limits": Limits(60.0, speed=50.0), "speed": 20.0, "band": (5.0, 800.0, 5.0)}
HEAVY = {
    "axis": {
        "mechanics": {"mass": 900.0, "viscous": 400.0, "coulomb": 250.0},
        "drive": {"force_gain": 42.0, "voltage_limit": 250.0},
        "controller": {"kind": "cascade", "position": {"kp": 12.0}, "velocity": {"kp": 1200.0, "ti": 0.05}},
    },
    "limits": Limits(5.0, force=3000.0),
    "speed": 0.5,
    "band": (2.0, 200.0, 2.0),
}


@pytest.mark.parametrize("how", [{}, {"steps": 20}, {"at": "reference"}], ids=["multi-sine", "stepped", "reference"])
@pytest.mark.parametrize("case", [ROTARY, HEAVY], ids=["rotary", "heavy"])
def test_what_is_announced_holds_on_ramps_between_steps_and_for_the_controllers_own_share(case, how):
    """Where the controller answers with more than the sum, its output is what meets the limit of the drive."""
    axis = machine("emps2019").replace(effects=[], **case["axis"])
    low, high, resolution = case["band"]
    found = design_experiment(axis, case["limits"], case["speed"], low, high, resolution, **how)
    simulated = Plant.of(axis).closed_loop(found.q_ref, voltage_noise=found.excitation)
    limits, most = case["limits"], np.abs(simulated.u).max()
    assert np.abs(simulated.v).max() <= min(found.peaks["velocity"] * (1.0 + 1e-9), limits.speed or np.inf)
    assert most <= found.peaks["command"] * (1.0 + 1e-9)
    assert most < axis.drive.command_limit
    assert axis.drive.gain * most <= (limits.force or np.inf)
    assert np.abs(simulated.u - found.excitation).max() < axis.drive.command_limit  # nor is the controller clipped
    assert found.peaks["excitation_command"] > 0.01 * found.peaks["command"]


def test_passes_that_break_a_limit_by_themselves_are_refused():
    """A soft loop overshoots as it breaks away: 21 mm/s where the passes are of 10."""
    axis = machine("emps2019").replace(
        mechanics={"mass": 0.02, "viscous": 0.15, "coulomb": 0.05, "offset": -0.02},
        drive={"force_gain": 3.2, "voltage_limit": 5.0, "current_time_constant": 2e-4},
        sampling={"period": 2.5e-4, "encoder_resolution": 1e-6, "computation_delay": 1},
        controller={
            "kind": "cascade",
            "position": {"kp": 40.56},
            "velocity": {"kp": 0.538, "ti": 0.017},
            "velocity_estimator": "backward",
        },
        effects=[],
    )
    with pytest.raises(
        InputError, match="speed limit: the passes without excitation reach .* m/s, expected at most 0.019 m/s"
    ):
        design_experiment(axis, Limits(0.08, speed=0.019), 0.01, low=3.0, high=150.0, resolution=2.0)


def test_a_coarse_encoder_costs_at_most_twice_the_expected_deviation():
    axis = machine("emps2019").replace(**LIGHT).replace(sampling={"encoder_resolution": 1e-6})
    newtons = 0.004 * axis.mechanics.mass
    found = design_experiment(axis, Limits(0.4), 0.05, low=3.0, high=150.0, resolution=1.0, noise=newtons)
    estimate = estimate_response(noisy(axis, found, newtons), axis)
    expected = np.interp(estimate.response.frequency, found.frequency, found.std)
    assert 1.0 < np.median(estimate.response.std / expected) < 2.0


def test_added_to_the_reference():
    axis = two_mass()
    found = design_experiment(axis, Limits(0.4), 0.05, low=3.0, high=80.0, resolution=1.0, at="reference", noise=0.2)
    assert not np.any(found.excitation)
    assert list(found.columns) == ["t [s]", "q_ref [m]"]
    estimate = estimate_response(noisy(axis, found, 0.2), axis)
    assert (estimate.method, estimate.instrument, estimate.reversals) == ("periodic", "reference", 0)
    error = np.abs(estimate.response.response / exact(axis, estimate.response.frequency) - 1.0)
    assert np.mean(error <= BAND * estimate.response.std) >= 0.9


STEPPED = pytest.mark.study("experiments of minutes")


@pytest.mark.study("experiments of minutes")
@pytest.mark.parametrize(
    ("axis", "at"),
    [
        pytest.param(two_mass(), "command", id="two masses-command", marks=STEPPED),
        pytest.param(two_mass(), "reference", id="two masses-reference", marks=STEPPED),
        pytest.param(machine("emps2019").replace(**LIGHT), "command", id="light-command"),
        pytest.param(machine("emps2019").replace(**LIGHT), "reference", id="light-reference", marks=STEPPED),
    ],
)
def test_a_stepped_sine(axis, at):
    newtons = 0.01 * axis.mechanics.mass
    given = {"low": 3.0, "high": 150.0, "resolution": 1.0, "passes": 2, "noise": newtons, "at": at, "steps": 30}
    found = design_experiment(axis, Limits(0.4, speed=0.2), 0.05, **given)
    assert (found.signal, found.frequency.size) == ("stepped sine", 30)
    assert np.allclose(found.frequency, np.geomspace(3.0, 150.0, 30), rtol=5e-3)
    simulated = Plant.of(axis).closed_loop(found.q_ref, voltage_noise=found.excitation)
    assert np.ptp(simulated.position) < 0.4
    assert np.max(np.abs(simulated.v)) < 1.05 * found.peaks["velocity"] <= 0.2
    estimate = estimate_response(noisy(axis, found, newtons), axis)
    assert (estimate.method, estimate.reversals) == ("stepped", 0)
    assert estimate.instrument == ("reference" if at == "reference" else "excitation")
    assert estimate.passes == 60
    assert np.allclose(estimate.response.frequency, found.frequency)
    inside = []
    for seed in range(1, 5):
        response = estimate_response(noisy(axis, found, newtons, seed), axis).response
        inside.append(np.abs(response.response / exact(axis, response.frequency) - 1.0) <= BAND * response.std)
    assert np.mean(np.concatenate(inside)) >= 0.9
    assert 0.9 < np.median(estimate.response.std / found.std) < 1.6


@pytest.mark.parametrize(("step", "speed"), [(1e-4, 0.5), (1e-5, 0.5), (1e-4, 0.471116)])
def test_the_speed_is_just_below_the_asked_one_and_no_whole_number_of_steps_in_a_period(step, speed):
    axis = machine("emps2019").replace(**HEAVY["axis"], effects=[], sampling={"encoder_resolution": step})
    found = design_experiment(axis, Limits(5.0), speed, high=100.0, resolution=1.0)
    assert found.requested_speed == speed
    assert speed - 1.5 * step < found.speed <= speed  # of a period of 1 s
    advance = found.speed * found.samples * found.period / step
    assert 0.15 < advance % 1.0 < 0.85
    assert repeated_share(advance, 8) < 0.13
    assert found.to_dict()["asked_speed"] == speed


def test_both_speeds_are_told(capsys):
    assert command(["excite", "emps2019", "--stroke", "0.5", "--speed", "0.05", "--resolution", "1"]) == 0
    assert re.search(r"passes at 0\.0[45]\d* m/s \(requested: 0\.05\)", " ".join(capsys.readouterr().out.split()))


def test_the_velocity_at_the_reference_is_told_against_the_passes_not_against_what_is_added():
    """At 80 % of the speed no velocity changes its sign, whatever the reference with its excitation does."""
    found = design_experiment(machine("emps2019"), Limits(0.5), 0.05, at="reference")
    assert found.bound_by == "speed of the passes"
    assert found.peaks["slowest"] == pytest.approx(0.2 * found.speed, rel=0.05)


def test_a_jerk_limit_makes_it_smaller():
    axis = two_mass()
    free = design_experiment(axis, Limits(0.4), 0.05, high=100.0, resolution=1.0)
    jerk = 0.3 * free.peaks["excitation_jerk"]
    found = design_experiment(axis, Limits(0.4, jerk=jerk), 0.05, high=100.0, resolution=1.0)
    assert found.bound_by == "jerk limit"
    assert found.peaks["excitation_jerk"] == pytest.approx(0.9 * jerk)
    assert np.all(found.std > free.std)


def test_the_command_falls_with_frequency_and_lines_are_odd():
    found = design_experiment(two_mass(), Limits(0.4), 0.05, low=3.0, high=100.0, resolution=1.0, slope=1.0)
    lines = np.round(found.frequency * found.samples * found.period).astype(int)
    assert np.all(lines % 2 == 1)
    left_out = set(range(lines[0], lines[-1], 2)) - set(lines.tolist())
    assert len(left_out) >= lines.size // 5
    flat = design_experiment(two_mass(), Limits(0.4), 0.05, low=3.0, high=100.0, resolution=1.0, slope=0.0)
    assert found.std[-1] / found.std[3] > 3.0 * flat.std[-1] / flat.std[3]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"limits": Limits(0.05)},
            "stroke: found 0.05 m: a pass at 0.05 m/s can be excited for .* expected at least",
        ),
        ({"high": 500.0}, "frequency: found 500 Hz, expected less than the Nyquist frequency, 500 Hz"),
        ({"low": 0.0}, "frequencies: found 0 to 400 Hz"),
        ({"resolution": 0.0}, "resolution: found 0 Hz"),
        ({"low": 10.0, "high": 14.0, "resolution": 1.0}, "resolution: found .* lines in the band"),
        ({"speed": 0.0}, "speed: found 0, expected a positive number"),
        ({"limits": Limits(0.5, speed=0.05)}, "speed: found passes at 0.05 m/s, expected less than the limit"),
        ({"limits": Limits(0.5, force=10.0)}, "force limit: steady motion at 0.05 m/s leaves no margin"),
        ({"steps": 3}, "steps: found 3, expected at least 4 lines"),
        ({"limits": Limits(0.5, force=float("nan"))}, "force limit: found nan, expected a positive number"),
        ({"limits": Limits(0.5, jerk=float("nan"))}, "jerk limit: found nan, expected a positive number"),
        ({"limits": Limits(0.5, speed=float("inf"))}, "speed limit: found inf, expected a positive number"),
        (
            {"limits": Limits(1e6), "speed": 1e-3},
            "stroke: found an experiment of 3.6e\\+09 s, expected at most",
        ),
        (
            {"limits": Limits(1e6), "speed": 1e-3, "steps": 20, "resolution": 1e-3},
            "stroke: found an experiment of .* s, expected at most 5e\\+03 s",
        ),
        ({"at": "motor"}, "`at`: found 'motor', expected one of command, reference"),
    ],
)
def test_refused(change, message):
    given = {"limits": Limits(0.5), "speed": 0.05, **change}
    with pytest.raises(InputError, match=message):
        design_experiment(machine("emps2019"), **given)


def test_an_unstable_loop_is_not_excited():
    axis = machine("emps2019")
    with pytest.raises(UnstableError, match="its loop is unstable, largest pole"):
        design_experiment(axis.replace(controller={"kv": 20.0 * axis.controller.kv}), Limits(0.5), 0.05)


def test_the_circle_closes_without_a_drive(tmp_path, capsys):
    axis, program, record = (str(tmp_path / name) for name in ("axis.toml", "program.csv", "record.csv"))
    (tmp_path / "axis.toml").write_text(two_mass().to_toml())
    line = [
        "excite",
        axis,
        "--stroke",
        "0.3",
        "--speed",
        "0.05",
        "--to",
        "120Hz",
        "--resolution",
        "1",
        "--out",
        program,
    ]
    assert command([*line, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["lines"] == len(document["expected_std"])
    assert command(line) == 0
    assert "expected for" in capsys.readouterr().out
    assert command(["simulate", axis, "--reference", program, "--out", record, "--json"]) == 0
    capsys.readouterr()
    assert command(["frf", record, "--axis", axis, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["method"], found["instrument"], found["reversals"]) == ("periodic", "excitation", 0)
    assert found["resonances"][0]["frequency_hz"] == pytest.approx(60.0 * np.sqrt(0.6), rel=5e-3)


@pytest.mark.study("an experiment of minutes")
def test_a_rotary_axis_of_two_rates(tmp_path, capsys):
    coupling = {"kind": "flexible_coupling", "frequency": 210.0, "damping": 0.02, "share": 0.5}
    axis = Axis(
        name="spindle",
        motion="rotary",
        mechanics={"mass": 2e-4, "viscous": 4e-4, "coulomb": 0.02},
        drive={"command": "current", "force_gain": 0.1, "command_limit": 12.0},
        sampling={"period": 2.5e-4, "encoder_resolution": 1e-6, "computation_delay": 1},
        controller={
            "kind": "cascade",
            "position": {"kp": 40.0, "every": 4},
            "velocity": {"kp": 0.3, "ti": 0.02},
            "filters": [{"kind": "notch", "frequency": 210.0, "damping": 0.6, "depth": 0.1333}],
        },
        effects=[coupling],
    )
    (tmp_path / "axis.toml").write_text(axis.to_toml())
    files = [str(tmp_path / name) for name in ("axis.toml", "program.csv", "record.csv", "response.csv")]
    options = ["--stroke", "30", "--speed", "4", "--from", "4", "--to", "500", "--resolution", "2", "--out"]
    assert command(["excite", files[0], *options, files[1]]) == 0
    assert command(["simulate", files[0], "--reference", files[1], "--out", files[2]]) == 0
    assert command(["frf", files[2], "--axis", files[0], "--out", files[3]]) == 0
    assert "magnitude" in capsys.readouterr().out
    found = read_response(files[3])
    assert np.median(np.abs(found.response / exact(axis, found.frequency, 4.0) - 1.0)) < 0.01
    assert command(["gains", files[0], "--crossover", "150", "--frf", files[3], "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    for name in ("crossover", "phase_margin_deg", "delay_margin"):
        assert document["measured"][name] == pytest.approx(document["sampled"][name], rel=0.03)


def test_a_run_keeps_its_excitation(tmp_path):
    from emps_design.simulation import Run
    from emps_design.simulation.scenarios import follow

    axis = machine("emps2019")
    excitation = 0.1 * np.sin(np.arange(400.0))
    found = follow(axis, np.linspace(0.0, 0.02, 400), excitation=excitation).run
    found.save(tmp_path / "run.npz")
    assert np.array_equal(Run.load(tmp_path / "run.npz").excitation, excitation)
    assert np.array_equal(found.record().excitation, excitation)
