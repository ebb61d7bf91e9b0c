"""The whole way from a record to a verdict on small simulated records, and everything that is refused."""

import dataclasses
import json
import re
import threading

import numpy as np
import pytest

from emps_design.cli.output import Terminal
from emps_design.discrepancy import diagnose, parallel, rules
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.preparation import check_records, check_same_drive, prepare
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import split
from emps_design.effects import get_effect, known_effects
from emps_design.effects.sizes import sizes
from emps_design.errors import InputError, RecordError
from emps_design.laws import law_of
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps
from tests.studies import quick

AXIS = machine("emps2019")
Q_REF = trapezoid_laps(1e-3, stroke=0.06, speed=0.2, laps=2)
SHORT = tuple(
    get_effect(name)
    for name in ("stribeck_friction", "actuator_delay", "actuator_lag", "elastic_force", "controller_disturbance")
)


def record(*effects, q_ref=Q_REF, seed=0, name="run") -> Record:
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(q_ref.size)
    run = Plant.of(AXIS.replace(effects=list(effects))).closed_loop(q_ref, voltage_noise=noise)
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name=name)


DELAYED = {"kind": "actuator_delay", "delay": 1.6e-3}


@pytest.fixture(scope="module")
def delayed():
    return diagnose(record(DELAYED), AXIS, holdout=record(DELAYED, seed=1, name="other"), library=SHORT)


def test_a_delay_is_named_and_confirmed(delayed):
    assert delayed.verdict == "named"
    assert [f.effect for f in delayed.findings] == ["actuator_delay"]
    found = delayed.findings[0].parameters["delay"]
    assert found["value"] == pytest.approx(1.6e-3, abs=5 * found["std"])
    assert delayed.holdout.extended < 0.3 * delayed.holdout.baseline
    assert delayed.findings[0].p_value <= 0.005


@pytest.mark.study("two diagnoses with the whole library")
@pytest.mark.parametrize("weight", [60.0, -60.0])
def test_the_transmission_of_an_upright_axis_is_loaded_by_the_weight(weight):
    """The axis file knows of no weight: the constant force is found, and that friction grows with all of it."""
    friction = {"kind": "load_dependent_friction", "share": 0.2, "carried_force": weight}
    upright, q_ref = AXIS.replace(mechanics={"offset": weight}, effects=[friction]), trapezoid_laps(1e-3, laps=3)
    noise = 4e-3 * np.random.default_rng(1).standard_normal(q_ref.size)
    run = Plant.of(upright).closed_loop(q_ref, voltage_noise=noise)
    answer = diagnose(Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name="upright"), AXIS)
    assert answer.verdict == "named"
    assert [finding.effect for finding in answer.findings] == ["load_dependent_friction"]
    found = answer.findings[0].parameters
    assert found["share"]["value"] == pytest.approx(0.2, rel=0.01)
    assert found["carried_force"]["value"] == pytest.approx(weight, rel=0.01)


def test_the_document_has_what_the_contract_asks(delayed):
    document = Terminal().json_data(delayed.to_dict())
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["schema"] == "emps-design/diagnosis/1"
    for gap in (document["gap"], document["gap_inverse_60hz"]):
        assert set(gap) == {"unit", "floor", "floor_interval", "floor_from", "train", "holdout"}
        assert gap["floor_interval"][0] < gap["floor"] < gap["floor_interval"][1]
        for part in ("train", "holdout"):
            for model in ("baseline", "extended"):
                low, high = gap[part][f"{model}_interval"]
                assert low < gap[part][model] < high
    finding = document["findings"][0]
    assert {"effect", "equivalents", "where", "parameters", "p_value", "gap_before", "gap_after", "note"} <= set(
        finding
    )
    assert {"channel", "text", "velocity", "position", "time", "frequency"} <= set(finding["where"])


def test_the_extended_axis_replays_the_prediction(delayed):
    prediction = delayed.trace
    run = Plant.of(delayed.axis).closed_loop(prediction.record.q_ref)
    assert np.allclose(run.force, prediction.extended)


@pytest.mark.parametrize("cores", quick([3, 1], 1, "the same again on one core"))
def test_the_same_seed_gives_the_same_document_on_any_number_of_cores(delayed, cores, monkeypatch):
    assert rules.CORES == 2  # with which `delayed` was found
    monkeypatch.setattr(parallel, "_idle_cores", threading.Semaphore(cores - 1))
    again = diagnose(record(DELAYED), AXIS, holdout=record(DELAYED, seed=1, name="other"), library=SHORT)
    assert json.dumps(Terminal().json_data(again.to_dict())) == json.dumps(Terminal().json_data(delayed.to_dict()))


