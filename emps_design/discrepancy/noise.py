"""What repeats and what does not: the noise floor of the force, and the whitening of its residual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy.problem import Whitening, whitening_of
from emps_design.discrepancy.split import START_UP, Split

BAND_HZ = 60.0
PIECE = 500  # samples
UNUSUAL = 2.5  # times the typical deviation of a piece


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


def floor_of_laps(residuals: tuple[np.ndarray, ...], splits: tuple[Split, ...], period: float) -> Floor | None:
    """Floor from repeated laps of any record, or None where no reference repeats.

    ``residuals`` (n,) [N] are what a fitted model leaves: what it knows of one lap and not of another, such as a
    disturbance of the controller, is then not taken for noise.
    """
    from emps_design.identification.filters import low_pass

    differences, smooth = [], []
    for force, split in zip(residuals, splits, strict=True):
        used = np.nonzero(split.used)[0]
        if split.lap == 0 or used.size < 2 * split.lap - START_UP:
            continue
        slow = low_pass(force, BAND_HZ, period)
        first, last = int(used[0]), int(used[-1]) + 1
        # The first lap starts from rest unlike the others: leave it out where there are laps to spare.
        begin = first + split.lap if last - first > 2.5 * split.lap else first
        for start in range(begin, last - split.lap - START_UP, split.lap):
            stop = min(start + split.lap, last - split.lap)
            differences.append((force[start + split.lap : stop + split.lap] - force[start:stop]) / np.sqrt(2))
            smooth.append((slow[start + split.lap : stop + split.lap] - slow[start:stop]) / np.sqrt(2))
    if not differences:
        return None
    return _floor(*_steady(differences, smooth), from_laps=True)


def floor_of_residual(residuals: tuple[np.ndarray, ...], period: float) -> Floor:
    """Floor taken from a model's own residual (n,) [N], where nothing repeats."""
    from emps_design.identification.filters import low_pass

    kept = [r[START_UP:] for r in residuals]
    return _floor(kept, [low_pass(r, BAND_HZ, period) for r in kept], from_laps=False)


def _floor(raw: list[np.ndarray], smooth: list[np.ndarray], from_laps: bool) -> Floor:
    whitening = whitening_of(tuple(np.concatenate((np.zeros(START_UP), d)) for d in raw))
    draws = np.concatenate([whitening.apply(d - d.mean())[START_UP:] for d in raw])
    return Floor(_rms(raw), _rms(smooth), whitening, draws / draws.std(), from_laps)


def _steady(raw: list[np.ndarray], smooth: list[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Leave out the pieces in which laps differ far more than they usually do.

    An event that happens in one lap only (a push, a mass put on) differs between laps without being noise. Pieces, not
    samples, so that what is kept still has the noise's correlation.
    """
    typical = np.median([np.std(piece) for part in raw for piece in _pieces(part)])
    kept_raw, kept_smooth = [], []
    for part, slow in zip(raw, smooth, strict=True):
        usual = [np.std(piece) <= UNUSUAL * typical for piece in _pieces(part)]
        if any(usual):
            mask = np.repeat(usual, PIECE)
            kept_raw.append(part[: mask.size][mask])
            kept_smooth.append(slow[: mask.size][mask])
    return kept_raw, kept_smooth


def _pieces(part: np.ndarray) -> np.ndarray:
    return part[: part.size // PIECE * PIECE].reshape(-1, PIECE)


def _rms(parts: list[np.ndarray]) -> float:
    """Rms [N] of ``parts``, the mean of each removed."""
    return float(np.sqrt(np.mean(np.concatenate([(p - p.mean()) ** 2 for p in parts]))))
