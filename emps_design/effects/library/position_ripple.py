"""Position ripple: a force that repeats with travel, amplitude sin(2 pi q / period + phase), the same both ways.

Cogging of the motor, a bent or eccentric screw, a belt's teeth: the period names the part (a revolution of the screw,
of the encoder, a pole pair). The force derives from a potential, so a round trip costs nothing. The phase depends on
where the encoder's zero was when the record was taken. Cogging has several such lines, harmonics or not: each is
found and listed by itself.
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
        where="one line in the spectrum over position, at every speed with the same amplitude",
        experiment="two slow constant-velocity strokes at different speeds: the period and the force stay the same",
        remedy="feed the ripple forward from position, or keep k v / period away from the loop's resonances",
    ),
    claims=Claims(parity="even", passive=True),
    checks=(
        ({"amplitude": 3.0, "phase": 0.0, "period": 0.004}, {"q": 0.001}, 3.0),
        ({"amplitude": 3.0, "phase": pi / 2, "period": 0.004}, {"q": 0.002, "v": -0.3}, -3.0),
    ),
)
