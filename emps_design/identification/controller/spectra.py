"""Cross spectra of a record in bands, on which timing, form and filters are tried without touching the samples again.

A filter multiplies the regressors' spectra, a delay turns them, and both are nearly constant over a band. So the
squares that a candidate leaves are a sum over some hundred bands. Spectra are those of first differences over
``1 - z^-1``: a record need not end where it began, and its mean does not count. What is found here starts :mod:`.fit`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import next_fast_len, rfft

from emps_design.identification.controller.filters import Filter
from emps_design.identification.controller.regressors import COLUMNS, SAMPLED, Signals, Timing
from emps_design.identification.controller.structures import Structure
from emps_design.laws.estimators import estimator_at

BANDS = 200
RIDGE = 1e-11  # of the scaled normal equations, where gains cannot be told apart
SCAN = 31  # integral rates tried, from so small that it does nothing on


@dataclass(frozen=True)
class Spectra:
    """Cross spectra in bands about ``z`` (n_bands,) on the unit circle: ``regressors`` (n_bands, n_columns^2), real,
    ``answer`` (n_bands, n_columns), of the regressors with the command, ``power`` (n_bands,) of the command; ``counts``
    (n_bands,) frequencies in each; ``position`` (n_bands, n_columns) how regressors answer to the position."""

    z: np.ndarray
    regressors: np.ndarray
    answer: np.ndarray
    power: np.ndarray
    counts: np.ndarray
    position: np.ndarray
    samples: int
    period: float

    @cached_property
    def back(self) -> np.ndarray:
        """``z`` to the powers 0, -1 and -2, (3, n_bands)."""
        return np.stack([np.ones_like(self.z), 1.0 / self.z, self.z**-2])


def transform(signals: Signals, columns: np.ndarray) -> np.ndarray:
    """Spectra (n_frequencies, n_columns) of ``columns`` (n, n_columns), without frequency 0, whitened."""
    columns = columns[int(np.argmax(signals.used)) :]
    n = next_fast_len(len(columns), real=True)
    steps = np.diff(columns, axis=0, prepend=columns[:1])
    steps[0] += columns[0] * np.all(columns == columns[0], axis=0)
    values = rfft(steps, n, axis=0)[1:]
    z = np.exp(2j * np.pi * np.arange(1, len(values) + 1) / n)
    weight = np.polyval(signals.whitening[::-1], 1.0 / z) / (1.0 - 1.0 / z) * np.sqrt(2.0 / n)
    return values * weight[:, None]


def bands(n: int) -> np.ndarray:
    """First frequency of each band out of ``n``: as wide as their distance from 0 allows."""
    return np.unique(np.concatenate([[0], np.geomspace(1, n, BANDS), np.linspace(1, n, BANDS)]).astype(int))[:-1]


def cross(
    signals: Signals, values: np.ndarray, command: np.ndarray, timing: Timing, like: Spectra | None = None
) -> Spectra:
    """Cross spectra of ``values`` (n_frequencies, n_columns) among one another and with the ``command``'s.

    Those ``like`` them differ in the samples of the position loop alone, and so in few columns.
    """
    edges, width = bands(len(values)), len(COLUMNS)
    new = width if like is None else SAMPLED
    products = (values[:, :new, None].conj() * values[:, None, :]).real.reshape(len(values), -1)
    both = np.add.reduceat(products, edges).reshape(-1, new, width)
    answer = np.add.reduceat(values[:, :new].conj() * command[:, None], edges)
    if like is not None:
        whole = like.regressors.reshape(-1, width, width).copy()
        whole[:, :new], whole[:, :, :new] = both, both.transpose(0, 2, 1)
        both, answer = whole, np.column_stack([answer, like.answer[:, new:]])
    middle = 0.5 * (edges + np.append(edges[1:], len(values)) + 1)
    samples = len(signals) - int(np.argmax(signals.used))
    z = np.exp(2j * np.pi * middle / next_fast_len(samples, real=True))
    power = np.add.reduceat(np.abs(command) ** 2, edges)
    counts = np.diff(np.append(edges, len(values)))
    position = position_response(z, signals.period, timing, signals.velocity_reference)
    return Spectra(z, both.reshape(len(edges), -1), answer, power, counts, position, samples, signals.period)


def position_response(z: np.ndarray, period: float, timing: Timing, velocity_reference: bool) -> np.ndarray:
    """How each regressor answers to the position at ``z`` (n_bands,), (n_bands, n_columns); a hold counts as none."""
    rate = estimator_at(timing.velocity_estimator, 1.0 / z, period) * (1.0 - 1.0 / z) / period
    total = period / (1.0 - 1.0 / z)
    error = np.zeros_like(z) if velocity_reference else -np.ones_like(z)
    none = np.zeros_like(z)
    return np.stack([error, error * total, -rate, -rate * total, rate, rate * total, none, none, none, none], axis=1)


def response(filters: tuple[Filter, ...], s: Spectra, delay: int) -> np.ndarray:
    """Frequency response (n_bands,) of the filters and the delay."""
    total = s.z ** (-float(delay))
    for one in filters:
        top, bottom = one.coefficients(s.period)
        powers = s.back[: len(top)]
        total = total * (top @ powers) / (bottom @ powers)
    return total


def normal(s: Spectra, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the regressors behind the responses ``h`` (..., n_bands)."""
    width = len(COLUMNS)
    return (np.abs(h) ** 2 @ s.regressors).reshape(*h.shape[:-1], width, width), (h.conj() @ s.answer).real


