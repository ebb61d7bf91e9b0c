"""A record that its own controller or motion contradicts is read with a warning that says how; no other record is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.importing import import_record
from emps_design.importing.read import MEANS, with_contradictions
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.records.layout import Layout
from emps_design.simulation.synthetic import synthetic_record, trapezoid_laps
from tests.unit.unlike_axes import JOINT

STAGE = Axis.from_dict(
    {
        "name": "stage",
        "mechanics": {"mass": 7.0, "viscous": 25.0, "coulomb": 6.0, "offset": -1.0},
        "drive": {"command": "current", "force_gain": 11.0, "command_limit": 4.0},
        "sampling": {"period": 1e-3, "encoder_resolution": 1e-6},
        "controller": {
            "kind": "cascade",
            "position": {"kp": 30.0, "every": 4},
            "velocity": {"kp": 60.0, "ti": 0.04},
            "feedforward": {"velocity": 1.0, "acceleration": 0.6, "coulomb": 0.5},
            "filters": [{"kind": "lowpass", "frequency": 150.0}],
        },
    }
)
SERVO = JOINT.replace(controller={"kind": "p", "kp": 12.0}, sampling={"computation_delay": 0})
UNKNOWN = {"kind": "none"}


def healthy(axis, stroke=0.2, speed=0.25, acceleration=2.0, seed=3):
    return synthetic_record(axis, seed, q_ref=trapezoid_laps(axis.sampling.period, stroke, speed, acceleration, 1))


@pytest.fixture(scope="module")
def stage():
    return healthy(STAGE)


@pytest.fixture(scope="module")
def servo():
    return healthy(SERVO, 1.5, 4.0, 20.0)


def low_passed(x, hz=5.0, period=1e-3):
    keep = np.exp(-2.0 * np.pi * hz * period)
    return lfilter([1.0 - keep], [1.0, -keep], x, zi=[keep * x[0]])[0]


def rows(record, kept):
    return Record.from_arrays(
        record.period, record.q_ref[kept], record.q[kept], record.u[kept], layout=Layout(units=STAGE.units)
    )


def half(record):
    return np.arange(len(record)) < len(record) // 2


def one_of_900(record):
    return replace(record, u=np.where(np.arange(len(record)) == 4000, 900.0, record.u))


def half_amps(record):
    return replace(record, u=0.5 * np.round(record.u / 0.5))


def held_for(record, name, samples):
    return replace(record, **{name: getattr(record, name)[np.arange(len(record)) // samples * samples]})


def another(record):
    return np.std(record.u) * np.sin(np.arange(len(record)) / 200.0)


EVERY_FIFTH = lambda r: rows(r, np.arange(len(r)) % 5 != 4)  # noqa: E731
TWICE = lambda r: rows(r, np.repeat(np.arange(len(r)), 1 + (np.arange(len(r)) % 50 == 0)))  # noqa: E731
DAMAGED = {
    "position low-passed": (lambda r: replace(r, q=low_passed(r.q)), ""),
    "command low-passed": (lambda r: replace(r, u=low_passed(r.u)), "behind a low-pass of about 5 Hz"),
    "command in steps": (half_amps, "the command is recorded in steps of 0.5 A"),
    "1 in 100 lost": (lambda r: rows(r, np.arange(len(r)) % 100 != 99), "q jumps ahead at"),
    "1 in 5 lost": (EVERY_FIFTH, "q jumps ahead at"),
    "rows repeated": (TWICE, "rows repeated"),
    "every second command": (
        lambda r: replace(r, u=np.where(np.arange(len(r)) % 2, r.u, another(r))),
        "some of every 2 samples",
    ),
    "all commands": (lambda r: replace(r, u=another(r)), "or it is from another controller or axis"),
    "exchanged": (lambda r: replace(r, q=r.q_ref, q_ref=r.q), "q and q_ref are exchanged"),
    "gain doubled": (
        lambda r: replace(r, u=np.where(half(r), 1.0, 2.0) * r.u),
        "s on the command is 1.99 times that",
    ),
    "one sample": (one_of_900, "one sample, 900 A at 4 s, is far from the command of the law"),
    "late": (lambda r: replace(r, u=np.roll(r.u, 20)), "20 samples later than reference and position"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_the_law_shows_what_was_done_to_a_record(stage, name):
    damage, words = DAMAGED[name]
    (said,) = with_contradictions(STAGE, damage(stage)).contradictions
    assert said.startswith("u: the cascade law of stage gives another command for this q_ref and q: ")
    assert words in said
    assert said.endswith(MEANS)


@pytest.mark.parametrize("damage", [EVERY_FIFTH, TWICE], ids=["lost", "repeated"])
def test_a_law_without_a_memory_does_not_hide_odd_increments(servo, damage):
    damaged = damage(servo)
    assert with_contradictions(SERVO, damaged).contradictions[0].startswith("q ")


def test_a_position_whose_rounding_hides_the_law_is_judged_by_its_motion(stage):
    (said,) = with_contradictions(STAGE, held_for(stage, "q", 10)).contradictions
    assert said.startswith("q does not change at 82 % of the samples in full motion: values are held")


WITHOUT_A_LAW = {
    "command in steps": "u: recorded in steps of 0.5, ",
    "1 in 5 lost": "q jumps ahead at",
    "rows repeated": "values are held, or rows repeated",
    "position held": "values are held, or rows repeated",
    "every second command": "every second sample is from another signal",
    "gain doubled": "mass and friction alike",
    "one sample": "and the axis does not respond to it",
    "late": "earlier than it was recorded",
}


@pytest.mark.parametrize("name", WITHOUT_A_LAW)
def test_without_a_law_what_no_drive_does_is_seen(stage, name):
    axis = Axis.from_dict({**STAGE.to_dict(), "controller": UNKNOWN})
    damage = (lambda r: held_for(r, "q", 10)) if name == "position held" else DAMAGED[name][0]
    said = with_contradictions(axis, damage(stage)).contradictions
    assert any(WITHOUT_A_LAW[name] in text for text in said), said


def cut(record):
    return record.part(2501, len(record))


def few_digits(record):
    return replace(record, q=np.round(record.q, 5), q_ref=np.round(record.q_ref, 5), u=np.round(record.u, 3))


@pytest.mark.parametrize("change", [lambda r: r, cut, few_digits, lambda r: cut(few_digits(r))])
@pytest.mark.parametrize("known", [True, False], ids=["law", "no law"])
def test_a_healthy_record_is_read_without_a_word(stage, servo, change, known):
    for axis, record in ((STAGE, stage), (SERVO, servo)):
        read_for = axis if known else Axis.from_dict({**axis.to_dict(), "controller": UNKNOWN})
        assert with_contradictions(read_for, change(record)).contradictions == ()


def test_where_an_integrator_stood_and_a_limit_acts_is_no_contradiction(stage):
    limited = STAGE.replace(drive={"command_limit": float(np.quantile(np.abs(stage.u), 0.9))})
    record = healthy(limited)
    assert np.mean(np.abs(record.u) > 0.999 * limited.drive.command_limit) > 0.05
    for start in (0, 1234, 3001):
        assert with_contradictions(limited, record.part(start, len(record))).contradictions == ()


def test_what_was_added_to_the_command_and_recorded_is_no_contradiction(stage):
    added = np.where(half(stage), 0.0, 1.0)
    record = replace(stage, u=stage.u + added, excitation=added)
    assert with_contradictions(STAGE, record).contradictions == ()
    (said,) = with_contradictions(STAGE, replace(record, excitation=None)).contradictions
    assert "differs from the law by up to 1.01 A" in said or "differs from the law by up to 1 A" in said


def test_a_record_of_another_period_is_not_held_against_the_law(stage):
    slower = replace(rows(stage, slice(None, None, 4)), period=4e-3, t=4.0 * stage.t[: len(stage.t[::4])])
    assert with_contradictions(STAGE, slower).contradictions == ()


@pytest.mark.slow("every command that reads a record")
def test_every_command_that_reads_a_record_says_it(stage, tmp_path, capsys):
    axis, path = tmp_path / "stage.toml", tmp_path / "record.npz"
    axis.write_text(STAGE.to_toml())
    replace(stage, u=np.where(half(stage), 1.0, 1.1) * stage.u).save(path)
    words = "the cascade law of stage gives another command"
    for command in (["identify", path, "--axis", axis], ["observe", path, "--axis", axis],
                    ["simulate", axis, "--scenario", "replay", "--record", path]):  # fmt: skip
        assert app.run([*map(str, command), "--json"]) == 0
        out, err = capsys.readouterr()
        assert any(words in text for text in json.loads(out)["warnings"]), command
        assert words in err or command[0] == "simulate"


@pytest.mark.study("a search for the law")
def test_law_is_exempt_for_it_says_which_law_made_the_record(stage, tmp_path, capsys):
    axis, path = tmp_path / "stage.toml", tmp_path / "record.npz"
    axis.write_text(STAGE.to_toml())
    replace(stage, u=np.where(half(stage), 1.0, 1.1) * stage.u).save(path)
    assert app.run(["law", str(path), "--axis", str(axis), "--json"]) == 0
    warnings = json.loads(capsys.readouterr()[0])["warnings"]
    assert not any("the cascade law of stage gives another command" in text for text in warnings)


def test_diagnose_and_frf_carry_it(stage, tmp_path):
    from emps_design.discrepancy.preparation import check_records

    path = tmp_path / "record.npz"
    replace(stage, u=1.5 * stage.u).save(path)
    record = import_record(path, STAGE)
    assert any("times that of the law" in text for text in check_records((record,), STAGE))


def test_the_embedded_machine_reads_its_own_records():
    axis = machine("emps2019")
    record = synthetic_record(axis, laps=1, stroke=0.1)
    assert with_contradictions(axis, record) is record


ONCE = [(60, 0.0), (150, 15.0), (150, 5.0), (300, 0.0), (100, -30.0), (140, 0.0)]  # samples, m/s^2


@pytest.mark.parametrize(("pieces", "halved_from", "said"), [(ONCE, 376, False), ([*ONCE, *ONCE], 900, True)])
def test_a_part_that_only_speeds_up_and_one_that_only_brakes_have_no_gain_to_compare(pieces, halved_from, said):
    """Half the command once it is fast may be friction that depends on the torque; half of a whole motion is none."""
    period = 1e-3
    a = np.concatenate([np.full(n, at) for n, at in pieces])
    v = period * np.cumsum(a)
    v[np.abs(v) < 1e-9] = 0.0
    u = (0.1 * a + np.sign(v)) * np.where(np.arange(a.size) < halved_from, 1.0, 0.5)
    u += 0.01 * np.random.default_rng(5).standard_normal(a.size)
    q = period * np.cumsum(v)
    axis = Axis.from_dict({**STAGE.to_dict(), "controller": UNKNOWN})
    record = Record.from_arrays(period, q, q, u, layout=Layout(units=STAGE.units))
    found = with_contradictions(axis, record).contradictions
    assert any("its gain or its unit changes" in text for text in found) == said


def test_jitter_of_time_stamps_is_no_loss_of_samples(stage):
    """A PC's clock in whole milliseconds: late stamps, two samples in one of them, and times that are known."""
    late = np.round(1e3 * stage.t + 0.5 * np.abs(np.random.default_rng(0).standard_normal(len(stage))))
    kept = np.diff(np.maximum.accumulate(late), prepend=-1.0) > 0.0
    columns = (x[kept] for x in (1e-3 * late, stage.q_ref, stage.q, stage.u))
    record = Record.from_arrays(*columns, layout=Layout(units=STAGE.units, period=1e-3))
    assert record.measured is not None
    assert with_contradictions(STAGE.replace(controller=UNKNOWN), record).contradictions == ()
