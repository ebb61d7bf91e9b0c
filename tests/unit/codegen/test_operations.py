"""Operations counted in the translated code, and gains under the names that drives give them."""

import json

import pytest

from emps_design.cli import app
from emps_design.codegen import export_controller
from emps_design.codegen.program import ARRAY, INT, REAL
from emps_design.codegen.reader import read_program
from emps_design.codegen.targets import SETTINGS, drive_settings, gains_of
from emps_design.codegen.vectors import counted, operations_of
from emps_design.compensation import compensate
from emps_design.machines import machine
from emps_design.simulation import trapezoid_laps

CASCADE = {"kind": "cascade", "position": {"kp": 30.0}, "velocity": {"kp": 2.0, "ti": 0.05}}
OF_THE_EMPS = {**CASCADE, "velocity": {"kp": 300.0, "ti": 0.05}}
pytestmark = pytest.mark.usefixtures("short_vectors")


def test_operations_are_those_counted_by_hand():
    count = counted(read_program(loop_and_branch, (INT, REAL, ARRAY)), {2: [2.0, 3.0]})
    assert dict(count) == {"multiply": 2, "add": 2, "compare": 2, "divide": 1}


def loop_and_branch(k, x, gains):
    y = 0.0
    for i in range(int(gains[0])):
        y += gains[i] * x
    if x > 1.0:
        y = max(y / x, 0.0)
    else:
        y = -y
    return y


def test_filters_and_a_feed_forward_cost_what_they_add():
    axis = machine("emps2019").replace(controller=OF_THE_EMPS)
    lowpass = {"kind": "lowpass", "frequency": 200.0}
    plain, filtered = (
        operations_of(export_controller(axis.replace(controller={**OF_THE_EMPS, "filters": [lowpass] * n}), "c").block)
        for n in (0, 2)
    )
    assert filtered["multiply"] - plain["multiply"] == 2 * 5
    assert filtered["add"] - plain["add"] == 2 * 4
    found = compensate(machine("emps2019"), trapezoid_laps(1e-3, 0.05, 0.15, 1.0, laps=1)).to_dict()
    own, ahead = (export_controller(machine("emps2019"), "c", one).to_dict()["operations"] for one in (None, found))
    assert ahead["multiply"] == own["multiply"] + 3
    assert ahead["divide"] == 2


@pytest.mark.parametrize(
    ("family", "expected"),
    [
        ("Beckhoff AX5000", {"S-0-0100": 2.0 * 0.5, "S-0-0101": 50.0}),
        ("Beckhoff AX8000", {"3140:01": 2.0 * 0.5, "3140:02": 0.05}),
        ("Beckhoff EP7047", {"8014:03": 2.0 / 0.1e-3, "8014:04": 5000.0}),
        ("Beckhoff AX2000-B750", {"S-0-0104": 180.0, "S-0-0101": 500.0}),
        ("Yaskawa Sigma-II", {"Pn102": 30.0, "Pn100": 2.0 * 0.5 / 0.01 / 6.283185307179586, "Pn101": 5000.0}),
    ],
)
def test_gains_under_a_drives_own_names(family, expected):
    """On a motor that takes a current: 0.5 N m/A, 0.01 kg m^2."""
    axis = machine("emps2019").replace(
        motion="rotary", mechanics={"mass": 0.01, "viscous": 0.001, "coulomb": 0.1, "offset": 0.0},
        drive={"command": "current", "force_gain": 0.5, "command_limit": 10.0}, controller=CASCADE,
    )  # fmt: skip
    rows = [row for row in drive_settings(axis, gains_of(axis)) if row["family"] == family]
    assert {row["parameter"]: row["value"] for row in rows} == pytest.approx(expected)


