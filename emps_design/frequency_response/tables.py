"""Files of a frequency response: CSV, and MATLAB files with the same names.

A CSV has the columns ``frequency_hz, magnitude, phase_deg, coherence, std``; the first three are needed. A MATLAB file
(v5, that is ``save -v7`` or ``-v6``, and v7.3) has real arrays with these names, or a structure with what an ``frd``
object ``sys`` holds, since the object itself is stored in a form that MATLAB alone reads:

    s = struct('ResponseData', sys.ResponseData, 'Frequency', sys.Frequency, 'FrequencyUnit', sys.FrequencyUnit);

What is written has both, the structure as ``response``. Back in MATLAB:

    sys = frd(response.ResponseData, response.Frequency, 'FrequencyUnit', response.FrequencyUnit);
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

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
RADIANS = {"": 1.0, "rad/s": 1.0, "rad/TimeUnit": 1.0, "Hz": 2.0 * np.pi, "kHz": 2e3 * np.pi, "rpm": np.pi / 30.0}
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
                arrays: dict[str, Any] = {name: np.asarray(values)[:, None] for name, values in columns.items()}
                arrays["response"] = {
                    "ResponseData": response.response[None, None],
                    "Frequency": response.frequency[:, None],
                    "FrequencyUnit": "Hz",
                    "Ts": 0.0,
                }
                savemat(file, arrays)
        else:
            table = np.column_stack([columns[name] for name in COLUMNS])
            np.savetxt(aside, table, fmt="%.10g", delimiter=",", header=",".join(COLUMNS), comments="")


def read_response(path: str | Path) -> FrequencyResponse:
    """Read the response at ``path``; raises :class:`InputError` in one line for anything else."""
    path = Path(path)
    content = read_bytes(path, MAX_BYTES, EXPECTED)
    if is_v73(content[:4096]):
        columns = read_v73(io.BytesIO(content), str(path), MAX_BYTES, structures=True)
    elif is_v5(content[:128]):
        columns = read_v5(io.BytesIO(content), str(path), MAX_BYTES, structures=True)
    else:
        columns = read_plain_table(content, str(path), EXPECTED, NEEDED)
    if not all(name in columns for name in NEEDED):
        columns = _of_frd(columns, path) or columns
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


def _of_frd(columns: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """The columns of the first structure that has the fields of an ``frd`` object; none where there is none."""
    name = next((name.removesuffix(".ResponseData") for name in columns if name.endswith(".ResponseData")), None)
    if name is None or f"{name}.Frequency" not in columns:
        return {}
    data, frequency = columns[f"{name}.ResponseData"], np.ravel(columns[f"{name}.Frequency"]).astype(float)
    if data.size != frequency.size:
        raise InputError(
            f"{path}: {name}: found {data.size} numbers in ResponseData, expected {frequency.size} as in Frequency: "
            "one input and one output"
        )
    unit = "".join(map(chr, np.ravel(columns.get(f"{name}.FrequencyUnit", np.zeros(0, int))).astype(int)))
    if unit not in RADIANS:
        known = ", ".join(repr(one) for one in RADIANS if one)
        raise InputError(f"{path}: {name}: found FrequencyUnit {unit!r}, expected one of {known}")
    response = np.ravel(data)
    return {
        "frequency_hz": frequency * RADIANS[unit] / (2.0 * np.pi),
        "magnitude": np.abs(response),
        "phase_deg": np.degrees(np.angle(response)),
    }
