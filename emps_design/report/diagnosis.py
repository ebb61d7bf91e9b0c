"""The page of ``diagnose``: the result in plain words, places, before and after, candidates, remedies.

It includes a comparison of velocity loops designed on both models, and the experiment to record next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.advice import advise
from emps_design.axis import Axis, Mechanics
from emps_design.discrepancy.placement import EVERYWHERE
from emps_design.discrepancy.view import diagnosis_view
from emps_design.errors import EmpsError
from emps_design.figures import Axes, Curve, Grid, thin
from emps_design.report import diagnosis_sections as figures
from emps_design.report.diagnosis_sections import (
    candidates_section,
    closed_share,
    closest_section,
    findings_section,
    gap_section,
    in_plain_words,
    limits_section,
    method_section,
    model_file,
    parameters_section,
    unexplained_section,
    views_section,
)
from emps_design.report.loop_figures import response_section
from emps_design.report.page import (
    NOTHING,
    Facts,
    Line,
    Page,
    Picture,
    Section,
    Table,
    advice_line,
    angle,
    delay,
    html,
    number,
    quantity,
    ratio,
    words,
)
from emps_design.report.style import drawn
from emps_design.units import LINEAR, Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.discrepancy.result import Diagnosis

CROSSOVER, PHASE_MARGIN = 100.0, 60.0  # rad/s, deg: the specification of the paper's velocity loop

VERDICTS = {
    "named": ("warning", "The missing effects were identified"),
    "parameters-only": ("good", "Nothing is missing: only the parameters of the axis file are wrong"),
    "partly-named": ("warning", "Some of the missing effects were identified, but no effect explains the rest"),
    "nothing-missing": ("good", "Nothing is missing from the model"),
    "ambiguous": ("warning", "An effect is missing, but these data do not show which of several it is"),
    "unnamed": ("warning", "Something is missing that no effect of the library explains"),
}


SIMULATED = {
    "closed loop": "in closed loop from the reference alone",
    "inverse model": "as inverse models of the recorded motion",
}


def axis_before(extended: Axis, parameters: Mapping[str, Any]) -> Axis:
    """Return ``extended`` without the effects found, with the refitted baseline of ``parameters``."""
    numbers = extended.mechanics.parameters
    for name in numbers:
        refitted = parameters.get(name, {}).get("baseline")
        if refitted and refitted["value"] is not None:
            numbers[name] = refitted["value"]
    return extended.replace(effects=[], mechanics=Mechanics.table(list(numbers.values())))


def design_change(before: Axis, after: Axis) -> list[dict[str, Any]]:
    """Return rows {quantity, before, after, note} for the velocity loop on both axes, or one row with the error.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019")
    >>> rows = design_change(axis, axis.replace(mechanics={"mass": 100.0}))
    >>> rows[0]["quantity"], rows[0]["before"], rows[0]["after"]
    ('k_v1', '462.9 V/(m/s)', '487.0 V/(m/s)')
    """
    from emps_design.control.velocity.design import design_velocity_loop

    units = after.units
    try:
        old, new = (design_velocity_loop(axis, CROSSOVER, phase_margin_deg=PHASE_MARGIN) for axis in (before, after))
        expected, actual = old.sampled.margins, replace(old, axis=after).sampled.margins
        better = new.sampled.margins
    except EmpsError as error:
        return [_row("velocity loop", None, None, str(error))]
    specification = f"for {number(CROSSOVER, 3)} rad/s and {number(PHASE_MARGIN, 2)}°"
    rows = [
        _row("k_v1", quantity(old.k_v1, "V/(m/s)", 4, units), quantity(new.k_v1, "V/(m/s)", 4, units), specification),
        _row("t_v", quantity(old.t_v, "s"), quantity(new.t_v, "s"), specification),
    ]
    if not actual.stable:
        predicted = "stable" if expected.stable else "unstable"
        note = "designed on the original model, evaluated on the extended one"
        rows.append(_row("the old gains", predicted, "unstable", note))
    else:
        phases = angle(expected.phase_margin_deg), angle(actual.phase_margin_deg)
        note = "as designed, and on the extended model"
        rows.append(_row("phase margin of the old gains", *phases, note))
    if expected.stable and better.stable:
        for name, shown in (
            ("phase margin, sampled", lambda m: angle(m.phase_margin_deg)),
            ("delay margin, sampled", lambda m: delay(m.delay_margin, m.period)),
            ("gain margin, sampled", lambda m: ratio(m.gain_margin)),
        ):
            rows.append(_row(name, shown(expected), shown(better), "each with its own gains"))
    note = "in addition to the effects found" if after.effects else ""
    for name, key, unit in (
        ("Coulomb friction to compensate", "coulomb", "N"),
        ("viscous friction", "viscous", "N/(m/s)"),
    ):
        numbers = [quantity(getattr(axis.mechanics, key), unit, 4, units) for axis in (before, after)]
        rows.append(_row(name, numbers[0], numbers[1], note))
    return rows


def _row(quantity: str, before: str | None, after: str | None, note: str) -> dict[str, Any]:
    return {"quantity": quantity, "before": before, "after": after, "note": note}


def design_section(diagnosis: Diagnosis, document: Mapping[str, Any]) -> Section | None:
    """Return the section that compares the design on both models, or None without findings."""
    axis, parameters = getattr(diagnosis, "axis", None), document.get("parameters")
    if axis is None or not parameters or not document["findings"]:
        return None
    rows = design_change(axis_before(axis, parameters), axis)
    return Section(
        "Changes in the design",
        Table(
            ["quantity", "with the original model", "with the extended model", "remark"],
            [[row["quantity"], row["before"], row["after"], row["note"]] for row in rows],
            "The same specification, designed on both models.",
            missing=NOTHING,
        ),
    )


def experiment_section(chosen: Mapping[str, Any] | None, experiment: Any, units: Units) -> Section | None:
    """Return the section on ``chosen``, the ``experiment`` of the document, or None without one.

    ``experiment`` has the reference to draw, if any: ``t`` [s] (n,) and ``q_ref`` [m] (n,) or None.
    """
    if not chosen:
        return None
    blocks: list[Any] = []
    if getattr(experiment, "q_ref", None) is not None:
        blocks.append(
            Picture(
                reference_figure(experiment.t, experiment.q_ref),
                f"The reference of the experiment, {words(chosen['program'])}, {experiment.t[-1]:.0f} s. It starts and "
                "ends at rest at the first position of the record.",
                "What to record",
            )
        )
    if chosen.get("file"):
        blocks.append(
            Line(
                html(
                    "It is in <code>{}</code>, columns t [s] and q_ref [{}]. Try it first: "
                    "<code>emps-design simulate model.toml --reference {}</code>.",
                    chosen["file"],
                    units.unit("m"),
                    chosen["file"],
                )
            )
        )
    if chosen.get("menu"):
        between = " and ".join(words(name) for name in chosen["between"])
        blocks.append(
            Table(
                ["program", "motion", f"difference [{units.unit('N')} rms]", "difference [std of the noise]"],
                [
                    [words(row["program"]), row["text"], number(row["distance"]), number(row["over_noise"])]
                    for row in chosen["menu"]
                ],
                f"Difference of {between}, fitted to one another, on each program within the range of the records; "
                f"{quantity(chosen['needed'], '', 2)} standard deviations are needed.",
            )
        )
    return Section("What to record next", *blocks) if blocks else None


def reference_figure(t: np.ndarray, q_ref: np.ndarray) -> Figure:
    """Draw a reference: position [m] (n,) over ``t`` [s], and its velocity."""
    position = Curve(*thin(t, 1e3 * q_ref), width=1.3)
    velocity = Curve(*thin(t, 1e3 * np.gradient(q_ref, t)), width=0.9)
    return drawn(
        Grid.of(Axes((position,), "", "reference [mm]"), Axes((velocity,), "time [s]", "velocity [mm/s]"), height=3.6)
    )


def diagnosis_page(diagnosis: Diagnosis) -> Page:
    """Return the page of a diagnosis."""
    document = diagnosis.to_dict()
    findings, axis = document["findings"], getattr(diagnosis, "axis", None)
    units = LINEAR if axis is None else axis.units
    level, verdict = VERDICTS[document["verdict"]]
    summary: list[Any] = [
        advice_line(advise("diagnose", document, units=units)),
        Line(html("<b>{}.</b> {}", verdict, in_plain_words(document)), level),
        *diagnosis_view(document, units),
        *model_file(document),
    ]
    simulated = document.get("simulation", "closed loop")
    whole = document.get("held_out", {}).get("time") is None
    summary.append(_gap_facts(document["gap"], simulated, document.get("unexplained") or {}, whole, units))
    if diagnosis.views:
        summary.append(Picture(figures.where_figure(diagnosis), _where_caption(diagnosis, findings, units), "Where"))
    if diagnosis.trace is not None:
        summary.append(
            Picture(
                figures.before_after_figure(diagnosis),
                _trace_caption(diagnosis.trace.name, simulated, bool(findings), units),
                "Before and after",
            )
        )
    response = getattr(diagnosis, "response", None)
    sections = [
        findings_section(findings, units),
        unexplained_section(document, units),
        closest_section(document, units),
        experiment_section(document.get("experiment"), getattr(diagnosis, "experiment", None), units),
        parameters_section(document, units),
        gap_section(document, units),
        views_section(diagnosis, units),
        None if response is None else response_section(response),
        candidates_section(diagnosis, document.get("candidates", ()), units),
        limits_section(document),
        design_section(diagnosis, document),
        method_section(document, units),
    ]
    names = ", ".join(record["name"] for record in document.get("records", ()))
    return Page(
        "Where simulation and machine disagree",
        names,
        tuple(summary),
        tuple(section for section in sections if section is not None),
        units=units,
    )


def _where_caption(diagnosis: Diagnosis, findings: Sequence[Mapping[str, Any]], units: Units) -> str:
    view = diagnosis.views[0]
    texts = (f.get("where", {}).get("text") for f in findings)
    places = "; ".join(dict.fromkeys(text for text in texts if text and text != EVERYWHERE))
    where = f" The effects found act {places}." if places else ""
    models = ", before (original model, refitted) and after" if findings else " of the refitted model"
    return f"Residual {units.word('force')} over {view.quantity}{models}.{where}"


def _trace_caption(name: str, simulated: str, extended: bool, units: Units) -> str:
    models = "by two models" if extended else "by the refitted model"
    model = "the extended model" if extended else "the model"
    return (
        f"Record {name}: {units.word('force')} measured and simulated {models}, {SIMULATED[simulated]}. In the lower "
        f"picture the residual of {model} should look like noise."
    )


def _gap_facts(
    gap: Mapping[str, Any], simulated: str, unexplained: Mapping[str, Any], whole: bool, units: Units
) -> Facts:
    """Return the force error before and after, and with the unknown force if that is of one kind.

    ``whole``: the held-out data, if any, are a whole record.
    """
    held_out = gap.get("holdout")
    nothing_added = held_out and held_out["baseline"] == held_out["extended"]
    part = "holdout" if held_out and not (nothing_added and unexplained.get("record") == "train") else "train"
    values = gap[part]
    unit, force = gap.get("unit", "N"), units.word("force")
    word = f"{'held-out' if part == 'holdout' else 'training'} {'record' if whole else 'part'}"
    before, after, floor = values.get("baseline"), values.get("extended"), gap.get("floor")
    errors = [(f"{force} error before", before), (f"{force} error after", after)]
    if before == after:  # one model: nothing was added
        errors = [(f"{force} error", before)]
    items = [(name, quantity(value, unit, 3, units), f"{word}, {simulated}") for name, value in errors]
    if unexplained.get("kind"):
        remaining_force = quantity(unexplained["kind_leaves"], unit, 3, units)
        remark = f"like {unexplained['kind']}; the larger of all records"
        items.append((f"with the unknown {force}", remaining_force, remark))
    items.append(("noise floor", quantity(floor, unit, 3, units), gap.get("floor_from", "")))
    if before is not None and after is not None and floor is not None and before > max(floor, after):
        items.append(
            (
                "share of the gap closed",
                closed_share(before, after, floor),
                f"of the {word}, mean square above the floor",
            )
        )
    return Facts(tuple(items))
