"""The third stage: which effects to try together, the best few sets of them extended again and again.

A beam search over sets of effects. Each round adds every effect to the best few models so far, refits everything, and
keeps the best few sets: pairs in which neither effect stands out alone are found because a round starts from several
first guesses. An effect that is a curve of any shape could stand in for others, and waits until none of them is found.

What adding one effect after the other cannot do: another effect, or another shape, in the place of one found.

What was found first was fitted while the rest was missing, and may stand in for part of it: a lag for a delay, a
resonance at the frequency that made up best for a friction not known yet. Beside the others its own residual is clear.

What was accepted first may be a stand-in for what was found after it: a model without what it no longer needs.

Searches beside an unknown force: of one kind, or any function of the state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import Accept
from emps_design.discrepancy.calibration import Calibration, FitsBySet, OfAKind, Outcome, calibrate, set_of
from emps_design.discrepancy.extension import converged, extended, extensions, freed
from emps_design.discrepancy.fit import Fit, admissible, bounded_cost, evaluate, fit, play_anew
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.starts import either_baseline, tangent
from emps_design.discrepancy.unknown_force import KINDS, Kind, beside_kind, with_kind
from emps_design.effects import Effect
from emps_design.effects.two_mass import has_play
from emps_design.errors import SimulationError
from emps_design.progress import Progress, no_progress

BEAM = (3, 2, 1)  # sets kept after the first round, the second, and any later one
A_FEW = len(BEAM)  # effects after which the search goes on from one set only
MOST_EFFECTS = 7
PASSES = 5  # times the search goes on, from an exchange, an effect that was far behind, or a curve
UNFINISHED = "interrupted: the search was not finished, what follows is what was known by then"

Step = tuple[frozenset[str], frozenset[str]]  # from the effects of one model to those of another

STARTS = 2  # models of the path beside which a kind of force is looked for
IN_TURN = 3  # times that a force in the loop and the numbers beside it are fitted


def exchanges(best: Fit, known: tuple[str, ...], library: tuple[Effect, ...]) -> list[Fit]:
    """Models with what is easily confused with an effect of ``best``, or that effect anew, in its place.

    ``known`` effects stay. The others keep their numbers until everything is fitted; so does the baseline, but where a
    stand-in may have bent it the axis file's numbers are tried as well.
    """
    places: list[tuple[Hypothesis, Effect]] = []
    for index, effect in enumerate(best.model.effects):
        if effect.name in known:
            continue
        places += [(rest, effect) for rest in either_baseline(best.with_model(best.model.without(index)))]

    def instead(rest: Hypothesis, effect: Effect) -> list[Fit]:
        without = evaluate(rest)
        if not without.innovations:
            return []
        alike = tuple(one for one in library if not one.general and (one is effect or one.confusable(effect)))
        return extended(without, alike)[0]

    return [fitted for fits in side_by_side(instead, places) for fitted in fits if admissible(fitted)]


def pruned(best: Fit, known: tuple[str, ...], tried: FitsBySet, accept: Accept) -> list[Fit]:
    """``best`` without one effect after the other that is no finding beside the rest, ``known`` ones kept.

    The rest may have been ``tried`` before, and have found a better place than the one it is left in.
    """
    path: list[Fit] = []
    while len(best.model.effects) > len(known) + 1:
        smaller = [best.model.without(i) for i, name in enumerate(best.model.names) if name not in known]
        # With as much care as the best one was fitted, or every effect would look needed.
        careful = len(best.model.effects) <= rules.CREDIBLE
        rests = side_by_side(_fitted_anew if careful else fit, [(best.with_model(model),) for model in smaller])
        sound = [_better(rest, tried) for rest in rests if admissible(rest)]
        idle = [rest for rest in sound if not accept(best, rest)]
        if not idle and sound:
            cheapest = _reshaped(best, min(sound, key=lambda f: f.cost))
            idle = [] if accept(best, cheapest) else [cheapest]
        if not idle:
            break
        best = converged(min(idle, key=lambda f: f.cost))
        path.append(best)
    return path


def _fitted_anew(hypothesis: Hypothesis) -> Fit:
    """Fit a model, and play in it anew."""
    return play_anew(fit(hypothesis))


def _better(fitted: Fit, tried: FitsBySet) -> Fit:
    """``fitted``, or what was ``tried`` with the same effects where that leaves less."""
    return min((fitted, tried.get(set_of(fitted), fitted)), key=lambda f: f.cost)


def _reshaped(best: Fit, rest: Fit) -> Fit:
    """``rest`` with what is easily confused with the effect of ``best`` it lacks fitted anew, other shapes tried.

    Beside that effect it had only a part to play, and its shape may be that of the part.
    """
    dropped = next(effect for effect in best.model.effects if effect.name not in rest.model.names)
    for effect, values in zip(rest.model.effects, rest.model.values, strict=True):
        if effect.confusable(dropped):
            last = rest.model.without_named([effect.name]).with_effect(effect, values)
            again = converged(fit(rest.with_model(last)))
            rest = min((rest, again), key=lambda f: f.cost) if admissible(again) else rest
    return rest


def begun(calibration: Calibration, progress: Progress, most: int, before: Outcome | None = None) -> Outcome:
    """Extend the baseline of ``calibration`` up to ``most`` effects, while its judge accepts the best admissible one.

    After a search ``before``, under other noise, its model is extended instead, where that is accepted. What was found
    so :func:`finished` may still change. An interrupt from the keyboard ends either where it is.
    """
    baseline = calibration.baseline
    outcome = Outcome(calibration, (baseline,), {set_of(baseline): baseline}, {}, warnings=calibration.warnings)

    def extend(path: list[Fit]) -> None:
        if before is not None and before.best.model.names != baseline.model.names:
            _remember(outcome.tried, _fitted_again(baseline, before))
            again = outcome.tried.get(set_of(before.best))
            if again is not None and calibration.judge.accepts(again, baseline):
                outcome.alone.update({found[0].model.names[-1]: found[0].gain for found in calibration.screened})
                path.append(again)
        _extend(outcome, path, progress, most)

    return until_interrupted(outcome, extend)


def _fitted_again(baseline: Fit, before: Outcome) -> list[Fit]:
    """What a search ``before`` found, and what it tried next to that, fitted under the noise of ``baseline``.

    Next to it are the models on the way, each effect alone, and another effect in the place of one.
    """
    names, first = set_of(before.best), len(set_of(baseline))
    near = [
        fitted
        for key, fitted in before.tried.items()
        if len(key) == first + 1 or key < names or (len(key) == len(names) == len(key & names) + 1)
    ]
    best = converged(fit(baseline.with_model(before.best.model)))
    return [best, *filter(admissible, side_by_side(fit, [(baseline.with_model(one.model),) for one in near]))]


def finished(outcome: Outcome, progress: Progress, most: int = MOST_EFFECTS) -> Outcome:
    """A search that was :func:`begun`, gone on with up to ``most`` effects until nothing is accepted any more."""
    if outcome.interrupted:
        return outcome

    def to_the_end(path: list[Fit]) -> None:
        if _found(outcome.calibration, path[-1]) >= A_FEW:
            _extend(outcome, path, progress, most)
        _go_on(outcome, path, progress, most)
        path[-1] = freed(path[-1])
        _remember(outcome.tried, _rivals(path, outcome.tried))

    return until_interrupted(outcome, to_the_end)


def with_before(outcome: Outcome, before: Candidate | None) -> Outcome:
    """``outcome`` gone back to the model found ``before``, under other noise, where that leaves less."""
    better = _found_before(before, outcome.best, outcome.tried)
    return outcome if better is None else replace(outcome, path=(*outcome.path, better))


def until_interrupted(outcome: Outcome, goes_on: Callable[[list[Fit]], None]) -> Outcome:
    """``outcome`` with its path as far as ``goes_on`` took it before an interrupt from the keyboard."""
    path, warnings, interrupted = list(outcome.path), outcome.warnings, False
    try:
        goes_on(path)
    except KeyboardInterrupt:
        warnings, interrupted = (*warnings, UNFINISHED), True
    return replace(outcome, path=tuple(path), warnings=warnings, interrupted=interrupted)


def _go_on(outcome: Outcome, path: list[Fit], progress: Progress, most: int) -> None:
    """Prune the last model of ``path``, exchange its effects and extend it again, until nothing leaves less."""
    calibration, tried = outcome.calibration, outcome.tried
    known, accepts = calibration.baseline.model.names, calibration.judge.accepts
    gone_on: dict[Step, float] = {}  # from one set to another, and its cost there
    for _ in range(PASSES):
        path += pruned(path[-1], known, tried, accepts)
        better = (
            _exchanged(calibration, path[-1], tried, progress)
            or _pair(calibration, path[-1], tried, progress)
            or _far_behind(calibration, path[-1], tried, progress)
            or _curve(calibration, path[-1], tried, progress, most)
        )
        if better is None or not _pays_again(better, (set_of(path[-1]), set_of(better)), gone_on):
            break
        path.append(better)
        _extend(outcome, path, progress, most)
    else:
        path += pruned(path[-1], known, tried, accepts)


def _extend(outcome: Outcome, path: list[Fit], progress: Progress, most: int) -> None:
    """Add up to ``most`` effects to the last model of ``path`` while one is accepted.

    What was fitted on the way is added to ``tried``, what each effect gained in the very first round to ``alone``.
    """
    calibration, tried, beam = outcome.calibration, outcome.tried, path[-1:]
    baseline, accept = calibration.baseline, calibration.judge.accepts
    noise, library = baseline.problem.samples("used"), _library(calibration, general=False)
    if not _found(calibration, path[-1]):
        beam = [*beam, *_as_given(path[-1])]
    while (number := 1 + _found(calibration, path[-1])) <= most:
        explained = baseline.cost - path[-1].cost
        if number > rules.ENOUGH_ROUNDS and explained < rules.LEAST_EXPLAINED * (baseline.cost - noise):
            break
        sound, gains = _round(calibration, beam, number, library, progress)
        if not outcome.alone:
            outcome.alone.update(gains)
        _remember(tried, sound.values())
        ranked = _ranked(path[-1], sound, accept)
        if not ranked:
            break
        gain = baseline.cost - ranked[0].cost
        others = ranked[1 : BEAM[min(number, len(BEAM)) - 1]]
        # The best is kept even where it leaves more bursts than the baseline, which hardly count in what is accepted.
        leading = [ranked[0], *(f for f in others if baseline.cost - f.cost >= rules.RIVAL * gain)]
        beam = sorted(side_by_side(converged, [(f,) for f in leading]), key=lambda f: f.criterion)
        _remember(tried, beam)
        path.append(beam[0])
        if (1 - rules.WORTH_AT_FLOOR) * beam[0].cost < noise:
            beam = beam[:1]  # what is to be found on top of another set would have to leave less than noise


def _as_given(fitted: Fit) -> list[Fit]:
    """The baseline ``fitted`` with the axis file's numbers, where what is missing may have bent the fitted ones."""
    return [given for given in map(evaluate, either_baseline(fitted)[1:]) if given.innovations]


