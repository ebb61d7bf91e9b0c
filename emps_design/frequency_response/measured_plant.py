"""A measured response as a sampled plant, and the frequency response of the linear law in front of it.

A command u[k] is held over a period T and the position is read at the samples. With P(s) = G(s)/s from force to
position, the sampled response is the sum over all aliases of the band,

    Q/F = (1/T) sum_n P(s_n) (1 - e^{-s_n T}) / s_n,    s_n = j (w + 2 pi n / T).

The term n = 0 holds the continuous response: hold and difference are divided out of it exactly. The aliases, the other
terms, cannot be measured apart from it. They fall with the third power of the frequency, and at high frequency a plant
is the mass m on the encoder's side: for P = 1/(m s^2) the sum has a closed form. With x = w T/2 it is
x^3 cos(x) / sin(x)^3 times its term n = 0, so the aliases add (x^3 cos(x) / sin(x)^3 - 1) / (j w m) to G. That is
0.07 % of the mass line at a fifth of the Nyquist frequency and 3 % at half of it. Source: K. J. Astrom and
B. Wittenmark, Computer-Controlled Systems, chapters 2 and 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.control.discretisation import Peaks, frequencies_around
from emps_design.control.margins import transfer
from emps_design.errors import InputError
from emps_design.frequency_response.response import BAND, FrequencyResponse
from emps_design.laws.linear import LinearLaw

ALIASES = 4  # on either side that are counted
TOP_SHARE = 0.6  # the mass line is read from the lines above this share of the highest one

BETWEEN = 6  # points of the grid in each interval of the data
BEYOND = 60  # points on either side of the data
FAR_BELOW = 1e-3  # of the lowest line, where the grid begins


def continuous_from_increments(ratio: np.ndarray, w: np.ndarray, period: float, delay: float = 0.0) -> np.ndarray:
    """Force to velocity (n,) [m/s/N] with its aliases, from ``ratio`` (n,) [m/N], position increment over held force.

    ``w`` [rad/s], ``period`` [s]; the force acts ``delay`` [s] after its sample.

    >>> w, T = np.array([10.0]), 1e-3  # a mass of 2 kg: q[k+1] - 2 q[k] + q[k-1] = T^2/4 (u[k] + u[k-1])
    >>> z = np.exp(1j * w * T)
    >>> increments = T**2 / 4.0 * (z + 1.0) / (z - 1.0) / z
    >>> round(abs(complex(continuous_from_increments(increments, w, T)[0])) * 10.0, 6)
    0.5
    """
    x = 0.5 * w * period
    return ratio * (x / np.sin(x)) ** 2 * np.exp(1j * (2.0 * x + w * delay)) / period


def alias_share(w: np.ndarray, period: float) -> np.ndarray:
    """Aliases of the response of a mass over the response itself: x^3 cos(x) / sin(x)^3 - 1, x = w T/2.

    >>> alias_share(np.pi / 1e-3 * np.array([0.2, 0.5]), 1e-3).round(5).tolist()
    [-0.00067, -0.03105]
    """
    x = 0.5 * np.asarray(w) * period
    return x**3 * np.cos(x) / np.sin(x) ** 3 - 1.0


def mass_line(w: np.ndarray, response: np.ndarray, std: np.ndarray, share: Any = 0.0) -> tuple[float, float]:
    """Inverse mass [1/kg] of the top lines of ``response`` (n,) [m/s/N], and their relative rms difference, at most 1.

    ``share`` is :func:`alias_share` where the response still has its aliases.

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
    """``response`` (n,) [m/s/N] less the aliases of its mass line, and the relative deviation (n,) by the rest.

    The aliases of a mass nearly cancel in pairs; behind a lag or a resonance they do not. The deviation is the sum of
    all their moduli, as the radius of a 95 % circle, times the relative difference of the plant from a mass at the
    sampling frequency: that of the top lines, extrapolated in proportion to frequency, at most 1. Without a mass line
    the aliases are uncertain altogether.
    """
    share = alias_share(w, period)
    inverse, apart = mass_line(w, response, std, share)
    corrected = response - share * inverse / (1j * w)
    turns = 2.0 * np.pi / period * np.delete(np.arange(-ALIASES, ALIASES + 1), ALIASES)
    most = np.sum(np.abs(w / (w + turns[:, None])) ** 3, axis=0)
    above = min(1.0, apart * 2.0 * np.pi / period / w[-1])
    size = inverse / (w * np.abs(corrected)) if inverse else 1.0
    return corrected, above * most * size / BAND


