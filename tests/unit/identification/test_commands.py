"""The commands identify and observe, from the command line to files and exit status."""

import json
from dataclasses import replace

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.identification import identify, identify_several, observe
from emps_design.identification.controller import identify_law
from emps_design.machines import machine
from emps_design.records import Record, read_record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import synthetic_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("identify")
    for seed in range(3):
        synthetic_record(machine("emps2019"), seed=seed, laps=1, stroke=0.1).save(folder / f"day{seed}.npz")
    return folder


@pytest.mark.parametrize("options", [[], ["--estimator", "iv"], ["--estimator", "oe"], ["--filter", "hold"]])
def test_identify_writes_the_axis_it_prints(folder, capsys, options):
    out = folder / "found.toml"
    assert run(["identify", str(folder / "day0.npz"), "--json", "--out", str(out), *options]) == 0
    document = json.loads(capsys.readouterr().out)
    axis = Axis.load(out)
    assert axis.name == "found"
    assert axis.mechanics.mass == pytest.approx(document["parameters"]["mass"]["value"])
    assert axis.mechanics.offset == pytest.approx(document["parameters"]["constant_force"]["value"])


def test_identify_shows_values_and_what_they_are_worth(folder, capsys):
    assert run(["identify", str(folder / "day0.npz"), "--model", "asymmetric"]) == 0
    text = capsys.readouterr().out
    for word in ("viscous_positive", "coulomb_negative", "95 %", "kg", "independent", "Hz"):
        assert word in text


