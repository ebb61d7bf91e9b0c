"""Asymmetric viscous friction: the two directions of travel have different viscous coefficients.

With F_v = (F_v+ + F_v-)/2 in the baseline and ``viscous_difference`` = (F_v+ - F_v-)/2 the extra force is
viscous_difference |v|. The other asymmetry of a two-quadrant friction, different Coulomb levels, is not part of it:
half their difference is exactly a constant force, which is in the offset of the baseline. ``FrictionModel`` has the
four parameters of equation (3).
"""

import numpy as np

from emps_design.effects.effect import Claims, Effect, Estimation, Motion, Parameter, Parameters, Search, Solver, Words

PARAMETERS = (
    Parameter("viscous_difference", r"\tfrac{1}{2}(F_v^+ - F_v^-)", "N/(m/s)", linear=True, scale=20.0,
              text="half the difference of the viscous coefficients of the two directions"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * abs(v)


def slopes(p):
    return p[0], -p[0]


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return np.abs(motion.v)[:, None]


def expression(q, v, t, tau, p, b):
    import sympy

    return p["viscous_difference"] * sympy.Abs(v)


def of_two_quadrants(identified: Parameters) -> dict[str, float]:
    return {"viscous_difference": 0.5 * (identified["viscous_positive"] - identified["viscous_negative"])}


def of_difference(identified: Parameters) -> dict[str, float]:
    return {"viscous_difference": identified["viscous_difference"]}


EFFECT = Effect(
    name="asymmetric_viscous_friction",
    label="Asymmetric viscous friction",
    equation=r"F = \tfrac{1}{2}(F_v^+ - F_v^-)\,|\dot q|",
    source="paper, eq. (3), Fig. 3 and Table I",
    parameters=PARAMETERS,
    force=force,
    regressor=regressor,
    expression=expression,
    estimation=Estimation(identified_by={"asymmetric": of_two_quadrants, "asymmetric-viscous": of_difference}),
    solver=Solver(slopes=slopes),
    search=Search(confused_with=("elastic_force", "friction_drift", "nonlinear_viscous_friction")),
    words=Words(
        where="in proportion to speed, with the same sign in both directions",
        experiment="constant-velocity strokes at three speeds, each in both directions over the same travel",
        remedy="compensate friction with one coefficient for each direction",
    ),
    claims=Claims(parity="even"),
    checks=(
        ({"viscous_difference": -40.0}, {"v": 0.5}, -20.0),
        ({"viscous_difference": -40.0}, {"v": -0.25}, -10.0),
    ),
)
