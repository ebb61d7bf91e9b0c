"""Whether the confirming record wants the effects that were found, in the amount that was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.checks.preparation import HeldOut
from emps_design.discrepancy.model.candidate import BASELINE
from emps_design.discrepancy.model.fit import Fit, evaluate, sensitivities
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.acceptance import Judge
from emps_design.discrepancy.validation.holdout import adapted
from emps_design.errors import SimulationError
from emps_design.observer import motor_force


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
        return self.exercised and apart - rules.SURE * self.std > rules.ASKED_APART


def confirm(judge: Judge, held_out: HeldOut, extended: Fit) -> tuple[Fit, tuple[Asked, ...]]:
    """Withdraw from ``extended`` what the confirming data refute, one after the other, and refit the rest.

    Also returns what was withdrawn. An effect of the controller has its evidence in the law, and is not asked for.
    """
    refuted: list[Asked] = []
    while True:
        model = extended.model
        asked = asked_for(Hypothesis(held_out.problem, adapted(held_out, model, model)))
        claims = [effect.name for effect in model.effects if effect.channel != "controller"]
        doubtful = [a for a in asked if a.refuted and a.name in claims]
        if not doubtful:
            return extended, tuple(refuted)
        worst = max(doubtful, key=lambda a: abs(a.share - 1) / a.std)
        refuted.append(worst)
        extended = judge.refitted(extended.with_model(model.without(model.names.index(worst.name))))


def asked_for(hypothesis: Hypothesis) -> tuple[Asked, ...]:
    """How much of each effect of a model the first record asks for, all of them at once.

    What every effect changes in the whitened residual, and what the four baseline numbers do, are regressed onto that
    residual. A stand-in for unknown physics fits one motion; on another one it is wanted in another amount.
    """
    problem, model = hypothesis.problem, hypothesis.model
    noise = problem.whitening.undo(np.random.default_rng(0).standard_normal(len(problem.records[0])))
    whole, disturbed = _left(hypothesis), _left(hypothesis, noise)
    changes, again = [], []
    for index in range(len(model.effects)):
        rest = hypothesis.with_model(model.without(index))
        changes.append(_left(rest) - whole)
        again.append(_left(rest, noise) - disturbed)
    baseline = sensitivities(evaluate(hypothesis), model.slots()[: len(BASELINE)], "used")
    design = np.column_stack([*changes, baseline])
    size = np.linalg.norm(design, axis=0)
    least = np.where(np.arange(size.size) < len(changes), rules.EXERCISED * np.sqrt(whole.size), 1e-12)
    exercised = size > least
    unit = design[:, exercised] / size[exercised]
    inverse = np.linalg.pinv(unit.T @ unit, hermitian=True)
    change, std = np.zeros(size.size), np.zeros(size.size)
    change[exercised] = inverse @ (unit.T @ whole) / size[exercised]
    wider = np.sqrt(max(1.0, float(whole @ whole) / whole.size))
    std[exercised] = wider * np.sqrt(np.diag(inverse)) / size[exercised]
    repeats = [min(1.0, float(c @ a) / max(float(a @ a), 1e-30)) for c, a in zip(changes, again, strict=True)]
    return tuple(
        Asked(name, 1.0 + float(change[i]), float(std[i]), repeats[i], bool(exercised[i]))
        for i, name in enumerate(model.names)
    )


def _left(hypothesis: Hypothesis, disturbance: np.ndarray | None = None) -> np.ndarray:
    """Whitened residual of the first record on the used samples; a model that cannot run leaves nothing to compare."""
    problem = hypothesis.problem
    record, used = problem.records[0], problem.splits[0].used
    try:
        run = hypothesis.run(0, disturbance)
    except SimulationError:
        return np.zeros(int(used.sum()))
    return problem.whitening.apply(motor_force(problem.axis, record) - run.force)[used]
