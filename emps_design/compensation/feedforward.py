"""Feed-forward along a reference: the command that the motion needs by the model, added to that of the law.

Terms are ``inertia``, ``viscous``, ``coulomb`` and ``constant`` of the baseline, ``lead`` for the delay between
command and force, and one for each effect of the axis that acts on the carriage as a force of position and velocity.
Every term evaluates the effect's own kernel on the reference. Friction takes the sign of the reference velocity and is
proportional to it below a small speed, so it does not chatter at a reversal. The law acts on the position error alone:
its response to the reference itself (the braking of a velocity feedback) is already part of the feed-forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from emps_design.effects import Effect
from emps_design.effects.effect import COULOMB, MASS, OFFSET, VISCOUS

if TYPE_CHECKING:
    from emps_design.axis import Axis

BASELINE = {"inertia": MASS, "viscous": VISCOUS, "coulomb": COULOMB, "constant": OFFSET}
LEAD = "lead"
REVERSAL = 2e-3  # of the reference's highest speed: below it friction is fed forward in proportion to the speed


@dataclass(frozen=True)
class FeedForward:
    """Feed-forward of the ``terms`` of an ``axis``; ``baseline`` and ``parameters`` replace the axis's own."""

    axis: Axis
    terms: tuple[str, ...]
    baseline: np.ndarray = field(repr=False)
    parameters: tuple[np.ndarray, ...] = field(repr=False)
    back_emf: float = 0.0  # N/(m/s), braking of a motor without a current loop: part of the viscous term
    late: float = 0.0  # s, from command to force, without the hold and the computation delay
    reversal: float = 0.0  # m/s, friction is proportional to velocity below it; 0: a share of the highest speed

    @classmethod
    def of(cls, axis: Axis, terms: Sequence[str]) -> FeedForward:
        """The feed-forward of ``terms`` with the numbers of ``axis``."""
        parameters = tuple(entry.effect.values(entry.parameters) for entry in axis.effects)
        braked = axis.drive.braking if "viscous" in terms else 0.0
        return cls(axis, tuple(terms), axis.mechanics.array(), parameters, braked, lateness(axis))

    def along(self, q_ref: np.ndarray) -> np.ndarray:
        """Return the command (n,) that is added along ``q_ref`` (n,) [m] to that of the law on its error.

        >>> from emps_design.machines import machine
        >>> ahead = FeedForward.of(machine("emps2019"), ("constant",)).along(np.zeros(5))
        >>> ahead.round(4).tolist()
        [-0.09, -0.09, -0.09, -0.09, -0.09]
        """
        period = self.axis.sampling.period
        q, v, a = motion_ahead(q_ref, period, self.wait)
        return replace(self, reversal=self.reversal or reversal_of(q_ref, period)).command(q, v, a)

    @property
    def wait(self) -> float:
        """Time [s] from a sample to the middle of the period in which its command acts."""
        sampling = self.axis.sampling
        return (0.5 + sampling.computation_delay) * sampling.period + (self.late if LEAD in self.terms else 0.0)

    def command(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Command (n,) that the motion ``q`` [m], ``v`` [m/s], ``a`` [m/s^2] (n,) needs, by the terms."""
        from emps_design.simulation.kernels.inverse import force_along, table

        direction = np.clip(v / self.reversal, -1.0, 1.0) if self.reversal > 0.0 else np.zeros(q.size)
        chosen = self.effects()
        hooks, starts = table([effect for _, effect, _ in chosen])
        p, force = np.concatenate([np.zeros(0), *(values for _, _, values in chosen)]), np.empty(q.size)
        force_along(q, v, a, direction, self.own(), self.baseline, hooks, starts, p, np.zeros(1), force)
        return (force + self.back_emf * v if self.back_emf else force) / self.axis.drive.gain

    def own(self) -> np.ndarray:
        """The baseline (4,), 0 for each parameter that is not among the terms."""
        return np.array([self.baseline[at] if name in self.terms else 0.0 for name, at in BASELINE.items()])

    def effects(self) -> list[tuple[str, Effect, np.ndarray]]:
        """Name, effect and parameters of every effect among the terms."""
        each = zip(names_of_effects(self.axis), self.axis.effects, self.parameters, strict=True)
        return [(name, entry.effect, values) for name, entry, values in each if name in self.terms]


def reversal_of(q_ref: np.ndarray, period: float) -> float:
    """The speed [m/s] below which friction is fed forward in proportion, along a reference ``q_ref`` (n,) [m]."""
    return REVERSAL * float(np.abs(motion_ahead(q_ref, period, 0.0)[1]).max(initial=0.0))


def names_of_effects(axis: Axis) -> list[str]:
    """A name for each effect of ``axis``: its kind, numbered where there are several of one."""
    kinds, names = [entry.kind for entry in axis.effects], []
    for place, kind in enumerate(kinds):
        names.append(kind if kinds.count(kind) == 1 else f"{kind}_{kinds[: place + 1].count(kind)}")
    return names


def terms_of(axis: Axis) -> tuple[tuple[str, ...], dict[str, str]]:
    """Every term that ``axis`` has, and a line for each of its effects that cannot be compensated."""
    terms, not_compensated = [*BASELINE], {}
    for name, entry in zip(names_of_effects(axis), axis.effects, strict=True):
        reason = why_not(entry.effect)
        if not reason:
            terms.append(name)
        elif entry.effect.delay is None and entry.effect.lag is None:
            not_compensated[name] = reason
    return (*terms, *([LEAD] if lateness(axis) > 0.0 else [])), not_compensated


def lateness(axis: Axis) -> float:
    """Time [s] by which the force lags the command: current loop, lags and delays among the effects."""
    b, late = axis.mechanics.array(), axis.drive.current_time_constant
    for entry in axis.effects:
        p = entry.effect.values(entry.parameters)
        for hook in (entry.effect.delay, entry.effect.lag):
            late += hook(0.0, 0.0, 0.0, 0.0, np.zeros(0), p, b) if hook is not None else 0.0
    return float(late)


def why_not(effect: Effect) -> str:
    """Return why no force of the present position and velocity stands for ``effect``; empty if one does."""
    if effect.rate is not None:
        return "it has a state of its own, which position and velocity do not give"
    if effect.channel != "plant":
        return f"it acts in the {effect.channel}, not as a force of position and velocity"
    if effect.over == "t":
        return "it goes by the time of one record, which a controller does not know"
    return ""


def motion_ahead(q_ref: np.ndarray, period: float, wait: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (n,) of ``q_ref`` (n,) a time ``wait`` [s] later, at rest before and after.

    >>> q, v, a = motion_ahead(np.array([0.0, 1.0, 2.0, 3.0]), 1.0, 0.5)
    >>> q.tolist(), v.tolist()
    ([0.5, 1.5, 2.5, 3.0], [0.75, 1.0, 0.75, 0.5])
    """
    edged = np.concatenate([q_ref[:1], q_ref, q_ref[-1:]])
    v = (edged[2:] - edged[:-2]) / (2.0 * period)
    a = (edged[2:] - 2.0 * edged[1:-1] + edged[:-2]) / period**2
    at = np.arange(q_ref.size) + wait / period
    index = np.arange(q_ref.size)
    return np.interp(at, index, q_ref), np.interp(at, index, v), np.interp(at, index, a)