def test_every_row_has_its_manual_and_goes_into_the_page(tmp_path, capsys):
    assert all(one.source.startswith("https://") for one in SETTINGS)
    path = tmp_path / "axis.toml"
    path.write_text(machine("emps2019").replace(controller=OF_THE_EMPS).to_toml(), encoding="utf-8")
    assert app.run(["export", str(path), "--to", "c", "--out", str(tmp_path / "code")]) == 0
    assert "Yaskawa Sigma-II Pn102 30 1/s position.kp" in " ".join(capsys.readouterr().out.split())
    assert "| Beckhoff AX5000 | S-0-0101 | 50 | ms |" in (tmp_path / "code" / "README.md").read_text(encoding="utf-8")
    assert app.run(["export", str(path), "--to", "json", "--out", str(tmp_path / "json")]) == 0
    document = json.loads((tmp_path / "json" / "emps2019.json").read_text(encoding="utf-8"))
    assert {row["family"] for row in document["drives"]} >= {"Beckhoff AX5000", "Yaskawa Sigma-II"}
    assert drive_settings(machine("emps2019"), gains_of(machine("emps2019"))) == []


def turning(**drive):
    """A motor that takes a current: 0.5 N m/A, 0.01 kg m^2."""
    return machine("emps2019").replace(
        motion="rotary", mechanics={"mass": 0.01, "viscous": 0.001, "coulomb": 0.1, "offset": 0.0},
        drive={"command": "current", "force_gain": 0.5, "command_limit": 10.0, **drive}, controller=CASCADE,
    )  # fmt: skip


def settings(axis, gains):
    return {(row["family"], row["parameter"]): row["value"] for row in drive_settings(axis, gains)}


def test_a_drives_gains_do_not_depend_on_what_the_command_is_counted_in():
    gains = {"velocity.kp": 2.0}
    milli = turning(command_unit="mA", force_gain=0.5e-3)
    expected = settings(turning(), gains)
    assert settings(milli, {"velocity.kp": 2000.0}) == pytest.approx(expected)
    rated = settings(turning(command_unit="%", force_gain=0.05), {"velocity.kp": 20.0})
    assert ("Beckhoff EP7047", "8014:03") not in rated  # nothing says how many amperes a per cent is
    assert {key: expected[key] for key in rated} == pytest.approx(rated)


def test_a_drives_gains_are_on_the_motors_side_where_the_reduction_is_known():
    gains = {"velocity.kp": 2.0, "velocity.ti": 0.05}
    data_sheet = {"current_gain": 1.0, "reduction": 100.0, "torque_constant": 0.005}
    own, geared = settings(turning(), gains), settings(turning(**data_sheet), gains)
    assert geared["Beckhoff AX5000", "S-0-0100"] == pytest.approx(own["Beckhoff AX5000", "S-0-0100"] / 1e4)
    assert geared["Beckhoff AX8000", "3140:01"] == pytest.approx(own["Beckhoff AX8000", "3140:01"] / 1e4)
    assert geared["Beckhoff EP7047", "8014:03"] == pytest.approx(own["Beckhoff EP7047", "8014:03"] / 100.0)
    assert geared["Beckhoff AX5000", "S-0-0101"] == own["Beckhoff AX5000", "S-0-0101"]
    sides = {row["side"] for axis in (turning(), turning(**data_sheet)) for row in drive_settings(axis, gains)}
    assert sides == {"axis", "motor"}
    pages = [export_controller(axis, "c").files["README.md"] for axis in (turning(), turning(**data_sheet))]
    assert "On the load side" in pages[0]
    assert "On the motor side" in pages[1]


def test_a_document_has_its_feed_forward_in_numbers_and_its_origin():
    axis = machine("emps2019").replace(controller=OF_THE_EMPS)
    found = compensate(axis, q_ref=trapezoid_laps(1e-3, stroke=0.1, speed=0.2, laps=1)).to_dict()
    document = json.loads(export_controller(axis, "json", found, origin="axis.toml of today").files["emps2019.json"])
    assert document["origin"] == "axis.toml of today"
    ahead = document["feedforward"]
    assert all(isinstance(ahead[key], float) for key in ("gain", "back_emf", "reversal", "wait"))
    assert ahead["gain"] == axis.drive.gain
    assert all(isinstance(number, float) for number in ahead["own"])


def test_of_a_whole_and_a_real_number_the_larger_is_real():
    program = read_program(larger, (INT, REAL))
    assert program.kernel.result == REAL
    assert program.calls == {"max"}


def larger(k, x):
    return max(k, x)
