"""Data that nothing was decided on: the gap there, before and after, with what belongs to one record fitted anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emps_design.discrepancy.checks.controller_law import check_law, propose_command
from emps_design.discrepancy.model.candidate import BASELINE, Candidate
from emps_design.discrepancy.model.following import drive
from emps_design.discrepancy.model.missing_force import missing_force
from emps_design.discrepancy.model.problem import Problem, evaluate, fit, sensitivities
from emps_design.discrepancy.search.noise_floor import rms_interval
from emps_design.errors import SimulationError
from emps_design.records import Record
from emps_design.simulation import Plant

ASKED_APART = 0.3  # from all of an effect, beyond which a record refutes it
SURE = 3.0  # standard deviations
EXERCISED = 0.05  # standard deviations of the noise that an effect must change in the mean to be seen at all


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

    def to_dict(self) -> dict[str, Any]:
        """The contract's pair, with intervals."""
        return self._pair("")

    def to_dict_60hz(self) -> dict[str, Any]:
        """The contract's pair for the inverse model at 60 Hz, with intervals."""
        return self._pair("_60hz")

    def _pair(self, measure: str) -> dict[str, Any]:
        names = ("baseline", "extended")
        pair = {name: getattr(self, name + measure) for name in names}
        return pair | {f"{name}_interval": list(self.intervals[name + measure]) for name in names}


