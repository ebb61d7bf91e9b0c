"""Data-driven starting points for effects whose shape no short list of values covers: periods, instants, pulses.

Everything here looks at a force residual (n,) [N] of the inverse model, trusted where ``away`` (n,) is True, and only
proposes: the decision is made elsewhere, in closed loop.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

THINNED = 4000  # samples kept for a spectral search; structure up to the filter's band survives


def thin(away: np.ndarray, most: int = THINNED) -> np.ndarray:
    """Indices of at most ``most`` trusted samples, evenly spread."""
    trusted = np.nonzero(away)[0]
    return trusted[:: max(1, -(-trusted.size // most))]


def absorb(residual: np.ndarray, v: np.ndarray, a: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual at ``index`` free of what mass, friction and offset absorb; and an orthonormal basis (k, 4) of those."""
    columns = np.column_stack([a[index], v[index], np.sign(v[index]), np.ones(index.size)])
    scale = np.linalg.norm(columns, axis=0)
    basis = np.linalg.svd(columns[:, scale > 0] / scale[scale > 0], full_matrices=False)[0]
    kept = residual[index]
    return kept - basis @ (basis.T @ kept), basis


def explained(target: np.ndarray, basis: np.ndarray, pair: np.ndarray) -> float:
    """Sum of squares of ``target`` (k,) that the columns ``pair`` (k, c) explain beyond ``basis``."""
    free = pair - basis @ (basis.T @ pair)
    gram, right = free.T @ free, free.T @ target
    gram[np.diag_indices_from(gram)] += 1e-12 * np.trace(gram) + 1e-300
    return float(right @ np.linalg.solve(gram, right))


def strongest(power: np.ndarray, count: int) -> list[int]:
    """Indices of the ``count`` highest local maxima of ``power``, highest first."""
    inner = np.nonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:]))[0] + 1
    peaks = inner if inner.size else np.array([int(np.argmax(power))])
    return [int(i) for i in peaks[np.argsort(power[peaks])[::-1][:count]]]


def periods(
    residual: np.ndarray,
    coordinate: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    away: np.ndarray,
    columns: Callable[[np.ndarray, float], np.ndarray],
    shortest: float,
    count: int = 3,
) -> list[float]:
    """Periods of ``coordinate`` (n,) at which ``columns(index, period)`` (k, 2) explain most of ``residual``.

    Searched from the span of the coordinate down to ``shortest`` [unit of the coordinate], at half the resolution of
    the span.
    """
    index = thin(away)
    span = float(np.ptp(coordinate[index])) if index.size else 0.0
    if index.size < 100 or span <= shortest:
        return []
    target, basis = absorb(residual, v, a, index)
    wave_numbers = np.arange(1.0 / span, 1.0 / shortest, 0.5 / span)
    power = np.array([explained(target, basis, columns(index, 1.0 / k)) for k in wave_numbers])
    return [float(1.0 / wave_numbers[i]) for i in strongest(power, count)]


def instants(
    residual: np.ndarray,
    t: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    away: np.ndarray,
    after: Callable[[np.ndarray, float], np.ndarray],
    count: int = 3,
) -> list[float]:
    """Instants [s] from which on ``after(index, instant)`` (k, c) explains most of ``residual``."""
    index = thin(away, 2000)
    if index.size < 100:
        return []
    target, basis = absorb(residual, v, a, index)
    grid = np.linspace(t[index[0]], t[index[-1]], 62)[1:-1]
    power = np.array([explained(target, basis, after(index, instant)) for instant in grid])
    return [float(grid[i]) for i in strongest(power, count)]


def pulses(residual: np.ndarray, t: np.ndarray, period: float) -> list[dict[str, float]]:
    """Pulse trains (amplitude, start, duration, every) that ``residual`` (n,) [N] shows; strongest first.

    A pulse is a stretch in which the residual, averaged over 20 ms, stays beyond four robust deviations.
    """
    width = max(1, round(0.02 / period))
    smooth = np.convolve(residual - np.median(residual), np.ones(width) / width, mode="same")
    spread = 1.4826 * float(np.median(np.abs(smooth))) + 1e-12
    found: list[dict[str, float]] = []
    for sign in (1.0, -1.0):
        beyond = np.concatenate(([0], (sign * smooth > 4 * spread).astype(int), [0]))
        edges = np.diff(beyond)
        runs = [
            (a, b)
            for a, b in zip(np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0], strict=True)
            if (b - a) * period > 0.04
        ]
        if not runs:
            continue
        heights = [float(smooth[a:b].mean()) for a, b in runs]
        tallest = max(range(len(runs)), key=lambda i: abs(heights[i]) * (runs[i][1] - runs[i][0]))
        duration = (runs[tallest][1] - runs[tallest][0]) * period
        alike = [
            i
            for i, (a, b) in enumerate(runs)
            if abs(heights[i]) > 0.5 * abs(heights[tallest]) and 0.5 < (b - a) * period / duration < 2
        ]
        begins = [float(t[runs[i][0]]) for i in alike]
        gaps = np.diff(begins)
        every = float(np.median(gaps)) if gaps.size else 0.0
        pulse = {"amplitude": heights[tallest], "start": begins[0], "duration": duration}
        found.append({**pulse, "every": every})
        if every:
            found.append({**pulse, "start": float(t[runs[tallest][0]]), "every": 0.0})
    return sorted(found, key=lambda p: -abs(p["amplitude"]) * p["duration"])
