"""The operator's task: guide the carriage with a compliant hand, or push it with a set force; then release it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.robustness import break_away, corner_errors, stacked
from emps_design.control.impedance.sampled import (
    Clock,
    Environment,
    numbers,
    relay_oscillations,
    sampled_loop,
    sampled_loops,
)
from emps_design.control.sampled import MARGINAL
from emps_design.errors import InputError
from emps_design.units import TURN

HAND = (1000.0, 100.0)  # N/m and N/(m/s) of an operator's hand
RATES = (0.4, 1.0)  # Hz, about, at which a hand moves the carriage to and fro
PACE = 2.0 * math.pi * RATES[0]  # rad/s
HELD, CALMING, WATCHED = 5.0, 4.0, 1.0  # s, at least: in the hand, calming down, watched for a verdict
DECAYS, CYCLES = 8.0, 3.0  # time constants of the slowest pole, periods of the slowest oscillation that is predicted
LONGEST = 400_000  # samples after the release


@dataclass(frozen=True)
class Task:
    """An operator's task, sampled with the controller.

    ``push`` (n,) [N] is the operator's force, zero from ``release`` on; ``wish`` (n,) [m] is the position that the hand
    aims at, nan from ``release`` on. ``hand``: its stiffness [N/m] and damping [N/(m/s)]; its force is held over each
    period. The carriage is released at sample ``release``; verdicts use the samples from ``end`` on.
    """

    name: str
    push: np.ndarray
    wish: np.ndarray
    hand: tuple[float, float]
    release: int
    end: int
    period: float
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The operator's task, SI units."""
        wish = self.wish[: self.release]
        return {
            "name": self.name,
            "hand": {"stiffness": self.hand[0], "damping": self.hand[1]},
            "push": float(np.abs(self.push).max()),
            "travel": float(np.nanmax(np.abs(wish))) if np.isfinite(wish).any() else None,
            "release": self.release * self.period,
            "watched_from": self.end * self.period,
            "duration": self.duration,
        }

    @property
    def time(self) -> np.ndarray:
        """Sample times [s], shape (n,)."""
        return np.arange(len(self.push)) * self.period

    @property
    def reversed(self) -> Task:
        """The same task in the opposite direction."""
        return replace(self, push=-self.push, wish=-self.wish)

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self.push) * self.period

    @cached_property
    def turns(self) -> np.ndarray:
        """Cosine and minus sine of the phase of both frequencies of the task while it lasts, shape (release, 4)."""
        phase = 2.0 * np.pi * np.outer(np.arange(self.release) / self.release, periods_of(self.release * self.period))
        return np.stack([np.cos(phase), -np.sin(phase)], axis=-1).reshape(self.release, -1)


def guided_task(
    period: float,
    duration: float = 10.0,
    hand: tuple[float, float] = HAND,
    scale: float = 1.0,
    free: float | None = None,
    watched: float | None = None,
) -> Task:
    """Return a task in which a hand guides the carriage over +-0.12 m and releases it in motion.

    ``hand`` is its stiffness [N/m] and damping [N/(m/s)]. It aims at 0.10 m at about 0.4 Hz plus 0.02 m at about 1 Hz,
    times ``scale``, faded in over half a second, with whole periods up to the release at half of ``duration`` [s],
    where the carriage is fastest; the force follows from the law. Free motion of ``free`` [s] follows, by default the
    other half; a verdict uses the last ``watched`` [s], by default a tenth of ``duration``. :func:`fitted_task` chooses
    all this for an axis and a law. Raises :class:`InputError` for a scale that is not above 0.
    """
    if not np.isfinite(scale) or scale <= 0.0:
        raise InputError(f"scale: found {scale:g}, expected a number above 0")
    n, release, end = _samples(period, duration, free, watched)
    t = np.arange(n) * period
    until = release * period
    position = sum(
        amplitude * np.sin(2 * np.pi * periods * t / until)
        for amplitude, periods in zip((0.10, 0.02), periods_of(until), strict=True)
    )
    rise = np.clip(t / min(0.5, 0.5 * until), 0.0, 1.0)
    position = scale * position * rise**2 * (3.0 - 2.0 * rise)
    return Task("guided", np.zeros(n), np.where(np.arange(n) < release, position, np.nan), hand, release, end, period)


def periods_of(until: float) -> tuple[int, int]:
    """Whole periods of the two frequencies, about 0.4 and 1 Hz, in a task of ``until`` seconds; at least one of each.

    >>> periods_of(5.0)
    (2, 5)
    """
    slow, fast = (max(1, round(rate * until)) for rate in RATES)
    return slow, fast


def pushed_task(
    period: float,
    duration: float = 10.0,
    force: float = 40.0,
    free: float | None = None,
    watched: float | None = None,
) -> Task:
    """Return a task of pushes of ``force`` [N] to and fro with 0.25 s ramps, the last ending at half time (Fig. 12).

    The force must exceed the break-away force, or nothing moves: the law compensates no Coulomb friction at rest.
    Raises :class:`InputError` for a force that is not above 0.
    ``free`` and ``watched`` [s] as in :func:`guided_task`.
    """
    if not np.isfinite(force) or force <= 0.0:
        raise InputError(f"force: found {force:g} N, expected a push of more than 0 N")
    n, release, end = _samples(period, duration, free, watched)
    t = np.arange(n) * period / (release * period / 5.0)  # the plan is written for 5 s
    corners = [0.0, 0.25, 0.5, 1.5, 2.0, 3.25, 3.75, 4.75, 5.0]
    levels = [0.0, 0.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 0.0]
    push = force * np.interp(t, corners, levels, right=0.0)
    return Task("pushed", push, np.full(n, np.nan), (0.0, 0.0), release, end, period)


