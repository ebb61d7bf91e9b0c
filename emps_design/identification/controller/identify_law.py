"""Tell the controller that made a record from its reference, position and command alone.

A search over band spectra finds timing, form and filters; least squares on the samples refines them, first as if noise
were white, then behind a filter that makes the residual so; terms that are zero are left out; what could be otherwise
is fitted too, and named where it explains the record as well. See docs/theory/controller_law.md.

Steps that something adds to a controller's output: pulses of an instrument, a switch. They are taken off.

Whatever stands still between its steps has no first difference but there: a law that is fitted to differences, without
those that stick out, finds where it steps. Between these the command may carry a constant of its own.
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
    joined,
    regressors,
)
from emps_design.identification.controller.wording import (
    AMBIGUOUS,
    NOT_TOLD,
    TIMES,
    TOLD,
    LawEstimate,
    described,
    deviations_of,
    disagreement,
    halves,
    how_far_apart,
    in_parts,
    kind_of,
    notes_of,
    numbers_of,
    short,
    table_of,
    times_allowed,
    too_much_left,
    unlike,
)
from emps_design.records import Record

ROUNDS = 12
OUTLYING = 8.0  # deviations of the typical difference
RAREST, MOST = 2, 0.02  # steps; share of the samples: more is no matter of steps

START_UP = 0.02  # s, before which what the controller remembers is not known
FEWEST = 200  # samples
AROUND = 3  # samples about one with the motor switched off that do not count
FEWEST_AT_START = 4  # samples left out, whatever the period
FEEDBACK = ("kp", "kv", "k_v1", "t_v", "position.kp", "velocity.kp", "velocity.ti")
LOOSE = 0.2  # relative deviation of a gain beyond which it is not determined
ON_THE_CLOCK = 0.01  # of a period that a sample may be off its clock
INNER = 2.0  # times as much left by the position's law: the velocity that is recorded beside it comes from elsewhere
SURELY_APART = 3.0  # deviations
ROUNDING = 1e-6  # relative, by which the numbers of one law written in two ways may differ

IRREGULAR = "irregular samples tell no law with a memory, only a proportional one"


def without_steps(signals: ControllerSignals) -> tuple[ControllerSignals, np.ndarray] | None:
    """The signals with such steps taken off the command, and these (n,); None where there are none."""
    tables = [regressors(signals, Timing(velocity_estimator=name)) for name in ESTIMATORS]
    outlying = min((_outlying(signals, table) for table in tables), key=lambda pair: pair[0])[1]
    if not RAREST <= outlying.sum() <= MOST * len(signals):
        return None
    used = signals.used & ~outlying
    levels = np.cumsum(outlying) + (0 if signals.levels is None else signals.levels)
    stretches = replace(signals, used=used, levels=levels, records=False)
    fits = [_within(stretches, table) for table in tables]
    left = min(fits, key=lambda left: float(np.sum(stretches.counted(left) ** 2)))
    known = levels[used]
    means = np.bincount(known, left[used]) / np.maximum(np.bincount(known), 1)
    # A stretch without a sample that counts goes on as the one before it.
    steps = means[np.unique(known)[np.searchsorted(np.unique(known), levels, "right") - 1]]
    return replace(stretches, command=signals.command - steps), steps


def _outlying(signals: ControllerSignals, table: np.ndarray) -> tuple[float, np.ndarray]:
    """Typical difference that a law without memory leaves, and the samples (n,) whose difference sticks out."""
    columns, target = np.diff(table, axis=0), np.diff(signals.command)
    scale = np.linalg.norm(columns, axis=0)
    columns = columns[:, scale > 0.0] / scale[scale > 0.0]
    whole = signals.used[1:] & signals.used[:-1]
    kept, left = whole, target
    for _ in range(ROUNDS):
        left = target - columns @ np.linalg.lstsq(columns[kept], target[kept], rcond=1e-10)[0]
        kept = whole & (np.abs(left) < OUTLYING * robust_deviation(left[whole]))
    return robust_deviation(left[whole]), np.concatenate([[False], whole & ~kept])


def _within(signals: ControllerSignals, table: np.ndarray) -> np.ndarray:
    """What is left (n,) of the command by a law without filters, with a constant in each stretch."""
    columns, target = signals.counted(table), signals.counted(signals.command)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale < 1e-9 * scale.max()] = np.inf
    return signals.command - table @ (np.linalg.lstsq(columns / scale, target, rcond=1e-10)[0] / scale)


def identify_law(records: Record | Sequence[Record], command_unit: str = "V") -> LawEstimate:
    """Tell the controller that made one or several ``records``, whose command is in ``command_unit``; reads no axis.

    Several tell more than each alone: they are taken as one, in which the integral starts anew with each. Raises
    :class:`RecordError` for records of other columns or samples than the first.

    >>> import numpy as np
    >>> t = np.arange(4000) * 1e-3
    >>> r = 0.1 * np.sin(3.0 * t) * np.minimum(t, 1.0)
    >>> q = np.round((r - 1e-4 * np.sin(20.0 * t)) / 1e-7) * 1e-7
    >>> u = 40.0 * (50.0 * (r - q) - np.diff(q, prepend=q[0]) / 1e-3)
    >>> u = u + np.random.default_rng(0).normal(0.0, 1e-3, u.size)
    >>> found = identify_law(Record.from_arrays(1e-3, r, q, u))
    >>> found.verdict, found.controller["kind"], round(found.controller["kp"], 1), round(found.controller["kv"], 1)
    ('told', 'position_pd', 50.0, 40.0)
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # the matrices here are tall and thin: BLAS threads would only spin
        return _identified([records] if isinstance(records, Record) else _alike(records), command_unit)


