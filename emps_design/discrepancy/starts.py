"""Where to start fitting an effect: shapes from its own proposals or starts, linear parameters by regression.

Every start is judged in closed loop by one simulation. Its change of the whitened residual is the effect's *signature*;
without the part that refitting the present model absorbs, the residual along the signature is the first-order gain of a
fit, whatever the amplitude. That needs no regressor.

The shares of the residual that effects explain are also shown as suspects while a search runs.
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


@dataclass(frozen=True)
class Start:
    """A hypothesis to start a fit from, its first-order ``gain`` in whitened cost, its unit ``signature`` (n,).

    ``size`` is the length of the signature before normalisation, in standard deviations of the noise. ``anchored``: the
    rest of the model is the fitted one, so that its tangent holds.
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
    """What refitting a model absorbs: an orthonormal ``basis`` (n, k), and the ``residual`` (n,) orthogonal to it.

    ``whole`` (n,) is the whitened residual before the projection.
    """

    whole: np.ndarray
    residual: np.ndarray
    basis: np.ndarray

    def free(self, vector: np.ndarray) -> np.ndarray:
        """``vector`` (n,) projected orthogonally to the basis."""
        return vector - self.basis @ (self.basis.T @ vector)


def tangent(current: Fit, part: str = "fit", slots: tuple[Slot, ...] | None = None) -> Tangent:
    """The tangent of the whitened residual at ``current``, by finite differences in ``slots``, by default all."""
    base = current.residual(part)
    slots = current.model.slots() if slots is None else slots
    u, s, _ = np.linalg.svd(sensitivities(current, slots, part), full_matrices=False)
    basis = u[:, s > 1e-9 * s[0]]
    return Tangent(base, base - basis @ (basis.T @ base), basis)


def screen(current: Fit, library: tuple[Effect, ...], absorbed: Tangent) -> list[list[Start]]:
    """Starts of each effect of ``library`` that ``current`` does not have, the most promising of each first."""
    missing = missing_force(current)
    names = current.model.names
    absent = [effect for effect in library if effect.name not in names and effect.search.after in ("", *names)]
    # Effects of drive and sensor, last in a library, take longest; short ones at the end keep both cores busy.
    tried = side_by_side(starts, [(current, effect, missing, absorbed) for effect in reversed(absent)])
    return [some for some in reversed(tried) if some]


def starts(current: Fit, effect: Effect, missing: tuple[MissingForce, ...], absorbed: Tangent) -> list[Start]:
    """Return the starts of ``current`` with ``effect`` added, the one with the largest gain first.

    A gap so large that it bent the fitted baseline is also evaluated from the axis file's baseline: there the gain is
    the reduction by the start itself.
    """
    base = absorbed.whole
    axis_model = current.with_axis_baseline().model
    far = bent(current, float(base @ base) / base.size)

    def from_values(values: np.ndarray) -> list[Start]:
        begins: list[Start] = []
        trial = current.with_model(current.model.with_effect(effect, values))
        with suppress(SimulationError):
            change = absorbed.free(trial.residual("fit") - base)
            size = float(np.linalg.norm(change))
            if size <= (rules.SLIGHT * np.sqrt(base.size) if current.problem.states else 0.0):
                return []  # its change may be a function of the state
            signature = change / size
            # The residual falls when the signature points against it; an effect of the wrong sign gains nothing.
            along = float(absorbed.residual @ signature)
            begins.append(Start(trial, along**2 if along < 0 else 0.0, signature, size, anchored=True))
            if far:
                other = current.with_model(axis_model.with_effect(effect, values))
                residual = other.residual("fit")
                gain = max(0.0, float(base @ base - residual @ residual))
                begins.append(Start(other, gain, signature, size, anchored=False))
        return begins

    groups = side_by_side(from_values, [(values,) for values in _values(current, effect, missing)])
    return sorted(chain.from_iterable(groups), key=lambda start: -start.gain)


