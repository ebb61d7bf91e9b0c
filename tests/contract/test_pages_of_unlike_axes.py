"""Every page on a light and fast, a heavy and slow, and the embedded axis: no library warns of anything on the way.

Warnings are errors here, so that one ends the command with another exit status.
"""

import dataclasses

import pytest

from benchmarks.coverage_axes import CASES, Records
from emps_design.cli import app
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

# Axis and, for it: crossover [rad/s], k_e1 [(m/s)/N], wall [N/m], apparent mass [kg] and damping [N/(m/s)].
AXES = {
    "0.6 kg, 4 kHz": (CASES[1], "100", "0.1", "1e3", "0.4", "3"),
    "20 t, 100 Hz": (CASES[7], "2", "1e-5", "1e5", "1.5e4", "1e4"),
    "emps": (None, "100", "0.005", "1e4", "80", "200"),
}
LINES = {
    "identify": "identify {record} --axis {axis}",
    "report": "report {axis} --record {record} --crossover {crossover} --k-e1 {k_e1} --environment {wall} "
    "--mass {mass} --damping {damping} --out {out}/report.html",
}


def in_kilovolts(records):
    """The axis of ``records`` and its first one, with a thousand times the force gain: no drive has 10 kV."""
    axis, record, gains = records.axis, records(1), records.axis.controller.parameters
    drive = {"force_gain": 1e3 * axis.drive.force_gain, "command_limit": 1e-3 * axis.drive.command_limit}
    controller = {"kind": axis.controller.kind, "kp": gains["kp"], "kv": 1e-3 * gains["kv"]}
    return axis.replace(drive=drive, controller=controller), dataclasses.replace(record, u=1e-3 * record.u)


@pytest.fixture(scope="module", params=AXES)
def given(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("unlike")
    case, *numbers = AXES[request.param]
    if case is None:
        axis = machine("emps2019")
        record = synthetic_record(axis, laps=1, stroke=0.1)
    else:
        axis, record = in_kilovolts(Records(case))
    (folder / "axis.toml").write_text(axis.to_toml())
    record.save(folder / "record.npz")
    names = dict(zip(("crossover", "k_e1", "wall", "mass", "damping"), numbers, strict=True))
    return {**names, "axis": folder / "axis.toml", "record": folder / "record.npz", "out": folder}


@pytest.mark.parametrize("name", ["identify", pytest.param("report", marks=pytest.mark.study("three whole reports"))])
def test_no_library_warns(name, given, capsys):
    status = app.run(LINES[name].format(**given).split())
    err = capsys.readouterr().err
    assert status in (0, 4), err
    assert all(line.startswith("emps-design: ") for line in err.splitlines()), err
    if name == "report":
        assert (given["out"] / "report.html").read_text().rstrip().endswith("</html>")
