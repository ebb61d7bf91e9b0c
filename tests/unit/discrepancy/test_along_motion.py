"""Records whose loop cannot be simulated: twins of slow logs, an arm moved by hand, a shaft that turns for ever."""

import collections
import json
import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from emps_design.cli.app import run
from emps_design.discrepancy import diagnose
from emps_design.discrepancy.balance import FittedModel, command_lag, with_shifted_command
from emps_design.effects import get_effect
from emps_design.errors import RecordError, SimulationError
from tests.unit.discrepancy.slow_twins import KINDS, WEIGHT, drawn, endless, joint, moved_by_hand, robot

HOW_TO = Path(__file__).resolve().parents[3] / "docs" / "howto" / "slow_log.py"
PERIODS = pytest.mark.parametrize(("period", "irregular"), [(0.01, False), (0.02, True), (0.05, False)])


@pytest.fixture(scope="module")
def weighed():
    return robot(joint([WEIGHT]))


def test_a_deviation_is_half_of_what_its_interval_has_to_either_side():
    """Of few independent rows Student's t makes the interval, and what is held at nothing may be more."""
    intervals = {"mass": (1.0, 5.0), "viscous": (-0.4, 0.2), "coulomb": None}
    numbers = {name: SimpleNamespace(interval_95=ends) for name, ends in intervals.items()}
    found = SimpleNamespace(parameters=numbers, residual=SimpleNamespace(quantile=4.3))
    fitted = FittedModel(found, None, np.zeros(3), ("viscous",), {"mass": 0.0, "viscous": 0.0, "coulomb": 0.0})
    assert fitted.deviation("mass") == pytest.approx(2.0 / 1.96)
    assert fitted.deviation("viscous") == pytest.approx(0.2 / 1.96)
    assert fitted.deviation("coulomb") == 0.0
    assert replace(fitted, clock_effects={"mass": 3.0}).deviation("mass") == pytest.approx(np.hypot(2.0 / 1.96, 3.0))


@PERIODS
def test_a_weight_is_the_one_name_at_any_rate(period, irregular):
    record, axis = robot(joint([WEIGHT]), period, 1, irregular)
    answer = diagnose(record, axis)
    assert [finding.effect for finding in answer.findings] == ["gravity"]
    finding = answer.findings[0]
    assert finding.parameters["torque"]["value"] == pytest.approx(37.0, rel=0.02)
    assert finding.parameters["angle"]["value"] == pytest.approx(3.0, abs=0.03)
    assert finding.confirmed["share"] == pytest.approx(1.0, abs=0.05)
    assert answer.axis.mechanics.mass == pytest.approx(3.5, rel=0.05)
    assert [effect.kind for effect in answer.axis.effects] == ["gravity"]
    assert answer.axis.sampling == axis.sampling


@PERIODS
def test_a_healthy_joint_lacks_nothing(period, irregular):
    record, axis = robot(joint(), period, 2, irregular)
    answer = diagnose(record, axis.replace(mechanics=joint().mechanics.model_dump()))
    assert (answer.verdict, answer.findings) == ("nothing-missing", ())
    assert answer.holdout.extended == pytest.approx(answer.floor, rel=0.2)


def test_a_wrong_number_is_no_missing_effect():
    record, axis = robot(joint(coulomb=8.0), seed=3)
    answer = diagnose(record, axis.replace(mechanics=joint().mechanics.model_dump()))
    assert (answer.verdict, answer.findings) == ("parameters-only", ())
    assert answer.details["changed"].startswith("coulomb 5 -> ")
    assert answer.axis.mechanics.coulomb == pytest.approx(8.0, rel=0.02)


def test_what_is_too_fast_is_said(weighed):
    text = diagnose(*weighed).sentence
    assert "Hz are not analysed" in text
    slower = robot(joint([WEIGHT]), 0.05)
    assert "Frequencies above 4 Hz are not analysed." in diagnose(*slower).sentence


