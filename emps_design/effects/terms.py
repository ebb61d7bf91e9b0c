"""What an identification may have beside mass and friction, and in which parameters: a few of the effects.

An effect whose ``estimation.identified_by`` has the name of a term takes the term's parameters to its own.
"""

from __future__ import annotations

from typing import NamedTuple

from emps_design.quantities import Quantity

GRAVITY, ASYMMETRIC, BENT = "gravity", "asymmetric-viscous", "bent-viscous"
LOWEST, HIGHEST = 0.3, 2.0  # power of the speed that a bent friction may have
ANGLE = Quantity("gravity_angle", r"\varphi", "rad", text="angle of the arm from hanging at the encoder's zero")
POWER = Quantity("viscous_exponent", "n", "", LOWEST, HIGHEST, text="power of the speed in viscous friction")


class Term(NamedTuple):
    """A term's parameters, the motions of an axis that can have it, and whether it needs a ``symmetric`` friction."""

    quantities: tuple[Quantity, ...]
    motions: tuple[str, ...] = ("linear", "rotary")
    symmetric: bool = True


TERMS: dict[str, Term] = {
    GRAVITY: Term(
        (Quantity("gravity_torque", "A", "N", text="weight times its distance"), ANGLE),
        motions=("rotary",),
        symmetric=False,
    ),
    ASYMMETRIC: Term(
        (
            Quantity(
                "viscous_difference",
                r"\tfrac{1}{2}(F_v^+ - F_v^-)",
                "N/(m/s)",
                text="half the difference of the viscous friction of the two directions",
            ),
        ),
    ),
    BENT: Term((POWER,)),
}
