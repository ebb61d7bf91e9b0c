"""The verdict on a design is that of the worst loop that will run, on every machine asked about; held by simulation."""

import json
import math

import numpy as np
import pytest

from emps_design.advice import advise, where_in_words
from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.codegen import export_controller
from emps_design.compensation import compensate
from emps_design.control.controller import controller_margins
from emps_design.control.force import design_force_loop
from emps_design.control.margins import Margins
from emps_design.control.sampled import NestedLoop, nested_loops, safety, worst_loop
from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop
from emps_design.control.velocity.gains import PI
from emps_design.control.velocity.load_range import LoadRange, loaded, margins_under_mismatch, relative_mismatch
from emps_design.control.verdict import DesignVerdict, cases_of
from emps_design.errors import UnstableError
from emps_design.machines import machine
from emps_design.report.velocity import gains_section
from emps_design.simulation import Plant
from emps_design.simulation.scenarios import follow
from emps_design.view import Line

# A ball screw whose position loop was made for a velocity loop four times as fast as the one asked for below.
SCREW = Axis.from_dict(
    {
        "name": "screw",
        "mechanics": {"mass": 48.0, "viscous": 260.0, "coulomb": 35.0},
        "drive": {"command": "torque", "command_unit": "%", "force_gain": 15.1, "command_limit": 150.0},
        "sampling": {"period": 0.5e-3, "encoder_resolution": 1e-7},
        "controller": {
            "kind": "cascade",
            "position": {"kp": 100.0, "every": 2},
            "velocity": {"kp": 724.5, "ti": 0.00856},
            "feedforward": {"velocity": 1.0, "acceleration": 2.5},
        },
    }
)
ASKED = {"crossover": 60.0, "phase_margin_deg": 50.0}
LINE = "--crossover 60 --phase-margin 50"


@pytest.fixture
def screw(tmp_path):
    path = tmp_path / "screw.toml"
    path.write_text(SCREW.to_toml())
    return path


def document(capsys, line, status=0):
    assert run([*line.split(), "--json"]) == status
    return json.loads(capsys.readouterr().out)


def swings(axis, step=1e-5):
    """Size of the error late after a small step of the reference, over the step, in the linear simulated drive."""
    free = axis.replace(mechanics={"coulomb": 0.0, "offset": 0.0})
    reference = np.full(3000, step)
    reference[0] = 0.0
    return float(np.abs(Plant.of(free).closed_loop(reference, quantise=False).q[-600:] / step - 1.0).max())


def test_the_position_loop_that_is_kept_is_judged_over_the_range(capsys, screw, tmp_path):
    out = tmp_path / "out.toml"
    said = document(capsys, f"gains {screw} {LINE} --inertia-range 1:3 --out {out}", 4)
    assert not out.exists()
    assert said["sampled"]["stable"]  # the innermost loop alone
    assert (said["stable"], said["worst_loop"]["name"]) == (False, "position loop")
    assert [[loop["stable"] for loop in point["loops"]] for point in said["load_range"]["points"]] == [
        [True, True, True], [True, False, False], [True, False, False],
    ]  # fmt: skip
    assert said["reason"].startswith("the axis file's position loop with kp = 100 is unstable around this velocity")
    kp = said["nearest"]["position_kp"]
    held = document(capsys, f"gains {screw} {LINE} --inertia-range 1:3 --position-kp {kp} --out {out}")
    assert held["stable"]
    assert held["worst_loop"]["phase_margin_deg"] > 20.0
    written = Axis.load(out)
    assert written.controller.position["kp"] == kp
    kept = design_velocity_loop(SCREW, **ASKED).axis_that_runs
    for factor in (1.0, 2.0, 3.0):
        assert swings(loaded(written, factor, 1.0)) < 0.5
    assert swings(loaded(kept, 3.0, 1.0)) > 2.0


