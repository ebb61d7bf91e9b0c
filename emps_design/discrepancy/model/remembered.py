"""Residuals of models that were simulated before: a search comes back to them, with other noise or neighbours."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

MOST = 128e6  # bytes of residuals that are kept, those asked for last


class Remembered:
    """What was computed for the same objects and the same numbers; a copy or a pickle of it is empty.

    >>> remembered, axis = Remembered(), object()
    >>> remembered.get((axis,), [np.ones(1)], lambda: (np.zeros(2),))
    (array([0., 0.]),)
    >>> remembered.get((axis,), [np.ones(1)], lambda: (np.ones(2),))
    (array([0., 0.]),)
    """

    def __init__(self) -> None:
        # The objects are kept with the arrays: as long as they are, nothing else has their ids.
        self._kept: OrderedDict[Any, tuple[Sequence[Any], tuple[np.ndarray, ...]]] = OrderedDict()

    def __reduce__(self) -> tuple[type[Remembered], tuple[()]]:
        return Remembered, ()

    def get(
        self,
        objects: Sequence[Any],
        numbers: Sequence[np.ndarray],
        compute: Callable[[], tuple[np.ndarray, ...]],
    ) -> tuple[np.ndarray, ...]:
        """What ``compute`` gave for ``objects`` and ``numbers``, or gives now: arrays that are not to be changed."""
        key = (*map(id, objects), *(one.tobytes() for one in numbers))
        found = self._kept.pop(key, None)  # by one thread: another that asks at the same time computes it too
        if found is None:
            arrays = compute()
            for one in arrays:
                one.flags.writeable = False
            found = objects, arrays
        self._kept[key] = found
        most = MOST // max(1, sum(one.nbytes for one in found[1]))
        while len(self._kept) > most:
            self._kept.popitem(last=False)
        return found[1]
