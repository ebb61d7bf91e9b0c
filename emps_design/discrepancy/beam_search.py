"""The third stage: a beam search over sets of effects.

Each round adds every effect to the best few models so far, refits everything, and keeps the best few sets: starting
from several models finds pairs of effects of which neither stands out alone. A general curve could replace other
effects, and is tried only when none of them is accepted.

Adding effects one after the other is not enough. The first effect was fitted while the rest was missing, and may
compensate for part of it: a lag for a delay, a resonance for an unknown friction. So effects are exchanged once the
others are in the model, and effects that are no longer needed are pruned.

A search may also run beside an unknown force: of one kind, or any smooth function of the state.
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
from emps_design.errors import SimulationError
from emps_design.messages import warning
from emps_design.progress import Progress, no_progress

BEAM = (3, 2, 1)  # sets kept after the first round, the second, and any later one
A_FEW = len(BEAM)  # effects from which on the search keeps one set only
MOST_EFFECTS = 7
PASSES = 5  # times the search continues from an exchange, a pair, a low-ranked effect, or a curve
UNFINISHED = warning(
    "search-interrupted", "interrupted: the search was not finished, what follows is what was known by then"
)

Step = tuple[frozenset[str], frozenset[str]]  # from the effects of one model to those of another

STARTS = 2  # models of the path beside which a kind of force is looked for
IN_TURN = 3  # times that a force in the loop and the numbers beside it are fitted


def exchanges(best: Fit, known: tuple[str, ...], library: tuple[Effect, ...]) -> list[Fit]:
    """Fits of ``best`` with one effect replaced by a confusable one, or by itself from new starts.

    ``known`` effects stay. The other effects start from their numbers, and the baseline does too; where the replaced
    effect may have bent the baseline, the axis file's numbers are tried as well.
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
        alike = tuple(
            other for other in library if not other.search.general and (other is effect or other.confusable(effect))
        )
        return extended(without, alike)[0]

    return [fitted for fits in side_by_side(instead, places) for fitted in fits if admissible(fitted)]


def pruned(best: Fit, known: tuple[str, ...], tried: FitsBySet, accept: Accept) -> list[Fit]:
    """The models of ``best`` with unneeded effects removed one by one, ``known`` ones kept; empty where all are needed.

    The smaller model may have been ``tried`` before with a better fit, which is then taken.
    """
    path: list[Fit] = []
    while len(best.model.effects) > len(known) + 1:
        smaller = [best.model.without(i) for i, name in enumerate(best.model.names) if name not in known]
        # With the same effort as the best model, or every effect would look needed.
        careful = len(best.model.effects) <= rules.CREDIBLE
        refit = (lambda start: play_anew(fit(start))) if careful else fit
        rests = filter(admissible, side_by_side(refit, [(best.with_model(model),) for model in smaller]))
        sound = [min((rest, tried.get(set_of(rest), rest)), key=lambda f: f.cost) for rest in rests]
        idle = [rest for rest in sound if not accept(best, rest)]
        if not idle and sound:
            cheapest = _reshaped(best, min(sound, key=lambda f: f.cost))
            idle = [] if accept(best, cheapest) else [cheapest]
        if not idle:
            break
        best = converged(min(idle, key=lambda f: f.cost))
        path.append(best)
    return path


def _reshaped(best: Fit, rest: Fit) -> Fit:
    """``rest`` with the effects refitted, in other shapes too, that are confusable with the one it lacks of ``best``.

    Beside that effect they explained only a part, and their shapes may fit only that part.
    """
    dropped = next(effect for effect in best.model.effects if effect.name not in rest.model.names)
    for effect, values in zip(rest.model.effects, rest.model.values, strict=True):
        if effect.confusable(dropped):
            last = rest.model.without_named([effect.name]).with_effect(effect, values)
            again = converged(fit(rest.with_model(last)))
            rest = min((rest, again), key=lambda f: f.cost) if admissible(again) else rest
    return rest


