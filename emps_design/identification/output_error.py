"""Closed-loop output error: parameters whose simulation from ``q_ref`` asks for the force that was measured.

No derivative of a measured signal is taken, and the hold is in the simulation. The controller makes the voltage of
reference and position, so an error of the position is in the force as well, and counts once. What a slow force does to
a carriage at rest is no force error of a moving one: rests are left out as in the ``hold`` chain, where anything else
is in the record (Gauss-Newton with a line search).

A record simulated again: closed loop, from its reference, with the parameters of a model.

What the steps of the encoder alone do to an estimate, by simulation of the closed loop.

At a constant speed the steps come too fast for the filters; while the axis starts and stops they do not. So they are in
the motion just where the mass is told, which no statistics of a residual that is the same all along can see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import AxisError, EmpsError, InputError, RankError, RecordError, SimulationError
from emps_design.identification.assemble import (
    Errors,
    Estimated,
    assemble,
    cutoff_sensitivity,
    implausible,
    residual_statistics,
)
from emps_design.identification.chains import hold_chain
from emps_design.identification.excitation import REFUSE, check_record
from emps_design.identification.filters import low_pass
from emps_design.identification.inverse_model import LeastSquares, chosen_cutoff, least_squares, regression
from emps_design.identification.model import Model
from emps_design.identification.problem import Regression, acting, identified_effects, known_part, notes, settled
from emps_design.identification.result import Identification
from emps_design.laws import NONE
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.simulation import Plant, Run
from emps_design.simulation.run import driven_by

PHASES = 8  # of the encoder's steps against the motion
STRIDE = 3  # of the phases, from one run to the next: where within a step the axis stood at first, against the phase

ITERATIONS = 12
STEP = 1e-3  # of a parameter, for the derivatives
CONVERGED = 1e-6  # relative fall of the criterion
RESTS_TAKE_PART = (
    "too little of the record is away from rest, so rests take part: a slow force that acts on the carriage at rest "
    "biases its friction"
)


def simulate(record: Record, axis: Axis, model: Model, value: np.ndarray, quantise: bool = False) -> Run:
    """Closed-loop run of ``record`` from its reference and measured external force with the solution ``value`` (p,).

    The encoder is exact, or that of ``axis`` with ``quantise``. Raises :class:`RecordError` for ``value`` that no
    simulation starts from, and where the controller of ``axis`` did not make the record.
    """
    p = model.natural(value)
    mechanics = dict(zip(("mass", "viscous", "coulomb", "offset"), model.baseline(p).tolist(), strict=True))
    found = {**mechanics, "viscous": p.get("viscous", mechanics["viscous"])}
    for name in ("mass", "viscous", "coulomb"):
        if not found[name] > 0:
            why = implausible(p, axis) or [
                "the record does not determine it: record several constant speeds in both directions, with "
                "acceleration between them"
            ]
            raise RecordError(
                f"{record.name}: {name} came out as {found[name]:.4g}, and no simulation starts from that; {why[0]}"
            )
    effects = [*identified_effects(model, p), *known_part(axis, model).effects]
    machine = axis.replace(mechanics=mechanics, effects=effects, sampling={"period": record.period})
    try:
        return Plant.of(machine).closed_loop(**driven_by(machine, record), quantise=quantise)
    except SimulationError as error:
        raise RecordError(
            f"{record.name}: no simulation with the controller of {axis.name} at {1 / record.period:g} Hz ({error}), "
            "so the record was made with another one; put its controller into the axis, or use `identify`"
        ) from error


def error_of_steps(
    record: Record, axis: Axis, model: Model, value: np.ndarray, estimate: Callable[[Record, Record], np.ndarray]
) -> np.ndarray | None:
    """Rms (p,) by which the steps of the encoder move ``estimate``, over several of their phases.

    ``estimate`` gives parameters (p,) of a simulated record, beside the same record by an exact encoder; ``value`` (p,)
    are those that are simulated. None without a resolution or a controller in ``axis``, without a recorded reference,
    and where no simulation with ``value`` follows it.
    """
    resolution = axis.sampling.encoder_resolution
    if not resolution or axis.controller.kind == NONE or not record.has_reference:
        return None
    try:
        exact = _as_record(record, axis, model, value)
        right, errors = estimate(exact, exact), []
        for phase in range(PHASES):
            moved, stood = (resolution * (i % PHASES) / PHASES for i in (phase, STRIDE * phase))
            seen = _as_record(record, axis, model, value, moved, stood - 0.5 * resolution)
            errors.append(estimate(seen, exact) - right)
        return np.sqrt(np.mean(np.square(errors), axis=0))
    except (EmpsError, np.linalg.LinAlgError):
        return None


def _as_record(
    record: Record, axis: Axis, model: Model, value: np.ndarray, moved: float = 0.0, stood: float | None = None
) -> Record:
    """``record`` as the axis with ``value`` would have made it, by an exact encoder without ``stood``.

    ``moved`` [m] is all of it against the encoder's steps, ``stood`` [m] how far the axis was at first from what the
    encoder said.
    """
    start = replace(record, q_ref=record.q_ref + moved, q=record.q + moved + (stood or 0.0))
    run = simulate(start, axis, model, value, quantise=stood is not None)
    return replace(record, q=run.q - moved, u=run.u)


def identify_by_output_error(
    record: Record,
    axis: Axis,
    model: str | Model = "symmetric",
    cutoff: float | None = None,
    external_force: str = REFUSE,
) -> Identification:
    """Identify ``axis`` from ``record`` by closed-loop output error on the motor force.

    Starts at the least-squares estimate of the ``hold`` chain, or, where that finds too little away from rest, at the
    mechanics of ``axis``; ``cutoff`` [Hz] low-passes the residual. ``extra`` holds the errors in position [m] and
    force [N]. Raises :class:`AxisError` without a controller, :class:`InputError` where the search does not converge.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> found = identify_by_output_error(synthetic_record(axis, laps=1), axis)
    >>> round(found.parameters["viscous"].value, -1), found.extra["closed_loop"]["position_rms_error"] < 1e-6
    (200.0, True)
    """
    if axis.controller.kind == NONE:
        raise AxisError(f"{axis.name}: output error needs the controller of the record; give [controller] in the axis")
    axis = axis.supplied_by(record)
    record = check_record(record, axis, external_force)
    model = Model.of(model)
    axis = known_part(axis, model)
    if cutoff is None:
        cutoff = chosen_cutoff(acting(record, axis))
    problem, start, said = _problem(record, axis, model, cutoff)
    model = problem.model
    measured = motor_force(axis, record)

    def force_error(parameters: np.ndarray) -> np.ndarray:
        return measured - simulate(record, axis, model, parameters).force

    def filtered_error(parameters: np.ndarray) -> np.ndarray:
        return _rows(force_error(parameters), problem)

    value, residual, jacobian = _least(filtered_error, start, model, record.name)
    problem, fit = _linear(problem, jacobian, residual, value)
    off = low_pass(record.q - simulate(record, axis, model, value).position, cutoff, record.period)
    edge = _edge(problem)
    extra = {
        "closed_loop": {
            "position_rms_error": float(np.sqrt(np.mean(off[edge : len(record) - edge] ** 2))),
            "force_rms_error": fit.rms_error,
            "force_relative_error_percent": fit.relative_error_percent,
        }
    }

    def of_steps(seen: Record, exact: Record) -> np.ndarray:
        off = _rows(motor_force(axis, seen) - motor_force(axis, exact), problem)
        return least_squares(jacobian, off, problem.names, problem.used).value

    error = force_error(value)
    slopes = _jacobian(force_error, value, error, model).T

    def at(frequency: float) -> Estimated:
        """One step of Gauss and Newton from the estimate, with error and derivatives filtered otherwise."""
        other, _, _ = _problem(record, axis, model, frequency)
        columns, left = np.column_stack([_rows(one, other) for one in slopes]), _rows(error, other)
        step = least_squares(columns, left, other.names, other.used)
        linear, found = _linear(other, columns, step.residual, value + step.value)
        return Estimated(other.parameters(found.value), residual_statistics(linear, found)[0].std)

    own = Estimated(problem.parameters(value), residual_statistics(problem, fit)[0].std)
    errors = Errors(
        encoder=error_of_steps(record, axis, model, value, of_steps),
        cutoff=cutoff_sensitivity(problem.names, own, cutoff, record.period, at),
    )
    found = assemble(problem, fit, "output_error", None, errors, said, extra, weakest=0.0)
    return replace(found, series={**found.series, "measured": problem.Y, "model": problem.Y - residual})


def _problem(record: Record, axis: Axis, model: Model, cutoff: float) -> tuple[Regression, np.ndarray, list[str]]:
    """The regression at this ``cutoff`` [Hz], where its least squares start the search (p,), and notes on both.

    With rests, and from the mechanics of the ``axis``, where too little of the record is away from rest.
    """
    said = notes(axis, simulated=True)
    try:
        problem = Regression.of(record, axis, model, cutoff=cutoff)
        return problem, problem.solved().value, said
    except (RecordError, RankError):
        filtered = hold_chain(record, axis.drive.gain, cutoff, fewest_rows=0)
        filtered = replace(filtered, used=np.ones_like(filtered.used))
        model = settled(filtered, model)
        W, Y = regression(filtered, model)
        return Regression(record, axis, model, filtered, W, Y), _mechanics(axis, model), [*said, RESTS_TAKE_PART]


def _linear(
    problem: Regression, jacobian: np.ndarray, residual: np.ndarray, value: np.ndarray
) -> tuple[Regression, LeastSquares]:
    """The ``problem`` with the derivatives (n, p) as its columns, and its solution ``value`` (p,)."""
    spread, condition = np.linalg.inv(jacobian.T @ jacobian), float(np.linalg.cond(jacobian))
    force, rows = problem.filtered.force * problem.used, int(problem.used.sum())
    fit = LeastSquares.of(problem.names, value, spread, residual, force, rows, condition)
    return replace(problem, W=jacobian, Y=force), fit


def _edge(problem: Regression) -> int:
    """Samples at each end in which the filter makes up what lies outside the record."""
    return int(1.0 / (problem.filtered.band_hz * problem.record.period))


def _rows(force: np.ndarray, problem: Regression) -> np.ndarray:
    """A ``force`` [N] of the record's rate, filtered to the rows of the ``problem``."""
    smooth = low_pass(force, problem.filtered.band_hz, problem.record.period)
    return problem.filtered.reduce(smooth) * problem.used


