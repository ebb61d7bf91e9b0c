"""Starting values from data, for shapes that no short list of values covers: periods, instants, pulses.

All functions take a force residual (n,) [N] of the inverse model, valid where ``away`` (n,) is True, and return
proposals, which are then fitted in closed loop.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from emps_design.stretches import stretches

SHARP = 2e-3  # s, resolution of the edges of pulses
THINNED = 3000  # samples used for a search: above 100 Hz for a 25 s record
MOST_PULSES = 100  # of a train; more are a periodic disturbance
CHUNK = 32  # wave numbers at a time, so that the arrays fit into the cache of the processor


def thin(away: np.ndarray, most: int = THINNED) -> np.ndarray:
    """Indices of at most ``most`` samples ``away`` from reversals, evenly spaced."""
    valid = np.nonzero(away)[0]
    return valid[:: max(1, -(-valid.size // most))]


def absorb(residual: np.ndarray, v: np.ndarray, a: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual (k,) at ``index`` without its projection on mass, friction and offset, and their orthonormal basis."""
    columns = np.column_stack([a[index], v[index], np.sign(v[index]), np.ones(index.size)])
    scale = np.linalg.norm(columns, axis=0)
    basis = np.linalg.svd(columns[:, scale > 0] / scale[scale > 0], full_matrices=False)[0]
    selected = residual[index]
    return selected - basis @ (basis.T @ selected), basis


