"""The unexplained residual: its size, and the variables that predict it on held-out data. Warnings of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import force_rms
from emps_design.discrepancy.calibration import Outcome
from emps_design.discrepancy.confirmation import Share
from emps_design.discrepancy.gap import record_of_largest_residual
from emps_design.discrepancy.placement import EVERYWHERE, extent, placement, where_document
from emps_design.discrepancy.preparation import HeldOut
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.residual_views import force_map
from emps_design.discrepancy.unknown_force import MissingForce, missing_force, since_reversal, slowest
from emps_design.discrepancy.verdict import Validation
from emps_design.discrepancy.words import filled, listed
from emps_design.messages import Message, note, warning
from emps_design.quantities import rounded, share_asked
from emps_design.units import Units

GAIN_KNOWN = (
    "the {force} gain of the drive is known: an error in it scales all mechanical parameters and has no other effect"
)
ONE_FORCE = (
    "a Coulomb asymmetry and a constant {force} cannot be separated in any record, and both count as constant {force} "
    "here"
)
ASSUMPTIONS = (GAIN_KNOWN, "the drive holds each {voltage} over the period that follows its sample", ONE_FORCE)
FOLLOWED = (
    "the controller is unknown: the models follow the recorded motion and {voltage}, and a disturbance added by the "
    "controller cannot be detected"
)


def calibration_in_words(search: Outcome) -> str:
    """The gain in whitened cost that a finding needs, and how it was found, as text."""
    healthy, runs = search.healthy, search.healthy.largest.size
    level = max(rules.LEVEL, 1 / (runs + 1))
    origin = f"{runs} simulated healthy records, each searched like this one"
    if not healthy.searched:
        origin = f"{runs} healthy references made of resampled noise"
    return (
        f"A finding must reduce the whitened cost by more than {healthy.threshold:.1f}, which the best candidate "
        f"reaches in {100 * level:.2g} % of {origin}, and by more than {100 * rules.WORTH:g} % "
        f"({100 * rules.WORTH_AT_FLOOR:g} % where only noise is left); the noise is {search.floor.source}."
    )


def warnings(validation: Validation) -> list[Message]:
    """Messages about everything that limits the verdict."""
    preparation = validation.outcome.preparation
    remarks = [*preparation.warnings, *validation.outcome.warnings, *_limits(validation)]
    if preparation.held_out is not None:
        remarks += _of_holdout(validation, preparation.held_out)
    for index, effect in enumerate(validation.extended.model.effects):
        remarks += [message.of(effect.label) for message in earlier_instants(validation, index)]
    units = validation.extended.problem.axis.units
    given_up = listed(validation.given_up, units)
    if validation.in_free_run:
        before, after = (units.quantity(error, "m/s", rounded) for error in validation.in_free_run)
        text = (
            f"a model with {given_up} follows the record, but driven by the recorded command alone its velocity error "
            f"is {after} rms, more than the {before} without: it is rejected"
        )
        remarks.append(warning("misses-in-free-run", text, effects=validation.given_up))
    elif validation.given_up:
        text = (
            f"a model with {given_up} explains {100 * validation.share:.0f} % of the gap and is rejected: this is too "
            "little, or not on both records, or too many other effects explain as much"
        )
        remarks.append(warning("does-not-stand", text, effects=validation.given_up, share=validation.share))
    return remarks


def earlier_instants(validation: Validation, index: int) -> list[Message]:
    """Messages about instants of effect ``index`` that are earlier in the held-out part than in the fitted part.

    Per-record parameters were fitted again on the held-out part; the new values are used only if clearly better.
    """
    choice, held_out = validation.outcome.preparation.hold_out, validation.held_out
    effect = validation.extended.model.effects[index]
    if choice.chosen != "kept" or choice.time is None or held_out is None or effect.name not in held_out.extended.names:
        return []
    start, stop = choice.time
    now, there = (m.values[m.names.index(effect.name)][0] for m in (validation.extended.model, held_out.extended))
    return [
        warning(
            "earlier-instant",
            f"{p.name} is the first one in the fitted data; in {choice.what}, held out, it is at "
            f"{there[place]:.4g} {p.unit}",
            parameter=p.name,
            time=float(there[place]),
        )
        for place, p in enumerate(effect.parameters)
        if p.per_record and p.unit == "s" and start <= there[place] < stop <= now[place]
    ]


def _limits(validation: Validation) -> list[Message]:
    outcome, extended = validation.outcome, validation.extended
    floor, units = outcome.floor, extended.problem.axis.units
    remarks = [warning("follows-motion", filled(FOLLOWED, units))] if extended.problem.follows else []
    residual = units.quantity(force_rms(extended), "N", rounded)
    if not floor.from_laps:
        text = (
            f"the noise is {floor.source}, not the difference between laps: an effect outside the library that differs "
            "from stroke to stroke would be taken for noise"
        )
        remarks.append(warning("noise-without-laps", text))
    if validation.verdict in ("named", "ambiguous") and outcome.judge.leaves_structure(extended):
        text = (
            f"structure remains after the last finding: residual {residual}, noise "
            f"{units.quantity(floor.force, 'N', rounded)}; no further effect of the library is clear enough to name"
        )
        remarks.append(warning("structure-remains", text, noise=floor.force))
    if validation.verdict == "unnamed":
        least = units.quantity(force_rms(validation.outcome.path[0]), "N", rounded)
        text = (
            f"{units.word('mass')} and friction are estimated robustly, so that the unexplained structure biases them "
            f"little: the residual is {residual}, and {least} with ordinary least squares"
        )
        remarks.append(warning("robust-estimates", text))
    if outcome.preparation.unexplained_law:
        text = "the command differs from the controller's law, and no effect explains it: treated as a known input"
        remarks.append(warning("law-gap", text))
    return remarks


def _of_holdout(validation: Validation, held_out: HeldOut) -> list[Message]:
    units = validation.extended.problem.axis.units
    remarks = []
    for refuted in validation.refuted:
        text = (
            f"{listed([refuted.name], units)} is withdrawn: it fits the training record, but the held-out record needs "
            f"{_amount(refuted)} of it"
        )
        remarks.append(warning("effect-withdrawn", text, effect=refuted.name, share=refuted.share, std=refuted.std))
    if held_out.added not in ("", *validation.extended.model.names):
        seen = f"{listed([held_out.added], units)} on the held-out record, seen in its {units.word('voltage')}"
        text = f"{seen}: a known input of both models there"
        remarks.append(warning("effect-of-confirming-record", text, effect=held_out.added))
    elif held_out.law is not None and held_out.law.unexplained:
        text = "the command of the held-out record differs from the controller's law too: treated as a known input"
        remarks.append(warning("law-gap-on-confirming-record", text))
    if validation.held_out is not None and validation.held_out.refitted:
        names = ", ".join(validation.held_out.refitted)
        text = f"fitted again on the held-out record, because they differ from record to record: {names}"
        remarks.append(note("fitted-anew", text, parameters=validation.held_out.refitted))
    return remarks


def _amount(share: Share) -> str:
    """The share of a withdrawn effect as text: the refuted one, or the mean of all weightings."""
    confirmed = None if share.refuted else share.confirmed
    return share_asked(share.share, share.std) if confirmed is None else share_asked(**confirmed)


def unexplained(validation: Validation) -> dict[str, Any]:
    """The contract's ``unexplained`` of a validation whose residual has structure.

    ``rms`` [N] is the residual above the noise, ``share`` its part of the gap's mean square; ``over`` are the variables
    that predict it on held-out data, best first, and ``predicted`` the share of each. ``record`` is where it shows:
    "train", or "holdout" if the residual of the training data is noise. ``kind`` is the kind of unknown force that
    explains it, "" if unknown, and ``kind_leaves`` [N] the residual with it, noise included. ``law_gap`` [V] is the
    unexplained difference between the command and the controller's law.
    """
    floor, held_out = validation.outcome.floor.force, validation.held_out
    shown = _where_it_shows(validation)
    # Held-out data without the cause, such as a push that occurs in training only, say nothing about it.
    judged = validation.train if held_out is None or held_out.remaining_force <= rules.QUIET * floor else held_out
    most = record_of_largest_residual(shown)
    remaining = float(np.sqrt(max(min(judged.remaining_force, judged.gap.extended) ** 2 - floor**2, 0.0)))
    share = remaining**2 / max(judged.gap.baseline**2 - floor**2, remaining**2, 1e-30)
    shares = predicted(validation, confirming=judged is held_out)
    over, depends = follows(shares)
    problem, units = shown.problem, shown.problem.axis.units
    region = extent(problem.records[most], shown.residuals()[most], problem.splits[most].used, floor)
    where = where_document(region, units, shown=placement(shown, most, rules.SOME * floor))
    place = most_of_it(where)
    if validation.kind:
        depends = like(validation.kind, validation.kind_leaves, units)
    text = (
        f"{units.quantity(remaining, 'N', '.2g')} rms over the noise{place}, {100 * share:.0f} % of the gap; {depends}"
    )
    laws = [law for law in validation.outcome.preparation.laws if law.unexplained]
    law_gap = {"law_gap": max(float(np.std(law.gap)) for law in laws)} if laws else {}
    kind_leaves = {"kind_leaves": validation.kind_leaves} if validation.kind else {}
    if laws:
        difference = units.quantity(law_gap["law_gap"], "V", rounded)
        text += f"; the command differs from the controller's law by {difference} rms"
    return {
        **law_gap,
        **kind_leaves,
        "rms": remaining,
        "share": share,
        "over": over,
        "predicted": shares,
        **where,
        "text": text,
        "place": where["text"],
        "kind": validation.kind,
        "record": "train" if shown is validation.extended else "holdout",
        "map": force_map(missing_force(shown)[most], units),
    }


def most_of_it(where: Mapping[str, Any]) -> str:
    """The place of a residual in ``where``, to continue a sentence; empty if it is everywhere."""
    return "" if where["text"] == EVERYWHERE else f", most of it {where['text']}"


def follows(predicted: Mapping[str, float]) -> tuple[list[str], str]:
    """The variables that predict more than ``rules.PART`` of the residual, best first, and a clause that names them.

    >>> follows({"position": 0.1, "time": 0.5})
    (['time'], 'on held-out data it follows time (50 %)')
    """
    over = [name for name in sorted(predicted, key=lambda name: -predicted[name]) if predicted[name] > rules.PART]
    if not over:
        return over, "it depends on none of position, velocity, time and load alone"
    parts = [f"{name} ({100 * predicted[name]:.0f} %)" for name in over[: rules.FEW]]
    return over, f"on held-out data it follows {' and '.join(parts)}"


def like(kind: str, leaves: float, units: Units) -> str:
    """Text for a residual that an unknown force of a ``kind`` reduces to ``leaves`` [N], noise included.

    >>> like("friction that depends on the past motion", 0.5, Units())
    'it is like friction that depends on the past motion, with which the residual is 0.50 N'
    """
    return f"it is like {kind}, with which the residual is {units.quantity(leaves, 'N', rounded)}"


def _where_it_shows(validation: Validation) -> Hypothesis:
    """The extended model on the training records, or on the held-out data if only those show more than noise."""
    data, held_out = validation.outcome.preparation.held_out, validation.held_out
    if data is None or held_out is None or not validation.training_is_quiet:
        return validation.extended
    return Hypothesis(data.problem.with_whitening(validation.extended.problem.whitening), held_out.extended)


def predicted(validation: Validation, confirming: bool = True) -> dict[str, float]:
    """Share of the missing force's mean square that each variable predicts on samples not fitted.

    Fitted to the training records and judged on the held-out data, or with ``confirming`` False on selecting strokes.
    """
    extended, data = validation.extended, validation.outcome.preparation.held_out
    missing = missing_force(extended)
    used, judged = (extended.problem.masks(part) for part in ("fit", "select"))
    known, new, there = missing, missing, judged
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
    """Share of the missing force on ``new`` records, in the samples ``there``, that each variable predicts.

    Fitted to the missing force on the ``known`` ones in the samples ``used``; both masks (n,) bool per record.
    """
    ranges = {name: _range(known, name) for name in VARIABLES}
    shares = {}
    for name in VARIABLES:
        design, force = _design(known, used, name, ranges[name])
        others, there_columns = _design(new, there, name, ranges[name])
        square = design.T @ design
        ridge = rules.NOTHING * np.trace(square) / len(square) * np.eye(len(square))
        rest = there_columns - others @ np.linalg.solve(square + ridge, design.T @ force)
        shares[name] = max(0.0, 1.0 - float(rest @ rest) / max(float(there_columns @ there_columns), 1e-30))
    return shares | {"frequency": _in_one_line(new, there)}


VARIABLES: dict[str, Callable[[MissingForce], np.ndarray]] = {  # signals (n,) along a record
    "position": lambda missing: missing.motion.q,
    "velocity": lambda missing: np.abs(missing.motion.v),
    "time": lambda missing: missing.motion.t - missing.motion.t[0],
    "load": lambda missing: np.abs(missing.motion.tau),
    # Memory of standstill fades with the logarithm of the time since the last reversal.
    "time since a reversal": lambda missing: np.log1p(since_reversal(missing.motion.v)),
}


def _range(missing: tuple[MissingForce, ...], name: str) -> tuple[float, float]:
    values = np.concatenate([VARIABLES[name](gap) for gap in missing])
    return float(values.min()), float(np.ptp(values)) or 1.0


def _design(
    missing: tuple[MissingForce, ...], masks: tuple[np.ndarray, ...], name: str, scale: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Polynomials of one variable for each direction of motion (n, k), and the missing force (n,) [N] beside them."""
    rows, force = [], []
    for gap, mask in zip(missing, masks, strict=True):
        x = np.clip(2 * (VARIABLES[name](gap) - scale[0]) / scale[1] - 1, -1, 1)
        columns, direction = chebvander(x, 2 * rules.DEGREE), np.tanh(gap.motion.v / slowest(gap.motion.v))
        rows.append(np.column_stack([columns, columns * direction[:, None]])[mask])
        force.append((gap.force - np.mean(gap.force[mask]))[mask])
    return np.concatenate(rows), np.concatenate(force)


def _in_one_line(missing: tuple[MissingForce, ...], masks: tuple[np.ndarray, ...]) -> float:
    """Share of the missing force's mean square within 10 % of its strongest frequency above that of the strokes."""
    from scipy.signal import periodogram

    shares = []
    for gap, mask in zip(missing, masks, strict=True):
        frequency, power = periodogram(np.where(mask, gap.force, 0.0), 1 / gap.motion.period)
        power[frequency < rules.LINES_HZ[0]] = 0.0
        top = frequency[np.argmax(power)]
        close = np.abs(frequency - top) < (1 - rules.NEARLY_ALL) * top
        whole = max(float(np.var(gap.force[mask])) / max(frequency[1], 1e-12), 1e-30)
        shares.append(min(1.0, float(power[close].sum()) / whole))
    return float(np.mean(shares))
