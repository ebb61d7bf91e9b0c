"""Contact with a wall under an impedance law: rest or bouncing, and the stiffest wall with a stable contact.

The poles of the loop in contact give one limit. Below it the Coulomb compensation, a relay, can sustain an oscillation,
and so can the encoder and a mismatch. The describing function predicts it; a simulation of the whole axis pressed
against the wall decides.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw, law_for
from emps_design.control.impedance.passivity import Clock, Environment, largest_wall, relay_oscillations, sampled_loop
from emps_design.control.impedance.robustness import break_away, exact_and_corners, stacked
from emps_design.errors import InputError, SimulationError
from emps_design.simulation.environment import Hand, Wall
from emps_design.simulation.plant import Plant

PUSHED = 0.75  # share of the time in which the hand pushes before it releases the carriage
CALM = 0.8  # an oscillation that decays to this share within a second is calming

LOWEST = 1.0 / 16.0  # softest simulated wall, relative to the linear limit
STEP, HALVINGS = math.sqrt(2.0), 3  # ratio of the simulated stiffnesses, and number of bisections of the last step
# Factor on the push, and speed of arrival relative to that of the push.
PUSHES = ((0.5, 3.0), (0.5, 0.0), (1.0, 0.0), (1.0, 1.0), (2.0, 0.0))
# An oscillation does not come to rest if from one sixth of the run to the next it keeps the share STAYS, or the share
# KEPT while it decays more slowly than the poles by the factor SLOWER.
KEPT, STAYS, SLOWER = 0.3, 0.9, 1.2
MOST = 100_000  # samples of a run


@dataclass(frozen=True)
class WallContact:
    """A push of ``force`` [N] into a wall of ``stiffness`` [N/m] at ``position`` [m], with a ``release`` [s].

    ``t`` [s], ``q`` [m], ``v`` [m/s], ``push`` [N] and ``wall_force`` [N] (negative) are arrays (n,). If the simulation
    stopped because the loop is unstable, they are empty and ``reason`` says so.
    """

    force: float
    stiffness: float
    position: float
    release: float
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    push: np.ndarray
    wall_force: np.ndarray
    reason: str = ""

    @property
    def touched(self) -> bool:
        """Whether the carriage reached the wall."""
        return bool(np.any(self.wall_force < 0.0))

    @property
    def peak_force(self) -> float | None:
        """Largest force of the wall [N]; None if the simulation stopped early."""
        return float(-self.wall_force.min()) if self.t.size else None

    @property
    def swings(self) -> tuple[float, float] | None:
        """Peak-to-peak position [m] in the second to last and in the last second of the push; None without contact."""
        if not self.touched:
            return None
        before, last = (
            self.q[(self.t >= self.release - start) & (self.t < self.release - start + 1.0)] for start in (2.0, 1.0)
        )
        return float(np.ptp(before)), float(np.ptp(last))

    @property
    def verdict(self) -> str:
        """``at rest``, ``calming``, ``bouncing``, ``not reached`` or ``unstable``."""
        if self.reason:
            return "unstable"
        if self.swings is None:
            return "not reached"
        before, last = self.swings
        if last == 0.0:
            return "at rest"
        return "calming" if last < CALM * before else "bouncing"

    def to_dict(self) -> dict[str, Any]:
        """Verdict and measures for JSON."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "force": self.force,
            "stiffness": self.stiffness,
            "position": self.position,
            "peak_force": self.peak_force,
            "swings": self.swings,
        }


def push_into_wall(
    axis: Axis,
    law: ImpedanceLaw,
    stiffness: float,
    force: float = 40.0,
    position: float = 0.02,
    duration: float = 12.0,
) -> WallContact:
    """Push the carriage with ``force`` [N] into a wall of ``stiffness`` [N/m] at ``position`` [m], then release it.

    The push lasts three quarters of ``duration`` [s]. The axis is simulated with all its effects. If the poles of the
    loop in contact (``sampled_loop`` with an ``Environment``) are unstable, it keeps bouncing. Raises
    :class:`InputError` unless push and distance are above 0.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> [push_into_wall(axis, law, stiffness).verdict for stiffness in (1e4, 2e5)]
    ['at rest', 'bouncing']
    """
    for name, value, unit in (("force", force, "N"), ("position", position, "m")):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(
                f"{axis.units.word(name)}: found {axis.units.quantity(value, unit, 'g')}, "
                f"expected more than 0 {axis.units.unit(unit)}"
            )
    period = axis.sampling.period
    n, release = round(duration / period), PUSHED * duration
    t = np.arange(n) * period
    push = np.where(t < release, force, 0.0)
    plant = Plant.of(axis).touched_by(Wall(position, stiffness))
    try:
        run = plant.closed_loop(np.zeros(n), disturbance=push, law=law_for(axis, law, period))
    except SimulationError as error:
        nothing = np.empty(0)
        return WallContact(force, stiffness, position, release, nothing, nothing, nothing, nothing, nothing, str(error))
    wall_force = np.minimum(run.f_ext - push, 0.0)
    return WallContact(force, stiffness, position, release, t, run.position, run.v, push, wall_force)


