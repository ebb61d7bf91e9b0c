"""Position ripple: a force periodic in position, amplitude sin(2 pi q / period + phase), the same in both directions.

Caused by cogging, a bent or eccentric screw, or the teeth of a belt: the period identifies the part (a revolution of
the screw or encoder, a pole pair). The force has a potential, so its work over a closed path is zero. The phase depends
on the zero of the encoder in the record. Cogging has several such lines, harmonics or not; each is found and listed
separately.
"""

from math import pi

import numpy as np

from emps_design.effects import harmonic
from emps_design.effects.effect import Claims, Motion, Parameter, Search, Words


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    return harmonic.periods(motion, residual, away, harmonic.waves())


EFFECT = harmonic.along(
    "force",
    Parameter("amplitude", "A", "N", lower=0.0, linear=True, scale=2.0, text="amplitude of the ripple"),
    harmonic.period("the ripple"),
    name="position_ripple",
    label="Position ripple",
    equation=r"F = A \sin(2\pi q/\lambda + \varphi)",
    source="cogging and screw eccentricity; one encoder revolution is 2.5 mm on the EMPS",
    search=Search(
        propose=propose,
        plausible=harmonic.plausible,
        confused_with=("encoder_error", "position_dependent_friction", "periodic_disturbance"),
        lines=6,
    ),
    words=Words(
        where="one line in the spectrum over position, with the same amplitude at every speed",
        experiment="two slow constant-velocity strokes at different speeds: period and force do not change",
        remedy="feed the ripple forward from position, or keep k v / period away from resonances of the loop",
    ),
    claims=Claims(parity="even", passive=True),
    checks=(
        ({"amplitude": 3.0, "phase": 0.0, "period": 0.004}, {"q": 0.001}, 3.0),
        ({"amplitude": 3.0, "phase": pi / 2, "period": 0.004}, {"q": 0.002, "v": -0.3}, -3.0),
    ),
)
