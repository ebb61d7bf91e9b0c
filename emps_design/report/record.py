"""The sections about a record: what it holds, the parameters it gives, and the force they explain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from emps_design.report.display import NOTHING, number, quantity, words
from emps_design.report.page import Callout, Picture, Section, Table, Text
from emps_design.report.record_figures import force_figure, record_figure

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.identification.identify import Identification
    from emps_design.records import Record


def record_section(record: Record, found: Sequence[Identification], axis: Axis) -> Section:
    """Return the section on ``record`` with every identification ``found`` on it; ``axis`` is what the file says."""
    first = found[0]
    warnings = tuple(dict.fromkeys(warning for one in found for warning in one.warnings))
    return Section(
        f"Record {record.name}",
        Text(
            f"{len(record)} samples of {quantity(record.period, 's')}, {quantity(record.duration, 's', 3)} in all. "
            f"Filter {first.chain}: {first.filter_text}."
        ),
        Picture(
            record_figure(record, axis.units),
            "Position on the load side and the voltage that the drive was given.",
            "Record",
        ),
        *(_parameters_table(one, axis) for one in found),
        _quality_table(found),
        _force_picture(first),
        _warnings(warnings),
    )


def identification_blocks(found: Identification, axis: Axis) -> tuple[Any, ...]:
    """Return tables, picture and warnings of one identification; ``axis`` is what it is compared with."""
    return (_parameters_table(found, axis), _quality_table((found,)), _force_picture(found), _warnings(found.warnings))


def _warnings(warnings: Sequence[str]) -> Callout | None:
    return Callout("warning", "What the record says about itself", items=tuple(warnings)) if warnings else None


def _force_picture(found: Identification) -> Picture:
    known = ", both less what the effects of the axis file take" if found.axis.effects else ""
    return Picture(
        force_figure(found),
        f"Force of the motor, measured and by the {found.model} model with the identified parameters{known}. "
        "The middle picture enlarges the yellow part. What is left in the lowest picture and repeats from stroke to "
        "stroke is physics that the model lacks; emps-design diagnose names it.",
        "Measured against identified force",
    )


def _parameters_table(found: Identification, axis: Axis) -> Table:
    mechanics = axis.mechanics
    known = {
        "mass": mechanics.mass,
        "viscous": mechanics.viscous,
        "coulomb": mechanics.coulomb,
        "constant_force": mechanics.offset,
    }
    rows: list[list[Any]] = []
    for name, estimate in found.parameters.items():
        unit = estimate.quantity.unit
        if estimate.interval_95 is None:
            rows.append([words(name), unit, "not determined", NOTHING, NOTHING, NOTHING, known.get(name)])
            continue
        low, high = estimate.interval_95
        rows.append(
            [
                words(name),
                unit,
                number(estimate.value, 6),
                number(estimate.std, 3),
                f"{estimate.relative_std_percent:.2f} %" if estimate.relative_std_percent is not None else NOTHING,
                f"{number(low)} to {number(high)}",
                number(known[name], 6) if name in known else NOTHING,
            ]
        )
    return Table(
        ["parameter", "unit", "value", "std, (15)", "relative std, (16)", "95 % interval", f"axis {axis.name}"],
        rows,
        f"Identified parameters, {found.model} model{_asked_for(found)}. Std by (15) counts every sample as "
        "independent; the interval allows for the correlation of the residual and is the one to believe.",
    )


def _asked_for(found: Identification) -> str:
    """What beside the model the record asked for by itself."""
    return f"; proposed by the record: {', '.join(found.proposed)}" if found.proposed else ""


def _quality_table(found: Sequence[Identification]) -> Table:
    return Table(
        ["model", "force error [N rms]", "of the force", "condition number", "rows", "independent rows"],
        [
            [
                one.model,
                number(one.rms_error),
                f"{one.relative_error_percent:.2f} %" if math.isfinite(one.relative_error_percent) else NOTHING,
                number(one.condition_number, 3),
                one.samples,
                str(round(one.residual.effective_samples)),
            ]
            for one in found
        ],
        "How well each model explains the force.",
    )
