"""The fourth stage: the model refitted to everything, confirmed, and what it all amounts to.

Effects that stand beside an unknown force, found by a second search and confirmed like any other.

The force is of one kind, with which and few effects next to nothing is left, or any function of the state. Where smooth
functions of the state explain nothing, neither does most friction; what is left there of an instant, a drift, a delay
or a line along the travel has no unknown force to share with, and its numbers are not bent by one.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import Judge, explained, force_rms
from emps_design.discrepancy.beam_search import acting, finished, in_turn, next_to_nothing, only_noise, search_beside
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
from emps_design.discrepancy.gap import GapComparison, adapted, compare, compare_on
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.preparation import HeldOut
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.unknown_force import Kind, beside_state
from emps_design.errors import SimulationError
from emps_design.progress import Progress


@dataclass(frozen=True)
class BesideUnknown:
    """A fit judged beside an unknown force, how much of its effects the confirming data ask for, their equivalents.

    ``kind`` of ``KINDS`` is what the force is like; empty where it may be any function of the state. ``left`` [N] is
    the rms that the two leave, on training or confirming records, whichever is more; ``is_all`` whether that is nothing
    but noise on both, of so much that nothing else is to be said of the records.
    """

    found: Fit
    asked: list[Share]
    equivalents: dict[str, list[str]]
    kind: str = ""
    left: float = np.inf
    is_all: bool = False

    @property
    def names(self) -> list[str]:
        """Names of the effects, without what is known from the controller's law."""
        return [one.name for one in self.asked]

    @property
    def is_an_answer(self) -> bool:
        """Whether it has effects to name, or nothing else is to be said: the records need no other model."""
        return bool(self.names) or self.is_all


def found_beside_kind(outcome: Outcome, data: HeldOut) -> BesideUnknown | None:
    """What the search found beside an unknown force of one kind, maybe nothing; None where there is no such force.

    Where the two leave next to nothing of the confirming ``data`` either, with the force fitted anew there.
    """
    force = outcome.of_a_kind
    if force is None:
        return None
    known = _known_on(data, outcome)
    before = (force.start, _on(data, known, force.start))
    with suppress(SimulationError):
        given = force.kind.beside_given()
        there = acting(_on(data, known, force.found), given)
        beside = _standing(force.outcome, force.found, there, data)
        start = beside.found if beside.names else force.outcome.path[0]
        beside = replace(beside, found=_in_the_loop(start, force.kind))
        after = (beside.found, evaluate(acting(_on(data, there, beside.found), given)))
        if all(map(next_to_nothing, before, after)):
            is_all = force.is_plain and all(only_noise(one, rules.AT_FLOOR) for one in after)
            return replace(beside, kind=force.kind.name, left=max(map(force_rms, after)), is_all=is_all)
    return None


def _in_the_loop(found: Fit, kind: Kind) -> Fit:
    """``found`` with its numbers and the force that acts fitted in turn; no number is known better than it moved."""
    fits = in_turn(found, kind)
    last = robust(fits[-1])
    return evaluate(last, last.slots, widened(last.covariance, [one.model.vector(last.slots) for one in fits]))


def found_beside_state(outcome: Outcome, data: HeldOut) -> BesideUnknown | None:
    """What a second search finds beside the state and the confirming ``data`` ask for there; None where nothing."""
    again = search_beside(outcome.calibration, beside_state(outcome.calibration.baseline))
    if again.best.model.names == outcome.path[0].model.names:
        return None
    found = again.calibration.judge.refitted(again.best)
    beside = _standing(again, found, beside_state(_known_on(data, outcome)), data)
    return beside if beside.names else None


def _known_on(data: HeldOut, outcome: Outcome) -> Hypothesis:
    """The model that the search began with, on the confirming ``data``."""
    return Hypothesis(data.problem, outcome.path[0].model.only(0))


