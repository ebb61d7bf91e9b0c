"""Simulations side by side: they release the interpreter, so threads are enough."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

CORES = 2


def side_by_side(function: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Return ``function(*row)`` of each row of ``arguments``, in their order.

    >>> side_by_side(pow, [(2, 3), (3, 2)])
    [8, 9]
    """
    from joblib import Parallel, delayed

    return Parallel(n_jobs=CORES, prefer="threads")(delayed(function)(*row) for row in arguments)
