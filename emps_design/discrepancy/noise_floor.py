"""The noise floor of the force, its whitening by an autoregressive model, and the confidence interval of an rms."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.records import Split

LAPS = "the difference between laps"
STROKES = "the part that other strokes do not predict"
RESIDUAL = "the residual of the best model"

Signals = tuple[np.ndarray, np.ndarray]  # a force (n,) [N], unfiltered and low-passed
Parts = tuple[list[np.ndarray], list[np.ndarray]]  # pieces of such forces
LapDifference = Callable[[Signals, Split], Parts]  # a way to take differences of laps


@dataclass(frozen=True)
class Whitening:
    """Autoregressive model of the force noise: ``coefficients`` (p + 1,), the first 1; ``std`` [N] of innovations."""

    coefficients: np.ndarray
    std: float

    @classmethod
    def none(cls) -> Whitening:
        """The whitening of white noise with 1 N standard deviation, which changes nothing."""
        return cls(np.array([1.0]), 1.0)

    @classmethod
    def of_autocovariance(cls, lags: np.ndarray) -> Whitening:
        """The model of noise with autocovariance ``lags`` (order + 1,) [N^2], by the Yule-Walker equations."""
        from emps_design.identification.statistics import autoregression

        lags = lags * np.concatenate(([1 + 1e-9], np.ones(lags.size - 1)))
        a, variance = autoregression(lags, lags.size - 1)
        return cls(np.concatenate(([1.0], -a)), float(np.sqrt(max(variance, 1e-12))))

    def apply(self, residual: np.ndarray) -> np.ndarray:
        """Innovations of ``residual`` (n,) [N] in units of their standard deviation."""
        return np.convolve(self.coefficients, residual)[: residual.size] / self.std

    def undo(self, innovations: np.ndarray) -> np.ndarray:
        """Force noise (n,) [N] with ``innovations`` (n,): the inverse of :meth:`apply`."""
        from scipy.signal import lfilter

        return self.std * lfilter((1.0,), self.coefficients, innovations)


def rms_interval(error: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """95 % confidence interval of the rms of ``error`` (n,), by the stationary bootstrap.

    Blocks of geometrically distributed length start anywhere in the record, which is continued periodically (Politis
    and Romano, The stationary bootstrap, 1994). Only their sums of squares are computed.

    >>> low, high = rms_interval(np.random.default_rng(0).standard_normal(20_000))
    >>> 0.97 < low < 1.0 < high < 1.03
    True
    """
    generator, n = np.random.default_rng(seed), error.size
    piece = min(rules.PIECE, n // 4)
    lengths = generator.geometric(
        1 / piece, (rules.RESAMPLES, 2 * (n // piece) + 50)
    )  # more than enough to fill the record
    ends = np.minimum(np.cumsum(lengths, axis=1), n)
    lengths = np.diff(ends, axis=1, prepend=0)
    begins = generator.integers(0, n, lengths.shape)
    squares = np.concatenate(([0.0], np.cumsum(np.tile(error**2, 2))))
    means = (squares[begins + lengths] - squares[begins]).sum(axis=1) / ends[:, -1]
    low, high = np.sqrt(np.quantile(means, rules.INTERVAL))
    return float(low), float(high)


@dataclass(frozen=True)
class Floor:
    """Rms [N] of the noise of the force, ``force`` unfiltered and ``force_60hz`` low-passed.

    ``interval`` and ``interval_60hz`` are their 95 % intervals. ``whitening`` is the noise model, ``draws`` are its
    innovations for resampling. ``source`` is what it was estimated from, in words.
    """

    force: float
    force_60hz: float
    interval: tuple[float, float]
    interval_60hz: tuple[float, float]
    whitening: Whitening
    draws: np.ndarray
    source: str

    @property
    def from_laps(self) -> bool:
        """Whether it was estimated from differences between laps, not from the residual of a model."""
        return self.source == LAPS

    def to_dict(self, measure: str = "") -> dict[str, object]:
        """The contract's ``floor`` with its interval, of ``gap`` or, by ``measure`` "_60hz", of the inverse model."""
        rms, interval = getattr(self, f"force{measure}"), getattr(self, f"interval{measure}")
        return {"floor": rms, "floor_interval": list(interval), "floor_from": self.source}


