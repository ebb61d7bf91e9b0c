"""The last stage: a validated outcome as a diagnosis, with places, pictures, tables, words and the next experiment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.experiment.discrimination import Experiment, experiment, what_to_record
from emps_design.discrepancy.explain.detection_limits import least_visible, not_excluded
from emps_design.discrepancy.explain.findings import deviation, findings
from emps_design.discrepancy.explain.measured_response import measured_response
from emps_design.discrepancy.explain.remarks import ASSUMPTIONS, calibration_in_words, warnings
from emps_design.discrepancy.explain.residual_views import (
    SPECTRAL,
    View,
    shown,
    spectrum_over_time,
    views,
)  # fmt: skip
from emps_design.discrepancy.explain.unexplained import unexplained
from emps_design.discrepancy.model.candidate import BASELINE
from emps_design.discrepancy.model.missing_force import MissingForce, missing_force
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.result import Diagnosis, Finding
from emps_design.discrepancy.search.acceptance import force_rms
from emps_design.discrepancy.validation.closest import Closest
from emps_design.discrepancy.validation.gap import most_missed
from emps_design.discrepancy.validation.verdict import Validation, wrong_numbers
from emps_design.effects import get_effect, kind_of
from emps_design.effects.effect import COULOMB, OFFSET
from emps_design.identification.model import LUMP

SHOWN_CANDIDATES = 10
UNTOLD = {"value": None, "std": None}
# The picture over the coordinate of an extent.
_OVER = {"reversals": "time from reversal", "speed": "velocity", "position": "position", "time": "time"}


def explain(validation: Validation, rest: tuple[str, ...] = (), closest: Closest | None = None) -> Diagnosis:
    """Say what a validation means: what is missing and where, how much of the gap is closed, what to record next.

    ``rest`` says what was not searched, and what is left there; ``closest`` what follows most closely, where asked for.
    """
    outcome, problem = validation.outcome, validation.extended.problem
    held_out = outcome.calibration.preparation.held_out
    judged = validation.held_out or validation.train
    most = most_missed(validation.baseline)
    before, after = (missing_force(fitted)[most] for fitted in (validation.baseline, validation.extended))
    floor, used = outcome.calibration.floor, problem.splits[most].used
    limit = problem.axis.drive.command_limit
    details, found, drawn = side_by_side(  # the longest first
        lambda work, *given: work(*given),
        [(_details, validation, before), (findings, validation), (views, before, after, used, floor.force_60hz, limit)],
    )
    details["warnings"] += rest
    details["rest"] = rest
    extended = judged.extended.to_axis(problem.axis)
    return Diagnosis(
        verdict=validation.verdict,
        findings=found,
        axis=extended,
        noise=floor,
        train=validation.train.gap,
        holdout=None if validation.held_out is None else validation.held_out.gap,
        trace=replace(judged.prediction, window=None if held_out is None else held_out.window),
        views=marked(drawn, found),
        details=details,
        experiment=_experiment(validation, details.get("unexplained")),
        response=measured_response(outcome.calibration.preparation.records, extended),
        closest=closest,
    )


def _experiment(validation: Validation, left: dict[str, Any] | None) -> Experiment | None:
    """What to record next: what shows more of the unexplained, or tells equivalents apart where these are too many."""
    outcome, extended = validation.outcome, validation.extended
    asked = any(len(others) > rules.MOST_EQUIVALENTS for others in validation.equivalents.values())
    if left is not None and not asked and not outcome.interrupted:
        return what_to_record(extended, left["over"])
    return experiment(outcome, extended.model.names, validation.equivalents)


def marked(drawn: list[View], found: tuple[Finding, ...]) -> tuple[View, ...]:
    """The ``drawn`` residuals with the extents of the findings; first is what tells where the first of them acts.

    Where it acts everywhere, the one that shows most comes first.
    """
    pictures = []
    for view in drawn:
        marks: list[Any] = []
        for finding in found:
            place = finding.where.get(view.quantity)
            if place is not None and view.quantity not in SPECTRAL:
                marks += map(tuple, place if view.quantity == "time" else [place])
        pictures.append(replace(view, marks=tuple(marks)))
    head, tail = pictures[:-1], pictures[-1:]
    told = _OVER.get(found[0].where["place"]) if found else None
    head.sort(key=lambda view: (not (view.quantity == told and shown(view) > 0.0), -shown(view)))
    return (*head, *tail)


def _details(validation: Validation, missed: MissingForce) -> dict[str, Any]:
    """What the report shows besides the contract's keys; ``missed`` is what the baseline misses of the record shown."""
    outcome, baseline, extended = validation.outcome, validation.baseline, validation.extended
    calibration, axis = outcome.calibration, extended.problem.axis
    unseen = not_excluded(calibration, extended.model.names)
    shown: dict[str, Any] = {
        "simulation": "inverse model" if extended.problem.follows else "closed loop",
        "candidates": _candidates(validation),
        "parameters": _parameters(validation),
        "not_excluded": unseen,
        "records": _records(validation),
        "held_out": calibration.preparation.confirming.to_dict(),
        "calibration": calibration_in_words(calibration),
        "assumptions": list(ASSUMPTIONS),
        "warnings": warnings(validation),
    }
    if validation.verdict in ("nothing-missing", "parameters-only"):
        shown["least_visible"] = least_visible(unseen)
    if validation.verdict == "parameters-only":
        given = axis.mechanics.array()
        shown["changed"] = ", ".join(
            f"{q.name.replace('_', ' ')} {given[i]:.5g} -> {baseline.model.baseline[i]:.5g} {q.unit}"
            for i, q in enumerate(BASELINE)
            if i in wrong_numbers(baseline)
        )
    shown["spectrum_over_time"] = spectrum_over_time(missed)
    shown["interrupted"] = outcome.interrupted
    if validation.verdict in ("unnamed", "partly-named"):
        shown["unexplained"] = unexplained(validation)
    return shown


