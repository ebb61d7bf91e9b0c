"""A control law around a measured plant: stability, margins and sensitivity peaks, with bands from the deviations.

The open loop at the plant input is the law as it is computed, exactly, times the measured response with hold,
computation delay and aliases put back; between the lines log(j w G) is interpolated in log w by a spline. Above
the highest line the response goes on as the mass line of the last ones, below the lowest as a mass too; a margin that
lies there is said to. Stability is Nyquist's: 1 + L turns, from 0 to the Nyquist frequency, by a quarter for each
integrator.

The margins are smallest over all crossings. The disk margin is the largest a for which every gain and phase change
f = (1 + d/2)/(1 - d/2), |d| < a, at the plant input keeps the loop stable: a = 1/max|S - 1/2|. Gain alone may change
from (2 - a)/(2 + a) to its inverse, phase alone up to 2 atan(a/2) (P. Seiler, A. Packard, P. Gahinet, IEEE Control
Systems 40(5), 2020).

Bands: for crossings the data are drawn anew with their deviations, each line by itself, and the quantiles of what the
draws give are taken. A largest value over noisy lines would lie too high in every draw; it lies between the largest of
the lines' lower bounds and the largest of their upper ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop.margins import margin_arrays
from emps_design.control.loop.transfer import transfer
from emps_design.errors import InputError
from emps_design.frequency_response.hold import mass_line, sampled_position
from emps_design.frequency_response.resonances import resonances
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.laws import law_of
from emps_design.laws.linear import LinearLaw, linear_law

DRAWS, SEED = 600, 20
BETWEEN = 6  # points of the grid in each interval of the data
BEYOND = 60  # points on either side of the data
FAR_BELOW = 1e-3  # of the lowest line, where the grid begins
# Of the draws 99 % for a band of 95 %: they know nothing of what the deviations are uncertain by themselves.
QUANTILES = (0.005, 0.995)
BOUND = 2.5  # standard deviations of one line's bound, where the largest of many is taken
CROSSINGS = ("phase_margin_deg", "crossover", "delay_margin", "gain_margin", "gain_margin_frequency")
NAMES = (*CROSSINGS, "disk_margin", "sensitivity_peak_below", "sensitivity_peak_above")
LARGEST_IS_WORST = ("sensitivity_peak_below", "sensitivity_peak_above")


@dataclass(frozen=True)
class MeasuredMargins:
    """Margins of one loop, units as in :data:`NAMES`: deg, rad/s, s, ratio; None where unbounded or undefined.

    ``bands`` has low and high of the 95 % interval of each, ``stable_share`` the share of the draws that are stable.
    """

    name: str
    stable: bool
    values: dict[str, float | None]
    bands: dict[str, tuple[float, float] | None]
    stable_share: float
    antiresonance: float | None
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain data; the disk margin also as gain and phase alone."""
        a = self.values["disk_margin"]
        disk = None
        if a is not None:
            gain = None if a >= 2.0 else (2.0 + a) / (2.0 - a)
            disk = {"gain": gain, "phase_deg": 2.0 * math.degrees(math.atan(0.5 * a))}
        return {
            "name": self.name,
            "stable": self.stable,
            **self.values,
            "disk": disk,
            "antiresonance_hz": self.antiresonance,
            "bands": {name: None if band is None else list(band) for name, band in self.bands.items()},
            "stable_share": self.stable_share,
        }


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """A measured response in the place of a sampled plant: from command to what a law reads at the samples.

    ``rows`` (m, n) are responses at the lines of ``frequency`` (n,) [rad/s] and ``inverse_mass`` (m,) [1/kg] how each
    ends; ``gain`` [N/V] and ``delay`` [s] are the drive's and the program's.
    """

    frequency: np.ndarray
    rows: np.ndarray
    inverse_mass: np.ndarray
    gain: float
    delay: float
    period: float

    @classmethod
    def of(cls, response: FrequencyResponse, axis: Axis, rows: np.ndarray | None = None) -> MeasuredPlant:
        """The plant of ``axis`` as measured in ``response``, or ``rows`` (m, n) drawn around it."""
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
        return cls(response.w, data, masses, axis.drive.gain, late, period)

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
        """Force to velocity of the ``rows`` at ``w`` [rad/s]; both broadcast."""
        w, rows = np.broadcast_arrays(np.asarray(w, dtype=float), rows)
        x = np.log(self.frequency)
        at = np.clip(np.searchsorted(self.frequency, w) - 1, 0, x.size - 2)
        beside = np.clip(np.log(w), x[0], x[-1]) - x[at]
        cubic, square, slope, start = (self._pieces[power, at, rows] for power in range(4))
        flat = np.exp(start + beside * (slope + beside * (square + beside * cubic)))
        masses = np.maximum(self.inverse_mass[rows], 1e-300)
        return np.where(w > self.frequency[-1], masses, flat) / (1j * w)

    def position(self, w: np.ndarray, rows: np.ndarray | int = 0, delay: np.ndarray | float = 0.0) -> np.ndarray:
        """Position at the samples over command [m/V] of the ``rows`` at ``w`` [rad/s], ``delay`` [s] more."""
        found = sampled_position(
            w, self.continuous(w, rows), self.period, self.delay + np.asarray(delay), self.inverse_mass[rows]
        )
        return self.gain * found


