"""Resonances and antiresonances of a measured response, with their deviations.

Around each dip of |j w G| that the deviations do not explain, and around each peak, a quotient of two parabolas in
frequency, with complex coefficients, is fitted to the response. The root of its numerator next to the dip is the zero,
that of its denominator next to the peak the pole: the real part in frequency is the natural frequency, the imaginary
part the damping. The fit is linear once the denominator of the last turn weighs the equations (C. K. Sanathanan and
J. Koerner, IEEE Trans. Automatic Control 8, 1963).
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
SYSTEMATIC = 1e-3  # relative, what a quotient of parabolas may differ from a response by
CLEAR = 1.3  # ratio to both flanks that makes an extreme
FAR = 0.5  # share of the frequency within which the flanks are looked for
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
        clear = max(CLEAR, 1.0 + 6.0 * float(np.max(std[max(0, at - 2) : at + 3])))
        if size[at] > clear * np.min(left) and size[at] > clear * np.min(right):
            found.append(at)
    return found


def _root(response: FrequencyResponse, at: int, kind: str) -> Resonance | None:
    """The zero or the pole next to line ``at``; None where it is not there after all."""
    f, centre = response.frequency, float(response.frequency[at])
    near = np.abs(f - centre) <= WIDEST * centre
    near[max(0, at - NARROWEST) : at + NARROWEST + 1] = True
    x = f[near] / centre - 1.0
    y = 1j * response.w[near] * response.response[near]
    y = y / np.max(np.abs(y))
    spread = np.hypot(response.std[near], SYSTEMATIC) * np.abs(y)
    reach = float(np.max(np.abs(x)))
    powers = (x[:, None] / reach) ** np.arange(ORDER + 1)
    below = np.ones(x.size, complex)
    for _ in range(TURNS):
        rows = np.concatenate([powers, -y[:, None] * powers[:, 1:]], axis=1) / (spread * below)[:, None]
        theta = np.linalg.lstsq(rows, y / (spread * below), rcond=1e-12)[0]
        below = powers @ np.concatenate([[1.0], theta[ORDER + 1 :]])
    top, bottom = theta[: ORDER + 1], np.concatenate([[1.0], theta[ORDER + 1 :]])
    polynomial, first = (top, 0) if kind == "antiresonance" else (bottom, ORDER)
    if polynomial[-1] == 0.0 or not np.all(np.isfinite(theta)):
        return None
    roots = np.roots(polynomial[::-1])
    root = roots[np.argmin(np.abs(roots))]
    if abs(root) > 1.0:
        return None
    rows = np.concatenate([powers, -(powers @ top / below)[:, None] * powers[:, 1:]], axis=1)
    cov = np.linalg.pinv(rows / (spread * below)[:, None])
    cov = cov @ cov.conj().T
    slope = polynomial[1] + 2.0 * polynomial[2] * root
    row = np.zeros(2 * ORDER + 1, complex)
    powers_of_root = root ** np.arange(ORDER + 1)
    row[first : first + ORDER + 1] = powers_of_root / slope
    if kind == "resonance":  # the denominator's constant is not free
        row[first] = 0.0
    std = reach * float(np.sqrt(max(0.0, 0.5 * (row @ cov @ row.conj()).real)))
    place = 1.0 + reach * root
    damping = float(abs(place.imag) / place.real)
    if std > VAGUE or damping > BROAD:
        return None
    return Resonance(kind, float(centre * place.real), centre * std, damping)
