"""A control law around a measured plant: stability, margins and sensitivity peaks with bands, and gains retuned on it.

The open loop at the plant input is the exact sampled law times the measured response with hold, computation delay and
aliases put back; between the lines log(j w G) is interpolated in log w by a spline. Above the highest line the
response continues as the mass line of the last ones, below the lowest as a mass too, to whose phase it turns; a
warning says where a margin lies there. Stability follows from Nyquist's criterion: from 0 to the Nyquist frequency 1
+ L turns by 90 degrees for each integrator.

The margins are smallest over all crossings. The disk margin is the largest a for which every gain and phase change
f = (1 + d/2)/(1 - d/2), |d| < a, at the plant input keeps the loop stable: a = 1/max|S - 1/2|. Gain alone may change
from (2 - a)/(2 + a) to its inverse, phase alone up to 2 atan(a/2) (P. Seiler, A. Packard, P. Gahinet, IEEE Control
Systems 40(5), 2020).

Bands: for crossings, draws of the data with independent errors of the lines give quantiles. The maximum over noisy
lines would be too high in every draw; its band is from the largest of the lines' lower bounds to the largest of their
upper ones.

A law with loops at different rates repeats after N samples. It answers a sine at w at all N frequencies w + 2 pi m/(N
T). Over these the plant is diagonal, from the data, and the law a matrix H(w), that of its lifted form; the open loop
is L(w) = -H(w) P(w), N by N. A factor f at the plant input leaves the loop at the edge of stability where det(I + f
L(w)) = 0, a delay where det(I + L(w)) = 0 with the delay in it. The eigenvalues of L on the measured data give the
start of these roots, Newton's method the roots for each draw. The sensitivity from a frequency to itself is the
diagonal of (I + L)^-1.

Source: S. Bittanti and P. Colaneri, Periodic Systems, Springer 2009, chapters 2 and 6.

Retuned gains follow from the same two equations as for the model, :mod:`emps_design.control.velocity.limits`, with
the measured response. A filter is designed on the masses that fit the response and checked on the data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import filter_response, law_peaks
from emps_design.control.margins import KEYS, Margins, disk_size, lifted, margin_arrays, transfers
from emps_design.control.sampled import PLANT_INPUT, NestedLoop
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.gains import PLACES, Structure, own_filters, own_structure
from emps_design.control.velocity.limits import retuned_gains, suggest_filter
from emps_design.control.velocity.specification import check_specification
from emps_design.errors import InputError, SpecificationError
from emps_design.frequency_response.coupling import ResponseComparison
from emps_design.frequency_response.measured_plant import MeasuredPlant, law_response, stable_loops
from emps_design.frequency_response.response import FrequencyResponse, resonances
from emps_design.laws import law_of
from emps_design.laws.estimators import AnyEstimator, estimator_response
from emps_design.laws.library.cascade import Filter
from emps_design.laws.linear import LinearLaw, linear_law
from emps_design.messages import Message, grave, warning
from emps_design.request import Request, option, takes
from emps_design.units import Units

MOST = 32  # samples after which a law repeats
TURNS = 40
FOUND = 1e-9  # of the determinant, relative to its slope

DRAWS, SEED = 600, 20
# 99 % of the draws for a band of 95 %: the draws neglect that the deviations are uncertain themselves.
QUANTILES = (0.005, 0.995)
BOUND = 2.5  # standard deviations of the bound of one line, for a maximum over many
CROSSINGS = ("phase_margin_deg", "crossover", "delay_margin", "gain_margin", "gain_margin_frequency")
NAMES = (*CROSSINGS, "disk_margin", "sensitivity_peak_below", "sensitivity_peak_above")
LARGEST_IS_WORST = ("sensitivity_peak_below", "sensitivity_peak_above")

NEAREST = 60  # slower crossovers that are tried
MET = 1e-2  # relative tolerance of the phase margin

SIDES = ("without", "with_equal_margins", "with")
MARGINS = ("phase_margin_deg", "gain_margin", "disk_margin")


@dataclass(frozen=True, eq=False)
class SeveralRates:
    """The open loop of ``law`` around ``plant``; raises :class:`InputError` for a ``cycle`` of more than ``MOST``."""

    plant: MeasuredPlant
    law: LinearLaw

    def __post_init__(self) -> None:
        if self.law.cycle > MOST:
            raise InputError(f"law: found loops with a period of {self.law.cycle} samples, expected at most {MOST}")

    @property
    def _slow_nyquist(self) -> float:
        """The Nyquist frequency of the slow rate [rad/s]; all others fold on frequencies below it."""
        return math.pi / (self.law.cycle * self.plant.period)

    @cached_property
    def grid(self) -> np.ndarray:
        """Frequencies [rad/s] onto which the plant's grid folds."""
        folded = np.mod(self.plant.grid, 2.0 * self._slow_nyquist)
        folded = np.unique(np.minimum(folded, 2.0 * self._slow_nyquist - folded))
        far = folded[np.concatenate([[True], np.diff(folded) > 1e-9 * folded[1:]])]
        return far[far >= self.plant.grid[0] * (1.0 - 1e-9)]

    def _coupled_frequencies(self, w: np.ndarray) -> np.ndarray:
        """The frequencies (..., N) [rad/s] that the law couples with ``w`` (...), from -pi/T to pi/T."""
        all_of_them = w[..., None] + 2.0 * self._slow_nyquist * np.arange(self.law.cycle)
        nyquist = math.pi / self.plant.period
        return np.where(all_of_them > nyquist, all_of_them - 2.0 * nyquist, all_of_them)

    def _law(self, w: np.ndarray) -> np.ndarray:
        """Command over position (..., N, N) between the frequencies of :meth:`_coupled_frequencies`."""
        cycle, period = self.law.cycle, self.plant.period
        A, B, C, D = self._lifted
        several, rows = np.broadcast_to(A, (cycle, *A.shape)), np.broadcast_to(C[:, None, :], (cycle, *B.T.shape))
        samples = np.moveaxis(transfers(several, B.T, rows, D, np.exp(1j * w * cycle * period)), (0, 1), (-2, -1))
        turns = np.exp(1j * period * self._coupled_frequencies(w)[..., None, :] * np.arange(cycle)[:, None])
        return turns.conj().swapaxes(-1, -2) @ samples @ turns / cycle

    @cached_property
    def _lifted(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        law = self.law
        return lifted(law.A, law.B[..., [1]], law.C[:, None, :], law.D[:, None, [1]])

    @cached_property
    def _law_on_grid(self) -> np.ndarray:
        return self._law(self.grid)

    def matrix(
        self, w: np.ndarray, rows: np.ndarray | int, delay: np.ndarray | float = 0.0, law: np.ndarray | None = None
    ) -> np.ndarray:
        """The open loop (..., N, N) of the ``rows`` at ``w`` (...) [rad/s], ``delay`` [s] more; ``law`` if known."""
        if law is None:
            law = self._law_on_grid if w is self.grid else self._law(w)
        places = self._coupled_frequencies(w)
        plant = self.plant.position(np.abs(places), np.asarray(rows)[..., None], np.asarray(delay)[..., None])
        return -law * np.where(places < 0.0, plant.conj(), plant)[..., None, :]

    def margins(self) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Margins of every row, as :func:`~emps_design.control.margins.margin_arrays`, and which are stable (m,)."""
        count, unit = len(self.plant.rows), np.eye(self.law.cycle)
        rows = np.arange(count)
        on_grid = np.array([np.linalg.det(unit + self.matrix(self.grid, row)) - 1.0 for row in range(count)])
        margins = {key: np.full(count, np.nan) for key in KEYS}
        w, value, place = self._crossings(lambda values: np.log(np.abs(values)))
        sign = np.where(place < 0.0, -1.0, 1.0)
        lag = np.mod(sign * np.angle(value) + np.pi, 2.0 * np.pi)

        # Each returns a function of the unknown at the frequencies w, with what does not depend on it computed once.
        def turned(w: np.ndarray, sign: float) -> Callable[[np.ndarray], np.ndarray]:
            loop = self.matrix(w, rows)
            return lambda y: np.linalg.det(unit + np.exp(-1j * sign * y)[..., None, None] * loop)

        def later(w: np.ndarray, sign: float) -> Callable[[np.ndarray], np.ndarray]:
            law = self._law(w)
            return lambda y: np.linalg.det(unit + self.matrix(w, rows, y * self.plant.period, law))

        def more(w: np.ndarray, sign: float) -> Callable[[np.ndarray], np.ndarray]:
            loop = self.matrix(w, rows)
            return lambda y: np.linalg.det(unit + np.exp(y)[..., None, None] * loop)

        for start, at, side, angle in zip(w, place, sign, lag, strict=True):
            true, phase = self._roots(turned, start, angle, side)
            self._keep_smaller(
                margins, "phase_margin_deg", np.degrees(phase), "crossover", np.abs(at) + side * (true - start)
            )
            _, samples = self._roots(later, start, angle / abs(at) / self.plant.period, side)
            self._keep_smaller(margins, "delay_margin", self.plant.period * samples)
        w, value, place = self._crossings(lambda values: np.where(values.real < 0.0, np.sin(np.angle(values)), 1.0))
        for start, eigenvalue, at in zip(w, value, place, strict=True):
            if eigenvalue.real < 0.0:
                true, gain = self._roots(more, start, math.log(-1.0 / eigenvalue.real), 1.0)
                self._keep_gain(margins, np.exp(gain), np.abs(at) + math.copysign(1.0, at) * (true - start))
        last = np.linalg.eigvals(self.matrix(np.full(count, self._slow_nyquist), rows))
        for eigenvalue in last.T:
            real = np.abs(eigenvalue.imag) < 1e-6 * np.abs(eigenvalue)
            gain = np.where(real & (eigenvalue.real < 0.0), -1.0 / eigenvalue.real, np.nan)
            self._keep_gain(margins, gain, np.full(count, self._slow_nyquist))
        return margins, stable_loops(self.grid, on_grid)

    def _crossings(self, sign_of: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where ``sign_of`` the eigenvalues of the first row changes: frequency, eigenvalue and the frequency of its
        largest component, (k,) each."""
        values, places = self.loci(0)
        sign = sign_of(values)
        at, which = np.nonzero((sign[1:] < 0.0) != (sign[:-1] < 0.0))
        before, after = np.abs(sign[at, which]), np.abs(sign[at + 1, which])
        share = np.clip(before / np.maximum(before + after, 1e-300), 0.0, 1.0)
        value = values[at, which] * (1.0 - share) + values[at + 1, which] * share
        w = self.grid[at] * (1.0 - share) + self.grid[at + 1] * share
        return w, value, places[at, which]

    def _roots(
        self, gap: Callable[[np.ndarray, float], Callable[[np.ndarray], np.ndarray]], w: float, y: float, sign: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Roots (w, y) of ``gap(w, sign)(y)`` in every row, by Newton's method from the same start; NaN without one."""
        count, small = len(self.plant.rows), 1e-6
        x, value = np.full(count, math.log(w)), np.full(count, y)
        residual = np.full(count, np.inf + 0j)
        for _ in range(TURNS):
            here = gap(np.exp(x), sign)
            now = here(value)
            by_x = (gap(np.exp(x + small), sign)(value) - now) / small
            by_y = (here(value + small) - now) / small
            determinant = by_x.real * by_y.imag - by_x.imag * by_y.real
            with np.errstate(divide="ignore", invalid="ignore"):
                step_x = (now.imag * by_y.real - now.real * by_y.imag) / determinant
                step_y = (now.real * by_x.imag - now.imag * by_x.real) / determinant
                residual = now / np.abs(by_y)
            if np.all(np.abs(residual) < FOUND):
                break
            x = np.minimum(x + np.clip(np.nan_to_num(step_x), -0.05, 0.05), math.log(self._slow_nyquist))
            value = np.maximum(value + np.clip(np.nan_to_num(step_y), -0.2, 0.2), -1e3)
        good = np.abs(residual) < math.sqrt(FOUND)
        return np.where(good, np.exp(x), np.nan), np.where(good, value, np.nan)

    @staticmethod
    def _keep_smaller(
        margins: dict[str, np.ndarray], key: str, value: np.ndarray, beside: str = "", w: Any = 0.0
    ) -> None:
        """Replace the margins ``key`` by smaller positive ones, and the entries ``beside`` them by ``w``."""
        smaller = (value > 0.0) & ~(value >= margins[key])
        margins[key] = np.where(smaller, value, margins[key])
        if beside:
            margins[beside] = np.where(smaller, w, margins[beside])

    def _keep_gain(self, margins: dict[str, np.ndarray], gain: np.ndarray, w: np.ndarray) -> None:
        self._keep_smaller(margins, "gain_margin", np.where(gain > 1.0, gain, np.nan), "gain_margin_frequency", w)

    def sensitive(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (n,) [rad/s] and the single-rate loop (n,) with the same sensitivity as a row."""
        through = np.diagonal(np.linalg.inv(np.eye(self.law.cycle) + self.matrix(self.grid, row)), axis1=-2, axis2=-1)
        w = np.abs(self._coupled_frequencies(self.grid)).ravel()
        order = np.argsort(w)
        return w[order], (1.0 / through - 1.0).ravel()[order]

    def loci(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues (g, N) of a row on the grid, largest first, and the frequency [rad/s] of the largest component of
        each, negative beyond the Nyquist frequency."""
        values, vectors = np.linalg.eig(self.matrix(self.grid, row))
        order = np.argsort(-np.abs(values), axis=-1)
        largest = np.argmax(np.abs(vectors), axis=-2)
        places = np.take_along_axis(self._coupled_frequencies(self.grid), largest, axis=-1)
        return np.take_along_axis(values, order, axis=-1), np.take_along_axis(places, order, axis=-1)


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
    warnings: tuple[Message, ...] = ()

    def loop(self, name: str) -> NestedLoop:
        """The margins as a :class:`NestedLoop` of that ``name``."""
        own = {key: self.values[key] for key in (*CROSSINGS, "disk_margin")}
        return NestedLoop(name, PLANT_INPUT, Margins(stable=self.stable, **own), {"response": self.name})

    def to_dict(self) -> dict[str, Any]:
        """Plain data; the disk margin also as a gain and as a phase."""
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

    For a law of several rates, gain and phase change in all samples alike, and fewer draws are made. Raises
    :class:`InputError` for lines at or beyond the Nyquist frequency of ``axis``.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(mechanics={"viscous": 0.0})
    >>> f = np.geomspace(2.0, 300.0, 120)
    >>> mass = FrequencyResponse.of(f, 1.0 / (2j * np.pi * f * axis.mechanics.mass), np.full(120, 0.01))
    >>> margins = measured_margins(mass, axis)
    >>> margins.stable, round(margins.values["phase_margin_deg"], 1)
    (True, 34.0)
    """
    period = axis.sampling.period
    law = linear_law(law_of(axis, period), period)
    drawn = draws // law.cycle if np.any(response.std > 0.0) else 0
    random = np.random.default_rng(SEED)
    noise = random.standard_normal((2, drawn, len(response))) / math.sqrt(2.0)
    itself = np.ones((1, len(response)))  # the first row is interpolated by a spline, the last linearly
    rows = response.response * np.concatenate([itself, 1.0 + response.std * (noise[0] + 1j * noise[1]), itself])
    plant = MeasuredPlant.of(response, axis, rows, law_peaks(law, period))
    grid = plant.grid
    if law.cycle > 1:
        several = SeveralRates(plant, law)
        margins, stable = several.margins()
        ends = [(*several.sensitive(row), *map(np.ravel, several.loci(row))) for row in (0, -1)]
    else:
        L = -law_response(law, grid, period) * plant.position(grid[None], np.arange(len(rows))[:, None])

        def loop(w: np.ndarray, which: np.ndarray, delay: np.ndarray | float = 0.0) -> np.ndarray:
            if w.shape == (1, grid.size):
                return L
            return -law_response(law, w, period) * plant.position(w, which, delay)

        margins = margin_arrays(loop, len(rows), grid, math.pi / period, loop)
        stable = stable_loops(grid, L)
        ends = [(grid, L[row], L[row], grid) for row in (0, -1)]
    values = {name: _finite_or_none(margins[name][0]) if stable[0] else None for name in CROSSINGS}
    bands = {name: _band(margins[name]) if drawn and stable[0] else None for name in CROSSINGS}
    first = next((resonance.frequency for resonance in resonances(response) if resonance.kind == "antiresonance"), None)
    curved, straight = (_peaks(w, L, loci, places, response, first) for w, L, loci, places in ends)
    for name, (value, band) in curved.items():
        values[name] = value if stable[0] else None
        both = [interval for interval in (band, straight[name][1]) if interval is not None]
        bands[name] = (
            (min(low for low, _ in both), max(high for _, high in both)) if drawn and stable[0] and both else None
        )
    share = float(np.mean(stable[1:]))
    words = _messages(response, bool(stable[0]), share, values, np.abs(ends[0][1]), ends[0][0], axis.units)
    return MeasuredMargins(response.name, bool(stable[0]), values, bands, share, first, tuple(words))


def _peaks(
    w: np.ndarray,
    L: np.ndarray,
    loci: np.ndarray,
    places: np.ndarray,
    response: FrequencyResponse,
    antiresonance: float | None,
) -> dict[str, tuple[float | None, tuple[float, float] | None]]:
    """Disk margin and sensitivity peaks with their bands: the sensitivity of the loop ``L`` (n,) at ``w`` (n,) [rad/s],
    the disk margin of the eigenvalues ``loci`` (m,) at ``places`` (m,) [rad/s]."""

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
    """The worst of each margin over several responses: loads, places, directions; None where a loop is unstable."""
    if not all(loop.stable for loop in margins):
        return dict.fromkeys(NAMES)
    worst: dict[str, float | None] = {}
    for name in NAMES:
        known = [value for loop in margins if (value := loop.values[name]) is not None]
        worst[name] = (max(known) if name in LARGEST_IS_WORST else min(known)) if known else None
    return worst


def over_limits(values: Mapping[str, Any], limits: Mapping[str, float]) -> list[Message]:
    """Return a message on each sensitivity peak of ``values`` above its limit; both are ratios by name.

    >>> over_limits({"sensitivity_peak_below": 2.31, "sensitivity_peak_above": 1.2}, {"sensitivity_peak_below": 2.0})
    ['the largest sensitivity below the first antiresonance is 2.31, requested at most 2']
    """
    return [
        warning(
            "sensitivity-peak",
            f"the largest sensitivity {name.rpartition('_')[2]} the first antiresonance is {values[name]:.4g}, "
            f"requested at most {limit:.4g}",
            value=values[name],
            limit=limit,
        )
        for name, limit in limits.items()
        if values[name] is not None and values[name] > limit
    ]


def measured_document(margins: Sequence[MeasuredMargins], limits: Mapping[str, float]) -> dict[str, Any]:
    """The document of ``gains`` on measured plants: the worst margins beside the ``limits``, and those of each."""
    only = margins[0] if len(margins) == 1 else None
    return {
        "stable": all(loop.stable for loop in margins),
        **({"requested": dict(limits)} if limits else {}),
        **worst_of(margins),
        "bands": only.to_dict()["bands"] if only else None,
        "responses": [loop.to_dict() for loop in margins],
    }


def _finite_or_none(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _band(values: np.ndarray) -> tuple[float, float] | None:
    """The interval around the first of ``values`` from the draws after it; None where fewer than half are finite."""
    drawn = values[1:][np.isfinite(values[1:])]
    if not math.isfinite(values[0]) or drawn.size < 0.5 * (values.size - 1):
        return None
    low, high = np.quantile(drawn, QUANTILES)
    return min(float(low), float(values[0])), max(float(high), float(values[0]))


def _messages(
    response: FrequencyResponse,
    stable: bool,
    share: float,
    values: dict[str, float | None],
    size: np.ndarray,
    grid: np.ndarray,
    units: Units,
) -> list[Message]:
    """Messages on an unstable loop, and on margins beyond the data."""
    name, messages = response.name, list(response.warnings)
    low, high = float(response.w[0]), float(response.w[-1])
    if not stable:
        messages.append(grave("unstable-on-measured-plant", f"{name}: the loop is unstable on the measured plant"))
    elif share < 0.975:
        text = f"{name}: unstable in {100 * (1 - share):.3g} % of the plants that the deviations allow"
        messages.append(grave("unstable-within-deviations", text, share=share))
    lowest, highest = (size[int(np.searchsorted(grid, w))] for w in (low, high * (1.0 - 1e-12)))
    if lowest < 1.0:
        text = (
            f"{name}: the open loop is {lowest:.2g} at the lowest line, {low / (2 * math.pi):.3g} Hz: a crossover "
            "below it cannot be detected; measure at lower frequencies"
        )
        messages.append(warning("crossover-below-data", text, gain=float(lowest), frequency=low))
    if highest > 0.5:
        text = (
            f"{name}: the open loop is {highest:.2g} at the highest line, {high / (2 * math.pi):.4g} Hz: a crossover "
            "above it cannot be detected; measure at higher frequencies"
        )
        messages.append(warning("crossover-above-data", text, gain=float(highest), frequency=high))
    at = values["gain_margin_frequency"]
    if at is not None and not low <= at <= high:
        text = (
            f"{name}: the gain margin is at {at / (2 * math.pi):.4g} Hz, outside the data, where the response is "
            f"extrapolated as a {units.word('mass')}"
        )
        messages.append(warning("gain-margin-beyond-data", text, frequency=at))
    return messages


@dataclass(frozen=True, eq=False)
class _Estimated:
    """A measured plant up to the velocity that a law estimates, for :func:`retuned_gains`."""

    plant: MeasuredPlant
    estimator: AnyEstimator
    filters: tuple[Filter, ...]

    @property
    def period(self) -> float:
        return self.plant.period

    def response(self, w: np.ndarray) -> np.ndarray:
        back = np.exp(-1j * np.asarray(w) * self.period)
        estimate = estimator_response(self.estimator, w, self.period) * (1.0 - back) / self.period
        return self.plant.position(w) * estimate * filter_response(self.filters, w, self.period)

    def integrator(self, w: np.ndarray) -> np.ndarray:
        return self.period / (1.0 - np.exp(-1j * np.asarray(w) * self.period))


@dataclass(frozen=True)
class RetuneRequest(Request):
    """What :func:`retune_on_response` takes beside response and axis."""

    crossover: float = option(..., "crossover of the loop on the measured plant [rad/s]")
    phase_margin_deg: float = option(60.0, "its phase margin [deg]")
    at: str = option(PLACES[0], "where the loop is broken", choices=PLACES)
    velocity: float = option(0.1, "where the effects of the axis are linearised [m/s]")
    structure: Structure | str | None = option(None, "what the gains act on, None: as in the axis's controller")
    filters: Sequence[Filter | str] | None = option(
        None, "at the output of the law, None: those of the axis's controller"
    )
    limits: Mapping[str, float] | None = option(
        None, "upper limits of sensitivity_peak_below and sensitivity_peak_above the first antiresonance [ratio]"
    )


@takes(RetuneRequest)
def retune_on_response(response: FrequencyResponse, axis: Axis, request: RetuneRequest) -> VelocityLoopDesign:
    """Return the design whose loop on the measured plant has ``crossover`` [rad/s] and ``phase_margin_deg`` [deg].

    Raises :class:`SpecificationError` where the gains would not be positive, another crossing has less phase margin,
    the loop is unstable or a limit is exceeded; it has the nearest slower crossover that works.

    >>> from emps_design.machines import machine
    >>> f = np.geomspace(1.0, 300.0, 200)
    >>> mass = FrequencyResponse.of(f, 1.0 / (2j * np.pi * f * 100.0 + 200.0))
    >>> design = retune_on_response(mass, machine("emps2018"), 120.0, 50.0)
    >>> run = design.axis.replace(controller=design.controller_table())
    >>> round(measured_margins(mass, run).values["phase_margin_deg"], 2)
    50.0
    """
    crossover, phase_margin_deg, at = request.crossover, request.phase_margin_deg, request.at
    velocity, limits = request.velocity, request.limits or {}
    requested = check_specification(crossover, None, phase_margin_deg)
    low, high = float(response.w[0]), float(response.w[-1])
    if not low < crossover < high:
        raise InputError(
            f"{response.name}: found a crossover of {crossover:g} rad/s, expected one within the data, {low:.4g} to "
            f"{high:.4g} rad/s"
        )
    structure, filters = own_structure(axis, request.structure), own_filters(axis, request.filters)
    plant = _Estimated(MeasuredPlant.of(response, axis), axis.controller.velocity_estimator, filters)
    place = structure.place(at)

    def design_of(w: float) -> tuple[VelocityLoopDesign | None, str]:
        """The design for a crossover ``w`` [rad/s] and its shortcomings in words, "" for none."""
        k_v1, t_v = (float(gain) for gain in retuned_gains(plant, w, phase_margin_deg, place))
        if not np.isfinite(k_v1):
            return None, "the gains would not be positive"
        design = VelocityLoopDesign(
            axis, k_v1, t_v, requested, retuned_at=at, velocity=velocity, structure=structure, filters=filters
        )
        margins = measured_margins(response, design.loop_axis, draws=0)
        if not margins.stable:
            return design, "the loop would be unstable"
        lacks: list[str] = [*over_limits(margins.values, limits)]
        phase = margins.values["phase_margin_deg"]
        if place == PLACES[0] and (phase is None or abs(phase / phase_margin_deg - 1.0) >= MET):
            lacks.append("another crossing has less phase margin")
        return design, " and ".join(lacks)

    design, lacks = design_of(crossover)
    if design is not None and not lacks:
        return design
    slower = np.geomspace(crossover, low, NEAREST)[1:]
    nearest = next((float(w) for w in slower if not design_of(float(w))[1]), None)
    words = "no lower crossover within the data works" if nearest is None else f"{nearest:.4g} rad/s works"
    raise SpecificationError(
        f"retune on {response.name}: no gains give {phase_margin_deg:g} deg at a crossover of {crossover:g} rad/s; "
        f"{lacks}; {words}",
        {} if nearest is None else {"crossover": nearest, "phase_margin_deg": phase_margin_deg, **limits},
    )


def suggest_filter_on_response(
    response: FrequencyResponse,
    axis: Axis,
    phase_margin_deg: float,
    structure: Structure,
    filters: tuple[Filter, ...],
    velocity: float = 0.1,
) -> dict[str, Any]:
    """Return the document of :func:`suggest_filter` for the masses that fit ``response``, checked on the data.

    ``measured`` of each design has ``stable`` and its margins on the data. A filter with which the loop is unstable
    there is not suggested.

    >>> import numpy as np
    >>> from emps_design.control.velocity.gains import PI
    >>> from emps_design.frequency_response.coupling import axis_response
    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> axis, f = machine("emps2018").replace(effects=bent), np.geomspace(1.0, 400.0, 300)
    >>> suggestion = suggest_filter_on_response(
    ...     FrequencyResponse.of(f, axis_response(axis, f), np.full(300, 0.01)), machine("emps2018"), 50.0, PI, ()
    ... )
    >>> suggestion["filter"]["kind"], abs(suggestion["with"]["measured"]["phase_margin_deg"] - 50.0) < 2.0
    ('notch', True)
    """
    model = ResponseComparison(response, axis).chain.on(axis)
    suggestion = suggest_filter(model, phase_margin_deg, structure, filters, velocity)
    for name in SIDES:
        side = suggestion[name]
        if side is None or side["crossover"] is None:
            continue
        added = () if name == "without" else (Filter(**suggestion["filter"]),)
        design = VelocityLoopDesign(
            axis, side["k_v1"], side["t_v"], {}, velocity=velocity, structure=structure, filters=(*filters, *added)
        )
        on_data = measured_margins(response, design.loop_axis, draws=0)
        side["measured"] = {"stable": on_data.stable, **{key: on_data.values[key] for key in MARGINS}}
    if suggestion["filter"] is not None and not suggestion["with"]["measured"]["stable"]:
        suggestion |= {"filter": None, "with_equal_margins": None, "with": None}
    return {**suggestion, "model": f"the {axis.units.word('masses')} that fit {response.name}"}
