"""The force gap of a baseline and an extended model on the same records, before and after.

The data that nothing was decided on: what belongs to one record is fitted there anew, everything else stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.fit import evaluate, fit
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import rms_interval
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.preparation import HeldOut, check_law, propose_command
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import CUTOFF_HZ
from emps_design.discrepancy.unknown_force import missing_force
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.simulation import Plant


@dataclass(frozen=True)
class Gap:
    """Rms force error [N] of baseline and extended model, unfiltered closed loop and inverse model at 60 Hz.

    ``intervals`` holds each with 95 %, by the names of the numbers.
    """

    baseline: float
    extended: float
    baseline_60hz: float
    extended_60hz: float
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)

    def to_dict(self, measure: str = "") -> dict[str, Any]:
        """The contract's pair with intervals, of ``gap`` or, by ``measure`` "_60hz", of the inverse model."""
        names = ("baseline", "extended")
        pair = {name: getattr(self, name + measure) for name in names}
        return pair | {f"{name}_interval": list(self.intervals[name + measure]) for name in names}


@dataclass(frozen=True)
class Prediction:
    """Force of one record [N], (n,) each: measured, and simulated from its reference with both models.

    ``used`` (n,) bool are the samples that count; ``window`` [s] is where they are, None where that is a whole record.
    """

    record: Record
    measured: np.ndarray
    baseline: np.ndarray
    extended: np.ndarray
    used: np.ndarray
    window: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """Name of the record."""
        return self.record.name

    @property
    def t(self) -> np.ndarray:
        """Time (n,) [s]."""
        return self.record.t

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured minus simulated [N] on what is used, with the baseline and the extended model, means removed."""
        left = [(self.measured - force)[self.used] for force in (self.baseline, self.extended)]
        return left[0] - left[0].mean(), left[1] - left[1].mean()


@dataclass(frozen=True)
class GapComparison:
    """Two models on the same records: the gap over all of them, and of the one that the baseline misses most its
    prediction and the extended model. ``refitted`` names what was fitted anew for it.

    ``left`` [N] is what the extended model leaves where its encoder is exact: the record's own steps are noise, those
    of a second, simulated encoder would be counted as a gap.
    """

    gap: Gap
    prediction: Prediction
    extended: Candidate
    left: float
    refitted: tuple[str, ...] = ()


def compare(
    problem: Problem, baseline: Candidate, extended: Candidate, refitted: tuple[str, ...] = ()
) -> GapComparison:
    """Compare both models on the records of ``problem``."""
    models = [Hypothesis(problem, model) for model in (baseline, extended)]
    predictions = [_predict(*(model.only(i) for model in models)) for i in range(len(problem.records))]
    pairs = zip(*(prediction.errors() for prediction in predictions), strict=True)
    errors = {name: np.concatenate(parts) for name, parts in zip(("baseline", "extended"), pairs, strict=True)}
    for name, model in zip(("baseline_60hz", "extended_60hz"), models, strict=True):
        missing = problem.pick(tuple(m.force for m in missing_force(model, CUTOFF_HZ)), "used")
        errors[name] = np.concatenate([force - force.mean() for force in missing])
    intervals = side_by_side(rms_interval, [(error,) for error in errors.values()])
    gap = Gap(
        **{name: float(np.std(error)) for name, error in errors.items()},
        intervals=dict(zip(errors, intervals, strict=True)),
    )
    most = most_missed(models[0])
    left = np.concatenate([force - force.mean() for force in models[1].left()])
    return GapComparison(gap, predictions[most], extended.only(most), float(np.std(left)), refitted)


def most_missed(hypothesis: Hypothesis) -> int:
    """The record of which a model leaves most."""
    return int(np.argmax([np.std(force) for force in hypothesis.left()]))


def _predict(baseline: Hypothesis, extended: Hypothesis) -> Prediction:
    """Simulate the first record from its reference alone with both models, encoder quantised as it is."""
    problem = baseline.problem
    axis, record = problem.axis, problem.records[0]
    measured = motor_force(axis, record)

    def simulated(one: Hypothesis) -> np.ndarray:
        force = Plant.of(one.model.to_axis(axis)).closed_loop(**one.driven(0)).force
        return measured - problem.compared((measured - force,))[0] if problem.follows else force

    before, after = side_by_side(simulated, [(baseline,), (extended,)])
    return Prediction(record, measured, before, after, problem.splits[0].used)


def compare_on(held_out: HeldOut, baseline: Candidate, extended: Candidate) -> GapComparison:
    """Compare two models of the training records, each with what belongs to the held-out record fitted anew."""
    before, after = (adapted(held_out, model, extended) for model in (baseline, extended))
    return compare(held_out.problem, before, after, per_record_names(after))


def adapted(held_out: HeldOut, model: Candidate, found: Candidate) -> Candidate:
    """``model`` of the training records, with what the controller does here, and what belongs to this record.

    What is part of ``found`` is no part of a baseline.
    """
    if held_out.law is not None:
        addition = held_out.law.addition
        theirs = [e.name for e in model.effects if e.channel == "controller" and e.name != held_out.added]
        model = model.without_named(theirs)
        if addition is not None and held_out.added not in (*model.names, *found.names):
            model = model.with_effect(*addition)
    return refit_per_record(Hypothesis(held_out.problem, model.only(0)))


def per_record_names(model: Candidate) -> tuple[str, ...]:
    """Names of the numbers of ``model`` that belong to one record and can be fitted."""
    pairs = [(effect, p) for effect in model.effects for p in effect.parameters]
    return tuple(f"{effect.name}.{p.name}" for effect, p in pairs if p.per_record and not p.discrete)


def refit_per_record(hypothesis: Hypothesis) -> Candidate:
    """Fit what belongs to one record on the only record of ``hypothesis``.

    Starts are the numbers of the record before and the effect's own proposals here; the old numbers stay unless new
    ones are clearly better.
    """
    if not per_record_names(hypothesis.model):
        return hypothesis.model
    for index, effect in enumerate(hypothesis.model.effects):
        if any(p.per_record for p in effect.parameters):
            rows = [hypothesis.model.values[index][0], *_proposals(hypothesis, index)]
            models = [hypothesis.model.with_row(index, row) for row in rows]
            trials = side_by_side(evaluate, [(hypothesis.with_model(model),) for model in models])
            best = min(trials, key=lambda trial: trial.cost)
            if best.cost < rules.BETTER_PROPOSAL * trials[0].cost:
                hypothesis = hypothesis.with_model(best.model)
    before = evaluate(hypothesis)
    after = fit(hypothesis, "used", hypothesis.model.slots(frozen=True))
    return after.model if after.cost < rules.BETTER_FIT * before.cost else before.model


def _proposals(hypothesis: Hypothesis, index: int) -> list[np.ndarray]:
    """Parameters (n_parameters,) of effect ``index`` with what belongs to the record as the effect proposes it."""
    problem, model = hypothesis.problem, hypothesis.model
    record, effect, row = problem.records[0], model.effects[index], model.values[index][0]
    own = [p.per_record for p in effect.parameters]
    if effect.channel == "controller":
        found = propose_command(effect, record, check_law(record, problem.axis, ()).gap)
        return [] if found is None else [np.where(own, found, row)]
    if effect.propose is None:
        return []
    seen = missing_force(hypothesis.with_model(model.without(index)))[0]
    tables = effect.propose(seen.motion, seen.force, model.baseline, seen.away)
    full = [[t.get(p.name, old) for p, old in zip(effect.parameters, row, strict=True)] for t in tables]
    return [np.where(own, values, row) for values in full]
