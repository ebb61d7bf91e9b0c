"""Diagnosis along the measured motion, without simulation: fit, select terms by strokes, judge on held-out data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import BASELINE, Axis, Mechanics
from emps_design.discrepancy import rules
from emps_design.discrepancy.balance import (
    Balance,
    CandidateTerm,
    FittedModel,
    NamedEffect,
    candidate_terms,
    named_effects,
    refuted_terms,
    select_terms,
    term_shares,
    terms_of,
)
from emps_design.discrepancy.experiment import NextExperiment, varies
from emps_design.discrepancy.explanation import with_marks
from emps_design.discrepancy.gap import Gap, Prediction
from emps_design.discrepancy.noise_floor import Floor, Whitening, rms_interval
from emps_design.discrepancy.placement import extent, where_document
from emps_design.discrepancy.preparation import (
    HoldOut,
    Interval,
    check_records,
    check_same_drive,
    dropped_effects_message,
    samples_within,
    user_choice,
)
from emps_design.discrepancy.request import DiagnosisRequest
from emps_design.discrepancy.residual_views import force_map, spectrum_over_time, views
from emps_design.discrepancy.result import Diagnosis, Finding
from emps_design.discrepancy.unexplained import GAIN_KNOWN, ONE_FORCE, depends_on, follows, most_of_it
from emps_design.discrepancy.words import changed, filled, worded
from emps_design.effects.effect import COULOMB, OFFSET
from emps_design.effects.sizes import sized, sizes
from emps_design.identification.excitation import one_direction
from emps_design.identification.model import LUMP, ONE_WAY
from emps_design.identification.proposals import FEWEST_STROKES, LITTLE, TWICE, Unexplained
from emps_design.messages import Message, note, warning
from emps_design.observer import motor_force
from emps_design.quantities import inside, rounded
from emps_design.records import Record
from emps_design.records.record import joined

NOISE = "the part that does not repeat with the motion"
BALANCED = (
    "{forces} are balanced along the measured motion, without a simulation: only effects that depend on the present "
    "motion are looked for, {looked_for}"
)


@dataclass(frozen=True)
class BalanceResult:
    """Result of a force ``balance``: the ``baseline`` and the ``extended`` model, and the effects ``named`` in it.

    ``held_out`` are the errors (rows,) [N] of both models on the held-out strokes, None without any; ``other`` is the
    balance of a held-out record. ``records`` are the user's; ``warnings`` say what they do not determine.
    """

    records: tuple[Record, ...]
    balance: Balance
    baseline: FittedModel
    extended: FittedModel
    named: tuple[NamedEffect, ...]
    tried: Sequence[CandidateTerm]
    hold_out: HoldOut
    held_out: tuple[np.ndarray, np.ndarray] | None
    other: Balance | None
    warnings: tuple[Message, ...]

    @property
    def unexplained(self) -> Unexplained:
        """The residual of the extended model, and the part of it that repeats with the motion."""
        entry = self.extended.identification.extra["unexplained"]
        return Unexplained(entry["share"], entry["structure"], entry["passes"], entry["widening"])

    @property
    def lacks(self) -> bool:
        """Whether the residual is unexplained: it repeats with the motion, or is too large for noise."""
        return self.unexplained.structure > LITTLE or self.unexplained.share > rules.MINOR

    @property
    def off(self) -> list[int]:
        """Indices of the baseline numbers at which the axis file is wrong: significantly, and by a relevant amount."""
        axis_numbers, places = self.balance.axis.mechanics.array(), []
        for place, quantity in enumerate(BASELINE):
            if quantity.name in self.extended.determined:
                value, std = self.extended.parameters[quantity.name], self.extended.deviation(quantity.name)
                apart = abs(value - axis_numbers[place])
                if apart > rules.SURE * std and apart > rules.OFF * max(abs(value), abs(axis_numbers[place])):
                    places.append(place)
        return places

    @property
    def verdict(self) -> str:
        """The contract's verdict."""
        if self.named:
            ambiguous = any(finding.equivalents for finding in self.named)
            return "partly-named" if self.lacks else "ambiguous" if ambiguous else "named"
        if self.lacks:
            return "unnamed"
        return "parameters-only" if self.off else "nothing-missing"


