"""Gravity on an axis that turns: the weight of an arm, torque sin(q + angle), the same in both directions.

An arm whose centre of mass is off the axis of rotation; the torque is m g l, at its largest where the arm is level.
``angle`` is where the encoder's zero lies: the arm hangs straight down at q = -angle. On an axis that moves along a
line gravity is a constant force, which the baseline has.
"""

from math import pi, sin

import numpy as np

from emps_design.effects import harmonic
from emps_design.effects.effect import Claims, Effect, Motion, Parameter, Parameters, Search, Words

PARAMETERS = (
    Parameter("torque", "A", "N", lower=0.0, linear=True, scale=1.0, text="weight times its distance"),
    Parameter("angle", r"\varphi", "rad", linear=True, scale=1.0,
              text="angle of the arm from hanging at the encoder's zero"),
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
        where="over the angle, the same in both directions and at every speed, once round in a revolution",
        experiment="hold the arm at several angles over as much of a turn as there is, "
        "approaching each from both sides",
        remedy="feed the weight forward from the angle, or balance the arm",
    ),
    claims=Claims(parity="even", passive=True),
    checks=(
        ({"torque": 4.0, "angle": 0.0}, {"q": pi / 6}, 2.0),
        ({"torque": 3.0, "angle": pi / 2}, {"q": pi, "v": -0.3}, -3.0),
    ),
)
