"""The columns that a servo's command is linear in, from what its controller saw: reference and position.

Without its filters and below its limit, the command of a cascade at sample k is a sum of these, each times a product of
gains (``data``: the difference equations of :mod:`emps_design.laws.library.cascade`):

    error         r - q, held between the position loop's samples         error_sum         its sum times the period
    slip          vr - v                                                  slip_sum          its sum times the period
    velocity      v                                                       velocity_sum      its sum times the period
    acceleration  ar                                                      sign              sign(vr)
    force_sum     sum of a measured external force times the period       offset            1

The sums belong to the integral part. It stands still while the limit acts, and so do they.

The velocity estimators that are tried, and the number of one that is sought: its logarithm, within bounds.

Which terms a controller has, and how its command is linear in what is left once its integral time is known.

With ``wi = 1/ti`` and the gain K of the velocity loop, the command before the filters is, see :mod:`.regressors`,

    pi      K kp (error + wi error_sum) + K share (slip + wi slip_sum) - K (1 - share) (velocity + wi velocity_sum)
    ip      K kp wi error_sum + K share (wi slip_sum - velocity) - K (1 - share) (velocity + wi velocity_sum)

and the feed-forward; so for each ``wi`` it is linear in K kp, K share, K (1 - share), and the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.signal import lfilter, savgol_filter

from emps_design.laws.estimators import MOST_POINTS, NUMBERS, Estimator, polynomials

ESTIMATORS = ("backward", "two_tap")
POINTS = (4, 5, 6, 8, 11, 16)  # of slopes that are tried first; 2 and 3 are the named ones
SHARES = np.geomspace(0.006, 0.25, 5)  # of the sampling frequency: corners that are tried first
LOOP = 2.0  # times the corner of a filter: a tracking loop that is late by as much
LEAST_LAG = 0.3  # samples: filters that are faster are none
WITHIN = {"filtered": (1e-4, 0.45), "tracking": (6e-4, 3.0)}  # number times the period
STEP = 1e-4  # of a sought number, for its derivative
UNUSUAL = 2.0 * float(np.log(len(POINTS) + 2 * len(SHARES)))  # of the criterion: half of all drives take a named one

AnyEstimator = str | Estimator

EVERY = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20)  # samples of a position loop that are tried
DELAYS = (0, 1, 2)  # samples
AHEAD = 4  # samples before and after one that tell the velocity of a profile there
STRANGE_START = 20.0  # of the criterion, for a position loop that does not start with the record, as axis files have it

WHOLE_LOOPS = int(np.lcm.reduce(EVERY))  # samples after which a position loop of any rate is where it began

COLUMNS = (
    "error",
    "error_sum",
    "slip",
    "slip_sum",
    "velocity",
    "velocity_sum",
    "acceleration",
    "sign",
    "force_sum",
    "offset",
)
SAMPLED = 2  # of them, the first, depend on the samples of the position loop

PLACE = {name: i for i, name in enumerate(COLUMNS)}


@cache
def with_numbers(period: float) -> tuple[Estimator, ...]:
    """Estimators with a number to start from, at a sampling ``period`` [s].

    >>> [one.number for one in with_numbers(1e-3)][:3]
    [4.0, 5.0, 6.0]
    """
    corners = [float(share) / period for share in SHARES]
    found = [Estimator(kind="slope", points=n) for n in POINTS]
    found += [Estimator(kind="filtered", frequency=corner) for corner in corners]
    found += [Estimator(kind="tracking", bandwidth=LOOP * 2.0 * float(np.pi) * corner) for corner in corners]
    return tuple(found)


def lag(estimator: AnyEstimator, period: float) -> float:
    """Samples that a steady change comes late by, beside those of the backward difference.

    >>> lag("two_tap", 1e-3), round(lag(Estimator(kind="slope", points=4), 1e-3), 9)
    (0.5, 1.0)
    """
    late = [float(np.arange(len(one)) @ np.array(one)) / sum(one) for one in polynomials(estimator, period)]
    return late[0] - late[1]


def rivals_of(own: AnyEstimator, period: float) -> list[AnyEstimator]:
    """What could pass for the estimator ``own``: those with a name, and of each other kind what is as late."""
    late = max(lag(own, period), LEAST_LAG)
    points = round(2.0 * late) + 2
    found: list[AnyEstimator] = [*ESTIMATORS]
    found += [Estimator(kind="slope", points=n) for n in range(points - 1, points + 2) if 4 <= n <= MOST_POINTS]
    found.append(Estimator(kind="filtered", frequency=1.0 / (2.0 * float(np.pi) * late * period)))
    found.append(Estimator(kind="tracking", bandwidth=LOOP / (late * period)))
    kind = own.kind if isinstance(own, Estimator) and sought(own) else ""  # whose number is found by the fit
    return [one for one in found if one != own and not (isinstance(one, Estimator) and one.kind == kind)]


def sought(estimator: AnyEstimator) -> bool:
    """Whether an estimator has a number that is sought: a corner or a bandwidth, no count of points."""
    return isinstance(estimator, Estimator) and estimator.kind in WITHIN


def at_step(estimator: AnyEstimator, step: float, period: float) -> AnyEstimator:
    """``estimator`` with the logarithm of its number changed by ``step``, kept within what it can be."""
    assert isinstance(estimator, Estimator)
    low, high = (bound / period for bound in WITHIN[estimator.kind])
    number = float(np.clip(estimator.number * np.exp(step), low, high))
    return Estimator.model_validate({"kind": estimator.kind, NUMBERS[estimator.kind]: number})


def beside(estimator: AnyEstimator, period: float, ratio: float) -> tuple[AnyEstimator, ...]:
    """The estimators next to one with a number: a point more or less, or the number times and over ``ratio``."""
    if not isinstance(estimator, Estimator):
        return ()
    if estimator.kind == "slope":
        counts = (int(estimator.number) + more for more in (-1, 1))
        return tuple(Estimator(kind="slope", points=n) for n in counts if 4 <= n <= MOST_POINTS)
    step = float(np.log(ratio))
    return tuple(at_step(estimator, sign * step, period) for sign in (-1.0, 1.0))


def could_pass_for(own: AnyEstimator) -> list[AnyEstimator]:
    """The named estimators, ``own``, and a slope of a point more or less: for a reference half a period late."""
    more = beside(own, 1.0, 1.0) if not sought(own) else ()
    return list(dict.fromkeys((*ESTIMATORS, own, *more)))


def table_of(estimator: AnyEstimator, number: float | None = None) -> str | dict[str, object]:
    """The estimator as in an axis file, with another ``number`` where one is given."""
    if isinstance(estimator, str):
        return estimator
    table = estimator.model_dump(exclude_none=True)
    return table if number is None else {**table, NUMBERS[estimator.kind]: number}


@dataclass(frozen=True)
class ControllerSignals:
    """What a controller saw and gave: ``reference``, ``position`` and ``command`` (n,), each ``period`` [s].

    The reference is a position [m or rad], or a velocity where ``velocity_reference``; ``force`` (n,) [N or N m] is
    a measured external force; ``used`` (n,) says which samples count. ``whitening`` are the coefficients of the
    prediction error filter in z^-1 that makes the noise of the command white; ``used`` is about what leaves it.
    ``levels`` (n,) numbers stretches in each of which the command may carry a constant of its own: each a record, where
    ``records``, with a constant only if there is an integral. ``times`` (n,) [s]
    are those of irregular samples, whose noise no filter makes white.
    """

    reference: np.ndarray
    position: np.ndarray
    command: np.ndarray
    period: float
    used: np.ndarray
    velocity_reference: bool = False
    force: np.ndarray | None = None
    whitening: tuple[float, ...] = (1.0,)
    levels: np.ndarray | None = None
    records: bool = False
    times: np.ndarray | None = None

    def __len__(self) -> int:
        return self.position.size

    @property
    def first_level(self) -> ControllerSignals:
        """The first stretch of ``levels`` alone, up to the last sample of it that counts."""
        if self.levels is None:
            return self
        return self.part(slice(0, int(np.flatnonzero(self.used & (self.levels == self.levels[0]))[-1]) + 1))

    def part(self, part: slice) -> ControllerSignals:
        """A ``part`` of one stretch."""
        names = ("reference", "position", "command", "used", "force")
        there = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(self, levels=None, **{name: values[part] for name, values in there.items()})

    def counted(self, columns: np.ndarray) -> np.ndarray:
        """What counts of ``columns`` (n, ...): whitened, the samples used, without the mean of each stretch."""
        rows = lfilter(self.whitening, [1.0], columns, axis=0)[self.used]
        if self.levels is None:
            return rows
        starts = np.flatnonzero(np.diff(self.levels[self.used], prepend=-1))
        sizes = np.diff(np.append(starts, len(rows)))
        means = np.add.reduceat(rows, starts, axis=0) / sizes.reshape(-1, *[1] * (rows.ndim - 1))
        return rows - np.repeat(means, sizes, axis=0)


@dataclass(frozen=True)
class Timing:
    """Which samples a controller takes: the position loop every n-th, from ``phase`` on; ``delay`` [samples] between
    a measurement and its command; how velocity is estimated; whether what is fed forward comes from the ``profile``
    itself, at the sample, and is no difference of the reference."""

    every: int = 1
    phase: int = 0
    delay: int = 0
    velocity_estimator: AnyEstimator = "backward"
    profile: bool = False

    @property
    def surprise(self) -> float:
        """-2 log of its probability before the record is seen: half of all loops run at one rate, the rest share.

        And half of all drives take an estimator that has a name.
        """
        rates = 2.0 * float(np.log(len(EVERY) - 1)) if self.every > 1 else 0.0
        return rates + STRANGE_START * (self.phase > 0) + UNUSUAL * (not isinstance(self.velocity_estimator, str))


def regressors(signals: ControllerSignals, timing: Timing, limited: np.ndarray | None = None) -> np.ndarray:
    """The columns (n, len(COLUMNS)); ``limited`` (n,) says in which samples the limit acts.

    What a record cannot have (the error where the reference is a velocity, a force that was not measured) is 0.

    >>> ramp = np.arange(4.0)
    >>> signals = ControllerSignals(ramp, 0.5 * ramp, ramp, 1.0, np.ones(4, bool))
    >>> regressors(signals, Timing(every=2))[:, :3].T.tolist()
    [[0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 2.0], [0.0, 0.5, 0.5, 0.5]]
    """
    n, period = len(signals), signals.period
    r, q = signals.reference, signals.position
    free = _free(n, timing, limited)
    v = estimated_velocity(q, period, timing.velocity_estimator)
    if signals.times is not None:
        v = np.gradient(q, signals.times)
    vr = r if signals.velocity_reference else np.diff(r, prepend=r[:1]) / period
    ar = np.diff(vr, prepend=vr[:1] if signals.velocity_reference else 0.0) / period
    direction = np.sign(vr)
    if timing.profile:
        vr, ar = _of_the_profile(signals)
    force = np.zeros(n) if signals.force is None else signals.force
    slip = vr - v
    sums = [_held_sum(x, free) * period for x in (slip, v, force)]
    columns = (slip, sums[0], v, sums[1], ar, direction, sums[2])
    table = np.column_stack([*_of_the_position_loop(signals, timing, free), *columns, np.ones(n)])
    if timing.delay:
        table = np.concatenate([np.repeat(table[:1], timing.delay, axis=0), table[: n - timing.delay]])
    return table


def sampled_regressors(signals: ControllerSignals, timing: Timing, limited: np.ndarray | None = None) -> np.ndarray:
    """The first :data:`SAMPLED` columns (n, SAMPLED) without delay: what the samples of a position loop change."""
    free = _free(len(signals), replace(timing, delay=0), limited)
    return np.column_stack(_of_the_position_loop(signals, timing, free))


def _of_the_position_loop(
    signals: ControllerSignals, timing: Timing, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The error (n,) in the samples of the position loop, and its sum times the period."""
    if signals.velocity_reference:
        error = np.zeros(len(signals))
    else:
        error = held(signals.reference - signals.position, timing.every, timing.phase)
    return error, _held_sum(error, free) * signals.period


