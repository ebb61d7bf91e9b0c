"""Turn a fit into an identification: statistics, intervals, undetermined parameters, plausibility.

Sensitivity to the cut-off: the same estimate at half and at twice the cut-off. Encoder noise, a delay that the model
lacks and rests that the filter smears all move the estimate with the cut-off, which residual statistics at a single
cut-off cannot show. The estimates share most of their noise, so the variance of their difference is the difference of
their variances (J. A. Hausman, 1978); any change beyond that is added to the interval.

Plausibility: whether the parameters are physically possible and close to the axis file, and if not, the likely cause.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.terms import ANGLE, POWER
from emps_design.errors import InputError, RankError, RecordError
from emps_design.identification.chains import LONGEST, first_part
from emps_design.identification.excitation import WEAK_RELIABILITY, follows, reliability, share_near_gaps
from emps_design.identification.inverse_model import LeastSquares, Regression
from emps_design.identification.model import FRICTION
from emps_design.identification.proposals import unexplained
from emps_design.identification.result import Estimate, Identification
from emps_design.identification.statistics import LongRun, hac_covariance, long_run, residual_bootstrap
from emps_design.messages import Message, grave, warning, wrong
from emps_design.units import Units

FACTORS = (0.5, 2.0)
HIGHEST = 0.4  # of the sampling frequency, for a cut-off that is tried
CHANCE = 2.0  # deviations by which two estimates of the same parameter may differ
NEGLIGIBLE = 1e-3  # of the value
ALIKE = 0.5  # of the deviation: least deviation of the difference between two estimates

FAR = {"mass": 3.0, "viscous": 10.0, "coulomb": 10.0}  # times the axis's value, or a part of it
DECADES = 0.15  # decades by which a power of ten may be missed
# Effect of a wrong unit of a column on mass, viscous and Coulomb friction: exponents of its factor.
UNITS = {
    "u (or the {force} gain)": (1, 1, 1),
    "q (and q_ref)": (-1, -1, 0),
    "t": (2, 1, 0),
}
SOUGHT = tuple(FAR)

LAGS = (0.0, 0.005, 0.01, 0.02, 0.04)  # s by which a loop may lag its reference
MAY_BE_ZERO = ("constant_force", ANGLE.name, "viscous_difference")  # on a machine without fault
OPEN = 0.5  # of the force: a parameter whose interval spans zero and this much is not determined
LARGEST_NEAR_GAPS = 0.5  # share of a friction parameter's information that may lie beside a rest


@dataclass(frozen=True)
class Solution:
    """The ``fit`` of a ``problem``, by instruments ``Z`` (n, p) where given, with the statistics of its residual."""

    problem: Regression
    fit: LeastSquares
    Z: np.ndarray | None = None

    @classmethod
    def of(cls, problem: Regression) -> Solution:
        """Least squares; raises :class:`RankError` for columns that the record cannot tell apart."""
        return cls(problem, problem.solved())

    @cached_property
    def parameters(self) -> np.ndarray:
        """The parameters (p,), in the order of the model."""
        return np.array(list(self.problem.model.natural(self.fit.value).values()))

    @property
    def instruments(self) -> np.ndarray:
        """The instruments (n, p); of least squares they are the columns of W."""
        return self.problem.W if self.Z is None else self.Z

    @cached_property
    def spread(self) -> LongRun:
        """Long-run statistics of the residual.

        The autoregressive model is made of rows away from rest, as far apart as the band resolves (half a period).
        """
        filtered = self.problem.filtered
        steps, away = filtered.independent_rows
        return long_run(
            self.problem.W[::steps],
            self.fit.residual[::steps] * away[::steps],
            away[::steps],
            filtered.period * steps,
            self.instruments[::steps],
        )

    @property
    def hac_lag(self) -> int:
        """Lag [rows] of the HAC covariance: four correlation times, at least 0.1 s."""
        lag = int(max(0.1, 4.0 * self.spread.correlation_time) / self.problem.filtered.period)
        return min(lag, len(self.problem.W) // 10)


@dataclass(frozen=True)
class CutoffSensitivity:
    """The parameters ``value`` (p,), and ``tried`` (tried, p) at other ``cutoffs`` (tried,) [Hz].

    ``beyond_chance`` (p,) is the change less what chance and known encoder noise explain.
    """

    names: tuple[str, ...]
    value: np.ndarray
    cutoffs: tuple[float, ...]
    tried: np.ndarray
    beyond_chance: np.ndarray

    @property
    def relative(self) -> dict[str, float | None]:
        """The contract's ``cutoff_sensitivity``: the largest change over the value; None where the value is 0."""
        largest = np.max(np.abs(self.tried - self.value), axis=0, initial=0.0)
        pairs = zip(self.names, largest.tolist(), np.abs(self.value).tolist(), strict=True)
        return {name: change / value if value > 0.0 else None for name, change, value in pairs}

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the estimates at the other cut-offs."""
        return {"cutoff_hz": list(self.cutoffs), **dict(zip(self.names, self.tried.T.tolist(), strict=True))}


def cutoff_sensitivity(
    own: Solution,
    at: Callable[[float], Solution],
    bias: Callable[[Solution], np.ndarray | float] = lambda solution: 0.0,
) -> CutoffSensitivity:
    """Solve again ``at`` half and twice the cut-off [Hz] of ``own``, where the record allows it.

    At twice the cut-off encoder noise is much larger, so the change by the known ``bias`` (p,) of a solution does not
    count. At half the cut-off there is hardly any noise: the bias of ``own`` counts only as far as that estimate
    confirms it.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> def at(cutoff):
    ...     return Solution.of(Regression.of(record, axis, "symmetric", cutoff=cutoff))
    >>> sensitivity = cutoff_sensitivity(at(40.0), at)
    >>> sensitivity.cutoffs, 0.0 < sensitivity.relative["mass"] < 0.01
    ((20.0, 80.0), True)
    """
    names, cutoff, value = own.problem.names, own.problem.filtered.band_hz, own.parameters
    std, cutoffs, tried = own.spread.std, [], []
    known = bias(own)
    most_known = np.abs(known) + np.zeros(len(names))
    moved = np.zeros(len(names))
    for factor in FACTORS:
        frequency = min(factor * cutoff, HIGHEST / own.problem.record.period)
        if factor > 1.0 and frequency < 1.2 * cutoff:
            continue
        try:
            other = at(frequency)
            other_std, other_known = other.spread.std, bias(other)
        except (RecordError, RankError, InputError, np.linalg.LinAlgError):
            continue  # too little of the record is away from rest at that cut-off
        cutoffs.append(frequency)
        tried.append(other.parameters)
        shift = other.parameters - value
        chance = CHANCE * np.maximum(np.sqrt(np.abs(other_std**2 - std**2)), ALIKE * std)
        if factor < 1.0:
            most_known = np.minimum(most_known, np.abs(shift) + chance)
        else:
            expected = known - other_known
            shift = shift - np.clip(shift, np.minimum(expected, 0.0), np.maximum(expected, 0.0))
        moved = np.maximum(moved, np.sqrt(np.maximum(shift**2 - chance**2, 0.0)))
    moved = np.maximum(moved, most_known)
    moved = np.where(moved > NEGLIGIBLE * np.abs(value), moved, 0.0)
    return CutoffSensitivity(names, value, tuple(cutoffs), np.reshape(tried, (len(tried), len(names))), moved)


def implausible(values: Mapping[str, float], axis: Axis) -> list[Message]:
    """A message where parameters are impossible or far from ``axis``, with the likely cause; [] for plausible ones.

    ``values`` are identified parameters by name, SI; of two directions the mean counts.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019")
    >>> implausible({"mass": 95.0, "viscous": 200.0, "coulomb": 20.0}, axis)
    []
    >>> implausible({"mass": -95.0, "viscous": -200.0, "coulomb": -20.0}, axis)[0].split(": ")[0]
    'no axis has mass -95 kg, viscous friction -200 N/(m/s), Coulomb friction -20 N'
    >>> implausible({"mass": 0.095, "viscous": 0.2, "coulomb": 20.0}, axis)[0].split("; ")[1]
    'this would follow from q (and q_ref) in another unit, 1000 times too large: check the unit of that column'
    """
    identified = {name: value for name in SOUGHT if (value := _mean(values, name)) is not None}
    negative = [name for name, value in identified.items() if value < 0]
    if negative:
        listed = ", ".join(_with_unit(name, identified[name], axis.units) for name in negative)
        text = f"no axis has {listed}: {_why_negative(identified, negative)}"
        return [wrong("impossible-parameters", text, **{name: identified[name] for name in negative})]
    own = axis.mechanics.parameters
    shares = {name: value / own[name] for name, value in identified.items() if own[name] > 0 and value > 0}
    far = [name for name, share in shares.items() if not 1.0 / FAR[name] < share < FAR[name]]
    if not far:
        return []
    beside = ", ".join(
        f"{_with_unit(name, identified[name], axis.units)} where {axis.name} says {own[name]:.4g}" for name in far
    )
    unit, force = _unit(shares), axis.units.word("force")
    if unit is None:
        why = f"another machine or payload, a wrong {force} gain, or a wrong unit: check force_gain and the columns"
    else:
        column, factor = unit
        size = f"{factor:g} times too large" if factor > 1 else f"{1 / factor:g} times too small"
        why = (
            f"this would follow from {column.format(force=force)} in another unit, {size}: check the unit of that "
            "column"
        )
    text = f"far from the axis: {beside}; {why}"
    return [wrong("far-from-axis", text, **{name: identified[name] for name in far})]


def _mean(values: Mapping[str, float], name: str) -> float | None:
    own = [values[key] for key in (name, f"{name}_positive", f"{name}_negative") if key in values]
    own = [value for value in own if math.isfinite(value)]
    return sum(own) / len(own) if own else None


def _why_negative(identified: Mapping[str, float], negative: list[str]) -> str:
    if "mass" in negative and all(identified[name] < 0 for name in identified):
        return "the sign of u is probably opposite to that of q; invert one of the two columns"
    if "mass" in negative:
        return "u and q probably do not belong together: check the sign of u, the columns and their time bases"
    return "the record hardly determines it, or friction decreases with speed; next: diagnose"


def _unit(shares: Mapping[str, float]) -> tuple[str, float] | None:
    """The column with a wrong unit, and its factor, that explain ``shares`` of the axis's values; None: no such."""
    if len(shares) < len(SOUGHT):
        return None
    decades = [math.log10(shares[name]) for name in SOUGHT]
    for column, powers in UNITS.items():
        exponent = round(sum(d * p for d, p in zip(decades, powers, strict=True)) / sum(p * p for p in powers))
        misses = [abs(d - p * exponent) for d, p in zip(decades, powers, strict=True)]
        # Friction may differ a little from the axis file; the mass may not.
        if exponent and misses[0] < DECADES and max(misses) < 2 * DECADES:
            return column, 10.0**exponent
    return None


