"""What the report shows besides the findings: pictures of the residual, what was tried, what was not seen, warnings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.discrepancy.explain.detection_limits import least_visible, not_excluded
from emps_design.discrepancy.explain.extent import described, extent
from emps_design.discrepancy.explain.findings import deviation
from emps_design.discrepancy.explain.residual_views import SPECTRAL, View, force_map, shown, spectrum_over_time, views
from emps_design.discrepancy.model.candidate import BASELINE
from emps_design.discrepancy.model.missing_force import MissingForce, missing_force
from emps_design.discrepancy.model.problem import Fit
from emps_design.discrepancy.result import Finding
from emps_design.discrepancy.search.acceptance import WORTH, WORTH_AT_FLOOR, force_rms
from emps_design.discrepancy.search.null_distribution import LEVEL
from emps_design.discrepancy.search.outcome import Confirmation, Work
from emps_design.discrepancy.validation.holdout import most_missed
from emps_design.effects import get_effect
from emps_design.records import Record

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


def marked_views(
    before: MissingForce,
    after: MissingForce,
    used: np.ndarray,
    work: Work,
    found: tuple[Finding, ...],
) -> tuple[View, ...]:
    """The residual over each quantity, the extents of the findings marked, the one that shows most first."""
    drawn = []
    for view in views(before, after, used, work.floor.force_60hz, work.problem.axis.drive.voltage_limit):
        marks = []
        for finding in found:
            place = finding.where.get(view.quantity)
            if place is not None and view.quantity not in SPECTRAL:
                marks += map(tuple, place if view.quantity == "time" else [place])
        drawn.append(replace(view, marks=tuple(marks)))
    head, tail = drawn[:-1], drawn[-1:]
    head.sort(key=lambda view: -shown(view))
    return (*head, *tail)


def details(
    work: Work,
    verdict: str,
    baseline: Fit,
    extended: Fit,
    missed: MissingForce,
    confirmation: Confirmation | None = None,
    given_up: tuple[tuple[str, ...], float] = ((), 0.0),
) -> dict[str, Any]:
    """What the report shows besides the contract's keys.

    ``missed`` is what ``baseline`` misses of the record shown; ``given_up`` are the effects of a model that did not
    stand, and the share of the gap it explained.
    """
    problem = work.problem
    unseen = not_excluded(work, extended.model.names)
    told = {
        "simulation": "inverse model" if problem.axis.controller.kind == "none" else "closed loop",
        "candidates": _candidates(work, extended),
        "parameters": _parameters(work, baseline, extended),
        "not_excluded": unseen,
        "records": [{"name": r.name, "role": role, "sha256": r.sha256} for r, role in _records(work, confirmation)],
        "calibration": _calibration(work),
        "assumptions": list(ASSUMPTIONS),
        "warnings": [
            *work.warnings,
            *_warnings(work, verdict, extended),
            *_said_by(confirmation),
            *_said_of(*given_up),
        ],
    }
    if verdict in ("nothing-missing", "parameters-only"):
        told["least_visible"] = least_visible(unseen)
    if verdict == "parameters-only":
        told["changed"] = ", ".join(
            f"{q.name.replace('_', ' ')} {axis:.5g} -> {new:.5g} {q.unit}"
            for q, axis, new in zip(BASELINE, problem.axis.mechanics.array(), baseline.model.baseline, strict=True)
            if abs(axis - new) > 0.005 * max(abs(new), 1.0)
        )
    told["spectrum_over_time"] = spectrum_over_time(missed)
    told["interrupted"] = work.found.interrupted
    if verdict == "unnamed":
        most = most_missed(problem, extended.model)
        residual, used = problem.residuals(extended.model)[most], problem.splits[most].used
        told["unexplained"] = described(extent(problem.records[most], residual, used, work.floor.force))
        told["unexplained"]["map"] = force_map(missing_force(problem, extended.model)[most])
    return told


def _calibration(work: Work) -> str:
    runs = work.healthy.largest.size
    level = max(LEVEL, 1 / (runs + 1))
    made = f"{runs} simulated healthy records, each searched like this one"
    if not work.healthy.searched:
        made = f"{runs} healthy references made of resampled noise"
    return (
        f"A finding must gain more than {work.healthy.threshold:.1f} in whitened cost, the largest gain of any "
        f"candidate in {100 * level:.2g} % of {made}, and more than {100 * WORTH:g} % of the cost "
        f"({100 * WORTH_AT_FLOOR:g} % where it is noise already); the noise is {work.floor.source}."
    )


def _records(work: Work, confirmation: Confirmation | None) -> list[tuple[Record, str]]:
    told = [(record, "train") for record in work.problem.records]
    if confirmation is not None and all(confirmation.record is not record for record, _ in told):
        told.append((confirmation.record, "holdout"))
    return told


def _said_by(confirmation: Confirmation | None) -> list[str]:
    if confirmation is None:
        return []
    said = [
        f"{get_effect(a.name).label.lower()} fitted the training record and is withdrawn: the confirming record asks "
        f"for {a.share:.2f} +- {a.std:.2f} of it"
        for a in confirmation.refuted
    ]
    if confirmation.own:
        label = get_effect(confirmation.own).label.lower()
        said.append(f"{label} on the confirming record, seen in its voltage: taken as known there, by both models")
    elif confirmation.unnamed_law:
        said.append("the controller's law has a gap on the confirming record that no effect explains")
    if confirmation.refitted:
        names = ", ".join(confirmation.refitted)
        said.append(f"fitted anew on the confirming record, because they belong to one record: {names}")
    return said


def _said_of(given_up: tuple[str, ...], share: float) -> list[str]:
    if not given_up:
        return []
    labels = ", ".join(get_effect(name).label.lower() for name in given_up)
    return [
        f"a model with {labels} explains {100 * share:.0f} % of the gap, and does not stand: too little of it, not on "
        "both records, or too many others would do"
    ]


def _warnings(work: Work, verdict: str, extended: Fit) -> list[str]:
    said = [FOLLOWED] if work.problem.axis.controller.kind == "none" else []
    if not work.floor.from_laps:
        said.append(
            f"noise is {work.floor.source}, not what differs between laps: what is unlike all candidates, and differs "
            "from stroke to stroke, would pass for it"
        )
    if verdict in ("named", "ambiguous") and work.judge.leaves_structure(extended):
        said.append(
            f"structure remains after the last finding: {force_rms(work.problem, extended):.2f} N where noise is "
            f"{work.floor.force:.2f} N; no further effect of the library is clear enough to name"
        )
    if work.unnamed_law:
        said.append("the controller's law has a gap that no effect explains: look at u minus the law first")
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
                "threshold": work.judge.to_beat(base),
                "accepted": name in extended.model.names,
                "note": "first guess only, too poor to be fitted" if full is None else "alone, on top of the baseline",
            }
        )
    return rows


def _parameters(work: Work, baseline: Fit, extended: Fit) -> dict[str, Any]:
    told = work.problem.axis.mechanics.array()
    first, best = work.found.path[0], work.found.best
    table = {}
    for place, quantity in enumerate(BASELINE):
        table[quantity.name] = {
            "unit": quantity.unit,
            "axis": float(told[place]),
            "baseline": {"value": float(baseline.model.baseline[place]), "std": deviation(baseline, first, -1, place)},
            "extended": {"value": float(extended.model.baseline[place]), "std": deviation(extended, best, -1, place)},
        }
    return table
