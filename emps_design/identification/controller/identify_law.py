"""Tell the controller that made a record from its reference, position and command alone.

A search over band spectra finds timing, form and filters; least squares on the samples refines them, first as if noise
were white, then behind a filter that makes the residual so; terms that are zero are left out; what could be otherwise
is fitted too, and named where it explains the record as well. See docs/theory/controller_law.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.identification.controller.choice import choose, mirrored, simplify
from emps_design.identification.controller.deviations import covariance, with_deviations
from emps_design.identification.controller.filters import filtered
from emps_design.identification.controller.fit import Fit, fit
from emps_design.identification.controller.law_estimate import AMBIGUOUS, NOT_TOLD, TOLD, LawEstimate
from emps_design.identification.controller.limit import acting, plateau
from emps_design.identification.controller.noise import robust_deviation, usable_behind, whitening_filter
from emps_design.identification.controller.regressors import Signals, regressors
from emps_design.identification.controller.search import search
from emps_design.identification.controller.steps import without_steps
from emps_design.identification.controller.tables import deviations_of, kind_of, numbers_of, table_of
from emps_design.records import Record

START_UP = 0.02  # s, before which what the controller remembers is not known
FEWEST = 200  # samples
HOLDS = 0.05  # of the command's deviation: a law that leaves more is none
AS_GOOD = 6.0  # of the information criterion, odds of 20 : 1: a rival closer than that cannot be told apart
LIMIT_ROUNDS = 4
AROUND = 3  # samples about one with the motor switched off that do not count
FEWEST_AT_START = 4  # samples left out, whatever the period
FEEDBACK = ("kp", "kv", "k_v1", "t_v", "position.kp", "velocity.kp", "velocity.ti")
LOOSE = 0.2  # relative deviation of a gain beyond which it is not determined


def identify_law(record: Record, command_unit: str = "V") -> LawEstimate:
    """Tell the controller that made ``record``, whose command is in ``command_unit``; reads no axis.

    >>> import numpy as np
    >>> t = np.arange(4000) * 1e-3
    >>> r = 0.1 * np.sin(3.0 * t) * np.minimum(t, 1.0)
    >>> q = np.round((r - 1e-4 * np.sin(20.0 * t)) / 1e-7) * 1e-7
    >>> u = 40.0 * (50.0 * (r - q) - np.diff(q, prepend=q[0]) / 1e-3)
    >>> found = identify_law(Record.from_arrays(1e-3, r, q, u))
    >>> found.verdict, found.controller["kind"], round(found.controller["kp"], 6), round(found.controller["kv"], 6)
    ('told', 'position_pd', 50.0, 40.0)
    """
    signals = signals_of(record)
    if isinstance(signals, str):
        return _not_told(record, command_unit, signals)
    stepless, steps = without_steps(signals), None
    found = None if stepless is None else tell(stepless[0])
    if stepless is not None and found is not None and found.share <= HOLDS:
        steps = stepless[1]
    else:
        found = tell(signals)
    return _report(record, command_unit, found, steps)


def signals_of(record: Record) -> Signals | str:
    """What the controller of a record saw and gave, or why it cannot be told from that."""
    velocity = record.velocity_reference
    if velocity is None and not record.q_ref_recorded:
        return "the record has no reference, which the controller followed; record it too"
    used = np.ones(len(record), bool)
    if record.enable is not None:
        used &= np.convolve(record.enable <= 0.0, np.ones(2 * AROUND + 1), "same") < 0.5
    used[: max(FEWEST_AT_START, round(START_UP / record.period))] = False
    if used.sum() < FEWEST:
        return f"{int(used.sum())} samples with the controller at work, expected at least {FEWEST}; record longer"
    if not np.ptp(record.q[used]) > 0.0:
        return "the axis stands still; record a motion"
    if not np.ptp(record.u[used]) > 0.0:
        return "the command stands still; record what the controller gives while the axis moves"
    command = record.u if record.excitation is None else record.u - record.excitation
    reference = record.q_ref if velocity is None else velocity
    return Signals(reference, record.q, command, record.period, used, velocity is not None, record.f_ext)


@dataclass(frozen=True)
class Found:
    """The law that explains a command best, and how well: ``share`` of the command's deviation is left."""

    signals: Signals  # whitened
    fit: Fit
    rivals: list[Fit]
    rms: float
    share: float
    limited: np.ndarray | None
    limit: float | None
    holds: bool

    @property
    def held(self) -> np.ndarray | None:
        """Samples (n,) in which the integral stands still."""
        return self.limited if self.holds else None


