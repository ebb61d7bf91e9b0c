"""Stretches of true values."""

from __future__ import annotations

import numpy as np


def stretches(holds: np.ndarray) -> list[tuple[int, int]]:
    """First place and the one after the last of each stretch of true values of ``holds`` (n,).

    >>> stretches(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
