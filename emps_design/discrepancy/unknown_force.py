"""The missing force of a model, and unknown forces: of one kind with few parameters, or any smooth function of state.

The missing force is the force that the motor would have to add in the closed-loop simulation to move as measured. With
the measured and the simulated run of the same reference, both sliding in the same direction, it is

    missing = (F - F_s) - M (qdd - qdd_s) - F_v (qd - qd_s)

for any internal states of the model, because these are in its simulation. The hold is the same in both runs.

A smooth function of the state also explains most friction. An unknown force of one kind does not explain effects of
another kind, so these can be found together with it. Its effect on the motor force is that in the closed loop: each
column is simulated as a force on the carriage.
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
    """Motion of a record, with ``motion.tau`` from the model, and its missing force (n,) [N].

    ``away`` (n,) bool are the samples away from reversals, in which the force is valid.
    """

    motion: Motion
    force: np.ndarray
    away: np.ndarray


def missing_force(hypothesis: Hypothesis, cutoff_hz: float | None = None) -> tuple[MissingForce, ...]:
    """Return the missing force of a model, one per record, low-passed with zero phase at ``cutoff_hz`` [Hz].

    Default: ``rules.CUTOFF_HZ``, or twice the band of the command if that is higher.
    """
    problem, baseline = hypothesis.problem, hypothesis.model.baseline
    gain, bands, result = problem.axis.drive.gain, problem.record_set.bands, []
    for record, run, split, band in zip(problem.records, hypothesis.runs(), problem.splits, bands, strict=True):
        cut = cutoff_hz or max(rules.CUTOFF_HZ, min(2.0 * band, rules.FASTEST / record.period))
        share = motor_share(problem.axis, record)
        applied, replayed = replace(record, u=share * record.u), replace(record, q=run.q, u=share * run.u)
        (measured, measured_force), (simulated, predicted) = side_by_side(
            lambda position, driven, cut=cut: (motion(position, cut), held_force(driven, gain, cut)),
            [(record, applied), (replayed, replayed)],
        )
        inertia = baseline[MASS] * (measured.a - simulated.a)
        viscous = baseline[VISCOUS] * (measured.v - simulated.v)
        force = measured_force - predicted - inertia - viscous
        away = away_from_reversals(measured.v, record.period) & split.used
        if away.sum() <= rules.NEGLIGIBLE * split.used.sum():  # the motion reverses nearly all the time
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
    excluded = np.zeros(v.size, bool)
    width = max(1, round(margin / period))
    for edge in np.nonzero(np.diff(np.sign(v)) != 0)[0]:
        excluded[max(0, edge - width) : edge + width + 1] = True
    return excluded


def since_reversal(v: np.ndarray) -> np.ndarray:
    """Samples (n,) since ``v`` (n,) last changed its sign.

    >>> since_reversal(np.array([1.0, 2.0, -1.0, -1.0, -2.0])).tolist()
    [0, 1, 0, 1, 2]
    """
    index = np.arange(v.size)
    turns = np.concatenate(([True], np.diff(np.sign(v)) != 0))
    return index - np.maximum.accumulate(np.where(turns, index, 0))


def beside_state(hypothesis: Hypothesis) -> Hypothesis:
    """The same model, with all smooth functions of its simulated state projected out of the residual."""
    return Hypothesis(replace(hypothesis.problem, states=states_of(hypothesis)), hypothesis.model)


def states_of(hypothesis: Hypothesis) -> tuple[np.ndarray, ...]:
    """:func:`smooth_of_state` along the simulated motion of ``hypothesis``, one array (n, k) per record."""
    return tuple(smooth_of_state(run.q, hypothesis.problem.period) for run in hypothesis.runs())


def smooth_of_state(q: np.ndarray, period: float) -> np.ndarray:
    """Smooth functions (n, k) of position ``q`` (n,) [m], velocity and past motion, without assumptions on the physics.

    Polynomials in position and speed for each direction, and friction with memory.
    """
    from numpy.polynomial.chebyshev import chebvander

    v = np.gradient(q, period)
    direction, speed = np.tanh(v / slowest(v)), np.abs(v) / np.abs(v).max()
    surface = along(q, rules.DEGREE)[:, :, None] * chebvander(2 * speed - 1, rules.DEGREE)[:, None]
    surface = surface.reshape(q.size, -1)
    with_memory, count = (memories(q, period), fading_memories(v, period)), surface.shape[1]
    functions = np.empty((q.size, 2 * count + sum(part.shape[1] for part in with_memory)))
    np.multiply(surface, (direction > 0)[:, None], out=functions[:, :count])
    np.multiply(surface, (direction <= 0)[:, None], out=functions[:, count : 2 * count])
    np.concatenate(with_memory, axis=1, out=functions[:, 2 * count :])
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
    """Friction forces (n, k) that depend on the past motion ``q`` (n,) [m].

    They depend on the age of the contact, the path since a reversal, and low-passed direction and sliding.
    """
    v = np.gradient(q, period)
    direction = np.tanh(v / slowest(v))
    path = np.cumsum(np.abs(v)) * period
    path -= path[np.arange(q.size) - since_reversal(v)]
    fading = np.exp(-path[:, None] / (stroke_size(q) * np.array(rules.FADING_WAYS)))
    levels = np.column_stack([contact_age(v, period), fading, fading_memories(np.abs(direction), period)])
    return np.column_stack([levels * direction[:, None], fading_memories(direction, period)])


def fading_memories(signal: np.ndarray, period: float) -> np.ndarray:
    """``signal`` (n,) after first-order low-passes (n, k), one for each time constant of ``rules.FADING_TIMES``."""
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
        final, constant = (0.0, times) if slides[begin] else (1.0, rules.RESTING_TIME)
        states[begin:end] = final + (now - final) * np.exp(-period * np.arange(1, end - begin + 1)[:, None] / constant)
        now, begin = states[end - 1], end
    return states


@dataclass(frozen=True)
class Kind:
    """A kind of unknown force: any linear combination of its ``columns``."""

    name: str
    columns: Columns

    def with_baseline(self) -> Kind:
        """The same kind with the columns of the baseline added, for a model with fixed parameters."""
        return replace(
            self, columns=lambda *arguments: np.column_stack([self.columns(*arguments), baseline(*arguments)])
        )


def inertia(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """An inertia m(q) that varies along the travel, as of a crank: m a + m' v^2 / 2 (Lagrange); m is a polynomial."""
    shapes, slopes = along(measured.q, degree), slopes_along(measured.q, degree)
    return (shapes * measured.a[:, None] + 0.5 * slopes * measured.v[:, None] ** 2)[:, 1:]


