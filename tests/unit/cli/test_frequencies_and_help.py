"""Frequencies with their unit, --debug in every help, tables that fit a terminal of 80 columns."""

import json
import math

import pytest

from emps_design.cli.app import COMMANDS, run
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.quantities import read_frequency
from emps_design.report import Page
from emps_design.simulation.synthetic import synthetic_record


@pytest.mark.parametrize(
    ("text", "in_rad_s", "in_hertz"),
    [
        ("188.5", 188.5, 188.5),  # a bare number is in the option's own unit
        (188.5, 188.5, 188.5),
        ("30Hz", 60 * math.pi, 30.0),
        (" 30 hz ", 60 * math.pi, 30.0),
        ("3e-2kHz", 60 * math.pi, 30.0),
        ("377rad/s", 377.0, 188.5 / math.pi),
        ("377 1/s", 377.0, 188.5 / math.pi),
        ("inf", math.inf, math.inf),
        ("-2Hz", -4 * math.pi, -2.0),
    ],
)
def test_a_frequency_as_someone_writes_it(text, in_rad_s, in_hertz):
    assert read_frequency(text) == pytest.approx(in_rad_s)
    assert read_frequency(text, "Hz") == pytest.approx(in_hertz)


@pytest.mark.parametrize("text", ["", "Hz", "30 Herz", "30 V", "3O", "1e", "30 30", "0x1F", "1_000"])
def test_what_is_no_frequency(text):
    with pytest.raises(InputError, match="expected a number in rad/s, or one such as 30Hz"):
        read_frequency(text)


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ("gains {option} 10Hz", "--crossover"),
        ("gains {option} 10Hz", "--bandwidth"),
        ("force --k-e1 0.005 {option} 10Hz", "--crossover"),
        ("force --k-e1 0.005 {option} 10Hz", "--bandwidth"),
        ("impedance --mass 50 --damping 100 {option} 10Hz", "--filter"),
        ("report --out {out} {option} 10Hz", "--crossover"),
        ("report --out {out} {option} 10Hz", "--bandwidth"),
        pytest.param(
            "report --out {out} --mass 50 --damping 100 {option} 10Hz", "--filter", marks=pytest.mark.study("reports")
        ),
        ("identify {record} {option} 40Hz", "--cutoff"),
        ("observe {record} {option} 10Hz", "--cutoff"),
        ("observe {record} {option} 40Hz", "--offline-cutoff"),
    ],
)
def test_every_option_that_asks_for_a_frequency(line, key, tmp_path, capsys, monkeypatch):
    """With its unit it does what the bare number does; with a unit that is none it says what was expected."""
    # The documents are compared, not the pictures.
    monkeypatch.setattr("emps_design.report.assemble.design_page", lambda results: Page("title", "", (), ()))
    record = tmp_path / "record.npz"
    if "{record}" in line:
        synthetic_record(machine("emps2019"), laps=1, stroke=0.1).save(record)
    plain = {"40Hz": "40", "10Hz": "10"} if "cutoff" in key else {"10Hz": repr(20 * math.pi)}
    words = line.format(option=key, out=tmp_path / "out.html", record=record).split()
    found = []
    for asked in (words, [plain.get(word, word) for word in words]):
        assert run([*asked, "--json", "--force"] if "report" in line else [*asked, "--json"]) in (0, 4)
        document = json.loads(capsys.readouterr().out)
        document.get("advice", {}).pop("next", None)  # repeats the words as they were given
        found.append(document)
    assert found[0] == found[1]
    assert run([*words[:-1], "10Hx"]) == 2
    assert f"{key}: frequency: found '10Hx', expected a number in" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_help_knows_debug_and_fits(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert run([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--debug" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("name", ["gains", "impedance", "simulate", "report"])
def test_help_says_what_its_units_are_on_an_axis_that_turns(name, capsys):
    assert run([name, "--help"]) == 0
    assert "read kg m^2 for kg, N m for N and rad for m" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("line", "linear", "turning"),
    [
        ("gains {axis} --crossover 60 --position-stiffness 1e20", "1e+12 N/m;", "1e+12 N m/rad;"),
        ("force {axis} --crossover 60 --k-e1 0.01 --environment 1e20", "1e+12 N/m;", "1e+12 N m/rad;"),
        ("impedance {axis} --mass 1e20 --damping 1", "1e+07 kg;", "1e+07 kg m^2;"),
        ("simulate {axis} --scenario breakaway --rate 1e20", "1e+09 N/s;", "1e+15 N m/s;"),
        ("report {axis} --mass 1e20 --damping 1 --out {out}", "1e+07 kg;", "1e+07 kg m^2;"),
    ],
)
def test_a_number_that_no_machine_has_is_refused_in_the_units_of_the_axis(line, linear, turning, tmp_path, capsys):
    joint = tmp_path / "joint.toml"
    joint.write_text(machine("emps2019").replace(motion="rotary").to_toml())
    for axis, limit in (("emps2019", linear), (joint, turning)):
        assert run(line.format(axis=axis, out=tmp_path / "page.html").split()) == 2
        error = " ".join(capsys.readouterr().err.split())
        assert error.startswith("emps-design: --")
        assert f"expected a magnitude of at most {limit}" in error
    assert not (tmp_path / "page.html").exists()


def test_a_number_is_refused_without_an_axis_too(tmp_path, capsys):
    for line in (
        f"report --mass 1e20 --damping 1 --out {tmp_path / 'page.html'}",
        "simulate --scenario bench --tau-ref 1e20",
    ):
        assert run(line.split()) == 2
        assert "expected a magnitude of at most" in " ".join(capsys.readouterr().err.split())
    assert run(["gains", "emps2019", "--crossover", "60", "--json"]) == 0  # nothing is left over of the one before


@pytest.mark.parametrize(
    "line",
    [
        "gains --crossover 100 --mismatch 0.02",
        "gains --crossover 100 --phase-margin 80 --computation-delay 1",
        "force --k-e1 0.005 --environment 1000",
        "impedance --mass 50 --damping 100",
        pytest.param(
            "impedance --mass 50 --damping 100 --mismatch 0.02 --plants 4", marks=pytest.mark.study("a mismatch")
        ),
        "simulate --scenario breakaway --rate 20",
        "simulate --record {record}",
        "simulate --scenario comanipulation --plants 4",
        "identify {record} --model asymmetric --estimator iv",
        "observe {record}",
    ],
)
def test_tables_fit_80_columns(line, tmp_path, capsys, monkeypatch):
    """Laid out with all the room there is, no table is wider than 80 columns, so none is squeezed at 80."""
    monkeypatch.setenv("COLUMNS", "200")
    record = tmp_path / "record.npz"
    synthetic_record(machine("emps2019"), laps=1, stroke=0.1).save(record)
    run(line.format(record=record).split())
    rows = [row for row in capsys.readouterr().out.splitlines() if set(row) & set("│┃─━")]
    assert rows
    assert max(map(len, rows)) <= 80


def test_a_scenario_prints_each_quantity_in_a_unit_of_the_axis(tmp_path, capsys):
    """The rows of `simulate` say what their numbers are in: N on an axis that slides, N m on one that turns."""
    turning = tmp_path / "turning.toml"
    turning.write_text(machine("emps2019").replace(motion="rotary").to_toml())
    for axis, unit in (("emps2019", "N"), (str(turning), "N m")):
        assert run(["simulate", axis, "--scenario", "breakaway", "--rate", "20"]) == 0
        rows = capsys.readouterr().out.splitlines()
        (static,) = (row for row in rows if "static friction" in row)
        assert static.rstrip().endswith(f" {unit}")
