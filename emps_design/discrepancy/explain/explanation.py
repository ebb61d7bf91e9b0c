"""The last stage: a validated outcome as a diagnosis, with places, pictures, words and the next experiment."""

from __future__ import annotations

from dataclasses import replace

from emps_design.discrepancy.experiment.discrimination import experiment
from emps_design.discrepancy.explain.details import details
from emps_design.discrepancy.explain.findings import findings
from emps_design.discrepancy.explain.residual_views import SPECTRAL, View, shown, views
from emps_design.discrepancy.model.missing_force import missing_force
from emps_design.discrepancy.result import Diagnosis, Finding
from emps_design.discrepancy.validation.gap import most_missed
from emps_design.discrepancy.validation.verdict import Validation


def explain(validation: Validation) -> Diagnosis:
    """Say what a validation means: what is missing and where, how much of the gap is closed, what to record next."""
    outcome, problem = validation.outcome, validation.extended.problem
    held_out = outcome.calibration.preparation.held_out
    judged = validation.held_out or validation.train
    found = findings(validation)
    most = most_missed(validation.baseline)
    before, after = (missing_force(fitted)[most] for fitted in (validation.baseline, validation.extended))
    floor, used = outcome.calibration.floor, problem.splits[most].used
    drawn = views(before, after, used, floor.force_60hz, problem.axis.drive.voltage_limit)
    return Diagnosis(
        verdict=validation.verdict,
        findings=found,
        axis=judged.extended.to_axis(problem.axis),
        noise=floor,
        train=validation.train.gap,
        holdout=None if validation.held_out is None else validation.held_out.gap,
        prediction=judged.prediction,
        views=_marked(drawn, found),
        details=details(validation, before),
        window=None if held_out is None else held_out.interval,
        experiment=experiment(outcome, validation.extended.model.names, validation.equivalents),
    )


def _marked(drawn: list[View], found: tuple[Finding, ...]) -> tuple[View, ...]:
    """The residual over each quantity, the extents of the findings marked, the one that shows most first."""
    marked = []
    for view in drawn:
        marks = []
        for finding in found:
            place = finding.where.get(view.quantity)
            if place is not None and view.quantity not in SPECTRAL:
                marks += map(tuple, place if view.quantity == "time" else [place])
        marked.append(replace(view, marks=tuple(marks)))
    head, tail = marked[:-1], marked[-1:]
    head.sort(key=lambda view: -shown(view))
    return (*head, *tail)