def test_a_healthy_record_has_nothing_missing():
    answer = diagnose(record(), AXIS, library=SHORT)
    assert answer.verdict == "nothing-missing"
    assert answer.findings == ()
    assert answer.to_dict()["not_excluded"]


def test_wrong_numbers_are_only_numbers():
    answer = diagnose(record(), AXIS.replace(mechanics={"mass": 100.0, "offset": 0.0}), library=SHORT)
    assert answer.verdict == "parameters-only"
    assert answer.axis.mechanics.mass == pytest.approx(AXIS.mechanics.mass, rel=0.01)
    assert "mass 100 -> 95" in answer.sentence


def test_a_disturbance_of_the_controller_is_named_in_the_controller_and_nowhere_else():
    pulses = {"kind": "controller_disturbance", "amplitude": 2.0, "frequency": 1.0, "duty": 0.5, "start": 0.3437}
    answer = diagnose(record(pulses), AXIS, library=SHORT)
    assert [f.effect for f in answer.findings] == ["controller_disturbance"]
    found = {name: table["value"] for name, table in answer.findings[0].parameters.items()}
    assert answer.findings[0].channel == "controller"
    assert found["amplitude"] == pytest.approx(2.0, rel=0.02)
    assert found["frequency"] == pytest.approx(1.0, rel=1e-3)
    assert found["start"] == pytest.approx(0.3437, abs=2e-3)


@pytest.fixture(scope="module")
def unexplained():
    """A delay, and a library that has none."""
    return diagnose(record(DELAYED), AXIS, library=(get_effect("elastic_force"),))


@pytest.mark.slow("a diagnosis that keeps a lap closed, and opens it")
def test_what_no_effect_explains_is_unnamed(unexplained):
    answer = unexplained
    assert answer.verdict == "unnamed"
    assert answer.findings == ()


def test_where_only_the_confirming_record_has_more_than_noise_something_is_missing():
    answer = diagnose(
        record(),
        AXIS,
        holdout=record({"kind": "elastic_force", "stiffness": 400.0, "rest_position": 0.0}, name="pushed"),
        library=SHORT,
    )
    assert answer.verdict == "unnamed"
    assert answer.train.extended < rules.QUIET * answer.floor < answer.holdout.extended
    assert answer.details["unexplained"]["record"] == "holdout"
    assert "on the held-out record" in answer.sentence


