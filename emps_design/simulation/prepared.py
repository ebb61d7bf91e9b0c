"""What a plant hands to the general stepper: checked signals, and the numbers of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Drive
from emps_design.errors import InputError


@dataclass(frozen=True)
class Prepared:
    """What the general stepper is given besides the law, the signals and room for the answer.

    ``baseline`` (4,), ``parameters``, ``settings``, ``y`` the state at first, the table of hooks with its ``starts``,
    ``columns`` that are written to ``slots`` of the parameters at every sample, ``floors`` and ``scratch``.
    """

    baseline: np.ndarray
    parameters: np.ndarray
    settings: np.ndarray
    y: np.ndarray
    hooks: np.ndarray
    starts: np.ndarray
    columns: np.ndarray
    slots: np.ndarray
    floors: np.ndarray
    scratch: np.ndarray


def intention_columns(wanted: np.ndarray, hand: np.ndarray, held: bool, n: int, period: float) -> np.ndarray:
    """Return the parameters (n, 6) of a ``hand`` that means to be at ``wanted`` (n,) [m], nan where it has let go.

    Between samples the intention moves evenly; the force of a ``held`` hand is that of the sample itself.
    """
    grips, speed = ~np.isnan(wanted), np.zeros(wanted.size)
    if wanted.size > 1:
        step = np.diff(wanted) / period
        speed = np.gradient(wanted, period) if held else np.append(step, 0.0)
        speed[1:] = np.where(np.isnan(speed[1:]), step, speed[1:])
    place = signal(np.where(grips, wanted, 0.0), "intention", "m", n)
    return np.column_stack([grips[:, None] * hand[:3], place, np.nan_to_num(speed), np.arange(n) * period])


def motor_rows(drive: Drive, supply: Any, enable: Any, n: int) -> np.ndarray:
    """Gain [N/V] and braking [N/(m/s)] of a motor at each sample, (n, 2), or (0, 2) where they never change.

    ``supply`` (n,) [V] of a duty, None: that of the ``drive``; ``enable`` (n,) 0 where it is off, None: nowhere.
    """
    supply = None if drive.command != "duty" or supply is None else signal(supply, "supply", "V", n)
    if supply is None and enable is None:
        return np.zeros((0, 2))
    on = np.ones(n) if enable is None else (signal(enable, "enable", "", n) != 0.0).astype(float)
    gain = drive.gain if supply is None else drive.force_gain * supply
    return np.column_stack([on * gain, on * drive.braking])


def positive(period: Any) -> float:
    """Return ``period`` [s]; raises :class:`InputError` where it is not positive."""
    if not (np.isfinite(period) and period > 0):
        raise InputError(f"period: found {period:g} s, expected a positive number")
    return float(period)


def signal(values: Any, name: str, unit: str, n: int | None = None) -> np.ndarray:
    """Return ``values`` as a row of floats; raises :class:`InputError` where they are not ``n`` finite numbers."""
    found = np.ascontiguousarray(values, dtype=float)
    if found.ndim != 1 or found.size == 0 or (n is not None and found.size != n):
        wanted = f"{n} numbers" if n else "a row of numbers"
        raise InputError(f"{name}: found shape {found.shape}, expected {wanted} [{unit}]")
    # A finite sum proves all finite, in one pass; otherwise look for the culprit (there is none if the sum overflowed).
    if not np.isfinite(found.sum()) and not np.isfinite(found).all():
        first = int(np.argmin(np.isfinite(found)))
        raise InputError(f"{name}: sample {first} is {found[first]}, expected finite numbers [{unit}]")
    return found
