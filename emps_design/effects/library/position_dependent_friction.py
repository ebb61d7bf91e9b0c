"""Position-dependent friction: the Coulomb level varies along the travel, amplitude sin(2 pi q / length + phase).

Caused by guides that are not parallel, varying preload, or a dirty part of a rail. Unlike a ripple it changes sign with
the direction of motion. The total level is never negative.
"""

from math import pi

import numpy as np

from emps_design.effects import harmonic
from emps_design.effects.effect import Claims, Motion, Parameter, Parameters, Search, Words

LENGTH = Parameter("length", r"\Lambda", "m", 0.02, 5.0, starts=(0.1, 0.2, 0.3, 0.5, 0.8),
                   text="travel after which the level repeats")  # fmt: skip


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:  # slow enough to pass any filter
    return harmonic.columns(2 * pi * motion.q / shape["length"]) * np.sign(motion.v)[:, None]


def plausible(parameters: Parameters, motion: Motion) -> bool:
    return parameters["length"] < 3 * float(np.ptp(motion.q))  # longer is a straight line over the stroke


EFFECT = harmonic.along(
    "dry",
    Parameter("amplitude", "A", "N", lower=0.0, linear=True, scale=3.0, text="variation of the Coulomb level"),
    LENGTH,
    name="position_dependent_friction",
    label="Position-dependent friction",
    equation=r"F = A \sin(2\pi q/\Lambda + \varphi)\, \mathrm{sign}(\dot q)",
    source="first harmonic of the Coulomb level over position; paper section II-B assumes a constant level",
    regressor=regressor,
    search=Search(plausible=plausible, confused_with=("position_ripple", "elastic_force", "friction_drift")),
    words=Words(
        where="slowly varying along the travel, with opposite sign in the two directions, at any speed",
        experiment="one slow constant-velocity stroke over the whole travel in each direction",
        remedy="align or relubricate the affected length, or schedule the friction compensation with position",
    ),
    claims=Claims(parity="odd"),
    checks=(
        ({"amplitude": 5.0, "phase": 0.0, "length": 0.4}, {"q": 0.1, "v": 0.2}, 5.0),
        ({"amplitude": 5.0, "phase": pi / 2, "length": 0.4}, {"q": 0.0, "v": -0.2}, -5.0),
    ),
)
