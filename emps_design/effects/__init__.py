"""Physical effects: the package's own library, one file each, and those that a user adds.

A user's own effect is a file with an ``EFFECT`` like those here. :func:`load_file` registers it, and so does naming it
in the environment, ``EMPS_DESIGN_EFFECTS=path1.py:path2.py`` (``;`` between paths on Windows), when the package is
imported. It is a plain import: the file's code runs.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

from emps_design.effects.effect import Effect, Motion, Parameter
from emps_design.effects.library import EFFECTS
from emps_design.errors import AxisError, nearest_name

VARIABLE = "EMPS_DESIGN_EFFECTS"  # environment variable with the files of a user's own effects

_added: dict[str, Effect] = {}


def known_effects() -> dict[str, Effect]:
    """Every effect by name: the package's own, then those a user registered.

    >>> "backlash" in known_effects()
    True
    """
    return {**{effect.name: effect for effect in EFFECTS}, **_added}


def get_effect(name: str) -> Effect:
    """Return the effect called ``name``; :class:`AxisError` names the nearest one otherwise.

    >>> get_effect("position_ripple").shape
    ('period',)
    """
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


def load_file(path: str | Path) -> Effect:
    """Run the Python file at ``path``, register its ``EFFECT`` and return it.

    Raises :class:`AxisError` naming the file where it cannot be run or has no ``EFFECT``.
    """
    path = Path(path)
    if not path.is_file():
        raise AxisError(f"{path}: no such file; expected a Python file with an EFFECT")
    spec = importlib.util.spec_from_file_location(f"emps_design_effect_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise AxisError(f"{path}: found a name that does not end in .py, expected a Python file with an EFFECT")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # kernels compiled by another process are found again by their module's name
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file may raise, told with its name
        raise AxisError(f"{path}: {type(error).__name__}: {error}") from error
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise AxisError(f"{path}: found EFFECT = {effect!r}, expected an emps_design.effects.Effect")
    return register(effect)


for _path in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
    load_file(_path)

__all__ = [
    "EFFECTS",
    "VARIABLE",
    "Effect",
    "Motion",
    "Parameter",
    "get_effect",
    "known_effects",
    "load_file",
    "register",
]
