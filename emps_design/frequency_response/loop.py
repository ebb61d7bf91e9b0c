"""A control law around a measured plant: stability, margins and sensitivity peaks, with bands from the deviations.

The open loop at the plant input is the law as it is computed, exactly, times the measured response with hold,
computation delay and aliases put back; between the lines log(j w G) is interpolated in log w by a spline. Above
the highest line the response goes on as the mass line of the last ones, below the lowest as a mass too, to whose phase
it turns from that of the line; a margin that lies there is said to. Stability is Nyquist's: 1 + L turns, from 0 to the
Nyquist frequency, by a quarter for each integrator.

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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop.margins import Margins, disk_size, margin_arrays
from emps_design.control.loop.nested import PLANT_INPUT, NestedLoop
from emps_design.control.plant.peaks import law_peaks
from emps_design.frequency_response.measured_plant import MeasuredPlant, law_response, stable_loops
from emps_design.frequency_response.resonances import resonances
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.frequency_response.several_rates import SeveralRates
from emps_design.laws import law_of
from emps_design.laws.linear import linear_law

DRAWS, SEED = 600, 20
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

    def loop(self, name: str) -> NestedLoop:
        """These margins as those of the loop of that ``name``, to be judged with others."""
        own = {key: self.values[key] for key in (*CROSSINGS, "disk_margin")}
        return NestedLoop(name, PLANT_INPUT, Margins(stable=self.stable, **own), {"response": self.name})

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


def measured_margins(response: FrequencyResponse, axis: Axis, draws: int = DRAWS) -> MeasuredMargins:
    """Return the margins of the controller of ``axis`` around the plant measured in ``response``.

    Raises :class:`InputError` for lines at or beyond the Nyquist frequency of ``axis``. For a law of several rates the
    factors are the same in all samples, and fewer draws are made.

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
    drawn = draws // law.cycle if np.any(response.std > 0.0) else 0
    random = np.random.default_rng(SEED)
    noise = random.standard_normal((2, drawn, len(response))) / math.sqrt(2.0)
    itself = np.ones((1, len(response)))  # first by a spline, last by straight lines
    rows = response.response * np.concatenate([itself, 1.0 + response.std * (noise[0] + 1j * noise[1]), itself])
    plant = MeasuredPlant.of(response, axis, rows, law_peaks(law, period))
    grid = plant.grid
    if law.cycle > 1:
        several = SeveralRates(plant, law)
        found, stable = several.margins()
        ends = [(*several.sensitive(row), *map(np.ravel, several.loci(row))) for row in (0, -1)]
    else:
        L = -law_response(law, grid, period) * plant.position(grid[None], np.arange(len(rows))[:, None])

        def loop(w: np.ndarray, which: np.ndarray, delay: np.ndarray | float = 0.0) -> np.ndarray:
            if w.shape == (1, grid.size):
                return L
            return -law_response(law, w, period) * plant.position(w, which, delay)

        found = margin_arrays(loop, len(rows), grid, math.pi / period, loop)
        stable = stable_loops(grid, L)
        ends = [(grid, L[row], L[row], grid) for row in (0, -1)]
    values = {name: _number(found[name][0]) if stable[0] else None for name in CROSSINGS}
    bands = {name: _band(found[name]) if drawn and stable[0] else None for name in CROSSINGS}
    first = next((one.frequency for one in resonances(response) if one.kind == "antiresonance"), None)
    curved, straight = (_peaks(w, L, loci, places, response, first) for w, L, loci, places in ends)
    for name, (value, band) in curved.items():
        values[name] = value if stable[0] else None
        both = [one for one in (band, straight[name][1]) if one is not None]
        bands[name] = (
            (min(low for low, _ in both), max(high for _, high in both)) if drawn and stable[0] and both else None
        )
    share = float(np.mean(stable[1:]))
    words = _words(response, bool(stable[0]), share, values, np.abs(ends[0][1]), ends[0][0])
    return MeasuredMargins(response.name, bool(stable[0]), values, bands, share, first, tuple(words))


def _peaks(
    w: np.ndarray,
    L: np.ndarray,
    loci: np.ndarray,
    places: np.ndarray,
    response: FrequencyResponse,
    antiresonance: float | None,
) -> dict[str, tuple[float | None, tuple[float, float] | None]]:
    """Disk margin and sensitivity peaks with their bands: of the loop ``L`` (n,) at ``w`` (n,) [rad/s] the sensitivity,
    of ``loci`` (m,), at ``places`` (m,) of the plant, the disk margin."""

    def moved(w: np.ndarray, L: np.ndarray) -> np.ndarray:
        std = np.interp(np.abs(w), response.w, response.std)
        return BOUND * std / math.sqrt(2.0) * np.abs(L / (1.0 + L) ** 2)  # |dS| = |S^2 dL|

    def largest(size: np.ndarray, reach: np.ndarray) -> tuple[float, tuple[float, float]]:
        return float(np.max(size)), (float(np.max(size - reach)), float(np.max(size + reach)))

    below = np.ones(w.size, bool) if antiresonance is None else w <= 2.0 * math.pi * antiresonance
    peak, (low, high) = largest(disk_size(loci), moved(places, loci))
    S, reach = np.abs(1.0 / (1.0 + L)), moved(w, L)
    return {
        "disk_margin": (1.0 / peak, (1.0 / high, 1.0 / low)),
        "sensitivity_peak_below": largest(S[below], reach[below]),
        "sensitivity_peak_above": largest(S[~below], reach[~below]) if not below.all() else (None, None),
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


def over_limits(values: Mapping[str, Any], limits: Mapping[str, float]) -> list[str]:
    """Return, in words, which sensitivity peaks of ``values`` exceed their ``limits``, both ratios by their names.

    >>> over_limits({"sensitivity_peak_below": 2.31, "sensitivity_peak_above": 1.2}, {"sensitivity_peak_below": 2.0})
    ['the largest sensitivity below the first antiresonance is 2.31, asked for at most 2']
    """
    return [
        f"the largest sensitivity {name.rpartition('_')[2]} the first antiresonance is {values[name]:.4g}, "
        f"asked for at most {limit:.4g}"
        for name, limit in limits.items()
        if values[name] is not None and values[name] > limit
    ]


def measured_document(margins: Sequence[MeasuredMargins], limits: Mapping[str, float]) -> dict[str, Any]:
    """What ``gains`` says about the loop on the measured plants: the worst beside the ``limits``, and each."""
    one = margins[0] if len(margins) == 1 else None
    return {
        "stable": all(found.stable for found in margins),
        **({"requested": dict(limits)} if limits else {}),
        **worst_of(margins),
        "bands": one.to_dict()["bands"] if one else None,
        "responses": [found.to_dict() for found in margins],
    }


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
