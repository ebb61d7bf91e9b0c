"""Every format gives the same record; what is not a record is refused in one line that says why."""

import io
import os
import re
import zipfile

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from emps_design.errors import RecordError
from emps_design.records import Record, read_record, record_from_bytes
from emps_design.records.layout import ColumnMap, Layout

N = 200
T = np.arange(N) * 1e-3
Q_REF = 0.1 * np.sin(6 * T)
Q = Q_REF - 1e-5
U = np.cos(6 * T) + 0.1 * np.sin(200 * T)
COLUMNS = {"t": T, "q_ref": Q_REF, "q": Q, "u": U}
EMPS = {"t": T[:, None], "qg": Q_REF[:, None], "qm": Q[:, None], "vir": U[:, None], "gtau": 35.15, "kp": 160.0}


def same(record: Record) -> bool:
    return record.period == 1e-3 and all(
        np.allclose(getattr(record, name), COLUMNS[name], atol=1e-12) for name in COLUMNS
    )


def write_h5(path, userblock=512, **columns):
    with h5py.File(path, "w", userblock_size=userblock) as file:
        for name, values in columns.items():
            file.create_dataset(name, data=np.atleast_2d(values).T if np.ndim(values) == 1 else values)


def table(delimiter=",", header="t,q_ref,q,u", decimal=".", factor=1.0) -> bytes:
    rows = [header.replace(",", delimiter)]
    samples = zip(T, Q_REF * factor, Q * factor, U, strict=True)
    rows.extend(delimiter.join(f"{x:.15g}".replace(".", decimal) for x in sample) for sample in samples)
    return "\n".join(rows).encode()


def test_mat_v5(tmp_path):
    savemat(tmp_path / "a.mat", EMPS)
    savemat(tmp_path / "b.mat", EMPS, do_compression=True)
    record = read_record(tmp_path / "a.mat")
    assert same(record)
    assert same(read_record(tmp_path / "b.mat"))
    assert float(np.ravel(record.extra["gtau"])[0]) == 35.15
    assert len(record.sha256) == 64


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("kind", ["v5", "v7.3", "npz"])
def test_a_matrix_is_mapped_by_place(tmp_path, kind, flat):
    """However it lies in the file; without a mapping the message says how to name its columns."""
    table = np.column_stack([1e3 * T, Q, Q_REF, U])
    table = table.T if flat else table
    path = tmp_path / ("a.npz" if kind == "npz" else "a.mat")
    if kind == "npz":
        np.savez(path, data=table, Ts=1e-3)
    elif kind == "v5":
        savemat(path, {"data": table, "Ts": 1e-3, "gain": np.eye(3)})
    else:
        write_h5(path, data=table, Ts=1e-3)
    keys = {"time": {"unit": "ms"}, "position": {}, "reference": {}, "command": {}}
    columns = {key: {"column": f"data:{k}", **more} for k, (key, more) in enumerate(keys.items())}
    assert same(read_record(path, layout=Layout(columns=ColumnMap.model_validate(columns))))
    with pytest.raises(RecordError, match=r'missing column t, .*data:0, data:1.*position = . column = "data:1"'):
        read_record(path)


@pytest.mark.parametrize("userblock", [0, 512])
def test_mat_v73(tmp_path, userblock):
    write_h5(tmp_path / "a.mat", userblock, t=T, qg=Q_REF, qm=Q, vir=U)
    assert same(read_record(tmp_path / "a.mat"))


