"""Which records are judged along their motion, and how: fit, ask the strokes, judge on what took no part.

From records and an axis to a diagnosis along the measured motion: what was asked for, what is left, in words.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.balance import (
    Balance,
    Fitted,
    Named,
    Tried,
    asked_for,
    named,
    refuted,
    shares,
    terms_of,
    tried,
)
from emps_design.discrepancy.experiment import NextExperiment, varies
from emps_design.discrepancy.explanation import marked
from emps_design.discrepancy.gap import Gap, Prediction
from emps_design.discrepancy.least_squares import BASELINE, LEAST_MASS
from emps_design.discrepancy.noise_floor import Floor, Whitening, rms_interval
from emps_design.discrepancy.preparation import (
    SLOWEST_PERIOD,
    Confirming,
    Interval,
    between,
    check_records,
    check_same_drive,
    given,
)
from emps_design.discrepancy.residual_views import EVERYWHERE, described, extent, force_map, spectrum_over_time, views
from emps_design.discrepancy.result import Diagnosis, Finding
from emps_design.discrepancy.unexplained import GAIN_KNOWN, ONE_FORCE, SAID, depends_on
from emps_design.effects import Effect
from emps_design.effects.effect import COULOMB, OFFSET
from emps_design.effects.sizes import sized, sizes
from emps_design.identification.excitation import one_direction
from emps_design.identification.model import LUMP, ONE_WAY
from emps_design.identification.proposals import FEWEST_STROKES, LITTLE, TWICE, Unexplained
from emps_design.observer import motor_force
from emps_design.progress import Progress
from emps_design.quantities import inside, rounded
from emps_design.records import Record
from emps_design.records.record import joined

NOISE = "what does not come again with the same motion"
BALANCED = (
    "forces are balanced along the measured motion and nothing is simulated: of the effects only those are looked for "
    "that the motion of a moment tells, {looked_for}"
)
MOST_LEFT = 0.1  # of the force, up to which what does not come again with the motion may be noise and no more
BESIDE = 0.75  # samples, from which on a command is said to be logged beside the motion: instants are half a sample


@dataclass(frozen=True)
class BalanceResult:
    """What was found on a ``balance``: the ``baseline`` and the ``extended`` model, with what of it is ``named``.

    ``held_out`` are the errors of both models (rows,) [N] on the strokes that ``confirming`` speaks of, None for none;
    ``other`` is the balance of a record that was held out. ``records`` are as they were given; ``warnings`` what they
    cannot tell.
    """

    records: tuple[Record, ...]
    balance: Balance
    baseline: Fitted
    extended: Fitted
    named: tuple[Named, ...]
    tried: Sequence[Tried]
    confirming: Confirming
    held_out: tuple[np.ndarray, np.ndarray] | None
    other: Balance | None
    warnings: tuple[str, ...]

    @property
    def left(self) -> Unexplained:
        """What the extended model leaves, and how much of it comes again with the motion."""
        told = self.extended.found.extra["unexplained"]
        return Unexplained(told["share"], told["structure"], told["passes"], told["widening"])

    @property
    def lacks(self) -> bool:
        """Whether something is left that no term explains: it comes again with the motion, or is much."""
        return self.left.structure > LITTLE or self.left.share > MOST_LEFT

    @property
    def off(self) -> list[int]:
        """Places in the baseline at which the axis file is off: clearly, and by more than next to nothing."""
        given, places = self.balance.axis.mechanics.array(), []
        for place, quantity in enumerate(BASELINE):
            if quantity.name in self.extended.determined:
                value, std = self.extended.parameters[quantity.name], self.extended.deviation(quantity.name)
                apart = abs(value - given[place])
                if apart > rules.OFF_SURELY * std and apart > rules.OFF * max(abs(value), abs(given[place])):
                    places.append(place)
        return places

    @property
    def verdict(self) -> str:
        """The contract's verdict."""
        if self.named:
            alike = any(one.equivalents for one in self.named)
            return "partly-named" if self.lacks else "ambiguous" if alike else "named"
        if self.lacks:
            return "unnamed"
        return "parameters-only" if self.off else "nothing-missing"


