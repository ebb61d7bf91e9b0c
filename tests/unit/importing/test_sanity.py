"""An export that cannot be of its axis is refused in one line that says why; what is odd is noted, nothing mended."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.errors import RecordError
from emps_design.importing import import_bytes
from emps_design.importing.account import Account, encoder_step
from emps_design.machines import machine
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
    record = synthetic_record(axis, laps=1)
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
            "columns q_ref and q: found ranges of 0.24 and 0.0002401 m, expected the same",
        ),
        (lambda c: {"q_ref": 1e-3 * c["q_ref"]}, r"a position that is 1000 times the reference \(mm for m"),
        (lambda c: {"q": 57.2958 * c["q"]}, r"times the reference \(deg for rad\?\)"),
        (
            lambda c: {"q": 1e-3 * c["q"], "q_ref": 1e-3 * c["q_ref"]},
            r"motion that (9|1)\S* times the mass of the axis would make under this command",
        ),
        (lambda c: {"q": -c["q"]}, "motion against the reference, expected along it; one of them needs sign = -1"),
        (lambda c: {"q": c["q_ref"], "q_ref": c["q"]}, "columns q and q_ref: .*; are they exchanged in .record.?"),
        (lambda c: {"q": c["u"], "u": c["q"]}, "q and u: found a position that is rougher than the command"),
        (lambda c: {"q_ref": c["u"], "u": c["q_ref"]}, "q_ref and u: found a command that the position follows"),
        (lambda c: {"u": 1e3 * c["u"]}, "column u: found 4516 V, expected at most 1000 V"),
        (
            lambda c: {"u": 1e2 * c["u"]},
            "column u: found up to 451.6, expected at most the limit of 10 in the axis file",
        ),
        (lambda c: {"u": 1e-3 * c["u"]}, "u and q: found force_gain x command 0.00.* times what mass and friction"),
        (lambda c: {"u": -c["u"]}, "column u: found a command against the motion it makes"),
        (lambda c: {"t": 1e3 * c["t"]}, "sampling period of 1 s"),
        (lambda c: {"t": 1e-3 * c["t"]}, "a speed of .* m/s, expected metres|period"),
    ],
)
def test_refused(axis, columns, change, message):
    with pytest.raises(RecordError, match=message) as caught:
        import_bytes(trace(columns, **change(columns)), "trace.csv", axis)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("trace.csv: ")


def test_exchanged_position_and_reference_are_seen_without_an_encoder(axis, columns):
    blind = axis.replace(sampling={"encoder_resolution": 0.0})
    import_bytes(trace(columns), "trace.csv", blind)
    exchanged = trace(columns, q=columns["q_ref"], q_ref=columns["q"])
    with pytest.raises(RecordError, match="q and q_ref: found a reference that explains the command better"):
        import_bytes(exchanged, "trace.csv", blind)


def test_a_missing_tenth_of_a_second_is_named_whether_time_tells_it_or_not(axis, columns):
    moving = int(np.argmax(np.abs(np.diff(columns["q"])))) - 50
    cut = {name: without(values, moving, moving + 100) for name, values in columns.items()}
    at = cut["t"][moving - 1] / 1e3
    with pytest.raises(
        RecordError, match=rf"column t, row {moving + 2}: nothing from {at:.6g} s to {at + 0.101:.6g} s"
    ):
        import_bytes(trace(cut), "trace.csv", axis)
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


def test_no_step_is_seen_where_there_is_none():
    t = np.arange(5000) / 1000
    assert encoder_step(np.sin(t) + 1e-5 * np.random.default_rng(0).standard_normal(t.size)) is None
    assert encoder_step(np.zeros(100)) is None
