"""Kinds of unknown force, each with few free numbers: what an axis may have that no effect of the library describes.

A smooth function of the state could be nearly anything, and takes most friction with it. An unknown force of one kind
leaves alone what is of another kind, so that effects are found beside it. What it does to the motor force is that of
the closed loop: a column is simulated as a force on the carriage, and not taken for its own answer.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from emps_design.discrepancy.model.missing_force import SLOWEST
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import RANK, Hypothesis
from emps_design.discrepancy.model.state import along, faded, memories, slopes_along
from emps_design.effects import Motion
from emps_design.errors import SimulationError

COARSE = 6  # degree of the polynomials in position
FINE = 12  # the same where that leaves clearly less
SHARES = (1.0, 0.5, 0.25, 0.125)  # of a force that is put in the loop
PUSH = 0.1  # of the force that a model leaves: rms of a column when its answer is simulated

# Forces (n, k) along a measured motion, which the force has taken part in, and the simulated position (n,) [m].
Columns = Callable[[Motion, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Kind:
    """A kind of unknown force by its ``columns``: the force is any sum of them."""

    name: str
    columns: Columns

    def beside_given(self) -> Kind:
        """The same kind beside a model whose numbers are given: what it has numbers for is a part of the force."""
        return replace(self, columns=lambda *seen: np.column_stack([self.columns(*seen), baseline(*seen)]))


def inertia(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """An inertia m(q) that varies along the travel, as of a crank: m a + m' v^2 / 2 (Lagrange), m a polynomial."""
    shapes, slopes = along(measured.q, degree), slopes_along(measured.q, degree)
    return (shapes * measured.a[:, None] + 0.5 * slopes * measured.v[:, None] ** 2)[:, 1:]


def damping(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """Friction in proportion to velocity, by polynomials in position."""
    return along(measured.q, degree)[:, 1:] * measured.v[:, None]


def damping_each_way(measured: Motion, simulated: np.ndarray, degree: int) -> np.ndarray:
    """The same for each direction by itself."""
    speed = np.abs(measured.v)[:, None]
    return np.column_stack([damping(measured, simulated, degree), along(measured.q, degree) * speed])


def memory(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    """Friction that remembers the motion before: the simulated one, which stands still where the encoder does not.

    Not only whether it moved, but how fast. What remembers velocity with its sign would be a spring, or viscous.
    """
    v = np.gradient(simulated, measured.period)
    fast = faded(np.abs(v), measured.period) * np.tanh(v / SLOWEST)[:, None]
    return np.column_stack([memories(simulated, measured.period), fast])


def baseline(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    """What the four numbers of a model act on: acceleration, velocity, its direction, and 1."""
    v = measured.v
    return np.column_stack([measured.a, v, np.tanh(v / SLOWEST), np.ones_like(v)])


def _by_degree(name: str, columns: Callable[..., np.ndarray]) -> tuple[Kind, ...]:
    return tuple(Kind(name, partial(columns, degree=degree)) for degree in (COARSE, FINE))


# Each with few columns and with many, and what is part of another kind before it.
KINDS: tuple[tuple[tuple[Kind, ...], ...], ...] = (
    (_by_degree("an inertia that varies along the travel", inertia),),
    (
        _by_degree("viscous friction that varies along the travel", damping),
        _by_degree("viscous friction that varies along the travel, each way by itself", damping_each_way),
    ),
    ((Kind("friction that remembers the motion before", memory),),),
)


def beside_kind(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """The same model, judged by what no unknown force of a ``kind`` could do beside it.

    What the force does to the loop is taken as linear. Raises :class:`SimulationError` where the model does not run
    with a force a tenth as large as the one that it leaves.
    """
    states = _answers(hypothesis, _columns(hypothesis, kind))
    return Hypothesis(replace(hypothesis.problem, states=states), hypothesis.model)


def with_kind(hypothesis: Hypothesis, kind: Kind) -> Hypothesis:
    """:func:`beside_kind` about the loop on which the force of that kind acts that explains most of what is left.

    A force that is a good part of all that moves the carriage changes how the loop answers; of a motor at its limit so
    much that only a share of ``SHARES`` of it may leave less. Raises as that does.
    """
    problem = replace(hypothesis.problem, states=())
    hypothesis = Hypothesis(problem, hypothesis.model)
    columns = _columns(hypothesis, kind)
    left, answers = (problem.whiten(x) for x in (hypothesis.residuals(), _answers(hypothesis, columns)))
    shares = [
        np.linalg.lstsq(answer[used], one[used], rcond=RANK)[0]
        for answer, one, used in zip(answers, left, problem.masks("used"), strict=True)
    ]
    forces = [column @ share for column, share in zip(columns, shares, strict=True)]
    before = hypothesis.excess()
    for part in SHARES:
        acted = Hypothesis(problem.with_acting([part * force for force in forces]), hypothesis.model)
        with suppress(SimulationError):
            if acted.excess() < before:
                return beside_kind(acted, kind)
    return beside_kind(hypothesis, kind)


def _columns(hypothesis: Hypothesis, kind: Kind) -> list[np.ndarray]:
    """Forces [N] of a ``kind``, (n, k) along each record, each of ``PUSH`` of the size of what the model leaves."""
    columns = []
    measured = hypothesis.problem.recorded.motions
    for seen, run, left in zip(measured, hypothesis.runs(), hypothesis.residuals(), strict=True):
        one = kind.columns(seen, run.q)
        rms = np.sqrt(np.mean(one * one, axis=0))
        columns.append(one * (PUSH * np.std(left) / np.maximum(rms, 1e-30)))
    return columns


def _answers(hypothesis: Hypothesis, columns: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """What each of the ``columns`` [N], (n, k) per record, changes in the motor force [N] as a push of the carriage."""
    whole = hypothesis.residuals()
    pushes = zip(*(np.ascontiguousarray(one.T) for one in columns), strict=True)
    pushed = side_by_side(hypothesis.residuals, [(push,) for push in pushes])
    return tuple(
        np.column_stack([a - b for b in there]) for a, there in zip(whole, zip(*pushed, strict=True), strict=True)
    )
