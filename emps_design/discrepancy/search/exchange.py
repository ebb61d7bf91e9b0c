"""What adding one effect after the other cannot do: another effect, or another shape, in the place of one found.

What was found first was fitted while the rest was missing, and may stand in for part of it: a lag for a delay, a
resonance at the frequency that made up best for a friction not known yet. Beside the others its own residual is clear.
"""

from __future__ import annotations

from collections.abc import Callable

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit, admissible, evaluate
from emps_design.discrepancy.search.extension import converged, extensions
from emps_design.discrepancy.search.starts import screen, tangent
from emps_design.effects import Effect


def exchanges(best: Fit, known: tuple[str, ...], library: tuple[Effect, ...]) -> list[Fit]:
    """Models with what is easily confused with an effect of ``best``, or that effect anew, in its place.

    ``known`` effects stay. The others keep their numbers until everything is fitted.
    """
    found = []
    for index, effect in enumerate(best.model.effects):
        if effect.name in known:
            continue
        rest = evaluate(best.with_model(best.model.without(index)))
        if rest.innovations:
            absorbed = tangent(rest)
            found += extensions(rest, screen(rest, _alike(effect, library), absorbed), absorbed)[0]
    return [fitted for fitted in found if admissible(fitted)]


def _alike(effect: Effect, library: tuple[Effect, ...]) -> tuple[Effect, ...]:
    return tuple(
        other
        for other in library
        if other is effect or other.name in effect.confused_with or effect.name in other.confused_with
    )
