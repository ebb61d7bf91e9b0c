"""Load-dependent friction: the Coulomb level grows with the force that the transmission carries.

The friction of a screw or a gear under load: a loss of efficiency, 1 - mu when driving and 1 / (1 + mu) when being
driven. It looks like Coulomb friction at constant speed and like too much mass (accelerating) and too little (braking)
otherwise. The constant force of this machine is taken as an offset of the amplifier, which the transmission never
sees. The motor's force reaches it less the share ``motor_side`` of viscous and Coulomb friction, that of motor and
input stage: with a share of 1, a load that turns a motor without current loads the gear too.

Whether the loss is a share of the force before the gear, as here, or of that behind it, no record of motor force and
motion tells: in the latter case mass and forces of the load are 1 / (1 - mu^2) times what a fit gives.
"""

import numpy as np

from emps_design.effects.effect import COULOMB, OFFSET, VISCOUS, Effect, Motion, Parameter, Parameters


def dry(q, v, t, tau, x, p, b):
    coulomb = 0.0
    if v > 0.0:
        coulomb = b[COULOMB]
    elif v < 0.0:
        coulomb = -b[COULOMB]
    return p[0] * abs(tau - b[OFFSET] - p[1] * (b[VISCOUS] * v + coulomb))


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    direction = np.sign(motion.v)
    before = shape["motor_side"] * (b[VISCOUS] * motion.v + b[COULOMB] * direction)
    return (np.abs(motion.tau - b[OFFSET] - before) * direction)[:, None]


def expression(q, v, t, tau, p, b):
    import sympy

    direction = sympy.sign(v)
    before = p["motor_side"] * (b[VISCOUS] * v + b[COULOMB] * direction)
    return p["share"] * sympy.Abs(tau - b[OFFSET] - before) * direction


EFFECT = Effect(
    name="load_dependent_friction",
    label="Load-dependent friction",
    channel="plant",
    equation=r"F = \mu\, |\tau - \mathrm{offset} - \kappa (F_v \dot q + F_c\, \mathrm{sign}(\dot q))|\, "
    r"\mathrm{sign}(\dot q)",
    source="transmission losses; P. Hamon, M. Gautier, P. Garrec, IROS 2010",
    parameters=(
        Parameter(
            "share", r"\mu", "", lower=0.0, upper=0.9, linear=True, scale=0.05, text="share of the carried force lost"
        ),
        Parameter(
            "motor_side",
            r"\kappa",
            "",
            lower=0.0,
            upper=1.0,
            starts=(0.0, 1.0),
            discrete=True,
            default=0.0,
            text="share of viscous and Coulomb friction on the motor's side, which the transmission does not carry",
        ),
    ),
    dry=dry,
    regressor=regressor,
    expression=expression,
    over="tau",
    where="during acceleration and braking, with opposite apparent change of the mass",
    confused_with=("mass_change", "nonlinear_viscous_friction", "stribeck_friction"),
    experiment="the same strokes at three accelerations, or with a known payload pulling along the axis; "
    "with the motor off, a load that falls tells what friction the gear carries",
    remedy="compensate with the motor force of the model, and expect a lower efficiency when loaded",
    checks=(
        ({"share": 0.1, "motor_side": 0.0}, {"v": 0.2, "tau": -150.0}, 14.5),
        ({"share": 0.05, "motor_side": 0.0}, {"v": -0.2, "tau": -40.0}, -1.75),
        ({"share": 0.1, "motor_side": 1.0}, {"v": 0.2, "tau": 150.0}, 9.5),  # 155 N less 40 and 20
        ({"share": 0.1, "motor_side": 1.0}, {"v": -0.2, "tau": -5.0}, -6.0),  # no motor force: 60 N of friction
    ),
    passive=True,
    parity="odd",
)
