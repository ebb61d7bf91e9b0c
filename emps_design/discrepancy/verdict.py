"""The fourth stage: refit the model to all used samples, confirm it, and reach the verdict.

Effects may be named together with an unknown force. They are found by a second search and confirmed like any other. The
force is of one kind that, with few effects, explains nearly all of the residual, or any smooth function of the state.
With all smooth functions projected out, most friction cannot be found. An event, a drift, a delay or a ripple can, and
the unknown force does not bias its parameters.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import Judge, explained, force_rms
from emps_design.discrepancy.beam_search import (
    finish_search,
    fit_alternately,
    leaves_little,
    only_noise,
    search_beside,
    with_force_in_loop,
)
from emps_design.discrepancy.calibration import Outcome
from emps_design.discrepancy.confirmation import (
    Share,
    confirm,
    equivalents,
    equivalents_beside_unknown,
    reliable_effects,
    robust,
    shares_on,
    widened,
    with_central_instants,
)
from emps_design.discrepancy.fit import Fit, evaluate, fit
from emps_design.discrepancy.gap import GapComparison, adapt, compare, compare_on
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.preparation import HeldOut
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.unknown_force import Kind, beside_state
from emps_design.errors import SimulationError
from emps_design.progress import Progress


@dataclass(frozen=True)
class BesideUnknown:
    """A model ``fitted`` together with an unknown force, the shares of its effects on the held-out data, equivalents.

    ``kind`` is the name of the force in ``KINDS``; empty if it may be any function of the state. ``remaining_force``
    [N] is the rms residual with both, the larger of training and held-out records. ``is_all``: the residual is only
    noise on both, and the force so large that the records need no other model.
    """

    fitted: Fit
    shares: list[Share]
    equivalents: dict[str, list[str]]
    kind: str = ""
    remaining_force: float = np.inf
    is_all: bool = False

    @property
    def names(self) -> list[str]:
        """Names of the effects, except those known from the controller's law."""
        return [share.name for share in self.shares]

    @property
    def is_an_answer(self) -> bool:
        """Whether it has effects to name, or the records need no other model."""
        return bool(self.names) or self.is_all


def found_beside_kind(outcome: Outcome, data: HeldOut) -> BesideUnknown | None:
    """The effects, possibly none, found together with an unknown force of one kind; None if there is no such force.

    Both must also explain nearly all of the held-out ``data``, with the force fitted again there.
    """
    force = outcome.unknown_force
    if force is None:
        return None
    known = _known_on(data, outcome)
    before = (force.start, _on_held_out(data, known, force.start))
    with suppress(SimulationError):
        kind = force.kind.with_baseline()
        there = with_force_in_loop(_on_held_out(data, known, force.fitted), kind)
        beside = _reliable_beside(force.search, force.fitted, there, data)
        start = beside.fitted if beside.names else force.search.path[0]
        beside = replace(beside, fitted=_in_the_loop(start, force.kind))
        after = (beside.fitted, evaluate(with_force_in_loop(_on_held_out(data, there, beside.fitted), kind)))
        if all(map(leaves_little, before, after)):
            is_all = force.is_sufficient and all(only_noise(hypothesis, rules.AT_FLOOR) for hypothesis in after)
            return replace(beside, kind=force.kind.name, remaining_force=max(map(force_rms, after)), is_all=is_all)
    return None


def _in_the_loop(fitted: Fit, kind: Kind) -> Fit:
    """``fitted`` with parameters and acting force fitted alternately; deviations cover the changes between the fits."""
    fits = fit_alternately(fitted, kind)
    last = robust(fits[-1])
    return evaluate(last, last.slots, widened(last.covariance, [step.model.vector(last.slots) for step in fits]))


def found_beside_state(outcome: Outcome, data: HeldOut) -> BesideUnknown | None:
    """The effects found by a second search with a function of the state, confirmed by ``data``; None without any."""
    again = search_beside(outcome, beside_state(outcome.baseline))
    if again.best.model.names == outcome.path[0].model.names:
        return None
    fitted = again.judge.refit(again.best)
    beside = _reliable_beside(again, fitted, beside_state(_known_on(data, outcome)), data)
    return beside if beside.names else None