def _free(n: int, timing: Timing, limited: np.ndarray | None) -> np.ndarray:
    """In which samples (n,) the integral goes on: the limit acts ``timing.delay`` later than what it is made of."""
    free = np.ones(n, bool)
    if limited is not None:
        free[: n - timing.delay] = ~limited[timing.delay :]
    return free


def joined(several: Sequence[ControllerSignals]) -> ControllerSignals:
    """Signals of one controller from several records, one after the other, each a level of its own.

    Each starts at the position where the one before ended, so that nothing jumps, and in a sample in which position
    loops of every rate run; until then the one before stands still, in samples that do not count.
    """
    if len(several) == 1:
        return several[0]
    pieces: dict[str, list[np.ndarray]] = {name: [] for name in ("reference", "position", "command", "force", "used")}
    levels, end = [], several[0].position[0]
    for place, one in enumerate(several):
        shift = end - one.position[0]
        reference = one.reference if one.velocity_reference else one.reference + shift
        own = (reference, one.position + shift, one.command, one.force)
        more = -len(one) % WHOLE_LOOPS
        for name, column in zip(pieces, own, strict=False):
            pieces[name].append(np.pad(np.zeros(len(one)) if column is None else column, (0, more), "edge"))
        pieces["used"].append(np.pad(one.used, (0, more)))
        levels.append(np.full(len(one) + more, place))
        end = pieces["position"][-1][-1]
    columns: dict[str, Any] = {name: np.concatenate(rows) for name, rows in pieces.items()}
    columns["force"] = None if several[0].force is None else columns["force"]
    return replace(several[0], **columns, levels=np.concatenate(levels), records=True)


