"""What drives write is taken as it is: preamble, encoding, separators, units, comments, status, Scope exports."""

import numpy as np
import pytest

from emps_design.discrepancy.records import split
from emps_design.errors import AxisError, RecordError
from emps_design.identification.filters import at_rest
from emps_design.importing import import_bytes, import_record
from emps_design.importing.account import Account, record_table
from emps_design.machines import machine
from emps_design.records import read_record, record_from_bytes
from emps_design.records.check import PLAIN
from emps_design.records.layout import ColumnMap, Layout
from emps_design.units import Units
from tests.unit.records.exports import ENCODER, Q_REF, N, Q, T, U, german, rows, scope

TORQUE = Units("linear", "torque", "%")
GERMAN = {
    "time": {"column": "Zeit", "unit": "ms"},
    "position": {"column": "Lageistwert", "unit": "mm"},
    "reference": {"column": "Lagesollwert", "unit": "mm"},
    "command": {"column": "Momentensollwert"},
}


def layout(columns=None, units=TORQUE, **more):
    return Layout(units, ColumnMap.model_validate(columns or {}), 1e-3, **more)


def read(text, columns=None, encoding="utf-8", **more):
    return record_from_bytes(text.encode(encoding), "trace.csv", layout=layout(columns, **more))


def same(record, digits=10):
    wanted = {"q": Q, "q_ref": Q_REF, "u": U}
    return record.period == 1e-3 and all(np.allclose(getattr(record, k), v, atol=10.0**-7) for k, v in wanted.items())


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
@pytest.mark.parametrize("columns", [GERMAN, None], ids=["mapped", "by its titles"])
def test_a_german_export(encoding, columns):
    record = read(german(), columns, encoding)
    assert same(record)
    assert [one.title for one in record.assigned][:2] == ["Zeit [ms]", "Lagesollwert [mm]"]
    said = [note for note in record.warnings if "taken from column" in note]
    assert len(said) == (0 if columns else 4)  # a guess is never silent


@pytest.mark.parametrize("between", [";", "\t", ","])
def test_a_comment_units_after_an_underscore_and_a_status_of_words(between):
    titles = between.join(("time_s", "cmd_A", "pos_deg", "ref_deg", "state"))
    lines = [
        f"{line}{between}ready" for line in rows(T, U, np.degrees(Q), np.degrees(Q_REF), between=between, digits=9)
    ]
    text = "\n".join(["# axis trace, 1000 Hz", titles, *lines[:200], "# marker", *lines[200:]])
    columns = {
        "time": {"column": "time_s"},
        "position": {"column": "pos_deg"},
        "reference": {"column": "ref_deg", "unit": "deg"},
        "command": {"column": "cmd_A"},
    }
    assert same(read(text, columns, units=Units("rotary", "current", "A")))
    assert same(read(text, None, units=Units("rotary", "current", "A")))


def test_units_on_a_line_of_their_own_and_titles_in_a_comment():
    titles, units = "Time;Actual position;Set position;Set torque", "[ms];[mm];[mm];[%]"
    body = rows(1e3 * T, 1e3 * Q, 1e3 * Q_REF, U)
    assert same(read("\n".join([titles, units, *body])))
    assert same(read("\n".join(["# Time [ms];Actual position [mm];Set position [mm];Set torque [%]", *body])))


@pytest.mark.parametrize("between", [";", ",", "\t", "  "])
def test_units_below_the_titles_and_plainer_titles_beside_them(between):
    """A servo tool writes Time over ms, but Analog 1 over what that is."""
    head = [
        "Axis1",
        f"Number of data{between}400",
        between.join(["Time", "Analog 1", "Analog 2", "Analog 3", "Analog 4"]),
    ]
    plainer = between.join(["ms", "Motor speed", "Actual position", "Set position", "Torque"])
    body = rows(1e3 * T, 60 * T, Q, Q_REF, U, between=between)
    columns = {
        "time": {"column": "Time"},
        "velocity": {"column": "Motor speed", "unit": "r/min"},
        "position": {"column": "Actual position", "unit": "rad"},
        "reference": {"column": "Set position", "unit": "rad"},
        "command": {"column": "Torque"},
    }
    turning = Units("rotary", "torque", "%")
    record = read("\n".join([*head, plainer, *body]), columns, units=turning)
    assert same(record)
    assert [one.title for one in record.assigned][:2] == ["Time [ms]", "Set position"]
    by_place = {key: {**one, "column": f"Analog {k}"} for k, (key, one) in enumerate(columns.items())}
    by_place["time"] = {"column": "Time", "unit": "ms"}
    assert same(read("\n".join([*head, plainer, *body]), by_place, units=turning))


