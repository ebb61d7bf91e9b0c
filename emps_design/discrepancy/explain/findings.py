"""The accepted effects: where each acts, its numbers and their deviations, and the gap without it and with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.discrepancy.explain.contribution import contribution, drawn, most_exercised
from emps_design.discrepancy.explain.extent import described, extent
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.problem import Fit, Problem, fit
from emps_design.discrepancy.result import Finding
from emps_design.discrepancy.search.acceptance import force_rms
from emps_design.discrepancy.search.outcome import Work
from emps_design.effects import Parameter
from emps_design.errors import SimulationError


def findings(work: Work, extended: Fit, equivalents: dict[str, list[str]]) -> tuple[Finding, ...]:
    """The accepted effects in the order found, each with the force gap before and after it."""
    problem, model = work.problem, extended.model
    order = [name for step in work.found.path for name in step.model.names]
    names = [name for name in dict.fromkeys(order) if name in model.names]
    result = []
    for name in names:
        index = model.names.index(name)
        record = most_exercised(problem, model, index)
        effect, values = model.effects[index], model.parameters(record)[index]
        without = _without(work, model, index)
        gain = without.cost - extended.cost
        parameters = {
            p.name: {
                "value": float(values[place]),
                "std": deviation(extended, work.found.best, index, place, record),
                "unit": p.unit,
                **_per_record(p, model.values[index][:, place]),
            }
            for place, p in enumerate(effect.parameters)
        }
        result.append(
            Finding(
                effect=name,
                label=effect.label,
                channel=effect.channel,
                where=_where(problem, extended, index, record),
                parameters=parameters,
                p_value=work.healthy.p_value(gain),
                gap_before=force_rms(problem, without),
                gap_after=force_rms(problem, extended),
                equivalents=tuple(equivalents.get(name, ())),
                remedy=effect.remedy,
                note=_note(work, effect.channel, record),
            )
        )
    return tuple(result)


def deviation(fitted: Fit, before: Fit, index: int, place: int, record: int = 0) -> float:
    """Standard deviation of a number of ``fitted`` on ``record``, its baseline's with ``index`` -1.

    Not less than the number moved since ``before``, the same effects on the fitting strokes alone: where play bounces,
    what a tiny change of a number does to the force says nothing of how well the record determines it.
    """
    linear = fitted.std(index, place, record)
    if linear == 0.0 or fitted.model.names != before.model.names:
        return linear
    now, then = (fit.model.baseline if index < 0 else fit.model.parameters(record)[index] for fit in (fitted, before))
    return max(linear, abs(float(now[place] - then[place])))


def _per_record(parameter: Parameter, values: np.ndarray) -> dict[str, Any]:
    """What is said besides of a number that is not one and the same: whether by nature, and that of each record."""
    said: dict[str, Any] = {"per_record": True} if parameter.per_record else {}
    return said | ({"values": values.tolist()} if np.ptp(values) > 0 else {})


def _without(work: Work, model: Candidate, index: int) -> Fit:
    """``model`` without effect ``index``, the rest re-adjusted: against it stands what the effect itself is good for.

    An effect may have taken a baseline number far from where it is alone: both are tried for a start.
    """
    rest, first = model.without(index), work.found.path[0]
    tried = [
        fit(work.problem, start, part="used", steps=5) for start in (rest, replace(rest, baseline=first.model.baseline))
    ]
    # What does not run without the effect stands against the baseline alone.
    return min((fitted for fitted in tried if fitted.innovations), key=lambda fitted: fitted.cost, default=first)


def _where(problem: Problem, fitted: Fit, index: int, number: int) -> dict[str, Any]:
    """Where the force of effect ``index`` acts on record ``number``, with what its numbers' deviations leave open."""
    found, record = [], problem.records[number]
    for model in (fitted.model, *drawn(problem, fitted, index)):
        try:
            found.append(extent(record, *contribution(problem, model, index, number)))
        except SimulationError:
            continue  # numbers at which the model is unstable do not describe this machine
    if not found:  # nothing runs without the effect: it acts wherever the model moves
        found.append(extent(record, problem.run(fitted.model, number).force, problem.splits[number].used))
    said = described(found[0], found[1:])
    return said if len(problem.records) == 1 else {**said, "record": record.name}


def _note(work: Work, channel: str, record: int) -> str:
    if channel != "controller":
        whose = "training record" if len(work.problem.records) == 1 else "training records together"
        return f"gap of the {whose}, with the other effects refitted"
    noise = 1e3 * work.checks[record].noise
    return f"seen in u minus the controller's law, noise {noise:.2g} mV; the force balance holds with it"
