"""What a run of a plant takes: a reference or commands, and the conditions of the run; the signals checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Drive
from emps_design.errors import InputError
from emps_design.laws import Law
from emps_design.request import Request, option


@dataclass(frozen=True)
class _Conditions(Request):
    """What every run takes beside its reference or commands."""

    baseline: np.ndarray | None = option(None, "[mass, viscous, coulomb, offset] in place of the axis's")
    parameters: Sequence[np.ndarray] | None = option(None, "one array per effect in place of the axis's")
    disturbance: np.ndarray | None = option(None, "force (n,) [N] on the carriage, held over each period")
    v0: float = option(0.0, "first velocity [m/s]")
    period: float | None = option(None, "sampling period [s], by default the axis's")
    quantise: bool = option(True, "whether the encoder has steps; otherwise it is exact")
    intention: np.ndarray | None = option(
        None, "position (n,) [m] that a hand at the carriage aims at, nan after it has let go"
    )
    supply: np.ndarray | None = option(None, "supply (n,) [V] of a duty, by default the axis's")
    enable: np.ndarray | None = option(None, "(n,), 0 where the motor is switched off, its winding open")
    energy: bool = option(False, "whether the run has its energy balance")
    tolerance: float = option(1.0, "factor on the error tolerance of a step")
    method: str = option("auto", "of stepping: auto, general, linear, plain or folded")


@dataclass(frozen=True)
class _Reference(Request):
    q_ref: np.ndarray = option(..., "position reference (n,) [m]", argument=True)


@dataclass(frozen=True)
class _Commands(Request):
    u: np.ndarray = option(..., "voltage (n,) [V], held over each period", argument=True)


@dataclass(frozen=True)
class ClosedLoopRun(_Conditions, _Reference):
    """What :meth:`Plant.closed_loop` takes."""

    voltage_noise: np.ndarray | None = option(None, "voltage (n,) [V] added after the controller")
    q0: float | None = option(None, "first position [m], by default that of the reference")
    law: Law | None = option(None, "law in place of the axis's controller")
    reference: np.ndarray | None = option(
        None,
        "reference (n,) of the law, by default q_ref, or its backward difference for a law that follows a velocity",
    )


@dataclass(frozen=True)
class OpenLoopRun(_Conditions, _Commands):
    """What :meth:`Plant.open_loop` takes."""

    q0: float = option(0.0, "first position [m]")


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
    """Return ``period`` [s]; raise :class:`InputError` if it is not positive."""
    if not (np.isfinite(period) and period > 0):
        raise InputError(f"period: found {period:g} s, expected a positive number")
    return float(period)


def signal(values: Any, name: str, unit: str, n: int | None = None) -> np.ndarray:
    """Return ``values`` as an array (n,) of floats; raise :class:`InputError` unless they are ``n`` finite numbers."""
    row = np.ascontiguousarray(values, dtype=float)
    if row.ndim != 1 or row.size == 0 or (n is not None and row.size != n):
        wanted = f"{n} numbers" if n else "a row of numbers"
        raise InputError(f"{name}: found shape {row.shape}, expected {wanted} [{unit}]")
    # A finite sum proves all finite, in one pass; otherwise find the first that is not (none if the sum overflowed).
    if not np.isfinite(row.sum()) and not np.isfinite(row).all():
        first = int(np.argmin(np.isfinite(row)))
        raise InputError(f"{name}: sample {first} is {row[first]}, expected finite numbers [{unit}]")
    return row
