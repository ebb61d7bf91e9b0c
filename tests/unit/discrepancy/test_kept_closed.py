"""The part of a record that is held out where no other record confirms, and the messages about it."""

import json

import numpy as np
import pytest

from emps_design.cli.app import run as command
from emps_design.discrepancy import diagnose
from emps_design.discrepancy.preparation import choose_held_out, prepare
from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation.synthetic import synthetic_record, trapezoid_laps

AXIS = machine("emps2019")
LIBRARY = (get_effect("actuator_delay"),)


def moved(q_ref):
    return Record.from_arrays(1e-3, q_ref, q_ref, q_ref, name="run")


LAPS = trapezoid_laps(1e-3, stroke=0.06, laps=3)
WANDER = np.cumsum(np.repeat([1.0, -0.6, 0.7, -1.1, 0.4, -0.9, 0.8, -0.3], 500)) * 1e-4  # eight strokes, no laps


def test_of_laps_one_is_kept_and_of_strokes_the_last_third():
    lap = LAPS.size // 3
    found = choose_held_out((moved(LAPS),))
    assert (found.chosen, found.what[:13]) == ("kept", "the first lap")
    assert found.time == pytest.approx((0.0, lap * 1e-3), abs=1e-3)
    assert choose_held_out((moved(WANDER),)).what == "the last 2 of 8 strokes of run, 3 to 4 s"
    within = choose_held_out((moved(LAPS),), (0.0, 1.7 * lap * 1e-3))
    assert within.chosen == "none"  # one lap and a bit would be left


@pytest.mark.parametrize("records", [(moved(LAPS[: 2 * LAPS.size // 3]),), (moved(WANDER[:2400]),), (moved(LAPS),) * 2])
def test_where_too_little_would_be_left_nothing_is_held_out_and_it_is_said(records):
    found = choose_held_out(records)
    assert (found.chosen, found.time) == ("none", None)
    assert found.sentence.startswith("Nothing was held out (")
    assert "errors and shares refer to the fitted data; give another record as `holdout`" in found.sentence


def test_nothing_of_what_is_kept_is_fitted():
    record = synthetic_record(AXIS, stroke=0.06)
    preparation = prepare((record,), AXIS, LIBRARY, None, None, None)
    (split,) = preparation.start.problem.splits
    (closed,) = preparation.held_out.problem.splits
    n = split.used.size
    assert not np.any(split.used & closed.used[:n])
    assert np.count_nonzero(closed.used) > 0.3 * len(record)
    assert preparation.hold_out.chosen == "kept"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept")
    delayed = AXIS.replace(effects=[{"kind": "actuator_delay", "delay": 2e-3}])
    synthetic_record(delayed, stroke=0.06).save(folder / "one.npz")
    synthetic_record(AXIS, seed=1, stroke=0.06).save(folder / "other.npz")
    return folder


def test_the_answer_says_what_confirmed_it(folder):
    answer = diagnose(synthetic_record(AXIS.replace(effects=[]), stroke=0.06, seed=3), AXIS, library=LIBRARY)
    document = answer.to_dict()
    assert document["verdict"] == "nothing-missing"
    assert document["held_out"]["chosen"] == "kept"
    assert document["gap"]["holdout"]["extended"] < 2.0 * document["gap"]["floor"]
    assert document["held_out"]["text"] in document["sentence"]
    assert "Held out for confirmation: the first lap of synthetic-emps2019" in document["sentence"]


def test_a_diagnosis_of_another_record_is_not_replaced_without_being_asked(folder, capsys):
    out = folder / "found"
    out.mkdir()
    (out / "diagnosis.json").write_text(
        json.dumps({"records": [{"name": "one", "role": "train", "sha256": "ab" * 32}]}), encoding="utf-8"
    )
    assert command(["diagnose", str(folder / "other.npz"), "--axis", "emps2019", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert "holds the diagnosis of one, expected one of the same records or none" in error
    assert "--force" in error
    assert error.count("\n") == 1
    (out / "diagnosis.json").write_text("{}", encoding="utf-8")
    assert command(["diagnose", str(folder / "other.npz"), "--axis", "emps2019", "--out", str(out)]) == 2
    assert "is not a readable diagnosis" in capsys.readouterr().err


def test_what_happens_in_the_part_kept_closed_opens_it():
    changed = AXIS.replace(effects=[{"kind": "mass_change", "change": 0.3, "time": 4.0}])
    library = (get_effect("mass_change"), *LIBRARY)
    answer = diagnose(synthetic_record(changed, stroke=0.06), AXIS, library=library)
    assert [finding.effect for finding in answer.findings] == ["mass_change"]
    assert answer.holdout is None
    assert "held out at first, shows something that the rest does not" in answer.sentence


def test_a_push_that_began_in_the_part_kept_closed_is_said_to_have():
    """Pulses from 0.9 s on: the fitted data begin one lap later, so the first pulse in them is a later one."""
    pushes = {"kind": "external_force", "amplitude": 15.0, "start": 0.9, "duration": 0.3, "every": 2.9}
    record = synthetic_record(AXIS.replace(effects=[pushes]), stroke=0.06)
    answer = diagnose(record, AXIS, library=(get_effect("external_force"),))
    (finding,) = answer.findings
    assert finding.parameters["start"]["value"] == pytest.approx(6.7, abs=1e-2)
    (message,) = (message for message in answer.details["warnings"] if message.code == "earlier-instant")
    assert message.startswith("External force: start is the first one in the fitted data; in the first lap of")
    assert float(message.split()[-2]) == pytest.approx(0.9, abs=1e-3)
    assert finding.note.endswith(message.removeprefix("External force: "))
