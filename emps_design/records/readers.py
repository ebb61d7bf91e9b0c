"""Read a record from a file, by its suffix and its first bytes, which must agree."""

from __future__ import annotations

import hashlib
import io
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from emps_design.errors import InputError, RecordError, one_line
from emps_design.messages import Message, note
from emps_design.records.archives import is_v5, is_v73, read_archive, read_v5, read_v73
from emps_design.records.check import CUT, PLAIN, SHORTEST, check_columns
from emps_design.records.columns import NAMES, RECORD, column_titles
from emps_design.records.layout import NAMED, Layout, assign
from emps_design.records.record import MEASURED, Record
from emps_design.records.tables import read_table, table_titles

MAX_BYTES = 250_000_000  # of a file, and again of its unpacked content: two hours at 1 kHz
MAX_BYTES_TO_CUT = 3 * MAX_BYTES  # of a file from which a part is read

HEAD = 4096  # bytes that identify the kind of a file

_KINDS = {".mat": "MATLAB v5 or v7.3 file", ".npz": "NumPy archive", ".csv": "text table"}
_TEXT = (".csv", ".txt", ".tsv")


def read_record(path: str | Path, max_bytes: int = MAX_BYTES, layout: Layout = PLAIN) -> Record:
    """Read and check the record at ``path`` (.mat v5 or v7.3, .csv, .npz).

    Columns: ``t`` [s], ``q_ref`` [m], ``q`` [m], ``u`` [V], optional ``f_ext`` [N]; the EMPS names ``t qg qm vir`` are
    known too, and a title may have a unit (``q [mm]``). ``max_bytes`` limits the file and its unpacked content;
    :func:`emps_design.importing.import_record` passes the ``layout`` of an axis file. Nothing in a file is executed or
    unpickled. Raises :class:`RecordError`, one line with the file, the place, what was found and expected, and a
    remedy.
    """
    path = Path(path)
    with _open(path, max_bytes) as file:
        return _read(file, path.name, str(path), max_bytes, layout)


