"""References, generated or read from a file, and synthetic records: simulations with the noise of a measured record.

References are positions (n,) [m] sampled at the period of the drive; numbers out of range raise :class:`InputError`. A
file with a reference, .csv or .npz, has ``t`` [s], ``q_ref`` [m], optional ``f_ext`` [N] and ``excitation`` [V].

A synthetic record has laps of trapezoidal velocity, two strokes at each of three speeds, like those of the EMPS data
set. It has 4 mV of voltage noise and 0.35 N rms of force noise below 40 Hz, as between the laps of DATA_EMPS, scaled
for an axis that is much weaker or stronger.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.effects.sizes import sizes
from emps_design.errors import InputError, RecordError
from emps_design.files import read_bytes
from emps_design.laws import NONE, known_laws, law_of
from emps_design.records import Record
from emps_design.records.archives import read_archive
from emps_design.records.check import LONGEST
from emps_design.records.clock import SHORTEST_PERIOD
from emps_design.records.columns import PLAIN, read_title
from emps_design.records.layout import Layout
from emps_design.records.tables import read_plain_table
from emps_design.request import typed
from emps_design.simulation.plant import Plant
from emps_design.units import Units

VOLTAGE_NOISE = 0.004  # V, of an ordinary axis
FORCE_NOISE, FORCE_BAND = 0.35, 40.0  # N rms of an ordinary axis, and Hz
SPEEDS = (1.0, 0.5, 0.25)  # of the highest speed
MAX_BYTES = 100_000_000  # of a file


@typed
def trapezoid_laps(
    period: float, stroke: float = 0.24, speed: float = 0.2, acceleration: float = 1.0, laps: int = 3
) -> np.ndarray:
    """Return a position reference (n,) [m] of equal laps, each back and forth at three speeds.

    ``period`` [s], ``stroke`` [m], highest ``speed`` [m/s], ``acceleration`` [m/s^2].

    >>> q_ref = trapezoid_laps(1e-3)
    >>> round(float(q_ref.max()), 9), float(q_ref[0]), abs(float(q_ref[-1])) < 1e-12
    (0.24, 0.0, True)
    """
    check_positive(period=period, stroke=stroke, speed=speed, acceleration=acceleration, laps=laps)
    if period < SHORTEST_PERIOD:
        raise InputError(f"period: found {period:g} s, expected at least {SHORTEST_PERIOD:g} s")
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


def half_ramp_program(
    period: float, speeds: tuple[float, ...] = (0.2, 0.1, 0.05), segment: float = 0.5, laps: int = 1
) -> np.ndarray:
    """Position [m] with linearly varying velocity half of the time and constant velocity the other half, section III-A.

    For each of ``speeds`` [m/s], back and forth: ``segment`` seconds of constant velocity between two ramps of half
    that duration. It ends at its first position.

    >>> q = half_ramp_program(1e-3)
    >>> v = np.diff(q) / 1e-3
    >>> constant = np.abs(np.diff(v)) < 1e-9
    >>> round(float(constant.mean()), 2), abs(float(q[-1])) < 1e-9
    (0.5, True)
    """
    check_positive(period=period, segment=segment, laps=laps, **{f"speeds[{i}]": v for i, v in enumerate(speeds)})
    ramp, flat = max(1, round(0.5 * segment / period)), max(1, round(segment / period))
    up = (np.arange(ramp) + 0.5) / ramp
    shape = np.concatenate([up, np.ones(flat), up[::-1]])
    velocity = np.concatenate([sign * speed * shape for speed in speeds for sign in (1.0, -1.0)])
    return np.concatenate([[0.0], np.cumsum(np.tile(velocity, int(laps))) * period])


def multi_sine(
    period: float,
    duration: float = 10.0,
    frequencies: tuple[float, ...] = (0.3, 0.7, 1.1, 2.3, 4.1),
    amplitude: float = 0.02,
    seed: int = 0,
) -> np.ndarray:
    """Position [m]: sines of equal velocity at ``frequencies`` [Hz], phases from ``seed``, peak ``amplitude`` [m].

    The amplitude rises over the first half second, so that it starts at rest at 0.

    >>> q = multi_sine(1e-3, duration=4.0)
    >>> abs(float(q[0])), round(float(np.abs(q).max()), 6)
    (0.0, 0.02)
    """
    numbers = {f"f{i}": f for i, f in enumerate(frequencies)}
    check_positive(period=period, duration=duration, amplitude=amplitude, **numbers)
    t = np.arange(round(duration / period)) * period
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(frequencies))
    q = sum(np.sin(2.0 * np.pi * f * t + phase) / f for f, phase in zip(frequencies, phases, strict=True))
    q *= 0.5 - 0.5 * np.cos(np.pi * np.minimum(t / 0.5, 1.0))
    return amplitude * q / np.abs(q).max()


def check_positive(**numbers: float) -> None:
    """Raise :class:`InputError` naming the first of ``numbers`` that is not positive and finite."""
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}: found {value:g}, expected a positive number")


def read_reference(
    path: str | Path, period: float, units: Units = PLAIN
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Return ``q_ref`` (n,) [m], ``f_ext`` (n,) [N] or None and ``excitation`` (n,) [V] or None.

    They are interpolated at multiples of ``period`` [s]; an excitation is held from one row to the next.
    ``units`` are those of the axis. Raises :class:`RecordError` for a file without these columns, with numbers that are
    not finite, or with a time that does not increase.
    """
    try:
        content = read_bytes(Path(path), MAX_BYTES, "expected a .csv or .npz reference")
    except InputError as error:
        raise RecordError(str(error)) from error
    return reference_from_bytes(content, str(path), period, units)


