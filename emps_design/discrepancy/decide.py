"""Which effects to accept: every effect of the library refitted in closed loop, the best few extended again.

A beam search over sets of effects: each round adds every effect to the best few models so far, refits everything, and
keeps the best few sets. Pairs in which neither effect stands out alone are found because the second round starts from
several first guesses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from emps_design.discrepancy.missing_force import missing_force
from emps_design.discrepancy.problem import Fit, Problem, fit
from emps_design.discrepancy.propose import starts, tangent
from emps_design.effects import Effect

BEAM = 3
REFINED = 2  # starts of each effect that are worth a fit
MOST_EFFECTS = 4

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
    """Fit ``current`` with each effect of ``library`` added that it does not have yet; best first."""
    missing = missing_force(problem, current.model)
    absorbed = tangent(problem, current.model)
    fits = []
    for effect in library:
        if effect.name in current.model.names:
            continue
        ranked = starts(problem, current.model, effect, missing, absorbed, REFINED)
        refined = [fit(problem, start.model) for start in ranked]
        if refined:
            fits.append(min(refined, key=lambda f: f.cost_fit))
    return sorted(fits, key=lambda f: f.cost)


def search(
    problem: Problem,
    baseline: Fit,
    library: tuple[Effect, ...],
    accept: Callable[[Fit, Fit], bool],
    finished: Callable[[Fit], bool],
    progress: Progress | None = None,
) -> Search:
    """Extend ``baseline`` while ``accept(better, worse)`` holds and the best model is not ``finished``."""
    tried: dict[frozenset[str], Fit] = {frozenset(): baseline}
    path, beam = [baseline], [baseline]
    for depth in range(MOST_EFFECTS):
        if finished(path[-1]):
            break
        pool: dict[frozenset[str], Fit] = {}
        for number, member in enumerate(beam):
            if progress:
                progress(f"trying {len(library)} effects, round {depth + 1}", number / len(beam))
            for extended in extensions(problem, member, library):
                key = frozenset(extended.model.names)
                if key not in pool or extended.cost < pool[key].cost:
                    pool[key] = extended
        tried.update(pool)
        ranked = sorted(pool.values(), key=lambda f: f.cost)
        if not ranked or not accept(ranked[0], path[-1]):
            break
        path.append(ranked[0])
        beam = ranked[:BEAM]
    return Search(tuple(path), tried)
