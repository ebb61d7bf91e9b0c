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

from emps_design.discrepancy.missing_force import missing_force
from emps_design.discrepancy.problem import Fit, Problem, fit
from emps_design.discrepancy.propose import starts, tangent
from emps_design.effects import Effect

BEAM = 3
RIVAL = 0.5  # a set joins the beam only if it explains at least this share of what the best set explains
REFINED = 2  # starts of each effect that are worth a short fit
SMALLEST_GAIN = 30.0  # in whitened cost; below the chance level of a search over hundreds of shapes
WORTH_FITTING = 0.05  # of the largest first-order gain
FINALISTS = 7  # effects worth a full fit
MOST_EFFECTS = 6
CORES = 2

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Search:
    """All models that were fitted, by their set of effects, and the ``path`` of best models, baseline first."""

    path: tuple[Fit, ...]
    tried: dict[frozenset[str], Fit] = field(repr=False)

    @property
    def best(self) -> Fit:
        """The model accepted last."""
        return self.path[-1]


def extensions(problem: Problem, current: Fit, library: tuple[Effect, ...]) -> list[Fit]:
    """Fit ``current`` with those effects of ``library`` added that promise a gain; best first."""
    missing = missing_force(problem, current.model)
    absorbed = tangent(problem, current)
    absent = [effect for effect in library if effect.name not in current.model.names]
    for effect in absent:  # make the plants here: the threads below only read them
        _warm(problem, current, effect)
    run = Parallel(n_jobs=CORES, prefer="threads")
    started = run(delayed(starts)(problem, current, effect, missing, absorbed) for effect in absent)
    best = max((found[0].gain for found in started if found), default=0.0)
    least = max(SMALLEST_GAIN, WORTH_FITTING * best)
    worth = [start.model for found in started for start in found[:REFINED] if start.gain >= least]
    short = run(delayed(fit)(problem, model, steps=3) for model in worth)
    by_name = {}
    for short_fit in sorted(short, key=lambda f: -f.cost_fit):
        by_name[short_fit.model.names[-1]] = short_fit
    ranked = sorted(by_name.values(), key=lambda f: f.cost_fit)
    full = run(delayed(fit)(problem, f.model) for f in ranked[:FINALISTS])
    return sorted([*full, *ranked[FINALISTS:]], key=lambda f: f.cost)


def _warm(problem: Problem, current: Fit, effect: Effect) -> None:
    values = [min(max(p.starts[0] if p.starts else p.scale, p.lower), p.upper) for p in effect.parameters]
    problem.plant(current.model.with_effect(effect, np.array([values])))


def search(
    problem: Problem,
    baseline: Fit,
    library: tuple[Effect, ...],
    accept: Callable[[Fit, Fit], bool],
    progress: Progress | None = None,
) -> Search:
    """Extend ``baseline`` while ``accept(better, worse)`` holds."""
    tried: dict[frozenset[str], Fit] = {frozenset(): baseline}
    path, beam = [baseline], [baseline]
    for depth in range(MOST_EFFECTS):
        pool: dict[frozenset[str], Fit] = {}
        for number, member in enumerate(beam):
            if progress:
                progress(f"trying {len(library)} effects, round {depth + 1}", number / len(beam))
            for extended in extensions(problem, member, library):
                key = frozenset(extended.model.names)
                if key not in pool or extended.cost < pool[key].cost:
                    pool[key] = extended
        tried.update({key: f for key, f in pool.items() if key not in tried or f.cost < tried[key].cost})
        ranked = sorted(pool.values(), key=lambda f: f.cost)
        if not ranked or not accept(ranked[0], path[-1]):
            break
        path.append(ranked[0])
        best_gain = path[0].cost - ranked[0].cost
        beam = [f for f in ranked[:BEAM] if path[0].cost - f.cost >= RIVAL * best_gain]
    return Search(tuple(path), tried)
