"""Standard deviations for residuals that are correlated from sample to sample.

Equation (15) takes every sample as an independent observation. Three estimates do not: the long-run covariance of an
autoregressive model of the residual (which the intervals use), the heteroscedasticity and autocorrelation consistent
(HAC) sandwich with a given lag, and a block bootstrap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from emps_design.errors import InputError
from emps_design.identification.filters import BLOCK

LARGEST_ORDER = 4
ROWS_PER_ORDER = 20
LAGS = LARGEST_ORDER + 1  # of the residual's autocovariance, zero among them
CORRECTIONS = 8  # iterations that correct it for the regression and for gaps
LEAST_PAIRS = 0.2  # of the rows: least share with a partner at a lag
NEGLIGIBLE = 1e-4  # share of the variance at which a model's autocovariance is cut


@dataclass(frozen=True)
class LongRun:
    """Covariance of an estimate, and the correlation of its residual.

    ``covariance`` (p, p); ``autocovariance`` of the noise at the first lags; ``order`` of its autoregressive model;
    ``correlation_time`` [s] the integral time scale of the residual; ``effective_samples`` how many independent
    observations the record amounts to; ``quantile`` of Student's t that makes the 95 % interval.
    """

    covariance: np.ndarray
    autocovariance: np.ndarray
    order: int
    correlation_time: float
    effective_samples: float
    quantile: float

    @property
    def std(self) -> np.ndarray:
        """Standard deviations, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    def to_dict(self) -> dict[str, Any]:
        """The correlation of the residual, as plain data."""
        return {
            "autoregressive_order": self.order,
            "correlation_time": self.correlation_time,
            "effective_samples": self.effective_samples,
            "quantile_95": self.quantile,
        }


