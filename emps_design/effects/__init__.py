"""The physical effects this package knows, one file each, in the order they are listed and tried."""

from __future__ import annotations

from emps_design.effects import (
    flexible_coupling,
    stribeck_friction,
)
from emps_design.effects.effect import Effect, Motion, Parameter
from emps_design.errors import AxisError, nearest_name

EFFECTS: tuple[Effect, ...] = (
    stribeck_friction.EFFECT,
    flexible_coupling.EFFECT,
)

_added: dict[str, Effect] = {}


def known_effects() -> dict[str, Effect]:
    """Every effect by name: the package's own, then those a user registered."""
    return {**{effect.name: effect for effect in EFFECTS}, **_added}


def get_effect(name: str) -> Effect:
    """Return the effect called ``name``; :class:`AxisError` names the nearest one otherwise."""
    known = known_effects()
    if name not in known:
        raise AxisError(
            f"effects: found kind {name!r}, expected one of {', '.join(known)}{nearest_name(name, list(known))}"
        )
    return known[name]


def register(effect: Effect) -> Effect:
    """Let a user's own effect take part in everything the package's effects take part in; returns it."""
    if effect.name in {own.name for own in EFFECTS}:
        raise AxisError(f"effect {effect.name}: the package has one of that name, choose another")
    _added[effect.name] = effect
    return effect


__all__ = ["EFFECTS", "Effect", "Motion", "Parameter", "get_effect", "known_effects", "register"]
