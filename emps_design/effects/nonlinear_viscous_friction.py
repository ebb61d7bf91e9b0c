"""Nonlinear viscous friction: the friction curve bends at speed, by quadratic v |v|.

A positive coefficient is drag that grows faster than speed (churning, air), a negative one a curve that flattens
(shear thinning of the grease); the viscous coefficient of the baseline is then the slope at rest.
"""

import numpy as np

from emps_design.effects.effect import Effect, Motion, Parameter, Parameters


def force(q, v, t, tau, x, p, b):
    return p[0] * v * abs(v)


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return (motion.v * np.abs(motion.v))[:, None]


def expression(q, v, t, tau, p, b):
    import sympy

    return p["quadratic"] * v * sympy.Abs(v)


EFFECT = Effect(
    name="nonlinear_viscous_friction",
    label="Nonlinear viscous friction",
    channel="plant",
    equation=r"F = F_{v2}\, \dot q\, |\dot q|",
    source="friction polynomial; B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994)",
    parameters=(
        Parameter(
            "quadratic",
            r"F_{v2}",
            "N/(m/s)^2",
            linear=True,
            scale=300.0,
            text="bend of the friction curve; negative where friction flattens with speed",
        ),
    ),
    force=force,
    regressor=regressor,
    expression=expression,
    over="v",
    where="at the highest speeds, and with opposite sign between rest and half of them",
    confused_with=("stribeck_friction", "load_dependent_friction", "asymmetric_viscous_friction"),
    experiment="constant-velocity strokes at five or more speeds spread evenly up to the highest",
    remedy="identify over the speeds of use only, or put the curve in the friction compensation",
    checks=(
        ({"quadratic": 900.0}, {"v": 0.1}, 9.0),
        ({"quadratic": -400.0}, {"v": -0.5}, 100.0),
    ),
    parity="odd",
)
