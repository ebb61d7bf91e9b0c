"""Progress of long computations: the stage in words and the share that is done, 0 to 1."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]

LOOKING = "looking for the controller that made the record"  # a stage of law, init --from and identify


def no_progress(stage: str, share: float) -> None:
    """Report nothing."""


def of_part(progress: Progress, begin: float, share: float) -> Progress:
    """Return a function that reports a part of the work, from ``begin`` on and with ``share`` of it, to ``progress``.

    >>> of_part(lambda stage, done: print(stage, done), 0.5, 0.4)("fitting", 0.25)
    fitting 0.6
    """
    return lambda stage, done: progress(stage, begin + share * done)