def answer(outcome: BalanceResult, axis: Axis) -> Diagnosis:
    """The diagnosis of the machine of ``axis`` by a force balance with the result ``outcome``."""
    balance, used, units = outcome.balance, outcome.balance.used, axis.units
    before, after = (balance.missing(model) for model in (outcome.baseline, outcome.extended))
    forces = balance.filtered.force[balance.filtered.used]
    gap = _gap(*(balance.residual(model)[balance.filtered.used] for model in (outcome.baseline, outcome.extended)))
    noise = outcome.unexplained.noise * float(np.sqrt(np.mean(forces**2)))
    ratio = noise / max(gap.extended, 1e-300)
    low, high = (ratio * end for end in gap.intervals["extended"])
    floor = Floor(noise, noise, (low, high), (low, high), Whitening.none(), np.zeros(0), NOISE)
    findings = tuple(_finding(outcome, finding) for finding in outcome.named)
    drawn = views(before, after, used, noise, balance.axis, balance.cutoff)
    balanced = BALANCED.format(forces=units.word("forces"), looked_for=_candidate_labels(outcome))
    band = balance.filtered.band_hz
    band_limit = note("nothing-above-band", f"Frequencies above {band:.2g} Hz are not analysed", band_hz=band)
    details: dict[str, Any] = {
        "simulation": "inverse model",
        "band_hz": balance.filtered.band_hz,
        "candidates": [_candidate(candidate) for candidate in outcome.tried],
        "parameters": _parameters(outcome),
        "not_excluded": [],
        "records": _records(outcome),
        "held_out": outcome.hold_out.to_dict(),
        "calibration": (
            f"With all other findings in the model, a finding must reduce the error on strokes outside its fit at "
            f"least {TWICE:g} times, on stroke after stroke and significantly, and by more than {100 * LITTLE:g} % of "
            f"the {units.word('force')}."
        ),
        "assumptions": [filled(GAIN_KNOWN, units), filled(ONE_FORCE, units), balanced],
        "warnings": [*_warnings(outcome), band_limit],
        "rest": (band_limit,),
        "spectrum_over_time": spectrum_over_time(before, units),
        "interrupted": False,
    }
    over: list[str] = []
    if outcome.verdict == "parameters-only":
        numbers = outcome.extended.model.baseline(_with_constant_force(outcome.extended))
        details["changed"] = changed(balance.axis.mechanics.array(), numbers, outcome.off, units)
    if outcome.lacks:
        details["unexplained"] = _unexplained(outcome, gap, noise)
        over = details["unexplained"]["over"]
    experiment = None
    if outcome.lacks:
        experiment = NextExperiment(varies(over)[1])
    elif outcome.named:
        experiment = NextExperiment(outcome.named[0].effect.words.experiment)
    return Diagnosis(
        verdict=outcome.verdict,
        findings=findings,
        axis=_axis(outcome, axis),
        noise=floor,
        train=gap,
        holdout=None if outcome.held_out is None else _gap(*outcome.held_out),
        trace=_trace(outcome),
        views=with_marks(drawn, findings),
        details=details,
        experiment=experiment,
    )


def _gap(before: np.ndarray, after: np.ndarray) -> Gap:
    """The gap of two models from their errors (rows,) [N]; both measures of an inverse model are the same."""
    sizes = [float(np.sqrt(np.mean(error**2))) for error in (before, after)]
    ends = [rms_interval(error) for error in (before, after)]
    names = ("baseline", "extended", "baseline_60hz", "extended_60hz")
    return Gap(sizes[0], sizes[1], sizes[0], sizes[1], dict(zip(names, [*ends, *ends], strict=True)))


