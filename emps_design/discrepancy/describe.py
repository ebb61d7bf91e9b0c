"""Findings in words and numbers: where, how large, what it costs, what it could be instead, what was not seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.discrepancy.candidate import BASELINE, Candidate
from emps_design.discrepancy.confirm import Asked
from emps_design.discrepancy.contribution import contribution, drawn
from emps_design.discrepancy.decide import Search
from emps_design.discrepancy.diagnosis import Finding
from emps_design.discrepancy.healthy import LEVEL, Healthy
from emps_design.discrepancy.judge import WORTH, WORTH_AT_FLOOR, Judge, force_rms
from emps_design.discrepancy.law_check import LawCheck
from emps_design.discrepancy.locate import View, described, extent, force_map, views
from emps_design.discrepancy.missing_force import MissingForce, missing_force
from emps_design.discrepancy.noise import Floor
from emps_design.discrepancy.problem import Fit, Problem, fit
from emps_design.discrepancy.propose import Start
from emps_design.effects import Parameter, get_effect
from emps_design.errors import SimulationError
from emps_design.quantities import display_unit

ASSUMPTIONS = (
    "the force gain of the drive is known: an error of it scales every mechanical parameter and shows nowhere else",
    "the drive holds each voltage over the period that follows its sample",
    "a Coulomb asymmetry and a constant force are one and the same in any record, and both are the constant force here",
)
FOLLOWED = (
    "the controller is not known: the models follow the recorded motion and voltage, and what the controller itself "
    "adds to the voltage cannot be checked"
)
SHOWN_CANDIDATES = 10


@dataclass(frozen=True)
class Work:
    """What the search leaves for the words: the problem, the rules, all fits, the noise, the checks of the law."""

    problem: Problem
    judge: Judge
    found: Search
    floor: Floor
    checks: tuple[LawCheck, ...]
    healthy: Healthy
    screened: list[list[Start]]
    warnings: tuple[str, ...]

    @property
    def unnamed_law(self) -> bool:
        """Whether the controller's law has a gap with structure that no effect explains."""
        return any(check.structured and check.effect is None for check in self.checks)


def findings(work: Work, extended: Fit, equivalents: dict[str, list[str]]) -> tuple[Finding, ...]:
    """The accepted effects in the order found, each with the force gap before and after it."""
    problem, model = work.problem, extended.model
    order = [name for step in work.found.path for name in step.model.names]
    names = [name for name in dict.fromkeys(order) if name in model.names]
    result = []
    for name in names:
        index = model.names.index(name)
        effect, values = model.effects[index], model.values[index][0]
        without = _without(work, model, index)
        gain = without.cost - extended.cost
        parameters = {
            p.name: {
                "value": float(values[place]),
                "std": _std(work, extended, index, place),
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
                where=_where(problem, extended, index),
                parameters=parameters,
                p_value=work.healthy.p_value(gain),
                gap_before=force_rms(problem, without),
                gap_after=force_rms(problem, extended),
                equivalents=tuple(equivalents.get(name, ())),
                remedy=effect.remedy,
                note=_note(work, effect.channel),
            )
        )
    return tuple(result)


def _per_record(parameter: Parameter, values: np.ndarray) -> dict[str, Any]:
    """What is said besides of a number that belongs to one record: that of each, where there are several."""
    if not parameter.per_record:
        return {}
    return {"per_record": True} | ({"values": values.tolist()} if values.size > 1 else {})


def _without(work: Work, model: Candidate, index: int) -> Fit:
    """``model`` without effect ``index``, the rest re-adjusted: against it stands what the effect itself is good for.

    An effect may have taken a baseline number far from where it is alone: both are tried for a start.
    """
    rest, alone = model.without(index), work.found.path[0].model.baseline
    tried = [fit(work.problem, start, part="used", steps=5) for start in (rest, replace(rest, baseline=alone))]
    return min(tried, key=lambda fitted: fitted.cost)


