"""Instrumental variables (IDIM-IV), and the test that says when least squares is biased.

In a closed loop the noise of the force moves the carriage, so it is in the columns of W too, and least squares is
biased. The instruments are the same columns of a simulation from the reference alone: they move with the motion and
know nothing of the noise (A. Janot, P.-O. Vandanjon, M. Gautier, 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import AxisError
from emps_design.identification.assemble import assemble, residual_statistics, resolved_steps
from emps_design.identification.chains import hold_chain
from emps_design.identification.closed_loop import simulate
from emps_design.identification.cutoff import first_part
from emps_design.identification.encoder import error_of_steps
from emps_design.identification.excitation import check_record
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import (
    LeastSquares,
    least_squares,
    parameters_of,
    regression,
)
from emps_design.identification.known import filter_record, known_part, notes
from emps_design.identification.result import Identification
from emps_design.identification.statistics import long_run
from emps_design.records import Record

ITERATIONS = 8
WEAK_INSTRUMENT = 0.1  # share of a column that its instrument explains, below which it says nothing
SETTLED = 0.02  # of a standard deviation: an iteration that changes less is the last


@dataclass(frozen=True)
class HausmanTest:
    """Durbin-Wu-Hausman test: does the part of W that the instruments miss explain the residual?

    ``statistic`` is chi-squared with ``degrees`` of freedom where least squares is unbiased, with a covariance that
    allows for the correlation of the residual. ``shift`` is the largest difference between the two estimates, in
    standard deviations: a bias that is certain may still be too small to matter.
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
        """Whether the bias is certain and moves a parameter by half a standard deviation or more."""
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


def identify_with_instruments(
    record: Record,
    axis: Axis,
    model: str = "symmetric",
    cutoff_hz: float | None = None,
    external_force_known: bool = False,
) -> Identification:
    """Identify ``axis`` from ``record`` by IDIM-IV on the ``hold`` chain, with the Durbin-Wu-Hausman test.

    The axis needs its controller (the simulation follows ``q_ref``); :class:`AxisError` otherwise. The least-squares
    values stand in ``extra`` beside the test.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> found = identify_with_instruments(synthetic_record(axis, laps=1), axis)
    >>> round(found.parameters["mass"].value, 0), found.extra["hausman_test"]["bias_matters"]
    (95.0, False)
    """
    if axis.controller.kind == "none":
        raise AxisError(f"{axis.name}: instruments need the controller of the record; give [controller] in the axis")
    axis = axis.supplied_by(record)
    record = check_record(record, axis, external_force_known)
    axis = known_part(axis, model)
    filtered = filter_record(record, axis, "hold", cutoff_hz)
    names = tuple(p.name for p in parameters_of(model))
    W, Y = regression(filtered, model)
    start = least_squares(W, Y, names, filtered.used)
    _, spread, _, _ = residual_statistics(filtered, W, start)
    value, fit, Z = start.value, start, W
    for _ in range(ITERATIONS):
        Z = instruments(record, axis, model, value, filtered)
        fit = _solve(Z, W, Y, names, int(filtered.used.sum()))
        change = np.max(np.abs(fit.value - value) / spread.std)
        value = fit.value
        if change < SETTLED:
            break

    def estimate(seen: Record, exact: Record) -> np.ndarray:
        again = filter_record(seen, axis, "hold", filtered.cutoff_hz)
        led = _columns(exact, axis, model, again)
        return _solve(led, *regression(again, model), names, int(again.used.sum())).value

    test = hausman_test(W, Y, Z, filtered, float(np.max(np.abs(value - start.value) / spread.std)))
    extra = {
        "least_squares": dict(zip(names, map(float, start.value), strict=True)),
        "hausman_test": test.to_dict(),
    }
    return assemble(
        record,
        axis,
        model,
        "instrumental_variables",
        filtered,
        W,
        fit,
        Z=Z,
        extra=extra,
        encoder=error_of_steps(first_part(record), axis, model, value, estimate),
        notes=notes(axis),
        weakest=WEAK_INSTRUMENT,
    )


def instruments(record: Record, axis: Axis, model: str, value: np.ndarray, filtered: Filtered) -> np.ndarray:
    """Columns of the closed-loop simulation from ``q_ref`` with parameters ``value``, filtered alike, (n, p)."""
    run = simulate(record, axis, model, value)
    return _columns(replace(record, q=run.position, u=run.u), axis, model, filtered)


def _columns(run: Record, axis: Axis, model: str, filtered: Filtered) -> np.ndarray:
    Z, _ = regression(hold_chain(run, axis.drive.gain, filtered.cutoff_hz), model)
    return Z * filtered.used[:, None]


def hausman_test(W: np.ndarray, Y: np.ndarray, Z: np.ndarray, filtered: Filtered, shift: float) -> HausmanTest:
    """Durbin-Wu-Hausman test by the augmented regression: W with what of it the instruments Z do not explain.

    ``shift`` is what the two estimates differ by, in standard deviations.
    """
    from scipy.stats import chi2

    # Rows as far apart as the band resolves: what is nonzero between them alone is no evidence.
    steps = resolved_steps(filtered)
    W, Y, Z, used = W[::steps], Y[::steps], Z[::steps], filtered.used[::steps]
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
    spread = long_run(both, fit.residual, used, filtered.period * steps)
    extra = slice(W.shape[1], None)
    statistic = float(fit.value[extra] @ np.linalg.solve(spread.covariance[extra, extra], fit.value[extra]))
    return HausmanTest(statistic, missed.shape[1], float(chi2.sf(statistic, missed.shape[1])), shift)


def _solve(Z: np.ndarray, W: np.ndarray, Y: np.ndarray, names: tuple[str, ...], n: int) -> LeastSquares:
    """(Z^T W)^-1 Z^T Y in the shape of a least-squares fit, with the deviations for independent errors."""
    bread = np.linalg.inv(Z.T @ W)
    value = bread @ (Z.T @ Y)
    condition = float(np.linalg.cond(Z.T @ W) ** 0.5)
    return LeastSquares.of(names, value, bread @ (Z.T @ Z) @ bread.T, Y - W @ value, Y, n, condition)