def tell(signals: Signals) -> Found:
    """The law that explains the command best, whatever that is worth."""
    flat = plateau(signals.command) & signals.used
    for stands_still in (None, flat):
        best = search(signals, stands_still)[0]
        start = Fit(replace(best.structure, offset=True), best.timing, best.filters, best.wi, np.zeros(0), 1.0, 1)
        fitted, limited, limit, holds = _up_to_the_limit(signals, start, flat)
        free = signals if limited is None else replace(signals, used=signals.used & ~limited)
        held = limited if holds else None
        left = _left(free, fitted, held)
        if not flat.any() or float(np.std(left[free.used])) < HOLDS * float(np.std(signals.command)):
            break
    fitted = simplify(free, fitted, best.filter_worth, held)
    whitening = whitening_filter(_left(free, fitted, held), free.used)
    white = replace(free, whitening=whitening, used=usable_behind(free.used, whitening))
    fitted, rivals = choose(white, fitted, best.filter_worth, held)
    if (other := mirrored(white, fitted, held)) is not None:
        # Alike, the position loop is taken to be the slower of the two, as it is where people set it.
        if other.criterion < fitted.criterion - AS_GOOD or (
            other.criterion < fitted.criterion + AS_GOOD and other.position_rate < other.wi
        ):
            fitted, other = other, fitted
        rivals = [other, *rivals]
    rms = float(np.sqrt(np.mean(_left(free, fitted, held)[free.used] ** 2)))
    share = rms / float(np.std(signals.command[free.used]))
    return Found(white, fitted, rivals, rms, share, limited, limit, holds)


def command_of(signals: Signals, found: Fit, held: np.ndarray | None) -> np.ndarray:
    """Command (n,) of a fit without its limit."""
    return filtered(found.filters, regressors(signals, found.timing, held) @ found.beta, signals.period)


def _left(signals: Signals, found: Fit, held: np.ndarray | None) -> np.ndarray:
    """What a fit leaves (n,) of the command in the samples that count, 0 in others."""
    left = np.zeros(len(signals))
    left[signals.used] = signals.counted(signals.command - command_of(signals, found, held))
    return left


def _up_to_the_limit(
    signals: Signals, start: Fit, flat: np.ndarray
) -> tuple[Fit, np.ndarray | None, float | None, bool]:
    """Fit the samples in which no limit acts; where it does, by the law that is found itself."""
    limited: np.ndarray | None = flat if flat.any() else None
    if limited is None:
        return fit(signals, start), None, None, True
    limit = None
    for _ in range(LIMIT_ROUNDS):
        free = replace(signals, used=signals.used & ~limited)
        tried = [(fit(free, start, limited), True)]
        if start.structure.form:
            tried.append((fit(free, start), False))
        fitted, holds = min(tried, key=lambda pair: pair[0].cost)
        wanted = command_of(signals, fitted, limited if holds else None)
        noise = robust_deviation((signals.command - wanted)[free.used])
        now, limit = acting(signals.command, np.where(signals.used, wanted, 0.0), noise)
        if limit is None:
            return fit(signals, start), None, None, True
        if np.array_equal(now, limited):
            break
        limited, start = now, fitted
    return fitted, limited, limit, holds


