"""The first stage: records that can be judged, split, with what their controller's law already tells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.checks.controller_law import LawCheck, beside_the_law, check_law
from emps_design.discrepancy.checks.kept_closed import Confirming, given, kept_closed
from emps_design.discrepancy.checks.requirements import (
    ONE_SPEED,
    check_records,
    check_same_drive,
    keeps_one_speed,
    same_run,
    told_by_one_speed,
)
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.partition import FEWEST_STROKES, PARTS, Split, find_strokes, split
from emps_design.discrepancy.model.problem import Hypothesis, Problem
from emps_design.discrepancy.model.whitening import Whitening
from emps_design.effects import Effect
from emps_design.effects.effect import COULOMB, MASS, OFFSET, VISCOUS
from emps_design.effects.sizes import sized, sizes
from emps_design.errors import InputError
from emps_design.identification.excitation import one_direction
from emps_design.identification.model import LUMPED
from emps_design.records import Record

Interval = tuple[float, float]


@dataclass(frozen=True)
class HeldOut:
    """The data that confirm, as a problem of their own; ``window`` (start, stop) [s] where they are part of a record.

    Without a ``law`` the controller is unknown, or does what it does on the training record that this is a part of.
    """

    problem: Problem
    window: Interval | None
    law: LawCheck | None

    @property
    def added(self) -> str:
        """Name of the effect that the controller adds here, or ""."""
        return "" if self.law is None else self.law.added

    def with_whitening(self, whitening: Whitening) -> HeldOut:
        """The same data judged with other noise."""
        return replace(self, problem=self.problem.with_whitening(whitening))


@dataclass(frozen=True)
class Preparation:
    """What a diagnosis starts from.

    ``records`` are as they were given; ``start`` is the axis file's own model of them, with what the controller adds to
    its law; ``library`` are the effects to look for, ``laws`` the checks of the controller's law, one per record where
    the controller is known. ``confirming`` says what ``held_out`` is, or why it is None. ``direction`` is 1 or -1 where
    all goes one way: then Coulomb friction and the constant force are one, and the latter stays as the axis file says.
    """

    records: tuple[Record, ...]
    start: Hypothesis
    library: tuple[Effect, ...]
    laws: tuple[LawCheck, ...]
    held_out: HeldOut | None
    confirming: Confirming
    warnings: tuple[str, ...]
    direction: int = 0

    @property
    def unexplained_law(self) -> bool:
        """Whether the controller does something on the training records that no effect explains."""
        return any(law.unexplained for law in self.laws)


def prepare(
    records: tuple[Record, ...],
    axis: Axis,
    library: tuple[Effect, ...],
    holdout: Record | None,
    fit_time: Interval | None,
    confirm_time: Interval | None,
    opened: Confirming | None = None,
) -> Preparation:
    """Check the records and the controller's law, size the library to the axis, split what may be fitted.

    What confirms stays closed: ``holdout``, or ``confirm_time`` [s] of the first record, or else what can be spared,
    unless that was ``opened``.
    """
    confirming = opened or _confirming(records, holdout, fit_time, confirm_time)
    confirm_time = confirming.time
    dropped, first = [one.effect.name for one in axis.effects], records[0]
    axis = axis.replace(effects=[]).supplied_by(*records, *(() if holdout is None else (holdout,)))
    factors = sizes(first.q, first.u, first.period, axis.drive.gain)
    lines = (line for effect in library if effect.acts_on(axis.motion) for line in effect.several())
    library = tuple(sized(line, factors) for line in lines)
    warnings = check_records(records, axis)
    if dropped:
        warnings.append(f"the axis's own effects are left out and looked for again: {', '.join(dropped)}")
    for other in (*records[1:], *(() if holdout is None else (holdout,))):
        check_same_drive(first, other, axis)
    for one, other in combinations(records, 2):
        if same_run(one, other):
            raise InputError(f"{other.name}: is the record {one.name} again; give each record once")
    known, law = axis.controller.kind != "none", None
    if holdout is not None:
        if any(same_run(holdout, record) for record in records):
            raise InputError(f"{holdout.name}: is a training record too; confirm on one that nothing was fitted to")
        warnings += check_records((holdout,), axis)
        # A foreign controller is to be refused before the search; the law says nothing of the plant.
        law = check_law(holdout, axis, library) if known else None
    laws = tuple(check_law(record, axis, library) for record in records if known)
    judged = tuple(map(beside_the_law, records, laws)) if known else records
    splits = _splits(records, fit_time, confirm_time)
    # Nothing of a record is simulated behind the last sample that is fitted: no filter sees what confirms.
    ends = [int(np.flatnonzero(one.used)[-1]) + 1 if one.used.any() else len(one.fit) for one in splits]
    searched, splits = tuple(map(Record.until, judged, ends)), tuple(map(Split.until, splits, ends))
    problem = Problem(axis, searched, splits, Whitening.none())
    held_out = None
    if holdout is not None or confirm_time is not None:
        record, window = judged[0] if holdout is None else beside_the_law(holdout, law), None
        inside = np.ones(len(record), bool)
        if confirm_time is not None:
            inside = between(record, confirm_time, "`confirm_time`")
        if not inside.all():
            window = float(record.t[inside][0]), float(record.t[inside][-1])
        held_out = HeldOut(Problem(axis, (record,), (split(record, inside),), Whitening.none()), window, law)
    held: tuple[int, ...] = ()
    direction = one_direction(searched)
    if problem.follows and all(map(keeps_one_speed, searched, problem.masks("used"))):
        held = MASS, VISCOUS, COULOMB
        library = tuple(filter(told_by_one_speed, library))
        warnings.append(ONE_SPEED)
        direction = 0
    elif direction:
        held = (OFFSET,)
        warnings.append(LUMPED)
    start = Hypothesis(problem, _as_the_axis_says(Candidate.of(axis, factors, held), laws))
    plant = tuple(effect for effect in library if effect.channel != "controller")
    return Preparation(records, start, plant, laws, held_out, confirming, tuple(warnings), direction)


def _confirming(
    records: tuple[Record, ...], holdout: Record | None, fit_time: Interval | None, confirm_time: Interval | None
) -> Confirming:
    if holdout is not None:
        return given(holdout)
    return kept_closed(records, fit_time) if confirm_time is None else given(records[0], confirm_time)


def _splits(records: tuple[Record, ...], fit_time: Interval | None, confirm_time: Interval | None) -> tuple[Split, ...]:
    """What fits and what selects of each record; refuses what is too little."""
    allowed = [np.ones(len(r), bool) if fit_time is None else between(r, fit_time, "`fit_time`") for r in records]
    if confirm_time is not None:
        kept = between(records[0], confirm_time, "`confirm_time`")
        if kept.sum() < rules.FEWEST_TO_CONFIRM:
            raise InputError(
                f"`confirm_time`: found {kept.sum()} samples of {records[0].name}, expected at least "
                f"{rules.FEWEST_TO_CONFIRM}"
            )
        allowed[0] &= ~kept
    there = [
        mask[start:stop].any()
        for record, mask in zip(records, allowed, strict=True)
        for start, stop in find_strokes(record.q_ref, record.period)
    ]
    few = sum(there) < FEWEST_STROKES
    splits: list[Split] = []
    for record, mask in zip(records, allowed, strict=True):
        splits.append(split(record, mask, sum(len(made.strokes) for made in splits), PARTS if few else 1))
    fits, selects, used = (int(sum(getattr(s, part).sum() for s in splits)) for part in ("fit", "select", "used"))
    if fits < rules.FEWEST_TO_FIT or selects < rules.FEWEST_TO_SELECT:
        raise InputError(
            f"{', '.join(record.name for record in records)}: found {used} samples to fit, in "
            f"{sum(len(made.strokes) for made in splits)} strokes; expected at least {rules.FEWEST_TO_FIT} to fit and "
            f"{rules.FEWEST_TO_SELECT} others to select from: record longer (identify needs less)"
        )
    return tuple(splits)


def _as_the_axis_says(start: Candidate, laws: tuple[LawCheck, ...]) -> Candidate:
    """The axis file's numbers, with the effect that explains what the controller adds to its law."""
    additions = [law.addition for law in laws]
    first = next((addition for addition in additions if addition is not None), None)
    if first is None:
        return start
    effect, values = first
    # A record without the disturbance has none of it, whatever its rhythm elsewhere.
    idle = np.where([p.unit == "V" for p in effect.parameters], 0.0, values)
    rows = [idle if addition is None or addition[0] is not effect else addition[1] for addition in additions]
    return start.with_effect(effect, np.array(rows))


def between(record: Record, window: Interval, option: str) -> np.ndarray:
    """Samples (n,) bool of ``record`` inside ``window`` (start, stop) [s]; refuses an empty one."""
    inside = (record.t >= window[0]) & (record.t < window[1])
    if not inside.any():
        raise InputError(
            f"{option}: found {window[0]:g}:{window[1]:g} s, expected a part of {record.name}, which lasts "
            f"{record.duration:.3g} s"
        )
    return inside