def _found_before(before: Candidate | None, current: Fit, tried: FitsBySet) -> Fit | None:
    """The model found ``before``, fitted under this noise, where it leaves less than ``current``."""
    if before is None or before.names in ((), current.model.names):
        return None
    found = converged(fit(current.with_model(before)))
    if not admissible(found):
        return None
    _remember(tried, [found])
    return found if found.cost < (1 - rules.STILL_PAYS) * current.cost else None


def _far_behind(calibration: Calibration, current: Fit, tried: FitsBySet, progress: Progress) -> Fit | None:
    """``current`` with an effect that gains little beside the best ones, which may be stand-ins: none was accepted."""
    number, names = 1 + _found(calibration, current), set_of(current)
    if number > rules.CREDIBLE or not calibration.judge.leaves_structure(current):
        return None
    rest = tuple(one for one in _library(calibration, general=False) if names | {one.name} not in tried)
    sound, _ = _round(calibration, [current], number, rest, progress, rules.FAR_BEHIND)
    _remember(tried, sound.values())
    return _best_accepted(calibration, current, sound)


def _curve(calibration: Calibration, current: Fit, tried: FitsBySet, progress: Progress, most: int) -> Fit | None:
    """``current`` with a curve of any shape, which no single effect of the library explains, where that is accepted."""
    number = 1 + _found(calibration, current)
    if number > most:
        return None
    sound, _ = _round(calibration, [current], number, _library(calibration, general=True), progress)
    _remember(tried, sound.values())
    return _best_accepted(calibration, current, sound)