def answer(found: BalanceResult, axis: Axis) -> Diagnosis:
    """The diagnosis of what was ``found`` on the machine of ``axis``."""
    balance, used = found.balance, found.balance.used
    before, after = (balance.missing(one) for one in (found.baseline, found.extended))
    forces = balance.filtered.force[balance.filtered.used]
    gap = _gap(*(balance.left(one)[balance.filtered.used] for one in (found.baseline, found.extended)))
    noise = found.left.noise * float(np.sqrt(np.mean(forces**2)))
    ratio = noise / max(gap.extended, 1e-300)
    low, high = (ratio * end for end in gap.intervals["extended"])
    floor = Floor(noise, noise, (low, high), (low, high), Whitening.none(), np.zeros(0), NOISE)
    findings = tuple(_finding(found, one) for one in found.named)
    limit = balance.axis.drive.command_limit
    drawn = views(before, after, used, noise, limit, balance.cutoff)
    too_fast = f"Nothing above {balance.filtered.band_hz:.2g} Hz can be told"
    details: dict[str, Any] = {
        "simulation": "inverse model",
        "band_hz": balance.filtered.band_hz,
        "candidates": [_candidate(one) for one in found.tried],
        "parameters": _parameters(found),
        "not_excluded": [],
        "records": _records(found),
        "held_out": found.confirming.to_dict(),
        "calibration": (
            f"A finding must lower the error of strokes that took no part in its fit {TWICE:g} times or more, in one "
            f"stroke after the other and not by chance, beside all other findings, and by more than {100 * LITTLE:g} % "
            "of the force."
        ),
        "assumptions": [GAIN_KNOWN, ONE_FORCE, BALANCED.format(looked_for=_looked_for(found))],
        "warnings": [*_warnings(found), too_fast],
        "rest": (too_fast,),
        "spectrum_over_time": spectrum_over_time(before),
        "interrupted": False,
    }
    over: list[str] = []
    if found.verdict == "parameters-only":
        given = balance.axis.mechanics.array()
        details["changed"] = ", ".join(
            f"{BASELINE[i].name.replace('_', ' ')} {given[i]:.5g} -> "
            f"{found.extended.parameters[BASELINE[i].name]:.5g} {BASELINE[i].unit}"
            for i in found.off
        )
    if found.lacks:
        details["unexplained"] = _unexplained(found, gap, noise)
        over = details["unexplained"]["over"]
    experiment = None
    if found.lacks:
        experiment = NextExperiment(varies(over)[1])
    elif found.named:
        experiment = NextExperiment(found.named[0].effect.experiment)
    return Diagnosis(
        verdict=found.verdict,
        findings=findings,
        axis=_axis(found, axis),
        noise=floor,
        train=gap,
        holdout=None if found.held_out is None else _gap(*found.held_out),
        trace=_trace(found),
        views=marked(drawn, findings),
        details=details,
        experiment=experiment,
    )


def _gap(before: np.ndarray, after: np.ndarray) -> Gap:
    """The gap of two models by their errors (rows,) [N]: an inverse model's, unfiltered or not."""
    sizes = [float(np.sqrt(np.mean(error**2))) for error in (before, after)]
    ends = [rms_interval(error) for error in (before, after)]
    names = ("baseline", "extended", "baseline_60hz", "extended_60hz")
    return Gap(sizes[0], sizes[1], sizes[0], sizes[1], dict(zip(names, [*ends, *ends], strict=True)))


def _finding(found: BalanceResult, one: Named) -> Finding:
    balance, units = found.balance, {p.name: p.unit for p in one.effect.parameters}
    left = [balance.left(model)[balance.filtered.used] for model in (one.without, found.extended)]
    before, after = (float(np.sqrt(np.mean(error**2))) for error in left)
    where = described(extent(balance.record, balance.along(one.force), balance.used))
    return Finding(
        effect=one.effect.name,
        label=one.effect.label,
        channel=one.effect.channel,
        where=where,
        parameters={
            name: {"value": float(value), "std": one.std[name], "unit": units[name]}
            for name, value in one.parameters.items()
        },
        p_value=one.chance,
        gap_before=before,
        gap_after=after,
        confirmed=one.confirmed,
        equivalents=one.equivalents[: rules.MOST_EQUIVALENTS],
        remedy=one.effect.remedy,
    )


def _candidate(one: Tried) -> dict[str, Any]:
    return {
        "effect": one.effect.name,
        "label": one.effect.label,
        "gap": one.error,
        "statistic": one.times,
        "threshold": TWICE,
        "accepted": one.accepted,
        "note": "times as large the error of held-out strokes is without it",
    }


def _parameters(found: BalanceResult) -> dict[str, Any]:
    """The baseline's numbers: the axis file's, fitted alone, and beside the effects; None where not determined."""
    given, table = found.balance.axis.mechanics.array(), {}
    for place, quantity in enumerate(BASELINE):
        entry = {"unit": quantity.unit, "axis": float(given[place])}
        for name, fitted in (("baseline", found.baseline), ("extended", found.extended)):
            told = quantity.name in fitted.determined
            value = float(fitted.model.baseline(_whole(fitted))[place]) if told else None
            entry[name] = {"value": value, "std": fitted.deviation(quantity.name) if told else None}
        table[quantity.name] = entry
    if found.balance.friction == ONE_WAY:
        direction = one_direction([found.balance.record])
        entry = {"unit": LUMP.unit, "axis": float(given[COULOMB] + direction * given[OFFSET])}
        for name, fitted in (("baseline", found.baseline), ("extended", found.extended)):
            value = fitted.determined.get(LUMP.name)
            entry[name] = {"value": value, "std": None if value is None else fitted.deviation(LUMP.name)}
        table[LUMP.name] = entry
    return table


