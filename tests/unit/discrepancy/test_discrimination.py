"""Excitations stay inside what the record shows; the chosen one tells two models apart, as far as it says."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.discrepancy import diagnose
from emps_design.discrepancy.acceptance import Healthy
from emps_design.discrepancy.calibration import Outcome
from emps_design.discrepancy.experiment import EXCITATIONS, Envelope, choose, excitations, experiment, instruction
from emps_design.discrepancy.fit import fit
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import Whitening, floor_of_laps
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import split
from emps_design.effects import REGISTRY, get_effect, register
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import multi_sine, synthetic_record, trapezoid_laps
from emps_design.units import Units
from tests.studies import quick

AXIS = machine("emps2019")
THRESHOLD = 15.0  # gain in whitened cost, as a healthy reference gives it
REFERENCES = {
    "trapezoids": 0.05 + trapezoid_laps(1e-3, stroke=0.1, speed=0.2, laps=1),
    "long stroke": trapezoid_laps(1e-3, stroke=0.5, speed=0.1, acceleration=0.5, laps=1),
    "multi-sine": 0.2 + multi_sine(1e-3, 12.0),
    "triangles": 0.1 * np.abs((np.arange(12000) * 1e-3 + 1) % 2 - 1),
    "slow": trapezoid_laps(1e-3, stroke=0.1, speed=0.02, laps=1),
    "2 ms": trapezoid_laps(2e-3, stroke=0.2, laps=1),
}


def record(axis=AXIS, q_ref=REFERENCES["trapezoids"], seed=0) -> Record:
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(q_ref.size)
    run = Plant.of(axis).closed_loop(q_ref, voltage_noise=noise)
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=axis.sampling.period)


def test_the_envelope_is_what_the_record_shows():
    seen = Envelope.of([record()])
    assert seen.home == 0.05
    assert 0.05 < seen.low < 0.053
    assert 0.147 < seen.high < 0.15
    assert seen.speed == pytest.approx(0.9 * 0.2, rel=1e-3)
    assert seen.acceleration == pytest.approx(0.9, rel=1e-3)
    # A reference that turns at once asks for 200 m/s^2; the machine does not.
    assert Envelope.of([record(q_ref=REFERENCES["triangles"])]).acceleration < 20


@pytest.mark.parametrize("reference", REFERENCES)
def test_excitations_stay_inside_the_record_and_begin_and_end_at_rest_where_it_began(reference):
    period = 2e-3 if reference == "2 ms" else 1e-3
    seen = Envelope.of([record(AXIS.replace(sampling={"period": period}), REFERENCES[reference])])
    references = excitations(seen)
    assert list(references) == [excitation.__name__ for excitation in EXCITATIONS]
    for name, q_ref in references.items():
        derivatives = [np.diff(q_ref, order) / period**order for order in (1, 2, 3)]
        limits = (seen.speed, seen.acceleration, seen.jerk)
        for derivative, limit in zip(derivatives, limits, strict=True):
            assert np.abs(derivative).max() <= 1.001 * limit, name
        assert min(seen.home, seen.low) - 1e-9 <= q_ref.min(), name
        assert q_ref.max() <= max(seen.home, seen.high) + 1e-9, name
        assert q_ref[[0, -1]] == pytest.approx(seen.home, abs=1e-6), name
        assert np.abs(derivatives[0][[0, -1]]).max() < 1e-9, name
        assert 10 <= q_ref.size * period <= 45, name
        parts = split(Record(np.arange(q_ref.size) * period, q_ref, q_ref, 0.0 * q_ref, period))
        assert len(parts.strokes) >= 4, name
        assert 0.15 < parts.select.sum() / parts.used.sum() < 0.5, name
        assert instruction(name)[0].islower()


def problem_of(effect: dict, q_ref: np.ndarray) -> Problem:
    measured = record(AXIS.replace(effects=[effect]), q_ref)
    problem = Problem(AXIS, (measured,), (split(measured),), Whitening.none())
    floor = floor_of_laps(
        Hypothesis(problem, Candidate(AXIS.mechanics.array())).residuals(), problem.splits, measured.period
    )
    return problem.with_whitening(floor.whitening)


def fitted(problem: Problem, effect, **parameters: float):
    values = np.array([[parameters[p.name] for p in effect.parameters]])
    return fit(Hypothesis(problem, Candidate(AXIS.mechanics.array()).with_effect(effect, values)))


RIPPLE = {"amplitude": 0.1, "phase": 0.3, "period": 0.0025}
PAIRS = {
    "delay or lag": (("actuator_delay", {"delay": 3e-4}), ("actuator_lag", {"time_constant": 3e-4})),
    "force or encoder": (("position_ripple", RIPPLE), ("encoder_error", {**RIPPLE, "amplitude": 5e-8})),
}


@pytest.mark.parametrize("pair", PAIRS)
def test_a_record_of_the_chosen_excitation_tells_the_two_apart_by_as_much_as_was_promised(pair):
    (true, numbers), (other, guess) = PAIRS[pair]
    problem = problem_of({"kind": true, **numbers}, trapezoid_laps(1e-3, stroke=0.1, laps=3))
    rivals = fitted(problem, get_effect(true), **numbers), fitted(problem, get_effect(other), **guess)
    chosen = choose(rivals, THRESHOLD)
    assert chosen.between == (true, other)
    assert chosen.over_noise > chosen.needed
    assert [row["over_noise"] for row in chosen.compared] == sorted(
        (row["over_noise"] for row in chosen.compared), reverse=True
    )
    for index, truth in enumerate(rivals):
        new = record(truth.model.to_axis(AXIS), chosen.q_ref, seed=7)
        both = replace(problem, records=(*problem.records, new), splits=(*problem.splits, split(new)))
        costs = [
            fit(
                Hypothesis(both, replace(f.model, values=tuple(np.vstack((v, v)) for v in f.model.values))), "used"
            ).cost
            - f.cost
            for f in rivals
        ]
        gain = max(costs) - min(costs)
        assert costs.index(min(costs)) == index
        assert gain > chosen.over_noise**2 - 4 * chosen.over_noise


@pytest.mark.study("two diagnoses")
@pytest.mark.parametrize("true", quick(["actuator_delay", "actuator_lag"], 1, "the other of the two"))
def test_the_record_that_was_asked_for_makes_an_ambiguous_verdict_a_name(true):
    library = tuple(get_effect(name) for name in ("actuator_delay", "actuator_lag"))
    axis = AXIS.replace(effects=[{"kind": true, **dict(PAIRS["delay or lag"])[true]}])
    first = synthetic_record(axis, stroke=0.1)
    answer = diagnose(first, AXIS, library=library)
    assert answer.verdict == "ambiguous"
    second = synthetic_record(axis, seed=1, q_ref=answer.experiment.q_ref)
    answered = diagnose([first, second], AXIS, library=library)
    assert answered.verdict == "named"
    assert [finding.effect for finding in answered.findings] == [true]


def test_without_equivalents_the_effect_s_own_advice_stays():
    problem = problem_of({"kind": "actuator_delay", "delay": 1e-3}, trapezoid_laps(1e-3, stroke=0.1, laps=3))
    delay, lag = get_effect("actuator_delay"), get_effect("actuator_lag")
    best, rival = fitted(problem, delay, delay=1e-3), fitted(problem, lag, time_constant=1e-3)
    tried = {frozenset(f.model.names): f for f in (best, rival)}
    found = Outcome(None, None, Healthy(np.full(199, THRESHOLD)), [], (best,), tried)
    alone = experiment(found, ("actuator_delay",), {"actuator_delay": []}).to_dict(Units())
    assert alone["text"] == delay.words.experiment
    assert {alone[key] for key in ("program", "duration", "distance", "over_noise", "between", "file")} == {None}
    both = {"actuator_delay": ["actuator_lag"]}
    assert experiment(found, (), both) is None
    assert experiment(found, ("actuator_delay",), both).between == ("actuator_delay", "actuator_lag")
    unknown = replace(problem, axis=AXIS.replace(controller={"kind": "none"}))
    blind = replace(found, path=(replace(best, problem=unknown),))
    advice = experiment(blind, ("actuator_delay",), both)
    assert (advice.text, advice.excitation) == (delay.words.experiment, None)


@pytest.fixture
def same_delay():
    """The delay under another name."""
    yield register(replace(get_effect("actuator_delay"), name="same_delay", label="Same delay"))
    REGISTRY.added.pop("same_delay")


def test_no_excitation_separates_a_model_from_itself(same_delay):
    problem = problem_of({"kind": "actuator_delay", "delay": 3e-4}, trapezoid_laps(1e-3, stroke=0.1, laps=3))
    rivals = tuple(fitted(problem, effect, delay=3e-4) for effect in (get_effect("actuator_delay"), same_delay))
    chosen = choose(rivals, THRESHOLD)
    assert chosen.over_noise < 0.5
    assert chosen.distance < 1e-3
    assert (chosen.excitation, chosen.q_ref) == (None, None)
    assert "no motion" in chosen.text
    assert same_delay.words.experiment in chosen.text
