"""Back-EMF braking: a motor without a current loop brakes in proportion to its speed, as long as its winding is closed.

With k_e the voltage per speed and G_tau the force per volt at the winding, ``braking`` = G_tau k_e. While the motor is
on, no record separates this from viscous friction; while it is switched off (column ``enable``), the braking is zero
and the friction is not. An axis file may have k_e instead, as ``back_emf`` of its ``[drive]``; this effect then adds to
that value.
"""

import numpy as np

from emps_design.effects.effect import VISCOUS, Claims, Effect, Motion, Parameter, Parameters, Search, Solver, Words

PARTS = (0.25, 0.5, 0.9)  # shares of the viscous friction that was fitted without the effect
PARAMETERS = (
    Parameter("braking", r"G_\tau k_e", "N/(m/s)", lower=0.0, linear=True, scale=20.0,
              text="braking force per speed while the motor is on"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * v


def slopes(p):
    return p[0], p[0]


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    return motion.v[:, None]


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    return [{"braking": part * float(b[VISCOUS])} for part in PARTS]


def expression(q, v, t, tau, p, b):
    return p["braking"] * v


EFFECT = Effect(
    name="back_emf_braking",
    label="Back-EMF braking",
    equation=r"F = G_\tau k_e\, \dot q \ \text{ while the winding is closed}",
    source="voltage balance of the winding, R i = u - k_e qd, without inductance",
    parameters=PARAMETERS,
    force=force,
    winding=True,
    regressor=regressor,
    expression=expression,
    solver=Solver(slopes=slopes),
    search=Search(
        propose=propose,
        confused_with=("asymmetric_viscous_friction", "nonlinear_viscous_friction", "load_dependent_friction"),
    ),
    words=Words(
        where="in proportion to speed, and only while the motor is on",
        experiment="switch the motor off in motion, and record the column enable: the remaining braking is friction",
        remedy="use a current loop, or feed the back-EMF forward from the speed",
    ),
    claims=Claims(parity="odd", passive=True),
    checks=(({"braking": 40.0}, {"v": 0.5}, 20.0), ({"braking": 40.0}, {"v": -0.25}, -10.0)),
)
