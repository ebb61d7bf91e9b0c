"""Which records are judged along their motion, and how: fit, ask the strokes, judge on what took no part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy.along_motion.answer import Found, answer
from emps_design.discrepancy.along_motion.balance import Balance, terms_of
from emps_design.discrepancy.along_motion.names import asked_for, named, refuted, shares, tried
from emps_design.discrepancy.checks.kept_closed import Confirming, given
from emps_design.discrepancy.checks.preparation import Interval, between
from emps_design.discrepancy.checks.requirements import SLOWEST_PERIOD, check_records, check_same_drive
from emps_design.discrepancy.result import Diagnosis
from emps_design.effects import Effect
from emps_design.effects.sizes import sized, sizes
from emps_design.identification.proposals import FEWEST_STROKES
from emps_design.progress import Progress
from emps_design.quantities import inside
from emps_design.records import Record
from emps_design.records.joined import joined


def too_slow(records: Sequence[Record]) -> bool:
    """Whether a record is sampled too slowly for a simulation of its loop to be compared with it."""
    return any(record.period > SLOWEST_PERIOD for record in records)


def diagnose_along_motion(
    records: tuple[Record, ...],
    axis: Axis,
    library: tuple[Effect, ...],
    holdout: Record | None,
    windows: tuple[Interval | None, Interval | None],
    progress: Progress,
    searched: Callable[[Axis], None],
) -> Diagnosis:
    """Diagnose ``records`` by the balance of forces along their motion; see :func:`emps_design.discrepancy.diagnose`.

    ``windows`` are what may be fitted and what confirms [s], of the first record. Raises :class:`InputError` for
    records that cannot be judged so.
    """
    progress("balancing the forces along the motion", 0.1)
    warnings = check_records(records, axis, along_motion=True)
    for other in (*records[1:], *(() if holdout is None else (holdout,))):
        check_same_drive(records[0], other, axis)
    if holdout is not None:
        warnings += check_records((holdout,), axis, along_motion=True)
    known = axis.replace(effects=[])
    if axis.effects:
        dropped = ", ".join(one.effect.name for one in axis.effects)
        warnings.append(f"the axis's own effects are left out and looked for again: {dropped}")
    parts, kept, confirming = _parts(records, holdout, *windows)
    fitted = parts[0] if len(parts) == 1 else joined(parts, axis.units.rotary)
    balance = Balance.of(fitted, known)
    factors = sizes(fitted.q, fitted.u, fitted.period, axis.drive.gain)
    effects = {one.name: sized(one, factors) for one in library if one.acts_on(axis.motion)}
    baseline = balance.fitted()
    progress("asking the strokes that take no part", 0.4)
    terms = terms_of(axis, effects)
    asked, said = asked_for(balance, terms, effects)
    extended = balance.fitted(asked)
    progress("confirming on data not used so far", 0.8)
    other = None if kept is None else Balance.of(kept, known, alike=balance)
    against = refuted(shares(balance, asked, other))
    for term in against:
        label = inside(effects[terms[term]].label)
        said.append(f"{label} fitted the training record and is withdrawn: the confirming data ask for another amount")
    stands = tuple(term for term in asked if term not in against and extended.tells(term))
    if stands != asked:
        asked, extended = stands, balance.fitted(stands)
    strokes, held_out = balance.strokes, None
    if other is not None:
        held_out = other.strokes.left((), known=strokes), other.strokes.left(asked, known=strokes)
    elif strokes.count >= FEWEST_STROKES:
        held_out = strokes.left(()), strokes.left(asked)
        whole = float(fitted.t[0]), float(fitted.t[-1]) + 0.5 * fitted.period
        confirming = Confirming(f"the {strokes.count} strokes of {fitted.name}", "in turn", whole)
    found = Found(
        records,
        balance,
        baseline,
        extended,
        named(balance, extended, terms, effects, shares(balance, asked, other)),
        tried(balance, terms, asked, effects),
        confirming,
        held_out,
        other,
        tuple(dict.fromkeys([*warnings, *said, *_of_records(records)])),
    )
    diagnosis = answer(found, axis)
    searched(diagnosis.axis)
    return diagnosis


def _parts(
    records: tuple[Record, ...], holdout: Record | None, fit: Interval | None, confirm: Interval | None
) -> tuple[list[Record], Record | None, Confirming]:
    """What is fitted, what confirms, and that in words."""
    first, confirming = records[0], Confirming("fewer than three strokes are between rests", "none")
    allowed = [np.ones(len(one), bool) if fit is None else between(one, fit, "`fit_time`") for one in records]
    kept = holdout
    if holdout is not None:
        confirming = given(holdout)
    elif confirm is not None:
        inside = between(first, confirm, "`confirm_time`")
        allowed[0] &= ~inside
        kept, confirming = _only(first, inside), given(first, confirm)
    parts = [one if mask.all() else _only(one, mask) for one, mask in zip(records, allowed, strict=True)]
    return parts, kept, confirming


def _of_records(records: tuple[Record, ...]) -> list[str]:
    """What reading ``records`` noticed, but for what their check says, and of references, which are not needed."""
    said = [text for record in records for text in record.warnings if text not in record.contradictions]
    return [text for text in said if not text.startswith("q_ref: ")]


def _only(record: Record, inside: np.ndarray) -> Record:
    """``record`` of which only the samples ``inside`` (n,) bool take part."""
    return replace(record, bridged=np.where(inside, record.in_gap, 1.0))
