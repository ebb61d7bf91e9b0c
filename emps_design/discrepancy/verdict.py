"""The fourth stage: refit the model to all used samples, confirm it, and reach the verdict.

Effects may stand beside an unknown force, found by a second search and confirmed like any other. The force is of one
kind, which with few effects leaves next to nothing, or any smooth function of the state. With all smooth functions
projected out, most friction cannot be found; an event, a drift, a delay or a ripple can, and the unknown force does not
bend its parameters.
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
    acting,
    finish_search,
    in_turn,
    next_to_nothing,
    only_noise,
    search_beside,
)
from emps_design.discrepancy.calibration import Outcome
from emps_design.discrepancy.confirmation import (
    Share,
    alike_in_company,
    centred,
    claims_on,
    confirm,
    equivalents,
    robust,
    standing,
    widened,
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
    """A model ``fitted`` beside an unknown force, the shares of its effects on the confirming data, and equivalents.

    ``kind`` is the name of the force in ``KINDS``; empty where it may be any function of the state. ``remaining_force``
    [N] is the rms with both, the larger of training and confirming records; ``is_all`` whether that is only noise on
    both, and the force so large that the records need no other model.
    """

    fitted: Fit
    shares: list[Share]
    equivalents: dict[str, list[str]]
    kind: str = ""
    remaining_force: float = np.inf
    is_all: bool = False

    @property
    def names(self) -> list[str]:
        """Names of the effects, without those known from the controller's law."""
        return [share.name for share in self.shares]

    @property
    def is_an_answer(self) -> bool:
        """Whether it has effects to name, or the records need no other model."""
        return bool(self.names) or self.is_all


def found_beside_kind(outcome: Outcome, data: HeldOut) -> BesideUnknown | None:
    """The effects found beside an unknown force of one kind, maybe none; None where there is no such force.

    Both must leave next to nothing of the confirming ``data`` too, with the force fitted again there.
    """
    force = outcome.of_a_kind
    if force is None:
        return None
    known = _known_on(data, outcome)
    before = (force.start, _on(data, known, force.start))
    with suppress(SimulationError):
        kind = force.kind.with_baseline()
        there = acting(_on(data, known, force.fitted), kind)
        beside = _standing(force.search, force.fitted, there, data)
        start = beside.fitted if beside.names else force.search.path[0]
        beside = replace(beside, fitted=_in_the_loop(start, force.kind))
        after = (beside.fitted, evaluate(acting(_on(data, there, beside.fitted), kind)))
        if all(map(next_to_nothing, before, after)):
            is_all = force.is_plain and all(only_noise(hypothesis, rules.AT_FLOOR) for hypothesis in after)
            return replace(beside, kind=force.kind.name, remaining_force=max(map(force_rms, after)), is_all=is_all)
    return None


def _in_the_loop(fitted: Fit, kind: Kind) -> Fit:
    """``fitted`` with parameters and acting force fitted in turn; deviations cover the changes on the way."""
    fits = in_turn(fitted, kind)
    last = robust(fits[-1])
    return evaluate(last, last.slots, widened(last.covariance, [step.model.vector(last.slots) for step in fits]))


def found_beside_state(outcome: Outcome, data: HeldOut) -> BesideUnknown | None:
    """The effects that a second search finds beside the state and ``data`` confirm; None without any."""
    again = search_beside(outcome, beside_state(outcome.baseline))
    if again.best.model.names == outcome.path[0].model.names:
        return None
    fitted = again.judge.refitted(again.best)
    beside = _standing(again, fitted, beside_state(_known_on(data, outcome)), data)
    return beside if beside.names else None


def _known_on(data: HeldOut, outcome: Outcome) -> Hypothesis:
    """The model that the search began with, on the confirming ``data``."""
    return Hypothesis(data.problem, outcome.path[0].model.only(0))


def _on(data: HeldOut, there: Hypothesis, fitted: Fit) -> Hypothesis:
    """The model of ``fitted`` on the confirming ``data``, in the problem of ``there``."""
    return there.with_model(adapt(data, fitted.model, fitted.model))


def _standing(again: Outcome, fitted: Fit, there: Hypothesis, data: HeldOut) -> BesideUnknown:
    """The effects of ``fitted``, of the search ``again``, that stand on ``data`` beside the force of ``there``.

    Without effects where none stands.
    """
    data = replace(data, problem=there.problem)
    stands, _ = standing(data, fitted)
    return BesideUnknown(stands, claims_on(data, stands), alike_in_company(again, stands))


