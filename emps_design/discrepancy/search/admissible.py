"""Whether the numbers that fit still mean the effects they belong to."""

from __future__ import annotations

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit, evaluate, fit
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.effects import Motion
from emps_design.records import Record


def admissible(fitted: Fit) -> bool:
    """Whether every number of ``fitted`` is inside its bounds and still means its effect."""
    return not on_bound(fitted) and plausible(fitted)


def plausible(hypothesis: Hypothesis) -> bool:
    """Whether the numbers of every effect still mean that effect on the motion of some record."""
    model, motions = hypothesis.model, [_motion(record) for record in hypothesis.problem.records]
    for index, effect in enumerate(model.effects):
        if effect.plausible is None:
            continue
        rows = [model.parameters(i)[index] for i in range(len(motions))]
        tables = [{p.name: float(x) for p, x in zip(effect.parameters, row, strict=True)} for row in rows]
        if not any(effect.plausible(table, motion) for table, motion in zip(tables, motions, strict=True)):
            return False
    return True


def on_bound(fitted: Fit) -> bool:
    """Whether a free parameter of an effect ended on its bound, where the physics it stands for ends."""
    for slot, value in zip(fitted.slots, fitted.model.vector(fitted.slots), strict=True):
        near = rules.ON_BOUND * slot.magnitude
        if slot.effect >= 0 and (value <= slot.quantity.lower + near or value >= slot.quantity.upper - near):
            return True
    return False


def refitted(hypothesis: Hypothesis) -> Fit:
    """A model fitted to all that may be used; with its own numbers where that leaves its physics."""
    found = fit(hypothesis, part="used")
    return found if admissible(found) else evaluate(hypothesis, found.slots, found.covariance)


def _motion(record: Record) -> Motion:
    v = np.gradient(record.q, record.period)
    return Motion(record.t, record.q, v, np.gradient(v, record.period), v, record.period, record.u)
