"""Records of other people that were refused once: each is read, and tells what is known of it."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.identification import identify
from emps_design.identification.several import identify_together
from emps_design.importing import import_record
from emps_design.importing.account import axis_text, read_trace
from tests.conftest import DATA

MOTOR = {
    "name": "motor",
    "motion": "rotary",
    "mechanics": {"mass": 1.2e-4, "viscous": 2e-4, "coulomb": 0.02},
    "drive": {"command": "torque", "force_gain": 1.0, "command_limit": 300.0},
    "sampling": {"period": 1e-3},
    "controller": {"kind": "none"},
}


@pytest.fixture
def case():
    """Folder of a case by its name."""

    def folder(name):
        path = DATA / "public" / "cases" / name
        if not path.is_dir():
            pytest.skip(f"the public records are not in {path.parent}")
        return path

    return folder


def test_a_matrix_without_names(case):
    columns = {
        "time": {"column": "data:0", "unit": "s"},
        "position": {"column": "data:1", "unit": "rad"},
        "velocity": {"column": "data:2", "unit": "rad/s"},
        "command": {"column": "data:3"},
    }
    record = import_record(case("mat-matrix") / "log.mat", Axis.from_dict(MOTOR | {"record": columns}))
    assert (len(record), record.period) == (3000, 1e-3)
    assert not any("saturated" in note for note in record.warnings)


def test_speed_and_torque_of_a_servo_amplifier(case):
    path = case("speed-only-trace") / "trace.csv"
    columns = {
        "time": {"column": "Time/ms"},
        "velocity": {"column": "Servo motor speed", "unit": "r/min"},
        "command": {"column": "Torque"},
    }
    drive = MOTOR["drive"] | {"command_unit": "%"}
    record = import_record(path, Axis.from_dict(MOTOR | {"drive": drive, "record": columns}))
    assert record.period == pytest.approx(2e-3 / 3, rel=1e-5)
    assert record.velocity.min() == pytest.approx(-2000 * 2 * np.pi / 60, rel=1e-6)
    assert np.gradient(record.q, record.period)[5:-5] == pytest.approx(record.velocity[5:-5], abs=1.5)
    assert any("integral of velocity" in note for note in record.warnings)
    text = axis_text(read_trace(path))
    assert '# velocity = { column = "Servo motor speed", unit = "rpm" }' in text
    assert 'motion = "rotary"' in text


def test_nan_before_the_part_that_is_taken(case):
    folder = case("nan-before-time-cut")
    record = import_record(folder / "log.csv", Axis.load(folder / "axis.toml"), window=(1.0, 15.0))
    assert len(record) == 1401


@pytest.mark.parametrize("name", ["sine_0.5hz", "sine_1hz", "sine_8hz"])
def test_a_sine_in_open_loop_is_not_refused(case, name):
    folder = case("sine-open-loop")
    assert len(import_record(folder / f"{name}.csv", Axis.load(folder / "axis.toml"))) > 3000


def test_a_sine_in_open_loop_tells_the_same_by_any_titles(case):
    folder = case("sine-open-loop")
    found = [
        identify(import_record(folder / file, axis), axis).parameters
        for file, axis in (
            ("sine_0.5hz.csv", Axis.load(folder / "axis.toml")),
            ("named_0.5hz.csv", Axis.load(folder / "axis_named.toml")),
        )
    ]
    for name, truth in (("mass", 0.72), ("viscous", 8.4), ("coulomb", 0.43)):
        assert found[0][name].value == pytest.approx(found[1][name].value, rel=1e-6)
        assert found[0][name].value == pytest.approx(truth, rel=0.01)


def test_strokes_one_way(case):
    folder = case("one-way-strokes")
    axis = Axis.load(folder / "axis.toml")
    pair = [import_record(folder / f"{name}.csv", axis) for name in ("pos", "neg")]
    assert not any("saturated" in note for record in pair for note in record.warnings)
    truth = {"mass": 1.2e-4, "viscous": 2e-4, "coulomb": 0.02, "constant_force": 0.002}
    found = identify_together(pair, axis)
    assert {name: one.value for name, one in found.parameters.items()} == pytest.approx(truth, rel=0.02)
    for record, lump in zip(pair, (0.022, 0.018), strict=True):
        alone = identify(record, axis).parameters
        assert [alone[name].value for name in ("mass", "viscous", "coulomb_and_offset")] == pytest.approx(
            [1.2e-4, 2e-4, lump], rel=0.02
        )


@pytest.mark.parametrize(("name", "force", "friction"), [("one_bar", 49.0, 5.6), ("seven_bar", 346.2, 10.8)])
def test_a_piston_at_constant_speeds_with_gaps(case, name, force, friction):
    folder = case("gaps")
    axis = Axis.load(folder / "axis.toml")
    record = import_record(folder / f"{name}.npz", axis)
    assert (record.bridged is not None) == (name == "seven_bar")
    found = identify(record, axis)
    assert not found.parameters["mass"].determined
    assert not any("belong together" in warning for warning in found.warnings)
    assert found.parameters["constant_force"].value == pytest.approx(force, abs=1.5)
    speed = 0.01  # m/s, of 6 to 14 mm/s
    p = {key: one.value for key, one in found.parameters.items() if one.determined}
    assert p["coulomb"] + speed * p["viscous"] == pytest.approx(friction, abs=0.8)
