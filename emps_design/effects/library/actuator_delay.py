"""Actuator delay: the voltage acts a time ``delay`` after it was recorded.

Causes are a fieldbus, the sampling of a current loop, or a computation that the record does not show. It adds to the
hold of the drive and to ``computation_delay`` in the axis file. The regressor is the first-order term delay dtau/dt,
valid if the delay is short compared with the motion.
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
    source="transport delay; paper section II-A assumes a drive without delay",
    parameters=PARAMETERS,
    delay=delay,
    over="step",
    regressor=regressor,
    expression=expression,
    search=Search(confused_with=("actuator_lag", "flexible_coupling", "presliding_friction")),
    words=Words(
        where="in proportion to the rate of the motor force: at every change of acceleration and every reversal",
        experiment="a multi-sine from 5 to 100 Hz: the phase lag of a delay is proportional to frequency, "
        "the gain constant",
        remedy="subtract it from the phase margin: crossover times delay in radians; shorten the bus cycle",
    ),
    checks=(
        ({"delay": 1.6e-3}, {}, 1.6e-3),
        ({"delay": 0.0}, {"v": 0.1, "tau": 30.0}, 0.0),
    ),
)