def test_npz_and_f_ext(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", **COLUMNS, f_ext=np.ones(N))
    record = read_record(tmp_path / "a.npz")
    assert same(record)
    assert record.f_ext.sum() == N
    assert record.warnings == ("f_ext: constant at 1 N",)


@pytest.mark.parametrize(
    ("content", "notes"),
    [
        (table(), 0),
        (table(";"), 0),
        (table("\t"), 0),
        (table(";", decimal=","), 0),
        (table("\t", decimal=","), 0),
        (table(header="t [s],q_ref [m],q [m],u [V]"), 0),
        (table(";", header="t (s),qg (mm),qm (mm),vir (V)", decimal=",", factor=1000.0), 2),
        (table(header="t/s,qg/um,qm/um,vir/V", factor=1e6), 2),
        (b"\xef\xbb\xbf" + table(), 0),
        (table().decode().encode("utf-16"), 0),
        (b"# measured on a Friday\n\n" + table() + b"\n\n", 0),
        (table().replace(b"\n", b"\r\n"), 0),
        (table(header="T,Q_REF,Q,U"), 0),
        (b"\n".join(line + b",comment" for line in table().split(b"\n")), 0),
    ],
)
def test_tables(content, notes):
    record = record_from_bytes(content, "a.csv")
    assert same(record)
    assert len(record.warnings) == notes
    assert all("converted" in note for note in record.warnings)


def test_quoted_cells_and_a_late_decimal_comma():
    lines = table(";").decode().splitlines()
    lines[150] = ";".join(f'"{cell}"' for cell in lines[150].replace(".", ",").split(";"))
    assert same(record_from_bytes("\n".join(lines).encode(), "a.csv"))


def test_the_measured_records_pass_without_a_word(emps_data):
    for name in ("DATA_EMPS", "DATA_EMPS_PULSES"):
        record = read_record(emps_data / f"{name}.mat")
        assert record.period == 1e-3
        assert len(record) == 24841
        assert record.warnings == ()


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_saved_and_read_again(tmp_path, suffix):
    record = Record.from_arrays(1e-3, Q_REF, Q, U, f_ext=np.sin(T))
    record.save(tmp_path / f"a.{suffix}")
    record.save(tmp_path / f"b.{suffix}")
    again = read_record(tmp_path / f"a.{suffix}")
    assert all(np.array_equal(again.columns[name], values) for name, values in record.columns.items())
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
    assert again.to_dict()["samples"] == N


def test_save_refuses_other_suffixes(tmp_path):
    with pytest.raises(ValueError, match=r"found suffix '\.mat', expected \.npz or \.csv"):
        Record.from_arrays(1e-3, Q_REF, Q, U).save(tmp_path / "a.mat")


def npz(**columns) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **columns)
    return stream.getvalue()