@pytest.mark.parametrize(
    ("effects", "verdict"), quick([((), "unnamed"), ((DELAYED,), "partly-named")], 1, "an effect beside it")
)
def test_what_a_controller_does_beside_its_law_hides_nothing_of_the_plant(effects, verdict):
    noise = np.random.default_rng(0)
    dither = 0.15 * np.repeat(noise.standard_normal(1 + Q_REF.size // 60), 60)[: Q_REF.size]
    voltage = dither + 4e-3 * noise.standard_normal(Q_REF.size)
    run = Plant.of(AXIS.replace(effects=list(effects))).closed_loop(Q_REF, voltage_noise=voltage)
    recorded = Record(t=run.t, q_ref=Q_REF, q=run.q, u=run.u, period=1e-3, name="run")
    found = diagnose(recorded, AXIS, library=SHORT)
    assert found.verdict == verdict
    assert [f.effect for f in found.findings] == [effect["kind"] for effect in effects]
    assert found.details["unexplained"]["law_gap"] == pytest.approx(np.std(voltage), rel=0.02)
    assert f"{np.std(voltage):.2f} V rms" in found.sentence
    assert "the command differs from the controller's law" in found.sentence
    assert any(message.code == "law-gap" for message in found.details["warnings"])
    assert found.train.extended < 1.5 * found.floor


@pytest.mark.parametrize("gains", [{"kp": 100.0}, {"kv": 300.0}])
def test_a_wrong_controller_is_recognised_with_the_gains_that_fit(gains):
    with pytest.raises(InputError, match=r"does not follow .* it fits kp = 160\.\d+ 1/s and kv = 243\.\d+ V/\(m/s\)"):
        diagnose(record(), AXIS.replace(controller=gains), library=SHORT)


@pytest.mark.study("a search over every law")
def test_a_controller_of_another_kind_is_named():
    axis = AXIS.replace(controller={"kind": "ip_velocity", "k_v1": 500.0, "t_v": 0.01})
    with pytest.raises(
        InputError, match=r"does not follow .* position_pd with kp = 160\.\d+, kv = 243\.\d+.* correct the axis"
    ):
        diagnose(record(), axis, library=SHORT)


@pytest.mark.study("a diagnosis with two ripples")
def test_a_ripple_with_two_lines_is_listed_line_by_line():
    lines = {0.0025: 3.0, 0.004: 2.0}  # m, N
    effects = [
        {"kind": "position_ripple", "amplitude": amplitude, "phase": 0.5, "period": period}
        for period, amplitude in lines.items()
    ]
    answer = diagnose(record(*effects), AXIS, library=(get_effect("position_ripple"), *SHORT))
    assert answer.verdict == "named"
    assert [finding.effect for finding in answer.findings] == ["position_ripple"] * 2
    numbers = [finding.parameters for finding in answer.findings]
    found = {round(number["period"]["value"], 5): number["amplitude"] for number in numbers}
    assert set(found) == set(lines)
    for period, amplitude in found.items():
        assert amplitude["value"] == pytest.approx(lines[period], abs=4 * amplitude["std"])
    assert [one.kind for one in answer.axis.effects] == ["position_ripple"] * 2
    assert answer.to_dict()["remedies"] == [get_effect("position_ripple").words.remedy]  # once


def test_records_that_cannot_be_judged_say_what_to_record():
    whole = record()
    with pytest.raises(RecordError, match="expected at least 2 s"):
        diagnose(whole.part(0, 1500), AXIS)
    still = Record(whole.t, np.zeros(len(whole)), np.zeros(len(whole)), whole.u, 1e-3)
    with pytest.raises(RecordError, match="does not move"):
        diagnose(still, AXIS)
    full = Record(whole.t, whole.q_ref, whole.q, np.full(len(whole), 10.0), 1e-3)
    with pytest.raises(RecordError, match="at the voltage limit"):
        diagnose(full, AXIS)
    with pytest.raises(RecordError, match="sampling period of 2 ms"):
        diagnose(Record(2 * whole.t, whole.q_ref, whole.q, whole.u, 2e-3), AXIS)
    with pytest.raises(RecordError, match="one drive"):
        diagnose(whole, AXIS, holdout=Record(2 * whole.t, whole.q_ref, whole.q, whole.u, 2e-3))
    with pytest.raises(InputError, match="`confirm_time`: found 39 samples"):
        diagnose(whole, AXIS, library=SHORT, confirm_time=(0.001, 0.04))
    with pytest.raises(InputError, match="`confirm_time`"):
        diagnose(whole, AXIS, confirm_time=(1e4, 2e4))


def test_an_effect_of_a_user_takes_part():
    from emps_design.effects import REGISTRY, register

    own = get_effect("actuator_delay")
    renamed = type(own)(**{**own.__dict__, "name": "my_delay"})
    register(renamed)
    try:
        answer = diagnose(record(DELAYED), AXIS, library=(get_effect("elastic_force"), renamed))
        assert [f.effect for f in answer.findings] == ["my_delay"]
    finally:
        REGISTRY.added.pop("my_delay")


@pytest.mark.study("diagnoses of the inverse model")
@pytest.mark.parametrize(
    "effect",
    quick([{"kind": "elastic_force", "stiffness": 80.0, "rest_position": 0.05}, DELAYED], 1, "another effect"),
)
def test_without_a_controller_the_models_follow_the_recorded_motion(effect):
    unknown = AXIS.replace(controller={"kind": "none"})
    answer = diagnose(record(effect), unknown, holdout=record(effect, seed=1), library=SHORT)
    assert [f.effect for f in answer.findings] == [effect["kind"]]
    assert answer.holdout.extended < 0.5 * answer.holdout.baseline
    document = answer.to_dict()
    assert document["simulation"] == "inverse model"
    assert any("the controller is unknown" in text for text in document["warnings"])
    assert answer.axis.controller.kind == "none"


def test_a_motor_that_reaches_its_current_limit_lacks_nothing():
    """The law that follows a record corrects both ways, at the limit of the recorded command as well."""
    motor = AXIS.replace(
        motion="rotary",
        mechanics={"mass": 2e-4, "viscous": 1e-3, "coulomb": 5e-3, "offset": 0.0},
        drive={"force_gain": 0.05, "command": "current", "command_limit": 5.0},
        sampling={"encoder_resolution": 2 * np.pi / 10_000},
        controller={"kind": "position_pd", "kp": 60.0, "kv": 1.0},
    )
    speeds = np.repeat(np.random.default_rng(71).uniform(-40.0, 40.0, 24), 400)  # rad/s, which step
    run = Plant.of(motor).closed_loop(np.cumsum(speeds) * 1e-3)
    assert 0.005 < np.mean(np.abs(run.u) == 5.0) < 0.2
    unknown = motor.replace(controller={"kind": "none"})
    recorded = Record(t=run.t, q_ref=run.q, q=run.q, u=run.u, period=1e-3, name="steps")
    answer = diagnose(recorded, unknown, library=SHORT)
    assert answer.verdict == "nothing-missing"
    assert answer.train.baseline < 1.5 * answer.noise.force


def test_a_stroke_of_micrometres_is_motion_for_a_fine_encoder():
    whole = record()
    small = dataclasses.replace(whole, q=2e-4 * whole.q, q_ref=2e-4 * whole.q_ref)  # 12 um
    with pytest.raises(RecordError, match="does not move"):
        check_records((small,), AXIS.replace(sampling={"encoder_resolution": 1e-5}))
    check_records((small,), AXIS.replace(sampling={"encoder_resolution": 1e-9}))


@pytest.mark.parametrize("share", [0.01, 0.05, 0.08, 1.0])
def test_a_record_is_followed_by_a_light_model_too(share):
    """The law that follows is sized by the model's mass as well: by the file's alone its loop would swing."""
    unknown = AXIS.replace(controller={"kind": "none"})
    start = prepare((record(),), unknown, SHORT, None, None, None).start
    model = dataclasses.replace(start.model, baseline=start.model.baseline * [share, 1.0, 1.0, 1.0])
    run = start.with_model(model).run(0)
    assert np.abs(run.q - start.problem.records[0].q).max() < 6e-3  # m
    assert np.abs(np.diff(run.u)).max() < 1.0  # V, from sample to sample


def test_one_speed_and_an_unknown_controller_tell_neither_mass_nor_friction():
    """The ripple drives the shaft round and round, and mass times acceleration is a line along the turn like it."""
    numbers = {"mass": 0.5, "viscous": 2.0, "coulomb": 5.0, "offset": 0.0}
    loop = {"kind": "position_pd", "kp": 20.0, "kv": 1.3}
    motor = AXIS.replace(motion="rotary", mechanics=numbers, controller=loop)
    ripple = {"kind": "position_ripple", "amplitude": 8.0, "phase": 0.3, "period": 2 * np.pi / 18}
    turning = Plant.of(motor.replace(effects=[ripple])).closed_loop(4.0 * np.arange(7000) * 1e-3)
    measured = turning.u + 4e-3 * np.random.default_rng(0).standard_normal(7000)
    recorded = Record(t=turning.t, q_ref=turning.q, q=turning.q, u=measured, period=1e-3, name="turns")
    unknown = motor.replace(controller={"kind": "none"}, mechanics={"mass": 0.55})
    answer = diagnose(recorded, unknown, fit_time=(0.5, 7.0), library=(get_effect("position_ripple"),))
    assert [f.effect for f in answer.findings] == ["position_ripple"]
    assert answer.findings[0].parameters["amplitude"]["value"] == pytest.approx(8.0, rel=0.05)
    mechanics = answer.axis.mechanics
    assert (mechanics.mass, mechanics.viscous, mechanics.coulomb) == tuple(unknown.mechanics.array()[:3])
    assert any("inertia and friction stay as in the axis file" in text for text in answer.details["warnings"])


def test_the_confirming_record_withdraws_what_it_does_not_ask_for():
    # A spring that is there on the training record only: nothing of it is in the other one.
    spring = {"kind": "elastic_force", "stiffness": 80.0, "rest_position": 0.05}
    answer = diagnose(record(spring), AXIS, holdout=record(seed=1), library=SHORT)
    assert answer.findings == ()
    assert answer.verdict == "unnamed"
    assert any("elastic force" in text and "withdrawn" in text for text in answer.details["warnings"])


def test_what_nothing_explains_has_a_place_and_a_map(unexplained):
    found = unexplained.details["unexplained"]
    force = np.array(found["map"]["force"], float)
    assert force.shape == (len(found["map"]["velocity"]), len(found["map"]["position"]))
    assert np.isfinite(force).any()
    assert found["text"]


def test_where_is_told_in_the_words_of_the_effect():
    low = {"kind": "stribeck_friction", "excess": 8.0, "stribeck_velocity": 8e-3, "exponent": 1.0}
    found = diagnose(record(low), AXIS, library=SHORT).findings[0]
    assert found.effect == "stribeck_friction"
    assert found.where["force"]["sense"] == "more"
    assert "below" in found.where["text"]
    assert found.where["velocity"][1] < 0.03
    assert 4.0 < found.where["force"]["value"] < 12.0


def test_the_calibration_can_search_healthy_records():
    linear, searched = (diagnose(record(), AXIS, library=SHORT, searches=n) for n in (0, 6))
    assert searched.verdict == linear.verdict == "nothing-missing"
    assert "6 simulated healthy records, each searched like this one" in searched.details["calibration"]
    thresholds = [
        float(re.search(r"cost by more than ([0-9.]+),", d.details["calibration"])[1]) for d in (linear, searched)
    ]
    assert 0.2 * thresholds[0] < thresholds[1] < 2 * thresholds[0]


@pytest.mark.study("a diagnosis of two records")
def test_several_records_make_one_diagnosis_with_numbers_of_their_own():
    ripples = [{"kind": "position_ripple", "amplitude": 3.0, "phase": phase, "period": 5e-3} for phase in (0.3, 2.0)]
    library = (get_effect("position_ripple"), get_effect("elastic_force"))
    together = [record(ripple, seed=i, name=f"run {i}") for i, ripple in enumerate(ripples)]
    answer = diagnose(together, AXIS, library=library)
    (found,) = answer.findings
    assert found.effect == "position_ripple"
    assert found.parameters["amplitude"]["value"] == pytest.approx(3.0, abs=0.2)
    phases = found.parameters["phase"]["values"]
    assert (phases[1] - phases[0]) % (2 * np.pi) == pytest.approx(1.7, abs=0.1)
    assert [r["name"] for r in answer.details["records"]] == ["run 0", "run 1"]


def test_an_interrupt_leaves_what_is_known_by_then():
    low = {"kind": "stribeck_friction", "excess": 8.0, "stribeck_velocity": 8e-3, "exponent": 1.0}

    def stop(stage, fraction):
        if stage.startswith("round 2"):
            raise KeyboardInterrupt

    answer = diagnose(record(low), AXIS, library=SHORT, progress=stop)
    assert [f.effect for f in answer.findings] == ["stribeck_friction"]
    assert any(message.code == "search-interrupted" for message in answer.details["warnings"])


@pytest.mark.parametrize(
    ("code", "text"), [("one-speed", "one speed only"), ("no-slow-motion", "hardly any motion below 20 mm/s")]
)
def test_a_record_with_one_speed_says_what_it_does_not_excite(code, text):
    q_ref = np.abs((1e-4 * np.arange(8000) + 0.1) % 0.2 - 0.1)
    (message,) = (m for m in check_records((record(q_ref=q_ref),), AXIS) if m.code == code)
    assert text in message


@pytest.mark.study("a diagnosis of two records")
def test_what_the_controller_adds_on_the_confirming_record_only_is_known_there():
    pulses = {"kind": "controller_disturbance", "amplitude": 2.0, "frequency": 1.0, "duty": 0.5, "start": 0.3437}
    answer = diagnose(record(DELAYED), AXIS, holdout=record(DELAYED, pulses, seed=1), library=SHORT)
    assert [f.effect for f in answer.findings] == ["actuator_delay"]
    assert answer.holdout.extended < 0.4 * answer.holdout.baseline
    (seen,) = (message for message in answer.details["warnings"] if message.code == "effect-of-confirming-record")
    assert seen.startswith("controller disturbance on the held-out record")


@pytest.mark.study("a diagnosis of two records")
def test_a_disturbance_of_the_controller_need_not_be_there_on_the_confirming_record():
    pulses = {"kind": "controller_disturbance", "amplitude": 2.0, "frequency": 1.0, "duty": 0.5, "start": 0.3437}
    answer = diagnose(record(DELAYED, pulses), AXIS, holdout=record(DELAYED, seed=1), library=SHORT)
    assert {f.effect for f in answer.findings} == {"controller_disturbance", "actuator_delay"}
    assert answer.holdout.extended < 0.4 * answer.holdout.baseline


def test_a_holdout_of_another_drive_is_refused():
    one, other = (dataclasses.replace(record(), extra={"gtau": gain}) for gain in (35.15, 30.0))
    with pytest.raises(RecordError, match="found gtau = 30, expected 35.15"):
        diagnose(one, AXIS, holdout=other)


def test_gains_that_the_law_takes_from_each_record_may_differ():
    one, other = (dataclasses.replace(record(), extra={"kp": gain}) for gain in (100.0, 200.0))
    with pytest.raises(RecordError, match="found kp = 200, expected 100"):
        check_same_drive(one, other, AXIS)
    own = {"kind": "p", "kp": {"record": "kp", "scale": 390.0}}
    check_same_drive(one, other, AXIS.replace(controller=own))  # no refusal


def test_a_motor_that_is_switched_off_tells_by_its_motion():
    axis = AXIS.replace(controller={"kind": "p", "kp": {"record": "gain", "scale": 2.0}})
    t = np.arange(4000) * 1e-3
    reference = 0.05 * np.sin(2 * np.pi * 0.5 * t)
    off = (t < 2.2).astype(float)
    law = law_of(axis, 1e-3, {"gain": 1000.0})
    run = Plant.of(axis).closed_loop(reference, law=law, enable=off)
    seen = Record(t=t, q_ref=reference, q=run.q, u=run.u, period=1e-3, enable=off, extra={"gain": 1000.0})
    problem = Problem(axis, (seen,), (split(seen),), Whitening.none())
    right = Candidate.of(axis, sizes(seen.q, seen.u, 1e-3, axis.drive.gain))
    rough = dataclasses.replace(right, baseline=right.baseline * [1.0, 1.0, 2.0, 1.0])
    (left,), (more,) = Hypothesis(problem, right).residuals(), Hypothesis(problem, rough).residuals()
    assert np.abs(left).max() < 0.05  # N
    rolls = slice(2300, 4000)  # the same law that had the motor would ask for this
    expected = 2000.0 * axis.drive.gain * (Hypothesis(problem, rough).run(0).q - seen.q)[rolls]
    assert more[rolls] == pytest.approx(expected)
    assert np.abs(expected).max() > 5.0
    # Another motion of the same machine has the gain of the record too.
    assert np.ptp(Hypothesis(problem, right).simulate(0, q_ref=0.5 * reference).force) > 1.0


def test_records_of_one_stroke_each_fit_and_select_together():
    stroke = np.interp(np.arange(2500), [200, 1200, 1500, 2300], [0.0, 0.05, 0.05, 0.2])
    runs = tuple(record(q_ref=stroke, seed=seed, name=f"run {seed}") for seed in range(3))
    problem = prepare(runs, AXIS, SHORT, None, None, None).start.problem
    assert problem.samples("fit") == 2 * problem.samples("select")
    alone = prepare(runs[:1], AXIS, SHORT, None, None, None).start.problem  # within its strokes
    assert 2450 * 0.6 < alone.samples("fit") < 2450 * 0.9
    assert alone.samples("select") == 2450 - alone.samples("fit")


@pytest.mark.study("a diagnosis")
def test_a_stretch_of_the_record_confirms():
    whole = record(DELAYED)
    answer = diagnose(whole, AXIS, library=SHORT, confirm_time=(0.0, whole.duration / 3))
    assert [f.effect for f in answer.findings] == ["actuator_delay"]
    assert answer.holdout.extended < 0.4 * answer.holdout.baseline
    assert answer.trace.window == pytest.approx((0.0, whole.duration / 3), abs=2e-3)


def test_a_disturbance_on_one_of_two_records_is_not_put_on_the_other():
    pulses = {"kind": "controller_disturbance", "amplitude": 2.0, "frequency": 1.0, "duty": 0.5, "start": 0.3437}
    answer = diagnose([record(seed=1), record(pulses, name="pulsed")], AXIS, library=SHORT)
    assert [f.effect for f in answer.findings] == ["controller_disturbance"]
    amplitude = answer.findings[0].parameters["amplitude"]
    assert amplitude["value"] == amplitude["values"][1] == pytest.approx(2.0, abs=0.01)
    assert amplitude["values"][0] == 0.0
    assert answer.findings[0].where["record"] == "pulsed"
    assert answer.findings[0].gap_after < 0.5


def test_an_external_force_that_was_measured_is_nothing_missing():
    q_ref = trapezoid_laps(1e-3, stroke=0.06, speed=0.2, laps=3)  # of two that differ, none is the healthy one
    push = 20.0 * ((np.arange(q_ref.size) > 3000) & (np.arange(q_ref.size) < 4000))
    run = Plant.of(AXIS).closed_loop(
        q_ref, disturbance=push, voltage_noise=4e-3 * np.random.default_rng(0).standard_normal(q_ref.size)
    )
    sensed = Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, f_ext=push)
    library = (get_effect("external_force"), get_effect("elastic_force"))
    assert diagnose(sensed, AXIS, library=library).findings == ()
    blind = dataclasses.replace(sensed, f_ext=None)
    assert diagnose(blind, AXIS, library=library).verdict == "unnamed"  # one push, seen in one stroke only


def test_an_interrupt_before_anything_was_found_claims_nothing():
    def stop(stage, fraction):
        if stage.startswith("round 1"):
            raise KeyboardInterrupt

    answer = diagnose(record(DELAYED), AXIS, library=SHORT, progress=stop)
    assert answer.verdict == "unnamed"
    assert answer.sentence.startswith("Interrupted")


def test_a_training_record_does_not_confirm_itself():
    one = record()
    with pytest.raises(InputError, match="copy: also a training record"):
        diagnose(one, AXIS, holdout=dataclasses.replace(one, name="copy"), library=SHORT)


def test_what_could_not_be_excluded_names_every_effect_with_a_size():
    library = tuple(get_effect(n) for n in ("backlash", "flexible_coupling", "presliding_friction", "actuator_delay"))
    rows = {row["effect"]: row for row in diagnose(record(), AXIS, library=library).details["not_excluded"]}
    assert set(rows) == {effect.name for effect in library}
    assert 1e-7 < rows["backlash"]["size"] < 5e-5
    assert rows["backlash"]["text"].endswith("or more")
    assert rows["flexible_coupling"]["size"] > 50.0
    assert rows["flexible_coupling"]["text"].endswith("Hz or less")
    assert 1e-6 < rows["actuator_delay"]["size"] < 1e-3


@pytest.mark.study("three diagnoses")
def test_the_smallest_size_seen_is_seen_and_half_of_it_is_not():
    row = diagnose(record(), AXIS, library=SHORT).details["not_excluded"]
    delay = next(entry["size"] for entry in row if entry["effect"] == "actuator_delay")
    answers = [
        diagnose(record({"kind": "actuator_delay", "delay": k * delay}), AXIS, library=SHORT) for k in (1.5, 0.4)
    ]
    assert [len(answer.findings) for answer in answers] == [1, 0]
    assert answers[0].verdict in ("named", "ambiguous")  # so small a delay is as well a lag
    assert "actuator delay" in answers[0].sentence.lower()


def test_the_residual_is_looked_at_from_every_side(delayed):
    seen = {view.quantity for view in delayed.views}
    assert {"velocity", "position", "acceleration", "motor force", "voltage margin to the limit", "time"} <= seen
    assert {"time from reversal", "period of position", "frequency"} <= seen
    spectrum = delayed.details["spectrum_over_time"]
    force = np.array(spectrum["force"])
    assert force.shape == (len(spectrum["frequency"]), len(spectrum["time"]))
    assert (force >= 0).all()
    assert force.max() > 0


def test_the_same_record_twice_is_refused():
    with pytest.raises(InputError, match="again: same measurement as run"):
        diagnose([record(), dataclasses.replace(record(), name="again")], AXIS, library=SHORT)


def test_every_effect_has_a_row_under_what_could_not_be_excluded():
    rows = diagnose(record(), AXIS).details["not_excluded"]
    possible = {name: one for name, one in known_effects().items() if one.acts_on(AXIS.motion)}
    assert {row["effect"] for row in rows} == {n for n, one in possible.items() if one.channel != "controller"}
    assert all(row["text"] for row in rows)
