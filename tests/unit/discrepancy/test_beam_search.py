"""What a search leaves at its end: no stand-in beside the real thing, rivals fitted as long, deviations that hold."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from emps_design.discrepancy import beam_search, diagnose, extension, rules
from emps_design.discrepancy.acceptance import Judge, _gain_repeats
from emps_design.discrepancy.beam_search import (
    ADD,
    EXCHANGE,
    FAR_BEHIND,
    PAIR,
    PRUNE,
    RIVALS,
    Move,
    Proposal,
    _accepted_when_converged,
    bring_in_move,
    walk,
)
from emps_design.discrepancy.calibration import Outcome, best_of_each_set
from emps_design.discrepancy.extension import _fit_within_bounds, converged, extended, extensions, free_all
from emps_design.discrepancy.fit import evaluate, fit, on_bound, with_noise_weights
from emps_design.discrepancy.least_squares import Candidate, descend
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import split
from emps_design.discrepancy.starts import screen, tangent
from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.progress import no_progress
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps
from tests.studies import quick

AXIS = machine("emps2019")
Q_REF = trapezoid_laps(1e-3, stroke=0.1, speed=0.2, laps=3)
DELAY, LAG, SPRING = (get_effect(name) for name in ("actuator_delay", "actuator_lag", "elastic_force"))


def hypothesis(model, *effects) -> Hypothesis:
    """``model`` of a record of a machine with ``effects``."""
    noise = 4e-3 * np.random.default_rng(0).standard_normal(Q_REF.size)
    run = Plant.of(AXIS.replace(effects=list(effects))).closed_loop(Q_REF, voltage_noise=noise)
    record = Record(t=run.t, q_ref=Q_REF, q=run.q, u=run.u, period=1e-3, name="run")
    return Hypothesis(Problem(AXIS, (record,), (split(record),), Whitening(np.array([1.0]), 0.2)), model)


BASELINE = Candidate(AXIS.mechanics.array())
DELAYED = {"kind": "actuator_delay", "delay": 1.6e-3}
LAGGING = {"kind": "actuator_lag", "time_constant": 1e-3}


class Judged(Outcome):
    """A search whose judge says what a test lets it."""

    accept = staticmethod(lambda better, worse: True)
    structure = staticmethod(lambda fitted: False)

    @property
    def judge(self):
        return SimpleNamespace(accepts=type(self).accept, leaves_structure=type(self).structure)


def search_at(*path, accept=Judged.accept, structure=Judged.structure, tried=(), library=(), known=(), threshold=0.0):
    """A search that has come along ``path``; its baseline has the effects ``known``."""
    kind = type("Judged", (Judged,), {"accept": staticmethod(accept), "structure": staticmethod(structure)})
    first = path[0].with_model(path[0].model.without_named([n for n in path[0].model.names if n not in known]))
    path = path if path[0].model.names == first.model.names else (evaluate(first), *path)
    preparation, healthy = SimpleNamespace(library=library), SimpleNamespace(threshold=threshold)
    return kind(preparation, None, healthy, [], path, best_of_each_set({}, (*path, *tried)), most=rules.MOST_EFFECTS)


def exchanged(best, library, known=()):
    """What is proposed in the place of each effect of ``best``."""
    return EXCHANGE.proposes(search_at(best, library=library, known=known), no_progress).fits


def test_a_stand_in_that_was_found_first_goes():
    start = BASELINE.with_effect(LAG, np.array([[2e-4]])).with_effect(DELAY, np.array([[1.5e-3]]))
    both = fit(hypothesis(start, DELAYED))
    worth = lambda better, worse: worse.cost - better.cost > 0.01 * worse.cost  # noqa: E731
    best = walk(search_at(both, accept=worth), (PRUNE,), no_progress).best
    assert best.model.names == ("actuator_delay",)
    assert best.model.values[0][0, 0] == pytest.approx(1.6e-3, rel=0.02)


def test_a_stand_in_in_company_gives_way_to_what_it_stood_in_for():
    spring = {"kind": "elastic_force", "stiffness": 80.0, "rest_position": 0.05}
    start = BASELINE.with_effect(LAG, np.array([[1.5e-3]])).with_effect(SPRING, np.array([[80.0, 0.05]]))
    stand_in = fit(hypothesis(start, DELAYED, spring))
    others = exchanged(stand_in, (DELAY, LAG, SPRING))
    best = min(others, key=lambda f: f.cost)
    assert set(best.model.names) == {"actuator_delay", "elastic_force"}
    assert best.cost < 0.9 * stand_in.cost
    assert all("actuator_lag" in f.model.names for f in exchanged(stand_in, (DELAY, LAG, SPRING), ("actuator_lag",)))


def test_a_baseline_that_a_stand_in_bent_is_tried_from_the_axis_file_too():
    bend = {"kind": "nonlinear_viscous_friction", "amount": 30.0, "exponent": 2.0}
    library = (get_effect("stribeck_friction"), get_effect("nonlinear_viscous_friction"))
    bent = replace(BASELINE, baseline=np.array([95.0, 450.0, 0.0, -3.0]))
    stand_in = fit(hypothesis(bent.with_effect(library[0], np.array([[12.0, 0.04, 2.0]])), bend))
    best = min(exchanged(stand_in, library), key=lambda f: f.cost)
    assert best.model.names == ("nonlinear_viscous_friction",)
    assert best.model.values[0][0, 0] == pytest.approx(30.0, rel=0.1)


@pytest.mark.parametrize(("hidden", "left"), [((), ()), ((LAGGING,), ("actuator_lag",))], ids=["bound", "inside"])
def test_a_number_held_on_its_way_is_free_again_at_the_end(hidden, left):
    begin = hypothesis(BASELINE.with_effect(LAG, np.array([[1e-4]])), *hidden)
    held = fit(begin, slots=begin.model.slots()[:4])
    last = free_all(held)
    assert last.model.names == left
    assert len(last.slots) == len(last.model.slots())
    assert free_all(last) is last


def test_what_is_left_of_a_model_can_be_simulated(monkeypatch):
    start = BASELINE.with_effect(LAG, np.array([[1e-4]])).with_effect(SPRING, np.array([[80.0, 0.05]]))
    begin = hypothesis(start, {"kind": "elastic_force", "stiffness": 80.0, "rest_position": 0.05})
    held = fit(begin, slots=begin.model.slots()[:4])

    def failing(hypothesis, *more):
        found = fit(hypothesis, *more)
        return replace(found, innovations=()) if found.model.names == ("elastic_force",) else found

    assert free_all(held).model.names == ("elastic_force",)
    monkeypatch.setattr(sys.modules[free_all.__module__], "fit", failing)
    last = free_all(held)
    assert last.model.names == ()
    assert last.innovations


def test_a_number_that_ends_on_a_bound_is_held():
    begin = hypothesis(BASELINE.with_effect(LAG, np.array([[1e-4]])))
    assert on_bound(fit(begin))
    held = _fit_within_bounds(begin)
    assert not on_bound(held)
    assert held.model.values[0][0, 0] == 1e-4


def test_a_search_goes_on_from_a_model_found_before_that_leaves_less():
    delayed = BASELINE.with_effect(DELAY, np.array([[1.5e-3]]))
    current = fit(hypothesis(BASELINE.with_effect(SPRING, np.array([[1.0, 0.0]])), DELAYED))
    search = search_at(current)
    further = walk(search, (bring_in_move(delayed),), no_progress)
    found = further.best
    assert further.path == (*search.path, found)
    assert found.model.names == ("actuator_delay",)
    assert found.model.values[0][0, 0] == pytest.approx(1.6e-3, rel=1e-2)  # fitted under the noise of ``current``
    assert further.tried[frozenset({"actuator_delay"})] is found
    for before in (delayed, current.model):  # the search has ended there already; it leaves more
        assert walk(further, (bring_in_move(before),), no_progress).path == further.path


def test_what_is_known_from_the_law_is_never_pruned():
    start = BASELINE.with_effect(LAG, np.array([[1e-4]])).with_effect(SPRING, np.array([[5.0, 0.0]]))
    search = search_at(fit(hypothesis(start)), accept=lambda better, worse: False, known=("actuator_lag",))
    assert walk(search, (PRUNE,), no_progress) is search


def test_what_was_tried_before_counts_where_the_rest_of_a_model_is_left_in_a_poor_place(monkeypatch):
    delay = np.array([[1.5e-3]])
    start = hypothesis(BASELINE.with_effect(LAG, np.array([[2e-4]])).with_effect(DELAY, delay), DELAYED)
    both, alone = fit(start), fit(start.with_model(BASELINE.with_effect(DELAY, delay)))
    monkeypatch.setattr(beam_search, "fit", evaluate)  # the rest stays as the model with both left it
    compared = {}

    def accept(better, worse):
        compared.setdefault(worse.model.names, worse.cost)
        return True

    walk(search_at(both, accept=accept, tried=(alone,)), (PRUNE,), no_progress)
    assert compared["actuator_delay",] == alone.cost
    assert compared["actuator_lag",] == evaluate(both.with_model(both.model.without(1))).cost


def test_a_rival_is_fitted_as_long_as_the_finding():
    baseline = fit(hypothesis(BASELINE, DELAYED))
    best = fit(baseline.with_model(BASELINE.with_effect(DELAY, np.array([[1.5e-3]]))))
    short = fit(baseline.with_model(BASELINE.with_effect(LAG, np.array([[1.2e-3]]))), steps=1)
    search = walk(search_at(baseline, best, tried=(short,)), (RIVALS,), no_progress)
    assert search.path == (baseline, best)
    assert search.tried[frozenset({"actuator_lag"})].cost < short.cost


def test_deviations_hold_where_the_residual_is_structure():
    """Monte Carlo: the spread of a fitted level under slow noise, against its deviation."""
    slot = Candidate(AXIS.mechanics.array()).slots()[3:4]
    found, stated = [], []
    for seed in range(40):
        white = np.random.default_rng(seed).standard_normal(20_000)
        slow = np.convolve(white, np.full(200, 200**-0.5), mode="same")
        level = descend(
            Candidate(AXIS.mechanics.array()), slot, lambda model, slow=slow: slow - model.baseline[3], steps=8
        )
        found.append(level.model.baseline[3])
        stated.append(np.sqrt(level.covariance[0, 0]))
    naive = 20_000**-0.5
    assert np.std(found) > 8 * naive
    assert np.mean(stated) == pytest.approx(np.std(found), rel=0.35)


def test_what_is_accepted_is_kept_where_it_leaves_more_bursts(monkeypatch):
    """An acceptance counts bursts little, the whole cost counts them fully."""
    baseline = fit(hypothesis(BASELINE))
    worse = fit(baseline.with_model(BASELINE.with_effect(LAG, np.array([[5e-3]]))), slots=baseline.slots)
    assert worse.cost > baseline.cost
    rounds = [Proposal([worse], {"actuator_lag": 0.0}), Proposal([])]
    monkeypatch.setattr(beam_search, "_round", lambda *given: rounds.pop(0))
    monkeypatch.setattr(beam_search, "converged", lambda found: found)
    search = walk(search_at(baseline), (ADD,), no_progress)
    assert search.path == (baseline, worse)
    assert search.alone == {"actuator_lag": 0.0}
    assert set(search.tried) == {frozenset(), frozenset({"actuator_lag"})}


def test_two_effects_are_found_of_which_neither_is_accepted_alone(monkeypatch):
    noisy = hypothesis(BASELINE, DELAYED, {"kind": "elastic_force", "stiffness": 300.0, "rest_position": 0.05})
    baseline = fit(noisy)
    delayed = fit(baseline.with_model(BASELINE.with_effect(DELAY, np.array([[1.6e-3]]))))
    both = fit(delayed.with_model(delayed.model.with_effect(SPRING, np.array([[300.0, 0.05]]))))
    started = []

    def played(search, beam, *rest):
        started.append([member.model.names for member in beam])
        return Proposal([both])

    monkeypatch.setattr(beam_search, "_round", played)
    judged = {"accept": lambda better, worse: better is not delayed, "structure": lambda fitted: fitted is baseline}
    found = walk(search_at(baseline, tried=(delayed,), **judged), (PAIR,), no_progress)
    assert found.best.model.names == ("actuator_delay", "elastic_force")
    assert started == [[("actuator_delay",)]]
    assert frozenset(both.model.names) in found.tried
    assert not PAIR.applies(search_at(baseline, delayed, **judged))


def test_what_is_far_behind_is_looked_for_where_structure_is_left_among_what_was_not_fitted(monkeypatch):
    baseline = fit(hypothesis(BASELINE, {"kind": "elastic_force", "stiffness": 300.0, "rest_position": 0.05}))
    delayed = fit(baseline.with_model(BASELINE.with_effect(DELAY, np.array([[1.6e-3]]))))
    sprung = fit(baseline.with_model(BASELINE.with_effect(SPRING, np.array([[250.0, 0.0]]))))
    calls = []

    def played(search, beam, library, progress, rival):
        calls.append(([effect.name for effect in library], rival))
        return Proposal([sprung])

    monkeypatch.setattr(beam_search, "_round", played)
    judged = {"structure": lambda fitted: fitted is baseline}
    library = (DELAY, LAG, SPRING, get_effect("force_map"))
    found = walk(search_at(baseline, tried=(delayed,), library=library, **judged), (FAR_BEHIND,), no_progress)
    assert found.best.model.names == ("elastic_force",)
    assert calls == [(["actuator_lag", "elastic_force"], rules.MINOR)]
    assert frozenset(sprung.model.names) in found.tried
    assert not FAR_BEHIND.applies(search_at(baseline, sprung, **judged))


def test_what_promises_much_is_fitted_though_its_short_fit_was_misled(monkeypatch):
    """As load-dependent friction is that takes the place of the baseline's: its short fit keeps the baseline's."""
    short_fit = extension._short_fit

    def misled(*arguments):
        short = short_fit(*arguments)
        return replace(short, cost=1e3 * short.cost) if short.model.names[-1] == "actuator_delay" else short

    monkeypatch.setattr(extension, "_short_fit", misled)
    monkeypatch.setattr(extension, "bent", lambda *_: False)
    fitted = fit(hypothesis(BASELINE, DELAYED))
    absorbed = tangent(fitted)
    fits, gains = extensions(fitted, screen(fitted, (DELAY, LAG, SPRING), absorbed), absorbed)
    assert gains["actuator_delay"] < 0 < gains["actuator_lag"]
    assert fits[0].model.names == ("actuator_delay",)


def test_what_gains_next_to_nothing_in_its_first_step_gets_no_other(monkeypatch):
    short_fit, steps = extension._short_fit, {}

    def counted(start, begin, absorbed, more):
        name = begin.names[-1]
        steps[name] = steps.get(name, 0) + more
        return short_fit(start, begin, absorbed, more)

    monkeypatch.setattr(extension, "_short_fit", counted)
    fitted = fit(hypothesis(BASELINE, DELAYED))
    absorbed = tangent(fitted)
    screened = screen(fitted, (DELAY, LAG, SPRING), absorbed)
    extensions(fitted, [[replace(found[0], gain=min(found[0].gain, 100.0))] for found in screened], absorbed)
    assert steps["actuator_delay"] == rules.SHORT_STEPS
    assert steps["elastic_force"] == 1


def test_an_interrupt_of_the_second_search_keeps_the_first(monkeypatch):
    t = np.arange(16_000) * 1e-3
    wave = sum(np.sin(2 * np.pi * f * t + i) / f for i, f in enumerate((0.13, 0.31, 0.47, 0.71)))
    q_ref = 0.1 * (wave - wave[0]) * np.minimum(t / 2, 1) ** 2 / np.ptp(wave)
    axis = AXIS.replace(effects=[{"kind": "elastic_force", "stiffness": 500.0, "rest_position": 0.1}])
    run = Plant.of(axis).closed_loop(q_ref, voltage_noise=4e-3 * np.random.default_rng(1).standard_normal(t.size))
    record = Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name="free")
    module = sys.modules["emps_design.discrepancy.diagnosis"]
    searched, calls = module.search_with_unknown_force, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return searched(*arguments)

    monkeypatch.setattr(module, "search_with_unknown_force", interrupted)
    monkeypatch.setattr(rules, "FINER", 10.0)  # so that there is a second search
    answer = diagnose(record, AXIS, library=(SPRING,))
    assert [f.effect for f in answer.findings] == ["elastic_force"]
    assert any("was not repeated" in text for text in answer.details["warnings"])
    assert answer.verdict == "named"


def test_what_explains_most_of_the_rest_is_fitted_to_convergence_before_it_is_turned_down():
    baseline = fit(hypothesis(BASELINE, DELAYED))
    short = fit(baseline.with_model(BASELINE.with_effect(DELAY, np.array([[1.2e-3]]))), steps=1)
    better = _accepted_when_converged(
        search_at(baseline, accept=lambda one, other: one.cost < 0.9 * short.cost), [short]
    )
    assert [f.model.names for f in better] == [("actuator_delay",)]
    assert _accepted_when_converged(search_at(baseline), []) == []
    poor = fit(baseline.with_model(BASELINE.with_effect(SPRING, np.array([[1.0, 0.0]]))))
    assert _accepted_when_converged(search_at(baseline), [poor]) == []


def test_nothing_is_fitted_on_where_less_than_the_noise_is_left():
    baseline = fit(hypothesis(BASELINE))
    quiet = replace(baseline, cost_fit=10.0, cost_select=5.0)
    assert _accepted_when_converged(search_at(quiet), []) == []
    assert _accepted_when_converged(search_at(quiet), [baseline]) == []


HEIGHTS = {f"height_{i}": h for i, h in enumerate((4.0, -3.0, 6.0, 0.0, 5.0, -4.0), start=1)}


@pytest.mark.study("a search over curves")
@pytest.mark.parametrize(
    "hidden",
    quick(
        [
            {"kind": "elastic_force", "stiffness": 80.0, "rest_position": 0.05},
            {"kind": "force_map", "start": 0.0, "end": 0.1, **HEIGHTS},
        ],
        1,
        "six heights",
    ),
    ids=["elastic_force", "force_map"],
)
def test_a_curve_of_any_shape_is_named_where_nothing_else_is_found(hidden):
    noisy = hypothesis(BASELINE, hidden)
    library = [get_effect(kind) for kind in ("force_map", "friction_map", "elastic_force", "friction_ripple")]
    found = diagnose(noisy.problem.records, AXIS, library=library)
    assert [finding.effect for finding in found.findings] == [hidden["kind"]]


@pytest.mark.parametrize("rest", [0.0, 0.5])
def test_what_a_transmission_carries_of_the_constant_force_is_found_where_it_is_needed(rest):
    """The preload of a spring is the amplifier's offset to all but the friction that grows with the load."""
    spring = {"kind": "elastic_force", "stiffness": 150.0, "rest_position": rest}
    noisy = hypothesis(BASELINE, spring, {"kind": "load_dependent_friction", "share": 0.15})
    model = BASELINE.with_effect(SPRING, np.array([[150.0, 0.0]]))
    begin = model.with_effect(get_effect("load_dependent_friction"), np.array([[0.05, 0.0, 0.0]]))
    found = converged(fit(noisy.with_model(begin)))
    (stiffness, _), (share, _, carried) = (values[0] for values in found.model.values)
    assert share == pytest.approx(0.15, rel=0.02)
    assert carried == pytest.approx(-150.0 * rest, rel=0.02)
    assert stiffness == pytest.approx(150.0, rel=0.02)
    assert found.cost < 1.1 * found.problem.samples("used")


