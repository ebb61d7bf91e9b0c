"""Progress of long computations: the name of the stage and the completed share, 0 to 1."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]

LOOKING = "identifying the controller that made the record"  # a stage of law, init --from and identify


def no_progress(stage: str, share: float) -> None:
    """Report nothing."""


def of_part(progress: Progress, begin: float, share: float) -> Progress:
    """Return a progress function for one part of the work: it starts at ``begin`` and takes ``share`` of the whole.

    >>> of_part(lambda stage, done: print(stage, done), 0.5, 0.4)("fitting", 0.25)
    fitting 0.6
    """
    return lambda stage, done: progress(stage, begin + share * done)
