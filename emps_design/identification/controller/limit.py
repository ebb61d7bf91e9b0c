"""Where the limit of a command acts, told from the record and from the law that was found on the other samples."""

from __future__ import annotations

import numpy as np

from emps_design.identification.controller.noise import robust_deviation

PLATEAU = 3  # samples in a row at the largest command that may be the limit
NOISE = 6.0  # deviations of the noise below the largest command that still count as it
AT = 3.0  # deviations of the noise below the limit that a limited sample may be
FEWEST = 5  # samples beyond the limit that show it


def plateau(command: np.ndarray) -> np.ndarray:
    """Samples (n,) in which ``command`` may be limited: in a row at its largest size, as far as its noise tells.

    >>> plateau(np.array([0.0, 1.0, 2.0, 2.0, 2.0, 1.0, -1.0, 0.5])).tolist()
    [False, False, True, True, True, False, False, False]
    """
    size = np.abs(command)
    noise = robust_deviation(np.diff(command, 2)) / 6.0**0.5
    top = float(size.max())
    at = size >= top - min(NOISE * noise, 0.02 * top) - 1e-9 * top
    run = np.convolve(at, np.ones(PLATEAU), "same") >= PLATEAU
    if not run.any():
        return run
    level, spread = np.median(size[run]), robust_deviation(size[run])
    return size >= level - NOISE * spread - 1e-9 * top


def longest_between(limited: np.ndarray) -> slice:
    """The longest run of samples that are not ``limited`` (n,).

    >>> longest_between(np.array([False, True, False, False, True]))
    slice(2, 4, None)
    """
    ends = np.flatnonzero(np.diff(limited, prepend=True, append=True))
    longest = int(np.argmax(ends[1::2] - ends[::2])) if ends.size else 0
    return slice(int(ends[2 * longest]), int(ends[2 * longest + 1])) if ends.size else slice(0, 0)


def acting(command: np.ndarray, wanted: np.ndarray, noise: float) -> tuple[np.ndarray, float | None]:
    """Samples (n,) in which the limit acts, and the limit; ``wanted`` (n,) is what the law gives without one.

    >>> acting(np.array([1.0, 2.0] + [3.0] * 9), np.array([1.0, 2.0] + [4.0] * 9), 0.01)[1]
    3.0
    """
    beyond = (np.abs(wanted) > np.abs(command) + NOISE * noise) & (np.abs(command) > 0.9 * np.abs(command).max())
    beyond &= wanted * command > 0.0
    if beyond.sum() < FEWEST:
        return np.zeros(command.size, bool), None
    limit = float(np.median(np.abs(command[beyond])))
    if robust_deviation(np.abs(command[beyond])) > 3.0 * noise + 1e-3 * limit:
        return np.zeros(command.size, bool), None
    return (np.abs(wanted) > limit) & (np.abs(command) > limit - AT * noise), limit