def _finding(outcome: BalanceResult, finding: NamedEffect) -> Finding:
    balance, unit_of = outcome.balance, {p.name: p.unit for p in finding.effect.parameters}
    residuals = [balance.residual(model)[balance.filtered.used] for model in (finding.without, outcome.extended)]
    before, after = (float(np.sqrt(np.mean(error**2))) for error in residuals)
    region = extent(balance.record, balance.along(finding.force), balance.used)
    where = where_document(region, balance.axis.units)
    return Finding(
        effect=finding.effect.name,
        label=finding.effect.label,
        channel=finding.effect.channel,
        where=where,
        parameters={
            name: {"value": float(value), "std": finding.std[name], "unit": unit_of[name]}
            for name, value in finding.parameters.items()
        },
        p_value=finding.chance,
        gap_before=before,
        gap_after=after,
        confirmed=finding.confirmed,
        equivalents=finding.equivalents[: rules.MOST_EQUIVALENTS],
        remedy=finding.effect.words.remedy,
    )


def _candidate(candidate: CandidateTerm) -> dict[str, Any]:
    return {
        "effect": candidate.effect.name,
        "label": candidate.effect.label,
        "gap": candidate.error,
        "statistic": candidate.times,
        "threshold": TWICE,
        "accepted": candidate.accepted,
        "note": "factor by which the error on held-out strokes grows without it",
    }


def _parameters(outcome: BalanceResult) -> dict[str, Any]:
    """Baseline parameters: of the axis file, fitted alone, and fitted with the effects; None if not determined."""
    axis_numbers, table, units = outcome.balance.axis.mechanics.array(), {}, outcome.balance.axis.units
    for place, quantity in enumerate(BASELINE):
        entry = {"unit": units.unit(quantity.unit), "axis": float(axis_numbers[place])}
        for name, fitted in (("baseline", outcome.baseline), ("extended", outcome.extended)):
            determined = quantity.name in fitted.determined
            value = float(fitted.model.baseline(_with_constant_force(fitted))[place]) if determined else None
            entry[name] = {"value": value, "std": fitted.deviation(quantity.name) if determined else None}
        table[quantity.name] = entry
    if outcome.balance.friction == ONE_WAY:
        direction = one_direction([outcome.balance.record])
        entry = {"unit": units.unit(LUMP.unit), "axis": float(axis_numbers[COULOMB] + direction * axis_numbers[OFFSET])}
        for name, fitted in (("baseline", outcome.baseline), ("extended", outcome.extended)):
            value = fitted.determined.get(LUMP.name)
            entry[name] = {"value": value, "std": None if value is None else fitted.deviation(LUMP.name)}
        table[LUMP.name] = entry
    return table


def _with_constant_force(fitted: FittedModel) -> dict[str, float]:
    return {"constant_force": 0.0, **fitted.parameters}


def _axis(outcome: BalanceResult, axis: Axis) -> Axis:
    """``axis`` with the identified parameters and effects; an undetermined parameter keeps its value."""
    from emps_design.identification.model import identified_effects

    axis_numbers = axis.mechanics.array()
    fitted = outcome.extended.model.baseline(_with_constant_force(outcome.extended))
    determined = [quantity.name in outcome.extended.determined for quantity in BASELINE]
    numbers = [float(new if known else old) for new, old, known in zip(fitted, axis_numbers, determined, strict=True)]
    numbers[0] = max(numbers[0], rules.LEAST_MASS * float(axis_numbers[0]))
    effects = identified_effects(outcome.extended.model, outcome.extended.parameters) if outcome.named else []
    return axis.replace(mechanics=Mechanics.table(numbers), effects=effects)


def _records(outcome: BalanceResult) -> list[dict[str, Any]]:
    roles = [(record, "train") for record in outcome.records]
    if outcome.other is not None and outcome.hold_out.time is None:
        roles.append((outcome.other.record, "holdout"))
    return [{"name": record.name, "role": role, "sha256": record.sha256} for record, role in roles]