def begin_search(calibration: Calibration, progress: Progress, most: int, before: Outcome | None = None) -> Outcome:
    """Extend the baseline of ``calibration`` up to ``most`` effects, while its judge accepts the best admissible one.

    After a search ``before``, under other noise, its model is extended instead, where that is accepted.
    :func:`finish_search` may still change the result. A keyboard interrupt ends both with the models found so far.
    """
    baseline = calibration.baseline
    outcome = Outcome(calibration, (baseline,), {set_of(baseline): baseline}, {}, warnings=calibration.warnings)

    def extend(path: list[Fit]) -> None:
        if before is not None and before.best.model.names != baseline.model.names:
            _remember(outcome.tried, _refit_previous(baseline, before))
            again = outcome.tried.get(set_of(before.best))
            if again is not None and calibration.judge.accepts(again, baseline):
                outcome.alone.update({starts[0].model.names[-1]: starts[0].gain for starts in calibration.screened})
                path.append(again)
        _extend(outcome, path, progress, most)

    return until_interrupted(outcome, extend)


def _refit_previous(baseline: Fit, before: Outcome) -> list[Fit]:
    """Admissible fits of the best model of a search ``before``, and its neighbours, under the noise of ``baseline``.

    Neighbours are the models on the path, each effect alone, and the best model with one effect exchanged.
    """
    names, first = set_of(before.best), len(set_of(baseline))
    near = [
        fitted
        for key, fitted in before.tried.items()
        if key != names and (len(key) == first + 1 or key < names or len(key) == len(names) == len(key & names) + 1)
    ]
    best = converged(fit(baseline.with_model(before.best.model)))
    refits = side_by_side(fit, [(baseline.with_model(fitted.model),) for fitted in near])
    return [fitted for fitted in (best, *refits) if admissible(fitted)]


def finish_search(outcome: Outcome, progress: Progress, most: int = MOST_EFFECTS) -> Outcome:
    """Continue a search of :func:`begin_search`, with up to ``most`` effects, until nothing more is accepted."""
    if outcome.interrupted:
        return outcome

    def to_the_end(path: list[Fit]) -> None:
        if _effect_count(outcome.calibration, path[-1]) >= A_FEW:
            _extend(outcome, path, progress, most)
        _go_on(outcome, path, progress, most)
        path[-1] = freed(path[-1])
        _remember(outcome.tried, _rivals(path, outcome.tried))

    return until_interrupted(outcome, to_the_end)


def with_before(outcome: Outcome, before: Candidate | None) -> Outcome:
    """``outcome`` with the model ``before``, of a search under other noise, as its best where that leaves less."""
    better = _previous_model(before, outcome.best, outcome.tried)
    return outcome if better is None else replace(outcome, path=(*outcome.path, better))


def until_interrupted(outcome: Outcome, goes_on: Callable[[list[Fit]], None]) -> Outcome:
    """``outcome`` with its path as ``goes_on`` extends it, up to a keyboard interrupt."""
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
    step_costs: dict[Step, float] = {}  # cost that each step has led to
    for _ in range(PASSES):
        path += pruned(path[-1], known, tried, accepts)
        better = (
            _exchange(calibration, path[-1], tried, progress)
            or _pair(calibration, path[-1], tried, progress)
            or _far_behind(calibration, path[-1], tried, progress)
            or _curve(calibration, path[-1], tried, progress, most)
        )
        if better is None or not _pays_again(better, (set_of(path[-1]), set_of(better)), step_costs):
            break
        path.append(better)
        _extend(outcome, path, progress, most)
    else:
        path += pruned(path[-1], known, tried, accepts)


def _extend(outcome: Outcome, path: list[Fit], progress: Progress, most: int) -> None:
    """Add up to ``most`` effects to the last model of ``path`` while one is accepted.

    All fits are added to ``tried``, the gain of each effect in the first round to ``alone``.
    """
    calibration, tried, beam = outcome.calibration, outcome.tried, path[-1:]
    baseline, accept = calibration.baseline, calibration.judge.accepts
    noise, library = baseline.problem.samples("used"), shapes(calibration.preparation.library, general=False)
    if not _effect_count(calibration, path[-1]):
        # Missing physics may have bent the fitted baseline: the axis file's is extended as well.
        alternatives = map(evaluate, either_baseline(path[-1])[1:])
        beam += [alternative for alternative in alternatives if alternative.innovations]
    while (number := 1 + _effect_count(calibration, path[-1])) <= most:
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
        # The best is kept even where it leaves more bursts than the baseline: acceptance hardly counts bursts.
        leading = [ranked[0], *(f for f in others if baseline.cost - f.cost >= rules.RIVAL * gain)]
        beam = sorted(side_by_side(converged, [(f,) for f in leading]), key=lambda f: f.criterion)
        _remember(tried, beam)
        path.append(beam[0])
        if (1 - rules.WORTH_AT_FLOOR) * beam[0].cost < noise:
            beam = beam[:1]  # an effect added to another set would have to leave less than noise