def _identified(several: list[Record], command_unit: str) -> LawEstimate:
    """The controller that made ``several`` records of one kind."""
    name = " + ".join(one.name for one in several)
    there = measured_there(several[0])
    read = [signals_of(own_samples(one) if there is None else one, there) for one in several]
    for one, said in zip(several, read, strict=True):
        if isinstance(said, str):
            return _not_told(name, command_unit, said if len(several) == 1 else f"{one.name}: {said}")
    known = [one for one in read if not isinstance(one, str)]
    signals = joined(known)
    if several[0].measured is not None and there is None:
        if signals.velocity_reference:
            return _not_told(name, command_unit, f"{IRREGULAR}, and that follows no velocity")
        polled = best_law(replace(signals, times=several[0].measured["t"]), replace(PROPORTIONAL, skew=True))
        parts = halves(polled.signals)
        return _report(several, command_unit, polled, None, parts, f"{IRREGULAR}: that ")
    found, steps = best_law(signals), None
    if not signals.velocity_reference and all(one.velocity_reference is not None for one in several):
        inner = best_law(joined([_of_its_velocity(*pair) for pair in zip(known, several, strict=True)]))
        if found.rms > INNER * inner.rms:
            found = inner
    if found.share > HOLDS and (stepless := without_steps(signals)) is not None:
        again = best_law(stepless[0])
        if again.share <= HOLDS:
            found, steps = again, stepless[1]
    ends = np.cumsum([0, *(len(one) + -len(one) % WHOLE_LOOPS for one in known)])
    samples = np.arange(len(signals))
    parts = [(samples >= start) & (samples < end) for start, end in pairwise(ends)]
    told = _report(several, command_unit, found, steps, parts if len(several) > 1 else halves(found.signals))
    if len(several) == 1 or told.controller is not None:
        return told
    return unlike(told, [_identified([one], command_unit) for one in several])


def signals_of(record: Record, there: np.ndarray | None = None) -> ControllerSignals | str:
    """What the controller of a record saw and gave, or why it cannot be told from that.

    ``there`` (n,) says which samples were recorded: behind one that was not the integral may have any value.
    """
    velocity = None if record.q_ref_recorded else record.velocity_reference
    if velocity is None and not record.q_ref_recorded:
        return "the record has no reference, which the controller followed; record it too"
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
        return f"{int(used.sum())} samples with the controller at work, expected at least {FEWEST}; record longer"
    if not np.ptp(record.q[used]) > 0.0:
        return "the axis stands still; record a motion"
    if not np.ptp(record.u[used]) > 0.0:
        return "the command stands still; record what the controller gives while the axis moves"
    command = record.u if record.excitation is None else record.u - record.excitation
    reference = record.q_ref if velocity is None else velocity
    follows = velocity is not None
    return ControllerSignals(reference, record.q, command, record.period, used, follows, record.f_ext, levels=levels)


