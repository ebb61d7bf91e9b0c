"""Where a model is wrong: the residual force over velocity, position, time and frequency, before and after.

The extent of a finding is the shortest stretch of each coordinate that holds most of what it improves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.discrepancy.missing_force import MissingForce, near_reversals
from emps_design.records import Record

SHARE = 0.8  # of the improvement that an extent holds
LOCAL = 0.6  # an extent is worth words when it covers less than this share of what the record visits
SLOW = 1e-3  # m/s, from which on an extent of velocity begins at rest
EVERYWHERE = "everywhere the record goes"
REVERSAL_TIME = 0.1  # s on both sides of a reversal


@dataclass(frozen=True)
class View:
    """Mean residual force [N] over one quantity, before and after; ``band`` is what noise alone would show."""

    quantity: str
    unit: str
    x: np.ndarray
    before: np.ndarray
    after: np.ndarray
    band: np.ndarray | None = None
    marks: tuple[tuple[float, float], ...] = ()
    title: str = ""


def views(before: MissingForce, after: MissingForce, window: np.ndarray, floor: float) -> list[View]:
    """Residual force over velocity, position (both ways), time and frequency, from the force both models miss."""
    motion = before.motion
    pairs = (before.force, after.force)
    result = [_binned("velocity", "m/s", motion.v, pairs, window, floor, 41)]
    for sign, title in ((1, "forwards"), (-1, "backwards")):
        moving = window & before.away & (sign * motion.v > 0)
        if moving.sum() > 200:
            result.append(_binned("position", "m", motion.q, pairs, moving, floor, 60, title))
    result.append(_binned("time", "s", motion.t, pairs, window, floor, 80))
    result.append(_spectrum(pairs, window, motion.period))
    return result


def _binned(
    quantity: str,
    unit: str,
    x: np.ndarray,
    pairs: tuple[np.ndarray, np.ndarray],
    kept: np.ndarray,
    floor: float,
    bins: int,
    title: str = "",
) -> View:
    edges = np.linspace(float(x[kept].min()), float(x[kept].max()) + 1e-12, bins + 1)
    place = np.clip(np.digitize(x[kept], edges) - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    thick = np.maximum(count, 1)
    means = [np.where(count > 5, np.bincount(place, f[kept], bins) / thick, np.nan) for f in pairs]
    # Noise of a 60 Hz signal: about 120 independent values a second, so one in eight samples at 1 kHz counts.
    band = 2 * floor / np.sqrt(np.maximum(count / 8, 1))
    return View(quantity, unit, 0.5 * (edges[1:] + edges[:-1]), *means, band=band, title=title)


def _spectrum(pairs: tuple[np.ndarray, np.ndarray], window: np.ndarray, period: float) -> View:
    from scipy.signal import welch

    length = int(min(4096, max(256, window.sum() // 4)))
    amplitudes = []
    for force in pairs:
        frequency, density = welch(force[window], 1 / period, nperseg=length, detrend="constant")
        amplitudes.append(np.sqrt(density * (frequency[1] - frequency[0])))
    kept = (frequency > 0) & (frequency <= 100.0)
    return View("frequency", "Hz", frequency[kept], amplitudes[0][kept], amplitudes[1][kept], title="rms in each line")


def extent(record: Record, v: np.ndarray, improvement: np.ndarray, window: np.ndarray) -> dict[str, Any]:
    """Where ``improvement`` (n,) [N^2], squared residual without less with the effect, is found: numbers and words."""
    gain = np.where(window, improvement, 0.0)
    width = max(1, round(0.02 / record.period))
    gain = np.convolve(gain, np.ones(width) / width, mode="same")
    gain = np.maximum(gain, 0.0)
    velocity, slow = _shortest(np.abs(v), gain, window)
    position, near = _shortest(record.q, gain, window)
    time, when = _shortest(record.t, gain, window)
    forwards = float(gain[v > 0].sum() / max(gain.sum(), 1e-30))
    turning = near_reversals(v, record.period, REVERSAL_TIME)
    around = float(gain[turning].sum() / max(gain.sum(), 1e-30))
    words = []
    if around > SHARE and turning[window].mean() < LOCAL:
        words.append("around reversals")
    elif slow < LOCAL:
        fast = f"{1e3 * velocity[1]:.3g} mm/s"
        words.append(f"below {fast}" if velocity[0] < SLOW else f"between {1e3 * velocity[0]:.3g} and {fast}")
    if forwards > SHARE or forwards < 1 - SHARE:
        words.append("moving forwards" if forwards > 0.5 else "moving backwards")
    elif words:
        words.append("both ways")
    if near < LOCAL:
        words.append(f"between {1e3 * position[0]:.4g} and {1e3 * position[1]:.4g} mm")
    if when < LOCAL:
        words.append(f"from {time[0]:.3g} to {time[1]:.3g} s")
    lower = -velocity[1] if forwards < SHARE else velocity[0]
    upper = velocity[1] if forwards > 1 - SHARE else -velocity[0]
    return {
        "text": ", ".join(words) or EVERYWHERE,
        "velocity": [float(lower), float(upper)],
        "position": [float(x) for x in position],
        "time": [[float(x) for x in time]],
        "frequency": _band(improvement, window, record.period),
    }


def _shortest(x: np.ndarray, gain: np.ndarray, window: np.ndarray, bins: int = 40) -> tuple[tuple[float, float], float]:
    """Shortest interval of ``x`` with ``SHARE`` of ``gain``, and the share of the samples inside it."""
    inside = x[window]
    edges = np.linspace(float(inside.min()), float(inside.max()), bins + 1)
    mass = np.histogram(x, edges, weights=gain)[0]
    total = np.concatenate(([0.0], np.cumsum(mass)))
    best = (0, bins)
    for start in range(bins):
        stop = int(np.searchsorted(total, total[start] + SHARE * total[-1]))
        if stop <= bins and stop - start < best[1] - best[0]:
            best = (start, stop)
    lower, upper = float(edges[best[0]]), float(edges[best[1]])
    return (lower, upper), float(np.mean((inside >= lower) & (inside <= upper)))


def _band(improvement: np.ndarray, window: np.ndarray, period: float) -> list[float]:
    """Band [Hz] that holds most of the improvement's force, up to 100 Hz."""
    from scipy.signal import welch

    force = np.sqrt(np.abs(improvement)) * np.sign(improvement)
    frequency, density = welch(force[window], 1 / period, nperseg=int(min(4096, window.sum())), detrend="constant")
    kept = frequency <= 100.0
    total = np.cumsum(density[kept]) / max(float(density[kept].sum()), 1e-30)
    return [float(frequency[kept][np.searchsorted(total, q)]) for q in (0.1, 0.9)]