def _pair(calibration: Calibration, current: Fit, tried: FitsBySet, progress: Progress) -> Fit | None:
    """The baseline with two effects, where nothing was found and that is accepted.

    From the best few that gain what a finding must be worth: beside much that is missing it is not seen everywhere.
    """
    judge, names = calibration.judge, set_of(current)
    if _found(calibration, current) or not judge.leaves_structure(current):
        return None
    worth = max(judge.healthy.threshold, rules.WORTH * current.cost)
    alone = [f for key, f in tried.items() if len(key) == len(names) + 1 and not f.model.effects[-1].general]
    begun = sorted((f for f in alone if current.cost - f.cost > worth), key=lambda f: f.cost)[: BEAM[0]]
    if not begun:
        return None
    pairs, _ = _round(calibration, begun, 2, _library(calibration, general=False), progress)
    _remember(tried, pairs.values())
    return _best_accepted(calibration, current, pairs)


def _best_accepted(calibration: Calibration, current: Fit, sound: FitsBySet) -> Fit | None:
    return next((converged(best) for best in _ranked(current, sound, calibration.judge.accepts)), None)


def _library(calibration: Calibration, *, general: bool) -> tuple[Effect, ...]:
    """The effects to look for: the curves of any shape, or all others."""
    return tuple(effect for effect in calibration.preparation.library if effect.general is general)


