"""How certain an rms is: a bootstrap that keeps the correlation of what it redraws."""

from __future__ import annotations

import numpy as np

PIECE = 500  # samples drawn together in the mean
DRAWS = 199
ENDS = (0.025, 0.975)  # quantiles


def rms_interval(error: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """Interval that holds the rms of ``error`` (n,) with 95 %: stationary bootstrap of pieces of it.

    Pieces of random, geometrically distributed length begin anywhere in the record, closed to a ring (Politis and
    Romano, The stationary bootstrap, 1994). Only their sums of squares are wanted, so that no sample is drawn.

    >>> low, high = rms_interval(np.random.default_rng(0).standard_normal(20_000))
    >>> 0.97 < low < 1.0 < high < 1.03
    True
    """
    generator, n = np.random.default_rng(seed), error.size
    piece = min(PIECE, n // 4)
    lengths = generator.geometric(1 / piece, (DRAWS, 2 * (n // piece) + 50))  # more than fill the record
    ends = np.minimum(np.cumsum(lengths, axis=1), n)
    lengths = np.diff(ends, axis=1, prepend=0)
    begins = generator.integers(0, n, lengths.shape)
    squares = np.concatenate(([0.0], np.cumsum(np.tile(error**2, 2))))
    means = (squares[begins + lengths] - squares[begins]).sum(axis=1) / ends[:, -1]
    low, high = np.sqrt(np.quantile(means, ENDS))
    return float(low), float(high)
