"""Scenarios, reference programs, reference files, and the command that runs them."""

import json
import re

import numpy as np
import pytest

from emps_design.cli.app import run as command_line
from emps_design.discrepancy.preparation import check_law, law_voltage
from emps_design.errors import InputError, RecordError
from emps_design.machines import machine
from emps_design.simulation import Plant, Run, breakaway, replay, synthetic as programs, trapezoid_laps
from emps_design.simulation.scenarios import follow, force_ramp
from emps_design.simulation.synthetic import read_reference
from tests.unit.records.with_gaps import as_one, lost

AXIS = machine("emps2019")
Q_REF = 0.05 * np.sin(2 * np.pi * 0.6 * np.arange(1500) * 1e-3) ** 2


@pytest.fixture
def record_file(tmp_path):
    run = Plant.of(AXIS).closed_loop(Q_REF)
    np.savez(tmp_path / "record.npz", t=run.t, q_ref=run.q_ref, q=run.q, u=run.u)
    return tmp_path / "record.npz"


def test_replay_of_ones_own_run_is_exact():
    record = Plant.of(AXIS).closed_loop(Q_REF).record()
    errors = replay(AXIS, record).relative_error_percent
    assert set(errors) == {"position", "velocity", "acceleration", "force"}
    assert errors["position"] < 1e-10
    assert errors["force"] < 1e-8
    heavier = replay(AXIS.replace(mechanics={"mass": 105.0}), record).relative_error_percent
    assert heavier["force"] > 1.0


@pytest.mark.parametrize("delay", [1, 3])
def test_a_record_holds_the_voltage_before_the_computation_delay(delay):
    """Replay in closed and in open loop, the check of the law and its proposal read a record as a run writes it."""
    axis = AXIS.replace(sampling={"computation_delay": delay})
    run = Plant.of(axis).closed_loop(trapezoid_laps(1e-3, laps=1))
    record = run.record()
    for kind in (axis, axis.replace(controller={"kind": "none"})):
        assert max(replay(kind, record).relative_error_percent.values()) < 1e-6
    np.testing.assert_allclose(law_voltage(record, axis), record.u, atol=1e-9)
    with pytest.raises(InputError, match=r"it fits kp = 160\.18 1/s and kv = 243\.45 V/\(m/s\)"):
        check_law(record, axis.replace(controller={"kp": 300.0}), ())


def test_replay_without_a_controller_is_open_loop():
    record = Plant.of(AXIS).closed_loop(Q_REF).record()
    found = replay(AXIS.replace(controller={"kind": "none"}), record)
    assert not found.closed_loop
    assert found.relative_error_percent["position"] < 1e-3
    assert "open loop" in found.warnings[0]


@pytest.mark.parametrize(("kind", "share"), [("position_pd", 0.7), ("none", 0.2)])
def test_replay_takes_a_record_with_gaps_as_its_pieces(kind, share):
    axis = AXIS.replace(controller={"kind": kind})
    record = lost(Plant.of(AXIS).closed_loop(Q_REF).record(), 500, 800)
    found, bridged = replay(axis, record), replay(axis, as_one(record))
    for name in ("position", "velocity", "acceleration"):
        assert found.relative_error_percent[name] < share * bridged.relative_error_percent[name]
        assert found.rms_error[name] < share * bridged.rms_error[name]
    assert "emps2019: used as 2 pieces, without the gaps between them" in found.warnings
    assert len(found.run) == len(record)
    assert np.array_equal(found.run.u[800:], record.u[800:]) == (kind == "none")


def test_replay_wants_the_axis_period():
    record = Plant.of(AXIS).closed_loop(Q_REF).record()
    with pytest.raises(InputError, match="expected the same period"):
        replay(AXIS.replace(sampling={"period": 2e-3}), record)
    with pytest.raises(InputError, match="found 40 samples, expected more than 52"):
        replay(AXIS, record.part(0, 40))


def test_breakaway_finds_both_sides_and_the_constant_force():
    stribeck = {"kind": "stribeck_friction", "excess": 6.0, "stribeck_velocity": 0.01, "exponent": 1.0}
    found = breakaway(AXIS.replace(effects=[stribeck]), rate=5.0).to_dict()
    assert found["static_friction"] == pytest.approx(AXIS.mechanics.coulomb + 6.0, abs=0.01)
    assert found["constant_force"] == pytest.approx(AXIS.mechanics.offset, abs=0.01)


