"""Nonlinear viscous friction: the friction curve is not straight, by amount sign(v) (|v| / 0.1 m/s)^exponent.

Exponent 2 is drag that grows faster than speed (churning, air), or with a negative amount a curve that flattens at high
speed; exponent 1/2 is a curve that rises steeply from rest and then flattens (shear thinning of the grease). The linear
part is the viscous coefficient of the baseline. Below ``SMOOTH`` the curve is a straight line, so that the slope at
rest is finite: force = amount (v/V) ((v^2 + SMOOTH^2)/V^2)^((exponent - 1)/2) with V = 0.1 m/s.
"""

from math import sqrt

import numpy as np

from emps_design.effects.effect import Claims, Effect, Estimation, Motion, Parameter, Parameters, Search, Words

SPEED = 0.1  # m/s, at which the force is the amount
SMOOTH = 1e-4  # m/s
PARAMETERS = (
    Parameter("amount", r"F_{0.1}", "N", linear=True, scale=5.0,
              text="nonlinear force at 0.1 m/s; negative if it reduces friction"),
    Parameter("exponent", "n", "", 0.3, 4.0, starts=(2.0, 0.5), discrete=True,
              text="power of the speed: above 1 the curve bends up, below 1 it flattens"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    bend = sqrt(v * v + SMOOTH * SMOOTH) * (1.0 / SPEED)
    if p[1] != 2.0:  # the power is the slowest operation
        bend = bend ** (p[1] - 1.0)
    return p[0] * (1.0 / SPEED) * v * bend


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    size = (motion.v**2 + SMOOTH**2) / SPEED**2
    return (motion.v / SPEED * size ** (0.5 * (shape["exponent"] - 1)))[:, None]


def of_power(identified: Parameters) -> dict[str, float]:
    power = identified["viscous_exponent"]
    return {"amount": identified["viscous"] * SPEED**power, "exponent": power}


def expression(q, v, t, tau, p, b):
    return p["amount"] * v / SPEED * ((v**2 + SMOOTH**2) / SPEED**2) ** ((p["exponent"] - 1) / 2)


EFFECT = Effect(
    name="nonlinear_viscous_friction",
    label="Nonlinear viscous friction",
    equation=r"F = F_{0.1}\, \mathrm{sign}(\dot q)\, (|\dot q| / 0.1)^{n}",
    source="friction over speed as a power; B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994)",
    parameters=PARAMETERS,
    force=force,
    regressor=regressor,
    expression=expression,
    estimation=Estimation(identified_by={"bent-viscous": of_power}),
    search=Search(confused_with=("stribeck_friction", "load_dependent_friction", "asymmetric_viscous_friction")),
    words=Words(
        where="at the highest speeds, and with opposite sign below half of them",
        experiment="constant-velocity strokes at five or more speeds, spaced evenly up to the highest",
        remedy="identify only in the speed range in use, or use the curve in the friction compensation",
    ),
    claims=Claims(parity="odd"),
    checks=(
        ({"amount": 9.0, "exponent": 2.0}, {"v": 0.1}, 9.0 * (1.0 + 1e-6) ** 0.5),
        ({"amount": -20.0, "exponent": 0.5}, {"v": -0.025}, 10.0 * (1.0 + 1.6e-5) ** -0.25),
    ),
)