@pytest.mark.parametrize("mark", ["# ", "#", "% ", "// "])
def test_what_savetxt_writes(mark):
    head = [
        f"{mark}bench 3, measured on a Friday",
        f"{mark}Time [ms] Actual position [mm]  Set position [mm] Set torque [%]",
    ]
    assert same(read("\n".join([*head, *rows(1e3 * T, 1e3 * Q, 1e3 * Q_REF, U, between=" ")])))
    plain = [f"{mark}t q q_ref u", f"{mark}ms mm mm -"]
    assert same(read("\n".join([*plain, *rows(1e3 * T, 1e3 * Q, 1e3 * Q_REF, U, between=" ")])))


def test_a_table_between_spaces_with_a_preamble_decimal_commas_and_comments():
    head = ["Test bench 4", "rate 1000 Hz", "", "   Time       Actual position   Set position   Set torque"]
    units = "    [ms]       [mm]              [mm]           [%]"
    body = [f"   {row}" for row in rows(1e3 * T, 1e3 * Q, 1e3 * Q_REF, U, between="     ", comma=True)]
    assert same(read("\n".join([*head, units, *body[:200], "# half-way", *body[200:]])))
    with pytest.raises(RecordError, match="row 12, column 'Actual position .mm.': found 'x', expected a number"):
        read("\n".join([*head, units, *body[:6], "0 x 0 0", *body[6:]]))


def test_a_table_without_titles_is_mapped_by_place():
    columns = {
        "time": {"column": "data:0", "unit": "ms"},
        "position": {"column": "data:1", "unit": "mm"},
        "reference": {"column": "data:2", "unit": "mm"},
        "command": {"column": "data:3"},
    }
    body = rows(1e3 * T, 1e3 * Q, 1e3 * Q_REF, U, between=" ")
    assert same(read("\n".join(body), columns))
    assert same(read("\n".join(["# measured on a Friday at four", *body]), columns))
    with pytest.raises(RecordError, match="row 1: found numbers, expected a header .* columns data:0, data:1"):
        read("\n".join(body))


def test_counts_scale_and_sign():
    header = "Takt;Lageistwert [inc];Lagesollwert [mm];Momentensollwert [%]"
    text = "\n".join([header, *rows(np.arange(N), -Q / ENCODER, 1e3 * Q_REF, U / 10)])
    columns = {
        **GERMAN,
        "time": {"column": "Takt", "unit": "counts", "scale": 1e-3},
        "position": {"column": "Lageistwert", "unit": "counts", "scale": ENCODER, "sign": -1},
        "command": {"column": "Momentensollwert", "scale": 10},
    }
    assert same(read(text, columns))


def test_a_column_that_is_recorded_late_is_read_earlier(tmp_path):
    late, delay = np.interp(T - 3e-3, T, U), {"delay": 3e-3}
    header = "Zeit [ms];Lageistwert [mm];Lagesollwert [mm];Momentensollwert [%]"
    text = "\n".join([header, *rows(1e3 * T, 1e3 * Q, 1e3 * Q_REF, late, digits=12)])
    columns = {**GERMAN, "command": {**GERMAN["command"], **delay}}
    record = read(text, columns)
    assert len(record) == N - 3  # what was not recorded any more is not made up
    np.testing.assert_allclose(record.u, U[:-3], atol=1e-6)
    np.testing.assert_allclose(record.q, Q[:-3], atol=1e-9)
    assert "u: read 3 ms earlier than it was recorded" in record.warnings
    assert "u: not recorded for the last 3 samples, left out" in record.warnings
    record.save(tmp_path / "a.npz")  # read once, it is late no more
    again = record_from_bytes((tmp_path / "a.npz").read_bytes(), "a.npz", layout=layout(columns))
    assert np.array_equal(again.u, record.u)
    assert 'command = { column = "Momentensollwert", delay = 0.003 }' in record_table(record.assigned)


