"""What is found beside an unknown force: a smooth function of the state, or a force of one kind."""

import sys
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from emps_design.discrepancy import beam_search, diagnose, rules, verdict
from emps_design.discrepancy.confirmation import Share
from emps_design.discrepancy.explanation import explain
from emps_design.discrepancy.fit import evaluate, fit
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import acceleration_band, split
from emps_design.discrepancy.starts import starts, tangent
from emps_design.discrepancy.unknown_force import KINDS, beside_kind, beside_state, inertia, missing_force, with_kind
from emps_design.discrepancy.verdict import BesideUnknown, _fitted_around
from emps_design.effects import Motion, get_effect
from emps_design.machines import machine
from emps_design.progress import no_progress
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps

AXIS = machine("emps2019")
Q_REF = trapezoid_laps(1e-3, stroke=0.1, speed=0.2, laps=4)
AT = 6.3  # s, in motion
WEIGHT = {"kind": "mass_change", "change": 0.08, "time": AT}
LIBRARY = [
    get_effect(name)
    for name in ("mass_change", "friction_drift", "actuator_delay", "asymmetric_viscous_friction", "position_ripple")
]
SMOOTH, SLOWER = (
    np.convolve(np.pad(trapezoid_laps(1e-3, stroke=0.1, speed=speed, laps=4), (200, 0)), np.ones(201) / 201, "valid")
    for speed in (0.2, 0.15)
)
WHITE = Whitening(np.array([1.0]), 0.14)


def unknown(q_ref):
    """A brake of 40 N that acts forwards in the middle of the travel: no effect of the library."""
    v = np.gradient(q_ref, 1e-3)
    return -200.0 * np.maximum(v, 0.0) * np.exp(-(((q_ref - 0.05) / 0.02) ** 2))


def record(seed, q_ref, *effects, name="run"):
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(q_ref.size)
    run = Plant.of(AXIS.replace(effects=list(effects))).closed_loop(
        q_ref, voltage_noise=noise, disturbance=unknown(q_ref)
    )
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name=name)


def problem(*effects):
    seen = record(1, Q_REF, *effects)
    return Problem(AXIS, (seen,), (split(seen),), WHITE)


def test_a_function_of_the_state_leaves_nothing_and_a_weight_does():
    start = Hypothesis(problem(), Candidate(AXIS.mechanics.array()))
    beside = beside_state(start)
    assert np.std(beside.residual("used")) < 0.35 * np.std(start.residual("used"))
    assert np.std(np.concatenate(beside.remaining_force())) < 0.35 * np.std(np.concatenate(start.remaining_force()))
    effect = get_effect("mass_change")
    heavier = beside.with_model(beside.model.with_effect(effect, effect.values({"change": 0.08, "time": AT})))
    assert np.linalg.norm(heavier.residual("used") - beside.residual("used")) > 30.0


def test_the_states_explain_nothing_however_often_the_residual_is_taken():
    beside = beside_state(Hypothesis(problem(), Candidate(AXIS.mechanics.array()))).problem
    once = beside.whiten((unknown(Q_REF),))
    follows = beside.gather(replace(beside, states=()).whiten(beside.states), "used")
    along = np.abs(follows.T @ beside.gather(once, "used")) / np.linalg.norm(follows, axis=0)
    assert along.max() < 1e-6 * np.linalg.norm(beside.gather(once, "used"))
    assert beside.only(0).states[0] is beside.states[0]


def test_what_stands_is_fitted_from_the_baseline_that_was_found_beside_the_state_too():
    weight = get_effect("mass_change")
    numbers = Candidate(AXIS.mechanics.array()).with_effect(weight, weight.values({"change": 0.08, "time": AT}))
    found = fit(beside_state(Hypothesis(problem(WEIGHT), numbers)), "used")
    # What a model leaves behind of which everything was withdrawn: no friction, and twice the mass.
    reliable = evaluate(Hypothesis(problem(WEIGHT), Candidate(AXIS.mechanics.array() * [2.0, 0.0, 0.0, 1.0])))
    best = fit(reliable.with_model(found.model), "used")
    around = _fitted_around(reliable, BesideUnknown(found, [Share("mass_change", 1.0, 0.01, 1.0, exercised=True)], {}))
    assert around.model.names == ("mass_change",)
    assert np.array_equal(around.model.values[0], found.model.values[0])
    assert around.cost < 1.2 * best.cost < fit(reliable, "used").cost


