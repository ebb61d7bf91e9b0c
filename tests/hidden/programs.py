"""Reference programs for the hidden-effect cases: repeated laps of trapezoids, strokes at random, a multi-sine."""

from __future__ import annotations

import numpy as np


def stroke(start: float, stop: float, speed: float, acceleration: float, period: float) -> np.ndarray:
    """Trapezoid from ``start`` to ``stop`` [m], sampled; a triangle where the stroke is too short for ``speed``."""
    length = abs(stop - start)
    speed = min(speed, np.sqrt(length * acceleration))
    rise = speed / acceleration
    total = length / speed + rise
    t = np.linspace(0.0, total, int(np.ceil(total / period)) + 1)[1:]
    up, down = np.clip(t, 0, rise), np.clip(t - (total - rise), 0, rise)
    flat = np.clip(t - rise, 0, total - 2 * rise)
    distance = acceleration * up**2 / 2 + speed * flat + speed * down - acceleration * down**2 / 2
    return start + np.sign(stop - start) * distance


def laps(
    rng: np.random.Generator, travel: float, speeds: list[float], acceleration: float, count: int, period: float
) -> np.ndarray:
    """``count`` identical laps over ``travel`` [m]: each direction in as many strokes as there are ``speeds`` [m/s]."""
    pieces, here = [np.zeros(round(rng.uniform(0.05, 0.2) / period))], 0.0
    for direction in (1, -1):
        cuts = np.sort(rng.dirichlet(np.full(len(speeds), 4.0)).cumsum()[:-1]) * travel
        stops = [*cuts, travel] if direction > 0 else [*cuts[::-1], 0.0]
        for stop, speed in zip(stops, rng.permutation(speeds), strict=True):
            pieces.append(stroke(here, float(stop), float(speed), acceleration, period))
            here = float(stop)
            pieces.append(np.full(round(rng.uniform(0.0, 0.12) / period), here))
    return np.tile(np.concatenate(pieces), count)


def wander(
    rng: np.random.Generator, travel: float, speeds: list[float], acceleration: float, length: int, period: float
) -> np.ndarray:
    """Strokes to random places within ``travel`` [m] at random ``speeds`` [m/s]: nothing repeats."""
    pieces, here, samples = [np.zeros(round(rng.uniform(0.05, 0.2) / period))], 0.0, 0
    while samples < length:
        stop = rng.uniform(0.0, travel)
        if abs(stop - here) < 0.15 * travel:
            continue
        pieces.append(stroke(here, stop, rng.uniform(min(speeds), max(speeds)), acceleration, period))
        pieces.append(np.full(round(rng.uniform(0.0, 0.12) / period), stop))
        here, samples = stop, sum(piece.size for piece in pieces)
    return np.concatenate(pieces)[:length]


def multi_sine(rng: np.random.Generator, travel: float, acceleration: float, length: int, period: float) -> np.ndarray:
    """Random-phase multi-sine within ``travel`` [m], scaled down until ``acceleration`` [m/s^2] holds too."""
    t = np.arange(length) * period
    frequencies = rng.uniform(0.08, 0.9, 6)
    wave = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / f**0.8 for f in frequencies)
    wave *= np.clip(t / 2.0, 0, 1) ** 2 * (3 - 2 * np.clip(t / 2.0, 0, 1))
    peak = np.abs(np.diff(wave, 2)).max() / period**2
    wave *= min(travel / np.ptp(wave), acceleration / peak)
    return wave - wave[0] + max(0.0, -(wave - wave[0]).min())