def law_response(law: LinearLaw, w: np.ndarray, period: float) -> np.ndarray:
    """Command over position, at the samples, of a law of one rate at ``w`` [rad/s]."""
    if law.cycle > 1:
        raise InputError(
            f"law: found loops of different rates, the same again after {law.cycle} samples, expected one rate: a "
            "response at one frequency says nothing about the others that such a law makes of it"
        )
    kept = law.used
    A, b, c = law.A[np.ix_(kept, kept)], law.B[kept, 1], law.C[kept]
    return transfer(A, b, c, law.D[1], np.exp(1j * np.asarray(w) * period))


def measured_margins(response: FrequencyResponse, axis: Axis, draws: int = DRAWS) -> MeasuredMargins:
    """Return the margins of the controller of ``axis`` around the plant measured in ``response``.

    Raises :class:`InputError` for lines at or beyond the Nyquist frequency of ``axis`` and for a law of several rates.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(mechanics={"viscous": 0.0})
    >>> f = np.geomspace(2.0, 300.0, 120)
    >>> mass = FrequencyResponse.of(f, 1.0 / (2j * np.pi * f * axis.mechanics.mass), np.full(120, 0.01))
    >>> found = measured_margins(mass, axis)
    >>> found.stable, round(found.values["phase_margin_deg"], 1)
    (True, 34.0)
    """
    period = axis.sampling.period
    law = linear_law(law_of(axis, period), period)
    drawn = draws if np.any(response.std > 0.0) else 0
    random = np.random.default_rng(SEED)
    noise = random.standard_normal((2, drawn, len(response))) / math.sqrt(2.0)
    itself = np.ones((1, len(response)))  # first by a spline, last by straight lines
    rows = response.response * np.concatenate([itself, 1.0 + response.std * (noise[0] + 1j * noise[1]), itself])
    plant = MeasuredPlant.of(response, axis, rows)
    grid = _grid(plant)
    law_at_grid = law_response(law, grid, period)

    def loop(w: np.ndarray, which: np.ndarray, delay: np.ndarray | float = 0.0) -> np.ndarray:
        by = law_at_grid if w.shape == (1, grid.size) else law_response(law, w, period)
        return -by * plant.position(w, which, delay)

    count = len(rows)
    found = margin_arrays(loop, count, grid, math.pi / period, loop)
    L = loop(grid[None], np.arange(count)[:, None])
    stable = _stable(grid, L)
    values = {name: _number(found[name][0]) if stable[0] else None for name in CROSSINGS}
    bands = {name: _band(found[name]) if drawn and stable[0] else None for name in CROSSINGS}
    std = np.interp(grid, response.w, response.std)
    first = next((one.frequency for one in resonances(response) if one.kind == "antiresonance"), None)
    straight = _peaks(grid, L[-1], std, first)
    for name, (value, band) in _peaks(grid, L[0], std, first).items():
        values[name] = value if stable[0] else None
        both = [one for one in (band, straight[name][1]) if one is not None]
        bands[name] = (
            (min(low for low, _ in both), max(high for _, high in both)) if drawn and stable[0] and both else None
        )
    share = float(np.mean(stable[1:]))
    words = _words(response, bool(stable[0]), share, values, np.abs(L[0]), grid)
    return MeasuredMargins(response.name, bool(stable[0]), values, bands, share, first, tuple(words))