def squares_explained(target: np.ndarray, basis: np.ndarray, sine: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Sum of squares (m,) of ``target`` (k,) that each pair of columns of ``sine`` and ``cosine`` (k, m) explains.

    ``target`` is orthogonal to the orthonormal ``basis`` (k, 4); the part of the pairs in its span does not count.
    """
    inside = basis.T @ sine, basis.T @ cosine
    whole = sine, cosine

    def product(i: int, j: int) -> np.ndarray:  # of the parts orthogonal to the basis
        return np.einsum("km,km->m", whole[i], whole[j]) - np.einsum("km,km->m", inside[i], inside[j])

    aa, bb, ab = product(0, 0), product(1, 1), product(0, 1)
    ra, rb = target @ sine, target @ cosine
    determinant = aa * bb - ab**2
    safe = determinant > 1e-9 * (aa * bb) + 1e-300
    power = (ra**2 * bb - 2 * ra * rb * ab + rb**2 * aa) / np.where(safe, determinant, 1.0)
    return np.where(safe, power, 0.0)


# Both columns (k, m) of some samples (k,) and angular wave numbers (m,), whose sine and cosine (k, m) are given.
Waves = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


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
    columns: Waves,
    shortest: float,
    count: int = 3,
) -> list[float]:
    """Periods of ``coordinate`` (n,) at which ``columns`` explain most of ``residual``.

    ``columns(index, waves, sine, cosine)`` returns the two columns of each angular wave number, shape (k, m) both. The
    search goes from the span of the coordinate down to ``shortest`` [unit of the coordinate], in steps of half the
    resolution of the span.
    """
    index = thin(away)
    span = float(np.ptp(coordinate[index])) if index.size else 0.0
    if index.size < 100 or span <= shortest:
        return []
    target, basis = absorb(residual, v, a, index)
    turns = np.arange(1.0 / span, 1.0 / shortest, 0.5 / span)
    power = np.empty(turns.size)
    angle = 2 * np.pi * coordinate[index][:, None]
    first = np.exp(1j * angle * turns[:CHUNK])
    for start in range(0, turns.size, CHUNK):  # the waves of a chunk are those of the first one, shifted in phase
        piece = slice(start, start + CHUNK)
        shifted = first[:, : turns[piece].size] * np.exp(1j * angle * (turns[start] - turns[0]))
        phases = np.ascontiguousarray(shifted.imag), np.ascontiguousarray(shifted.real)
        power[piece] = squares_explained(target, basis, *columns(index, 2 * np.pi * turns[piece], *phases))
    return [float(1.0 / turns[i]) for i in strongest(power, count)]


def instants(
    residual: np.ndarray,
    t: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    away: np.ndarray,
    column: np.ndarray,
) -> list[float]:
    """The three instants [s] from which on ``column`` (n,) explains most of ``residual``."""
    index = thin(away)
    if index.size < 100:
        return []
    target, basis = absorb(residual, v, a, index)

    def power(grid: np.ndarray) -> np.ndarray:
        after = np.where(t[index][:, None] > grid, column[index][:, None], 0.0)
        free = after - basis @ (basis.T @ after)
        size = (free**2).sum(axis=0)
        return np.where(size > 0, (target @ free) ** 2 / np.where(size > 0, size, 1.0), 0.0)

    coarse = np.linspace(t[index[0]], t[index[-1]], 62)
    step, edges = coarse[1] - coarse[0], []
    for best in strongest(power(coarse[1:-1]), 3):  # refined to a fiftieth of the step: an edge has no gradient
        fine = coarse[1 + best] + np.linspace(-step, step, 101)
        edges.append(float(fine[int(np.argmax(power(fine)))]))
    return edges


def pulses(residual: np.ndarray, t: np.ndarray, period: float) -> list[dict[str, float]]:
    """Pulse trains (amplitude, start, duration, every) in ``residual`` (n,) [N], the strongest first.

    A pulse is an interval in which the residual, averaged over 20 ms, exceeds four robust standard deviations.
    """
    width = max(1, round(0.02 / period))
    smooth = np.convolve(residual - np.median(residual), np.ones(width) / width, mode="same")
    spread = 1.4826 * float(np.median(np.abs(smooth))) + 1e-12
    trains: list[dict[str, float]] = []
    for sign in (1.0, -1.0):
        runs = [(a, b) for a, b in stretches(sign * smooth > 4 * spread) if (b - a) * period > 0.04]
        if not runs:
            continue
        heights = [float(smooth[a:b].mean()) for a, b in runs]
        tallest = max(range(len(runs)), key=lambda i: abs(heights[i]) * (runs[i][1] - runs[i][0]))
        duration = (runs[tallest][1] - runs[tallest][0]) * period
        same = [
            i
            for i, (a, b) in enumerate(runs)
            if abs(heights[i]) > 0.5 * abs(heights[tallest]) and 0.5 < (b - a) * period / duration < 2
        ]
        begins = [float(t[runs[i][0]]) for i in same]
        gaps = np.diff(begins)
        pulse = {"amplitude": heights[tallest], "start": begins[0], "duration": duration}
        # If some pulses are not found, the shortest interval between two is the period.
        intervals = {float(np.median(gaps)), float(gaps.min())} if gaps.size else set()
        trains += [{**pulse, "every": every} for every in sorted(intervals)]
        trains.append({**pulse, "start": float(t[runs[tallest][0]]), "every": 0.0})
    trains = [pulse for pulse in trains if not pulse["every"] or t[-1] - pulse["start"] < MOST_PULSES * pulse["every"]]
    area = np.concatenate(([0.0], np.cumsum(residual - np.median(residual)))) * period
    trains = [_refined_train(pulse, area, t, period) for pulse in trains]
    return sorted(trains, key=lambda p: -abs(p["amplitude"]) * p["duration"])


def _refined_train(pulse: dict[str, float], area: np.ndarray, t: np.ndarray, period: float) -> dict[str, float]:
    """The train near ``pulse`` that best fits the signal with the integral ``area`` (n + 1,).

    If friction hides the edge of a pulse, the first estimate of its edges is wrong, and so are all later pulses.
    """
    start, every, length = pulse["start"], pulse["every"], pulse["duration"]
    least = max(length, (t[-1] - start) / MOST_PULSES)  # pulses do not overlap
    for step in (5 * SHARP, SHARP):
        reach = step * np.arange(-12, 13)
        intervals = np.maximum(every + reach, least) if every else np.zeros(1)
        s, e, d = np.meshgrid(start + reach, intervals, np.maximum(length + reach, 4 * step), indexing="ij")
        d = np.minimum(d, e) if every else d
        inside, total = np.zeros(s.shape), np.zeros(s.shape)
        for k in range(int((t[-1] - start) / every) + 1 if every else 1):
            begin = np.clip(np.rint((s + k * e - t[0]) / period).astype(int), 0, t.size)
            end = np.clip(np.rint((s + k * e + d - t[0]) / period).astype(int), 0, t.size)
            total += area[end] - area[begin]
            inside += (end - begin) * period
        best = np.unravel_index(np.argmax(total**2 / np.maximum(inside, period)), s.shape)
        start, every, length = float(s[best]), float(e[best]), float(d[best])
        height = float(total[best] / max(float(inside[best]), period))
    return {"amplitude": height, "start": max(start, 0.0), "duration": length, "every": every}
