"""The regressors of a servo's command, from the controller's inputs: reference and position.

Without filters and below the limit, the command of a cascade at sample k is a sum of these columns, each times a
product of gains (see the difference equations of :mod:`emps_design.laws.library.cascade`):

    error         r - q, held between the position loop's samples         error_sum         its sum times the period
    slip          vr - v                                                  slip_sum          its sum times the period
    velocity      v                                                       velocity_sum      its sum times the period
    acceleration  ar                                                      sign              sign(vr)
    force_sum     sum of a measured external force times the period       offset            1

The sums belong to the integral part, which stops while the limit acts; so do they.

A velocity estimator may have a number of its own (a corner, a bandwidth, a count of points); the fit varies the
logarithm of a continuous one within bounds.

:class:`LawStructure` says which terms a controller has. Once the integral time is known, its command is linear in the
other numbers. With ``wi = 1/ti`` and the gain K of the velocity loop, the command before the filters is

    pi      K kp (error + wi error_sum) + K share (slip + wi slip_sum) - K (1 - share) (velocity + wi velocity_sum)
    ip      K kp wi error_sum + K share (wi slip_sum - velocity) - K (1 - share) (velocity + wi velocity_sum)

plus the feed-forward; so for each ``wi`` it is linear in K kp, K share, K (1 - share) and the feed-forward gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import scipy

from emps_design.laws.estimators import MOST_POINTS, NUMBERS, Estimator, KnownEstimator, polynomials

ESTIMATORS = ("backward", "two_tap")
POINTS = (4, 5, 6, 8, 11, 16)  # of slopes that are tried first; 2 and 3 are the named ones
SHARES = np.geomspace(0.006, 0.25, 5)  # of the sampling frequency: corners that are tried first
LOOP = 2.0  # times the corner of a filter: bandwidth of the tracking loop with the same lag
LEAST_LAG = 0.3  # samples: faster filters have no effect
WITHIN = {"filtered": (1e-4, 0.45), "tracking": (6e-4, 3.0)}  # number times the period
STEP = 1e-4  # of a fitted number, for its derivative
UNUSUAL = 2.0 * float(np.log(len(POINTS) + 2 * len(SHARES)))  # of the criterion: half of all drives have a named one


EVERY = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20)  # samples of a position loop that are tried
DELAYS = (0, 1, 2)  # samples
AHEAD = 4  # samples on either side that determine the velocity of a profile
STRANGE_START = 20.0  # of the criterion, for a position loop that does not start with the record, as in axis files

WHOLE_LOOPS = int(np.lcm.reduce(EVERY))  # samples: a common multiple of the periods of all position loops

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

SWITCHES = ("acceleration", "coulomb", "force", "offset", "skew")  # terms that a law has or has not

PLACE = {name: i for i, name in enumerate(COLUMNS)}


@cache
def with_numbers(period: float) -> tuple[Estimator, ...]:
    """Estimators with a number, as starting points, at a sampling ``period`` [s].

    >>> [estimator.number for estimator in with_numbers(1e-3)][:3]
    [4.0, 5.0, 6.0]
    """
    corners = [float(share) / period for share in SHARES]
    estimators = [Estimator(kind="slope", points=n) for n in POINTS]
    estimators += [Estimator(kind="filtered", frequency=corner) for corner in corners]
    estimators += [Estimator(kind="tracking", bandwidth=LOOP * 2.0 * float(np.pi) * corner) for corner in corners]
    return tuple(estimators)


def lag(estimator: KnownEstimator, period: float) -> float:
    """Delay in samples of a constant velocity change, beyond that of the backward difference.

    >>> lag("two_tap", 1e-3), round(lag(Estimator(kind="slope", points=4), 1e-3), 9)
    (0.5, 1.0)
    """
    late = [float(np.arange(len(taps)) @ np.array(taps)) / sum(taps) for taps in polynomials(estimator, period)]
    return late[0] - late[1]


def rivals_of(own: KnownEstimator, period: float) -> list[KnownEstimator]:
    """Estimators that may be mistaken for ``own``: the named ones, and of each other kind those with the same lag."""
    late = max(lag(own, period), LEAST_LAG)
    points = round(2.0 * late) + 2
    candidates: list[KnownEstimator] = [*ESTIMATORS]
    candidates += [Estimator(kind="slope", points=n) for n in range(points - 1, points + 2) if 4 <= n <= MOST_POINTS]
    candidates.append(Estimator(kind="filtered", frequency=1.0 / (2.0 * float(np.pi) * late * period)))
    candidates.append(Estimator(kind="tracking", bandwidth=LOOP / (late * period)))
    kind = own.kind if isinstance(own, Estimator) and sought(own) else ""  # the fit itself finds its number
    return [rival for rival in candidates if rival != own and not (isinstance(rival, Estimator) and rival.kind == kind)]


def sought(estimator: KnownEstimator) -> bool:
    """Whether an estimator has a number to be fitted: a corner or a bandwidth, not a count of points."""
    return isinstance(estimator, Estimator) and estimator.kind in WITHIN


def at_step(estimator: KnownEstimator, step: float, period: float) -> KnownEstimator:
    """``estimator`` with the logarithm of its number changed by ``step``, kept within its bounds."""
    assert isinstance(estimator, Estimator)
    low, high = (bound / period for bound in WITHIN[estimator.kind])
    number = float(np.clip(estimator.number * np.exp(step), low, high))
    return Estimator.model_validate({"kind": estimator.kind, NUMBERS[estimator.kind]: number})


def beside(estimator: KnownEstimator, period: float, ratio: float) -> tuple[KnownEstimator, ...]:
    """The neighbours of an estimator with a number: a point more or less, or the number times and over ``ratio``."""
    if not isinstance(estimator, Estimator):
        return ()
    if estimator.kind == "slope":
        counts = (int(estimator.number) + more for more in (-1, 1))
        return tuple(Estimator(kind="slope", points=n) for n in counts if 4 <= n <= MOST_POINTS)
    step = float(np.log(ratio))
    return tuple(at_step(estimator, sign * step, period) for sign in (-1.0, 1.0))


def could_pass_for(own: KnownEstimator) -> list[KnownEstimator]:
    """The named estimators, ``own``, and slopes of a point more or less, for a reference half a sample late."""
    more = beside(own, 1.0, 1.0) if not sought(own) else ()
    return list(dict.fromkeys((*ESTIMATORS, own, *more)))


def estimator_table(estimator: KnownEstimator, number: float | None = None) -> str | dict[str, object]:
    """The estimator as in an axis file, with another ``number`` where one is given."""
    if isinstance(estimator, str):
        return estimator
    table = estimator.model_dump(exclude_none=True)
    return table if number is None else {**table, NUMBERS[estimator.kind]: number}


@dataclass(frozen=True)
class ControllerSignals:
    """Inputs and output of a controller: ``reference``, ``position`` and ``command`` (n,), sampled with ``period`` [s].

    The reference is a position [m or rad], or a velocity where ``velocity_reference``; ``force`` (n,) [N or N m] is
    a measured external force; ``used`` (n,) is the mask of the samples that count, at the output of the whitening
    filter. ``whitening`` holds its coefficients in z^-1: the prediction error filter that makes the command's noise
    white. ``levels`` (n,) numbers stretches whose command may have a constant each. With ``records`` each stretch is a
    record, and there is a constant only with an integral. ``times`` (n,) [s] are given for irregular samples, whose
    noise is not whitened.
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
        """The first stretch of ``levels``, up to its last sample that counts."""
        if self.levels is None:
            return self
        return self.part(slice(0, int(np.flatnonzero(self.used & (self.levels == self.levels[0]))[-1]) + 1))

    def part(self, part: slice) -> ControllerSignals:
        """The samples ``part`` of a single stretch."""
        names = ("reference", "position", "command", "used", "force")
        there = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(self, levels=None, **{name: values[part] for name, values in there.items()})

    def counted(self, columns: np.ndarray) -> np.ndarray:
        """The used rows of ``columns`` (n, ...), whitened, less the mean of each stretch."""
        rows = scipy.signal.lfilter(self.whitening, [1.0], columns, axis=0)[self.used]
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
    velocity_estimator: KnownEstimator = "backward"
    profile: bool = False

    @property
    def surprise(self) -> float:
        """-2 log of the prior probability: half of all position loops run at the servo rate, half of all estimators
        have a name, and the others share the rest equally."""
        rates = 2.0 * float(np.log(len(EVERY) - 1)) if self.every > 1 else 0.0
        return rates + STRANGE_START * (self.phase > 0) + UNUSUAL * (not isinstance(self.velocity_estimator, str))


