"""Actuator dead zone: below ``width`` the voltage has no effect, above it ``width`` is subtracted.

The dead band of a power stage (dead time of its switches) or of the input of a servo amplifier. For |u| > width the
lost force is G_tau width sign(u), the regressor; within the dead zone it is less, and the regressor is approximate.
"""

import numpy as np

from emps_design.effects.effect import Effect, Motion, Parameter, Parameters, Search, Words

PARAMETERS = (
    Parameter("width", "u_0", "V", 0.0, 10.0, linear=True, starts=(0.05, 0.1, 0.2, 0.5),
              text="voltage below which no force acts"),
)  # fmt: skip


def actuator(u, p):
    if u > p[0]:
        return u - p[0]
    if u < -p[0]:
        return u + p[0]
    return 0.0


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return (motion.force_gain * np.sign(motion.tau))[:, None]


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    typical = float(np.sqrt(np.mean(np.asarray(motion.voltage) ** 2)))
    return [{"width": share * typical} for share in (0.03, 0.1, 0.2, 0.4)]


def expression(q, v, t, tau, p, b):
    import sympy

    return sympy.sign(tau) * sympy.Max(0, sympy.Abs(tau) - p["width"])


EFFECT = Effect(
    name="actuator_deadzone",
    label="Actuator dead zone",
    channel="actuator",
    equation=r"u_a = \mathrm{sign}(u)\, \max(0, |u| - u_0)",
    source="dead band of a power stage; G. Tao, P. V. Kokotovic, Adaptive Control with Actuator Nonlinearities, 1996",
    parameters=PARAMETERS,
    actuator=actuator,
    over="u",
    regressor=regressor,
    expression=expression,
    search=Search(propose=propose, confused_with=("stribeck_friction", "presliding_friction", "backlash")),
    words=Words(
        where="a step whenever the motor force changes sign, on braking as well as on reversing",
        experiment="brake along one direction without reversing: the step follows the voltage, not the speed",
        remedy="add the width to the command with the sign of the command, smoothed near zero",
    ),
    checks=(
        ({"width": 0.2}, {"u": 1.0}, 0.8),
        ({"width": 0.2}, {"u": -0.15}, 0.0),
    ),
)
