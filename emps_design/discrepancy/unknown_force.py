"""The missing force of a model, and unknown forces: of one kind with few parameters, or any smooth function of state.

The missing force is what a motor would have to add to the closed-loop simulation to move as measured. With the measured
and the simulated run of the same reference, both sliding in the same direction,

    missing = (F - F_s) - M (qdd - qdd_s) - F_v (qd - qd_s)

whatever hidden states the model has, because they are in its simulation. The hold is the same in both runs.

A smooth function of the state could be almost anything, and explains most friction too. An unknown force of one kind
does not explain effects of another kind, so that these are found beside it. Its effect on the motor force is that of
the closed loop: each column is simulated as a force on the carriage.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.effects import Motion
from emps_design.effects.effect import MASS, VISCOUS
from emps_design.effects.sizes import speed_size, stroke_size
from emps_design.errors import SimulationError
from emps_design.identification.filters import held_force, motion
from emps_design.observer import motor_share

# Forces (n, k) of the measured motion and the simulated position (n,) [m].
Columns = Callable[[Motion, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class MissingForce:
    """Motion of a record (``motion.tau`` as the model predicts it), missing force (n,) [N], trusted where ``away``."""

    motion: Motion
    force: np.ndarray
    away: np.ndarray


def missing_force(hypothesis: Hypothesis, cutoff_hz: float | None = None) -> tuple[MissingForce, ...]:
    """Return the missing force of a model, one per record, low-passed at ``cutoff_hz`` [Hz] without phase.

    By default at ``rules.CUTOFF_HZ``, or at twice the band of the command where that is faster.
    """
    problem, baseline = hypothesis.problem, hypothesis.model.baseline
    gain, bands, result = problem.axis.drive.gain, problem.recorded.bands, []
    for record, run, split, band in zip(problem.records, hypothesis.runs(), problem.splits, bands, strict=True):
        cut = cutoff_hz or max(rules.CUTOFF_HZ, min(2.0 * band, rules.FASTEST / record.period))
        share = motor_share(problem.axis, record)
        acting, played = replace(record, u=share * record.u), replace(record, q=run.q, u=share * run.u)
        (measured, acted), (simulated, predicted) = side_by_side(
            lambda moved, driven, cut=cut: (motion(moved, cut), held_force(driven, gain, cut)),
            [(record, acting), (played, played)],
        )
        inertia = baseline[MASS] * (measured.a - simulated.a)
        viscous = baseline[VISCOUS] * (measured.v - simulated.v)
        force = acted - predicted - inertia - viscous
        away = away_from_reversals(measured.v, record.period) & split.used
        if away.sum() <= rules.NEGLIGIBLE * split.used.sum():  # a motion that reverses nearly all the time
            away = away_from_reversals(measured.v, record.period, 0.0) & split.used
        result.append(MissingForce(replace(measured, tau=predicted, voltage=record.u, force_gain=gain), force, away))
    return tuple(result)


def away_from_reversals(v: np.ndarray, period: float, margin: float = rules.REVERSAL_MARGIN) -> np.ndarray:
    """Samples (n,) bool in which ``v`` (n,) [m/s] keeps its sign for ``margin`` [s] on both sides."""
    sliding = np.abs(v) > max(slowest(v), 0.01 * float(np.abs(v).max()))
    return sliding & ~near_reversals(v, period, margin)


def slowest(v: np.ndarray) -> float:
    """The speed [m/s] below which the direction of a motion with velocities ``v`` (n,) is not certain."""
    return rules.SLOWEST * speed_size(v)


def near_reversals(v: np.ndarray, period: float, margin: float) -> np.ndarray:
    """Samples (n,) bool within ``margin`` [s] of a change of sign of ``v`` (n,)."""
    near = np.zeros(v.size, bool)
    width = max(1, round(margin / period))
    for edge in np.nonzero(np.diff(np.sign(v)) != 0)[0]:
        near[max(0, edge - width) : edge + width + 1] = True
    return near


def since_reversal(v: np.ndarray) -> np.ndarray:
    """Samples (n,) since ``v`` (n,) last changed its sign.

    >>> since_reversal(np.array([1.0, 2.0, -1.0, -1.0, -2.0])).tolist()
    [0, 1, 0, 1, 2]
    """
    index = np.arange(v.size)
    turns = np.concatenate(([True], np.diff(np.sign(v)) != 0))
    return index - np.maximum.accumulate(np.where(turns, index, 0))


def beside_state(hypothesis: Hypothesis) -> Hypothesis:
    """The same model, judged with all smooth functions of its simulated state projected out."""
    return Hypothesis(replace(hypothesis.problem, states=states_of(hypothesis)), hypothesis.model)


def states_of(hypothesis: Hypothesis) -> tuple[np.ndarray, ...]:
    """:func:`smooth_of_state` along the motion that ``hypothesis`` simulates, one array (n, k) per record."""
    return tuple(smooth_of_state(run.q, hypothesis.problem.period) for run in hypothesis.runs())


def smooth_of_state(q: np.ndarray, period: float) -> np.ndarray:
    """Smooth functions (n, k) of position ``q`` (n,) [m], velocity and past motion, without assumed physics.

    Polynomials in position and speed for each direction, and the memories of friction.
    """
    from numpy.polynomial.chebyshev import chebvander

    v = np.gradient(q, period)
    direction, speed = np.tanh(v / slowest(v)), np.abs(v) / np.abs(v).max()
    surface = along(q, rules.DEGREE)[:, :, None] * chebvander(2 * speed - 1, rules.DEGREE)[:, None]
    surface = surface.reshape(q.size, -1)
    remembered, count = (memories(q, period), fading_memories(v, period)), surface.shape[1]
    functions = np.empty((q.size, 2 * count + sum(part.shape[1] for part in remembered)))
    np.multiply(surface, (direction > 0)[:, None], out=functions[:, :count])
    np.multiply(surface, (direction <= 0)[:, None], out=functions[:, count : 2 * count])
    np.concatenate(remembered, axis=1, out=functions[:, 2 * count :])
    return functions


def along(q: np.ndarray, degree: int) -> np.ndarray:
    """Polynomials in position ``q`` (n,) [m], (n, ``degree`` + 1)."""
    from numpy.polynomial.chebyshev import chebvander

    return chebvander(2 * (q - q.min()) / np.ptp(q) - 1, degree)


def slopes_along(q: np.ndarray, degree: int) -> np.ndarray:
    """Derivatives [1/m] of the polynomials of :func:`along` with respect to ``q``."""
    from numpy.polynomial.chebyshev import chebder

    return along(q, degree - 1) @ chebder(np.eye(degree + 1), scl=2 / np.ptp(q))


def memories(q: np.ndarray, period: float) -> np.ndarray:
    """Forces (n, k) of a friction that depends on the past motion ``q`` (n,) [m].

    On the age of the contact, the way since a reversal, and fading memories of direction and of sliding.
    """
    v = np.gradient(q, period)
    direction = np.tanh(v / slowest(v))
    way = np.cumsum(np.abs(v)) * period
    way -= way[np.arange(q.size) - since_reversal(v)]
    fading = np.exp(-way[:, None] / (stroke_size(q) * np.array(rules.FADING_WAYS)))
    along_it = np.column_stack([contact_age(v, period), fading, fading_memories(np.abs(direction), period)])
    return np.column_stack([along_it * direction[:, None], fading_memories(direction, period)])


def fading_memories(signal: np.ndarray, period: float) -> np.ndarray:
    """Fading memories (n, k) of a ``signal`` (n,), one for each of ``rules.FADING_TIMES``."""
    from scipy.signal import lfilter

    shares = [period / time for time in rules.FADING_TIMES]
    return np.column_stack([lfilter([share], [1.0, share - 1.0], signal) for share in shares])


def contact_age(v: np.ndarray, period: float) -> np.ndarray:
    """Age of a contact, 0 to 1, (n, k) along a velocity ``v`` (n,) [m/s]: it grows at rest and decays in sliding.

    It grows within ``rules.RESTING_TIME`` and decays within each of ``rules.FADING_TIMES``, from 1 at first.

    >>> v = np.concatenate([np.zeros(3), np.ones(640), np.zeros(1000)])
    >>> contact_age(v, 1e-3)[[2, 642, -1], -1].round(3).tolist()
    [1.0, 0.368, 1.0]
    """
    slides, times = np.abs(v) > 0.5 * slowest(v), np.array(rules.FADING_TIMES)
    states, now, begin = np.empty((v.size, times.size)), np.ones(times.size), 0
    for end in np.append(np.flatnonzero(np.diff(slides)) + 1, v.size):
        aim, own = (0.0, times) if slides[begin] else (1.0, rules.RESTING_TIME)
        states[begin:end] = aim + (now - aim) * np.exp(-period * np.arange(1, end - begin + 1)[:, None] / own)
        now, begin = states[end - 1], end
    return states


@dataclass(frozen=True)
class Kind:
    """A kind of unknown force: any linear combination of its ``columns``."""

    name: str
    columns: Columns

    def with_baseline(self) -> Kind:
        """The same kind for a model of fixed parameters: the columns of the baseline are part of the force."""
        return replace(
            self, columns=lambda *arguments: np.column_stack([self.columns(*arguments), baseline(*arguments)])
        )


def inertia(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """An inertia m(q) that varies along the travel, as of a crank: m a + m' v^2 / 2 (Lagrange), m a polynomial."""
    shapes, slopes = along(measured.q, degree), slopes_along(measured.q, degree)
    return (shapes * measured.a[:, None] + 0.5 * slopes * measured.v[:, None] ** 2)[:, 1:]


