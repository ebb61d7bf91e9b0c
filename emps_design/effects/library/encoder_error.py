"""Encoder error: the encoder reads q + amplitude sin(2 pi q / period + phase).

Caused by an eccentric disc or interpolation. The controller acts on the error, too. In the inverse dynamic model of the
measured motion q_m = q + e the extra left-hand force is -(M d2e/dt2 + F_v de/dt); the regressors evaluate e at the
measured position, which is accurate for amplitudes much smaller than the period. The force grows with the square of the
speed; that of a ripple does not.
"""

from math import pi

import numpy as np

from emps_design.effects import harmonic
from emps_design.effects.effect import MASS, VISCOUS, Motion, Parameter, Parameters, Search, Words


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    angle, rate = 2 * pi * motion.q / shape["period"], 2 * pi / shape["period"]
    sine, cosine = harmonic.columns(angle).T
    # d/dt sin = rate v cos, d2/dt2 sin = rate a cos - rate^2 v^2 sin, likewise for cos
    speed, turn = rate * motion.v, rate * motion.a
    of_sine = b[MASS] * (turn * cosine - speed**2 * sine) + b[VISCOUS] * speed * cosine
    of_cosine = b[MASS] * (-turn * sine - speed**2 * cosine) - b[VISCOUS] * speed * sine
    return -np.column_stack([motion.smooth(of_sine), motion.smooth(of_cosine)])


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    def columns(
        index: np.ndarray, waves: np.ndarray, sine: np.ndarray, cosine: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        speed, turn = (motion.v[index][:, None] * waves) ** 2, motion.a[index][:, None] * waves
        return speed * sine - turn * cosine, speed * cosine + turn * sine

    return harmonic.periods(motion, residual, away, columns)


EFFECT = harmonic.along(
    "sensor",
    Parameter("amplitude", "A", "m", 0.0, 1e-2, linear=True, scale=5e-6, text="amplitude of the error"),
    harmonic.period("the error"),
    name="encoder_error",
    label="Encoder error",
    channel="sensor",
    equation=r"q_m = q + A \sin(2\pi q/\lambda + \varphi)",
    source="eccentricity and interpolation error of incremental encoders",
    regressor=regressor,
    search=Search(
        propose=propose, plausible=harmonic.plausible, confused_with=("position_ripple", "periodic_disturbance")
    ),
    words=Words(
        where="one line in the spectrum over position, with a force that grows with the square of speed",
        experiment="constant-velocity strokes at two speeds: at twice the speed the force of an encoder error is "
        "four times as large",
        remedy="calibrate the encoder over one period, or keep 2 pi v / period below the crossover",
    ),
    checks=(
        ({"amplitude": 6e-6, "phase": 0.0, "period": 0.004}, {"q": 0.001}, 6e-6),
        ({"amplitude": 6e-6, "phase": pi / 2, "period": 0.004}, {"q": 0.002, "v": 0.4}, -6e-6),
    ),
)