def test_the_headline_is_that_of_the_worst_loop(capsys, screw):
    assert run(f"gains {screw} {LINE}".split()) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first == "screw: sampled velocity loop, PI, with the axis file's position loop around it, is stable"
    assert second.startswith("worst: whole loop: phase margin 5.4")
    assert run(f"gains {screw} {LINE} --inertia-range 1:3".split()) == 4
    out, err = capsys.readouterr()
    assert out.splitlines()[0].endswith("over the range of loads, is UNSTABLE")
    assert "nearest that is stable: --position-kp" in err


def test_a_position_gain_that_leaves_little_is_named_with_one_that_leaves_more(capsys, screw):
    said = document(capsys, f"gains {screw} {LINE}")
    (warning,) = [one for one in said["warnings"] if one.startswith("the whole loop has only 5.4 deg")]
    kp = float(warning.split("--position-kp ")[1].split()[0])
    better = document(capsys, f"gains {screw} {LINE} --position-kp {kp}")
    assert all(loop["phase_margin_deg"] >= 30.0 for loop in better["position_loop"]["loops"])


@pytest.mark.parametrize("option", ["--mismatch 0.5", "--delay-range 0:0.01"])
def test_an_unstable_corner_or_delay_exits_4(capsys, option, tmp_path):
    out = tmp_path / "out.toml"
    said = document(capsys, f"gains emps2018 --crossover 150 --phase-margin 60 {option} --out {out}", 4)
    assert said["sampled"]["stable"]
    assert (said["stable"], said["worst_loop"]["name"]) == (False, "velocity loop")
    assert not out.exists()
    assert said["nearest"]["crossover"] < 150.0
    again = f"gains emps2018 --crossover {said['nearest']['crossover']} --phase-margin 60 {option} --out {out}"
    assert document(capsys, again)["stable"]
    assert out.exists()


def test_a_range_is_unstable_where_it_is_between_its_ends():
    """A conditionally stable plant in the middle of a range is seen though both ends hold."""
    span = LoadRange(inertia=(1.0, 3.0))
    assert len(span.points(span.enough)) == 9
    assert {point["inertia"] for point in span.points()} <= {point["inertia"] for point in span.points(span.enough)}
    both = LoadRange(inertia=(1.0, 3.0), delay=(0.0, 1e-3))
    assert len(both.points(both.enough)) == 25


def test_the_worst_is_unstable_before_it_is_small_and_counts_phase_and_gain():
    def loop(name, **margins):
        return NestedLoop(name, "plant input", Margins(**margins))

    phase = loop("phase", stable=True, phase_margin_deg=29.0, gain_margin=9.0)
    gain = loop("gain", stable=True, phase_margin_deg=80.0, gain_margin=1.9)
    gone, later = loop("gone", stable=False), loop("later", stable=False)
    assert worst_loop([gain, phase]) is gain
    assert worst_loop([gain, phase, gone, later]) is gone
    assert safety(loop("safe", stable=True, phase_margin_deg=30.0, gain_margin=2.0).margins) == pytest.approx(1.0)
    assert safety(loop("none", stable=True).margins) == math.inf
    assert where_in_words({}) == ""
    assert where_in_words({"velocity": -0.1}) == "at -0.1 m/s"


def test_the_other_way_counts_where_friction_differs():
    """Viscous friction of another slope the other way: there the loop has other margins, and they are judged."""
    axis = machine("emps2018-two-quadrant")
    design = design_velocity_loop(axis, crossover=100.0)
    ways = [dict(case.where) for case in cases_of(design.axis_that_runs)]
    assert ways == [{}, {"velocity": -0.1}]
    back = VelocityLoopDesign(axis, design.k_v1, design.t_v, {}, velocity=-0.1).sampled.margins
    own = DesignVerdict(design).at({"velocity": -0.1})[0].margins
    assert own.phase_margin_deg == pytest.approx(back.phase_margin_deg)