def damping(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """Viscous friction with a coefficient that is a polynomial in position."""
    return along(measured.q, degree)[:, 1:] * measured.v[:, None]


def damping_each_way(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """The same with one polynomial for each direction."""
    speed = np.abs(measured.v)[:, None]
    return np.column_stack([damping(measured, simulated, degree), along(measured.q, degree) * speed])


def memory(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    """Friction that depends on the past simulated motion, which stands still where the encoder does not.

    On its speed as well. A memory of the signed velocity would be a spring, or viscous friction.
    """
    v = np.gradient(simulated, measured.period)
    fast = fading_memories(np.abs(v), measured.period) * np.tanh(v / slowest(v))[:, None]
    return np.column_stack([memories(simulated, measured.period), fast])


def baseline(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    """The columns (n, 4) of the baseline: acceleration, velocity, its direction, and 1."""
    v = measured.v
    return np.column_stack([measured.a, v, np.tanh(v / slowest(v)), np.ones_like(v)])


def _by_degree(name: str, columns: Callable[..., np.ndarray]) -> tuple[Kind, ...]:
    return tuple(Kind(name, partial(columns, degree=degree)) for degree in (rules.DEGREE_ALONG, 2 * rules.DEGREE_ALONG))


# Each with few and with many columns; a kind that is part of another comes before it.
KINDS: tuple[tuple[tuple[Kind, ...], ...], ...] = (
    (_by_degree("an inertia that varies along the travel", inertia),),
    (
        _by_degree("viscous friction that varies along the travel", damping),
        _by_degree("viscous friction that varies along the travel, each way by itself", damping_each_way),
    ),
    ((Kind("friction that remembers the motion before", memory),),),
)


def beside_kind(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """The same model, judged with the response to any unknown force of a ``kind`` projected out.

    The response of the loop is linearised. Raises :class:`SimulationError` where the model cannot be simulated with a
    force of a tenth of its residual.
    """
    states = _answers(hypothesis, _columns(hypothesis, kind))
    return Hypothesis(replace(hypothesis.problem, states=states), hypothesis.model)


def with_kind(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """:func:`beside_kind` linearised with the best-fitting force of that kind acting in the loop.

    A large force changes the response of the loop; with a motor at its limit so much that only a share of the force, of
    ``rules.LOOP_SHARES``, may leave less. Raises as that does.
    """
    problem = replace(hypothesis.problem, states=())
    hypothesis = Hypothesis(problem, hypothesis.model)
    columns = _columns(hypothesis, kind)
    innovations, answers = (problem.whiten(x) for x in (hypothesis.residuals(), _answers(hypothesis, columns)))
    shares = [
        np.linalg.lstsq(answer[used], wanted[used], rcond=rules.NOTHING)[0]
        for answer, wanted, used in zip(answers, innovations, problem.masks("used"), strict=True)
    ]
    forces = [column @ share for column, share in zip(columns, shares, strict=True)]
    before = hypothesis.excess()
    for part in rules.LOOP_SHARES:
        acted = Hypothesis(problem.with_acting([part * force for force in forces]), hypothesis.model)
        with suppress(SimulationError):
            if acted.excess() < before:
                return beside_kind(acted, kind)
    return beside_kind(hypothesis, kind)


def _columns(hypothesis: Hypothesis, kind: Kind) -> list[np.ndarray]:
    """Forces [N] of a ``kind``, (n, k) along each record, each of rms ``rules.MINOR`` times that of the residual."""
    columns = []
    motions = hypothesis.problem.recorded.motions
    for measured, run, residual in zip(motions, hypothesis.runs(), hypothesis.residuals(), strict=True):
        forces = kind.columns(measured, run.q)
        rms = np.sqrt(np.mean(forces * forces, axis=0))
        columns.append(forces * (rules.MINOR * np.std(residual) / np.maximum(rms, 1e-30)))
    return columns


def _answers(hypothesis: Hypothesis, columns: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Change of the motor force [N], (n, k) per record, by each of the ``columns`` [N] as a force on the carriage."""
    whole = hypothesis.residuals()
    pushes = zip(*(np.ascontiguousarray(column.T) for column in columns), strict=True)
    pushed = side_by_side(hypothesis.residuals, [(push,) for push in pushes])
    return tuple(
        np.column_stack([a - b for b in there]) for a, there in zip(whole, zip(*pushed, strict=True), strict=True)
    )
