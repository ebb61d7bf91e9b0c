"""The accepted effects: where each acts, its numbers and their deviations, and the gap without it and with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.discrepancy.checks.preparation import Preparation
from emps_design.discrepancy.explain.contribution import contribution, drawn, most_exercised
from emps_design.discrepancy.explain.extent import Extent, described, extent
from emps_design.discrepancy.explain.remarks import begun_earlier
from emps_design.discrepancy.model.fit import Fit, fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.result import Finding
from emps_design.discrepancy.search.acceptance import force_rms
from emps_design.discrepancy.validation.instants import deviation_in_time
from emps_design.discrepancy.validation.verdict import Validation
from emps_design.effects import Parameter, kind_of
from emps_design.errors import SimulationError

TRIED_STEPS, READJUSTING_STEPS = 1, 3  # of the fit without an effect: from either start, and from the better one


def findings(validation: Validation) -> tuple[Finding, ...]:
    """The accepted effects in the order found, each with the force gap before and after it."""
    extended, outcome = validation.extended, validation.outcome
    model = extended.model
    steps = (*(step.model for step in outcome.path), model)
    order = dict.fromkeys(name for step in steps for name in step.names)
    return tuple(_finding(validation, model.names.index(name)) for name in order if name in model.names)


def _finding(validation: Validation, index: int) -> Finding:
    extended, outcome = validation.extended, validation.outcome
    record = most_exercised(extended, index)
    effect, values = extended.model.effects[index], extended.model.parameters(record)[index]
    without = _without(extended, index, outcome.path[0])
    parameters = {
        p.name: {
            "value": float(values[place]),
            "std": deviation(extended, outcome.best, index, place, record),
            "unit": p.unit,
            **_per_record(p, extended.model.values[index][:, place]),
        }
        for place, p in enumerate(effect.parameters)
    }
    return Finding(
        effect=kind_of(effect.name),
        label=effect.label,
        channel=effect.channel,
        where=_where(extended, index, record),
        parameters=parameters,
        p_value=outcome.calibration.healthy.p_value(without.cost - extended.cost),
        gap_before=force_rms(without),
        gap_after=force_rms(extended),
        confirmed=validation.confirmed.get(effect.name),
        equivalents=tuple(dict.fromkeys(map(kind_of, validation.equivalents.get(effect.name, ())))),
        remedy=effect.remedy,
        note="; ".join(
            [_note(outcome.calibration.preparation, effect.channel, record), *begun_earlier(validation, index)]
        ),
    )


def deviation(fitted: Fit, before: Fit, index: int, place: int, record: int = 0) -> float:
    """Standard deviation of a number of ``fitted`` on ``record``, its baseline's with ``index`` -1.

    Of an instant, what covers all that leave as little. Else not less than the number moved since ``before``, the same
    effects on the fitting strokes alone: where play bounces, what a tiny change of a number does to the force says
    nothing of how well the record determines it.
    """
    linear, in_time = fitted.std(index, place, record), deviation_in_time(fitted, index, place, record)
    if in_time > 0.0:
        return max(linear, in_time)
    if linear == 0.0 or fitted.model.names != before.model.names:
        return linear
    now, then = (fit.model.baseline if index < 0 else fit.model.parameters(record)[index] for fit in (fitted, before))
    return max(linear, abs(float(now[place] - then[place])))


def _per_record(parameter: Parameter, values: np.ndarray) -> dict[str, Any]:
    """What is added for a number that is not one and the same: whether by nature, and that of each record."""
    entry: dict[str, Any] = {"per_record": True} if parameter.per_record else {}
    return entry | ({"values": values.tolist()} if np.ptp(values) > 0 else {})


def _without(extended: Fit, index: int, first: Fit) -> Fit:
    """The model without effect ``index``, the rest re-adjusted: against it stands what the effect itself is good for.

    An effect may have taken a baseline number far from where it is alone, in the ``first`` model: both are tried for a
    start, and the one goes on that leaves less after a step.
    """
    rest = extended.model.without(index)
    begins = (rest, replace(rest, baseline=first.model.baseline))
    tried = side_by_side(fit, [(extended.with_model(begin), "used", None, TRIED_STEPS) for begin in begins])
    runs = [fitted for fitted in tried if fitted.innovations]
    if not runs:  # what does not run without the effect stands against the baseline alone
        return first
    return fit(min(runs, key=lambda fitted: fitted.cost), "used", steps=READJUSTING_STEPS)


def _where(fitted: Fit, index: int, number: int) -> dict[str, Any]:
    """Where the force of effect ``index`` acts on record ``number``, with what its numbers' deviations leave open."""
    record = fitted.problem.records[number]

    def seen(hypothesis: Hypothesis) -> Extent | None:
        try:
            return extent(record, *contribution(hypothesis, index, number))
        except SimulationError:
            return None  # numbers at which the model is unstable do not describe this machine

    tried = side_by_side(seen, [(hypothesis,) for hypothesis in (fitted, *drawn(fitted, index))])
    found = [one for one in tried if one is not None]
    if not found:  # nothing runs without the effect: it acts wherever the model moves
        found.append(extent(record, fitted.run(number).force, fitted.problem.splits[number].used))
    where = described(found[0], found[1:])
    return where if len(fitted.problem.records) == 1 else {**where, "record": record.name}


def _note(preparation: Preparation, channel: str, record: int) -> str:
    if channel != "controller":
        alone = len(preparation.start.problem.records) == 1
        whose = "training record" if alone else "training records together"
        return f"gap of the {whose}, with the other effects refitted"
    noise = 1e3 * preparation.laws[record].noise
    return f"seen in u minus the controller's law, noise {noise:.2g} mV; the force balance holds with it"
