"""Resonances and antiresonances of a measured response, with their deviations.

Around each peak of |j w G| that stands out of what is usual beside it by more than the deviations explain, a parabola
in frequency over a straight line, with complex coefficients, is fitted to the response; around each dip, to its
inverse. The root of the line is the pole, or the zero: its real part in frequency is the natural frequency, its
imaginary part the damping, which no machine has below 0. The fit is linear once the denominator of the last turn weighs
the equations (C. K. Sanathanan and J. Koerner, IEEE Trans. Automatic Control 8, 1963). Where the response is rough, as
dry friction makes it, one line that stands out is no peak, and what the fit leaves raises the deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.frequency_response.response import FrequencyResponse

ORDER = 2
TURNS = 12
NARROWEST = 5  # lines on either side of the extreme
WIDEST = 0.1  # share of its frequency on either side
SYSTEMATIC = 1e-3  # relative, what the fit may differ from a response by
CLEAR = 1.3  # ratio to both flanks, as they usually are, that makes an extreme
ROUGH = 0.05  # deviation from which on one line alone makes none
FAR = 0.5  # share of the frequency within which the flanks are looked for
UNLIKELY = 3.0  # deviations by which a damping may be below 0
VAGUE = 0.02  # share of its frequency; a root that is less certain is none
BROAD = 0.3  # damping ratio from which on there is no extreme to speak of


@dataclass(frozen=True)
class Resonance:
    """``kind`` is ``resonance`` or ``antiresonance``; ``frequency`` and its ``std`` [Hz], ``damping`` ratio."""

    kind: str
    frequency: float
    std: float
    damping: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {"kind": self.kind, "frequency_hz": self.frequency, "std_hz": self.std, "damping": self.damping}


def resonances(response: FrequencyResponse) -> tuple[Resonance, ...]:
    """Return the resonances and antiresonances of ``response`` by frequency.

    >>> f = np.arange(5.0, 100.0)
    >>> s = 2j * np.pi * f
    >>> two = lambda at: s**2 + 0.04 * 2.0 * np.pi * at * s + (2.0 * np.pi * at) ** 2
    >>> for one in resonances(FrequencyResponse.of(f, two(30.3) / two(44.7) / s, np.full(f.size, 1e-3))):
    ...     print(one.kind, round(one.frequency, 1), round(one.damping, 3))
    antiresonance 30.3 0.02
    resonance 44.7 0.02
    """
    flat = np.abs(response.w * response.response)
    found = []
    for kind, size in (("antiresonance", 1.0 / flat), ("resonance", flat)):
        for at in _peaks(size, response.frequency, response.std):
            one = _root(response, at, kind)
            if one is not None:
                found.append(one)
    return tuple(sorted(found, key=lambda one: one.frequency))


def _peaks(size: np.ndarray, frequency: np.ndarray, std: np.ndarray) -> list[int]:
    """Places of the peaks of ``size`` that stand clear of their flanks by more than noise."""
    found = []
    for at in range(2, size.size - 2):
        near = np.abs(frequency - frequency[at]) <= WIDEST * frequency[at]
        near[max(0, at - NARROWEST) : at + NARROWEST + 1] = True
        if size[at] < np.max(size[near]):
            continue
        far = np.abs(frequency - frequency[at]) <= FAR * frequency[at]
        left, right = size[:at][far[:at]], size[at + 1 :][far[at + 1 :]]
        if left.size < 2 or right.size < 2:
            continue
        spread = float(np.max(std[max(0, at - 2) : at + 3]))
        height = size[at] if spread < ROUGH else max(size[at - 1], size[at + 1])
        if height > max(CLEAR, 1.0 + 6.0 * spread) * max(np.median(left), np.median(right)):
            found.append(at)
    return found


def _root(response: FrequencyResponse, at: int, kind: str) -> Resonance | None:
    """The zero or the pole next to line ``at``; None where it is not there after all."""
    f, centre = response.frequency, float(response.frequency[at])
    near = np.abs(f - centre) <= WIDEST * centre
    near[max(0, at - NARROWEST) : at + NARROWEST + 1] = True
    x = f[near] / centre - 1.0
    y = 1j * response.w[near] * response.response[near]
    y = y if kind == "resonance" else 1.0 / y
    y = y / np.max(np.abs(y))
    spread = np.hypot(response.std[near], SYSTEMATIC) * np.abs(y)
    powers = x[:, None] ** np.arange(ORDER + 1)
    below = np.ones(x.size, complex)
    for _ in range(TURNS):
        rows = np.column_stack([powers, -y * x]) / (spread * below)[:, None]
        theta = np.linalg.lstsq(rows, y / (spread * below), rcond=1e-12)[0]
        below = 1.0 + theta[-1] * x
    if theta[-1] == 0.0 or not np.all(np.isfinite(theta)) or np.any(below == 0.0):
        return None
    root = -1.0 / theta[-1]
    if abs(root) > np.max(np.abs(x)):
        return None
    fitted = powers @ theta[:-1] / below
    rows = np.column_stack([powers, -fitted * x]) / (spread * below)[:, None]
    inverse = np.linalg.pinv(rows)[-1]
    misfit = float(np.sqrt(np.sum(np.abs((y - fitted) / spread) ** 2) / (x.size - theta.size)))
    std = float(np.sqrt(0.5) * np.linalg.norm(inverse) * abs(root) ** 2) * max(1.0, misfit)
    place = 1.0 + root
    damping = float(place.imag / place.real)
    if std > VAGUE or abs(damping) > BROAD or damping < -UNLIKELY * std:  # which would swing up by itself
        return None
    return Resonance(kind, float(centre * place.real), centre * std, abs(damping))