LATE = {"command": {"column": "u", "delay": 0.05}, "velocity": {"column": "v", "delay": -0.02}}
LATE_AT = {"u": U, "v": np.cos(6 * T)}  # as they act


def delayed(t=T):
    """A record in which u comes 50 ms late and v 20 ms early, at the times ``t`` [s]."""
    late = {"u": np.interp(T - 0.05, T, LATE_AT["u"]), "v": np.interp(T + 0.02, T, LATE_AT["v"])}
    return "\n".join(["t;q;q_ref;u;v;state", *rows(t, Q, Q_REF, late["u"], late["v"], np.arange(N), digits=12)])


def test_a_part_of_a_file_takes_late_values_from_beyond_the_part():
    record = read(delayed(), LATE, units=PLAIN.units, window=(0.1, 0.3))
    assert len(record) == 201
    np.testing.assert_allclose(record.u, U[100:301], atol=1e-6)
    np.testing.assert_allclose(record.velocity, LATE_AT["v"][100:301], atol=1e-6)
    assert not any("left out" in note for note in record.warnings)
    near = read(delayed(), LATE, units=PLAIN.units, window=(0.0, 0.37))
    np.testing.assert_allclose(near.u, U[20:350], atol=1e-6)
    np.testing.assert_allclose(near.velocity, LATE_AT["v"][20:350], atol=1e-6)
    assert "u and velocity: not recorded for the first 20 samples, left out" in near.warnings
    assert "u and velocity: not recorded for the last 21 samples, left out" in near.warnings


def test_late_values_are_not_taken_from_beyond_a_gap():
    gap = T + np.where(np.arange(N) > 300, 0.04, 0.0)
    record = read(delayed(gap), LATE, units=PLAIN.units, window=(0.1, 0.3))
    np.testing.assert_allclose(record.u, U[100:251], atol=1e-6)
    assert "u and velocity: not recorded for the last 50 samples, left out" in record.warnings


@pytest.mark.parametrize(
    ("away", "message"),
    [(0.04, r"row 392: nothing from 0\.389 s to 0\.43 s"), (-0.2, "row 392: found time going backwards")],
    ids=["gap", "back"],
)
def test_time_that_is_wrong_near_the_end_is_refused_with_a_delay_too(away, message):
    with pytest.raises(RecordError, match=message):
        read(delayed(T + np.where(np.arange(N) >= 390, away, 0.0)), LATE, units=PLAIN.units)


def test_a_file_that_is_too_short_for_its_delay_is_refused():
    with pytest.raises(RecordError, match="found 1 sample left by the delay of u and velocity, expected at least 50"):
        read(delayed(), LATE, units=PLAIN.units, window=(0.349, 0.399))


def test_a_switch_that_is_recorded_late_stays_a_switch():
    text = "\n".join(["t;q;q_ref;u;on", *rows(T, Q, Q_REF, U, T > 0.1)])
    record = read(text, {"enable": {"column": "on", "delay": 0.0125}})
    assert set(record.enable) == {0.0, 1.0}
    assert T[np.argmax(record.enable)] == pytest.approx(0.0885, abs=1e-3)


@pytest.mark.parametrize(
    "table",
    [{"time": {"column": "t", "delay": 1e-3}}, {"command": {"column": "u", "delay": 1.0}}],
    ids=["time", "long"],
)
def test_a_delay_that_cannot_be_is_refused(table):
    with pytest.raises(AxisError, match=r"record.*delay"):
        machine("emps2019").replace(record=table)


@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("end", ["", "EOF"])
def test_a_scope_export(comma, end):
    record = read(scope(comma, end=end))
    assert same(record)
    assert same(read(scope(comma, end=end), {**{k: GERMAN[k] for k in ()}, "position": {"column": "ActPos"}}))


def test_the_scale_of_a_scope_is_said():
    record = read(scope().replace("ScaleFactor\t1\t1", "ScaleFactor\t1\t0.1"))
    assert [message.values["column"] for message in record.warnings if message.code == "scope-scale"] == [
        "TorqueCommand [%]"
    ]


def test_a_scope_export_without_samples_is_refused():
    header = scope().split("Unit ScaleFactor")[0]
    with pytest.raises(RecordError, match="found a header and no samples"):
        read(header)


