"""What the command does between two samples of a record: held, smooth, or recorded late.

A drive holds the command over its own period. Where that is the period T of the record, the mean force around t_k is
that of a held command; where the drive is much faster, that of a smooth one (:mod:`.filters`). The two are half a
sample apart, which moves inertia and friction against each other. A record alone does not say which it is, but its
residual may: with the forces Y_h and Y_s of the two, the regression

    Y_h = W X + share (Y_h - Y_s)

also finds how far from held (0) to smooth (1) the command is. Between them the drive holds it over a part of T; beyond
1, or below 0, it is recorded share T/2 later than it acts. Two fits are compared by their likelihoods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from emps_design.errors import InputError, RankError, RecordError
from emps_design.identification.assemble import Solution
from emps_design.identification.inverse_model import least_squares
from emps_design.messages import Message, note, warning

DECIDED = 6.0  # twice the log of the odds, from which on one of two fits is right: 20 : 1
LEAST_OWN = 0.1  # of the change of the force, that inertia and friction do not explain
LEAST_GAIN = 0.1  # of the residual: a delay that explains less may stand for other physics, and is not reported
MOST_SHARE = 1.5  # of the way from held to smooth, beyond which the command is recorded late


@dataclass(frozen=True)
class CommandHold:
    """What the record says of its command between samples.

    ``smooth``: the drive is faster than the record. ``change`` (p,) is what the parameters change with a command that
    the record does not exclude, None for none. ``late`` [s] is how much later than it acts the command is recorded.
    """

    smooth: bool = False
    change: np.ndarray | None = None
    late: float = 0.0

    @property
    def messages(self) -> tuple[Message, ...]:
        """What a reader should know of it."""
        if self.smooth:
            text = "u: samples of a drive that is faster than its record; a smooth curve lies between them"
            return (note("faster-drive", text),)
        if not self.late:
            return ()
        way = "later" if self.late > 0.0 else "earlier"
        text = (
            f"u and q: the command fits the motion best if it is recorded {1e3 * abs(self.late):.2g} ms {way} than it "
            f"acts, as where a bus or a filter delays one of them; the intervals hold what that changes, and delay = "
            f"{self.late:.2g} of command in [record] corrects it"
        )
        return (warning("command-recorded-late", text, delay=self.late),)


def command_hold(solution: Solution) -> CommandHold:
    """What the record of a ``solution`` with a held command, or with a smooth one, says of it.

    >>> from emps_design.identification.inverse_model import Regression
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> late = replace(record, u=np.interp(record.t - 5e-3, record.t, record.u))
    >>> found = [command_hold(Solution.of(Regression.of(r, axis, "symmetric", cutoff=40.0))) for r in (record, late)]
    >>> [hold.smooth for hold in found], [round(1e3 * hold.late) for hold in found]
    ([False, False], [0, 5])
    """
    other = _otherwise(solution)
    if other is None:
        return CommandHold()
    between, share = _between(solution, other)
    held = solution.problem.record.held
    certain = between is not None and evidence(solution, between) > DECIDED
    clear = between is not None and between.fit.rms_error < (1.0 - LEAST_GAIN) * solution.fit.rms_error
    late = held and certain and clear and not 1.0 - MOST_SHARE < share < MOST_SHARE
    if held and not late and evidence(solution, other) > DECIDED:
        return CommandHold(smooth=True)
    if between is not None and (certain or not held):
        other = between
    elif not held or evidence(other, solution) > DECIDED:
        return CommandHold()
    change = np.abs(other.parameters - solution.parameters)
    return CommandHold(change=change, late=0.5 * share * solution.problem.record.period if late else 0.0)


def evidence(own: Solution, other: Solution) -> float:
    """Twice the log of the likelihood of ``other`` over that of ``own``, by their residuals."""
    independent = min(own.spread.effective_samples, other.spread.effective_samples)
    return 2.0 * independent * math.log(own.fit.rms_error / other.fit.rms_error)


def _otherwise(solution: Solution) -> Solution | None:
    """The solution with a smooth command instead of a held one, or the reverse; None where there is none."""
    problem = solution.problem
    try:
        return Solution.of(problem.alike(replace(problem.record, held=not problem.record.held)))
    except (RecordError, RankError, np.linalg.LinAlgError):
        return None


def _between(own: Solution, other: Solution) -> tuple[Solution | None, float]:
    """The solution with the best force between ``own`` (0) and ``other`` (1), or beyond, and its place; or None."""
    problem, names = own.problem, (*own.problem.names, "share")
    change = problem.Y - other.problem.Y
    basis = np.linalg.qr(problem.W)[0]
    if np.linalg.norm(change - basis @ (basis.T @ change)) < LEAST_OWN * np.linalg.norm(change):
        return None, 0.0  # of a single sine a delay is inertia and friction
    W = np.column_stack([problem.W, change])
    try:
        fit = least_squares(W, problem.Y, names, problem.used, problem.axis.units)
    except (InputError, RankError, np.linalg.LinAlgError):
        return None, 0.0
    return replace(own, fit=replace(fit, value=fit.value[:-1])), float(fit.value[-1])