def _previous_model(before: Candidate | None, current: Fit, tried: FitsBySet) -> Fit | None:
    """The model ``before`` fitted under this noise, where it leaves less than ``current``; else None."""
    if before is None or before.names in ((), current.model.names):
        return None
    refit = converged(fit(current.with_model(before)))
    if not admissible(refit):
        return None
    _remember(tried, [refit])
    return refit if refit.cost < (1 - rules.STILL_PAYS) * current.cost else None


def _far_behind(calibration: Calibration, current: Fit, tried: FitsBySet, progress: Progress) -> Fit | None:
    """``current`` with a low-ranked effect: where none of the best is accepted, those may compensate for others."""
    number, names = 1 + _effect_count(calibration, current), set_of(current)
    if number > rules.CREDIBLE or not calibration.judge.leaves_structure(current):
        return None
    specific = shapes(calibration.preparation.library, general=False)
    rest = tuple(effect for effect in specific if names | {effect.name} not in tried)
    sound, _ = _round(calibration, [current], number, rest, progress, rules.FAR_BEHIND)
    _remember(tried, sound.values())
    return _best_accepted(calibration, current, sound)


def _curve(calibration: Calibration, current: Fit, tried: FitsBySet, progress: Progress, most: int) -> Fit | None:
    """``current`` with a general curve, where that is accepted; else None."""
    number = 1 + _effect_count(calibration, current)
    if number > most:
        return None
    sound, _ = _round(calibration, [current], number, shapes(calibration.preparation.library, general=True), progress)
    _remember(tried, sound.values())
    return _best_accepted(calibration, current, sound)


def _pair(calibration: Calibration, current: Fit, tried: FitsBySet, progress: Progress) -> Fit | None:
    """The baseline with two effects, where no single one was accepted and the pair is; else None.

    Starts from the best few single effects with enough gain: an effect may show on too few strokes while another is
    missing.
    """
    judge, names = calibration.judge, set_of(current)
    if _effect_count(calibration, current) or not judge.leaves_structure(current):
        return None
    worth = max(judge.healthy.threshold, rules.WORTH * current.cost)
    alone = [f for key, f in tried.items() if len(key) == len(names) + 1 and not f.model.effects[-1].search.general]
    leading = sorted((f for f in alone if current.cost - f.cost > worth), key=lambda f: f.cost)[: BEAM[0]]
    if not leading:
        return None
    pairs, _ = _round(calibration, leading, 2, shapes(calibration.preparation.library, general=False), progress)
    _remember(tried, pairs.values())
    return _best_accepted(calibration, current, pairs)


def _best_accepted(calibration: Calibration, current: Fit, sound: FitsBySet) -> Fit | None:
    return next((converged(best) for best in _ranked(current, sound, calibration.judge.accepts)), None)


def shapes(library: Iterable[Effect], *, general: bool) -> tuple[Effect, ...]:
    """The effects of ``library`` to look for: the curves of any shape, or all others."""
    return tuple(effect for effect in library if effect.search.general is general)


def _effect_count(calibration: Calibration, fitted: Fit) -> int:
    """Number of effects of ``fitted``, without those known from the controller's law."""
    return len(fitted.model.effects) - len(calibration.baseline.model.effects)


def _exchange(calibration: Calibration, best: Fit, tried: FitsBySet, progress: Progress) -> Fit | None:
    """``best`` with one effect exchanged, or in another shape, where that leaves clearly less; else None.

    Only for two effects or more, because the first was fitted while the rest was missing; for two only where structure
    is left.
    """
    known, judge, count = calibration.baseline.model.names, calibration.judge, _effect_count(calibration, best)
    if not 2 <= count <= rules.CREDIBLE or (count == 2 and judge.at_floor(best)):
        return None
    progress("each effect anew beside the others", 0.95)
    others = exchanges(best, known, calibration.preparation.library)
    _remember(tried, others)
    # With play that bounces, the bursts of a few impacts are as large as the gain of an exchange.
    cost = bounded_cost if any(effect.play for effect in best.model.effects) else lambda f: f.cost
    least = min(others, key=cost, default=best)
    pays = cost(best) - cost(least) > max(judge.healthy.threshold, rules.STILL_PAYS * cost(best))
    return converged(least) if pays else None


