"""An axis file from a trace alone: what it tells stands there, what it does not tell waits, and both are valid TOML."""

import json
import tomllib

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.errors import AxisError
from emps_design.importing import import_record
from emps_design.importing.account import axis_text, read_trace
from tests.unit.records.exports import ENCODER, Q_REF, N, Q, T, U, german, rows, scope

FILLED = ("mass", "viscous", "coulomb", "force_gain", "command_limit")


@pytest.mark.parametrize(
    ("text", "motion", "command", "unit"),
    [
        (german(), "linear", "torque", "%"),
        (scope(), "linear", "torque", "%"),
        (
            german(header="Zeit [ms];Lageistwert [°];Lagesollwert [°];Stromsollwert [A];Status"),
            "rotary",
            "current",
            "A",
        ),
        ("\n".join(["t;q;q_ref;u", *rows(T, Q, Q_REF, U)]), "linear", "voltage", "V"),
    ],
)
def test_an_axis_file_of_a_trace_reads_that_trace(tmp_path, text, motion, command, unit):
    (tmp_path / "trace.csv").write_text(text, encoding="utf-8")
    trace = read_trace(tmp_path / "trace.csv")
    written = axis_text(trace)
    with pytest.raises(AxisError, match="missing, expected a number"):
        Axis.from_toml(written)
    for key in FILLED:
        written = written.replace(f"# {key} = ", f"{key} = ")
    axis = Axis.from_toml(written)
    assert (axis.motion, axis.drive.command, axis.drive.command_unit) == (motion, command, unit)
    assert axis.sampling.period == 1e-3
    record = import_record(tmp_path / "trace.csv", axis.replace(drive={"command_limit": 100.0}))
    assert len(record) == N
    assert not any("taken from column" in note for note in record.warnings)
    if motion == "linear":
        assert axis.sampling.encoder_resolution == pytest.approx(ENCODER, rel=1e-3)


def test_a_limit_is_seen_where_the_drive_stops_at_it(tmp_path):
    (tmp_path / "trace.csv").write_text(german(u=np.clip(U, -30, 30)), encoding="utf-8")
    assert read_trace(tmp_path / "trace.csv").limit == pytest.approx(30.0)
    (tmp_path / "trace.csv").write_text(german(), encoding="utf-8")
    assert read_trace(tmp_path / "trace.csv").limit is None


def test_columns_that_are_not_understood_wait_to_be_chosen(tmp_path):
    (tmp_path / "trace.csv").write_text(
        german(header="Zeit [ms];Kanal 1;Kanal 2;Momentensollwert [%];S"), encoding="utf-8"
    )
    trace = read_trace(tmp_path / "trace.csv")
    assert trace.record is None
    text = axis_text(trace)
    table = tomllib.loads(text)
    assert table["record"] == {"time": {"column": "Zeit", "unit": "ms"}, "command": {"column": "Momentensollwert"}}
    assert "# columns of the file: Zeit [ms], Kanal 1, Kanal 2, Momentensollwert [%], S" in text
    assert '# position = { column = "", unit = "m" }' in text


