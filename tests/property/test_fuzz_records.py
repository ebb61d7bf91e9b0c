"""Whatever bytes come in, a reader gives a checked record or refuses in one line: no other error, no hang, no flood.

A share of the inputs runs with the tests; `make fuzz` sets EMPS_DESIGN_FUZZ to 10,000 for each reader.
"""

import io
import resource
from contextlib import suppress

import h5py
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.io import savemat

from emps_design.errors import RecordError
from emps_design.records import Record, record_from_bytes
from emps_design.records.check import PLAIN
from emps_design.records.layout import ColumnMap, Layout
from emps_design.records.readers import titles_from_bytes
from emps_design.units import Units
from tests.property.fuzzing import fuzz

N = 60
MAX_BYTES = 20_000_000


def columns() -> dict[str, np.ndarray]:
    t = np.arange(N) * 1e-3
    return {"t": t, "q_ref": np.sin(9 * t), "q": np.sin(9 * t) + 1e-4, "u": np.cos(70 * t)}


def as_csv() -> bytes:
    rows = [";".join(columns()), *(";".join(f"{x:.6g}" for x in row) for row in zip(*columns().values(), strict=True))]
    return "\n".join(rows).encode()


def as_npz() -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **columns())
    return stream.getvalue()


def as_mat(compressed: bool) -> bytes:
    stream = io.BytesIO()
    savemat(stream, columns(), do_compression=compressed)
    return stream.getvalue()


def as_mat73() -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values in columns().items():
            file[name] = values
    return stream.getvalue()


def as_german() -> bytes:
    """An export with a preamble, a status of words, units and decimal commas."""
    head = [
        "Name;Aufzeichnung 4",
        "Startzeit;12.03.2026 08:14:22",
        "",
        "Zeit [ms];Ist [mm];Soll [mm];Moment [%];Status",
    ]
    rows = [";".join(f"{1e3 * x:.4f}" for x in row) + ";bereit" for row in zip(*columns().values(), strict=True)]
    return "\n".join([*head, *(row.replace(".", ",") for row in rows)]).encode("cp1252")


