"""Every command with --json prints one JSON document and nothing else on standard output, with the contract's keys."""

import functools
import io
import json
import math
import multiprocessing
import shutil
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stdout

import pytest

from emps_design.cli import app
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a short synthetic record and the axis it came from."""
    folder = tmp_path_factory.mktemp("cli")
    axis = machine("emps2019")
    synthetic_record(axis, laps=1, stroke=0.1).save(folder / "record.npz")
    (folder / "axis.toml").write_text(axis.to_toml())
    return folder


# command line, keys that the document must have ("a.b": b inside a)
DOCUMENTS = {
    "gains": (
        "gains --crossover 100 --phase-margin 60",
        "k_v1 t_v K_v omega_0v z_v crossover phase_margin_deg bandwidth plant_input.phase_margin_deg "
        "plant_input.crossover plant_input.delay_margin sampled.stable sampled.phase_margin_deg sampled.crossover "
        "sampled.delay_margin sampled.gain_margin feasible_phase_margin_deg warnings",
    ),
    "gains-bandwidth": ("gains emps2019 --bandwidth 160 --phase-margin 60", "k_v1 t_v bandwidth"),
    "force": ("force --k-e1 0.005", "k_e1 k_c stable k_e1_max.continuous k_e1_max.sampled poles warnings"),
    "impedance": (
        "impedance --mass 50 --damping 300 --mismatch 0.02 --plants 5",
        "derived.apparent_mass derived.apparent_damping derived.coulomb_left printed.apparent_mass "
        "printed.apparent_damping printed.coulomb_left sampled.stable sampled.poles mismatch.creep_speed "
        "mismatch.dead_band mismatch.worst.parameters mismatch.worst.verdict mismatch.stable_share "
        "equivalent_loop.k_e1 equivalent_loop.criterion",
    ),
    "replay": (
        "simulate {axis} --scenario replay --record {record}",
        "relative_error_percent.position relative_error_percent.velocity relative_error_percent.acceleration "
        "relative_error_percent.force",
    ),
    "comanipulation": (
        "simulate --scenario comanipulation --plants 5",
        "verdict transparency.apparent_mass transparency.apparent_damping transparency.r2 transparency.error "
        "seed plants",
    ),
    "identify": (
        "identify {record} --axis {axis}",
        "parameters.mass.value parameters.mass.std parameters.mass.relative_std_percent parameters.mass.unit "
        "parameters.viscous.value parameters.coulomb.value parameters.constant_force.value rms_error "
        "relative_error_percent condition_number",
    ),
    "identify-asymmetric": (
        "identify {record} --model asymmetric",
        "parameters.viscous_positive.value parameters.viscous_negative.value parameters.coulomb_positive.value "
        "parameters.coulomb_negative.value",
    ),
    "observe": (
        "observe {record} --axis {axis}",
        "offline.rms_error offline.delay offline.smallest_observable_force.value "
        "offline.smallest_observable_force.bound online.rms_error online.delay "
        "online.smallest_observable_force.value online.smallest_observable_force.bound",
    ),
    "compensate": (
        "compensate {axis} --stroke 0.05 --out {out}",
        "tracking_rms.without tracking_rms.baseline tracking_rms.with tracking_rms.worst terms",
    ),
    "export": ("export {axis} --to c --out {out}", "files vectors"),
    "export-st": ("export {axis} --to st --out {out}", "files vectors"),
    "export-json": ("export {axis} --to json --out {out}", "files vectors"),
    "derive": ("derive", ""),
    "report": ("report {axis} --record {record} --crossover 100 --out {out}.html", "warnings"),
    "demo": ("demo --out {out}.html", "machine record out force_loop.k_e1 force_loop.k_e1_max.sampled"),
    "init": ("init {out}", "directory files"),
    "import": (
        "import {record} --axis {axis} --out {out}.npz",
        "columns sampling.period sampling.resampled encoder_step.seen encoder_step.axis record_table warnings out",
    ),
}


LINES = {name: line for name, (line, _) in DOCUMENTS.items()}
LINES["diagnose"] = "diagnose {record} --axis {axis} --out {out}"


def outcome(folder, name):
    """Exit status of the command called ``name``, what it prints, and what it writes."""
    place = folder / "written" / name
    place.mkdir(parents=True)
    line = LINES[name].format(record=folder / "record.npz", axis=folder / "axis.toml", out=place / "out")
    with redirect_stdout(io.StringIO()) as said:
        status = app.run([*line.split(), "--json"])
    files = {path.relative_to(place).as_posix(): path.read_bytes() for path in place.rglob("*") if path.is_file()}
    shutil.rmtree(place)
    return status, said.getvalue(), files


@pytest.fixture(scope="module")
def first(folder):
    """The outcome of a command the first time in this process, by its name."""
    return functools.cache(functools.partial(outcome, folder))


def refuse_constant(name):
    raise AssertionError(f"{name} in JSON")


def at(document, path):
    for key in path.split("."):
        assert key in document, f"{path}: {key} is not there"
        document = document[key]
    return document


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow("a whole report")] * (name == "demo")) for name in DOCUMENTS],
)
def test_one_document_with_the_contract_keys(name, first):
    status, text, _ = first(name)
    assert status == 0
    document = json.loads(text, parse_constant=refuse_constant)
    for path in DOCUMENTS[name][1].split():
        at(document, path)


def test_diagnose_writes_what_the_contract_lists(first, tmp_path):
    status, text, files = first("diagnose")
    assert status == 0
    document = json.loads(text, parse_constant=refuse_constant)
    for path in "verdict findings gap.unit gap.floor gap.train.baseline gap.train.extended model_file".split():  # noqa: SIM905
        at(document, path)
    assert document["schema"] == "emps-design/diagnosis/1"
    assert document["verdict"] in ("named", "nothing-missing", "unnamed", "ambiguous", "parameters-only")
    assert json.loads(files["out/diagnosis.json"]) == document
    header = files["out/holdout_prediction.csv"].decode().splitlines()[0]
    assert header == "t,force_measured,force_baseline,force_extended"
    assert files.keys() >= {"out/model.toml", "out/report.html"}
    (tmp_path / "model.toml").write_bytes(files["out/model.toml"])
    assert app.run(["gains", str(tmp_path / "model.toml"), "--crossover", "50", "--json"]) == 0


@pytest.mark.parametrize("name", ["gains", "identify", "observe", "replay", "comanipulation", "impedance"])
def test_same_input_same_seed_same_bytes(name, folder, first):
    assert outcome(folder, name) == first(name)


LONG = ("impedance", "report", "demo", "diagnose", "derive", "comanipulation")
SHORT = [name for name in LINES if name not in LONG]


def elsewhere(folder, names):
    """Outcomes of ``names`` in a process with an order of sets of its own, in another order of commands."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONHASHSEED", "2")
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
            return {name: process.submit(outcome, folder, name).result() for name in reversed(names)}