def test_breakaway_of_a_bending_contact_and_one_that_holds():
    bent = breakaway(AXIS.replace(effects=[{"kind": "presliding_friction", "stiffness": 1e6}]), rate=1.0).to_dict()
    assert bent["static_friction"] == pytest.approx(AXIS.mechanics.coulomb, rel=0.1)
    held = breakaway(AXIS, rate=5.0, peak=5.0)
    assert held.to_dict()["static_friction"] is None
    assert "raise `peak`" in held.warnings[0]
    with pytest.raises(InputError, match="rate: found -1 N/s"):
        breakaway(AXIS, rate=-1.0)


@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_a_fast_push_ends_before_the_carriage_has_come_far(rate):
    """It left at 17.4 N, and at 1000 N/s the push is over before it has moved 1 mm."""
    found = breakaway(AXIS, rate=rate)
    step = rate * AXIS.sampling.period
    assert found.to_dict()["static_friction"] == pytest.approx(AXIS.mechanics.coulomb, abs=step)
    assert found.warnings == (
        f"the push rises by {step:.3g} N per sample, the resolution of the break-away force; lower `rate`",
    )
    assert breakaway(AXIS, rate=20.0).warnings == ()


def test_a_bending_contact_that_has_not_moved_far_is_not_said_to_hold():
    bent = AXIS.replace(effects=[{"kind": "presliding_friction", "stiffness": 1e6}])
    found = breakaway(bent, rate=1000.0)
    assert found.forward is None
    assert re.match(r"the carriage moved 0\.\d+ mm up to .* N, and break-away needs 1 mm; .* `rate`", found.warnings[0])


def test_a_carriage_that_stops_again_has_not_left():
    """Against a spring a stick-slip friction lets go, jumps and holds again before 1 mm."""
    stribeck = {"kind": "stribeck_friction", "excess": 6.0, "stribeck_velocity": 0.01, "exponent": 1.0}
    spring = {"kind": "elastic_force", "stiffness": 2e5, "rest_position": 0.0}
    axis = AXIS.replace(mechanics={"offset": 0.0}, effects=[stribeck, spring])
    found = breakaway(axis, rate=5.0, peak=AXIS.mechanics.coulomb + 6.65)
    assert [kind for _, kind, _ in found.run.events] == [2, 1]  # break-away, stick
    assert found.forward is None
    assert "the carriage moved 0.0035 mm" in found.warnings[0]
    assert "raise `peak`" in found.warnings[0]


def test_follow_tells_when_the_voltage_is_at_its_limit():
    found = follow(AXIS, np.concatenate([np.zeros(100), np.full(400, 0.1)]))
    assert found.to_dict()["saturated_share"] > 0
    assert "at its limit" in found.warnings[0]


def test_half_of_the_program_is_ramp_and_half_constant():
    q = programs.half_ramp_program(1e-3, speeds=(0.2, 0.1), segment=0.4, laps=2)
    v = np.diff(q) / 1e-3
    assert np.mean(np.abs(np.diff(v)) < 1e-9) == pytest.approx(0.5, abs=0.01)
    assert np.abs(v).max() == pytest.approx(0.2)
    for call in (
        lambda: programs.half_ramp_program(0.0),
        lambda: programs.multi_sine(1e-3, duration=-1.0),
        lambda: force_ramp(1e-3, 1.0, 0.0),
        lambda: force_ramp(1e-3, np.nan, 1.0),
    ):
        with pytest.raises(InputError, match="expected a positive number"):
            call()


