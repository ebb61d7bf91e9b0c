"""Periodic disturbance: a force over time, amplitude sin(2 pi frequency t + phase), positive towards +q.

Caused by a neighbouring machine, a pump, or hum of the supply. On the side of the friction its sign is negative.
"""

from math import pi, sin

import numpy as np

from emps_design.effects import guesses as search, harmonic
from emps_design.effects.effect import Claims, Effect, Motion, Parameter, Parameters, Search, Words

MOVED = 0.5  # of the mean square of the velocity
PARAMETERS = (
    Parameter("amplitude", "A", "N", lower=0.0, linear=True, scale=2.0, text="amplitude of the force"),
    harmonic.phase("the record's first sample"),
    Parameter("frequency", "f", "Hz", 0.25, 500.0, starts=(0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0),
              text="frequency of the force"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return -p[0] * sin(2.0 * pi * p[2] * t + p[1])


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return -harmonic.filtered_columns(motion, 2 * pi * shape["frequency"] * motion.t)


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    waves = harmonic.waves()
    seconds = search.periods(residual, motion.t, motion.v, motion.a, away, waves, shortest=0.025, count=6)
    return [{"frequency": 1.0 / period} for period in seconds]


def plausible(parameters: Parameters, motion: Motion) -> bool:
    if parameters["frequency"] * float(motion.t[-1]) <= 20:
        return False  # with fewer periods it is a drift, or part of the program
    # If the machine itself moves at this frequency, the force could not be separated from that of its inertia.
    line = np.mean(motion.v * np.exp(-2j * pi * parameters["frequency"] * motion.t))
    return bool(2.0 * abs(line) ** 2 < MOVED * np.mean(motion.v**2))


def expression(q, v, t, tau, p, b):
    import sympy

    return -p["amplitude"] * sympy.sin(2 * sympy.pi * p["frequency"] * t + p["phase"])


EFFECT = Effect(
    name="periodic_disturbance",
    label="Periodic disturbance",
    equation=r"F = -A \sin(2\pi f t + \varphi)",
    source="harmonic external force of paper eq. (2)",
    parameters=PARAMETERS,
    force=force,
    over="t",
    regressor=regressor,
    expression=expression,
    estimation=harmonic.estimation(),
    search=Search(
        propose=propose, plausible=plausible, confused_with=("external_force", "position_ripple", "encoder_error")
    ),
    words=Words(
        where="one line in the spectrum over time, at every position and speed, also at rest",
        experiment="a record at standstill: the line is still there",
        remedy="isolate the source, or use a resonant term in the controller at that frequency",
    ),
    claims=Claims(parity="even"),
    checks=(
        ({"amplitude": 3.0, "phase": 0.0, "frequency": 2.5}, {"t": 0.1}, -3.0),
        ({"amplitude": 3.0, "phase": pi / 2, "frequency": 2.5}, {"t": 0.2, "v": 0.1}, 3.0),
    ),
)
