"""Friction ripple: dry friction that is periodic in position, amplitude sin(2 pi q / period + phase) sign(v).

With an eccentric nut or bearing, or a bent screw, friction is higher once per revolution. The force changes sign with
the direction of motion; that of a ``position_ripple`` does not. Both have the same period if one part causes both.
"""

from math import pi

import numpy as np

from emps_design.effects import harmonic
from emps_design.effects.effect import Claims, Motion, Parameter, Search, Words


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    return harmonic.periods(motion, residual, away, harmonic.waves(np.sign(motion.v)))


EFFECT = harmonic.along(
    "dry",
    Parameter("amplitude", "A", "N", lower=0.0, linear=True, scale=2.0, text="amplitude of the ripple"),
    harmonic.period("the friction"),
    name="friction_ripple",
    label="Friction ripple",
    equation=r"F = A \sin(2\pi q/\lambda + \varphi)\, \mathrm{sign}(\dot q)",
    source="eccentric screw and nut; one revolution of the encoder is 2.5 mm on the EMPS",
    search=Search(
        propose=propose,
        plausible=harmonic.plausible,
        confused_with=("position_ripple", "position_dependent_friction", "encoder_error"),
    ),
    words=Words(
        where="one line in the spectrum over position, with opposite sign in the two directions",
        experiment="slow constant-velocity strokes in both directions over the same travel: "
        "half the difference has the line",
        remedy="align screw and nut, or feed the ripple forward with the sign of the velocity",
    ),
    claims=Claims(parity="odd"),
    checks=(
        ({"amplitude": 3.0, "phase": 0.0, "period": 0.004}, {"q": 0.001, "v": 0.1}, 3.0),
        ({"amplitude": 3.0, "phase": pi / 2, "period": 0.004}, {"q": 0.002, "v": -0.3}, 3.0),
    ),
)
