"""The third stage: a beam search over sets of effects, as one loop over a table of moves.

:func:`walk` is the loop, and ``MOVES`` the table. A move proposes fits of the best model with one change and accepts
some of them by its own rule. The search continues from the best of these, again with the first move of the table, until
no move is accepted.

Adding effects one after the other is not enough. Each round extends the best few sets, so that a pair is found even if
neither effect is prominent alone. The first effect is fitted while the rest is missing, and may compensate for part of
it: a lag for a delay, a resonance for an unknown friction. So effects are exchanged once the others are in the model,
and effects that are no longer needed are pruned. A general curve could replace other effects, and is tried last.

A search may also include an unknown force: one of a given kind, or any smooth function of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from emps_design.discrepancy import rules
from emps_design.discrepancy.calibration import Outcome, UnknownForce, best_of_each_set, calibrate, set_of
from emps_design.discrepancy.extension import converged, extended, extensions, free_all
from emps_design.discrepancy.fit import Fit, admissible, bounded_cost, evaluate, fit, refit_play
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.starts import either_baseline, tangent
from emps_design.discrepancy.unknown_force import KINDS, Kind, beside_kind, with_kind
from emps_design.effects import Effect
from emps_design.errors import SimulationError
from emps_design.messages import warning
from emps_design.progress import Progress, no_progress

UNFINISHED = warning(
    "search-interrupted", "interrupted: the search did not finish, and the result is what it had found by then"
)


class Proposal(NamedTuple):
    """Admissible ``fits`` of a move; for a round that extends the baseline also the ``gains`` of each effect alone."""

    fits: Sequence[Fit]
    gains: dict[str, float] | None = None


@dataclass(frozen=True)
class Move:
    """A change of the best model of a search: whether it ``applies``, the fits it ``proposes``, those it ``takes``.

    ``takes`` returns the models to continue from, best first; none if the move fails. A ``detour`` may undo the change
    of another move, so at most ``rules.CREDIBLE`` are made, and the search ends if one leads back to an earlier model.
    ``closes`` are the names of the moves that cannot succeed after this one.
    """

    name: str
    applies: Callable[[Outcome], bool]
    proposes: Callable[[Outcome, Progress], Proposal]
    takes: Callable[[Outcome, Sequence[Fit]], list[Fit]]
    detour: bool = False
    closes: frozenset[str] = frozenset()


def walk(search: Outcome, moves: Sequence[Move], progress: Progress) -> Outcome:
    """``search`` after repeatedly making the first of ``moves`` that is accepted, until none is.

    The best fit of each set of effects is stored. A keyboard interrupt ends the search with the models found so far.
    """
    if search.interrupted:
        return search
    try:
        while (move := _next_move(search, moves)) is not None:
            proposed = move.proposes(search, progress)
            search = search.with_fits(proposed.fits, proposed.gains)
            accepted = move.takes(search, proposed.fits)
            if not accepted:
                search = replace(search, closed=search.closed | {move.name})
            elif move.detour and _in_a_circle(search, accepted[0]):
                break
            else:
                search = search.with_fits(accepted).advanced(accepted, move.detour, move.closes)
    except KeyboardInterrupt:
        return interrupted(search)
    return search


def interrupted(search: Outcome) -> Outcome:
    """``search`` marked as interrupted by the user."""
    return replace(search, warnings=(*search.warnings, UNFINISHED), interrupted=True)


def _next_move(search: Outcome, moves: Sequence[Move]) -> Move | None:
    """The first of ``moves`` that applies to ``search`` and has not failed from its best model."""
    for move in moves:
        exhausted = move.name in search.closed or (move.detour and search.detours == rules.CREDIBLE)
        if not exhausted and move.applies(search):
            return move
    return None


def _in_a_circle(search: Outcome, better: Fit) -> bool:
    """Whether ``search`` made the step from its best set to that of ``better`` before, at the same cost."""
    step = set_of(search.best), set_of(better)
    costs = [after.cost for at, after in pairwise(search.path) if (set_of(at), set_of(after)) == step]
    return bool(costs) and better.cost >= (1 - rules.STILL_PAYS) * costs[-1]


def shapes(library: Iterable[Effect], *, general: bool) -> tuple[Effect, ...]:
    """The effects of ``library`` to look for: the general curves, or all others."""
    return tuple(effect for effect in library if effect.search.general is general)


def _round(
    search: Outcome,
    beam: Sequence[Fit],
    library: tuple[Effect, ...],
    progress: Progress,
    rival: float = rules.HALF,
) -> Proposal:
    """The best admissible fit of each set made of a model of ``beam`` and one more effect of ``library``.

    Only effects whose short fit gains the share ``rival`` of the best gain are fitted.
    """
    number, first = 1 + search.count_of(beam[0]), beam[0] is search.baseline
    names = " + ".join(beam[0].model.names) or "the baseline"
    addition = "a general curve" if any(effect.search.general for effect in library) else "one more effect"
    progress(f"round {number}: {names} plus {addition}", 1 - 0.9 * 0.75 ** (number - 1))

    def tries(member: Fit) -> tuple[list[Fit], dict[str, float]]:
        if member is not search.baseline:
            return extended(member, library, rival)
        screened = [starts for starts in search.screened if starts[0].model.effects[-1] in library]
        return extensions(member, screened, tangent(member), rival)

    attempts = side_by_side(tries, [(member,) for member in beam])
    pool = best_of_each_set({}, (fitted for fits, _ in attempts for fitted in fits))
    gains = next((gains for _, gains in attempts if gains), None) if first else None
    return Proposal([fitted for fitted in pool.values() if admissible(fitted)], gains)


def _accepted(search: Outcome, fits: Sequence[Fit], most: int = 1) -> list[Fit]:
    """The best of the ``fits`` that the judge accepts, converged, and up to ``most`` in all that come close to it.

    The best is returned even if it has more bursts than the baseline: bursts have little weight in acceptance.
    """
    ranked = [fitted for fitted in sorted(fits, key=lambda f: f.criterion) if search.accepts(fitted)]
    ranked = ranked or _accepted_when_converged(search, fits)
    if not ranked:
        return []
    baseline = search.baseline.cost
    least = rules.HALF * (baseline - ranked[0].cost)
    leading = [ranked[0], *(fitted for fitted in ranked[1:most] if baseline - fitted.cost >= least)]
    return sorted(side_by_side(converged, [(fitted,) for fitted in leading]), key=lambda f: f.criterion)


def _accepted_when_converged(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
    """The best of ``fits`` alone, if it is accepted once converged: an instant may have been a stroke off."""
    current, best = search.best, min(fits, key=lambda f: f.cost, default=None)
    excess = current.cost - current.problem.samples("used")
    if best is None or excess <= 0 or current.cost - best.cost < rules.HALF * excess:
        return []
    further = converged(best)
    return [further] if search.accepts(further) else []


def _may_grow(search: Outcome) -> bool:
    """Whether ``search`` may add an effect: not if several effects explain too little."""
    baseline, number = search.baseline, 1 + search.count
    explained, excess = baseline.cost - search.best.cost, baseline.cost - baseline.problem.samples("used")
    given_up = number > rules.A_FEW and explained < rules.LEAST_EXPLAINED * excess
    return number <= search.most and not given_up


def _extend_beam(search: Outcome, progress: Progress) -> Proposal:
    """The next round: the beam with one more effect, general curves excluded."""
    best, beam = search.best, search.beam or (search.best,)
    if not search.count:
        # Missing physics may have biased the fitted baseline: that of the axis file is extended as well.
        alternatives = map(evaluate, either_baseline(best)[1:])
        beam = (best, *(alternative for alternative in alternatives if alternative.innovations))
    elif (1 - rules.WORTH_AT_FLOOR) * best.cost < best.problem.samples("used"):
        beam = (best,)  # no effect added to another set can be better: its residual would be below the noise
    return _round(search, beam, shapes(search.preparation.library, general=False), progress)


def _accepted_beam(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
    """The accepted ``fits`` that the next round extends."""
    return _accepted(search, fits, rules.BEAM[min(1 + search.count, rules.A_FEW) - 1])


def _prune_effects(search: Outcome, progress: Progress) -> Proposal:
    """The best model without an effect that is not a finding in addition to the others; effects of the law stay.

    If the smaller model was fitted before with a lower cost, that fit is used.
    """
    best, known = search.best, search.baseline.model.names
    smaller = [best.model.without(i) for i, name in enumerate(best.model.names) if name not in known]
    # Fitted with the same effort as the best model; otherwise every effect would look necessary.
    careful = len(best.model.effects) <= rules.CREDIBLE
    refit = (lambda start: refit_play(fit(start))) if careful else fit
    rests = filter(admissible, side_by_side(refit, [(best.with_model(model),) for model in smaller]))
    sound = [min((rest, search.tried.get(set_of(rest), rest)), key=lambda f: f.cost) for rest in rests]
    idle = [rest for rest in sound if not search.judge.accepts(best, rest)]
    if not idle and sound:
        cheapest = _reshaped(best, min(sound, key=lambda f: f.cost))
        idle = [] if search.judge.accepts(best, cheapest) else [cheapest]
    return Proposal(idle)


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


def _exchange_effects(search: Outcome, progress: Progress) -> Proposal:
    """The best model with one effect replaced by a confusable one, or by itself from new starts.

    Effects known from the controller's law are not replaced.

    The other effects and the baseline start from their present parameters. If the replaced effect may have biased the
    baseline, the parameters of the axis file are tried as well.
    """
    progress("exchanging one effect at a time", 0.95)
    best, known, places = search.best, search.baseline.model.names, list[tuple[Hypothesis, Effect]]()
    for index, effect in enumerate(best.model.effects):
        if effect.name not in known:
            places += [(rest, effect) for rest in either_baseline(best.with_model(best.model.without(index)))]

    def instead(rest: Hypothesis, effect: Effect) -> list[Fit]:
        without, specific = evaluate(rest), shapes(search.preparation.library, general=False)
        candidates = tuple(other for other in specific if other is effect or other.confusable(effect))
        return extended(without, candidates)[0] if without.innovations else []

    return Proposal([fitted for fits in side_by_side(instead, places) for fitted in fits if admissible(fitted)])


def _clear_improvement(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
    """The fit with the lowest cost, if that is clearly lower than the cost of the best model."""
    best = search.best
    # With bouncing backlash, the bursts of a few impacts are as large as the gain of an exchange.
    cost = bounded_cost if any(effect.play for effect in best.model.effects) else lambda f: f.cost
    least = min(fits, key=cost, default=best)
    improved = cost(best) - cost(least) > max(search.healthy.threshold, rules.STILL_PAYS * cost(best))
    return [converged(least)] if improved else []


def _add_to_single_effects(search: Outcome, progress: Progress) -> Proposal:
    """The best few single effects with enough gain, each with one more effect.

    An effect may show on too few strokes as long as another is missing.
    """
    current = search.best
    least_gain = max(search.healthy.threshold, rules.WORTH * current.cost)
    single = [f for f in search.tried.values() if search.count_of(f) == 1 and not f.model.effects[-1].search.general]
    leading = sorted((f for f in single if current.cost - f.cost > least_gain), key=lambda f: f.cost)[: rules.BEAM[0]]
    if not leading:
        return Proposal([])
    return _round(search, leading, shapes(search.preparation.library, general=False), progress)


def _add_untried_effect(search: Outcome, progress: Progress) -> Proposal:
    """The best model with an effect that has not been fitted yet: the best ones may compensate for others."""
    specific, names = shapes(search.preparation.library, general=False), set_of(search.best)
    rest = tuple(effect for effect in specific if names | {effect.name} not in search.tried)
    return _round(search, [search.best], rest, progress, rules.MINOR)


def _add_curve(search: Outcome, progress: Progress) -> Proposal:
    """The best model with a general curve."""
    return _round(search, [search.best], shapes(search.preparation.library, general=True), progress)


def _converge_rivals(search: Outcome, progress: Progress) -> Proposal:
    """The models with one effect of the best model exchanged and nearly its cost, fitted to convergence.

    Otherwise the best model would win only because it was fitted with more steps.
    """
    best, by_set, names = search.best, search.tried, set_of(search.best)
    close = []
    for name in names - set_of(search.baseline):
        others = names - {name}
        without = by_set.get(others, search.baseline).cost
        least = rules.NEARLY_ALL * (without - best.cost)
        rivals = [rival for key, rival in by_set.items() if len(key) == len(names) and others < key != names]
        close += [(rival,) for rival in rivals if without - rival.cost >= least]
    return Proposal(side_by_side(converged, close))


def _may_be_exchanged(search: Outcome) -> bool:
    """Whether effects may have been fitted while others were missing; with two only if structure remains."""
    return 2 <= search.count <= rules.CREDIBLE and not (search.count == 2 and search.judge.at_floor(search.best))


def _may_lack_more(search: Outcome) -> bool:
    """Whether structure remains and the model has fewer effects than are credible."""
    return search.count < rules.CREDIBLE and search.judge.leaves_structure(search.best)


def _may_be_two(search: Outcome) -> bool:
    """Whether structure remains although no effect was found."""
    return not search.count and search.judge.leaves_structure(search.best)


ADD = Move("add", _may_grow, _extend_beam, _accepted_beam)
PRUNE = Move(
    "prune",
    lambda search: search.count > 1,
    _prune_effects,
    lambda search, fits: [converged(min(fits, key=lambda f: f.cost))] if fits else [],
    closes=frozenset({"add"}),
)
EXCHANGE = Move("exchange", _may_be_exchanged, _exchange_effects, _clear_improvement, detour=True)
PAIR = Move("pair", _may_be_two, _add_to_single_effects, _accepted, detour=True)
FAR_BEHIND = Move("far behind", _may_lack_more, _add_untried_effect, _accepted, detour=True)
CURVE = Move("curve", lambda search: search.count < search.most, _add_curve, _accepted, detour=True)
MOVES = (ADD, PRUNE, EXCHANGE, PAIR, FAR_BEHIND, CURVE)

FREE = Move(
    "free",
    lambda search: len(search.best.slots) < len(search.best.model.slots()),
    lambda search, progress: Proposal([free_all(search.best)]),
    lambda search, fits: list(fits),
)
RIVALS = Move("rivals", lambda search: True, _converge_rivals, lambda search, fits: [])
LAST = (FREE, RIVALS)


def resume_move(before: Outcome) -> Move:
    """The move to the best model of an earlier search ``before``, if this search, with other noise, accepts it.

    Its neighbours are fitted too: the models on its path, each effect alone, and the best model with one exchanged.
    """
    names = set_of(before.best)

    def refits(search: Outcome, progress: Progress) -> Proposal:
        baseline, first = search.baseline, len(set_of(search.baseline))
        close = [
            fitted
            for key, fitted in before.tried.items()
            if key != names and (len(key) == first + 1 or key < names or len(key) == len(names) == len(key & names) + 1)
        ]
        best = converged(fit(baseline.with_model(before.best.model)))
        fits = side_by_side(fit, [(baseline.with_model(fitted.model),) for fitted in close])
        return Proposal([fitted for fitted in (best, *fits) if admissible(fitted)])

    def takes(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
        again = search.tried.get(names)
        return [again] if again is not None and search.accepts(again) else []

    found = before.best.model.names != before.baseline.model.names
    return Move("take up", lambda search: found and search.best is search.baseline, refits, takes)


def bring_in_move(before: Candidate) -> Move:
    """The move to the model ``before`` of a search with another noise estimate, if its cost is clearly lower."""

    def refit(search: Outcome, progress: Progress) -> Proposal:
        return Proposal(list(filter(admissible, [converged(fit(search.best.with_model(before)))])))

    def takes(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
        return [fitted for fitted in fits if fitted.cost < (1 - rules.STILL_PAYS) * search.best.cost]

    news = lambda search: before.names not in ((), search.best.model.names)  # noqa: E731
    return Move("bring in", news, refit, takes, closes=frozenset({"add"}))


def begin_search(search: Outcome, progress: Progress, most: int, before: Outcome | None = None) -> Outcome:
    """Add up to ``most`` effects to the baseline, or to the best model of an earlier search ``before``.

    :func:`finish_search` may still change the result.
    """
    moves = (ADD,) if before is None else (resume_move(before), ADD)
    return walk(replace(search, most=most), moves, progress)


def finish_search(search: Outcome, progress: Progress, most: int = rules.MOST_EFFECTS) -> Outcome:
    """Continue a search of :func:`begin_search`, with up to ``most`` effects, until no change is accepted."""
    return walk(walk(replace(search, most=most), MOVES, progress), LAST, progress)


def search_with_unknown_force(search: Outcome, progress: Progress, before: Outcome | None = None) -> Outcome:
    """Search, and stop at an unknown force of one kind that explains the residual of a few effects.

    The model of an earlier search ``before`` is tried as well, also together with such a force. A force is looked for
    only with held-out data, in addition to the baseline and to the first effect: a motor at its limit, or an end stop,
    hides the kind of the residual.
    """
    search = begin_search(search, progress, rules.A_FEW, before)
    confirmed = search.preparation.held_out is not None
    if confirmed and not search.interrupted and search.judge.leaves_structure(search.best):
        progress(f"testing for an unknown {search.baseline.problem.axis.units.word('force')} of one kind", 0.6)
        try:
            search = replace(
                search, unknown_force=_find_unknown_force(search, before.unknown_force if before else None)
            )
        except KeyboardInterrupt:
            return interrupted(search)
    return finish_search(search, progress) if search.unknown_force is None else search


def finish_stopped(search: Outcome, progress: Progress) -> Outcome:
    """Finish a search that stopped at an unknown force, unless that force is sufficient."""
    return finish_search(search, progress) if search.stopped else search


def search_beside(search: Outcome, start: Hypothesis) -> Outcome:
    """Search again from ``start``, the baseline of ``search`` with an unknown force.

    An unknown force that is any smooth function of the state also explains most friction, but no event, drift, delay or
    ripple along the travel. General curves are such functions themselves, and are not candidates.
    """
    return finish_search(_begin_beside(search, start), no_progress, most=rules.CREDIBLE)


def _begin_beside(search: Outcome, start: Hypothesis) -> Outcome:
    """The search with an unknown force and up to ``rules.CREDIBLE`` effects: more would only imitate the force."""
    first = search.preparation
    library = tuple(effect for effect in first.library if not effect.search.general and not effect.search.element)
    preparation = replace(first, start=start, library=library)
    return begin_search(calibrate(preparation, start, search.floor, 0, 0, no_progress), no_progress, rules.CREDIBLE)


def _find_unknown_force(search: Outcome, before: UnknownForce | None) -> UnknownForce | None:
    """The first kind of force that, with the effects found together with it, explains nearly all of the residual.

    Searched from the first models of the path, and with the model ``before`` if its cost is lower. None if there is no
    such force, or if the best model alone has a smaller residual. A search whose residual keeps structure is not
    finished. A keyboard interrupt is raised again.
    """
    for kind, start, beside in _kinds_beside(search.path[:2]):
        with suppress(SimulationError):
            problem = fit_alternately(beside, kind)[-1].problem
            again = _begin_beside(search, Hypothesis(problem, search.baseline.model))
            if before is not None:
                again = walk(again, (bring_in_move(before.fitted.model),), no_progress)
            if not again.judge.leaves_structure(again.best):
                again = finish_search(again, no_progress, most=rules.CREDIBLE)
            if again.interrupted:
                raise KeyboardInterrupt
            fitted = fit_alternately(again.judge.refit(again.best), kind)[-1]
            if leaves_little(start, fitted) and fitted.excess() < search.best.excess():
                return UnknownForce(kind, start, again, fitted)
    return None


def fit_alternately(fitted: Fit, kind: Kind) -> list[Fit]:
    """Fits of the model to all used samples, each with the unknown force of the previous fit in the loop.

    Raises :class:`SimulationError` if the model cannot be simulated with it.
    """
    fits = []
    for _ in range(rules.IN_TURN):
        fitted = fit(with_kind(fitted, kind), "used")
        fits.append(fitted)
    return fits


def with_force_in_loop(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """``hypothesis`` with an unknown force in the loop, estimated iteratively. Raises as :func:`fit_alternately`."""
    for _ in range(rules.IN_TURN):
        hypothesis = with_kind(hypothesis, kind)
    return hypothesis


def leaves_little(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether the residual of ``after`` is only noise, or has a negligible part of the excess of ``before``."""
    return only_noise(after, rules.STRUCTURED) or after.excess() <= rules.EQUIVALENT * before.excess()