@dataclass(frozen=True)
class WallLimit:
    """Largest stiffness [N/m] of an undamped wall: by the poles, predicted, and simulated with pushes up to 2 ``push``.

    - ``linear``: the poles of every corner of the mismatch are stable up to this stiffness.
    - ``predicted``: the describing function predicts no oscillation.
    - ``simulated``: the axis comes to rest when pressed against the wall, and after a push into it. 0: not even against
      a wall of 1/16 of the linear limit.

    ``errors`` are those of the simulated corner.
    """

    linear: float
    predicted: float
    simulated: float
    push: float
    errors: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """The three limits [N/m], the push [N], and the errors of the estimates."""
        return asdict(self)


def wall_limit(axis: Axis, law: ImpedanceLaw, mismatch: float = 0.0) -> WallLimit | None:
    """Find the stiffest wall with a stable contact under ``law``, for errors of the estimates up to ``mismatch``.

    None if the poles are stable for every wall up to 1 GN/m. The simulated corner is the one with the largest predicted
    oscillation against a wall of half the linear limit.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> limit = wall_limit(axis, impedance_law(axis, 50.0, 100.0))
    >>> limit.simulated < limit.linear
    True
    """
    plant, clock, corners = FrictionModel.of(axis), Clock.of(axis), exact_and_corners(mismatch)
    laws = [law.with_errors(errors) for errors in corners]
    together = law.with_errors(stacked(corners))
    walls = [largest_wall(corner_law, plant, clock) for corner_law in laws]
    limits = [wall for wall in walls if wall is not None]
    if not limits:
        return None
    linear = min(limits)
    if linear == 0.0:
        return WallLimit(0.0, 0.0, 0.0, 0.0, corners[int(np.argmin([math.inf if w is None else w for w in walls]))])
    grid = linear * STEP ** np.arange(round(math.log(LOWEST, STEP)), 1)

    def speeds(wall: float) -> np.ndarray:
        oscillations = relay_oscillations(together, plant, clock, wall)
        return np.array([0.0 if oscillation is None else oscillation[1] for oscillation in oscillations])

    worst = int(np.argmax(speeds(0.5 * linear) - 1e-6 * np.array([wall or 0.0 for wall in walls])))
    quiet = [not speeds(wall).any() for wall in grid]
    predicted = 0.0 if not quiet[0] else float(grid[quiet.index(False) - 1] if False in quiet else linear)
    push = max(2.3 * break_away(law, plant), 0.1 * abs(complex(law.damping, 5.0 * law.mass)))
    simulated = _simulated_limit(axis, laws[worst], grid, push)
    return WallLimit(linear, predicted, min(simulated, linear), push, corners[worst])


def _simulated_limit(axis: Axis, law: ImpedanceLaw, grid: np.ndarray, push: float) -> float:
    """Largest stiffness [N/m] with rest both when pressed against the wall and after a push into it."""
    low = _resting_limit(axis, law, grid, push)
    duration = max(12.0, 24.0 * law.mass / law.damping if law.damping > 0.0 else 0.0)
    duration = min(duration, MOST * axis.sampling.period)
    while low > 0.0 and push_into_wall(axis, law, low, push, duration=duration).verdict in ("bouncing", "unstable"):
        low = low / STEP**0.25 if low > grid[0] else 0.0
    return low


def _resting_limit(axis: Axis, law: ImpedanceLaw, grid: np.ndarray, push: float) -> float:
    """Largest stiffness [N/m] at which the axis pressed against the wall comes to rest; 0 if not at the softest."""
    low = 0.0
    for wall in grid:
        if cycles(axis, law, wall, push):
            break
        low = float(wall)
    else:
        return low
    if low == 0.0:
        return 0.0
    high = STEP * low
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if cycles(axis, law, middle, push) else (middle, high)
    return low


def cycles(axis: Axis, law: ImpedanceLaw, stiffness: float, push: float) -> bool:
    """Whether the carriage keeps oscillating when pressed against a wall of ``stiffness`` [N/m] with ``push`` [N]."""
    period, resolution = axis.sampling.period, axis.sampling.encoder_resolution
    speed = math.sqrt(stiffness * law.mass)
    decay = law.mass / law.damping if law.damping > 0.0 else 0.0
    n = int(min(max(18.0 * decay, 60.0 * 2.0 * math.pi * law.mass / speed, 300.0 * period) / period, MOST))
    plant, compiled, sixth = Plant.of(axis).touched_by(Hand(stiffness=stiffness)), law_for(axis, law, period), n // 6
    friction, clock, wall = FrictionModel.of(axis), Clock.of(axis), Environment(stiffness=stiffness)
    radius = max(sampled_loop(law, friction, clock, direction, wall).radius for direction in friction.directions)
    largest_ratio = min(STAYS, max(KEPT, SLOWER * radius**sixth))
    for direction, (share, arrival) in product(friction.directions, PUSHES):
        force = np.full(n, direction * share * push)
        try:
            q = plant.closed_loop(np.zeros(n), disturbance=force, v0=arrival * force[0] / speed, law=compiled).position
        except SimulationError:
            return True
        before, last = np.ptp(q[-2 * sixth : -sixth]), np.ptp(q[-sixth:])
        if last > max(largest_ratio * before, 4.0 * resolution, 1e-4 * push / stiffness):
            return True
    return False
