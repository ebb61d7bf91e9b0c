"""What a better model changes in the design: one specification on both models, and the old gains on the new one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.report.diagnosis_protocol import Diagnosis
from emps_design.report.display import NOTHING, angle, delay, number, quantity, ratio
from emps_design.report.page import Section, Table

CROSSOVER, PHASE_MARGIN = 100.0, 60.0  # rad/s, deg: the specification of the paper's velocity loop


def axis_before(extended: Axis, parameters: Mapping[str, Any]) -> Axis:
    """Return ``extended`` as it was without the effects found: its baseline refitted, from ``parameters``."""
    baseline = {name: entry["baseline"]["value"] for name, entry in parameters.items() if entry.get("baseline")}
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
    from emps_design.control.plant.discretisation import sample_axis
    from emps_design.control.velocity.design import design_velocity_loop
    from emps_design.control.velocity.sampled import SampledVelocityLoop

    try:
        old, new = (design_velocity_loop(axis, CROSSOVER, phase_margin_deg=PHASE_MARGIN) for axis in (before, after))
        kept = SampledVelocityLoop(sample_axis(after), old.k_v1, old.t_v)
        expected, really, better = old.sampled.margins, kept.margins, new.sampled.margins
    except EmpsError as error:
        return [{"quantity": "velocity loop", "before": None, "after": None, "note": str(error)}]
    asked = f"for {number(CROSSOVER, 3)} rad/s and {number(PHASE_MARGIN, 2)}°"
    if not really.stable:
        surprise = {
            "quantity": "the old gains",
            "before": "stable" if expected.stable else "unstable",
            "after": "unstable",
            "note": "designed on the model as it was, run on the better one",
        }
    else:
        surprise = {
            "quantity": "phase margin of the old gains",
            "before": angle(expected.phase_margin_deg),
            "after": angle(really.phase_margin_deg),
            "note": "what was expected, and what the better model says they have",
        }
    rows = [
        {
            "quantity": "k_v1",
            "before": quantity(old.k_v1, "V/(m/s)"),
            "after": quantity(new.k_v1, "V/(m/s)"),
            "note": asked,
        },
        {"quantity": "t_v", "before": quantity(old.t_v, "s"), "after": quantity(new.t_v, "s"), "note": asked},
        surprise,
    ]
    if expected.stable and better.stable:
        for name, shown in (
            ("phase margin, sampled", lambda m: angle(m.phase_margin_deg)),
            ("delay margin, sampled", lambda m: delay(m.delay_margin, m.period)),
            ("gain margin, sampled", lambda m: ratio(m.gain_margin)),
        ):
            rows.append(
                {"quantity": name, "before": shown(expected), "after": shown(better), "note": "each with its own gains"}
            )
    for name, attribute, unit in (
        ("Coulomb friction to compensate", "coulomb", "N"),
        ("viscous friction", "viscous", "N/(m/s)"),
    ):
        rows.append(
            {
                "quantity": name,
                "before": quantity(getattr(before.mechanics, attribute), unit),
                "after": quantity(getattr(after.mechanics, attribute), unit),
                "note": "beside the effects found" if after.effects else "",
            }
        )
    return rows


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
