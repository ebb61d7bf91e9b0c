"""Records of one axis, with what is read from them once, whatever model and whatever noise they are judged by."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy.model.following import band
from emps_design.effects import Motion
from emps_design.identification.filters import low_pass, motion
from emps_design.laws import NONE, law_of
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.simulation.driven import driven_by

CUTOFF_HZ = 60.0  # up to which forces are looked at where the command is no faster
FASTEST = 0.4  # of the sampling rate, to which a fast command raises the cut-off
NOISY = 0.03  # of an acceleration: most that the noise of the encoder may be in the band that is looked at


@dataclass(frozen=True, eq=False)
class Recorded:
    """The ``records`` of an ``axis``."""

    axis: Axis
    records: tuple[Record, ...]

    @property
    def follows(self) -> bool:
        """Whether models follow the recorded motion, for want of the controller that made it."""
        return bool(self.axis.controller.kind == NONE)

    @cached_property
    def starts(self) -> tuple[dict[str, Any], ...]:
        """What drives the simulation of every record, but for a law that follows its motion."""
        return tuple(driven_by(self.axis, record) for record in self.records)

    @cached_property
    def bands(self) -> tuple[float, ...]:
        """The :func:`band` of every record [Hz]."""
        return tuple(band(record) for record in self.records)

    @cached_property
    def forces(self) -> tuple[np.ndarray, ...]:
        """The motor force (n,) [N] that the command of every record asks for."""
        return tuple(motor_force(self.axis, record) for record in self.records)

    @cached_property
    def asked(self) -> tuple[np.ndarray | None, ...]:
        """What the law asks for (n,) along every record in which the motor is switched off, None of the others."""
        off = [not self.follows and record.enable is not None and not record.enable.all() for record in self.records]
        return tuple(
            _commands(self.axis, record, record.q) if one else None
            for record, one in zip(self.records, off, strict=True)
        )

    @cached_property
    def motions(self) -> tuple[Motion, ...]:
        """The motion of every record in the band in which its acceleration is seen."""
        return tuple(motion(record, seen_up_to(record)) for record in self.records)


def seen_up_to(record: Record) -> float:
    """Band [Hz] in which the encoder's noise is a small part of the acceleration, from ``CUTOFF_HZ`` on.

    An inertia that is missed changes how the loop answers up to where it has gain. The noise, taken as white, is what
    is seen of the position beyond any motion, its usual size: impacts are motion.
    """
    fastest = FASTEST / record.period
    beyond = np.abs(record.q - low_pass(record.q, fastest, record.period))
    noise = (np.median(beyond) / 0.6745) ** 2 / (1.0 - 2.0 * FASTEST)
    density = 2.0 * record.period * noise * (2.0 * np.pi) ** 4  # of the acceleration over f^4 [m^2/s^4/Hz^5]
    size = np.var(motion(record, CUTOFF_HZ).a)
    most = (5.0 * NOISY**2 * size / max(density, 1e-300)) ** 0.2
    return float(np.clip(most, CUTOFF_HZ, fastest))


def _commands(axis: Axis, record: Record, q: np.ndarray) -> np.ndarray:
    """What the law of ``axis`` would ask for (n,) along the positions ``q`` (n,) [m], in units of the command."""
    law = law_of(axis, record.period, record.extra)
    return law.commands(law.followed(record), q, np.inf, record.f_ext)


def missing_while_off(axis: Axis, record: Record, wanted: np.ndarray, q: np.ndarray) -> np.ndarray:
    """What the law ``wanted`` along ``record``, less what it would along ``q`` (n,) [N]; 0 while the motor is on."""
    more = motor_force(axis, replace(record, u=wanted - _commands(axis, record, q), enable=None))
    return np.where(record.enable == 0.0, more, 0.0)