def _pays_again(better: Fit, step: Step, step_costs: dict[Step, float]) -> bool:
    """Whether to take a ``step`` from one set to another; a second time only if ``better`` leaves less than before."""
    pays = better.cost < (1 - rules.STILL_PAYS) * step_costs.get(step, math.inf)
    if pays:
        step_costs[step] = better.cost
    return pays


def _remember(tried: FitsBySet, fits: Iterable[Fit]) -> None:
    """Keep the best fit of each set of effects in ``tried``."""
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
    """The best admissible fit of each set with one effect of ``library`` more than a model of ``beam``.

    Only effects whose short fit gains the share ``rival`` of the best gain are fitted. Also returns the gain of each
    effect alone on top of the first model [whitened cost].
    """
    names = " + ".join(beam[0].model.names) or "the baseline"
    curves = ", as a curve" if any(effect.search.general for effect in library) else ""
    progress(f"round {number}: {names}, and what else{curves}", 1 - 0.9 * 0.75 ** (number - 1))

    def tries(member: Fit) -> tuple[list[Fit], dict[str, float]]:
        if member is not calibration.baseline:
            return extended(member, library, rival)
        screened = [starts for starts in calibration.screened if starts[0].model.effects[-1] in library]
        return extensions(member, screened, tangent(member), rival)

    attempts = side_by_side(tries, [(member,) for member in beam])
    pool: FitsBySet = {}
    _remember(pool, (fitted for fits, _ in attempts for fitted in fits))
    alone: dict[str, float] = next((gains for _, gains in attempts if gains), {})
    return {key: fitted for key, fitted in pool.items() if admissible(fitted)}, alone


def _ranked(current: Fit, sound: FitsBySet, accept: Accept) -> list[Fit]:
    """Those of ``sound`` that are accepted, best first."""
    ranked = [f for f in sorted(sound.values(), key=lambda f: f.criterion) if accept(f, current)]
    return ranked or _late(current, sound, accept)


def _late(current: Fit, sound: FitsBySet, accept: Accept) -> list[Fit]:
    """The best of ``sound`` alone, where it is accepted once converged: an instant may have been a stroke off."""
    best = min(sound.values(), key=lambda f: f.cost, default=None)
    excess = current.cost - current.problem.samples("used")
    if best is None or excess <= 0 or current.cost - best.cost < rules.RIVAL * excess:
        return []
    further = converged(best)
    return [further] if accept(further, current) else []