@pytest.mark.slow("looks for the law of a trace")
def test_init_from(tmp_path, capsys):
    (tmp_path / "trace.csv").write_text(german(), encoding="utf-8")
    words = ["init", "--from", str(tmp_path / "trace.csv"), str(tmp_path / "start"), "--json"]
    assert app.run(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["files"] == ["axis.toml"]
    assert document["to_fill_in"] == list(FILLED)
    assert document["encoder_step"] == pytest.approx(ENCODER, rel=1e-3)
    assert app.run(words) == 2
    assert "axis.toml exists already" in capsys.readouterr().err
    (tmp_path / "trace.csv").write_text(german().replace("Lagesollwert", "Schleppfehler"), encoding="utf-8")
    assert app.run([*words, "--force"]) == 0
    assert app.run([*words, "--force", "--machine", "emps2018"]) == 2
    assert app.run(["init", "--from", str(tmp_path / "none.csv"), str(tmp_path / "a")]) == 2
    assert not (tmp_path / "a").exists()


def test_a_trace_without_a_reference_or_in_another_unit_still_tells_the_rest(tmp_path, capsys):
    text = german().replace("Lagesollwert", "Schleppfehler").replace("[%]", "[0.1 %]")
    (tmp_path / "trace.csv").write_text(text, encoding="utf-8")
    assert app.run(["init", "--from", str(tmp_path / "trace.csv"), str(tmp_path / "start"), "--json"]) == 0
    waiting = json.loads(capsys.readouterr().out)["to_fill_in"]
    assert all(name.isidentifier() for name in waiting), waiting
    text = german().replace("Lagesollwert", "Schleppfehler")
    (tmp_path / "trace.csv").write_text(text, encoding="utf-8")
    assert app.run(["init", "--from", str(tmp_path / "trace.csv"), str(tmp_path / "start"), "--json", "--force"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["encoder_step"] == pytest.approx(ENCODER, rel=1e-3)
    assert "period" not in document["to_fill_in"]


def written(tmp_path, text):
    (tmp_path / "trace.csv").write_text(text, encoding="utf-8")
    trace = read_trace(tmp_path / "trace.csv")
    return trace, axis_text(trace)


SERVO = "\n".join(
    [
        "Axis1",
        "Time,Analog 1,Analog 2",
        "ms,Servo motor speed,Torque",
        *rows(1e3 * T, 60 * np.cos(6 * T), U, between=","),
    ]
)


def test_a_column_without_a_unit_is_filled_in_and_waits_for_it(tmp_path, capsys):
    """Period and command are told all the same; the speed waits behind a # with the unit that a drive writes."""
    trace, text = written(tmp_path, SERVO)
    assert (trace.units.motion, trace.units.command, trace.guessed) == ("rotary", "torque", ("velocity",))
    table = tomllib.loads(text)
    assert table["record"] == {"time": {"column": "Time", "unit": "ms"}, "command": {"column": "Torque"}}
    assert table["sampling"] == {"period": 1e-3}
    assert '# velocity = { column = "Servo motor speed", unit = "rpm" }' in text
    assert "# position" not in text
    for key in ("mass", "viscous", "coulomb", "force_gain", "command_limit", "encoder_resolution", "velocity"):
        text = text.replace(f"# {key} = ", f"{key} = ")
    axis = Axis.from_toml(text).replace(drive={"command_limit": 100.0})
    assert "integral of velocity" in import_record(tmp_path / "trace.csv", axis).warnings[0]
    assert app.run(["init", "--from", str(tmp_path / "trace.csv"), str(tmp_path / "start"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert "velocity" in document["to_fill_in"]
    assert "'Servo motor speed': found no unit" in document["warnings"][0]


def test_with_its_unit_nothing_of_the_table_waits(tmp_path):
    trace, text = written(tmp_path, SERVO.replace("Servo motor speed", "Speed [r/min]"))
    assert trace.units.motion == "rotary"
    assert tomllib.loads(text)["record"]["velocity"] == {"column": "Speed", "unit": "rpm"}


@pytest.mark.parametrize(("title", "command"), [("i [A]", "current"), ("tau [N m]", "torque")])
def test_a_letter_with_its_unit_is_the_command(tmp_path, title, command):
    trace, text = written(tmp_path, "\n".join([f"t [s],theta [rad],{title}", *rows(T, Q, U, between=",")]))
    assert (trace.units.motion, trace.units.command) == ("rotary", command)
    assert tomllib.loads(text)["record"]["command"]["column"] == title.split()[0]


def test_columns_with_the_names_of_a_record_are_not_asked_for(tmp_path):
    trace, text = written(tmp_path, "\n".join(["t,x,u", *rows(T, Q, U, between=",")]))
    assert trace.guessed == ("q",)
    assert '# position = { column = "x", unit = "m" }' in text
    assert "# time" not in text
    assert "# command = {" not in text
    assert trace.encoder_step is None