def _known_on(data: HeldOut, outcome: Outcome) -> Hypothesis:
    """The baseline of the search on the held-out ``data``."""
    return Hypothesis(data.problem, outcome.path[0].model.only(0))


def _on_held_out(data: HeldOut, there: Hypothesis, fitted: Fit) -> Hypothesis:
    """The model of ``fitted`` on the held-out ``data``, in the problem of ``there``."""
    return there.with_model(adapt(data, fitted.model, fitted.model))


def _reliable_beside(again: Outcome, fitted: Fit, there: Hypothesis, data: HeldOut) -> BesideUnknown:
    """The effects of ``fitted``, found by the search ``again``, that ``data`` confirm with the force of ``there``."""
    data = replace(data, problem=there.problem)
    reliable, _ = reliable_effects(data, fitted)
    return BesideUnknown(reliable, shares_on(data, reliable), equivalents_beside_unknown(again, reliable))


def combine(reliable: Fit, beside: BesideUnknown, data: HeldOut) -> tuple[Fit, list[Share]]:
    """``reliable`` with the effects of ``beside`` added unchanged, the rest refitted, and the shares of its effects.

    Effects of ``reliable`` that the held-out ``data`` do not confirm together with the added ones are removed.
    """
    alone = reliable.model.without_named([name for name in beside.names if name in reliable.model.names])
    fitted = _fitted_around(reliable.with_model(alone), beside)
    shares = shares_on(data, fitted)
    removed = [share.name for share in shares if share.name in alone.names and not share.is_reliable]
    if removed:
        fitted = _fitted_around(reliable.with_model(alone.without_named(removed)), beside)
        shares = shares_on(data, fitted)
    return fitted, [share for share in shares if share.name in alone.names]


def _fitted_around(start: Hypothesis, beside: BesideUnknown) -> Fit:
    """``start`` fitted with the effects of ``beside`` added, whose parameters and deviations do not change.

    The better of two fits, from its own baseline and from that of ``beside``: its own may lack friction once its
    effects are withdrawn.
    """
    model, theirs = start.model, beside.fitted.model
    places = {}
    for name in beside.names:
        index = theirs.names.index(name)
        places[index] = len(model.effects)
        model = model.with_effect(theirs.effects[index], theirs.values[index])
    begins = (model, replace(model, baseline=theirs.baseline))
    free = [tuple(slot for slot in begin.slots() if slot.effect < len(start.model.effects)) for begin in begins]
    fits = side_by_side(fit, [(start.with_model(b), "used", slots) for b, slots in zip(begins, free, strict=True)])
    fitted = min(fits, key=lambda f: f.cost)
    own_slots = fitted.slots
    added = [(i, replace(s, effect=places[s.effect])) for i, s in enumerate(beside.fitted.slots) if s.effect in places]
    rows = np.array([i for i, _ in added], dtype=int)
    covariance = np.zeros((len(own_slots) + rows.size,) * 2)
    covariance[: len(own_slots), : len(own_slots)] = fitted.covariance
    covariance[len(own_slots) :, len(own_slots) :] = beside.fitted.covariance[np.ix_(rows, rows)]
    return evaluate(fitted, (*own_slots, *(slot for _, slot in added)), covariance)


