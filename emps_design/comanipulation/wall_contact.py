"""A push into a wall under an impedance law: does the carriage come to rest against it, or bounce for ever?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance.law import ImpedanceLaw, law_for
from emps_design.errors import InputError, SimulationError
from emps_design.simulation.environment import Wall
from emps_design.simulation.plant import Plant

PUSHED = 0.75  # share of the time during which the push lasts; then the hand lets go
CALM = 0.8  # a swing that shrinks to this share of itself within a second calms down


@dataclass(frozen=True)
class WallContact:
    """A push of ``force`` [N] into a wall of ``stiffness`` [N/m] at ``position`` [m], let go at ``release`` [s].

    ``t`` [s], ``q`` [m], ``v`` [m/s], ``push`` [N], ``wall_force`` [N] (negative): arrays (n,),
    empty where the simulation found the loop unstable and gave up; ``reason`` says so.
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
        """Whether the carriage came to the wall."""
        return bool(np.any(self.wall_force < 0.0))

    @property
    def peak_force(self) -> float | None:
        """Largest force of the wall [N]; None where the simulation gave up."""
        return float(-self.wall_force.min()) if self.t.size else None

    @property
    def swings(self) -> tuple[float, float] | None:
        """Peak to peak of the position [m] in the last second but one of the push, and in the last."""
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
    """Push the carriage with ``force`` [N] into a wall of ``stiffness`` [N/m] at ``position`` [m], then let go.

    The push lasts three quarters of ``duration`` [s]. The axis is simulated with all its effects. Where the poles of
    the loop in contact (``sampled_loop`` with an ``Environment``) are unstable, it bounces for ever. Raises
    :class:`InputError` for a push or a distance that is not above 0.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> [push_into_wall(axis, law, stiffness).verdict for stiffness in (1e4, 2e5)]
    ['at rest', 'bouncing']
    """
    for name, value, unit in (("force", force, "N"), ("position", position, "m")):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name}: found {value:g} {unit}, expected more than 0 {unit}")
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
