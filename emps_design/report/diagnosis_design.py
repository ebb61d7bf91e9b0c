"""What a better model changes in the design: one specification on both models, and the old gains on the new one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.report.display import NOTHING, angle, delay, number, quantity, ratio
from emps_design.report.page import Section, Table

if TYPE_CHECKING:
    from emps_design.discrepancy.result import Diagnosis

NUMBERS = ("mass", "viscous", "coulomb", "constant_force")  # of the axis, by which a document has them
CROSSOVER, PHASE_MARGIN = 100.0, 60.0  # rad/s, deg: the specification of the paper's velocity loop


def axis_before(extended: Axis, parameters: Mapping[str, Any]) -> Axis:
    """Return ``extended`` as it was without the effects found: its baseline refitted, from ``parameters``."""
    entries = {name: parameters[name]["baseline"] for name in NUMBERS if parameters.get(name, {}).get("baseline")}
    baseline = {name: entry["value"] for name, entry in entries.items() if entry["value"] is not None}
    if "constant_force" in baseline:
        baseline["offset"] = baseline.pop("constant_force")
    return extended.replace(effects=[], mechanics=baseline)


def design_change(before: Axis, after: Axis) -> list[dict[str, Any]]:
    """Return rows {quantity, before, after, note} for the velocity loop on both axes; a reason where there is none.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019")
    >>> rows = design_change(axis, axis.replace(mechanics={"mass": 100.0}))
    >>> rows[0]["quantity"], rows[0]["before"], rows[0]["after"]
    ('k_v1', '462.9 V/(m/s)', '487.0 V/(m/s)')
    """
    from emps_design.control.velocity.design import design_velocity_loop

    try:
        old, new = (design_velocity_loop(axis, CROSSOVER, phase_margin_deg=PHASE_MARGIN) for axis in (before, after))
        kept = replace(old, axis=after).sampled
        expected, really, better = old.sampled.margins, kept.margins, new.sampled.margins
    except EmpsError as error:
        return [_row("velocity loop", None, None, str(error))]
    asked = f"for {number(CROSSOVER, 3)} rad/s and {number(PHASE_MARGIN, 2)}°"
    rows = [
        _row("k_v1", quantity(old.k_v1, "V/(m/s)"), quantity(new.k_v1, "V/(m/s)"), asked),
        _row("t_v", quantity(old.t_v, "s"), quantity(new.t_v, "s"), asked),
    ]
    if not really.stable:
        now = "stable" if expected.stable else "unstable"
        rows.append(_row("the old gains", now, "unstable", "designed on the model as it was, run on the better one"))
    else:
        phases = angle(expected.phase_margin_deg), angle(really.phase_margin_deg)
        note = "what was expected, and what the better model says they have"
        rows.append(_row("phase margin of the old gains", *phases, note))
    if expected.stable and better.stable:
        for name, shown in (
            ("phase margin, sampled", lambda m: angle(m.phase_margin_deg)),
            ("delay margin, sampled", lambda m: delay(m.delay_margin, m.period)),
            ("gain margin, sampled", lambda m: ratio(m.gain_margin)),
        ):
            rows.append(_row(name, shown(expected), shown(better), "each with its own gains"))
    note = "beside the effects found" if after.effects else ""
    for name, key, unit in (
        ("Coulomb friction to compensate", "coulomb", "N"),
        ("viscous friction", "viscous", "N/(m/s)"),
    ):
        was, now = (quantity(getattr(axis.mechanics, key), unit) for axis in (before, after))
        rows.append(_row(name, was, now, note))
    return rows


def _row(quantity: str, before: str | None, after: str | None, note: str) -> dict[str, Any]:
    return {"quantity": quantity, "before": before, "after": after, "note": note}


def _design_rows(diagnosis: Diagnosis, document: Mapping[str, Any]) -> list[dict[str, Any]]:
    axis, parameters = getattr(diagnosis, "axis", None), document.get("parameters")
    if axis is None or not parameters or not document["findings"]:
        return []
    return design_change(axis_before(axis, parameters), axis)


def design_section(diagnosis: Diagnosis, document: Mapping[str, Any]) -> Section | None:
    """The section that compares the design on both models."""
    rows = document.get("design") or _design_rows(diagnosis, document)
    if not rows:
        return None

    def shown(value: Any, unit: str) -> str:
        if isinstance(value, str) or value is None:
            return value or NOTHING
        return angle(value) if unit == "deg" else quantity(value, unit)

    return Section(
        "What the better model changes in the design",
        Table(
            ["quantity", "with the model as it was", "with the better model", "remark"],
            [
                [
                    row["quantity"],
                    shown(row["before"], row.get("unit", "")),
                    shown(row["after"], row.get("unit", "")),
                    row.get("note", ""),
                ]
                for row in rows
            ],
            "The same specification, designed on both models.",
        ),
    )
