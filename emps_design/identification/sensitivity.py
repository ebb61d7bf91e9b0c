"""What the cut-off does to an estimate: the same at half and at twice of it.

Noise of the encoder, a delay that the model lacks, rests that the filter spreads: each moves the estimate with the
cut-off, and no statistics of the residual at one cut-off see it. The estimates share most of their noise, so that the
variance of what they differ by is the difference of their variances (J. A. Hausman, 1978); what is beyond that is
added to the interval.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from emps_design.errors import InputError, RankError, RecordError

FACTORS = (0.5, 2.0)
HIGHEST = 0.4  # of the sampling frequency, for a cut-off that is tried
CHANCE = 2.0  # deviations by which two estimates of one thing may differ
NEGLIGIBLE = 1e-3  # of the value
ALIKE = 0.5  # of a deviation, of what two estimates differ by that have the same


class Estimated(NamedTuple):
    """Parameters (p,), their deviations (p,), and what the encoder's noise is known to take from them (p,)."""

    value: np.ndarray
    std: np.ndarray
    known: np.ndarray | float = 0.0


@dataclass(frozen=True)
class CutoffSensitivity:
    """The parameters ``value`` (p,) at other ``cutoffs`` (tried,) [Hz]: ``tried`` (tried, p).

    ``beyond_chance`` (p,) is how far they moved, less what chance and known noise do.
    """

    names: tuple[str, ...]
    value: np.ndarray
    cutoffs: tuple[float, ...]
    tried: np.ndarray
    beyond_chance: np.ndarray

    @property
    def relative(self) -> dict[str, float | None]:
        """The contract's ``cutoff_sensitivity``: the largest change over the value; None of nothing."""
        largest = np.max(np.abs(self.tried - self.value), axis=0, initial=0.0)
        pairs = zip(self.names, largest.tolist(), np.abs(self.value).tolist(), strict=True)
        return {name: change / value if value > 0.0 else None for name, change, value in pairs}

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the estimates at the other cut-offs."""
        return {"cutoff_hz": list(self.cutoffs), **dict(zip(self.names, self.tried.T.tolist(), strict=True))}


def cutoff_sensitivity(
    names: tuple[str, ...],
    own: Estimated,
    cutoff: float,
    period: float,
    estimate: Callable[[float], Estimated],
) -> CutoffSensitivity:
    """Estimate again at half and twice the ``cutoff`` [Hz], where the record, sampled with ``period`` [s], allows it.

    At twice of it noise is much more, and what it is known to do there says nothing; at half of it there is hardly any:
    what the estimate is known to be off by is believed as far as that one allows.

    >>> own = Estimated(np.array([2.0]), np.array([0.1]))
    >>> def estimate(cutoff):
    ...     return Estimated(np.array([2.0 - 0.01 * cutoff]), np.array([0.1]))
    >>> found = cutoff_sensitivity(("mass",), own, 10.0, 1e-3, estimate)
    >>> round(found.relative["mass"], 6), found.beyond_chance.round(3).tolist()
    (0.1, [0.173])
    """
    cutoffs, tried = [], []
    most_known = np.abs(own.known) + np.zeros(len(names))
    moved = np.zeros(len(names))
    for factor in FACTORS:
        other = min(factor * cutoff, HIGHEST / period)
        if factor > 1.0 and other < 1.2 * cutoff:
            continue
        try:
            found = estimate(other)
        except (RecordError, RankError, InputError, np.linalg.LinAlgError):
            continue  # too little of the record is away from rest at that cut-off
        cutoffs.append(other)
        tried.append(found.value)
        shift = found.value - own.value
        chance = CHANCE * np.maximum(np.sqrt(np.abs(found.std**2 - own.std**2)), ALIKE * own.std)
        if factor < 1.0:
            most_known = np.minimum(most_known, np.abs(shift) + chance)
        else:
            expected = own.known - found.known
            shift = shift - np.clip(shift, np.minimum(expected, 0.0), np.maximum(expected, 0.0))
        moved = np.maximum(moved, np.sqrt(np.maximum(shift**2 - chance**2, 0.0)))
    moved = np.maximum(moved, most_known)
    moved = np.where(moved > NEGLIGIBLE * np.abs(own.value), moved, 0.0)
    return CutoffSensitivity(names, own.value, tuple(cutoffs), np.reshape(tried, (len(tried), len(names))), moved)