@pytest.mark.parametrize(
    "names",
    [pytest.param(tuple(SHORT), id="short"), pytest.param(LONG, id="long", marks=pytest.mark.study("long commands"))],
)
def test_same_bytes_in_another_process(names, folder, first):
    other = elsewhere(folder, names)
    assert [name for name in names if first(name) != other[name]] == []


@pytest.mark.parametrize("name", ["gains", "force", "impedance", "identify", "derive"])
def test_without_json_it_is_read_by_people(name, capsys, folder, tmp_path, no_walls):
    line, _ = DOCUMENTS[name]
    words = line.format(record=folder / "record.npz", axis=folder / "axis.toml", out=tmp_path / "out").split()
    assert app.run(words) == 0
    text = capsys.readouterr().out
    assert len(text.splitlines()) > 3
    with pytest.raises(ValueError, match="Expecting value|Extra data"):
        json.loads(text)


def test_published_design(first):
    document = json.loads(first("gains")[1])
    # Table I, w = 100 rad/s, phi = 60 deg; FACTS: k_v1 = 556.766 V/(m/s), t_v = 8.45505 ms
    assert math.isclose(document["k_v1"], 556.766, rel_tol=1e-6)
    assert math.isclose(document["t_v"], 8.45505e-3, rel_tol=1e-6)


def test_the_demo_shows_the_force_loop_of_the_paper_against_a_wall(first):
    force = json.loads(first("demo")[1])["force_loop"]
    assert (force["k_e1"], force["operator"]["environment"]) == (0.01, 1e4)
    assert force["stable"]


def test_the_demo_finds_what_it_simulated_with(first):
    document = json.loads(first("demo")[1])
    for name, truth in document["truth"].items():
        low, high = at(document, f"identification.symmetric.parameters.{name}.interval_95")
        assert low < truth < high


def test_gains_that_cannot_be_met_exit_3_with_the_nearest(capsys):
    assert app.run(["gains", "--crossover", "100", "--phase-margin", "90", "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert document["nearest"]
    assert document["reason"]


CASCADE = {"kind": "cascade", "position": {"kp": 120.0, "every": 4}, "velocity": {"kp": 600.0, "ti": 0.05}}


@pytest.mark.slow("a whole report of an unstable loop")
def test_gains_say_what_becomes_of_the_position_loop_around_them(capsys, tmp_path, sketched):
    """It was made for a faster velocity loop: margins where it is stable, and nothing is written where it is not."""
    axis, out = tmp_path / "axis.toml", tmp_path / "out.toml"
    axis.write_text(machine("emps2019").replace(controller=CASCADE).to_toml())
    assert app.run(["gains", str(axis), "--crossover", "100", "--json", "--out", str(out)]) == 0
    fast = json.loads(capsys.readouterr().out)["kept_position_loop"]["loops"]
    assert [loop["name"] for loop in fast] == ["velocity loop", "position loop", "whole loop"]
    assert 0.0 < fast[-1]["phase_margin_deg"] < fast[0]["phase_margin_deg"]
    assert out.exists()
    assert app.run(["gains", str(axis), "--crossover", "5", "--json", "--out", str(tmp_path / "slow.toml")]) == 4
    slow = json.loads(capsys.readouterr().out)
    assert [loop["stable"] for loop in slow["kept_position_loop"]["loops"]] == [True, False, False]
    assert "position loop with kp = 120 is unstable" in slow["reason"]
    assert not (tmp_path / "slow.toml").exists()
    page = ["report", str(axis), "--crossover", "5", "--out", str(tmp_path / "slow.html"), "--json"]
    assert app.run(page) == 4
    document = json.loads(capsys.readouterr().out)
    assert [loop["stable"] for loop in document["controller_loops"]] == [True, True, True]  # as the axis file has them
    assert document["kept_position_loop"] == slow["kept_position_loop"]
    assert document["reason"] == slow["reason"]
    assert "position loop with kp = 120 is unstable" in (tmp_path / "slow.html").read_text()
    made_for_it = ["gains", str(axis), "--crossover", "5", "--position-overshoot", "0", "--json"]
    assert app.run(made_for_it) == 0
    assert "kept_position_loop" not in json.loads(capsys.readouterr().out)


def test_an_unstable_force_loop_exits_4_with_the_nearest(capsys):
    assert app.run(["force", "--k-e1", "1", "--environment", "10000", "--json"]) == 4
    document = json.loads(capsys.readouterr().out)
    assert document["stable"] is False or document["nearest"]
