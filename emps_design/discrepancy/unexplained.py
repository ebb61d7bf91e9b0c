"""What no effect explains: how much is left, over which variables it repeats on data not seen, what to record next.

What a reader must know beside the findings: what is assumed, how it was judged, what is doubtful.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import force_rms
from emps_design.discrepancy.calibration import Calibration
from emps_design.discrepancy.confirmation import Share
from emps_design.discrepancy.gap import most_missed
from emps_design.discrepancy.preparation import HeldOut
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.residual_views import EVERYWHERE, described, extent, force_map
from emps_design.discrepancy.unknown_force import SLOWEST, MissingForce, missing_force, since_reversal
from emps_design.discrepancy.verdict import Validation
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

DEGREE = 8  # of the polynomials in one variable
RIDGE = 1e-6  # of the mean square of a column
SAID = 2  # variables in the sentence
LOWEST_HZ = 2.0  # below, lines are those of the strokes
FROM_THE_LAW = "by which the command differs from the controller's law"
WIDTH = 0.1  # of a frequency, within which its line counts


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
    if validation.in_free_run:
        before, after = map(rounded, validation.in_free_run)
        labels = ", ".join(inside(get_effect(kind_of(name)).label) for name in validation.given_up)
        remarks.append(
            f"a model with {labels} follows the record, but driven by the recorded command alone it misses the "
            f"velocity by {after} m/s rms, more than the {before} m/s without: it does not stand"
        )
    elif validation.given_up:
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


def _amount(asked: Share) -> str:
    """The share that was clearly refuted; of what is hardly wanted that of all weighings together."""
    told = None if asked.refuted else asked.confirmed
    return share_asked(asked.share, asked.std) if told is None else share_asked(**told)


def unexplained(validation: Validation) -> dict[str, Any]:
    """The contract's ``unexplained`` of a validation in which structure is left.

    ``rms`` [N] is what the model leaves over the noise, ``share`` of the gap's mean square; ``over`` the variables that
    predict it on data not fitted to, the best first, and ``predicted`` the share of it that each does. ``record`` says
    where it shows: "train", or "holdout" where training leaves nothing but noise. ``kind`` is what it is like, "" where
    that is not known: beside an unknown force of that kind, what is named leaves next to nothing, ``kind_leaves`` [N]
    with the noise. ``law_gap`` [V] is by how much the command differs from the controller's law, where that has no name
    either.
    """
    floor, held_out = validation.outcome.calibration.floor.force, validation.held_out
    shown = _where_it_shows(validation)
    # Confirming data that show nothing, as of a push or a mass put on in training alone, say nothing of it.
    judged = validation.train if held_out is None or held_out.left <= rules.QUIET * floor else held_out
    most = most_missed(shown)
    left = float(np.sqrt(max(min(judged.left, judged.gap.extended) ** 2 - floor**2, 0.0)))
    share = left**2 / max(judged.gap.baseline**2 - floor**2, left**2, 1e-30)
    shares = predicted(validation, confirming=judged is held_out)
    over = [name for name in sorted(shares, key=lambda name: -shares[name]) if shares[name] > rules.DEPENDS]
    problem = shown.problem
    where = described(extent(problem.records[most], shown.residuals()[most], problem.splits[most].used, floor))
    place = "" if where["text"] == EVERYWHERE else f", most of it {where['text']}"
    depends = "it depends on none of position, velocity, time and load alone"
    if over:
        parts = [f"{name} ({100 * shares[name]:.0f} %)" for name in over[:SAID]]
        depends = f"it follows {' and '.join(parts)} on data that it was not fitted to"
    if validation.kind:
        depends = like(validation.kind, validation.kind_leaves)
    text = f"{left:.2g} N rms over the noise{place}, {100 * share:.0f} % of the gap; {depends}"
    laws = [law for law in validation.outcome.calibration.preparation.laws if law.unexplained]
    law_gap = {"law_gap": max(float(np.std(law.gap)) for law in laws)} if laws else {}
    kind_leaves = {"kind_leaves": validation.kind_leaves} if validation.kind else {}
    if laws:
        text += f", and {rounded(law_gap['law_gap'])} V rms {FROM_THE_LAW}"
    return {
        **law_gap,
        **kind_leaves,
        "rms": left,
        "share": share,
        "over": over,
        "predicted": shares,
        **where,
        "text": text,
        "place": where["text"],
        "kind": validation.kind,
        "record": "train" if shown is validation.extended else "holdout",
        "map": force_map(missing_force(shown)[most]),
    }


def like(kind: str, leaves: float) -> str:
    """What is left is of a ``kind`` of unknown force, which ``leaves`` [N] of it and of the noise.

    >>> like("friction that remembers the motion before", 0.5)
    'it is like friction that remembers the motion before, with which 0.50 N would be left'
    """
    return f"it is like {kind}, with which {rounded(leaves)} N would be left"


def _where_it_shows(validation: Validation) -> Hypothesis:
    """The extended model on the training records, or on the confirming data where those leave nothing but noise."""
    data, held_out = validation.outcome.calibration.preparation.held_out, validation.held_out
    if data is None or held_out is None or not validation.training_is_quiet:
        return validation.extended
    return Hypothesis(data.problem, held_out.extended)


def predicted(validation: Validation, confirming: bool = True) -> dict[str, float]:
    """Share of the missing force's mean square that each variable predicts on samples it was not fitted to.

    Fitted to the training records and judged on the ``confirming`` one; without one, on the selecting strokes.
    """
    extended, data = validation.extended, validation.outcome.calibration.preparation.held_out
    seen = missing_force(extended)
    used, judged = (extended.problem.masks(part) for part in ("fit", "select"))
    known, new, there = seen, seen, judged
    if confirming and data is not None and validation.held_out is not None:
        used = extended.problem.masks("used")
        new = missing_force(Hypothesis(data.problem, validation.held_out.extended))
        there = data.problem.masks("used")
    return depends_on(known, used, new, there)


def depends_on(
    known: tuple[MissingForce, ...],
    used: tuple[np.ndarray, ...],
    new: tuple[MissingForce, ...],
    there: tuple[np.ndarray, ...],
) -> dict[str, float]:
    """Share of the force that is missing on ``new`` records, in the samples ``there``, that each variable predicts.

    Fitted to what is missing on the ``known`` ones in the samples ``used``, both (n,) bool of each record.
    """
    ranges = {name: _range(known, name) for name in VARIABLES}
    found = {}
    for name in VARIABLES:
        design, force = _design(known, used, name, ranges[name])
        others, wanted = _design(new, there, name, ranges[name])
        square = design.T @ design
        ridge = RIDGE * np.trace(square) / len(square) * np.eye(len(square))
        rest = wanted - others @ np.linalg.solve(square + ridge, design.T @ force)
        found[name] = max(0.0, 1.0 - float(rest @ rest) / max(float(wanted @ wanted), 1e-30))
    return found | {"frequency": _in_one_line(new, there)}


def _position(seen: MissingForce) -> np.ndarray:
    return seen.motion.q


def _speed(seen: MissingForce) -> np.ndarray:
    return np.abs(seen.motion.v)


def _time(seen: MissingForce) -> np.ndarray:
    return seen.motion.t - seen.motion.t[0]


def _load(seen: MissingForce) -> np.ndarray:
    return np.abs(seen.motion.tau)


def _since_reversal(seen: MissingForce) -> np.ndarray:
    """Logarithm of the samples since the last reversal: what memory of standing still fades with."""
    return np.log1p(since_reversal(seen.motion.v))


VARIABLES = {
    "position": _position,
    "velocity": _speed,
    "time": _time,
    "load": _load,
    "time since a reversal": _since_reversal,
}


def _range(seen: tuple[MissingForce, ...], name: str) -> tuple[float, float]:
    values = np.concatenate([VARIABLES[name](one) for one in seen])
    return float(values.min()), float(np.ptp(values)) or 1.0


def _design(
    seen: tuple[MissingForce, ...], masks: tuple[np.ndarray, ...], name: str, scale: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Polynomials of one variable for each direction of motion (n, k), and the missing force (n,) [N] beside them."""
    rows, force = [], []
    for one, mask in zip(seen, masks, strict=True):
        x = np.clip(2 * (VARIABLES[name](one) - scale[0]) / scale[1] - 1, -1, 1)
        columns, direction = chebvander(x, DEGREE), np.tanh(one.motion.v / SLOWEST)
        rows.append(np.column_stack([columns, columns * direction[:, None]])[mask])
        force.append((one.force - np.mean(one.force[mask]))[mask])
    return np.concatenate(rows), np.concatenate(force)


def _in_one_line(seen: tuple[MissingForce, ...], masks: tuple[np.ndarray, ...]) -> float:
    """Share of the missing force's mean square within a tenth of its strongest frequency that strokes do not have."""
    from scipy.signal import periodogram

    shares = []
    for one, mask in zip(seen, masks, strict=True):
        frequency, power = periodogram(np.where(mask, one.force, 0.0), 1 / one.motion.period)
        power[frequency < LOWEST_HZ] = 0.0
        top = frequency[np.argmax(power)]
        near = np.abs(frequency - top) < WIDTH * top
        whole = max(float(np.var(one.force[mask])) / max(frequency[1], 1e-12), 1e-30)
        shares.append(min(1.0, float(power[near].sum()) / whole))
    return float(np.mean(shares))
