"""Effects that could stand in the place of a finding as far as the records tell."""

from __future__ import annotations

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit, admissible, evaluate, fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.noise_floor import LEFT, floor_of_residual
from emps_design.discrepancy.search.outcome import Outcome, set_of

STEPS = 8


def equivalents(outcome: Outcome) -> dict[str, list[str]]:
    """For each accepted effect, those that could stand in its place as far as these records tell."""
    best, judge = outcome.best, outcome.calibration.judge
    threshold, found = judge.healthy.threshold, {}
    for name in best.model.names:
        others = set_of(best) - {name}
        without = outcome.tried.get(others, outcome.path[0]).cost
        # At the floor chance is the only excuse; above it, what is missing may favour either by a few percent.
        margin = threshold
        if not judge.at_floor(best):
            margin = max(threshold, rules.EQUIVALENT * (without - best.cost))
        rivals = [
            (rival.cost, next(iter(key - others)))
            for key, rival in outcome.tried.items()
            if len(key) == len(others) + 1 and others < key and name not in key and rival.cost <= best.cost + margin
        ]
        found[name] = [rival for _, rival in sorted(rivals)]
    return found


def alike_in_company(outcome: Outcome, stands: Fit) -> dict[str, list[str]]:
    """The same for what ``stands`` beside something unknown, with what it leaves as the noise.

    Tried in the place of each finding are the effects it is known to be confused with, from their own best fit.
    """
    noise = floor_of_residual(stands.left(), stands.problem.period, LEFT).whitening
    weighed, found = stands.problem.with_whitening(noise), {}
    own = evaluate(Hypothesis(weighed, stands.model))
    for index, effect in enumerate(stands.model.effects):
        rest = stands.model.without(index)
        others = [
            (other, values)
            for key, alone in outcome.tried.items()
            for other, values in zip(alone.model.effects, alone.model.values, strict=True)
            if len(key) == len(outcome.path[0].model.names) + 1 and other.name not in stands.model.names
            if effect.confusable(other)
        ]
        begins = [rest, *(rest.with_effect(other, values) for other, values in others)]
        without, *rivals = side_by_side(fit, [(Hypothesis(weighed, model), "used", None, STEPS) for model in begins])
        margin = max(outcome.calibration.healthy.threshold, rules.EQUIVALENT * (without.cost - own.cost))
        alike = [rival for rival in rivals if admissible(rival) and rival.cost <= own.cost + margin]
        found[effect.name] = [rival.model.names[-1] for rival in sorted(alike, key=lambda rival: rival.cost)]
    return found