def test_no_share_of_a_force_that_is_nothing(folder, tmp_path, capsys):
    """A motor switched off in the last third: the filter rings on there, and an error in % of that says nothing."""
    day = synthetic_record(machine("emps2019"), laps=1, stroke=0.1)
    off = np.where(np.arange(len(day)) < len(day) // 2, day.u, 0.0)
    path = tmp_path / "off.npz"
    Record.from_arrays(day.period, day.q_ref, day.q, off).save(path)
    assert run(["identify", str(path)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "N rms, where the force is 0" in text
    assert run(["identify", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["held_out"]["relative_error_percent"] is None


def test_identify_several_records(folder, capsys):
    paths = [str(folder / f"day{seed}.npz") for seed in range(3)]
    assert run(["identify", *paths, "--filter", "hold", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert np.shape(document["cross_validation"]) == (3, 3)
    assert document["parameters"]["mass"]["mean"] == pytest.approx(95.1, abs=0.2)
    assert run(["identify", *paths]) == 0
    assert "spread" in capsys.readouterr().out


@pytest.mark.study("ten records")
def test_the_table_of_ten_records_fits_a_terminal(folder, capsys):
    paths = [str(folder / f"day{seed % 3}.npz") for seed in range(10)]
    assert run(["identify", *paths]) == 0
    text = capsys.readouterr().out
    assert "…" not in text
    assert all(f"{number} day" in text for number in range(1, 11))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--estimator", "olse"], "--estimator: found 'olse'"),
        (["--external-force", "maybe"], "--external-force: found 'maybe', expected one of refuse, known"),
        (["--filter", "holt"], "did you mean 'hold'"),
        (["--cutoff", "900"], "Nyquist"),
        (["--estimator", "iv", "--holdout", "other.npz"], "--holdout: requires --estimator ls, found iv"),
        (
            ["--estimator", "oe", "--filter", "paper", "--bootstrap", "200", "--cutoff", "40"],
            "--filter, --bootstrap: requires --estimator ls, found oe",
        ),
        (["--estimator", "iv", "--filter", "hold"], "--filter: requires --estimator ls, found iv"),
        (["--filter", "paper", "--cutoff", "40"], "cut-off: the paper's chain has none"),
        (["--seed", "3"], "--seed: requires --bootstrap"),
        (["day1.npz", "--bootstrap", "9"], "--bootstrap: requires a single record, found 2"),
        (["day1.npz", "--holdout", "day2.npz"], "--holdout: requires a single record, found 2"),
        (["day1.npz", "--estimator", "iv"], "--estimator: iv takes one record, found 2"),
    ],
)
def test_identify_refuses_in_one_line(folder, capsys, options, words):
    options = [str(folder / word) if word.startswith("day") else word for word in options]
    assert run(["identify", str(folder / "day0.npz"), *options]) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_options_are_checked_before_a_record_is_read(capsys):
    assert run(["identify", "nothing.csv", "--seed", "3"]) == 2
    assert "--seed: requires --bootstrap" in capsys.readouterr().err


def test_what_a_record_lacks_is_said_in_the_units_of_its_axis(tmp_path, capsys):
    joint = machine("emps2019").replace(motion="rotary")
    (tmp_path / "joint.toml").write_text(joint.to_toml())
    day = synthetic_record(machine("emps2019"), laps=1, stroke=0.1)
    still = replace(day, q=1e-6 * day.q, q_ref=1e-6 * day.q_ref, sha256="")
    still.save(tmp_path / "still.npz")
    assert run(["identify", str(tmp_path / "still.npz"), "--axis", str(tmp_path / "joint.toml")]) == 2
    assert " rad" in capsys.readouterr().err


def test_instruments_take_one_record(folder, capsys):
    paths = [str(folder / f"day{seed}.npz") for seed in range(2)]
    assert run(["identify", *paths, "--estimator", "iv"]) == 2
    assert "iv takes one record, found 2" in capsys.readouterr().err


def test_observe_writes_a_table_of_forces(folder, capsys):
    out = folder / "forces.csv"
    assert run(["observe", str(folder / "day0.npz"), "--axis", "emps2019", "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["online"]["delay"] > document["offline"]["delay"] == 0.0
    assert document["online"]["smallest_observable_force"]["bound"] == "break_away"
    lines = out.read_text().splitlines()
    assert lines[0] == "t [s],offline [N],online [N],kalman [N]"
    assert len(lines) == 1 + len(np.load(folder / "day0.npz")["t"])
    assert lines[1] == "0,,,"
    assert lines[-1].split(",")[1] == ""
    assert all(cell for cell in lines[len(lines) // 2].split(","))


def test_observe_shows_its_bounds(folder, capsys):
    assert run(["observe", str(folder / "day0.npz")]) == 0
    text = capsys.readouterr().out
    bounds = next(line for line in text.splitlines() if "break-away" in line)
    assert bounds.split() == ["method", "force", "set", "by", "break-away", "noise", "parameter"]
    smallest = [line.split() for line in text.splitlines() if line.split()[:1] == ["kalman"]][-1]
    assert smallest[2] == "break-away"
    assert smallest[1] == smallest[3]


def test_observe_is_told_of_an_injected_voltage(folder, capsys):
    """A voltage added behind the controller is a force the drive does not know of: with it named, it is the truth."""
    plain = synthetic_record(machine("emps2019"), laps=1, stroke=0.1)
    wave = (np.arange(len(plain)) // 500 % 2).astype(np.uint8)
    made = Plant.of(machine("emps2019")).closed_loop(plain.q_ref, voltage_noise=3.0 * wave)
    np.savez(folder / "wave.npz", t=made.t, q_ref=plain.q_ref, q=made.q, u=made.u, wave=wave, gain=35.0)
    path = str(folder / "wave.npz")
    assert run(["observe", path, "--injected", "wave:3.0", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    for method in ("offline", "online", "kalman"):
        assert abs(document[method]["steps"]["plateau_error_percent"]) < 1.0
        assert document[method]["rms_error"] > document[method]["steps"]["rms_error_away_from_edges"]
    assert run(["observe", path, "--injected", "wave:3.0"]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("delay [ms]", "rise [ms]", "edges", "valid from and to"))
    wrongs = (("wafe:3.0", "additional column of wave: wave"), ("gain:1", "expected COLUMN:VOLTS"), ("wave:x", "'x'"))
    for wrong, words in wrongs:
        assert run(["observe", path, "--injected", wrong]) == 2
        err = capsys.readouterr().err
        assert words in err
        assert err.count("\n") == 1


def test_what_was_found_is_shown_even_where_it_is_no_machine(folder, tmp_path, capsys):
    """What helps the motion along makes Coulomb friction come out below zero: a table says so, a file cannot."""
    day = synthetic_record(machine("emps2019"), laps=1, stroke=0.1)
    helped = replace(day, u=day.u - 1.5 * np.sign(np.gradient(day.q_ref)), sha256="")
    helped.save(tmp_path / "helped.npz")
    out = tmp_path / "found.toml"
    assert run(["identify", str(tmp_path / "helped.npz"), "--json", "--out", str(out)]) == 2
    printed = capsys.readouterr()
    assert json.loads(printed.out)["parameters"]["coulomb"]["value"] < 0.0
    assert printed.err.strip().endswith("biases them; next: diagnose")
    assert not out.exists()


@pytest.mark.parametrize("title", ["q", "q [mm]"])
@pytest.mark.parametrize("command", ["identify", "observe"])
def test_what_the_reader_did_as_the_file_says_is_no_reason_for_caution(folder, tmp_path, capsys, command, title):
    """A reference that nobody needs is missing, and a unit is converted: both are said, and the result stands."""
    day = synthetic_record(machine("emps2019"), laps=1, stroke=0.1)
    path, axis = tmp_path / "day.csv", tmp_path / "axis.toml"
    q = day.q * (1e3 if "mm" in title else 1.0)
    np.savetxt(path, np.c_[day.t, q, day.u], delimiter=",", header=f"t,{title},u", comments="", fmt="%.12g")
    axis.write_text(machine("emps2019").replace(controller={"kind": "none"}).to_toml())
    assert run([command, str(path), "--axis", str(axis), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert "q_ref: not recorded; replaced by q" in document["warnings"]
    assert document["advice"]["level"] == "safe", document["advice"]
    if command == "identify":
        assert {entry["reliability"] for entry in document["parameters"].values()} == {None}


def test_python_has_the_document_of_the_command_with_its_advice(folder, capsys):
    records = [read_record(folder / f"day{seed}.npz") for seed in range(2)]
    axis = machine("emps2019")
    results = {
        "identify": [identify(records[0], axis), identify_several(records, axis)],
        "observe": [observe(records[0], axis)],
        "law": [identify_law(records[0])],
    }
    for command, given in results.items():
        for result in given:
            paths = [str(folder / f"{name}.npz") for name in ("day0", "day1")[: len(getattr(result, "records", "1"))]]
            assert run([command, *paths, "--json"]) == 0
            asked = json.loads(capsys.readouterr().out)
            own = result.to_dict()
            assert asked.keys() - {"out"} == own.keys()
            assert {key: own["advice"][key] for key in ("level", "text")} == {
                key: asked["advice"][key] for key in ("level", "text")
            }
