"""Effects that are one harmonic, A sin(angle + phase): kernel, two linear coefficients, parameters, search.

Amplitude and phase follow from the coefficients of sine and cosine of the angle, which are linear. :func:`along`
makes the effect of a harmonic over position.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from emps_design.effects import guesses
from emps_design.effects.effect import Effect, Estimation, Motion, Parameter, Parameters
from emps_design.effects.sizes import stroke_size

SHORTEST = 5e-4  # m, shortest period in position that is looked for on an ordinary stroke


def along_travel(q: float, v: float, t: float, tau: float, x: Any, p: Any, b: Any) -> float:
    """Kernel of one harmonic of the position ``q`` [m]: ``p`` = amplitude, phase [rad], period [m]."""
    return p[0] * math.sin(2.0 * math.pi / p[2] * q + p[1])


def columns(angle: np.ndarray) -> np.ndarray:
    """Return sin and cos of ``angle`` [rad] side by side, shape (n, 2)."""
    return np.column_stack([np.sin(angle), np.cos(angle)])


def filtered_columns(motion: Motion, angle: np.ndarray) -> np.ndarray:
    """Return sin and cos of ``angle`` (n,) [rad], filtered like ``motion``, shape (n, 2)."""
    sine, cosine = columns(angle).T
    return np.column_stack([motion.smooth(sine), motion.smooth(cosine)])


def estimation(size: str = "amplitude", angle: str = "phase", **identified_by: Any) -> Estimation:
    """Return the conversion of sine and cosine coefficients to the parameters ``size`` >= 0 and ``angle`` [rad].

    >>> wave = estimation()
    >>> wave.to_linear({"amplitude": 2.0, "phase": 0.0})
    array([2., 0.])
    >>> wave.from_linear([0.0, 3.0], {"period": 0.005})
    {'amplitude': 3.0, 'phase': 1.5707963267948966, 'period': 0.005}
    """

    def to_linear(parameters: Parameters) -> np.ndarray:
        return parameters[size] * np.array([math.cos(parameters[angle]), math.sin(parameters[angle])])

    def from_linear(coefficients: np.ndarray, shape: Parameters) -> dict[str, float]:
        sine, cosine = (float(c) for c in coefficients)
        rest = {name: value for name, value in shape.items() if name not in (size, angle)}
        return {size: math.hypot(sine, cosine), angle: math.atan2(cosine, sine), **rest}

    return Estimation(to_linear, from_linear, identified_by)


def along(hook: str, amplitude: Parameter, repeats: Parameter, **declared: Any) -> Effect:
    """Return the effect whose ``hook``, "force", "dry" or "sensor", is one harmonic over position.

    ``repeats`` is the parameter that is its period. ``declared`` are the other fields of the effect; ``regressor`` is
    by default sine and cosine, times the sign of the velocity if the hook is "dry".
    """

    def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
        waves = filtered_columns(motion, 2 * math.pi * motion.q / shape[repeats.name])
        return waves * np.sign(motion.v)[:, None] if hook == "dry" else waves

    def expression(q: Any, v: Any, t: Any, tau: Any, p: Parameters, b: np.ndarray) -> Any:
        import sympy

        wave = p["amplitude"] * sympy.sin(2 * sympy.pi * q / p[repeats.name] + p["phase"])
        return wave * sympy.sign(v) if hook == "dry" else wave

    derived: dict[str, Any] = {hook: along_travel, "regressor": regressor, "expression": expression, **declared}
    parameters = amplitude, phase("the encoder's zero"), repeats
    return Effect(parameters=parameters, repeats=repeats.name, over="q", estimation=estimation(), **derived)


def phase(zero: str) -> Parameter:
    """The parameter of the phase at ``zero``, which differs from record to record."""
    return Parameter("phase", r"\varphi", "rad", linear=True, scale=1.0, per_record=True, text=f"phase at {zero}")


def period(what: str) -> Parameter:
    """The parameter of the travel after which ``what`` repeats, 0.1 mm to 10 cm."""
    starts = (0.001, 0.002, 0.0025, 0.004, 0.005, 0.01, 0.02)
    text = f"travel after which {what} repeats"
    return Parameter("period", r"\lambda", "m", lower=1e-4, upper=0.1, starts=starts, text=text)


def periods(motion: Motion, residual: np.ndarray, away: np.ndarray, columns: guesses.Waves) -> list[dict[str, float]]:
    """Starts for ``period``: those at which ``columns`` explain most of ``residual`` (n,) [N] on the samples ``away``.

    The shortest is proportional to the stroke, and not shorter than the record resolves.
    """
    shortest = max(SHORTEST * stroke_size(motion.q), shortest_resolved(motion))
    lengths = guesses.periods(residual, motion.q, motion.v, motion.a, away, columns, shortest)
    return [{"period": period} for period in lengths]


def shortest_resolved(motion: Motion) -> float:
    """The shortest period in position [m] that a record resolves: two samples per period on half of the travel.

    >>> t = np.arange(0.0, 1.0, 0.01)
    >>> shortest_resolved(Motion(t, 0.1 * t, 0.1 + 0.0 * t, 0.0 * t, 0.0 * t, 0.01))
    0.002
    """
    speed = np.sort(np.abs(motion.v))
    travel = np.cumsum(speed)
    return float(2.0 * motion.period * speed[np.searchsorted(travel, 0.5 * travel[-1])])


def plausible(parameters: Parameters, motion: Motion) -> bool:
    """Whether a ``period`` is a line; longer than a third of the stroke it is a force or a scale error."""
    return parameters["period"] < float(np.ptp(motion.q)) / 3


def waves(size: np.ndarray | float = 1.0) -> guesses.Waves:
    """The function that multiplies sine and cosine by ``size`` (n,), for :func:`.guesses.periods`."""

    def columns(
        index: np.ndarray, waves: np.ndarray, sine: np.ndarray, cosine: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        weight = size[index][:, None] if isinstance(size, np.ndarray) else size
        return weight * sine, weight * cosine

    return columns
