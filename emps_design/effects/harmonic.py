"""Amplitude and phase of a harmonic, A sin(angle + phase), as two linear coefficients and back."""

from __future__ import annotations

import math

import numpy as np

from emps_design.effects.effect import Parameters


def columns(angle: np.ndarray) -> np.ndarray:
    """Return sin and cos of ``angle`` [rad] side by side, shape (n, 2)."""
    return np.column_stack([np.sin(angle), np.cos(angle)])


def to_linear(parameters: Parameters) -> np.ndarray:
    """Coefficients of :func:`columns` that belong to ``amplitude`` and ``phase``.

    >>> to_linear({"amplitude": 2.0, "phase": 0.0})
    array([2., 0.])
    """
    return parameters["amplitude"] * np.array([math.cos(parameters["phase"]), math.sin(parameters["phase"])])


def from_linear(coefficients: np.ndarray, shape: Parameters) -> dict[str, float]:
    """Return ``amplitude`` (not negative) and ``phase`` [rad] in (-pi, pi], with the shape parameters unchanged.

    >>> from_linear([0.0, 3.0], {"period": 0.005})
    {'amplitude': 3.0, 'phase': 1.5707963267948966, 'period': 0.005}
    """
    sine, cosine = (float(c) for c in coefficients)
    rest = {name: value for name, value in shape.items() if name not in ("amplitude", "phase")}
    return {"amplitude": math.hypot(sine, cosine), "phase": math.atan2(cosine, sine), **rest}
