"""Identification of simulated records, whose parameters are known."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.errors import AxisError, InputError, RankError, RecordError
from emps_design.identification import identify
from emps_design.identification.chains import hold_chain, report_chain
from emps_design.identification.filters import central_difference, decimate, held_force, low_pass, mean_of_held, motion
from emps_design.identification.inverse_model import least_squares, regression
from emps_design.identification.model import baseline_columns, parameters_of, with_predicted_force
from emps_design.machines import machine
from emps_design.records import Record

AXIS = machine("emps2019")


@pytest.fixture(scope="module")
def clean(simulate):
    return simulate(1, std=0.0)


def test_hold_chain_returns_the_truth(clean, truth):
    found = identify(clean, AXIS, filter="hold", cutoff=40.0)
    for name, value in truth.items():
        assert found.parameters[name].value == pytest.approx(value, rel=2e-3, abs=0.02)
    assert found.rms_error < 0.3


def test_a_record_that_ends_on_the_move_biases_nothing(clean, truth):
    """Beyond its ends the filters of motion and force go on differently; what they make up is left out."""
    faster = np.diff(np.abs(central_difference(low_pass(clean.q, 20.0, clean.period), clean.period)))
    half = len(faster) // 2
    cut = clean.part(int(np.argmax(faster[:half])), half + int(np.argmax(faster[half:])))
    W, Y = regression(hold_chain(cut, AXIS.drive.force_gain, 20.0), "symmetric")
    assert np.max(np.abs(Y - W @ np.array(list(truth.values())))) < 0.25  # N, of 95


def test_ignoring_the_hold_costs_accuracy(clean, truth):
    """With u[k] in place of (u[k] + u[k-1])/2 the error is larger: half a sample of delay."""
    hold = hold_chain(clean, AXIS.drive.force_gain, 60.0)
    W = baseline_columns(hold.motion)[500:-500]
    used = hold.motion.v[500:-500] != 0
    good = held_force(clean, AXIS.drive.force_gain, 60.0)[500:-500]
    late = low_pass(AXIS.drive.force_gain * clean.u, 60.0, clean.period)[500:-500]
    errors = [np.linalg.norm((force - W @ np.array(list(truth.values())))[used]) for force in (good, late)]
    assert errors[0] < errors[1]


def test_asymmetric_model_of_a_symmetric_machine(clean, truth):
    p = identify(clean, AXIS, model="asymmetric", filter="hold", cutoff=40.0).parameters
    assert p["viscous_positive"].value == pytest.approx(p["viscous_negative"].value, abs=3.0)
    half = 0.5 * (p["coulomb_positive"].value - p["coulomb_negative"].value)
    assert half == pytest.approx(truth["constant_force"], abs=0.1)


@pytest.mark.parametrize("model", ["symmetric", "asymmetric"])
def test_to_axis_holds_the_parameters_and_reads_back(record, model):
    found = identify(record, AXIS, model=model)
    axis = found.to_axis("mine")
    assert Axis.from_toml(axis.to_toml()) == axis
    assert axis.mechanics.mass == pytest.approx(found.parameters["mass"].value)
    if model == "asymmetric":
        p = found.parameters
        half = 0.5 * (p["viscous_positive"].value - p["viscous_negative"].value)
        assert axis.effects[0].kind == "asymmetric_viscous_friction"
        assert axis.effects[0].parameters["viscous_difference"] == pytest.approx(half)
        assert axis.mechanics.offset == pytest.approx(0.5 * (p["coulomb_positive"].value - p["coulomb_negative"].value))


def test_names_of_the_contract(record):
    keys = set(identify(record, AXIS, model="asymmetric").to_dict()["parameters"])
    assert keys == {"mass", "viscous_positive", "viscous_negative", "coulomb_positive", "coulomb_negative"}
    data = identify(record, AXIS).to_dict()
    assert set(data["parameters"]["mass"]) >= {"value", "std", "relative_std_percent", "unit"}
    assert {"rms_error", "relative_error_percent", "condition_number"} <= set(data)


def test_force_gain_scales_every_parameter(record):
    """A gain error cannot be told from the mechanics."""
    twice = AXIS.replace(drive={"force_gain": 2 * AXIS.drive.force_gain})
    np.testing.assert_allclose(identify(record, twice).values(), 2 * identify(record, AXIS).values(), rtol=1e-9)


def test_measured_external_force_takes_part(record, truth, reference_plant):
    """Y = tau_m + tau_e (21): with the force known the parameters come out, refused without a word about it."""
    push = 30.0 * np.sin(2 * np.pi * 0.7 * record.t)
    run = reference_plant.closed_loop(record.q_ref, disturbance=push)
    pushed = replace(record, q=run.q, u=run.u, f_ext=push)
    with pytest.raises(RecordError, match=r"external force of 21\.\d N rms acts.*`external_force='known'`"):
        identify(pushed, AXIS)
    found = identify(pushed, AXIS, external_force="known", filter="hold", cutoff=40.0)
    assert found.parameters["mass"].value == pytest.approx(truth["mass"], rel=5e-3)


def test_bootstrap_agrees_with_the_long_run(record):
    found = identify(record, AXIS, filter="hold", cutoff=30.0, bootstrap=200, seed=3)
    again = identify(record, AXIS, filter="hold", cutoff=30.0, bootstrap=200, seed=3)
    for name, estimate in found.parameters.items():
        assert estimate.std_bootstrap == again.parameters[name].std_bootstrap
        assert 0.4 < estimate.std_bootstrap / estimate.std_long_run < 1.6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: replace(r, q=np.zeros_like(r.q)), r"no motion, the stroke is 0 m; record a trajectory"),
        (
            lambda r: replace(r, q=3e-5 * r.q),
            r"found a stroke of .* m, \d+ steps of the encoder, expected at least 200;",
        ),
        (lambda r: replace(r, u=10.0 * np.sign(r.u)), r"at the limit of 10 V for \d+ % of the time.*slower motion"),
    ],
)
def test_records_that_cannot_identify(record, change, message):
    with pytest.raises(RecordError, match=message):
        identify(change(record), AXIS)


def test_a_stage_that_moves_by_micrometres_is_identified(record):
    """What matters is the number of encoder steps in the stroke."""
    small = replace(record, q=1e-6 * record.q, q_ref=1e-6 * record.q_ref)
    fine = AXIS.replace(sampling={"encoder_resolution": 1e-6 * AXIS.sampling.encoder_resolution})
    found, large = (identify(r, axis, filter="hold", cutoff=30.0) for r, axis in ((small, fine), (record, AXIS)))
    assert np.ptp(small.q) < 1e-6
    for name, size in (("mass", 1e6), ("viscous", 1e6), ("coulomb", 1.0)):
        assert found.parameters[name].value == pytest.approx(size * large.parameters[name].value, rel=1e-6)


def test_one_speed_one_way_tells_nothing_and_says_what_to_record(record):
    found = identify(replace(record, q=record.t * 0.01, q_ref=record.t * 0.01), AXIS)
    assert not any(one.determined for one in found.parameters.values())
    warnings = " ".join(found.warnings)
    assert "includes more than the whole force; record several speeds in both directions" in warnings
    assert "the motion has one direction only" in warnings


def test_rank_deficiency_names_the_columns():
    v = np.array([1.0, -1.0, 2.0, -2.0])
    columns = np.column_stack([v > 0, -1.0 * (v < 0), np.ones(4)]).astype(float)
    with pytest.raises(RankError, match="coulomb_positive, coulomb_negative, constant_force") as caught:
        least_squares(columns, v, ("coulomb_positive", "coulomb_negative", "constant_force"))
    assert caught.value.columns == ("coulomb_positive", "coulomb_negative", "constant_force")
    with pytest.raises(RankError, match="does not excite: mass"):
        least_squares(np.column_stack([np.zeros(4), v]), v, ("mass", "viscous"))


def test_refusals_name_the_nearest(record):
    with pytest.raises(InputError, match="`model`: found 'asymetric'.*did you mean 'asymmetric'"):
        identify(record, AXIS, model="asymetric")
    with pytest.raises(InputError, match="model: found 'symetric'.*did you mean 'symmetric'"):
        parameters_of("symetric")
    with pytest.raises(InputError, match="`filter`: found 'holt'.*did you mean 'hold'"):
        identify(record, AXIS, filter="holt")
    with pytest.raises(InputError, match="Nyquist frequency 500 Hz"):
        identify(record, AXIS, cutoff=600.0)
    with pytest.raises(InputError, match="the paper's chain has none"):
        identify(record, AXIS, filter="paper", cutoff=50.0)
    with pytest.raises(InputError, match="found 10 samples, expected more than 12"):
        low_pass(np.zeros(10), 50.0, 1e-3)


def run_along(reference_plant, record, q_ref):
    run = reference_plant.closed_loop(q_ref, voltage_noise=4e-3 * np.random.default_rng(0).standard_normal(q_ref.size))
    return replace(record, t=run.t, q_ref=q_ref, q=run.q, u=run.u, name="poor")


def test_a_mass_that_nothing_accelerates_is_not_determined(record, reference_plant):
    """The acceleration of a very slow sine is encoder noise: no mass, rather than one with a tiny deviation.

    At the cut-off that motion and encoder ask for it is motion, and the mass is found.
    """
    t = np.arange(20000) * record.period
    slow = run_along(reference_plant, record, 0.01 * (1 - np.cos(2 * np.pi * 0.05 * t)))
    found = identify(slow, AXIS, filter="report")
    mass = found.parameters["mass"]
    assert not mass.determined
    assert mass.value is mass.std is mass.interval_95 is None
    assert found.parameters["coulomb"].determined
    assert "mass is not determined: the reference explains" in " ".join(found.warnings)
    assert np.isnan(found.values()[0])
    with pytest.raises(AxisError, match=r"mass not determined by the record, the axis needs all"):
        found.to_axis()
    low, high = identify(slow, AXIS).parameters["mass"].interval_95
    assert low < AXIS.mechanics.mass < high < 1.01 * low


def test_friction_from_one_speed_is_not_split(record, reference_plant):
    """At one speed viscous and Coulomb friction are told apart by reversals alone, which the chain does not model."""
    t = np.arange(20000) * record.period
    velocity = np.convolve(np.where((t % 4) < 2, 0.05, -0.05), np.ones(50) / 50, "same")
    one_speed = run_along(reference_plant, record, np.cumsum(velocity) * record.period)
    for found in (identify(one_speed, AXIS, estimator=one) for one in ("ls", "iv")):
        assert not found.parameters["coulomb"].determined
        assert found.parameters["constant_force"].determined
        assert "only reversals and rests determine it" in " ".join(found.warnings)


def test_a_record_that_never_slides_long_says_so(record, reference_plant):
    t = np.arange(20000) * record.period
    shaken = run_along(reference_plant, record, 0.0005 * (1 - np.cos(2 * np.pi * 9 * t)))
    found = identify(shaken, AXIS)
    assert found.parameters["mass"].value == pytest.approx(AXIS.mechanics.mass, rel=1e-3)
    assert "viscous is not determined: only reversals and rests determine it" in " ".join(found.warnings)
    with pytest.raises(RecordError, match=r"\d+ rows away from rest at a cut-off of 20 Hz.* record longer strokes"):
        identify(shaken, AXIS, cutoff=20.0)


def test_a_short_stop_is_a_rest_at_any_cutoff(reference_plant, record):
    """A stop of 20 ms between two strokes the same way is smoothed away by a low cut-off, and stays left out."""
    velocity = np.concatenate([np.full(400, 0.1), np.zeros(20), np.full(400, 0.1), np.full(800, -0.1), np.zeros(100)])
    smooth = np.convolve(np.tile(velocity, 4), np.ones(10) / 10, "same")
    stopping = run_along(reference_plant, record, np.cumsum(smooth) * record.period)
    for cutoff in (15.0, 60.0):
        chain = hold_chain(stopping, AXIS.drive.force_gain, cutoff)
        stops = (chain.t % 1.72 > 0.405) & (chain.t % 1.72 < 0.425)
        assert stops.any()
        assert not chain.used[stops].any()


def test_a_record_that_holds_enough_is_not_refused(simulate, truth):
    """A few strokes at a low cut-off are fewer than 400 rows away from rest, and tell the parameters all the same."""
    found = identify(simulate(3, laps=1).part(2000, 6500), AXIS, cutoff=12.0)
    assert 160 < found.samples < 400
    for name in ("mass", "viscous", "coulomb"):
        low, high = found.parameters[name].interval_95
        assert low < truth[name] < high


def test_motion_is_the_same_filter_on_all(clean):
    seen = motion(clean, 50.0)
    np.testing.assert_allclose(seen.smooth(clean.q), seen.q)
    b = np.array([95.0, 200.0, 20.0, -3.0])
    np.testing.assert_allclose(with_predicted_force(seen, b).tau, baseline_columns(seen) @ b)


def test_second_difference_and_held_force_balance_exactly():
    """A mass alone under a held force: M times the second difference is the mean of two forces, to rounding."""
    rng = np.random.default_rng(5)
    force, mass, T = rng.standard_normal(200), 3.0, 1e-3
    q, v = np.zeros(201), 0.0
    for k in range(200):
        q[k + 1] = q[k] + v * T + 0.5 * force[k] / mass * T**2
        v += force[k] / mass * T
    second = (q[2:] - 2 * q[1:-1] + q[:-2]) / T**2
    np.testing.assert_allclose(mass * second, mean_of_held(force)[1:], rtol=1e-6, atol=1e-6)


def test_long_signals_are_filtered_in_blocks_without_a_trace(monkeypatch):
    signal = np.cumsum(np.random.default_rng(0).standard_normal(30000))
    whole = low_pass(signal, 60.0, 1e-3), decimate(signal, 10)
    monkeypatch.setattr("emps_design.identification.filters.BLOCK", 4000)
    for block, reference in zip((low_pass(signal, 60.0, 1e-3), decimate(signal, 10)), whole, strict=True):
        np.testing.assert_allclose(block, reference, rtol=0, atol=1e-12 * np.max(np.abs(signal)))


def test_report_chain_keeps_every_tenth_sample_to_the_last(record):
    seen = report_chain(record, 35.0)
    assert len(seen.reduce(seen.motion.q)) == len(seen.used)
    assert decimate(np.arange(95.0), 10).size == 10
    assert seen.t[-1] == record.t[-1]
    np.testing.assert_allclose(np.diff(seen.t), 10 * record.period)
    whole = identify(record, AXIS, filter="hold").series["t"]
    assert record.t[0] < whole[0] < whole[-1] < record.t[-1]


def test_interval_of_a_chain_that_ignores_the_hold_knows_its_bias(truth):
    """On a quiet record the report's chain is wrong by more than its statistics; its interval says so."""
    from emps_design.simulation.synthetic import synthetic_record

    quiet = synthetic_record(AXIS, laps=1, stroke=0.1)
    found = identify(quiet, AXIS, filter="report")
    mass = found.parameters["mass"]
    assert abs(mass.value - truth["mass"]) > 2 * mass.std_long_run
    for name, value in truth.items():
        low, high = found.parameters[name].interval_95
        assert low <= value <= high
    assert identify(quiet, AXIS).parameters["mass"].systematic is None


