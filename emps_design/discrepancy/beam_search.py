"""The third stage: a beam search over sets of effects, as one loop over a table of moves.

:func:`walk` is the loop, and ``MOVES`` the table. A move proposes fits of the best model changed in one way, and takes
those that its own rule accepts; the search goes on from the best of them, with the first move of the table again, until
none leads further.

Adding effects one after the other is not enough. Pairs of which neither effect stands out alone are found because each
round extends the best few sets. The first effect was fitted while the rest was missing, and may compensate for part of
it: a lag for a delay, a resonance for an unknown friction. So effects are exchanged once the others are in the model,
and effects that are no longer needed are pruned. A general curve could replace other effects, and comes last.

A search may also run beside an unknown force: of one kind, or any smooth function of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from emps_design.discrepancy import rules
from emps_design.discrepancy.calibration import OfAKind, Outcome, calibrate, remembered, set_of
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

UNFINISHED = warning(
    "search-interrupted", "interrupted: the search was not finished, what follows is what was known by then"
)


class Proposed(NamedTuple):
    """Admissible ``fits`` of a move; of a round on top of the baseline also the ``gains`` of each effect alone."""

    fits: Sequence[Fit]
    gains: dict[str, float] | None = None


@dataclass(frozen=True)
class Move:
    """A way to go on from the best model of a search: when it ``applies``, what it ``proposes``, what it ``takes``.

    ``takes`` gives the models to go on from, best first; none where the move leads nowhere. ``detour``: it may undo
    what another move did, so that there are ``rules.CREDIBLE`` at most, and one that leads in a circle ends the search.
    ``closes`` are the names of the moves that lead nowhere from its models.
    """

    name: str
    applies: Callable[[Outcome], bool]
    proposes: Callable[[Outcome, Progress], Proposed]
    takes: Callable[[Outcome, Sequence[Fit]], list[Fit]]
    detour: bool = False
    closes: frozenset[str] = frozenset()


def walk(search: Outcome, moves: Sequence[Move], progress: Progress) -> Outcome:
    """``search`` after the first of ``moves`` that leads further from its best model, again until none does.

    All that a move proposes and takes is kept, the best fit of each set. A keyboard interrupt ends the search with the
    models found so far.
    """
    if search.interrupted:
        return search
    try:
        while (move := _next_move(search, moves)) is not None:
            proposed = move.proposes(search, progress)
            search = search.knowing(proposed.fits, proposed.gains)
            taken = move.takes(search, proposed.fits)
            if not taken:
                search = replace(search, closed=search.closed | {move.name})
            elif move.detour and _in_a_circle(search, taken[0]):
                break
            else:
                search = search.knowing(taken).further(taken, move.detour, move.closes)
    except KeyboardInterrupt:
        return interrupted(search)
    return search


def interrupted(search: Outcome) -> Outcome:
    """``search`` as the user ended it."""
    return replace(search, warnings=(*search.warnings, UNFINISHED), interrupted=True)


def _next_move(search: Outcome, moves: Sequence[Move]) -> Move | None:
    """The first of ``moves`` that applies to ``search``, and was not found to lead nowhere from its best model."""
    for move in moves:
        exhausted = move.name in search.closed or (move.detour and search.detours == rules.CREDIBLE)
        if not exhausted and move.applies(search):
            return move
    return None


def _in_a_circle(search: Outcome, better: Fit) -> bool:
    """Whether ``search`` went from its best set to that of ``better`` before, and leaves as much as then."""
    step = set_of(search.best), set_of(better)
    costs = [after.cost for at, after in pairwise(search.path) if (set_of(at), set_of(after)) == step]
    return bool(costs) and better.cost >= (1 - rules.STILL_PAYS) * costs[-1]


def shapes(library: Iterable[Effect], *, general: bool) -> tuple[Effect, ...]:
    """The effects of ``library`` to look for: the curves of any shape, or all others."""
    return tuple(effect for effect in library if effect.search.general is general)


def _round(
    search: Outcome,
    beam: Sequence[Fit],
    library: tuple[Effect, ...],
    progress: Progress,
    rival: float = rules.HALF,
) -> Proposed:
    """The best admissible fit of each set with one effect of ``library`` more than a model of ``beam``.

    Only effects whose short fit gains the share ``rival`` of the best gain are fitted.
    """
    number, first = 1 + search.count_of(beam[0]), beam[0] is search.baseline
    names = " + ".join(beam[0].model.names) or "the baseline"
    curves = ", as a curve" if any(effect.search.general for effect in library) else ""
    progress(f"round {number}: {names}, and what else{curves}", 1 - 0.9 * 0.75 ** (number - 1))

    def tries(member: Fit) -> tuple[list[Fit], dict[str, float]]:
        if member is not search.baseline:
            return extended(member, library, rival)
        screened = [starts for starts in search.screened if starts[0].model.effects[-1] in library]
        return extensions(member, screened, tangent(member), rival)

    attempts = side_by_side(tries, [(member,) for member in beam])
    pool = remembered({}, (fitted for fits, _ in attempts for fitted in fits))
    gains = next((gains for _, gains in attempts if gains), None) if first else None
    return Proposed([fitted for fitted in pool.values() if admissible(fitted)], gains)


def _accepted(search: Outcome, fits: Sequence[Fit], most: int = 1) -> list[Fit]:
    """Up to ``most`` of the ``fits`` that the judge accepts, converged, best first; others than one that come close.

    The best is kept even where it leaves more bursts than the baseline: acceptance hardly counts bursts.
    """
    ranked = [fitted for fitted in sorted(fits, key=lambda f: f.criterion) if search.accepts(fitted)]
    ranked = ranked or _late(search, fits)
    if not ranked:
        return []
    baseline = search.baseline.cost
    least = rules.HALF * (baseline - ranked[0].cost)
    leading = [ranked[0], *(fitted for fitted in ranked[1:most] if baseline - fitted.cost >= least)]
    return sorted(side_by_side(converged, [(fitted,) for fitted in leading]), key=lambda f: f.criterion)


def _late(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
    """The best of ``fits`` alone, where it is accepted once converged: an instant may have been a stroke off."""
    current, best = search.best, min(fits, key=lambda f: f.cost, default=None)
    excess = current.cost - current.problem.samples("used")
    if best is None or excess <= 0 or current.cost - best.cost < rules.HALF * excess:
        return []
    further = converged(best)
    return [further] if search.accepts(further) else []


def _may_grow(search: Outcome) -> bool:
    """Whether ``search`` may add an effect: not after some that explain too little."""
    baseline, number = search.baseline, 1 + search.count
    explained, excess = baseline.cost - search.best.cost, baseline.cost - baseline.problem.samples("used")
    given_up = number > rules.A_FEW and explained < rules.LEAST_EXPLAINED * excess
    return number <= search.most and not given_up


def _with_any(search: Outcome, progress: Progress) -> Proposed:
    """The next round: the beam with one effect more, of any but the general curves."""
    best, beam = search.best, search.beam or (search.best,)
    if not search.count:
        # Missing physics may have bent the fitted baseline: the axis file's is extended as well.
        alternatives = map(evaluate, either_baseline(best)[1:])
        beam = (best, *(alternative for alternative in alternatives if alternative.innovations))
    elif (1 - rules.WORTH_AT_FLOOR) * best.cost < best.problem.samples("used"):
        beam = (best,)  # an effect added to another set would have to leave less than noise
    return _round(search, beam, shapes(search.preparation.library, general=False), progress)


def _widest(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
    """The accepted of ``fits`` that the next round extends."""
    return _accepted(search, fits, rules.BEAM[min(1 + search.count, rules.A_FEW) - 1])


def _without_needless(search: Outcome, progress: Progress) -> Proposed:
    """The best model without one effect that is no finding beside the others; those known from the law stay.

    The smaller model may have been tried before with a better fit, which is then taken.
    """
    best, known = search.best, search.baseline.model.names
    smaller = [best.model.without(i) for i, name in enumerate(best.model.names) if name not in known]
    # With the same effort as the best model, or every effect would look needed.
    careful = len(best.model.effects) <= rules.CREDIBLE
    refit = (lambda start: play_anew(fit(start))) if careful else fit
    rests = filter(admissible, side_by_side(refit, [(best.with_model(model),) for model in smaller]))
    sound = [min((rest, search.tried.get(set_of(rest), rest)), key=lambda f: f.cost) for rest in rests]
    idle = [rest for rest in sound if not search.judge.accepts(best, rest)]
    if not idle and sound:
        cheapest = _reshaped(best, min(sound, key=lambda f: f.cost))
        idle = [] if search.judge.accepts(best, cheapest) else [cheapest]
    return Proposed(idle)


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


def _exchanged(search: Outcome, progress: Progress) -> Proposed:
    """The best model with one effect replaced by a confusable one, or by itself from new starts; known ones stay.

    The other effects start from their numbers, and the baseline does too; where the replaced effect may have bent the
    baseline, the axis file's numbers are tried as well.
    """
    progress("each effect anew beside the others", 0.95)
    best, known, places = search.best, search.baseline.model.names, list[tuple[Hypothesis, Effect]]()
    for index, effect in enumerate(best.model.effects):
        if effect.name not in known:
            places += [(rest, effect) for rest in either_baseline(best.with_model(best.model.without(index)))]

    def instead(rest: Hypothesis, effect: Effect) -> list[Fit]:
        without, specific = evaluate(rest), shapes(search.preparation.library, general=False)
        alike = tuple(other for other in specific if other is effect or other.confusable(effect))
        return extended(without, alike)[0] if without.innovations else []

    return Proposed([fitted for fits in side_by_side(instead, places) for fitted in fits if admissible(fitted)])


def _clearly_less(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
    """The one of ``fits`` that leaves least, where that is clearly less than the best model leaves."""
    best = search.best
    # With play that bounces, the bursts of a few impacts are as large as the gain of an exchange.
    cost = bounded_cost if any(effect.play for effect in best.model.effects) else lambda f: f.cost
    least = min(fits, key=cost, default=best)
    pays = cost(best) - cost(least) > max(search.healthy.threshold, rules.STILL_PAYS * cost(best))
    return [converged(least)] if pays else []


def _pairs(search: Outcome, progress: Progress) -> Proposed:
    """The best few single effects with enough gain, and one effect more.

    An effect may show on too few strokes while another is missing.
    """
    current = search.best
    worth = max(search.healthy.threshold, rules.WORTH * current.cost)
    single = [f for f in search.tried.values() if search.count_of(f) == 1 and not f.model.effects[-1].search.general]
    leading = sorted((f for f in single if current.cost - f.cost > worth), key=lambda f: f.cost)[: rules.BEAM[0]]
    if not leading:
        return Proposed([])
    return _round(search, leading, shapes(search.preparation.library, general=False), progress)


def _low_ranked(search: Outcome, progress: Progress) -> Proposed:
    """The best model with an effect that was not fitted so far: the best ones may compensate for others."""
    specific, names = shapes(search.preparation.library, general=False), set_of(search.best)
    rest = tuple(effect for effect in specific if names | {effect.name} not in search.tried)
    return _round(search, [search.best], rest, progress, rules.MINOR)


def _curves(search: Outcome, progress: Progress) -> Proposed:
    """The best model with a general curve."""
    return _round(search, [search.best], shapes(search.preparation.library, general=True), progress)


def _rivals(search: Outcome, progress: Progress) -> Proposed:
    """The models tried with one effect of the best model exchanged that come close, fitted to convergence.

    Otherwise the best model would win only because it was fitted longer.
    """
    best, tried, names = search.best, search.tried, set_of(search.best)
    close = []
    for name in names - set_of(search.baseline):
        others = names - {name}
        without = tried.get(others, search.baseline).cost
        least = rules.NEARLY_ALL * (without - best.cost)
        alike = [rival for key, rival in tried.items() if len(key) == len(names) and others < key != names]
        close += [(rival,) for rival in alike if without - rival.cost >= least]
    return Proposed(side_by_side(converged, close))


def _may_be_exchanged(search: Outcome) -> bool:
    """Whether effects may have been fitted while others were missing; of two only where structure is left."""
    return 2 <= search.count <= rules.CREDIBLE and not (search.count == 2 and search.judge.at_floor(search.best))


def _may_lack_more(search: Outcome) -> bool:
    """Whether structure is left of a model with fewer effects than are credible."""
    return search.count < rules.CREDIBLE and search.judge.leaves_structure(search.best)


def _may_be_two(search: Outcome) -> bool:
    """Whether nothing was found though structure is left."""
    return not search.count and search.judge.leaves_structure(search.best)


ADD = Move("add", _may_grow, _with_any, _widest)
PRUNE = Move(
    "prune",
    lambda search: search.count > 1,
    _without_needless,
    lambda search, fits: [converged(min(fits, key=lambda f: f.cost))] if fits else [],
    closes=frozenset({"add"}),
)
EXCHANGE = Move("exchange", _may_be_exchanged, _exchanged, _clearly_less, detour=True)
PAIR = Move("pair", _may_be_two, _pairs, _accepted, detour=True)
FAR_BEHIND = Move("far behind", _may_lack_more, _low_ranked, _accepted, detour=True)
CURVE = Move("curve", lambda search: search.count < search.most, _curves, _accepted, detour=True)
MOVES = (ADD, PRUNE, EXCHANGE, PAIR, FAR_BEHIND, CURVE)

FREE = Move(
    "free",
    lambda search: len(search.best.slots) < len(search.best.model.slots()),
    lambda search, progress: Proposed([freed(search.best)]),
    lambda search, fits: list(fits),
)
RIVALS = Move("rivals", lambda search: True, _rivals, lambda search, fits: [])
LAST = (FREE, RIVALS)


def taken_up(before: Outcome) -> Move:
    """The move to the best model of a search ``before``, under other noise, if this one accepts it.

    Its neighbours are fitted too: the models on its path, each effect alone, and the best model with one exchanged.
    """
    names = set_of(before.best)

    def refits(search: Outcome, progress: Progress) -> Proposed:
        baseline, first = search.baseline, len(set_of(search.baseline))
        near = [
            fitted
            for key, fitted in before.tried.items()
            if key != names and (len(key) == first + 1 or key < names or len(key) == len(names) == len(key & names) + 1)
        ]
        best = converged(fit(baseline.with_model(before.best.model)))
        fits = side_by_side(fit, [(baseline.with_model(fitted.model),) for fitted in near])
        return Proposed([fitted for fitted in (best, *fits) if admissible(fitted)])

    def takes(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
        again = search.tried.get(names)
        return [again] if again is not None and search.accepts(again) else []

    found = before.best.model.names != before.baseline.model.names
    return Move("take up", lambda search: found and search.best is search.baseline, refits, takes)


def brought_in(before: Candidate) -> Move:
    """The move to the model ``before``, of a search under other noise, where it leaves clearly less than the best."""

    def refit(search: Outcome, progress: Progress) -> Proposed:
        return Proposed(list(filter(admissible, [converged(fit(search.best.with_model(before)))])))

    def takes(search: Outcome, fits: Sequence[Fit]) -> list[Fit]:
        return [fitted for fitted in fits if fitted.cost < (1 - rules.STILL_PAYS) * search.best.cost]

    news = lambda search: before.names not in ((), search.best.model.names)  # noqa: E731
    return Move("bring in", news, refit, takes, closes=frozenset({"add"}))


def begin_search(search: Outcome, progress: Progress, most: int, before: Outcome | None = None) -> Outcome:
    """Add up to ``most`` effects to the baseline, or to the best model of a search ``before`` under other noise.

    :func:`finish_search` may still change the result.
    """
    moves = (ADD,) if before is None else (taken_up(before), ADD)
    return walk(replace(search, most=most), moves, progress)


def finish_search(search: Outcome, progress: Progress, most: int = rules.MOST_EFFECTS) -> Outcome:
    """Continue a search of :func:`begin_search`, with up to ``most`` effects, until nothing more is accepted."""
    return walk(walk(replace(search, most=most), MOVES, progress), LAST, progress)


def search_or_kind(search: Outcome, progress: Progress, before: Outcome | None = None) -> Outcome:
    """Search, and stop at an unknown force of one kind that explains what a few effects leave.

    The model of a search ``before``, under other noise, is tried as well, also beside such a force. That is looked for
    where data confirm it, beside the baseline and beside the first effect: a motor at its limit, or an end stop, hides
    the kind of the rest.
    """
    search = begin_search(search, progress, rules.A_FEW, before)
    confirmed = search.preparation.held_out is not None
    if confirmed and not search.interrupted and search.judge.leaves_structure(search.best):
        progress(f"whether it is an unknown {search.baseline.problem.axis.units.word('force')} of one kind", 0.6)
        try:
            search = replace(search, of_a_kind=_of_a_kind(search, before.of_a_kind if before else None))
        except KeyboardInterrupt:
            return interrupted(search)
    return finish_search(search, progress) if search.of_a_kind is None else search


def past_the_kind(search: Outcome, progress: Progress) -> Outcome:
    """Finish a search that stopped at an unknown force, unless the force is plain and ends the search."""
    return finish_search(search, progress) if search.stopped else search


def search_beside(search: Outcome, start: Hypothesis) -> Outcome:
    """Search again from ``start``, the baseline of ``search`` judged beside an unknown force.

    Such a force, any smooth function of the state, explains most friction too, but no event, drift, delay or ripple
    along the travel. A general curve is such a function itself, and is not a candidate.
    """
    return finish_search(_begin_beside(search, start), no_progress, most=rules.CREDIBLE)


def _begin_beside(search: Outcome, start: Hypothesis) -> Outcome:
    """The search beside an unknown force, with up to ``rules.CREDIBLE`` effects: more would only imitate the force."""
    first = search.preparation
    library = tuple(effect for effect in first.library if not effect.search.general and not effect.search.element)
    preparation = replace(first, start=start, library=library)
    return begin_search(calibrate(preparation, start, search.floor, 0, 0, no_progress), no_progress, rules.CREDIBLE)


def _of_a_kind(search: Outcome, before: OfAKind | None) -> OfAKind | None:
    """The first kind of force that, with the effects found beside it, leaves next to nothing.

    Searched from the first models of the path, and with the model ``before`` where that leaves less. None where there
    is none, or where the effects of the best model alone leave less. A search that leaves structure beside the force is
    not finished. A keyboard interrupt is raised again.
    """
    for kind, start, beside in _kinds_beside(search.path[:2]):
        with suppress(SimulationError):
            problem = in_turn(beside, kind)[-1].problem
            again = _begin_beside(search, Hypothesis(problem, search.baseline.model))
            if before is not None:
                again = walk(again, (brought_in(before.fitted.model),), no_progress)
            if not again.judge.leaves_structure(again.best):
                again = finish_search(again, no_progress, most=rules.CREDIBLE)
            if again.interrupted:
                raise KeyboardInterrupt
            fitted = in_turn(again.judge.refitted(again.best), kind)[-1]
            if next_to_nothing(start, fitted) and fitted.excess() < search.best.excess():
                return OfAKind(kind, start, again, fitted)
    return None


def in_turn(fitted: Fit, kind: Kind) -> list[Fit]:
    """Fits of the model to all used samples, each with the unknown force of the one before in the loop.

    Raises :class:`SimulationError` where the model does not run with it.
    """
    fits = []
    for _ in range(rules.IN_TURN):
        fitted = fit(with_kind(fitted, kind), "used")
        fits.append(fitted)
    return fits


def acting(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """``hypothesis`` with an unknown force in the loop, estimated in turns. Raises as :func:`in_turn`."""
    for _ in range(rules.IN_TURN):
        hypothesis = with_kind(hypothesis, kind)
    return hypothesis


def next_to_nothing(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether ``after`` leaves only noise, or a negligible part of the excess of ``before``."""
    return only_noise(after, rules.STRUCTURED) or after.excess() <= rules.EQUIVALENT * before.excess()