def estimated_velocity(q: np.ndarray, period: float, estimator: AnyEstimator) -> np.ndarray:
    """Velocity (n,) from the position (n,) by an estimator; at rest before the first sample."""
    if not isinstance(estimator, str):
        return lfilter(*polynomials(estimator, period), np.diff(q, prepend=q[:1]) / period)
    taps = 2 if estimator == "two_tap" else 1
    before = np.concatenate([np.full(taps, q[0]), q[:-taps]])
    return (q - before) / (taps * period)


def _of_the_profile(signals: ControllerSignals) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and acceleration (n,) that the generator of a position reference has at its samples.

    Of a polynomial of fourth degree through nine samples each: the steps in which a reference is recorded are smoothed.
    """
    r = np.pad(signals.reference, AHEAD, mode="edge")
    first, second = (
        savgol_filter(r, 2 * AHEAD + 1, 4, deriv=order, delta=signals.period)[AHEAD:-AHEAD] for order in (1, 2)
    )
    return first, second


def held(x: np.ndarray, every: int, phase: int) -> np.ndarray:
    """``x`` (n,) taken every n-th sample from ``phase`` on and held; before that, as if held since before the start."""
    samples = np.arange(x.size)
    return x[np.maximum((samples - phase) // every * every + phase, 0)]


def _held_sum(x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Sum of ``x`` up to each sample, that keeps nothing of samples that are not ``free``."""
    kept = np.cumsum(np.where(free, x, 0.0))
    return np.where(free, kept, kept + x)


