"""How far long work is: it tells a stage in words and the share that is done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]


def untold(stage: str, share: float) -> None:
    """Nobody hears how far it is."""


def of_part(progress: Progress, begin: float, share: float) -> Progress:
    """Tell ``progress`` of a part that is ``share`` of the work, after ``begin`` of it.

    >>> of_part(lambda stage, done: print(stage, done), 0.5, 0.4)("fitting", 0.25)
    fitting 0.6
    """
    return lambda stage, done: progress(stage, begin + share * done)
