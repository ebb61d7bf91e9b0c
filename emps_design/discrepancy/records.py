"""Records of one axis: their drive, their motion, and their split into strokes and laps.

The simulation of a record is driven by its reference through the controller. If the controller is unknown
(``controller.kind = "none"``), the model becomes an inverse model: it is driven by the recorded voltage, and a position
law adds the voltage that keeps it on the recorded motion. That correction is the force the model lacks, within the
bandwidth of the law, with all internal states of the model simulated.

The fitting and the selecting part of a record consist of whole strokes or laps.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import NO_LIMIT, Axis
from emps_design.discrepancy import rules
from emps_design.effects import Motion
from emps_design.effects.sizes import TURN, sizes
from emps_design.identification.filters import encoder_variance, low_pass, motion
from emps_design.laws import NONE
from emps_design.laws.library import position_pd
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.simulation.run import commands_of, driven_by


def band(record: Record) -> float:
    """Frequency [Hz] below which the command has 90 % of its power and the encoder noise is minor.

    Above it, white noise of the position exceeds ``rules.MINOR`` of the acceleration below that frequency, and the best
    fit of a model that follows the record would have hardly any mass.

    >>> t = np.arange(4000) * 1e-3
    >>> command = np.sin(2 * np.pi * 72 * t)
    >>> round(band(Record(t, t, -1e-3 * command, command, 1e-3)))
    72
    >>> noisy = 1e-3 * (np.random.default_rng(0).standard_normal(4000) - command)
    >>> band(Record(t, t, noisy, command, 1e-3)) < 50.0
    True
    """
    n, period = len(record), record.period
    power = np.cumsum(np.abs(np.fft.rfft(record.u - record.u.mean())) ** 2)
    acceleration = np.gradient(np.gradient(record.q, period), period)
    motion = np.cumsum(np.abs(np.fft.rfft(acceleration)) ** 2) * 2.0 / n**2  # (m/s^2)^2 below each frequency
    frequencies = np.fft.rfftfreq(n, period)
    noise = encoder_variance(record) * 2.0 * period * (2.0 * np.pi) ** 4 * frequencies**5 / 5.0
    above_noise = frequencies[np.flatnonzero(noise <= rules.MINOR**2 * motion)[-1]]
    return float(min(frequencies[np.searchsorted(power, rules.NEARLY_ALL * power[-1])], above_noise))


def bandwidth(record: Record, band_hz: float) -> float:
    """Bandwidth [Hz] of the velocity loop that follows ``record``, whose :func:`band` is ``band_hz``."""
    usual = min(rules.BANDWIDTH_HZ, 1 / (rules.LEAST_SAMPLES * record.period))
    return max(usual, min(band_hz, _fastest(record)))


def _fastest(record: Record) -> float:
    """The highest bandwidth [Hz] of a law that follows ``record`` and is computed once per sample."""
    return 1 / (rules.FAST_SAMPLES * record.period)


def in_followed_band(force: np.ndarray, record: Record, band_hz: float) -> np.ndarray:
    """The ``force`` (n,) [N] that keeps a model on ``record``, low-passed to the band of the following law."""
    return low_pass(force, rules.COMPARED * bandwidth(record, band_hz), record.period)


def drive(start: dict[str, Any], axis: Axis, record: Record, mass: float, band_hz: float) -> dict[str, Any]:
    """Keywords of :meth:`Plant.closed_loop`: initial state and inputs of ``record``.

    ``start`` is :func:`~emps_design.simulation.run.driven_by` of ``axis`` and ``record``. ``mass`` [kg] is that of the
    model and scales the gains of the following law: otherwise the loop of a heavier model would be slower and show less
    of the force, and that of a much lighter one too fast for the sampling. ``band_hz`` is the :func:`band` of the
    record.
    """
    if "law" in start:
        return dict(start)
    loop_bandwidth = bandwidth(record, band_hz)
    rate = 2 * np.pi * loop_bandwidth  # rad/s
    scale = min(np.hypot(mass, axis.mechanics.mass) / np.sqrt(2.0), mass * _fastest(record) / loop_bandwidth)
    kp, kv = rules.QUARTER * rate, scale * rate / axis.drive.gain
    law = position_pd.LAW.law(position_pd.Table(kp=kp, kv=kv), axis, record.period)
    past = np.concatenate((np.full(2, record.q[0]), record.q[:-2]))
    # The law damps the absolute velocity; a reference that leads by v/kp makes it damp the velocity error.
    lead = (record.q - past) / (2 * record.period) / kp
    return {**start, "law": law, "reference": record.q + lead, "voltage_noise": record.u}


@dataclass(frozen=True, eq=False)
class RecordSet:
    """The ``records`` of an ``axis``, and quantities computed from them once."""

    axis: Axis
    records: tuple[Record, ...]

    @property
    def follows(self) -> bool:
        """Whether models follow the recorded motion because the controller is unknown."""
        return bool(self.axis.controller.kind == NONE)

    @cached_property
    def simulated(self) -> Axis:
        """The axis of the simulations, without a command limit if the law follows the recorded motion.

        Otherwise the law could correct a model in one direction only while the recorded command is at the limit.
        """
        return self.axis.replace(drive={"command_limit": NO_LIMIT}) if self.follows else self.axis

    @cached_property
    def tolerance(self) -> float:
        """Factor on the integrator's error tolerance, smaller for an axis of small stroke or speed."""
        gain = self.axis.drive.gain
        scales = [sizes(record.q, record.u, record.period, gain) for record in self.records]
        return rules.LOOSE * min(1.0, *(scale[unit] for scale in scales for unit in ("m", "m/s")))

    @cached_property
    def starts(self) -> tuple[dict[str, Any], ...]:
        """Inputs of the simulation of every record, without the law that follows the recorded motion."""
        return tuple(driven_by(self.axis, record) for record in self.records)

    @cached_property
    def bands(self) -> tuple[float, ...]:
        """The :func:`band` of every record [Hz]."""
        return tuple(band(record) for record in self.records)

    @cached_property
    def forces(self) -> tuple[np.ndarray, ...]:
        """The motor force (n,) [N] of the command of every record."""
        return tuple(motor_force(self.axis, record) for record in self.records)

    @cached_property
    def off_commands(self) -> tuple[np.ndarray | None, ...]:
        """Commands (n,) of the law along every record with the motor off at times, None for the others."""
        off = [not self.follows and record.enable is not None and not record.enable.all() for record in self.records]
        return tuple(self.commands(i, record.q) if off[i] else None for i, record in enumerate(self.records))

    def commands(self, number: int, q: np.ndarray) -> np.ndarray:
        """Commands (n,) of the law of record ``number`` along the positions ``q`` (n,) [m], without a limit."""
        start = self.starts[number]
        return commands_of(start["law"], start["reference"], q, np.inf, self.records[number].f_ext)

    def missing_while_off(self, number: int, q: np.ndarray) -> np.ndarray | float:
        """Motor force (n,) [N] of the law's commands along record ``number``, minus those along ``q`` (n,) [m].

        0 while the motor is on.
        """
        command, record = self.off_commands[number], self.records[number]
        if command is None:
            return 0.0
        difference = motor_force(self.axis, replace(record, u=command - self.commands(number, q), enable=None))
        return np.where(record.enable == 0.0, difference, 0.0)

    @cached_property
    def motions(self) -> tuple[Motion, ...]:
        """The motion of every record in its :func:`acceleration_band`."""
        return tuple(motion(record, acceleration_band(record)) for record in self.records)


