"""When a loop is safe, and the machines that it was tried on, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SAFE_PHASE_MARGIN_DEG, SAFE_GAIN_MARGIN = 30.0, 2.0


def where_in_words(where: Mapping[str, Any]) -> str:
    """Say on which machine a loop is, from what that has different from the axis; empty for the axis as it is.

    ``inertia`` and ``compliance`` are factors, ``delay`` [s] comes on top, ``velocity`` [m/s] is where the effects are
    linearised, ``response`` the name of a measured one; any other is the relative error of a parameter.

    >>> where_in_words({"inertia": 3.0, "delay": 1e-3})
    'with 3 times the inertia and 1 ms more delay'
    >>> where_in_words({"mass": -0.02, "force_gain": 0.02})
    'with mass -2 % and force gain +2 %'
    """
    parts, places = [], []
    for name, value in where.items():
        if name in ("inertia", "compliance"):
            parts.append(f"{value:.4g} times the {name}")
        elif name == "delay":
            parts.append(f"{1e3 * value:.4g} ms more delay")
        elif name == "velocity":
            places.append(f"at {value:g} m/s")
        elif name == "response":
            places.append(f"on the measured plant {value}")
        else:
            parts.append(f"{name.replace('_', ' ')} {100.0 * value:+.3g} %")
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
    return " ".join([*([f"with {listed}"] if listed else []), *places])
