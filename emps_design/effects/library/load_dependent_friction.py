"""Load-dependent friction: the Coulomb level grows with the force that the transmission carries.

The friction of a screw or a gear under load: an efficiency of 1 - mu when driving and 1 / (1 + mu) when being driven.
It looks like Coulomb friction at constant speed, and otherwise like too much mass (accelerating) or too little
(braking). A constant force counts as an offset of the amplifier, which the transmission does not carry;
``carried_force`` is the part that the transmission does carry: the weight on an inclined axis, or the preload of a
spring. The transmission carries the motor force minus the share ``motor_side`` of viscous and Coulomb friction, that of
motor and input stage. With a share of 1, a load that turns a motor without current also loads the gear.

A record of motor force and motion does not show whether the loss is a share of the force before the gear, as here, or
of the force behind it. In the latter case mass and forces of the load are 1 / (1 - mu^2) times the fitted values.
"""

import numpy as np

from emps_design.effects.effect import (
    COULOMB,
    OFFSET,
    VISCOUS,
    Claims,
    Effect,
    Motion,
    Parameter,
    Parameters,
    Search,
    Words,
)

PARAMETERS = (
    Parameter("share", r"\mu", "", 0.0, 0.9, linear=True, scale=0.05, text="lost share of the carried force"),
    Parameter("motor_side", r"\kappa", "", 0.0, 1.0, starts=(0.0, 1.0), discrete=True, default=0.0,
              text="share of viscous and Coulomb friction on the motor's side, which the transmission does not carry"),
    Parameter("carried_force", "F_0", "N", -1e4, 1e4, starts=(0.0, 50.0, -50.0), default=0.0,
              text="constant force that the transmission carries, a weight or a preload"),
)  # fmt: skip


def dry(q, v, t, tau, x, p, b):
    coulomb = 0.0
    if v > 0.0:
        coulomb = b[COULOMB]
    elif v < 0.0:
        coulomb = -b[COULOMB]
    return p[0] * abs(tau - b[OFFSET] + p[2] - p[1] * (b[VISCOUS] * v + coulomb))


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    direction = np.sign(motion.v)
    before = shape["motor_side"] * (b[VISCOUS] * motion.v + b[COULOMB] * direction)
    carried = motion.tau - b[OFFSET] + shape["carried_force"] - before
    return (np.abs(carried) * direction)[:, None]


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    # A constant force above the Coulomb friction is hardly an offset of the amplifier.
    carried = [0.0, float(b[OFFSET])] if abs(b[OFFSET]) > b[COULOMB] else [0.0]
    return [{"motor_side": 0.0, "carried_force": force} for force in carried]


def expression(q, v, t, tau, p, b):
    import sympy

    direction = sympy.sign(v)
    before = p["motor_side"] * (b[VISCOUS] * v + b[COULOMB] * direction)
    return p["share"] * sympy.Abs(tau - b[OFFSET] + p["carried_force"] - before) * direction


EFFECT = Effect(
    name="load_dependent_friction",
    label="Load-dependent friction",
    equation=r"F = \mu\, |\tau - \mathrm{offset} + F_0 - \kappa (F_v \dot q + F_c\, \mathrm{sign}(\dot q))|\, "
    r"\mathrm{sign}(\dot q)",
    source="transmission losses; P. Hamon, M. Gautier, P. Garrec, IROS 2010",
    parameters=PARAMETERS,
    dry=dry,
    over="tau",
    regressor=regressor,
    expression=expression,
    search=Search(propose=propose, confused_with=("mass_change", "nonlinear_viscous_friction", "stribeck_friction")),
    words=Words(
        where="during acceleration and braking, with opposite apparent change of the mass",
        experiment="the same strokes at three accelerations, or with a known payload pulling along the axis; "
        "with the motor off, a falling load shows which friction the gear carries",
        remedy="compensate with the motor force of the model, and expect a lower efficiency under load",
    ),
    claims=Claims(parity="odd", passive=True),
    checks=(
        ({"share": 0.1, "motor_side": 0.0, "carried_force": 0.0}, {"v": 0.2, "tau": -150.0}, 14.5),
        ({"share": 0.05, "motor_side": 0.0, "carried_force": 0.0}, {"v": -0.2, "tau": -40.0}, -1.75),
        # 155 N minus 40 N and 20 N; without motor force 60 N of friction
        ({"share": 0.1, "motor_side": 1.0, "carried_force": 0.0}, {"v": 0.2, "tau": 150.0}, 9.5),
        ({"share": 0.1, "motor_side": 1.0, "carried_force": 0.0}, {"v": -0.2, "tau": -5.0}, -6.0),
        ({"share": 0.1, "motor_side": 0.0, "carried_force": 45.0}, {"v": -0.2, "tau": -20.0}, -3.0),
    ),
)
