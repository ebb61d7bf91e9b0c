"""Every command on every effect, small, typical and large, and on pairs: it runs, or refuses in one line."""

import importlib
import itertools
import json
import math

import pytest

from emps_design.cli import app
from emps_design.effects import EFFECTS
from emps_design.machines import machine
from emps_design.report import Page
from emps_design.simulation.synthetic import synthetic_record

# Commands that take an axis: `design` is the machine of the paper, `record` that of the data set, each extended.
DESIGN = {
    "gains": "gains {design} --crossover 100 --mismatch 0.02",
    "gains-slow": "gains {design} --crossover 40",
    "gains-fast": "gains {design} --crossover 150",
    "retune": "gains {design} --crossover 40 --retune",
    "retune-bandwidth": "gains {design} --bandwidth 60 --retune",
    "force": "force {design} --k-e1 0.005 --environment 1000",
}
SIMULATED = {
    "breakaway": "simulate {identified} --scenario breakaway --rate 20",
    "replay": "simulate {identified} --scenario replay --record {record}",
    "identify": "identify {record} --axis {identified}",
    "observe": "observe {record} --axis {identified}",
}
LAW = {"impedance": "impedance {design} --mass 50 --damping 100"}
LONG = {
    "comanipulation": "simulate {design} --scenario comanipulation --plants 2",
    "diagnose": "diagnose {record} --axis {identified}",
}
REPORT = {"report": "report {design} --k-e1 0.005 --out {out}"}
SIZES = {"small": 1e-3, "typical": 1.0, "large": 100.0}
STUDY = pytest.mark.study("all commands on all effects, small and large")
ONE_EACH = [effect.name for effect in EFFECTS]
# Pairs that meet in one place of the plant: two of the actuator, two over position, play and spring, sensor and drive.
PAIRS = [
    ("actuator_deadzone", "actuator_saturation"),
    ("position_ripple", "position_dependent_friction"),
    ("backlash", "flexible_coupling"),
    ("encoder_error", "actuator_delay"),
    ("elastic_force", "end_stop"),
    ("presliding_friction", "load_dependent_friction"),
    ("mass_change", "actuator_lag"),
    ("presliding_friction", "maxwell_slip_friction"),
    ("force_map", "friction_map"),
]


def parameters(name, size):
    """Typical numbers of an effect, its amounts a thousandth or a hundredfold, its shapes at their bounds."""
    effect = next(effect for effect in EFFECTS if effect.name == name)
    found = dict(effect.checks[0][0])
    for p in effect.parameters:
        if p.discrete or size == "typical":
            continue
        bound = p.lower if size == "small" else p.upper
        shape = p.starts and not p.linear and math.isfinite(bound)
        found[p.name] = float(min(max(bound if shape else found[p.name] * SIZES[size], p.lower), p.upper))
    return {"kind": name, **found}


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    path = tmp_path_factory.mktemp("every") / "record.npz"
    synthetic_record(machine("emps2019"), laps=1, stroke=0.03, speed=0.15).save(path)
    return path


def check(lines, effects, record, folder, capsys):
    """Run every line on the machines with ``effects``: documented exit status, one document where there is one."""
    paths = {"design": folder / "design.toml", "identified": folder / "identified.toml"}
    for key, name in (("design", "emps2018"), ("identified", "emps2019")):
        kinds = {one["kind"] for one in effects}
        motion = next((one.motion for one in EFFECTS if one.motion and one.name in kinds), "linear")
        paths[key].write_text(machine(name).replace(motion=motion, effects=effects).to_toml())
    for name, line in lines.items():
        out = folder / f"{name}.html"
        status = app.run([*line.format(record=record, out=out, **paths).split(), "--json"])
        text, error = capsys.readouterr()
        assert status in (0, 2, 3, 4), f"{name}: exit status {status}\n{error}"
        assert "Traceback" not in error
        assert "Warning" not in error, f"{name}: {error}"
        if status == 2:  # refused in one line; a design command says which effect
            assert error.strip().splitlines()[-1].startswith("emps-design: "), error
            assert name not in DESIGN or any(effect["kind"] in error for effect in effects), f"{name}: {error}"
            continue
        document = json.loads(text)
        if status:
            assert document["reason"], name


@pytest.mark.parametrize("name", ONE_EACH)
def test_design_commands_run(name, record, tmp_path, capsys):
    """Two of them on each effect; the study has all."""
    turn = ("gains", "retune", "force")[ONE_EACH.index(name) % 3]
    lines = {key: DESIGN[key] for key in ("gains-slow", turn)}
    check(lines, [parameters(name, "typical")], record, tmp_path, capsys)


@STUDY
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ONE_EACH)
def test_every_design_command_runs(name, size, record, tmp_path, capsys):
    check(DESIGN, [parameters(name, size)], record, tmp_path, capsys)


@pytest.mark.study("two commands on pairs of effects of nine sizes")
@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_every_design_command_runs_on_pairs(pair, record, tmp_path, capsys):
    for sizes in itertools.product(SIZES, repeat=2):
        effects = [parameters(name, size) for name, size in zip(pair, sizes, strict=True)]
        check({"gains": DESIGN["gains"], "force": DESIGN["force"]}, effects, record, tmp_path, capsys)


@pytest.mark.parametrize("name", ONE_EACH)
def test_every_simulating_command_runs(name, record, tmp_path, capsys):
    """Each effect is replayed; the study has all the commands."""
    turn = ("breakaway", "observe")[ONE_EACH.index(name) % 2]
    lines = {key: SIMULATED[key] for key in ("replay", turn)}
    check(lines, [parameters(name, "typical")], record, tmp_path, capsys)


@STUDY
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ONE_EACH)
def test_every_long_command_runs(name, size, record, tmp_path, capsys, monkeypatch):
    # Pictures take longest, and there an effect is a number like any other: one is drawn.
    if (name, size) != ("elastic_force", "typical"):
        monkeypatch.setattr("emps_design.report.assemble.design_page", lambda results: Page("title", "", (), ()))
    # A diagnosis leaves the axis's own effects out: of all effects and sizes it would be the same search of one
    # record each time.
    alone = {effect.name: effect for effect in EFFECTS if effect.name == name}
    monkeypatch.setattr(importlib.import_module("emps_design.discrepancy.diagnosis"), "known_effects", lambda: alone)
    lines = SIMULATED | LAW | LONG | REPORT
    if size != "typical":
        del lines["diagnose"]
    check(lines, [parameters(name, size)], record, tmp_path, capsys)


@pytest.mark.study("all commands on pairs of effects")
@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_every_simulating_command_runs_on_pairs(pair, record, tmp_path, capsys):
    check(SIMULATED | LAW | LONG, [parameters(name, "typical") for name in pair], record, tmp_path, capsys)