def bent(current: Fit, cost: float) -> bool:
    """Whether a gap of ``cost`` per sample is large enough to bend the fitted baseline."""
    return cost > rules.BENT and not current.model.effects


def either_baseline(fitted: Hypothesis) -> list[Hypothesis]:
    """``fitted``, and the same effects on the axis file's baseline where mass or a friction is far from it.

    Missing effects, or ones that imitate them, may have bent the fitted baseline.
    """
    alternative = fitted.with_axis_baseline()
    numbers = np.array([fitted.model.baseline, alternative.model.baseline])[:, [MASS, VISCOUS, COULOMB]]
    apart = np.any(np.ptp(numbers, axis=0) > rules.HALF * numbers.max(axis=0))
    return [fitted, alternative] if apart else [fitted]


def _values(current: Hypothesis, effect: Effect, missing: tuple[MissingForce, ...]) -> list[np.ndarray]:
    """Parameter arrays (n_records, n_parameters) to try."""
    model, tables = current.model, []
    problem = current.problem
    switches = [record.enable for record in problem.records if record.enable is not None]
    if effect.winding and not any(np.any(on == 0.0) and np.any(on) for on in switches):
        return []  # without a switched-off motor it equals viscous friction
    unknown = problem.states or tuple(np.zeros((gap.force.size, 0)) for gap in missing)
    for gap, split, states in zip(missing, problem.splits, unknown, strict=True):
        if effect.search.propose is not None:
            force = np.where(split.used, gap.force, 0.0)  # what confirms stays closed
            proposed = effect.search.propose(gap.motion, force, model.baseline, gap.away)
            shapes = [effect.completed(shape) for shape in proposed]
        else:
            shapes = grid(effect)
        tables.append([_complete(effect, shape, gap, states, model) for shape in shapes])
    # Records with the largest missing force propose; the others take the shape with their own per-record parameters.
    own = np.array([p.per_record for p in effect.parameters])
    rows: list[np.ndarray] = []
    missed = [np.std(force) for force in problem.pick(tuple(gap.force for gap in missing), "used")]
    for proposer in sorted(np.argsort(missed)[::-1][: rules.A_FEW]):
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
    effect: Effect, shape: dict[str, float], missing: MissingForce, states: np.ndarray, model: Candidate
) -> np.ndarray | None:
    """Parameters (n_parameters,) of ``shape``, missing ones by regression of the missing force, within bounds.

    Beside ``states`` (n, k), which an unknown force may explain. None where the regression is impossible.
    """
    absent = [p.name for p in effect.parameters if p.name not in shape]
    if absent and effect.regressor is not None and missing.away.sum() > rules.FEWEST_TO_SELECT:
        columns = effect.regressor(
            missing.motion, {**{p.name: 0.0 for p in effect.parameters}, **shape}, model.baseline
        )
        m = missing.motion
        sign = np.sign(m.v)
        absorbing = np.column_stack([m.a, m.v, sign, np.ones_like(m.v), states])
        kept = thin(missing.away)
        design = np.column_stack([columns, absorbing])[kept]
        size = np.sqrt((design**2).mean(axis=0))
        if not np.all(size[: columns.shape[1]] > 0):
            return None
        size[size == 0] = 1.0
        solution = np.linalg.lstsq(design / size, missing.force[kept], rcond=1e-8)[0] / size
        shape = {**shape, **effect.from_coefficients(solution[: columns.shape[1]], shape)}
    elif absent:
        return None
    values, strongest = [], float(np.abs(missing.motion.tau).max())
    for p in effect.parameters:
        value = min(max(shape[p.name], p.lower), p.upper)
        if p.linear and p.unit == "N":  # a column near zero on these samples does not limit its amplitude
            value = min(max(value, -strongest), strongest)
        # A signature needs some of the effect, even where the regression wants none.
        least = rules.SLIGHT * p.scale if p.linear and p.scale and not p.per_record else 0.0
        values.append(value if abs(value) >= least else float(np.copysign(least, value)))
    return np.array(values)