def _whole(fitted: Fitted) -> dict[str, float]:
    return {"constant_force": 0.0, **fitted.parameters}


def _axis(found: BalanceResult, axis: Axis) -> Axis:
    """``axis`` with what was found; a number that is not determined stays as it was."""
    from emps_design.identification.problem import identified_effects

    given, own = axis.mechanics.array(), found.extended.model.baseline(_whole(found.extended))
    told = [quantity.name in found.extended.determined for quantity in BASELINE]
    numbers = [float(new if known else old) for new, old, known in zip(own, given, told, strict=True)]
    numbers[0] = max(numbers[0], LEAST_MASS * float(given[0]))
    mechanics = dict(zip(("mass", "viscous", "coulomb", "offset"), numbers, strict=True))
    effects = identified_effects(found.extended.model, found.extended.parameters) if found.named else []
    return axis.replace(mechanics=mechanics, effects=effects)


def _records(found: BalanceResult) -> list[dict[str, Any]]:
    roles = [(record, "train") for record in found.records]
    if found.other is not None and found.confirming.time is None:
        roles.append((found.other.record, "holdout"))
    return [{"name": record.name, "role": role, "sha256": record.sha256} for record, role in roles]


def _trace(found: BalanceResult) -> Prediction:
    """What both models make of the held-out record, or of the training record, and what was measured."""
    balance = found.other or found.balance
    measured = motor_force(balance.axis, balance.record)
    missing = [balance.missing(one).force for one in (found.baseline, found.extended)]
    return Prediction(
        balance.record,
        measured,
        measured - missing[0],
        measured - missing[1],
        balance.used,
        found.confirming.time if found.other is not None else None,
    )


def _looked_for(found: BalanceResult) -> str:
    labels = [inside(one.effect.label) for one in found.tried]
    return ", ".join(labels) if labels else "none, for fewer than three strokes are between rests"


def _unexplained(found: BalanceResult, gap: Gap, noise: float) -> dict[str, Any]:
    """The contract's ``unexplained``: what comes again with the motion, or all that is left where none of it does."""
    balance, again = found.balance, found.left.structure > LITTLE
    seen, used = balance.missing(found.extended), balance.used
    rms = float(np.sqrt(max(gap.extended**2 - noise**2, 0.0))) if again else gap.extended
    share = min(1.0, rms**2 / max(gap.baseline**2 - (noise**2 if again else 0.0), rms**2, 1e-300))
    fold = np.arange(len(balance.record)) * 10 // len(balance.record) % 2  # every second tenth of the record
    shares = depends_on((seen,), (used & (fold == 0),), (seen,), (used & (fold == 1),))
    over = [name for name in sorted(shares, key=lambda name: -shares[name]) if shares[name] > rules.DEPENDS]
    where = described(extent(balance.record, seen.force, used, noise if again else 0.0))
    place = "" if where["text"] == EVERYWHERE else f", most of it {where['text']}"
    depends = "it depends on none of position, velocity, time and load alone"
    if over:
        parts = [f"{name} ({100 * shares[name]:.0f} %)" for name in over[:SAID]]
        depends = f"it follows {' and '.join(parts)} on data that it was not fitted to"
    size = f"{rounded(rms)} N rms over the noise" if again else f"{rounded(rms)} N rms"
    of = f"{100 * found.left.share:.2g} % of the force"
    text = f"{size}{place}, where the model leaves {of}; {depends}"
    return {
        "rms": rms,
        "share": share,
        "over": over,
        "predicted": shares,
        **where,
        "text": text,
        "place": where["text"],
        "kind": "",
        "record": "train",
        "map": force_map(seen),
    }


def _warnings(found: BalanceResult) -> list[str]:
    fitted, late = found.extended, found.balance.clock.samples
    remarks = [*found.warnings]
    if abs(late) > BESIDE:
        remarks.append(
            f"the command was logged {abs(late):.2g} samples {'after' if late > 0 else 'before'} what the motion "
            "answers to, and is moved by that: less than two samples tell a drive that is late from none of the log's"
        )
    remarks += [text for text in fitted.found.warnings if " not determined: " in text]
    if fitted.held:
        remarks.append(f"{', '.join(fitted.held)}: held at nothing, for the record asks for less, which no axis has")
    left = found.left
    if left.share > MOST_LEFT and left.structure <= LITTLE:
        remarks.append(
            f"{100 * left.share:.2g} % of the force is left and does not come again with the motion: noise of the "
            "command, or something that remembers what was before"
        )
    return remarks


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
    found = BalanceResult(
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