def acceleration_band(record: Record) -> float:
    """Band [Hz] in which the encoder's noise is a small part of the acceleration, at least ``rules.CUTOFF_HZ``.

    A missing inertia changes the response of the loop up to its bandwidth. The noise, assumed white, comes from the
    median of the position above the fastest motion, so that impacts do not count as noise.
    """
    fastest = rules.FASTEST / record.period
    high_passed = np.abs(record.q - low_pass(record.q, fastest, record.period))
    noise = (np.median(high_passed) / 0.6745) ** 2 / (1.0 - 2.0 * rules.FASTEST)
    density = 2.0 * record.period * noise * (2.0 * np.pi) ** 4  # of the acceleration over f^4 [m^2/s^4/Hz^5]
    size = np.var(motion(record, rules.CUTOFF_HZ).a)
    most = (5.0 * rules.NOISY**2 * size / max(density, 1e-300)) ** 0.2
    return float(np.clip(most, rules.CUTOFF_HZ, fastest))


@dataclass(frozen=True)
class Split:
    """Strokes and length of a lap [samples], and the fitting and the selecting samples as boolean arrays.

    With at least three laps, laps alternate between fitting and selecting (the start of the first is excluded);
    otherwise strokes, or parts of strokes if these are too few. So both cover the whole time.
    """

    strokes: tuple[tuple[int, int], ...]
    lap: int
    fit: np.ndarray
    select: np.ndarray

    @property
    def used(self) -> np.ndarray:
        """Samples that either fit or select."""
        return self.fit | self.select

    def until(self, stop: int) -> Split:
        """The same of the first ``stop`` samples."""
        strokes = tuple((start, min(end, stop)) for start, end in self.strokes if start < stop)
        return Split(strokes, self.lap, self.fit[:stop], self.select[:stop])


