"""Records that go one way, with gaps, or at constant speeds: what they tell is given, what they do not is said."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.errors import AxisError, InputError, RecordError
from emps_design.identification import identify
from emps_design.identification.excitation import goes_one_way
from emps_design.identification.several import identify_together
from emps_design.importing import layout_of
from emps_design.records import Record
from emps_design.records.record import joined

T = 1e-3
INERTIA, VISCOUS, COULOMB, OFFSET = 1.2e-4, 2e-4, 0.02, 0.002
MOTOR = Axis.from_dict(
    {
        "name": "motor",
        "motion": "rotary",
        "mechanics": {"mass": INERTIA, "viscous": VISCOUS, "coulomb": COULOMB, "offset": 0.0},
        "drive": {"command": "torque", "force_gain": 1.0, "command_limit": 0.3},
        "sampling": {"period": T, "encoder_resolution": 6.283e-4},
        "controller": {"kind": "none"},
    }
)


def run(direction, steps=(0.05, 0.08, 0.06), seconds=2.0):
    """A motor that is given torque steps one way from rest; exact between them."""
    u = direction * np.repeat(steps, round(seconds / T))
    v, q = np.zeros(u.size + 1), np.zeros(u.size + 1)
    decay = np.exp(-VISCOUS / INERTIA * T)
    for k, torque in enumerate(u):
        end = (torque - direction * COULOMB - OFFSET) / VISCOUS
        v[k + 1] = end + (v[k] - end) * decay
        q[k + 1] = q[k] + end * T + (v[k] - end) * (1.0 - decay) * INERTIA / VISCOUS
    q = np.round(q[:-1] / 6.283e-4) * 6.283e-4
    record = Record.from_arrays(T, q, q, u, name="pos" if direction > 0 else "neg", layout=layout_of(MOTOR))
    return replace(record, q_ref_recorded=False)


@pytest.fixture(scope="module")
def both():
    return run(1), run(-1)


def test_one_way_tells_inertia_viscous_friction_and_a_sum(both):
    for record, lump in zip(both, (COULOMB + OFFSET, COULOMB - OFFSET), strict=True):
        found = identify(record, MOTOR)
        assert found.parameters["mass"].value == pytest.approx(INERTIA, rel=0.02)
        assert found.parameters["viscous"].value == pytest.approx(VISCOUS, rel=0.02)
        assert found.parameters["coulomb_and_offset"].value == pytest.approx(lump, rel=0.02)
        assert list(found.parameters) == ["mass", "viscous", "coulomb", "constant_force", "coulomb_and_offset"]
        assert not found.parameters["coulomb"].determined
        assert not found.parameters["constant_force"].determined
        assert any("one direction only" in warning and "both records" in warning for warning in found.warnings)
        with pytest.raises(AxisError, match="coulomb, constant_force not determined"):
            found.to_axis()


def test_a_pair_tells_all(both):
    found = identify_together(both, MOTOR)
    wanted = {"mass": INERTIA, "viscous": VISCOUS, "coulomb": COULOMB, "constant_force": OFFSET}
    assert {name: one.value for name, one in found.parameters.items()} == pytest.approx(wanted, rel=0.03)
    assert found.record == "pos + neg"
    assert found.to_axis().mechanics.offset == pytest.approx(OFFSET, rel=0.03)
    with pytest.raises(InputError, match="found 'iv', expected 'ls' for records with one direction each"):
        identify_together(both, MOTOR, estimator="iv")


def test_two_records_the_same_way_still_go_one_way(both):
    assert goes_one_way(joined([both[0], both[0]], rotary=True))
    assert not goes_one_way(joined(both, rotary=True))


def test_the_command_takes_a_pair(both, tmp_path, capsys):
    (tmp_path / "axis.toml").write_text(MOTOR.to_toml())
    paths = [str(tmp_path / f"{record.name}.npz") for record in both]
    for record, path in zip(both, paths, strict=True):
        record.save(path)
    words = ["identify", *paths, "--axis", str(tmp_path / "axis.toml"), "--json"]
    assert app.run(words) == 0
    parameters = json.loads(capsys.readouterr().out)["parameters"]
    assert parameters["constant_force"]["value"] == pytest.approx(OFFSET, rel=0.03)
    assert app.run([words[0], paths[0], *words[3:]]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["parameters"]["coulomb"]["value"] is None
    assert document["advice"]["level"] == "caution"


def test_an_asymmetric_model_still_asks_for_both_ways(both):
    with pytest.raises(RecordError, match="no reversal"):
        identify(both[0], MOTOR, model="asymmetric")


def test_speeds_that_are_constant_tell_no_mass():
    """A piston that a test stand moves to and fro: friction and a weight, and an acceleration that is the encoder's."""
    t = np.arange(12_000) * 5e-3
    speed = np.where((t % 20.0) < 10.0, 0.006, 0.012)
    v = speed * np.where((t % 2.0) < 1.0, 1.0, -1.0)
    q = np.round(np.cumsum(v) * 5e-3 / 5e-6) * 5e-6
    wave = 0.3 * np.sin(2 * np.pi * 1.3 * t) + 0.05 * np.random.default_rng(1).standard_normal(t.size)
    drive = {"command": "force", "command_unit": "N", "command_limit": 600.0}
    piston = MOTOR.replace(motion="linear", drive=drive, sampling={"encoder_resolution": 5e-6})
    record = Record.from_arrays(5e-3, q, q, 49.0 + 5.0 * np.sign(v) + wave, layout=layout_of(piston))
    found = identify(replace(record, q_ref_recorded=False), piston)
    assert not found.parameters["mass"].determined
    assert any("the speed is constant" in warning or "more than the whole" in warning for warning in found.warnings)
    assert not any("no axis has mass" in warning for warning in found.warnings)
    assert found.parameters["constant_force"].value == pytest.approx(49.0, abs=0.3)
    assert found.parameters["coulomb"].value == pytest.approx(5.0, abs=0.5)


def test_friction_that_may_be_nothing_or_half_of_the_force_is_not_determined():
    t = np.arange(3000) * 0.01
    q = np.sin(t) + 0.3 * np.sin(2.7 * t)
    slow = lfilter([0.2], [1.0, -0.98], np.random.default_rng(11).standard_normal(t.size))
    v = np.gradient(q, t)
    axis = MOTOR.replace(mechanics={"mass": 0.1}, drive={"command_limit": 30.0}, sampling={"period": 0.01})
    for size, determined in ((0.02, True), (0.6, False)):
        u = 0.1 * np.gradient(v, t) + 0.1 * np.sign(v) + size * slow
        found = identify(replace(Record.from_arrays(0.01, q, q, u, layout=layout_of(axis)), q_ref_recorded=False), axis)
        assert found.parameters["coulomb"].determined == determined
    assert any(text.startswith("coulomb is not determined") and "zero and half" in text for text in found.warnings)