def test_what_is_looked_for_with_bursts_weighed_is_fitted_as_everything_else_is():
    limited, play = get_effect("actuator_saturation"), get_effect("backlash")
    hidden = {"kind": "actuator_saturation", "limit": 3.6}
    curve = {"kind": "nonlinear_viscous_friction", "amount": 25.0, "exponent": 2.0}
    noisy = hypothesis(BASELINE.with_effect(limited, np.array([[3.6]])), hidden, curve)
    current = evaluate(noisy)
    quieter = with_noise_weights(current)
    assert quieter.cost < 0.9 * current.cost
    np.testing.assert_allclose(quieter.innovations[0] * current.noise_gain[0], current.innovations[0])
    np.testing.assert_array_equal(quieter.problem.only(0).noise_gain[0], current.noise_gain[0])
    kinds = ("nonlinear_viscous_friction", "stribeck_friction", "actuator_lag")
    library = tuple(map(get_effect, kinds))
    absorbed = tangent(current)
    alone, _ = extensions(current, screen(current, library, absorbed), absorbed)
    found, _ = extended(current, library)
    assert all(one.problem is current.problem for one in found)
    assert len(found) > len(alone)
    assert found[0].cost < alone[0].cost
    assert with_noise_weights(evaluate(hypothesis(BASELINE))) is None
    bouncing = BASELINE.with_effect(limited, np.array([[3.6]])).with_effect(
        play, np.array([[1e-4, 60.0, 0.1, 0.3, 0.0]])
    )
    assert with_noise_weights(evaluate(noisy.with_model(bouncing))) is None


