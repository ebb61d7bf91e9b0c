"""The operator's task, the measures of a simulated run, and the verdict that follows from them.

The operator guides the carriage with a compliant hand, or pushes it with a given force, and releases it. The measures
are computed sample by sample.

The apparent impedance is evaluated at the frequencies of the task. ``F``, ``V`` and ``A`` are sums of the force, the
mean velocity and the mean acceleration per period, times ``exp(-j w t)``, over the guided samples in motion. Mass and
damping minimise ``|F - M A - B V|^2`` summed over the frequencies of the task. This is ``F/V = B + j w M`` weighted by
the spectrum of the velocity, and it is exact for a motion that does not begin and end at rest, too. A regression on the
acceleration of single samples would fit encoder steps instead of the mass: between samples they are much larger than
the acceleration of the motion, and the force does not follow them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.passivity import Clock, Environment, relay_oscillations, sampled_loop
from emps_design.control.impedance.robustness import VERDICTS, break_away, exact_and_corners, stacked
from emps_design.control.sampled import MARGINAL
from emps_design.errors import InputError
from emps_design.messages import Message, grave, warning
from emps_design.simulation.kernels.compile import inlined, part
from emps_design.units import TURN

USUAL_HAND = (1000.0, 100.0)  # N/m and N/(m/s) of an operator's hand
RATES = (0.4, 1.0)  # Hz, approximate frequencies of the hand's motion
PACE = 2.0 * math.pi * RATES[0]  # rad/s
HELD, SETTLING, WATCHED = 5.0, 4.0, 1.0  # s, minimum time: guided, settling, observed for the verdict
DECAYS, CYCLES = 8.0, 3.0  # time constants of the slowest pole, periods of the slowest predicted oscillation
LONGEST = 400_000  # samples after the release

# The measures in the order of their array; the sums at the two frequencies follow.
NAMES = (
    "peak_u", "clipped", "clipped_end", "flips", "peak_force", "force2", "impulse", "work", "path", "miss2", "held",
    "end_min_v", "end_max_v", "end_turns", "end_min_u", "end_max_u", "end_speed", "release_v", "moving", "drift",
    "ratio", "diverged",
)  # fmt: skip
(_PEAK_U, _CLIPPED, _CLIPPED_END, _FLIPS, _PEAK_FORCE, _FORCE2, _IMPULSE, _WORK, _PATH, _MISS2, _HELD,
 _END_MIN_V, _END_MAX_V, _END_TURNS, _END_MIN_U, _END_MAX_U, _END_SPEED, _RELEASE_V, _MOVING, _DRIFT, _RATIO, _DIVERGED,
 _SLOW) = range(len(NAMES) + 1)  # fmt: skip
_FAST, MEASURES = _SLOW + 6, _SLOW + 12  # acceleration, velocity and force, real and imaginary part each
_CHANGE = 0.01  # relative change of the speed between two spans below which it counts as rounding
_SWING = 50  # samples within which the voltage must change from one limit to the other to count as a flip


@dataclass(frozen=True)
class Task:
    """An operator's task, sampled with the controller.

    ``push`` (n,) [N] is the operator's force, zero from ``release`` on; ``wish`` (n,) [m] is the target position of the
    hand, nan from ``release`` on. ``hand`` is its stiffness [N/m] and damping [N/(m/s)]; its force is constant over
    each period. The carriage is released at sample ``release``; verdicts use the samples from ``end`` on.
    """

    name: str
    push: np.ndarray
    wish: np.ndarray
    hand: tuple[float, float]
    release: int
    end: int
    period: float
    warnings: tuple[Message, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The parameters of the task, SI units."""
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
        """Cosine and minus sine of the phase of both frequencies until the release, shape (release, 4)."""
        phase = 2.0 * np.pi * np.outer(np.arange(self.release) / self.release, periods_of(self.release * self.period))
        return np.stack([np.cos(phase), -np.sin(phase)], axis=-1).reshape(self.release, -1)


