"""Elastic force: a spring to the frame, stiffness (q - rest_position).

A hose, a cable chain, a balancing spring. The rest position cannot be separated from the constant force of the
baseline: motion determines only the stiffness, and the rest position is 0 unless a test without offset gives it. The
preload, on which load-dependent friction depends, is the ``carried_force`` of that effect.
"""

import numpy as np

from emps_design.effects.effect import Claims, Effect, Motion, Parameter, Parameters, Search, Words

PARAMETERS = (
    Parameter("stiffness", "k", "N/m", lower=0.0, linear=True, scale=50.0, text="stiffness of the spring"),
    Parameter("rest_position", "q_0", "m", -10.0, 10.0, starts=(0.0,), discrete=True,
              text="position without force; collinear with the constant force"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * (q - p[1])


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return (motion.q - shape["rest_position"])[:, None]


def expression(q, v, t, tau, p, b):
    return p["stiffness"] * (q - p["rest_position"])


EFFECT = Effect(
    name="elastic_force",
    label="Elastic force",
    equation=r"F = k\,(q - q_0)",
    source="linear spring; one more regressor in the inverse dynamic models of M. Gautier",
    parameters=PARAMETERS,
    force=force,
    over="q",
    regressor=regressor,
    expression=expression,
    search=Search(confused_with=("end_stop", "position_dependent_friction", "asymmetric_viscous_friction")),
    words=Words(
        where="in proportion to position, the same in both directions and at every speed",
        experiment="hold the carriage at several positions and read the voltage, approaching each from both sides",
        remedy="feed the spring forward, or add it to the impedance of the environment in the force loop",
    ),
    claims=Claims(parity="even", passive=True),
    checks=(
        ({"stiffness": 50.0, "rest_position": 0.1}, {"q": 0.3}, 10.0),
        ({"stiffness": 200.0, "rest_position": 0.0}, {"q": -0.05, "v": 1.0}, -10.0),
    ),
)
