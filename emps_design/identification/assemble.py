"""Put statistics beside a fit, and say which parameters the record does not determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.effects.terms import ANGLE, POWER
from emps_design.identification.cutoff import LONGEST, first_part
from emps_design.identification.excitation import WEAK_RELIABILITY, follows, reliability, share_near_gaps
from emps_design.identification.inverse_model import LeastSquares
from emps_design.identification.model import FRICTION
from emps_design.identification.plausibility import implausible
from emps_design.identification.problem import Problem
from emps_design.identification.result import Estimate, Identification
from emps_design.identification.sensitivity import CutoffSensitivity
from emps_design.identification.statistics import LongRun, hac_covariance, long_run
from emps_design.identification.unexplained import unexplained

LAGS = (0.0, 0.005, 0.01, 0.02, 0.04)  # s by which a loop may follow its reference late
MAY_BE_ZERO = ("constant_force", ANGLE.name, "viscous_difference")  # on a machine with nothing wrong
OPEN = 0.5  # of the force: what may be nothing and may be as much is not determined
LARGEST_NEAR_GAPS = 0.5  # share of what tells a friction parameter apart that may lie beside a rest


@dataclass(frozen=True)
class Errors:
    """What an estimate is off by besides chance, (p,) each, None where it was not looked for: part of the intervals.

    ``systematic``: what a chain that models neither hold nor rest is off by (NaN: another chain finds the parameter not
    determined away from rest). ``encoder``: what the steps of the encoder do. ``cutoff``: what half and twice the
    cut-off say.
    """

    systematic: np.ndarray | None = None
    encoder: np.ndarray | None = None
    cutoff: CutoffSensitivity | None = None


def assemble(
    problem: Problem,
    fit: LeastSquares,
    estimator: str,
    Z: np.ndarray | None = None,
    errors: Errors = Errors(),
    notes: Sequence[str] = (),
    extra: Mapping[str, Any] | None = None,
    weakest: float = WEAK_RELIABILITY,
) -> Identification:
    """Put statistics beside the ``fit`` of a ``problem`` and make an :class:`Identification` of it.

    ``Z`` (n, p) are the instruments, if any. ``weakest`` reliability of a column that still determines its parameter; 0
    where W was simulated, not measured.
    """
    record, axis, filtered, W = problem.record, problem.axis, problem.filtered, problem.W
    spread, lag = residual_statistics(problem, fit, Z)
    hac = np.sqrt(np.diag(hac_covariance(W, fit.residual, lag, Z)))
    left = unexplained(problem, fit.residual, spread)
    shares = _reliability(problem) if weakest > 0 else [None] * len(problem.names)
    at_rests = told_at_rests(problem) if weakest > 0 else ()
    used = filtered.used
    sizes, swing = np.sqrt(np.mean(W[used] ** 2, axis=0)), float(np.std(problem.Y[used]))
    warnings: list[str] = []
    estimates = {}
    values = problem.told(fit.value)
    std = left.widening * spread.std
    bias, steps, moved = np.zeros((3, len(values)))
    if errors.systematic is not None:
        bias = errors.systematic
    if errors.encoder is not None:  # a residual that tells of more than the encoder's steps has told of them
        steps = np.where(errors.encoder > std, errors.encoder, 0.0)
    if errors.cutoff is not None:
        moved = errors.cutoff.beyond_chance
    halves = np.hypot(spread.quantile * np.linalg.norm([std, bias, steps], axis=0), moved)
    pushed = _moved_by_another(problem.names, values, halves)
    for i, written in enumerate(problem.model.quantities):
        quantity = replace(written, unit=axis.units.unit(written.unit), text=axis.units.words(written.text))
        value, half = float(values[i]), float(halves[i])
        told, why = shares[i], ""
        said = f"what the record says of it, {value:.3g} +- {half:.2g} {quantity.unit}, may be"
        if told is not None and told < weakest:
            why = (
                f"the reference explains {100 * told:.0f} % of its column, the rest is noise; "
                "record motion that excites it"
            )
        elif np.isnan(bias[i]) or quantity.name in at_rests:
            why = (
                "only reversals and rests speak of it, which the inverse model does not hold; record several constant "
                "speeds in both directions, with acceleration between them"
            )
        elif half * sizes[i] > swing:
            why = f"{said} more than all of the {axis.units.words('force')}; record several speeds both ways"
        elif half > abs(value) and half * sizes[i] > OPEN * swing:
            why = f"{said} nothing or half of the {axis.units.words('force')}; record several speeds both ways"
        elif quantity.name == "mass" and half >= abs(value):
            why = f"{said} nothing: speeds are constant, or the encoder hides the acceleration; record acceleration"
        elif quantity.name in pushed:
            why = (
                f"neither inertia nor friction takes a {axis.units.words('force')} that the record shows, so something "
                "else than the motor made the motion (a hand, another drive); record motion that the motor makes"
            )
        if why:
            warnings.append(f"{quantity.name} is not determined: {why}")
            estimates[quantity.name] = Estimate(quantity, None, None, reliability=told)
            continue
        if half > abs(value) and quantity.name not in MAY_BE_ZERO:
            warnings.append(f"{quantity.name}: its 95 % interval reaches zero; the record hardly determines it")
        estimates[quantity.name] = Estimate(
            quantity=quantity,
            value=value,
            std=float(fit.std[i]),
            std_long_run=float(std[i]),
            interval_95=_around(value, half),
            std_hac=float(hac[i]),
            systematic=None if errors.systematic is None else float(bias[i]),
            encoder=None if errors.encoder is None else float(steps[i]),
            cutoff=None if errors.cutoff is None else float(moved[i]),
            reliability=told,
        )
    found = {name: one.value for name, one in estimates.items() if one.value is not None}
    if POWER.name in problem.names:
        found.pop("viscous", None)  # of another unit than what the axis has
    warnings = [*record.warnings, *notes, *implausible(found, axis), *warnings]
    return Identification(
        record=record.name,
        sha256=record.sha256,
        fitted=problem.model,
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
        hac_lag=lag * filtered.period,
        warnings=(*warnings, *left.warnings()),
        axis=axis,
        period=record.period,
        series={
            "t": filtered.t,
            "columns": W,
            "measured": W @ fit.value + fit.residual,
            "model": W @ fit.value,
            "residual": fit.residual,
            "used": filtered.used,
        },
        extra={
            "unexplained": left.to_dict(),
            "cutoff_sensitivity": None if errors.cutoff is None else errors.cutoff.relative,
            "cutoffs_tried": None if errors.cutoff is None else errors.cutoff.to_dict(),
            **(extra or {}),
        },
    )


def _moved_by_another(names: Sequence[str], values: np.ndarray, halves: np.ndarray) -> tuple[str, ...]:
    """Mass and friction where none of them is shown to be more than nothing, beside halves of intervals (p,).

    A motor that moves an axis accelerates it or works against friction. All of them less than nothing are a sign.
    """
    own = [i for i, name in enumerate(names) if name == "mass" or name in FRICTION]
    low, high = values[own] - halves[own], values[own] + halves[own]
    return tuple(names[i] for i in own) if np.all(low <= 0.0) and np.any(high >= 0.0) else ()


def _around(value: float, half: float) -> tuple[float, float]:
    return float(value - half), float(value + half)


def with_bootstrap(found: Identification, problem: Problem, fit: LeastSquares, draws: int, seed: int) -> Identification:
    """``found`` with the deviations and intervals of a bootstrap that redraws the residual's noise ``draws`` times."""
    from emps_design.identification.statistics import residual_bootstrap

    steps, away = problem.filtered.independent_rows
    rows = (problem.W[::steps], fit.residual[::steps] * away[::steps], away[::steps])
    std = np.sqrt(np.diag(residual_bootstrap(*rows, found.residual, draws, seed)))
    parameters, widening = {}, found.extra["unexplained"]["widening"]
    for (name, one), own in zip(found.parameters.items(), std.tolist(), strict=True):
        parameters[name] = one
        if one.value is None:
            continue
        known = np.linalg.norm([widening * own, one.systematic or 0.0, one.encoder or 0.0])
        half = float(np.hypot(found.residual.quantile * known, one.cutoff or 0.0))
        parameters[name] = replace(one, std_bootstrap=own, interval_95_bootstrap=_around(one.value, half))
    return replace(found, parameters=parameters)