def test_a_force_loop_runs_without_contact_too(capsys, tmp_path):
    """A hand that damps the carriage holds a velocity loop that is unstable by itself, until the hand lets go."""
    design = design_velocity_loop(machine("emps2018"), crossover=380.0)
    force = design_force_loop(design, 1e-5, hand=1e5)
    assert (force.stable, force.worst.name, force.worst.margins.stable) == (True, "velocity loop", False)
    line = f"force --k-e1 1e-5 --hand 1e5 --crossover 380 --out {tmp_path / 'out.toml'}"
    said = document(capsys, line, 4)
    assert not said["stable"]
    assert said["reason"].startswith("the sampled velocity loop is unstable without contact; nearest")
    assert not (tmp_path / "out.toml").exists()
    slower = said["nearest"]["crossover"]
    assert document(capsys, f"force --k-e1 1e-5 --hand 1e5 --crossover {slower} --phase-margin 60")["stable"]


def test_a_velocity_loop_alone_is_called_that():
    design = design_velocity_loop(machine("emps2018"), crossover=100.0)
    (loop,) = nested_loops(design.axis_that_runs)
    assert loop.name == "velocity loop"
    assert loop.margins.phase_margin_deg == pytest.approx(design.sampled.margins.phase_margin_deg, abs=1e-6)
    late = nested_loops(design.axis_that_runs, delay=1e-3)[0].margins
    assert late.delay_margin == pytest.approx(loop.margins.delay_margin - 1e-3, abs=1e-7)


def test_margins_without_those_of_a_delay_are_otherwise_the_same():
    for whole, quick in zip(nested_loops(SCREW), nested_loops(SCREW, delay_margins=False), strict=True):
        assert whole.margins.phase_margin_deg == quick.margins.phase_margin_deg
        assert whole.margins.gain_margin == quick.margins.gain_margin
    assert quick.margins.delay_margin is None
    cases = cases_of(SCREW, span=LoadRange(inertia=(1.0, 2.0)))
    assert [len(case.loops) for case in cases] == [3] * 9


# A small positioner that friction damps in one direction alone, and one that it hardly damps in either.
ONE_WAY = Axis.from_dict(
    {
        "name": "positioner",
        "mechanics": {"mass": 10.0, "viscous": 25.0, "coulomb": 1.0},
        "drive": {"force_gain": 10.0},
        "sampling": {"period": 1e-3, "computation_delay": 3},
        "controller": {"kind": "p", "kp": 25.0},
        "effects": [{"kind": "asymmetric_viscous_friction", "viscous_difference": 24.9}],
    }
)
SLIPPERY = ONE_WAY.replace(mechanics={"viscous": 0.5}, effects=[])


@pytest.mark.parametrize(("axis", "where"), [(ONE_WAY, {"velocity": -0.1}), (SLIPPERY, {})])
def test_no_command_calls_a_loop_safe_that_is_unstable_in_a_direction(axis, where):
    """A run that ends before the loop has swung up is no proof; nor is the other direction."""
    assert controller_margins(axis).worst.where == where
    followed = follow(axis, 0.1 * np.clip(1e-3 * np.arange(2000), 0.0, 1.0)).to_dict()
    assert followed["worst_loop"].get("where", {}) == where
    assert followed["reason"].startswith("the whole loop")
    assert advise("simulate", followed).level == "do-not-run"
    with pytest.raises(UnstableError, match="the whole loop .*is unstable without feed-forward"):
        compensate(axis)
    with pytest.raises(UnstableError, match="the whole loop .*is unstable; no code was exported"):
        export_controller(axis, "c")


def test_an_unstable_worst_loop_is_not_safe_though_nothing_else_says_so():
    worst = NestedLoop("whole loop", "plant input", Margins(stable=False)).to_dict()
    advice = advise("margins", {"axis": "servo", "worst_loop": worst, "warnings": []})
    assert (advice.level, advice.text) == ("caution", "the whole loop is unstable")


