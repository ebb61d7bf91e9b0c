"""Gravity on a rotary axis: the weight of an arm, torque sin(q + angle), the same in both directions.

The centre of mass of the arm is off the axis of rotation; the torque is m g l when the arm is horizontal. ``angle`` is
the angle of the arm at the zero of the encoder: the arm hangs straight down at q = -angle. On a linear axis gravity is
a constant force, which is part of the baseline.
"""

from math import pi, sin

import numpy as np

from emps_design.effects import harmonic
from emps_design.effects.effect import Claims, Effect, Motion, Parameter, Parameters, Search, Words

PARAMETERS = (
    Parameter("torque", "A", "N", lower=0.0, linear=True, scale=1.0, text="weight times distance from the axis"),
    Parameter("angle", r"\varphi", "rad", linear=True, scale=1.0,
              text="angle of the arm from hanging down, at the encoder's zero"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * sin(q + p[1])


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return harmonic.filtered_columns(motion, motion.q)


def identified(parameters: Parameters) -> dict[str, float]:
    return {"torque": parameters["gravity_torque"], "angle": parameters["gravity_angle"]}


def expression(q, v, t, tau, p, b):
    import sympy

    return p["torque"] * sympy.sin(q + p["angle"])


EFFECT = Effect(
    name="gravity",
    label="Gravity",
    motion="rotary",
    equation=r"F = A \sin(q + \varphi)",
    source="weight of an unbalanced arm; W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, ch. 9",
    parameters=PARAMETERS,
    force=force,
    over="q",
    regressor=regressor,
    expression=expression,
    estimation=harmonic.estimation("torque", "angle", gravity=identified),
    search=Search(confused_with=("elastic_force", "position_ripple", "position_dependent_friction")),
    words=Words(
        where="a sine over the angle, once per revolution, the same in both directions and at every speed",
        experiment="hold the arm at several angles over as much of a turn as possible, "
        "approaching each from both sides",
        remedy="feed the weight forward from the angle, or balance the arm",
    ),
    claims=Claims(parity="even", passive=True),
    checks=(
        ({"torque": 4.0, "angle": 0.0}, {"q": pi / 6}, 2.0),
        ({"torque": 3.0, "angle": pi / 2}, {"q": pi, "v": -0.3}, -3.0),
    ),
)