def test_a_spring_is_not_called_a_weight():
    spring = {"kind": "elastic_force", "stiffness": 10.0, "rest_position": 0.0}
    answer = diagnose(*robot(joint([spring]), seed=4))
    assert (answer.verdict, answer.findings) == ("unnamed", ())
    assert any("elastic torque more" in text for text in answer.details["warnings"])
    assert answer.details["unexplained"]["over"][0] == "position"


@pytest.mark.parametrize("seed", [5, 17])  # where the residual repeats with the motion, and where it does not
def test_a_second_mass_is_no_friction(seed):
    coupling = {"kind": "flexible_coupling", "frequency": 4.0, "damping": 0.05, "share": 0.5}
    answer = diagnose(*robot(joint([coupling]), seed=seed))
    assert (answer.verdict, answer.findings) == ("unnamed", ())


def test_the_work_of_a_hand_tells_the_weight_and_no_inertia():
    record, axis = moved_by_hand(3.3)
    answer = diagnose(record, axis)
    assert [finding.effect for finding in answer.findings] == ["gravity"]
    assert answer.findings[0].parameters["torque"]["value"] == pytest.approx(3.3, rel=0.01)
    assert answer.details["parameters"]["mass"]["extended"]["value"] is None
    assert answer.axis.mechanics.mass == axis.mechanics.mass


def test_a_shaft_that_turns_for_ever_tells_its_inertia():
    record, axis = endless()
    assert np.ptp(record.q) > 500.0  # rad
    answer = diagnose(record, axis)
    assert answer.findings == ()
    assert answer.axis.mechanics.mass == pytest.approx(1.2e-3, rel=0.05)
    assert answer.axis.mechanics.coulomb == axis.mechanics.coulomb  # one force with the offset, one way


def test_instants_of_a_command_are_half_a_sample_late():
    record, axis = robot(joint([WEIGHT]), seed=6)
    assert command_lag(record, axis, "symmetric", 15.0).samples == pytest.approx(0.5, abs=0.11)
    late = replace(record, u=np.concatenate([record.u[:1], record.u[:-1]]))
    assert command_lag(late, axis, "symmetric", 15.0).samples == pytest.approx(1.5, abs=0.11)
    held = with_shifted_command(record, 0.5)  # as a drive holds it
    assert command_lag(held, axis, "symmetric", 15.0).samples == pytest.approx(0.0, abs=0.11)
    on_time, delayed = (diagnose(r, axis) for r in (record, late))
    assert not any(message.code == "command-late" for message in on_time.details["warnings"])
    (message,) = (message for message in delayed.details["warnings"] if message.code == "command-late")
    assert "samples too late for the motion" in message
    assert delayed.axis.mechanics.mass == pytest.approx(on_time.axis.mechanics.mass, rel=0.01)


def test_a_record_that_was_held_out_confirms(weighed):
    record, axis = weighed
    other, _ = robot(joint([WEIGHT]), seed=7)
    other = replace(other, name="other")
    answer = diagnose(record, axis, holdout=other)
    assert answer.holdout.baseline > 10.0 * answer.holdout.extended
    assert answer.findings[0].confirmed["share"] == pytest.approx(1.0, abs=0.02)
    assert answer.trace.name == "other"
    roles = [(one["name"], one["role"]) for one in answer.details["records"]]
    assert roles == [("log", "train"), ("other", "holdout")]
    empty, _ = robot(joint(), seed=8)
    refuted = diagnose(record, axis, holdout=empty)
    assert (refuted.verdict, refuted.findings) == ("unnamed", ())
    assert any(message.code == "term-withdrawn" for message in refuted.details["warnings"])


def test_a_part_of_a_record_is_fitted_and_another_confirms(weighed):
    record, axis = weighed
    half = 0.5 * record.duration
    answer = diagnose(record, axis, fit_time=(0.0, half), confirm_time=(half, record.duration))
    assert [finding.effect for finding in answer.findings] == ["gravity"]
    assert answer.details["held_out"]["chosen"] == "given"
    assert answer.trace.window == (half, record.duration)
    assert not answer.trace.used[record.t < half].any()


def test_several_records_are_explained_together(weighed):
    record, axis = weighed
    pair = [record.part(0, 900, "first"), record.part(1200, 2400, "second")]
    answer = diagnose(pair, axis)
    assert [finding.effect for finding in answer.findings] == ["gravity"]
    assert [one["name"] for one in answer.details["records"]] == ["first", "second"]


