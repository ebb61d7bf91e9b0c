"""Cases of which ``make test`` takes some and ``make studies`` the others."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def quick(values: Iterable[Any], taken: int | Callable[[Any], bool], why: str) -> list[Any]:
    """``values`` for ``parametrize``: those that ``taken`` names, or the first so many, stay tests.

    >>> [getattr(value, "marks", None) is not None for value in quick("abc", 1, "more letters")]
    [False, True, True]
    """
    keep = (lambda place, value: place < taken) if isinstance(taken, int) else (lambda place, value: taken(value))
    marked = []
    for place, value in enumerate(values):
        parts = value if isinstance(value, tuple) else (value,)
        marked.append(value if keep(place, value) else pytest.param(*parts, marks=pytest.mark.study(why)))
    return marked