# A slow drive in per cent with a lag of 40 ms, whose friction is less steep the other way.
UNEVEN = Axis.from_dict(
    {
        "name": "uneven",
        "mechanics": {"mass": 266.0, "viscous": 1160.0, "coulomb": 5.0},
        "drive": {"command": "torque", "command_unit": "%", "force_gain": 110.0, "current_time_constant": 0.04},
        "sampling": {"period": 1e-2, "computation_delay": 1},
        "controller": {"kind": "cascade", "position": {"kp": 1.35}, "velocity": {"kp": 100.0, "ti": 0.237}},
        "effects": [{"kind": "asymmetric_viscous_friction", "viscous_difference": 400.0}],
    }
)


def largest_pole(mass, viscous, gain):
    """Of the loop of UNEVEN, from its difference equations and the exact motion of mass and lag over a period."""
    T, lag, kp, ti, position = 1e-2, 0.04, 100.0, 0.237, 1.35
    motion = np.array([[0.0, 1.0, 0.0], [0.0, -viscous / mass, 1.0 / mass], [0.0, 0.0, -1.0 / lag]])
    values, vectors = np.linalg.eig(motion)
    grown = np.where(values == 0.0, T, np.expm1(values * T) / np.where(values == 0.0, 1.0, values))
    moved = (vectors * np.exp(values * T)) @ np.linalg.inv(vectors)
    driven = (vectors * grown) @ np.linalg.inv(vectors) @ np.array([0.0, 0.0, gain / lag])
    step = np.zeros((6, 6))  # of q, v, force, q[k-1], the integral and the command of the sample before
    step[:3, :3], step[:3, 5], step[3, 0] = moved, driven, 1.0
    error = np.array([-position - 1.0 / T, 0.0, 0.0, 1.0 / T, 0.0, 0.0])
    integral = kp * T / ti * error + np.eye(6)[4]
    step[4], step[5] = integral, kp * error + integral
    return float(np.abs(np.linalg.eigvals(step)).max())


def test_wrong_parameters_and_loads_are_judged_in_both_directions():
    """The corner that is unstable is so at -0.1 m/s alone; the forward corners and the axis itself are stable."""
    off, forward, backward = 0.1, 1160.0 + 400.0, 1160.0 - 400.0
    corners = [(m, v, g) for m in (1 - off, 1 + off) for v in (1 - off, 1 + off) for g in (1 - off, 1 + off)]
    assert max(largest_pole(266.0, viscous, 110.0) for viscous in (forward, backward)) < 1.0
    ahead = [largest_pole(266.0 * m, 1160.0 * v + 400.0, 110.0 * g) for m, v, g in corners]
    back = [largest_pole(266.0 * m, 1160.0 * v - 400.0, 110.0 * g) for m, v, g in corners]
    assert max(ahead) < 1.0 < max(back)
    found = controller_margins(UNEVEN, mismatch=off)
    assert controller_margins(UNEVEN).stable
    assert (found.stable, found.worst.where["velocity"]) == (False, -0.1)
    loops = [case.judged for case in cases_of(UNEVEN, errors=dict.fromkeys(("mass", "viscous", "force_gain"), off))]
    assert sum(not all(loop.margins.stable for loop in case) for case in loops) == sum(pole > 1.0 for pole in back)
    heavier = cases_of(UNEVEN, span=LoadRange(inertia=(1.0, 2.0)))
    assert [dict(case.where) for case in heavier][-1] == {"inertia": 2.0, "velocity": -0.1}


def test_the_page_counts_the_corners_of_all_loops():
    """Two per cent off, the velocity loop is stable at every corner, the cascade around it is not."""
    steep = UNEVEN.replace(controller={"velocity": {"kp": 110.0, "ti": 0.237}})
    design = VelocityLoopDesign(steep, 110.0, 0.237, {}, structure=PI)
    corners = relative_mismatch(0.02)
    assert margins_under_mismatch(design, corners)["stable_share"] == 1.0
    assert DesignVerdict(design).stable
    share = DesignVerdict(design, errors=corners).stable_share
    assert 0.0 < share < 1.0
    lines = [block.text for block in gains_section(design, DesignVerdict(design)).blocks if isinstance(block, Line)]
    assert [line for line in lines if line.startswith(f"stable at {100 * share:.4g} % of the corners; worst: position")]