def _records(validation: Validation) -> list[dict[str, Any]]:
    preparation = validation.outcome.calibration.preparation
    roles = [(record, "train") for record in preparation.records]
    held_out = preparation.held_out
    if held_out is not None and held_out.window is None:
        roles.append((held_out.problem.records[0], "holdout"))
    return [{"name": record.name, "role": role, "sha256": record.sha256} for record, role in roles]


def _candidates(validation: Validation) -> list[dict[str, Any]]:
    """The effects by what each explains alone on top of the baseline."""
    outcome = validation.outcome
    base, to_beat = outcome.path[0], outcome.calibration.judge.to_beat(outcome.path[0])
    ranked = sorted(outcome.alone.items(), key=lambda pair: -pair[1])
    rows = []
    for name, gain in ranked[:SHOWN_CANDIDATES]:
        full = outcome.tried.get(frozenset((*base.model.names, name)))
        rows.append(
            {
                "effect": name,
                "label": get_effect(kind_of(name)).label,
                "gap": None if full is None else force_rms(full),
                "statistic": gain if full is None else base.cost_fit - full.cost_fit,
                "threshold": to_beat,
                "accepted": name in validation.extended.model.names,
                "note": "first guess only: too poor to be fitted, or fitted with numbers that it cannot have"
                if full is None
                else "alone, on top of the baseline",
            }
        )
    return rows


def _parameters(validation: Validation) -> dict[str, Any]:
    """The baseline's numbers: the axis file's, fitted alone, and beside the effects; None where one way tells none."""
    direction = validation.outcome.calibration.preparation.direction
    given = validation.extended.problem.axis.mechanics.array()
    pairs = {
        "baseline": (validation.baseline, validation.outcome.path[0]),
        "extended": (validation.extended, validation.outcome.best),
    }

    def entry(unit: str, weights: np.ndarray) -> dict[str, Any]:
        """The sum of the baseline's numbers with ``weights`` (4,), of which one is free."""
        place = int(np.flatnonzero(weights)[0])
        fitted = {
            name: {"value": float(now.model.baseline @ weights), "std": deviation(now, before, -1, place)}
            for name, (now, before) in pairs.items()
        }
        return {"unit": unit, "axis": float(given @ weights), **fitted}

    every = np.eye(len(BASELINE))
    table = {quantity.name: entry(quantity.unit, row) for quantity, row in zip(BASELINE, every, strict=True)}
    if direction:
        for place in (COULOMB, OFFSET):
            table[BASELINE[place].name] |= dict.fromkeys(pairs, UNTOLD)
        table[LUMP.name] = entry(LUMP.unit, every[COULOMB] + direction * every[OFFSET])
    return table
