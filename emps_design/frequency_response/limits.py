"""What an experiment must stay within, and whether what is asked of one can be meant at all."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from emps_design.errors import InputError
from emps_design.frequency_response.waves import GROUP
from emps_design.records.layout import LONGEST

PLACES = ("command", "reference")
ROOM = 0.9  # share of a limit that is used


@dataclass(frozen=True)
class Limits:
    """What must not be exceeded, None: no limit. ``stroke`` [m], ``speed`` [m/s], ``force`` [N], ``jerk`` [m/s^3]."""

    stroke: float
    speed: float | None = None
    force: float | None = None
    jerk: float | None = None


def check_asked(
    limits: Limits, speed: float, low: float, high: float, resolution: float, nyquist: float, at: str, steps: int | None
) -> None:
    """Raise :class:`InputError` for a place, a band, a number of steps, a speed or a limit that cannot be meant.

    >>> check_asked(Limits(0.5, force=float("nan")), 0.05, 2.0, 100.0, 0.5, 500.0, "command", None)
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: force limit: found nan, expected a positive number
    """
    if at not in PLACES:
        raise InputError(f"place of the excitation: found {at!r}, expected {' or '.join(PLACES)}")
    if not 0.0 < low < high:
        raise InputError(f"frequencies: found {low:g} to {high:g} Hz, expected a rising pair above 0")
    if high >= nyquist:
        raise InputError(f"frequency: found {high:g} Hz, expected less than the Nyquist frequency, {nyquist:g} Hz")
    if not 0.0 < resolution <= 0.5 * (high - low):
        raise InputError(f"resolution: found {resolution:g} Hz, expected more than 0 and several lines in the band")
    if steps is not None and steps < GROUP:
        raise InputError(f"steps: found {steps}, expected at least {GROUP} lines")
    bounds = {one.name if one.name == "stroke" else f"{one.name} limit": getattr(limits, one.name)
              for one in fields(limits)}  # fmt: skip
    for name, value in {"speed": speed, **bounds}.items():
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"{name}: found {value:g}, expected a positive number")
    if limits.speed is not None and speed >= ROOM * limits.speed:
        raise InputError(f"speed: found passes at {speed:g} m/s, expected less than the limit of {limits.speed:g} m/s")


def check_length(samples: float, period: float) -> None:
    """Raise :class:`InputError` for an experiment of more ``samples`` than a record may have.

    >>> check_length(6e6, 1e-3)
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: stroke: found an experiment of 6e+03 s, expected at most 5e+03 s (5000000 samples): \
take a shorter stroke, a higher speed, or fewer passes
    """
    if samples > LONGEST:
        raise InputError(
            f"stroke: found an experiment of {samples * period:.3g} s, expected at most {LONGEST * period:.3g} s "
            f"({LONGEST} samples): take a shorter stroke, a higher speed, or fewer passes"
        )
