"""What the noise of a command is like: its prediction error filter, and its deviation, deaf to a few bursts."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_toeplitz

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # of the autoregressive model, by the information criterion
ROWS_PER_ORDER = 50


def whitening_filter(residual: np.ndarray, used: np.ndarray) -> tuple[float, ...]:
    """Coefficients in z^-1 of the filter that makes ``residual`` (n,) white, of the order that pays; (1,) for white.

    >>> white = np.random.default_rng(1).standard_normal(5000)
    >>> whitening_filter(white, np.ones(5000, bool))
    (1.0,)
    """
    e = np.where(used, residual, 0.0)
    n = int(used.sum())
    longest = min(max(ORDERS), n // ROWS_PER_ORDER)
    covariance = np.array([e[: len(e) - lag] @ e[lag:] for lag in range(longest + 1)]) / n
    if not covariance[0] > 0.0:
        return (1.0,)
    found, best = (1.0,), n * np.log(covariance[0])
    for order in (order for order in ORDERS if order <= longest):
        phi = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        left = max(covariance[0] - phi @ covariance[1 : order + 1], 1e-12 * covariance[0])
        criterion = n * np.log(left) + order * np.log(n)
        if criterion < best:
            found, best = (1.0, *(-phi).tolist()), criterion
    return found


def resolution(x: np.ndarray) -> float:
    """Step of which all values of ``x`` are multiples, 0 where there is none.

    >>> resolution(np.array([0.5, -1.0, 2.5])), resolution(np.array([0.0, 1.0, 1.3]))
    (0.5, 0.0)
    """
    values = np.unique(np.append(x, 0.0))
    step = float(np.min(np.diff(values), initial=np.inf, where=np.diff(values) > 1e-9 * np.ptp(values)))
    share = values / step
    return step if np.all(np.abs(share - np.round(share)) < 0.01) else 0.0


def usable_behind(used: np.ndarray, whitening: tuple[float, ...]) -> np.ndarray:
    """Samples (n,) for which the filter looks back on nothing that does not count."""
    return np.convolve(~used, np.ones(len(whitening)))[: used.size] < 0.5


def robust_deviation(x: np.ndarray) -> float:
    """Standard deviation of ``x`` from the median of its size."""
    return 1.4826 * float(np.median(np.abs(x - np.median(x))))
