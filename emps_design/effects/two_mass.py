"""What effects with part of the mass behind a coupling share: the parameters of the coupling and the load's states."""

from __future__ import annotations

from emps_design.effects.effect import Parameter
from emps_design.quantities import Quantity

STATES = (Quantity("twist", "d", "m"), Quantity("load_velocity", r"\dot q_l", "m/s"))
NO_REGRESSOR = "the load is a state that no measured signal gives"


def coupling(pair: str, starts: tuple[float, ...], damping: float, behind: str) -> tuple[Parameter, ...]:
    """Resonance [Hz] of the free ``pair`` of masses, its damping ratio, and the share of the mass ``behind`` it."""
    resonance, ratio = f"resonance of the two masses{pair}, free", "damping ratio of that resonance"
    return (
        Parameter("frequency", "f_n", "Hz", lower=5.0, upper=400.0, starts=starts, text=resonance),
        Parameter("damping", r"\zeta", "", lower=0.0, upper=1.0, starts=(damping,), text=ratio),
        Parameter("share", r"\mu", "", lower=0.01, upper=0.95, starts=(0.4,), text=f"share of the mass {behind}"),
    )


def linear_coupling(frequency: float, damping: float, share: float) -> dict[str, float | str]:
    """The ``[[effects]]`` table of a coupling without play: resonance [Hz], damping ratio, share of the mass behind."""
    return {"kind": "flexible_coupling", "frequency": frequency, "damping": damping, "share": share}
