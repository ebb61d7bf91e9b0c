"""What the carriage is attached to, and what a force sensor between the two reads."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.control.plant.linear_plant import POSITION, VELOCITY, LinearPlant


@dataclass(frozen=True)
class Environment:
    """What the carriage is attached to: added mass [kg], damping [N/(m/s)] and stiffness to ground [N/m].

    A passive hand is ``tau_e = -(mass qdd + damping qd + stiffness q)``; a stiff wall has stiffness alone.
    """

    mass: float | np.ndarray = 0.0
    damping: float | np.ndarray = 0.0
    stiffness: float | np.ndarray = 0.0


FREE = Environment()


@dataclass(frozen=True)
class Felt:
    """What the force sensor reads at a sample: ``state`` (..., n) x + ``voltage`` u + ``force`` f_ext [N].

    ``u`` is the voltage that acted until then, f_ext the force from outside, held from then on.
    """

    state: np.ndarray
    voltage: np.ndarray | float = 0.0
    force: np.ndarray | float = 1.0


def attached(plant: LinearPlant, environment: Environment) -> LinearPlant:
    """Return ``plant`` with the ``environment`` on its carriage; arrays (m,) in it make m plants.

    >>> from emps_design.control.plant.linear_plant import rigid_plant
    >>> attached(rigid_plant(2.0, 6.0), Environment(mass=1.0, stiffness=30.0)).A.tolist()
    [[0.0, 1.0], [-10.0, -2.0]]
    """
    share = np.asarray(plant.E[..., VELOCITY] / (plant.E[..., VELOCITY] * environment.mass + 1.0))
    share = share / plant.E[..., VELOCITY]  # of the force that is left to the carriage's own mass
    shape = np.broadcast_shapes(share.shape, np.shape(environment.damping), np.shape(environment.stiffness))
    A = np.broadcast_to(plant.A, (*shape, *plant.A.shape[-2:])).copy()
    B, E = (np.broadcast_to(x, (*shape, x.shape[-1])).copy() for x in (plant.B, plant.E))
    A[..., VELOCITY, :] *= share[..., None]
    B[..., VELOCITY] *= share
    E[..., VELOCITY] *= share
    A[..., VELOCITY, POSITION] -= E[..., VELOCITY] * environment.stiffness
    A[..., VELOCITY, VELOCITY] -= E[..., VELOCITY] * environment.damping
    return replace(plant, A=A, B=B, E=E)


def felt(plant: LinearPlant, environment: Environment) -> Felt:
    """What a sensor between the carriage of ``plant``, as :func:`attached`, and the ``environment`` reads.

    All of the environment's force, inertia included, and the force from outside.
    """
    mass = np.asarray(environment.mass)
    state = -mass[..., None] * plant.A[..., VELOCITY, :]
    state = np.broadcast_to(state, np.broadcast_shapes(state.shape, plant.A.shape[:-1])).copy()
    state[..., POSITION] -= environment.stiffness
    state[..., VELOCITY] -= environment.damping
    return Felt(state, -mass * plant.B[..., VELOCITY], 1.0 - mass * plant.E[..., VELOCITY])