def damping(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """Viscous friction with a coefficient that is a polynomial in position."""
    return along(measured.q, degree)[:, 1:] * measured.v[:, None]


def damping_each_way(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """:func:`damping` with one polynomial for each direction."""
    speed = np.abs(measured.v)[:, None]
    return np.column_stack([damping(measured, simulated, degree), along(measured.q, degree) * speed])


def memory(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    """Friction that depends on the past of the simulated motion, which has no encoder noise at standstill.

    It depends on the past speed as well. A memory of the signed velocity would be a spring, or viscous friction.
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
        _by_degree("viscous friction that varies along the travel, separately for each direction", damping_each_way),
    ),
    ((Kind("friction that depends on the past motion", memory),),),
)


def beside_kind(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """The same model, with the response to any unknown force of a ``kind`` projected out of the residual.

    The response of the loop is linearised. Raises :class:`SimulationError` if the model cannot be simulated with a
    force of a tenth of its residual.
    """
    states = _loop_responses(hypothesis, _columns(hypothesis, kind))
    return Hypothesis(replace(hypothesis.problem, states=states), hypothesis.model)


def with_kind(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """:func:`beside_kind`, linearised with the best-fitting force of that kind acting in the loop.

    A large force changes the response of the loop; with a motor at its limit so much that perhaps only a share of the
    force, one of ``rules.LOOP_SHARES``, lowers the cost. Raises as :func:`beside_kind`.
    """
    problem = replace(hypothesis.problem, states=())
    hypothesis = Hypothesis(problem, hypothesis.model)
    columns = _columns(hypothesis, kind)
    innovations, responses = (problem.whiten(x) for x in (hypothesis.residuals(), _loop_responses(hypothesis, columns)))
    shares = [
        np.linalg.lstsq(response[used], residual[used], rcond=rules.NOTHING)[0]
        for response, residual, used in zip(responses, innovations, problem.masks("used"), strict=True)
    ]
    forces = [column @ share for column, share in zip(columns, shares, strict=True)]
    before = hypothesis.excess()
    for part in rules.LOOP_SHARES:
        forced = Hypothesis(problem.with_acting([part * force for force in forces]), hypothesis.model)
        with suppress(SimulationError):
            if forced.excess() < before:
                return beside_kind(forced, kind)
    return beside_kind(hypothesis, kind)


def _columns(hypothesis: Hypothesis, kind: Kind) -> list[np.ndarray]:
    """Forces [N] of a ``kind``, (n, k) along each record, each of rms ``rules.MINOR`` times that of the residual."""
    columns = []
    motions = hypothesis.problem.record_set.motions
    for measured, run, residual in zip(motions, hypothesis.runs(), hypothesis.residuals(), strict=True):
        forces = kind.columns(measured, run.q)
        rms = np.sqrt(np.mean(forces * forces, axis=0))
        columns.append(forces * (rules.MINOR * np.std(residual) / np.maximum(rms, 1e-30)))
    return columns


def _loop_responses(hypothesis: Hypothesis, columns: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Change of the motor force [N], (n, k) per record, by each of the ``columns`` [N] as a force on the carriage."""
    whole = hypothesis.residuals()
    forces = zip(*(np.ascontiguousarray(column.T) for column in columns), strict=True)
    disturbed = side_by_side(hypothesis.residuals, [(force,) for force in forces])
    return tuple(
        np.column_stack([a - b for b in rest]) for a, rest in zip(whole, zip(*disturbed, strict=True), strict=True)
    )
