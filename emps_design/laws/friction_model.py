"""The friction model that a law may carry: the vector X of equation (5), read from an axis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.errors import InputError

PARAMETERS = ("mass", "viscous_positive", "viscous_negative", "coulomb_positive", "coulomb_negative")


@dataclass(frozen=True)
class FrictionModel:
    """The vector X of equation (5): mass [kg], viscous [N/(m/s)] and Coulomb friction [N] for either direction."""

    mass: float
    viscous_positive: float
    viscous_negative: float
    coulomb_positive: float
    coulomb_negative: float

    @classmethod
    def of(cls, axis: Any) -> FrictionModel:
        """Read X from an ``Axis``; back-EMF and effects proportional to speed add to the viscous friction.

        Other effects are left out, see :func:`left_out`.

        >>> from emps_design.machines import machine
        >>> FrictionModel.of(machine("emps2018-two-quadrant")).viscous_negative
        563.8568
        """
        m = axis.mechanics
        positive, negative = axis.damping, axis.damping
        for entry in axis.effects:
            if entry.effect.solver.slopes is not None:
                slopes = entry.effect.solver.slopes(entry.effect.values(entry.parameters))
                positive, negative = positive + float(slopes[0]), negative + float(slopes[1])
        return cls(m.mass, round(positive, 12), round(negative, 12), m.coulomb + m.offset, m.coulomb - m.offset)

    @property
    def two_quadrant(self) -> bool:
        """Whether friction differs with the direction."""
        return self.viscous_positive != self.viscous_negative or self.coulomb_positive != self.coulomb_negative

    @property
    def directions(self) -> tuple[int, ...]:
        """The directions of motion that differ: 1 and -1, or 1 alone where friction is alike in both."""
        return (1, -1) if self.two_quadrant else (1,)

    @property
    def coulomb(self) -> tuple[float, float]:
        """Coulomb friction for motion to + and to - [N]."""
        return self.coulomb_positive, self.coulomb_negative

    @property
    def viscous(self) -> tuple[float, float]:
        """Viscous friction for motion to + and to - [N/(m/s)]."""
        return self.viscous_positive, self.viscous_negative

    def with_errors(self, errors: dict[str, Any]) -> FrictionModel:
        """Return estimates ``(1 + error)`` times these numbers; raises :class:`InputError` if one turns negative.

        ``errors`` has keys of ``PARAMETERS``, or ``viscous`` and ``coulomb`` for both directions alike; arrays (m,)
        make m models of one.

        >>> FrictionModel(100.0, 400.0, 400.0, 20.0, 20.0).with_errors({"coulomb": 0.05}).coulomb
        (21.0, 21.0)
        """
        both = {name: error for name, error in errors.items() if name in PARAMETERS}
        for name in ("viscous", "coulomb"):
            if name in errors:
                both |= {f"{name}_positive": errors[name], f"{name}_negative": errors[name]}
        for name, error in both.items():
            bad = np.extract(~(np.isfinite(error) & np.greater(error, -1.0)), error)
            if bad.size:
                raise InputError(
                    f"mismatch: found {bad[0]:g} on {name.replace('_', ' ')}, so the estimate is not positive; "
                    "expected more than -1"
                )
        return replace(self, **{name: getattr(self, name) * (1.0 + error) for name, error in both.items()})

    def array(self) -> np.ndarray:
        """The five numbers in the order of ``PARAMETERS``."""
        return np.array([getattr(self, name) for name in PARAMETERS])

    def to_dict(self) -> dict[str, float]:
        """The five numbers by name, SI."""
        return {name: getattr(self, name) for name in PARAMETERS}


def left_out(axis: Any) -> tuple[str, ...]:
    """Kinds of the effects of ``axis`` that X of (5) leaves out; name them wherever the model is used."""
    return tuple(entry.kind for entry in axis.effects if entry.effect.solver.slopes is None)
