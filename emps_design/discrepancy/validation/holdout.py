"""The data that nothing was decided on: what belongs to one record is fitted there anew, everything else stands."""

from __future__ import annotations

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.checks.controller_law import check_law, propose_command
from emps_design.discrepancy.checks.preparation import HeldOut
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.fit import evaluate, fit
from emps_design.discrepancy.model.missing_force import missing_force
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.validation.gap import Comparison, compare


def compare_on(held_out: HeldOut, baseline: Candidate, extended: Candidate) -> Comparison:
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