def only_noise(hypothesis: Hypothesis, most: float) -> bool:
    """Whether the whitened cost of ``hypothesis`` is at most ``most`` times that of noise."""
    return hypothesis.excess() <= (most - 1.0) * hypothesis.problem.samples("used")


def _kinds_beside(starts: Sequence[Fit]) -> list[tuple[Kind, Fit, Fit]]:
    """Kinds of force that explain a good part of the residual of one of ``starts``: kind, start, fit with the kind.

    The kind with the lowest cost comes first, but after kinds that are part of it. A later start must have a clearly
    lower cost, because its effect may itself imitate the force.
    """
    by_cost = []
    for place, start in enumerate(starts):
        for related in KINDS:
            fits = [(kind, start, fitted) for degrees in related for kind, fitted in _of_lowest_degree(start, degrees)]
            good = [candidate for candidate in fits if candidate[-1].excess() <= (1.0 - rules.HALF) * start.excess()]
            if good:
                by_cost.append((min(fitted.cost for *_, fitted in good) / rules.CLEARLY_LESS**place, good))
    return [candidate for _, good in sorted(by_cost, key=lambda ranked: ranked[0]) for candidate in good]


def _of_lowest_degree(start: Fit, degrees: tuple[Kind, ...]) -> list[tuple[Kind, Fit]]:
    """The kind of the lowest degree with which ``start`` can be simulated, and the fit; empty if there is none.

    A higher degree only if its residual is clearly smaller: otherwise it would explain part of the known effects.
    """
    fits = [(kind, fitted) for kind in degrees for fitted in _fitted_beside(start, kind)]
    best = fits[:1]
    for kind, fitted in fits[1:]:
        if fitted.excess() < rules.CLEARLY_LESS * best[0][1].excess():
            best = [(kind, fitted)]
    return best


def _fitted_beside(start: Fit, kind: Kind) -> list[Fit]:
    """``start`` fitted with an unknown force in the loop; empty if it cannot be simulated with one."""
    with suppress(SimulationError):
        return [fit(with_kind(fit(beside_kind(start, kind)), kind))]
    return []
