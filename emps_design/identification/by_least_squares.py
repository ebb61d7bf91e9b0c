"""Least squares on the inverse dynamic model, (12)-(17), by any chain of filters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError, RankError, RecordError
from emps_design.identification.assemble import Errors, assemble, residual_statistics, with_bootstrap
from emps_design.identification.chains import DEFAULT_CHAIN, LONG
from emps_design.identification.cutoff import acceleration_noise, chosen_cutoff, explained_by_frequency, first_part
from emps_design.identification.excitation import REFUSE, check_record, force_free, goes_one_way
from emps_design.identification.inverse_model import LeastSquares, least_squares, relative_error
from emps_design.identification.known import acting, known_part, notes
from emps_design.identification.model import LUMP, LUMPED, ONE_WAY, Model
from emps_design.identification.problem import Problem
from emps_design.identification.proposals import proposed_terms
from emps_design.identification.request import Request
from emps_design.identification.result import Estimate, Identification
from emps_design.identification.sensitivity import CutoffSensitivity, Estimated, cutoff_sensitivity
from emps_design.records import Record

MOST_NOISE = 0.5  # of a column's own power, that is taken for the encoder's noise


def identify_by_least_squares(record: Record, axis: Axis, request: Request) -> Identification:
    """Identify ``axis`` from ``record`` by least squares; options and errors are those of :func:`.identify`."""
    axis = axis.supplied_by(record)
    friction = ONE_WAY if request.model == "symmetric" and goes_one_way(record) else request.model
    record = check_record(record, axis, request.external_force, one_way=friction == ONE_WAY)
    hold = request.filter == DEFAULT_CHAIN
    asked = request.terms
    axis = known_part(axis, Model(request.model, asked or ()))
    said, chosen = notes(axis), chosen_cutoff(acting(record, axis))
    cutoff = chosen if hold and request.cutoff is None else request.cutoff
    proposed: tuple[str, ...] = ()
    if asked is None and hold:
        proposed = proposed_terms(record, axis, friction, cutoff or chosen)
    model = Model(friction, proposed if asked is None else asked)
    problem = Problem.of(record, axis, model, request.filter, cutoff)
    fit = problem.solved()
    extra: dict[str, Any] = {
        "held_out": _held_out(problem, fit, request),
        "cutoff_from_data": explained_by_frequency(
            acting(record, axis), chosen, replace(problem.model, friction="symmetric")
        ),
    }
    if hold:
        errors = Errors(encoder=_encoder(problem, fit), cutoff=_cutoff(problem, fit))
    else:
        better, systematic = _against_hold(problem, fit, chosen)
        errors = Errors(systematic)
        if better is None:
            said.append("no interval away from rest: the intervals leave out what friction at rest does to them")
        else:
            extra["hold_modelled"] = {name: one.to_dict() for name, one in better.parameters.items()}
    found = assemble(problem, fit, "least_squares", errors=errors, notes=said, extra=extra)
    if request.bootstrap:
        found = with_bootstrap(found, problem, fit, request.bootstrap, request.seed)
    found = replace(found, proposed=proposed)
    return found if friction == request.model else _one_way(found, request.model)


def _one_way(found: Identification, model: str) -> Identification:
    """``found`` with the parameters of ``model`` that motion one way does not tell apart, not determined."""
    whole, told = replace(found.fitted, friction=model), dict(found.parameters)
    for written in whole.quantities:
        if written.name not in told:
            units = found.axis.units
            quantity = replace(written, unit=units.unit(written.unit), text=units.words(written.text))
            told[written.name] = Estimate(quantity, None, None)
    parameters = {name: told[name] for name in (*whole.names, LUMP.name)}
    return replace(found, fitted=whole, parameters=parameters, warnings=(*found.warnings, LUMPED))


def _encoder(problem: Problem, fit: LeastSquares) -> np.ndarray | None:
    """What the steps of the encoder alone do to least squares (p,)."""
    if len(problem.record) > LONG:
        return None
    # Imported here: beside a long record's regression the modules of a simulation are a tenth of its memory.
    from emps_design.identification.encoder import error_of_steps

    def estimate(seen: Record, exact: Record) -> np.ndarray:
        return problem.alike(seen).solved().value

    return error_of_steps(first_part(problem.record), problem.axis, problem.model, fit.value, estimate)


def _cutoff(problem: Problem, fit: LeastSquares) -> CutoffSensitivity:
    """What half and twice the cut-off do; of a long record in part."""
    part = first_part(problem.record)
    if part is not problem.record:
        problem = problem.alike(part)
        fit = problem.solved()

    def at(frequency: float) -> Estimated:
        other = Problem.of(part, problem.axis, problem.model, cutoff=frequency)
        return _estimated(other, other.solved())

    return cutoff_sensitivity(problem.names, _estimated(problem, fit), problem.filtered.band_hz, part.period, at)


def _estimated(problem: Problem, fit: LeastSquares) -> Estimated:
    """Least squares, and what the encoder's noise in the mass's column is known to take from it: it pulls it down."""
    square = problem.W.T @ problem.W
    own = 1.0 / float(np.linalg.inv(square)[0, 0])  # of the mass's column, less what the others explain
    noise = acceleration_noise(problem.record, problem.filtered.band_hz) * int(problem.used.sum())
    square[0, 0] -= min(noise, MOST_NOISE * own)
    without = np.linalg.solve(square, problem.W.T @ problem.Y)
    return Estimated(problem.told(fit.value), residual_statistics(problem, fit)[0].std, without - fit.value)


def _against_hold(
    problem: Problem, fit: LeastSquares, cutoff: float
) -> tuple[Identification | None, np.ndarray | None]:
    """The same by the chain that models hold and rest, and what ``fit`` is off by; long records in part.

    None where too little of the record is away from rest for that chain.
    """
    part = first_part(problem.record)
    if part is not problem.record:
        fit = problem.alike(part).solved()
    try:
        judge = Problem.of(part, problem.axis, problem.model, cutoff=cutoff)
        better = assemble(judge, judge.solved(), "least_squares")
    except (RecordError, RankError):
        return None, None
    return better, fit.value - better.solution()


def _held_out(problem: Problem, fit: LeastSquares, request: Request) -> dict[str, Any] | None:
    """Force error on data that took no part: another record, or the last third; None where the rest cannot do alone."""
    if request.holdout is not None:
        other = problem.alike(force_free(request.holdout, problem.axis, request.external_force))
        return _judged(request.holdout.name, other.Y - other.W @ fit.value, other.Y, other.used)
    cut = 2 * len(problem.W) // 3
    W, Y, used = problem.W, problem.Y, problem.used
    try:
        first = least_squares(W[:cut], Y[:cut], fit.names, used[:cut])
    except (InputError, RankError):
        return None
    return _judged("last third", Y[cut:] - W[cut:] @ first.value, Y[cut:], used[cut:])


def held_out_on(found: Identification, holdout: Record, external_force: str = REFUSE) -> dict[str, Any]:
    """Force error on ``holdout`` of the parameters ``found``, by the inverse model and the filter they came from."""
    record = force_free(holdout, found.axis, external_force)
    other = Problem.of(record, found.axis, found.fitted, found.chain, found.cutoff_hz)
    return _judged(holdout.name, other.Y - other.W @ found.solution(), other.Y, other.used)


def _judged(on: str, error: np.ndarray, force: np.ndarray, used: np.ndarray) -> dict[str, Any]:
    return {
        "on": on,
        "rms_error": float(np.sqrt(error @ error / max(int(used.sum()), 1))),
        "relative_error_percent": relative_error(error, force),
    }