def _report(record: Record, unit: str, found: Found, steps: np.ndarray | None) -> LawEstimate:
    velocity_reference = found.signals.velocity_reference
    tried = tuple(_described(one, found) for one in [found.fit, *found.rivals])
    said: dict[str, Any] = {"residual_rms": found.rms, "residual_share": found.share, "tried": tried}
    if found.share > HOLDS or not found.fit.stabilising:
        reason = (
            f"the best law tried leaves {100 * found.share:.3g} % of the command's deviation, expected at most "
            f"{100 * HOLDS:g} %: an open loop, another structure, or columns that are not the controller's own"
        )
        return _not_told(record, unit, reason, **said)
    kind = kind_of(found.fit, velocity_reference)
    if not kind:
        reason = f"the command follows a law that no kind of controller here has: {tried[0]['terms']}"
        return _not_told(record, unit, reason, **said)
    spread = covariance(found.signals, found.fit, found.held)
    numbers = with_deviations(found.fit, spread, lambda one: numbers_of(one, velocity_reference))
    loose = [name for name, (value, std) in numbers.items() if name in FEEDBACK and not std < LOOSE * abs(value)]
    if loose:
        reason = f"the record does not determine {', '.join(loose)}; record more motion"
        return _not_told(record, unit, reason, **said)
    values = {name: value for name, (value, _) in numbers.items()}
    close = [one for one in found.rivals if one.criterion < found.fit.criterion + AS_GOOD]
    close = [one for one in close if kind_of(one, velocity_reference)]
    other_numbers = all(_same_structure(one, found.fit) for one in close)
    equivalents = tuple(
        table_of(one, velocity_reference, numbers_of(one, velocity_reference), found.holds) for one in close
    )
    reason = ""
    if close:
        what = "position.kp and 1/velocity.ti exchanged" if other_numbers else ", ".join(map(_short, equivalents))
        reason = f"the record fits as well: {what}"
    return LawEstimate(
        record=record.name,
        verdict=TOLD if other_numbers else AMBIGUOUS,
        reason=reason,
        controller=table_of(found.fit, velocity_reference, values, found.holds),
        std=deviations_of(found.fit, {name: std for name, (_, std) in numbers.items()}),
        command_unit=unit,
        delay=found.fit.timing.delay,
        limit=found.limit,
        limited_samples=0 if found.limited is None else int(found.limited.sum()),
        equivalents=equivalents,
        notes=_notes(record, unit, found, steps),
        **said,
    )


def _notes(record: Record, unit: str, found: Found, steps: np.ndarray | None) -> tuple[str, ...]:
    timing, s = found.fit.timing, found.fit.structure
    notes = []
    if timing.delay:
        notes.append(f"the command in the record is {timing.delay} samples behind the position it follows from")
    if timing.phase:
        notes.append(f"the position loop runs first at sample {timing.phase}: leave out as many at the start")
    if s.offset:
        offset = float(found.fit.linear[s.linear.index("offset")])
        what = "the integral starts at" if s.form else "the command carries a constant"
        notes.append(f"{what} {offset:.4g} {unit}, which no table holds")
    if found.limit is not None:
        notes.append(f"the limit of {found.limit:.6g} {unit} acts: command_limit of [drive]")
    if steps is not None:
        notes.append(f"steps of {np.std(steps):.3g} {unit} rms, added to the controller's output, were taken off first")
    if record.enable is not None and np.any(record.enable <= 0.0):
        notes.append("samples with the motor switched off were left out")
    if not np.ptp(found.signals.reference[found.signals.used]) > 0.0:
        notes.append("the reference stands still, so feed-forward is not told")
    return tuple(notes)


def _same_structure(one: Fit, other: Fit) -> bool:
    return one.structure == other.structure and one.timing == other.timing and len(one.filters) == len(other.filters)


def _described(one: Fit, found: Found) -> dict[str, Any]:
    """A structure that was compared, as plain data."""
    s, timing = one.structure, one.timing
    terms = [f"{s.form or 'p'} velocity loop" if s.velocity else "no velocity loop"]
    terms += [f"position loop every {timing.every}" + (f" from {timing.phase}" if timing.phase else "")] if s.position else []
    terms += ["all of the reference velocity" if s.share == 1 else "a share of it"] if s.velocity and s.share != 0 else []
    terms += [name for name in ("acceleration", "coulomb", "force", "offset") if getattr(s, name)]
    terms += [timing.velocity_estimator.replace("_", "-"), f"delay {timing.delay}"]
    terms += [f"{f.kind} {f.frequency:.4g} Hz" for f in one.filters]
    return {
        "terms": ", ".join(terms),
        "residual_rms": float(np.sqrt(one.cost / one.samples)),
        "criterion": one.criterion - found.fit.criterion,
    }


def _short(table: dict[str, Any]) -> str:
    every = table.get("position", {}).get("every")
    form = table.get("velocity", {}).get("form")
    parts = [table["kind"], f"form {form}" if form else "", f"every {every}" if every else ""]
    return " ".join(part for part in [*parts, table.get("velocity_estimator", "")] if part)


def _not_told(record: Record, unit: str, reason: str, **said: Any) -> LawEstimate:
    given = {"residual_rms": None, "residual_share": None} | said
    return LawEstimate(
        record=record.name, verdict=NOT_TOLD, reason=reason, controller=None, std={}, command_unit=unit, **given
    )
