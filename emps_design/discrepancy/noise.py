"""What repeats and what does not: the noise floor of the force, and the whitening of its residual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy.problem import Whitening, whitening_of
from emps_design.discrepancy.split import START_UP, Split
from emps_design.records import Record

BAND_HZ = 60.0


@dataclass(frozen=True)
class Floor:
    """Rms [N] of what differs between laps of the same reference, ``force`` unfiltered and ``force_60hz`` low-passed.

    ``whitening`` models it; ``draws`` are its innovations, to resample. ``from_laps`` False: the reference does not
    repeat, and the floor is a model's residual, an upper bound.
    """

    force: float
    force_60hz: float
    whitening: Whitening
    draws: np.ndarray
    from_laps: bool


def floor_of_laps(records: tuple[Record, ...], splits: tuple[Split, ...], force_gain: float) -> Floor | None:
    """Floor from repeated laps of any record, or None where no reference repeats."""
    from emps_design.identification.filters import low_pass

    differences, smooth = [], []
    for record, split in zip(records, splits, strict=True):
        used = np.nonzero(split.used)[0]
        if split.lap == 0 or used.size < 2 * split.lap - START_UP:
            continue
        force = force_gain * record.u
        slow = low_pass(force, BAND_HZ, record.period)
        first, last = int(used[0]), int(used[-1]) + 1
        # The first lap starts from rest unlike the others: leave it out where there are laps to spare.
        begin = first + split.lap if last - first > 2.5 * split.lap else first
        for start in range(begin, last - split.lap - START_UP, split.lap):
            stop = min(start + split.lap, last - split.lap)
            differences.append((force[start + split.lap : stop + split.lap] - force[start:stop]) / np.sqrt(2))
            smooth.append((slow[start + split.lap : stop + split.lap] - slow[start:stop]) / np.sqrt(2))
    if not differences:
        return None
    return _floor(differences, smooth, True)


def floor_of_residual(residuals: tuple[np.ndarray, ...], period: float) -> Floor:
    """Floor taken from a model's own residual (n,) [N], where nothing repeats."""
    from emps_design.identification.filters import low_pass

    kept = [r[START_UP:] for r in residuals]
    return _floor(kept, [low_pass(r, BAND_HZ, period) for r in kept], False)


def _floor(raw: list[np.ndarray], smooth: list[np.ndarray], from_laps: bool) -> Floor:
    whitening = whitening_of(tuple(np.concatenate((np.zeros(START_UP), d)) for d in raw))
    draws = np.concatenate([whitening.apply(d - d.mean())[START_UP:] for d in raw])
    return Floor(_rms(raw), _rms(smooth), whitening, draws / draws.std(), from_laps)


def _rms(parts: list[np.ndarray]) -> float:
    """Typical deviation of ``parts``: the median of those of 0.5 s pieces would miss bursts, their mean would not."""
    return float(np.sqrt(np.mean(np.concatenate([(p - p.mean()) ** 2 for p in parts]))))
