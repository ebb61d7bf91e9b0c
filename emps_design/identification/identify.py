"""Identify the parameters of an axis from one record by the inverse dynamic model, (12)-(17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError, RankError, RecordError
from emps_design.identification.chains import Filtered
from emps_design.identification.cutoff import LONGEST, can_choose, chosen_cutoff
from emps_design.identification.excitation import WEAK_RELIABILITY, check_record, reliability
from emps_design.identification.inverse_model import (
    LeastSquares,
    least_squares,
    parameters_of,
    regression,
    relative_error,
)
from emps_design.identification.known import acting, filter_record, known_part
from emps_design.identification.known import notes as notes_on
from emps_design.identification.result import Estimate, Identification
from emps_design.identification.statistics import LongRun, hac_covariance, long_run
from emps_design.records import Record

LAGS = (0.0, 0.005, 0.01, 0.02, 0.04)  # s by which a loop may follow its reference late
FEWEST_STEPS = 100  # away from rest, for statistics that leave rest out


def identify(
    record: Record,
    axis: Axis | None = None,
    model: str = "symmetric",
    chain: str = "report",
    cutoff_hz: float | None = None,
    external_force_known: bool = False,
    bootstrap: int = 0,
    seed: int = 0,
    holdout: Record | None = None,
) -> Identification:
    """Identify ``axis`` from ``record`` by least squares on the inverse dynamic model.

    ``axis`` (default: the embedded emps2019) gives G_tau, the voltage limit and what is known already: delays and lags
    of its drive, and its effects, whose force is taken out and which stay in the identified axis; ``model`` is
    ``symmetric`` or ``asymmetric``; ``chain`` the filters: ``report`` (2019 report), ``paper`` (2018 paper) or ``hold``
    (the hold modelled, cut-off chosen from the data); ``cutoff_hz`` [Hz] overrides the chain's.
    ``external_force_known`` lets a measured external force take part as in (21); ``bootstrap`` draws that many samples
    of blocks. The fit is judged on ``holdout``, or, without one, on the last third of the record with parameters from
    the rest. Raises
    :class:`RecordError` for a record that cannot identify, :class:`RankError` for columns it cannot tell apart.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.practice import practice_record
    >>> found = identify(practice_record(machine("emps2019"), laps=1), chain="hold")
    >>> round(found.parameters["mass"].value, 0), found.parameters["mass"].quantity.unit
    (95.0, 'kg')
    """
    if axis is None:
        from emps_design.machines import machine

        axis = machine("emps2019")
    check_record(record, axis, external_force_known)
    axis, notes = known_part(axis, model), notes_on(known_part(axis, model))
    cutoff = chosen_cutoff(acting(record, axis)) if can_choose(record) else None
    if chain == "hold" and cutoff is not None:
        cutoff_hz = cutoff_hz or cutoff.cutoff_hz
    filtered = filter_record(record, axis, chain, cutoff_hz)
    W, Y = regression(filtered, model)
    filtered = replace(filtered, motion=None)  # three columns of the whole record, which nothing after this needs
    names = tuple(p.name for p in parameters_of(model))
    fit = least_squares(W, Y, names, filtered.used)
    extra: dict[str, Any] = {"held_out": _held_out(filtered, W, Y, fit, axis, model, holdout)}
    systematic = None
    if cutoff is not None:
        extra["cutoff_from_data"] = cutoff.to_dict()
        if chain != "hold":
            better, systematic = _against_hold(record, axis, model, filtered, fit, cutoff.cutoff_hz)
            if better is None:
                notes.append("no stretch away from rest: the intervals leave out what friction at rest does to them")
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
        notes=notes,
    )


def _against_hold(
    record: Record, axis: Axis, model: str, filtered: Filtered, fit: LeastSquares, cutoff_hz: float
) -> tuple[Identification | None, np.ndarray | None]:
    """The same by the chain that models hold and rest, and what ``fit`` is off by; long records in part.

    None where too little of the record is away from rest for that chain.
    """
    part = record.part(0, LONGEST, record.name) if len(record) > LONGEST else record
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
) -> dict[str, Any] | None:
    """Force error on data that took no part: another record, or the last third; None where the rest cannot do alone."""
    if holdout is not None:
        other = filter_record(holdout, axis, filtered.chain, filtered.cutoff_hz)
        W, Y = regression(other, model)
        error, force, rows, on = Y - W @ fit.value, Y, int(other.used.sum()), holdout.name
    else:
        cut = 2 * len(W) // 3
        try:
            first = least_squares(W[:cut], Y[:cut], fit.names, filtered.used[:cut])
        except (InputError, RankError):
            return None
        error, force = Y[cut:] - W[cut:] @ first.value, Y[cut:]
        rows, on = int(filtered.used[cut:].sum()), "last third"
    return {
        "on": on,
        "rms_error": float(np.sqrt(error @ error / max(rows, 1))),
        "relative_error_percent": relative_error(error, force),
    }


def assemble(
    record: Record,
    axis: Axis,
    model: str,
    estimator: str,
    filtered: Filtered,
    W: np.ndarray,
    fit: LeastSquares,
    Z: np.ndarray | None = None,
    bootstrap: int = 0,
    seed: int = 0,
    extra: dict[str, Any] | None = None,
    systematic: np.ndarray | None = None,
    notes: Sequence[str] = (),
    weakest: float = WEAK_RELIABILITY,
) -> Identification:
    """Put statistics beside ``fit`` and make an :class:`Identification` of it; ``Z`` are the instruments, if any.

    ``systematic`` (p,) is what the chain is off by, where that is known (NaN: another chain finds the parameter not
    determined away from rest): it widens the intervals. ``weakest`` reliability of a column that still determines
    its parameter; 0 where W was simulated, not measured.
    """
    residual, spread, lag, period = residual_statistics(filtered, W, fit, Z)
    hac = np.sqrt(np.diag(hac_covariance(W, fit.residual, lag, Z)))
    boot = np.full(len(fit.value), np.nan)
    if bootstrap:
        from emps_design.identification.statistics import block_bootstrap

        covariance = block_bootstrap(W, W @ fit.value + fit.residual, fit.value, lag, bootstrap, seed)
        boot = np.sqrt(np.diag(covariance))
    shares = _reliability(record, axis, model, filtered, W) if weakest > 0 else None
    warnings = [*record.warnings, *notes]
    estimates = {}
    for i, quantity in enumerate(parameters_of(model)):
        if shares is not None and shares[i] < weakest:
            warnings.append(
                f"{quantity.name} is not determined: the reference explains {100 * shares[i]:.0f} % of its column, the "
                "rest is noise; record motion that excites it"
            )
            estimates[quantity.name] = Estimate(quantity, None, None, reliability=float(shares[i]))
            continue
        if systematic is not None and np.isnan(systematic[i]):
            warnings.append(
                f"{quantity.name} is not determined: only reversals and rests speak of it, which this filter does not "
                "model; record several constant speeds in both directions, with acceleration between them"
            )
            estimates[quantity.name] = Estimate(
                quantity, None, None, reliability=None if shares is None else float(shares[i])
            )
            continue
        bias = 0.0 if systematic is None else float(systematic[i])
        half = spread.quantile * float(np.hypot(spread.std[i], bias))
        if half > abs(fit.value[i]) and quantity.name != "constant_force":
            warnings.append(f"{quantity.name}: its 95 % interval reaches zero; the record hardly determines it")
        estimates[quantity.name] = Estimate(
            quantity=quantity,
            value=float(fit.value[i]),
            std=float(fit.std[i]),
            std_long_run=float(spread.std[i]),
            interval_95=(float(fit.value[i] - half), float(fit.value[i] + half)),
            std_hac=float(hac[i]),
            std_bootstrap=float(boot[i]) if bootstrap else None,
            systematic=None if systematic is None else bias,
            reliability=None if shares is None else float(shares[i]),
        )
    return Identification(
        record=record.name,
        sha256=record.sha256,
        model=model,
        estimator=estimator,
        chain=filtered.chain,
        filter_text=filtered.text,
        cutoff_hz=filtered.cutoff_hz,
        parameters=estimates,
        rms_error=fit.rms_error,
        relative_error_percent=fit.relative_error_percent,
        condition_number=fit.condition_number,
        samples=int(filtered.used.sum()),
        residual=spread,
        hac_lag=lag * period,
        warnings=tuple(warnings),
        axis=axis,
        period=record.period,
        series={
            "t": filtered.t,
            "measured": W @ fit.value + fit.residual,
            "model": W @ fit.value,
            "residual": residual,
            "used": filtered.used,
        },
        extra=extra or {},
    )


def residual_statistics(
    filtered: Filtered, W: np.ndarray, fit: LeastSquares, Z: np.ndarray | None = None
) -> tuple[np.ndarray, LongRun, int, float]:
    """Residual [N], its long-run statistics, the HAC lag [rows] and the period of a row [s].

    The lag is four correlation times, at least 0.1 s. The autoregressive model is made of rows away from rest, as far
    apart as the band resolves (half a period).
    """
    steps = resolved_steps(filtered)
    away = filtered.used & filtered.away
    if int(away[::steps].sum()) < FEWEST_STEPS:
        away = filtered.used
    spread = long_run(
        W[::steps],
        (fit.residual * away)[::steps],
        away[::steps],
        filtered.period * steps,
        None if Z is None else Z[::steps],
    )
    lag = int(max(0.1, 4.0 * spread.correlation_time) / filtered.period)
    return fit.residual, spread, min(lag, len(W) // 10), filtered.period


def resolved_steps(filtered: Filtered) -> int:
    """Rows between two that the filter's band lets differ: half a period of its upper end."""
    return max(1, round(0.5 / (filtered.band_hz * filtered.period)))


def _reliability(record: Record, axis: Axis, model: str, filtered: Filtered, W: np.ndarray) -> np.ndarray | None:
    """Reliability of each column by the same chain on the reference; None where the motion does not follow it."""
    part = record.part(0, LONGEST) if len(record) > LONGEST else record
    if float(np.std(part.q - part.q_ref)) > 0.1 * float(np.std(part.q)):
        return None
    if part is not record:
        filtered = filter_record(part, axis, filtered.chain, filtered.cutoff_hz)
        W, _ = regression(filtered, model)
    led = filter_record(replace(part, q=part.q_ref), axis, filtered.chain, filtered.cutoff_hz)
    Z, _ = regression(led, model)
    lags = tuple(round(delay / filtered.period) for delay in LAGS)
    return reliability(W, Z * filtered.used[:, None], tuple(sorted(set(lags))))