def _on(data: HeldOut, there: Hypothesis, found: Fit) -> Hypothesis:
    """The model of ``found`` on the confirming ``data`` as they are judged ``there``."""
    return there.with_model(adapted(data, found.model, found.model))


def _standing(again: Outcome, found: Fit, there: Hypothesis, data: HeldOut) -> BesideUnknown:
    """What the confirming ``data`` ask for of what the search ``again`` ``found``, beside the force as it is ``there``.

    Empty where that is nothing.
    """
    data = replace(data, problem=there.problem)
    stands, _ = standing(data, found)
    return BesideUnknown(stands, claims_on(data, stands), alike_in_company(again, stands))


def joined(stands: Fit, beside: BesideUnknown, data: HeldOut) -> tuple[Fit, list[Share]]:
    """``stands`` with the effects of ``beside`` as they were found, all else fitted again and asked for.

    Without those of ``stands`` that the confirming ``data`` do not ask for in this company.
    """
    own = stands.model.without_named([name for name in beside.names if name in stands.model.names])
    fitted = _fitted_around(stands.with_model(own), beside)
    asked = claims_on(data, fitted)
    gone = [one.name for one in asked if one.name in own.names and not one.stands]
    if gone:
        fitted = _fitted_around(stands.with_model(own.without_named(gone)), beside)
        asked = claims_on(data, fitted)
    return fitted, [one for one in asked if one.name in own.names]


def _fitted_around(start: Hypothesis, beside: BesideUnknown) -> Fit:
    """``start`` fitted with the effects of ``beside`` added, whose numbers and deviations stay.

    From its own baseline and from that of ``beside``: where all that stood was withdrawn, friction may be gone.
    """
    model, theirs = start.model, beside.found.model
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
    moved = [(i, replace(s, effect=places[s.effect])) for i, s in enumerate(beside.found.slots) if s.effect in places]
    rows = np.array([i for i, _ in moved], dtype=int)
    covariance = np.zeros((len(own) + rows.size,) * 2)
    covariance[: len(own), : len(own)] = fitted.covariance
    covariance[len(own) :, len(own) :] = beside.found.covariance[np.ix_(rows, rows)]
    return evaluate(fitted, (*own, *(slot for _, slot in moved)), covariance)


@dataclass(frozen=True)
class Validation:
    """The verdict on an ``outcome`` and the models it speaks of, both fitted to all that may be used.

    Where structure is left that has no name, both are the robust estimate of the baseline.
    ``confirmed`` is how much of each finding the confirming data ask for; ``equivalents`` of each finding are effects
    that could stand in its place; ``refuted`` is what the held-out data withdrew; ``given_up`` are the effects of a
    model that explained ``share`` of the gap and did not stand; ``kind``, one of ``unknown_force.KINDS``, says what the
    rest is like, where that is known, and ``kind_leaves`` [N] what would be left with an unknown force of that kind.
    ``in_free_run`` are the velocity errors [m/s] of baseline and ``given_up`` effects where those refute the effects.
    """

    outcome: Outcome
    verdict: str
    baseline: Fit
    extended: Fit
    equivalents: dict[str, list[str]]
    train: GapComparison
    held_out: GapComparison | None
    confirmed: dict[str, dict[str, float] | None]
    refuted: tuple[Share, ...]
    given_up: tuple[str, ...]
    share: float
    kind: str = ""
    kind_leaves: float = math.inf
    in_free_run: tuple[float, float] | None = None

    @property
    def training_is_quiet(self) -> bool:
        """Whether the extended model leaves nothing but noise of the records that it was fitted to."""
        return self.train.gap.extended <= rules.QUIET * self.outcome.calibration.floor.force

    def beside_something_unknown(self) -> Validation:
        """The same findings, where data that were not searched show that something else is missing."""
        named = self.verdict in ("named", "ambiguous", "partly-named")
        return replace(self, verdict="partly-named" if named else "unnamed")