def test_an_effect_that_fades_is_seen_again_by_what_it_changes():
    n = 10_000
    noise, later = np.random.default_rng(0).standard_normal(n), np.arange(n) >= n // 2
    parts = SimpleNamespace(fit=~later, select=later)
    problem = SimpleNamespace(
        splits=(parts,), samples=lambda part: n // 2, gather=lambda signals, part: signals[0][getattr(parts, part)]
    )
    fitted = lambda left: SimpleNamespace(problem=problem, innovations=(left,), noise_gain=(np.ones(n),))  # noqa: E731
    fading = np.where(later, 0.5, 2.0)
    assert _gain_repeats(fitted(noise), fitted(noise + fading), 5.0)
    elsewhere = np.where(later, 0.5 * np.sign(np.sin(np.arange(n))), 0.0)  # a stand-in changes what it should not
    assert not _gain_repeats(fitted(noise + elsewhere), fitted(noise + np.where(later, 0.0, 2.0)), 5.0)
    faint = np.where(later, 0.05, 2.0)
    assert not _gain_repeats(fitted(noise), fitted(noise + faint), 5.0)


def test_a_burst_that_noise_makes_again_and_again_is_no_evidence():
    worse = fit(hypothesis(BASELINE))
    burst = np.zeros(Q_REF.size)
    burst[2000:4000] = 6.0 * np.sin(np.arange(2000))
    louder = replace(worse, innovations=(worse.innovations[0] + burst,), cost_fit=worse.cost_fit + 2000 * 18.0)
    usual = np.ones(Q_REF.size)
    judge = Judge(SimpleNamespace(force=0.2), SimpleNamespace(threshold=30.0))
    gains = []
    for loudness in (usual, np.where(burst != 0, 20.0, 1.0)):
        louder.__dict__["noise_gain"] = (loudness,)
        gains.append(louder.cost_fit - worse.cost_fit > judge.to_beat(louder) and judge.accepts(worse, louder))
    assert gains == [True, False]


