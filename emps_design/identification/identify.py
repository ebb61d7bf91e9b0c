"""Identify the parameters of an axis from one record by the inverse dynamic model, (12)-(17)."""

from __future__ import annotations

from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError, RankError, RecordError
from emps_design.identification.assemble import assemble
from emps_design.identification.chains import DEFAULT_CHAIN, LONG
from emps_design.identification.cutoff import chosen_cutoff, explained_by_frequency, first_part
from emps_design.identification.excitation import (
    check_record,
    force_free,
)
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import (
    LeastSquares,
    least_squares,
    parameters_of,
    regression,
    relative_error,
)
from emps_design.identification.known import acting, filter_record, known_part
from emps_design.identification.known import notes as notes_on
from emps_design.identification.result import Identification
from emps_design.records import Record


def identify(
    record: Record,
    axis: Axis | None = None,
    model: str = "symmetric",
    chain: str = DEFAULT_CHAIN,
    cutoff_hz: float | None = None,
    external_force_known: bool = False,
    bootstrap: int = 0,
    seed: int = 0,
    holdout: Record | None = None,
) -> Identification:
    """Identify ``axis`` from ``record`` by least squares on the inverse dynamic model.

    ``axis`` (default: the embedded emps2019) gives G_tau, the voltage limit and what is known already: delays and lags
    of its drive, and its effects, whose force is taken out and which stay in the identified axis; ``model`` is
    ``symmetric`` or ``asymmetric``; ``chain`` the filters: ``hold`` (the hold modelled, rests left out, cut-off chosen
    from the data), ``report`` (2019 report) or ``paper`` (2018 paper); ``cutoff_hz`` [Hz] overrides the chain's.
    ``external_force_known`` lets a measured external force take part as in (21); ``bootstrap`` redraws the noise that
    often. The fit is judged on ``holdout``, or, without one, on the last third of the record with parameters from the
    rest. What cannot be, or is far from ``axis``, is a warning. Raises :class:`RecordError` for a record that cannot
    identify, :class:`RankError` for columns it cannot tell apart.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> found = identify(synthetic_record(machine("emps2019"), laps=1))
    >>> round(found.parameters["mass"].value, 0), found.parameters["mass"].quantity.unit
    (95.0, 'kg')
    """
    if axis is None:
        from emps_design.machines import machine

        axis = machine("emps2019")
    axis = axis.supplied_by(record)
    record = check_record(record, axis, external_force_known)
    axis, notes = known_part(axis, model), notes_on(known_part(axis, model))
    chosen = chosen_cutoff(acting(record, axis))
    if chain == "hold" and cutoff_hz is None:
        cutoff_hz = chosen
    filtered = filter_record(record, axis, chain, cutoff_hz)
    W, Y = regression(filtered, model)
    filtered = filtered.without_motion()
    names = tuple(p.name for p in parameters_of(model))
    fit = least_squares(W, Y, names, filtered.used)
    extra: dict[str, Any] = {
        "held_out": _held_out(filtered, W, Y, fit, axis, model, holdout, external_force_known),
        "cutoff_from_data": explained_by_frequency(acting(record, axis), chosen),
    }
    del Y  # as long as the record; the rest is in the residual
    systematic = None
    if chain != "hold":
        better, systematic = _against_hold(record, axis, model, filtered, fit, chosen)
        if better is None:
            notes.append("no interval away from rest: the intervals leave out what friction at rest does to them")
        else:
            extra["hold_modelled"] = {name: one.to_dict() for name, one in better.parameters.items()}
    return assemble(
        record,
        axis,
        model,
        "least_squares",
        filtered,
        W,
        fit,
        bootstrap=bootstrap,
        seed=seed,
        extra=extra,
        systematic=systematic,
        encoder=_encoder(record, axis, model, filtered, fit) if chain == "hold" and len(record) <= LONG else None,
        notes=notes,
    )


def _encoder(record: Record, axis: Axis, model: str, filtered: Filtered, fit: LeastSquares) -> np.ndarray | None:
    """What the steps of the encoder alone do to least squares (p,)."""
    # Imported here: beside a long record's regression the modules of a simulation are a tenth of its memory.
    from emps_design.identification.encoder import error_of_steps

    def estimate(seen: Record, exact: Record) -> np.ndarray:
        again = filter_record(seen, axis, "hold", filtered.cutoff_hz)
        return least_squares(*regression(again, model), fit.names, again.used).value

    return error_of_steps(first_part(record), axis, model, fit.value, estimate)


def _against_hold(
    record: Record, axis: Axis, model: str, filtered: Filtered, fit: LeastSquares, cutoff_hz: float
) -> tuple[Identification | None, np.ndarray | None]:
    """The same by the chain that models hold and rest, and what ``fit`` is off by; long records in part.

    None where too little of the record is away from rest for that chain.
    """
    part = first_part(record)
    if part is not record:
        W, Y = regression(filter_record(part, axis, filtered.chain, filtered.cutoff_hz), model)
        fit = least_squares(W, Y, fit.names)
    try:
        judge = filter_record(part, axis, "hold", cutoff_hz)
        W, Y = regression(judge, model)
        better = assemble(part, axis, model, "least_squares", judge, W, least_squares(W, Y, fit.names, judge.used))
    except (RecordError, RankError):
        return None, None
    return better, fit.value - better.values()


def _held_out(
    filtered: Filtered,
    W: np.ndarray,
    Y: np.ndarray,
    fit: LeastSquares,
    axis: Axis,
    model: str,
    holdout: Record | None,
    external_force_known: bool,
) -> dict[str, Any] | None:
    """Force error on data that took no part: another record, or the last third; None where the rest cannot do alone."""
    if holdout is not None:
        return held_out_on(holdout, axis, model, fit.value, filtered, external_force_known)
    cut = 2 * len(W) // 3
    try:
        first = least_squares(W[:cut], Y[:cut], fit.names, filtered.used[:cut])
    except (InputError, RankError):
        return None
    return _judged("last third", Y[cut:] - W[cut:] @ first.value, Y[cut:], filtered.used[cut:])


def held_out_on(
    holdout: Record,
    axis: Axis,
    model: str,
    value: np.ndarray,
    by: Filtered | Identification,
    external_force_known: bool = False,
) -> dict[str, Any]:
    """Force error of the parameters ``value`` (p,) on ``holdout``, filtered as what they were found ``by``."""
    other = filter_record(force_free(holdout, axis, external_force_known), axis, by.chain, by.cutoff_hz)
    W, Y = regression(other, model)
    return _judged(holdout.name, Y - W @ value, Y, other.used)


def _judged(on: str, error: np.ndarray, force: np.ndarray, used: np.ndarray) -> dict[str, Any]:
    return {
        "on": on,
        "rms_error": float(np.sqrt(error @ error / max(int(used.sum()), 1))),
        "relative_error_percent": relative_error(error, force),
    }