@dataclass(frozen=True)
class _Answer:
    """What is said of the models so far; ``held_out`` compares them, where that was done."""

    verdict: str
    baseline: Fit
    extended: Fit
    equivalents: dict[str, list[str]]
    asked: list[Share]
    refuted: tuple[Share, ...]
    given_up: tuple[str, ...]
    held_out: GapComparison | None
    kind: str = ""
    kind_leaves: float = math.inf

    @property
    def left(self) -> tuple[float, float]:
        """Force [N] that baseline and model leave, of the confirming data where they were compared there."""
        if self.held_out is None:
            return force_rms(self.baseline), force_rms(self.extended)
        return self.held_out.gap.baseline, self.held_out.gap.extended


def validate(outcome: Outcome, progress: Progress) -> Validation:
    """Refit the search's best model on everything, open the confirming data, and reach a verdict.

    A search that ended early for an unknown force is gone on with where those data do not confirm the force, or with it
    no effect that could be named.
    """
    calibration = outcome.calibration
    problem, data = calibration.baseline.problem, calibration.preparation.held_out
    force = None
    if data is not None:
        data = data.with_whitening(problem.whitening)
        force = found_beside_kind(outcome, data)
    if outcome.ended_early and (force is None or not force.is_an_answer):
        outcome = replace(finished(outcome, progress), of_a_kind=None)
    start = fit(calibration.baseline, part="used")
    searched = calibration.judge.refitted(outcome.best) if len(outcome.path) > 1 else start
    answer, share, left_over = _all_or_nothing(outcome, data, start, searched, force)
    if left_over or outcome.ended_early:
        answer = _effect_by_effect(outcome, data, searched, answer, force)
    in_free_run = _refuted_in_free_run(start, answer)
    if in_free_run is not None:
        answer = replace(answer, verdict="unnamed", given_up=answer.extended.model.names)
    if answer.verdict == "unnamed":
        estimate = robust(answer.baseline)
        answer = replace(answer, baseline=estimate, extended=estimate, asked=[], held_out=None)
    baseline, extended, held_out = _alone(answer.baseline), centred(answer.extended), answer.held_out
    if data is not None and (held_out is None or baseline is not answer.baseline or extended is not answer.extended):
        held_out = compare_on(data, baseline.model, extended.model)
    return Validation(
        outcome=outcome,
        verdict=answer.verdict,
        baseline=baseline,
        extended=extended,
        equivalents=answer.equivalents,
        train=compare(problem, baseline.model, extended.model),
        held_out=held_out,
        confirmed={one.name: one.confirmed for one in answer.asked},
        refuted=answer.refuted,
        given_up=answer.given_up,
        share=share,
        kind=answer.kind,
        kind_leaves=answer.kind_leaves,
        in_free_run=in_free_run,
    )


def _refuted_in_free_run(start: Fit, answer: _Answer) -> tuple[float, float] | None:
    """Velocity errors [m/s] of the baseline and the extended model driven by the command alone, where those refute it.

    A model that is made to follow its record is judged by the force that takes, and an effect can take the place of
    another in that force alone: a dead zone that of a load on a spring. Moving freely it leads elsewhere. Both by least
    squares, ``start`` the baseline. What the sensor adds moves nothing, and a motion without bound tells nothing.
    """
    effects = answer.extended.model.effects
    if not answer.extended.problem.follows or answer.verdict == "unnamed" or not effects:
        return None
    if all(effect.channel == "sensor" for effect in effects):
        return None
    with suppress(SimulationError):
        before, after = start.free_run_error(), fit(answer.extended, "used").free_run_error()
        return (before, after) if after > rules.FREE_RUN * before else None
    return None


