"""Views of the residual force over each quantity it could depend on, before and after, and where a force acts.

The extent of a force is the shortest interval of each coordinate that contains most of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.unknown_force import SLOWEST, MissingForce, near_reversals
from emps_design.effects import Motion
from emps_design.effects.guesses import squares_explained, thin
from emps_design.records import Record
from emps_design.units import Units

SHARE = 0.8  # of the squared force inside an extent
LOCAL = 0.3  # share of the range of the record below which an extent is local
LONG = 0.9  # the same for one interval of time, which may begin with an event
CELLS = 160  # of a coordinate: resolution of an extent
RESTING = 0.02  # of the upper speed: an extent of velocity that begins below it begins at rest
EVERYWHERE = "everywhere the record goes"
REVERSAL_TIME = 0.1  # s on both sides of a reversal
SMOOTH_TIME = 0.02  # s
CELL_TIME = 0.05  # s
APART = 0.3  # s between two separate intervals of time
SEEN = 0.05  # of the largest mean square, from which a cell of time counts
MOST_INTERVALS = 6  # more are not events
PEAK = 0.995  # quantile of the force for "up to"
ONE_SIDED = 0.7  # share of the force that resists, or drives, from which it is "more", or "less"

REVERSAL_DRAWN = 0.2  # s, drawn on both sides of a reversal
MAP_CELLS = 36  # of position and of velocity in the map
LINE_TIME = 0.5  # s of a piece of the spectrum over time
HIGHEST_HZ = 100.0  # drawn of spectra
FEWEST = 5  # samples that a bin must exceed to have a mean
SPECTRAL = ("frequency", "period of position")  # quantities over which a view has amplitudes


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

    @property
    def place(self) -> str:
        """The coordinate that locates it best: "speed", "position", "time", "reversals", or "" for everywhere."""
        if self.turning > SHARE and self.share["reversals"] < LOCAL:
            return "reversals"
        limits = {"speed": LOCAL, "position": LOCAL, "time": LONG if len(self.time) == 1 else LOCAL}
        return min((n for n, limit in limits.items() if self.share[n] < limit), key=lambda n: self.share[n], default="")


def extent(record: Record, force: np.ndarray, window: np.ndarray, noise: float = 0.0) -> Extent:
    """Where ``force`` (n,) [N] acts on the samples of ``window`` (n,) bool; ``noise`` [N] rms is subtracted."""
    v = np.gradient(record.q, record.period)
    acting, t = np.where(window, force, 0.0), record.t - record.t[0]
    energy = acting**2
    if noise:
        width = max(1, round(SMOOTH_TIME / record.period))
        energy = np.maximum(np.convolve(energy, np.ones(width) / width, mode="same") - noise**2, 0.0)
    total, moving = max(float(energy.sum()), 1e-30), np.where(v != 0, energy, 0.0)
    turning = near_reversals(v, record.period, REVERSAL_TIME)
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
        peak=float(np.quantile(np.abs(acting[window]), PEAK)),
        resisting=float(np.sum(acting * np.sign(v)) / max(float(np.abs(acting[v != 0]).sum()), 1e-30)),
    )


def where_document(region: Extent, units: Units, others: Sequence[Extent] = ()) -> dict[str, Any]:
    """The contract's ``where`` of an extent, in numbers and in words of an axis with ``units``.

    ``others`` are the extents of the same effect with its parameters drawn from their covariance: the range of the ends
    of the intervals is ``confidence``. ``place`` names the coordinate in ``text``.
    """
    slow, fast = region.speed
    forwards, backwards = region.forwards > 1 - SHARE, region.forwards < SHARE
    below = f"below {units.quantity(fast, 'mm/s', '.3g')}"
    words = {
        "reversals": f"around reversals, {below}",
        "speed": below if slow < RESTING * fast else _between(region.speed, "mm/s", units),
        "position": _between(region.position, "mm", units),
        "time": _times(region.time),
        "": "" if forwards and backwards else "all along",
    }[region.place]
    if not (forwards and backwards):
        words += ", moving forwards" if forwards else ", moving backwards"
    elif region.place in ("speed", "reversals"):
        words += ", both ways"
    result: dict[str, Any] = {
        "text": words or EVERYWHERE,
        "place": region.place or "everywhere",
        "velocity": [-fast if backwards else slow, fast if forwards else -slow],
        "position": list(region.position),
        "time": [list(interval) for interval in region.time],
        "frequency": list(region.frequency),
        "force": {"value": region.peak, "unit": units.unit("N"), "sense": _sense(region.resisting)},
    }
    if others:
        level = 1 - 2 / (len(others) + 1)
        spans = {name: _span([getattr(e, name) for e in (region, *others)]) for name in ("speed", "position")}
        result["confidence"] = {"level": level, **spans}
    return result


def _sense(resisting: float) -> str:
    if abs(resisting) < ONE_SIDED:
        return "more or less"
    return "more" if resisting > 0 else "less"


def _between(interval: tuple[float, float], unit: str, units: Units) -> str:
    """The ``interval`` [m or m/s] in text, with ``unit`` mm or mm/s."""
    shown, factor = units.read(unit)
    start, stop = (1e3 * factor * end for end in interval)
    return f"between {start:.4g} and {stop:.4g} {shown}"


def _times(intervals: tuple[tuple[float, float], ...]) -> str:
    (start, stop), rest = intervals[0], len(intervals) - 1
    others = f" and {rest} time{'s' if rest > 1 else ''} more" if rest else ""
    return f"from {start:.3g} to {stop:.3g} s{others}"


def _span(intervals: list[tuple[float, float]]) -> list[list[float]]:
    """Smallest and largest of the lower ends, and of the upper ends."""
    return [[min(ends), max(ends)] for ends in zip(*intervals, strict=True)]


def _shortest(x: np.ndarray, energy: np.ndarray, window: np.ndarray) -> tuple[float, float]:
    """Shortest interval of ``x`` with ``SHARE`` of the mean ``energy`` per cell, whatever the time spent in each."""
    inside = x[window]
    edges = np.linspace(float(inside.min()), float(inside.max()), CELLS + 1)
    count = np.histogram(inside, edges)[0]
    mass = np.histogram(inside, edges, weights=energy[window])[0] / np.maximum(count, 1)
    total = np.concatenate(([0.0], np.cumsum(mass)))
    if total[-1] <= 0:
        return float(edges[0]), float(edges[-1])
    stops = np.searchsorted(total, total[:-1] + SHARE * total[-1] * (1 - 1e-12))
    starts = np.arange(CELLS)[stops <= CELLS]
    best = starts[np.argmin(stops[starts] - starts)]
    return float(edges[best]), float(edges[stops[best]])


def _intervals_of_time(t: np.ndarray, energy: np.ndarray, period: float) -> tuple[tuple[float, float], ...]:
    """Intervals of ``t`` [s] with relevant ``energy``; one from first to last where they are many."""
    width = max(1, round(CELL_TIME / period))
    cells = energy[: energy.size // width * width].reshape(-1, width).mean(axis=1)
    high = np.nonzero(cells > SEEN * cells.max())[0]
    whole = ((float(t[0]), float(t[-1])),)
    if high.size == 0:
        return whole
    breaks = np.nonzero(np.diff(high) * CELL_TIME > APART)[0]
    starts, stops = high[np.append(0, breaks + 1)], high[np.append(breaks, high.size - 1)] + 1
    if starts.size > MOST_INTERVALS:
        starts, stops = starts[:1], stops[-1:]
    edges = t[np.minimum(np.stack((starts, stops), axis=1) * width, t.size - 1)]
    return tuple((float(start), float(stop)) for start, stop in edges)


def _band(force: np.ndarray, period: float) -> tuple[float, float]:
    """Band [Hz] with 80 % of the power of ``force`` (n,), up to 100 Hz."""
    from scipy.signal import welch

    frequency, density = welch(force, 1 / period, nperseg=int(min(4096, force.size)), detrend="constant")
    kept = frequency <= 100.0
    total = np.cumsum(density[kept]) / max(float(density[kept].sum()), 1e-30)
    lower, upper = (float(frequency[kept][min(np.searchsorted(total, q), kept.sum() - 1)]) for q in (0.1, 0.9))
    return lower, upper


@dataclass(frozen=True)
class View:
    """Mean residual force [N] over one quantity, before and after; ``band`` is two deviations of noise alone."""

    quantity: str
    unit: str
    x: np.ndarray
    before: np.ndarray
    after: np.ndarray
    band: np.ndarray | None = None
    marks: tuple[tuple[float, float], ...] = ()
    title: str = ""


def views(
    before: MissingForce,
    after: MissingForce,
    window: np.ndarray,
    floor: float,
    axis: Axis,
    cutoff_hz: float = rules.CUTOFF_HZ,
) -> list[View]:
    """Residual force over each quantity it could depend on.

    Velocity, position (both ways), acceleration, motor force, distance of the command from the limit of the ``axis``,
    time from a reversal, period of position, time, frequency: the missing force of the models before and after, on the
    samples of ``window`` (n,) bool; ``floor`` [N] is the noise, low-passed at ``cutoff_hz`` [Hz].
    """
    motion, motor_force = before.motion, f"motor {axis.units.word('force')}"
    pairs = (before.force, after.force)
    # Low-passed at the cutoff, a signal has two independent values in each period of it.
    noise = floor / np.sqrt(2 * cutoff_hz * motion.period)
    result = [_binned("velocity", "m/s", motion.v, pairs, window, noise, 41)]
    for sign, title in ((1, "forwards"), (-1, "backwards")):
        moving = window & before.away & (sign * motion.v > 0)
        if moving.sum() > 200:
            result.append(_binned("position", "m", motion.q, pairs, moving, noise, 60, title))
    result.append(_binned("acceleration", "m/s^2", motion.a, pairs, window, noise, 41))
    result.append(_binned(motor_force, "N", before.motion.tau, pairs, window, noise, 41))
    left = f"{axis.units.word('voltage')} left to the limit"
    spare = axis.drive.command_limit - np.abs(np.asarray(motion.voltage))
    resisting = tuple(np.sign(motion.tau) * force for force in pairs)
    result.append(_binned(left, "V", spare, resisting, window, noise, 41, f"along the {motor_force}"))
    result += _around_reversals(motion, pairs, window, noise)
    result += _periods(motion, pairs, window & before.away)
    result.append(_binned("time", "s", motion.t, pairs, window, noise, 80))
    result.append(_spectrum(pairs, window, motion.period))
    return result


def shown(view: View) -> float:
    """Part of the gap that a view shows [N rms]: by the means in its bins, or the strongest line of a spectrum."""
    parts = []
    for y in (view.before, view.after):
        kept = y[np.isfinite(y)]
        spectral = view.quantity in SPECTRAL
        parts.append(float(kept.max() / np.sqrt(2) if spectral else np.sqrt(np.mean(kept**2))) if kept.size else 0.0)
    return parts[0] - parts[1] if not np.array_equal(view.before, view.after, equal_nan=True) else parts[0]


def _around_reversals(
    motion: Motion, pairs: tuple[np.ndarray, np.ndarray], window: np.ndarray, noise: float
) -> list[View]:
    """Force in the new direction of motion over the time from the reversal, where there are two of them at least."""
    sure = np.nonzero(np.abs(motion.v) > SLOWEST)[0]
    if sure.size == 0:
        return []
    turns = sure[1:][np.diff(np.sign(motion.v[sure])) != 0]
    if turns.size < 2:
        return []
    since, towards = np.full(motion.t.size, np.nan), np.zeros(motion.t.size)
    for turn in turns:
        near = np.abs(motion.t - motion.t[turn]) <= REVERSAL_DRAWN
        since[near], towards[near] = (motion.t - motion.t[turn])[near], np.sign(motion.v[turn])
    kept = window & np.isfinite(since)
    if not kept.any():  # all of them lie outside the window
        return []
    forces = tuple(towards * force for force in pairs)
    return [_binned("time from reversal", "s", since, forces, kept, noise, 60, "in the new direction")]


def _periods(motion: Motion, pairs: tuple[np.ndarray, np.ndarray], away: np.ndarray) -> list[View]:
    """Amplitude of the force at each period of position (Lomb and Scargle), away from reversals."""
    kept = thin(away)
    stroke = float(np.ptp(motion.q))
    if kept.size < 200 or stroke <= 0:
        return []
    periods = np.geomspace(stroke / 3, stroke / 300, 400)
    phase = motion.q[kept][:, None] * (2 * np.pi / periods)
    waves, mean = (np.sin(phase), np.cos(phase)), np.full((kept.size, 1), kept.size**-0.5)
    explained = [squares_explained(f[kept] - f[kept].mean(), mean, *waves) for f in pairs]
    amplitudes = [np.sqrt(2 * squares / kept.size) for squares in explained]
    return [View("period of position", "m", periods[::-1], amplitudes[0][::-1], amplitudes[1][::-1])]


def _binned(
    quantity: str,
    unit: str,
    x: np.ndarray,
    pairs: tuple[np.ndarray, np.ndarray],
    kept: np.ndarray,
    noise: float,
    bins: int,
    title: str = "",
) -> View:
    edges = np.linspace(float(x[kept].min()), float(x[kept].max()) + 1e-12, bins + 1)
    place = np.clip(np.digitize(x[kept], edges) - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    thick = np.maximum(count, 1)
    before, after = (np.where(count > FEWEST, np.bincount(place, f[kept], bins) / thick, np.nan) for f in pairs)
    band = np.where(count > FEWEST, 2 * noise / np.sqrt(thick), np.nan)
    return View(quantity, unit, 0.5 * (edges[1:] + edges[:-1]), before, after, band=band, title=title)


def _spectrum(pairs: tuple[np.ndarray, np.ndarray], window: np.ndarray, period: float) -> View:
    from scipy.signal import welch

    length = int(min(4096, max(256, window.sum() // 4), window.sum()))
    amplitudes = []
    for force in pairs:
        frequency, density = welch(force[window], 1 / period, nperseg=length, detrend="constant")
        amplitudes.append(np.sqrt(density * (frequency[1] - frequency[0])))
    kept = (frequency > 0) & (frequency <= HIGHEST_HZ)
    return View("frequency", "Hz", frequency[kept], amplitudes[0][kept], amplitudes[1][kept], title="rms in each line")


def force_map(missing: MissingForce, units: Units) -> dict[str, Any]:
    """Mean missing force [N] over position and velocity, away from reversals; assumes no effect.

    ``force`` has one row per velocity; None in cells without samples.
    """
    kept = (
        missing.away if missing.away.any() else np.ones_like(missing.away)
    )  # where all samples are near reversals, take all
    q, v, force = (x[kept] for x in (missing.motion.q, missing.motion.v, missing.force))
    edges = [np.linspace(float(x.min()), float(x.max()) + 1e-12, MAP_CELLS + 1) for x in (v, q)]
    count = np.histogram2d(v, q, edges)[0]
    mean = np.histogram2d(v, q, edges, weights=force)[0] / np.maximum(count, 1)
    centres = [(0.5 * (e[1:] + e[:-1])).tolist() for e in edges]
    rows = [[float(f) if n else None for f, n in zip(*row, strict=True)] for row in zip(mean, count, strict=True)]
    own = {"velocity": units.unit("m/s"), "position": units.unit("m"), "force": units.unit("N")}
    return {"velocity": centres[0], "position": centres[1], "force": rows, "units": own}


def spectrum_over_time(missing: MissingForce, units: Units) -> dict[str, Any]:
    """Rms [N] of the missing force in each line of its spectrum, over time.

    ``force`` has one row per frequency.
    """
    from scipy.signal import spectrogram

    rate = 1 / missing.motion.period
    length = int(min(max(rate * LINE_TIME, 16), missing.force.size // 4))
    overlap = max(0, length - max(1, (missing.force.size - length) // MAP_CELLS))
    frequency, time, density = spectrogram(missing.force, rate, nperseg=length, noverlap=overlap)
    kept = (frequency > 0) & (frequency <= HIGHEST_HZ)
    rms = np.sqrt(density[kept] * (frequency[1] - frequency[0]))
    own = {"time": "s", "frequency": "Hz", "force": units.unit("N")}
    return {"time": time.tolist(), "frequency": frequency[kept].tolist(), "force": rms.tolist(), "units": own}
