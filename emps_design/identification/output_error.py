"""Closed-loop output error: parameters whose simulation from ``q_ref`` follows measured position *and* force.

No derivative of a measured signal is taken, reversals and rests take part, and the hold is in the simulation. The
residuals of both signals are low-passed alike and weighed by their own size (Gauss-Newton with a line search).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import AxisError, InputError
from emps_design.identification.assemble import assemble
from emps_design.identification.cutoff import chosen_cutoff
from emps_design.identification.excitation import check_record
from emps_design.identification.filters import low_pass
from emps_design.identification.instruments import simulate
from emps_design.identification.inverse_model import LeastSquares, least_squares, parameters_of, regression
from emps_design.identification.known import acting, filter_record, known_part, notes
from emps_design.identification.result import Identification
from emps_design.records import Record

ITERATIONS = 12
STEP = 1e-3  # of a parameter, for the derivatives
CONVERGED = 1e-6  # relative fall of the criterion


def identify_by_output_error(
    record: Record,
    axis: Axis,
    model: str = "symmetric",
    cutoff_hz: float | None = None,
    external_force_known: bool = False,
) -> Identification:
    """Identify ``axis`` from ``record`` by closed-loop output error on position and force.

    Starts at the least-squares estimate of the ``hold`` chain; ``cutoff_hz`` [Hz] low-passes the residuals. ``extra``
    holds the errors in position [m] and force [N]. Raises :class:`AxisError` without a controller,
    :class:`InputError` where the search does not converge.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> found = identify_by_output_error(synthetic_record(axis, laps=1), axis)
    >>> round(found.parameters["viscous"].value, -1), found.extra["closed_loop"]["position_rms_error"] < 1e-6
    (200.0, True)
    """
    if axis.controller.kind == "none":
        raise AxisError(f"{axis.name}: output error needs the controller of the record; give [controller] in the axis")
    record = check_record(record, axis, external_force_known)
    axis = known_part(axis, model)
    if cutoff_hz is None:
        cutoff_hz = chosen_cutoff(acting(record, axis)).cutoff_hz
    filtered = filter_record(record, axis, "hold", cutoff_hz)
    names = tuple(p.name for p in parameters_of(model))
    W, Y = regression(filtered, model)
    value = least_squares(W, Y, names, filtered.used).value
    edge = int(1.0 / (cutoff_hz * record.period))

    def outputs(parameters: np.ndarray) -> np.ndarray:
        run = simulate(record, axis, model, parameters)
        both = (record.q - run.position, axis.drive.force_gain * (record.u - run.u))
        kept = slice(edge, len(record) - edge, filtered.decimation)
        return np.stack([low_pass(signal, cutoff_hz, record.period)[kept] for signal in both])

    residual = outputs(value)
    scale = np.sqrt(np.mean(residual**2, axis=1))[:, None]
    best = float(np.sum((residual / scale) ** 2))
    jacobian = _jacobian(outputs, value, residual)
    for _ in range(ITERATIONS):
        stacked = (jacobian / scale[..., None]).reshape(-1, len(value))
        step = np.linalg.lstsq(stacked, (residual / scale).ravel(), rcond=None)[0]
        for share in (1.0, 0.5, 0.25, 0.1):
            trial = value + share * step
            if np.any(trial[: 3 if model == "symmetric" else None] <= 0):
                continue
            attempt = outputs(trial)
            criterion = float(np.sum((attempt / scale) ** 2))
            if criterion < best:
                break
        else:
            break
        fall, value, residual, best = (best - criterion) / best, trial, attempt, criterion
        jacobian = _jacobian(outputs, value, residual)
        if fall < CONVERGED:
            break
    else:
        raise InputError(
            f"{record.name}: output error did not converge in {ITERATIONS} steps; give a lower `cutoff_hz`"
        )
    return _result(record, axis, model, filtered, value, residual, jacobian, scale, names)


def _jacobian(outputs: Callable[[np.ndarray], np.ndarray], value: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Derivative of the simulated outputs by each parameter, shape (2, n, p)."""
    columns = []
    for i, one in enumerate(value):
        moved = value.copy()
        moved[i] += STEP * max(abs(one), 1.0)
        columns.append((residual - outputs(moved)) / (moved[i] - one))
    return np.stack(columns, axis=-1)


def _result(record, axis, model, filtered, value, residual, jacobian, scale, names) -> Identification:
    # Position and force errors are two views of one disturbance, so the deviations come from the force's alone,
    # with the whole estimator as its instrument: what it makes of the force is what both together make.
    n = residual.shape[1]
    J = jacobian[1]
    weighed = (jacobian / scale[..., None]).reshape(-1, len(value))
    stacked = (residual / scale).ravel()
    variance = float(stacked @ stacked) / (2 * n - len(value))
    force = residual[1]
    measured = filtered.force
    fit = LeastSquares(
        names=names,
        value=value,
        covariance=variance * np.linalg.inv(weighed.T @ weighed),
        residual=force,
        rms_error=float(np.sqrt(np.mean(force**2))),
        relative_error_percent=100.0 * float(np.linalg.norm(force) / np.linalg.norm(measured)),
        condition_number=float(np.linalg.cond(weighed)),
    )
    extra = {
        "closed_loop": {
            "position_rms_error": float(np.sqrt(np.mean(residual[0] ** 2))),
            "force_rms_error": fit.rms_error,
            "force_relative_error_percent": fit.relative_error_percent,
        }
    }
    everywhere = replace(filtered, used=np.ones(n, dtype=bool))
    found = assemble(
        record,
        axis,
        model,
        "output_error",
        everywhere,
        J,
        fit,
        extra=extra,
        notes=notes(axis, simulated=True),
        weakest=0.0,
    )
    return replace(found, series={**found.series, "measured": measured, "model": measured - force})