@dataclass(frozen=True)
class Prediction:
    """Force of one record [N], (n,) each: measured, and simulated from its reference with both models."""

    record: Record
    measured: np.ndarray
    baseline: np.ndarray
    extended: np.ndarray
    window: np.ndarray

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured minus simulated [N] on the window, with the baseline and with the extended model, means removed."""
        left = [(self.measured - force)[self.window] for force in (self.baseline, self.extended)]
        return left[0] - left[0].mean(), left[1] - left[1].mean()


def refit_per_record(problem: Problem, model: Candidate) -> tuple[Candidate, list[str]]:
    """Fit what belongs to one record on ``problem``'s own record; returns the model and the names that were fitted.

    Starts are the numbers of the record before and the effect's own proposals here; the old numbers stay unless new
    ones are clearly better.
    """
    names = [
        f"{effect.name}.{p.name}"
        for effect in model.effects
        for p in effect.parameters
        if p.per_record and not p.discrete
    ]
    if not names:
        return model, []
    record = problem.records[0]
    for index, effect in enumerate(model.effects):
        places = [p.per_record for p in effect.parameters]
        if not any(places):
            continue
        row = model.values[index][0]
        rows = [row]
        if effect.channel == "controller":
            found = propose_command(effect, record, check_law(record, problem.axis, ()).gap)
            rows += [] if found is None else [np.where(places, found, row)]
        elif effect.propose is not None:
            seen = missing_force(problem, model.without(index))[0]
            for table in effect.propose(seen.motion, seen.force, model.baseline, seen.away):
                full = [table.get(p.name, old) for p, old in zip(effect.parameters, row, strict=True)]
                rows.append(np.where(places, full, row))
        trials = [evaluate(problem, _with_row(model, index, r)) for r in rows]
        best = min(range(len(rows)), key=lambda i: trials[i].cost)
        if trials[best].cost < 0.98 * trials[0].cost:
            model = trials[best].model
    before, after = evaluate(problem, model), fit(problem, model, "used", model.slots(frozen=True))
    return (after.model if after.cost < 0.995 * before.cost else model), names


def _with_row(model: Candidate, index: int, row: np.ndarray) -> Candidate:
    values = list(model.values)
    values[index] = np.atleast_2d(row)
    return Candidate(model.baseline, model.effects, tuple(values))


@dataclass(frozen=True)
class Asked:
    """How much of an effect a record asks for: ``share`` 1 is all of it, 0 none; ``std`` its standard deviation.

    ``repeats`` is the share that the effect asks of itself when the carriage is disturbed by noise: below 1 where play
    bounces, and no two laps are alike. ``exercised`` False: the record does not bring the effect out, and says nothing
    of it.
    """

    name: str
    share: float
    std: float
    repeats: float
    exercised: bool

    @property
    def refuted(self) -> bool:
        """Whether the record clearly wants another amount of it than the effect itself, or all of it."""
        apart = max(self.repeats - self.share, self.share - 1.0)
        return self.exercised and apart - SURE * self.std > ASKED_APART


def asked_for(problem: Problem, model: Candidate) -> tuple[Asked, ...]:
    """How much of each effect of ``model`` the first record of ``problem`` asks for, all of them at once.

    What every effect changes in the whitened residual, and what the four baseline numbers do, are regressed onto that
    residual. A stand-in for unknown physics fits one motion; on another one it is wanted in another amount.
    """
    noise = problem.whitening.undo(np.random.default_rng(0).standard_normal(len(problem.records[0])))
    whole, disturbed = _left(problem, model), _left(problem, model, noise)
    changes, again = [], []
    for index in range(len(model.effects)):
        rest = model.without(index)
        changes.append(_left(problem, rest) - whole)
        again.append(_left(problem, rest, noise) - disturbed)
    baseline = sensitivities(problem, evaluate(problem, model), model.slots()[: len(BASELINE)], "used")
    design = np.column_stack([*changes, baseline])
    size = np.linalg.norm(design, axis=0)
    least = np.where(np.arange(size.size) < len(changes), EXERCISED * np.sqrt(whole.size), 1e-12)
    exercised = size > least
    unit = design[:, exercised] / size[exercised]
    inverse = np.linalg.pinv(unit.T @ unit, hermitian=True)
    change, std = np.zeros(size.size), np.zeros(size.size)
    change[exercised] = inverse @ (unit.T @ whole) / size[exercised]
    scale = np.sqrt(max(1.0, float(whole @ whole) / whole.size))
    std[exercised] = scale * np.sqrt(np.diag(inverse)) / size[exercised]
    repeats = [min(1.0, float(c @ a) / max(float(a @ a), 1e-30)) for c, a in zip(changes, again, strict=True)]
    return tuple(
        Asked(name, 1.0 + float(change[i]), float(std[i]), repeats[i], bool(exercised[i]))
        for i, name in enumerate(model.names)
    )


def _left(problem: Problem, model: Candidate, disturbance: np.ndarray | None = None) -> np.ndarray:
    """Whitened residual of the first record on the used samples; a model that cannot run leaves nothing to compare."""
    record, used = problem.records[0], problem.splits[0].used
    try:
        run = problem.run(model, 0, disturbance)
    except SimulationError:
        return np.zeros(int(used.sum()))
    return problem.whitening.apply(problem.axis.drive.force_gain * record.u - run.force)[used]


def predict(problem: Problem, baseline: Candidate, extended: Candidate) -> Prediction:
    """Simulate the first record from its reference alone with both models, encoder quantised as it is."""
    axis, record = problem.axis, problem.records[0]
    forces = [Plant.of(model.to_axis(axis)).closed_loop(**drive(axis, record)).force for model in (baseline, extended)]
    return Prediction(record, axis.drive.force_gain * record.u, *forces, problem.splits[0].used)


def gap_of(problem: Problem, predictions: Sequence[Prediction], baseline: Candidate, extended: Candidate) -> Gap:
    """Both measures of the gap of ``predictions``, one a record, reversals included in both."""
    pairs = zip(*(prediction.errors() for prediction in predictions), strict=True)
    errors = {name: np.concatenate(parts) for name, parts in zip(("baseline", "extended"), pairs, strict=True)}
    for name, model in (("baseline_60hz", baseline), ("extended_60hz", extended)):
        missing = [m.force[used] for m, used in zip(missing_force(problem, model), problem.masks("used"), strict=True)]
        errors[name] = np.concatenate([force - force.mean() for force in missing])
    return Gap(
        **{name: float(np.std(error)) for name, error in errors.items()},
        intervals={name: rms_interval(error) for name, error in errors.items()},
    )