@dataclass(frozen=True)
class LawStructure:
    """The terms of a controller.

    ``form`` "pi" or "ip", or "" without integral; ``position`` whether a position loop is there; ``share`` of the
    reference's velocity 0 or 1, or None where it is a number between; ``velocity`` whether velocity is fed back at
    all; ``acceleration``, ``coulomb``, ``force``, ``offset`` whether these terms are there; ``skew`` whether the
    position was recorded at another instant than the one that the command follows: next to a law without velocity it
    shows.
    """

    form: str = "pi"
    position: bool = True
    share: int | None = None
    velocity: bool = True
    acceleration: bool = True
    coulomb: bool = True
    force: bool = False
    offset: bool = True
    skew: bool = False

    @property
    def linear(self) -> tuple[str, ...]:
        """The linear coefficients, in the order of :meth:`combination`."""
        names = ["position"] if self.position else []
        if self.velocity:
            names += {None: ["following", "damping"], 1: ["following"], 0: ["damping"]}[self.share]
        names += [name for name in ("acceleration", "coulomb", "force", "offset", "skew") if getattr(self, name)]
        return tuple(names)

    @property
    def feeds_forward(self) -> bool:
        """Whether the velocity of the reference is fed forward to a velocity loop within a position loop."""
        return self.position and self.velocity and self.share != 0

    @property
    def size(self) -> int:
        """How many numbers it has, without those of filters."""
        return len(self.linear) + bool(self.form)

    def combination(self, wi: float | np.ndarray) -> np.ndarray:
        """What takes the regressors to the columns of ``linear``, (..., len(COLUMNS), n_linear) for ``wi`` (...)."""
        constant, integral = _combinations(self)
        return constant + np.multiply.outer(wi, integral)

    def stabilising(self, linear: np.ndarray) -> np.ndarray:
        """Whether these coefficients (..., n_linear) feed position and velocity back with the sign of a controller."""
        part = dict(zip(self.linear, np.moveaxis(linear, -1, 0), strict=True))
        velocity = part.get("following", 0.0) + part.get("damping", 0.0)
        return (velocity > 0.0 if self.velocity else True) & (part.get("position", 1.0) > 0.0)

    @property
    def simpler(self) -> tuple[LawStructure, ...]:
        """The structures with one number less."""
        found = []
        if self.acceleration:
            found.append(replace(self, acceleration=False))
        if self.coulomb:
            found.append(replace(self, coulomb=False))
        if self.force:
            found.append(replace(self, force=False))
        if self.offset:
            found.append(replace(self, offset=False))
        if self.skew:
            found.append(replace(self, skew=False))
        if self.form == "pi":
            found.append(replace(self, form=""))
        if self.velocity and self.share is None:
            found += [replace(self, share=0), replace(self, share=1)]
        if self.position and self.velocity and (self.form or self.share != 0):
            found.append(replace(self, position=False))
        if self.position and self.velocity and not self.form and self.share is not None:
            found.append(replace(self, velocity=False, share=0))
        return tuple(found)


@cache
def _combinations(structure: LawStructure) -> tuple[np.ndarray, np.ndarray]:
    """The part of the combination that is the same for every ``wi``, and the one in proportion to it."""
    proportional = float(structure.form != "ip")
    constant = {
        "position": {"error": proportional},
        "following": {"slip": proportional, "velocity": proportional - 1.0},
        "damping": {"velocity": -1.0},
        "acceleration": {"acceleration": 1.0},
        "coulomb": {"sign": 1.0},
        "offset": {"offset": 1.0},
        "skew": {"velocity": 1.0},
    }
    integral = {
        "position": {"error_sum": 1.0},
        "following": {"slip_sum": 1.0},
        "damping": {"velocity_sum": -1.0},
        "force": {"force_sum": 1.0},
    }
    tables = np.zeros((2, len(COLUMNS), len(structure.linear)))
    for table, terms in zip(tables, (constant, integral), strict=True):
        for column, name in enumerate(structure.linear):
            for regressor, factor in terms.get(name, {}).items():
                table[PLACE[regressor], column] = factor
    return tables[0], tables[1]


PROPORTIONAL = LawStructure(form="", share=0, velocity=False, acceleration=False, coulomb=False)
