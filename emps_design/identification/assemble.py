"""Put statistics beside a fit, and say which parameters the record does not determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.identification.cutoff import LONGEST, first_part
from emps_design.identification.excitation import WEAK_RELIABILITY, reliability, share_near_gaps
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import LeastSquares, parameters_of, regression
from emps_design.identification.known import filter_record
from emps_design.identification.plausibility import implausible
from emps_design.identification.result import Estimate, Identification
from emps_design.identification.statistics import LongRun, hac_covariance, long_run
from emps_design.records import Record

LAGS = (0.0, 0.005, 0.01, 0.02, 0.04)  # s by which a loop may follow its reference late
LARGEST_NEAR_GAPS = 0.5  # share of what tells a friction parameter apart that may lie beside a rest
FEWEST_STEPS = 100  # away from rest, for statistics that leave rest out


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
    encoder: np.ndarray | None = None,
    notes: Sequence[str] = (),
    weakest: float = WEAK_RELIABILITY,
) -> Identification:
    """Put statistics beside ``fit`` and make an :class:`Identification` of it; ``Z`` are the instruments, if any.

    ``systematic`` (p,) is what the chain is off by, where that is known (NaN: another chain finds the parameter not
    determined away from rest), ``encoder`` (p,) what the steps of the encoder do: both widen the intervals, the second
    where it is more than the residual tells. ``weakest`` reliability of a column that still determines its parameter;
    0 where W was simulated, not measured.
    """
    residual, spread, lag, period = residual_statistics(filtered, W, fit, Z)
    hac = np.sqrt(np.diag(hac_covariance(W, fit.residual, lag, Z)))
    boot = np.full(len(fit.value), np.nan)
    if bootstrap:
        from emps_design.identification.statistics import residual_bootstrap

        steps, away = independent_rows(filtered)
        rows = (W[::steps], fit.residual[::steps] * away[::steps], away[::steps])
        boot = np.sqrt(np.diag(residual_bootstrap(*rows, spread, bootstrap, seed)))
    shares = _reliability(record, axis, model, filtered, W) if weakest > 0 else None
    at_rests = told_at_rests(W, filtered, model) if weakest > 0 else ()
    said = dict(zip((quantity.name for quantity in parameters_of(model)), fit.value.tolist(), strict=True))
    warnings = [*record.warnings, *notes, *implausible(said, axis)]
    estimates = {}
    for i, written in enumerate(parameters_of(model)):
        quantity = replace(written, unit=axis.units.unit(written.unit), text=axis.units.words(written.text))
        told, why = None if shares is None else float(shares[i]), ""
        if told is not None and told < weakest:
            why = (
                f"the reference explains {100 * told:.0f} % of its column, the rest is noise; "
                "record motion that excites it"
            )
        elif (systematic is not None and np.isnan(systematic[i])) or quantity.name in at_rests:
            why = (
                "only reversals and rests speak of it, which the inverse model does not hold; record several constant "
                "speeds in both directions, with acceleration between them"
            )
        if why:
            warnings.append(f"{quantity.name} is not determined: {why}")
            estimates[quantity.name] = Estimate(quantity, None, None, reliability=told)
            continue
        bias = 0.0 if systematic is None else float(systematic[i])
        # Where the residual tells of more than the steps of the encoder do, it has told of them.
        stepped = 0.0 if encoder is None or encoder[i] <= spread.std[i] else float(encoder[i])
        known = float(np.hypot(bias, stepped))
        half = spread.quantile * float(np.hypot(spread.std[i], known))
        if half > abs(fit.value[i]) and quantity.name != "constant_force":
            warnings.append(f"{quantity.name}: its 95 % interval reaches zero; the record hardly determines it")
        estimates[quantity.name] = Estimate(
            quantity=quantity,
            value=float(fit.value[i]),
            std=float(fit.std[i]),
            std_long_run=float(spread.std[i]),
            interval_95=_around(fit.value[i], half),
            std_hac=float(hac[i]),
            std_bootstrap=float(boot[i]) if bootstrap else None,
            interval_95_bootstrap=_around(fit.value[i], spread.quantile * np.hypot(boot[i], known))
            if bootstrap
            else None,
            systematic=None if systematic is None else bias,
            encoder=None if encoder is None else stepped,
            reliability=told,
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
            "columns": W,
            "measured": W @ fit.value + fit.residual,
            "model": W @ fit.value,
            "residual": residual,
            "used": filtered.used,
        },
        extra=extra or {},
    )


def _around(value: float, half: float) -> tuple[float, float]:
    return float(value - half), float(value + half)


def residual_statistics(
    filtered: Filtered, W: np.ndarray, fit: LeastSquares, Z: np.ndarray | None = None
) -> tuple[np.ndarray, LongRun, int, float]:
    """Residual [N], its long-run statistics, the HAC lag [rows] and the period of a row [s].

    The lag is four correlation times, at least 0.1 s. The autoregressive model is made of rows away from rest, as far
    apart as the band resolves (half a period).
    """
    steps, away = independent_rows(filtered)
    spread = long_run(
        W[::steps],
        fit.residual[::steps] * away[::steps],
        away[::steps],
        filtered.period * steps,
        None if Z is None else Z[::steps],
    )
    lag = int(max(0.1, 4.0 * spread.correlation_time) / filtered.period)
    return fit.residual, spread, min(lag, len(W) // 10), filtered.period


def independent_rows(filtered: Filtered) -> tuple[int, np.ndarray]:
    """Rows between two that the band resolves, and which take part in the statistics: those away from rest (n,)."""
    steps = resolved_steps(filtered)
    away = filtered.used & filtered.away
    return steps, away if int(away[::steps].sum()) >= FEWEST_STEPS else filtered.used


def resolved_steps(filtered: Filtered) -> int:
    """Rows between two that the filter's band lets differ: half a period of its upper end."""
    return max(1, round(0.5 / (filtered.band_hz * filtered.period)))


def told_at_rests(W: np.ndarray, filtered: Filtered, model: str) -> tuple[str, ...]:
    """Friction parameters that mostly the rows beside what the ``hold`` chain leaves out tell apart.

    Within another period of the cut-off the filter still spreads what friction does at rest. A mass may be told there:
    acceleration is where the velocity turns.
    """
    if filtered.chain != "hold":
        return ()
    part = slice(0, LONGEST)
    shares = share_near_gaps(W[part], filtered.used[part], int(1.0 / (filtered.band_hz * filtered.period)))
    names = (quantity.name for quantity in parameters_of(model))
    friction = ("viscous", "coulomb")
    return tuple(n for n, s in zip(names, shares, strict=True) if n.startswith(friction) and s > LARGEST_NEAR_GAPS)


def _reliability(record: Record, axis: Axis, model: str, filtered: Filtered, W: np.ndarray) -> np.ndarray | None:
    """Reliability of each column by the same chain on the reference; None where the motion does not follow it."""
    part = first_part(record)
    if float(np.std(part.q - part.q_ref)) > 0.1 * float(np.std(part.q)):
        return None
    if part is not record:
        filtered = filter_record(part, axis, filtered.chain, filtered.cutoff_hz)
        W, _ = regression(filtered, model)
    led = filter_record(replace(part, q=part.q_ref), axis, filtered.chain, filtered.cutoff_hz)
    Z, _ = regression(led, model)
    lags = tuple(round(delay / filtered.period) for delay in LAGS)
    return reliability(W, Z * filtered.used[:, None], tuple(sorted(set(lags))))