def reference_from_bytes(
    content: bytes, name: str, period: float, units: Units = PLAIN
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    r""":func:`read_reference` for the ``content`` of a file called ``name``.

    >>> reference_from_bytes(b"t,q_ref [mm]\n0,0\n0.2,4\n", "way.csv", 0.1)[0].tolist()
    [0.0, 0.002, 0.004]
    """
    if content[:2] == b"PK":
        columns = read_archive(io.BytesIO(content), name, MAX_BYTES)
    else:
        columns = read_plain_table(content, name, "expected columns t, q_ref (.csv or .npz)")
    named = {}
    for text, values in columns.items():
        title = read_title(text, name, units)
        if title.name in ("t", "q_ref", "f_ext", "excitation"):
            named[title.name] = np.ravel(np.asarray(values)).astype(float) * title.factor
    missing = [column for column in ("t", "q_ref") if column not in named]
    if missing:
        raise RecordError(f"{name}: missing column {', '.join(missing)}; found {', '.join(columns)}; expected t, q_ref")
    t = named["t"]
    for column, values in named.items():
        if values.size != t.size or t.size < 2:
            raise RecordError(
                f"{name}: column {column}: found {values.size} samples, expected {max(2, t.size)} as in t"
            )
        if not np.isfinite(values).all():
            raise RecordError(f"{name}: column {column}: sample {int(np.argmin(np.isfinite(values)))} is not finite")
    if not (np.diff(t) > 0).all():
        raise RecordError(
            f"{name}: column t: sample {int(np.argmin(np.diff(t) > 0)) + 1} is not later than the one before"
        )
    n = int(np.floor((t[-1] - t[0]) / period * (1 + 1e-12))) + 1
    if not 2 <= n <= LONGEST:
        raise RecordError(f"{name}: {t[-1] - t[0]:g} s at {period:g} s are {n} samples, expected 2 to {LONGEST}")
    grid = t[0] + np.arange(n) * period
    force = np.interp(grid, t, named["f_ext"]) if "f_ext" in named else None
    held = np.searchsorted(t, grid + 1e-6 * period, side="right") - 1
    excitation = named["excitation"][held] if "excitation" in named else None
    return np.interp(grid, t, named["q_ref"]), force, excitation


@typed
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
    without_noise = plant.closed_loop(q_ref)
    size = sizes(without_noise.q, without_noise.u, period, axis.drive.gain)
    run = plant.closed_loop(
        q_ref,
        disturbance=size["N"] * _force_noise(random, q_ref.size, period),
        voltage_noise=size["V"] * VOLTAGE_NOISE * random.standard_normal(q_ref.size),
    )
    return Record.from_arrays(
        period, run.q_ref, run.q, run.u, name=f"synthetic-{axis.name}", layout=Layout(units=axis.units)
    )


def _force_noise(random: np.random.Generator, n: int, period: float) -> np.ndarray:
    """First-order noise (n,) [N] with the level and band of an ordinary axis."""
    decay = float(np.exp(-2.0 * np.pi * FORCE_BAND * period))
    return FORCE_NOISE * scipy.signal.lfilter([1.0], [1.0, -decay], random.standard_normal(n) * np.sqrt(1.0 - decay**2))