def test_the_exponent_of_a_curve_changes_with_all_other_numbers_in_their_places():
    low = {"kind": "stribeck_friction", "excess": 12.0, "stribeck_velocity": 7e-3, "exponent": 1.0}
    effect = get_effect("stribeck_friction")
    sharp = BASELINE.with_effect(effect, np.array([[9.0, 9e-3, 2.0]]))
    found = converged(fit(hypothesis(sharp, low)))
    assert found.model.values[0][0] == pytest.approx([12.0, 7e-3, 1.0], rel=0.15)


def test_another_exponent_is_tried_from_the_axis_files_friction_where_the_first_one_took_it_over():
    flattens = {"kind": "nonlinear_viscous_friction", "amount": -5.0, "exponent": 2.0}
    steep = BASELINE.with_effect(get_effect("nonlinear_viscous_friction"), np.array([[15.0, 0.5]]))
    stand_in = fit(hypothesis(steep, flattens))
    assert stand_in.model.baseline[1] < 0.1 * BASELINE.baseline[1]
    found = converged(stand_in)
    assert found.model.values[0][0] == pytest.approx([-5.0, 2.0], rel=0.02)
    assert found.cost < 0.1 * stand_in.cost


def test_under_finer_noise_nothing_is_gone_on_from_where_nothing_was_found():
    search = SimpleNamespace(best=SimpleNamespace(model=SimpleNamespace(names=("stribeck_friction",))))
    assert not bring_in_move(SimpleNamespace(names=())).applies(search)


