"""What a search leaves at its end: no stand-in beside the real thing, rivals walked as far, deviations that hold."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from emps_design.discrepancy import diagnose
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.partition import split
from emps_design.discrepancy.model.problem import Problem, Whitening, descend, fit
from emps_design.discrepancy.search import beam_search as decide
from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic_record import trapezoid_laps

AXIS = machine("emps2019")
Q_REF = trapezoid_laps(1e-3, stroke=0.1, speed=0.2, laps=3)
DELAY, LAG, SPRING = (get_effect(name) for name in ("actuator_delay", "actuator_lag", "elastic_force"))


def problem(*effects) -> Problem:
    noise = 4e-3 * np.random.default_rng(0).standard_normal(Q_REF.size)
    run = Plant.of(AXIS.replace(effects=list(effects))).closed_loop(Q_REF, voltage_noise=noise)
    record = Record(t=run.t, q_ref=Q_REF, q=run.q, u=run.u, period=1e-3, name="run")
    return Problem(AXIS, (record,), (split(record),), Whitening(np.array([1.0]), 0.2))


def test_a_stand_in_that_was_found_first_goes():
    delayed = problem({"kind": "actuator_delay", "delay": 1.6e-3})
    start = Candidate(AXIS.mechanics.array()).with_effect(LAG, np.array([[2e-4]]))
    both = fit(delayed, start.with_effect(DELAY, np.array([[1.5e-3]])))
    worth = lambda better, worse: worse.cost - better.cost > 0.01 * worse.cost  # noqa: E731
    path = decide._pruned(delayed, both, (), worth)
    assert path[-1].model.names == ("actuator_delay",)
    assert path[-1].model.values[0][0, 0] == pytest.approx(1.6e-3, rel=0.02)


def test_what_is_known_from_the_law_is_never_pruned():
    healthy = problem()
    start = Candidate(AXIS.mechanics.array()).with_effect(LAG, np.array([[1e-4]]))
    both = fit(healthy, start.with_effect(SPRING, np.array([[5.0, 0.0]])))
    path = decide._pruned(healthy, both, ("actuator_lag",), lambda better, worse: False)
    assert path == []


def test_a_rival_is_walked_as_far_as_the_finding():
    delayed = problem({"kind": "actuator_delay", "delay": 1.6e-3})
    start = Candidate(AXIS.mechanics.array())
    baseline = fit(delayed, start)
    best = fit(delayed, start.with_effect(DELAY, np.array([[1.5e-3]])))
    short = fit(delayed, start.with_effect(LAG, np.array([[1.2e-3]])), steps=1)
    tried = {frozenset(f.model.names): f for f in (baseline, best, short)}
    close = decide._rivals(delayed, [baseline, best], tried)
    assert set(close) == {frozenset({"actuator_lag"})}
    assert close[frozenset({"actuator_lag"})].cost < short.cost


def test_deviations_hold_where_the_residual_is_structure():
    """Monte Carlo: the spread of a fitted level under slow noise, against the deviation that is told."""
    slot = Candidate(AXIS.mechanics.array()).slots()[3:4]
    found, told = [], []
    for seed in range(40):
        white = np.random.default_rng(seed).standard_normal(20_000)
        slow = np.convolve(white, np.full(200, 200**-0.5), mode="same")
        level = descend(
            Candidate(AXIS.mechanics.array()), slot, lambda model, slow=slow: slow - model.baseline[3], steps=8
        )
        found.append(level.model.baseline[3])
        told.append(np.sqrt(level.covariance[0, 0]))
    naive = 20_000**-0.5
    assert np.std(found) > 8 * naive
    assert np.mean(told) == pytest.approx(np.std(found), rel=0.35)


def test_an_interrupt_of_the_second_search_keeps_the_first(monkeypatch):
    t = np.arange(16_000) * 1e-3
    wave = sum(np.sin(2 * np.pi * f * t + i) / f for i, f in enumerate((0.13, 0.31, 0.47, 0.71)))
    q_ref = 0.1 * (wave - wave[0]) * np.minimum(t / 2, 1) ** 2 / np.ptp(wave)
    axis = AXIS.replace(effects=[{"kind": "elastic_force", "stiffness": 500.0, "rest_position": 0.1}])
    run = Plant.of(axis).closed_loop(q_ref, voltage_noise=4e-3 * np.random.default_rng(1).standard_normal(t.size))
    record = Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name="free")
    module = sys.modules["emps_design.discrepancy.diagnose"]
    searched, calls = module._searched, []

    def interrupted(*given):
        calls.append(given)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return searched(*given)

    monkeypatch.setattr(module, "_searched", interrupted)
    monkeypatch.setattr(module, "FINER", 10.0)  # so that there is a second search
    answer = diagnose(record, AXIS, library=(SPRING,))
    assert [f.effect for f in answer.findings] == ["elastic_force"]
    assert any("was not repeated" in said for said in answer.details["warnings"])
    assert answer.verdict == "named"


def test_what_explains_most_of_the_rest_is_walked_to_its_end_before_it_is_turned_down():
    delayed = problem({"kind": "actuator_delay", "delay": 1.6e-3})
    start = Candidate(AXIS.mechanics.array())
    baseline = fit(delayed, start)
    short = fit(delayed, start.with_effect(DELAY, np.array([[1.2e-3]])), steps=1)
    sound = {frozenset(short.model.names): short}
    better = decide._late(delayed, baseline, sound, lambda one, other: one.cost < 0.9 * short.cost)
    assert [f.model.names for f in better] == [("actuator_delay",)]
    assert decide._late(delayed, baseline, {}, lambda one, other: True) == []
    poor = fit(delayed, start.with_effect(SPRING, np.array([[1.0, 0.0]])))
    assert decide._late(delayed, baseline, {frozenset(poor.model.names): poor}, lambda one, other: True) == []


def test_nothing_is_walked_on_where_less_than_the_noise_is_left():
    healthy = problem()
    baseline = fit(healthy, Candidate(AXIS.mechanics.array()))
    quiet = replace(baseline, cost_fit=10.0, cost_select=5.0)
    assert decide._late(healthy, quiet, {}, lambda one, other: True) == []
    assert decide._late(healthy, quiet, {frozenset({"actuator_lag"}): baseline}, lambda one, other: True) == []
