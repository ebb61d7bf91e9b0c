"""Where to start fitting an effect: shapes from its own proposals or starts, linear parameters by regression.

Every start is judged in closed loop by one simulation. What it changes in the whitened residual is the effect's
*signature*; free of what re-adjusting the present model absorbs, the share of the residual along the signature is what
a fit would gain to first order, whatever the amplitude. That needs no regressor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.missing_force import MissingForce
from emps_design.discrepancy.model.problem import Fit, Problem, gather, sensitivities
from emps_design.effects import Effect
from emps_design.effects.guesses import thin
from emps_design.errors import SimulationError

LEAST_AMPLITUDE = 0.05  # of a parameter's typical size
BENT = 20.0  # whitened cost per sample beyond which a fitted baseline may have been bent by what is missing


@dataclass(frozen=True)
class Start:
    """A model to start a fit from, its first-order ``gain`` in whitened cost, its unit ``signature`` (n,) and the
    ``size`` of that signature before it was made unit, in standard deviations of the noise. ``anchored``: the rest of
    the model is the fitted one, whose tangent tells what it absorbs."""

    model: Candidate
    gain: float
    signature: np.ndarray
    size: float
    anchored: bool


@dataclass(frozen=True)
class Tangent:
    """The whitened residual (n,) of a fitted model and an orthonormal basis (n, k) of what re-adjusting it absorbs."""

    residual: np.ndarray
    basis: np.ndarray

    def free(self, vector: np.ndarray) -> np.ndarray:
        """``vector`` (n,) without its part inside the basis."""
        return vector - self.basis @ (self.basis.T @ vector)


def tangent(problem: Problem, current: Fit, part: str = "fit") -> Tangent:
    """Finite-difference sensitivities of the whitened residual to the free numbers of ``current``."""
    base = gather(problem, current.innovations, part)
    u, s, _ = np.linalg.svd(sensitivities(problem, current, current.model.slots(), part), full_matrices=False)
    basis = u[:, s > 1e-9 * s[0]]
    return Tangent(base - basis @ (basis.T @ base), basis)


def starts(
    problem: Problem, current: Fit, effect: Effect, missing: tuple[MissingForce, ...], absorbed: Tangent
) -> list[Start]:
    """Return the starts of ``current`` with ``effect`` added, the one with the largest gain first.

    A gap so large that it bent the fitted baseline is looked at from the axis file's numbers too: there the gain is
    what the start itself explains.
    """
    base, found = gather(problem, current.innovations, "fit"), []
    told = replace(current.model, baseline=problem.axis.mechanics.array())
    far = bent(current, float(base @ base) / base.size)
    for values in _values(problem, current.model, effect, missing):
        trial = current.model.with_effect(effect, values)
        try:
            change = absorbed.free(gather(problem, problem.whitened(trial), "fit") - base)
            size = float(np.linalg.norm(change))
            if size == 0:
                continue
            signature = change / size
            # The residual falls when the signature points against it; an effect of the wrong sign gains nothing.
            along = float(absorbed.residual @ signature)
            found.append(Start(trial, along**2 if along < 0 else 0.0, signature, size, anchored=True))
            if far:
                other = told.with_effect(effect, values)
                left = gather(problem, problem.whitened(other), "fit")
                gain = max(0.0, float(base @ base - left @ left))
                found.append(Start(other, gain, signature, size, anchored=False))
        except SimulationError:
            continue
    return sorted(found, key=lambda start: -start.gain)


def bent(current: Fit, cost: float) -> bool:
    """Whether the gap, of ``cost`` a sample, is so large that it bent the baseline fitted to it."""
    return cost > BENT and not current.model.effects


def _values(problem: Problem, model: Candidate, effect: Effect, missing: tuple[MissingForce, ...]) -> list[np.ndarray]:
    """Parameter arrays (n_records, n_parameters) to try."""
    tables = []
    for seen, split in zip(missing, problem.splits, strict=True):
        if effect.propose is not None:
            force = np.where(split.used, seen.force, 0.0)  # what confirms stays closed
            shapes = effect.propose(seen.motion, force, model.baseline, seen.away)
        else:
            names = [p.name for p in effect.parameters if p.starts]
            shapes = [dict(zip(names, combination, strict=True)) for combination in product(*_grids(effect))]
        tables.append([_complete(effect, shape, seen, model) for shape in shapes])
    # Each record proposes; the others follow with their own per-record numbers where they proposed as many.
    own = np.array([p.per_record for p in effect.parameters])
    rows = []
    for proposer in tables:
        for index, shape in enumerate(proposer):
            if shape is None:
                continue
            theirs = [t[index] if index < len(t) and t[index] is not None else shape for t in tables]
            row = np.array([np.where(own, values, shape) for values in theirs])
            if not any(np.array_equal(row, other) for other in rows):
                rows.append(row)
    return rows


def _grids(effect: Effect) -> list[tuple[float, ...]]:
    return [p.starts for p in effect.parameters if p.starts]


def _complete(effect: Effect, shape: dict[str, float], seen: MissingForce, model: Candidate) -> np.ndarray | None:
    """Fill in what ``shape`` leaves out, by regression of the missing force, and hold everything within bounds."""
    absent = [p.name for p in effect.parameters if p.name not in shape]
    if absent and effect.regressor is not None and seen.away.sum() > 100:
        columns = effect.regressor(seen.motion, {**{p.name: 0.0 for p in effect.parameters}, **shape}, model.baseline)
        m = seen.motion
        sign = np.sign(m.v)
        absorbing = np.column_stack([m.a, m.v, sign, np.ones_like(m.v)])
        kept = thin(seen.away)
        design = np.column_stack([columns, absorbing])[kept]
        scale = np.sqrt((design**2).mean(axis=0))
        if not np.all(scale[: columns.shape[1]] > 0):
            return None
        scale[scale == 0] = 1.0
        solution = np.linalg.lstsq(design / scale, seen.force[kept], rcond=1e-8)[0] / scale
        shape = {**shape, **effect.from_coefficients(solution[: columns.shape[1]], shape)}
    elif absent:
        return None
    values = []
    for p in effect.parameters:
        value = min(max(shape[p.name], p.lower), p.upper)
        # A signature needs some of the effect, even where the regression wants none.
        least = LEAST_AMPLITUDE * p.scale if p.linear and p.scale and not p.per_record else 0.0
        values.append(value if abs(value) >= least else float(np.copysign(least, value)))
    return np.array(values)
