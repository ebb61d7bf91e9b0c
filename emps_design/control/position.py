"""Design of the position loop around an existing velocity loop: its gain for one specification, in the sampled loop.

The specification is the overshoot of the step response to the position reference, a -3 dB bandwidth, or a stiffness: a
step of force over the largest displacement. All are computed from the linear loop of
:func:`~emps_design.control.sampled.close`, with the position loop in every n-th sample and without feed-forward, which
changes the response to the reference but not the loop. Following errors are given for each feed-forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis, Controller
from emps_design.control.margins import bisect
from emps_design.control.sampled import NestedLoop, SampledLoop, axis_loop, nested_loops
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.gains import MINUS_3_DB
from emps_design.control.velocity.sampled import step_answer, velocity_table
from emps_design.errors import InputError, SpecificationError
from emps_design.laws.library import cascade

SPECIFICATIONS = {"overshoot": "%", "bandwidth": "rad/s", "stiffness": "N/m", "kp": "1/s"}
LOWEST = 1e-4  # slowest position loop of the search, relative to the fastest
KP_CLOSE = 1.0 + 2.1e-8  # ratio of the ends of the bracket at which the search for the gain ends


@dataclass(frozen=True)
class PositionLoopDesign:
    """A position loop with gain ``kp`` [1/s], computed every ``every``-th sample, around ``velocity_loop``."""

    velocity_loop: VelocityLoopDesign
    kp: float
    every: int
    requested: dict[str, float]

    def axis(self, **feedforward: float) -> Axis:
        """The axis with this position loop and a ``feedforward`` table as its controller."""
        loop = self.velocity_loop
        estimator = loop.axis.controller.velocity_estimator
        _, table = velocity_table(loop.k_v1, loop.t_v, loop.structure, loop.filters, estimator, in_a_cascade=True)
        outer = {"position": {"kp": self.kp, "every": self.every}, "feedforward": feedforward}
        if loop.axis.controller.anti_windup is not None:
            outer["anti_windup"] = loop.axis.controller.anti_windup
        whole = {"kind": cascade.LAW.name, **table.model_dump(exclude_none=True), **outer}
        return loop.axis.replace(controller=Controller.model_validate(whole))

    def controller_table(self) -> dict[str, Any]:
        """The ``[controller]`` table of the axis file for this design, with the feed-forward of the axis."""
        feedforward = self.velocity_loop.axis.controller.feedforward
        return self.axis(**(feedforward or {})).controller.model_dump(exclude_none=True)

    @cached_property
    def loop(self) -> SampledLoop:
        """The closed loop without feed-forward."""
        return axis_loop(self.axis(), self.velocity_loop.velocity)

    @cached_property
    def nested(self) -> tuple[NestedLoop, ...]:
        """Velocity loop, position loop and whole loop, each with its margins."""
        return nested_loops(self.axis(), self.velocity_loop.velocity)

    @property
    def stable(self) -> bool:
        """Whether the whole sampled loop is stable."""
        return bool(self.loop.stable)

    def position_response(self, w: np.ndarray) -> np.ndarray:
        """From position reference to position at ``w`` (f,) [rad/s]."""
        return self.loop.position_response(w, "reference")

    @property
    def overshoot_percent(self) -> float:
        """Overshoot [%] of the response to a step of the position reference."""
        return float(max(0.0, 100.0 * (self._step_positions("reference").max() - 1.0)))

    def _step_positions(self, name: str) -> np.ndarray:
        """Positions at the ends of the samples after a unit step of an input."""
        slowest = min(self.kp, self.velocity_loop.crossover)
        return step_answer(self.loop, name, max(50, round(8.0 / (slowest * self.loop.period))))[2]

    @property
    def bandwidth(self) -> float:
        """First frequency [rad/s] at which the position has fallen to -3 dB of its reference."""
        grid = np.geomspace(0.02 * self.kp, 0.99 * math.pi / self.loop.period, 300)
        below = np.flatnonzero(np.abs(self.position_response(grid)) < MINUS_3_DB)
        if not below.size or not below[0]:
            return math.nan
        fine = np.geomspace(grid[below[0] - 1], grid[below[0]], 50)
        size = np.log(np.abs(self.position_response(fine)))
        return float(np.exp(np.interp(-math.log(MINUS_3_DB), -size, np.log(fine))))

    @property
    def stiffness(self) -> float:
        """Ratio of a step of force to its largest displacement [N/m]."""
        return float(1.0 / np.max(np.abs(self._step_positions("force"))))

    @property
    def feedforwards(self) -> dict[str, dict[str, float]]:
        """Feed-forward tables by name; the acceleration gain is that of the whole moving mass."""
        loop = self.velocity_loop
        inertia = float(loop.axis.mechanics.mass / loop.axis.drive.gain)
        return {
            "none": {},
            "velocity": {"velocity": 1.0},
            "velocity and acceleration": {"velocity": 1.0, "acceleration": inertia},
        }

    def following_errors(self) -> dict[str, dict[str, float]]:
        """Errors per velocity [m per m/s], acceleration [m per m/s^2] and jerk [m per m/s^3], by feed-forward.

        The velocity share is 1; the acceleration gain is that of the inertia. Dry friction is not considered.
        """
        loop = self.velocity_loop
        low = 0.02 * min(self.kp, 1.0 / loop.t_v)
        w = np.array([low, 2.0 * low])
        errors = {}
        for name, feedforward in self.feedforwards.items():
            ahead = axis_loop(self.axis(**feedforward), loop.velocity)
            error = (1.0 - ahead.position_response(w, "reference")) / (1j * w)
            jerk = (error[0].real - error[1].real) / (3.0 * low**2)  # of c1 + c2 jw + c3 (jw)^2
            errors[name] = {
                "velocity": float(error[0].real + jerk * low**2),
                "acceleration": float(error[0].imag / low),
                "jerk": float(jerk),
            }
        return errors

    def to_dict(self) -> dict[str, Any]:
        """Plain data: gain, requested and achieved numbers, margins and following errors."""
        achieved: dict[str, Any] = {name: None for name in ("overshoot_percent", "bandwidth", "stiffness")}
        if self.stable:
            achieved = {name: getattr(self, name) for name in achieved}
        return {
            "kp": self.kp,
            "every": self.every,
            "requested": dict(self.requested),
            "stable": self.stable,
            **achieved,
            "loops": [loop.to_dict() for loop in self.nested],
            "following_error": self.following_errors() if self.stable else None,
        }


def design_position_loop(
    velocity_loop: VelocityLoopDesign, wanted: str, value: float, every: int = 1
) -> PositionLoopDesign:
    """Return the position loop around ``velocity_loop`` that meets one specification, ``wanted`` with its ``value``.

    ``wanted`` is "overshoot" [%], "bandwidth" [rad/s], "stiffness" [N/m] or "kp" [1/s]. For an overshoot it is the
    fastest loop within it, for a kp the loop with that gain, stable or not. The position loop runs in every
    ``every``-th sample. Raises :class:`SpecificationError` if no gain meets it, with the nearest.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> inner = design_velocity_loop(machine("emps2018"), crossover=100.0)
    >>> outer = design_position_loop(inner, "bandwidth", 20.0, every=4)
    >>> round(outer.bandwidth, 3), outer.stable
    (20.0, True)
    """
    if wanted not in SPECIFICATIONS:
        raise InputError(f"position loop: found {wanted!r}, expected one of {', '.join(SPECIFICATIONS)}")
    if not math.isfinite(value) or value < 0.0 or (value == 0.0 and wanted != "overshoot"):
        found = velocity_loop.axis.units.quantity(value, SPECIFICATIONS[wanted], "g")
        raise InputError(f"position loop: found {wanted} {found}, expected a positive number")
    if not velocity_loop.sampled.stable:
        raise SpecificationError("position loop: the inner velocity loop is unstable", {})
    requested = {wanted: float(value)}

    def design(kp: float) -> PositionLoopDesign:
        return PositionLoopDesign(velocity_loop, kp, every, requested)

    if wanted == "kp":
        return design(float(value))

    def reached(kp: float) -> bool:
        """Whether a position loop with ``kp`` reaches the wanted value or is unstable."""
        trial = design(kp)
        if not trial.stable:
            return True
        if wanted == "overshoot":
            return trial.overshoot_percent > value + 1e-3
        return (trial.bandwidth if wanted == "bandwidth" else trial.stiffness) >= value

    fastest = 4.0 * velocity_loop.crossover
    grid = np.geomspace(LOWEST * fastest, fastest, 28)
    first = next((place for place, kp in enumerate(grid) if reached(float(kp))), None)
    if first is None or first == 0:
        raise _unreachable(design(float(grid[-1 if first is None else 0])), wanted, value)
    kp, _ = bisect(reached, float(grid[first - 1]), float(grid[first]), KP_CLOSE)
    if wanted == "overshoot":
        kp *= 1.0 - 1e-9
    position_loop = design(kp)
    if not position_loop.stable or (
        wanted != "overshoot" and not math.isclose(getattr(position_loop, wanted), value, rel_tol=1e-2)
    ):
        raise _unreachable(design(float(grid[first - 1])), wanted, value)
    return position_loop


def _unreachable(nearest: PositionLoopDesign, wanted: str, value: float) -> SpecificationError:
    name = "overshoot_percent" if wanted == "overshoot" else wanted
    shown, unit = nearest.velocity_loop.axis.units.quantity, SPECIFICATIONS[wanted]
    has = f"has {shown(getattr(nearest, name), unit)}" if nearest.stable else "is unstable"
    return SpecificationError(
        f"position loop: no gain gives the {wanted} of {shown(value, unit, 'g')} around this velocity loop; nearest: "
        f"kp {nearest.kp:.4g} 1/s, which {has}",
        {"kp": nearest.kp},
    )
