"""What effects with part of the mass behind a coupling share: the parameters of the coupling and the load's states.

Of the baseline's viscous and Coulomb friction a share may act on the load (guides, a spindle's nut), the rest on the
encoder's side (motor bearings); the friction of other effects stays there. The load's direction is a smooth one, where
friction brings it to rest: within ``SETTLING`` its speed has fallen by a factor of e.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from emps_design.effects.effect import COULOMB, VISCOUS, Effect, Parameter
from emps_design.quantities import Quantity

STATES = (Quantity("twist", "d", "m"), Quantity("load_velocity", r"\dot q_l", "m/s"))
LOWEST, HIGHEST = 5.0, 400.0  # Hz, between which a search looks for the resonance
# What an axis file may give: a gantry with a long arm sways slowly, a small drive rings far beyond what a record shows.
RESONANCES, DAMPINGS, SHARES = (0.1, 20_000.0), (0.0, 10.0), (1e-4, 0.9999)
SETTLING = 2e-5  # s


def coupling(pair: str, starts: tuple[float, ...], damping: float, behind: str) -> tuple[Parameter, ...]:
    """Resonance [Hz] of the free ``pair`` of masses, its damping ratio, and the share of the mass ``behind`` it.

    Their bounds are those within which a search looks; an axis file may go beyond them.
    """
    resonance, ratio = f"resonance of the two masses{pair}, free", "damping ratio of that resonance"
    return (
        Parameter("frequency", "f_n", "Hz", LOWEST, HIGHEST, starts=starts, text=resonance, allowed=RESONANCES),
        Parameter("damping", r"\zeta", "", 0.0, 1.0, starts=(damping,), text=ratio, allowed=DAMPINGS),
        Parameter("share", r"\mu", "", 0.01, 0.95, starts=(0.4,), text=f"share of the mass {behind}", allowed=SHARES),
        Parameter(
            "load_friction",
            r"\lambda",
            "",
            lower=0.0,
            upper=1.0,
            starts=(0.0, 0.5, 1.0),
            default=0.0,
            text="share of viscous and Coulomb friction that acts on the load",
        ),
    )


def load_friction(v: float, share: float, mass: float, b: np.ndarray) -> float:
    """The ``share`` of the friction of the baseline ``b`` [N] that brakes a load of ``mass`` [kg] at ``v`` [m/s]."""
    if share == 0.0:  # the usual case, without the square root
        return 0.0
    coulomb = share * b[COULOMB]
    slow = SETTLING * coulomb / mass
    return share * b[VISCOUS] * v + coulomb * v / sqrt(v * v + slow * slow + 1e-300)


def affine(share: float, half: float) -> tuple[float, float] | None:
    """Range of the twist [m] around 0 with a play of ``half`` to each side, between and beyond which forces are affine.

    None where a ``share`` of the friction acts on the load, which it brings to rest in a curve.
    """
    return (-half, half) if share == 0.0 else None


def is_coupling(effect: Effect) -> bool:
    """Whether ``effect`` puts part of the mass behind a coupling, with play or without."""
    return effect.states == STATES


def linear_coupling(frequency: float, damping: float, share: float) -> dict[str, float | str]:
    """The ``[[effects]]`` table of a coupling without play: resonance [Hz], damping ratio, share of the mass behind."""
    return {"kind": "flexible_coupling", "frequency": frequency, "damping": damping, "share": share}