def split(record: Record, fit_share: np.ndarray | None = None, before: int = 0, parts: int = 1) -> Split:
    """Split ``record`` by whole strokes; ``fit_share`` (n,) bool limits the samples that may be used at all.

    ``before`` is the number of strokes in the records before this one, so that records with a single stroke alternate
    too; each stroke is split into ``parts``.
    """
    n = len(record)
    allowed = np.ones(n, bool) if fit_share is None else fit_share.copy()
    allowed[: rules.START_UP] = False
    # Samples near a gap are excluded: during the gap the model may drift away from the record.
    allowed &= np.convolve(record.in_gap, np.ones(2 * rules.START_UP + 1), "same") < 0.5
    strokes = find_strokes(record.q_ref, record.period)
    if parts > 1:
        strokes = tuple(part for start, stop in strokes for part in _parts(record.q, start, stop, parts))
    lap = find_lap(record.q_ref)
    laps = int(allowed.sum()) // lap if lap else 0
    fit = np.zeros(n, bool)
    if laps >= 3:
        fit = (np.arange(n) // lap) % 2 == 0
    else:
        for index, (start, stop) in enumerate(strokes):
            fit[start:stop] = (before + index) % 3 != 2
    return Split(strokes, lap, fit & allowed, ~fit & allowed)


def _parts(q: np.ndarray, start: int, stop: int, count: int) -> list[tuple[int, int]]:
    """Samples of ``count`` parts of a stroke of ``q`` (n,) with equal sums of relative time and travel.

    >>> _parts(np.concatenate([np.arange(100.0), np.full(300, 99.0)]), 0, 400, 2)
    [(0, 80), (80, 400)]
    """
    travel = np.cumsum(np.abs(np.diff(q[start:stop], prepend=q[start])))
    progress = np.arange(stop - start) / (stop - start) + travel / max(float(travel[-1]), 1e-300)
    edges = [start, *(start + np.searchsorted(progress, progress[-1] * np.arange(1, count) / count)).tolist(), stop]
    return list(itertools.pairwise(edges))


def find_lap(q_ref: np.ndarray) -> int:
    """The period [samples] of ``q_ref`` (n,) [m], 0 if it does not repeat within n/2."""
    n = q_ref.size
    centred = q_ref - q_ref.mean()
    energy = np.concatenate(([0.0], np.cumsum(centred**2)))
    spectrum = np.fft.rfft(centred, 2 * n)
    product = np.fft.irfft(spectrum * spectrum.conj(), 2 * n)[:n]
    lags = np.arange(n)
    difference = energy[n - lags] + (energy[n] - energy[lags]) - 2 * product
    mean_square = np.maximum(difference, 0.0) / (n - lags)
    limit = 1e-8 * centred.var()
    lag = int(np.argmax(mean_square > 1e-2 * centred.var()))  # leave the neighbourhood of lag 0 first
    close = np.nonzero(mean_square[lag : n // 2 + 1] < limit)[0]
    if lag == 0 or close.size == 0:
        return 0
    first = lag + int(close[0])
    last = first + int(np.argmax(np.append(np.diff(close[:50]) > 1, True)))
    return first + int(np.argmin(mean_square[first : last + 1]))


def find_strokes(q_ref: np.ndarray, period: float) -> tuple[tuple[int, int], ...]:
    """Strokes (start, stop) between reversals of the reference (n,) [m]; standstill belongs to the stroke before it.

    For a shaft that turns in one direction, pieces of at least one turn are the strokes.
    """
    velocity = np.gradient(q_ref, period)
    direction = np.sign(velocity) * (np.abs(velocity) > 1e-3 * np.abs(velocity).max())
    moving = np.nonzero(direction)[0]
    if moving.size == 0:
        return ((0, q_ref.size),)
    turns = moving[1:][np.diff(direction[moving]) != 0]
    edges = [0, *(int(turn) for turn in turns), q_ref.size]
    if len(edges) == 2:
        count = min(max(1, int(np.ptp(q_ref) / TURN)), rules.MOST_TURNS)
        edges = np.linspace(0, q_ref.size, count + 1).astype(int).tolist()
    return tuple((a, b) for a, b in itertools.pairwise(edges) if b - a > 20)
