"""What a residual looks like before any effect was fitted to it: told while the search goes on, judged by nobody."""

from __future__ import annotations

import numpy as np

from emps_design.discrepancy.model.missing_force import MissingForce, away_from_reversals
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.starts import Start, Tangent, grid
from emps_design.effects import Effect, Motion
from emps_design.effects.effect import MASS, VISCOUS
from emps_design.effects.guesses import absorb, thin
from emps_design.observer import motor_force
from emps_design.quantities import inside

BLOCK_TIME = 8e-3  # s, of the means that are looked at
LEAST = 0.1  # share of the residual, below which nothing stands out
MOST = 2  # that are told
FEWEST = 100  # samples of a record to look at


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
