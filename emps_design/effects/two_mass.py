"""Common part of effects with a share of the mass behind a coupling: parameters of the coupling and states of the load.

A share of the viscous and Coulomb friction of the baseline may act on the load (guides, spindle nut), the rest on the
encoder's side (motor bearings), together with the friction of other effects. The sign of the load velocity is smoothed:
friction brings the load to rest with a time constant of ``SETTLING``.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from emps_design.effects.effect import COULOMB, VISCOUS, Effect, Parameter
from emps_design.quantities import Quantity

STATES = (Quantity("twist", "d", "m"), Quantity("load_velocity", r"\dot q_l", "m/s"))
LOWEST, HIGHEST = 5.0, 400.0  # Hz, range of the resonance in a search
# Limits of an axis file: a gantry with a long arm has a low resonance, a small drive one far above the record.
RESONANCES, DAMPINGS, SHARES = (0.1, 20_000.0), (0.0, 10.0), (1e-4, 0.9999)
SETTLING = 2e-5  # s


def coupling(pair: str, starts: tuple[float, ...], damping: float, behind: str) -> tuple[Parameter, ...]:
    """Parameters: resonance [Hz] of the free ``pair`` of masses, damping ratio, share of the mass ``behind``, friction.

    The bounds are those of a search; an axis file may exceed them.
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
    """The ``share`` of the baseline friction [N] that acts on a load of ``mass`` [kg] at ``v`` [m/s]."""
    if share == 0.0:  # the usual case, without the square root
        return 0.0
    coulomb = share * b[COULOMB]
    slow = SETTLING * coulomb / mass
    return share * b[VISCOUS] * v + coulomb * v / sqrt(v * v + slow * slow + 1e-300)


def affine(share: float, half: float) -> tuple[float, float] | None:
    """Range (-half, half) of the twist [m] for a play of ``half`` to each side; forces are affine inside and outside.

    None if a ``share`` of the friction acts on the load, because its smoothed sign is not affine.
    """
    return (-half, half) if share == 0.0 else None


def is_coupling(effect: Effect) -> bool:
    """Whether ``effect`` puts part of the mass behind a coupling, with or without play."""
    return effect.states == STATES


def linear_coupling(frequency: float, damping: float, share: float) -> dict[str, float | str]:
    """The ``[[effects]]`` table of a coupling without play: resonance [Hz], damping ratio, share of the mass behind."""
    return {"kind": "flexible_coupling", "frequency": frequency, "damping": damping, "share": share}