def sampled_position(
    w: np.ndarray,
    response: np.ndarray,
    period: float,
    delay: np.ndarray | float = 0.0,
    inverse_mass: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Sampled position over held force (n,) [m/N] at ``w`` [rad/s], from the continuous ``response`` [m/s/N].

    The force acts ``delay`` [s] after its sample, any fraction of a period. ``inverse_mass`` [1/kg] adds the aliases of
    a mass, for which the sampled response behind a fractional delay has a closed form.
    """
    w = np.asarray(w, dtype=float)
    z, late = np.exp(1j * w * period), np.exp(-1j * w * delay)
    held = (1.0 - 1.0 / z) / (1j * w * period)
    position = response / (1j * w) * held * late
    if np.any(inverse_mass):
        position = position + inverse_mass * (_sampled_mass(z, period, delay) - held * late / (1j * w) ** 2)
    return position


def _sampled_mass(z: np.ndarray, period: float, delay: np.ndarray | float) -> np.ndarray:
    """Position of a mass of 1 kg over the held force, ``delay`` [s] late, by the modified z-transform."""
    samples = np.asarray(delay) / period
    whole = np.floor(samples + 1e-9)
    late = np.maximum(samples - whole, 0.0)
    newer, back = (1.0 - late) ** 2, 1.0 / z
    step = 0.5 * (newer + (1.0 - newer) * back) * (z - 1.0) + (1.0 - late) + late * back
    return period**2 * step / (z - 1.0) ** 2 / z**whole


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """A measured response as a sampled plant, from command to the position at the samples.

    ``rows`` (m, n) are responses at the lines ``frequency`` (n,) [rad/s], ``inverse_mass`` (m,) [1/kg] their mass
    lines; ``gain`` [N/V] is the drive's, ``delay`` [s] that of the computation. The grid is fine around ``peaks``,
    those of the law.
    """

    frequency: np.ndarray
    rows: np.ndarray
    inverse_mass: np.ndarray
    gain: float
    delay: float
    period: float
    peaks: Peaks = ()

    @classmethod
    def of(
        cls, response: FrequencyResponse, axis: Axis, rows: np.ndarray | None = None, peaks: Peaks = ()
    ) -> MeasuredPlant:
        """The plant of ``axis`` as measured in ``response``, or ``rows`` (m, n) drawn around it; ``peaks`` of a law."""
        nyquist = 0.5 / axis.sampling.period
        if response.frequency[-1] >= nyquist:
            raise InputError(
                f"{response.name}: found a line at {response.frequency[-1]:.6g} Hz, expected less than the Nyquist "
                f"frequency of {axis.name}, {nyquist:g} Hz"
            )
        data = response.response[None] if rows is None else rows
        std = np.maximum(response.std, 1e-6)
        masses = np.array([mass_line(response.w, row, std)[0] for row in data])
        period = axis.sampling.period
        late = axis.sampling.computation_delay * period
        return cls(response.w, data, masses, axis.drive.gain, late, period, peaks)

    @cached_property
    def _pieces(self) -> np.ndarray:
        """Coefficients (4, n - 1, m) of the cubics through log(j w G), highest power first.

        The interpolation changes from a spline for the first row to straight lines for the last, to reflect the
        uncertainty between the lines.
        """
        flat = 1j * self.frequency * self.rows
        logs = (np.log(np.abs(flat)) + 1j * np.unwrap(np.angle(flat), axis=-1)).T
        x = np.log(self.frequency)
        straight = np.zeros((4, x.size - 1, len(self.rows)), complex)
        straight[2], straight[3] = np.diff(logs, axis=0) / np.diff(x)[:, None], logs[:-1]
        curved = scipy.interpolate.CubicSpline(x, logs, axis=0, bc_type="natural").c
        return curved + np.linspace(0.0, 1.0, len(self.rows)) * (straight - curved)

    def continuous(self, w: np.ndarray, rows: np.ndarray | int = 0) -> np.ndarray:
        """Force to velocity of the ``rows`` at ``w`` [rad/s]; both broadcast.

        Below the lowest line the modulus continues as that of a mass. The phase difference to a mass, up to 90 deg
        where friction dominates, falls to 0 in proportion to ``w``: :func:`stable_loops` counts turns from a mass.
        """
        w = np.asarray(w, dtype=float)
        x = np.log(self.frequency)
        at = np.clip(np.searchsorted(self.frequency, w) - 1, 0, x.size - 2)
        beside = np.clip(np.log(w), x[0], x[-1]) - x[at]
        cubic, square, slope, start = (self._pieces[power, at, rows] for power in range(4))
        logs = start + beside * (slope + beside * (square + beside * cubic))
        flat = np.exp(logs.real + 1j * logs.imag * np.minimum(w / self.frequency[0], 1.0))
        masses = np.maximum(self.inverse_mass[rows], 1e-300)
        return np.where(w > self.frequency[-1], masses, flat) / (1j * w)

    def position(self, w: np.ndarray, rows: np.ndarray | int = 0, delay: np.ndarray | float = 0.0) -> np.ndarray:
        """Sampled position over command [m/V] of the ``rows`` at ``w`` [rad/s], with a further ``delay`` [s]."""
        return self.gain * sampled_position(
            w, self.continuous(w, rows), self.period, self.delay + np.asarray(delay), self.inverse_mass[rows]
        )

    @cached_property
    def grid(self) -> np.ndarray:
        """Frequencies [rad/s] from far below the data to the Nyquist frequency: lines, points between them, peaks."""
        lines, nyquist = self.frequency, math.pi / self.period
        x = np.log(lines)
        between = np.exp(x[:-1, None] + np.diff(x)[:, None] * np.arange(BETWEEN) / BETWEEN).ravel()
        before = np.geomspace(FAR_BELOW * lines[0], lines[0], BEYOND, endpoint=False)
        after = np.geomspace(lines[-1], nyquist * (1.0 - 1e-9), BEYOND)
        grid, beside = np.concatenate([before, between, after]), frequencies_around(self.peaks)
        return np.unique(np.concatenate([grid, beside[(beside > grid[1]) & (beside < grid[-1])]]))


def law_response(law: LinearLaw, w: np.ndarray, period: float) -> np.ndarray:
    """Command over position, at the samples, of a law of one rate at ``w`` [rad/s]."""
    if law.cycle > 1:
        raise InputError(
            f"law: found loops at different rates, with a period of {law.cycle} samples, expected one rate: such a "
            "law couples frequencies"
        )
    kept = law.used()
    A, b, c = law.A[np.ix_(kept, kept)], law.B[kept, 1], law.C[kept]
    return transfer(A, b, c, law.D[1], np.exp(1j * np.asarray(w) * period))


def stable_loops(w: np.ndarray, L: np.ndarray) -> np.ndarray:
    """Whether the loops (m, n) are stable, by the turns of 1 + L; the slope at the lowest two frequencies counts the
    integrators."""
    integrators = np.round(-np.log(np.abs(L[:, 1] / L[:, 0])) / np.log(w[1] / w[0]))
    turned = np.degrees(np.sum(np.angle((1.0 + L[:, 1:]) / (1.0 + L[:, :-1])), axis=1))
    return np.abs(turned - 90.0 * integrators) < 45.0