def _rivals(path: list[Fit], tried: FitsBySet) -> list[Fit]:
    """The models of ``tried`` with one effect of the best model exchanged that come close, fitted to convergence.

    Otherwise the best model would win only because it was fitted longer.
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
    """Search, and stop at an unknown force of one kind that explains what a few effects leave.

    The model of a search ``before``, under other noise, is tried as well, also beside such a force.

    The force is looked for where data confirm it, beside the baseline and beside the first effect: a motor at its
    limit, or an end stop, hides the kind of the rest.
    """
    outcome, forces = begin_search(calibration, progress, A_FEW, before), list[OfAKind]()
    units = calibration.baseline.problem.axis.units

    def look(path: list[Fit]) -> None:
        progress(f"whether it is an unknown {units.word('force')} of one kind", 0.6)
        forces.extend(_of_a_kind(calibration, path, before.of_a_kind if before else None))

    confirmed = calibration.preparation.held_out is not None
    if confirmed and not outcome.interrupted and calibration.judge.leaves_structure(outcome.best):
        outcome = replace(until_interrupted(outcome, look), of_a_kind=forces[0] if forces else None)
    return finish_search(outcome, progress) if outcome.of_a_kind is None else outcome


def past_the_kind(outcome: Outcome, progress: Progress) -> Outcome:
    """Finish a search that stopped at an unknown force, unless the force is plain and ends the search."""
    return finish_search(outcome, progress) if outcome.stopped else outcome


def search_beside(calibration: Calibration, start: Hypothesis) -> Outcome:
    """Search again from ``start``, the baseline of ``calibration`` judged beside an unknown force.

    Such a force, any smooth function of the state, explains most friction too, but no event, drift, delay or ripple
    along the travel. A general curve is such a function itself, and is not a candidate.
    """
    return _finish_beside(_begin_beside(calibration, start))


def _begin_beside(calibration: Calibration, start: Hypothesis) -> Outcome:
    """The search beside an unknown force, with up to ``rules.CREDIBLE`` effects."""
    first = calibration.preparation
    library = tuple(effect for effect in first.library if not effect.search.general and not effect.search.element)
    preparation = replace(first, start=start, library=library)
    calibration = calibrate(preparation, start, calibration.floor, 0, 0, no_progress)
    return begin_search(calibration, no_progress, rules.CREDIBLE)


def _finish_beside(outcome: Outcome) -> Outcome:
    """Finish the search beside an unknown force; more effects than credible would only imitate the force."""
    return finish_search(outcome, no_progress, most=rules.CREDIBLE)


def _of_a_kind(calibration: Calibration, path: list[Fit], before: OfAKind | None) -> list[OfAKind]:
    """The first kind of force that, with the effects found beside it, leaves next to nothing; at most one.

    Searched from the first models of ``path``, and with the model ``before`` where that leaves less. Empty where there
    is none, or where the effects of ``path`` alone leave less. A search that leaves structure beside the force is not
    finished. A keyboard interrupt is raised again.
    """
    for kind, start, beside in _kinds_beside(path[:STARTS]):
        with suppress(SimulationError):
            problem = in_turn(beside, kind)[-1].problem
            again = _begin_beside(calibration, Hypothesis(problem, calibration.baseline.model))
            if before is not None and not again.interrupted:
                again = with_before(again, before.fitted.model)
            if not again.calibration.judge.leaves_structure(again.best):
                again = _finish_beside(again)
            if again.interrupted:
                raise KeyboardInterrupt
            fitted = in_turn(again.calibration.judge.refitted(again.best), kind)[-1]
            if next_to_nothing(start, fitted) and fitted.excess() < path[-1].excess():
                return [OfAKind(kind, start, again, fitted)]
    return []


def in_turn(fitted: Fit, kind: Kind) -> list[Fit]:
    """Fits of the model to all used samples, each with the unknown force of the one before in the loop.

    Raises :class:`SimulationError` where the model does not run with it.
    """
    fits = []
    for _ in range(IN_TURN):
        fitted = fit(with_kind(fitted, kind), "used")
        fits.append(fitted)
    return fits


def acting(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """``hypothesis`` with an unknown force in the loop, estimated in turns. Raises as :func:`in_turn`."""
    for _ in range(IN_TURN):
        hypothesis = with_kind(hypothesis, kind)
    return hypothesis


def next_to_nothing(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether ``after`` leaves only noise, or a negligible part of the excess of ``before``."""
    return only_noise(after, rules.STRUCTURED) or after.excess() <= (1.0 - rules.COMPLETE) * before.excess()


def only_noise(hypothesis: Hypothesis, most: float) -> bool:
    """Whether ``hypothesis`` leaves no more than ``most`` times the whitened cost of noise."""
    return hypothesis.excess() <= (most - 1.0) * hypothesis.problem.samples("used")


def _kinds_beside(starts: list[Fit]) -> list[tuple[Kind, Fit, Fit]]:
    """Kinds of force that explain a good part of what one of ``starts`` leaves: kind, start, fit beside the kind.

    The kind that leaves least comes first, but after kinds that are part of it. A later start must leave clearly less,
    because its effect may itself imitate the force.
    """
    by_cost = []
    for place, start in enumerate(starts):
        for related in KINDS:
            fits = [(kind, start, fitted) for degrees in related for kind, fitted in _of_few_columns(start, degrees)]
            good = [
                candidate for candidate in fits if candidate[-1].excess() <= (1.0 - rules.OF_A_KIND) * start.excess()
            ]
            if good:
                by_cost.append((min(fitted.cost for *_, fitted in good) / rules.SHARPER**place, good))
    return [candidate for _, good in sorted(by_cost, key=lambda ranked: ranked[0]) for candidate in good]


def _of_few_columns(start: Fit, degrees: tuple[Kind, ...]) -> list[tuple[Kind, Fit]]:
    """The kind of the lowest degree beside which ``start`` runs, and the fit; empty where there is none.

    A higher degree only where it leaves clearly less: otherwise it would take the part of known effects.
    """
    fits = [(kind, fitted) for kind in degrees for fitted in _fitted_beside(start, kind)]
    best = fits[:1]
    for kind, fitted in fits[1:]:
        if fitted.excess() < rules.SHARPER * best[0][1].excess():
            best = [(kind, fitted)]
    return best


def _fitted_beside(start: Fit, kind: Kind) -> list[Fit]:
    """``start`` fitted beside an unknown force in the loop; empty where it cannot be simulated with one."""
    with suppress(SimulationError):
        return [fit(with_kind(fit(beside_kind(start, kind)), kind))]
    return []
