"""Physical effects: the library of the package, one file each, and effects added by the user.

A user's effect is a file with an ``EFFECT`` like those in the library. Register it with :func:`load_file`, or name it
in the environment variable ``EMPS_DESIGN_EFFECTS=path1.py:path2.py`` (``;`` between paths on Windows) before importing
the package. The file is imported, so its code runs.
"""

from __future__ import annotations

from emps_design.effects.effect import (
    Claims as Claims,
    Effect as Effect,
    Estimation as Estimation,
    Motion as Motion,
    Parameter as Parameter,
    Search as Search,
    Solver as Solver,
    Words as Words,
    kind_of as kind_of,
)
from emps_design.effects.library import EFFECTS as EFFECTS
from emps_design.registry import Registry

VARIABLE = "EMPS_DESIGN_EFFECTS"  # environment variable with the files of a user's effects
REGISTRY: Registry[Effect] = Registry("effect", Effect, EFFECTS, VARIABLE, "effects")

known_effects, get_effect = REGISTRY.known, REGISTRY.get
register, load_file = REGISTRY.register, REGISTRY.load_file

REGISTRY.load_environment()
