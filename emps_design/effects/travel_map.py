"""Effects that are a map over position, made by :func:`along`: a smooth curve through few knots.

The travel from ``start`` to ``end`` is divided into six equal pieces. The curve is zero at the start, where the
constant force or the Coulomb level of the axis is valid, ``height_1`` to ``height_6`` at the other knots, and constant
outside. Between knots it is a cubic; its slopes at the knots are central differences (Catmull-Rom), at both ends zero.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from emps_design.effects import harmonic
from emps_design.effects.effect import Effect, Motion, Parameter, Parameters, Search

PIECES = 6
NAMES = tuple(f"height_{i + 1}" for i in range(PIECES))
ALIKE = 0.97  # share of a map's variance from which on a simpler curve fits as well
LENGTHS = np.geomspace(0.4, 1.5, 12)  # periods of the harmonics to compare with, in lengths of the map


def height(q: float, v: float, t: float, tau: float, x: Any, p: Any, b: Any) -> float:
    """Kernel of the curve at ``q`` [m]: ``p`` = start, end [m], heights [N]."""
    place = (q - p[0]) / (p[1] - p[0]) * PIECES
    if place <= 0.0:
        return 0.0
    if place >= PIECES:
        return p[1 + PIECES]
    piece = int(place)
    along = place - piece
    left = p[1 + piece] if piece > 0 else 0.0
    right = p[2 + piece]
    before = p[piece] if piece > 1 else 0.0
    begins = 0.5 * (right - before) if piece > 0 else 0.0
    ends = 0.5 * (p[3 + piece] - left) if piece < PIECES - 1 else 0.0
    rise = right - left
    return left + along * (begins + along * (3.0 * rise - 2.0 * begins - ends + along * (begins + ends - 2.0 * rise)))


def parameters(what: str) -> tuple[Parameter, ...]:
    """The parameters of a map: start, end, and the heights at its knots; ``what`` describes a height."""
    return (
        Parameter("start", "q_0", "m", -1e3, 1e3, starts=(0.0,), discrete=True, text="start of the map"),
        Parameter("end", "q_1", "m", -1e3, 1e3, starts=(0.25,), discrete=True, text="end of the map"),
        *(
            Parameter(name, f"h_{i + 1}", "N", linear=True, scale=2.0, text=f"{what} after {i + 1} of {PIECES} pieces")
            for i, name in enumerate(NAMES)
        ),
    )


def columns(motion: Motion, shape: Parameters) -> np.ndarray:
    """Change of the curve per newton of each height, (n, ``PIECES``)."""
    from scipy.interpolate import CubicHermiteSpline

    knots = np.linspace(shape["start"], shape["end"], PIECES + 1)
    units = np.eye(PIECES + 1)[:, 1:]
    slopes = np.gradient(units, knots, axis=0)
    slopes[[0, -1]] = 0.0
    return CubicHermiteSpline(knots, units, slopes)(np.clip(motion.q, knots[0], knots[-1]))


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    """Start and end at the travel of the record, rounded to a thousandth; the heights come from a regression."""
    span = float(np.ptp(motion.q))
    if span == 0.0:
        return []
    digits = 3 - int(np.floor(np.log10(span)))
    return [{"start": round(float(motion.q.min()), digits), "end": round(float(motion.q.max()), digits)}]


def plausible(line: bool) -> Callable[[Parameters, Motion], bool]:
    """Return the test that no simpler curve fits as well: a harmonic over position, or a straight ``line``."""

    def plausible(parameters: Parameters, motion: Motion) -> bool:
        place = np.linspace(0.0, 1.0, PIECES + 1)
        heights = np.array([0.0, *(parameters[name] for name in NAMES)])
        simpler = [harmonic.columns(2 * np.pi * place / length) for length in LENGTHS]
        simpler += [place[:, None]] * line
        designs = [np.column_stack([np.ones_like(place), curve]) for curve in simpler]
        unexplained = min(float(np.sum((heights - d @ np.linalg.lstsq(d, heights)[0]) ** 2)) for d in designs)
        return unexplained > (1.0 - ALIKE) * float(np.sum((heights - heights.mean()) ** 2))

    return plausible


def along(hook: str, what: str, confused_with: tuple[str, ...], line: bool = False, **declared: Any) -> Effect:
    """Return the effect whose ``hook``, "force" or "dry", is the curve; ``what`` describes its height at a knot.

    A force is filtered like the motion; dry friction has the sign of the velocity. ``line``: a straight line counts as
    another effect. ``declared`` are the other fields.
    """

    def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
        curves = columns(motion, shape)
        if hook == "dry":
            return curves * np.sign(motion.v)[:, None]
        return np.column_stack([motion.smooth(curve) for curve in curves.T])

    def expression(q: Any, v: Any, t: Any, tau: Any, p: Parameters, b: np.ndarray) -> Any:
        import sympy

        return in_symbols(q, p) * sympy.sign(v) if hook == "dry" else in_symbols(q, p)

    search = Search(propose=propose, plausible=plausible(line), confused_with=confused_with, general=True)
    derived: dict[str, Any] = {hook: height, "regressor": regressor, "expression": expression, "search": search}
    return Effect(parameters=parameters(what), over="q", **derived, **declared)


def in_symbols(q: Any, p: Parameters) -> Any:
    """The curve as a SymPy expression."""
    import sympy

    heights = [sympy.Integer(0), *(p[name] for name in NAMES)]
    middle = [(right - left) / 2 for left, right in zip(heights, heights[2:], strict=False)]
    slopes, place = [0, *middle, 0], (q - p["start"]) / (p["end"] - p["start"]) * PIECES
    pieces = [(sympy.Integer(0), place <= 0)]
    for i, (left, right) in enumerate(itertools.pairwise(heights)):
        along, begins, ends, rise = place - i, slopes[i], slopes[i + 1], right - left
        bend = 3 * rise - 2 * begins - ends + along * (begins + ends - 2 * rise)
        pieces.append((left + along * (begins + along * bend), place < i + 1))
    return sympy.Piecewise(*pieces, (heights[-1], True))