def _where(problem: Problem, fitted: Fit, index: int) -> dict[str, Any]:
    """Where the force of effect ``index`` acts, with what its numbers' deviations leave open."""
    found = []
    for model in (fitted.model, *drawn(problem, fitted, index)):
        try:
            found.append(extent(problem.records[0], *contribution(problem, model, index)))
        except SimulationError:
            continue  # numbers at which the model is unstable do not describe this machine
    if not found:  # nothing runs without the effect: it acts wherever the model moves
        found.append(extent(problem.records[0], problem.run(fitted.model, 0).force, problem.splits[0].used))
    return described(found[0], found[1:])


def _note(work: Work, channel: str) -> str:
    if channel != "controller":
        return "gap of the training record, with the other effects refitted"
    noise = 1e3 * work.checks[0].noise
    return f"seen in u minus the controller's law, noise {noise:.2g} mV; the force balance holds with it"


def marked_views(
    before: MissingForce, after: MissingForce, used: np.ndarray, floor: float, found: tuple[Finding, ...]
) -> tuple[View, ...]:
    """The residual over each quantity, the extents of the findings marked, the one that shows most first."""
    drawn = []
    for view in views(before, after, used, floor):
        marks = []
        for finding in found:
            place = finding.where.get(view.quantity)
            if place is not None and view.quantity != "frequency":
                marks.append(tuple(place[0]) if view.quantity == "time" else tuple(place))
        drawn.append(replace(view, marks=tuple(marks)))
    head, tail = drawn[:-1], drawn[-1:]
    head.sort(key=lambda view: -_shown(view, found))
    return (*head, *tail)


def _shown(view: View, found: tuple[Finding, ...]) -> float:
    """How much of the gap a picture shows [N]: rms of the mean over a bin, less what findings leave of it."""
    left = np.sqrt(np.nanmean(view.after**2)) if found else 0.0
    return float(np.sqrt(np.nanmean(view.before**2)) - left)


def details(
    work: Work, verdict: str, baseline: Fit, extended: Fit, refitted: tuple[str, ...], refuted: tuple[Asked, ...] = ()
) -> dict[str, Any]:
    """What the report shows besides the contract's keys."""
    problem = work.problem
    unseen = _not_excluded(work, extended)
    told = {
        "simulation": "inverse model" if problem.axis.controller.kind == "none" else "closed loop",
        "candidates": _candidates(work, extended),
        "parameters": _parameters(work, baseline, extended),
        "not_excluded": unseen,
        "records": [{"name": r.name, "role": "train", "sha256": r.sha256} for r in problem.records],
        "calibration": _calibration(work),
        "assumptions": list(ASSUMPTIONS),
        "warnings": [*work.warnings, *_warnings(work, verdict, extended, refitted, refuted)],
    }
    if verdict in ("nothing-missing", "parameters-only") and unseen:
        told["least_visible"] = f"{unseen[0]['text']} ({unseen[0]['label'].lower()})"
    if verdict == "parameters-only":
        told["changed"] = ", ".join(
            f"{q.name.replace('_', ' ')} {axis:.5g} -> {new:.5g} {q.unit}"
            for q, axis, new in zip(BASELINE, problem.axis.mechanics.array(), baseline.model.baseline, strict=True)
            if abs(axis - new) > 0.005 * max(abs(new), 1.0)
        )
    if verdict == "unnamed":
        residual, used = problem.residuals(extended.model)[0], problem.splits[0].used
        told["unexplained"] = described(extent(problem.records[0], residual, used, work.floor.force))
        told["unexplained"]["map"] = force_map(missing_force(problem, extended.model)[0])
    return told


def _calibration(work: Work) -> str:
    runs = work.healthy.largest.size
    made = f"{runs} simulated healthy records, each searched like this one"
    if not work.healthy.searched:
        made = f"{runs} healthy references made of resampled noise"
    noise = "what differs between repeated laps" if work.floor.from_laps else "the residual of the model itself"
    return (
        f"A finding must gain more than {work.healthy.threshold:.1f} in whitened cost, the largest gain of any "
        f"candidate in {100 * LEVEL:g} % of {made}, and more than {100 * WORTH:g} % of the cost "
        f"({100 * WORTH_AT_FLOOR:g} % where it is noise already); the noise is {noise}."
    )