def repacked(content: bytes, change) -> bytes:
    """An archive of which every member went through ``change``."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            new.writestr(name, change(old.read(name)))
    return out.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"", r"a\.csv: is empty"),
        ("a.mat", b"t,q\n1,2\n", r"a\.mat: found text, expected a MATLAB v5 or v7\.3 file"),
        ("a.mat", b"\0\1\2\3" * 99, r"a\.mat: found something else, expected a MATLAB"),
        ("a.npz", b"t,q\n1,2\n", r"found text, expected a NumPy archive"),
        ("a.csv", npz(**COLUMNS), r"found a NumPy archive, expected a text table as its name says"),
        ("a.csv", b"# only words\n", r"found no rows"),
        ("a.csv", b"t,q_ref,q,u\n", r"found a header and no samples"),
        ("a.csv", b"1,2,3,4\n5,6,7,8", r"row 1: found numbers, expected a header"),
        ("a.csv", b"\x81\x8d\xfbtq", r"byte 0: not cp1252 text"),
        ("a.csv", b"t,q\0", r"found binary data, expected a text table"),
        ("a.csv", table(header="t,q_ref,q,v"), r"missing column u; found t, q_ref, q, v; expected"),
        ("a.csv", table(header="t,qg,q_ref,u"), r"columns 'qg' and 'q_ref' both stand for q_ref"),
        (
            "a.csv",
            table(header="t,qg,q [ell],u"),
            r"column 'q \[ell\]': linear position: found unit 'ell', expected m, cm",
        ),
        (
            "a.csv",
            table().replace(b"\n0.002,", b"\n0.002,x"),
            r"row 4, column 'q_ref': found 'x0\..*', expected a number",
        ),
        ("a.csv", table().replace(b"\n0.003,", b"\n\n0.003,"), r"column t, row 5: found nan"),
        ("a.csv", table().replace(b"\n0.003,", b"\n,"), r"column t, row 5: found nan"),
        ("a.npz", npz(**{**COLUMNS, "q": np.array(["a"] * N)}), r"column 'q': found <U1 values, expected real numbers"),
        ("a.npz", npz(**{**COLUMNS, "q": np.ones((N, 2))}), r"column 'q': found shape \(200, 2\)"),
        ("a.npz", npz(**{**COLUMNS, "q": Q[:-1]}), r"column q: found 199 samples, expected 200"),
        ("a.npz", npz(**COLUMNS)[:900], r"damaged \.npz archive"),
        (
            "a.npz",
            repacked(npz(**COLUMNS), lambda data: data[:-8]),
            r"found 1592 bytes of data, expected shape \(200,\)",
        ),
        ("a.npz", npz(**{**COLUMNS, "q": np.array([None] * N)}), r"found pickled objects, .* never unpickled"),
    ],
)
def test_refused(name, content, message):
    with pytest.raises(RecordError, match=message) as caught:
        record_from_bytes(content, name)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


def test_pickles_are_not_run(tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    trapped = np.empty(N, dtype=object)
    trapped[:] = [Trap() for _ in range(N)]
    with pytest.raises(RecordError, match="never unpickled"):
        record_from_bytes(npz(**{**COLUMNS, "q": trapped}), "a.npz")
    assert not (tmp_path / "sprung").exists()


def test_bombs_are_not_unpacked(tmp_path):
    bomb = {**COLUMNS, "zeros": np.zeros(2_000_000)}
    np.savez_compressed(tmp_path / "a.npz", **bomb)
    savemat(tmp_path / "a.mat", bomb, do_compression=True)
    with h5py.File(tmp_path / "b.mat", "w") as file:
        for name, values in COLUMNS.items():
            file[name] = values
        file.create_dataset("hole", shape=(10**12,), dtype=float, chunks=(1000,))
    for name, message in (
        ("a.npz", "bytes unpacked, expected at most 1000000"),
        ("a.mat", "more than 1000000 bytes unpacked"),
        ("b.mat", "more than 1000000 bytes of arrays"),
    ):
        with pytest.raises(RecordError, match=message):
            read_record(tmp_path / name, max_bytes=1_000_000)


def test_a_matlab_array_has_as_many_values_as_its_shape_says(tmp_path):
    savemat(tmp_path / "a.mat", {"table": np.ones((7, 5))})
    content = (tmp_path / "a.mat").read_bytes()
    shape, larger = (np.array(rows_and_columns, dtype="<i4").tobytes() for rows_and_columns in ((7, 5), (8, 5)))
    assert content.count(shape) == 1
    (tmp_path / "a.mat").write_bytes(content.replace(shape, larger))
    with pytest.raises(RecordError, match=r"an array of shape \(8, 5\) has 35 values"):
        read_record(tmp_path / "a.mat")


def test_no_link_leaves_the_file(tmp_path):
    write_h5(tmp_path / "other.mat", 0, u=U)
    with h5py.File(tmp_path / "a.mat", "w") as file:
        for name in ("t", "q_ref", "q"):
            file[name] = COLUMNS[name]
        file["u"] = h5py.ExternalLink(str(tmp_path / "other.mat"), "u")
    with pytest.raises(RecordError, match="missing column u"):
        read_record(tmp_path / "a.mat")


def test_no_data_outside_the_file(tmp_path):
    (tmp_path / "raw").write_bytes(U.tobytes())
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file.create_dataset("u", shape=(N,), dtype=float, external=[(str(tmp_path / "raw"), 0, 8 * N)])
    with pytest.raises(RecordError, match="column 'u': found data kept outside the file"):
        read_record(tmp_path / "a.mat")


def test_mat_of_cells_and_structs_has_no_columns(tmp_path):
    savemat(tmp_path / "a.mat", {"t": {"inner": T}, "word": "q_ref"})
    with pytest.raises(RecordError, match="missing column t, q_ref, q, u; found none"):
        read_record(tmp_path / "a.mat")


@pytest.mark.parametrize("name", ["a.mat", "b.mat"])
def test_damaged_mat(tmp_path, name):
    if name == "a.mat":
        savemat(tmp_path / name, EMPS)
    else:
        write_h5(tmp_path / name, 512, t=T, qg=Q_REF, qm=Q, vir=U)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: len(content) * 3 // 5])
    with pytest.raises(RecordError, match=rf"{name}: damaged MATLAB"):
        read_record(tmp_path / name)


def test_paths(tmp_path):
    with pytest.raises(RecordError, match="is a folder, expected"):
        read_record(tmp_path)
    with pytest.raises(RecordError, match="No such file or directory; expected a"):
        read_record(tmp_path / "none.csv")
    with pytest.raises(RecordError, match="null"):
        read_record("a\0b.csv")
    with pytest.raises(RecordError, match="is not an ordinary file"):
        read_record("/dev/zero")
    (tmp_path / "a.csv").write_bytes(table())
    with pytest.raises(RecordError, match=re.escape("found more than 0.001 MB, expected at most that")):
        read_record(tmp_path / "a.csv", max_bytes=1000)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_unreadable(tmp_path):
    (tmp_path / "a.csv").write_bytes(table())
    (tmp_path / "a.csv").chmod(0)
    with pytest.raises(RecordError, match="Permission denied"):
        read_record(tmp_path / "a.csv")


def test_too_many_rows(monkeypatch):
    monkeypatch.setattr("emps_design.records.layout.LONGEST", 100)
    with pytest.raises(RecordError, match="found more than 100 rows"):
        record_from_bytes(table(), "a.csv")


def test_tables_are_read_block_by_block(monkeypatch):
    """Blocks leave no trace: the same samples, the same rows in messages, blank rows at the end only."""
    monkeypatch.setattr("emps_design.records.tables.BLOCK", 7)
    assert same(record_from_bytes(table(";", decimal=",") + b"\n" * 20, "a.csv"))
    with pytest.raises(RecordError, match=r"row 152, column 'q_ref': found 'x"):
        record_from_bytes(table().replace(b"\n0.15,", b"\n0.15,x"), "a.csv")
    with pytest.raises(RecordError, match=r"column t, row 152: found nan"):
        record_from_bytes(table().replace(b"\n0.15,", b"\n" * 20 + b"0.15,"), "a.csv")


def test_the_place_of_a_broken_character_is_that_in_the_file(monkeypatch):
    monkeypatch.setattr("emps_design.records.tables.HEAD", 1000)
    content = table()
    at = content.index(b"\n0.15,")
    with pytest.raises(RecordError, match=rf"byte {at + 1}: not utf-8 text"):
        record_from_bytes(content[: at + 1] + b"\xff" + content[at + 1 :], "a.csv")


def test_a_long_record_takes_little_more_than_its_samples(tmp_path):
    """The file is not in memory beside its columns, nor a column twice."""
    import tracemalloc

    n = 400_000
    t = np.arange(n) * 1e-3
    np.savez(tmp_path / "long.npz", t=t, q_ref=np.sin(t), q=np.sin(t) + 1e-6, u=np.cos(3 * t))
    tracemalloc.start()
    record = read_record(tmp_path / "long.npz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    samples = sum(column.nbytes for column in record.columns.values())
    assert peak < 2.3 * samples


def test_more_cells_than_titles_are_refused_unless_they_are_empty():
    def written(rows):
        return ("t,q_ref,q,u\n" + "\n".join(rows) + "\n").encode()

    rows = [f"{0.001 * k:.3f},{0.1 * k / 200},{0.0999 * k / 200},{0.1 * (k % 7)}" for k in range(200)]
    plain = record_from_bytes(written(rows), "a.csv")
    ended = record_from_bytes(written([f"{row}," for row in rows]), "a.csv")
    assert np.array_equal(plain.q, ended.q)
    rows[120] = rows[120].replace("0.120,", "0,120,", 1)
    with pytest.raises(RecordError, match=r"a.csv: row 122: found 5 cells under 4 titles"):
        record_from_bytes(written(rows), "a.csv")