def _peaks(
    w: np.ndarray, L: np.ndarray, std: np.ndarray, antiresonance: float | None
) -> dict[str, tuple[float | None, tuple[float, float] | None]]:
    """Disk margin and sensitivity peaks of the loop (n,) with their bands; ``std`` (n,) is relative to L."""
    S = 1.0 / (1.0 + L)
    moved = BOUND * std / math.sqrt(2.0) * np.abs(S * S * L)  # |dS| = |S^2 dL|
    below = np.ones(w.size, bool) if antiresonance is None else w <= 2.0 * math.pi * antiresonance

    def largest(size: np.ndarray, where: np.ndarray) -> tuple[float, tuple[float, float]]:
        size, reach = size[where], moved[where]
        return float(np.max(size)), (float(np.max(size - reach)), float(np.max(size + reach)))

    peak, (low, high) = largest(np.abs(S - 0.5), np.ones(w.size, bool))
    above = largest(np.abs(S), ~below) if not below.all() else (None, None)
    return {
        "disk_margin": (1.0 / peak, (1.0 / high, 1.0 / low)),
        "sensitivity_peak_below": largest(np.abs(S), below),
        "sensitivity_peak_above": above,
    }


def worst_of(margins: Sequence[MeasuredMargins]) -> dict[str, float | None]:
    """The worst of each margin over several responses: loads, places, directions.

    A loop that is unstable has none, and then they have none together.
    """
    if not all(one.stable for one in margins):
        return dict.fromkeys(NAMES)
    worst: dict[str, float | None] = {}
    for name in NAMES:
        known = [value for one in margins if (value := one.values[name]) is not None]
        worst[name] = (max(known) if name in LARGEST_IS_WORST else min(known)) if known else None
    return worst


def measured_document(margins: Sequence[MeasuredMargins]) -> dict[str, Any]:
    """What ``gains`` says about the loop on the measured plants: the worst, and each."""
    one = margins[0] if len(margins) == 1 else None
    return {
        "stable": all(found.stable for found in margins),
        **worst_of(margins),
        "bands": one.to_dict()["bands"] if one else None,
        "responses": [found.to_dict() for found in margins],
    }


def _grid(plant: MeasuredPlant) -> np.ndarray:
    """Frequencies [rad/s] from far below the data up to the Nyquist frequency, the lines and some between them."""
    lines, nyquist = plant.frequency, math.pi / plant.period
    x = np.log(lines)
    between = np.exp(x[:-1, None] + np.diff(x)[:, None] * np.arange(BETWEEN) / BETWEEN).ravel()
    before = np.geomspace(FAR_BELOW * lines[0], lines[0], BEYOND, endpoint=False)
    after = np.geomspace(lines[-1], nyquist * (1.0 - 1e-9), BEYOND)
    return np.concatenate([before, between, after])


def _stable(w: np.ndarray, L: np.ndarray) -> np.ndarray:
    """Whether the loops (m, n) are stable, by the turns of 1 + L; the lowest two frequencies tell the integrators."""
    integrators = np.round(-np.log(np.abs(L[:, 1] / L[:, 0])) / np.log(w[1] / w[0]))
    turned = np.degrees(np.sum(np.angle((1.0 + L[:, 1:]) / (1.0 + L[:, :-1])), axis=1))
    return np.abs(turned - 90.0 * integrators) < 45.0


def _number(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _band(values: np.ndarray) -> tuple[float, float] | None:
    """The interval around the first of ``values`` from the others; None where too few have one."""
    drawn = values[1:][np.isfinite(values[1:])]
    if not math.isfinite(values[0]) or drawn.size < 0.5 * (values.size - 1):
        return None
    low, high = np.quantile(drawn, QUANTILES)
    return min(float(low), float(values[0])), max(float(high), float(values[0]))


def _words(
    response: FrequencyResponse,
    stable: bool,
    share: float,
    values: dict[str, float | None],
    size: np.ndarray,
    grid: np.ndarray,
) -> list[str]:
    """What the data cannot say."""
    words = list(response.warnings)
    low, high = float(response.w[0]), float(response.w[-1])
    if not stable:
        words.append(f"{response.name}: the loop is unstable on the measured plant")
    elif share < 0.975:
        words.append(f"{response.name}: unstable in {100 * (1 - share):.3g} % of the plants that the deviations allow")
    lowest, highest = (size[int(np.searchsorted(grid, w))] for w in (low, high * (1.0 - 1e-12)))
    if lowest < 1.0:
        words.append(
            f"{response.name}: the open loop is {lowest:.2g} at the lowest line, {low / (2 * math.pi):.3g} Hz: a "
            "crossover below it is not seen; measure from lower frequencies"
        )
    if highest > 0.5:
        words.append(
            f"{response.name}: the open loop is {highest:.2g} at the highest line, {high / (2 * math.pi):.4g} Hz: "
            "a crossover above it is not seen; measure up to higher frequencies"
        )
    at = values["gain_margin_frequency"]
    if at is not None and not low <= at <= high:
        words.append(
            f"{response.name}: the gain margin lies at {at / (2 * math.pi):.4g} Hz, beyond the data, on their mass line"
        )
    return words
