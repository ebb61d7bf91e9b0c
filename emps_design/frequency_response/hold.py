"""Between what a drive samples and the continuous plant: the hold, the difference and the aliases.

A command u[k] is held over a period T and the position is read at the samples. With P(s) = G(s)/s from force to
position, the sampled response is the sum over all aliases of the band,

    Q/F = (1/T) sum_n P(s_n) (1 - e^{-s_n T}) / s_n,    s_n = j (w + 2 pi n / T).

The term n = 0 is what one wants to know; hold and difference are divided out of it exactly. The others cannot be
measured apart from it. They fall with the third power of the frequency, and a plant ends as a mass m on the encoder's
side: P = 1/(m s^2) has the sum in closed form. With x = w T/2 it is x^3 cos(x) / sin(x)^3 times its own term n = 0, so
(that ratio - 1) / (j w m) is what the aliases add to G. It is 0.07 % of the mass line at a fifth of the Nyquist
frequency and 3 % at half of it. Source: K. J. Astrom and B. Wittenmark, Computer-Controlled Systems, chapters 2 and 7.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from emps_design.frequency_response.response import BAND

ALIASES = 4  # on either side that are looked at
TOP_SHARE = 0.6  # the mass line is read from the lines above this share of the highest one


def continuous_from_increments(ratio: np.ndarray, w: np.ndarray, period: float, delay: float = 0.0) -> np.ndarray:
    """Force to velocity, aliases still in it, from ``ratio`` (n,), position increment over held force [m/N].

    ``w`` [rad/s], ``period`` [s]; the force comes ``delay`` [s] after its sample.

    >>> w, T = np.array([10.0]), 1e-3  # a mass of 2 kg: q[k+1] - 2 q[k] + q[k-1] = T^2/4 (u[k] + u[k-1])
    >>> z = np.exp(1j * w * T)
    >>> increments = T**2 / 4.0 * (z + 1.0) / (z - 1.0) / z
    >>> round(abs(complex(continuous_from_increments(increments, w, T)[0])) * 10.0, 6)
    0.5
    """
    x = 0.5 * w * period
    return ratio * (x / np.sin(x)) ** 2 * np.exp(1j * (2.0 * x + w * delay)) / period


def alias_share(w: np.ndarray, period: float) -> np.ndarray:
    """What the aliases add to the response of a mass, as a share of it: x^3 cos(x) / sin(x)^3 - 1, x = w T/2.

    >>> alias_share(np.pi / 1e-3 * np.array([0.2, 0.5]), 1e-3).round(5).tolist()
    [-0.00067, -0.03105]
    """
    x = 0.5 * np.asarray(w) * period
    return x**3 * np.cos(x) / np.sin(x) ** 3 - 1.0


def mass_line(w: np.ndarray, response: np.ndarray, std: np.ndarray, share: Any = 0.0) -> tuple[float, float]:
    """The inverse mass [1/kg] in which ``response`` (n,) [m/s/N] ends, and the rms by which its top lines differ.

    ``share`` is :func:`alias_share` where the aliases are still in the response. The difference is relative, at most 1.

    >>> w = np.linspace(100.0, 1000.0, 50)
    >>> inverse, apart = mass_line(w, 1.0 / (4j * w), np.full(50, 0.01))
    >>> round(inverse, 6), round(apart, 6)
    (0.25, 0.0)
    """
    top = w >= TOP_SHARE * w[-1]
    flat = (1j * w * response / (1.0 + share))[top]
    weights = 1.0 / np.maximum(np.abs(flat) * std[top], 1e-3 * np.abs(flat)) ** 2
    inverse = float(np.sum(weights * flat.real) / np.sum(weights))
    if inverse <= 0.0:
        return 0.0, 1.0
    apart = np.sum(weights * np.abs(flat / inverse - 1.0) ** 2) / np.sum(weights)
    return inverse, min(1.0, float(np.sqrt(apart)))


def without_aliases(
    w: np.ndarray, response: np.ndarray, std: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """``response`` (n,) [m/s/N] without the aliases of its mass line, and the relative deviation that this leaves (n,).

    Those of a mass nearly cancel in pairs. A lag or a resonance turns them, and they do not: the deviation is what they
    all amount to, as the radius of a 95 % circle, times how far a line of the sampling frequency is from the mass line;
    that of the top lines grows with the frequency at most. Where they end in no mass line all of it is uncertain.
    """
    share = alias_share(w, period)
    inverse, apart = mass_line(w, response, std, share)
    found = response - share * inverse / (1j * w)
    turns = 2.0 * np.pi / period * np.delete(np.arange(-ALIASES, ALIASES + 1), ALIASES)
    most = np.sum(np.abs(w / (w + turns[:, None])) ** 3, axis=0)
    above = min(1.0, apart * 2.0 * np.pi / period / w[-1])
    size = inverse / (w * np.abs(found)) if inverse else 1.0
    return found, above * most * size / BAND


def sampled_position(
    w: np.ndarray,
    response: np.ndarray,
    period: float,
    delay: np.ndarray | float = 0.0,
    inverse_mass: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Position at the samples over held force at ``w`` [rad/s], from the continuous ``response`` [m/s/N]: (n,) [m/N].

    The force comes ``delay`` [s] after its sample, any fraction of a period. ``inverse_mass`` [1/kg] gives the aliases,
    those of a mass, for which the sampled response behind a fractional delay is known in closed form.
    """
    w = np.asarray(w, dtype=float)
    z, late = np.exp(1j * w * period), np.exp(-1j * w * delay)
    held = (1.0 - 1.0 / z) / (1j * w * period)
    found = response / (1j * w) * held * late
    if np.any(inverse_mass):
        found = found + inverse_mass * (_sampled_mass(z, period, delay) - held * late / (1j * w) ** 2)
    return found


def _sampled_mass(z: np.ndarray, period: float, delay: np.ndarray | float) -> np.ndarray:
    """Position of a mass of 1 kg over the held force that comes ``delay`` [s] late (modified z-transform)."""
    samples = np.asarray(delay) / period
    whole = np.floor(samples + 1e-9)
    late = np.maximum(samples - whole, 0.0)
    newer, back = (1.0 - late) ** 2, 1.0 / z
    step = 0.5 * (newer + (1.0 - newer) * back) * (z - 1.0) + (1.0 - late) + late * back
    return period**2 * step / (z - 1.0) ** 2 / z**whole
