"""Contact of the carriage: an operator's hand with an intended motion, and a wall.

They join the plant through the hooks of an effect, so the same stepper locates their contacts; their force is the
external force ``f_ext`` that a sensor on the carriage measures, positive towards +q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.effects import Effect, Parameter, Solver
from emps_design.errors import InputError


def hand_force(q: float, v: float, t: float, tau: float, x: np.ndarray, p: np.ndarray, b: np.ndarray) -> float:
    """Force [N] with which a hand resists the motion."""
    return p[1] * (v - p[4]) + p[2] * (q - p[3] - p[4] * (t - p[5]))


def _hand_inertia(q: float, v: float, t: float, tau: float, x: np.ndarray, p: np.ndarray, b: np.ndarray) -> float:
    return p[0]


def _wall_force(q: float, v: float, t: float, tau: float, x: np.ndarray, p: np.ndarray, b: np.ndarray) -> float:
    depth = p[3] * (q - p[0])
    if depth <= 0.0:
        return 0.0
    return p[3] * max(0.0, p[1] * depth * (1.0 + p[2] * p[3] * v))


def _wall_guard(q: float, v: float, t: float, tau: float, x: np.ndarray, p: np.ndarray, b: np.ndarray) -> float:
    return p[3] * (q - p[0])


HAND = Effect(
    name="hand",
    label="Operator's hand",
    equation=r"\tau_e = B_h (\dot q_i - \dot q) + K_h (q_i - q) - M_h \ddot q",
    source="mass, damper and spring towards an intended motion q_i",
    parameters=(
        Parameter("mass", "M_h", "kg", lower=0.0),
        Parameter("damping", "B_h", "N/(m/s)", lower=0.0),
        Parameter("stiffness", "K_h", "N/m", lower=0.0),
        Parameter("intended_position", "q_i", "m"),
        Parameter("intended_velocity", r"\dot q_i", "m/s"),
        Parameter("since", "t_i", "s"),
    ),
    force=hand_force,
    inertia=_hand_inertia,
)
WALL = Effect(
    name="wall",
    label="Wall",
    equation=r"\tau_e = -K d (1 + c \dot d),\ d = \max(0, s (q - q_w))",
    source="contact with damping that grows with depth; K. Hunt, F. Crossley, J. Appl. Mech. 42 (1975)",
    parameters=(
        Parameter("position", "q_w", "m"),
        Parameter("stiffness", "K", "N/m", lower=0.0),
        Parameter("damping", "c", "s/m", lower=0.0),
        Parameter("side", "s", "", lower=-1.0, upper=1.0),
    ),
    force=_wall_force,
    solver=Solver(guard=_wall_guard),
)


@dataclass(frozen=True)
class Hand:
    """A hand on the carriage: ``mass`` [kg] moves with it; ``damping`` [N/(m/s)] and ``stiffness`` [N/m] couple to it.

    Its intended motion is the argument ``intention`` (n,) [m] of a simulation, linear between the samples; nan means
    that the hand has released the carriage. ``held``: its force is constant over a period, like the voltage of the
    drive; such a hand has no mass.

    >>> Hand(mass=1.0, damping=20.0, stiffness=500.0).stiffness
    500.0
    """

    mass: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    held: bool = False

    def __post_init__(self) -> None:
        self.effect()
        if self.held and self.mass > 0.0:
            raise InputError(f"hand: found mass={self.mass:g} with held=True, expected mass=0 or held=False")

    def effect(self) -> tuple[Effect, np.ndarray]:
        """The hand as an effect with its parameters; :class:`InputError` for a number out of its bounds."""
        parameters = {"mass": self.mass, "damping": self.damping, "stiffness": self.stiffness}
        return HAND, HAND.values({**parameters, "intended_position": 0.0, "intended_velocity": 0.0, "since": 0.0})


@dataclass(frozen=True)
class Wall:
    """A wall at ``position`` [m] on the ``side`` +1 or -1: ``stiffness`` [N/m], ``damping`` [s/m] relative to it."""

    position: float
    stiffness: float
    damping: float = 0.0
    side: float = 1.0

    def __post_init__(self) -> None:
        self.effect()
        if self.side not in (-1.0, 1.0):
            raise InputError(f"wall: found side {self.side:g}, expected +1 or -1")

    def effect(self) -> tuple[Effect, np.ndarray]:
        """The wall as an effect with its parameters; :class:`InputError` for a number out of its bounds."""
        return WALL, WALL.values(vars(self))
