"""The force gap of a baseline and an extended model on the same records.

On held-out data the per-record parameters are fitted again; all others keep their values.
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
from emps_design.discrepancy.unknown_force import missing_force
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.simulation import Plant


@dataclass(frozen=True)
class Gap:
    """Rms force error [N] of baseline and extended model: closed loop, unfiltered, and inverse model below 60 Hz.

    ``intervals`` are the 95 % intervals by the names of these fields.
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

    ``used`` (n,) bool are the compared samples; ``window`` [s] is their interval, None for a whole record.
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
        """Measured minus simulated force (n_used,) [N] of the baseline and of the extended model, means removed."""
        before, after = ((self.measured - force)[self.used] for force in (self.baseline, self.extended))
        return before - before.mean(), after - after.mean()


@dataclass(frozen=True)
class GapComparison:
    """Two models on the same records: the ``gap`` over all records, and ``prediction`` and ``extended`` model of the
    record with the largest residual of the baseline. ``refitted`` are the names of the parameters fitted again for it.

    ``remaining_force`` [N] is the rms residual of the extended model with an exact encoder: the steps of the recorded
    encoder are noise, but those of a second, simulated encoder would count as a gap.
    """

    gap: Gap
    prediction: Prediction
    extended: Candidate
    remaining_force: float
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
        missing = problem.pick(tuple(m.force for m in missing_force(model, rules.CUTOFF_HZ)), "used")
        errors[name] = np.concatenate([force - force.mean() for force in missing])
    intervals = side_by_side(rms_interval, [(error,) for error in errors.values()])
    gap = Gap(
        **{name: float(np.std(error)) for name, error in errors.items()},
        intervals=dict(zip(errors, intervals, strict=True)),
    )
    most = record_of_largest_residual(models[0])
    remaining = np.concatenate([force - force.mean() for force in models[1].remaining_force()])
    return GapComparison(gap, predictions[most], extended.only(most), float(np.std(remaining)), refitted)


def record_of_largest_residual(hypothesis: Hypothesis) -> int:
    """Index of the record on which the residual of a model is largest."""
    return int(np.argmax([np.std(force) for force in hypothesis.remaining_force()]))


def _predict(baseline: Hypothesis, extended: Hypothesis) -> Prediction:
    """Simulate the first record with both models, from its reference.

    The encoder is quantised unless the law follows the recorded motion.
    """
    problem = baseline.problem
    axis, record = problem.record_set.simulated, problem.records[0]
    measured = motor_force(axis, record)

    def simulated(hypothesis: Hypothesis) -> np.ndarray:
        plant = Plant.of(hypothesis.model.to_axis(axis))
        force = plant.closed_loop(**hypothesis.driven(0), quantise=not problem.follows).force
        return measured - problem.compared((measured - force,))[0] if problem.follows else force

    before, after = side_by_side(simulated, [(baseline,), (extended,)])
    return Prediction(record, measured, before, after, problem.splits[0].used)


def compare_on(held_out: HeldOut, baseline: Candidate, extended: Candidate) -> GapComparison:
    """Compare two models on the held-out record, its per-record parameters fitted again in each."""
    before, after = (adapt(held_out, model, extended) for model in (baseline, extended))
    return compare(held_out.problem, before, after, per_record_names(after))


def adapt(held_out: HeldOut, model: Candidate, extended: Candidate) -> Candidate:
    """``model`` of the training records with the controller's effect and per-record parameters of the held-out record.

    The controller's effect is not added to a baseline if ``extended`` has it.
    """
    if held_out.law is not None:
        addition = held_out.law.addition
        others = [e.name for e in model.effects if e.channel == "controller" and e.name != held_out.added]
        model = model.without_named(others)
        if addition is not None and held_out.added not in (*model.names, *extended.names):
            model = model.with_effect(*addition)
    return refit_per_record(Hypothesis(held_out.problem, model.only(0)))


def per_record_names(model: Candidate) -> tuple[str, ...]:
    """Names of the continuous parameters of ``model`` that belong to one record."""
    pairs = [(effect, p) for effect in model.effects for p in effect.parameters]
    return tuple(f"{effect.name}.{p.name}" for effect, p in pairs if p.per_record and not p.discrete)


def refit_per_record(hypothesis: Hypothesis) -> Candidate:
    """Fit the per-record parameters on the only record of ``hypothesis``.

    Starts are the present parameters and the proposals of the effect on this record; new parameters are used only if
    they are clearly better.
    """
    if not per_record_names(hypothesis.model):
        return hypothesis.model
    for index, effect in enumerate(hypothesis.model.effects):
        if any(p.per_record for p in effect.parameters):
            rows = [hypothesis.model.values[index][0], *_proposals(hypothesis, index)]
            models = [hypothesis.model.with_row(index, row) for row in rows]
            trials = side_by_side(evaluate, [(hypothesis.with_model(model),) for model in models])
            best = min(trials, key=lambda trial: trial.cost)
            if best.cost < (1 - rules.NEGLIGIBLE) * trials[0].cost:
                hypothesis = hypothesis.with_model(best.model)
    before = evaluate(hypothesis)
    after = fit(hypothesis, "used", hypothesis.model.slots(frozen=True))
    return after.model if after.cost < (1 - rules.STILL_PAYS) * before.cost else before.model


def _proposals(hypothesis: Hypothesis, index: int) -> list[np.ndarray]:
    """Parameters (n_parameters,) of effect ``index`` with the per-record ones proposed by the effect."""
    problem, model = hypothesis.problem, hypothesis.model
    record, effect, row = problem.records[0], model.effects[index], model.values[index][0]
    per_record = [p.per_record for p in effect.parameters]
    if effect.channel == "controller":
        proposed = propose_command(effect, record, check_law(record, problem.axis, ()).gap)
        return [] if proposed is None else [np.where(per_record, proposed, row)]
    if effect.search.propose is None:
        return []
    missing = missing_force(hypothesis.with_model(model.without(index)))[0]
    tables = effect.search.propose(missing.motion, missing.force, model.baseline, missing.away)
    full = [[t.get(p.name, old) for p, old in zip(effect.parameters, row, strict=True)] for t in tables]
    return [np.where(per_record, values, row) for values in full]