def test_a_search_goes_on_from_one_set_to_another_twice_only_if_it_leaves_less():
    first = evaluate(hypothesis(BASELINE))
    lagging = evaluate(first.with_model(BASELINE.with_effect(LAG, np.array([[1e-4]]))))
    costs, taken = [100.0, 100.0, 99.9, 90.0], []

    def proposed(search, progress):
        return Proposal([replace(lagging, cost_fit=costs.pop(0), cost_select=0.0)])

    def takes(search, fits):
        taken.append(fits[0].cost)
        return list(fits)

    there = Move("there", lambda search: bool(costs) and search.best is first, proposed, takes, detour=True)
    back = Move(
        "back", lambda search: search.best is not first, lambda *_: Proposal([first]), lambda search, fits: list(fits)
    )
    search = walk(search_at(first), (there, back), no_progress)
    assert (taken, search.best, search.detours) == ([100.0, 100.0], first, 1)
    while costs:
        search = walk(search, (there, back), no_progress)
    assert (taken, search.detours) == ([100.0, 100.0, 99.9, 90.0], 2)


def test_a_move_that_led_nowhere_is_tried_again_only_from_another_model():
    first = evaluate(hypothesis(BASELINE))
    lagging = evaluate(first.with_model(BASELINE.with_effect(LAG, np.array([[1e-4]]))))
    calls = []

    def nothing(search, progress):
        calls.append(search.best.model.names)
        return Proposal([])

    vain = Move("vain", lambda search: True, nothing, lambda search, fits: [])
    add = Move("add", lambda search: not search.count, lambda *_: Proposal([lagging]), lambda search, fits: list(fits))
    search = walk(search_at(first), (vain, add), no_progress)
    assert search.best is lagging
    assert calls == [(), ("actuator_lag",)]
    assert walk(search, (vain, add), no_progress) is search


def test_an_interrupt_keeps_what_was_found():
    first = evaluate(hypothesis(BASELINE))
    lagging = evaluate(first.with_model(BASELINE.with_effect(LAG, np.array([[1e-4]]))))

    def ended(search):
        if search.count:
            raise KeyboardInterrupt
        return True

    add = Move("add", ended, lambda *_: Proposal([lagging]), lambda search, fits: list(fits))
    search = walk(search_at(first), (add,), no_progress)
    assert (search.best, search.interrupted, search.warnings) == (lagging, True, (beam_search.UNFINISHED,))
    assert walk(search, (add,), no_progress) is search