def least(
    s: Spectra, equations: tuple[np.ndarray, np.ndarray], structure: Structure, wi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Squares left (m,) and linear coefficients (m, n_linear) at the integral rates ``wi`` (m,).

    The normal ``equations`` are one for all, or one for each.
    """
    gram, answer = equations
    combine = structure.combination(wi)
    turned = combine.transpose(0, 2, 1)
    g = turned @ gram @ combine
    a = (turned @ answer[..., None])[..., 0]
    scale = np.sqrt(np.maximum(np.einsum("mii->mi", g), 1e-300))
    g = g / scale[:, :, None] / scale[:, None, :] + RIDGE * np.eye(g.shape[1])
    a = a / scale
    found = np.linalg.solve(g, a[..., None])[..., 0]
    return np.maximum(s.power.sum() - np.einsum("mi,mi->m", found, a), 1e-14 * s.power.sum()), found / scale


def squares_and_slopes(
    s: Spectra, filters: tuple[Filter, ...], delay: int, structure: Structure, wi: float
) -> tuple[float, np.ndarray]:
    """Squares left, and their slopes (1 + n_numbers,) over the logarithm of ``wi`` and the numbers of the filters.

    The linear coefficients are at their best: to first order it does not matter how they move.
    """
    h = response(filters, s, delay)
    gram, answer = normal(s, h)
    squares, linear = least(s, (gram, answer), structure, np.array([wi]))
    beta = structure.combination(wi) @ linear[0]
    by_rate = (beta - structure.combination(0.0) @ linear[0]) @ (gram @ beta - answer)
    by_response = np.abs(h) ** 2 * _explained(s, beta) - h * (s.answer @ beta).conj()
    slopes = [by_rate]
    for one in filters:
        top, bottom = one.coefficients(s.period)
        powers = s.back[: len(top)]
        over_top, over_bottom = by_response / (top @ powers), by_response / (bottom @ powers)
        slopes += [float((t @ powers @ over_top - b @ powers @ over_bottom).real) for t, b in one.slopes(s.period)]
    return float(squares[0]), 2.0 * np.array(slopes)


def coloured(s: Spectra, h: np.ndarray, beta: np.ndarray) -> float:
    """Squares left, weighed as for noise that is white on the recorded position instead of on the command.

    Rounded once more than the controller saw it, a position leaves such a residual, coloured by the law itself.
    """
    left = s.power - 2.0 * (h.conj() * (s.answer @ beta)).real + np.abs(h) ** 2 * _explained(s, beta)
    shape = np.maximum(np.abs(h * (s.position @ beta)) ** 2, 1e-300)
    shape = shape / np.exp(np.average(np.log(shape), weights=s.counts))
    return float(max(np.sum(np.maximum(left, 0.0) / shape), 1e-14 * s.power.sum()))


def _explained(s: Spectra, beta: np.ndarray) -> np.ndarray:
    """Power (n_bands,) of the regressors' combination ``beta`` (n_columns,), before any filter."""
    return s.regressors @ np.outer(beta, beta).ravel()


def rates(s: Spectra) -> np.ndarray:
    """Integral rates to try [1/s]."""
    return np.geomspace(1e-3 / (s.samples * s.period), 0.3 / s.period, SCAN)