def test_a_slower_channel_of_a_scope_is_interpolated_and_said():
    record = read(scope(step=4))
    assert len(record) == N - 3  # the reference ends earlier
    np.testing.assert_allclose(record.q_ref, Q_REF[: N - 3], atol=1e-5)
    assert any("SetPos [mm]: sampled every 4 ms, interpolated" in note for note in record.warnings)


def test_a_mapped_column_wins_over_one_with_the_name_of_a_record():
    text = "\n".join(["t;q;q_ref;u;pos [mm]", *rows(T, 0 * Q + 3, Q_REF, U, 1e3 * Q)])
    assert same(read(text, {"position": {"column": "pos"}}))


def test_a_saved_import_is_read_by_the_same_layout(tmp_path):
    columns = {**GERMAN, "position": {"column": "q", "unit": "mm"}}  # whose title a record has too
    text = german(header="Zeit;q;Lagesollwert;Momentensollwert;Status")
    record = read(text, columns)
    assert same(record)
    record.save(tmp_path / "a.npz")
    again = record_from_bytes((tmp_path / "a.npz").read_bytes(), "a.npz", layout=layout(columns))
    assert all(np.array_equal(again.columns[name], values) for name, values in record.columns.items())


def test_a_missing_column_is_not_taken_from_one_with_the_name_of_a_record():
    """Volts beside a duty: where the duty is missing, the volts are no command."""
    columns = {"position": {"column": "q"}, "command": {"column": "duty"}}
    text = "\n".join(["t;q;q_ref;u;temperature", *rows(T, Q, Q_REF, U, 0 * T)])
    with pytest.raises(RecordError, match="command: found no column 'duty'"):
        read(text, columns)
    plain = read("\n".join(["t;q;q_ref;u", *rows(T, Q, Q_REF, U)]), columns)  # nothing but the names of a record
    assert same(plain)
    assert any("read by the names of a record" in note for note in plain.warnings)


def test_optional_columns_are_kept_and_come_back(tmp_path):
    header = "t;q;q_ref;u;v_act [rpm];bus [V];on;vset [rad/s];inj"
    text = "\n".join([header, *rows(T, Q, Q_REF, U, 60 * T, 48 + 0 * T, T > 0.1, T, 0.1 * T)])
    columns = {
        "velocity": {"column": "v_act"},
        "supply": {"column": "bus"},
        "enable": {"column": "on"},
        "velocity_reference": {"column": "vset"},
        "excitation": {"column": "inj"},
    }
    record = read(text, columns, units=Units("rotary", "duty", ""))
    np.testing.assert_allclose(record.velocity, 2 * np.pi * T, atol=1e-6)
    assert set(record.columns) == {"t", "q", "q_ref", "u", *columns}
    record.save(tmp_path / "a.npz")
    record.save(tmp_path / "a.csv")
    for name in ("a.npz", "a.csv"):
        again = record_from_bytes((tmp_path / name).read_bytes(), name, layout=layout(columns))
        assert all(np.array_equal(again.columns[key], values) for key, values in record.columns.items())
    part = record.part(100, 200)
    assert np.array_equal(part.velocity, record.velocity[100:200])
    assert part.f_ext is None


@pytest.mark.parametrize("unit", ["r/min", "rpm", "1/min", "U/min", "min-1", "rev/min"])
def test_revolutions_a_minute_however_they_are_written(unit):
    titled = "\n".join(["t;q;q_ref;u;Motor speed [" + unit + "]", *rows(T, Q, Q_REF, U, 60 * T)])
    plain = titled.replace(f" [{unit}]", "")
    turning = Units("rotary")
    by_table = read(plain, {"velocity": {"column": "Motor speed", "unit": unit}}, units=turning)
    by_title = read(titled, {"velocity": {"column": "Motor speed"}}, units=turning)
    for record in (by_table, by_title):
        np.testing.assert_allclose(record.velocity, 2 * np.pi * T, atol=1e-6)


def test_a_reference_may_be_absent_where_no_controller_needs_one():
    text = "\n".join(["t;q;u;vset", *rows(T, Q, U, np.gradient(Q_REF, T))])
    columns = {"reference": {"column": "q_ref"}, "velocity_reference": {"column": "vset", "unit": "m/s"}}
    record = read(text, columns, reference_needed=False)
    assert not record.q_ref_recorded
    assert "q_ref" not in record.columns
    assert any("integral of velocity_reference" in note for note in record.warnings)
    np.testing.assert_allclose(np.diff(record.q_ref), record.velocity_reference[1:] * 1e-3, atol=1e-12)
    del columns["velocity_reference"]
    record = read(text, columns, reference_needed=False)
    assert np.array_equal(record.q_ref, record.q)
    with pytest.raises(RecordError, match="reference: found no column 'q_ref'"):
        read(text, columns)


