"""Friction drift: Coulomb and viscous friction drift to another level, by the factor 1 + change (1 - exp(-t/T)).

The usual cause is grease that warms up, with a negative change. The baseline is the friction at the first sample.
"""

from math import exp

import numpy as np

from emps_design.effects.effect import COULOMB, VISCOUS, Claims, Effect, Motion, Parameter, Parameters, Search, Words

PARAMETERS = (
    Parameter("change", "c", "", -0.95, 5.0, linear=True, scale=0.2, text="final relative change of friction"),
    Parameter("time_constant", "T", "s", 0.1, 3600.0, starts=(3.0, 6.0, 12.0, 25.0, 60.0),
              text="time constant of the drift"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return b[VISCOUS] * p[0] * (1.0 - exp(-t / p[1])) * v


def dry(q, v, t, tau, x, p, b):
    return b[COULOMB] * p[0] * (1.0 - exp(-t / p[1]))


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    friction = b[COULOMB] * np.sign(motion.v) + b[VISCOUS] * motion.v
    return (friction * -np.expm1(-motion.t / shape["time_constant"]))[:, None]


def plausible(parameters: Parameters, motion: Motion) -> bool:
    span = float(motion.t[-1])
    return 0.05 * span < parameters["time_constant"] < 20 * span  # faster: a start-up; slower: a straight line


def expression(q, v, t, tau, p, b):
    import sympy

    settled = 1 - sympy.exp(-t / p["time_constant"])
    return p["change"] * settled * (b[COULOMB] * sympy.sign(v) + b[VISCOUS] * v)


EFFECT = Effect(
    name="friction_drift",
    label="Friction drift",
    equation=r"F = c\,(1 - e^{-t/T})\,(F_c\, \mathrm{sign}(\dot q) + F_v \dot q)",
    source="first-order warming; friction of geared joints over temperature, A. C. Bittencourt, S. Gunnarsson, 2012",
    parameters=PARAMETERS,
    force=force,
    dry=dry,
    over="t",
    regressor=regressor,
    expression=expression,
    search=Search(
        plausible=plausible, confused_with=("mass_change", "position_dependent_friction", "asymmetric_viscous_friction")
    ),
    words=Words(
        where="from the start of the record on, in both directions; laps differ from one another",
        experiment="repeat one lap for some minutes from cold: the force of equal strokes settles",
        remedy="warm the axis up before identification, and use an observer or adaptive friction compensation",
    ),
    claims=Claims(parity="odd"),
    checks=(
        ({"change": -0.3, "time_constant": 12.0}, {"t": 0.0, "v": 0.2}, 0.0),
        ({"change": -0.5, "time_constant": 1.0}, {"t": 1e3, "v": -0.1}, 20.0),
    ),
)
