"""What is said of a law beside its table: the structures that were compared, and what no table holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.identification.controller.best_law import AS_GOOD, Found
from emps_design.identification.controller.fit import Fit
from emps_design.identification.controller.law_estimate import LawEstimate
from emps_design.identification.controller.told import Disagreement
from emps_design.laws import leaves
from emps_design.laws.estimators import estimator_in_words
from emps_design.records import Record

DISTINCT = 3.0  # deviations, those of two laws added, beyond which their numbers are two
# Twice the logarithm of the odds of the true law against one D^0.5 deviations apart is normal about D, with variance
# 4 D: from here on it passes what counts as alike in 39 of 40 records.
SURE = 2.0 + (4.0 + AS_GOOD) ** 0.5


def described(one: Fit, found: Found) -> dict[str, Any]:
    """A structure that was compared, as plain data."""
    s, timing = one.structure, one.timing
    terms = [f"{s.form or 'p'} velocity loop" if s.velocity else "no velocity loop"]
    if s.position:
        terms.append(f"position loop every {timing.every}" + (f" from {timing.phase}" if timing.phase else ""))
    if s.velocity and s.share != 0:
        of = "profile's" if timing.profile else "reference"
        terms.append(f"all of the {of} velocity" if s.share == 1 else f"a share of the {of} velocity")
    terms += [name for name in ("acceleration", "coulomb", "force", "offset") if getattr(s, name)]
    terms += [estimator_in_words(timing.velocity_estimator), f"delay {timing.delay}"]
    terms += [f"{f.kind} {f.frequency:.4g} Hz" for f in one.filters]
    return {
        "terms": ", ".join(terms),
        "residual_rms": float(np.sqrt(one.cost / one.samples)),
        "criterion": one.criterion - found.fit.criterion,
        "apart": found.apart(one),
    }


def short(table: dict[str, Any]) -> str:
    """A table's structure in a few words."""
    every = table.get("position", {}).get("every")
    form = table.get("velocity", {}).get("form")
    source = table.get("feedforward", {}).get("source")
    parts = [table["kind"], f"form {form}" if form else "", f"every {every}" if every else "", source or ""]
    estimator = table.get("velocity_estimator", "")
    own = estimator if isinstance(estimator, str) else estimator_in_words(estimator)
    return " ".join(part for part in [*parts, own] if part)


def how_far_apart(close: Sequence[Fit], found: Found) -> str:
    """How far the nearest of the ``close`` laws is from the one given, and what would tell it."""
    apart = max(min(map(found.apart, close)), 1e-6)
    return (
        f"the nearest of them is {apart:.2g} standard deviations of the noise apart, over all samples; to tell it "
        f"takes {SURE:.2g}: about {(SURE / apart) ** 2:.2g} times as much of such motion, all given to law"
    )


def notes_of(several: Sequence[Record], unit: str, found: Found, steps: np.ndarray | None) -> tuple[str, ...]:
    """What the reader has to know and the table does not say."""
    timing, s = found.fit.timing, found.fit.structure
    notes = []
    if timing.delay:
        notes.append(f"the command in the record is {timing.delay} samples behind the position it follows from")
    if s.skew:
        part = dict(zip(s.linear, found.fit.linear, strict=True))
        ahead = -1e3 * float(part["skew"] / part["position"])
        when = "before" if ahead > 0.0 else "after"
        other = ", or the law damps velocity as much" if ahead > 0.0 else ""
        notes.append(f"the position is recorded {abs(ahead):.2g} ms {when} the one that the command follows{other}")
    if timing.phase:
        notes.append(f"the position loop runs first at sample {timing.phase}: leave out as many at the start")
    if s.offset:
        offset = float(found.fit.linear[s.linear.index("offset")])
        what = "the integral starts at" if s.form else "the command carries a constant"
        notes.append(f"{what} {f'{offset:.4g} {unit}'.rstrip()}, which no table holds")
    if found.limit is not None:
        notes.append(f"the limit of {f'{found.limit:.6g} {unit}'.rstrip()} acts: command_limit of [drive]")
        if found.holds is None and s.form:
            notes.append("what the integral does at the limit is not told: anti_windup is the default")
    if steps is not None:
        notes.append(f"steps of {np.std(steps):.3g} {unit} rms, added to the controller's output, were taken off first")
    if any(one.enable is not None and np.any(one.enable <= 0.0) for one in several):
        notes.append("samples with the motor switched off were left out")
    if not np.ptp(found.signals.reference[found.signals.used]) > 0.0:
        notes.append("the reference stands still, so feed-forward is not told")
    return tuple(notes)


def too_much_left(found: Found, times: float, unit: str) -> str:
    """Why a law is none although it leaves little: how close it came, and what is left."""
    left = f"{found.rms:.3g} {unit}".rstrip()
    return (
        f"the closest law leaves {left} rms, {100 * found.share:.3g} % of the command's deviation, {times:.3g} times "
        "what the record's own noise and resolution would: it has another structure, filter or velocity estimator"
    )


def in_parts(apart: Disagreement, several: Sequence[Record]) -> str:
    """Which number two parts of a record, or two records, tell otherwise."""
    (one, one_std), (other, other_std) = apart.one, apart.other
    said = f"{apart.name} is {one:.5g} +- {one_std:.2g}"
    if len(several) > 1:
        first, second = (several[place].name for place in apart.parts)
        return f"the records disagree: {said} in {first}, {other:.5g} +- {other_std:.2g} in {second}"
    return f"its halves disagree: {said} in the first, {other:.5g} +- {other_std:.2g} in the second"


def unlike(together: LawEstimate, alone: Sequence[LawEstimate]) -> LawEstimate:
    """What no one law made, with what the records say alone: which disagree, and on what."""
    known = [one for one in alone if one.controller is not None]
    if len(known) < 2:
        return together
    first, *rest = known
    for other in rest:
        differ = _differences(first, other)
        if differ:
            reason = f"the records disagree, {first.record} and {other.record}: {'; '.join(differ)}"
            return replace(together, reason=reason, closest=None)
    return together


def _differences(one: LawEstimate, other: LawEstimate) -> list[str]:
    """What the tables of two laws have different, numbers beyond their deviations."""
    tables = [dict(leaves(_of_unlike_estimators(own, against))) for own, against in ((one, other), (other, one))]
    stds = [dict(leaves(estimate.std)) for estimate in (one, other)]
    found = []
    for path in dict.fromkeys([*tables[0], *tables[1]]):
        a, b = (table.get(path) for table in tables)
        spread = sum(std.get(path, 0.0) for std in stds)
        alike = isinstance(a, float) and isinstance(b, float) and abs(a - b) <= DISTINCT * spread
        if a != b and not alike:
            found.append(f"{'.'.join(path)} {_shown(a)} and {_shown(b)}")
    return found


def _of_unlike_estimators(own: LawEstimate, against: LawEstimate) -> dict[str, Any]:
    """The table of ``own``, its velocity estimator in words where the other's is of another kind."""
    table = own.controller or {}
    mine, other = table.get("velocity_estimator"), (against.controller or {}).get("velocity_estimator")
    kinds = [one.get("kind") if isinstance(one, dict) else one for one in (mine, other)]
    if mine is None or other is None or kinds[0] == kinds[1]:
        return table
    return {**table, "velocity_estimator": estimator_in_words(mine)}


def _shown(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else "none" if value is None else str(value)
