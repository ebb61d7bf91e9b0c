"""Where a record is at rest, and how noisy its encoder is: read from the position alone.

Friction at rest is any force up to the break-away, so rows near a rest say nothing of friction. A low filter would
smooth a short stop away: rests are looked for in a velocity that is filtered no more than the encoder's noise asks for.
"""

from __future__ import annotations

import numpy as np

from emps_design.identification.filters import central_difference, low_pass
from emps_design.records import Record

SLOW = 0.01  # of the largest velocity: below it friction may be that of rest
HIGHEST = 0.2  # of the sampling frequency, for any low-pass that is chosen
REACH = 1.5  # periods of the cut-off over which a low-pass spreads a jump
FAR = 3.0  # the same for what it makes up
ACCELERATES = 0.1  # of the rms acceleration
BLOCKS = 50  # in whose median the noise of the encoder is read
MOVING = 0.1  # of the samples of such a block that differ from the one before, at least


def encoder_variance(record: Record) -> float:
    """Variance of the encoder's white noise, rounding included [m^2]: the fourth difference of a motion is 70 of it.

    Read while the position changes, for an axis at rest shows no steps; no less than the finest step's rounding.

    >>> t = np.arange(20000) * 1e-3
    >>> q = 0.1 * np.sin(t) + 2e-6 * np.random.default_rng(0).standard_normal(20000)
    >>> round(1e6 * encoder_variance(Record(t=t, q_ref=q, q=q, u=q, period=1e-3)) ** 0.5, 1)
    2.0
    """
    step = np.abs(np.diff(record.q))
    fourth, moves = _means(np.diff(record.q, 4) ** 2), _means(step[3:] > 0.0)
    moving = fourth[moves > MOVING]
    finest = float(np.min(step, initial=np.inf, where=step > 0.0))
    rounding = finest**2 / 12.0 if np.isfinite(finest) else 0.0
    return max(float(np.median(moving)) / 70.0 if moving.size else 0.0, rounding)


def _means(signal: np.ndarray) -> np.ndarray:
    """Means of ``signal`` (n,) over equal blocks one behind the other, (:data:`BLOCKS`,) at most."""
    size, longer = divmod(len(signal), BLOCKS)
    first, rest = signal[: longer * (size + 1)], signal[longer * (size + 1) :]
    parts = first.reshape(longer, size + 1), rest.reshape(-1, size) if size else rest.reshape(0, 1)
    return np.concatenate([np.mean(part, axis=1) for part in parts])


def at_rest(record: Record) -> np.ndarray:
    """Where the carriage turns, is slower than 1 % of its largest velocity, or was not recorded, (n,) of bool."""
    top = HIGHEST / record.period
    rough = central_difference(low_pass(record.q, top, record.period), record.period)
    slow = SLOW * float(np.quantile(np.abs(rough), 0.999))
    # White noise of variance s^2 has the variance 2 s^2 T (2 pi)^2 f^3 / 3 in the velocity below f.
    density = max(2.0 * encoder_variance(record) * record.period, 1e-300)
    quiet = (3.0 * (slow / 3.0) ** 2 / ((2.0 * np.pi) ** 2 * density)) ** (1.0 / 3.0)
    v = rough
    if quiet < top:
        quiet = max(quiet, 10.0 / record.duration)
        v = central_difference(low_pass(record.q, quiet, record.period), record.period)
    rest = (v < slow) & (v > -slow)
    rest[1:] |= (v[1:] > 0) != (v[:-1] > 0)  # a reversal may pass between two samples
    return rest | record.in_gap


def known(record: Record, a: np.ndarray, cutoff_hz: float) -> np.ndarray:
    """Where a filter of ``cutoff_hz`` [Hz] sees nothing that it makes up, (n,) of bool.

    That is what lies in a gap, and beyond an end at which the axis has an acceleration ``a`` (n,), which no reflection
    continues: unlike a jump of friction, all of the force is wrong there, and seen from further away.
    """
    n = len(record)
    made_up = record.in_gap
    inside = min(int(1.0 / (cutoff_hz * record.period)), n - 1)  # where the reflection leaves the acceleration alone
    felt = ACCELERATES * float(np.sqrt(np.mean(a**2)))
    made_up[0] |= abs(a[inside]) > felt
    made_up[-1] |= abs(a[-1 - inside]) > felt
    return away_from(made_up, cutoff_hz * REACH / FAR, record.period)


def away_from(rest: np.ndarray, cutoff_hz: float, period: float) -> np.ndarray:
    """Where the carriage slides for certain, (n,) of bool: 1.5 periods of the cut-off [Hz] from any ``rest`` (n,).

    A zero-phase filter spreads the jump of friction that far to both sides.

    >>> away_from(np.array([False, False, True, False, False, False]), 1.5, 1.0).tolist()
    [True, False, False, False, True, True]
    """
    reach, n = int(REACH / (cutoff_hz * period)), len(rest)
    # Rests before each moment, so that those within reach are a difference.
    before = np.zeros(n + 2 * reach + 1, dtype=np.int32)
    np.cumsum(rest, out=before[reach + 1 : reach + n + 1])
    before[reach + n + 1 :] = before[reach + n]
    return before[2 * reach + 1 :] == before[:n]
