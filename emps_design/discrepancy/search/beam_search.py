"""Which effects to try together: every effect of the library fitted in closed loop, the best few sets extended again.

A beam search over sets of effects. Each round adds every effect to the best few models so far, refits everything, and
keeps the best few sets: pairs in which neither effect stands out alone are found because a round starts from several
first guesses. Poor fits are given up early (successive halving).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from joblib import Parallel, delayed

from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.missing_force import missing_force
from emps_design.discrepancy.model.problem import Descent, Fit, Problem, descend, evaluate, fit, gather
from emps_design.discrepancy.search.starts import Start, Tangent, bent, starts, tangent
from emps_design.effects import Effect, Motion
from emps_design.records import Record

BEAM = (3, 2, 1)  # sets kept after the first round, the second, and any later one
RIVAL = 0.5  # a set joins the beam, an effect the full fits, with this share of what the best one explains
CLOSE_RIVAL = 0.9  # of what an effect explains, from which on another one in its place is fitted as long as it was
REFINED = 2  # starts of each effect that are worth a short fit
SMALLEST_GAIN = 30.0  # in whitened cost; below the chance level of a search over hundreds of shapes
WORTH_FITTING = 0.05  # of the largest first-order gain
SHORT_STEPS = 4
FINALISTS = 4  # effects worth a full fit
MOST_EFFECTS = 7
ENOUGH_ROUNDS = 3  # after which a search that explained less than LEAST_EXPLAINED of the excess is given up
LEAST_EXPLAINED = 0.4
MOST_WALKS = 8
BENT_EFFECTS, BENT_STARTS = 2, 6  # fitted in full where the gap bent the baseline
REVISED = 4  # other shapes of an effect that are fitted when it is accepted
STILL_PAYS = 0.005  # of the cost
CORES = 2

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Search:
    """The ``path`` of best models, baseline first; all sound models fitted in full by their set of effects; and what
    each effect gained alone in the first round [whitened cost]."""

    path: tuple[Fit, ...]
    tried: dict[frozenset[str], Fit] = field(repr=False)
    alone: dict[str, float] = field(default_factory=dict, repr=False)
    interrupted: bool = False

    @property
    def best(self) -> Fit:
        """The model accepted last."""
        return self.path[-1]


def screen(problem: Problem, current: Fit, library: tuple[Effect, ...], absorbed: Tangent) -> list[list[Start]]:
    """Starts of each effect of ``library`` that ``current`` does not have, the most promising of each first."""
    missing = missing_force(problem, current.model)
    absent = [effect for effect in library if effect.name not in current.model.names]
    for effect in absent:  # make the plants here: the threads below only read them
        _warm(problem, current, effect)
    tried = Parallel(n_jobs=CORES, prefer="threads")(
        delayed(starts)(problem, current, effect, missing, absorbed) for effect in absent
    )
    return [found for found in tried if found]


def extensions(
    problem: Problem, current: Fit, screened: list[list[Start]], absorbed: Tangent
) -> tuple[list[Fit], dict[str, float]]:
    """Fit those of the ``screened`` starts on top of ``current`` that promise a gain; best first.

    A short fit moves the new effect alone and lets the tangent stand for what the rest absorbs; the best few effects
    are then fitted with everything free. Also returns what each effect gained in its short fit [whitened cost].
    """
    best = max((found[0].gain for found in screened), default=0.0)
    least = max(SMALLEST_GAIN, WORTH_FITTING * best)
    worth = [start for found in screened for start in found[:REFINED] if start.gain >= least]
    run = Parallel(n_jobs=CORES, prefer="threads")
    leading: dict[str, Descent] = {}
    for short in run(delayed(_short_fit)(problem, start, absorbed) for start in worth):
        name = short.model.names[-1]
        if name not in leading or short.cost < leading[name].cost:
            leading[name] = short
    before = float(absorbed.residual @ absorbed.residual)
    gains = {found[0].model.names[-1]: found[0].gain for found in screened}
    gains |= {name: before - short.cost for name, short in leading.items()}
    ranked = sorted((s for s in leading.values() if plausible(problem, s.model)), key=lambda short: short.cost)
    finalists = [s for s in ranked[:FINALISTS] if before - s.cost >= RIVAL * (before - ranked[0].cost)]
    begins = [s.model for s in finalists]
    if bent(current, before / absorbed.residual.size):
        # A baseline bent by the gap leads short fits astray: the leading effects are fitted from several starts.
        leaders = sorted(screened, key=lambda found: -found[0].gain)[:BENT_EFFECTS]
        begins += [start.model for found in leaders for start in found[:BENT_STARTS] if plausible(problem, start.model)]
    return sorted(run(delayed(fit)(problem, model) for model in begins), key=lambda f: f.cost), gains


def _settled(problem: Problem, fitted: Fit) -> Fit:
    """Fit on until it pays no more: a valley that is not walked to its end looks like another effect."""
    for _ in range(MOST_WALKS):
        further = fit(problem, fitted.model)
        if further.cost > (1 - STILL_PAYS) * fitted.cost:
            return min(fitted, further, key=lambda f: f.cost)
        fitted = further
    return fitted


def _revised(problem: Problem, fitted: Fit) -> Fit:
    """Look again at the shapes of the effect found last, now that all numbers fit it.

    A descent does not cross to another exponent, nor to another stroke of the time at which something happened.
    """
    model = fitted.model
    effect, values = model.effects[-1], model.values[-1]
    shapes = [i for i, p in enumerate(effect.parameters) if p.discrete or (p.per_record and p.unit == "s")]
    if not shapes:
        return fitted
    without = evaluate(problem, model.without(len(model.effects) - 1))
    if not without.innovations:
        return fitted
    found = starts(problem, without, effect, missing_force(problem, without.model), tangent(problem, without))
    other = [s for s in found if s.anchored and not np.array_equal(s.model.values[-1][:, shapes], values[:, shapes])]
    tried = Parallel(n_jobs=CORES, prefer="threads")(delayed(fit)(problem, s.model) for s in other[:REVISED])
    best = min((fitted, *tried), key=lambda f: f.cost)
    return fitted if best is fitted or not admissible(problem, best) else _settled(problem, best)


def _finished(problem: Problem, fitted: Fit) -> Fit:
    """``fitted`` walked to the end of its valley, other shapes tried; as it was where that leaves its physics."""
    further = _revised(problem, _settled(problem, fitted))
    return further if admissible(problem, further) else fitted


def _late(
    problem: Problem, current: Fit, sound: dict[frozenset[str], Fit], accept: Callable[[Fit, Fit], bool]
) -> list[Fit]:
    """The best of ``sound``, walked to its end, if it is accepted then: an instant may have been a stroke off."""
    best = min(sound.values(), key=lambda f: f.cost, default=None)
    left = current.cost - problem.samples("used")
    if best is None or left <= 0 or current.cost - best.cost < RIVAL * left:
        return []
    further = _finished(problem, best)
    return [further] if accept(further, current) else []


def _pruned(problem: Problem, best: Fit, known: tuple[str, ...], accept: Callable[[Fit, Fit], bool]) -> list[Fit]:
    """``best`` without one effect after the other that is no finding beside the rest, ``known`` ones kept.

    What was accepted first may be a stand-in for what was found after it.
    """
    path: list[Fit] = []
    while len(best.model.effects) > len(known) + 1:
        smaller = [best.model.without(i) for i, name in enumerate(best.model.names) if name not in known]
        for model in smaller:
            problem.plant(model)
        rests = Parallel(n_jobs=CORES, prefer="threads")(delayed(fit)(problem, model) for model in smaller)
        idle = [rest for rest in rests if admissible(problem, rest) and not accept(best, rest)]
        if not idle:
            break
        best = _finished(problem, min(idle, key=lambda f: f.cost))
        path.append(best)
    return path


def _rivals(problem: Problem, path: list[Fit], tried: dict[frozenset[str], Fit]) -> dict[frozenset[str], Fit]:
    """Models with another effect in the place of one of the best model's that come close, walked to their ends too.

    Else the effect found first would win by having been fitted longer.
    """
    best, names = path[-1], frozenset(path[-1].model.names)
    close = {}
    for name in names - set(path[0].model.names):
        others = names - {name}
        without = tried.get(others, path[0]).cost
        for key, rival in tried.items():
            alike = len(key) == len(names) and others < key and key != names
            if alike and without - rival.cost >= CLOSE_RIVAL * (without - best.cost):
                close[key] = _finished(problem, rival)
    return close


def _short_fit(problem: Problem, start: Start, absorbed: Tangent) -> Descent:
    own = tuple(slot for slot in start.model.slots() if slot.effect == len(start.model.effects) - 1)
    if not start.anchored:
        return descend(start.model, own, lambda m: gather(problem, problem.whitened(m), "fit"), SHORT_STEPS)
    return descend(start.model, own, lambda m: absorbed.free(gather(problem, problem.whitened(m), "fit")), SHORT_STEPS)


def _warm(problem: Problem, current: Fit, effect: Effect) -> None:
    values = [min(max(p.starts[0] if p.starts else p.scale, p.lower), p.upper) for p in effect.parameters]
    problem.plant(current.model.with_effect(effect, np.array([values])))


def search(
    problem: Problem,
    baseline: Fit,
    library: tuple[Effect, ...],
    screened: list[list[Start]],
    accept: Callable[[Fit, Fit], bool],
    progress: Progress | None = None,
) -> Search:
    """Extend ``baseline`` while ``accept(better, worse)`` holds for the best admissible extension.

    ``screened`` are the starts on top of the baseline. An interrupt from the keyboard ends the search where it is.
    """
    tried: dict[frozenset[str], Fit] = {frozenset(baseline.model.names): baseline}
    alone: dict[str, float] = {}
    path, beam = [baseline], [baseline]
    try:
        while len(path) <= MOST_EFFECTS:
            pool: dict[frozenset[str], Fit] = {}
            for i, member in enumerate(beam):
                if progress:
                    names = " + ".join(member.model.names) or "the baseline"
                    progress(f"round {len(path)}: {names}, and what else", 1 - 0.75 ** (len(path) - 1 + i / len(beam)))
                absorbed = tangent(problem, member)
                starting = screened if member is baseline else screen(problem, member, library, absorbed)
                fits, gains = extensions(problem, member, starting, absorbed)
                alone = alone or gains
                for extended in fits:
                    key = frozenset(extended.model.names)
                    if key not in pool or extended.cost < pool[key].cost:
                        pool[key] = extended
            sound = {key: f for key, f in pool.items() if admissible(problem, f)}
            tried.update({key: f for key, f in sound.items() if key not in tried or f.cost < tried[key].cost})
            ranked = [f for f in sorted(sound.values(), key=lambda f: f.cost) if accept(f, path[-1])]
            if not ranked:
                ranked = _late(problem, path[-1], sound, accept)
            if not ranked:
                break
            width = BEAM[min(len(path) - 1, len(BEAM) - 1)]
            gain = path[0].cost - ranked[0].cost
            leading = [f for f in ranked[:width] if path[0].cost - f.cost >= RIVAL * gain]
            beam = sorted((_finished(problem, f) for f in leading), key=lambda f: f.cost)
            path.append(beam[0])
            gain = path[0].cost - path[-1].cost
            if len(path) > ENOUGH_ROUNDS and gain < LEAST_EXPLAINED * (path[0].cost - problem.samples("used")):
                break
        path += _pruned(problem, path[-1], baseline.model.names, accept)
        tried |= _rivals(problem, path, tried)
    except KeyboardInterrupt:
        return Search(tuple(path), tried, alone, interrupted=True)
    return Search(tuple(path), tried, alone)


def refitted(problem: Problem, model: Candidate) -> Fit:
    """``model`` fitted to all that may be used; its own numbers where that leaves its physics."""
    found = fit(problem, model, part="used")
    return found if admissible(problem, found) else evaluate(problem, model, found.slots, found.covariance)


def admissible(problem: Problem, fitted: Fit) -> bool:
    """Whether every number of ``fitted`` is inside its bounds and still means its effect."""
    return not on_bound(fitted) and plausible(problem, fitted.model)


def plausible(problem: Problem, model: Candidate) -> bool:
    """Whether the numbers of every effect still mean that effect on the motion of some record."""
    motions = [_motion(record) for record in problem.records]
    for index, effect in enumerate(model.effects):
        if effect.plausible is None:
            continue
        rows = [model.parameters(i)[index] for i in range(len(motions))]
        tables = [{p.name: float(x) for p, x in zip(effect.parameters, row, strict=True)} for row in rows]
        if not any(effect.plausible(table, motion) for table, motion in zip(tables, motions, strict=True)):
            return False
    return True


def _motion(record: Record) -> Motion:
    v = np.gradient(record.q, record.period)
    return Motion(record.t, record.q, v, np.gradient(v, record.period), v, record.period, record.u)


def on_bound(fitted: Fit) -> bool:
    """Whether a free parameter of an effect ended on its bound, where the physics it stands for ends."""
    for slot, value in zip(fitted.slots, fitted.model.vector(fitted.slots), strict=True):
        near = 1e-6 * slot.scale
        if slot.effect >= 0 and (value <= slot.quantity.lower + near or value >= slot.quantity.upper - near):
            return True
    return False
