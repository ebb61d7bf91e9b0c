"""What adding one effect after the other cannot do: another effect, or another shape, in the place of one found.

What was found first was fitted while the rest was missing, and may stand in for part of it: a lag for a delay, a
resonance at the frequency that made up best for a friction not known yet. Beside the others its own residual is clear.
"""

from __future__ import annotations

from emps_design.discrepancy.model.fit import Fit, admissible, evaluate
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.extension import extended
from emps_design.discrepancy.search.starts import either_baseline
from emps_design.effects import Effect


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