SPEED = 0.6 * np.cos(6 * T)


def test_a_velocity_without_a_position_is_integrated_and_said(tmp_path):
    text = "\n".join(["Time [ms];Motor speed;Torque", *rows(1e3 * T, SPEED / (2 * np.pi / 60), U)])
    turning = {"units": Units("rotary", "torque", "%"), "reference_needed": False}
    columns = {"velocity": {"column": "Motor speed", "unit": "r/min"}}
    record = read(text, columns, **turning)
    np.testing.assert_allclose(record.q, 0.1 * np.sin(6 * T), atol=1e-6)
    assert "q: not recorded; replaced by the integral of velocity from 0" in record.warnings
    assert Account(record, machine("emps2019")).encoder_step is None
    record.save(tmp_path / "a.npz")
    again = record_from_bytes((tmp_path / "a.npz").read_bytes(), "a.npz", layout=layout(columns, **turning))
    assert np.array_equal(again.q, record.q)
    with pytest.raises(
        RecordError, match="'Motor speed': found no unit, expected one such as rad/s; say in .record.: vel"
    ):
        read(text, **turning)
    by_title = read(text.replace("Motor speed", "Motor speed [r/min]"), **turning)
    assert np.array_equal(by_title.q, record.q)


def test_a_position_that_is_there_is_not_integrated():
    text = "\n".join(["Time [ms];Speed [m/s];Position [m];Torque", *rows(1e3 * T, SPEED, Q, U)])
    record = read(text, {"velocity": {"column": "Speed"}}, reference_needed=False)
    np.testing.assert_allclose(record.q, Q, atol=1e-7)
    with pytest.raises(RecordError, match="'Position': found no unit, expected one such as m"):
        read(text.replace("Position [m]", "Position"), {"velocity": {"column": "Speed"}}, reference_needed=False)


