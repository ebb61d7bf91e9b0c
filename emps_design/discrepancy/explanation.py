"""The last stage: from a validated outcome to a diagnosis with findings, views, tables and the next experiment.

A finding has the place where its effect acts, its parameters with standard deviations, and the gap with and without it.
The force of an effect has no noise: it is the missing force of the model without the effect on a simulation with it.
For effects not found, the result gives the smallest size that would have been a finding. Excited records are also
compared by their frequency response.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import BASELINE, Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import force_rms
from emps_design.discrepancy.calibration import Outcome
from emps_design.discrepancy.closest import Closest
from emps_design.discrepancy.confirmation import deviation_in_time
from emps_design.discrepancy.experiment import NextExperiment, experiment, what_to_record
from emps_design.discrepancy.fit import Fit, fit
from emps_design.discrepancy.gap import record_of_largest_residual
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.placement import Extent, Placement, extent, placement, where_document
from emps_design.discrepancy.preparation import Preparation, command_of
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.residual_views import SPECTRAL, View, shown, spectrum_over_time, views
from emps_design.discrepancy.result import Diagnosis, Finding
from emps_design.discrepancy.starts import Start, Tangent, tangent
from emps_design.discrepancy.unexplained import (
    ASSUMPTIONS,
    calibration_in_words,
    earlier_instants,
    unexplained,
    warnings,
)
from emps_design.discrepancy.unknown_force import MissingForce, missing_force
from emps_design.discrepancy.verdict import Validation, wrong_numbers
from emps_design.discrepancy.words import changed, filled, label_of
from emps_design.effects import Effect, Parameter, kind_of
from emps_design.effects.effect import COULOMB, OFFSET
from emps_design.errors import RecordError, SimulationError
from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.coupling import ResponseComparison
from emps_design.identification.model import LUMP
from emps_design.messages import Message
from emps_design.quantities import inside
from emps_design.records import Record
from emps_design.units import Units

HIDDEN = "any size: these records do not excite it"
NO_START = "not tested: these records give no starting values for it"
UNDETERMINED = {"value": None, "std": None}
# The quantity of the view for each coordinate of an extent.
_OVER = {"reversals": "time from reversal", "speed": "velocity", "position": "position", "time": "time"}


def contribution(hypothesis: Hypothesis, index: int, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Force (n,) [N] of effect ``index`` on record ``number``, and the samples (n,) bool to evaluate.

    The force is the missing force of the model without the effect on a simulation with it; its median is removed,
    because a constant force belongs to the baseline. For an effect of the controller, which the loop counteracts, it is
    the force of the added voltage. Reversals are excluded if the effect also acts elsewhere. Raises
    :class:`SimulationError` if the model cannot be simulated without the effect.
    """
    alone = hypothesis.only(number)
    problem, model = alone.problem, alone.model
    record, used = problem.records[0], problem.splits[0].used
    effect, values = model.effects[index], model.values[index][0]
    if effect.channel == "controller":
        return problem.axis.drive.gain * command_of(effect, values, record), used
    run = alone.run(0)
    simulated = replace(problem, records=(replace(record, q=run.q, u=run.u),))
    missing = missing_force(Hypothesis(simulated, model.without(index)))[0]
    force = missing.force - np.median(missing.force[used])
    away = missing.away & used
    return force, away if np.sum(force[away] ** 2) > rules.PART * np.sum(force[used] ** 2) else used


def most_exercised(hypothesis: Hypothesis, index: int) -> int:
    """The record on which effect ``index`` of a model contributes most force."""
    records = range(len(hypothesis.problem.records))
    if len(records) == 1:
        return 0
    sizes = []
    for number in records:
        try:
            force, samples = contribution(hypothesis, index, number)
            sizes.append(float(np.std(force[samples])))
        except SimulationError:  # unstable without the effect, which is therefore essential here
            sizes.append(np.inf)
    return int(np.argmax(sizes))


