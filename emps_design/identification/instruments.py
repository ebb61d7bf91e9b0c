"""Instrumental variables (IDIM-IV), and the test for the bias of least squares.

In a closed loop the force noise moves the carriage, so it enters the columns of W and least squares is biased. The
instruments are the same columns from a simulation driven by the reference alone: they are correlated with the motion,
not with the noise (A. Janot, P.-O. Vandanjon, M. Gautier, 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import AxisError
from emps_design.identification.assemble import Errors, Solution, assemble, cutoff_sensitivity
from emps_design.identification.chains import first_part, hold_chain
from emps_design.identification.excitation import REFUSE, check_record
from emps_design.identification.inverse_model import LeastSquares, Regression, least_squares, notes, regression
from emps_design.identification.model import Model, known_part
from emps_design.identification.output_error import error_of_steps, simulate
from emps_design.identification.result import Identification
from emps_design.identification.statistics import long_run
from emps_design.laws import NONE
from emps_design.records import Record

ITERATIONS = 8
WEAK_INSTRUMENT = 0.1  # share of a column explained by its instrument, below which the instrument is useless
SETTLED = 0.02  # of a standard deviation: an iteration that changes less is the last


@dataclass(frozen=True)
class HausmanTest:
    """Durbin-Wu-Hausman test: does the part of W that the instruments miss explain the residual?

    ``statistic`` is chi-squared with ``degrees`` of freedom where least squares is unbiased; its covariance allows for
    a correlated residual. ``shift`` is the largest difference between the two estimates, in standard deviations: a
    significant bias may still be too small to matter.
    """

    statistic: float
    degrees: int
    p_value: float
    shift: float

    @property
    def biased(self) -> bool:
        """Whether least squares is biased, at 1 %."""
        return self.p_value < 0.01

    @property
    def matters(self) -> bool:
        """Whether the bias is significant and at least half a standard deviation of a parameter."""
        return self.biased and self.shift >= 0.5

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "statistic": self.statistic,
            "degrees": self.degrees,
            "p_value": self.p_value,
            "least_squares_biased": self.biased,
            "shift_in_std": self.shift,
            "bias_matters": self.matters,
        }


@dataclass(frozen=True)
class InstrumentalFit:
    """The ``solution`` by instruments from the record ``simulated`` from the reference; ``start``: least squares.

    The test costs little; deviations and intervals are computed by :meth:`identification` only.
    """

    solution: Solution
    start: LeastSquares
    simulated: Record
    test: HausmanTest

    def identification(self) -> Identification:
        """The fit with its statistics, and its sensitivity to the encoder's steps and to the cut-off."""
        problem = self.solution.problem
        record, axis, model = problem.record, problem.axis, problem.model

        def of_steps(rounded: Record, exact: Record) -> np.ndarray:
            again = problem.alike(rounded)
            return _solved(_columns(exact, again), again).fit.value

        def at(frequency: float) -> Solution:
            other = Regression.of(record, axis, model, cutoff=frequency)
            return _solved(_columns(self.simulated, other), other)

        errors = Errors(
            encoder=error_of_steps(first_part(record), axis, model, self.solution.fit.value, of_steps),
            cutoff=cutoff_sensitivity(self.solution, at),
        )
        extra = {
            "least_squares": model.natural(self.start.value),
            "hausman_test": self.test.to_dict(),
        }
        return assemble(self.solution, "instrumental_variables", errors, notes(axis), extra, WEAK_INSTRUMENT)


def identify_with_instruments(
    record: Record,
    axis: Axis,
    model: str | Model = "symmetric",
    cutoff: float | None = None,
    external_force: str = REFUSE,
) -> Identification:
    """Identify ``axis`` from ``record`` by IDIM-IV on the ``hold`` chain, with the Durbin-Wu-Hausman test.

    The axis needs its controller (the simulation follows ``q_ref``); :class:`AxisError` otherwise. The least-squares
    values stand in ``extra`` beside the test.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> identification = identify_with_instruments(synthetic_record(axis, laps=1), axis)
    >>> round(identification.parameters["mass"].value, 0), identification.extra["hausman_test"]["bias_matters"]
    (95.0, False)
    """
    return solve_with_instruments(record, axis, model, cutoff, external_force).identification()


