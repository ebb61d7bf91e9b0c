"""The check at the door: each thing it refuses or notes, with the place and the numbers."""

import numpy as np
import pytest

from emps_design.errors import RecordError
from emps_design.records import Record
from emps_design.records.check import check_columns
from emps_design.records.layout import Layout

N = 400
T = np.arange(N) * 1e-3
Q = 0.1 * np.sin(6 * T)
U = np.cos(6 * T) + 0.1 * np.sin(200 * T)


def build(t=T, q_ref=Q, q=Q, u=U, **more) -> Record:
    return Record.from_arrays(t, q_ref, q, u, **more)


def changed(values, index, value):
    values = np.array(values, dtype=float)
    values[index] = value
    return values


def test_a_good_record_passes_as_it_is():
    record = build(name="good", extra={"temperature": 20.0, "kp": Q, "table": np.arange(3.0)})
    assert record.warnings == ()
    assert np.array_equal(record.q, Q)
    assert record.duration == pytest.approx(0.4)
    assert record.extra["temperature"] == 20.0
    part = record.part(100, 200)
    assert len(part) == 100
    assert part.extra.keys() == {"temperature", "kp"}
    assert np.array_equal(part.extra["kp"], Q[100:200])
    assert part.t[0] == 0.0


def test_quantised_time_gives_the_nominal_period():
    rng = np.random.default_rng(0)
    assert build(t=np.round(T * 1.000008, 7) + 1e-8 * rng.integers(-2, 3, N)).period == 1e-3
    assert build(t=np.arange(N) / 3000).period == pytest.approx(1 / 3000, rel=1e-15)
    assert build(t=np.arange(N) * 1.2365e-3).period == pytest.approx(1.2365e-3, rel=1e-9)
    assert build(t=5e-4).period == 5e-4


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"t": T[:3], "q_ref": Q[:3], "q": Q[:3], "u": U[:3]}, "found 3 samples, expected at least 50"),
        ({"q": changed(Q, 7, np.nan)}, "column q, row 7: found nan, expected a finite number; cut"),
        ({"q": changed(Q, N - 1, np.nan)}, "row 399: found nan, .*; it is the last row: delete it if the file was cut"),
        ({"q": np.rint(1e6 * Q)}, "a stroke of 1e.05 m, .*; it is probably in counts: map it in .record., with unit"),
        ({"u": changed(U, slice(7, 9), np.inf)}, r"column u, row 7: found inf, .*\(2 such samples\)"),
        ({"t": changed(T, 9, 0.0)}, r"row 9: found time going backwards \(0.008 s, then 0 s\)"),
        ({"t": changed(T, 9, T[8])}, "row 9: found the same time twice .*; delete a row that is written twice"),
        ({"t": T * 1000}, "sampling period of 1 s, expected 1e-06 to 0.1 s; if time is in ms"),
        ({"q": np.full(N, 0.1)}, "column q: found 0.1 m in every row; the axis must move"),
        ({"u": np.zeros(N)}, "column u: found 0 V in every row; the drive must work"),
        ({"q_ref": 2400 * Q, "q": 2400 * Q}, r"found a stroke of .* m, expected metres .* title the column 'q \[mm\]'"),
        ({"q_ref": 100 * Q, "q": 100 * Q, "t": T / 10}, r"column q: found a speed of .* m/s, expected metres"),
        ({"q": Q / 1000}, r"columns q_ref and q: found ranges of 0\.\d+ and 0\.000\d+ m, expected the same unit"),
        ({"u": 2000 * U}, r"column u: found .* V, expected at most 1000 V; .*'u \[mV\]'"),
        ({"f_ext": 1e9 * U}, r"column f_ext: found .* N, expected at most 1e\+06 N"),
        ({"t": np.zeros(5_000_001, dtype=np.int8)}, "found 5000001 samples, expected at most 5000000; take a part"),
        ({"q": Q + 0j}, "column 'q': found complex128 values"),
        ({"t": changed(T, N - 1, 5e157)}, r"column t, row \d+: found 5e\+157 s, expected a magnitude below 1e\+15"),
        ({"t": 1e160 * T}, r"column t, row \d+: found .*e\+159 s, expected a magnitude below 1e\+15"),
        ({"u": 1e308 * U}, r"column u, row \d+: found .* V, expected a magnitude below 1e\+15"),
    ],
)
def test_refused(columns, message):
    with pytest.raises(RecordError, match=message):
        build(**columns)


@pytest.mark.parametrize(
    ("columns", "note"),
    [
        ({"q_ref": np.zeros(N)}, "q_ref: constant at 0 m"),
        ({"q": 1e-5 * Q, "q_ref": 1e-5 * Q}, "q: a stroke of only"),
        ({"u": 1e-4 * U}, "u: at most 0.00011 V"),
        ({"u": np.clip(5 * U, -4, 4)}, "of the samples sit at the extreme of 4 V: saturated"),
        ({"t": T + 4e-5 * np.sin(np.arange(N) * 2.0)}, "t: sampling jitter of"),
    ],
)
def test_noted(columns, note):
    warnings = build(**columns).warnings
    assert len(warnings) == 1
    assert note in warnings[0]


@pytest.mark.parametrize(("limit", "said"), [(None, False), (0.3, False), (0.08, True)])
def test_a_command_in_steps_is_no_saturated_one(limit, said):
    steps = np.where(np.arange(N) < 150, 0.05, 0.08)
    record = Record.from_arrays(T, Q, Q, steps, layout=Layout(limit=limit))
    assert any("saturated" in note for note in record.warnings) is said


def test_a_unit_that_overflows_is_refused():
    with pytest.raises(RecordError, match="column u, row 0: found inf, expected a finite number"):
        check_columns({"t": T, "q_ref": Q, "q": Q, "u [kV]": 1e307 * U}, "r")


@pytest.mark.parametrize(("period", "digits"), [(2.5e-4, 4), (1.0 / 3000.0, 4)])
def test_stamps_that_were_rounded_are_those_of_an_even_clock(period, digits):
    """4 kHz with one decimal of a millisecond: 0.2, 0.5, 0.8, 1.0 ms. It is said that a sample is missing."""
    clock, k = np.round(period * np.arange(4000), digits), np.arange(4000)
    q, u = 0.1 * np.sin(3e-3 * k), np.cos(3e-3 * k) + 0.1 * np.sin(0.3 * k)
    record = build(clock, q, q, u)
    assert record.period == pytest.approx(period, rel=1e-9)
    assert [message.code for message in record.warnings] == ["rounded-time"]
    there = k != 2000
    (said,) = build(clock[there], q[there], q[there], u[there]).warnings
    assert said.code == "irregular-time"


@pytest.mark.parametrize(("lost", "period"), [(np.arange(20, 380, 40), 1e-3), (np.arange(200, 400, 2), 1e-3)])
def test_a_clock_that_lost_samples_stays_the_clock(lost, period):
    """Each recorded sample keeps its value, and what lies between is interpolated, as is said."""
    kept = np.delete(np.arange(N), lost)
    record = build(T[kept], Q[kept], Q[kept], U[kept])
    (said,) = record.warnings
    assert said.code == "irregular-time"
    assert record.period == period
    np.testing.assert_allclose(record.q[kept], Q[kept], atol=1e-12)
    with pytest.raises(RecordError, match="found a step of 0.002 s, expected 0.001 s .* sampling must be uniform"):
        Record.from_arrays(T[kept], Q[kept], Q[kept], U[kept], layout=Layout(resample=False))
