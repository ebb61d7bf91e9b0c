"""The transfer function of a sampled system in state space, at points of the z plane."""

from __future__ import annotations

from typing import Any

import numpy as np

AT_ONCE = 100_000  # systems solved together
ROUNDING = 32.0 * np.finfo(float).eps  # share of its size by which a coefficient is not known


def transfer(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: Any, z: np.ndarray) -> np.ndarray:
    """Return ``c (z I - A)^-1 b + d`` at ``z`` of any shape: (..., n, n), (..., n), (..., n), (...) -> (..., *z.shape).

    >>> delay = transfer(np.zeros((1, 1)), np.ones(1), np.ones(1), 0.0, np.array([1j, -1.0]))
    >>> bool(np.allclose(delay, [-1j, -1.0]))
    True
    """
    if A.ndim == 2 and b.ndim == c.ndim == 1 and np.size(z) == 1:  # a search goes from point to point
        state = np.linalg.solve(np.reshape(z, ()) * np.eye(b.size) - A, b)
        return np.reshape(np.sum(c * state) + d, np.shape(z))
    return transfers(A, b, c[None], np.asarray(d)[None], z)[0]


def transfers(A: np.ndarray, b: np.ndarray, C: np.ndarray, D: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return :func:`transfer` for each of several ``C`` (o, ..., n) and ``D`` (o, ...), from systems solved once."""
    if A.ndim == 3 and len(A) > 1:
        alike = _alike(A, b)
        if alike is not None:
            return _of_alike(A[0], b[0], *alike, C, D, z)
        if len(A) * z.size > AT_ONCE:  # in pieces that fit into memory
            half = len(A) // 2
            pieces = [transfers(A[i], b[i], C[:, i], D[:, i], z) for i in (slice(half), slice(half, None))]
            return np.concatenate(pieces, axis=1)
    states = _solved(A, b[..., None], z)[..., 0]
    found = np.stack([np.sum(c[..., None, :] * states, axis=-1) + d[..., None] for c, d in zip(C, D, strict=True)])
    return found.reshape(*found.shape[:-1], *z.shape)


def _solved(A: np.ndarray, columns: np.ndarray, z: np.ndarray) -> np.ndarray:
    """``(z I - A)^-1 columns`` (..., z.size, n, columns)."""
    systems = z.reshape(-1, 1, 1) * np.eye(A.shape[-1]) - A[..., None, :, :]
    wide = np.broadcast_to(columns[..., None, :, :], (*systems.shape[:-1], columns.shape[-1]))
    return np.linalg.solve(systems, wide)


def _alike(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A column (n,) and shares (m, n + 1): each ``[A b]`` is the first one plus the column times its shares; else None.

    So it is in loops around one plant whose laws, of one output each, differ in what that hears.
    """
    tables = np.concatenate([A, b[..., None]], axis=-1)
    apart = tables - tables[0]
    one, row, place = np.unravel_index(np.argmax(np.abs(apart)), apart.shape)
    column = apart[one, :, place]
    if column[row] == 0.0:
        return column, apart[:, row]
    shares = apart[:, row] / column[row]
    left = np.abs(apart - column[:, None] * shares[:, None, :])
    return (column, shares) if np.all(left <= ROUNDING * (np.abs(tables) + np.abs(tables[0]))) else None


def _of_alike(A: Any, b: Any, column: Any, shares: Any, C: Any, D: Any, z: np.ndarray) -> np.ndarray:
    """The transfer functions of systems that are :func:`_alike`, by Sherman and Morrison's formula."""
    first, moved = np.moveaxis(_solved(A, np.column_stack([b, column]), z), -1, 0)
    heard = shares[:, :-1]
    back = (shares[:, -1:] + heard @ first.T) / (1.0 - heard @ moved.T)
    found = np.stack([c @ first.T + (c @ moved.T) * back + d[..., None] for c, d in zip(C, D, strict=True)])
    return found.reshape(*found.shape[:-1], *z.shape)
