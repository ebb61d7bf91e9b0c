"""Closed-loop output error: parameters whose simulation from ``q_ref`` asks for the force that was measured.

No derivative of a measured signal is taken, and the hold is in the simulation. The controller makes the voltage of
reference and position, so an error of the position is in the force as well, and counts once. What a slow force does to
a carriage at rest is no force error of a moving one: rests are left out as in the ``hold`` chain, where anything else
is in the record (Gauss-Newton with a line search).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import AxisError, InputError, RankError, RecordError
from emps_design.identification.assemble import assemble
from emps_design.identification.chains import hold_chain
from emps_design.identification.closed_loop import simulate
from emps_design.identification.cutoff import chosen_cutoff
from emps_design.identification.encoder import error_of_steps
from emps_design.identification.excitation import check_record
from emps_design.identification.filters import low_pass
from emps_design.identification.inverse_model import (
    LeastSquares,
    least_squares,
    parameters_of,
    regression,
)
from emps_design.identification.known import acting, filter_record, known_part, notes
from emps_design.identification.result import Identification
from emps_design.observer import motor_force
from emps_design.records import Record

ITERATIONS = 12
STEP = 1e-3  # of a parameter, for the derivatives
CONVERGED = 1e-6  # relative fall of the criterion
RESTS_TAKE_PART = (
    "too little of the record is away from rest, so rests take part: a slow force that acts on the carriage at rest "
    "biases its friction"
)


def identify_by_output_error(
    record: Record,
    axis: Axis,
    model: str = "symmetric",
    cutoff_hz: float | None = None,
    external_force_known: bool = False,
) -> Identification:
    """Identify ``axis`` from ``record`` by closed-loop output error on the motor force.

    Starts at the least-squares estimate of the ``hold`` chain, or, where that finds too little away from rest, at the
    mechanics of ``axis``; ``cutoff_hz`` [Hz] low-passes the residual. ``extra`` holds the errors in position [m] and
    force [N]. Raises :class:`AxisError` without a controller, :class:`InputError` where the search does not converge.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> found = identify_by_output_error(synthetic_record(axis, laps=1), axis)
    >>> round(found.parameters["viscous"].value, -1), found.extra["closed_loop"]["position_rms_error"] < 1e-6
    (200.0, True)
    """
    if axis.controller.kind == "none":
        raise AxisError(f"{axis.name}: output error needs the controller of the record; give [controller] in the axis")
    axis = axis.supplied_by(record)
    record = check_record(record, axis, external_force_known)
    axis = known_part(axis, model)
    if cutoff_hz is None:
        cutoff_hz = chosen_cutoff(acting(record, axis))
    said = notes(axis, simulated=True)
    names = tuple(p.name for p in parameters_of(model))
    try:
        filtered = filter_record(record, axis, "hold", cutoff_hz)
        W, Y = regression(filtered, model)
        start = least_squares(W, Y, names, filtered.used).value
    except (RecordError, RankError):
        filtered = hold_chain(record, axis.drive.gain, cutoff_hz, fewest_rows=0)
        filtered = replace(filtered, used=np.ones_like(filtered.used))
        start = _mechanics(axis, model)
        said.append(RESTS_TAKE_PART)
    edge = int(1.0 / (cutoff_hz * record.period))

    measured = motor_force(axis, record)

    def force_error(parameters: np.ndarray) -> np.ndarray:
        run = simulate(record, axis, model, parameters)
        error = low_pass(measured - run.force, cutoff_hz, record.period)
        return error[edge : len(record) - edge : filtered.decimation] * filtered.used

    value, residual, jacobian = _least(force_error, start, 3 if model == "symmetric" else 5, record.name)
    measured, spread = filtered.force * filtered.used, np.linalg.inv(jacobian.T @ jacobian)
    rows, condition = int(filtered.used.sum()), float(np.linalg.cond(jacobian))
    fit = LeastSquares.of(names, value, spread, residual, measured, rows, condition)
    off = low_pass(record.q - simulate(record, axis, model, value).position, cutoff_hz, record.period)
    extra = {
        "closed_loop": {
            "position_rms_error": float(np.sqrt(np.mean(off[edge : len(record) - edge] ** 2))),
            "force_rms_error": fit.rms_error,
            "force_relative_error_percent": fit.relative_error_percent,
        }
    }

    def estimate(seen: Record, exact: Record) -> np.ndarray:
        error = low_pass(motor_force(axis, seen) - motor_force(axis, exact), cutoff_hz, record.period)
        off = error[edge : len(record) - edge : filtered.decimation] * filtered.used
        return least_squares(jacobian, off, names, filtered.used).value

    found = assemble(
        record, axis, model, "output_error", filtered, jacobian, fit,
        extra=extra, encoder=error_of_steps(record, axis, model, value, estimate), notes=said, weakest=0.0,
    )  # fmt: skip
    return replace(found, series={**found.series, "measured": measured, "model": measured - residual})


def _mechanics(axis: Axis, model: str) -> np.ndarray:
    """What the axis file says of the parameters of ``model``."""
    mass, viscous, coulomb, offset = axis.mechanics.array()
    if model == "symmetric":
        return axis.mechanics.array()
    return np.array([mass, viscous, viscous, coulomb + offset, coulomb - offset])


def _least(
    error: Callable[[np.ndarray], np.ndarray], value: np.ndarray, positive: int, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters (p,) with the least sum of squares, their error (n,) and its derivative (n, p).

    The first ``positive`` of them stay so.
    """
    residual = error(value)
    best = float(residual @ residual)
    jacobian = _jacobian(error, value, residual)
    for _ in range(ITERATIONS):
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        for share in (1.0, 0.5, 0.25, 0.1):
            trial = value + share * step
            if np.any(trial[:positive] <= 0):
                continue
            attempt = error(trial)
            criterion = float(attempt @ attempt)
            if criterion < best:
                break
        else:
            return value, residual, jacobian
        fall, value, residual, best = (best - criterion) / best, trial, attempt, criterion
        jacobian = _jacobian(error, value, residual)
        if fall < CONVERGED:
            return value, residual, jacobian
    raise InputError(f"{name}: output error did not converge in {ITERATIONS} steps; give a lower `cutoff_hz`")


def _jacobian(error: Callable[[np.ndarray], np.ndarray], value: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """What the simulated force changes by with each parameter, shape (n, p)."""
    columns = []
    for i, one in enumerate(value):
        moved = value.copy()
        moved[i] += STEP * max(abs(one), STEP)
        columns.append((residual - error(moved)) / (moved[i] - one))
    return np.stack(columns, axis=-1)