def parameter_draws(fitted: Fit, index: int, seed: int = 0) -> list[Hypothesis]:
    """``rules.DRAWS`` models with the parameters of effect ``index`` drawn from their covariance."""
    places = [i for i, slot in enumerate(fitted.slots) if slot.effect == index]
    slots, model = tuple(fitted.slots[i] for i in places), fitted.model
    size = np.array([slot.magnitude for slot in slots])
    values, vectors = np.linalg.eigh(fitted.covariance[np.ix_(places, places)] / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    centre, normals = model.vector(slots), np.random.default_rng(seed).standard_normal((rules.DRAWS, len(places)))
    draws = [model.with_vector(slots, centre + root @ normal) for normal in normals] if places else []
    return [fitted.with_model(draw) for draw in draws]


def measured_response(records: Sequence[Record], axis: Axis) -> ResponseComparison | None:
    """Frequency response of the excited ``records`` and of ``axis``; None without enough excitation."""
    excited = [record for record in records if record.excitation is not None and np.ptp(record.excitation) > 0.0]
    if not excited:
        return None
    try:
        return estimate_response(excited, axis).comparison
    except RecordError:
        return None


def findings(validation: Validation) -> tuple[Finding, ...]:
    """The accepted effects in the order found, each with the force gap before and after it."""
    extended, outcome = validation.extended, validation.outcome
    model = extended.model
    steps = (*(step.model for step in outcome.path), model)
    order = dict.fromkeys(name for step in steps for name in step.names)
    return tuple(_finding(validation, model.names.index(name)) for name in order if name in model.names)


def _finding(validation: Validation, index: int) -> Finding:
    extended, outcome = validation.extended, validation.outcome
    record = most_exercised(extended, index)
    effect, values = extended.model.effects[index], extended.model.parameters(record)[index]
    without = _without(extended, index, outcome.path[0])
    parameters = {
        p.name: {
            "value": float(values[place]),
            "std": deviation(extended, outcome.best, index, place, record),
            "unit": p.unit,
            **_per_record(p, extended.model.values[index][:, place]),
        }
        for place, p in enumerate(effect.parameters)
    }
    return Finding(
        effect=kind_of(effect.name),
        label=effect.label,
        channel=effect.channel,
        where=_where(extended, index, record, rules.SOME * outcome.floor.force),
        parameters=parameters,
        p_value=outcome.healthy.p_value(without.cost - extended.cost),
        gap_before=force_rms(without),
        gap_after=force_rms(extended),
        confirmed=validation.confirmed.get(effect.name),
        equivalents=tuple(dict.fromkeys(map(kind_of, validation.equivalents.get(effect.name, ())))),
        remedy=effect.words.remedy,
        note="; ".join([_note(outcome.preparation, effect.channel, record), *earlier_instants(validation, index)]),
    )


def deviation(fitted: Fit, before: Fit, index: int, place: int, record: int = 0) -> float:
    """Standard deviation of a parameter of ``fitted`` on ``record``; of the baseline with ``index`` -1.

    For an instant it covers all instants of equal cost. Otherwise it is at least the change from ``before``, the fit of
    the same effects to the fitting strokes alone: if backlash bounces, the sensitivity to a small change does not show
    how well the record determines a parameter.
    """
    linear, in_time = fitted.std(index, place, record), deviation_in_time(fitted, index, place, record)
    if in_time > 0.0:
        return max(linear, in_time)
    if linear == 0.0 or fitted.model.names != before.model.names:
        return linear
    now, then = (fit.model.baseline if index < 0 else fit.model.parameters(record)[index] for fit in (fitted, before))
    return max(linear, abs(float(now[place] - then[place])))


def _per_record(parameter: Parameter, values: np.ndarray) -> dict[str, Any]:
    """Entries of a parameter with a value per record: the flag, and the values where they differ."""
    entry: dict[str, Any] = {"per_record": True} if parameter.per_record else {}
    return entry | ({"values": values.tolist()} if np.ptp(values) > 0 else {})


def _without(extended: Fit, index: int, first: Fit) -> Fit:
    """The model without effect ``index``, refitted: the reference for the gain of the effect.

    The effect may have moved a baseline parameter far from its value in the ``first`` model. Both baselines are tried,
    and the one with the lower cost after one step is fitted further.
    """
    rest = extended.model.without(index)
    begins = (rest, replace(rest, baseline=first.model.baseline))
    trials = side_by_side(fit, [(extended.with_model(begin), "used", None, 1) for begin in begins])
    runs = [fitted for fitted in trials if fitted.innovations]
    if not runs:  # cannot be simulated without the effect: compare with the baseline
        return first
    return fit(min(runs, key=lambda fitted: fitted.cost), "used", steps=rules.FEW_STEPS)


def _where(fitted: Fit, index: int, number: int, least: float) -> dict[str, Any]:
    """The contract's ``where`` of effect ``index`` on record ``number``, with confidence from drawn parameters.

    Regions are tested for a missing force above ``least`` [N] of the model without the effect, except for effects of
    the controller, which the loop counteracts.
    """
    record, placed = fitted.problem.records[number], None
    if fitted.model.effects[index].channel != "controller":
        placed = Placement()
        with suppress(SimulationError):
            placed = placement(fitted.with_model(fitted.model.without(index)), number, least)

    def extent_of(hypothesis: Hypothesis) -> Extent | None:
        try:
            return extent(record, *contribution(hypothesis, index, number))
        except SimulationError:
            return None  # parameters that make the model unstable do not describe this machine

    extents = side_by_side(extent_of, [(hypothesis,) for hypothesis in (fitted, *parameter_draws(fitted, index))])
    regions = [region for region in extents if region is not None]
    if not regions:  # cannot be simulated without the effect: it acts wherever the model moves
        regions.append(extent(record, fitted.run(number).force, fitted.problem.splits[number].used))
    where = where_document(regions[0], fitted.problem.axis.units, regions[1:], placed)
    return where if len(fitted.problem.records) == 1 else {**where, "record": record.name}


def _note(preparation: Preparation, channel: str, record: int) -> str:
    if channel != "controller":
        alone = len(preparation.start.problem.records) == 1
        whose = "training record" if alone else "training records together"
        return f"gap of the {whose}, with the other effects refitted"
    units = preparation.start.problem.axis.units
    noise = units.quantity(preparation.laws[record].noise, "mV", ".2g")
    return f"seen in u minus the controller's law, noise {noise}; the {units.word('force')} balance does not change"


def not_excluded(search: Outcome, named: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each effect not in ``named``: the smallest size that would have been found, or None."""
    baseline = search.baseline
    gain = max(search.healthy.threshold, rules.WORTH_AT_FLOOR * baseline.problem.samples("fit"))
    least = rules.SOME * search.floor.force
    absorbed, screened = tangent(baseline), {s[0].model.names[-1]: s for s in search.screened}

    def row(effect: Effect) -> dict[str, Any]:
        starts, side = screened.get(effect.name, ()), "or more"
        if not starts:
            parameter, size, text = effect.parameters[0], None, NO_START
        elif effect.linear:
            parameter, size = _by_amplitude(starts, gain, least)
        else:
            parameter, size, grows = _by_shape(baseline, absorbed, starts, gain)
            side = "or less" if grows else "or more"
        if starts:
            text = HIDDEN if size is None else f"{_rounded(parameter, size, baseline.problem.axis.units)} {side}"
        return {"effect": effect.name, "label": effect.label, "size": size, "unit": parameter.unit, "text": text}

    library = search.preparation.library
    absent = [effect for effect in library if effect.name not in named and not effect.search.after]
    slowest_first = sorted(absent, key=lambda effect: bool(effect.linear))  # those that need simulations
    rows = {entry["effect"]: entry for entry in side_by_side(row, [(effect,) for effect in slowest_first])}
    return [rows[effect.name] for effect in absent]


def _rounded(parameter: Parameter, size: float, units: Units) -> str:
    unit, factor = units.readable(size, parameter.unit)
    name = units.words(parameter.name.replace("_", " "))
    return f"{name} {float(f'{size * factor:.2g}'):g} {unit}".rstrip()


def least_visible(rows: Sequence[Mapping[str, Any]]) -> str | None:
    """The largest force in ``rows`` that may be present undetected, for a sentence; None if no row is a force."""
    bounded = [row for row in rows if row["size"] is not None and row["unit"] == "N"]
    if not bounded:
        return None
    row = max(bounded, key=lambda row: row["size"])
    return f"{row['text'].removesuffix(' or more')} ({inside(row['label'])})"


def _by_amplitude(starts: Sequence[Start], gain: float, least: float) -> tuple[Parameter, float | None]:
    """Detectable amplitude of an effect that is linear in it, by its signatures; of a force at least ``least`` [N]."""
    effect = starts[0].model.effects[-1]
    place = [p.name for p in effect.parameters].index(effect.linear[0])
    parameter = effect.parameters[place]
    amplitudes = [float(np.abs(s.model.values[-1][:, place]).max() * np.sqrt(gain) / s.size) for s in starts]
    # Some shapes are not excited, such as an event at the end of the record, or a speed that it does not reach.
    most = min(rules.FAR * parameter.scale if parameter.scale else np.inf, parameter.upper)
    plausible = [
        amplitude
        for amplitude, start in zip(amplitudes, starts, strict=True)
        if max(amplitude, float(np.abs(start.model.values[-1][:, place]).max())) <= most
    ]
    if not plausible:
        return parameter, None
    size = float(np.median(plausible))
    return parameter, max(size, least) if parameter.unit == "N" else size


def _by_shape(
    baseline: Fit, absorbed: Tangent, starts: Sequence[Start], gain: float
) -> tuple[Parameter, float | None, bool]:
    """Smallest detectable first parameter of an effect without an amplitude, by bisection from the weakest shape found.

    Compared with the limit in which the effect vanishes, which may be another effect: backlash without its gap is an
    elastic coupling. Also returns whether the effect vanishes as the parameter grows, as with a stiffness.
    """
    effect = starts[0].model.effects[-1]
    parameter = effect.parameters[0]
    visible = [start for start in starts if start.size**2 >= gain]
    if not visible:
        return parameter, None, False
    faintest = min(visible, key=lambda start: start.size).model.values[-1]

    def innovations(value: float) -> np.ndarray:
        values = faintest.copy()
        values[:, 0] = value
        return baseline.with_model(baseline.model.with_effect(effect, values)).residual("fit")

    def apart(signal: np.ndarray, other: np.ndarray) -> float:
        return float(np.sum(absorbed.free(signal - other) ** 2))

    value = float(faintest[0, 0])
    try:
        ends = [min(max(value * factor, parameter.lower), parameter.upper) for factor in (rules.FAR, 1 / rules.FAR)]
        there = [innovations(end) for end in ends]
        grows = apart(there[0], absorbed.whole) < apart(there[1], absorbed.whole)
        unseen, faded = ends[not grows], there[not grows]
        if apart(innovations(value), faded) < gain:
            return parameter, None, grows
        while max(value, unseen) > rules.CLOSE * min(value, unseen):
            middle = float(np.sqrt(value * unseen))
            value, unseen = (middle, unseen) if apart(innovations(middle), faded) >= gain else (value, middle)
    except SimulationError:
        return parameter, None, False
    return parameter, value, grows


def explain(validation: Validation, rest: tuple[Message, ...] = (), closest: Closest | None = None) -> Diagnosis:
    """The diagnosis of a validation: what is missing and where, how much of the gap is closed, what to record next.

    ``rest`` are warnings about data not searched; ``closest`` is the closest model, if requested.
    """
    outcome, problem = validation.outcome, validation.extended.problem
    held_out = outcome.preparation.held_out
    judged = validation.held_out or validation.train
    most = record_of_largest_residual(validation.baseline)
    before, after = (missing_force(fitted)[most] for fitted in (validation.baseline, validation.extended))
    floor, used = outcome.floor, problem.splits[most].used
    details, named, drawn = side_by_side(  # the longest first
        lambda work, *arguments: work(*arguments),
        [
            (_details, validation, before),
            (findings, validation),
            (views, before, after, used, floor.force_60hz, problem.axis),
        ],
    )
    details["warnings"] += rest
    details["rest"] = rest
    extended = judged.extended.to_axis(problem.axis)
    return Diagnosis(
        verdict=validation.verdict,
        findings=named,
        axis=extended,
        noise=floor,
        train=validation.train.gap,
        holdout=None if validation.held_out is None else validation.held_out.gap,
        trace=replace(judged.prediction, window=None if held_out is None else held_out.window),
        views=with_marks(drawn, named),
        details=details,
        experiment=_experiment(validation, details.get("unexplained")),
        response=measured_response(outcome.preparation.records, extended),
        closest=closest,
    )


def _experiment(validation: Validation, rest: dict[str, Any] | None) -> NextExperiment | None:
    """What to record next: to explain the ``rest``, or to separate equivalents where they are too many."""
    outcome, extended = validation.outcome, validation.extended
    too_many = any(len(others) > rules.MOST_EQUIVALENTS for others in validation.equivalents.values())
    if rest is not None and not too_many and not outcome.interrupted:
        return what_to_record(extended, rest["over"])
    return experiment(outcome, extended.model.names, validation.equivalents)


def with_marks(drawn: list[View], named: tuple[Finding, ...]) -> tuple[View, ...]:
    """The views ``drawn`` with the extents of the findings marked; the one that locates the first finding comes first.

    If the first finding acts everywhere, the view that shows most of the gap comes first.
    """
    pictures = []
    for view in drawn:
        marks: list[Any] = []
        for finding in named:
            place = finding.where.get(view.quantity)
            if place is not None and view.quantity not in SPECTRAL:
                marks += map(tuple, place if view.quantity == "time" else [place])
        pictures.append(replace(view, marks=tuple(marks)))
    head, tail = pictures[:-1], pictures[-1:]
    coordinate = _OVER.get(named[0].where["place"]) if named else None
    head.sort(key=lambda view: (not (view.quantity == coordinate and shown(view) > 0.0), -shown(view)))
    return (*head, *tail)


def _details(validation: Validation, missing: MissingForce) -> dict[str, Any]:
    """Further entries of the document; ``missing`` is the baseline's missing force on the record shown."""
    outcome, baseline, extended = validation.outcome, validation.baseline, validation.extended
    axis = extended.problem.axis
    unseen = not_excluded(outcome, extended.model.names)
    shown: dict[str, Any] = {
        "simulation": "inverse model" if extended.problem.follows else "closed loop",
        "candidates": _candidates(validation),
        "parameters": _parameters(validation),
        "not_excluded": [{**row, "unit": axis.units.unit(row["unit"])} for row in unseen],
        "records": _records(validation),
        "held_out": outcome.preparation.hold_out.to_dict(),
        "calibration": calibration_in_words(outcome),
        "assumptions": [filled(text, axis.units) for text in ASSUMPTIONS],
        "warnings": warnings(validation),
    }
    if validation.verdict in ("nothing-missing", "parameters-only"):
        shown["least_visible"] = least_visible(unseen)
    if validation.verdict == "parameters-only":
        numbers = baseline.model.baseline
        shown["changed"] = changed(axis.mechanics.array(), numbers, wrong_numbers(baseline), axis.units)
    shown["spectrum_over_time"] = spectrum_over_time(missing, axis.units)
    shown["interrupted"] = outcome.interrupted
    if validation.verdict in ("unnamed", "partly-named"):
        shown["unexplained"] = unexplained(validation)
    return shown


def _records(validation: Validation) -> list[dict[str, Any]]:
    preparation = validation.outcome.preparation
    roles = [(record, "train") for record in preparation.records]
    held_out = preparation.held_out
    if held_out is not None and held_out.window is None:
        roles.append((held_out.problem.records[0], "holdout"))
    return [{"name": record.name, "role": role, "sha256": record.sha256} for record, role in roles]


def _candidates(validation: Validation, shown: int = 10) -> list[dict[str, Any]]:
    """Rows of the first ``shown`` effects by the gain of each alone on top of the baseline."""
    outcome = validation.outcome
    base, to_beat = outcome.path[0], outcome.judge.to_beat(outcome.path[0])
    ranked = sorted(outcome.alone.items(), key=lambda pair: -pair[1])
    rows = []
    for name, gain in ranked[:shown]:
        full = outcome.tried.get(frozenset((*base.model.names, name)))
        rows.append(
            {
                "effect": name,
                "label": label_of(name, base.problem.axis.units),
                "gap": None if full is None else force_rms(full),
                "statistic": gain if full is None else base.cost_fit - full.cost_fit,
                "threshold": to_beat,
                "accepted": name in validation.extended.model.names,
                "note": "first estimate only: too poor for a full fit, or fitted with implausible parameters"
                if full is None
                else "the only effect on top of the baseline",
            }
        )
    return rows


def _parameters(validation: Validation) -> dict[str, Any]:
    """Baseline parameters: of the axis file, fitted alone, and fitted with the effects; None if not determined."""
    direction = validation.outcome.preparation.direction
    axis = validation.extended.problem.axis
    axis_numbers = axis.mechanics.array()
    pairs = {
        "baseline": (validation.baseline, validation.outcome.path[0]),
        "extended": (validation.extended, validation.outcome.best),
    }

    def entry(unit: str, weights: np.ndarray) -> dict[str, Any]:
        """The entry of the baseline parameters' sum with ``weights`` (4,); deviation of the first."""
        place = int(np.flatnonzero(weights)[0])
        fitted = {
            name: {"value": float(now.model.baseline @ weights), "std": deviation(now, before, -1, place)}
            for name, (now, before) in pairs.items()
        }
        return {"unit": axis.units.unit(unit), "axis": float(axis_numbers @ weights), **fitted}

    every = np.eye(len(BASELINE))
    table = {quantity.name: entry(quantity.unit, row) for quantity, row in zip(BASELINE, every, strict=True)}
    if direction:
        for place in (COULOMB, OFFSET):
            table[BASELINE[place].name] |= dict.fromkeys(pairs, UNDETERMINED)
        table[LUMP.name] = entry(LUMP.unit, every[COULOMB] + direction * every[OFFSET])
    return table
