"""The model that follows most closely: described where nothing has a name, judged on data that it has not seen."""

import json

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.discrepancy import closest, diagnose
from emps_design.effects import get_effect, known_effects
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.run import driven_by
from emps_design.simulation.synthetic import trapezoid_laps

AXIS = machine("emps2019")
LEVEL = {"kind": "friction_map", "start": 0.0, "end": 0.1, **{f"height_{i + 1}": 3.0 + i for i in range(6)}}
SLIP = {"kind": "maxwell_slip_friction", "share": 0.4, "travel": 4e-3}
LIBRARY = tuple(get_effect(name) for name in ("elastic_force", "maxwell_slip_friction"))


def record(*effects, stroke=0.1, seed=0) -> Record:
    q_ref = trapezoid_laps(1e-3, stroke=stroke, speed=0.2, laps=3)
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(q_ref.size)
    run = Plant.of(AXIS.replace(effects=list(effects))).closed_loop(q_ref, voltage_noise=noise)
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name=f"run {seed}")


@pytest.fixture(scope="module")
def described():
    """A friction over position and one with a memory, of which the library has only the second."""
    held_out = record(LEVEL, SLIP, stroke=0.08, seed=1)
    return held_out, diagnose(record(LEVEL, SLIP), AXIS, holdout=held_out, library=LIBRARY, closest=True)


@pytest.mark.study("a whole diagnosis")
def test_what_has_no_name_is_described_and_follows_more_closely(described):
    held_out, answer = described
    found = answer.closest
    assert "maxwell_slip_friction" not in [finding.effect for finding in answer.findings]  # beside something unknown
    assert "Maxwell-slip friction" in found.effects
    assert found.holdout.extended < 0.9 * answer.holdout.extended
    run = Plant.of(found.axis).closed_loop(**driven_by(found.axis, held_out))
    error = AXIS.drive.gain * (held_out.u - run.u)
    assert found.share == pytest.approx(np.linalg.norm(error) / np.linalg.norm(AXIS.drive.gain * held_out.u), rel=0.05)
    assert "without naming a cause" in found.text


@pytest.mark.study("the same diagnosis")
def test_the_document_has_the_gaps_beside_those_of_the_named_model(described):
    _, answer = described
    shown = answer.with_file("model.toml").to_dict()["closest"]
    assert shown["model_file"] == "closest_model.toml"
    assert answer.to_dict()["closest"]["model_file"] is None
    assert shown["gap"]["holdout"]["baseline"] == pytest.approx(answer.holdout.baseline)
    assert shown["gap_inverse_60hz"]["holdout"]["extended"] == answer.closest.holdout.extended_60hz


def test_where_only_noise_is_left_nothing_is_described():
    found = diagnose(record(), AXIS, library=LIBRARY, closest=True).closest
    assert found.axis is None
    assert found.effects == ()
    assert "noise" in found.text


@pytest.mark.study("a diagnosis of two records")
def test_what_holds_on_one_record_only_is_not_given():
    spring = {"kind": "elastic_force", "stiffness": 80.0, "rest_position": 0.05}
    answer = diagnose(record(spring), AXIS, holdout=record(seed=1), library=LIBRARY, closest=True)
    assert answer.verdict == "unnamed"
    assert answer.closest.axis is None
    assert "no more closely" in answer.closest.text


def test_an_event_or_a_contact_describes_nothing(monkeypatch):
    calls = []
    monkeypatch.setattr(closest, "tangent", lambda found: None)
    monkeypatch.setattr(closest, "fit", lambda found, part: found)
    monkeypatch.setattr(closest, "screen", lambda found, library, absorbed: calls.extend(library) or [])
    closest.describe(None, tuple(known_effects().values()))
    names = {effect.name for effect in calls}
    assert {"force_map", "friction_map", "maxwell_slip_friction", "stribeck_friction"} <= names
    assert not names & {"external_force", "mass_change", "end_stop", "backlash", "actuator_lag", "encoder_error"}


@pytest.mark.study("the same diagnosis")
def test_the_command_writes_it_and_takes_an_old_one_away(described, tmp_path, monkeypatch, capsys):
    _, answer = described
    calls = []
    monkeypatch.setattr(
        "emps_design.discrepancy.diagnose",
        lambda request: calls.append(request.closest) or (answer if request.closest else healthy),
    )
    healthy = diagnose(record(), AXIS, library=LIBRARY)
    record().save(tmp_path / "run.npz")
    run = [str(tmp_path / "run.npz"), "--out", str(tmp_path / "found")]
    assert app.run(["diagnose", *run, "--closest-model"]) == 0
    assert "Closest model: with" in capsys.readouterr().out
    assert Axis.load(tmp_path / "found" / "closest_model.toml").effects == answer.closest.axis.effects
    assert "The closest model" in (tmp_path / "found" / "report.html").read_text()
    document = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    assert document["closest"]["model_file"] == "closest_model.toml"
    assert app.run(["diagnose", *run, "--force"]) == 0  # over the diagnosis of another record
    assert calls == [True, False]
    assert not (tmp_path / "found" / "closest_model.toml").exists()