@dataclass(frozen=True)
class Validation:
    """The verdict on an ``outcome`` and its two models, both fitted to all used samples.

    With the verdict "unnamed" both are the robust estimate of the baseline. ``shares`` are those of the findings on the
    held-out data; ``held_out`` compares the models on these data, None if not done. ``equivalents`` are the effects
    that explain the records as well in the place of a finding. ``refuted`` are the shares of effects withdrawn because
    of the held-out data. ``given_up`` are the effects of a model that explained ``share`` of the gap and was rejected.
    ``kind``, a name in ``unknown_force.KINDS``, is the kind of the unexplained force if known, and ``kind_leaves`` [N]
    the residual with a force of that kind. ``in_free_run`` are the velocity errors [m/s] of the baseline and of the
    model with the ``given_up`` effects, if these errors were the reason.
    """

    outcome: Outcome
    verdict: str
    baseline: Fit
    extended: Fit
    equivalents: dict[str, list[str]] = field(default_factory=dict)
    shares: list[Share] = field(default_factory=list)
    refuted: tuple[Share, ...] = ()
    given_up: tuple[str, ...] = ()
    share: float = 0.0
    held_out: GapComparison | None = None
    kind: str = ""
    kind_leaves: float = math.inf
    in_free_run: tuple[float, float] | None = None

    @cached_property
    def train(self) -> GapComparison:
        """Both models on the training records."""
        return compare(self.outcome.baseline.problem, self.baseline.model, self.extended.model)

    @property
    def confirmed(self) -> dict[str, dict[str, float] | None]:
        """The share of each finding on the held-out data, by name."""
        return {share.name: share.confirmed for share in self.shares}

    @property
    def remaining_force(self) -> tuple[float, float]:
        """Rms residual [N] of baseline and extended model, on the held-out data if compared there."""
        if self.held_out is None:
            return force_rms(self.baseline), force_rms(self.extended)
        return self.held_out.gap.baseline, self.held_out.gap.extended

    @property
    def training_is_quiet(self) -> bool:
        """Whether the residual of the extended model on the training records is only noise."""
        return self.train.gap.extended <= rules.QUIET * self.outcome.floor.force

    @property
    def names_something(self) -> bool:
        """Whether an effect is named, and none has too many equivalents."""
        many = any(len(others) > rules.MOST_EQUIVALENTS for others in self.equivalents.values())
        return len(self.extended.model.names) > len(self.baseline.model.names) and not many

    def compared(self, data: HeldOut | None) -> Validation:
        """The same with the models compared on the held-out ``data``, if there are any."""
        if data is None:
            return self
        return replace(self, held_out=compare_on(data, self.baseline.model, self.extended.model))

    def beside_something_unknown(self) -> Validation:
        """The same findings, with the verdict that something else is missing because data not searched show it."""
        named = self.verdict in ("named", "ambiguous", "partly-named")
        return replace(self, verdict="partly-named" if named else "unnamed")


def validate(outcome: Outcome, progress: Progress) -> Validation:
    """Refit the best model of the search to all used samples, evaluate it on the held-out data, and reach a verdict.

    A search that ended early at an unknown force is finished if the held-out data do not confirm the force, or if no
    effect can be named with it.
    """
    problem, data = outcome.baseline.problem, outcome.preparation.held_out
    force = None
    if data is not None:
        data = data.with_whitening(problem.whitening)
        force = found_beside_kind(outcome, data)
    if outcome.ended_early and (force is None or not force.is_an_answer):
        outcome = replace(finish_search(outcome, progress), unknown_force=None)
    start = fit(outcome.baseline, part="used")
    searched = outcome.judge.refit(outcome.best) if len(outcome.path) > 1 else start
    answer, left_over = _all_or_nothing(outcome, data, start, searched, force)
    if left_over or outcome.ended_early:
        answer = _effect_by_effect(data, searched, answer, force)
    in_free_run = _refuted_in_free_run(start, answer)
    if in_free_run is not None:
        answer = replace(answer, verdict="unnamed", given_up=answer.extended.model.names, in_free_run=in_free_run)
    if answer.verdict == "unnamed":
        estimate = robust(answer.baseline)
        answer = replace(answer, baseline=estimate, extended=estimate, shares=[], held_out=None)
    final = replace(
        answer, baseline=_without_controller_effect(answer.baseline), extended=with_central_instants(answer.extended)
    )
    changed = final.baseline is not answer.baseline or final.extended is not answer.extended
    return final.compared(data) if changed or final.held_out is None else final


