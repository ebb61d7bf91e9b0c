"""Starting values of an effect: shapes from its own proposals or starts, linear parameters by regression.

Every start is evaluated in closed loop by one simulation. The change that it makes in the whitened residual is the
*signature* of the effect. Without the part that a refit of the present model absorbs, the projection of the residual
onto the signature gives the first-order gain of a fit, for any amplitude. This needs no regressor.

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
    rest of the model is the fitted one, so its tangent is valid.
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
    """The changes that a refit of a model absorbs: orthonormal ``basis`` (n, k), ``residual`` (n,) orthogonal to it.

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
    """Starts of each effect of ``library`` that ``current`` does not have, the one with the largest gain first."""
    missing = missing_force(current)
    names = current.model.names
    absent = [effect for effect in library if effect.name not in names and effect.search.after in ("", *names)]
    # Effects of drive and sensor, last in a library, take longest; starting with them keeps both cores busy.
    groups = side_by_side(starts, [(current, effect, missing, absorbed) for effect in reversed(absent)])
    return [group for group in reversed(groups) if group]


def starts(current: Fit, effect: Effect, missing: tuple[MissingForce, ...], absorbed: Tangent) -> list[Start]:
    """Return the starts of ``current`` with ``effect`` added, the one with the largest gain first.

    If the gap is so large that it biases the fitted baseline, the starts are also evaluated with the baseline of the
    axis file; there the gain is the cost reduction by the start itself.
    """
    base = absorbed.whole
    axis_model = current.with_axis_baseline().model
    biased = bent(current, float(base @ base) / base.size)

    def from_values(values: np.ndarray) -> list[Start]:
        begins: list[Start] = []
        trial = current.with_model(current.model.with_effect(effect, values))
        with suppress(SimulationError):
            change = absorbed.free(trial.residual("fit") - base)
            size = float(np.linalg.norm(change))
            if size <= (rules.SLIGHT * np.sqrt(base.size) if current.problem.states else 0.0):
                return []  # its change may be a function of the state
            signature = change / size
            # The cost falls if the signature is opposite to the residual; an effect of the wrong sign gains nothing.
            projection = float(absorbed.residual @ signature)
            begins.append(Start(trial, projection**2 if projection < 0 else 0.0, signature, size, anchored=True))
            if biased:
                other = current.with_model(axis_model.with_effect(effect, values))
                residual = other.residual("fit")
                gain = max(0.0, float(base @ base - residual @ residual))
                begins.append(Start(other, gain, signature, size, anchored=False))
        return begins

    groups = side_by_side(from_values, [(values,) for values in _values(current, effect, missing)])
    return sorted(chain.from_iterable(groups), key=lambda start: -start.gain)


def bent(current: Fit, cost: float) -> bool:
    """Whether a gap of ``cost`` per sample is large enough to bias the fitted baseline."""
    return cost > rules.BENT and not current.model.effects


def either_baseline(fitted: Hypothesis) -> list[Hypothesis]:
    """``fitted``, and the same effects with the baseline of the axis file if mass or friction differs much from it.

    Missing effects, or effects that imitate them, may have biased the fitted baseline.
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
            force = np.where(split.used, gap.force, 0.0)  # without held-out samples
            proposed = effect.search.propose(gap.motion, force, model.baseline, gap.away)
            shapes = [effect.completed(shape) for shape in proposed]
        else:
            shapes = grid(effect)
        tables.append([_complete(effect, shape, gap, states, model) for shape in shapes])
    # Records with the largest missing force propose; the others take the shape with their own per-record parameters.
    per_record = np.array([p.per_record for p in effect.parameters])
    rows: list[np.ndarray] = []
    missing_rms = [np.std(force) for force in problem.pick(tuple(gap.force for gap in missing), "used")]
    for proposer in sorted(np.argsort(missing_rms)[::-1][: rules.A_FEW]):
        for index, shape in enumerate(tables[proposer]):
            if shape is None:
                continue
            proposals = [t[index] if index < len(t) else None for t in tables]
            row = np.array([shape if values is None else np.where(per_record, values, shape) for values in proposals])
            if not any(np.array_equal(row, other) for other in rows):
                rows.append(row)
    return rows


def grid(effect: Effect) -> list[dict[str, float]]:
    """Every combination of the starting values of the shapes of ``effect``, in its first form."""
    shapes = [p for p in effect.parameters if p.starts and p.default is None]
    names = [p.name for p in shapes]
    combinations = product(*(p.starts for p in shapes))
    return [effect.completed(dict(zip(names, combination, strict=True))) for combination in combinations]


def _complete(
    effect: Effect, shape: dict[str, float], missing: MissingForce, states: np.ndarray, model: Candidate
) -> np.ndarray | None:
    """Parameters (n_parameters,) of ``shape``, within bounds; those not given by regression of the missing force.

    ``states`` (n, k) are further regressors, for an unknown force. None if the regression is impossible.
    """
    absent = [p.name for p in effect.parameters if p.name not in shape]
    if absent and effect.regressor is not None and missing.away.sum() > rules.FEWEST_TO_SELECT:
        columns = effect.regressor(
            missing.motion, {**{p.name: 0.0 for p in effect.parameters}, **shape}, model.baseline
        )
        m = missing.motion
        sign = np.sign(m.v)
        absorbing = np.column_stack([m.a, m.v, sign, np.ones_like(m.v), states])
        places = thin(missing.away)
        design = np.column_stack([columns, absorbing])[places]
        size = np.sqrt((design**2).mean(axis=0))
        if not np.all(size[: columns.shape[1]] > 0):
            return None
        size[size == 0] = 1.0
        solution = np.linalg.lstsq(design / size, missing.force[places], rcond=1e-8)[0] / size
        shape = {**shape, **effect.from_coefficients(solution[: columns.shape[1]], shape)}
    elif absent:
        return None
    values, strongest = [], float(np.abs(missing.motion.tau).max())
    for p in effect.parameters:
        value = min(max(shape[p.name], p.lower), p.upper)
        if p.linear and p.unit == "N":  # a column near zero on these samples does not limit its amplitude
            value = min(max(value, -strongest), strongest)
        # A signature needs a nonzero amplitude, even if the regression gives zero.
        least = rules.SLIGHT * p.scale if p.linear and p.scale and not p.per_record else 0.0
        values.append(value if abs(value) >= least else float(np.copysign(least, value)))
    return np.array(values)


def quick_suspects(hypothesis: Hypothesis, library: tuple[Effect, ...]) -> dict[str, float]:
    """Share of the missing force that the columns of each effect of ``library`` explain, by label.

    One simulation, and regressions for effects whose columns have a known shape; the part explained by mass, friction
    and offset does not count. This is the first output of a process, so it imports no filter package.
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
    best = (group[0] for group in screened if not group[0].model.effects[-1].search.general)
    return {start.model.effects[-1].label: start.gain / total for start in best} if total > 0 else {}


def suspects_text(shares: dict[str, float]) -> str:
    """The effects with the largest ``shares``, as text for the progress of a search; "" if all are small.

    >>> suspects_text({"Backlash": 0.3, "Gravity": 0.02, "End stop": 0.41})
    '; suspects: end stop 41 %, backlash 30 %'
    """
    ranked = sorted(((share, label) for label, share in shares.items() if share >= rules.MINOR), reverse=True)[
        : rules.FEW
    ]
    named = ", ".join(f"{inside(label)} {100 * min(share, 1.0):.0f} %" for share, label in ranked)
    return f"; suspects: {named}" if named else ""
