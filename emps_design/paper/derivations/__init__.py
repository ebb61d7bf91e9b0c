"""The paper's equations, derived from its premises and compared with what it prints."""

from __future__ import annotations

from functools import cache

from emps_design.paper.derivations.model import DerivationStep

__all__ = ["DerivationStep", "derivation"]


@cache
def derivation() -> dict[str, tuple[str, tuple[DerivationStep, ...]]]:
    """Title and steps of each part, by name.

    >>> list(derivation())
    ['model', 'cascade', 'pi', 'identification', 'impedance']
    """
    from emps_design.paper.derivations.impedance import derive_impedance
    from emps_design.paper.derivations.model import derive_least_squares, derive_model
    from emps_design.paper.derivations.velocity_loop import derive_force_loop, derive_pi_loop, derive_velocity_loop

    return {
        "model": ("Drive and carriage, (1) to (5)", derive_model()),
        "cascade": ("Velocity and force loop, (6) to (11)", (*derive_velocity_loop(), *derive_force_loop())),
        "pi": ("The velocity loop of a servo drive, PI", derive_pi_loop()),
        "identification": ("Identification and observation, (12) to (23)", derive_least_squares()),
        "impedance": ("Impedance law, (24) to (30)", derive_impedance()),
    }