def regressors(signals: ControllerSignals, timing: Timing, limited: np.ndarray | None = None) -> np.ndarray:
    """The columns (n, len(COLUMNS)); ``limited`` (n,) is the mask of the samples in which the limit acts.

    Columns without data (the error where the reference is a velocity, a force that was not measured) are 0.

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
        vr, ar = _profile_derivatives(signals)
    force = np.zeros(n) if signals.force is None else signals.force
    slip = vr - v
    sums = [_held_sum(x, free) * period for x in (slip, v, force)]
    columns = (slip, sums[0], v, sums[1], ar, direction, sums[2])
    table = np.column_stack([*_position_error_columns(signals, timing, free), *columns, np.ones(n)])
    if timing.delay:
        table = np.concatenate([np.repeat(table[:1], timing.delay, axis=0), table[: n - timing.delay]])
    return table


def sampled_regressors(signals: ControllerSignals, timing: Timing, limited: np.ndarray | None = None) -> np.ndarray:
    """The first columns (n, SAMPLED) without delay: those that depend on the samples of the position loop."""
    free = _free(len(signals), replace(timing, delay=0), limited)
    return np.column_stack(_position_error_columns(signals, timing, free))


def _position_error_columns(
    signals: ControllerSignals, timing: Timing, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The error (n,) in the samples of the position loop, and its sum times the period."""
    if signals.velocity_reference:
        error = np.zeros(len(signals))
    else:
        error = sample_and_hold(signals.reference - signals.position, timing.every, timing.phase)
    return error, _held_sum(error, free) * signals.period


