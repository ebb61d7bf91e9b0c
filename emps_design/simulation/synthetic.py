"""Synthetic records: an axis under its own controller, with noise like that of a measured record.

Laps of trapezoidal velocity, two strokes at each of three speeds, like those of the EMPS data set; 4 mV of voltage
noise and 0.35 N rms of force noise below 40 Hz, as DATA_EMPS shows from lap to lap, scaled for an axis that is much
weaker or stronger.
"""

from __future__ import annotations

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.sizes import sizes
from emps_design.errors import InputError
from emps_design.laws import NONE, known_laws, law_of
from emps_design.records import Record
from emps_design.records.check import LONGEST
from emps_design.records.clock import SHORTEST_PERIOD
from emps_design.records.layout import Layout
from emps_design.simulation.plant import Plant

VOLTAGE_NOISE = 0.004  # V, of an ordinary axis
FORCE_NOISE, FORCE_BAND = 0.35, 40.0  # N rms of an ordinary axis, and Hz
SPEEDS = (1.0, 0.5, 0.25)  # of the highest speed


def trapezoid_laps(
    period: float, stroke: float = 0.24, speed: float = 0.2, acceleration: float = 1.0, laps: int = 3
) -> np.ndarray:
    """Return a position reference (n,) [m] of equal laps, each forth and back at three speeds.

    ``period`` [s], ``stroke`` [m], highest ``speed`` [m/s], ``acceleration`` [m/s^2].

    >>> q_ref = trapezoid_laps(1e-3)
    >>> round(float(q_ref.max()), 9), float(q_ref[0]), abs(float(q_ref[-1])) < 1e-12
    (0.24, 0.0, True)
    """
    values = {"period": period, "stroke": stroke, "speed": speed, "acceleration": acceleration, "laps": laps}
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}: found {value:g}, expected a positive number")
    if period < SHORTEST_PERIOD:
        raise InputError(f"period: found {period:g} s, expected at least {SHORTEST_PERIOD:g} s, or a record has no end")
    pause = 0.1
    lap = [there_and_back(period, stroke, share * speed, acceleration, pause) for share in SPEEDS]
    return np.tile(np.concatenate([np.zeros(round(pause / period)), *lap]), int(laps))


def there_and_back(period: float, stroke: float, speed: float, acceleration: float, pause: float) -> np.ndarray:
    """Return positions (n,) [m] from 0 to ``stroke`` [m] and back by :func:`point_to_point`, ``pause`` [s] after each.

    Raises :class:`InputError` for a motion longer than the longest record.

    >>> there_and_back(0.5, 1.0, 1.0, 2.0, 0.5).tolist()
    [0.0, 0.25, 0.75, 1.0, 1.0, 1.0, 0.75, 0.25, 0.0, 0.0]
    """
    reached = min(speed, np.sqrt(stroke * acceleration))
    samples = 2.0 * (stroke / reached + reached / acceleration + pause) / period
    if not samples < LONGEST:
        raise InputError(
            f"motion: found {samples * period:.4g} s at {period:g} s, {samples:.3g} samples, expected at most "
            f"{LONGEST}: take a shorter stroke or pause, or more speed or acceleration"
        )
    there, still = point_to_point(period, stroke, speed, acceleration), round(pause / period)
    return np.concatenate([there, np.full(still, stroke), stroke - there, np.zeros(still)])


def synthetic_record(
    axis: Axis,
    seed: int = 0,
    laps: int = 3,
    stroke: float = 0.24,
    speed: float = 0.2,
    q_ref: np.ndarray | None = None,
) -> Record:
    """Simulate ``axis`` over :func:`trapezoid_laps`, or along ``q_ref`` (n,) [m], and return the record.

    The same seed gives the same bits. Raises :class:`InputError` for an axis whose controller does not follow a
    position.

    >>> from emps_design.machines import machine
    >>> record = synthetic_record(machine("emps2019"), laps=1)
    >>> record.name, record.period, len(record)
    ('synthetic-emps2019', 0.001, 18206)
    """
    period = axis.sampling.period
    if axis.controller.kind == NONE or law_of(axis, period).follows != "position":
        following = [
            repr(law.name) for law in known_laws().values() if law.follows == "position" or callable(law.follows)
        ]
        raise InputError(
            f"axis {axis.name}: found controller {axis.controller.kind!r}, expected {' or '.join(following)}: "
            "laps need a controller that follows a position"
        )
    q_ref = trapezoid_laps(period, stroke, speed, laps=laps) if q_ref is None else q_ref
    random, plant = np.random.default_rng(seed), Plant.of(axis)
    quiet = plant.closed_loop(q_ref)
    size = sizes(quiet.q, quiet.u, period, axis.drive.gain)
    run = plant.closed_loop(
        q_ref,
        disturbance=size["N"] * _force_noise(random, q_ref.size, period),
        voltage_noise=size["V"] * VOLTAGE_NOISE * random.standard_normal(q_ref.size),
    )
    return Record.from_arrays(
        period, run.q_ref, run.q, run.u, name=f"synthetic-{axis.name}", layout=Layout(units=axis.units)
    )


def point_to_point(period: float, stroke: float, speed: float, acceleration: float) -> np.ndarray:
    """Positions (n,) [m] from 0 to ``stroke`` [m], both ends at rest, with a trapezoid of velocity.

    ``period`` [s], highest ``speed`` [m/s], reached or not, ``acceleration`` [m/s^2].

    >>> point_to_point(0.25, 1.0, 1.0, 2.0).round(4).tolist()
    [0.0, 0.0625, 0.25, 0.5, 0.75, 0.9375, 1.0]
    """
    speed = min(speed, np.sqrt(stroke * acceleration))
    ramp = speed / acceleration
    duration = stroke / speed + ramp
    t = np.arange(round(duration / period) + 1) * period
    # The velocity is a trapezoid; its integral, written as the difference of two parabolas with clipped times.
    rise = np.minimum(t, ramp)
    fall = np.clip(t - (duration - ramp), 0.0, ramp)
    q = 0.5 * acceleration * rise**2 + speed * np.clip(t - ramp, 0.0, duration - 2 * ramp)
    q += speed * fall - 0.5 * acceleration * fall**2
    return np.minimum(q, stroke)


def _force_noise(random: np.random.Generator, n: int, period: float) -> np.ndarray:
    """First-order noise (n,) [N] with the level and band of an ordinary axis."""
    from scipy.signal import lfilter

    decay = float(np.exp(-2.0 * np.pi * FORCE_BAND * period))
    return FORCE_NOISE * lfilter([1.0], [1.0, -decay], random.standard_normal(n) * np.sqrt(1.0 - decay**2))