def _of_its_velocity(signals: ControllerSignals, record: Record) -> ControllerSignals:
    """What a controller saw that follows the velocity reference of ``record`` and not its position reference."""
    assert record.velocity_reference is not None
    return replace(signals, reference=record.velocity_reference, velocity_reference=True)


def measured_there(record: Record) -> np.ndarray | None:
    """Which samples (n,) of a resampled record were recorded, where that is a clock of which some are missing."""
    if record.measured is None:
        return None
    place = (record.measured["t"] - record.measured["t"][0]) / record.period
    at = np.rint(place).astype(int)
    if np.max(np.abs(place - at)) > ON_THE_CLOCK or at[-1] >= len(record) or np.any(np.diff(at) < 1):
        return None
    return np.isin(np.arange(len(record)), at)


def own_samples(record: Record) -> Record:
    """The record at its own times where it was resampled, on a clock that then means nothing."""
    if record.measured is None:
        return record
    names = ("q_ref", "q", "u", "f_ext", "velocity_reference", "enable", "excitation")
    own: dict[str, Any] = {name: record.measured[name] for name in names if name in record.measured}
    t = np.arange(own["q"].size) * record.period
    return replace(record, t=t, measured=None, **own)


def _alike(records: Sequence[Record]) -> list[Record]:
    """The records, where one controller can have made them all."""
    first, *others = records
    for one in others:
        for what, own, expected in (
            ("period", f"{one.period:.6g} s", f"{first.period:.6g} s"),
            ("reference", *("a velocity" if r.velocity_reference is not None else "a position" for r in (one, first))),
            ("external force", *("none" if r.f_ext is None else "one" for r in (one, first))),
        ):
            if own != expected:
                raise RecordError(f"{one.name}: {what}: found {own}, expected {expected} as in {first.name}")
    for one in records:
        if others and one.measured is not None:
            raise RecordError(f"{one.name}: found irregular samples, expected regular ones beside another record")
    return list(records)


