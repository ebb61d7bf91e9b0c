"""What a confirming record asks of a model, and what counts as noise between laps."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from emps_design.discrepancy.acceptance import Judge, resampled
from emps_design.discrepancy.beam_search import UNFINISHED
from emps_design.discrepancy.calibration import Outcome
from emps_design.discrepancy.confirmation import Share, _size_known, effect_shares, reliable_effects
from emps_design.discrepancy.diagnosis import NOT_REPEATED, _finer_floor, _repeat_with_finer_noise
from emps_design.discrepancy.fit import evaluate, fit
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import LAPS, Whitening, floor_of_laps, floor_of_residual, rms_interval
from emps_design.discrepancy.preparation import prepare
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import split
from emps_design.discrepancy.verdict import _refuted_in_free_run
from emps_design.effects import get_effect
from emps_design.effects.guesses import pulses
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps
from tests.studies import quick

AXIS = machine("emps2019")
Q_REF = trapezoid_laps(1e-3, stroke=0.1, speed=0.2, laps=4)


def problem(stiffness):
    noise = 4e-3 * np.random.default_rng(3).standard_normal(Q_REF.size)
    spring = {"kind": "elastic_force", "stiffness": stiffness, "rest_position": 0.05}
    run = Plant.of(AXIS.replace(effects=[spring])).closed_loop(Q_REF, voltage_noise=noise)
    record = Record(t=run.t, q_ref=Q_REF, q=run.q, u=run.u, period=1e-3, name="run")
    quiet = Plant.of(AXIS.replace(effects=[spring])).closed_loop(Q_REF)
    return Problem(
        AXIS, (record,), (split(record),), floor_of_residual((run.force - quiet.force,), 1e-3, "noise").whitening
    )


def model(**effects):
    found = Candidate(AXIS.mechanics.array())
    for name, parameters in effects.items():
        effect = get_effect(name)
        found = found.with_effect(effect, effect.values(parameters))
    return found


SPRING = {"stiffness": 60.0, "rest_position": 0.05}


@pytest.mark.parametrize(
    ("there", "share", "refuted"), quick([(30.0, 0.5, True), (60.0, 1.0, False), (120.0, 2.0, True)], 1, "other shares")
)
def test_a_record_asks_for_the_share_that_is_there(there, share, refuted):
    (asked,) = effect_shares(Hypothesis(problem(there), model(elastic_force=SPRING)))
    assert asked.exercised
    assert asked.share == pytest.approx(share, abs=max(5 * asked.std, 0.02))
    assert asked.refuted is refuted


def test_an_effect_that_the_record_does_not_bring_out_is_not_refuted():
    far = {"stiffness": 5e4, "position": 10.0, "side": 1.0}  # m
    shares = effect_shares(Hypothesis(problem(60.0), model(elastic_force=SPRING, end_stop=far)))
    assert [a.exercised for a in shares] == [True, False]
    assert not any(a.refuted for a in shares)


def test_an_effect_stands_beside_something_unknown_and_what_stands_in_for_it_does_not():
    noise, unknown = np.random.default_rng(5), {"kind": "position_dependent_friction"}
    unknown |= {"amplitude": 4.0, "length": 0.08, "phase": 0.3}
    spring = {"kind": "elastic_force", **SPRING}
    axis = AXIS.replace(effects=[{**spring, "stiffness": 150.0}, unknown])
    run = Plant.of(axis).closed_loop(Q_REF, voltage_noise=4e-3 * noise.standard_normal(Q_REF.size))
    record = Record(t=run.t, q_ref=Q_REF, q=run.q, u=run.u, period=1e-3, name="run")
    seen = Problem(AXIS, (record,), (split(record),), problem(0.0).whitening)
    there, stand_in = {**SPRING, "stiffness": 150.0}, {"amplitude": 3.0, "period": 0.04, "phase": 0.0}
    shares = effect_shares(Hypothesis(seen, model(elastic_force=there, position_ripple=stand_in)))
    assert [a.is_reliable for a in shares] == [True, False]
    assert shares[0].confirmed["share"] == pytest.approx(1.0, abs=0.1)


def with_a_spring(stiffness):
    """A record of a machine with a spring under the noise of one without."""
    axis = AXIS.replace(effects=[{"kind": "elastic_force", **SPRING, "stiffness": stiffness}])
    run = Plant.of(axis).closed_loop(Q_REF, voltage_noise=4e-3 * np.random.default_rng(5).standard_normal(Q_REF.size))
    record = Record(t=run.t, q_ref=Q_REF, q=run.q, u=run.u, period=1e-3, name="run")
    return Problem(AXIS, (record,), (split(record),), problem(0.0).whitening)


@pytest.mark.study("several fits")
def test_what_stands_is_known_as_well_whatever_the_numbers_of_the_model_that_it_was_part_of():
    fitted_with_more = model(elastic_force={**SPRING, "stiffness": 130.0})
    reliable, withdrawn = reliable_effects(None, evaluate(Hypothesis(with_a_spring(150.0), fitted_with_more)))
    assert reliable.model.names == ("elastic_force",)
    assert withdrawn == ()
    assert reliable.model.values[0][0, 0] == pytest.approx(150.0, rel=0.01)


@pytest.mark.study("two diagnoses")
@pytest.mark.parametrize(("largest", "stands"), quick([(140.0, False), (1e9, True)], 1, "where it stands"))
def test_what_ends_on_a_bound_when_it_is_fitted_anew_does_not_stand(largest, stands):
    spring = get_effect("elastic_force")
    stiffness, *others = spring.parameters
    bounded = replace(spring, parameters=(replace(stiffness, upper=largest), *others))
    start_model = model().with_effect(bounded, bounded.values({**SPRING, "stiffness": 130.0}))
    found, _ = reliable_effects(None, evaluate(Hypothesis(with_a_spring(150.0), start_model)))
    assert bool(found.model.names) is stands


@pytest.mark.parametrize(("stiffness", "more"), [(60.0, False), (90.0, True)])
def test_a_force_of_more_than_noise_is_left_however_white_it_looks(stiffness, more):
    fitted = evaluate(Hypothesis(problem(60.0), model(elastic_force={**SPRING, "stiffness": stiffness})))
    floor = floor_of_residual(
        evaluate(Hypothesis(problem(60.0), model(elastic_force=SPRING))).remaining_force(), 1e-3, LAPS
    )
    judge = Judge(floor, SimpleNamespace(threshold=0.0))
    assert judge.leaves_force(fitted) is more
    assert judge.leaves_structure(fitted) is more
    assert judge.at_floor(fitted) is not more


def test_what_a_record_does_not_tell_is_not_confirmed():
    assert Share("end_stop", 1.0, 0.1, 1.0, exercised=False).confirmed is None
    assert Share("end_stop", 0.9, 0.01, 0.9, exercised=True).confirmed == {
        "share": 1.0,
        "std": pytest.approx(0.011, abs=1e-3),
    }


def test_what_is_lost_in_the_bounces_of_play_does_not_stand_and_the_play_itself_does():
    for repeats, of_another, of_play in ((0.2, False, True), (0.9, True, True)):
        shares = dict(share=repeats, std=0.01, repeats=repeats, exercised=True)
        assert Share("external_force", **shares).is_reliable is of_another
        assert Share("backlash", **shares, bounces=True).is_reliable is of_play


@pytest.mark.parametrize(
    ("share", "weighed", "hardly"),
    [
        (0.7, [(0.0, 0.09), (0.36, 0.08), (0.0, 0.11)], True),  # within reach of all of it by the noise of laps alone
        (1.2, [(0.6, 0.4), (-0.7, 0.4), (0.2, 0.5)], True),  # a share that is not known
        (0.9, [(0.5, 0.1), (0.8, 0.1), (0.4, 0.1)], False),
    ],
)
def test_what_is_hardly_wanted_however_the_rest_is_weighed_is_neither_refuted_nor_kept(share, weighed, hardly):
    tested = Share("stribeck_friction", share, 0.04, 1.0, exercised=True, weighted=tuple(weighed))
    assert (tested.refuted, tested.weakly_confirmed) == (False, hardly)
    assert not replace(tested, exercised=False).weakly_confirmed


def test_a_drift_between_laps_is_no_noise():
    lap = split(Record(np.arange(Q_REF.size) * 1e-3, Q_REF, Q_REF, 0 * Q_REF, 1e-3))
    noise = 0.5 * np.random.default_rng(0).standard_normal(Q_REF.size)
    drift = 20.0 * np.arange(Q_REF.size) / Q_REF.size * np.sign(np.gradient(Q_REF))
    floor = floor_of_laps((noise + drift,), (lap,), 1e-3)
    assert floor.force == pytest.approx(0.5, rel=0.05)
    assert floor_of_laps((noise,), (lap,), 1e-3).force == pytest.approx(0.5, rel=0.05)


def test_the_interval_of_an_rms_holds_it_for_coloured_noise():
    random, inside = np.random.default_rng(1), 0
    for _ in range(60):
        noise = np.convolve(random.standard_normal(10_200), np.ones(50) / np.sqrt(50), mode="valid")
        low, high = rms_interval(noise)
        inside += low < 1.0 < high
    assert inside >= 51  # 95 % of 60 is 57; fewer than 51 happens once in ten thousand


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_pulse_trains_are_found_to_two_milliseconds(sign):
    t = np.arange(25_000) * 1e-3
    train = sign * 17.0 * ((np.mod(t - 2.547, 5.279) < 0.2247) & (t > 2.547))
    found = pulses(train + np.random.default_rng(0).standard_normal(t.size), t, 1e-3)
    best = max(found, key=lambda p: p["every"])
    assert best["amplitude"] == pytest.approx(sign * 17.0, rel=0.03)
    assert [best[n] for n in ("start", "duration", "every")] == pytest.approx([2.547, 0.2247, 5.279], abs=3e-3)


def test_a_train_of_which_pulses_are_hidden_keeps_its_rhythm():
    """Those from 7 s to 10 s are not seen: the times between are 10.6, 5.3 and 5.3 s, and once only 10.6 and 5.3 s."""
    t = np.arange(25_000) * 1e-3
    train = 17.0 * ((np.mod(t - 2.547, 5.279) < 0.2247) & (t > 2.547)) * ((t < 7.0) | (t > 10.0))
    for end in (25.0, 20.0):
        seen = (train + np.random.default_rng(0).standard_normal(t.size)) * (t < end)
        found = pulses(seen, t, 1e-3)
        assert min(abs(p["every"] - 5.279) + abs(p["start"] - 2.547) for p in found) < 6e-3


def test_pulses_of_a_train_do_not_overlap():
    """What pulses ten times a second at the start of a record only is no train with none between its pulses."""
    t = np.arange(4000) * 1e-3
    seen = 5.0 * ((np.mod(t, 0.1) < 0.06) & (t < 1.5)) + 0.3 * np.random.default_rng(0).standard_normal(t.size)
    trains = [pulse for pulse in pulses(seen, t, 1e-3) if pulse["every"]]
    assert trains
    assert all(pulse["every"] >= pulse["duration"] for pulse in trains)


def test_a_hum_out_of_step_with_the_laps_is_no_noise():
    lap = split(Record(np.arange(Q_REF.size) * 1e-3, Q_REF, Q_REF, 0 * Q_REF, 1e-3))
    noise = 0.5 * np.random.default_rng(0).standard_normal(Q_REF.size)
    hum = 8.0 * np.sin(2 * np.pi * 3.66 * 1e-3 * np.arange(Q_REF.size))
    assert floor_of_laps((noise + hum,), (lap,), 1e-3).force == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize(("std", "known"), [(5.0, True), (18.0, False)])
def test_beside_something_unknown_an_effect_needs_a_size_of_its_own(std, known):
    """A spring of 74 +- 18 N/m, whose stiffness moves with how the rest is weighed, was lent by the rest."""
    spring = get_effect("elastic_force")
    model = SimpleNamespace(names=("elastic_force",), effects=(spring,), values=(np.array([[74.0]]),))
    fitted = SimpleNamespace(model=model, std=lambda effect, place: std)
    assert _size_known(fitted, "elastic_force") is known


def test_noise_is_what_differs_between_laps_beyond_what_the_model_knows_of():
    drift = {"kind": "friction_drift", "change": 0.5, "time_constant": 12.0}
    curved = {"kind": "nonlinear_viscous_friction", "amount": 6.0, "exponent": 2.0}
    noise = 4e-3 * np.random.default_rng(3).standard_normal(Q_REF.size)
    run = Plant.of(AXIS.replace(effects=[drift, curved])).closed_loop(Q_REF, voltage_noise=noise)
    record = Record(t=run.t, q_ref=Q_REF, q=run.q, u=run.u, period=1e-3, name="run")
    white = Problem(AXIS, (record,), (split(record),), Whitening(np.array([1.0]), 0.14))

    def of_laps(fitted):
        return floor_of_laps(fitted.residuals(), white.splits, 1e-3)

    start = fit(Hypothesis(white, Candidate(AXIS.mechanics.array())))
    effect = get_effect("friction_drift")
    begun = start.model.with_effect(effect, effect.values({"change": 0.4, "time_constant": 10.0}))
    drifting = fit(start.with_model(begun))
    taken = of_laps(start)
    assert (
        np.std(np.concatenate(drifting.remaining_force())) > taken.force
    )  # the friction hides in the noise of unlike laps

    def finer(floor, best, force=None):
        return _finer_floor(SimpleNamespace(floor=floor, best=best, unknown_force=force))

    again = finer(taken, drifting)
    assert again.source == LAPS
    assert again.force == pytest.approx(of_laps(drifting).force)
    assert again.force < 0.5 * taken.force
    assert finer(again, drifting) is None
    # Nor is noise what an unknown force of one kind explains, with what was found beside it.
    assert finer(taken, start) is None
    assert finer(taken, start, SimpleNamespace(fitted=drifting)).force == pytest.approx(again.force)


@pytest.mark.parametrize(("is_plain", "unfinished"), [(True, False), (False, True)])
def test_an_interrupt_of_a_later_search_says_what_was_left_undone(monkeypatch, is_plain, unfinished):
    """A search that stopped at an unknown force which is not plain was to be gone on with."""

    def interrupted(*arguments):
        raise KeyboardInterrupt

    module = sys.modules["emps_design.discrepancy.diagnosis"]
    monkeypatch.setattr(module, "_finer_floor", lambda outcome: "finer")
    monkeypatch.setattr(module, "calibrate", interrupted)
    of_a_kind = SimpleNamespace(is_sufficient=is_plain)
    first = Outcome(None, None, SimpleNamespace(searched=1), [], ("model",), {}, unknown_force=of_a_kind)
    repeated = _repeat_with_finer_noise(first, 0, 1, lambda stage, share: None)
    assert repeated.path == first.path
    assert repeated.warnings == (NOT_REPEATED, UNFINISHED)[: 1 + unfinished]
    assert repeated.interrupted is unfinished


def test_an_interrupt_of_the_healthy_searches_leaves_resampled_noise(monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    module = sys.modules["emps_design.discrepancy.calibration"]
    linearised = ("tangent", "screen", "by_signature", "suspects_text", "healthy_reference")
    for name in ("fit", *linearised, "Hypothesis", "best_of_each_set"):
        monkeypatch.setattr(module, name, lambda *arguments, **options: "made")
    monkeypatch.setattr(module, "healthy_runs", interrupted)
    start = SimpleNamespace(problem=SimpleNamespace(with_whitening=lambda whitening: None), model=None)
    floor, prepared = SimpleNamespace(whitening=None, draws=None), SimpleNamespace(library=())
    calibrated = module.calibrate(prepared, start, floor, 0, 1, lambda stage, share: None)
    assert [message.code for message in calibrated.warnings] == ["calibration-interrupted"]


SPRUNG = {"kind": "flexible_coupling", "frequency": 3.0, "damping": 0.01, "share": 0.6}


@pytest.mark.parametrize(("hidden", "refuted"), [(SPRUNG, True), ({"kind": "actuator_deadzone", "width": 0.5}, False)])
def test_a_dead_zone_that_stands_in_for_a_load_on_a_spring_is_refuted_by_the_free_run(hidden, refuted):
    """Square waves of one size: a dead zone nearly as wide leaves no force to miss, and moves elsewhere."""
    numbers, drive = (
        {"mass": 0.92, "viscous": 9.0, "coulomb": 0.3, "offset": 0.0},
        {"force_gain": 1.0, "voltage_limit": 10.0},
    )
    motor = AXIS.replace(controller={"kind": "none"}, mechanics=numbers, drive=drive)
    u = 1.5 * np.where(np.floor(np.arange(4001) * 1e-3) % 2 == 0, -1.0, 1.0)
    run = Plant.of(motor.replace(effects=[hidden])).open_loop(u)
    record = Record(t=run.t, q_ref=run.q, q=run.q, u=u, period=1e-3, name="square")
    dead_zone = get_effect("actuator_deadzone")
    first = prepare((record,), motor, (dead_zone,), None, None, None).start
    quiet = first.problem.with_whitening(Whitening(np.array([1.0]), 1e-3))  # N
    start = fit(Hypothesis(quiet, first.model))
    extended = fit(start.with_model(start.model.with_effect(dead_zone, np.array([[0.8]]))))
    errors = _refuted_in_free_run(start, SimpleNamespace(verdict="named", extended=extended))
    assert (errors is not None) is refuted
    if refuted:
        assert extended.cost < 1e-2 * start.cost  # the force that follows the record
        assert errors[0] == pytest.approx(np.sqrt(np.mean(start.free_run() ** 2)))
        assert errors[0] < errors[1]


def test_a_free_run_that_noise_alone_moves_as_far_refutes_nothing():
    """Friction that falls with speed makes slow free motion a matter of chance: whether it sticks, and when."""
    numbers = {"mass": 8e-4, "viscous": 2e-3, "coulomb": 0.16, "offset": 0.0}
    falls = {"kind": "stribeck_friction", "excess": 0.07, "stribeck_velocity": 2.5, "exponent": 2.0}
    motor = AXIS.replace(
        motion="rotary",
        mechanics=numbers,
        drive={"force_gain": 0.05, "command": "current", "command_limit": 30.0},
        sampling={"encoder_resolution": 2 * np.pi / 65536},
        controller={"kind": "position_pd", "kp": 40.0, "kv": 1.0},
    )
    generator = np.random.default_rng(19)
    speeds = np.repeat(generator.uniform(-200.0, 200.0, 14) * generator.choice([1.0, 0.1, 0.02], 14), 400)
    push = 2e-3 * generator.standard_normal(speeds.size)
    run = Plant.of(motor.replace(effects=[falls])).closed_loop(np.cumsum(speeds) * 1e-3, disturbance=push)
    record = Record(t=run.t, q_ref=run.q, q=run.q, u=run.u, period=1e-3, name="slow")
    effect = get_effect("stribeck_friction")
    first = prepare((record,), motor.replace(controller={"kind": "none"}), (effect,), None, None, None).start
    noisy = first.problem.with_whitening(Whitening(np.array([1.0]), 0.015))  # N m
    start = fit(Hypothesis(noisy, first.model))
    extended = fit(start.with_model(start.model.with_effect(effect, np.array([[0.07, 2.5, 2.0]]))))
    assert extended.cost < start.cost
    assert np.mean(extended.free_run() ** 2) > 2.0 * np.mean(start.free_run() ** 2)
    assert _refuted_in_free_run(start, SimpleNamespace(verdict="named", extended=extended)) is None


def test_few_draws_are_resampled_as_a_ring():
    drawn = resampled(np.array([1.0, 2.0, 3.0]), 5, np.array([1]), np.array([-1.0]))
    assert drawn.tolist() == [-2.0, -3.0, -1.0, -2.0, -3.0]
