"""Whole strokes and repeated laps of a record: what is fitted on, what selects, what repeats."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from emps_design.effects.sizes import TURN
from emps_design.records import Record

START_UP = 50  # samples left out at the start of a record: the loop's own transient, as in the published figures
FEWEST_STROKES, PARTS = 3, 4  # fewer strokes than that, of all records, are taken in so many parts each
MOST_TURNS = 12  # of a shaft that turns on and on: pieces that are whole strokes to it


@dataclass(frozen=True)
class Split:
    """Boundaries of strokes and laps [samples], and the samples that fit and that select, as boolean arrays.

    Laps alternate between fitting and selecting where there are more than three (the start of the first is left out),
    strokes otherwise, or parts of strokes where there are too few, so that whatever changes with time is seen by both.
    """

    strokes: tuple[tuple[int, int], ...]
    lap: int
    fit: np.ndarray
    select: np.ndarray

    @property
    def used(self) -> np.ndarray:
        """Samples that either fit or select."""
        return self.fit | self.select

    def until(self, stop: int) -> Split:
        """The same of the first ``stop`` samples."""
        strokes = tuple((start, min(end, stop)) for start, end in self.strokes if start < stop)
        return Split(strokes, self.lap, self.fit[:stop], self.select[:stop])


def split(record: Record, fit_share: np.ndarray | None = None, before: int = 0, parts: int = 1) -> Split:
    """Split ``record`` by whole strokes; ``fit_share`` (n,) bool limits what may be used at all.

    ``before`` is the number of strokes of the records before this one, so that single strokes take turns too; ``parts``
    into how many each is taken apart.
    """
    n = len(record)
    allowed = np.ones(n, bool) if fit_share is None else fit_share.copy()
    allowed[:START_UP] = False
    # Nor behind a gap, in which the model went its own way.
    allowed &= np.convolve(record.in_gap, np.ones(2 * START_UP + 1), "same") < 0.5
    strokes = find_strokes(record.q_ref, record.period)
    if parts > 1:
        strokes = tuple(part for start, stop in strokes for part in _parts(record.q, start, stop, parts))
    lap = find_lap(record.q_ref)
    laps = int(allowed.sum()) // lap if lap else 0
    fit = np.zeros(n, bool)
    if laps >= 3:
        fit = (np.arange(n) // lap) % 2 == 0
    else:
        for index, (start, stop) in enumerate(strokes):
            fit[start:stop] = (before + index) % 3 != 2
    return Split(strokes, lap, fit & allowed, ~fit & allowed)


def _parts(q: np.ndarray, start: int, stop: int, count: int) -> list[tuple[int, int]]:
    """``count`` parts of a stroke of ``q`` (n,), of as much time and travel together: a long rest tells little.

    >>> _parts(np.concatenate([np.arange(100.0), np.full(300, 99.0)]), 0, 400, 2)
    [(0, 80), (80, 400)]
    """
    travel = np.cumsum(np.abs(np.diff(q[start:stop], prepend=q[start])))
    spent = np.arange(stop - start) / (stop - start) + travel / max(float(travel[-1]), 1e-300)
    edges = [start, *(start + np.searchsorted(spent, spent[-1] * np.arange(1, count) / count)).tolist(), stop]
    return list(itertools.pairwise(edges))


def find_lap(q_ref: np.ndarray) -> int:
    """Return the number of samples after which ``q_ref`` (n,) [m] repeats itself, 0 where it does not within n/2."""
    n = q_ref.size
    centred = q_ref - q_ref.mean()
    energy = np.concatenate(([0.0], np.cumsum(centred**2)))
    spectrum = np.fft.rfft(centred, 2 * n)
    product = np.fft.irfft(spectrum * spectrum.conj(), 2 * n)[:n]
    lags = np.arange(n)
    difference = energy[n - lags] + (energy[n] - energy[lags]) - 2 * product
    mean_square = np.maximum(difference, 0.0) / (n - lags)
    limit = 1e-8 * centred.var()
    far = int(np.argmax(mean_square > 1e-2 * centred.var()))  # leave the neighbourhood of lag 0 first
    close = np.nonzero(mean_square[far : n // 2 + 1] < limit)[0]
    if far == 0 or close.size == 0:
        return 0
    first = far + int(close[0])
    last = first + int(np.argmax(np.append(np.diff(close[:50]) > 1, True)))
    return first + int(np.argmin(mean_square[first : last + 1]))


def find_strokes(q_ref: np.ndarray, period: float) -> tuple[tuple[int, int], ...]:
    """Cut where the reference (n,) [m] changes direction; standstill belongs to the stroke before it.

    A shaft that turns on and on the same way never does: there every piece of at least a turn, which meets the same
    places again, is a stroke.
    """
    velocity = np.gradient(q_ref, period)
    direction = np.sign(velocity) * (np.abs(velocity) > 1e-3 * np.abs(velocity).max())
    moving = np.nonzero(direction)[0]
    if moving.size == 0:
        return ((0, q_ref.size),)
    turns = moving[1:][np.diff(direction[moving]) != 0]
    edges = [0, *(int(turn) for turn in turns), q_ref.size]
    if len(edges) == 2:
        count = min(max(1, int(np.ptp(q_ref) / TURN)), MOST_TURNS)
        edges = np.linspace(0, q_ref.size, count + 1).astype(int).tolist()
    return tuple((a, b) for a, b in itertools.pairwise(edges) if b - a > 20)
