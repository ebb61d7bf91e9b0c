"""Mass change: at an instant the moving mass changes to (1 + change) times its value.

A payload is picked up or set down; it has the velocity of the carriage at that instant.
"""

from math import inf

import numpy as np

from emps_design.effects import guesses as search
from emps_design.effects.effect import MASS, SNAP, Effect, Motion, Parameter, Parameters, Search, Solver, Words

PARAMETERS = (
    Parameter("change", "c", "", -0.9, 10.0, linear=True, scale=0.1, text="relative change of the mass"),
    Parameter("time", "t_0", "s", lower=0.0, per_record=True, scale=0.1, text="instant of the change"),
)


def inertia(q, v, t, tau, x, p, b):
    if t >= p[1] - SNAP:
        return p[0] * b[MASS]
    return 0.0


def jump_time(q, v, t, tau, x, p, b):
    if t < p[1] - SNAP:
        return p[1]
    return inf


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return (b[MASS] * motion.a * motion.smooth((motion.t >= shape["time"] - SNAP).astype(float)))[:, None]


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    return [{"time": at} for at in search.instants(residual, motion.t, motion.v, motion.a, away, motion.a)]


def plausible(parameters: Parameters, motion: Motion) -> bool:
    return 0.05 < parameters["time"] / float(motion.t[-1]) < 0.95  # otherwise the record has only one mass


def expression(q, v, t, tau, p, b):
    import sympy

    return p["change"] * b[MASS] * sympy.Piecewise((1, t >= p["time"]), (0, True))


EFFECT = Effect(
    name="mass_change",
    label="Mass change",
    equation=r"F = c\,M \ddot q \;\text{ for } t \ge t_0",
    source="payload; M. Gautier, weighing with the inverse dynamic model",
    parameters=PARAMETERS,
    inertia=inertia,
    over="t",
    regressor=regressor,
    expression=expression,
    solver=Solver(jump_time=jump_time),
    search=Search(
        propose=propose,
        plausible=plausible,
        confused_with=("friction_drift", "load_dependent_friction", "actuator_saturation"),
    ),
    words=Words(
        where="during accelerations after one instant, not before",
        experiment="the same stroke before and after the suspected instant, at two accelerations",
        remedy="schedule mass and gains with the payload; the crossover of the velocity loop is proportional to 1/M",
    ),
    checks=(
        ({"change": 0.1, "time": 8.0}, {"t": 7.9}, 0.0),
        ({"change": 0.1, "time": 8.0}, {"t": 8.1}, 10.0),
    ),
)
