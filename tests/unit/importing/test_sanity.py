"""An export that cannot be of its axis is refused in one line that says why; what is odd is noted, nothing mended."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.errors import RecordError
from emps_design.importing import import_bytes, import_record
from emps_design.importing.account import Account, record_table
from emps_design.machines import machine
from emps_design.records.layout import Assignment
from emps_design.simulation.synthetic import synthetic_record

TABLE = {
    "time": {"column": "Zeit", "unit": "ms"},
    "position": {"column": "Lageistwert", "unit": "mm"},
    "reference": {"column": "Lagesollwert", "unit": "mm"},
    "command": {"column": "Spannung"},
}
TITLES = ("Zeit [ms]", "Lageistwert [mm]", "Lagesollwert [mm]", "Spannung [V]")


@pytest.fixture(scope="module")
def axis() -> Axis:
    return machine("emps2019").replace(sampling={"encoder_resolution": 1e-6}, record=TABLE)


@pytest.fixture(scope="module")
def columns(axis) -> dict[str, np.ndarray]:
    """One run of the machine in ms, mm and V, as its drive would write it."""
    record = synthetic_record(axis, laps=1, stroke=0.1)
    return {"t": 1e3 * record.t, "q": 1e3 * record.q, "q_ref": 1e3 * record.q_ref, "u": record.u}


def trace(columns, titles=TITLES, **change) -> bytes:
    values = {**columns, **change}
    rows = (";".join(f"{x:.7f}" for x in row) for row in zip(*values.values(), strict=True))
    return "\n".join([";".join(titles), *rows]).encode()


def without(values, start, stop):
    return np.delete(values, slice(start, stop))


def test_a_good_export_passes_without_a_word(axis, columns):
    record = import_bytes(trace(columns), "trace.csv", axis)
    assert record.warnings == ()
    np.testing.assert_allclose(record.q, 1e-3 * columns["q"], atol=1e-10)
    account = Account(record, axis)
    assert account.encoder_step == pytest.approx(1e-6, rel=1e-3)
    assert "position = {" in account.table


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda c: {"q": 1e-3 * c["q"]},
            "columns q_ref and q: found ranges of 0.1 and 0.0001001 m, expected the same",
        ),
        (lambda c: {"q_ref": 1e-3 * c["q_ref"]}, r"a position that is 1000 times the reference \(mm for m"),
        (lambda c: {"q": 57.2958 * c["q"]}, r"times the reference \(deg for rad\?\)"),
        (
            lambda c: {"q": 1e-3 * c["q"], "q_ref": 1e-3 * c["q_ref"]},
            r"motion that (9|1)\S* times the mass of the axis would make under this command",
        ),
        (
            lambda c: {"q": -c["q"]},
            "opposite to the reference, expected the same direction; one of them needs sign = -1",
        ),
        (lambda c: {"q": c["q_ref"], "q_ref": c["q"]}, "columns q and q_ref: .*; are they exchanged in .record.?"),
        (lambda c: {"q": c["u"], "u": c["q"]}, "q and u: found a position that is rougher than the command"),
        (lambda c: {"q_ref": c["u"], "u": c["q_ref"]}, "q_ref and u: found a command that the position follows"),
        (lambda c: {"u": 1e3 * c["u"]}, "column u: found 4535 V, expected at most 1000 V"),
        (
            lambda c: {"u": 1e2 * c["u"]},
            "column u: found up to 453.5, expected at most the limit of 10 in the axis file",
        ),
        (lambda c: {"u": 1e-3 * c["u"]}, "u and q: found force_gain x command 0.00.* times what mass and friction"),
        (lambda c: {"u": -c["u"]}, "column u: found a command opposite to the motion it causes"),
        (lambda c: {"t": 1e3 * c["t"]}, "sampling period of 1 s"),
        (lambda c: {"t": 1e-3 * c["t"]}, "a speed of .* m/s, expected metres|period"),
    ],
)
def test_refused(axis, columns, change, message):
    with pytest.raises(RecordError, match=message) as caught:
        import_bytes(trace(columns, **change(columns)), "trace.csv", axis)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("trace.csv: ")


OPEN = {
    "time": {"column": "t", "unit": "s"},
    "position": {"column": "x", "unit": "mm"},
    "command": {"column": "u", "unit": "V"},
}


@pytest.fixture(scope="module")
def driven():
    """An axis driven by a slow sine without a controller, and its export: time, position, command (n,) each."""
    axis = machine("emps2019").replace(controller={"kind": "none"}, record=OPEN)
    m, gain = axis.mechanics, axis.drive.gain
    t = np.arange(4000) * 1e-3
    v = 0.2 * np.cos(np.pi * t)
    force = m.mass * np.gradient(v, t) + m.viscous * v + m.coulomb * np.tanh(v / 1e-3)
    return axis, t, 200.0 / np.pi * np.sin(np.pi * t), force / gain + 4.0 * np.sin(np.pi * t)


def written(t, x, u):
    return "\n".join(["t,x,u", *(f"{a:.3f},{b:.6f},{c:.9f}" for a, b, c in zip(t, x, u, strict=True))]).encode()


@pytest.mark.parametrize("step", [0.005, 0.1])  # mm
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_an_encoder_does_not_make_a_position_rougher_than_the_command(driven, step, noise):
    axis, t, x, u = driven
    seen = np.round((x + noise * np.random.default_rng(3).standard_normal(t.size)) / step) * step
    assert len(import_bytes(written(t, seen, u), "sine.csv", axis)) == t.size
    assert len(import_bytes(written(t, seen, 4.0 * np.sin(np.pi * t)), "sine.csv", axis)) == t.size


def test_a_doubt_is_overruled_by_its_name(driven):
    axis, t, x, _ = driven
    wrong = written(t, 10.0 * np.tanh(10.0 * np.cos(np.pi * t)), x / 50.0)  # what Coulomb friction alone takes
    with pytest.raises(
        RecordError, match=r"rougher than the command; .*; or if it is right: accept = \[\"rough-pos.*\"\] in"
    ):
        import_bytes(wrong, "sine.csv", axis)
    others = ["rough-position", "opposed-command", "force-scale", "inertia-scale"]
    accepting = axis.replace(record={**OPEN, "accept": others})
    assert accepting == Axis.from_toml(accepting.to_toml())
    record = import_bytes(wrong, "sine.csv", accepting)
    accepted = [message for message in record.warnings if message.code == "accepted-doubt"]
    rough = [message.values["doubt"] for message in accepted if "rougher than the command" in message]
    assert rough == ["rough-position"]


def test_exchanged_position_and_reference_are_seen_without_an_encoder(axis, columns):
    blind = axis.replace(sampling={"encoder_resolution": 0.0})
    import_bytes(trace(columns), "trace.csv", blind)
    exchanged = trace(columns, q=columns["q_ref"], q_ref=columns["q"])
    with pytest.raises(RecordError, match="q and q_ref: found a reference that explains the command better"):
        import_bytes(exchanged, "trace.csv", blind)


def test_they_are_seen_at_speeds_of_whole_encoder_steps_too(axis):
    """Then what is no multiple of the step is hardly off it: 200 mm/s at 1 kHz is 200 steps of 1 um a sample."""
    t = np.arange(4000) * 1e-3
    ramp = np.minimum(np.abs((t + 0.3) % 2.0 - 1.0) * 0.25, 0.2)
    q_ref = 1e3 * np.convolve(np.pad(ramp, 20, "edge"), np.hanning(41) / np.hanning(41).sum(), "valid")
    q = np.round(1e3 * (q_ref - 0.01 * np.sin(3.0 * t))) / 1e3
    u = 0.2 * np.gradient(np.gradient(q_ref, 1e-3), 1e-3) / 1e3 + np.sin(40.0 * t)
    columns = {"t": 1e3 * t, "q": q, "q_ref": q_ref, "u": u}
    import_bytes(trace(columns), "trace.csv", axis)
    with pytest.raises(RecordError, match="q and q_ref: found a reference in steps of the encoder"):
        import_bytes(trace(columns, q=q_ref, q_ref=q), "trace.csv", axis)


def test_a_mapped_column_in_another_unit_is_not_told_to_be_titled(axis, columns):
    mapped = axis.replace(record=TABLE | {"position": {"column": "Lageistwert", "scale": 3.0}})
    titles = tuple(title.replace("Lageistwert [mm]", "Lageistwert") for title in TITLES)
    with pytest.raises(RecordError, match=r"found a stroke of .* correct unit or scale of position in \[record\]$"):
        import_bytes(trace(columns, titles), "trace.csv", mapped)
    in_seconds = axis.replace(record=TABLE | {"time": {"column": "Zeit", "unit": "s", "scale": 1e-6}})
    with pytest.raises(RecordError, match=r"found a speed of .* unit or scale of position, or of time, in \[record\]$"):
        import_bytes(trace(columns, ("Zeit", *TITLES[1:])), "trace.csv", in_seconds)


def test_the_word_of_a_state_may_be_hexadecimal(axis, columns):
    text = trace(columns).decode().splitlines()
    rows = [text[0] + ";enable", *(f"{row};0x{'1F' if k > 100 else '0'}" for k, row in enumerate(text[1:]))]
    record = import_bytes("\n".join(rows).encode(), "trace.csv", axis)
    assert record.enable is not None
    assert set(record.enable) == {0.0, 31.0}


def test_a_weight_is_part_of_what_a_motion_needs(axis):
    """Upwards, slowly: friction and weight are nearly all of the force, and alike."""
    heavy = axis.replace(mechanics={"offset": axis.mechanics.coulomb})
    record = synthetic_record(heavy, q_ref=5e-6 * np.arange(4000.0))
    columns = {"t": 1e3 * record.t, "q": 1e3 * record.q, "q_ref": 1e3 * record.q_ref, "u": record.u}
    assert not any("force_gain" in note for note in import_bytes(trace(columns), "trace.csv", heavy).warnings)


def test_a_missing_tenth_of_a_second_is_named_whether_time_tells_it_or_not(axis, columns):
    moving = int(np.argmax(np.abs(np.diff(columns["q"])))) - 50
    cut = {name: without(values, moving, moving + 100) for name, values in columns.items()}
    at = cut["t"][moving - 1] / 1e3
    record = import_bytes(trace(cut), "trace.csv", axis)
    assert any(f"nothing from {at:.6g} s to {at + 0.101:.6g} s; used as 2 pieces" in one for one in record.warnings)
    counted = cut | {"t": np.arange(cut["t"].size, dtype=float)}
    with pytest.raises(RecordError, match=rf"q and q_ref, at {at:.6g} s: found both jump.* samples are missing there"):
        import_bytes(trace(counted), "trace.csv", axis)


@pytest.mark.parametrize(
    ("change", "note"),
    [
        ({"u": 2.5}, "u: found up to .* the limit of 10"),
        ({"t": 2.0}, "t: found a sampling period of 2 ms, not the axis's 1 ms"),
        ({"u": 0.05}, "u and q: found force_gain x command 0.0.* check their units"),
    ],
)
def test_noted(axis, columns, change, note):
    import re

    scaled = {name: factor * columns[name] for name, factor in change.items()}
    warnings = import_bytes(trace(columns, **scaled), "trace.csv", axis).warnings
    assert any(re.search(note, warning) for warning in warnings), warnings


def test_another_encoder_is_noted(axis, columns):
    coarse = np.round(columns["q"] / 5e-3) * 5e-3
    account = Account(import_bytes(trace(columns, q=coarse), "trace.csv", axis), axis)
    assert any("moves in steps of 5 µm, the axis file says 1 µm" in note for note in account.notes)


def test_a_plain_record_is_taken_at_its_word(axis, columns):
    content = trace({**columns, "t": 1e-3 * columns["t"]}, ("t", "q [mm]", "q_ref [mm]", "u"), u=-columns["u"])
    assert import_bytes(content, "a.csv", machine("emps2019")).u[5] == pytest.approx(-columns["u"][5], abs=1e-6)


SCALED = {
    "position": {"column": "Pos", "scale": 1e-6},
    "reference": {"column": "Set", "unit": "counts", "scale": 2e-6, "sign": -1},
    "command": {"column": "Tq", "scale": 0.1, "sign": -1, "delay": 0.002},
}


@pytest.fixture
def scaled(axis, columns, tmp_path) -> tuple[Axis, Path]:
    """An axis that maps columns with scale, sign and delay, and a file whose time is known by its title alone."""
    own = Axis.from_dict({**axis.to_dict(), "record": SCALED})
    values = {"q": 1e3 * columns["q"], "q_ref": -0.5e3 * columns["q_ref"], "u": -10 * columns["u"]}
    (tmp_path / "a.csv").write_bytes(trace(columns, ("Time [ms]", "Pos", "Set", "Tq"), **values))
    return own, tmp_path / "a.csv"


def test_the_table_that_is_printed_reads_the_same_record_again(scaled):
    axis, path = scaled
    first = import_record(path, axis)
    table = tomllib.loads(Account(first, axis).to_dict()["record_table"])["record"]
    assert table == {"time": {"column": "Time", "unit": "ms"}, **SCALED}
    bare = {key: value for key, value in axis.to_dict().items() if key != "record"}
    pasted = Axis.from_toml(f"{Axis.from_dict(bare).to_toml()}\n{Account(first, axis).table}")
    again = import_record(path, pasted)
    assert {one.how for one in again.assigned} == {"mapped"}
    assert again.columns.keys() == first.columns.keys()
    for name, values in first.columns.items():
        assert np.array_equal(again.columns[name], values), name
    assert Account(again, pasted).table == Account(first, axis).table


def test_import_prints_the_entries_of_the_axis_file_unchanged(scaled, tmp_path, capsys):
    axis, path = scaled
    (tmp_path / "axis.toml").write_text(axis.to_toml(), encoding="utf-8")
    assert app.run(["import", str(path), "--axis", str(tmp_path / "axis.toml"), "--json"]) == 0
    table = tomllib.loads(json.loads(capsys.readouterr().out)["record_table"])["record"]
    assert {key: table[key] for key in SCALED} == SCALED


def test_a_mapped_reference_that_the_file_lacks_stays_in_the_table(axis, columns):
    mapping = {"position": {"column": "Pos", "scale": 1e-6}, "reference": {"column": "Set", "unit": "mm", "sign": -1}}
    own = Axis.from_dict({**axis.to_dict(), "controller": {"kind": "none"}, "record": mapping})
    three = {"t": columns["t"], "q": 1e3 * columns["q"], "u": columns["u"]}
    record = import_bytes(trace(three, ("Time [ms]", "Pos", "Voltage [V]")), "a.csv", own)
    table = tomllib.loads(Account(record, own).table)["record"]
    assert {key: table[key] for key in mapping} == mapping


def test_a_command_in_another_unit_than_that_of_the_axis_keeps_it():
    one = Assignment("u", "u/mV", "mV", 1e-3)
    assert record_table((one,)) == '[record]\ncommand = { column = "u/mV", unit = "mV" }\n'


def test_a_title_of_any_letters_is_valid_in_the_table():
    title = 'a "b" \\ \u2028 \x01'
    assert tomllib.loads(record_table((Assignment("q", title, "mm"),)))["record"]["position"]["column"] == title


@pytest.mark.parametrize("other", ["Lageistwert", "lageistwert [mm]"])
def test_one_column_for_two_keys_is_refused(axis, columns, tmp_path, capsys, other):
    twice = axis.replace(record={"reference": {"column": other, "unit": "mm"}})
    message = (
        r"\[record\] position and reference both take the column 'Lageistwert \[mm\]'; give them different "
        r"columns, or remove one from \[record\]"
    )
    with pytest.raises(RecordError, match=f"^trace.csv: {message}$"):
        import_bytes(trace(columns), "trace.csv", twice)
    (tmp_path / "axis.toml").write_text(twice.to_toml(), encoding="utf-8")
    (tmp_path / "a.csv").write_bytes(trace(columns))
    assert app.run(["import", str(tmp_path / "a.csv"), "--axis", str(tmp_path / "axis.toml")]) == 2
    assert "both take the column" in capsys.readouterr().err