@pytest.mark.study("a whole diagnosis beside an unknown force")
@pytest.mark.parametrize(("hidden", "names"), [((WEIGHT,), ("mass_change",)), ((), ())])
def test_a_weight_put_on_is_named_beside_a_brake_five_times_as_strong(hidden, names):
    other = trapezoid_laps(1e-3, stroke=0.1, speed=0.15, laps=4)
    held_out = record(2, other, *hidden, name="other")
    answer = diagnose(record(1, Q_REF, *hidden), AXIS, library=LIBRARY, holdout=held_out)
    assert tuple(finding.effect for finding in answer.findings) == names
    assert answer.verdict == ("partly-named" if names else "unnamed")
    for finding in answer.findings:
        change = finding.parameters["change"]
        assert change["value"] == pytest.approx(0.08, abs=max(3 * change["std"], 0.008))


def crank(q):
    """The force of a mass of 40 kg that comes and goes along the travel: no effect of the library."""
    v = np.gradient(q, 1e-3)
    turn = 2 * np.pi * (q - 0.03) / 0.16
    return -40.0 * (np.sin(turn) * np.gradient(v, 1e-3) + np.pi / 0.16 * np.cos(turn) * v * v)


def leaning(q):
    """Viscous friction that grows along the travel by 400 N/(m/s) on 0.1 m: no effect of the library."""
    return -4000.0 * (q - 0.05) * np.gradient(q, 1e-3)


def seal(q):
    """Friction of 12 N that comes back with time after every reversal: no effect of the library."""
    direction = np.tanh(np.gradient(q, 1e-3) / 1e-3)
    return -12.0 * (direction - lfilter([0.01], [1.0, -0.99], direction))


def wake(q):
    """A drag of 12 N towards where the axis was heading in the last 0.2 s: no effect of the library."""
    return 12.0 * lfilter([0.005], [1.0, -0.995], np.tanh(np.gradient(q, 1e-3) / 2e-3))


def with_force(force, seed, q_ref, *effects, name="run"):
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(q_ref.size)
    plant = Plant.of(AXIS.replace(effects=list(effects)))
    moved = q_ref
    for _ in range(5):  # until the force is that of the motion which it takes part in
        run = plant.closed_loop(q_ref, voltage_noise=noise, disturbance=force(moved))
        moved = run.position
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name=name)


def beside_crank():
    seen = with_force(crank, 1, SMOOTH)
    return Hypothesis(Problem(AXIS, (seen,), (split(seen),), WHITE), Candidate(AXIS.mechanics.array()))


def test_an_unknown_force_of_its_kind_leaves_nothing_and_one_of_another_kind_does():
    start = beside_crank()
    remaining = [
        np.std(beside_kind(start, coarse.with_baseline()).residual("used"))
        for related in KINDS
        for coarse, *_ in related
    ]
    assert remaining[0] < 0.1 * np.std(start.residual("used"))
    assert remaining[0] < 0.2 * min(remaining[1:])


def test_what_is_the_same_everywhere_is_the_models_where_it_is_fitted_and_the_forces_where_it_is_given():
    start = beside_crank()
    heavier = start.with_model(Candidate(AXIS.mechanics.array() * [1.1, 1.0, 1.0, 1.0]))
    varies = KINDS[0][0][0]
    remaining = [np.std(beside_kind(heavier, kind).residual("used")) for kind in (varies, varies.with_baseline())]
    assert remaining[1] < 0.5 * remaining[0]
    fitted = fit(beside_kind(heavier, varies), "used")
    assert np.std(fitted.residual("used")) == pytest.approx(remaining[1], rel=0.3)