def solve_with_instruments(
    record: Record, axis: Axis, model: str | Model, cutoff: float | None, external_force: str
) -> InstrumentalFit:
    """Iterate simulation and instruments until they converge; arguments as in :func:`identify_with_instruments`."""
    if axis.controller.kind == NONE:
        raise AxisError(f"{axis.name}: instruments need the controller of the record; give [controller] in the axis")
    axis = axis.supplied_by(record)
    record = check_record(record, axis, external_force)
    axis = known_part(axis, model)
    problem = Regression.of(record, axis, model, cutoff=cutoff)
    start = Solution.of(problem)
    std, first, value = start.spread.std, start.fit, start.fit.value
    for _ in range(ITERATIONS):
        run = simulate(record, axis, problem.model, value)
        simulated = replace(record, q=run.position, u=run.u)
        solution = _solved(_columns(simulated, problem), problem)
        change = np.max(np.abs(solution.fit.value - value) / std)
        value = solution.fit.value
        if change < SETTLED:
            break
    test = hausman_test(solution, float(np.max(np.abs(value - first.value) / std)))
    return InstrumentalFit(solution, first, simulated, test)


def _columns(simulated: Record, problem: Regression) -> np.ndarray:
    """Columns (n, p) of a record ``simulated`` from the reference, filtered as in ``problem``."""
    Z, _ = regression(hold_chain(simulated, problem.axis.drive.gain, problem.filtered.cutoff_hz), problem.model)
    return Z * problem.used[:, None]


def hausman_test(solution: Solution, shift: float) -> HausmanTest:
    """Durbin-Wu-Hausman test by the augmented regression: W and the part of it that the instruments miss.

    ``shift`` is the largest difference between the two estimates, in standard deviations.
    """
    from scipy.stats import chi2

    problem = solution.problem
    # Only rows as far apart as the band resolves: those between them are no independent evidence.
    steps = problem.filtered.resolved_steps
    W, Y, Z, used = (array[::steps] for array in (problem.W, problem.Y, solution.instruments, problem.used))
    basis = np.linalg.qr(Z)[0]
    missed = W - basis @ (basis.T @ W)
    kept = np.linalg.norm(missed, axis=0) > 1e-3 * np.linalg.norm(W, axis=0)
    # Columns of the missed part may repeat each other; keep independent ones.
    missed = missed[:, kept]
    while missed.shape[1] > 1:
        scaled = missed / np.linalg.norm(missed, axis=0)
        singular, right = np.linalg.svd(scaled, full_matrices=False)[1:]
        if singular[-1] > 1e-3 * singular[0]:
            break
        missed = np.delete(missed, int(np.argmax(np.abs(right[-1]))), axis=1)
    if missed.shape[1] == 0:
        return HausmanTest(0.0, 0, 1.0, shift)
    both = np.column_stack([W, missed])
    names = tuple(f"column {i}" for i in range(both.shape[1]))
    fit = least_squares(both, Y, names, used)
    spread = long_run(both, fit.residual, used, problem.filtered.period * steps)
    extra = slice(W.shape[1], None)
    statistic = float(fit.value[extra] @ np.linalg.solve(spread.covariance[extra, extra], fit.value[extra]))
    return HausmanTest(statistic, missed.shape[1], float(chi2.sf(statistic, missed.shape[1])), shift)


def _solved(Z: np.ndarray, problem: Regression) -> Solution:
    """(Z^T W)^-1 Z^T Y in the shape of a least-squares fit, with the deviations for independent errors."""
    W, Y = problem.W, problem.Y
    bread = np.linalg.inv(Z.T @ W)
    value = bread @ (Z.T @ Y)
    condition, rows = float(np.linalg.cond(Z.T @ W) ** 0.5), int(problem.used.sum())
    spread = bread @ (Z.T @ Z) @ bread.T
    return Solution(problem, LeastSquares.of(problem.names, value, spread, Y - W @ value, Y, rows, condition), Z)