def jittered(gap=0.0):
    t = T + 3e-4 * np.random.default_rng(1).uniform(-1, 1, N)
    t[N // 2 :] += gap
    return "\n".join(["t;q;q_ref;u", *rows(t, np.sin(6 * t), np.sin(6 * t), np.cos(6 * t), digits=12)])


def test_irregular_time_is_resampled_and_what_that_costs_is_said():
    record = read(jittered())
    assert record.period == 1e-3
    t0 = record.measured["t"][0]
    away = np.abs(record.q - np.sin(6 * (record.t + t0)))
    note = next(message for message in record.warnings if message.code == "irregular-time")
    promised = float(note.split("rms) q ")[1].split(",")[0])
    assert 0 < np.sqrt(np.mean(away**2)) <= promised < 1e-5
    with pytest.raises(RecordError, match="sampling must be uniform"):
        read(jittered(), resample=False)


def test_a_part_without_the_gap_is_read():
    record = read(jittered(gap=0.1), window=(0.0, 0.19))
    assert record.duration == pytest.approx(0.19, abs=2e-3)
    with pytest.raises(RecordError, match="column t: found .* s, expected some of it between 7 and 9 s"):
        read(jittered(), window=(7.0, 9.0))


def test_a_record_with_gaps_is_taken_as_its_pieces_and_says_so(tmp_path):
    t = T + np.where(T > 0.1, 0.05, 0.0) + np.where(T > 0.25, 0.02, 0.0)
    text = "\n".join(["t;q;q_ref;u", *rows(t, np.sin(6 * t), np.sin(6 * t), np.cos(6 * t), digits=12)])
    record = read(text)
    assert any(
        "nothing from 0.1 s to 0.151 s and in 1 more gaps, 0.072 s in all; used as 3 pieces" in note
        for note in record.warnings
    )
    there = record.bridged == 0.0
    assert there.sum() == N
    np.testing.assert_allclose(record.q[there], np.sin(6 * record.t[there]), atol=1e-6)
    assert np.all(at_rest(record)[~there])
    assert not split(record).used[~there].any()
    assert record.part(120, 300).bridged.sum() == (~there)[120:300].sum()
    for name in ("a.npz", "a.csv"):
        record.save(tmp_path / name)
        again = record_from_bytes((tmp_path / name).read_bytes(), name, layout=layout())
        assert np.array_equal(again.bridged, record.bridged)


def test_a_reference_that_is_constant_is_none_where_no_controller_needs_one():
    text = "\n".join(["t;q;q_ref;u", *rows(T, Q, 0 * T, U)])
    record = read(text, units=Units(), reference_needed=False)
    assert not record.q_ref_recorded
    assert np.array_equal(record.q_ref, record.q)
    assert [note for note in record.warnings if note.startswith("q_ref")] == [
        "q_ref: constant at 0 m, no reference of this motion; replaced by q",
    ]
    assert read(text, units=Units()).q_ref_recorded


@pytest.mark.parametrize("suffix", ["csv", "npz", "csv with empty cells"])
def test_what_is_missing_outside_the_part_does_not_matter(tmp_path, suffix):
    q, late = Q.copy(), np.interp(T - 0.05, T, U)
    q[:6], q[-3:] = np.nan, np.nan
    path, table = tmp_path / f"a.{suffix[:3]}", {"t": T, "q": q, "q_ref": Q_REF, "u": late, "angle": (3e3 * Q) % 360}
    if suffix == "npz":
        np.savez(path, **table)
    else:
        np.savetxt(path, np.column_stack(list(table.values())), header=" ".join(table), fmt="%.9g")
    if "empty" in suffix:
        path.write_text(path.read_text().replace(" ", ",").replace("nan", "").replace("#,", ""))
    columns = {"command": {"column": "u", "delay": 0.05}}
    record = read_record(path, layout=layout(columns, PLAIN.units, window=(0.1, 0.3)))
    np.testing.assert_allclose(record.q, Q[100:301], atol=1e-7)
    np.testing.assert_allclose(record.u, U[100:301], atol=1e-6)
    wrapped = {"position": {"column": "angle", "unit": "deg", "modulo": 360}}
    turned = read_record(path, layout=layout(wrapped, Units("rotary"), window=(0.1, 0.3)))
    assert np.ptp(turned.q) == pytest.approx(np.radians(3e3 * np.ptp(Q[100:301])), rel=1e-6)
    with pytest.raises(RecordError, match=r"column q, row \d+: found nan, .*6 such .*cut the gap out with import"):
        read_record(path, layout=layout({}, PLAIN.units, window=(0.0, 0.3)))
    end = read_record(path, layout=layout(columns, PLAIN.units, window=(0.2, 0.396)))
    assert "u: not recorded for the last 50 samples, left out" in end.warnings


def test_the_original_times_are_kept_through_an_archive(tmp_path):
    record = read(jittered())
    record.save(tmp_path / "a.npz")
    again = record_from_bytes((tmp_path / "a.npz").read_bytes(), "a.npz", layout=layout())
    assert set(again.measured) == {"t", "q", "q_ref", "u"}
    assert np.array_equal(again.measured["t"], record.measured["t"])


@pytest.mark.parametrize(
    ("text", "columns", "message"),
    [
        (
            jittered(gap=0.6),  # more than half of it
            {"position": {"column": "q"}},
            r"row 202: nothing from 0\.19\d* s to 0\.\d* s, expected a s",
        ),
        (
            german(),
            {**GERMAN, "position": {"column": "Lageistwerte"}},
            "no column 'Lageistwerte', did you mean 'Lageistw",
        ),
        (
            german(),
            {**GERMAN, "position": {"column": "Lageistwert", "unit": "m"}},
            r"the title says mm, .* says m; corr",
        ),
        (german(), {**GERMAN, "position": {"column": "Momentensollwert"}}, "found the unit %, expected m for position"),
        (german(), {**GERMAN, "position": {"column": "Status", "unit": "counts"}}, "counts.* without a scale"),
        (german(), {**GERMAN, "position": {"column": "Status", "scale": 0}}, "found scale 0, expected a finite number"),
        (german(), {**GERMAN, "position": {"column": "Status", "unit": "rad"}}, "linear position: found unit 'rad'"),
        (german(header="Zeit;a;b;c"), None, "missing column t, q_ref, q, u; found Zeit, a, b, c|no unit"),
        (
            german(header="Zeit [ms];Lageistwert;Lagesollwert [mm];Strom"),
            None,
            "'Lageistwert': found no unit, expected",
        ),
        (
            german(header="Zeit [ms];Lageistwert 1 [mm];Lageistwert 2 [mm];Momentensollwert [%];Lagesollwert [mm]"),
            None,
            "'Lageistwert 1 .mm.' and 'Lageistwert 2 .mm.' may each be position; say which",
        ),
        (
            german(header="Zeit;Lageistwert;Lageistwert;Momentensollwert"),
            GERMAN,
            "found 2 columns titled 'Lageistwert'",
        ),
    ],
)
def test_refused(text, columns, message):
    with pytest.raises(RecordError, match=message) as caught:
        read(text, columns)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("trace.csv: ")


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
@pytest.mark.parametrize("names", [("t", "q", "q_ref", "u"), ("Zeit", "Lage", "Soll", "Moment")])
def test_an_imported_record_is_read_back_as_it_is(tmp_path, suffix, names):
    """Its columns are SI and mapped no more, even where [record] maps columns of the same names."""
    keys, units = ("time", "position", "reference", "command"), ("ms", "mm", "mm", "")
    mapping = {
        key: {"column": name, **({"unit": unit} if unit else {"scale": 2.0})}
        for key, name, unit in zip(keys, names, units, strict=True)
    }
    axis = machine("emps2019").replace(record=mapping)
    k = np.arange(400)
    table = np.column_stack([k, 50.0 * np.sin(k / 50), 50.0 * np.sin(k / 49), 10.0 * np.cos(k / 50)])
    rows = "\n".join(";".join(f"{x:.5f}" for x in row) for row in table)
    first = import_bytes(f"{';'.join(names)}\n{rows}".encode(), "trace.csv", axis)
    path = tmp_path / f"record{suffix}"
    first.save(path)
    again = import_record(path, axis)
    assert again.period == pytest.approx(1e-3)
    assert np.ptp(again.u) == pytest.approx(40.0, rel=1e-3)
    for name, values in first.columns.items():
        assert np.allclose(again.columns[name], values, rtol=1e-11, atol=0.0), name
    assert {one.how for one in again.assigned} == {"named"}


def test_a_command_of_another_machine_is_pointed_to_the_command_that_makes_its_axis():
    with pytest.raises(RecordError, match="unit %, expected V .*another machine: emps-design init --from TRACE"):
        read(german(), units=Units())


def test_a_part_may_be_taken_of_a_file_that_is_too_long_as_a_whole(monkeypatch):
    for module in ("layout", "check"):
        monkeypatch.setattr(f"emps_design.records.{module}.LONGEST", 100)
    text = "t,q_ref,q,u\n" + "\n".join(f"{k / 1000:.3f},{k / 100:.2f},{k / 100:.2f},{k % 7}" for k in range(400))
    with pytest.raises(
        RecordError, match=r"found more than 100 rows, expected fewer; take a part of it with import and its `window`"
    ):
        record_from_bytes(text.encode(), "long.csv")
    part = record_from_bytes(text.encode(), "long.csv", layout=layout(units=PLAIN.units, window=(0.1, 0.15)))
    assert len(part) == 51
    with pytest.raises(RecordError, match="found 300 samples, expected at most 100; take a part of it"):
        record_from_bytes(text.encode(), "long.csv", layout=layout(units=PLAIN.units, window=(0.1, 1.0)))


def test_a_title_in_a_unit_of_another_quantity_contradicts_the_mapping():
    text = german().replace("Lageistwert [mm]", "Lageistwert [deg]").encode()
    with pytest.raises(RecordError, match=r"the title says deg, \[record\] position says mm; correct the axis file"):
        record_from_bytes(text, "trace.csv", layout=layout(GERMAN))


def test_titles_that_come_again_are_told_from_other_words():
    lines = ["t;q;q_ref;u", *rows(T, Q, Q, U)]
    again = [*lines[:200], lines[0], *lines[200:]]
    with pytest.raises(RecordError, match="row 201, column 't': found 't', expected a number; the titles come again"):
        read("\n".join(again))
    again[200] = "t;1;what;2"
    with pytest.raises(RecordError, match="row 201, column 'q_ref': found 'what', expected a number$"):
        read("\n".join([*again[:200], "0.2;1;what;2", *again[201:]]))
