"""An experiment run once on the nonlinear axis before it runs on the machine: what it reaches, and how much to keep.

The linear loop says what the excitation adds to steady motion. It knows neither the ramps of the passes, nor what comes
and goes between two steps, nor a controller whose own share of the command meets its limit before the sum does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError, SimulationError
from emps_design.simulation import Plant

TRIES = 12
SHRINKS, STEP = 0.98, 0.5  # of what the linear loop says has to go, and where it cannot say


@dataclass(frozen=True, eq=False)
class Signals:
    """What the loop is given: ``q_ref`` (n,) [m], ``excitation`` (n,) [V], and ``excited`` (n,) where one of them is.

    ``passes`` (n,) [m/s] is the velocity of the passes alone: an excitation that the reference carries is not in it.
    """

    q_ref: np.ndarray
    excitation: np.ndarray
    excited: np.ndarray
    passes: np.ndarray


@dataclass(frozen=True)
class Bound:
    """A ``limit`` of what is ``reached``; ``name`` and ``unit`` are for words."""

    name: str
    limit: float
    reached: Callable[[Reached], float]
    unit: str


@dataclass(frozen=True)
class Reached:
    """Largest velocity [m/s] and command [V] of a simulated experiment, its slowest excited pass, travel [m].

    ``own`` [V] is the controller's share of the command, which a drive limits before anything is added.
    """

    velocity: float
    slowest: float
    command: float
    own: float
    travel: float


def rehearsed(axis: Axis, bounds: list[Bound], signals: Callable[[float], Signals]) -> tuple[float, Reached, str]:
    """The largest share of the excitation whose ``signals(share)`` stay within ``bounds``; what it reaches.

    Also the name of the bound that took some of it away, "" where all may stay. Raises :class:`InputError` where the
    passes alone do not stay within the bounds.
    """
    alone = _reached(axis, signals(0.0))
    if alone is None:
        raise InputError("speed: the passes alone cannot be simulated, expected a lower speed")
    for bound in bounds:
        if bound.reached(alone) > bound.limit:
            raise InputError(
                f"{bound.name}: the passes alone reach {bound.reached(alone):.4g} {bound.unit}, expected at most "
                f"{bound.limit:.4g} {bound.unit}: a lower speed, or more stroke to run to it"
            )
    share, bound_by = 1.0, ""
    for _ in range(TRIES):
        found = _reached(axis, signals(share))
        over = bounds[:1] if found is None else [bound for bound in bounds if bound.reached(found) > bound.limit]
        if found is not None and not over:
            return share, found, bound_by
        bound_by = over[0].name
        if found is None or max(found.command, found.own) >= axis.drive.command_limit * (1.0 - 1e-9):
            share *= STEP  # beyond its limit nothing tells how much too large a command is
        else:
            share *= SHRINKS * min(_left_for(bound, alone, found) for bound in over)
    raise InputError(f"{bound_by}: found no excitation that stays within it, expected a lower speed")


def _left_for(bound: Bound, alone: Reached, found: Reached) -> float:
    """The share of an excitation that ``bound`` leaves, from what the passes reach without it and with it."""
    still = bound.reached(alone)
    return (bound.limit - still) / (bound.reached(found) - still)


def _reached(axis: Axis, signals: Signals) -> Reached | None:
    """What is reached in closed loop; None where the simulation cannot go on."""
    try:
        run = Plant.of(axis).closed_loop(signals.q_ref, voltage_noise=signals.excitation)
    except SimulationError:
        return None
    forwards = (run.v * np.sign(signals.passes))[signals.excited]
    return Reached(
        velocity=float(np.abs(run.v).max()),
        slowest=float(forwards.min()) if forwards.size else 0.0,
        command=float(np.abs(run.u).max()),
        own=float(np.abs(run.u - signals.excitation).max()),
        travel=float(np.ptp(run.position)),
    )
