"""Every command that judges ends with an advice whose level agrees with the exit status and with the warnings."""

import json
import math
import re
import shlex

import pytest

from emps_design.advice import LEVELS
from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.messages import Message
from emps_design.simulation.synthetic import synthetic_record

LINEAR = {
    "name": "linear",
    "mechanics": {"mass": 20.0, "viscous": 60.0, "coulomb": 4.0},
    "drive": {"force_gain": 12.0, "voltage_limit": 10.0, "current_time_constant": 0.3e-3},
    "sampling": {"period": 1e-3, "encoder_resolution": 1e-7},
    "controller": {"kind": "position_pd", "kp": 40.0, "kv": 120.0},
}
JOINT = {
    "name": "joint",
    "motion": "rotary",
    "mechanics": {"mass": 0.8, "viscous": 6.0, "coulomb": 3.0, "offset": 0.2},
    "drive": {"command": "current", "force_gain": 8.0, "command_limit": 12.0, "current_time_constant": 0.5e-3},
    "sampling": {"period": 1e-3, "encoder_resolution": 3e-6},
    "controller": {"kind": "cascade", "position": {"kp": 12.0}, "velocity": {"kp": 6.0, "ti": 0.08}},
}
GANTRY = {
    "name": "gantry",
    "mechanics": {"mass": 62.0, "viscous": 310.0, "coulomb": 48.0},
    "drive": {"command": "torque", "command_unit": "%", "force_gain": 15.0, "command_limit": 145.0},
    "sampling": {"period": 2e-3, "encoder_resolution": 1e-8, "computation_delay": 1},
    "controller": {"kind": "ip_velocity", "k_v1": 150.0, "t_v": 0.06},
}
SERVO = {
    "name": "servo",
    "motion": "rotary",
    "mechanics": {"mass": 0.012, "viscous": 0.05, "coulomb": 0.02},
    "drive": {"command": "duty", "force_gain": 0.02, "supply": 24.0, "command_limit": 1.0},
    "sampling": {"period": 5e-3, "encoder_resolution": 1e-4},
    "controller": {"kind": "p", "kp": 0.8},
}
AXES = {one["name"]: one for one in (LINEAR, JOINT, GANTRY, SERVO)}
CROSSOVER = {"linear": 60.0, "joint": 40.0, "gantry": 20.0, "servo": 10.0}  # rad/s, slow for the axis

DESIGNS = ("gains", "margins", "force", "impedance", "compensate", "simulate", "report")
ALARM = re.compile(r"unstable|creep|limit cycle|unexplained", re.IGNORECASE)


@pytest.fixture(autouse=True)
def _only_messages(monkeypatch):
    """Advice meets no plain text, whose severity is unknown: every command hands it messages."""

    def severity(text):
        assert isinstance(text, Message), text
        return text.severity

    monkeypatch.setattr("emps_design.advice.severity_of", severity)