def _trace(outcome: BalanceResult) -> Prediction:
    """Measured force and that of both models on the held-out record, or on the training record."""
    balance = outcome.other or outcome.balance
    measured = motor_force(balance.axis, balance.record)
    missing = [balance.missing(model).force for model in (outcome.baseline, outcome.extended)]
    return Prediction(
        balance.record,
        measured,
        measured - missing[0],
        measured - missing[1],
        balance.used,
        outcome.hold_out.time if outcome.other is not None else None,
    )


def _candidate_labels(outcome: BalanceResult) -> str:
    labels = [inside(candidate.effect.label) for candidate in outcome.tried]
    return ", ".join(labels) if labels else "none, because there are fewer than three strokes between rests"


def _unexplained(outcome: BalanceResult, gap: Gap, noise: float) -> dict[str, Any]:
    """The contract's ``unexplained``: the residual that repeats with the motion, or all of it if none repeats."""
    balance, repeats = outcome.balance, outcome.unexplained.structure > LITTLE
    missing, used = balance.missing(outcome.extended), balance.used
    rms = float(np.sqrt(max(gap.extended**2 - noise**2, 0.0))) if repeats else gap.extended
    share = min(1.0, rms**2 / max(gap.baseline**2 - (noise**2 if repeats else 0.0), rms**2, 1e-300))
    fold = np.arange(len(balance.record)) * 10 // len(balance.record) % 2  # every second tenth of the record
    term_shares = depends_on((missing,), (used & (fold == 0),), (missing,), (used & (fold == 1),))
    over, depends = follows(term_shares)
    units = balance.axis.units
    where = where_document(extent(balance.record, missing.force, used, noise if repeats else 0.0), units)
    size = f"{units.quantity(rms, 'N', rounded)} rms{' over the noise' if repeats else ''}"
    part = f"{100 * outcome.unexplained.share:.2g} % of the {units.word('force')}"
    text = f"{size}{most_of_it(where)}; the model does not explain {part}; {depends}"
    return {
        "rms": rms,
        "share": share,
        "over": over,
        "predicted": term_shares,
        **where,
        "text": text,
        "place": where["text"],
        "kind": "",
        "record": "train",
        "map": force_map(missing, units),
    }


def _warnings(outcome: BalanceResult) -> list[Message]:
    fitted, late = outcome.extended, outcome.balance.clock.samples
    remarks = [*outcome.warnings]
    # Sampled values and means differ by half a sample; a record resolves a quarter of a sample.
    if abs(late) > rules.HALF + rules.QUARTER:
        text = (
            f"the command is logged {abs(late):.2g} samples too {'late' if late > 0 else 'early'} for the motion, and "
            "was shifted by that; below two samples a delay of the log looks like a delay of the drive"
        )
        remarks.append(warning("command-late", text, samples=late))
    remarks += [message for message in fitted.identification.warnings if message.code == "not-determined"]
    if fitted.held:
        text = f"{', '.join(fitted.held)}: set to zero, because the fit gives a negative value, which no axis has"
        remarks.append(warning("held-at-nothing", text, parameters=fitted.held))
    unexplained = outcome.unexplained
    if unexplained.share > rules.MINOR and unexplained.structure <= LITTLE:
        text = (
            f"{100 * unexplained.share:.2g} % of the {outcome.balance.axis.units.word('force')} is unexplained and "
            "does not repeat with the motion: noise of the command, or an effect with memory"
        )
        remarks.append(warning("rest-does-not-repeat", text, share=unexplained.share))
    return remarks


def too_slow(records: Sequence[Record]) -> bool:
    """Whether a record is sampled too slowly to be compared with a simulation of its loop."""
    return any(record.period > rules.SLOWEST_PERIOD for record in records)


