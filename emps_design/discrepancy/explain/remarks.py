"""What a reader must know beside the findings: what is assumed, how it was judged, what is doubtful."""

from __future__ import annotations

from emps_design.discrepancy import rules
from emps_design.discrepancy.checks.preparation import HeldOut
from emps_design.discrepancy.search.acceptance import force_rms
from emps_design.discrepancy.search.calibration import Calibration
from emps_design.discrepancy.validation.evidence import Asked
from emps_design.discrepancy.validation.verdict import Validation
from emps_design.effects import get_effect, kind_of
from emps_design.quantities import inside, rounded, share_asked

GAIN_KNOWN = (
    "the force gain of the drive is known: an error of it scales every mechanical parameter and shows nowhere else"
)
ONE_FORCE = (
    "a Coulomb asymmetry and a constant force are one and the same in any record, and both are the constant force here"
)
ASSUMPTIONS = (GAIN_KNOWN, "the drive holds each voltage over the period that follows its sample", ONE_FORCE)
FOLLOWED = (
    "the controller is not known: the models follow the recorded motion and voltage, and what the controller itself "
    "adds to the voltage cannot be checked"
)


def calibration_in_words(calibration: Calibration) -> str:
    """What a finding had to gain, and why."""
    healthy, runs = calibration.healthy, calibration.healthy.largest.size
    level = max(rules.LEVEL, 1 / (runs + 1))
    made = f"{runs} simulated healthy records, each searched like this one"
    if not healthy.searched:
        made = f"{runs} healthy references made of resampled noise"
    return (
        f"A finding must gain more than {healthy.threshold:.1f} in whitened cost, the largest gain of any "
        f"candidate in {100 * level:.2g} % of {made}, and more than {100 * rules.WORTH:g} % of the cost "
        f"({100 * rules.WORTH_AT_FLOOR:g} % where it is noise already); the noise is {calibration.floor.source}."
    )


def warnings(validation: Validation) -> list[str]:
    """Everything that limits what the verdict says."""
    preparation = validation.outcome.calibration.preparation
    remarks = [*preparation.warnings, *validation.outcome.warnings, *_limits(validation)]
    if preparation.held_out is not None:
        remarks += _of_holdout(validation, preparation.held_out)
    for index, effect in enumerate(validation.extended.model.effects):
        remarks += [f"{effect.label}: {text}" for text in begun_earlier(validation, index)]
    if validation.given_up:
        labels = ", ".join(inside(get_effect(kind_of(name)).label) for name in validation.given_up)
        remarks.append(
            f"a model with {labels} explains {100 * validation.share:.0f} % of the gap, and does not stand: too little "
            "of it, not on both records, or too many others would do"
        )
    return remarks


def begun_earlier(validation: Validation, index: int) -> list[str]:
    """Which instants of effect ``index`` are only the first in what was fitted: the part kept closed has earlier ones.

    What belongs to one record was fitted there anew, and the old numbers stood where new ones were not clearly better.
    """
    kept, held_out = validation.outcome.calibration.preparation.confirming, validation.held_out
    effect = validation.extended.model.effects[index]
    if kept.chosen != "kept" or kept.time is None or held_out is None or effect.name not in held_out.extended.names:
        return []
    start, stop = kept.time
    now, there = (m.values[m.names.index(effect.name)][0] for m in (validation.extended.model, held_out.extended))
    return [
        f"{p.name} is the first in what was fitted: {kept.what}, kept closed, has it at {there[place]:.4g} {p.unit}"
        for place, p in enumerate(effect.parameters)
        if p.per_record and p.unit == "s" and start <= there[place] < stop <= now[place]
    ]


def _limits(validation: Validation) -> list[str]:
    calibration, extended = validation.outcome.calibration, validation.extended
    floor = calibration.floor
    remarks = [FOLLOWED] if extended.problem.follows else []
    if not floor.from_laps:
        remarks.append(
            f"noise is {floor.source}, not what differs between laps: what is unlike all candidates, and differs "
            "from stroke to stroke, would pass for it"
        )
    if validation.verdict in ("named", "ambiguous") and calibration.judge.leaves_structure(extended):
        remarks.append(
            f"structure remains after the last finding: {rounded(force_rms(extended))} N where noise is "
            f"{rounded(floor.force)} N; no further effect of the library is clear enough to name"
        )
    if validation.verdict == "unnamed":
        remarks.append(
            "mass and friction are estimated so that the structure that is left pulls little at them: they leave "
            f"{rounded(force_rms(extended))} N, where plain least squares would bend them to leave "
            f"{rounded(force_rms(validation.outcome.path[0]))} N"
        )
    if calibration.preparation.unexplained_law:
        remarks.append("the controller's law has a gap that no effect explains, taken as known: see u minus the law")
    return remarks


def _of_holdout(validation: Validation, held_out: HeldOut) -> list[str]:
    remarks = [
        f"{inside(get_effect(kind_of(a.name)).label)} fitted the training record and is withdrawn: the confirming "
        f"record asks for {_amount(a)} of it"
        for a in validation.refuted
    ]
    if held_out.added not in ("", *validation.extended.model.names):
        label = inside(get_effect(held_out.added).label)
        remarks.append(f"{label} on the confirming record, seen in its voltage: taken as known there, by both models")
    elif held_out.law is not None and held_out.law.unexplained:
        remarks.append("the controller's law has a gap on the confirming record too, taken as known there")
    if validation.held_out is not None and validation.held_out.refitted:
        names = ", ".join(validation.held_out.refitted)
        remarks.append(f"fitted anew on the confirming record, because they belong to one record: {names}")
    return remarks


def _amount(asked: Asked) -> str:
    """The share that was clearly refuted; of what is hardly wanted that of all weighings together."""
    told = None if asked.refuted else asked.confirmed
    return share_asked(asked.share, asked.std) if told is None else share_asked(**told)
