"""Reference programs for the axis and the ramp of force that starts it, sampled at the drive's period.

Every function returns an array (n,), SI, and refuses numbers that cannot be meant with :class:`InputError`.
"""

from __future__ import annotations

import numpy as np

from emps_design.errors import InputError
from emps_design.records.check import LONGEST
from emps_design.simulation.synthetic import trapezoid_laps


def half_ramp_program(
    period: float, speeds: tuple[float, ...] = (0.2, 0.1, 0.05), segment: float = 0.5, laps: int = 1
) -> np.ndarray:
    """Position [m] whose velocity varies linearly half the time and is constant the other half, section III-A.

    For each of ``speeds`` [m/s]: ramp, constant, ramp, forth and back, each ``segment`` seconds of constant velocity
    between two ramps of half that; it ends where it began.

    >>> q = half_ramp_program(1e-3)
    >>> v = np.diff(q) / 1e-3
    >>> constant = np.abs(np.diff(v)) < 1e-9
    >>> round(float(constant.mean()), 2), abs(float(q[-1])) < 1e-9
    (0.5, True)
    """
    _positive(period=period, segment=segment, laps=laps, **{f"speeds[{i}]": v for i, v in enumerate(speeds)})
    ramp, flat = max(1, round(0.5 * segment / period)), max(1, round(segment / period))
    up = (np.arange(ramp) + 0.5) / ramp
    shape = np.concatenate([up, np.ones(flat), up[::-1]])
    velocity = np.concatenate([sign * speed * shape for speed in speeds for sign in (1.0, -1.0)])
    return np.concatenate([[0.0], np.cumsum(np.tile(velocity, int(laps))) * period])


def multi_sine(
    period: float,
    duration: float = 10.0,
    frequencies: tuple[float, ...] = (0.3, 0.7, 1.1, 2.3, 4.1),
    amplitude: float = 0.02,
    seed: int = 0,
) -> np.ndarray:
    """Position [m]: sines of equal velocity at ``frequencies`` [Hz], phases from ``seed``, peak ``amplitude`` [m].

    It fades in over the first half second, so that it starts at rest at 0.

    >>> q = multi_sine(1e-3, duration=4.0)
    >>> abs(float(q[0])), round(float(np.abs(q).max()), 6)
    (0.0, 0.02)
    """
    _positive(period=period, duration=duration, amplitude=amplitude, **{f"f{i}": f for i, f in enumerate(frequencies)})
    t = np.arange(round(duration / period)) * period
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(frequencies))
    q = sum(np.sin(2.0 * np.pi * f * t + phase) / f for f, phase in zip(frequencies, phases, strict=True))
    q *= 0.5 - 0.5 * np.cos(np.pi * np.minimum(t / 0.5, 1.0))
    return amplitude * q / np.abs(q).max()


def force_ramp(period: float, rate: float, peak: float) -> np.ndarray:
    """Force [N] that rises at ``rate`` [N/s] from 0 to ``peak`` [N] (a negative peak falls).

    >>> force_ramp(0.1, 10.0, 2.0)
    array([0., 1., 2.])
    """
    _positive(period=period, rate=rate, peak=abs(peak))
    n = round(abs(peak) / (rate * period)) + 1
    if n > LONGEST:
        raise InputError(
            f"rate: found {rate:g} N/s, so that a rise to {abs(peak):g} N takes {n * period:.4g} s; expected at most "
            f"{LONGEST * period:.4g} s ({LONGEST} samples): raise it faster, or not as far"
        )
    return np.sign(peak) * np.minimum(np.arange(n) * rate * period, abs(peak))


def _positive(**numbers: float) -> None:
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}: found {value:g}, expected a positive number")


__all__ = ["force_ramp", "half_ramp_program", "multi_sine", "trapezoid_laps"]