def _refuted_in_free_run(start: Fit, answer: Validation) -> tuple[float, float] | None:
    """Velocity errors [m/s] of baseline and extended model, driven by the command alone, if these refute the effects.

    A model that follows its record is judged by the force needed for this. In that force one effect can imitate
    another: a dead zone a load on a spring. In free motion it cannot. Its error must exceed the change that noise makes
    in that motion, because friction that falls with speed, or a ripple that holds a slow axis, makes the motion
    sensitive to noise. Both models are least-squares fits; ``start`` is the baseline. Effects of the sensor do not
    change the motion. An unbounded motion proves nothing, nor does an error of the baseline as large as the motion.
    """
    effects = answer.extended.model.effects
    if not answer.extended.problem.follows or answer.verdict == "unnamed" or not effects:
        return None
    if all(effect.channel == "sensor" for effect in effects):
        return None
    with suppress(SimulationError):
        extended = fit(answer.extended, "used")
        error = extended.free_run()
        before, after = _rms(start.free_run()), _rms(error)
        if before > _rms(np.concatenate([np.gradient(record.q, record.period) for record in start.problem.records])):
            return None
        by_noise = [_rms(extended.free_run(extended.problem.noise(seed)) - error) for seed in range(rules.NOISES)]
        return (before, after) if after - max(by_noise) > rules.CLOSE * before else None
    return None


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def _all_or_nothing(
    outcome: Outcome, data: HeldOut | None, start: Fit, searched: Fit, force: BesideUnknown | None
) -> tuple[Validation, bool]:
    """The verdict on all effects of ``searched`` together, without those that the held-out ``data`` refute.

    ``start`` is the baseline. Also returns whether the residual, or an unknown ``force``, is so large that each effect
    needs its own evidence.
    """
    judge, floor, lost_share, extended = outcome.judge, outcome.floor.force, 0.0, searched
    shares: list[Share] = []
    refuted: tuple[Share, ...] = ()
    if data is not None:
        gain = start.cost - extended.cost
        extended, shares, refuted = confirm(judge, data, extended)
        lost_share = 1 - (start.cost - extended.cost) / gain if refuted else 0.0

    # Share of the gap closed by effects of the plant; a disturbance known from the controller's law does not count.
    named = extended.model.names != start.model.names
    remaining = [force_rms(extended)]
    closed = [explained(force_rms(start), remaining[0], floor)]
    held_out = None if data is None else compare_on(data, start.model, extended.model)
    if held_out is not None:
        remaining.append(min(held_out.remaining_force, held_out.gap.extended))
        closed.append(explained(held_out.gap.baseline, remaining[-1], floor))
    rivals = {n: others for n, others in equivalents(outcome).items() if n in extended.model.names}
    verdict = _verdict(judge, extended, start, rivals, closed[-1], max(remaining))
    # A gap closed on the training record only is not explained; neither is one of which a good part was refuted.
    unconfirmed = named and closed[-1] < rules.MOST * min(closed[0], 1.0)  # above 1 if the residual is below the noise
    doubtful = lost_share > rules.SLIGHT and not judge.at_floor(extended)
    interrupted_early = outcome.interrupted and not extended.model.names
    if interrupted_early or unconfirmed or doubtful:
        verdict = "unnamed"
    if outcome.preparation.unexplained_law:  # treated as a known input, but not explained
        verdict = "partly-named" if verdict in ("named", "ambiguous") else "unnamed"
    failed = verdict == "unnamed" and not judge.at_floor(extended)
    open_gap = judge.leaves_unexplained(extended) and (
        min(closed) < 1 - rules.EQUIVALENT or _explains(force, max(remaining), floor)
    )
    given_up = extended.model.names if verdict == "unnamed" and named else ()
    answer = Validation(
        outcome, verdict, start, extended, rivals, shares, refuted, given_up, share=closed[-1], held_out=held_out
    )
    return answer, (failed or unconfirmed or open_gap) and not interrupted_early


def _explains(force: BesideUnknown | None, remaining: float, floor: float) -> bool:
    """Whether an unknown ``force`` with effects to name explains a good part of ``remaining`` [N]."""
    return force is not None and bool(force.names) and explained(remaining, force.remaining_force, floor) >= rules.HALF


def _effect_by_effect(
    data: HeldOut | None, searched: Fit, answer: Validation, force: BesideUnknown | None
) -> Validation:
    """The result with only those effects that have their own evidence, for models whose residual has structure.

    With an unknown ``force`` of one kind, if that and few effects also explain nearly all of the held-out ``data``; if
    there are no effects, nothing is named. Otherwise effects of ``searched``, and those found with any function of the
    state, if the model has a smaller residual on these data than its baseline.
    """
    outcome = answer.outcome
    if data is not None and force is not None and force.is_an_answer:
        nothing = Validation(outcome, "partly-named", answer.baseline, answer.baseline, share=answer.share)
        answers = [_combine_with(force, nothing, answer.baseline, data)] if force.names else []
    else:
        answers = _beside_anything(data, searched, answer)
    compared = [candidate.compared(data) for candidate in answers if candidate.names_something]
    tenable = [
        candidate
        for candidate in compared
        if candidate.kind or candidate.remaining_force[1] < candidate.remaining_force[0]
    ]
    if tenable:
        return min(tenable, key=lambda candidate: candidate.remaining_force[1])
    given_up = answer.given_up or answer.extended.model.names
    floor, unexplained = outcome.floor.force, max(force_rms(answer.baseline), answer.remaining_force[0])
    if force is not None and explained(unexplained, force.remaining_force, floor) >= rules.HALF:
        answer = replace(answer, kind=force.kind, kind_leaves=force.remaining_force)
    return replace(answer, verdict="unnamed", equivalents=answers[-1].equivalents if answers else {}, given_up=given_up)


