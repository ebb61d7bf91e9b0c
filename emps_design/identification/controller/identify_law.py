"""Identify the controller that made a record from its reference, position and command alone.

A search over band spectra finds timing, form and filters; least squares on the samples refines them, first as if noise
were white, then behind a whitening filter. Terms that are zero are dropped; alternatives are fitted too, and reported
where they explain the record as well. See docs/theory/controller_law.md.

Steps that are added to the controller's output (pulses of an instrument, a switch) are removed first. Such a signal
has a first difference only at its steps: a law fitted to differences, without outliers, finds where they are. Between
the steps the command may carry a constant each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from emps_design.errors import RecordError
from emps_design.identification.controller.best_law import AS_GOOD, HOLDS, BestLaw, best_law, too_coarse
from emps_design.identification.controller.fit import LawFit, covariance, robust_deviation, with_deviations
from emps_design.identification.controller.regressors import (
    AHEAD,
    ESTIMATORS,
    PROPORTIONAL,
    WHOLE_LOOPS,
    ControllerSignals,
    Timing,
    joined_signals,
    regressors,
)
from emps_design.identification.controller.wording import (
    AMBIGUOUS,
    NOT_TOLD,
    TIMES,
    TOLD,
    LawEstimate,
    controller_table,
    described,
    deviations_of,
    disagreement,
    halves,
    how_far_apart,
    in_parts,
    law_kind,
    notes_of,
    numbers_of,
    short,
    times_allowed,
    too_much_left,
    unlike,
)
from emps_design.records import Record
from emps_design.threads import one_thread
from emps_design.units import LINEAR, Units

ROUNDS = 12
OUTLYING = 8.0  # deviations of the typical difference
RAREST, MOST = 2, 0.02  # steps; share of the samples: more is no matter of steps

START_UP = 0.02  # s, in which the controller's initial state still matters
FEWEST = 200  # samples
AROUND = 3  # samples on either side of one with the motor switched off that do not count
FEWEST_AT_START = 4  # samples left out, whatever the period
FEEDBACK = ("kp", "kv", "k_v1", "t_v", "position.kp", "velocity.kp", "velocity.ti")
LOOSE = 0.2  # relative deviation of a gain beyond which it is not determined
ON_THE_CLOCK = 0.01  # of a period that a sample may be off its clock
INNER = 2.0  # times the residual by the velocity reference: above it the controller follows that reference
SURELY_APART = 3.0  # deviations
ROUNDING = 1e-6  # relative, by which the numbers of one law written in two ways may differ

IRREGULAR = "irregular samples identify only a proportional law, without dynamics"


def without_steps(signals: ControllerSignals) -> tuple[ControllerSignals, np.ndarray] | None:
    """The signals without steps in the command, and the removed steps (n,); None where there are none."""
    tables = [regressors(signals, Timing(velocity_estimator=name)) for name in ESTIMATORS]
    outlying = min((_outlying(signals, table) for table in tables), key=lambda pair: pair[0])[1]
    if not RAREST <= outlying.sum() <= MOST * len(signals):
        return None
    used = signals.used & ~outlying
    levels = np.cumsum(outlying) + (0 if signals.levels is None else signals.levels)
    stretches = replace(signals, used=used, levels=levels, records=False)
    fits = [_within(stretches, table) for table in tables]
    residual = min(fits, key=lambda residual: float(np.sum(stretches.counted(residual) ** 2)))
    known = levels[used]
    means = np.bincount(known, residual[used]) / np.maximum(np.bincount(known), 1)
    # A stretch without samples that count continues the one before it.
    steps = means[np.unique(known)[np.searchsorted(np.unique(known), levels, "right") - 1]]
    return replace(stretches, command=signals.command - steps), steps


def _outlying(signals: ControllerSignals, table: np.ndarray) -> tuple[float, np.ndarray]:
    """Deviation of the difference that a law without memory leaves, and mask (n,) of the samples that are outliers."""
    columns, target = np.diff(table, axis=0), np.diff(signals.command)
    scale = np.linalg.norm(columns, axis=0)
    columns = columns[:, scale > 0.0] / scale[scale > 0.0]
    whole = signals.used[1:] & signals.used[:-1]
    kept, residual = whole, target
    for _ in range(ROUNDS):
        residual = target - columns @ np.linalg.lstsq(columns[kept], target[kept], rcond=1e-10)[0]
        kept = whole & (np.abs(residual) < OUTLYING * robust_deviation(residual[whole]))
    return robust_deviation(residual[whole]), np.concatenate([[False], whole & ~kept])


def _within(signals: ControllerSignals, table: np.ndarray) -> np.ndarray:
    """Residual (n,) of the command by a law without filters, with a constant in each stretch."""
    columns, target = signals.counted(table), signals.counted(signals.command)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale < 1e-9 * scale.max()] = np.inf
    return signals.command - table @ (np.linalg.lstsq(columns / scale, target, rcond=1e-10)[0] / scale)


def identify_law(records: Record | Sequence[Record], units: Units = LINEAR) -> LawEstimate:
    """Identify the controller that made ``records``, one or several, of an axis with ``units``.

    Several records are fitted together, with a new initial integral in each, which determines more than each alone.
    Raises :class:`RecordError` for records with other columns or another period than the first.

    >>> import numpy as np
    >>> t = np.arange(4000) * 1e-3
    >>> r = 0.1 * np.sin(3.0 * t) * np.minimum(t, 1.0)
    >>> q = np.round((r - 1e-4 * np.sin(20.0 * t)) / 1e-7) * 1e-7
    >>> u = 40.0 * (50.0 * (r - q) - np.diff(q, prepend=q[0]) / 1e-3)
    >>> u = u + np.random.default_rng(0).normal(0.0, 1e-3, u.size)
    >>> estimate = identify_law(Record.from_arrays(1e-3, r, q, u))
    >>> law = estimate.controller
    >>> estimate.verdict, law["kind"], round(law["kp"], 1), round(law["kv"], 1)
    ('told', 'position_pd', 50.0, 40.0)
    """
    with one_thread():
        return _identified([records] if isinstance(records, Record) else _checked_records(records, units), units)


def _identified(several: list[Record], units: Units) -> LawEstimate:
    """The controller that made ``several`` records with the same columns and period."""
    name = " + ".join(record.name for record in several)
    there = measured_there(several[0])
    read = [signals_of(own_samples(record) if there is None else record, there) for record in several]
    for record, reading in zip(several, read, strict=True):
        if isinstance(reading, str):
            return _not_told(name, units, reading if len(several) == 1 else f"{record.name}: {reading}")
    known = [reading for reading in read if not isinstance(reading, str)]
    signals = joined_signals(known)
    if several[0].measured is not None and there is None:
        if signals.velocity_reference:
            return _not_told(name, units, f"{IRREGULAR}, and that follows no velocity")
        polled = best_law(replace(signals, times=several[0].measured["t"]), replace(PROPORTIONAL, skew=True))
        parts = halves(polled.signals)
        return _report(several, units, polled, None, parts, f"{IRREGULAR}: that ")
    best, steps = best_law(signals), None
    if not signals.velocity_reference and all(record.velocity_reference is not None for record in several):
        inner = best_law(joined_signals([_with_velocity_reference(*pair) for pair in zip(known, several, strict=True)]))
        if best.rms > INNER * inner.rms:
            best = inner
    if best.share > HOLDS and (stepless := without_steps(signals)) is not None:
        again = best_law(stepless[0])
        if again.share <= HOLDS:
            best, steps = again, stepless[1]
    ends = np.cumsum([0, *(len(recorded) + -len(recorded) % WHOLE_LOOPS for recorded in known)])
    samples = np.arange(len(signals))
    parts = [(samples >= start) & (samples < end) for start, end in pairwise(ends)]
    estimate = _report(several, units, best, steps, parts if len(several) > 1 else halves(best.signals))
    if len(several) == 1 or estimate.controller is not None:
        return estimate
    return unlike(estimate, [_identified([record], units) for record in several])


def signals_of(record: Record, there: np.ndarray | None = None) -> ControllerSignals | str:
    """The controller's inputs and output in a record, or the reason why they cannot identify it.

    ``there`` (n,) is the mask of the recorded samples: behind a missing one the integral may have any value.
    """
    velocity = None if record.q_ref_recorded else record.velocity_reference
    if velocity is None and not record.q_ref_recorded:
        return "the record has no reference of the controller; record it too"
    used = np.ones(len(record), bool)
    if record.enable is not None:
        used &= np.convolve(record.enable <= 0.0, np.ones(2 * AROUND + 1), "same") < 0.5
    start_up = max(FEWEST_AT_START, round(START_UP / record.period))
    used[:start_up] = used[-AHEAD:] = False
    levels = None
    if there is not None:
        used &= np.convolve(~there, np.ones(start_up + AHEAD + 1))[AHEAD : used.size + AHEAD] < 0.5
        levels = np.cumsum(np.diff(there.astype(int), prepend=1) < 0)
    if used.sum() < FEWEST:
        return f"{int(used.sum())} samples with an active controller, expected at least {FEWEST}; make a longer record"
    if not np.ptp(record.q[used]) > 0.0:
        return "the axis is at rest; record a motion"
    if not np.ptp(record.u[used]) > 0.0:
        return "the command is constant; record the output of the controller while the axis moves"
    command = record.u if record.excitation is None else record.u - record.excitation
    reference = record.q_ref if velocity is None else velocity
    follows = velocity is not None
    return ControllerSignals(reference, record.q, command, record.period, used, follows, record.f_ext, levels=levels)


def _with_velocity_reference(signals: ControllerSignals, record: Record) -> ControllerSignals:
    """The signals of a controller that follows the velocity reference of ``record``, not its position reference."""
    assert record.velocity_reference is not None
    return replace(signals, reference=record.velocity_reference, velocity_reference=True)


def measured_there(record: Record) -> np.ndarray | None:
    """Mask (n,) of the recorded samples of a resampled record, where these lie on a regular clock; None otherwise."""
    if record.measured is None:
        return None
    place = (record.measured["t"] - record.measured["t"][0]) / record.period
    at = np.rint(place).astype(int)
    if np.max(np.abs(place - at)) > ON_THE_CLOCK or at[-1] >= len(record) or np.any(np.diff(at) < 1):
        return None
    return np.isin(np.arange(len(record)), at)


def own_samples(record: Record) -> Record:
    """The record with its own samples in place of resampled ones; its regular times then have no meaning."""
    if record.measured is None:
        return record
    names = ("q_ref", "q", "u", "f_ext", "velocity_reference", "enable", "excitation")
    own: dict[str, Any] = {name: record.measured[name] for name in names if name in record.measured}
    t = np.arange(own["q"].size) * record.period
    return replace(record, t=t, measured=None, **own)


def _checked_records(records: Sequence[Record], units: Units) -> list[Record]:
    """The records as a list; raises :class:`RecordError` where they cannot come from one controller."""
    first, *others = records
    for other in others:
        pair = other, first
        for what, own, expected in (
            ("period", f"{other.period:.6g} s", f"{first.period:.6g} s"),
            ("reference", *("a velocity" if r.velocity_reference is not None else "a position" for r in pair)),
            (f"external {units.word('force')}", *("none" if r.f_ext is None else "one" for r in pair)),
        ):
            if own != expected:
                raise RecordError(f"{other.name}: {what}: found {own}, expected {expected} as in {first.name}")
    for record in records:
        if others and record.measured is not None:
            raise RecordError(f"{record.name}: found irregular samples, expected regular ones beside another record")
    return list(records)


def _report(
    several: Sequence[Record],
    units: Units,
    best: BestLaw,
    steps: np.ndarray | None,
    parts: Sequence[np.ndarray],
    why: str = "",
) -> LawEstimate:
    name = " + ".join(record.name for record in several)
    velocity_reference = best.signals.velocity_reference
    compared: dict[str, dict[str, Any]] = {}  # a structure that was fitted from two beginnings is one
    for law in [best.fit, *best.rivals]:
        row = described(law, best, units)
        compared.setdefault(row["terms"], row)
    tried = tuple(compared.values())
    fields: dict[str, Any] = {"residual_rms": best.rms, "residual_share": best.share, "tried": tried}
    if best.share > HOLDS or not best.fit.stabilising:
        reason = (
            f"{why or 'the best law tried '}leaves {100 * best.share:.3g} % of the command's deviation, expected at "
            f"most {100 * HOLDS:g} %: an open loop, another structure, or columns of other signals"
        )
        return _not_told(name, units, reason, **fields)
    kind = law_kind(best.fit, velocity_reference)
    if not kind:
        reason = f"the command follows a law that no supported controller has: {tried[0]['terms']}"
        return _not_told(name, units, reason, **fields)
    if step := too_coarse(best):
        reason = f"the reference is recorded in steps of {step:.2g}, whose derivatives mask the feed-forward; "
        return _not_told(name, units, f"{reason}record it with more digits", **fields)
    spread = covariance(best.signals, best.fit, best.held)
    numbers = with_deviations(best.fit, spread, lambda law: numbers_of(law, velocity_reference))
    numbers |= _double_root_deviations(best, spread, numbers)
    loose = [name for name, (value, std) in numbers.items() if name in FEEDBACK and not std < LOOSE * abs(value)]
    if loose:
        reason = f"the record does not determine {', '.join(loose)}; record more motion"
        return _not_told(name, units, reason, **fields)
    values = {name: _rounded(value, std) for name, (value, std) in numbers.items()}
    table = controller_table(best.fit, velocity_reference, values, best.holds is not False)
    times = times_allowed(best)
    fields["allowed_rms"] = best.rms / times
    if times > TIMES:
        return _not_told(name, units, too_much_left(best, times, units.command_unit), closest=table, **fields)
    apart = disagreement(best, parts, lambda law: numbers_of(law, velocity_reference))
    if apart is not None:
        return _not_told(
            name, units, f"{in_parts(apart, several)}; one law does not explain all of it", closest=table, **fields
        )
    close = [law for law in best.rivals if law.criterion < best.fit.criterion + AS_GOOD]
    close = [law for law in close if law_kind(law, velocity_reference)]
    own, *others = (
        controller_table(law, velocity_reference, numbers_of(law, velocity_reference), best.holds is not False)
        for law in (best.fit, *close)
    )
    # Two structures may be the same law: an integral of the velocity error is a proportional position loop.
    differ = [not _same_numbers(other, own) for other in others]
    close = [rival for rival, other in zip(close, differ, strict=True) if other]
    equivalents = tuple(table for table, other in zip(others, differ, strict=True) if other)
    structure = best.fit.structure, best.fit.timing, len(best.fit.filters)
    structures = [rival for rival in close if (rival.structure, rival.timing, len(rival.filters)) != structure]
    for other in structures:  # the deviations cover the numbers of every ambiguous structure
        for place, value in numbers_of(other, velocity_reference).items():
            if place in numbers:
                own_value, std = numbers[place]
                numbers[place] = own_value, max(std, abs(value - own_value))
    reason = ""
    if close:
        what = ", ".join(map(short, equivalents)) if structures else "position.kp and 1/velocity.ti exchanged"
        reason = f"these fit the record as well: {what}"
    return LawEstimate(
        record=name,
        verdict=AMBIGUOUS if structures else TOLD,
        reason=reason,
        controller=table,
        std=deviations_of(best.fit, {name: std for name, (_, std) in numbers.items()}),
        command_unit=units.command_unit,
        delay=best.fit.timing.delay,
        limit=best.limit,
        limited_samples=0 if best.limited is None else int(best.limited.sum()),
        equivalents=equivalents,
        notes=(
            *([how_far_apart(structures, best)] if structures else []),
            *notes_of(several, units.command_unit, best, steps),
        ),
        **fields,
    )


def _double_root_deviations(
    best: BestLaw, spread: Any, numbers: dict[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """``position.kp`` and ``velocity.ti`` with enlarged deviations where their rates may be equal; {} otherwise.

    With the whole reference velocity both rates are the roots of a polynomial whose coefficients the record determines.
    The error of a double root is the square root of the error of the coefficients.
    """
    law = best.fit
    if law.structure.form != "pi" or law.structure.share != 1 or law.timing.every != 1 or not law.structure.position:
        return {}

    def discriminant(perturbed: LawFit) -> dict[str, float]:
        return {"": 0.25 * (perturbed.position_rate - perturbed.wi) ** 2}

    apart, std = with_deviations(law, spread, discriminant)[""]
    if apart > SURELY_APART * std:
        return {}
    off = 0.5 * (apart**0.5 + (apart + 2.0 * std) ** 0.5)
    (kp, _), (ti, _) = numbers["position.kp"], numbers["velocity.ti"]
    return {"position.kp": (kp, off), "velocity.ti": (ti, off * ti**2)}


def _rounded(value: float, std: float) -> float:
    """``value`` rounded to the third digit of its deviation ``std``."""
    return float(f"{value:.{max(0, min(15, 2 - int(np.floor(np.log10(std)))))}f}") if std > 0.0 else value


def _same_numbers(first: Any, other: Any) -> bool:
    """Whether two tables of a controller are equal but for rounding."""
    if isinstance(first, dict) and isinstance(other, dict):
        return first.keys() == other.keys() and all(_same_numbers(first[key], other[key]) for key in first)
    if isinstance(first, list) and isinstance(other, list):
        return len(first) == len(other) and all(map(_same_numbers, first, other))
    if isinstance(first, float) and isinstance(other, float):
        return abs(first - other) <= ROUNDING * abs(other)
    return bool(first == other)


def _not_told(name: str, units: Units, reason: str, **fields: Any) -> LawEstimate:
    fields = {"residual_rms": None, "residual_share": None} | fields
    return LawEstimate(
        record=name, verdict=NOT_TOLD, reason=reason, controller=None, std={}, command_unit=units.command_unit, **fields
    )
