"""Which terms a controller has, and how its command is linear in what is left once its integral time is known.

With ``wi = 1/ti`` and the gain K of the velocity loop, the command before the filters is, see :mod:`.regressors`,

    pi      K kp (error + wi error_sum) + K share (slip + wi slip_sum) - K (1 - share) (velocity + wi velocity_sum)
    ip      K kp wi error_sum + K share (wi slip_sum - velocity) - K (1 - share) (velocity + wi velocity_sum)

and the feed-forward; so for each ``wi`` it is linear in K kp, K share, K (1 - share), and the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from emps_design.identification.controller.regressors import COLUMNS

PLACE = {name: i for i, name in enumerate(COLUMNS)}


@dataclass(frozen=True)
class Structure:
    """The terms of a controller.

    ``form`` "pi" or "ip", or "" without integral; ``position`` whether a position loop is there; ``share`` of the
    reference's velocity 0 or 1, or None where it is a number between; ``velocity`` whether velocity is fed back at
    all; ``acceleration``, ``coulomb``, ``force``, ``offset`` whether these terms are there; ``skew`` whether the
    position was recorded at another instant than the one that the command follows: next to a law without velocity it
    shows.
    """

    form: str = "pi"
    position: bool = True
    share: int | None = None
    velocity: bool = True
    acceleration: bool = True
    coulomb: bool = True
    force: bool = False
    offset: bool = True
    skew: bool = False

    @property
    def linear(self) -> tuple[str, ...]:
        """The linear coefficients, in the order of :meth:`combination`."""
        names = ["position"] if self.position else []
        if self.velocity:
            names += {None: ["following", "damping"], 1: ["following"], 0: ["damping"]}[self.share]
        names += [name for name in ("acceleration", "coulomb", "force", "offset", "skew") if getattr(self, name)]
        return tuple(names)

    @property
    def feeds_forward(self) -> bool:
        """Whether the velocity of the reference is fed forward to a velocity loop within a position loop."""
        return self.position and self.velocity and self.share != 0

    @property
    def size(self) -> int:
        """How many numbers it has, without those of filters."""
        return len(self.linear) + bool(self.form)

    def combination(self, wi: float | np.ndarray) -> np.ndarray:
        """What takes the regressors to the columns of ``linear``, (..., len(COLUMNS), n_linear) for ``wi`` (...)."""
        constant, integral = _combinations(self)
        return constant + np.multiply.outer(wi, integral)

    def stabilising(self, linear: np.ndarray) -> np.ndarray:
        """Whether these coefficients (..., n_linear) feed position and velocity back with the sign of a controller."""
        part = dict(zip(self.linear, np.moveaxis(linear, -1, 0), strict=True))
        velocity = part.get("following", 0.0) + part.get("damping", 0.0)
        return (velocity > 0.0 if self.velocity else True) & (part.get("position", 1.0) > 0.0)

    @property
    def simpler(self) -> tuple[Structure, ...]:
        """The structures with one number less."""
        found = []
        if self.acceleration:
            found.append(replace(self, acceleration=False))
        if self.coulomb:
            found.append(replace(self, coulomb=False))
        if self.force:
            found.append(replace(self, force=False))
        if self.offset:
            found.append(replace(self, offset=False))
        if self.skew:
            found.append(replace(self, skew=False))
        if self.form == "pi":
            found.append(replace(self, form=""))
        if self.velocity and self.share is None:
            found += [replace(self, share=0), replace(self, share=1)]
        if self.position and self.velocity and (self.form or self.share != 0):
            found.append(replace(self, position=False))
        if self.position and self.velocity and not self.form and self.share is not None:
            found.append(replace(self, velocity=False, share=0))
        return tuple(found)


@cache
def _combinations(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """The part of the combination that is the same for every ``wi``, and the one in proportion to it."""
    proportional = float(structure.form != "ip")
    constant = {
        "position": {"error": proportional},
        "following": {"slip": proportional, "velocity": proportional - 1.0},
        "damping": {"velocity": -1.0},
        "acceleration": {"acceleration": 1.0},
        "coulomb": {"sign": 1.0},
        "offset": {"offset": 1.0},
        "skew": {"velocity": 1.0},
    }
    integral = {
        "position": {"error_sum": 1.0},
        "following": {"slip_sum": 1.0},
        "damping": {"velocity_sum": -1.0},
        "force": {"force_sum": 1.0},
    }
    tables = np.zeros((2, len(COLUMNS), len(structure.linear)))
    for table, terms in zip(tables, (constant, integral), strict=True):
        for column, name in enumerate(structure.linear):
            for regressor, factor in terms.get(name, {}).items():
                table[PLACE[regressor], column] = factor
    return tables[0], tables[1]


PROPORTIONAL = Structure(form="", share=0, velocity=False, acceleration=False, coulomb=False)