def joined(stands: Fit, beside: BesideUnknown, data: HeldOut) -> tuple[Fit, list[Share]]:
    """``stands`` with the effects of ``beside`` unchanged and all else refitted, and the shares of its own effects.

    Without the effects of ``stands`` that the confirming ``data`` do not want beside these.
    """
    own = stands.model.without_named([name for name in beside.names if name in stands.model.names])
    fitted = _fitted_around(stands.with_model(own), beside)
    shares = claims_on(data, fitted)
    gone = [share.name for share in shares if share.name in own.names and not share.stands]
    if gone:
        fitted = _fitted_around(stands.with_model(own.without_named(gone)), beside)
        shares = claims_on(data, fitted)
    return fitted, [share for share in shares if share.name in own.names]


def _fitted_around(start: Hypothesis, beside: BesideUnknown) -> Fit:
    """``start`` fitted with the effects of ``beside`` added, whose parameters and deviations stay.

    From its own baseline and from that of ``beside``: its own may lack friction once its effects are withdrawn.
    """
    model, theirs = start.model, beside.fitted.model
    places = {}
    for name in beside.names:
        index = theirs.names.index(name)
        places[index] = len(model.effects)
        model = model.with_effect(theirs.effects[index], theirs.values[index])
    begins = (model, replace(model, baseline=theirs.baseline))
    free = [tuple(slot for slot in begin.slots() if slot.effect < len(start.model.effects)) for begin in begins]
    fits = side_by_side(fit, [(start.with_model(b), "used", own) for b, own in zip(begins, free, strict=True)])
    fitted = min(fits, key=lambda f: f.cost)
    own = fitted.slots
    moved = [(i, replace(s, effect=places[s.effect])) for i, s in enumerate(beside.fitted.slots) if s.effect in places]
    rows = np.array([i for i, _ in moved], dtype=int)
    covariance = np.zeros((len(own) + rows.size,) * 2)
    covariance[: len(own), : len(own)] = fitted.covariance
    covariance[len(own) :, len(own) :] = beside.fitted.covariance[np.ix_(rows, rows)]
    return evaluate(fitted, (*own, *(slot for _, slot in moved)), covariance)