def diagnose_along_motion(request: DiagnosisRequest) -> Diagnosis:
    """Diagnose the records of ``request`` by the balance of forces along their motion.

    Raises :class:`InputError` for records that cannot be judged in this way.
    """
    records, axis, holdout, progress = request.records, request.axis, request.holdout, request.progress
    progress(f"balancing the {axis.units.word('forces')} along the motion", 0.1)
    warnings = check_records(records, axis, along_motion=True)
    for other in (*records[1:], *(() if holdout is None else (holdout,))):
        check_same_drive(records[0], other, axis)
    if holdout is not None:
        warnings += check_records((holdout,), axis, along_motion=True)
    known = axis.replace(effects=[])
    if axis.effects:
        warnings.append(dropped_effects_message([entry.effect.name for entry in axis.effects]))
    parts, held_out_record, hold_out = _parts(records, holdout, request.fit_time, request.confirm_time)
    fitted = parts[0] if len(parts) == 1 else joined(parts, axis.units.rotary)
    balance = Balance.of(fitted, known)
    factors = sizes(fitted.q, fitted.u, fitted.period, axis.drive.gain)
    library = (effect for effect in request.library or () if effect.acts_on(axis.motion))
    effects = {effect.name: worded(sized(effect, factors), axis.units) for effect in library}
    baseline = balance.fitted()
    progress("testing effects on held-out strokes", 0.4)
    terms = terms_of(axis, effects)
    selected, remarks = select_terms(balance, terms, effects)
    extended = balance.fitted(selected)
    progress("confirming on held-out data", 0.8)
    other = None if held_out_record is None else Balance.of(held_out_record, known, template=balance)
    withdrawn = refuted_terms(term_shares(balance, selected, other))
    for term in withdrawn:
        label = inside(effects[terms[term]].label)
        text = f"{label} is withdrawn: it fits the training record, but the held-out data need another amount of it"
        remarks.append(warning("term-withdrawn", text, term=term))
    confirmed = tuple(term for term in selected if term not in withdrawn and extended.determines(term))
    if confirmed != selected:
        selected, extended = confirmed, balance.fitted(confirmed)
    strokes, held_out = balance.strokes, None
    if other is not None:
        held_out = other.strokes.left((), known=strokes), other.strokes.left(selected, known=strokes)
    elif strokes.count >= FEWEST_STROKES:
        held_out = strokes.left(()), strokes.left(selected)
        whole = float(fitted.t[0]), float(fitted.t[-1]) + 0.5 * fitted.period
        hold_out = HoldOut(f"the {strokes.count} strokes of {fitted.name}", "in turn", whole)
    outcome = BalanceResult(
        records,
        balance,
        baseline,
        extended,
        named_effects(balance, extended, terms, effects, term_shares(balance, selected, other)),
        candidate_terms(balance, terms, selected, effects),
        hold_out,
        held_out,
        other,
        tuple(dict.fromkeys([*warnings, *remarks, *_of_records(records)])),
    )
    diagnosis = answer(outcome, axis)
    request.keep(diagnosis.axis)
    return diagnosis


def _parts(
    records: tuple[Record, ...], holdout: Record | None, fit: Interval | None, confirm: Interval | None
) -> tuple[list[Record], Record | None, HoldOut]:
    """The records to fit, the held-out record or None, and its description."""
    first, hold_out = records[0], HoldOut("fewer than three strokes between rests", "none")
    allowed = [
        np.ones(len(record), bool) if fit is None else samples_within(record, fit, "`fit_time`") for record in records
    ]
    held_out_record = holdout
    if holdout is not None:
        hold_out = user_choice(holdout)
    elif confirm is not None:
        inside = samples_within(first, confirm, "`confirm_time`")
        allowed[0] &= ~inside
        held_out_record, hold_out = _only(first, inside), user_choice(first, confirm)
    parts = [record if mask.all() else _only(record, mask) for record, mask in zip(records, allowed, strict=True)]
    return parts, held_out_record, hold_out


def _of_records(records: tuple[Record, ...]) -> list[Message]:
    """Messages about the files, without contradictions (reported by the check) and without those about ``q_ref``."""
    remarks = [message for record in records for message in record.warnings if message not in record.contradictions]
    return [message for message in remarks if message.values.get("column") != "q_ref"]


def _only(record: Record, inside: np.ndarray) -> Record:
    """``record`` with all samples outside ``inside`` (n,) bool excluded."""
    return replace(record, bridged=np.where(inside, record.in_gap, 1.0))
