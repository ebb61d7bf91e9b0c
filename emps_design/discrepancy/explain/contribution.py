"""The force that one effect of a fitted model contributes, free of noise: simulated with it, judged without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.discrepancy.checks.controller_law import command_of
from emps_design.discrepancy.model.fit import Fit
from emps_design.discrepancy.model.missing_force import missing_force
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.errors import SimulationError

DRAWS = 19  # of the parameters: with the fitted ones, what they span holds nine tenths
ELSEWHERE = 0.2  # of the squared force away from reversals, from which on that part is the place to look


def contribution(hypothesis: Hypothesis, index: int, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Force (n,) [N] of effect ``index`` on record ``number``, and the samples (n,) bool to look at.

    It is what the model without the effect, all other numbers as they are, would miss of the model with it; its median
    is removed, because a constant force is the baseline's own. Of an effect of the controller, whose loop takes back
    what it adds, it is the force of the added voltage. The samples leave reversals out where the effect acts elsewhere
    too. Raises :class:`SimulationError` where the model cannot be simulated without the effect.
    """
    alone = hypothesis.only(number)
    problem, model = alone.problem, alone.model
    record, used = problem.records[0], problem.splits[0].used
    effect, values = model.effects[index], model.values[index][0]
    if effect.channel == "controller":
        return problem.axis.drive.gain * command_of(effect, values, record), used
    run = alone.run(0)
    played = replace(problem, records=(replace(record, q=run.q, u=run.u),))
    seen = missing_force(Hypothesis(played, model.without(index)))[0]
    force = seen.force - np.median(seen.force[used])
    away = seen.away & used
    return force, away if np.sum(force[away] ** 2) > ELSEWHERE * np.sum(force[used] ** 2) else used


def most_exercised(hypothesis: Hypothesis, index: int) -> int:
    """The record on which effect ``index`` of a model contributes most force."""
    records = range(len(hypothesis.problem.records))
    if len(records) == 1:
        return 0
    sizes = []
    for number in records:
        try:
            force, seen = contribution(hypothesis, index, number)
            sizes.append(float(np.std(force[seen])))
        except SimulationError:  # unstable without the effect: it is needed here
            sizes.append(np.inf)
    return int(np.argmax(sizes))


def drawn(fitted: Fit, index: int, seed: int = 0) -> list[Hypothesis]:
    """Models with the numbers of effect ``index`` drawn from their covariance."""
    own = [i for i, slot in enumerate(fitted.slots) if slot.effect == index]
    slots, model = tuple(fitted.slots[i] for i in own), fitted.model
    size = np.array([slot.magnitude for slot in slots])
    values, vectors = np.linalg.eigh(fitted.covariance[np.ix_(own, own)] / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    centre, chances = model.vector(slots), np.random.default_rng(seed).standard_normal((DRAWS, len(own)))
    draws = [model.with_vector(slots, centre + root @ chance) for chance in chances] if own else []
    return [fitted.with_model(draw) for draw in draws]