def only_noise(hypothesis: Hypothesis, most: float) -> bool:
    """Whether ``hypothesis`` leaves no more than ``most`` times the whitened cost of noise."""
    return hypothesis.excess() <= (most - 1.0) * hypothesis.problem.samples("used")


def _kinds_beside(starts: Sequence[Fit]) -> list[tuple[Kind, Fit, Fit]]:
    """Kinds of force that explain a good part of what one of ``starts`` leaves: kind, start, fit beside the kind.

    The kind that leaves least comes first, but after kinds that are part of it. A later start must leave clearly less,
    because its effect may itself imitate the force.
    """
    by_cost = []
    for place, start in enumerate(starts):
        for related in KINDS:
            fits = [(kind, start, fitted) for degrees in related for kind, fitted in _of_few_columns(start, degrees)]
            good = [candidate for candidate in fits if candidate[-1].excess() <= (1.0 - rules.HALF) * start.excess()]
            if good:
                by_cost.append((min(fitted.cost for *_, fitted in good) / rules.CLEARLY_LESS**place, good))
    return [candidate for _, good in sorted(by_cost, key=lambda ranked: ranked[0]) for candidate in good]


def _of_few_columns(start: Fit, degrees: tuple[Kind, ...]) -> list[tuple[Kind, Fit]]:
    """The kind of the lowest degree beside which ``start`` runs, and the fit; empty where there is none.

    A higher degree only where it leaves clearly less: otherwise it would take the part of known effects.
    """
    fits = [(kind, fitted) for kind in degrees for fitted in _fitted_beside(start, kind)]
    best = fits[:1]
    for kind, fitted in fits[1:]:
        if fitted.excess() < rules.CLEARLY_LESS * best[0][1].excess():
            best = [(kind, fitted)]
    return best


def _fitted_beside(start: Fit, kind: Kind) -> list[Fit]:
    """``start`` fitted beside an unknown force in the loop; empty where it cannot be simulated with one."""
    with suppress(SimulationError):
        return [fit(with_kind(fit(beside_kind(start, kind)), kind))]
    return []