def _all_or_nothing(
    outcome: Outcome, data: HeldOut | None, start: Fit, searched: Fit, force: BesideUnknown | None
) -> tuple[_Answer, float, bool]:
    """The verdict on all effects of ``searched`` together, less what the confirming ``data`` refute.

    ``start`` is the baseline. Also returns the share of the gap that is closed, and whether so much is left over, or
    explained by an unknown ``force``, that each effect should stand on its own evidence.
    """
    calibration, extended = outcome.calibration, searched
    judge, floor, lost = calibration.judge, calibration.floor.force, 0.0
    asked: list[Share] = []
    refuted: tuple[Share, ...] = ()
    if data is not None:
        learnt = start.cost - extended.cost
        extended, asked, refuted = confirm(judge, data, extended)
        lost = 1 - (start.cost - extended.cost) / learnt if refuted else 0.0

    # What the plant's effects explain, beside a disturbance of the controller that is known from its law.
    named = extended.model.names != start.model.names
    left = [force_rms(extended)]
    shares = [explained(force_rms(start), left[0], floor)]
    held_out = None if data is None else compare_on(data, start.model, extended.model)
    if held_out is not None:
        left.append(min(held_out.left, held_out.gap.extended))
        shares.append(explained(held_out.gap.baseline, left[-1], floor))
    found = {n: others for n, others in equivalents(outcome).items() if n in extended.model.names}
    verdict = _verdict(judge, extended, start, found, shares[-1], max(left))
    # A gap closed on its own record only was not understood; nor was one of which a good part was refuted.
    forgotten = named and shares[-1] < rules.HELD * min(shares[0], 1.0)  # all of it, where less than noise is left
    doubtful = lost > rules.LOST and not judge.at_floor(extended)
    nothing_yet = outcome.interrupted and not extended.model.names
    if nothing_yet or forgotten or doubtful:
        verdict = "unnamed"
    if calibration.preparation.unexplained_law:  # known as a command, but not what it is
        verdict = "partly-named" if verdict in ("named", "ambiguous") else "unnamed"
    failed = verdict == "unnamed" and not judge.at_floor(extended)
    open_gap = judge.leaves_unexplained(extended) and (
        min(shares) < rules.COMPLETE or _explains(force, max(left), floor)
    )
    given_up = extended.model.names if verdict == "unnamed" and named else ()
    answer = _Answer(verdict, start, extended, found, asked, refuted, given_up, held_out)
    return answer, shares[-1], (failed or forgotten or open_gap) and not nothing_yet


def _explains(force: BesideUnknown | None, left: float, floor: float) -> bool:
    """Whether an unknown ``force``, and the effects to name beside it, explain a good part of what is ``left`` [N]."""
    return force is not None and bool(force.names) and explained(left, force.left, floor) >= rules.OF_A_KIND


def _effect_by_effect(
    outcome: Outcome, data: HeldOut | None, searched: Fit, answer: _Answer, force: BesideUnknown | None
) -> _Answer:
    """What stands on its own evidence: all or nothing is the wrong question where structure is left.

    Beside an unknown ``force`` of one kind, where that and few effects leave next to nothing of the confirming ``data``
    too; where none is needed, nothing is said. Else of ``searched``, with what stands beside any function of the state,
    and only what leaves less of those data than its baseline.
    """
    if data is not None and force is not None and force.is_an_answer:
        nothing = _Answer("partly-named", answer.baseline, answer.baseline, {}, [], (), (), None)
        answers = [_with(force, nothing, answer.baseline, data)] if force.names else []
    else:
        answers = _beside_anything(outcome, data, searched, answer)
    compared = [_compared(one, data) for one in answers if _sayable(one)]
    tenable = [one for one in compared if one.kind or one.left[1] < one.left[0]]
    if tenable:
        return min(tenable, key=lambda one: one.left[1])
    given_up = answer.given_up or answer.extended.model.names
    floor, missed = outcome.calibration.floor.force, max(force_rms(answer.baseline), answer.left[0])
    if force is not None and explained(missed, force.left, floor) >= rules.OF_A_KIND:
        answer = replace(answer, kind=force.kind, kind_leaves=force.left)
    return replace(answer, verdict="unnamed", equivalents=answers[-1].equivalents if answers else {}, given_up=given_up)