def floor_of_laps(residuals: tuple[np.ndarray, ...], splits: tuple[Split, ...], period: float) -> Floor | None:
    """Noise floor from repeated laps of any record, or None if no reference repeats.

    ``residuals`` (n,) [N] are those of a fitted model, so that differences between laps which the model explains, such
    as a disturbance of the controller, are not taken for noise. Neither is a drift: if the second difference of three
    laps is clearly smaller than the difference of two, the second difference is the floor. Nor are pushes in single
    laps: if two of three laps always agree far better than consecutive ones, their difference is the floor.
    """
    from emps_design.identification.filters import low_pass

    signals = [(force, low_pass(force, rules.CUTOFF_HZ, period)) for force in residuals]
    ways = partial(_weighted, order=1), partial(_weighted, order=2), _closest_laps
    first, second, agreeing = (_differences(signals, splits, difference) for difference in ways)
    if not first[0]:
        return None
    drifts = bool(second[0]) and _rms(second[0]) < rules.CLEARLY_LESS * _rms(first[0])
    floor = _floor(*(second if drifts else first), LAPS)
    if not agreeing[0]:
        return floor
    quietest = _floor(*agreeing, LAPS)
    return quietest if quietest.force < rules.THIRD * floor.force else floor


def _differences(signals: Sequence[Signals], splits: tuple[Split, ...], difference: LapDifference) -> Parts:
    """Lap differences by ``difference`` of all records, unfiltered and low-passed, without outlying pieces."""
    raw: list[np.ndarray] = []
    smooth: list[np.ndarray] = []
    for both, split in zip(signals, splits, strict=True):
        usual = _without_outliers(*difference(both, split))
        raw += usual[0]
        smooth += usual[1]
    return raw, smooth


def _weighted(signals: Signals, split: Split, order: int) -> Parts:
    """Differences of the given ``order`` between consecutive laps."""
    weights = np.diff(np.eye(order + 1), order, axis=0)[0]
    laps = _laps(split, weights.size)
    raw, smooth = ([_difference(signal, start, stop, split.lap, weights) for start, stop in laps] for signal in signals)
    return raw, smooth


def _closest_laps(signals: Signals, split: Split) -> Parts:
    """Differences of the two laps of every three that agree best, piece by piece."""
    raw: list[np.ndarray] = []
    smooth: list[np.ndarray] = []
    for start, stop in _laps(split, rules.LAPS)[:: rules.LAPS]:
        if stop - start < rules.PIECE:
            continue
        pairs, slow = (_pairs(signal, start, stop, split.lap) for signal in signals)
        best = np.argmin(np.sum(pairs**2, axis=2), axis=0), np.arange(pairs.shape[1])
        raw.append(np.concatenate(pairs[best]))
        smooth.append(np.concatenate(slow[best]))
    return raw, smooth


def _pairs(signal: np.ndarray, start: int, stop: int, lap: int) -> np.ndarray:
    """Differences (3, pieces, samples) of every two of three laps, minus their medians, which come from drift."""
    unit_weights = np.eye(rules.LAPS)
    every_two = [
        unit_weights[later] - unit_weights[earlier] for earlier, later in itertools.combinations(range(rules.LAPS), 2)
    ]
    pairs = [_difference(signal, start, stop, lap, weights) for weights in every_two]
    cut = np.array([_pieces(pair, rules.PIECE) for pair in pairs])
    return cut - np.median(cut, axis=(1, 2), keepdims=True)


def _laps(split: Split, together: int) -> list[tuple[int, int]]:
    """Samples (start, stop) of the first lap of every group of ``together`` consecutive laps."""
    used = np.nonzero(split.used)[0]
    if split.lap == 0 or used.size < together * split.lap - rules.START_UP:
        return []
    first, last, others = int(used[0]), int(used[-1]) + 1, (together - 1) * split.lap
    # The first lap starts from rest, unlike the others: it is excluded if there are enough laps.
    begin = first + split.lap if last - first > (together + 0.5) * split.lap else first
    groups = [(a, min(a + split.lap, last - others)) for a in range(begin, last - others - rules.START_UP, split.lap)]
    return [(a, b) for a, b in groups if split.used[a : b + others].all()]  # without the held-out part