def _found(calibration: Calibration, fitted: Fit) -> int:
    """How many effects ``fitted`` has beside what is known from the controller's law."""
    return len(fitted.model.effects) - len(calibration.baseline.model.effects)


def _exchanged(calibration: Calibration, best: Fit, tried: FitsBySet, progress: Progress) -> Fit | None:
    """``best`` with another effect, or another shape, in the place of one, where that leaves clearly less.

    Looked for in company only, where what was found first was fitted while the rest was missing; of two effects only
    where structure is left.
    """
    known, judge, found = calibration.baseline.model.names, calibration.judge, _found(calibration, best)
    if not 2 <= found <= rules.CREDIBLE or (found == 2 and judge.at_floor(best)):
        return None
    progress("each effect anew beside the others", 0.95)
    others = exchanges(best, known, calibration.preparation.library)
    _remember(tried, others)
    # Beside play that bounces, the bursts of a few impacts are as large as what another effect would be worth.
    cost = bounded_cost if any(map(has_play, best.model.effects)) else lambda f: f.cost
    least = min(others, key=cost, default=best)
    pays = cost(best) - cost(least) > max(judge.healthy.threshold, rules.STILL_PAYS * cost(best))
    return converged(least) if pays else None


def _pays_again(better: Fit, step: Step, gone_on: dict[Step, float]) -> bool:
    """Whether to go on by a ``step`` from one set to another: the same one twice only if ``better`` leaves less now."""
    pays = better.cost < (1 - rules.STILL_PAYS) * gone_on.get(step, math.inf)
    if pays:
        gone_on[step] = better.cost
    return pays


def _remember(tried: FitsBySet, fits: Iterable[Fit]) -> None:
    """Keep in ``tried`` the best fit of each set."""
    for fitted in fits:
        key = set_of(fitted)
        if key not in tried or fitted.cost < tried[key].cost:
            tried[key] = fitted


