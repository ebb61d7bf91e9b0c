"""Steps that something adds to a controller's output: pulses of an instrument, a switch. They are taken off.

Whatever stands still between its steps has no first difference but there: a law that is fitted to differences, without
those that stick out, finds where it steps. Between these the command may carry a constant of its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.identification.controller.estimators import ESTIMATORS
from emps_design.identification.controller.noise import robust_deviation
from emps_design.identification.controller.regressors import Signals, Timing, regressors

ROUNDS = 12
OUTLYING = 8.0  # deviations of the typical difference
RAREST, MOST = 2, 0.02  # steps; share of the samples: more is no matter of steps


def without_steps(signals: Signals) -> tuple[Signals, np.ndarray] | None:
    """The signals with such steps taken off the command, and these (n,); None where there are none."""
    tables = [regressors(signals, Timing(velocity_estimator=name)) for name in ESTIMATORS]
    outlying = min((_outlying(signals, table) for table in tables), key=lambda pair: pair[0])[1]
    if not RAREST <= outlying.sum() <= MOST * len(signals):
        return None
    used = signals.used & ~outlying
    levels = np.cumsum(outlying) + (0 if signals.levels is None else signals.levels)
    stretches = replace(signals, used=used, levels=levels, records=False)
    fits = [_within(stretches, table) for table in tables]
    left = min(fits, key=lambda left: float(np.sum(stretches.counted(left) ** 2)))
    known = levels[used]
    means = np.bincount(known, left[used]) / np.maximum(np.bincount(known), 1)
    # A stretch without a sample that counts goes on as the one before it.
    steps = means[np.unique(known)[np.searchsorted(np.unique(known), levels, "right") - 1]]
    return replace(stretches, command=signals.command - steps), steps


def _outlying(signals: Signals, table: np.ndarray) -> tuple[float, np.ndarray]:
    """Typical difference that a law without memory leaves, and the samples (n,) whose difference sticks out."""
    columns, target = np.diff(table, axis=0), np.diff(signals.command)
    scale = np.linalg.norm(columns, axis=0)
    columns = columns[:, scale > 0.0] / scale[scale > 0.0]
    whole = signals.used[1:] & signals.used[:-1]
    kept, left = whole, target
    for _ in range(ROUNDS):
        left = target - columns @ np.linalg.lstsq(columns[kept], target[kept], rcond=1e-10)[0]
        kept = whole & (np.abs(left) < OUTLYING * robust_deviation(left[whole]))
    return robust_deviation(left[whole]), np.concatenate([[False], whole & ~kept])


def _within(signals: Signals, table: np.ndarray) -> np.ndarray:
    """What is left (n,) of the command by a law without filters, with a constant in each stretch."""
    columns, target = signals.counted(table), signals.counted(signals.command)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale < 1e-9 * scale.max()] = np.inf
    return signals.command - table @ (np.linalg.lstsq(columns / scale, target, rcond=1e-10)[0] / scale)
