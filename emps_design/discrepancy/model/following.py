"""What drives the simulation of a record: its reference through the controller, or the recorded motion itself.

Where the controller is not known (``controller.kind = "none"``) the model becomes an inverse model: it gets the
recorded voltage, and a position law of this module adds what keeps it on the recorded motion. That correction is the
force the model lacks, seen through the bandwidth of the law, with every hidden state of the model in its place.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.identification.filters import low_pass
from emps_design.laws.library import position_pd
from emps_design.records import Record

IN_BAND = 0.9  # of the power of a command
BANDWIDTH_HZ = 25.0  # of the velocity loop that follows; the encoder's noise, differentiated, sets the upper end
LEAST_SAMPLES = 40  # per period of that bandwidth: with fewer the two-tap velocity loses too much phase
FAST_SAMPLES = 12  # the same where the command itself is that fast
COMPARED = 1.3  # of that bandwidth, up to which forces count: beyond it the law passes on the encoder's noise
POSITION_SHARE = 0.25  # of the velocity loop's bandwidth, for the position loop around it


def band(record: Record) -> float:
    """The frequency [Hz] below which nine tenths of what the command changes lie.

    >>> t = np.arange(4000) * 1e-3
    >>> round(band(Record(t, t, t, np.sin(2 * np.pi * 72 * t), 1e-3)))
    72
    """
    power = np.cumsum(np.abs(np.fft.rfft(record.u - record.u.mean())) ** 2)
    return float(np.searchsorted(power, IN_BAND * power[-1])) / (len(record) * record.period)


def bandwidth(record: Record, band_hz: float) -> float:
    """Bandwidth [Hz] of the velocity loop that follows ``record``, whose :func:`band` is ``band_hz``."""
    usual = min(BANDWIDTH_HZ, 1 / (LEAST_SAMPLES * record.period))
    return max(usual, min(band_hz, _fastest(record)))


def _fastest(record: Record) -> float:
    """The highest bandwidth [Hz] at which ``record`` can be followed by a law that is computed once a sample."""
    return 1 / (FAST_SAMPLES * record.period)


def followed(force: np.ndarray, record: Record, band_hz: float) -> np.ndarray:
    """What of a ``force`` (n,) [N] that keeps a model on ``record`` is for its motion, not for the encoder's noise."""
    return low_pass(force, COMPARED * bandwidth(record, band_hz), record.period)


def drive(start: dict[str, Any], axis: Axis, record: Record, mass: float, band_hz: float) -> dict[str, Any]:
    """Keywords of :meth:`Plant.closed_loop` that make the simulation of ``record`` start and move as it did.

    ``start`` is :func:`~emps_design.simulation.driven.driven_by` of ``axis`` and ``record``; ``mass`` [kg] is the
    model's: a heavier one would else be followed less, and leave less of the force, and the loop of a much lighter one
    would be too fast for the sampling. ``band_hz`` is the :func:`band` of the record.
    """
    if "law" in start:
        return dict(start)
    own = bandwidth(record, band_hz)
    rate = 2 * np.pi * own  # rad/s
    moved = min(np.hypot(mass, axis.mechanics.mass) / np.sqrt(2.0), mass * _fastest(record) / own)
    kp, kv = POSITION_SHARE * rate, moved * rate / axis.drive.gain
    law = position_pd.LAW.law(position_pd.Table(kp=kp, kv=kv), axis, record.period)
    past = np.concatenate((np.full(2, record.q[0]), record.q[:-2]))
    # The law brakes its own velocity: leading the reference by v/kp makes it act on the difference of velocities.
    lead = (record.q - past) / (2 * record.period) / kp
    return {**start, "law": law, "reference": record.q + lead, "voltage_noise": record.u}
