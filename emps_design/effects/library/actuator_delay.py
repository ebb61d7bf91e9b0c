"""Actuator delay: the voltage acts a time ``delay`` after it was recorded.

A fieldbus, a current loop's own sampling, a computation that the record does not show. It comes on top of the hold
of the drive and of ``computation_delay`` in the axis file. The column is its first order, delay dtau/dt, good while
the delay is short against the motion.
"""

import numpy as np

from emps_design.effects.effect import Effect, Motion, Parameter, Parameters, Search, Words

PARAMETERS = (
    Parameter("delay", "T_d", "s", 0.0, 20e-3, linear=True, starts=(0.5e-3, 1e-3, 2e-3, 4e-3),
              text="time between the recorded voltage and the force"),
)  # fmt: skip


def delay(q, v, t, tau, x, p, b):
    return p[0]


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return motion.derivative(motion.tau)[:, None]


def expression(q, v, t, tau, p, b):
    return p["delay"]


EFFECT = Effect(
    name="actuator_delay",
    label="Actuator delay",
    channel="actuator",
    equation=r"\tau(t) = G_\tau\, u(t - T_d)",
    source="transport delay; paper section II-A takes the drive as immediate",
    parameters=PARAMETERS,
    delay=delay,
    over="step",
    regressor=regressor,
    expression=expression,
    search=Search(confused_with=("actuator_lag", "flexible_coupling", "presliding_friction")),
    words=Words(
        where="in proportion to the rate of the motor force: at every change of acceleration and every reversal",
        experiment="a multi-sine from 5 to 100 Hz: a delay turns the phase in proportion to frequency, the gain stays",
        remedy="take it from the phase margin: crossover times delay in radians; shorten the bus cycle",
    ),
    checks=(
        ({"delay": 1.6e-3}, {}, 1.6e-3),
        ({"delay": 0.0}, {"v": 0.1, "tau": 30.0}, 0.0),
    ),
)
