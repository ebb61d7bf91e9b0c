"""The transfer function of a sampled system in state space, at points of the z plane."""

from __future__ import annotations

from typing import Any

import numpy as np

AT_ONCE = 100_000  # systems solved together


def transfer(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: Any, z: np.ndarray) -> np.ndarray:
    """Return ``c (z I - A)^-1 b + d`` at ``z`` of any shape: (..., n, n), (..., n), (..., n), (...) -> (..., *z.shape).

    >>> delay = transfer(np.zeros((1, 1)), np.ones(1), np.ones(1), 0.0, np.array([1j, -1.0]))
    >>> bool(np.allclose(delay, [-1j, -1.0]))
    True
    """
    if A.ndim > 2 and len(A) > 1 and len(A) * z.size > AT_ONCE:  # in pieces that fit into memory
        half = len(A) // 2
        return np.concatenate([transfer(A[i], b[i], c[i], d[i], z) for i in (slice(half), slice(half, None))])
    systems = z.reshape(-1, 1, 1) * np.eye(A.shape[-1]) - A[..., None, :, :]
    columns = np.broadcast_to(b[..., None, :, None], (*systems.shape[:-1], 1))
    found = np.sum(c[..., None, :] * np.linalg.solve(systems, columns)[..., 0], axis=-1) + np.asarray(d)[..., None]
    return found.reshape(*found.shape[:-1], *z.shape)