def _free(n: int, timing: Timing, limited: np.ndarray | None) -> np.ndarray:
    """Mask (n,) of the samples in which the integral runs: the limit acts ``timing.delay`` samples after its inputs."""
    free = np.ones(n, bool)
    if limited is not None:
        free[: n - timing.delay] = ~limited[timing.delay :]
    return free


def joined_signals(several: Sequence[ControllerSignals]) -> ControllerSignals:
    """Signals of one controller from several records in sequence, each a level of its own.

    Each record is shifted to the final position of the one before, so that nothing jumps, and starts in a sample in
    which position loops of every rate run. Until then the record before is held constant, in samples that do not count.
    """
    if len(several) == 1:
        return several[0]
    pieces: dict[str, list[np.ndarray]] = {name: [] for name in ("reference", "position", "command", "force", "used")}
    levels, end = [], several[0].position[0]
    for place, signals in enumerate(several):
        shift = end - signals.position[0]
        reference = signals.reference if signals.velocity_reference else signals.reference + shift
        own = (reference, signals.position + shift, signals.command, signals.force)
        more = -len(signals) % WHOLE_LOOPS
        for name, column in zip(pieces, own, strict=False):
            pieces[name].append(np.pad(np.zeros(len(signals)) if column is None else column, (0, more), "edge"))
        pieces["used"].append(np.pad(signals.used, (0, more)))
        levels.append(np.full(len(signals) + more, place))
        end = pieces["position"][-1][-1]
    columns: dict[str, Any] = {name: np.concatenate(rows) for name, rows in pieces.items()}
    columns["force"] = None if several[0].force is None else columns["force"]
    return replace(several[0], **columns, levels=np.concatenate(levels), records=True)