def _difference(signal: np.ndarray, start: int, stop: int, lap: int, weights: np.ndarray) -> np.ndarray:
    """Combination of laps with ``weights``, scaled to the standard deviation of one lap's noise."""
    laps = [weight * signal[start + i * lap : stop + i * lap] for i, weight in enumerate(weights)]
    return np.sum(laps, axis=0) / np.sqrt(np.sum(np.square(weights)))


def floor_of_residual(forces: Sequence[np.ndarray], period: float, source: str) -> Floor:
    """Noise floor from the residual ``forces`` (n_used,) [N] of a model, per record; ``source`` describes it."""
    from emps_design.identification.filters import low_pass

    raw, smooth = [], []
    for force in forces:
        usual = _without_outliers([force], [low_pass(force, rules.CUTOFF_HZ, period)])
        raw += usual[0]
        smooth += usual[1]
    return _floor(raw, smooth, source)


def _floor(raw: list[np.ndarray], smooth: list[np.ndarray], source: str) -> Floor:
    (force, lags), (force_60hz, _) = side_by_side(_broadband, [(raw,), (smooth,)])
    whitening = Whitening.of_autocovariance(lags)
    draws = np.concatenate([whitening.apply(d - d.mean())[rules.START_UP :] for d in raw])
    intervals = side_by_side(_interval, [(raw, force), (smooth, force_60hz)])
    return Floor(force, force_60hz, intervals[0], intervals[1], whitening, draws / draws.std(), source)


def _interval(parts: list[np.ndarray], rms: float) -> tuple[float, float]:
    """95 % interval of the floor ``rms`` [N], in proportion to that of the rms of ``parts``."""
    error = np.concatenate([p - p.mean() for p in parts])
    low, high = (rms / float(np.std(error)) * end for end in rms_interval(error))
    return low, high


def _broadband(parts: list[np.ndarray]) -> tuple[float, np.ndarray]:
    """Rms [N] and autocovariance (``rules.ORDER`` + 1,) [N^2] of ``parts`` without the lines of their spectrum.

    A tone that is not synchronous with the laps differs between them but is not noise: a line far above the median of
    its neighbours is reduced to that median.
    """
    from scipy.ndimage import median_filter

    size = max(part.size for part in parts)
    power, samples = np.zeros(size + 1), 0
    for part in parts:
        window = np.hanning(part.size)  # to limit the leakage of a tone
        power += np.abs(np.fft.rfft(window * (part - part.mean()), 2 * size)) ** 2 / np.mean(window**2)
        samples += part.size
    usual = median_filter(power, 2 * rules.NEIGHBOURS + 1, mode="nearest")
    power = np.where(power > rules.LINE * usual, usual, power)
    lags = np.fft.irfft(power)[: rules.ORDER + 1] / samples
    return float(np.sqrt(lags[0])), lags


def usual_rms(forces: Sequence[np.ndarray]) -> float:
    """Rms [N] of ``forces``, (n,) per record, without pieces in which a force is far larger than usual."""
    return _rms([part for force in forces for part in _without_outliers([force], [force])[0]])


def _without_outliers(raw: list[np.ndarray], smooth: list[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """``raw`` and ``smooth`` without the pieces in which ``raw`` is far larger than usual on its record.

    An event in one lap only (a push, a mass put on) differs between laps but is not noise. Whole pieces are removed, so
    that the rest has the correlation of the noise; each record by itself, because with four times the gain the same
    position error makes four times the force.
    """
    if not raw:
        return [], []
    length = min(rules.PIECE, *(part.size for part in raw))
    sizes = [np.std(_pieces(part, length), axis=1) for part in raw]
    typical = np.median(np.concatenate(sizes))
    kept_raw, kept_smooth = [], []
    for part, slow, size in zip(raw, smooth, sizes, strict=True):
        usual = size <= rules.UNUSUAL * typical
        if usual.any():
            mask = np.repeat(usual, length)
            kept_raw.append(part[: mask.size][mask])
            kept_smooth.append(slow[: mask.size][mask])
    return kept_raw, kept_smooth


def _pieces(part: np.ndarray, length: int) -> np.ndarray:
    return part[: part.size // length * length].reshape(-1, length)


def _rms(parts: list[np.ndarray]) -> float:
    """Rms [N] of ``parts``, the mean of each removed."""
    return float(np.sqrt(np.mean(np.concatenate([(p - p.mean()) ** 2 for p in parts]))))
