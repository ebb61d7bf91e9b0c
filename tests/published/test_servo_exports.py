"""The exports of servo drives and the measured records of other machines: all are read, and to the drive's rounding."""

from pathlib import Path

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.importing import import_record
from tests.conftest import DATA
from tests.studies import quick

FOLDERS = sorted(path.parent for path in DATA.glob("servo/*/axis.toml"))
FEW = [folder for folder in FOLDERS if "-none-" in folder.name] + FOLDERS[::5]
REAL = sorted(DATA.glob("real/*/*.npz"))
LAST_DIGIT = {"gantry": (1e-7, 1e-3), "joint": (1e-6, 1e-4)}  # of position [mm, deg] and command [%, A] in the file


def raw(path: Path, machine: str) -> dict[str, np.ndarray]:
    """The columns of an export by a reader of its own: the numbers as the file has them."""
    lines = path.read_text(encoding="cp1252").splitlines()
    start = next(i for i, line in enumerate(lines) if line[:4] in ("Zeit", "time"))
    between = ";" if machine == "gantry" else ","
    titles = [title.partition(" [")[0] for title in lines[start].split(between)]
    cells = (line.replace(",", ".") if between == ";" else line for line in lines[start + 1 :])
    table = np.loadtxt(cells, delimiter=between)
    return dict(zip(titles, table.T, strict=True))


@pytest.mark.skipif(not FOLDERS, reason="the servo exports are not beside the repository")
@pytest.mark.parametrize("folder", quick(FOLDERS, FEW.__contains__, "other exports"), ids=lambda folder: folder.name)
def test_a_servo_export_is_read_to_its_last_digit(folder):
    axis, machine = Axis.load(folder / "axis.toml"), folder.name.partition("-")[0]
    names = {"gantry": ("Lageistwert", "Lagesollwert", "Momentensollwert"), "joint": ("pos_deg", "ref_deg", "cmd_A")}
    unit = {"gantry": 1e-3, "joint": np.pi / 180}[machine]
    for part in ("train", "holdout") if "-none-" in folder.name else ("holdout",):  # written by one program
        record = import_record(folder / f"{part}.csv", axis)
        columns = raw(folder / f"{part}.csv", machine)
        assert record.period == axis.sampling.period
        assert record.warnings == ()
        signals = (record.q, record.q_ref, record.u)
        for values, name, factor in zip(signals, names[machine], (unit, unit, 1.0), strict=True):
            np.testing.assert_allclose(values, columns[name] * factor, rtol=1e-14)
    with np.load(folder / "scorer.npz") as truth:
        force = truth["force"]
    half = 0.5 * LAST_DIGIT[machine][1] * axis.drive.force_gain
    assert np.max(np.abs(force - axis.drive.force_gain * record.u)) <= half * (1 + 1e-9)
    again = Axis.from_toml(axis.to_toml())
    assert again == axis


@pytest.mark.skipif(not REAL, reason="the measured records of other machines are not beside the repository")
@pytest.mark.parametrize("path", REAL, ids=lambda path: path.stem)
def test_a_measured_record_is_read_on_its_axis_s_clock(path, tmp_path):
    axis = Axis.load(DATA / "real" / ("xl330.toml" if path.parent.name == "xl330" else "odri.toml"))
    record = import_record(path, axis)
    with np.load(path) as file:
        arrays = dict(file)
    assert record.period == axis.sampling.period
    assert np.array_equal(record.measured["t"], arrays["t"])
    command = arrays["duty" if path.parent.name == "xl330" else "i"]
    assert np.array_equal(record.measured["u"], command)
    assert any("resampled at" in note for note in record.warnings)
    if path.parent.name == "xl330":
        assert float(record.extra["kp"]) == float(arrays["kp"])
        assert set(np.unique(record.enable)) <= {0.0, 1.0}
    record.save(tmp_path / "a.npz")
    again = import_record(tmp_path / "a.npz", axis)
    assert all(np.array_equal(again.columns[name], values) for name, values in record.columns.items())
    if path.parent.name == "xl330":
        assert float(again.extra["kp"]) == float(arrays["kp"])