def _mechanics(axis: Axis, model: Model) -> np.ndarray:
    """What the axis file says of the parameters of ``model``, and of the terms beside it what is known of them."""
    mass, viscous, coulomb, offset = axis.mechanics.array().tolist()
    two = {f"viscous_{way}": viscous for way in ("positive", "negative")}
    two |= {"coulomb_positive": coulomb + offset, "coulomb_negative": coulomb - offset}
    own = {"mass": mass, "viscous": viscous, "coulomb": coulomb, "constant_force": offset, **two}
    return model.solution({name: model.point.get(name, own.get(name, 0.0)) for name in model.names})


def _least(
    error: Callable[[np.ndarray], np.ndarray], value: np.ndarray, model: Model, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters (p,) with the least sum of squares, possible ones, their error (n,) and its derivative (n, p)."""
    residual = error(value)
    best = float(residual @ residual)
    jacobian = _jacobian(error, value, residual, model)
    for _ in range(ITERATIONS):
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        for share in (1.0, 0.5, 0.25, 0.1):
            trial = value + share * step
            if not model.possible(trial):
                continue
            attempt = error(trial)
            criterion = float(attempt @ attempt)
            if criterion < best:
                break
        else:
            return value, residual, jacobian
        fall, value, residual, best = (best - criterion) / best, trial, attempt, criterion
        jacobian = _jacobian(error, value, residual, model)
        if fall < CONVERGED:
            return value, residual, jacobian
    raise InputError(f"{name}: output error did not converge in {ITERATIONS} steps; give a lower `cutoff`")


def _jacobian(
    error: Callable[[np.ndarray], np.ndarray], value: np.ndarray, residual: np.ndarray, model: Model
) -> np.ndarray:
    """What the simulated force changes by with each parameter, shape (n, p)."""
    columns = []
    sizes = np.where(model.curved, 1.0, np.maximum(np.abs(value), STEP))  # an angle or a power may differ by nothing
    for i, size in enumerate(sizes.tolist()):
        moved = value.copy()
        moved[i] += STEP * size
        columns.append((residual - error(moved)) / (moved[i] - value[i]))
    return np.stack(columns, axis=-1)
