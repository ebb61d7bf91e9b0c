"""What frequencies a record tells of: bounded by its sampling period, its command, its motion and its encoder."""

from __future__ import annotations

import itertools
import math

import numpy as np

from emps_design.identification.filters import low_pass, motion
from emps_design.importing.account import step_seen
from emps_design.records import Record

CUTOFF_HZ = 60.0  # up to which forces are looked at where the command is no faster
FASTEST = 0.4  # of the sampling rate, the most that is looked at
NOISY = 0.03  # of an acceleration: most that the noise of the encoder may be where an inertia is to be seen
STANDS_OUT = 10.0  # times the encoder's noise, in power: less is no motion
BANDS, FEW = 40, 3  # bands in which the power of a motion is looked at, and the least lines of one
LOWEST, SLOWEST = 5.0, 100.0  # periods in a record, of the first band, and of the last that is given up
USUAL = 1e-3  # s, period of a fast record
IN_BAND = 0.9  # of the power of a command


def cutoff(period: float) -> float:
    """The frequency [Hz] up to which forces sampled every ``period`` [s] are looked at.

    >>> cutoff(1e-3), cutoff(0.02)
    (60.0, 20.0)
    """
    return min(CUTOFF_HZ, FASTEST / period)


def as_many(count: int, period: float) -> int:
    """How many samples every ``period`` [s] tell as much as ``count`` of a fast record, which are hardly apart.

    >>> as_many(500, 1e-3), as_many(500, 0.01)
    (500, 75)
    """
    return count if FASTEST / period >= CUTOFF_HZ else math.ceil(count * CUTOFF_HZ * USUAL / FASTEST)


def band(record: Record) -> float:
    """The frequency [Hz] below which nine tenths of what the command changes lie.

    >>> t = np.arange(4000) * 1e-3
    >>> round(band(Record(t, t, t, np.sin(2 * np.pi * 72 * t), 1e-3)))
    72
    """
    power = np.cumsum(np.abs(np.fft.rfft(record.u - record.u.mean())) ** 2)
    return float(np.searchsorted(power, IN_BAND * power[-1])) / (len(record) * record.period)


def seen_up_to(record: Record) -> float:
    """Band [Hz] in which the encoder's noise is a small part of the acceleration, from :func:`cutoff` on.

    An inertia that is missed changes how the loop answers up to where it has gain.
    """
    usual, density = cutoff(record.period), _density(record)
    size = np.var(motion(record, usual).a)
    most = (5.0 * NOISY**2 * size / max(density, 1e-300)) ** 0.2
    return float(np.clip(most, usual, FASTEST / record.period))


def told_up_to(record: Record, resolution: float) -> float:
    """The frequency [Hz] at which the motion sinks in the noise of an encoder of ``resolution`` [m].

    The noise is taken as white: as much as there is in the upper half of the spectrum, where no motion is, and no less
    than steps of ``resolution`` make, or of those in which the position is seen to move.

    >>> t = np.arange(4000) * 1e-3
    >>> way = np.cumsum(np.cumsum(np.random.default_rng(0).standard_normal(4000))) * 1e-6
    >>> seen = [np.round(way / step) * step for step in (1e-9, 1e-5, 1e-3)]
    >>> [round(told_up_to(Record(t, q, q, t, 1e-3), 0.0)) for q in seen]
    [146, 53, 25]
    """
    highest, duration = FASTEST / record.period, len(record) * record.period
    bent = np.diff(record.q, 2)  # else the foot of the slow motion would cover all
    frequency = np.fft.rfftfreq(bent.size, record.period)[1:]
    power = np.abs(np.fft.rfft(np.hanning(bent.size) * bent)[1:]) ** 2 / np.sin(np.pi * frequency * record.period) ** 4
    edges = np.geomspace(max(LOWEST / duration, frequency[0]), highest, BANDS + 1)
    places = np.searchsorted(frequency, edges)
    step = max(resolution, step_seen(record) or 0.0)
    steps = 16.0 * 0.375 * bent.size * step**2 / 12.0
    noise = max(float(np.median(power[places[-1] // 2 : places[-1]])) / np.log(2.0), steps)
    least = min(SLOWEST / duration, highest)
    for low, high in reversed(list(itertools.pairwise(places))):
        if high - low >= FEW and float(np.mean(power[low:high])) >= STANDS_OUT * noise:
            return float(max(frequency[high - 1], least))
    return least


def _density(record: Record) -> float:
    """What the encoder's noise is of an acceleration at ``f`` [Hz], over f^4 [m^2/s^4/Hz^5].

    The noise, taken as white, is what is seen of the position beyond any motion, its usual size: impacts are motion.
    """
    fastest = FASTEST / record.period
    beyond = np.abs(record.q - low_pass(record.q, fastest, record.period))
    noise = (np.median(beyond) / 0.6745) ** 2 / (1.0 - 2.0 * FASTEST)
    return float(2.0 * record.period * noise * (2.0 * np.pi) ** 4)
