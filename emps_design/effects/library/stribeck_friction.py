"""Stribeck friction: dry friction is higher near zero velocity, by (F_s - F_c) exp(-|v/v_s|^delta) sign(v).

Equation (4) of the paper with ``excess = F_s - F_c`` and an exponent delta_s in [1, 2]. The excess multiplies the
set-valued sign, so the break-away force of a carriage at rest is F_c + excess.
"""

from math import exp

import numpy as np

from emps_design.effects.effect import Claims, Effect, Motion, Parameter, Parameters, Search, Words

PARAMETERS = (
    Parameter("excess", r"F_s - F_c", "N", lower=0.0, linear=True, scale=5.0,
              text="break-away force above Coulomb friction"),
    Parameter("stribeck_velocity", r"\dot q_s", "m/s", 1e-4, 1.0, starts=(0.002, 0.005, 0.01, 0.02, 0.04),
              text="velocity at which the excess has fallen to 1/e"),
    Parameter("exponent", r"\delta_s", "", 1.0, 2.0, starts=(1.0, 2.0), discrete=True, text="steepness of the decay"),
)  # fmt: skip


def dry(q, v, t, tau, x, p, b):
    ratio = abs(v) / p[1]
    if p[2] != 1.0:  # the power is the slowest operation
        ratio = ratio ** p[2]
    return p[0] * exp(-ratio)


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    decay = np.exp(-((np.abs(motion.v) / shape["stribeck_velocity"]) ** shape["exponent"]))
    return (decay * np.sign(motion.v))[:, None]


def plausible(parameters: Parameters, motion: Motion) -> bool:
    return parameters["stribeck_velocity"] < 0.25 * float(np.abs(motion.v).max())  # else nonlinear viscous friction


def expression(q, v, t, tau, p, b):
    import sympy

    return p["excess"] * sympy.exp(-((sympy.Abs(v) / p["stribeck_velocity"]) ** p["exponent"])) * sympy.sign(v)


EFFECT = Effect(
    name="stribeck_friction",
    label="Stribeck friction",
    equation=r"F = (F_s - F_c)\, e^{-|\dot q/\dot q_s|^{\delta_s}}\, \mathrm{sign}(\dot q)",
    source="paper, eq. (4), Fig. 3",
    parameters=PARAMETERS,
    dry=dry,
    regressor=regressor,
    expression=expression,
    search=Search(plausible=plausible, confused_with=("presliding_friction", "actuator_deadzone", "backlash")),
    words=Words(
        where="below a few Stribeck velocities, before and after every reversal",
        experiment="slow constant-velocity strokes at several speeds up to a tenth of the highest, a break-away test",
        remedy="add the excess to the friction compensation, or avoid references at low speed",
    ),
    claims=Claims(parity="odd", passive=True),
    checks=(
        ({"excess": 8.0, "stribeck_velocity": 0.01, "exponent": 1.0}, {"v": 0.01}, 8.0 / 2.718281828459045),
        ({"excess": 8.0, "stribeck_velocity": 0.01, "exponent": 2.0}, {"v": -0.02}, -8.0 / 54.598150033144236),
    ),
)