def _report(
    several: Sequence[Record],
    unit: str,
    found: BestLaw,
    steps: np.ndarray | None,
    parts: Sequence[np.ndarray],
    why: str = "",
) -> LawEstimate:
    name = " + ".join(one.name for one in several)
    velocity_reference = found.signals.velocity_reference
    compared: dict[str, dict[str, Any]] = {}  # a structure that was fitted from two beginnings is one
    for one in [found.fit, *found.rivals]:
        row = described(one, found)
        compared.setdefault(row["terms"], row)
    tried = tuple(compared.values())
    said: dict[str, Any] = {"residual_rms": found.rms, "residual_share": found.share, "tried": tried}
    if found.share > HOLDS or not found.fit.stabilising:
        reason = (
            f"{why or 'the best law tried '}leaves {100 * found.share:.3g} % of the command's deviation, expected at "
            f"most {100 * HOLDS:g} %: an open loop, another structure, or columns that are not the controller's own"
        )
        return _not_told(name, unit, reason, **said)
    kind = kind_of(found.fit, velocity_reference)
    if not kind:
        reason = f"the command follows a law that no kind of controller here has: {tried[0]['terms']}"
        return _not_told(name, unit, reason, **said)
    if step := too_coarse(found):
        reason = f"the reference is recorded in steps of {step:.2g}, of which derivatives hide what is fed forward; "
        return _not_told(name, unit, f"{reason}record it with more digits", **said)
    spread = covariance(found.signals, found.fit, found.held)
    numbers = with_deviations(found.fit, spread, lambda one: numbers_of(one, velocity_reference))
    numbers |= _of_two_alike(found, spread, numbers)
    loose = [name for name, (value, std) in numbers.items() if name in FEEDBACK and not std < LOOSE * abs(value)]
    if loose:
        reason = f"the record does not determine {', '.join(loose)}; record more motion"
        return _not_told(name, unit, reason, **said)
    values = {name: _rounded(value, std) for name, (value, std) in numbers.items()}
    table = table_of(found.fit, velocity_reference, values, found.holds is not False)
    times = times_allowed(found)
    said["allowed_rms"] = found.rms / times
    if times > TIMES:
        return _not_told(name, unit, too_much_left(found, times, unit), closest=table, **said)
    apart = disagreement(found, parts, lambda one: numbers_of(one, velocity_reference))
    if apart is not None:
        return _not_told(name, unit, f"{in_parts(apart, several)}; no one law made all of it", closest=table, **said)
    close = [one for one in found.rivals if one.criterion < found.fit.criterion + AS_GOOD]
    close = [one for one in close if kind_of(one, velocity_reference)]
    own, *others = (
        table_of(one, velocity_reference, numbers_of(one, velocity_reference), found.holds is not False)
        for one in (found.fit, *close)
    )
    # Two sums of terms may be one law: an integral of the velocity error is a proportional position loop.
    differ = [not _same_numbers(other, own) for other in others]
    close = [one for one, other in zip(close, differ, strict=True) if other]
    equivalents = tuple(table for table, other in zip(others, differ, strict=True) if other)
    structures = [one for one in close if not _same_structure(one, found.fit)]
    for other in structures:  # whichever made the record, its numbers are within the deviations
        for place, value in numbers_of(other, velocity_reference).items():
            if place in numbers:
                own_value, std = numbers[place]
                numbers[place] = own_value, max(std, abs(value - own_value))
    reason = ""
    if close:
        what = ", ".join(map(short, equivalents)) if structures else "position.kp and 1/velocity.ti exchanged"
        reason = f"the record fits as well: {what}"
    return LawEstimate(
        record=name,
        verdict=AMBIGUOUS if structures else TOLD,
        reason=reason,
        controller=table,
        std=deviations_of(found.fit, {name: std for name, (_, std) in numbers.items()}),
        command_unit=unit,
        delay=found.fit.timing.delay,
        limit=found.limit,
        limited_samples=0 if found.limited is None else int(found.limited.sum()),
        equivalents=equivalents,
        notes=(*([how_far_apart(structures, found)] if structures else []), *notes_of(several, unit, found, steps)),
        **said,
    )


def _of_two_alike(
    found: BestLaw, spread: Any, numbers: dict[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """``position.kp`` and ``velocity.ti`` with the deviations that a double root leaves them, where they may be one.

    With all of the reference's velocity they are the roots of a polynomial whose coefficients the record tells: roots
    that may be equal are off by the square root of what those are.
    """
    law = found.fit
    if law.structure.form != "pi" or law.structure.share != 1 or law.timing.every != 1 or not law.structure.position:
        return {}
    apart, std = with_deviations(law, spread, lambda one: {"": 0.25 * (one.position_rate - one.wi) ** 2})[""]
    if apart > SURELY_APART * std:
        return {}
    off = 0.5 * (apart**0.5 + (apart + 2.0 * std) ** 0.5)
    (kp, _), (ti, _) = numbers["position.kp"], numbers["velocity.ti"]
    return {"position.kp": (kp, off), "velocity.ti": (ti, off * ti**2)}


def _rounded(value: float, std: float) -> float:
    """The value to a thousandth of its deviation."""
    return float(f"{value:.{max(0, min(15, 2 - int(np.floor(np.log10(std)))))}f}") if std > 0.0 else value


def _same_structure(one: LawFit, other: LawFit) -> bool:
    return one.structure == other.structure and one.timing == other.timing and len(one.filters) == len(other.filters)


def _same_numbers(one: Any, other: Any) -> bool:
    """Whether two tables of a controller say the same, but for rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same_numbers(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same_numbers, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= ROUNDING * abs(other)
    return bool(one == other)


def _not_told(name: str, unit: str, reason: str, **said: Any) -> LawEstimate:
    given = {"residual_rms": None, "residual_share": None} | said
    return LawEstimate(
        record=name, verdict=NOT_TOLD, reason=reason, controller=None, std={}, command_unit=unit, **given
    )
