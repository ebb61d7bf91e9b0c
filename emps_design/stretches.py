"""Runs of true values in an array."""

from __future__ import annotations

import numpy as np


def stretches(holds: np.ndarray) -> list[tuple[int, int]]:
    """Start and stop index (exclusive) of each run of true values in ``holds`` (n,).

    >>> stretches(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