def test_fit_is_judged_on_what_took_no_part(record, simulate):
    """On a healthy machine the held-out error is the fit's own; on one whose friction changed it is not."""
    own = identify(record, AXIS, filter="hold", cutoff=30.0)
    assert own.extra["held_out"]["on"] == "last third"
    assert own.extra["held_out"]["rms_error"] == pytest.approx(own.rms_error, rel=0.3)
    other = identify(record, AXIS, filter="hold", cutoff=30.0, holdout=simulate(9))
    assert other.extra["held_out"]["on"] == "simulated-9"
    assert other.extra["held_out"]["rms_error"] == pytest.approx(own.rms_error, rel=0.3)


def test_a_force_sensor_nobody_touches_is_no_external_force(record, simulate):
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(record))
    plain = identify(record, AXIS)
    seen = identify(replace(record, f_ext=noise), AXIS)
    assert seen.values().tolist() == plain.values().tolist()
    assert "f_ext: its 0.05 N rms are treated as sensor noise and ignored" in " ".join(seen.warnings)
    with pytest.raises(RecordError, match="an external force of 30 N rms acts"):
        identify(replace(record, f_ext=np.full(len(record), 30.0)), AXIS)
    with pytest.raises(RecordError, match="simulated-9: an external force of 30 N rms acts"):
        identify(record, AXIS, holdout=replace(simulate(9), f_ext=np.full(len(record), 30.0)))


def test_a_cutoff_of_nothing_is_refused(record):
    for chain in ("report", "hold"):
        with pytest.raises(InputError, match="cut-off: found 0 Hz, expected between 0 and the Nyquist frequency"):
            identify(record, AXIS, filter=chain, cutoff=0.0)


def test_slow_sampling_says_what_to_use_instead(record):
    tenth = Record.from_arrays(10 * record.period, record.q_ref[::10], record.q[::10], record.u[::10], name="tenth")
    with pytest.raises(
        InputError, match="tenth: sampled at 100 Hz, the report's low-pass .* use `filter='hold'`, or give"
    ):
        identify(tenth, AXIS, filter="report")
    assert identify(tenth, AXIS).parameters["mass"].value == pytest.approx(AXIS.mechanics.mass, rel=0.02)
    with pytest.raises(
        RecordError, match="tenth: the simulation with the controller of emps2019 at 100 Hz .* another one"
    ):
        identify(tenth, AXIS, estimator="iv")
