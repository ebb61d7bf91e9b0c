"""Where to start fitting an effect: shapes from its own proposals or starts, linear parameters by regression.

Every start is judged in closed loop by one simulation. What it changes in the whitened residual is the effect's
*signature*; free of what re-adjusting the present model absorbs, the share of the residual along the signature is what
a fit would gain to first order, whatever the amplitude. That needs no regressor.

What a residual looks like before any effect was fitted to it: told while the search goes on, judged by nobody.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, product

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.fit import Fit, sensitivities
from emps_design.discrepancy.least_squares import Candidate, Slot
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.unknown_force import MissingForce, away_from_reversals, missing_force
from emps_design.effects import Effect, Motion
from emps_design.effects.effect import COULOMB, MASS, VISCOUS
from emps_design.effects.guesses import absorb, thin
from emps_design.errors import SimulationError
from emps_design.observer import motor_force
from emps_design.quantities import inside

PROPOSERS = 3  # records whose missing force proposes numbers; more of them only say the same again

BLOCK_TIME = 8e-3  # s, of the means that are looked at
LEAST = 0.1  # share of the residual, below which nothing stands out
MOST = 2  # that are told
FEWEST = 100  # samples of a record to look at


@dataclass(frozen=True)
class Start:
    """A hypothesis to start a fit from, its first-order ``gain`` in whitened cost, its unit ``signature`` (n,).

    ``size`` is the length of the signature before it was made unit, in standard deviations of the noise. ``anchored``:
    the rest of the model is the fitted one, whose tangent tells what it absorbs.
    """

    hypothesis: Hypothesis
    gain: float
    signature: np.ndarray
    size: float
    anchored: bool

    @property
    def model(self) -> Candidate:
        """The model to start from; its last effect is the one that was added."""
        return self.hypothesis.model


@dataclass(frozen=True)
class Tangent:
    """What re-adjusting a fitted model absorbs: an orthonormal ``basis`` (n, k), and the ``residual`` (n,) free of it.

    ``whole`` (n,) is the whitened residual with what would be absorbed.
    """

    whole: np.ndarray
    residual: np.ndarray
    basis: np.ndarray

    def free(self, vector: np.ndarray) -> np.ndarray:
        """``vector`` (n,) without its part inside the basis."""
        return vector - self.basis @ (self.basis.T @ vector)


def tangent(current: Fit, part: str = "fit", slots: tuple[Slot, ...] | None = None) -> Tangent:
    """Finite-difference sensitivities of the whitened residual to the numbers of ``current`` in ``slots``, else all."""
    base = current.residual(part)
    slots = current.model.slots() if slots is None else slots
    u, s, _ = np.linalg.svd(sensitivities(current, slots, part), full_matrices=False)
    basis = u[:, s > 1e-9 * s[0]]
    return Tangent(base, base - basis @ (basis.T @ base), basis)


def screen(current: Fit, library: tuple[Effect, ...], absorbed: Tangent) -> list[list[Start]]:
    """Starts of each effect of ``library`` that ``current`` does not have, the most promising of each first."""
    missing = missing_force(current)
    found = current.model.names
    absent = [effect for effect in library if effect.name not in found and effect.after in ("", *found)]
    # Those of drive and sensor, last in a library, take longest; short ones at the end keep both cores at work.
    tried = side_by_side(starts, [(current, effect, missing, absorbed) for effect in reversed(absent)])
    return [some for some in reversed(tried) if some]


def starts(current: Fit, effect: Effect, missing: tuple[MissingForce, ...], absorbed: Tangent) -> list[Start]:
    """Return the starts of ``current`` with ``effect`` added, the one with the largest gain first.

    A gap so large that it bent the fitted baseline is looked at from the axis file's numbers too: there the gain is
    what the start itself explains.
    """
    base = absorbed.whole
    given = current.as_given().model
    far = bent(current, float(base @ base) / base.size)

    def from_values(values: np.ndarray) -> list[Start]:
        found: list[Start] = []
        trial = current.with_model(current.model.with_effect(effect, values))
        with suppress(SimulationError):
            change = absorbed.free(trial.residual("fit") - base)
            size = float(np.linalg.norm(change))
            if size <= (rules.EXERCISED * np.sqrt(base.size) if current.problem.states else 0.0):
                return []  # all that it does could be a function of the state
            signature = change / size
            # The residual falls when the signature points against it; an effect of the wrong sign gains nothing.
            along = float(absorbed.residual @ signature)
            found.append(Start(trial, along**2 if along < 0 else 0.0, signature, size, anchored=True))
            if far:
                other = current.with_model(given.with_effect(effect, values))
                left = other.residual("fit")
                gain = max(0.0, float(base @ base - left @ left))
                found.append(Start(other, gain, signature, size, anchored=False))
        return found

    found = side_by_side(from_values, [(values,) for values in _values(current, effect, missing)])
    return sorted(chain.from_iterable(found), key=lambda start: -start.gain)


def bent(current: Fit, cost: float) -> bool:
    """Whether the gap, of ``cost`` per sample, is so large that it bent the baseline fitted to it."""
    return cost > rules.BENT and not current.model.effects


def either_baseline(fitted: Hypothesis) -> list[Hypothesis]:
    """``fitted``, and the same effects on the axis file's baseline where mass or a friction is far from it.

    What is missing, or stands in for something, may have bent the fitted numbers.
    """
    given = fitted.as_given()
    numbers = np.array([fitted.model.baseline, given.model.baseline])[:, [MASS, VISCOUS, COULOMB]]
    apart = np.any(np.ptp(numbers, axis=0) > rules.BENT_NUMBER * numbers.max(axis=0))
    return [fitted, given] if apart else [fitted]


def _values(current: Hypothesis, effect: Effect, missing: tuple[MissingForce, ...]) -> list[np.ndarray]:
    """Parameter arrays (n_records, n_parameters) to try."""
    model, tables = current.model, []
    problem = current.problem
    switches = [record.enable for record in problem.records if record.enable is not None]
    if effect.winding and not any(np.any(on == 0.0) and np.any(on) for on in switches):
        return []  # of a motor that is never off it is viscous friction
    unknown = problem.states or tuple(np.zeros((seen.force.size, 0)) for seen in missing)
    for seen, split, states in zip(missing, problem.splits, unknown, strict=True):
        if effect.propose is not None:
            force = np.where(split.used, seen.force, 0.0)  # what confirms stays closed
            proposed = effect.propose(seen.motion, force, model.baseline, seen.away)
            shapes = [effect.completed(shape) for shape in proposed]
        else:
            shapes = grid(effect)
        tables.append([_complete(effect, shape, seen, states, model) for shape in shapes])
    # The records that miss most propose; the others follow with their own per-record numbers where they do as often.
    own = np.array([p.per_record for p in effect.parameters])
    rows: list[np.ndarray] = []
    missed = [np.std(force) for force in problem.pick(tuple(seen.force for seen in missing), "used")]
    for proposer in sorted(np.argsort(missed)[::-1][:PROPOSERS]):
        for index, shape in enumerate(tables[proposer]):
            if shape is None:
                continue
            theirs = [t[index] if index < len(t) else None for t in tables]
            row = np.array([shape if values is None else np.where(own, values, shape) for values in theirs])
            if not any(np.array_equal(row, other) for other in rows):
                rows.append(row)
    return rows


def grid(effect: Effect) -> list[dict[str, float]]:
    """Every combination of the starts of the shapes of ``effect``, in its first form."""
    shapes = [p for p in effect.parameters if p.starts and p.default is None]
    names = [p.name for p in shapes]
    combinations = product(*(p.starts for p in shapes))
    return [effect.completed(dict(zip(names, combination, strict=True))) for combination in combinations]


def _complete(
    effect: Effect, shape: dict[str, float], seen: MissingForce, states: np.ndarray, model: Candidate
) -> np.ndarray | None:
    """Fill in what ``shape`` leaves out, by regression of the missing force, and hold everything within bounds.

    Beside ``states`` (n, k), what an unknown force may change in the motor's: it has taken part of the effect's.
    """
    absent = [p.name for p in effect.parameters if p.name not in shape]
    if absent and effect.regressor is not None and seen.away.sum() > 100:
        columns = effect.regressor(seen.motion, {**{p.name: 0.0 for p in effect.parameters}, **shape}, model.baseline)
        m = seen.motion
        sign = np.sign(m.v)
        absorbing = np.column_stack([m.a, m.v, sign, np.ones_like(m.v), states])
        kept = thin(seen.away)
        design = np.column_stack([columns, absorbing])[kept]
        size = np.sqrt((design**2).mean(axis=0))
        if not np.all(size[: columns.shape[1]] > 0):
            return None
        size[size == 0] = 1.0
        solution = np.linalg.lstsq(design / size, seen.force[kept], rcond=1e-8)[0] / size
        shape = {**shape, **effect.from_coefficients(solution[: columns.shape[1]], shape)}
    elif absent:
        return None
    values, strongest = [], float(np.abs(seen.motion.tau).max())
    for p in effect.parameters:
        value = min(max(shape[p.name], p.lower), p.upper)
        if p.linear and p.unit == "N":  # a column that is next to nothing where it was looked at asks for any amount
            value = min(max(value, -strongest), strongest)
        # A signature needs some of the effect, even where the regression wants none.
        least = rules.LEAST_AMPLITUDE * p.scale if p.linear and p.scale and not p.per_record else 0.0
        values.append(value if abs(value) >= least else float(np.copysign(least, value)))
    return np.array(values)


def at_first_sight(hypothesis: Hypothesis, library: tuple[Effect, ...]) -> dict[str, float]:
    """Share of the missing force that the columns of each effect of ``library`` follow, by label.

    One simulation and regressions: of effects that have columns and need not look for their shape first. What mass,
    friction and offset absorb counts for nothing. It is the first answer of a process, so it loads no package of
    filters.
    """
    quick = [effect for effect in library if effect.regressor is not None and effect.propose is None]
    explained, total = dict.fromkeys((effect.label for effect in quick), 0.0), 0.0
    for seen in _of_blocks(hypothesis):
        motion, index = seen.motion, thin(seen.away)
        if index.size <= FEWEST:
            continue
        left, basis = absorb(seen.force, motion.v, motion.a, index)
        total += float(left @ left)
        for effect in quick:
            assert effect.regressor is not None
            best = 0.0
            for shape in grid(effect):
                known = {**{p.name: 0.0 for p in effect.parameters}, **shape}
                columns = effect.regressor(motion, known, hypothesis.model.baseline)[index]
                columns = columns - basis @ (basis.T @ columns)
                best = max(best, float(left @ columns @ np.linalg.lstsq(columns, left, rcond=1e-8)[0]))
            explained[effect.label] += best
    return {label: gain / total for label, gain in explained.items()} if total > 0 else {}


def _of_blocks(hypothesis: Hypothesis) -> list[MissingForce]:
    """The missing force of a model as means over blocks of ``BLOCK_TIME``, one per record."""
    problem, baseline, found = hypothesis.problem, hypothesis.model.baseline, []
    for record, run, split in zip(problem.records, hypothesis.runs(), problem.splits, strict=True):
        size = max(1, round(BLOCK_TIME / record.period))
        signals = record.t, record.q, run.q, motor_force(problem.axis, record), run.force, record.u, split.used
        t, q, q_s, force, predicted, u, used = (_means(signal, size) for signal in signals)
        period = size * record.period
        (v, a), (v_s, a_s) = (_derivatives(place, period) for place in (q, q_s))
        missing = force - predicted - baseline[MASS] * (a - a_s) - baseline[VISCOUS] * (v - v_s)
        motion = Motion(t, q, v, a, predicted, period, u, force_gain=problem.axis.drive.gain)
        found.append(MissingForce(motion, missing, away_from_reversals(v, period) & (used == 1.0)))
    return found


def _means(signal: np.ndarray, size: int) -> np.ndarray:
    return signal[: signal.size // size * size].reshape(-1, size).mean(axis=1)


def _derivatives(q: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    v = np.gradient(q, period)
    return v, np.gradient(v, period)


def by_signature(screened: list[list[Start]], absorbed: Tangent) -> dict[str, float]:
    """Share of the residual that the best start of each effect explains to first order, by label."""
    total = float(absorbed.residual @ absorbed.residual)
    best = (some[0] for some in screened if not some[0].model.effects[-1].general)
    return {start.model.effects[-1].label: start.gain / total for start in best} if total > 0 else {}


def told(shares: dict[str, float]) -> str:
    """Words for the stage of a search: the effects with the largest ``shares``, "" where none stands out.

    >>> told({"Backlash": 0.3, "Gravity": 0.02, "End stop": 0.41})
    '; suspects: end stop 41 %, backlash 30 %'
    """
    ranked = sorted(((share, label) for label, share in shares.items() if share >= LEAST), reverse=True)[:MOST]
    named = ", ".join(f"{inside(label)} {100 * min(share, 1.0):.0f} %" for share, label in ranked)
    return f"; suspects: {named}" if named else ""
