"""Filters of the command, in discrete time: coefficients by the bilinear transform without prewarping.

A filter is a kind and the numbers that are sought: logarithms, so that no step leaves what a filter can be; the depth
of a notch is taken as it is, for it may be 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.signal import lfilter

# What a filter that is sought can be. Beyond half the sampling frequency a low-pass does nothing that shows.
CORNER = {"lowpass": (1e-4, 0.6), "notch": (1e-4, 0.48)}  # of the sampling frequency
DAMPING, DEPTH = (0.01, 2.0), (-0.3, 1.0)  # a depth below 0 is no notch: it is noise about 0, and said to be 0
STEP = 1e-4  # of a sought number, for its derivative


@dataclass(frozen=True)
class Filter:
    """One filter: ``kind`` "lowpass" (log frequency) or "notch" (log frequency, log damping, depth); in Hz."""

    kind: str
    numbers: tuple[float, ...]

    @classmethod
    def lowpass(cls, frequency: float) -> Filter:
        """The low-pass w0/(s + w0) of a ``frequency`` [Hz]."""
        return cls("lowpass", (float(np.log(frequency)),))

    @classmethod
    def notch(cls, frequency: float, damping: float, depth: float) -> Filter:
        """The notch of a ``frequency`` [Hz], a ``damping`` and a ``depth``, its gain at that frequency."""
        return cls("notch", (float(np.log(frequency)), float(np.log(damping)), float(depth)))

    def within(self, period: float) -> tuple[tuple[float, float, float], ...]:
        """Each sought number, with the bounds of what it can be at this ``period`` [s]."""
        return tuple((x, low, high) for x, (low, high) in zip(self.numbers, _bounds(self.kind, period), strict=False))

    @property
    def frequency(self) -> float:
        """Corner or centre frequency [Hz]."""
        return float(np.exp(self.numbers[0]))

    def table(self) -> dict[str, Any]:
        """The filter as in an axis file."""
        return {"kind": self.kind, **dict(zip(self.names, self.values, strict=True))}

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

        >>> b, a = Filter.lowpass(100.0).coefficients(1e-3)
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
        """How numerator and denominator in z^-1 change with each sought number.

        >>> low = Filter.lowpass(100.0)
        >>> (numerator, denominator), = low.slopes(1e-3)
        >>> further = Filter("lowpass", (low.numbers[0] + 1e-6,)).coefficients(1e-3)
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
    """What the sought numbers of a filter can be at this ``period`` [s]."""
    lowest, highest = (float(np.log(share / period)) for share in CORNER[kind])
    return (lowest, highest), (float(np.log(DAMPING[0])), float(np.log(DAMPING[1]))), DEPTH


def moved(filters: tuple[Filter, ...], steps: np.ndarray, period: float) -> tuple[Filter, ...]:
    """The ``filters`` with their numbers changed by ``steps``, kept within what a filter can be at this ``period``."""
    left, done = iter(steps), []
    for one in filters:
        numbers = [min(max(x + next(left), low), high) for x, low, high in one.within(period)]
        done.append(Filter(one.kind, tuple(map(float, numbers))))
    return tuple(done)


def filtered(filters: tuple[Filter, ...], columns: np.ndarray, period: float) -> np.ndarray:
    """``columns`` (n, ...) through the ``filters`` in order, which stood still at the first row before it."""
    first = columns[:1]
    rest = columns - first
    for one in filters:
        rest = lfilter(*one.coefficients(period), rest, axis=0)
    return rest + first


def derivatives(filters: tuple[Filter, ...], x: np.ndarray, period: float) -> np.ndarray:
    """How ``x`` (n,) behind the filters changes with each sought number, (n, n_numbers)."""
    columns = []
    for i, one in enumerate(filters):
        for j, number in enumerate(one.numbers):
            ends = []
            for step in (STEP, -STEP):
                moved = Filter(one.kind, (*one.numbers[:j], number + step, *one.numbers[j + 1 :]))
                ends.append(filtered((*filters[:i], moved, *filters[i + 1 :]), x, period))
            columns.append((ends[0] - ends[1]) / (2 * STEP))
    return np.column_stack(columns) if columns else np.zeros((x.size, 0))
