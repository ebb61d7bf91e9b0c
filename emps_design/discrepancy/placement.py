"""Where a force acts, in numbers and in words, and the regions in which a record shows it at a stated error rate.

The extent of a force is the shortest interval of each coordinate that contains most of it. The force of a model is no
evidence of its place. So one half of the record proposes regions and the other half tests them, and a place is named
only if a region there passes. On average at most ``rules.FALSE_REGIONS`` of the regions that pass are false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.records import Split
from emps_design.discrepancy.unknown_force import near_reversals
from emps_design.records import Record
from emps_design.simulation import Run
from emps_design.units import Units

EVERYWHERE = "throughout the record"


@dataclass(frozen=True)
class Region:
    """An ``interval`` of the coordinate ``over``, and the probability ``chance`` of as much force from noise alone."""

    over: str
    interval: tuple[float, float]
    chance: float


@dataclass(frozen=True)
class Placement:
    """The regions that ``passed`` the test, and the number of those ``proposed``."""

    passed: tuple[Region, ...] = ()
    proposed: int = 0

    def intervals(self, over: str) -> list[list[float]]:
        """The intervals of the coordinate ``over`` that passed, in order; those that touch are joined."""
        joined: list[list[float]] = []
        for low, high in sorted(region.interval for region in self.passed if region.over == over):
            if joined and low <= joined[-1][1]:
                joined[-1][1] = max(joined[-1][1], high)
            else:
                joined.append([low, high])
        return joined

    def shows(self, over: str, *intervals: tuple[float, float]) -> bool:
        """Whether a region of the coordinate ``over`` overlaps one of the ``intervals``."""
        return any(low <= stop and start <= high for low, high in self.intervals(over) for start, stop in intervals)

    def to_dict(self) -> dict[str, Any]:
        """The entry ``regions`` of a document: intervals of speed, position and time with a proven force, in SI."""
        counts = {"proposed": self.proposed, "passed": len(self.passed)}
        shown = {over: self.intervals(over) for over in ("speed", "position", "time")}
        return {"false_discovery_rate": rules.FALSE_REGIONS, **counts, **shown}


def placement(hypothesis: Hypothesis, number: int, least: float) -> Placement:
    """The regions in which the residual of a model on record ``number`` exceeds ``least`` [N]."""
    alone = hypothesis.only(number)
    return placed(alone.residuals()[0], alone.run(0), alone.problem.splits[0], alone.problem.whitening, least)


def placed(force: np.ndarray, run: Run, split: Split, whitening: Whitening, least: float) -> Placement:
    """The regions of speed, position and time in which ``force`` (n,) [N] exceeds ``least`` [N] and the noise.

    The force is tested as it is, and multiplied by the sign of the velocity and of the acceleration of a simulated
    ``run``, which has no noise. Adjacent cells of a coordinate with a clear mean of one sign on one half of the record
    are a region; its mean on the other half is tested. The halves are the fitting and the selecting strokes or laps,
    over time alternate pieces. The variance of a weighted sum of the noise is that of the reversed weights after the
    noise filter.
    """
    from scipy.special import ndtr

    turn = np.arange(force.size) // rules.PIECE % 2
    strokes, pieces = (split.fit, split.select), (split.used & (turn == 0), split.used & (turn == 1))
    coordinates = {
        "speed": (np.abs(run.v), rules.CELLS, strokes),
        "position": (run.q, rules.CELLS, strokes),
        "time": (run.t, max(1, force.size // (2 * rules.PIECE)), pieces),
    }
    ways = (np.ones(force.size), np.sign(run.v), np.sign(np.gradient(run.v)))
    # Standard deviation of a sum of n samples of the noise, divided by the square root of n, for large n.
    slow = whitening.std / abs(float(whitening.coefficients.sum()))
    tested = []
    for over, (x, cells, (proposing, testing)) in coordinates.items():
        edges = np.linspace(float(x[split.used].min()), float(x[split.used].max()), cells + 1)
        cell = np.clip(np.digitize(x, edges) - 1, 0, cells - 1)
        for direction in ways:
            sums = np.bincount(cell[proposing], (direction * force)[proposing], cells)
            count = np.bincount(cell[proposing], minlength=cells)
            clear = np.abs(sums) > least * count + rules.CHANCE * slow * np.sqrt(count)
            signs = np.where(clear, np.sign(sums), 0.0)
            starts = [0, *(np.flatnonzero(np.diff(signs)) + 1), cells]
            for start, stop in pairwise(starts):
                weights = np.where(testing & (cell >= start) & (cell < stop), signs[start] * direction, 0.0)
                if weights.any():
                    total, samples = float(weights @ force), float(np.abs(weights).sum())
                    deviation = float(np.linalg.norm(whitening.undo(weights[::-1])))
                    chance = float(ndtr((least * samples - total) / deviation))
                    interval = float(edges[start]), float(edges[stop])
                    tested.append(Region(over, interval, chance))
    return Placement(discoveries(tested), len(tested))


def discoveries(regions: Sequence[Region]) -> tuple[Region, ...]:
    """The ``regions`` that pass at ``rules.FALSE_REGIONS`` (Benjamini and Hochberg, 1995), in the given order.

    >>> chances = (0.04, 0.001, 0.5, 0.02)
    >>> regions = [Region("time", (0.0, 1.0), chance) for chance in chances]
    >>> [region.chance for region in discoveries(regions)]
    [0.001, 0.02]
    """
    ranked = sorted(region.chance for region in regions)
    allowed = [c for rank, c in enumerate(ranked, 1) if c <= rules.FALSE_REGIONS * rank / len(ranked)]
    return tuple(region for region in regions if allowed and region.chance <= allowed[-1])


@dataclass(frozen=True)
class Extent:
    """Where a force acts: intervals of speed [m/s], position [m] and time [s], the ``share`` of the record's range in
    each, and the distribution of the force over directions, reversals and frequencies."""

    speed: tuple[float, float]
    position: tuple[float, float]
    time: tuple[tuple[float, float], ...]
    share: dict[str, float]
    forwards: float  # share of the squared force while moving forwards
    turning: float  # share near reversals
    frequency: tuple[float, float]
    peak: float  # N
    resisting: float  # from -1, driving, to 1, resisting

    def place(self, shown: Placement | None) -> str:
        """The coordinate that locates it best: "speed", "position", "time", "reversals", or "" for everywhere.

        With ``shown`` only coordinates on which a region passed the test.
        """
        local = rules.SOME
        limits = {"speed": local, "position": local, "time": rules.NEARLY_ALL if len(self.time) == 1 else local}
        places = sorted((name for name in limits if self.share[name] < limits[name]), key=lambda name: self.share[name])
        if self.turning > rules.MOST and self.share["reversals"] < local:
            places.insert(0, "reversals")
        if shown is not None:
            slow = (0.0, self.speed[1])
            at = {"speed": [self.speed], "position": [self.position], "time": self.time, "reversals": [slow]}
            over = {"reversals": "speed"}
            places = [name for name in places if shown.shows(over.get(name, name), *at[name])]
        return places[0] if places else ""


def extent(record: Record, force: np.ndarray, window: np.ndarray, noise: float = 0.0) -> Extent:
    """Where ``force`` (n,) [N] acts on the samples of ``window`` (n,) bool; ``noise`` [N] rms is subtracted."""
    v = np.gradient(record.q, record.period)
    acting, t = np.where(window, force, 0.0), record.t - record.t[0]
    energy = acting**2
    if noise:
        width = max(1, round(rules.BLOCK_TIME / record.period))
        energy = np.maximum(np.convolve(energy, np.ones(width) / width, mode="same") - noise**2, 0.0)
    total, moving = max(float(energy.sum()), 1e-30), np.where(v != 0, energy, 0.0)
    turning = near_reversals(v, record.period, 2 * rules.CELL_TIME)
    speed, position = (_shortest(x, energy, window) for x in (np.abs(v), record.q))
    intervals = _intervals_of_time(t, energy, record.period)
    share = {
        "speed": (speed[1] - speed[0]) / float(np.ptp(np.abs(v[window]))),
        "position": (position[1] - position[0]) / float(np.ptp(record.q[window])),
        "time": sum(stop - start for start, stop in intervals) / float(np.ptp(t[window])),
        "reversals": float(turning[window].mean()),
    }
    return Extent(
        speed,
        position,
        intervals,
        share,
        forwards=float(moving[v > 0].sum() / max(moving.sum(), 1e-30)),
        turning=float(energy[turning].sum()) / total,
        frequency=_band(acting, record.period),
        peak=float(np.quantile(np.abs(acting[window]), rules.PEAK)),
        resisting=float(np.sum(acting * np.sign(v)) / max(float(np.abs(acting[v != 0]).sum()), 1e-30)),
    )


def where_document(
    region: Extent, units: Units, others: Sequence[Extent] = (), shown: Placement | None = None
) -> dict[str, Any]:
    """The contract's ``where`` of an extent, in numbers and in words of an axis with ``units``.

    ``others`` are the extents of the same effect with parameters drawn from their covariance; ``confidence`` is the
    range of the ends of the intervals. ``place`` is the coordinate in ``text``; with ``shown`` one with a region that
    passed the test.
    """
    slow, fast = region.speed
    place = region.place(shown)
    forwards, backwards = region.forwards > 1 - rules.MOST, region.forwards < rules.MOST
    below = f"below {units.quantity(fast, 'mm/s', '.3g')}"
    words = {
        "reversals": f"near reversals, {below}",
        "speed": below if slow < rules.NEGLIGIBLE * fast else _between(region.speed, "mm/s", units),
        "position": _between(region.position, "mm", units),
        "time": _times(region.time),
        "": "" if forwards and backwards else "throughout",
    }[place]
    if not (forwards and backwards):
        words += ", moving forwards" if forwards else ", moving backwards"
    elif place in ("speed", "reversals"):
        words += ", in both directions"
    # A force of which less than the share MOST resists motion, or drives it, is neither.
    sense = "more or less" if abs(region.resisting) < 2 * rules.MOST - 1 else "more" if region.resisting > 0 else "less"
    result: dict[str, Any] = {
        "text": words or EVERYWHERE,
        "place": place or "everywhere",
        "velocity": [-fast if backwards else slow, fast if forwards else -slow],
        "position": list(region.position),
        "time": [list(interval) for interval in region.time],
        "frequency": list(region.frequency),
        "force": {"value": region.peak, "unit": units.unit("N"), "sense": sense},
    }
    if others:
        level = 1 - 2 / (len(others) + 1)
        spans = {name: _span([getattr(e, name) for e in (region, *others)]) for name in ("speed", "position")}
        result["confidence"] = {"level": level, **spans}
    if shown is not None:
        result["regions"] = shown.to_dict()
    return result


def _between(interval: tuple[float, float], unit: str, units: Units) -> str:
    """The ``interval`` [m or m/s] in text, with ``unit`` mm or mm/s."""
    shown, factor = units.read(unit)
    start, stop = (1e3 * factor * end for end in interval)
    return f"between {start:.4g} and {stop:.4g} {shown}"


def _times(intervals: tuple[tuple[float, float], ...]) -> str:
    (start, stop), rest = intervals[0], len(intervals) - 1
    others = f" and {rest} more time{'s' if rest > 1 else ''}" if rest else ""
    return f"from {start:.3g} to {stop:.3g} s{others}"


def _span(intervals: list[tuple[float, float]]) -> list[list[float]]:
    """Smallest and largest of the lower ends, and of the upper ends."""
    return [[min(ends), max(ends)] for ends in zip(*intervals, strict=True)]


def _shortest(x: np.ndarray, energy: np.ndarray, window: np.ndarray) -> tuple[float, float]:
    """Shortest interval of ``x`` with most of the mean ``energy`` per cell, regardless of the time spent in each."""
    inside = x[window]
    edges = np.linspace(float(inside.min()), float(inside.max()), rules.CELLS + 1)
    count = np.histogram(inside, edges)[0]
    mass = np.histogram(inside, edges, weights=energy[window])[0] / np.maximum(count, 1)
    total = np.concatenate(([0.0], np.cumsum(mass)))
    if total[-1] <= 0:
        return float(edges[0]), float(edges[-1])
    stops = np.searchsorted(total, total[:-1] + rules.MOST * total[-1] * (1 - 1e-12))
    starts = np.arange(rules.CELLS)[stops <= rules.CELLS]
    best = starts[np.argmin(stops[starts] - starts)]
    return float(edges[best]), float(edges[stops[best]])


def _intervals_of_time(t: np.ndarray, energy: np.ndarray, period: float) -> tuple[tuple[float, float], ...]:
    """Intervals of ``t`` [s] with relevant ``energy``; one interval from first to last if they are many."""
    width = max(1, round(rules.CELL_TIME / period))
    cells = energy[: energy.size // width * width].reshape(-1, width).mean(axis=1)
    high = np.nonzero(cells > rules.SLIGHT * cells.max())[0]
    whole = ((float(t[0]), float(t[-1])),)
    if high.size == 0:
        return whole
    breaks = np.nonzero(np.diff(high) * rules.CELL_TIME > rules.APART)[0]
    starts, stops = high[np.append(0, breaks + 1)], high[np.append(breaks, high.size - 1)] + 1
    if starts.size > rules.MOST_INTERVALS:
        starts, stops = starts[:1], stops[-1:]
    edges = t[np.minimum(np.stack((starts, stops), axis=1) * width, t.size - 1)]
    return tuple((float(start), float(stop)) for start, stop in edges)


def _band(force: np.ndarray, period: float) -> tuple[float, float]:
    """Band [Hz] with 80 % of the power of ``force`` (n,), up to the highest line that is shown."""
    from scipy.signal import welch

    frequency, density = welch(force, 1 / period, nperseg=int(min(4096, force.size)), detrend="constant")
    shown = frequency <= rules.LINES_HZ[1]
    total = np.cumsum(density[shown]) / max(float(density[shown].sum()), 1e-30)
    lower, upper = (float(frequency[shown][min(np.searchsorted(total, q), shown.sum() - 1)]) for q in (0.1, 0.9))
    return lower, upper