@pytest.fixture(scope="module", params=AXES)
def axis(request, tmp_path_factory):
    """The name of an axis, and a folder with its file."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "axis.toml").write_text(Axis.from_dict(AXES[request.param]).to_toml())
    return request.param, folder


def asked(line, capsys):
    """Exit status and JSON document of a command."""
    status = app.run([*shlex.split(line), "--json"])
    printed = capsys.readouterr()
    assert status in (0, 3, 4), printed.err
    return status, json.loads(printed.out)


def agrees(command, status, document):
    """Check the advice of a ``document`` against the exit ``status``, the worst loop and the warnings; return it."""
    advice = document["advice"]
    assert advice.keys() == {"level", "text", "next"}
    assert advice["level"] in LEVELS
    assert advice["text"]
    assert "\n" not in advice["text"]
    assert advice["next"] is None or advice["next"].startswith("emps-design ")
    if command in DESIGNS:
        assert (advice["level"] == "do-not-run") == (status == 4)
    else:
        assert advice["level"] != "do-not-run"
    assert status != 3 or advice["level"] == "caution"
    if advice["level"] == "safe":
        assert not [warning for warning in document["warnings"] if ALARM.search(warning)]
        worst = document.get("worst_loop")
        if worst is not None:
            assert worst["stable"]
            assert worst["phase_margin_deg"] is None or worst["phase_margin_deg"] >= 30.0
            assert worst["gain_margin"] is None or worst["gain_margin"] >= 2.0
    return advice


CASES = {
    "gains safe": ("gains {axis} --crossover {slow} --phase-margin 65", "safe"),
    "gains caution": ("gains {axis} --crossover {slow} --phase-margin 25", "caution"),
    "gains refused": ("gains {axis} --crossover {slow} --phase-margin 179", "caution"),
    "gains unstable": ("gains {axis} --crossover {fast} --phase-margin 25", "do-not-run"),
    "force safe": ("force {axis} --k-e1 1e-4 --crossover {slow}", "safe"),
    "force unstable": ("force {axis} --k-e1 1e3 --environment 1e5 --crossover {slow}", "do-not-run"),
}


@pytest.mark.parametrize("case", CASES)
def test_level_and_exit_status_of_a_design_agree(axis, case, capsys):
    name, folder = axis
    line, level = CASES[case]
    words = line.format(axis=folder / "axis.toml", slow=CROSSOVER[name], fast=60.0 * CROSSOVER[name])
    status, document = asked(words, capsys)
    advice = agrees(words.split()[0], status, document)
    assert advice["level"] == level
    if level == "do-not-run" or status == 3:  # what is proposed works
        assert advice["next"] is not None
        again, other = asked(advice["next"].removeprefix("emps-design "), capsys)
        assert again == 0
        agrees(words.split()[0], again, other)


GAINS = {  # of the axis's own controller: times as high, and the level that has
    "linear": {"kp": ((1.0, "safe"), (6.0, "caution"), (60.0, "do-not-run"))},
    "joint": {"position": ((1.0, "safe"), (60.0, "caution"), (400.0, "do-not-run"))},
    "gantry": {"k_v1": ((1.0, "safe"), (6.0, "caution"), (30.0, "do-not-run"))},
    "servo": {"kp": ((1.0, "safe"), (12.0, "caution"), (200.0, "do-not-run"))},
}


def test_margins_of_the_controller_in_the_file(axis, capsys):
    name, folder = axis
    ((key, tried),) = GAINS[name].items()
    for factor, level in tried:
        own = dict(AXES[name]["controller"])
        own[key] = {"kp": factor * own[key]["kp"]} if key == "position" else factor * own[key]
        path = folder / f"gain{factor:g}.toml"
        path.write_text(Axis.from_dict({**AXES[name], "controller": own}).to_toml())
        status, document = asked(f"margins {path}", capsys)
        assert agrees("margins", status, document)["level"] == level
        assert app.run(["margins", str(path)]) == status
        last = capsys.readouterr().out.splitlines()[-1]
        assert last.startswith(f"{level}: ")


def test_a_range_makes_a_safe_controller_one_to_take_care_of(axis, capsys):
    name, folder = axis
    status, document = asked(f"margins {folder}/axis.toml --inertia-range 1:40 --mismatch 0.1", capsys)
    advice = agrees("margins", status, document)
    assert len(document["range"]) == 8 + 8
    if name != "servo":
        assert advice["level"] != "safe"


@pytest.mark.usefixtures("few_estimates")
@pytest.mark.parametrize("damping", [30.0, 0.0])
def test_impedance_and_its_simulation(axis, damping, capsys):
    name, folder = axis
    if not damping and name != "servo":
        pytest.skip("the nearest that works takes long to find")
    own = AXES[name]["mechanics"]
    law = f"--mass {0.8 * own['mass']} --damping {damping * own['viscous'] / 20.0} --mismatch 0.02 --plants 0"
    status, document = asked(f"impedance {folder}/axis.toml {law}", capsys)
    advice = agrees("impedance", status, document)
    assert damping or advice["level"] != "safe"
    status, document = asked(f"simulate {folder}/axis.toml --scenario comanipulation {law}", capsys)
    assert damping or agrees("simulate", status, document)["level"] != "safe"


def test_an_impedance_law_that_does_not_creep_is_safe(capsys):
    law = "impedance --mass 80 --damping 300 --coulomb-factor 0.97 --mismatch 0.02 --plants 0"
    status, document = asked(law, capsys)
    assert agrees("impedance", status, document)["level"] == "safe"


RUNS = ("compensate {axis} --stroke {stroke} --speed {speed}", "simulate {axis} --reference {reference}")


@pytest.mark.parametrize("line", RUNS, ids=lambda line: line.split()[0])
def test_runs_of_the_nonlinear_machine(axis, line, capsys):
    name, folder = axis
    reference = folder / "reference.csv"
    period = AXES[name]["sampling"]["period"]
    rows = (f"{k * period!r},{0.02 * (1.0 - math.cos(3.0 * k * period))!r}" for k in range(400))
    reference.write_text("t,q_ref\n" + "\n".join(rows) + "\n")
    words = line.format(axis=folder / "axis.toml", reference=reference, stroke=0.05, speed=0.1)
    status, document = asked(words, capsys)
    advice = agrees(words.split()[0], status, document)
    assert advice["level"] in ("safe", "caution")


@pytest.fixture(scope="module")
def record(axis):
    """A short record of the linear axis with its own controller, where nothing is wrong."""
    name, folder = axis
    if name != "linear":
        pytest.skip("one record is enough")
    synthetic_record(Axis.from_dict(LINEAR), laps=2, stroke=0.1).save(folder / "record.npz")
    return folder


@pytest.mark.parametrize("line", [
    "identify {record} --axis {axis}",
    "observe {record} --axis {axis}",
    "frf {record} --axis {axis}",
    "simulate {axis} --scenario replay --record {record}",
])  # fmt: skip
def test_what_is_said_about_a_record(record, line, capsys):
    words = line.format(record=record / "record.npz", axis=record / "axis.toml")
    status, document = asked(words, capsys)
    assert status == 0
    advice = agrees(words.split()[0], status, document)
    level = "caution" if line.startswith("frf") else "safe"  # laps with rests are no excitation
    assert advice["level"] == level
    assert app.run(shlex.split(words)) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"{level}: ")


def test_a_replay_of_another_machine_names_diagnose(record, capsys):
    heavier = record / "heavier.toml"
    heavier.write_text(Axis.from_dict(LINEAR).replace(mechanics={"mass": 28.0}).to_toml())
    status, document = asked(f"simulate {heavier} --scenario replay --record {record}/record.npz", capsys)
    advice = agrees("simulate", status, document)
    assert advice["level"] == "caution"
    assert advice["next"].startswith("emps-design diagnose ")


def test_units_are_those_of_the_axis(axis, capsys):
    name, folder = axis
    app.run(["force", str(folder / "axis.toml"), "--k-e1", "1e3", "--environment", "1e5", "--crossover", "20"])
    last = capsys.readouterr().out.splitlines()[-1]
    assert ("(rad/s)/(N m)" in last) == (AXES[name].get("motion") == "rotary")
