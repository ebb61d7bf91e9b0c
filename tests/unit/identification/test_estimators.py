"""Instruments, output error, several records, the chosen cut-off: each against a known truth."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.errors import AxisError, InputError, RecordError
from emps_design.identification import identify
from emps_design.identification.chains import chosen_cutoff
from emps_design.identification.closed_loop import identify_by_output_error, identify_with_instruments
from emps_design.identification.several import identify_several
from emps_design.machines import machine
from emps_design.records import Record
from tests.studies import quick
from tests.unit.identification.slow_noise_records import slow_noise, trajectory

AXIS = machine("emps2019")
CUTOFF = 40.0


@pytest.mark.parametrize("estimate", [identify_with_instruments, identify_by_output_error])
def test_estimators_return_the_truth(simulate, truth, estimate):
    found = estimate(simulate(2, std=0.0), AXIS, cutoff=CUTOFF)
    for name, value in truth.items():
        assert found.parameters[name].value == pytest.approx(value, rel=1e-3)


def test_least_squares_is_biased_by_fast_force_noise_and_instruments_are_not(simulate, truth):
    """Noise that the loop cannot follow moves the carriage: it is in the acceleration, and pulls the mass down."""
    bias, biased = {"ls": [], "iv": []}, 0
    for seed in range(6):
        found = identify_with_instruments(simulate(seed, std=25.0, time=0.005), AXIS, cutoff=60.0)
        bias["iv"].append(found.parameters["mass"].value - truth["mass"])
        bias["ls"].append(found.extra["least_squares"]["mass"] - truth["mass"])
        biased += found.extra["hausman_test"]["bias_matters"]
    assert np.mean(bias["ls"]) < -1.0
    assert abs(np.mean(bias["iv"])) < 0.3 * abs(np.mean(bias["ls"]))
    assert biased >= 5


def test_instruments_are_taken_where_least_squares_is_biased_and_only_there(simulate, truth):
    noisy, other = simulate(0, laps=2, std=25.0, time=0.005), simulate(9)
    led = identify(noisy, AXIS, cutoff=60.0, holdout=other)
    assert led.estimator == "instrumental_variables"
    assert any(text.startswith("mass: the reference explains 44 % of its column") for text in led.warnings)
    low, high = led.parameters["mass"].interval_95
    assert low < truth["mass"] < high
    assert led.extra["held_out"]["on"] == other.name
    assert led.extra["held_out"]["rms_error"] < identify(noisy, AXIS, estimator="ls", cutoff=60.0).rms_error
    # Least squares stays where it is as good, where another chain or a bootstrap is asked for, and without a reference.
    for record, axis, options in (
        (simulate(1, std=1.0), AXIS, {}),
        (noisy, AXIS, {"filter": "report"}),
        (noisy, AXIS, {"bootstrap": 20}),
        (replace(noisy, q_ref_recorded=False), AXIS, {}),
        (noisy, AXIS.replace(controller={"kp": 4e3}), {}),  # no simulation with it follows the record
    ):
        assert identify(record, axis, **options).estimator == "least_squares"


def test_several_records_are_identified_by_what_one_of_them_asks_for(simulate, truth):
    """As one record alone is: least squares would take the mass of each too small, by more than their spread."""
    records = [simulate(seed, std=15.0, time=0.005) for seed in range(3)]
    found = identify_several(records, AXIS, cutoff=60.0)
    assert found.estimator == found.to_dict()["estimator"] == "instrumental_variables"
    plain = identify_several(records, AXIS, cutoff=60.0, estimator="ls")
    assert plain.estimator == "least_squares"
    mass, biased = (one.table()[0]["mean"] for one in (found, plain))
    assert abs(mass - truth["mass"]) < 0.3 * abs(biased - truth["mass"])
    assert found.cross_validation == pytest.approx(plain.cross_validation, rel=0.05)


def test_what_was_not_tested_is_said(simulate):
    noisy = simulate(0, std=25.0, time=0.005)
    for axis, options in ((AXIS, {"bootstrap": 20}), (AXIS.replace(controller={"kp": 4e3}), {})):
        said = identify(noisy, axis, **options).warnings[-1]
        assert said.startswith("the bias of least squares was not tested: ")


def test_noise_of_the_measured_voltage_biases_nothing(simulate, truth):
    """Noise on u alone does not reach W: the test says so, and the two estimates agree."""
    clean = simulate(3, std=0.0)
    noise = np.random.default_rng(0).standard_normal(len(clean)) * 0.05
    found = identify_with_instruments(replace(clean, u=clean.u + noise), AXIS, cutoff=CUTOFF)
    assert not found.extra["hausman_test"]["bias_matters"]
    assert found.extra["least_squares"]["mass"] == pytest.approx(found.parameters["mass"].value, rel=1e-4)


def test_output_error_of_the_asymmetric_model(simulate, truth):
    p = identify_by_output_error(simulate(4, std=0.0), AXIS, model="asymmetric", cutoff=CUTOFF).parameters
    assert p["viscous_positive"].value == pytest.approx(truth["viscous"], rel=5e-3)
    assert p["viscous_negative"].value == pytest.approx(truth["viscous"], rel=5e-3)
    half = 0.5 * (p["coulomb_positive"].value - p["coulomb_negative"].value)
    assert half == pytest.approx(truth["constant_force"], abs=0.05)


def test_simulated_estimators_need_the_controller(record):
    bare = AXIS.replace(controller={"kind": "none", "kp": 1.0, "kv": 1.0})
    with pytest.raises(AxisError, match="instruments need the controller"):
        identify_with_instruments(record, bare)
    with pytest.raises(AxisError, match="output error needs the controller"):
        identify_by_output_error(record, bare)


def test_the_cutoff_follows_the_motion_and_the_encoder(record):
    """The same motion a thousand times slower has a cut-off a thousand times lower; a noisy encoder lowers it."""
    chosen = chosen_cutoff(record)
    slower = replace(record, period=1e3 * record.period, t=1e3 * record.t)
    assert chosen_cutoff(slower) == pytest.approx(1e-3 * chosen, rel=0.01)
    random = np.random.default_rng(0)
    noisy, noisier = (
        chosen_cutoff(replace(record, q=record.q + std * random.standard_normal(len(record)))) for std in (2e-6, 2e-4)
    )
    assert noisier <= noisy < chosen
    # However noisy, strokes of 1.4 s keep some of their ramps of 80 to 240 ms.
    assert 5.0 < noisier < 12.0


def test_the_cutoff_stays_below_what_the_clock_allows(record):
    tenth = replace(record, period=0.02, t=20.0 * record.t)
    assert 0.0 < chosen_cutoff(tenth) <= 0.2 / 0.02
    shaken = replace(record, q=1e-4 * np.sin(2 * np.pi * 100.0 * record.t))
    assert chosen_cutoff(shaken) == pytest.approx(200.0)


def test_the_curve_beside_the_cutoff_says_where_the_model_stops_explaining(record):
    found = identify(record, AXIS).extra["cutoff_from_data"]
    frequency, explained = np.array(found["frequency_hz"]), np.array(found["explained"])
    assert np.all(explained[frequency < 10.0] > 0.5)
    assert np.mean(explained[frequency > 100.0]) < 0.1


@pytest.mark.parametrize("estimator", quick(["ls", "oe", "iv"], 1, "other estimators"))
def test_rests_bias_nothing(reference_plant, truth, estimator):
    """Two thirds of the record stand still under a slow force: Coulomb friction was 3 % low by output error."""
    q_ref, values = trajectory(1, rest=2.5), []
    for seed in range(8):
        random = np.random.default_rng(100 + seed)
        run = reference_plant.closed_loop(q_ref, disturbance=slow_noise(q_ref.size, random, 1.0, 0.1))
        record = Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name="rests")
        values.append(identify(record, AXIS, estimator=estimator).values())
    errors = np.mean(values, axis=0) - np.array(list(truth.values()))
    assert np.all(np.abs(errors) < 3.0 * np.std(values, axis=0) / np.sqrt(8))
    assert abs(errors[2]) < 0.01 * truth["coulomb"]


def test_output_error_does_without_a_stretch_away_from_rest(reference_plant, truth):
    """Strokes of 25 ms: what the other estimators do not determine is in the reversals that this one simulates."""
    q_ref = 1e-4 * (1.0 - np.cos(2 * np.pi * 20.0 * 1e-3 * np.arange(20000)))
    noise = 4e-3 * np.random.default_rng(0).standard_normal(q_ref.size)
    run = reference_plant.closed_loop(q_ref, voltage_noise=noise)
    record = Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name="shaken")
    assert not identify(record, AXIS, estimator="ls").parameters["viscous"].determined
    found = identify_by_output_error(record, AXIS)
    for name, value in truth.items():
        assert found.parameters[name].value == pytest.approx(value, rel=0.03)
    with pytest.raises(RecordError, match="rows away from rest at a cut-off of 20 Hz, expected at least 160"):
        identify(record, AXIS, cutoff=20.0)
    alone = identify_by_output_error(record, AXIS, cutoff=40.0)
    assert "so rests are included" in " ".join(alone.warnings)
    assert alone.parameters["mass"].value == pytest.approx(truth["mass"], rel=0.01)


def test_several_records_mean_spread_matrix_and_drift(simulate, truth):
    records = [simulate(seed) for seed in range(5)]
    found = identify_several(records, AXIS, filter="hold", cutoff=30.0)
    rows = {row["name"]: row for row in found.table()}
    for name, value in truth.items():
        assert rows[name]["mean"] == pytest.approx(value, abs=4 * rows[name]["std"] / np.sqrt(5))
        assert 0.2 < rows[name]["spread"] / rows[name]["std"] < 2.5
        assert not rows[name]["drift_significant"]
    own = np.diag(found.cross_validation)
    assert np.all(found.cross_validation >= own[None, :] - 1e-12)
    assert found.to_axis("mean").mechanics.mass == pytest.approx(rows["mass"]["mean"])
    low, high = found.mean().parameters["mass"].interval_95
    assert 0.5 * (low + high) == pytest.approx(rows["mass"]["mean"])
    assert high - low == pytest.approx(2 * 2.776 * np.sqrt(1 + 1 / 5) * rows["mass"]["spread"], rel=1e-3)  # t of 4


def test_drift_is_found(simulate, reference_plant):
    """Coulomb friction that grows by 1 N a record is a drift of 1 N per record."""
    records = []
    for index in range(5):
        b = AXIS.mechanics.array() + np.array([0.0, 0.0, float(index), 0.0])
        run = reference_plant.closed_loop(simulate(0).q_ref, baseline=b)
        records.append(replace(simulate(0), q=run.q, u=run.u, name=f"day {index}"))
    rows = {row["name"]: row for row in identify_several(records, AXIS, filter="hold", cutoff=30.0).table()}
    assert rows["coulomb"]["drift"] == pytest.approx(1.0, abs=0.05)
    assert rows["coulomb"]["drift_significant"]


def test_one_record_is_not_several(record):
    with pytest.raises(InputError, match="found 1, expected two or more"):
        identify_several([record], AXIS)


def test_estimators_agree_on_a_noisy_record(record):
    values = [
        identify(record, AXIS, filter="hold", cutoff=CUTOFF),
        identify_with_instruments(record, AXIS, cutoff=CUTOFF),
        identify_by_output_error(record, AXIS, cutoff=CUTOFF),
    ]
    for name in ("mass", "viscous", "coulomb", "constant_force"):
        spread = values[0].parameters[name].std_long_run
        for other in values[1:]:
            assert abs(other.parameters[name].value - values[0].parameters[name].value) < 2.5 * spread


def test_two_records_tell_no_drift(simulate):
    rows = identify_several([simulate(0), simulate(1)], AXIS, filter="hold", cutoff=30.0).table()
    assert {(row["drift"], row["drift_p_value"], row["drift_significant"]) for row in rows} == {(None, None, False)}


def test_the_search_for_the_controller_is_reported(record):
    stages = []
    identify(record, AXIS.replace(controller={"kind": "none"}), progress=lambda stage, share: stages.append(stage))
    assert stages == ["identifying the controller that made the record"]
