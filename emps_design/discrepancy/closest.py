"""The model that follows the records most closely, also with effects that are no findings.

A search ends when no further effect is a finding. To simulate the machine rather than explain it, any effect is useful
that predicts more of the strokes not fitted. The model is compared with the named one on the held-out data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.fit import Fit, fit
from emps_design.discrepancy.gap import Gap, GapComparison, compare, compare_on
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.starts import screen, tangent
from emps_design.discrepancy.verdict import Validation
from emps_design.discrepancy.words import label_of
from emps_design.effects import Effect
from emps_design.quantities import inside, rounded

FILE = "closest_model.toml"
UNNEEDED = "the residual of the model is noise: no model can follow the records more closely"


def describe(current: Fit, library: tuple[Effect, ...]) -> Fit:
    """``current`` with effects of ``library`` that reduce the residual of fitting and selecting strokes, fitted to all.

    The effects are curves over position and velocity, and functions of the path since a reversal.
    """
    describing = tuple(effect for effect in library if _describes(effect))
    for _ in describing:
        promising = sorted(screen(current, describing, tangent(current)), key=lambda starts: -starts[0].gain)[
            : rules.FEW
        ]
        fits = side_by_side(fit, [(starts[0].hypothesis, "fit", None, rules.SHORT_STEPS) for starts in promising])
        closer = [fitted for fitted in fits if _closer(fitted, current)]
        if not closer:
            break
        current = min(closer, key=lambda f: f.cost)
    return fit(current, part="used")


def _describes(effect: Effect) -> bool:
    """Whether ``effect`` is a function of state or path, without contacts and not a further line of another effect."""
    over_state = effect.over in ("q", "v") or effect.solver.by_travel
    return effect.channel == "plant" and over_state and effect.solver.guard is None and not effect.search.after


def _closer(more: Fit, less: Fit) -> bool:
    """Whether ``more`` has a lower cost than ``less`` on fitting and selecting strokes, and a clearly lower sum."""
    both = more.cost_fit < less.cost_fit and more.cost_select < less.cost_select
    return both and more.cost < (1 - rules.WORTH_DESCRIBING) * less.cost


@dataclass(frozen=True)
class Closest:
    """An ``axis`` whose simulation follows the records more closely than the named model's, and by how much.

    ``effects`` are the labels of its effects that the named model lacks. If there is no such model, ``axis`` is None
    and ``text`` says why. ``train`` and ``holdout`` have its force error as ``extended``; ``share`` is the force error
    divided by the rms motor force, on the held-out or else the training record.
    """

    text: str
    axis: Axis | None = None
    effects: tuple[str, ...] = ()
    train: Gap | None = None
    holdout: Gap | None = None
    share: float | None = None

    def to_dict(self, unit: str, written: bool) -> Mapping[str, Any]:
        """The document's ``closest``: gaps [``unit``] in the contract's form, the effects, the file if ``written``."""
        judged = {name: gap for name, gap in (("train", self.train), ("holdout", self.holdout)) if gap is not None}
        gaps = {
            name: {"unit": unit, **{part: gap.to_dict(measure) for part, gap in judged.items()}}
            for name, measure in (("gap", ""), ("gap_inverse_60hz", "_60hz"))
        }
        known = {} if self.axis is None else {"effects": list(self.effects), **gaps, "share_of_force": self.share}
        return {"text": self.text, "model_file": FILE if written and self.axis is not None else None, **known}


def closest_of(validation: Validation) -> Closest:
    """The model that follows the records most closely, if its error on the held-out data is below the named model's."""
    outcome, named = validation.outcome, validation.extended
    judge = outcome.judge
    if not judge.leaves_structure(named):
        return Closest(UNNEEDED)
    problem, data = named.problem, outcome.preparation.held_out
    model = describe(outcome.best, outcome.preparation.library).model
    baseline = validation.baseline.model
    train = compare(problem, baseline, model)
    held_out = None
    if data is not None:
        held_out = compare_on(data.with_whitening(problem.whitening), baseline, model)
    judged, before = held_out or train, validation.held_out or validation.train
    where = "training" if held_out is None else "held-out"
    units = problem.axis.units
    error, instead = (units.quantity(gap.extended, "N", partial(rounded, places=3)) for gap in (judged.gap, before.gap))
    errors = f"the {where} {units.word('force')} error is {error} instead of {instead}"
    if judged.gap.extended >= before.gap.extended:
        return Closest(f"curves over position, velocity and path follow the records no more closely: {errors}")
    more = tuple(dict.fromkeys(label_of(name, units) for name in model.names if name not in named.model.names))
    added = ", ".join(map(inside, more)) or "other numbers"
    text = f"with {added} {errors}; this describes the machine without naming a cause"
    axis = judged.extended.to_axis(problem.axis)
    return Closest(text, axis, more, train.gap, None if held_out is None else held_out.gap, _share(judged))


def _share(judged: GapComparison) -> float:
    """Force error of the closed loop divided by the rms motor force, on the used samples of the compared record."""
    prediction = judged.prediction
    error = (prediction.measured - prediction.extended)[prediction.used]
    return float(np.linalg.norm(error) / np.linalg.norm(prediction.measured[prediction.used]))
