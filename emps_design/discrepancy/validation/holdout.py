"""The confirming record: both models on it, what belongs to it alone, and what it withdraws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from emps_design.discrepancy.checks.controller_law import LawCheck
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.partition import split
from emps_design.discrepancy.model.problem import Fit, Problem
from emps_design.discrepancy.search.outcome import Work
from emps_design.discrepancy.validation.gap import Asked, Gap, Prediction, asked_for, gap_of, predict, refit_per_record
from emps_design.errors import InputError
from emps_design.records import Record


@dataclass(frozen=True)
class Confirming:
    """The confirming record as a problem of its own, the samples (n,) bool that confirm, what its controller does."""

    problem: Problem
    window: np.ndarray
    law: LawCheck | None = None

    @property
    def stretch(self) -> tuple[float, float] | None:
        """Start and stop [s] of what confirms, None where it is a whole record."""
        t = self.problem.records[0].t[self.window]
        return None if self.window.all() else (float(t[0]), float(t[-1]))

    @property
    def added(self) -> str:
        """Name of the effect that the controller adds here, or ""."""
        return self.law.effect.name if self.law is not None and self.law.effect is not None else ""

    @property
    def unnamed_law(self) -> bool:
        """Whether the controller does something here that no effect explains."""
        return self.law is not None and self.law.structured and self.law.effect is None

    def of_this_record(self, model: Candidate, found: Candidate) -> Candidate:
        """``model`` of the training record with what the controller does here, which may be more or less than there.

        What is part of ``found`` is no part of a baseline.
        """
        if self.law is None:
            return model
        for name in [e.name for e in model.effects if e.channel == "controller" and e.name != self.added]:
            model = model.without(model.names.index(name))
        if self.added in ("", *model.names, *found.names):
            return model
        return model.with_effect(self.law.effect, self.law.values)


def confirming_on(work: Work, holdout: Record | None, confirm_time: tuple[float, float] | None) -> Confirming | None:
    """What confirms; None where there is nothing."""
    if holdout is None and confirm_time is None:
        return None
    record = work.problem.records[0] if holdout is None else holdout
    window = np.ones(len(record), bool) if confirm_time is None else between(record, confirm_time, "--confirm-time")
    own = replace(work.problem, records=(record,), splits=(split(record, window),))
    return Confirming(own, window, work.holdout_law)


@dataclass(frozen=True)
class Judged:
    """Both models on one record: the gap, the prediction, the extended model and what was fitted anew for it."""

    gap: Gap
    prediction: Prediction
    extended: Candidate
    refitted: tuple[str, ...]


def confirm(work: Work, confirming: Confirming, baseline: Fit, extended: Fit) -> tuple[Judged, Fit, tuple[Asked, ...]]:
    """Judge both models on the confirming data; withdraw what those data refute and refit the rest.

    An effect of the controller has its evidence in the law, and is not asked for.
    """
    refuted: list[Asked] = []
    while True:
        asked = asked_for(confirming.problem, _refitted(confirming, extended.model, extended.model)[0])
        claims = [effect.name for effect in extended.model.effects if effect.channel != "controller"]
        doubtful = [a for a in asked if a.refuted and a.name in claims]
        worst = max(doubtful, key=lambda a: abs(a.share - 1) / a.std, default=None)
        if worst is None:
            return confirming_gap(confirming, baseline.model, extended.model), extended, tuple(refuted)
        refuted.append(worst)
        rest = extended.model.without(extended.model.names.index(worst.name))
        extended = work.judge.refitted(rest)


def confirming_gap(confirming: Confirming, baseline: Candidate, extended: Candidate) -> Judged:
    """Both models on the confirming record, what belongs to a record fitted anew there."""
    (before, _), (after, names) = (_refitted(confirming, model, extended) for model in (baseline, extended))
    return gap_on(confirming.problem, before, after, names)


def _refitted(confirming: Confirming, model: Candidate, extended: Candidate) -> tuple[Candidate, list[str]]:
    """``model`` with what belongs to the confirming record fitted anew, and the names of that."""
    return refit_per_record(confirming.problem, confirming.of_this_record(model, extended).only(0))


def gap_on(problem: Problem, baseline: Candidate, extended: Candidate, refitted: Sequence[str] = ()) -> Judged:
    """Both models on the records of ``problem``: the gap over all, the rest of the one the baseline misses most."""
    each = range(len(problem.records))
    predictions = [predict(problem.only(i), baseline.only(i), extended.only(i)) for i in each]
    shown = most_missed(problem, baseline)
    gap = gap_of(problem, predictions, baseline, extended)
    return Judged(gap, predictions[shown], extended.only(shown), tuple(refitted))


def most_missed(problem: Problem, model: Candidate) -> int:
    """The record of which ``model`` leaves most."""
    return int(np.argmax([np.std(force) for force in problem.left(model)]))


def between(record: Record, window: tuple[float, float], option: str) -> np.ndarray:
    """Samples (n,) bool of ``record`` inside ``window`` (start, stop) [s]; refuses an empty one."""
    inside = (record.t >= window[0]) & (record.t < window[1])
    if not inside.any():
        raise InputError(
            f"{option}: found {window[0]:g}:{window[1]:g} s, expected a stretch of {record.name}, which lasts "
            f"{record.duration:.3g} s"
        )
    return inside