def _beside_anything(outcome: Outcome, data: HeldOut | None, searched: Fit, answer: _Answer) -> list[_Answer]:
    """What of ``searched`` stands on its own evidence, and the same with what is found beside the state."""
    by_itself = partial(_by_itself, outcome, data, searched, answer)
    if data is None:
        return [by_itself()]
    # The longest first, as this thread hears an interrupt: that ends the search only.
    beside, own = side_by_side(
        lambda find: find(), [(find,) for find in (partial(found_beside_state, outcome, data), by_itself)]
    )
    return [own] if beside is None else [_with(beside, own, answer.baseline, data), own]


def _by_itself(outcome: Outcome, data: HeldOut | None, searched: Fit, answer: _Answer) -> _Answer:
    """``answer`` with those effects of ``searched`` that stand on their own evidence."""
    stands, withdrawn = standing(data, searched)
    asked = [] if data is None else claims_on(data, stands)
    return _Answer(
        "partly-named", robust(answer.baseline), stands, alike_in_company(outcome, stands), asked, withdrawn, (), None
    )


def _with(beside: BesideUnknown, answer: _Answer, baseline: Fit, data: HeldOut) -> _Answer:
    """``answer`` with what was found ``beside`` an unknown force in the place of what it has of the same name."""
    both, asked = joined(answer.extended, beside, data)
    own = [name for name in both.model.names if name not in beside.names]
    return replace(
        answer,
        baseline=baseline,
        extended=both,
        kind=beside.kind,
        kind_leaves=beside.left,
        equivalents={name: answer.equivalents.get(name, []) for name in own} | beside.equivalents,
        asked=asked + beside.asked,
        refuted=tuple(one for one in answer.refuted if one.name not in beside.names),
    )


def _sayable(answer: _Answer) -> bool:
    """Whether ``answer`` names anything, and few enough others could be meant."""
    many = any(len(others) > rules.MOST_EQUIVALENTS for others in answer.equivalents.values())
    return len(answer.extended.model.names) > len(answer.baseline.model.names) and not many


def _compared(answer: _Answer, data: HeldOut | None) -> _Answer:
    """``answer`` with its models compared on the confirming ``data``, where there are any."""
    if data is None:
        return answer
    return replace(answer, held_out=compare_on(data, answer.baseline.model, answer.extended.model))


def _alone(start: Fit) -> Fit:
    """The baseline without the controller's disturbance, which the search took as known from the law."""
    if not start.model.names:
        return start
    return evaluate(start.with_model(replace(start.model, effects=(), values=())), start.slots, start.covariance)


def _verdict(judge: Judge, best: Fit, known: Fit, equivalents: dict[str, list[str]], share: float, left: float) -> str:
    """The verdict on ``best``, which explains ``share`` of the force gap; ``known`` is what the search began with.

    Where the model leaves structure, what was found stands only if it explains most of the gap. Nothing is missing only
    where all of the record and the confirming data say so, of which ``left`` [N] is the rms left of the worse one.
    """
    if best.model.names == known.model.names:
        if judge.leaves_structure(best):
            return "unnamed"
        if not best.model.names:
            if left > rules.QUIET * judge.floor.force:
                return "unnamed"
            return "parameters-only" if wrong_numbers(best) else "nothing-missing"
    elif not judge.at_floor(best) and share < rules.EXPLAINED:
        return "unnamed"
    if any(len(names) > rules.MOST_EQUIVALENTS for names in equivalents.values()):
        return "unnamed"
    return "ambiguous" if any(equivalents.values()) else "named"


def wrong_numbers(fitted: Fit) -> list[int]:
    """Places in the baseline at which the axis file is off: clearly, and by more than next to nothing."""
    off = fitted.model.baseline - fitted.problem.axis.mechanics.array()
    return [
        slot.place
        for slot in fitted.slots
        if slot.effect < 0
        and abs(off[slot.place]) > rules.OFF_SURELY * fitted.std(-1, slot.place)
        and abs(off[slot.place]) > rules.OFF * slot.magnitude
    ]
