"""Actuator lag: the force follows G_tau u with a first-order lag, time_constant df/dt + f = tau.

A current loop of finite bandwidth; the same physics as ``drive.current_time_constant`` of the axis file, identified
from a record. The state is the acting force f; the extra force on the left-hand side is tau - f. The regressor
time_constant df/dt is exact if f is the force that the motion needs.
"""

import numpy as np

from emps_design.effects.effect import Effect, Motion, Parameter, Parameters, Search, Solver, Words
from emps_design.quantities import Quantity

PARAMETERS = (
    Parameter("time_constant", "T_i", "s", 1e-5, 50e-3, linear=True, starts=(0.3e-3, 1e-3, 2e-3, 4e-3),
              text="time constant of the force"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return tau - x[0]


def rate(q, v, t, tau, x, p, b, level, dx):
    dx[0] = (tau - x[0]) / p[0]


def lag(q, v, t, tau, x, p, b):
    return p[0]


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return motion.derivative(motion.tau)[:, None]


EFFECT = Effect(
    name="actuator_lag",
    label="Actuator lag",
    channel="actuator",
    equation=r"T_i \dot f + f = G_\tau u",
    source="paper section II-A: a current loop 20 times faster than the velocity loop",
    parameters=PARAMETERS,
    force=force,
    states=(Quantity("acting_force", "f", "N"),),
    rate=rate,
    over="step",
    regressor=regressor,
    solver=Solver(lag=lag),
    search=Search(confused_with=("actuator_delay", "flexible_coupling", "presliding_friction")),
    words=Words(
        where="in proportion to the rate of the motor force: at every change of acceleration and every reversal",
        experiment="a multi-sine from 5 to 100 Hz: a lag reduces gain and phase, a delay only phase",
        remedy="raise the bandwidth of the current loop, or subtract its phase from the margin of the velocity loop",
    ),
    checks=(
        ({"time_constant": 2e-3}, {"tau": 50.0, "x": (20.0,)}, 30.0),
        ({"time_constant": 2e-3}, {"tau": -5.0, "x": (-5.0,), "v": 0.1}, 0.0),
    ),
)
