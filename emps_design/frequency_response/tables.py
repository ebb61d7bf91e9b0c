"""Files of a frequency response: CSV, and MATLAB files with the same names.

A CSV has the columns ``frequency_hz, magnitude, phase_deg, coherence, std``; the first three are needed. A MATLAB file
(v5, that is ``save -v7`` or ``-v6``, and v7.3) has real arrays with these names; of an ``frd`` object ``sys`` they are

    [magnitude, phase_deg, w] = bode(sys); frequency_hz = w/(2*pi); magnitude = squeeze(magnitude); ...

since the object itself is stored in a form that MATLAB alone reads. Back: ``sys = frd(magnitude .* exp(1j*phase_deg
*pi/180), frequency_hz, 'FrequencyUnit', 'Hz')``.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from emps_design.errors import InputError, nearest_name, one_line
from emps_design.files import read_bytes, write_aside
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.records.matlab_v5 import is_v5, read_v5
from emps_design.records.matlab_v73 import is_v73, read_v73
from emps_design.records.tables import read_plain_table

COLUMNS = ("frequency_hz", "magnitude", "phase_deg", "coherence", "std")
NEEDED = COLUMNS[:3]
MAX_BYTES = 50_000_000
EXPECTED = "expected a frequency response, .csv or .mat"


def write_response(path: str | Path, response: FrequencyResponse) -> None:
    """Write ``response`` to ``path`` (.csv, or .mat in v5), whole or not at all.

    >>> import tempfile
    >>> f = np.array([1.0, 2.0, 3.0, 4.0])
    >>> path = Path(tempfile.mkdtemp()) / "mass.csv"
    >>> write_response(path, FrequencyResponse.of(f, 1.0 / (2j * np.pi * f), np.full(4, 0.02)))
    >>> read_response(path).std.tolist()
    [0.02, 0.02, 0.02, 0.02]
    """
    path = Path(path)
    if path.suffix not in (".csv", ".mat"):
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected .csv or .mat")
    columns = response.to_dict()
    with write_aside(path) as aside:
        if path.suffix == ".mat":
            from scipy.io import savemat

            with aside.open("wb") as file:
                savemat(file, {name: np.asarray(values)[:, None] for name, values in columns.items()})
        else:
            table = np.column_stack([columns[name] for name in COLUMNS])
            np.savetxt(aside, table, fmt="%.10g", delimiter=",", header=",".join(COLUMNS), comments="")


def read_response(path: str | Path) -> FrequencyResponse:
    """Read the response at ``path``; raises :class:`InputError` in one line for anything else."""
    path = Path(path)
    content = read_bytes(path, MAX_BYTES, EXPECTED)
    if is_v73(content[:4096]):
        columns = read_v73(io.BytesIO(content), str(path), MAX_BYTES)
    elif is_v5(content[:128]):
        columns = read_v5(io.BytesIO(content), str(path), MAX_BYTES)
    else:
        columns = read_plain_table(content, str(path), EXPECTED, NEEDED)
    columns = {name.lower(): np.ravel(values) for name, values in columns.items()}
    missing = [name for name in NEEDED if name not in columns]
    if missing:
        hint = nearest_name(missing[0], list(columns))
        raise InputError(
            f"{path}: missing {', '.join(missing)}, found {', '.join(columns) or 'nothing'}{hint}; {EXPECTED}, with "
            f"{', '.join(COLUMNS)}"
        )
    sizes = {columns[name].size for name in NEEDED}
    if len(sizes) > 1:
        raise InputError(
            f"{path}: found columns of {', '.join(map(str, sorted(sizes)))} numbers, expected as many each"
        )
    phase = np.radians(columns["phase_deg"].astype(float))
    response = columns["magnitude"].astype(float) * np.exp(1j * phase)
    try:
        return FrequencyResponse.of(
            columns["frequency_hz"], response, columns.get("std"), columns.get("coherence"), one_line(path.stem)
        )
    except InputError as error:
        raise InputError(f"{path}: {str(error).partition(': ')[2]}") from error