@dataclass(frozen=True)
class Validation:
    """The verdict on an ``outcome`` and its two models, both fitted to all used samples.

    For an unnamed structure both are the robust estimate of the baseline. ``shares`` are those of the findings on the
    confirming data, on which ``held_out`` compares the models, None where not done; ``equivalents`` are the effects
    that explain the records as well in a finding's place; ``refuted`` are the shares that the held-out data withdrew;
    ``given_up`` are the effects of a model that explained ``share`` of the gap and did not stand; ``kind``, one of
    ``unknown_force.KINDS``, is the kind of the rest, where known, and ``kind_leaves`` [N] the residual with an unknown
    force of that kind. ``in_free_run`` are the velocity errors [m/s] of the baseline and of the model with ``given_up``
    effects where these refute the effects.
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
        """The share of each finding on the confirming data."""
        return {share.name: share.confirmed for share in self.shares}

    @property
    def remaining_force(self) -> tuple[float, float]:
        """Force [N] that baseline and model leave, on the confirming data where compared there."""
        if self.held_out is None:
            return force_rms(self.baseline), force_rms(self.extended)
        return self.held_out.gap.baseline, self.held_out.gap.extended

    @property
    def training_is_quiet(self) -> bool:
        """Whether the extended model leaves only noise on the training records."""
        return self.train.gap.extended <= rules.QUIET * self.outcome.floor.force

    @property
    def names_something(self) -> bool:
        """Whether an effect is named, and none has too many equivalents."""
        many = any(len(others) > rules.MOST_EQUIVALENTS for others in self.equivalents.values())
        return len(self.extended.model.names) > len(self.baseline.model.names) and not many

    def compared(self, data: HeldOut | None) -> Validation:
        """The same with the models compared on the confirming ``data``, where there are any."""
        if data is None:
            return self
        return replace(self, held_out=compare_on(data, self.baseline.model, self.extended.model))

    def beside_something_unknown(self) -> Validation:
        """The same findings with the verdict that something else is missing, as data not searched show."""
        named = self.verdict in ("named", "ambiguous", "partly-named")
        return replace(self, verdict="partly-named" if named else "unnamed")


def validate(outcome: Outcome, progress: Progress) -> Validation:
    """Refit the search's best model on everything, open the confirming data, and reach a verdict.

    A search that ended early at an unknown force is finished where these data do not confirm the force, or no effect
    can be named beside it.
    """
    problem, data = outcome.baseline.problem, outcome.preparation.held_out
    force = None
    if data is not None:
        data = data.with_whitening(problem.whitening)
        force = found_beside_kind(outcome, data)
    if outcome.ended_early and (force is None or not force.is_an_answer):
        outcome = replace(finish_search(outcome, progress), of_a_kind=None)
    start = fit(outcome.baseline, part="used")
    searched = outcome.judge.refitted(outcome.best) if len(outcome.path) > 1 else start
    answer, left_over = _all_or_nothing(outcome, data, start, searched, force)
    if left_over or outcome.ended_early:
        answer = _effect_by_effect(data, searched, answer, force)
    in_free_run = _refuted_in_free_run(start, answer)
    if in_free_run is not None:
        answer = replace(answer, verdict="unnamed", given_up=answer.extended.model.names, in_free_run=in_free_run)
    if answer.verdict == "unnamed":
        estimate = robust(answer.baseline)
        answer = replace(answer, baseline=estimate, extended=estimate, shares=[], held_out=None)
    final = replace(answer, baseline=_alone(answer.baseline), extended=centred(answer.extended))
    moved = final.baseline is not answer.baseline or final.extended is not answer.extended
    return final.compared(data) if moved or final.held_out is None else final


def _refuted_in_free_run(start: Fit, answer: Validation) -> tuple[float, float] | None:
    """Velocity errors [m/s] of the baseline and the extended model driven by the command alone, where those refute it.

    A model that follows its record is judged by the force this takes, and an effect can replace another in that force
    alone: a dead zone a load on a spring. In a free motion it fails, by more than noise changes that motion: friction
    that falls with speed, or a ripple that holds a slow axis, leaves much to chance. Both models by least squares,
    ``start`` is the baseline. Effects of the sensor move nothing. A motion without bounds tells nothing, nor does one
    that the baseline misses by all of it.
    """
    effects = answer.extended.model.effects
    if not answer.extended.problem.follows or answer.verdict == "unnamed" or not effects:
        return None
    if all(effect.channel == "sensor" for effect in effects):
        return None
    with suppress(SimulationError):
        extended = fit(answer.extended, "used")
        missed = extended.free_run()
        before, after = _rms(start.free_run()), _rms(missed)
        if before > _rms(np.concatenate([np.gradient(record.q, record.period) for record in start.problem.records])):
            return None
        chance = [_rms(extended.free_run(extended.problem.noise(seed)) - missed) for seed in range(rules.NOISES)]
        return (before, after) if after - max(chance) > rules.CLOSE * before else None
    return None


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def _all_or_nothing(
    outcome: Outcome, data: HeldOut | None, start: Fit, searched: Fit, force: BesideUnknown | None
) -> tuple[Validation, bool]:
    """The verdict on all effects of ``searched`` together, without those that the confirming ``data`` refute.

    ``start`` is the baseline. Also returns whether so much is left, or explained by an unknown ``force``, that each
    effect must stand on its own evidence.
    """
    judge, floor, lost, extended = outcome.judge, outcome.floor.force, 0.0, searched
    shares: list[Share] = []
    refuted: tuple[Share, ...] = ()
    if data is not None:
        learnt = start.cost - extended.cost
        extended, shares, refuted = confirm(judge, data, extended)
        lost = 1 - (start.cost - extended.cost) / learnt if refuted else 0.0

    # Share of the gap closed by the plant's effects, beside a disturbance known from the controller's law.
    named = extended.model.names != start.model.names
    remaining = [force_rms(extended)]
    closed = [explained(force_rms(start), remaining[0], floor)]
    held_out = None if data is None else compare_on(data, start.model, extended.model)
    if held_out is not None:
        remaining.append(min(held_out.remaining_force, held_out.gap.extended))
        closed.append(explained(held_out.gap.baseline, remaining[-1], floor))
    rivals = {n: others for n, others in equivalents(outcome).items() if n in extended.model.names}
    verdict = _verdict(judge, extended, start, rivals, closed[-1], max(remaining))
    # A gap closed on the training record only is not explained; nor is one of which a good part was refuted.
    forgotten = named and closed[-1] < rules.MOST * min(closed[0], 1.0)  # at most 1, where less than noise is left
    doubtful = lost > rules.SLIGHT and not judge.at_floor(extended)
    nothing_yet = outcome.interrupted and not extended.model.names
    if nothing_yet or forgotten or doubtful:
        verdict = "unnamed"
    if outcome.preparation.unexplained_law:  # known as a command, but not explained
        verdict = "partly-named" if verdict in ("named", "ambiguous") else "unnamed"
    failed = verdict == "unnamed" and not judge.at_floor(extended)
    open_gap = judge.leaves_unexplained(extended) and (
        min(closed) < 1 - rules.EQUIVALENT or _explains(force, max(remaining), floor)
    )
    given_up = extended.model.names if verdict == "unnamed" and named else ()
    answer = Validation(
        outcome, verdict, start, extended, rivals, shares, refuted, given_up, share=closed[-1], held_out=held_out
    )
    return answer, (failed or forgotten or open_gap) and not nothing_yet


def _explains(force: BesideUnknown | None, remaining: float, floor: float) -> bool:
    """Whether an unknown ``force`` with effects to name explains a good part of ``remaining`` [N]."""
    return force is not None and bool(force.names) and explained(remaining, force.remaining_force, floor) >= rules.HALF


def _effect_by_effect(
    data: HeldOut | None, searched: Fit, answer: Validation, force: BesideUnknown | None
) -> Validation:
    """The answer with the effects that stand on their own evidence, for models that leave structure.

    Beside an unknown ``force`` of one kind, where it and few effects leave next to nothing of the confirming ``data``
    too; without effects nothing is named. Otherwise effects of ``searched``, and those that stand beside any function
    of the state, where the model leaves less of these data than its baseline.
    """
    outcome = answer.outcome
    if data is not None and force is not None and force.is_an_answer:
        nothing = Validation(outcome, "partly-named", answer.baseline, answer.baseline, share=answer.share)
        answers = [_with(force, nothing, answer.baseline, data)] if force.names else []
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
    floor, missed = outcome.floor.force, max(force_rms(answer.baseline), answer.remaining_force[0])
    if force is not None and explained(missed, force.remaining_force, floor) >= rules.HALF:
        answer = replace(answer, kind=force.kind, kind_leaves=force.remaining_force)
    return replace(answer, verdict="unnamed", equivalents=answers[-1].equivalents if answers else {}, given_up=given_up)


def _beside_anything(data: HeldOut | None, searched: Fit, answer: Validation) -> list[Validation]:
    """Answers of the effects of ``searched`` that stand alone, first with those found beside the state, if any."""
    outcome = answer.outcome

    def by_itself() -> Validation:
        stands, refuted = standing(data, searched)
        if not stands.innovations:  # without the effects withdrawn, the rest of the model cannot be simulated
            stands = answer.baseline
        shares = [] if data is None else claims_on(data, stands)
        alike, baseline = alike_in_company(outcome, stands), robust(answer.baseline)
        return Validation(outcome, "partly-named", baseline, stands, alike, shares, refuted, share=answer.share)

    if data is None:
        return [by_itself()]
    # The longest first, in this thread, where an interrupt arrives: it ends the search only.
    beside, own = side_by_side(
        lambda find: find(), [(find,) for find in (partial(found_beside_state, outcome, data), by_itself)]
    )
    return [own] if beside is None else [_with(beside, own, answer.baseline, data), own]


def _with(beside: BesideUnknown, answer: Validation, baseline: Fit, data: HeldOut) -> Validation:
    """``answer`` with the effects ``beside`` an unknown force, which replace those of the same name."""
    both, shares = joined(answer.extended, beside, data)
    own = [name for name in both.model.names if name not in beside.names]
    return replace(
        answer,
        baseline=baseline,
        extended=both,
        kind=beside.kind,
        kind_leaves=beside.remaining_force,
        equivalents={name: answer.equivalents.get(name, []) for name in own} | beside.equivalents,
        shares=shares + beside.shares,
        refuted=tuple(share for share in answer.refuted if share.name not in beside.names),
    )


def _alone(start: Fit) -> Fit:
    """The baseline without the controller's disturbance, which is known from the law."""
    if not start.model.names:
        return start
    return evaluate(start.with_model(replace(start.model, effects=(), values=())), start.slots, start.covariance)


def _verdict(
    judge: Judge, best: Fit, known: Fit, equivalents: dict[str, list[str]], share: float, remaining: float
) -> str:
    """The verdict on ``best``, which explains ``share`` of the force gap; the search started with ``known``.

    Where the model leaves structure, effects stand only if they explain most of the gap. Nothing is missing only where
    training and confirming data say so; ``remaining`` [N] is the larger rms of both.
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
    """Indices of the baseline parameters at which the axis file is wrong: significantly, and by a relevant amount."""
    off = fitted.model.baseline - fitted.problem.axis.mechanics.array()
    return [
        slot.place
        for slot in fitted.slots
        if slot.effect < 0
        and abs(off[slot.place]) > rules.SURE * fitted.std(-1, slot.place)
        and abs(off[slot.place]) > rules.OFF * slot.magnitude
    ]
