"""Terms that an identification may add to mass and friction, with their parameters. They belong to a few effects.

``estimation.identified_by`` of an effect has, by the name of a term, the conversion from the term's parameters to those
of the effect.
"""

from __future__ import annotations

from typing import NamedTuple

from emps_design.quantities import Quantity

GRAVITY, ASYMMETRIC, BENT = "gravity", "asymmetric-viscous", "bent-viscous"
LOWEST, HIGHEST = 0.3, 2.0  # exponent of the speed in nonlinear viscous friction
ANGLE = Quantity("gravity_angle", r"\varphi", "rad", text="angle of the arm from hanging down, at the encoder's zero")
POWER = Quantity("viscous_exponent", "n", "", LOWEST, HIGHEST, text="power of the speed in viscous friction")


class Term(NamedTuple):
    """Parameters of a term, the ``motions`` of an axis that can have it, whether it needs ``symmetric`` friction."""

    quantities: tuple[Quantity, ...]
    motions: tuple[str, ...] = ("linear", "rotary")
    symmetric: bool = True


TERMS: dict[str, Term] = {
    GRAVITY: Term(
        (Quantity("gravity_torque", "A", "N", text="weight times distance from the axis"), ANGLE),
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