def test_an_inertia_along_the_travel_is_that_of_lagranges_equation():
    q = 0.05 + 0.04 * np.sin(np.linspace(0.0, 9.0, 4000))
    v = np.gradient(q, 1e-3)
    seen = Motion(t=1e-3 * np.arange(q.size), q=q, v=v, a=np.gradient(v, 1e-3), tau=0.0 * q, period=1e-3)
    columns = inertia(seen, q, 6)
    mass = 3.0 * q - 20.0 * q**3  # [kg], less a number
    momentum = np.gradient(mass * v, 1e-3) - 0.5 * (3.0 - 60.0 * q**2) * v * v  # d/dt dL/dv - dL/dq
    whole = np.column_stack([columns, seen.a])[5:-5]
    remaining = momentum[5:-5] - whole @ np.linalg.lstsq(whole, momentum[5:-5], rcond=None)[0]
    assert np.std(remaining) < 1e-4 * np.std(momentum)


@pytest.mark.parametrize(
    ("resolution", "least", "most"), [(1e-9, 399.0, 400.0), (1e-6, 90.0, 200.0), (2e-5, 60.0, 60.0)]
)
def test_an_acceleration_is_looked_at_as_far_as_the_encoder_sees_it(resolution, least, most):
    q = 0.05 * np.sin(2.0 * np.pi * np.arange(5000) * 1e-3)
    seen = Record(t=1e-3 * np.arange(q.size), q_ref=q, q=np.round(q / resolution) * resolution, u=0.0 * q, period=1e-3)
    assert least <= acceleration_band(seen) <= most


def test_a_large_unknown_force_leaves_less_with_its_share_on_the_carriage():
    seen = with_force(crank, 1, SLOWER)
    start = Hypothesis(Problem(AXIS, (seen,), (split(seen),), WHITE), Candidate(AXIS.mechanics.array()))
    linear, within = (judge(start, KINDS[0][0][0].with_baseline()) for judge in (beside_kind, with_kind))
    assert np.std(within.residual("used")) < 0.95 * np.std(linear.residual("used"))
    assert np.std(within.problem.acting[0] - crank(seen.q)) < 0.1 * np.std(crank(seen.q))
    assert within.problem.cache is not start.problem.cache  # other forces act: other residuals


def test_only_as_much_of_a_force_is_put_in_the_loop_as_leaves_less(monkeypatch):
    seen = with_force(crank, 1, SLOWER)
    start = Hypothesis(Problem(AXIS, (seen,), (split(seen),), WHITE), Candidate(AXIS.mechanics.array()))
    varies = KINDS[0][0][0]
    (whole,) = with_kind(start, varies).problem.acting
    for shares, acting in (((8.0, 0.5), 0.5 * whole), ((8.0,), None)):  # eight times as much is too much
        monkeypatch.setattr(rules, "LOOP_SHARES", shares)
        forces = with_kind(start, varies).problem.acting
        assert forces == () if acting is None else np.allclose(forces[0], acting)


SPRING = {"kind": "elastic_force", "stiffness": 100.0, "rest_position": 0.0}


@pytest.mark.parametrize("force", [seal, wake])
def test_an_effect_starts_in_its_own_size_where_an_unknown_force_took_most_of_it(force):
    seen = with_force(force, 1, SMOOTH, SPRING)
    baseline = fit(Hypothesis(Problem(AXIS, (seen,), (split(seen),), WHITE), Candidate(AXIS.mechanics.array())))
    beside = beam_search.fit_alternately(baseline, KINDS[2][0][0])[-1]
    assert beside.cost < 0.05 * baseline.cost
    first, *_ = starts(beside, get_effect("elastic_force"), missing_force(beside), tangent(beside))
    assert first.model.values[-1][0, 0] == pytest.approx(100.0, rel=0.15)


