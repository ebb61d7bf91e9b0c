"""The force a model misses: what a motor would have to add to its closed-loop simulation to move as measured.

With the measured and the simulated run of the same reference side by side, and both sliding in the same direction,

    missing = (F - F_s) - M (qdd - qdd_s) - F_v (qd - qd_s)

whatever hidden states the model has, because they are in its simulation. The hold is in both runs alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.model.recorded import CUTOFF_HZ, FASTEST
from emps_design.effects import Motion
from emps_design.effects.effect import MASS, VISCOUS
from emps_design.identification.filters import held_force, motion
from emps_design.observer import motor_share

REVERSAL_MARGIN = 0.06  # s on both sides of a reversal, where a zero-phase filter mixes the two directions
SELDOM = 0.02  # of what is used: where no more is away from reversals, the whole is looked at
SLOWEST = 2e-3  # m/s, below which the direction of motion is not certain


@dataclass(frozen=True)
class MissingForce:
    """Motion of a record (``motion.tau`` as the model predicts it), missing force (n,) [N], trusted where ``away``."""

    motion: Motion
    force: np.ndarray
    away: np.ndarray


def missing_force(hypothesis: Hypothesis, cutoff_hz: float | None = None) -> tuple[MissingForce, ...]:
    """Return the missing force of a model, one per record, low-passed at ``cutoff_hz`` [Hz] without phase.

    By default at ``CUTOFF_HZ``, or at twice the band of the command where that is faster.
    """
    problem, baseline = hypothesis.problem, hypothesis.model.baseline
    gain, bands, result = problem.axis.drive.gain, problem.recorded.bands, []
    for record, run, split, band in zip(problem.records, hypothesis.runs(), problem.splits, bands, strict=True):
        cut = cutoff_hz or max(CUTOFF_HZ, min(2.0 * band, FASTEST / record.period))
        share = motor_share(problem.axis, record)
        acting, played = replace(record, u=share * record.u), replace(record, q=run.q, u=share * run.u)
        (measured, acted), (simulated, predicted) = side_by_side(
            lambda seen, driven, cut=cut: (motion(seen, cut), held_force(driven, gain, cut)),
            [(record, acting), (played, played)],
        )
        inertia = baseline[MASS] * (measured.a - simulated.a)
        viscous = baseline[VISCOUS] * (measured.v - simulated.v)
        force = acted - predicted - inertia - viscous
        away = away_from_reversals(measured.v, record.period) & split.used
        if away.sum() <= SELDOM * split.used.sum():  # what reverses nearly all the time is seen at reversals or never
            away = away_from_reversals(measured.v, record.period, 0.0) & split.used
        result.append(MissingForce(replace(measured, tau=predicted, voltage=record.u, force_gain=gain), force, away))
    return tuple(result)


def away_from_reversals(v: np.ndarray, period: float, margin: float = REVERSAL_MARGIN) -> np.ndarray:
    """Samples (n,) bool in which ``v`` (n,) [m/s] keeps its sign for ``margin`` [s] on both sides."""
    sliding = np.abs(v) > max(SLOWEST, 0.01 * float(np.abs(v).max()))
    return sliding & ~near_reversals(v, period, margin)


def near_reversals(v: np.ndarray, period: float, margin: float) -> np.ndarray:
    """Samples (n,) bool within ``margin`` [s] of a change of sign of ``v`` (n,)."""
    near = np.zeros(v.size, bool)
    width = max(1, round(margin / period))
    for edge in np.nonzero(np.diff(np.sign(v)) != 0)[0]:
        near[max(0, edge - width) : edge + width + 1] = True
    return near


def since_reversal(v: np.ndarray) -> np.ndarray:
    """Samples (n,) since ``v`` (n,) last changed its sign.

    >>> since_reversal(np.array([1.0, 2.0, -1.0, -1.0, -2.0])).tolist()
    [0, 1, 0, 1, 2]
    """
    index = np.arange(v.size)
    turns = np.concatenate(([True], np.diff(np.sign(v)) != 0))
    return index - np.maximum.accumulate(np.where(turns, index, 0))