def guided_task(
    period: float,
    duration: float = 10.0,
    hand: tuple[float, float] = USUAL_HAND,
    scale: float = 1.0,
    free: float | None = None,
    watched: float | None = None,
) -> Task:
    """Return a task in which a hand guides the carriage over +-0.12 m and releases it in motion.

    ``hand`` is its stiffness [N/m] and damping [N/(m/s)]. Its target position is a sum of 0.10 m at about 0.4 Hz and
    0.02 m at about 1 Hz, times ``scale``, faded in over half a second. Whole periods end at the release at half of
    ``duration`` [s], where the speed is largest; the force follows from the law. Free motion of ``free`` [s] follows,
    by default the other half; a verdict uses the last ``watched`` [s], by default a tenth of ``duration``.
    :func:`fitted_task` chooses all this for an axis and a law. Raises :class:`InputError` unless the scale is above 0.
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
    """Return a task of alternating pushes of ``force`` [N] with 0.25 s ramps, which end at half time (Fig. 12).

    The force must exceed the break-away force to move the carriage, since the law compensates no Coulomb friction at
    rest. ``free`` and ``watched`` [s] as in :func:`guided_task`. Raises :class:`InputError` unless it is above 0.
    """
    if not np.isfinite(force) or force <= 0.0:
        raise InputError(f"force: found {force:g}, expected a push of more than 0")
    n, release, end = _samples(period, duration, free, watched)
    t = np.arange(n) * period / (release * period / 5.0)  # the profile is defined over 5 s
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
    """Return a task for the verdict on ``law`` on ``axis``: a guided one, or pushes of ``force`` [N].

    The hand is stiff enough to break the carriage away and to guide the apparent mass, and soft enough for a light
    carriage (:func:`fitted_hand`, unless ``hand`` is given). The free motion lasts eight time constants of the slowest
    pole at the corners of ``mismatch``, at least 4 s; the verdict uses three periods of the slowest oscillation that
    the describing function predicts there, at least 1 s.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> task = fitted_task(axis, impedance_law(axis, 50.0, 100.0)).to_dict()
    >>> task["hand"], round(task["duration"])
    ({'stiffness': 1000.0, 'damping': 100.0}, 10)
    """
    period = axis.sampling.period
    settling, watched = _slowest(axis, law, mismatch)
    messages = []
    if settling + watched > LONGEST * period:
        text = (
            f"the slowest mode needs {settling + watched:.3g} s for a verdict, but the simulated task ends "
            f"{LONGEST * period:g} s after the release: slow creep and slow oscillations may be missed"
        )
        messages.append(grave("task-too-short", text, needed=settling + watched, watched=LONGEST * period))
        share = LONGEST * period / (settling + watched)
        settling, watched = share * settling, share * watched
    held = max(HELD, 50 * period)
    times = {"duration": 2.0 * held, "free": settling + watched, "watched": watched}
    if force is not None:
        task = pushed_task(period, force=force, **times)
        starting = break_away(law, FrictionModel.of(axis))
        if force <= starting:
            units = axis.units
            text = (
                f"a push of {units.quantity(force, 'N', 'g')} does not move the {units.word('carriage')}: it is below "
                f"the break-away {units.word('force')} of {units.quantity(starting, 'N')}"
            )
            messages.append(warning("push-too-weak", text, force=force, break_away=starting))
    else:
        fitted, scale = fitted_hand(axis, law)
        task = guided_task(period, hand=hand or fitted, scale=scale, **times)
    return replace(task, warnings=tuple(messages))


def usual_scale(axis: Axis) -> float:
    """Scale of the 0.12 m travel of the guided task on ``axis``: 1, or 5 on a rotary one, for 0.6 rad.

    The travel must be large against the deflection of the hand at break-away to show the apparent inertia.
    """
    return TURN if axis.units.rotary else 1.0


def fitted_hand(axis: Axis, law: ImpedanceLaw) -> tuple[tuple[float, float], float]:
    """Return a hand (stiffness [N/m], damping [N/(m/s)]) for ``law`` on ``axis``, and the scale of its 0.12 m travel.

    The default is 1000 N/m and 100 N/(m/s). The hand is stiffer if three times the break-away force or the apparent
    impedance at the frequency of the motion requires it. It is softer for a light carriage, which would oscillate under
    a force that is constant over a period, and while the loop with the hand is unstable. The scale is that of
    :func:`usual_scale`, or smaller if the motor would reach its limit.
    """
    length = usual_scale(axis)
    plant, period = FrictionModel.of(axis), axis.sampling.period
    starting, light = break_away(law, plant), min(plant.mass, law.mass)
    viscous = max(plant.viscous)
    lead = abs(complex(law.damping, PACE * law.mass)) * PACE  # N/m, the apparent impedance over the position
    motor = abs(complex(viscous - law.damping, PACE * (plant.mass - law.mass))) * PACE * 0.24 * length  # N, full travel
    jump = max(1.0, law.ratio) * max(plant.coulomb)  # N, of the Coulomb compensation at a reversal
    available = 0.85 * axis.drive.gain * axis.drive.command_limit - jump
    scale = length * float(np.clip(available / motor, 0.01, 1.0)) if motor > 0.0 else length
    stiffness = max(USUAL_HAND[0], 3.0 * starting / (0.12 * scale), 2.0 * lead)
    stiffness = min(stiffness, 0.05 * light / period**2, 2.0 * light / period)
    for _ in range(12):
        contact = Environment(0.0, 0.1 * stiffness, stiffness)
        if sampled_loop(law, plant, Clock.of(axis), environment=contact).stable:
            break
        stiffness *= 0.5
    return (stiffness, 0.1 * stiffness), max(scale, 3.0 * starting / (0.12 * stiffness))


def _slowest(axis: Axis, law: ImpedanceLaw, mismatch: float) -> tuple[float, float]:
    """Return the settling time of the released carriage and the time to observe a limit cycle, both [s]."""
    plant, clock, corners = FrictionModel.of(axis), Clock.of(axis), exact_and_corners(mismatch)
    together, decay = law.with_errors(stacked(corners)), math.inf
    for direction in plant.directions:
        poles = np.abs(sampled_loop(together, plant, clock, direction).poles)
        inside = poles[(poles > 0.0) & (poles < 1.0 - MARGINAL)]
        if inside.size:
            decay = min(decay, -math.log(inside.max()) / clock.period)
    oscillations = relay_oscillations(together, plant, clock)
    slowest = min((oscillation[0] for oscillation in oscillations if oscillation is not None), default=math.inf)
    return max(SETTLING, DECAYS / decay), max(WATCHED, CYCLES * 2.0 * math.pi / slowest)


def _samples(period: float, duration: float, free: float | None, watched: float | None) -> tuple[int, int, int]:
    n = round(duration / period)
    if not np.isfinite(duration) or n < 100:
        raise InputError(f"duration: found {duration:g} s, expected at least 100 periods of {period:g} s")
    release = n // 2
    last = n // 10 if watched is None else max(1, round(watched / period))
    n = n if free is None else release + max(100, round(free / period))
    return n, release, n - min(last, n - release)


@part
def measure(q, v, u, force, wish, turns, limit, period, release, end, m):
    """Fill ``m`` (MEASURES,) from a run: ``q`` [m] and ``v`` [m/s] (n + 1,) include the final state.

    ``u`` [V], the operator's ``force`` [N], constant over each period, and the hand's target position ``wish`` [m] have
    n samples or one more; ``turns`` (release, 4) as :attr:`~emps_design.comanipulation.task.Task.turns`. The carriage
    is released at sample ``release``; a verdict uses the samples from ``end`` on.
    """
    n = q.size - 1
    last_clip, clipped_at = 0.0, 0
    reset(n, release, m)
    for k in range(n):
        if abs(u[k]) >= limit:
            clip = 1.0 if u[k] > 0.0 else -1.0
            m[_CLIPPED] += 1.0
            m[_CLIPPED_END] += 1.0 if k >= end else 0.0
            m[_FLIPS] += 1.0 if clip * last_clip < 0.0 and k - clipped_at <= _SWING else 0.0
            last_clip, clipped_at = clip, k
        if k < release:
            turn = (turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3])
            measure_guided(q[k], q[k + 1], v[k], v[k + 1], u[k], force[k], wish[k], turn, period, m)
        else:
            measure_free(v[k + 1], u[k], k, n, release, m)
        if k >= end:
            measure_end(q[k], q[k + 1], v[k], v[k + 1], u[k], m)
    finish(q[release:], v[release], n, release, end, period, m)


@part
def reset(n, release, m):
    """Set the measures ``m`` of ``n`` samples to their initial values."""
    for i in range(MEASURES):
        m[i] = 0.0
    m[_END_MIN_V], m[_END_MIN_U], m[_END_MAX_V], m[_END_MAX_U] = np.inf, np.inf, -np.inf, -np.inf
    m[_HELD], m[_MOVING] = release, n - release


@part
def measure_guided(q, q1, v, v1, u, force, wish, turn, period, m):
    """Measure one period before the release, from position and velocity at its beginning and its end.

    ``turn`` is a row of :attr:`Task.turns`, the slow frequency first.
    """
    moved, rate = q1 - q, 1.0 / period
    m[_PEAK_U] = max(m[_PEAK_U], abs(u))
    m[_PEAK_FORCE] = max(m[_PEAK_FORCE], abs(force))
    m[_FORCE2] += force * force
    m[_IMPULSE] += abs(force) * period
    m[_WORK] += force * moved
    m[_PATH] += abs(moved)
    m[_MISS2] += (wish - q) ** 2
    # Samples in motion only; means over the period in which the force is constant.
    moves = 1.0 if v * v1 > 0.0 else 0.0
    a, w, f = moves * ((v1 - v) * rate), moves * (moved * rate), moves * force
    slow_re, slow_im, fast_re, fast_im = turn
    m[_SLOW] += a * slow_re
    m[_SLOW + 1] += a * slow_im
    m[_SLOW + 2] += w * slow_re
    m[_SLOW + 3] += w * slow_im
    m[_SLOW + 4] += f * slow_re
    m[_SLOW + 5] += f * slow_im
    m[_FAST] += a * fast_re
    m[_FAST + 1] += a * fast_im
    m[_FAST + 2] += w * fast_re
    m[_FAST + 3] += w * fast_im
    m[_FAST + 4] += f * fast_re
    m[_FAST + 5] += f * fast_im


@part
def measure_free(v1, u, k, n, release, m):
    """Measure period ``k`` of ``n`` after the release: peak voltage, and number of samples until the first stop."""
    m[_PEAK_U] = max(m[_PEAK_U], abs(u))
    m[_MOVING] = k + 1.0 - release if v1 == 0.0 and m[_MOVING] == n - release else m[_MOVING]


@part
def measure_end(q, q1, v, v1, u, m):
    """Measure one of the periods that a verdict uses."""
    m[_END_MIN_V], m[_END_MAX_V] = min(m[_END_MIN_V], v1), max(m[_END_MAX_V], v1)
    m[_END_MIN_U], m[_END_MAX_U] = min(m[_END_MIN_U], u), max(m[_END_MAX_U], u)
    m[_END_TURNS] += 1.0 if v * v1 < 0.0 or (v != 0.0 and v1 == 0.0) else 0.0
    m[_END_SPEED] += q1 - q


@inlined
def finish(free, release_v, n, release, end, period, m):
    """Finish the measures: ``free`` (n + 1 - release,) [m] are the positions from the release on."""
    m[_END_SPEED] /= period * max(n - end, 1)
    m[_RELEASE_V] = release_v
    m[_DRIFT], m[_RATIO] = _drift(free, int(m[_MOVING]), period)


@part
def _drift(free, moving, period):
    """Return the limit of the free motion's speed [m/s] and the ratio of two changes of the speed.

    The limit is Aitken's extrapolation from the mean speeds of three equal spans, which is exact for one exponential
    decay. A negative limit means that dry friction stops the carriage in finite time. The first tenth is skipped, in
    which filters settle.
    """
    skip = moving // 10
    span = (moving - skip) // 3
    if span < 1:
        return 0.0, np.nan
    rate = 1.0 / (span * period)
    v1 = (free[skip + span] - free[skip]) * rate
    v2 = (free[skip + 2 * span] - free[skip + span]) * rate
    v3 = (free[skip + 3 * span] - free[skip + 2 * span]) * rate
    side = 1.0 if v1 >= 0.0 else -1.0
    first, second = v2 - v1, v3 - v2
    bend = second - first
    # A change much smaller than the speed is rounding, not growth.
    ratio = second / first if first != 0.0 and abs(second) > _CHANGE * abs(v3) else 0.0
    if abs(bend) > 1e-12 * (abs(v1) + abs(v3)):
        return side * (v3 - second * second / bend), ratio
    return side * v3, ratio


@part
def mark_unstable(limit, m):
    """Fill the measures of a run that ended early: diverged, peak voltage at the limit, the rest nan."""
    for i in range(MEASURES):
        m[i] = np.nan
    m[_DIVERGED], m[_PEAK_U] = 1.0, limit


@dataclass(frozen=True)
class Measures:
    """Measures of m simulated plants; every attribute is an array (m,).

    ``step`` [m/s] is one encoder step per period, ``threshold`` [m/s] is that of ``drift_threshold``; ``expected``
    [m/s] is the final speed of the free motion under friction, in closed form; ``integrates``: the law is a cascade.
    """

    raw: np.ndarray
    step: float
    threshold: np.ndarray
    expected: np.ndarray
    integrates: np.ndarray

    def __getattr__(self, name: str) -> np.ndarray:
        if name not in NAMES:
            raise AttributeError(name)
        return self.raw[:, NAMES.index(name)]

    @property
    def verdict(self) -> np.ndarray:
        """Indices into ``VERDICTS``.

        Unstable: the run diverged, ended at the voltage limit after the release, changed from limit to limit ten times
        or more, or its free motion grows. Limit cycle: in the observed samples the velocity still has both signs, by
        two encoder steps per period, or reaches zero ten times and has both signs; with one sign only it is stick-slip
        creep. No motion: the carriage was at rest at the release and stayed there. Otherwise the final speed of the
        free motion decides, except for a cascade, whose integral compensates dry friction.
        """
        low, high = -2.0 * self.step, 2.0 * self.step
        peak, back = (pick(self.end_max_v, -self.end_min_v) for pick in (np.maximum, np.minimum))
        with np.errstate(invalid="ignore"):
            grows = (self.ratio > 1.0) & (np.abs(self.end_speed) > 100.0 * self.step) & ~self.turned
            unstable = (self.diverged > 0) | (self.clipped_end > 0) | (self.flips >= 10)
            cycle = ((self.end_min_v < low) & (self.end_max_v > high)) | (
                (self.end_turns >= 10) & (peak > self.step) & (back > self.threshold)
            )
            unstable |= grows & ~cycle
        drift = self.tends_to
        creeping = ~self.at_rest & (drift > self.threshold) & ~self.wanders & ~self.integrates
        outcomes = {
            "unstable": unstable,
            "limit_cycle": cycle,
            "no_motion": self.at_rest & (self.release_v == 0.0),
            "creeping": creeping,
            "dead_band": (drift < -self.threshold) & ~self.integrates,
        }
        return np.select(list(outcomes.values()), [VERDICTS.index(name) for name in outcomes], 0)

    @property
    def at_rest(self) -> np.ndarray:
        """Whether the carriage was at rest in the observed samples."""
        return (self.end_max_v == 0.0) & (self.end_min_v == 0.0)

    @property
    def turned(self) -> np.ndarray:
        """Whether the motion reversed after the release, as on an axis that sinks under a constant force."""
        with np.errstate(invalid="ignore"):
            return (self.release_v * self.end_speed < 0.0) & ~self.at_rest

    @property
    def tends_to(self) -> np.ndarray:
        """Final speed [m/s] of the free motion, extrapolated; negative if friction stops it in finite time.

        If the motion reversed, the last speed of the simulation.
        """
        return np.where(self.turned, np.abs(self.end_speed), self.drift)

    @property
    def wanders(self) -> np.ndarray:
        """Whether quantisation, not friction, keeps it moving at up to two encoder steps per period."""
        slow = (np.abs(self.tends_to) <= 2.0 * self.step) & (self.expected <= self.threshold)
        return ~self.at_rest & (self.tends_to > self.threshold) & slow & ~self.integrates

    @property
    def fit(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apparent mass [kg], damping [N/(m/s)] and R^2 about zero, at the frequencies of the task and in motion."""
        spectra = self.raw[:, _SLOW:].reshape(-1, 2, 3, 2)  # frequency; acceleration, velocity, force
        a, v, f = np.moveaxis(spectra, 2, 0).reshape(3, -1, 4)

        def product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
            return np.sum(first * second, axis=1)

        aa, av, vv, ff = product(a, a), product(a, v), product(v, v), product(f, f)
        determinant = aa * vv - av**2
        with np.errstate(divide="ignore", invalid="ignore"):
            mass = (vv * product(a, f) - av * product(v, f)) / determinant
            damping = (aa * product(v, f) - av * product(a, f)) / determinant
            r2 = 1.0 - np.sum((f - mass[:, None] * a - damping[:, None] * v) ** 2, axis=1) / ff
        return mass, damping, r2

    @property
    def effort(self) -> dict[str, np.ndarray]:
        """The operator's effort: rms, peak force [N], impulse [N s], work [J], N per (m/s), tracking error [m]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return {
                "rms_force": np.sqrt(self.force2 / self.held),
                "peak_force": self.peak_force,
                "impulse": self.impulse,
                "work": self.work,
                "force_per_speed": np.where(self.path > 0, self.impulse / self.path, np.nan),
                "tracking_error": np.sqrt(self.miss2 / self.held),
            }