def fitted_task(
    axis: Axis,
    law: ImpedanceLaw,
    mismatch: float = 0.0,
    force: float | None = None,
    hand: tuple[float, float] | None = None,
) -> Task:
    """Return a task suited to judge ``law`` on ``axis``: a guided one, or pushes of ``force`` [N].

    The hand is strong enough to break the carriage away and to lead the apparent mass, and soft enough for a light
    carriage (:func:`fitted_hand`; ``hand`` sets it). The free motion lasts eight time constants of the slowest pole at
    the corners of ``mismatch``, and a verdict uses three periods of the slowest oscillation that the describing
    function predicts there; at least 4 s and 1 s.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> task = fitted_task(axis, impedance_law(axis, 50.0, 100.0)).to_dict()
    >>> task["hand"], round(task["duration"])
    ({'stiffness': 1000.0, 'damping': 100.0}, 10)
    """
    period = axis.sampling.period
    calming, watched = _slowest(axis, law, mismatch)
    words = []
    if calming + watched > LONGEST * period:
        words.append(
            f"the slowest mode takes {calming + watched:.3g} s to show what it does, the simulated task ends "
            f"{LONGEST * period:g} s after the release: slow creep and slow oscillations may be missed"
        )
        share = LONGEST * period / (calming + watched)
        calming, watched = share * calming, share * watched
    held = max(HELD, 50 * period)
    times = {"duration": 2.0 * held, "free": calming + watched, "watched": watched}
    if force is not None:
        task = pushed_task(period, force=force, **times)
        stuck = break_away(law, FrictionModel.of(axis))
        if force <= stuck:
            words.append(f"a push of {force:g} N does not break the carriage away, which takes {stuck:.4g} N")
    else:
        fitted, scale = fitted_hand(axis, law)
        task = guided_task(period, hand=hand or fitted, scale=scale, **times)
    return replace(task, warnings=tuple(words))


def usual_scale(axis: Axis) -> float:
    """Scale of the 0.12 m travel of the guided task on ``axis``: 1, or 5 on a rotary one, which makes it 0.6 rad.

    If most of the travel were break-away, the motion would not show the apparent inertia.
    """
    return TURN if axis.units.rotary else 1.0


def fitted_hand(axis: Axis, law: ImpedanceLaw) -> tuple[tuple[float, float], float]:
    """Return a hand (stiffness [N/m], damping [N/(m/s)]) for ``law`` on ``axis``, and the share of the 0.12 m it moves.

    1000 N/m and 100 N/(m/s) by default. Stiffer if three times the break-away force or the apparent impedance at the
    frequency of the movement requires it; softer for a light carriage, which a force held for a period would set
    swinging, and while the loop with the hand is unstable. The travel is that of :func:`usual_scale`, less if the motor
    would reach its limit.
    """
    length = usual_scale(axis)
    plant, period = FrictionModel.of(axis), axis.sampling.period
    stuck, light = break_away(law, plant), min(plant.mass, law.mass)
    viscous = max(plant.viscous)
    lead = abs(complex(law.damping, PACE * law.mass)) * PACE  # N/m, the apparent impedance over the position
    motor = abs(complex(viscous - law.damping, PACE * (plant.mass - law.mass))) * PACE * 0.24 * length  # N, full travel
    jolt = max(1.0, law.ratio) * max(plant.coulomb)  # N, of the Coulomb compensation when the velocity turns
    room = 0.85 * axis.drive.gain * axis.drive.command_limit - jolt
    scale = length * float(np.clip(room / motor, 0.01, 1.0)) if motor > 0.0 else length
    stiffness = max(HAND[0], 3.0 * stuck / (0.12 * scale), 2.0 * lead)
    stiffness = min(stiffness, 0.05 * light / period**2, 2.0 * light / period)
    for _ in range(12):
        contact = Environment(0.0, 0.1 * stiffness, stiffness)
        if sampled_loop(law, plant, Clock.of(axis), environment=contact).stable:
            break
        stiffness *= 0.5
    return (stiffness, 0.1 * stiffness), max(scale, 3.0 * stuck / (0.12 * stiffness))


def _slowest(axis: Axis, law: ImpedanceLaw, mismatch: float) -> tuple[float, float]:
    """Return the settling time of the released carriage and the time in which a limit cycle shows, both [s]."""
    plant, clock = FrictionModel.of(axis), Clock.of(axis)
    corners: list[dict[str, float]] = [{}, *(corner_errors(mismatch) if mismatch else ())]
    together, decay = law.with_errors(stacked(corners)), math.inf
    for direction in plant.directions:
        loops = sampled_loops(numbers(together, plant, direction), clock, law.velocity_estimator, law.force_sensor)
        poles = np.abs(loops.poles)
        inside = poles[(poles > 0.0) & (poles < 1.0 - MARGINAL)]
        if inside.size:
            decay = min(decay, -math.log(inside.max()) / clock.period)
    oscillations = relay_oscillations(together, plant, clock)
    slowest = min((oscillation[0] for oscillation in oscillations if oscillation is not None), default=math.inf)
    return max(CALMING, DECAYS / decay), max(WATCHED, CYCLES * 2.0 * math.pi / slowest)


def _samples(period: float, duration: float, free: float | None, watched: float | None) -> tuple[int, int, int]:
    n = round(duration / period)
    if not np.isfinite(duration) or n < 100:
        raise InputError(f"duration: found {duration:g} s, expected at least 100 periods of {period:g} s")
    release = n // 2
    last = n // 10 if watched is None else max(1, round(watched / period))
    n = n if free is None else release + max(100, round(free / period))
    return n, release, n - min(last, n - release)