@pytest.mark.study("a whole diagnosis beside an unknown force")
def test_a_spring_is_named_beside_friction_that_remembers():
    library = [get_effect(name) for name in ("elastic_force", "actuator_delay", "position_ripple", "end_stop")]
    held_out = with_force(wake, 2, SLOWER, SPRING, name="other")
    answer = diagnose(with_force(wake, 1, SMOOTH, SPRING), AXIS, library=library, holdout=held_out)
    assert [finding.effect for finding in answer.findings] == ["elastic_force"]
    assert answer.findings[0].parameters["stiffness"]["value"] == pytest.approx(100.0, rel=0.1)
    assert answer.details["unexplained"]["kind"] == KINDS[2][0][0].name


@pytest.mark.study("a whole diagnosis beside an unknown force")
@pytest.mark.parametrize("mechanism", [crank, leaning])
def test_an_asymmetry_of_friction_is_named_beside_what_could_hold_it(mechanism):
    hidden = {"kind": "asymmetric_viscous_friction", "viscous_difference": 60.0}
    library = [get_effect(name) for name in ("asymmetric_viscous_friction", "actuator_delay", "mass_change")]
    held_out = with_force(mechanism, 2, SLOWER, hidden, name="other")
    answer = diagnose(with_force(mechanism, 1, SMOOTH, hidden), AXIS, library=library, holdout=held_out)
    assert [finding.effect for finding in answer.findings] == ["asymmetric_viscous_friction"]
    assert answer.findings[0].parameters["viscous_difference"]["value"] == pytest.approx(60.0, rel=0.1)
    assert answer.details["unexplained"]["kind"] == KINDS[mechanism is leaning][0][0].name


FEW = [get_effect(name) for name in ("stribeck_friction", "actuator_delay", "position_ripple", "mass_change")]


@pytest.mark.study("a whole diagnosis beside an unknown force")
def test_friction_is_named_beside_a_mechanism():
    hidden = {"kind": "stribeck_friction", "excess": 6.0, "stribeck_velocity": 0.01, "exponent": 2.0}
    held_out = with_force(crank, 2, SLOWER, hidden, name="other")
    answer = diagnose(with_force(crank, 1, SMOOTH, hidden), AXIS, library=FEW, holdout=held_out)
    assert [finding.effect for finding in answer.findings] == ["stribeck_friction"]
    assert answer.findings[0].parameters["excess"]["value"] == pytest.approx(6.0, rel=0.1)
    says_what_the_rest_is_like(answer, "partly-named")


def says_what_the_rest_is_like(answer, verdict):
    unexplained = answer.details["unexplained"]
    assert answer.verdict == verdict
    assert "like an inertia that varies along the travel" in unexplained["text"]
    assert "like an inertia that varies along the travel" in answer.sentence
    assert unexplained["kind_leaves"] < 1.3 * answer.noise.force < unexplained["rms"]


@pytest.fixture(scope="module")
def stopped():
    """A search that an inertia along the travel ended, nothing else being hidden."""
    module, found = sys.modules["emps_design.discrepancy.diagnosis"], []

    class Searched(Exception):
        pass

    def before_it_is_confirmed(outcome, progress):
        found.append(outcome)
        raise Searched

    with pytest.MonkeyPatch.context() as patch, suppress(Searched):
        patch.setattr(module, "validate", before_it_is_confirmed)
        diagnose(with_force(crank, 1, SMOOTH), AXIS, library=FEW, holdout=with_force(crank, 2, SLOWER))
    return found[0]


@pytest.mark.study("a whole diagnosis beside an unknown force")
def test_no_unknown_force_is_needed_where_effects_leave_less(stopped):
    force, (baseline, *_) = stopped.unknown_force, stopped.path
    again = beam_search._find_unknown_force(replace(stopped, path=(baseline, baseline)), None)
    assert again.kind == force.kind
    better = evaluate(force.fitted)  # as effects that leave as little would
    assert beam_search._find_unknown_force(replace(stopped, path=(baseline, baseline, better)), None) is None