def _round(
    calibration: Calibration,
    beam: list[Fit],
    number: int,
    library: tuple[Effect, ...],
    progress: Progress,
    rival: float = rules.RIVAL,
) -> tuple[FitsBySet, dict[str, float]]:
    """The best admissible fit of each set that has one effect of ``library`` more than a set of ``beam``.

    Of those whose short fit gains ``rival`` of what the best one gains. Also returns what each
    effect gained alone on top of the first of them [whitened cost].
    """
    names = " + ".join(beam[0].model.names) or "the baseline"
    curves = ", as a curve" if any(effect.general for effect in library) else ""
    progress(f"round {number}: {names}, and what else{curves}", 1 - 0.9 * 0.75 ** (number - 1))

    def tries(member: Fit) -> tuple[list[Fit], dict[str, float]]:
        if member is not calibration.baseline:
            return extended(member, library, rival)
        screened = [found for found in calibration.screened if found[0].model.effects[-1] in library]
        return extensions(member, screened, tangent(member), rival)

    found = side_by_side(tries, [(member,) for member in beam])
    pool: FitsBySet = {}
    _remember(pool, (one for fits, _ in found for one in fits))
    alone: dict[str, float] = next((gains for _, gains in found if gains), {})
    return {key: fitted for key, fitted in pool.items() if admissible(fitted)}, alone


def _ranked(current: Fit, sound: FitsBySet, accept: Accept) -> list[Fit]:
    """Those of ``sound`` that are accepted, best first."""
    ranked = [f for f in sorted(sound.values(), key=lambda f: f.criterion) if accept(f, current)]
    return ranked or _late(current, sound, accept)


def _late(current: Fit, sound: FitsBySet, accept: Accept) -> list[Fit]:
    """The best of ``sound``, if it is accepted once it has converged: an instant may have been a stroke off."""
    best = min(sound.values(), key=lambda f: f.cost, default=None)
    left = current.cost - current.problem.samples("used")
    if best is None or left <= 0 or current.cost - best.cost < rules.RIVAL * left:
        return []
    further = converged(best)
    return [further] if accept(further, current) else []


def _rivals(path: list[Fit], tried: FitsBySet) -> list[Fit]:
    """Models with another effect in the place of one of the best model's that come close, fitted to convergence too.

    Else the effect found first would win by having been fitted longer.
    """
    best, names = path[-1], set_of(path[-1])
    close = []
    for name in names - set(path[0].model.names):
        others = names - {name}
        without = tried.get(others, path[0]).cost
        least = rules.CLOSE_RIVAL * (without - best.cost)
        alike = [rival for key, rival in tried.items() if len(key) == len(names) and others < key != names]
        close += [(rival,) for rival in alike if without - rival.cost >= least]
    return side_by_side(converged, close)


def search_or_kind(calibration: Calibration, progress: Progress, before: Outcome | None = None) -> Outcome:
    """A search, stopped at an unknown force of one kind that explains what a few effects leave.

    What a search found ``before``, under other noise, is tried as well, beside such a force too.

    Looked for where there are data to confirm it, beside the baseline and beside the effect found first: a motor at its
    limit, or a stop, hides of which kind the rest is.
    """
    outcome, found = begun(calibration, progress, A_FEW, before), list[OfAKind]()

    def look(path: list[Fit]) -> None:
        progress("whether it is an unknown force of one kind", 0.6)
        found.extend(_of_a_kind(calibration, path, before.of_a_kind if before else None))

    confirmed = calibration.preparation.held_out is not None
    if confirmed and not outcome.interrupted and calibration.judge.leaves_structure(outcome.best):
        outcome = replace(until_interrupted(outcome, look), of_a_kind=found[0] if found else None)
    return finished(outcome, progress) if outcome.of_a_kind is None else outcome


def past_the_kind(outcome: Outcome, progress: Progress) -> Outcome:
    """A search that was stopped at an unknown force, gone on with unless the force is plain: that ends it early."""
    return finished(outcome, progress) if outcome.stopped else outcome


def search_beside(calibration: Calibration, start: Hypothesis) -> Outcome:
    """Search again from ``start``, the baseline of ``calibration`` where an unknown force explains nothing.

    As any smooth function of the state it could follow most friction too; what happens at an instant, drifts, delays or
    repeats along the travel it cannot. A curve of any shape is one of them, and is not looked for.
    """
    return _finished_beside(_begun_beside(calibration, start))


def _begun_beside(calibration: Calibration, start: Hypothesis) -> Outcome:
    """The search beside an unknown force up to as many effects as it takes pains with."""
    first = calibration.preparation
    library = tuple(effect for effect in first.library if not effect.general and not effect.element)
    preparation = replace(first, start=start, library=library)
    return begun(calibrate(preparation, start, calibration.floor, 0, 0, no_progress), no_progress, rules.CREDIBLE)


