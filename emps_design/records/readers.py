"""Readers of .mat (v5, v7.3), .csv and .npz records. Nothing in a file is ever executed or unpickled."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.record import Record

ALIASES = {"t": "t", "qg": "q_ref", "q_ref": "q_ref", "qm": "q", "q": "q", "vir": "u", "u": "u", "f_ext": "f_ext"}
REQUIRED = ("t", "q_ref", "q", "u")


def read_record(path: str | Path) -> Record:
    """Read the record at ``path``; raises :class:`RecordError` in one line when it cannot be trusted."""
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}; expected a .mat, .csv or .npz record") from error
    columns = _read_npz(path) if path.suffix == ".npz" else _read_mat(path)
    named = {ALIASES[name]: np.ravel(value).astype(float) for name, value in columns.items() if name in ALIASES}
    missing = [name for name in REQUIRED if name not in named]
    if missing:
        raise RecordError(f"{path}: missing column {', '.join(missing)}; found {', '.join(columns)}")
    t = named["t"] - named["t"][0]
    period = float(np.median(np.diff(t)))
    period = float(f"{period:.3g}") if abs(period / float(f"{period:.3g}") - 1) < 1e-4 else period
    extra = {name: np.ravel(value) for name, value in columns.items() if name not in ALIASES}
    return Record(
        t=np.arange(t.size) * period,
        q_ref=named["q_ref"],
        q=named["q"],
        u=named["u"],
        f_ext=named.get("f_ext"),
        period=period,
        name=path.stem,
        sha256=hashlib.sha256(content).hexdigest(),
        extra=extra,
    )


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _read_mat(path: Path) -> dict[str, np.ndarray]:
    from scipy.io import loadmat

    return {name: value for name, value in loadmat(path).items() if not name.startswith("__")}