def long_run(
    W: np.ndarray, residual: np.ndarray, used: np.ndarray, period: float, Z: np.ndarray | None = None
) -> LongRun:
    """Covariance of least squares (or of the instruments ``Z``) when the residual is autoregressive.

    ``W``, ``Z`` (n, p) and ``residual`` (n,) are sampled with ``period`` [s]; unused rows are zero and False in
    ``used`` (n,). The autocovariance of the residual is corrected for the share that the p parameters absorb; the
    order, 1 to 4, has the least Akaike criterion. The long-run variance of an AR(p) model has a relative variance of
    about 4 p / n_eff, so Student's t has n_eff / (2 p) degrees of freedom. Rows must not be closer than the filter
    resolves, or the model describes the filter.

    >>> white = np.random.default_rng(0).standard_normal(4000)
    >>> statistics = long_run(np.ones((4000, 1)), white - white.mean(), np.ones(4000, dtype=bool), 1.0)
    >>> round(float(statistics.std[0]) * 4000**0.5, 1), statistics.effective_samples > 3000
    (1.0, True)
    """
    Z = W if Z is None else Z
    n = int(used.sum())
    if n < ROWS_PER_ORDER:
        raise InputError(f"statistics: found {n} usable rows, expected at least {ROWS_PER_ORDER}; record longer")
    sample = autocovariance(residual, n)
    pairs = autocovariance(used.astype(float), n)  # share of the rows with a used partner at each lag
    orders = range(1, min(LARGEST_ORDER, n // ROWS_PER_ORDER) + 1)
    order = min(orders, key=lambda p: n * np.log(autoregression(sample, p)[1]) + 2 * p)
    model = _model(sample, order, len(residual))
    basis, sample_of_noise = np.linalg.qr(W)[0], sample
    for _ in range(CORRECTIONS):
        corrected = (sample + _absorbed(model, basis, used, n)) / np.maximum(pairs, LEAST_PAIRS)
        try:
            model, sample_of_noise = _model(corrected, order, len(residual)), corrected
        except ArithmeticError:
            break  # the corrected autocovariance has no stationary model: keep the previous one
    bread = np.linalg.inv(Z.T @ W)
    integral = max(1.0, 1.0 + 2.0 * float(np.sum(model[1:])) / float(model[0]))
    return LongRun(
        covariance=bread @ (Z.T @ _convolve(model, Z)) @ bread.T,
        autocovariance=sample_of_noise,
        order=order,
        correlation_time=0.5 * period * integral,
        effective_samples=n / integral,
        quantile=float(scipy.stats.t.ppf(0.975, max(n / integral / (2 * order), 2.0))),
    )


def hac_covariance(W: np.ndarray, residual: np.ndarray, lag: int, Z: np.ndarray | None = None) -> np.ndarray:
    """HAC covariance (Newey and West, Bartlett weights over ``lag`` rows) of least squares or instruments, (p, p).

    Unused rows are zero, so that lags are distances in time.

    >>> hac_covariance(np.ones((4, 1)), np.array([1.0, -1.0, 1.0, -1.0]), lag=0).tolist()
    [[0.25]]
    """
    Z = W if Z is None else Z
    bread, meat = np.linalg.inv(Z.T @ W), np.zeros((W.shape[1], W.shape[1]))
    # Block by block, each with the ``lag`` rows before it: the products of an hour would not fit into memory.
    for start in range(0, len(Z), BLOCK):
        first = max(0, start - lag)
        products = Z[first : start + BLOCK] * residual[first : start + BLOCK, None]
        meat += _bartlett_sum(products, lag)
        if start > first:
            meat -= _bartlett_sum(products[: start - first], lag)
    return bread @ meat @ bread.T


def _bartlett_sum(rows: np.ndarray, lag: int) -> np.ndarray:
    """Sum (p, p) of products of ``rows`` (n, p) up to ``lag`` rows apart, with Bartlett weights.

    Two rows share ``lag + 1 - distance`` of all windows of ``lag + 1`` rows, which is Bartlett's weight: so the sum is
    the product of the windows' sums with themselves. Agrees with ``S_hac_simple`` of statsmodels.
    """
    total, none = np.cumsum(rows, axis=0), np.zeros((lag + 1, rows.shape[1]))
    windows = np.vstack([total, np.repeat(total[-1:], lag, axis=0)]) - np.vstack([none, total])[:-1]
    return windows.T @ windows / (lag + 1.0)


def residual_bootstrap(
    W: np.ndarray, residual: np.ndarray, used: np.ndarray, spread: LongRun, draws: int = 500, seed: int = 0
) -> np.ndarray:
    """Covariance (p, p) of least squares over ``draws`` noise sequences redrawn from the residual, with W fixed.

    Sieve bootstrap (P. Buehlmann, 1997): the innovations of the autoregressive model of ``spread`` are redrawn in
    blocks (Politis and Romano; ``arch``) and filtered by the model again, so that noise slower than a block keeps its
    correlation. W stays, for the reference determines it, not chance.

    >>> W, e = np.ones((400, 1)), np.random.default_rng(0).standard_normal(400)
    >>> used = np.ones(400, dtype=bool)
    >>> spread = long_run(W, e - e.mean(), used, 1.0)
    >>> round(float(residual_bootstrap(W, e - e.mean(), used, spread)) ** 0.5, 2)
    0.05
    """
    from arch.bootstrap import StationaryBootstrap

    phi, variance = autoregression(spread.autocovariance, spread.order)
    whiten = np.concatenate([[1.0], -phi])
    # Only rows whose predecessors in the model were all used.
    whole = np.convolve(~used, np.ones(spread.order + 1))[: len(used)] < 0.5
    innovations = scipy.signal.lfilter(whiten, [1.0], residual)[whole]
    innovations -= innovations.mean()
    innovations *= np.sqrt(variance / np.mean(innovations**2))
    solve = np.linalg.solve(W.T @ W, W.T)
    source = StationaryBootstrap(LARGEST_ORDER, innovations, seed=seed)
    settled = len(_model(spread.autocovariance, spread.order, len(residual)))
    estimates = []
    redrawn = source.bootstrap(-(-draws * (settled + len(residual)) // len(innovations)))
    buffer = np.zeros(0)
    for _ in range(draws):
        while len(buffer) < settled + len(residual):
            buffer = np.concatenate([buffer, next(redrawn)[0][0]])
        drawn, buffer = np.split(buffer, [settled + len(residual)])
        estimates.append(solve @ (scipy.signal.lfilter([1.0], whiten, drawn)[settled:] * used))
    return np.cov(np.array(estimates), rowvar=False)


def autocovariance(signal: np.ndarray, n: int, lags: int = LAGS) -> np.ndarray:
    """Autocovariance (lags,) of ``signal``, of whose samples ``n`` count and the others are zero.

    Divided by n at every lag: slightly biased towards zero, but always that of a stationary process.

    >>> autocovariance(np.array([1.0, 2.0, 3.0]), 3, 2).round(2).tolist()
    [4.67, 2.67]
    """
    return np.array([signal[: len(signal) - lag] @ signal[lag:] for lag in range(lags)]) / n


def _absorbed(model: np.ndarray, basis: np.ndarray, used: np.ndarray, n: int) -> np.ndarray:
    """Autocovariance that a regression onto ``basis`` removes from noise with autocovariance ``model``."""
    coloured = _convolve(model, basis) * used[:, None]
    back = basis @ (basis.T @ coloured)
    taken = []
    for lag in range(LAGS):
        head, tail = slice(0, len(basis) - lag), slice(lag, None)
        pairs = ((basis[head], coloured[tail]), (coloured[head], basis[tail]), (basis[head], back[tail]))
        once, mirrored, twice = (float(np.einsum("ij,ij->", *pair)) for pair in pairs)
        taken.append(once + mirrored - twice)
    return np.array(taken) / n


def autoregression(covariance: np.ndarray, order: int) -> tuple[np.ndarray, float]:
    """Coefficients (order,) of the autoregressive model with this autocovariance, and its innovations' variance.

    By the equations of Yule and Walker.

    >>> coefficients, variance = autoregression(np.array([2.0, 1.0]), 1)
    >>> coefficients.tolist(), variance
    ([0.5], 1.5)
    """
    phi = scipy.linalg.solve_toeplitz(covariance[:order], covariance[1 : order + 1])
    predicted = phi @ covariance[1 : order + 1]
    return phi, max(float(covariance[0] - predicted), 1e-12 * float(covariance[0]) + 1e-300)


def _model(covariance: np.ndarray, order: int, n: int) -> np.ndarray:
    """Autocovariance of the autoregressive model, up to where it is negligible; ArithmeticError if not stationary."""
    phi, _ = autoregression(covariance, order)
    slowest = float(np.max(np.abs(np.roots(np.concatenate([[1.0], -phi])))))
    if not slowest < 1.0:
        raise ArithmeticError("not stationary")
    length = int(min(n, max(order + 1, np.ceil(np.log(NEGLIGIBLE) / np.log(max(slowest, 1e-3))))))
    known = covariance[:order]
    denominator = np.concatenate([[1.0], -phi])
    state = scipy.signal.lfiltic([1.0], denominator, known[::-1])
    rest, _ = scipy.signal.lfilter([1.0], denominator, np.zeros(max(length - order, 0)), zi=state)
    return np.concatenate([known, rest])


def _convolve(model: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Product of the Toeplitz matrix of ``model`` with ``columns`` (n, p), without the matrix."""
    size = scipy.fft.next_fast_len(len(columns) + len(model) - 1, real=True)  # long enough against circular wrap-around
    kernel = np.zeros(size)
    kernel[: len(model)] = model
    kernel[size - len(model) + 1 :] = model[:0:-1]
    spectrum = scipy.fft.rfft(kernel)
    return np.column_stack(
        [scipy.fft.irfft(spectrum * scipy.fft.rfft(column, size), size)[: len(columns)] for column in columns.T]
    )
