"""Views of the residual force over each quantity on which it could depend, before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.unknown_force import MissingForce, slowest
from emps_design.effects import Motion
from emps_design.effects.guesses import squares_explained, thin
from emps_design.units import Units

SPECTRAL = ("frequency", "period of position")  # quantities over which a view has amplitudes


@dataclass(frozen=True)
class View:
    """Mean residual force [N] over one quantity, before and after; ``band`` is two standard deviations of the noise."""

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
    """Residual force over each quantity on which it could depend.

    Velocity, position (in each direction), acceleration, motor force, margin of the command to the limit of the
    ``axis``, time from a reversal, period of position, time, frequency: the missing force of the models before and
    after, on the samples of ``window`` (n,) bool. ``floor`` [N] is the noise, low-passed at ``cutoff_hz`` [Hz].
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
    to_limit = f"{axis.units.word('voltage')} margin to the limit"
    reserve = axis.drive.command_limit - np.abs(np.asarray(motion.voltage))
    resisting = tuple(np.sign(motion.tau) * force for force in pairs)
    result.append(_binned(to_limit, "V", reserve, resisting, window, noise, 41, f"along the {motor_force}"))
    result += _around_reversals(motion, pairs, window, noise)
    result += _periods(motion, pairs, window & before.away)
    result.append(_binned("time", "s", motion.t, pairs, window, noise, 80))
    result.append(_spectrum(pairs, window, motion.period))
    return result


def shown(view: View) -> float:
    """Part of the gap [N rms] that a view shows: by the means in its bins, or the strongest line of a spectrum."""
    parts = []
    for y in (view.before, view.after):
        finite = y[np.isfinite(y)]
        spectral = view.quantity in SPECTRAL
        rms = float(finite.max() / np.sqrt(2) if spectral else np.sqrt(np.mean(finite**2))) if finite.size else 0.0
        parts.append(rms)
    return parts[0] - parts[1] if not np.array_equal(view.before, view.after, equal_nan=True) else parts[0]


def _around_reversals(
    motion: Motion, pairs: tuple[np.ndarray, np.ndarray], window: np.ndarray, noise: float, drawn: float = 0.2
) -> list[View]:
    """Force in the new direction of motion over the time from the reversal, if there are at least two reversals.

    ``drawn`` [s] is the range on both sides.
    """
    sure = np.nonzero(np.abs(motion.v) > slowest(motion.v))[0]
    if sure.size == 0:
        return []
    turns = sure[1:][np.diff(np.sign(motion.v[sure])) != 0]
    if turns.size < 2:
        return []
    since, towards = np.full(motion.t.size, np.nan), np.zeros(motion.t.size)
    for turn in turns:
        in_window = np.abs(motion.t - motion.t[turn]) <= drawn
        since[in_window], towards[in_window] = (motion.t - motion.t[turn])[in_window], np.sign(motion.v[turn])
    shown = window & np.isfinite(since)
    if not shown.any():  # no reversal lies inside the window
        return []
    forces = tuple(towards * force for force in pairs)
    return [_binned("time from reversal", "s", since, forces, shown, noise, 60, "in the new direction")]


def _periods(motion: Motion, pairs: tuple[np.ndarray, np.ndarray], away: np.ndarray) -> list[View]:
    """Amplitude of the force at each period of position (Lomb-Scargle), away from reversals."""
    places = thin(away)
    stroke = float(np.ptp(motion.q))
    if places.size < 200 or stroke <= 0:
        return []
    periods = np.geomspace(stroke / 3, stroke / 300, 400)
    phase = motion.q[places][:, None] * (2 * np.pi / periods)
    waves, mean = (np.sin(phase), np.cos(phase)), np.full((places.size, 1), places.size**-0.5)
    explained = [squares_explained(f[places] - f[places].mean(), mean, *waves) for f in pairs]
    amplitudes = [np.sqrt(2 * squares / places.size) for squares in explained]
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
    """Means of a pair of forces in ``bins`` of ``x`` on the samples ``kept``; nan in bins with at most five samples."""
    edges = np.linspace(float(x[kept].min()), float(x[kept].max()) + 1e-12, bins + 1)
    place = np.clip(np.digitize(x[kept], edges) - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    thick = np.where(count > 5, count, np.nan)
    before, after = (np.bincount(place, f[kept], bins) / thick for f in pairs)
    band = 2 * noise / np.sqrt(thick)
    return View(quantity, unit, 0.5 * (edges[1:] + edges[:-1]), before, after, band=band, title=title)


def _spectrum(pairs: tuple[np.ndarray, np.ndarray], window: np.ndarray, period: float) -> View:
    from scipy.signal import welch

    length = int(min(4096, max(256, window.sum() // 4), window.sum()))
    amplitudes = []
    for force in pairs:
        frequency, density = welch(force[window], 1 / period, nperseg=length, detrend="constant")
        amplitudes.append(np.sqrt(density * (frequency[1] - frequency[0])))
    band = (frequency > 0) & (frequency <= rules.LINES_HZ[1])
    return View("frequency", "Hz", frequency[band], amplitudes[0][band], amplitudes[1][band], title="rms in each line")


def force_map(missing: MissingForce, units: Units, cells: int = 36) -> dict[str, Any]:
    """Mean missing force [N] over position and velocity, in ``cells`` of each, away from reversals.

    ``force`` has one row per velocity; None in cells without samples.
    """
    band = (
        missing.away if missing.away.any() else np.ones_like(missing.away)
    )  # where all samples are near reversals, take all
    q, v, force = (x[band] for x in (missing.motion.q, missing.motion.v, missing.force))
    edges = [np.linspace(float(x.min()), float(x.max()) + 1e-12, cells + 1) for x in (v, q)]
    count = np.histogram2d(v, q, edges)[0]
    mean = np.histogram2d(v, q, edges, weights=force)[0] / np.maximum(count, 1)
    centres = [(0.5 * (e[1:] + e[:-1])).tolist() for e in edges]
    rows = [[float(f) if n else None for f, n in zip(*row, strict=True)] for row in zip(mean, count, strict=True)]
    axis_units = {"velocity": units.unit("m/s"), "position": units.unit("m"), "force": units.unit("N")}
    return {"velocity": centres[0], "position": centres[1], "force": rows, "units": axis_units}


def spectrum_over_time(
    missing: MissingForce, units: Units, piece_time: float = 0.5, pieces: int = 36
) -> dict[str, Any]:
    """Rms [N] of the missing force in each line of its spectrum, over time, in ``pieces`` of ``piece_time`` [s].

    ``force`` has one row per frequency.
    """
    from scipy.signal import spectrogram

    rate = 1 / missing.motion.period
    length = int(min(max(rate * piece_time, 16), missing.force.size // 4))
    overlap = max(0, length - max(1, (missing.force.size - length) // pieces))
    frequency, time, density = spectrogram(missing.force, rate, nperseg=length, noverlap=overlap)
    band = (frequency > 0) & (frequency <= rules.LINES_HZ[1])
    rms = np.sqrt(density[band] * (frequency[1] - frequency[0]))
    axis_units = {"time": "s", "frequency": "Hz", "force": units.unit("N")}
    return {"time": time.tolist(), "frequency": frequency[band].tolist(), "force": rms.tolist(), "units": axis_units}
