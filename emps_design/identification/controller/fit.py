"""Least-squares fit of one control law: linear gains and integral time inside, the filters' numbers outside.

The regressors of a record are compressed once to a triangle (QR), on which every structure is tried without touching
the samples again. The filters' numbers are fitted by Gauss-Newton, with their derivatives as further columns.

A filter of the command is a kind and its fitted numbers, in logarithms, so that every step is admissible; only the
depth of a notch is linear, for it may be 0. Its discrete coefficients follow from the bilinear transform without
prewarping.

The noise of a command is described by its prediction error filter and a robust deviation. The covariance of a fit gives
the standard deviation of each number by name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import scipy

from emps_design.identification.controller.regressors import (
    COLUMNS,
    STEP,
    ControllerSignals,
    LawStructure,
    Timing,
    at_step,
    regressors,
    sought,
)
from emps_design.identification.statistics import autocovariance, autoregression, hac_covariance
from emps_design.laws.estimators import NUMBERS, Estimator

# Bounds of a fitted filter. Beyond half the sampling frequency a low-pass has no visible effect.
CORNER = {"lowpass": (1e-4, 0.6), "notch": (1e-4, 0.48)}  # of the sampling frequency
DAMPING, DEPTH = (0.01, 2.0), (-0.3, 1.0)  # a fitted depth below 0 is noise about 0 and reported as 0
FILTER_STEP = 1e-4  # of a fitted number, for its derivative

SCAN, FINE_SCAN = 41, 21  # integral rates tried, from a negligible one to a third of the sampling frequency
NEAR = 1.5  # times the last integral rate: bounds while filters move
ROUNDS = 30  # Gauss-Newton iterations, at most
LARGEST = 0.5  # change of a filter's number in one iteration
SHORTER, SHORTEST = 0.3, 1e-3  # factor on a step without gain, and the least share of a step
CONVERGED = 1e-9  # of the cost
RANK = 1e-10  # of the largest singular value: smaller ones count as zero

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # of the autoregressive model, by the information criterion
ROWS_PER_ORDER = 50

DIFFERENCE = 1e-6  # of a fitted number, for its derivative


@dataclass(frozen=True)
class CommandFilter:
    """One filter: ``kind`` "lowpass" (log frequency) or "notch" (log frequency, log damping, depth); in Hz."""

    kind: str
    numbers: tuple[float, ...]

    @classmethod
    def lowpass(cls, frequency: float) -> CommandFilter:
        """The low-pass w0/(s + w0) of a ``frequency`` [Hz]."""
        return cls("lowpass", (float(np.log(frequency)),))

    @classmethod
    def notch(cls, frequency: float, damping: float, depth: float) -> CommandFilter:
        """The notch of a ``frequency`` [Hz], a ``damping`` and a ``depth``, its gain at that frequency."""
        return cls("notch", (float(np.log(frequency)), float(np.log(damping)), float(depth)))

    def within(self, period: float) -> tuple[tuple[float, float, float], ...]:
        """Each fitted number with its lower and upper bound at this ``period`` [s]."""
        return tuple((x, low, high) for x, (low, high) in zip(self.numbers, _bounds(self.kind, period), strict=False))

    @property
    def frequency(self) -> float:
        """Corner or centre frequency [Hz]."""
        return float(np.exp(self.numbers[0]))

    @property
    def names(self) -> tuple[str, ...]:
        """Its keys in an axis file."""
        return ("frequency", "damping", "depth")[: len(self.numbers)]

    @property
    def values(self) -> tuple[float, ...]:
        """Its numbers in an axis file."""
        return tuple(float(np.exp(x)) if i < 2 else max(x, 0.0) for i, x in enumerate(self.numbers))

    def coefficients(self, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Numerator and denominator in z^-1.

        >>> b, a = CommandFilter.lowpass(100.0).coefficients(1e-3)
        >>> float((b.sum() / a.sum()).round(12))
        1.0
        """
        half = np.pi * self.frequency * period  # w0 T / 2
        if self.kind == "lowpass":
            return np.array([half, half]), np.array([1.0 + half, half - 1.0])
        damping, depth = float(np.exp(self.numbers[1])), self.numbers[2]
        middle, width = 2.0 * (half * half - 1.0), 2.0 * damping * half
        top = np.array([1.0 + depth * width + half * half, middle, 1.0 - depth * width + half * half])
        return top, np.array([1.0 + width + half * half, middle, 1.0 - width + half * half])

    def slopes(self, period: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Derivatives of numerator and denominator in z^-1 with respect to each fitted number.

        >>> low = CommandFilter.lowpass(100.0)
        >>> (numerator, denominator), = low.slopes(1e-3)
        >>> further = CommandFilter("lowpass", (low.numbers[0] + 1e-6,)).coefficients(1e-3)
        >>> bool(np.allclose((further[1] - low.coefficients(1e-3)[1]) / 1e-6, denominator, rtol=1e-5))
        True
        """
        half = np.pi * self.frequency * period
        if self.kind == "lowpass":
            return [(np.array([half, half]), np.array([half, half]))]
        depth, width = self.numbers[2], 2.0 * float(np.exp(self.numbers[1])) * half
        frequency, damping = 2.0 * half * half * np.array([1.0, 2.0, 1.0]), width * np.array([1.0, 0.0, -1.0])
        return [
            (frequency + depth * damping, frequency + damping),
            (depth * damping, damping),
            (damping, np.zeros(3)),
        ]


@cache
def _bounds(kind: str, period: float) -> tuple[tuple[float, float], ...]:
    """Bounds of a filter's fitted numbers at this ``period`` [s]."""
    lowest, highest = (float(np.log(share / period)) for share in CORNER[kind])
    return (lowest, highest), (float(np.log(DAMPING[0])), float(np.log(DAMPING[1]))), DEPTH


def moved_filters(filters: tuple[CommandFilter, ...], steps: np.ndarray, period: float) -> tuple[CommandFilter, ...]:
    """The ``filters`` with their numbers changed by ``steps``, kept within their bounds at this ``period`` [s]."""
    remaining, done = iter(steps), []
    for stage in filters:
        numbers = [min(max(x + next(remaining), low), high) for x, low, high in stage.within(period)]
        done.append(CommandFilter(stage.kind, tuple(map(float, numbers))))
    return tuple(done)


def filtered(filters: tuple[CommandFilter, ...], columns: np.ndarray, period: float) -> np.ndarray:
    """``columns`` (n, ...) through the ``filters`` in order, initially in steady state at the first row."""
    first = columns[:1]
    rest = columns - first
    for stage in filters:
        rest = scipy.signal.lfilter(*stage.coefficients(period), rest, axis=0)
    return rest + first


def derivatives(filters: tuple[CommandFilter, ...], x: np.ndarray, period: float) -> np.ndarray:
    """Derivatives of the filtered ``x`` (n,) with respect to each fitted number, (n, n_numbers)."""

    def at(step: float, i: int, j: int) -> np.ndarray:
        kind, numbers = filters[i].kind, list(filters[i].numbers)
        numbers[j] += step
        return filtered((*filters[:i], CommandFilter(kind, tuple(numbers)), *filters[i + 1 :]), x, period)

    places = [(i, j) for i, stage in enumerate(filters) for j in range(len(stage.numbers))]
    columns = [slope(partial(at, i=i, j=j), FILTER_STEP) for i, j in places]
    return np.column_stack(columns) if columns else np.zeros((x.size, 0))


def slope(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Derivative of a ``function`` at 0, by a central difference.

    >>> slope(lambda x: np.array([x**2 + 3.0 * x]), 0.5).tolist()
    [3.0]
    """
    return (function(step) - function(-step)) / (2.0 * step)


@dataclass(frozen=True)
class LawFit:
    """A fitted law: integral rate ``wi`` [1/s], ``linear`` coefficients, ``filters``; ``cost`` is the residual sum of
    squares over ``samples``."""

    structure: LawStructure
    timing: Timing
    filters: tuple[CommandFilter, ...]
    wi: float
    linear: np.ndarray
    cost: float
    samples: int

    @property
    def size(self) -> int:
        """Number of fitted parameters."""
        return self.structure.size + sum(len(f.numbers) for f in self.filters) + self.seeks_estimator

    @property
    def seeks_estimator(self) -> bool:
        """Whether the velocity estimator has a number to be fitted."""
        return self.structure.velocity and sought(self.timing.velocity_estimator)

    @property
    def criterion(self) -> float:
        """Bayesian information criterion."""
        n = self.samples
        return n * float(np.log(self.cost / n)) + self.size * float(np.log(n)) + self.timing.surprise

    @property
    def stabilising(self) -> bool:
        """Whether it feeds back with a stabilising sign."""
        return bool(self.structure.stabilising(self.linear))

    @property
    def part(self) -> dict[str, float]:
        """The linear coefficients by the names of :attr:`LawStructure.linear`."""
        return dict(zip(self.structure.linear, self.linear.tolist(), strict=True))

    @property
    def gain(self) -> float:
        """Gain of the velocity loop, 0 where there is none."""
        return self.part.get("following", 0.0) + self.part.get("damping", 0.0)

    @property
    def position_rate(self) -> float:
        """Gain of the position loop [1/s], 0 where it or the velocity loop is missing."""
        return self.part.get("position", 0.0) / self.gain if self.gain else 0.0

    @property
    def beta(self) -> np.ndarray:
        """Coefficients of the regressors, (len(COLUMNS),)."""
        return self.structure.combination(self.wi) @ self.linear


@dataclass(frozen=True)
class Compressed:
    """Regressors, filter derivatives and command of one record, reduced to their triangular factor."""

    table: np.ndarray  # (rows, len(COLUMNS)), each column over its norm
    norms: np.ndarray
    slopes: np.ndarray  # (rows, n_numbers)
    target: np.ndarray
    rest: float  # sum of squares that no column can explain
    samples: int


def compress(signals: ControllerSignals, columns: np.ndarray, slopes: np.ndarray | None = None) -> Compressed:
    """Triangular factor of filtered ``columns`` (n, len(COLUMNS)), ``slopes`` (n, n_numbers) and the command."""
    slopes = np.zeros((len(signals), 0)) if slopes is None else slopes
    stacked = signals.counted(np.column_stack([columns, slopes, signals.command]))
    norms = np.linalg.norm(stacked, axis=0)
    norms[norms == 0.0] = 1.0
    triangle = np.asarray(np.linalg.qr(stacked / norms, mode="r"))
    width = len(COLUMNS)
    target = triangle[:, -1] * norms[-1]
    table = triangle[:-1]
    return Compressed(
        table[:, :width], norms[:width], table[:, width:-1] * norms[width:-1], target[:-1],
        float(target[-1] ** 2), int(signals.used.sum()),
    )  # fmt: skip


def solve(
    c: Compressed, structure: LawStructure, period: float, within: tuple[float, float] | None = None
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Best integral rate ``within`` bounds [1/s], linear coefficients, steps of the filters' numbers, squares left."""
    table = c.table * c.norms

    def at(wi: float) -> tuple[float, np.ndarray, np.ndarray]:
        columns = np.column_stack([table @ structure.combination(wi), c.slopes])
        scale = np.linalg.norm(columns, axis=0)
        scale[scale == 0.0] = 1.0
        columns = columns / scale
        coefficients = np.linalg.lstsq(columns, c.target, rcond=RANK)[0]
        residual, coefficients = c.target - columns @ coefficients, coefficients / scale
        width = len(coefficients) - c.slopes.shape[1]
        return float(residual @ residual), coefficients[:width], coefficients[width:]

    if not structure.form:
        squares, linear, steps = at(0.0)
        return 0.0, linear, steps, squares + c.rest
    low, high = within or (1e-3 / (c.samples * period), 0.3 / period)
    # Two scans, for there are two close minima where position loop and integral have nearly the same rate.
    for count in (SCAN, FINE_SCAN) if within is None else (FINE_SCAN,):
        tried = np.geomspace(low, high, count)
        best = int(np.argmin([at(wi)[0] for wi in tried.tolist()]))
        low, high = tried[max(best - 1, 0)], tried[min(best + 1, count - 1)]
    minimum = scipy.optimize.minimize_scalar(
        lambda x: at(np.exp(x))[0] + c.rest,
        bounds=(np.log(low), np.log(high)),
        method="bounded",
        options={"xatol": 1e-9},
    )
    wi = float(np.exp(minimum.x))
    squares, linear, steps = at(wi)
    return wi, linear, steps, squares + c.rest


def fit(
    signals: ControllerSignals,
    start: LawFit,
    limited: np.ndarray | None = None,
    within: tuple[float, float] | None = None,
) -> LawFit:
    """Fit the structure of ``start``, beginning with its filters; the integral rate stays ``within`` bounds [1/s].

    ``limited`` (n,) is the mask of the samples in which the limit acts, so that the integral stops.
    """
    period = signals.period
    best: LawFit | None = None
    trial, timing, move, share = start.filters, start.timing, np.zeros(0), 1.0
    raw = regressors(signals, timing, limited)
    for _ in range(ROUNDS):
        columns = filtered(trial, raw, period)
        compressed = compress(signals, columns)
        wi, linear, _, cost = solve(compressed, start.structure, period, within)
        now = LawFit(start.structure, timing, trial, wi, linear, cost, compressed.samples)
        if best is not None and not now.cost < best.cost:
            share *= SHORTER
            if share < SHORTEST or now.cost - best.cost < CONVERGED * best.cost:
                break
            trial, timing = moved_numbers(best.filters, best.timing, share * move, period)
            raw = regressors(signals, timing, limited)
            continue
        gained = np.inf if best is None else best.cost - now.cost
        best, share = now, 1.0
        if not (trial or sought(timing.velocity_estimator)) or gained < CONVERGED * now.cost:
            break
        slopes = derivatives(trial, raw @ now.beta, period)
        slopes = np.column_stack([slopes, *estimator_slope(signals, now, limited)])
        near = within or (wi / NEAR, wi * NEAR)
        move = np.clip(solve(compress(signals, columns, slopes), start.structure, period, near)[2], -LARGEST, LARGEST)
        trial, timing = moved_numbers(trial, timing, move, period)
        raw = regressors(signals, timing, limited) if timing != now.timing else raw
    assert best is not None
    return best


def estimator_slope(signals: ControllerSignals, law: LawFit, limited: np.ndarray | None) -> list[np.ndarray]:
    """Derivative (n,) of the command with respect to the logarithm of the estimator's number; [] without one."""
    estimator, period = law.timing.velocity_estimator, signals.period
    if not (law.structure.velocity and sought(estimator)):
        return []

    def command(step: float) -> np.ndarray:
        timing = replace(law.timing, velocity_estimator=at_step(estimator, step, period))
        return regressors(signals, timing, limited) @ law.beta

    return [filtered(law.filters, slope(command, STEP), period)]


def moved_numbers(
    filters: tuple[CommandFilter, ...], timing: Timing, steps: np.ndarray, period: float
) -> tuple[tuple[CommandFilter, ...], Timing]:
    """Filters and estimator with their numbers changed by ``steps``; a last step is the estimator's."""
    count = sum(len(stage.numbers) for stage in filters)
    if steps.size > count:
        estimator = at_step(timing.velocity_estimator, float(steps[count]), period)
        timing = replace(timing, velocity_estimator=estimator)
    return moved_filters(filters, steps, period), timing


def whitening_filter(residual: np.ndarray, used: np.ndarray) -> tuple[float, ...]:
    """Coefficients in z^-1 of the filter that whitens ``residual`` (n,), of the best order; (1,) for white noise.

    >>> white = np.random.default_rng(1).standard_normal(5000)
    >>> whitening_filter(white, np.ones(5000, bool))
    (1.0,)
    """
    e = np.where(used, residual, 0.0)
    n = int(used.sum())
    longest = min(max(ORDERS), n // ROWS_PER_ORDER)
    sample = autocovariance(e, n, longest + 1)
    if not sample[0] > 0.0:
        return (1.0,)
    coefficients, best = (1.0,), n * np.log(sample[0])
    for order in (order for order in ORDERS if order <= longest):
        phi, variance = autoregression(sample, order)
        criterion = n * np.log(variance) + order * np.log(n)
        if criterion < best:
            coefficients, best = (1.0, *(-phi).tolist()), criterion
    return coefficients


def resolution(x: np.ndarray) -> float:
    """Step of which all values of ``x`` are multiples, 0 where there is none.

    >>> resolution(np.array([0.5, -1.0, 2.5])), resolution(np.array([0.0, 1.0, 1.3]))
    (0.5, 0.0)
    """
    values = np.unique(np.append(x, 0.0))
    step = float(np.min(np.diff(values), initial=np.inf, where=np.diff(values) > 1e-9 * np.ptp(values)))
    share = values / step
    return step if np.all(np.abs(share - np.round(share)) < 0.01) else 0.0


def usable_behind(used: np.ndarray, whitening: tuple[float, ...]) -> np.ndarray:
    """Mask (n,) of the samples for which the ``whitening`` filter uses only samples that count."""
    return np.convolve(~used, np.ones(len(whitening)))[: used.size] < 0.5


def robust_deviation(x: np.ndarray) -> float:
    """Standard deviation of ``x`` from the median of its size."""
    return 1.4826 * float(np.median(np.abs(x - np.median(x))))


def covariance(signals: ControllerSignals, law: LawFit, limited: np.ndarray | None) -> np.ndarray:
    """Covariance of the linear coefficients, the integral rate and the numbers of filters and estimator.

    By least squares behind the whitening filter, so it holds for correlated noise. Irregular samples have no such
    filter: there it is a HAC covariance, enlarged because a quantised command may be truncated instead of rounded,
    half a step towards zero.
    """
    raw, period = regressors(signals, law.timing, limited), signals.period
    columns = raw @ law.structure.combination(law.wi)
    if law.structure.form:
        by_rate = slope(lambda step: law.structure.combination(law.wi + step), DIFFERENCE * law.wi)
        columns = np.column_stack([columns, raw @ by_rate @ law.linear])
    columns = filtered(law.filters, columns, period)
    columns = np.column_stack([columns, derivatives(law.filters, raw @ law.beta, period)])
    columns = np.column_stack([columns, *estimator_slope(signals, law, limited)])
    columns = signals.counted(columns)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    if signals.times is not None:
        residual = signals.counted(signals.command - filtered(law.filters, raw @ law.beta, period))
        lag = int(4 * (len(residual) / 100) ** (2 / 9))  # Newey and West
        cut = signals.counted(0.5 * resolution(signals.command) * np.sign(signals.command))
        shift = np.linalg.lstsq(columns / scale, cut)[0]
        return (hac_covariance(columns / scale, residual, lag) + np.outer(shift, shift)) / np.outer(scale, scale)
    triangle = np.linalg.qr(columns / scale, mode="r")
    inverse = np.linalg.pinv(triangle) / scale[:, None]
    return law.cost / max(law.samples - law.size, 1) * inverse @ inverse.T


def with_deviations(
    law: LawFit, spread: np.ndarray, numbers: Callable[[LawFit], dict[str, float]]
) -> dict[str, tuple[float, float]]:
    """Each of the ``numbers`` of a fit with its deviation, from the ``spread`` of :func:`covariance`."""
    values, centre = numbers(law), _packed(law)

    def at(step: float, direction: np.ndarray) -> np.ndarray:
        return np.array(list(numbers(_unpacked(law, centre + step * direction)).values()))

    steps = DIFFERENCE * np.maximum(np.abs(centre), 1e-9 * np.max(np.abs(centre)))
    directions = zip(np.eye(centre.size), steps.tolist(), strict=True)
    table = np.array([slope(partial(at, direction=direction), step) for direction, step in directions]).T
    variance = np.einsum("ij,jk,ik->i", table, spread, table)
    deviations = np.sqrt(np.maximum(variance, 0.0)).tolist()
    return {name: (value, std) for (name, value), std in zip(values.items(), deviations, strict=True)}


def _packed(law: LawFit) -> np.ndarray:
    rate = [law.wi] if law.structure.form else []
    estimator = law.timing.velocity_estimator
    own = [float(np.log(estimator.number))] if law.seeks_estimator and not isinstance(estimator, str) else []
    return np.concatenate([law.linear, rate, *(stage.numbers for stage in law.filters), own])


def _unpacked(law: LawFit, x: np.ndarray) -> LawFit:
    linear, rest = x[: law.linear.size], x[law.linear.size :]
    change: dict[str, Any] = {"linear": linear}
    if law.structure.form:
        change["wi"], rest = float(rest[0]), rest[1:]
    filters = []
    for stage in law.filters:
        filters.append(CommandFilter(stage.kind, tuple(rest[: len(stage.numbers)].tolist())))
        rest = rest[len(stage.numbers) :]
    estimator = law.timing.velocity_estimator
    if law.seeks_estimator and not isinstance(estimator, str):
        own = {"kind": estimator.kind, NUMBERS[estimator.kind]: float(np.exp(rest[0]))}
        change["timing"] = replace(law.timing, velocity_estimator=Estimator.model_validate(own))
    return replace(law, **change, filters=tuple(filters))
