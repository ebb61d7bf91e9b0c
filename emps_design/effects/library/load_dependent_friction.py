"""Load-dependent friction: the Coulomb level grows with the force that the transmission carries.

The friction of a screw or a gear under load: a loss of efficiency. It looks like Coulomb friction at constant speed
and like too much mass (accelerating) and too little (braking) otherwise. The carried force is tau - offset: the
constant force of this machine is taken as an offset of the amplifier, which the transmission never sees.
"""

import numpy as np

from emps_design.effects.effect import OFFSET, Effect, Motion, Parameter, Parameters


def dry(q, v, t, tau, x, p, b):
    return p[0] * abs(tau - b[OFFSET])


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return (np.abs(motion.tau - b[OFFSET]) * np.sign(motion.v))[:, None]


def expression(q, v, t, tau, p, b):
    import sympy

    return p["share"] * sympy.Abs(tau - b[OFFSET]) * sympy.sign(v)


EFFECT = Effect(
    name="load_dependent_friction",
    label="Load-dependent friction",
    channel="plant",
    equation=r"F = \mu\, |\tau - \mathrm{offset}|\, \mathrm{sign}(\dot q)",
    source="transmission losses; P. Hamon, M. Gautier, P. Garrec, IROS 2010",
    parameters=(
        Parameter(
            "share", r"\mu", "", lower=0.0, upper=0.9, linear=True, scale=0.05, text="share of the motor force lost"
        ),
    ),
    dry=dry,
    regressor=regressor,
    expression=expression,
    over="tau",
    where="during acceleration and braking, with opposite apparent change of the mass",
    confused_with=("mass_change", "nonlinear_viscous_friction", "stribeck_friction"),
    experiment="the same strokes at three accelerations, or with a known payload pulling along the axis",
    remedy="compensate with the motor force of the model, and expect a lower efficiency when loaded",
    checks=(
        ({"share": 0.1}, {"v": 0.2, "tau": -150.0}, 14.5),
        ({"share": 0.05}, {"v": -0.2, "tau": -40.0}, -1.75),
    ),
    passive=True,
    parity="odd",
)