def _with_unit(name: str, value: float, units: Units) -> str:
    word = {"mass": units.word("mass"), "viscous": "viscous friction", "coulomb": "Coulomb friction"}[name]
    unit = {"mass": "kg", "viscous": "N/(m/s)", "coulomb": "N"}[name]
    return f"{word} {units.quantity(value, unit)}"


@dataclass(frozen=True)
class Errors:
    """Errors of an estimate besides chance, (p,) each, None where not computed; they are part of the intervals.

    ``systematic``: error of a chain that models neither hold nor rest (NaN: not determined away from rest).
    ``encoder``: error by the encoder's steps. ``cutoff``: change at half and twice the cut-off. ``hold``: change with
    another command between samples (:mod:`.command_hold`).
    """

    systematic: np.ndarray | None = None
    encoder: np.ndarray | None = None
    cutoff: CutoffSensitivity | None = None
    hold: np.ndarray | None = None


def assemble(
    solution: Solution,
    estimator: str,
    errors: Errors = Errors(),
    notes: Sequence[Message] = (),
    extra: Mapping[str, Any] | None = None,
    weakest: float = WEAK_RELIABILITY,
) -> Identification:
    """The :class:`Identification` that a ``solution`` makes, with its statistics and warnings.

    ``weakest`` is the least reliability of a column that still determines its parameter; 0 where W was simulated, not
    measured.
    """
    problem, fit, spread, lag = solution.problem, solution.fit, solution.spread, solution.hac_lag
    record, axis, filtered, W = problem.record, problem.axis, problem.filtered, problem.W
    hac = np.sqrt(np.diag(hac_covariance(W, fit.residual, lag, solution.instruments)))
    structure = unexplained(problem, fit.residual, spread)
    shares = _reliability(problem) if weakest > 0 else [None] * len(problem.names)
    at_rests = known_near_rest_only(problem) if weakest > 0 else ()
    used = filtered.used
    sizes, swing = np.sqrt(np.mean(W[used] ** 2, axis=0)), float(np.std(problem.Y[used]))
    warnings: list[Message] = []
    estimates = {}
    values = solution.parameters
    std = structure.widening * spread.std
    bias, steps, moved, other = np.zeros((4, len(values)))
    if errors.systematic is not None:
        bias = errors.systematic
    if errors.encoder is not None:  # smaller than std: the residual already contains the encoder's steps
        steps = np.where(errors.encoder > std, errors.encoder, 0.0)
    if errors.cutoff is not None:
        moved = errors.cutoff.beyond_chance
    if errors.hold is not None:
        other = errors.hold
    halves = np.linalg.norm([*(spread.quantile * np.array([std, bias, steps])), moved, other], axis=0)
    pushed = _without_motor_work(problem.names, values, halves)
    for i, written in enumerate(problem.model.quantities):
        quantity = replace(written, unit=axis.units.unit(written.unit), text=axis.units.words(written.text))
        value, half = float(values[i]), float(halves[i])
        share, why = shares[i], ""
        interval = f"its interval, {value:.3g} +- {half:.2g} {quantity.unit}, includes"
        if share is not None and share < weakest:
            why = (
                f"the reference explains {100 * share:.0f} % of its column, the rest is noise; record motion that "
                "excites it more"
            )
        elif np.isnan(bias[i]) or quantity.name in at_rests:
            why = (
                "only reversals and rests determine it, and the regression excludes them; record several constant "
                "speeds in both directions, with acceleration between them"
            )
        elif half * sizes[i] > swing:
            why = (
                f"{interval} more than the whole {axis.units.words('force')}; record several speeds in both directions"
            )
        elif half > abs(value) and half * sizes[i] > OPEN * swing:
            why = (
                f"{interval} zero and half of the {axis.units.words('force')}; record several speeds in both directions"
            )
        elif quantity.name == "mass" and half >= abs(value):
            why = f"{interval} zero: the speed is constant, or encoder noise hides the acceleration; record more of it"
        elif quantity.name in pushed:
            why = (
                f"inertia and friction do not account for the {axis.units.words('force')} of the record, so something "
                "other than the motor caused the motion (a hand, another drive); record motion that the motor causes"
            )
        if why:
            text = f"{axis.units.word(quantity.name)} is not determined: {why}"
            warnings.append(grave("not-determined", text, parameter=quantity.name))
            estimates[quantity.name] = Estimate(quantity, None, None, reliability=share)
            continue
        if half > abs(value) and quantity.name not in MAY_BE_ZERO:
            text = f"{axis.units.word(quantity.name)}: its 95 % interval reaches zero; the record hardly determines it"
            warnings.append(warning("interval-reaches-zero", text, parameter=quantity.name, value=value, half=half))
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
            hold=None if errors.hold is None else float(other[i]),
            reliability=share,
        )
    determined = {name: estimate.value for name, estimate in estimates.items() if estimate.value is not None}
    if POWER.name in problem.names:
        determined.pop("viscous", None)  # of another unit than what the axis has
    warnings = [*record.warnings, *notes, *implausible(determined, axis), *warnings]
    return Identification(
        record=record.name,
        sha256=record.sha256,
        fitted=problem.model,
        estimator=estimator,
        chain=filtered.chain,
        filter_text=axis.units.words(filtered.text),
        cutoff_hz=filtered.cutoff_hz,
        parameters=estimates,
        rms_error=fit.rms_error,
        relative_error_percent=fit.relative_error_percent,
        condition_number=fit.condition_number,
        samples=int(filtered.used.sum()),
        residual=spread,
        hac_lag=lag * filtered.period,
        warnings=(*warnings, *structure.warnings(axis.units)),
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
            "unexplained": structure.to_dict(),
            "cutoff_sensitivity": None if errors.cutoff is None else errors.cutoff.relative,
            "cutoffs_tried": None if errors.cutoff is None else errors.cutoff.to_dict(),
            **(extra or {}),
        },
    )


