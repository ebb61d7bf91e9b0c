"""How certain an rms is: a bootstrap that keeps the correlation of what it redraws."""

from __future__ import annotations

import numpy as np

PIECE = 500  # samples drawn together in the mean
DRAWS = 199
ENDS = (0.025, 0.975)  # quantiles


def rms_interval(error: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """Interval that holds the rms of ``error`` (n,) with 95 %: stationary bootstrap of pieces of it (``arch``).

    >>> low, high = rms_interval(np.random.default_rng(0).standard_normal(20_000))
    >>> 0.97 < low < 1.0 < high < 1.03
    True
    """
    from arch.bootstrap import StationaryBootstrap

    means = StationaryBootstrap(min(PIECE, error.size // 4), error**2, seed=seed).apply(np.mean, DRAWS)
    low, high = np.sqrt(np.quantile(means, ENDS))
    return float(low), float(high)