def _warnings(
    work: Work, verdict: str, extended: Fit, refitted: tuple[str, ...], refuted: tuple[Asked, ...]
) -> list[str]:
    said = [FOLLOWED] if work.problem.axis.controller.kind == "none" else []
    said += [
        f"{get_effect(a.name).label.lower()} fitted the training record and is withdrawn: the confirming record asks "
        f"for {a.share:.2f} +- {a.std:.2f} of it"
        for a in refuted
    ]
    if not work.floor.from_laps:
        said.append("the reference does not repeat: the noise floor is the residual of the baseline, an upper bound")
    noise = work.problem.samples("used")
    if verdict in ("named", "ambiguous") and extended.cost > 1.5 * noise:
        said.append(
            f"structure remains after the last finding: {force_rms(work.problem, extended):.2f} N where laps repeat to "
            f"{work.floor.force:.2f} N; no further effect of the library is clear enough to name"
        )
    if work.unnamed_law:
        said.append("the controller's law has a gap that no effect explains: look at u minus the law first")
    if refitted:
        said.append(f"fitted anew on the confirming record, because they belong to one record: {', '.join(refitted)}")
    return said


def _candidates(work: Work, extended: Fit) -> list[dict[str, Any]]:
    """The effects by what each explains alone on top of the baseline."""
    base = work.found.path[0]
    ranked = sorted(work.found.alone.items(), key=lambda pair: -pair[1])
    rows = []
    for name, gain in ranked[:SHOWN_CANDIDATES]:
        full = work.found.tried.get(frozenset((*base.model.names, name)))
        rows.append(
            {
                "effect": name,
                "label": get_effect(name).label,
                "gap": None if full is None else force_rms(work.problem, full),
                "statistic": gain if full is None else base.cost_fit - full.cost_fit,
                "threshold": max(work.healthy.threshold, WORTH * base.cost),
                "accepted": name in extended.model.names,
                "note": "first guess only, too poor to be fitted" if full is None else "alone, on top of the baseline",
            }
        )
    return rows


def _parameters(work: Work, baseline: Fit, extended: Fit) -> dict[str, Any]:
    told = work.problem.axis.mechanics.array()
    table = {}
    for place, quantity in enumerate(BASELINE):
        table[quantity.name] = {
            "unit": quantity.unit,
            "axis": float(told[place]),
            "baseline": {"value": float(baseline.model.baseline[place]), "std": baseline.std(-1, place)},
            "extended": {"value": float(extended.model.baseline[place]), "std": _std(work, extended, -1, place)},
        }
    return table


def _std(work: Work, extended: Fit, index: int, place: int) -> float:
    """Standard deviation of a number of the extended model, its baseline's with ``index`` -1.

    Not less than the number moved when the selecting strokes were added to the fitting ones: where play bounces, what
    a tiny change of a number does to the force says nothing of how well the record determines it.
    """
    linear, before = extended.std(index, place), work.found.best.model
    if index < 0:
        return max(linear, abs(float(extended.model.baseline[place] - before.baseline[place]))) if linear else 0.0
    name = extended.model.names[index]
    if linear == 0.0 or name not in before.names:
        return linear
    moved = extended.model.values[index][0, place] - before.values[before.names.index(name)][0, place]
    return max(linear, abs(float(moved)))


def _not_excluded(work: Work, extended: Fit) -> list[dict[str, Any]]:
    """The smallest size of each effect that would have been a finding, from its signature on the baseline."""
    gain = max(work.healthy.threshold, WORTH_AT_FLOOR * work.problem.samples("fit"))
    rows = []
    for found in work.screened:
        effect = found[0].model.effects[-1]
        if effect.name in extended.model.names:
            continue
        if not effect.linear:
            continue
        place = [p.name for p in effect.parameters].index(effect.linear[0])
        parameter = effect.parameters[place]
        # Of the shapes that were tried, the middle one: some hide completely, such as an event at the record's end.
        size = float(np.median([abs(s.model.values[-1][0][place]) * np.sqrt(gain) / s.size for s in found]))
        if size == 0.0:
            continue
        unit, factor = display_unit(size, parameter.unit)
        rows.append(
            {
                "effect": effect.name,
                "label": effect.label,
                "size": size,
                "unit": parameter.unit,
                "text": f"{parameter.name.replace('_', ' ')} {size * factor:.2g} {unit}".rstrip(),
            }
        )
    return rows