def _without_motor_work(names: Sequence[str], values: np.ndarray, halves: np.ndarray) -> tuple[str, ...]:
    """Mass and friction parameters where no interval (``halves`` its half widths, (p,)) excludes values <= 0.

    A motor that moves an axis accelerates it or works against friction. (All below zero: a column has the wrong sign.)
    """
    own = [i for i, name in enumerate(names) if name == "mass" or name in FRICTION]
    low, high = values[own] - halves[own], values[own] + halves[own]
    return tuple(names[i] for i in own) if np.all(low <= 0.0) and np.any(high >= 0.0) else ()


def _around(value: float, half: float) -> tuple[float, float]:
    return float(value - half), float(value + half)


def with_bootstrap(identification: Identification, solution: Solution, draws: int, seed: int) -> Identification:
    """``identification`` with deviations and intervals by a bootstrap of the residual with ``draws`` draws."""
    problem = solution.problem
    steps, away = problem.filtered.independent_rows
    rows = (problem.W[::steps], solution.fit.residual[::steps] * away[::steps], away[::steps])
    std = np.sqrt(np.diag(residual_bootstrap(*rows, identification.residual, draws, seed)))
    parameters, widening = {}, identification.extra["unexplained"]["widening"]
    for (name, estimate), own in zip(identification.parameters.items(), std.tolist(), strict=True):
        parameters[name] = estimate
        if estimate.value is None:
            continue
        known = np.linalg.norm([widening * own, estimate.systematic or 0.0, estimate.encoder or 0.0])
        chance = identification.residual.quantile * float(known)
        half = math.hypot(chance, estimate.cutoff or 0.0, estimate.hold or 0.0)
        parameters[name] = replace(estimate, std_bootstrap=own, interval_95_bootstrap=_around(estimate.value, half))
    return replace(identification, parameters=parameters)


def known_near_rest_only(problem: Regression) -> tuple[str, ...]:
    """Friction parameters that only rows beside rests determine, in the ``hold`` chain.

    Within one more period of the cut-off the filter still smears friction at rest. A mass may be determined there,
    for the acceleration is where the velocity reverses.
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


def _reliability(problem: Regression) -> list[float | None]:
    """Reliability of each column by the same chain on the reference; None without one that the motion follows.

    Only for mass and friction, whose columns are derivatives and hold noise; None for terms beside them.
    """
    part, names = first_part(problem.record), problem.names
    if not (part.has_reference and follows(part)):
        return [None] * len(names)
    if problem.model.terms:
        filtered = problem.filtered
        problem = Regression.of(part, problem.axis, problem.model.friction, filtered.chain, filtered.cutoff_hz)
    elif part is not problem.record:
        problem = problem.alike(part)
    ideal = problem.alike(replace(part, q=part.q_ref))
    lags = tuple(round(delay / problem.filtered.period) for delay in LAGS)
    shares = reliability(problem.W, ideal.W * problem.used[:, None], tuple(sorted(set(lags))))
    return [*shares.tolist(), *[None] * (len(names) - len(shares))]