def estimated_velocity(q: np.ndarray, period: float, estimator: KnownEstimator) -> np.ndarray:
    """Velocity (n,) from the position (n,) by an estimator; at rest before the first sample."""
    if not isinstance(estimator, str):
        return scipy.signal.lfilter(*polynomials(estimator, period), np.diff(q, prepend=q[:1]) / period)
    taps = 2 if estimator == "two_tap" else 1
    before = np.concatenate([np.full(taps, q[0]), q[:-taps]])
    return (q - before) / (taps * period)


def _profile_derivatives(signals: ControllerSignals) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and acceleration (n,) of the position reference's generator, at its samples.

    From a polynomial of fourth degree through nine samples each, which smooths the resolution of a recorded reference.
    """
    r = np.pad(signals.reference, AHEAD, mode="edge")
    first, second = (
        scipy.signal.savgol_filter(r, 2 * AHEAD + 1, 4, deriv=order, delta=signals.period)[AHEAD:-AHEAD]
        for order in (1, 2)
    )
    return first, second


def sample_and_hold(x: np.ndarray, every: int, phase: int) -> np.ndarray:
    """``x`` (n,) sampled in every ``every``-th sample from ``phase`` on, and held; before that ``x[0]``."""
    samples = np.arange(x.size)
    return x[np.maximum((samples - phase) // every * every + phase, 0)]


def _held_sum(x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Running sum of ``x`` that does not keep the contribution of samples that are not ``free``."""
    kept = np.cumsum(np.where(free, x, 0.0))
    return np.where(free, kept, kept + x)


@dataclass(frozen=True)
class LawStructure:
    """The terms of a controller.

    ``form`` is "pi" or "ip", or "" without integral; ``position``: with a position loop; ``share``: of the reference's
    velocity 0 or 1, or None where it is a number to be fitted; ``velocity``: with velocity feedback; ``acceleration``,
    ``coulomb``, ``force``, ``offset``: with these terms; ``skew``: the position was recorded at another instant than
    the one that the command follows, which can be seen only in a law without velocity.
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
        names += [name for name in SWITCHES if getattr(self, name)]
        return tuple(names)

    @property
    def feeds_forward(self) -> bool:
        """Whether the reference's velocity is fed forward to a velocity loop inside a position loop."""
        return self.position and self.velocity and self.share != 0

    @property
    def size(self) -> int:
        """Number of parameters, without those of filters."""
        return len(self.linear) + bool(self.form)

    def combination(self, wi: float | np.ndarray) -> np.ndarray:
        """Matrix from the regressors to the columns of ``linear``, (..., len(COLUMNS), n_linear) for ``wi`` (...)."""
        constant, integral = _combinations(self)
        return constant + np.multiply.outer(wi, integral)

    def stabilising(self, linear: np.ndarray) -> np.ndarray:
        """Whether these coefficients (..., n_linear) feed position and velocity back with a stabilising sign."""
        part = dict(zip(self.linear, np.moveaxis(linear, -1, 0), strict=True))
        velocity = part.get("following", 0.0) + part.get("damping", 0.0)
        return (velocity > 0.0 if self.velocity else True) & (part.get("position", 1.0) > 0.0)

    @property
    def simpler(self) -> tuple[LawStructure, ...]:
        """The structures with one parameter less."""
        off: list[dict[str, Any]] = [{name: False} for name in SWITCHES if getattr(self, name)]
        structures = [replace(self, **without) for without in off]
        if self.form == "pi":
            structures.append(replace(self, form=""))
        if self.velocity and self.share is None:
            structures += [replace(self, share=0), replace(self, share=1)]
        if self.position and self.velocity and (self.form or self.share != 0):
            structures.append(replace(self, position=False))
        if self.position and self.velocity and not self.form and self.share is not None:
            structures.append(replace(self, velocity=False, share=0))
        return tuple(structures)


@cache
def _combinations(structure: LawStructure) -> tuple[np.ndarray, np.ndarray]:
    """The part of the combination that does not depend on ``wi``, and the one in proportion to it."""
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