@contextmanager
def _open(path: Path, max_bytes: int) -> Iterator[BinaryIO]:
    """The ordinary file at ``path``, open for reading."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise RecordError(f"{path}: is a folder, expected a .mat, .csv or .npz record")
        if not stat.S_ISREG(status.st_mode):
            raise RecordError(f"{path}: is not an ordinary file, expected a .mat, .csv or .npz record")
        _refuse_large(status.st_size, str(path), max_bytes)
        with path.open("rb") as file:
            yield file
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise RecordError(f"{path}: {reason}; expected a .mat, .csv or .npz record") from error


def read_titles(path: str | Path) -> list[str]:
    """The titles of the columns, or names of the arrays, of the file at ``path``; raises :class:`RecordError`."""
    with _open(Path(path), MAX_BYTES) as file:
        return _titles(file, Path(path).name, str(path))


def titles_from_bytes(content: bytes, name: str) -> list[str]:
    """The titles of the columns in the ``content`` of a file called ``name``.

    >>> titles_from_bytes(b"a comment\\nt [ms];q;u\\n0;1;2\\n1;1;3\\n2;1;4", "a.csv")
    ['t [ms]', 'q', 'u']
    """
    _refuse_large(len(content), name, MAX_BYTES)
    return _titles(io.BytesIO(content), name, name)


def _titles(file: BinaryIO, name: str, source: str) -> list[str]:
    head, kind = _head_and_kind(file, name, source)
    if kind == ".csv":
        return table_titles(file, source)
    return [key for key, values in _arrays(file, kind, head, source, MAX_BYTES).items() if np.size(values) > 1]


def record_from_bytes(
    content: bytes, name: str, source: str | None = None, max_bytes: int = MAX_BYTES, layout: Layout = PLAIN
) -> Record:
    """Read a record from the ``content`` of a file called ``name``, ``source`` in messages.

    >>> table = "t;q_ref [mm];q [mm];u\\n" + "\\n".join(f"{k / 1000:.3f};{k};{k};1.{k:02d}" for k in range(60))
    >>> record = record_from_bytes(table.encode(), "small.csv")
    >>> record.period, round(float(record.q[-1]), 9), record.warnings
    (0.001, 0.059, ('q_ref: converted from mm to m', 'q: converted from mm to m'))
    """
    source = source or name
    _refuse_large(len(content), source, max_bytes)
    return _read(io.BytesIO(content), name, source, max_bytes, layout)


def _read(file: BinaryIO, name: str, source: str, max_bytes: int, layout: Layout) -> Record:
    """Read the open ``file`` in pieces: it is never in memory as a whole."""
    head, kind = _head_and_kind(file, name, source)
    digest = hashlib.file_digest(cast(Any, file), "sha256").hexdigest()
    file.seek(0)
    columns: dict[str, np.ndarray]
    notes: tuple[Message, ...]
    if kind == ".csv":
        table = read_table(file, source, lambda titles: _needed(titles, layout, source), layout.longest)
        columns, first_row, notes = table.columns, table.first_row, table.notes
    else:
        columns, first_row, notes = _arrays(file, kind, head, source, max_bytes), 0, ()
    measured = {key: columns.pop(key) for key in list(columns) if key.startswith(MEASURED)}
    assigned = assign(list(columns), layout, source)
    unmapped = all(assignment.how == NAMED for assignment in assigned)
    if columns.pop(RECORD, None) is None and layout.columns.named and unmapped:
        text = "read by the names of a record: it has none of the columns that [record] maps"
        notes = (*notes, note("read-by-names", text))
    signals = check_columns(columns, source, first_row, layout=layout, assigned=assigned)
    if measured:
        signals["measured"] = {key.removeprefix(MEASURED): values for key, values in measured.items()}
    signals["assigned"] = tuple(
        assignment for assignment in assigned if assignment.name != "q_ref" or signals["q_ref_recorded"]
    )
    signals["warnings"] = (*notes, *signals["warnings"])
    return Record(name=one_line(Path(name).stem), sha256=digest, **signals)


def _needed(titles: Sequence[str], layout: Layout, source: str) -> list[str]:
    """The ``titles`` of the columns of a text table to read."""
    marks = [title for title in titles if title == RECORD]
    return [assignment.title for assignment in assign(titles, layout, source)] + marks


def _head_and_kind(file: BinaryIO, name: str, source: str) -> tuple[bytes, str]:
    """The first bytes of ``file`` and its kind; raises :class:`RecordError` where the kind differs from its suffix."""
    head = file.read(HEAD)
    if not head.strip():
        raise RecordError(f"{source}: is empty, expected a .mat, .csv or .npz record")
    suffix = Path(name).suffix.lower()
    kind = _kind(head)
    expected = ".csv" if suffix in _TEXT else suffix if suffix in _KINDS else kind
    if kind != expected:
        text = "something else" if b"\0" in head else "text"
        found = text if kind == ".csv" else f"a {_KINDS[kind]}"
        raise RecordError(
            f"{source}: found {found}, expected a {_KINDS[expected]} as its name says"
            f"{'; save it with save -v7' if expected == '.mat' else ''}"
        )
    file.seek(0)
    return head, kind


def _arrays(file: BinaryIO, kind: str, head: bytes, source: str, max_bytes: int) -> dict[str, np.ndarray]:
    """The arrays of a binary file by name, those of a matrix by name and place."""
    if kind == ".npz":
        return _columns(read_archive(file, source, max_bytes))
    reader = read_v5 if is_v5(head) and not is_v73(head) else read_v73
    return _columns({n: v for n, v in reader(file, source, max_bytes).items() if not n.startswith("__")})


def _columns(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``arrays`` with each matrix split into vectors along its longer side.

    >>> sorted(_columns({"data": np.zeros((60, 2)), "gain": np.eye(3)}))
    ['data:0', 'data:1', 'gain']
    """
    columns: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        shape = values.shape
        if name in NAMES or len(shape) != 2 or not 2 <= min(shape) < max(shape) >= SHORTEST:
            columns[name] = values
            continue
        vectors = values if shape[1] > shape[0] else values.T
        columns |= dict(zip(column_titles(name, min(shape)), vectors, strict=True))
    return columns


def _kind(head: bytes) -> str:
    if head[:4] == b"PK\x03\x04":
        return ".npz"
    return ".mat" if is_v73(head) or is_v5(head) else ".csv"


def _refuse_large(size: int, source: str, max_bytes: int) -> None:
    if size > max_bytes:
        raise RecordError(f"{source}: found more than {max_bytes / 1e6:g} MB, expected at most that; {CUT}")