def residual_statistics(problem: Problem, fit: LeastSquares, Z: np.ndarray | None = None) -> tuple[LongRun, int]:
    """Long-run statistics of the residual of ``fit``, and the HAC lag [rows].

    The lag is four correlation times, at least 0.1 s. The autoregressive model is made of rows away from rest, as far
    apart as the band resolves (half a period).
    """
    filtered = problem.filtered
    steps, away = filtered.independent_rows
    spread = long_run(
        problem.W[::steps],
        fit.residual[::steps] * away[::steps],
        away[::steps],
        filtered.period * steps,
        None if Z is None else Z[::steps],
    )
    lag = int(max(0.1, 4.0 * spread.correlation_time) / filtered.period)
    return spread, min(lag, len(problem.W) // 10)


def told_at_rests(problem: Problem) -> tuple[str, ...]:
    """Friction parameters that mostly the rows beside what the ``hold`` chain leaves out tell apart.

    Within another period of the cut-off the filter still spreads what friction does at rest. A mass may be told there:
    acceleration is where the velocity turns.
    """
    filtered = problem.filtered
    if filtered.chain != "hold":
        return ()
    part = slice(0, LONGEST)
    reach = int(1.0 / (filtered.band_hz * filtered.period))
    shares = share_near_gaps(problem.W[part], filtered.used[part], reach)
    friction = ("viscous", "coulomb")
    pairs = zip(problem.names, shares, strict=True)
    return tuple(n for n, s in pairs if n.startswith(friction) and s > LARGEST_NEAR_GAPS)


def _reliability(problem: Problem) -> list[float | None]:
    """Reliability of each column by the same chain on the reference; None where the motion does not follow it.

    It tells of noise in derivatives: of mass and friction without the terms beside them, and of terms nothing.
    """
    part, names = first_part(problem.record), problem.names
    if not follows(part):
        return [None] * len(names)
    if problem.model.terms:
        filtered = problem.filtered
        problem = Problem.of(part, problem.axis, problem.model.friction, filtered.chain, filtered.cutoff_hz)
    elif part is not problem.record:
        problem = problem.alike(part)
    led = problem.alike(replace(part, q=part.q_ref))
    lags = tuple(round(delay / problem.filtered.period) for delay in LAGS)
    shares = reliability(problem.W, led.W * problem.used[:, None], tuple(sorted(set(lags))))
    return [*shares.tolist(), *[None] * (len(names) - len(shares))]
