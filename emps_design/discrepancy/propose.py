"""Where to start fitting an effect: shapes from its own proposals or starts, linear parameters by regression.

Every start is judged in closed loop: its whitened residual, free of what the baseline could absorb, is what a refit of
the baseline would leave to first order. That costs one simulation a start and needs no regressor.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from emps_design.discrepancy.candidate import Candidate
from emps_design.discrepancy.missing_force import MissingForce
from emps_design.discrepancy.problem import Problem
from emps_design.effects import Effect
from emps_design.errors import SimulationError


@dataclass(frozen=True)
class Start:
    """A model to start a fit from, and the whitened cost it leaves once the model before it has been re-adjusted."""

    model: Candidate
    cost: float


@dataclass(frozen=True)
class Tangent:
    """What re-adjusting a fitted model can absorb: an orthonormal basis (n, k) of its whitened sensitivities."""

    basis: np.ndarray
    masks: tuple[np.ndarray, ...]

    def cost(self, innovations: tuple[np.ndarray, ...]) -> float:
        """Sum of squares of ``innovations`` outside the basis."""
        r = np.concatenate([w[m] for w, m in zip(innovations, self.masks, strict=True)])
        inside = self.basis.T @ r
        return float(r @ r - inside @ inside)


def tangent(problem: Problem, model: Candidate, part: str = "fit") -> Tangent:
    """Finite-difference sensitivities of the whitened residual to the free numbers of ``model``."""
    masks, slots = problem.masks(part), model.slots()
    x = model.vector(slots)
    base = problem.whitened(model)
    columns = []
    for k, slot in enumerate(slots):
        step = 1e-3 * slot.scale * (1 if x[k] + 1e-3 * slot.scale <= slot.quantity.upper else -1)
        moved = x.copy()
        moved[k] += step
        shifted = problem.whitened(model.with_vector(slots, moved))
        columns.append(np.concatenate([(s - b)[m] for s, b, m in zip(shifted, base, masks, strict=True)]))
    u, s, _ = np.linalg.svd(np.column_stack(columns), full_matrices=False)
    return Tangent(u[:, s > 1e-9 * s[0]], masks)


def starts(
    problem: Problem, model: Candidate, effect: Effect, missing: tuple[MissingForce, ...], absorbed: Tangent, keep: int
) -> list[Start]:
    """Return the ``keep`` best starts of ``model`` with ``effect`` added, best first."""
    ranked = []
    for values in _values(problem, model, effect, missing):
        trial = model.with_effect(effect, values)
        try:
            ranked.append(Start(trial, absorbed.cost(problem.whitened(trial))))
        except SimulationError:
            continue
    ranked.sort(key=lambda start: start.cost)
    return ranked[:keep]


def _values(problem: Problem, model: Candidate, effect: Effect, missing: tuple[MissingForce, ...]) -> list[np.ndarray]:
    """Parameter arrays (n_records, n_parameters) to try."""
    tables = []
    for seen in missing:
        if effect.propose is not None:
            shapes = effect.propose(seen.motion, seen.force, model.baseline, seen.away)
        else:
            names = [p.name for p in effect.parameters if p.starts]
            shapes = [dict(zip(names, combination, strict=True)) for combination in product(*_grids(effect))]
        tables.append([_complete(effect, shape, seen, model) for shape in shapes])
    # The first record proposes; the others follow with their own per-record numbers where they proposed as many.
    rows = []
    for index, first in enumerate(tables[0]):
        if first is None:
            continue
        row = [first]
        for table in tables[1:]:
            other = table[index] if index < len(table) and table[index] is not None else first
            row.append(np.where([p.per_record for p in effect.parameters], other, first))
        rows.append(np.array(row))
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
        design = np.column_stack([columns, absorbing])[seen.away]
        scale = np.sqrt((design**2).mean(axis=0))
        if not np.all(scale[: columns.shape[1]] > 0):
            return None
        scale[scale == 0] = 1.0
        solution = np.linalg.lstsq(design / scale, seen.force[seen.away], rcond=1e-8)[0] / scale
        shape = {**shape, **effect.from_coefficients(solution[: columns.shape[1]], shape)}
    elif absent:
        return None
    return np.array([min(max(shape[p.name], p.lower), p.upper) for p in effect.parameters])