def as_scope() -> bytes:
    """A TwinCAT Scope export: two time columns, the second channel slower than the others."""
    t, q_ref, q, u = columns().values()
    head = [
        "Name\tProject",
        "",
        "Name\tActPos\tTorque\tName\tSetPos",
        "SampleTime[ms]\t1\t1\tSampleTime[ms]\t2",
        "Unit\tm (Length)\t% (Ratio)\tUnit\tm (Length)",
        "",
    ]
    slow = [f"{1e3 * a:g}\t{b:.6g}" for a, b in zip(t[::2], q_ref[::2], strict=True)] + ["\t"] * (N // 2)
    fast = [f"{1e3 * a:g}\t{b:.6g}\t{c:.6g}" for a, b, c in zip(t, q, u, strict=True)]
    return "\n".join([*head, *("\t".join(pair) for pair in zip(fast, slow, strict=True)), "EOF"]).encode()


EXPORTED = Layout(
    Units("linear", "torque", "%"),
    ColumnMap.model_validate(
        {
            "time": {"column": "Zeit", "unit": "ms"},
            "position": {"column": "Ist", "unit": "mm"},
            "reference": {"column": "Soll", "unit": "mm"},
            "command": {"column": "Moment"},
        }
    ),
    1e-3,
)
LAYOUTS = {"german": EXPORTED, "scope": Layout(EXPORTED.units, period=1e-3)}
GOOD = {
    "csv": ("a.csv", as_csv()),
    "csv-decimal-comma": ("a.csv", as_csv().replace(b".", b",")),
    "npz": ("a.npz", as_npz()),
    "mat-v5": ("a.mat", as_mat(False)),
    "mat-v5-compressed": ("a.mat", as_mat(True)),
    "mat-v7.3": ("a.mat", as_mat73()),
    "german": ("a.csv", as_german()),
    "scope": ("a.csv", as_scope()),
}


@pytest.fixture(autouse=True, scope="module")
def _memory_stays_below_a_gibibyte():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**20  # KiB


def check(content: bytes, name: str, layout: Layout = PLAIN) -> None:
    """A record that keeps its promises, or one line that names the file."""
    refusal = ""
    try:
        record = record_from_bytes(content, name, max_bytes=MAX_BYTES, layout=layout)
    except RecordError as error:
        refusal = str(error)
    if refusal:
        assert refusal.startswith(name)
        assert len(refusal.splitlines()) == 1
        return
    assert isinstance(record, Record)
    assert all(np.all(np.isfinite(values)) and values.size == len(record) for values in record.columns.values())
    assert np.all(np.diff(record.t) > 0)


@st.composite
def damaged(draw, content: bytes) -> bytes:
    """A good file with bytes changed, cut out, repeated or put in."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        how = draw(st.sampled_from(("change", "change", "change", "cut", "end", "repeat", "insert")))
        if how == "change":
            data[at : at + 1] = bytes([draw(st.integers(0, 255))])
        elif how == "cut":
            del data[at : at + draw(st.integers(1, 64))]
        elif how == "end":
            del data[at:]
        elif how == "repeat":
            data[at:at] = data[at : at + draw(st.integers(1, 200))]
        else:
            data[at:at] = draw(st.binary(min_size=1, max_size=16))
    return bytes(data)


@pytest.mark.parametrize("kind", GOOD)
def test_the_undamaged_file_is_read(kind):
    name, content = GOOD[kind]
    assert len(record_from_bytes(content, name, layout=LAYOUTS.get(kind, PLAIN))) in (N, N - 1)


@pytest.mark.parametrize("kind", GOOD)
@fuzz
@given(data=st.data())
def test_damaged_files(kind, data):
    name, content = GOOD[kind]
    check(data.draw(damaged(content)), name, LAYOUTS.get(kind, PLAIN))


@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.mat", "a"])
@fuzz
@given(content=st.binary(max_size=400))
def test_any_bytes(name, content):
    check(content, name)


@pytest.mark.parametrize("start", [b"PK\x03\x04", b"\x89HDF\r\n\x1a\n", b"MATLAB 5.0".ljust(124) + b"\0\1IM"])
@fuzz
@given(rest=st.binary(max_size=400))
def test_any_bytes_after_a_good_start(start, rest):
    check(start + rest, "a")


CELLS = st.one_of(
    st.floats().map(str),
    st.integers(-(10**30), 10**30).map(str),
    st.sampled_from(("", " ", "1,5", "1.5", '"', '"1,5"', "1e999", "nan", "-inf", "1_0", "0x10", "t", "q [mm]")),
    st.text(max_size=5),
)
TITLES = st.sampled_from(("t", "t [ms]", "q", "q_ref", "qm (mm)", "qg", "u", "u [mV]", "vir", "f_ext", "x", "", "q/um"))


@fuzz
@given(
    titles=st.lists(TITLES, max_size=7),
    rows=st.lists(st.lists(CELLS, max_size=7), max_size=8),
    delimiter=st.sampled_from(";,\t"),
    repeat=st.integers(1, 60),
)
def test_any_table(titles, rows, delimiter, repeat):
    lines = [delimiter.join(cells) for cells in rows] * repeat
    check("\n".join([delimiter.join(titles), *lines]).encode("utf-8", "surrogatepass"), "a.csv")


WORDS = st.sampled_from(
    ("Zeit", "Zeit [ms]", "Lageistwert [mm]", "Lagesollwert", "Set position [deg]", "act_pos_deg", "Torque [%]", "# t")
)


@fuzz
@given(
    preamble=st.lists(st.text(max_size=12), max_size=4),
    titles=st.lists(st.one_of(WORDS, TITLES, st.text(max_size=8)), max_size=6),
    rows=st.lists(st.lists(CELLS, max_size=6), max_size=6),
    delimiter=st.sampled_from(";,\t"),
    encoding=st.sampled_from(("utf-8", "utf-16", "cp1252")),
    layout=st.sampled_from((EXPORTED, LAYOUTS["scope"])),
)
def test_any_export(preamble, titles, rows, delimiter, encoding, layout):
    lines = [*preamble, delimiter.join(titles), *([delimiter.join(cells) for cells in rows] * 20)]
    content = "\n".join(lines).encode(encoding, "replace")
    check(content, "a.csv", layout)
    with suppress(RecordError):
        assert all(isinstance(title, str) for title in titles_from_bytes(content, "a.csv"))


ARRAYS = st.one_of(
    st.lists(st.floats(), max_size=80).map(np.array),
    st.integers(0, 200).map(lambda n: np.arange(n) / 1000),
    st.integers(0, 200).map(lambda n: np.sin(np.arange(n))),
    st.sampled_from((np.zeros((3, 3)), np.array("word"), np.array(1.0), np.array([True]), np.zeros(60, dtype="M8[s]"))),
)
NAMES = st.sampled_from(("t", "qg", "q_ref", "qm", "q", "vir", "u", "f_ext", "kp"))


@pytest.mark.filterwarnings("ignore::UserWarning")
@fuzz
@given(arrays=st.dictionaries(NAMES, ARRAYS, max_size=7))
def test_any_archive(arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    check(stream.getvalue(), "a.npz")


@fuzz
@given(
    changes=st.lists(
        st.tuples(st.sampled_from(("t", "q_ref", "q", "u", "f_ext")), st.integers(0, N - 1), st.floats()), max_size=6
    ),
    scale=st.sampled_from((1.0, 1e-200, 1e160, 1e308)),
    scaled=st.sampled_from(("t", "q_ref", "q", "u")),
)
def test_any_number_in_a_good_record(changes, scale, scaled):
    arrays = {**columns(), "f_ext": np.zeros(N)}
    arrays[scaled] = arrays[scaled] * scale
    for name, row, value in changes:
        arrays[name][row] = value
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    check(stream.getvalue(), "a.npz")
