"""Identify the parameters of an axis from one record: least squares, instruments or output error.

Least squares on the inverse dynamic model, (12)-(17), works with any filter chain. But force noise moves the carriage,
the more the lighter it is and the faster its loop, and then least squares underestimates the mass. Instruments replace
it where a test shows the bias, or where a column is mostly noise and its instrument is not. Where the measured
acceleration is all noise neither determines the mass; output error may, for it simulates the acceleration. Both need
the controller, which is identified from the record where the axis has none. Without controller or reference, and for
very long records (memory), least squares stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.terms import GRAVITY
from emps_design.errors import EmpsError, InputError, RankError, RecordError
from emps_design.identification.assemble import (
    CutoffSensitivity,
    Errors,
    Solution,
    assemble,
    cutoff_sensitivity,
    with_bootstrap,
)
from emps_design.identification.chains import (
    DEFAULT_CHAIN,
    LONG,
    acceleration_noise,
    chosen_cutoff,
    explained_by_frequency,
    first_part,
)
from emps_design.identification.command_hold import CommandHold, command_hold
from emps_design.identification.excitation import REFUSE, WEAK_RELIABILITY, check_record, force_free, goes_one_way
from emps_design.identification.inverse_model import Regression, least_squares, notes, relative_error
from emps_design.identification.model import LUMP, ONE_WAY, Model, known_part, lumped
from emps_design.identification.proposals import proposed_for, proposed_terms
from emps_design.identification.result import (
    AUTO,
    BY_INSTRUMENTS,
    BY_LEAST_SQUARES,
    BY_OUTPUT_ERROR,
    DEFAULTS,
    Estimate,
    Identification,
    IdentificationRequest,
)
from emps_design.laws import NONE
from emps_design.messages import Message, note, warning
from emps_design.observer import with_acting_command
from emps_design.progress import LOOKING
from emps_design.records import Record
from emps_design.request import takes

MOST_NOISE = 0.5  # of a column's own power: at most so much is attributed to encoder noise


def identify_by_least_squares(
    record: Record, axis: Axis, request: IdentificationRequest, aligned: bool = False
) -> Identification:
    """Identify ``axis`` from ``record`` by least squares; options and errors are those of :func:`.identify`.

    ``aligned``: the command of the record is in time with its motion, so what it does between samples is not judged.
    """
    axis = axis.supplied_by(record)
    friction = ONE_WAY if request.model == "symmetric" and goes_one_way(record) else request.model
    record = check_record(record, axis, request.external_force, one_way=friction == ONE_WAY)
    hold = request.filter == DEFAULT_CHAIN
    terms = request.terms
    axis = known_part(axis, Model(request.model, terms or ()))
    driven, _ = with_acting_command(axis, record)
    remarks, chosen = notes(axis), chosen_cutoff(driven)
    cutoff = chosen if hold and request.cutoff is None else request.cutoff
    proposed: tuple[str, ...] = ()
    if terms is None and hold:
        proposed = proposed_terms(record, axis, friction, cutoff or chosen)
    model = Model(friction, proposed if terms is None else terms)
    problem = Regression.of(record, axis, model, request.filter, cutoff)
    solution = Solution.of(problem)
    between = CommandHold()
    in_time = aligned or axis.controller.kind != NONE  # a known controller gives its command in time
    if hold and not in_time and len(record) <= LONG:
        between = command_hold(solution)
    if between.smooth:
        record = replace(record, held=False, warnings=(*record.warnings, *between.messages))
        return identify_by_least_squares(record, axis, request)
    extra: dict[str, Any] = {
        "held_out": _held_out(solution, request),
        "cutoff_from_data": explained_by_frequency(
            driven, chosen, replace(problem.model, friction="symmetric"), axis.units
        ),
    }
    if hold:
        remarks += between.messages
        errors = Errors(encoder=_encoder_error(solution), cutoff=_cutoff_change(solution), hold=between.change)
    else:
        better, systematic = _compare_with_hold(solution, chosen)
        errors = Errors(systematic)
        if better is None:
            text = "too little of the record is in motion: the intervals do not include the error by friction at rest"
            remarks.append(warning("rest-left-out", text))
        else:
            extra["hold_modelled"] = {name: estimate.to_dict() for name, estimate in better.parameters.items()}
    identification = assemble(solution, "least_squares", errors, remarks, extra)
    if request.bootstrap:
        identification = with_bootstrap(identification, solution, request.bootstrap, request.seed)
    identification = replace(identification, proposed=proposed)
    return identification if friction == request.model else _one_way(identification, request.model)


def _one_way(identification: Identification, model: str) -> Identification:
    """``identification`` with the parameters of ``model`` that motion one way cannot separate, as not determined."""
    whole, estimates = replace(identification.fitted, friction=model), dict(identification.parameters)
    units = identification.axis.units
    for written in whole.quantities:
        if written.name not in estimates:
            quantity = replace(written, unit=units.unit(written.unit), text=units.words(written.text))
            estimates[written.name] = Estimate(quantity, None, None)
    parameters = {name: estimates[name] for name in (*whole.names, LUMP.name)}
    warnings = (*identification.warnings, lumped(units))
    return replace(identification, fitted=whole, parameters=parameters, warnings=warnings)


def _encoder_error(solution: Solution) -> np.ndarray | None:
    """Rms error (p,) of least squares by the steps of the encoder; None where it is not computed."""
    problem = solution.problem
    if len(problem.record) > LONG:
        return None
    # Imported here: the simulation's modules would add a tenth to the memory of a long record's regression.
    from emps_design.identification.closed_loop import error_of_steps

    def estimate(rounded: Record, exact: Record) -> np.ndarray:
        return problem.alike(rounded).solved().value

    return error_of_steps(first_part(problem.record), problem.axis, problem.model, solution.fit.value, estimate)


def _cutoff_change(solution: Solution) -> CutoffSensitivity:
    """Sensitivity to half and twice the cut-off; of a long record by its first part."""
    problem = solution.problem
    part = first_part(problem.record)
    if part is not problem.record:
        solution = Solution.of(problem.alike(part))

    def at(frequency: float) -> Solution:
        return Solution.of(Regression.of(part, problem.axis, problem.model, cutoff=frequency))

    return cutoff_sensitivity(solution, at, _noise_bias)


def _noise_bias(solution: Solution) -> np.ndarray:
    """Known bias (p,) of least squares by encoder noise in the column of the mass, which pulls the mass down."""
    problem = solution.problem
    square = problem.W.T @ problem.W
    own = 1.0 / float(np.linalg.inv(square)[0, 0])  # of the mass's column, less what the others explain
    noise = acceleration_noise(problem.record, problem.filtered.band_hz) * int(problem.used.sum())
    square[0, 0] -= min(noise, MOST_NOISE * own)
    without = np.linalg.solve(square, problem.W.T @ problem.Y)
    return without - solution.fit.value


def _compare_with_hold(solution: Solution, cutoff: float) -> tuple[Identification | None, np.ndarray | None]:
    """Identification by the ``hold`` chain, and the error (p,) of a ``solution`` against it; of a long record the
    first part.

    None where too little of the record is away from rest for that chain.
    """
    problem, fit = solution.problem, solution.fit
    part = first_part(problem.record)
    if part is not problem.record:
        fit = problem.alike(part).solved()
    try:
        judge = Regression.of(part, problem.axis, problem.model, cutoff=cutoff)
        better = assemble(Solution.of(judge), "least_squares")
    except (RecordError, RankError):
        return None, None
    return better, fit.value - better.solution()


def _held_out(solution: Solution, request: IdentificationRequest) -> dict[str, Any] | None:
    """Force error on held-out data: another record, or the last third; None where the rest alone has no solution."""
    problem, fit = solution.problem, solution.fit
    if request.holdout is not None:
        other = problem.alike(force_free(request.holdout, problem.axis, request.external_force))
        return _force_error(request.holdout.name, other.Y - other.W @ fit.value, other.Y, other.used)
    cut = 2 * len(problem.W) // 3
    W, Y, used = problem.W, problem.Y, problem.used
    try:
        first = least_squares(W[:cut], Y[:cut], fit.names, used[:cut])
    except (InputError, RankError):
        return None
    return _force_error("last third", Y[cut:] - W[cut:] @ first.value, Y[cut:], used[cut:])


def held_out_on(identification: Identification, holdout: Record, external_force: str = REFUSE) -> dict[str, Any]:
    """Force error of ``identification`` on ``holdout``, by its inverse model and filter."""
    record = force_free(holdout, identification.axis, external_force)
    other = Regression.of(
        record, identification.axis, identification.fitted, identification.chain, identification.cutoff_hz
    )
    return _force_error(holdout.name, other.Y - other.W @ identification.solution(), other.Y, other.used)


def _force_error(on: str, error: np.ndarray, force: np.ndarray, used: np.ndarray) -> dict[str, Any]:
    return {
        "on": on,
        "rms_error": float(np.sqrt(error @ error / max(int(used.sum()), 1))),
        "relative_error_percent": relative_error(error, force),
    }


@takes(IdentificationRequest)
def identify(record: Record, axis: Axis | None = None, request: IdentificationRequest = DEFAULTS) -> Identification:
    """Identify ``axis`` from ``record``: the same as the command ``identify``, with its options and defaults.

    ``axis`` (default: the embedded emps2019) gives G_tau, the voltage limit, the controller, and what is known: delays
    and lags of the drive, and effects, whose force is subtracted and which stay in the identified axis. A missing
    controller is identified from the record. The estimator ``auto`` is ``ls``; ``iv`` where the Durbin-Wu-Hausman test
    finds ``ls`` biased, at 1 % and by at least half a standard deviation, or where it determines a parameter that noise
    hides from ``ls``; ``oe`` where only it determines such a parameter and all agree on the others.

    The intervals include the errors by the cut-off (at half and twice), by the encoder's steps and by structure in the
    residual. Parameters that are impossible or far from ``axis``, and an unexplained force, are warnings. Raises
    :class:`InputError` for options that do not go together, :class:`RecordError` for a record that cannot identify,
    :class:`RankError` for columns it cannot tell apart, :class:`AxisError` for ``iv`` and ``oe`` without a controller.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> identification = identify(synthetic_record(machine("emps2019"), laps=1))
    >>> mass = identification.parameters["mass"]
    >>> round(mass.value, 0), mass.quantity.unit, identification.estimator
    (95.0, 'kg', 'least_squares')
    """
    if axis is None:
        from emps_design.machines import machine

        axis = machine("emps2019")
    if axis.units.rotary or GRAVITY not in (request.terms or ()):
        return _identified(record, axis, request)
    request = replace(request, with_=[term for term in request.terms or () if term != GRAVITY])
    identification = _identified(record, axis, request)
    text = f"{GRAVITY}: on a linear axis a weight is the constant_force, which is always identified"
    return replace(identification, warnings=(*identification.warnings, warning("weight-is-constant", text)))


def _identified(record: Record, axis: Axis, request: IdentificationRequest) -> Identification:
    """By the requested estimator; where the axis has no controller, with the one identified from the record."""
    estimate = BY[request.estimator]
    if not request.simulates or axis.controller.kind != NONE or not record.has_reference or len(record) > LONG:
        return estimate(record, axis, request)
    request.progress(LOOKING, 0.0)
    with_law, remark = with_own_law(record, axis)
    identification = estimate(record, with_law or axis, request)
    # The axis keeps its own controller table: the command `law` writes the identified one.
    return replace(
        identification,
        axis=identification.axis.replace(controller=axis.controller),
        warnings=(*identification.warnings, remark),
    )


def with_own_law(record: Record, axis: Axis) -> tuple[Axis | None, Message]:
    """The ``axis`` with the controller identified from ``record``, None where there is none, and a message on it.

    >>> import numpy as np
    >>> from emps_design.machines import machine
    >>> ramp, n = np.linspace(0.0, 0.1, 500), np.arange(500.0)
    >>> driven_by_something_else = Record.from_arrays(1e-3, ramp, ramp, np.sin(n**2))
    >>> with_own_law(driven_by_something_else, machine("emps2019"))[0] is None
    True
    """
    from emps_design.identification.controller import identify_law

    law = identify_law(record, axis.units)
    if law.controller is None:
        text = f"{axis.name} has no controller, and none was identified from the record: {law.reason}"
        return None, warning("no-law", text)
    with_law = Axis.from_dict({**axis.to_dict(), "controller": law.controller}, axis.name)
    text = (
        f"{axis.name} has no controller; the controller identified from the record was used ({law.in_words}); the "
        "command law writes it"
    )
    return with_law, note("law-of-the-record", text)


def _auto(record: Record, axis: Axis, request: IdentificationRequest) -> Identification:
    """Least squares, or instruments where it is biased, or output error; with other chains always least squares."""
    plain = identify_by_least_squares(record, axis, request)
    if request.filter != DEFAULT_CHAIN or axis.controller.kind == NONE or not record.has_reference:
        return plain
    if request.bootstrap:
        return _untested(plain, "a bootstrap requires least squares")
    if len(record) > LONG:
        return _untested(plain, f"the test takes at most {LONG} samples; test a part of the record")
    if goes_one_way(record):
        return _untested(plain, "the motion has only one direction")
    from emps_design.identification.closed_loop import WEAK_INSTRUMENT, solve_with_instruments

    parameters = plain.parameters
    try:
        fit = solve_with_instruments(record, axis, plain.fitted, request.cutoff, request.external_force)
        undetermined = [name for name in parameters if _hidden_by_noise(parameters[name], WEAK_RELIABILITY)]
        instrumental = fit.identification() if undetermined or fit.test.matters else None
    except (EmpsError, np.linalg.LinAlgError) as error:  # the simulation with this controller does not follow
        return _untested(plain, str(error))
    hidden = [name for name in undetermined if _hidden_by_noise(parameters[name], WEAK_INSTRUMENT)]
    tried = None if instrumental is None else _output_error_for_hidden(record, axis, request, hidden, instrumental)
    if tried is not None:
        return replace(_with_held_out_error(tried, request), proposed=plain.proposed)
    instrumented = {} if instrumental is None else instrumental.parameters
    determined = {name: estimate.determined for name, estimate in instrumented.items()}
    if (
        instrumental is None
        or not (fit.test.matters or any(determined[name] for name in undetermined))
        or any(estimate.determined and not determined[name] for name, estimate in parameters.items())
    ):
        return replace(plain, extra=plain.extra | {"hausman_test": fit.test.to_dict()})
    instrumental = replace(
        instrumental, warnings=(*instrumental.warnings, *_weak_column_warnings(instrumental)), proposed=plain.proposed
    )
    return _with_held_out_error(instrumental, request)


def _untested(plain: Identification, why: str) -> Identification:
    """The ``plain`` least squares with the message that its bias was not tested, and ``why``."""
    message = warning("bias-not-tested", f"the bias of least squares was not tested: {why}")
    return replace(plain, warnings=(*plain.warnings, message))


# Imported in the functions: the simulation's modules would add a tenth to the memory of a long record's regression.
def _by_instruments(record: Record, axis: Axis, request: IdentificationRequest) -> Identification:
    from emps_design.identification.closed_loop import identify_with_instruments

    return _simulated(identify_with_instruments, record, axis, request)


def _by_output_error(record: Record, axis: Axis, request: IdentificationRequest) -> Identification:
    from emps_design.identification.closed_loop import identify_by_output_error

    return _simulated(identify_by_output_error, record, axis, request)


def _simulated(
    estimate: Callable[..., Identification], record: Record, axis: Axis, request: IdentificationRequest
) -> Identification:
    """By an estimator that simulates the record, with the requested terms or those that the record calls for."""
    if request.terms is not None:
        model = Model(request.model, request.terms)
        return estimate(record, axis, model, request.cutoff, request.external_force)
    proposed = proposed_for(record, axis, request)
    identification = estimate(record, axis, Model(request.model, proposed), request.cutoff, request.external_force)
    return replace(identification, proposed=proposed)


BY: dict[str, Callable[[Record, Axis, IdentificationRequest], Identification]] = {
    AUTO: _auto,
    BY_LEAST_SQUARES: identify_by_least_squares,
    BY_INSTRUMENTS: _by_instruments,
    BY_OUTPUT_ERROR: _by_output_error,
}


def _with_held_out_error(identification: Identification, request: IdentificationRequest) -> Identification:
    """``identification`` with its force error on the held-out record."""
    if request.holdout is None:
        return identification
    judged = held_out_on(identification, request.holdout, request.external_force)
    return replace(identification, extra=identification.extra | {"held_out": judged})


def _output_error_for_hidden(
    record: Record, axis: Axis, request: IdentificationRequest, hidden: list[str], instrumental: Identification
) -> Identification | None:
    """Output error where it determines the ``hidden`` parameters and agrees with instruments on the rest; else None."""
    if not hidden:
        return None
    try:
        by_output_error = _by_output_error(record, axis, replace(request, with_=instrumental.fitted.terms))
    except EmpsError:
        return None
    ends, others = (
        {name: estimate.interval_95 for name, estimate in fit.parameters.items() if estimate.interval_95 is not None}
        for fit in (by_output_error, instrumental)
    )
    sure = all(name in ends and ends[name][0] * ends[name][1] > 0.0 for name in hidden)
    if not sure or any(ends[name][0] > high or ends[name][1] < low for name, (low, high) in others.items()):
        return None
    remark = note(
        "by-output-error",
        f"{', '.join(map(axis.units.word, hidden))}: by output error: its column of the measured motion is mostly "
        "noise, so least squares and instruments do not determine it",
        parameters=hidden,
    )
    extra = by_output_error.extra | {"hausman_test": instrumental.extra["hausman_test"]}
    return replace(by_output_error, extra=extra, warnings=(*by_output_error.warnings, remark))


def _hidden_by_noise(estimate: Estimate, weakest: float) -> bool:
    """Whether noise in its column hides the parameter from an estimator that needs a reliability of ``weakest``."""
    return not estimate.determined and estimate.reliability is not None and estimate.reliability < weakest


def _weak_column_warnings(instrumental: Identification) -> list[Message]:
    """Messages on parameters that only instruments determine: their error may exceed their interval."""
    shares = {name: estimate.reliability for name, estimate in instrumental.parameters.items() if estimate.determined}
    word = instrumental.axis.units.word
    return [
        warning(
            "weak-column",
            f"{word(name)}: the reference explains {100.0 * share:.2g} % of its column, so least squares would not "
            "determine it; compare with output error (oe), or record more acceleration",
            parameter=name,
            share=share,
        )
        for name, share in shares.items()
        if share is not None and share < WEAK_RELIABILITY
    ]
