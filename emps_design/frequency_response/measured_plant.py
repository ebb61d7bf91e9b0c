"""A measured response in the place of a sampled plant, and the linear law in front of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop.transfer import transfer
from emps_design.control.plant.peaks import Peaks, frequencies_around
from emps_design.errors import InputError
from emps_design.frequency_response.hold import mass_line, sampled_position
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.laws.linear import LinearLaw

BETWEEN = 6  # points of the grid in each interval of the data
BEYOND = 60  # points on either side of the data
FAR_BELOW = 1e-3  # of the lowest line, where the grid begins


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """A measured response in the place of a sampled plant: from command to what a law reads at the samples.

    ``rows`` (m, n) are responses at the lines of ``frequency`` (n,) [rad/s] and ``inverse_mass`` (m,) [1/kg] how each
    ends; ``gain`` [N/V] and ``delay`` [s] are the drive's and the program's. ``peaks`` are those of the law in front of
    it, around which the grid is fine.
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
        masses = np.array([mass_line(response.w, one, std)[0] for one in data])
        period = axis.sampling.period
        late = axis.sampling.computation_delay * period
        return cls(response.w, data, masses, axis.drive.gain, late, period, peaks)

    @cached_property
    def _pieces(self) -> np.ndarray:
        """Coefficients (4, n - 1, m) of the cubics through log(j w G), highest power first.

        The rows differ in how they are interpolated too, from a spline for the first to straight lines for the last: so
        much is not known between the lines.
        """
        from scipy.interpolate import CubicSpline

        flat = 1j * self.frequency * self.rows
        logs = (np.log(np.abs(flat)) + 1j * np.unwrap(np.angle(flat), axis=-1)).T
        x = np.log(self.frequency)
        straight = np.zeros((4, x.size - 1, len(self.rows)), complex)
        straight[2], straight[3] = np.diff(logs, axis=0) / np.diff(x)[:, None], logs[:-1]
        curved = CubicSpline(x, logs, axis=0, bc_type="natural").c
        return curved + np.linspace(0.0, 1.0, len(self.rows)) * (straight - curved)

    def continuous(self, w: np.ndarray, rows: np.ndarray | int = 0) -> np.ndarray:
        """Force to velocity of the ``rows`` at ``w`` [rad/s]; both broadcast.

        Below the lowest line the modulus goes on as that of a mass, and what the phase there differs by from a mass's
        falls to 0 with ``w``: where friction rules that is up to 90 deg, and :func:`stable_loops` counts from a mass.
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
        """Position at the samples over command [m/V] of the ``rows`` at ``w`` [rad/s], ``delay`` [s] more."""
        found = sampled_position(
            w, self.continuous(w, rows), self.period, self.delay + np.asarray(delay), self.inverse_mass[rows]
        )
        return self.gain * found

    @cached_property
    def grid(self) -> np.ndarray:
        """Frequencies [rad/s] from far below the data up to the Nyquist frequency: lines, some between, peaks."""
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
            f"law: found loops of different rates, the same again after {law.cycle} samples, expected one rate: such a "
            "law makes other frequencies of one"
        )
    kept = law.used()
    A, b, c = law.A[np.ix_(kept, kept)], law.B[kept, 1], law.C[kept]
    return transfer(A, b, c, law.D[1], np.exp(1j * np.asarray(w) * period))


def stable_loops(w: np.ndarray, L: np.ndarray) -> np.ndarray:
    """Whether the loops (m, n) are stable, by the turns of 1 + L; the lowest two frequencies tell the integrators."""
    integrators = np.round(-np.log(np.abs(L[:, 1] / L[:, 0])) / np.log(w[1] / w[0]))
    turned = np.degrees(np.sum(np.angle((1.0 + L[:, 1:]) / (1.0 + L[:, :-1])), axis=1))
    return np.abs(turned - 90.0 * integrators) < 45.0
