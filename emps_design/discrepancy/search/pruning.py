"""What was accepted first may be a stand-in for what was found after it: a model without what it no longer needs."""

from __future__ import annotations

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit, admissible, fit, play_anew
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.acceptance import Accept
from emps_design.discrepancy.search.extension import converged
from emps_design.discrepancy.search.outcome import FitsBySet, set_of


def pruned(best: Fit, known: tuple[str, ...], tried: FitsBySet, accept: Accept) -> list[Fit]:
    """``best`` without one effect after the other that is no finding beside the rest, ``known`` ones kept.

    The rest may have been ``tried`` before, and have found a better place than the one it is left in.
    """
    path: list[Fit] = []
    while len(best.model.effects) > len(known) + 1:
        smaller = [best.model.without(i) for i, name in enumerate(best.model.names) if name not in known]
        # With as much care as the best one was fitted, or every effect would look needed.
        careful = len(best.model.effects) <= rules.CREDIBLE
        rests = side_by_side(_fitted_anew if careful else fit, [(best.with_model(model),) for model in smaller])
        sound = [_better(rest, tried) for rest in rests if admissible(rest)]
        idle = [rest for rest in sound if not accept(best, rest)]
        if not idle and sound:
            cheapest = _reshaped(best, min(sound, key=lambda f: f.cost))
            idle = [] if accept(best, cheapest) else [cheapest]
        if not idle:
            break
        best = converged(min(idle, key=lambda f: f.cost))
        path.append(best)
    return path


def _fitted_anew(hypothesis: Hypothesis) -> Fit:
    """Fit a model, and play in it anew."""
    return play_anew(fit(hypothesis))


def _better(fitted: Fit, tried: FitsBySet) -> Fit:
    """``fitted``, or what was ``tried`` with the same effects where that leaves less."""
    return min((fitted, tried.get(set_of(fitted), fitted)), key=lambda f: f.cost)


def _reshaped(best: Fit, rest: Fit) -> Fit:
    """``rest`` with what is easily confused with the effect of ``best`` it lacks fitted anew, other shapes tried.

    Beside that effect it had only a part to play, and its shape may be that of the part.
    """
    dropped = next(effect for effect in best.model.effects if effect.name not in rest.model.names)
    for effect, values in zip(rest.model.effects, rest.model.values, strict=True):
        if effect.confusable(dropped):
            last = rest.model.without_named([effect.name]).with_effect(effect, values)
            again = converged(fit(rest.with_model(last)))
            rest = min((rest, again), key=lambda f: f.cost) if admissible(again) else rest
    return rest
