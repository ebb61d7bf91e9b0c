"""Records of one axis, with what is read from them once, whatever model and whatever noise they are judged by."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import NO_LIMIT, Axis
from emps_design.discrepancy.model.bands import FASTEST, band, cutoff, seen_up_to
from emps_design.discrepancy.model.following import Lead
from emps_design.effects import Motion
from emps_design.identification.filters import motion
from emps_design.laws import NONE, law_of
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.simulation.driven import driven_by


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
        """What drives the simulation of every record, but for what leads it along its motion."""
        return tuple(driven_by(self.axis, record) for record in self.records)

    @cached_property
    def bands(self) -> tuple[float, ...]:
        """The :func:`band` of every record [Hz]."""
        return tuple(band(record) for record in self.records)

    @cached_property
    def cutoffs(self) -> tuple[float, ...]:
        """The frequencies [Hz] up to which the force that a model misses is looked at on every record.

        Twice the band of the command, where that is faster than usual.
        """
        pairs = zip(self.records, self.bands, strict=True)
        return tuple(max(cutoff(record.period), min(2.0 * fast, FASTEST / record.period)) for record, fast in pairs)

    @cached_property
    def leads(self) -> tuple[Lead, ...]:
        """What leads the models along every record, where they follow its motion."""
        mass = self.axis.mechanics.mass
        return tuple(Lead.along(record, mass) for record in self.records) if self.follows else ()

    @cached_property
    def unlimited(self) -> Axis:
        """The axis without a limit of its command: what was recorded is what was given."""
        return self.axis.replace(drive={"command_limit": NO_LIMIT})

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


def _commands(axis: Axis, record: Record, q: np.ndarray) -> np.ndarray:
    """What the law of ``axis`` would ask for (n,) along the positions ``q`` (n,) [m], in units of the command."""
    law = law_of(axis, record.period, record.extra)
    return law.commands(law.followed(record), q, np.inf, record.f_ext)


def missing_while_off(axis: Axis, record: Record, wanted: np.ndarray, q: np.ndarray) -> np.ndarray:
    """What the law ``wanted`` along ``record``, less what it would along ``q`` (n,) [N]; 0 while the motor is on."""
    more = motor_force(axis, replace(record, u=wanted - _commands(axis, record, q), enable=None))
    return np.where(record.enable == 0.0, more, 0.0)
