"""The third stage: which effects to try together, the best few sets of them extended again and again.

A beam search over sets of effects. Each round adds every effect to the best few models so far, refits everything, and
keeps the best few sets: pairs in which neither effect stands out alone are found because a round starts from several
first guesses. An effect that is a curve of any shape could stand in for others, and waits until none of them is found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.fit import Fit, admissible, bounded_cost, evaluate, fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.search.acceptance import Accept
from emps_design.discrepancy.search.calibration import Calibration
from emps_design.discrepancy.search.exchange import exchanges
from emps_design.discrepancy.search.extension import converged, extended, extensions, freed
from emps_design.discrepancy.search.outcome import FitsBySet, Outcome, set_of
from emps_design.discrepancy.search.pruning import pruned
from emps_design.discrepancy.search.starts import either_baseline, tangent
from emps_design.effects import Effect
from emps_design.effects.two_mass import has_play
from emps_design.progress import Progress

BEAM = (3, 2, 1)  # sets kept after the first round, the second, and any later one
A_FEW = len(BEAM)  # effects after which the search goes on from one set only
MOST_EFFECTS = 7
PASSES = 5  # times the search goes on, from an exchange, an effect that was far behind, or a curve
UNFINISHED = "interrupted: the search was not finished, what follows is what was known by then"

Step = tuple[frozenset[str], frozenset[str]]  # from the effects of one model to those of another


def begun(calibration: Calibration, progress: Progress, most: int) -> Outcome:
    """Extend the baseline of ``calibration`` up to ``most`` effects, while its judge accepts the best admissible one.

    What was found so :func:`finished` may still change. An interrupt from the keyboard ends either where it is.
    """
    baseline = calibration.baseline
    outcome = Outcome(calibration, (baseline,), {set_of(baseline): baseline}, {}, warnings=calibration.warnings)
    return until_interrupted(outcome, lambda path: _extend(outcome, path, progress, most))


def finished(
    outcome: Outcome, progress: Progress, before: Candidate | None = None, most: int = MOST_EFFECTS
) -> Outcome:
    """A search that was :func:`begun`, gone on with up to ``most`` effects until nothing is accepted any more.

    A model that was found ``before``, under other noise, is gone on from where the search leaves more than it.
    """
    if outcome.interrupted:
        return outcome

    def to_the_end(path: list[Fit]) -> None:
        if _found(outcome.calibration, path[-1]) >= A_FEW:
            _extend(outcome, path, progress, most)
        _go_on(outcome, path, progress, before, most)
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


def _go_on(outcome: Outcome, path: list[Fit], progress: Progress, before: Candidate | None, most: int) -> None:
    """Prune the last model of ``path``, exchange its effects and extend it again, until nothing leaves less."""
    calibration, tried = outcome.calibration, outcome.tried
    known, accepts = calibration.baseline.model.names, calibration.judge.accepts
    gone_on: dict[Step, float] = {}  # from one set to another, and its cost there
    for _ in range(PASSES):
        path += pruned(path[-1], known, tried, accepts)
        better = (
            _found_before(before, path[-1], tried)
            or _exchanged(calibration, path[-1], tried, progress)
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
