"""The model that follows the records most closely, also with effects that nothing shows to be the right ones.

A search ends where nothing more is a finding. Who wants to simulate the machine, and not to know what is wrong with it,
is served by whatever predicts more of the strokes that were not fitted to, whichever effect carries it.
"""

from __future__ import annotations

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit, fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.search.starts import screen, tangent
from emps_design.effects import Effect

MOST_ADDED = 12
TRIED = 2  # effects fitted in each round: those that gain most to first order
STEPS = 4  # of each of these fits


def described(found: Fit, library: tuple[Effect, ...]) -> Fit:
    """``found`` with whatever of ``library`` describes more of the fitting and the selecting strokes, fitted to all.

    Curves over position and velocity, and memories of the path since a reversal.
    """
    describing = tuple(effect for effect in library if _describes(effect))
    for _ in range(MOST_ADDED):
        promising = sorted(screen(found, describing, tangent(found)), key=lambda starts: -starts[0].gain)[:TRIED]
        fits = side_by_side(fit, [(starts[0].hypothesis, "fit", None, STEPS) for starts in promising])
        closer = [fitted for fitted in fits if _closer(fitted, found)]
        if not closer:
            break
        found = min(closer, key=lambda f: f.cost)
    return fit(found, part="used")


def _describes(effect: Effect) -> bool:
    """Whether ``effect`` is a curve over the state, or a memory of the path; a contact or a further line is none."""
    over_state = effect.over in ("q", "v") or effect.by_travel
    return effect.channel == "plant" and over_state and effect.guard is None and not effect.after


def _closer(more: Fit, less: Fit) -> bool:
    """Whether ``more`` leaves less than ``less`` of both kinds of strokes, and of all by what is worth a number."""
    both = more.cost_fit < less.cost_fit and more.cost_select < less.cost_select
    return both and more.cost < (1 - rules.WORTH_DESCRIBING) * less.cost