def test_an_effect_that_is_not_in_the_library_is_not_named(weighed):
    record, axis = weighed
    answer = diagnose(record, axis, library=[get_effect("stribeck_friction")])
    assert (answer.verdict, answer.findings) == ("unnamed", ())


def test_where_no_loop_of_ours_holds_a_model_its_forces_are_balanced(weighed, monkeypatch):
    record, axis = weighed
    expected = diagnose(record, axis).to_dict()

    def fails(*given):
        raise SimulationError("the loop is unstable", 1.0)

    module = sys.modules[diagnose.__module__]
    monkeypatch.setattr(module, "too_slow", lambda records: False)
    monkeypatch.setattr(module, "_by_simulation", fails)
    assert diagnose(record, axis).to_dict() == expected
    with pytest.raises(SimulationError, match="unstable"):
        diagnose(record, axis.replace(controller=joint().controller))
    with pytest.raises(SimulationError, match="unstable"):  # too short to be judged so, either
        diagnose(record.part(0, 90), axis)


def test_records_that_cannot_be_judged_are_refused(weighed):
    record, axis = weighed
    with pytest.raises(RecordError, match="expected at least 2 s"):
        diagnose(record.part(0, 90), axis)
    with pytest.raises(RecordError, match="found a sampling period"):
        diagnose(record, axis.replace(sampling={"period": 0.02}))
    nearly = replace(record, period=record.period * 1.0004)  # as stamps of an hour tell it
    assert diagnose(nearly, axis).verdict == "named"


def test_the_how_to_finds_the_weight_of_its_robot(tmp_path, monkeypatch, capsys):
    """Its commands run on the log that its program writes, with everything that a diagnosis writes."""
    monkeypatch.chdir(tmp_path)
    for words in ((), ("axis",)):
        monkeypatch.setattr("sys.argv", [str(HOW_TO), *words])
        runpy.run_path(str(HOW_TO), run_name="__main__")
    assert capsys.readouterr().out.startswith("timestamp,actual_q,actual_current")
    page = HOW_TO.with_suffix(".md").read_text(encoding="utf-8")
    (command,) = re.findall(r"\{run\} emps-design (diagnose .*)", page)
    assert run([*command.split(), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    assert document["verdict"] == "named"
    (finding,) = document["findings"]
    assert finding["effect"] == "gravity"
    assert finding["parameters"]["torque"]["value"] == pytest.approx(31.0, rel=0.01)
    assert document["gap"]["holdout"]["baseline"] > 10.0 * document["gap"]["holdout"]["extended"]
    written = {path.name for path in (tmp_path / "found").iterdir()}
    assert written == {"diagnosis.json", "model.toml", "report.html", "holdout_prediction.csv"}
    predicted = np.genfromtxt(tmp_path / "found" / "holdout_prediction.csv", delimiter=",", names=True)
    assert predicted.dtype.names == ("t", "force_measured", "force_baseline", "force_extended")


TWINS = {kind: (191_000 + 1000 * number, 40 if number < 2 else 10) for number, kind in enumerate(KINDS)}


@pytest.mark.study("ten to forty diagnoses of simulated logs")
@pytest.mark.parametrize("kind", KINDS)
def test_slow_twins_get_the_name_that_they_have_and_no_other(kind):
    """The first two kinds have a wrong number at most; ``pytest -m study -s`` prints a line of the table for each."""
    first, count = TWINS[kind]
    right, false, verdicts = 0, 0, collections.Counter()
    for seed in range(first, first + count):
        record, axis, _ = drawn(seed, kind)
        answer = diagnose(record, axis)
        names = [finding.effect for finding in answer.findings]
        false += any(name != kind for name in names)
        right += kind in names[:1]
        verdicts[answer.verdict] += 1
    print(f"\n{kind:28s} seeds {first} to {first + count - 1}: named {right}, falsely {false}; {dict(verdicts)}")
    assert false == 0
    assert right >= 0.8 * count or kind in KINDS[:2]
