"""Read a reference of one's own, .csv or .npz: ``t`` [s], ``q_ref`` [m], optional ``f_ext`` [N], ``excitation`` [V]."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from emps_design.errors import InputError, RecordError
from emps_design.files import read_bytes
from emps_design.records.archives import read_archive
from emps_design.records.columns import PLAIN, read_title
from emps_design.records.layout import LONGEST
from emps_design.records.tables import read_plain_table
from emps_design.units import Units

MAX_BYTES = 100_000_000
MAX_SAMPLES = LONGEST


def read_reference(
    path: str | Path, period: float, units: Units = PLAIN
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Return ``q_ref`` (n,) [m], ``f_ext`` (n,) [N] or None and ``excitation`` (n,) [V] or None.

    They are interpolated at multiples of ``period`` [s]; an excitation is held from one row to the next.
    ``units`` are those of the axis.
    Raises :class:`RecordError` in one line for a file that has no such columns, is not finite, or runs back in time.
    """
    try:
        content = read_bytes(Path(path), MAX_BYTES, "expected a .csv or .npz reference")
    except InputError as error:
        raise RecordError(str(error)) from error
    return reference_from_bytes(content, str(path), period, units)


def reference_from_bytes(
    content: bytes, name: str, period: float, units: Units = PLAIN
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    r"""Return what :func:`read_reference` does, from the ``content`` of a file called ``name``.

    >>> reference_from_bytes(b"t,q_ref [mm]\n0,0\n0.2,4\n", "way.csv", 0.1)[0].tolist()
    [0.0, 0.002, 0.004]
    """
    if content[:2] == b"PK":
        columns = read_archive(io.BytesIO(content), name, MAX_BYTES)
    else:
        columns = read_plain_table(content, name, "expected columns t, q_ref (.csv or .npz)")
    named = {}
    for text, values in columns.items():
        title = read_title(text, name, units)
        if title.name in ("t", "q_ref", "f_ext", "excitation"):
            named[title.name] = np.ravel(np.asarray(values)).astype(float) * title.factor
    missing = [column for column in ("t", "q_ref") if column not in named]
    if missing:
        raise RecordError(f"{name}: missing column {', '.join(missing)}; found {', '.join(columns)}; expected t, q_ref")
    t = named["t"]
    for column, values in named.items():
        if values.size != t.size or t.size < 2:
            raise RecordError(
                f"{name}: column {column}: found {values.size} samples, expected {max(2, t.size)} as in t"
            )
        if not np.isfinite(values).all():
            raise RecordError(f"{name}: column {column}: sample {int(np.argmin(np.isfinite(values)))} is not finite")
    if not (np.diff(t) > 0).all():
        raise RecordError(
            f"{name}: column t: sample {int(np.argmin(np.diff(t) > 0)) + 1} is not later than the one before"
        )
    n = int(np.floor((t[-1] - t[0]) / period * (1 + 1e-12))) + 1
    if not 2 <= n <= MAX_SAMPLES:
        raise RecordError(f"{name}: {t[-1] - t[0]:g} s at {period:g} s are {n} samples, expected 2 to {MAX_SAMPLES}")
    grid = t[0] + np.arange(n) * period
    force = np.interp(grid, t, named["f_ext"]) if "f_ext" in named else None
    held = np.searchsorted(t, grid + 1e-6 * period, side="right") - 1
    excitation = named["excitation"][held] if "excitation" in named else None
    return np.interp(grid, t, named["q_ref"]), force, excitation