def at_first_sight(hypothesis: Hypothesis, library: tuple[Effect, ...]) -> dict[str, float]:
    """Share of the missing force that the columns of each effect of ``library`` follow, by label.

    One simulation and regressions, for effects with columns whose shape is known. What mass, friction and offset absorb
    does not count. It is the first output of a process, so it imports no filter package.
    """
    quick = [effect for effect in library if effect.regressor is not None and effect.search.propose is None]
    explained, total = dict.fromkeys((effect.label for effect in quick), 0.0), 0.0
    for missing in _of_blocks(hypothesis):
        motion, index = missing.motion, thin(missing.away)
        if index.size <= rules.FEWEST_TO_SELECT:
            continue
        residual, basis = absorb(missing.force, motion.v, motion.a, index)
        total += float(residual @ residual)
        for effect in quick:
            assert effect.regressor is not None
            best = 0.0
            for shape in grid(effect):
                known = {**{p.name: 0.0 for p in effect.parameters}, **shape}
                columns = effect.regressor(motion, known, hypothesis.model.baseline)[index]
                columns = columns - basis @ (basis.T @ columns)
                best = max(best, float(residual @ columns @ np.linalg.lstsq(columns, residual, rcond=1e-8)[0]))
            explained[effect.label] += best
    return {label: gain / total for label, gain in explained.items()} if total > 0 else {}


def _of_blocks(hypothesis: Hypothesis) -> list[MissingForce]:
    """The missing force of a model as means over blocks of ``rules.BLOCK_TIME``, one per record."""
    problem, baseline, gaps = hypothesis.problem, hypothesis.model.baseline, []
    for record, run, split in zip(problem.records, hypothesis.runs(), problem.splits, strict=True):
        size = max(1, round(rules.BLOCK_TIME / record.period))
        signals = record.t, record.q, run.q, motor_force(problem.axis, record), run.force, record.u, split.used
        t, q, q_s, force, predicted, u, used = (_means(signal, size) for signal in signals)
        period = size * record.period
        (v, a), (v_s, a_s) = (_derivatives(place, period) for place in (q, q_s))
        missing = force - predicted - baseline[MASS] * (a - a_s) - baseline[VISCOUS] * (v - v_s)
        motion = Motion(t, q, v, a, predicted, period, u, force_gain=problem.axis.drive.gain)
        gaps.append(MissingForce(motion, missing, away_from_reversals(v, period) & (used == 1.0)))
    return gaps


def _means(signal: np.ndarray, size: int) -> np.ndarray:
    return signal[: signal.size // size * size].reshape(-1, size).mean(axis=1)


def _derivatives(q: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    v = np.gradient(q, period)
    return v, np.gradient(v, period)


def by_signature(screened: list[list[Start]], absorbed: Tangent) -> dict[str, float]:
    """Share of the residual that the best start of each effect explains to first order, by label."""
    total = float(absorbed.residual @ absorbed.residual)
    best = (some[0] for some in screened if not some[0].model.effects[-1].search.general)
    return {start.model.effects[-1].label: start.gain / total for start in best} if total > 0 else {}


def suspects_text(shares: dict[str, float]) -> str:
    """Text for the stage of a search: the effects with the largest ``shares``, "" where all are small.

    >>> suspects_text({"Backlash": 0.3, "Gravity": 0.02, "End stop": 0.41})
    '; suspects: end stop 41 %, backlash 30 %'
    """
    ranked = sorted(((share, label) for label, share in shares.items() if share >= rules.MINOR), reverse=True)[
        : rules.FEW
    ]
    named = ", ".join(f"{inside(label)} {100 * min(share, 1.0):.0f} %" for share, label in ranked)
    return f"; suspects: {named}" if named else ""