def test_reference_file_is_interpolated_with_units(tmp_path):
    (tmp_path / "program.csv").write_text("t [ms],q_ref [mm],f_ext\n0,0,0\n10,5,2\n20,0,0\n")
    q_ref, f_ext, _ = read_reference(tmp_path / "program.csv", 5e-3)
    np.testing.assert_allclose(q_ref, [0, 2.5e-3, 5e-3, 2.5e-3, 0], atol=1e-12)
    np.testing.assert_allclose(f_ext, [0, 1, 2, 1, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("t,q\n0,0\n1,1\n", "missing column q_ref"),
        ("t,q_ref\n0,0\n0,1\n", "column t: sample 1 is not later"),
        ("t,q_ref\n0,nan\n1,1\n", "not finite|nan"),
        ("t,q_ref\n0,0\n1e-9,1\n", "samples, expected 2 to"),
    ],
)
def test_reference_file_that_cannot_be_meant(tmp_path, content, message):
    path = tmp_path / "program.csv"
    path.write_text(content)
    with pytest.raises(RecordError, match=message):
        read_reference(path, 1e-3)
    with pytest.raises(RecordError, match="expected a .csv or .npz reference"):
        read_reference(tmp_path / "missing.csv", 1e-3)


def test_command_replays_a_record(record_file, capsys, tmp_path):
    out, plot = tmp_path / "run.npz", tmp_path / "run.svg"
    arguments = ["simulate", "emps2019", "--scenario", "replay", "--record", str(record_file), "--json"]
    assert command_line([*arguments, "--out", str(out), "--plot", str(plot)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document["relative_error_percent"]) == {"position", "velocity", "acceleration", "force"}
    assert len(Run.load(out)) == 1500
    assert plot.read_text().startswith("<?xml")


def test_command_follows_a_reference_and_tests_breakaway(tmp_path, capsys):
    (tmp_path / "program.csv").write_text("t,q_ref\n0,0\n0.5,0.02\n1.0,0.02\n")
    assert command_line(["simulate", "--reference", str(tmp_path / "program.csv")]) == 0
    assert "tracking error rms" in capsys.readouterr().out
    assert command_line(["simulate", "emps2018", "--scenario", "breakaway", "--rate", "20", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["static_friction"] == pytest.approx(17.38, abs=0.05)


def test_command_runs_the_comanipulation(capsys):
    assert command_line(["simulate", "--scenario", "comanipulation", "--plants", "4", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"verdict", "transparency", "seed", "plants"} <= set(document)
    assert {"apparent_mass", "apparent_damping", "r2", "error"} <= set(document["transparency"])


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["simulate"], 2, "--scenario: nothing to do"),
        (["simulate", "--scenario", "replai"], 2, "did you mean 'replay'"),
        (["simulate", "--scenario", "replay"], 2, "found no record"),
        (["simulate", "--scenario", "reference"], 2, "found no reference"),
        (["simulate", "--scenario", "comanipulation", "--out", "x.npz"], 2, "--out: requires --scenario replay or"),
        (
            ["simulate", "--scenario", "breakaway", "--record", "x.npz"],
            2,
            "requires --scenario replay, found",
        ),
        (["simulate", "--scenario", "breakaway", "--mismatch", "0.1"], 2, "--mismatch: requires --scenario comanip"),
        (["simulate", "--scenario", "breakaway", "--rate", "50", "--out", "x.txt"], 2, "ends in .npz or .csv"),
        (["simulate", "--scenario", "breakaway", "--rate", "50", "--plot", "x.txt"], 2, "ends in .png, .svg or .pdf"),
    ],
)
def test_command_refuses_in_one_line(arguments, status, message, capsys):
    assert command_line(arguments) == status
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_arm_that_falls_by_itself_has_no_break_away():
    arm = machine("emps2019").replace(motion="rotary", effects=[{"kind": "gravity", "torque": 90.0, "angle": 0.5}])
    found = breakaway(arm, rate=20.0)
    assert (found.forward, found.backward) == (None, None)
    assert found.to_dict()["static_friction"] is None
    assert "moves without a push" in found.warnings[0]


def test_a_loop_that_only_the_limit_holds_is_unstable():
    """Position gain 30 1/s around a velocity loop of 15 rad/s: the limit of 3 V keeps the swing bounded."""
    loop = {"kind": "cascade", "position": {"kp": 30.0}, "velocity": {"kp": 40.0, "ti": 0.05, "form": "ip"}}
    axis = AXIS.replace(controller=loop, drive={"command_limit": 3.0})
    found = follow(axis, 0.1 * (1.0 - np.cos(3e-3 * np.arange(1000)))).to_dict()
    assert found["reason"] == "the position loop is unstable; only limits bound it"
    assert "reason" not in follow(axis.replace(controller={**loop, "position": {"kp": 5.0}}), np.zeros(10)).to_dict()