def _beside_anything(data: HeldOut | None, searched: Fit, answer: Validation) -> list[Validation]:
    """Results with the reliable effects of ``searched``, the first also with those found with the state, if any."""
    outcome = answer.outcome

    def by_itself() -> Validation:
        reliable, refuted = reliable_effects(data, searched)
        if not reliable.innovations:  # without the withdrawn effects the rest of the model cannot be simulated
            reliable = answer.baseline
        shares = [] if data is None else shares_on(data, reliable)
        equivalents, baseline = equivalents_beside_unknown(outcome, reliable), robust(answer.baseline)
        return Validation(outcome, "partly-named", baseline, reliable, equivalents, shares, refuted, share=answer.share)

    if data is None:
        return [by_itself()]
    # The longest first, in this thread: an interrupt arrives here and ends the search only.
    beside, alone = side_by_side(
        lambda find: find(), [(find,) for find in (partial(found_beside_state, outcome, data), by_itself)]
    )
    return [alone] if beside is None else [_combine_with(beside, alone, answer.baseline, data), alone]


def _combine_with(beside: BesideUnknown, answer: Validation, baseline: Fit, data: HeldOut) -> Validation:
    """``answer`` with the effects of ``beside``, which replace those of the same name."""
    both, shares = combine(answer.extended, beside, data)
    only_alone = [name for name in both.model.names if name not in beside.names]
    return replace(
        answer,
        baseline=baseline,
        extended=both,
        kind=beside.kind,
        kind_leaves=beside.remaining_force,
        equivalents={name: answer.equivalents.get(name, []) for name in only_alone} | beside.equivalents,
        shares=shares + beside.shares,
        refuted=tuple(share for share in answer.refuted if share.name not in beside.names),
    )


def _without_controller_effect(start: Fit) -> Fit:
    """The baseline without the controller's disturbance, which is known from the law."""
    if not start.model.names:
        return start
    return evaluate(start.with_model(replace(start.model, effects=(), values=())), start.slots, start.covariance)


def _verdict(
    judge: Judge, best: Fit, known: Fit, equivalents: dict[str, list[str]], share: float, remaining: float
) -> str:
    """The verdict on ``best``, which explains ``share`` of the force gap; the search started with ``known``.

    If structure remains, effects are named only if they explain most of the gap. The verdict is "nothing-missing" only
    if training and held-out data agree on it; ``remaining`` [N] is the larger rms residual of both.
    """
    if best.model.names == known.model.names:
        if judge.leaves_structure(best):
            return "unnamed"
        if not best.model.names:
            if remaining > rules.QUIET * judge.floor.force:
                return "unnamed"
            return "parameters-only" if wrong_numbers(best) else "nothing-missing"
    elif not judge.at_floor(best) and share < rules.MOST:
        return "unnamed"
    if any(len(names) > rules.MOST_EQUIVALENTS for names in equivalents.values()):
        return "unnamed"
    return "ambiguous" if any(equivalents.values()) else "named"


def wrong_numbers(fitted: Fit) -> list[int]:
    """Indices of the baseline parameters in which the axis file is wrong: significantly, and by a relevant amount."""
    errors = fitted.model.baseline - fitted.problem.axis.mechanics.array()
    return [
        slot.place
        for slot in fitted.slots
        if slot.effect < 0
        and abs(errors[slot.place]) > rules.SURE * fitted.std(-1, slot.place)
        and abs(errors[slot.place]) > rules.OFF * slot.magnitude
    ]
