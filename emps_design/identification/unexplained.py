"""What a fit leaves of the force, and how much of that comes again wherever the motion does: no noise, but structure.

Noise of one moment says nothing of another. So the residual at a moment is compared with its mean at the moments of
other strokes at which position, velocity and acceleration were nearest: their product is on the average the square of
what repeats (a nearest-neighbour estimate of the residual variance: E. Liitiainen et al., 2008). Structure that repeats
with every stroke tells no more in ten strokes than in one, and the intervals are widened by that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.identification.chains import LONG
from emps_design.identification.excitation import follows
from emps_design.identification.filters import motion
from emps_design.identification.problem import Problem
from emps_design.identification.statistics import LongRun
from emps_design.records import Record

STATES = ((0, 1, 2), (1,), (0,))  # of position, velocity, acceleration: all, or one by which the others are passed over
NEIGHBOURS, WITHIN = 6, 64  # moments whose residuals are averaged, among so many that are nearest
SLOWER = 0.25  # of the cut-off, below which a motion without a reference is what was meant
ALIKE = 1e-3  # of the deviation of a state, within which two are the same
MOST_STATES = 0.5  # of them have such neighbours, at least
APART = 4.0  # correlation times between two moments that are compared, at least
MOST, SAMPLED, FEWEST_ROWS = 8000, 300, 120  # rows that are looked at, or counted, and at least
FEWEST_BLOCKS = 12  # of independent moments, to tell structure from chance
CERTAIN = 4.0  # deviations of the mean product from zero
LITTLE = 0.02  # of the force: structure below it goes without a word, though the intervals hold it
MUCH = 0.2  # of the force: more left is said, whether it repeats or not


@dataclass(frozen=True)
class Unexplained:
    """What a fit leaves of the force: ``share`` of its rms, of which ``structure`` repeats with the motion.

    ``passes`` is how often the record comes by the same state; ``widening`` the factor of the deviations.
    """

    share: float
    structure: float
    passes: float
    widening: float

    @property
    def noise(self) -> float:
        """Share of the force's rms that does not repeat."""
        return float(np.sqrt(max(self.share**2 - self.structure**2, 0.0)))

    @property
    def matters(self) -> bool:
        """Whether the model lacks something that a user should know of."""
        return self.structure > LITTLE or self.share > MUCH

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "share": self.share,
            "structure": self.structure,
            "noise": self.noise,
            "passes": self.passes,
            "widening": self.widening,
        }

    def warnings(self) -> list[str]:
        """What a user should know, and the next step."""
        if not self.matters:
            return []
        left = f"the model leaves {100.0 * self.share:.2g} % of the force unexplained"
        if self.structure > LITTLE:
            left += (
                f", and {100.0 * self.structure:.2g} % comes again with the same motion, so it is no noise (noise: "
                f"{100.0 * self.noise:.2g} %); the intervals are {self.widening:.2g} times as wide for it"
            )
        return [f"{left}: the machine has something that the model lacks; next: diagnose, which names it"]


def unexplained(problem: Problem, residual: np.ndarray, spread: LongRun) -> Unexplained:
    """Compare the ``residual`` (n,) [N] of ``problem`` with itself where the same motion comes again."""
    steps, away = problem.filtered.independent_rows
    every = steps * max(1, -(-len(residual) // steps // MOST))
    rows = np.flatnonzero(away[::every]) * every
    left, force = residual[rows], problem.Y[rows]
    share = float(np.linalg.norm(left) / max(float(np.linalg.norm(force)), 1e-300))
    none = Unexplained(share, 0.0, 1.0, 1.0)
    if problem.filtered.chain != "hold" or rows.size < FEWEST_ROWS or len(problem.record) > LONG:
        return none
    state = _state(problem)[rows]
    state /= np.maximum(np.std(state, axis=0), 1e-300)
    state += ALIKE * np.random.default_rng(0).standard_normal(state.shape)  # of what is equal, any may be nearest
    t, power = problem.filtered.t[rows], float(np.mean(left**2))
    # Structure is correlated along a stroke, too: no longer than leaves enough blocks to tell it from chance.
    longest = (t[-1] - t[0]) / (2 * FEWEST_BLOCKS)
    apart = min(APART * max(spread.correlation_time, problem.filtered.period * every), longest)
    best, of = max((_repeated(state[:, columns], left, t, apart), columns) for columns in STATES)
    if not best > 0.0:
        return none
    part, passes = min(best / power, 1.0), _passes(state[:, of], t, spread.correlation_time, apart)
    return Unexplained(share, share * part**0.5, passes, float(np.sqrt(1.0 - part + part * passes)))


def _state(problem: Problem) -> np.ndarray:
    """Position, velocity and acceleration (n, 3) that were meant: what noise does to the motion tells of the noise.

    Those of the reference where the motion follows it, late or not, else of the motion well below the cut-off.
    """
    record, band = problem.record, problem.filtered.band_hz
    late = late_reference(record) if record.q_ref_recorded else record
    if record.q_ref_recorded and follows(late):
        seen = motion(replace(record, q=late.q_ref), band)
    else:
        seen = motion(record, SLOWER * band)
    return np.column_stack([problem.filtered.reduce(one) for one in (seen.q, seen.v, seen.a)])


def late_reference(record: Record) -> Record:
    """The ``record`` with its reference as late as the motion is behind it on the average.

    >>> t = np.arange(1000) * 1e-3
    >>> record = Record(t=t, q_ref=np.sin(9.0 * t), q=np.sin(9.0 * (t - 0.03)), u=t, period=1e-3)
    >>> follows(record), follows(late_reference(record))
    (False, True)
    """
    speed = np.gradient(record.q_ref, record.period)
    lag = float(speed @ (record.q_ref - record.q)) / max(float(speed @ speed), 1e-300)
    return replace(record, q_ref=np.interp(record.t - max(lag, 0.0), record.t, record.q_ref))


def _repeated(state: np.ndarray, left: np.ndarray, t: np.ndarray, apart: float) -> float:
    """Power of what repeats in ``left`` (n,) with the ``state`` (n, k), 0 where chance does as much."""
    from scipy.spatial import cKDTree

    near = cKDTree(state).query(state, min(len(state), WITHIN))[1]
    other = np.abs(t[near] - t[:, None]) > apart
    other &= np.cumsum(other, axis=1) <= NEIGHBOURS
    count = other.sum(axis=1)
    known = count > 0
    if np.mean(known) < MOST_STATES:
        return 0.0
    mean = np.where(other, left[near], 0.0).sum(axis=1)[known] / count[known]
    product = left[known] * mean
    # The product of noise is independent from one block of time to the next.
    block = np.floor((t[known] - t[0]) / apart).astype(int)
    power = float(product.mean())
    deviation = float(np.sqrt(np.sum(np.bincount(block, product - power) ** 2))) / product.size
    enough = np.unique(block).size >= FEWEST_BLOCKS
    return power if enough and power > CERTAIN * deviation else 0.0


def _passes(state: np.ndarray, t: np.ndarray, time: float, apart: float) -> float:
    """How often the record comes by the same ``state`` (n, k): as near as it moves in its correlation ``time`` [s]."""
    from scipy.spatial import cKDTree

    step = max(1, round(time / float(np.median(np.diff(t)))))
    radius = float(np.median(np.linalg.norm(state[step:] - state[:-step], axis=1)))
    asked = np.arange(0, len(t), max(1, len(t) // SAMPLED))
    times = [np.sort(t[near]) for near in cKDTree(state).query_ball_point(state[asked], radius)]
    return float(np.mean([1 + np.sum(np.diff(one) > apart) for one in times]))
