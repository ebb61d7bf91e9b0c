"""How a model is led along a recorded motion, where the controller that made it is not known.

With ``controller.kind = "none"`` the model becomes an inverse model: it gets the recorded command, and a damper and a
spring lead it along the recorded motion. Their force is what the model lacks, with every hidden state of it in its
place. They take energy and give none, so that no model is unstable that way, at any sampling period; whether a
controller, a hand or nothing made the motion does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy.model.bands import FASTEST
from emps_design.effects import Effect
from emps_design.identification.filters import motion
from emps_design.records import Record
from emps_design.simulation import Run
from emps_design.simulation.environment import Guide

RATE = 0.5  # of the highest frequency of a record, of what leads: as stiff as need be
POSITION_SHARE = 0.25  # of the damper's rate, of the spring beside it: critically damped


@dataclass(frozen=True)
class Lead:
    """A ``guide`` along ``way`` (n, 3), every ``period`` [s]: position [m], velocity [m/s], acceleration [m/s^2] on it.

    The acceleration is the mean until the next sample, as the command is that is held till then.
    """

    guide: Guide
    way: np.ndarray
    period: float

    @classmethod
    def along(cls, record: Record, mass: float) -> Lead:
        """What leads a model of about ``mass`` [kg] along ``record``."""
        highest = FASTEST / record.period
        seen, rate = motion(record, highest), 2.0 * np.pi * RATE * highest
        damping = mass * rate
        way = np.column_stack([seen.q, seen.v, np.append(np.diff(seen.v), 0.0) / record.period])
        return cls(Guide(damping, POSITION_SHARE * damping * rate), way, record.period)

    def of_carriage(self, effects: list[tuple[Effect, np.ndarray]]) -> Lead:
        """The same for the carriage itself, where ``effects`` with their numbers are an encoder's error."""
        sensed = [(effect.sensor, values) for effect, values in effects if effect.sensor is not None]
        if not sensed:
            return self
        none, t = np.zeros(4), self.period * np.arange(len(self.way))
        places = zip(self.way[:, 0].tolist(), t.tolist(), strict=True)
        error = [sum(sensor(q, 0.0, s, 0.0, none, values, none) for sensor, values in sensed) for q, s in places]
        slope = np.gradient(error, self.period)
        return Lead(
            self.guide,
            self.way - np.column_stack([error, slope, np.append(np.diff(slope), 0.0) / self.period]),
            self.period,
        )

    def force(self, run: Run, mass: float, viscous: float) -> np.ndarray:
        """Mean force (n,) [N] over each period that the model of ``run`` lacks, as a held command would give it.

        That of the guide, and what ``mass`` [kg] and ``viscous`` [N/(m/s)] friction would take where it lags.
        """
        q, v, a = self.way.T
        behind, slower = q - run.position, v - run.v
        ahead = np.append((q + self.period * (v + 0.5 * self.period * a))[:-1] - run.position[1:], behind[-1])
        later = np.append((v + self.period * a)[:-1] - run.v[1:], slower[-1])
        mean = 0.5 * (behind + ahead) + self.period / 12.0 * (slower - later)
        taken = mass * (later - slower) + (self.guide.damping + viscous) * (ahead - behind)
        return taken / self.period + self.guide.stiffness * mean