def _finished_beside(outcome: Outcome) -> Outcome:
    """The search beside an unknown force to its end: more effects than it takes pains with would stand in for it."""
    return finished(outcome, no_progress, most=rules.CREDIBLE)


def _of_a_kind(calibration: Calibration, path: list[Fit], before: OfAKind | None) -> list[OfAKind]:
    """The first kind of force that leaves next to nothing beside a start of ``path`` and what is found beside it.

    Or what was found beside one ``before``, where that leaves less. Else nothing, and nothing either where the effects
    of ``path`` alone leave less; a search that leaves structure beside the force is not gone on with. An interrupt goes
    on to the search that asks.
    """
    for kind, start, beside in _kinds_beside(path[:STARTS]):
        with suppress(SimulationError):
            problem = in_turn(beside, kind)[-1].problem
            again = _begun_beside(calibration, Hypothesis(problem, calibration.baseline.model))
            if before is not None and not again.interrupted:
                again = with_before(again, before.found.model)
            if not again.calibration.judge.leaves_structure(again.best):
                again = _finished_beside(again)
            if again.interrupted:
                raise KeyboardInterrupt
            found = in_turn(again.calibration.judge.refitted(again.best), kind)[-1]
            if next_to_nothing(start, found) and found.excess() < path[-1].excess():
                return [OfAKind(kind, start, again, found)]
    return []


def in_turn(fitted: Fit, kind: Kind) -> list[Fit]:
    """Fits of the model of ``fitted`` to all that may be used, each with the force in the loop that the last one left.

    Raises :class:`SimulationError` where the model does not run with it.
    """
    fits = []
    for _ in range(IN_TURN):
        fitted = fit(with_kind(fitted, kind), "used")
        fits.append(fitted)
    return fits


def acting(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """``hypothesis`` with an unknown force in the loop, found again with that. Raises as :func:`in_turn`."""
    for _ in range(IN_TURN):
        hypothesis = with_kind(hypothesis, kind)
    return hypothesis


def next_to_nothing(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether ``after`` leaves nothing but noise, or next to nothing of the gap of ``before``."""
    return only_noise(after, rules.STRUCTURED) or after.excess() <= (1.0 - rules.COMPLETE) * before.excess()


def only_noise(hypothesis: Hypothesis, most: float) -> bool:
    """Whether ``hypothesis`` leaves no more than ``most`` times the whitened cost of noise."""
    return hypothesis.excess() <= (most - 1.0) * hypothesis.problem.samples("used")


def _kinds_beside(starts: list[Fit]) -> list[tuple[Kind, Fit, Fit]]:
    """The kinds of force that are a good part of what one of ``starts`` leaves, that start, and the fit beside them.

    The one that leaves least first, after those that are part of it; beside a later start only what leaves clearly less
    than all others, as it may itself stand in for the force.
    """
    found = []
    for place, start in enumerate(starts):
        for related in KINDS:
            fits = [(kind, start, one) for degrees in related for kind, one in _of_few_columns(start, degrees)]
            good = [one for one in fits if one[-1].excess() <= (1.0 - rules.OF_A_KIND) * start.excess()]
            if good:
                found.append((min(one.cost for *_, one in good) / rules.SHARPER**place, good))
    return [one for _, good in sorted(found, key=lambda ranked: ranked[0]) for one in good]


def _of_few_columns(start: Fit, degrees: tuple[Kind, ...]) -> list[tuple[Kind, Fit]]:
    """The first of ``degrees`` beside which ``start`` runs, and the fit; none where there is none.

    With more columns where these leave clearly less: else they would only take the part of something known.
    """
    fits = [(kind, one) for kind in degrees for one in _fitted_beside(start, kind)]
    best = fits[:1]
    for kind, one in fits[1:]:
        if one.excess() < rules.SHARPER * best[0][1].excess():
            best = [(kind, one)]
    return best


def _fitted_beside(start: Fit, kind: Kind) -> list[Fit]:
    """``start`` fitted beside an unknown force in the loop; nothing where it does not run with one."""
    with suppress(SimulationError):
        return [fit(with_kind(fit(beside_kind(start, kind)), kind))]
    return []