@pytest.mark.study("a whole diagnosis beside an unknown force")
@pytest.mark.parametrize("confirmed", ["as it is", "as all there is", "with nothing to name", ""])
def test_a_search_ends_for_a_force_that_answers_and_goes_on_where_it_does_not(monkeypatch, stopped, confirmed):
    def finds(outcome, data, found=verdict.found_beside_kind):
        beside = found(outcome, data)
        is_all = {"as it is": beside.is_all, "as all there is": True}.get(confirmed, False)
        return replace(beside, is_all=is_all) if confirmed else None

    gone_on = []

    def continued(outcome, *rest, goes_on=verdict.finish_search):
        gone_on.append(outcome)
        return goes_on(outcome, *rest)

    monkeypatch.setattr(verdict, "finish_search", continued)
    monkeypatch.setattr(verdict, "found_beside_kind", finds)
    answer = explain(verdict.validate(stopped, no_progress))
    assert bool(gone_on) is (confirmed in ("with nothing to name", ""))
    assert (answer.verdict, answer.findings) == ("unnamed", ())
    assert ("inertia" in answer.details["unexplained"]["kind"]) is bool(confirmed)
    if confirmed:
        says_what_the_rest_is_like(answer, "unnamed")


@pytest.mark.study("a whole diagnosis beside an unknown force")
def test_a_search_goes_on_past_a_force_when_the_noise_is_known(monkeypatch):
    module = sys.modules["emps_design.discrepancy.diagnosis"]
    stopped, gone_on = [], []
    monkeypatch.setattr(rules, "PLAIN", 1e9)  # never plain: the search must go on, once
    monkeypatch.setattr(rules, "FINER", 10.0)  # so that there are three searches

    def searched(*arguments, search=module.search_with_unknown_force):
        stopped.append(search(*arguments))
        return stopped[-1]

    def past(outcome, progress, goes_on=beam_search.finish_search, **named):
        gone_on.append(outcome)
        return goes_on(outcome, progress, **named)

    monkeypatch.setattr(module, "search_with_unknown_force", searched)
    monkeypatch.setattr(beam_search, "finish_search", past)
    stages = []
    library = [get_effect(name) for name in ("actuator_delay", "position_ripple", "mass_change")]
    first, second = with_force(crank, 1, SMOOTH), with_force(crank, 2, SLOWER)
    diagnose(first, AXIS, library=library, holdout=second, progress=lambda stage, share: stages.append(share))
    assert len(stopped) == rules.IN_TURN
    assert [any(one.path is it.path for it in gone_on) for one in stopped] == [False, False, True]
    assert stages == sorted(stages)


@pytest.mark.parametrize(
    ("names", "leaves", "explains"), [(("mass_change",), 1.2, True), (("mass_change",), 1.7, False), ((), 1.2, False)]
)
def test_what_is_left_counts_as_unknown_where_a_force_beside_effects_explains_half_of_it(names, leaves, explains):
    shares = [Share(name, 1.0, 0.01, 1.0, exercised=True) for name in names]
    found = evaluate(Hypothesis(problem(), Candidate(AXIS.mechanics.array())))
    force = BesideUnknown(found, shares, {}, kind="a memory", remaining_force=leaves)
    assert verdict._explains(force, remaining=1.8, floor=1.0) is explains
    assert not verdict._explains(None, remaining=1.8, floor=1.0)


@pytest.mark.study("a whole diagnosis beside an unknown force")
def test_a_motor_at_its_limit_does_not_hide_of_which_kind_the_rest_is():
    limit = {"kind": "actuator_saturation", "limit": 3.9}
    library = [get_effect(name) for name in ("actuator_saturation", "actuator_delay", "position_ripple", "mass_change")]
    held_out = with_force(seal, 2, SLOWER, limit, name="other")
    answer = diagnose(with_force(seal, 1, SMOOTH, limit), AXIS, library=library, holdout=held_out)
    assert [finding.effect for finding in answer.findings] == ["actuator_saturation"]
    found = answer.findings[0].parameters["limit"]
    assert abs(found["value"] - 3.9) < 3 * found["std"] < 0.4
    assert "like friction that depends on the past motion" in answer.sentence
