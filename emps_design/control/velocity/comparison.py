"""What each structure makes of the same gains: IP, PI, and PI with a reference filter, side by side."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from emps_design.control.cases import where_of
from emps_design.control.velocity.load_range import margins_over_range
from emps_design.control.velocity.sensitivity import margins_under_mismatch
from emps_design.control.velocity.step_response import step_responses
from emps_design.control.velocity.structure import STRUCTURES
from emps_design.control.verdict import DesignVerdict

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign


def gains_document(design: VelocityLoopDesign, verdict: DesignVerdict | None = None) -> dict[str, Any]:
    """What ``gains`` says about ``design``: its plain data, the ``verdict`` on it, and its gains in each structure.

    ``stable`` and ``worst_loop`` are the verdict over all loops and machines; ``reason`` says why the design is
    refused, and ``nearest`` what is not. ``position_loop`` is the one designed around it, ``kept_position_loop`` has
    the loops with the axis file's. ``load_range`` and ``mismatch`` are what was asked about.
    """
    verdict = verdict or DesignVerdict(design)
    document = {**design.to_dict(), **verdict.to_dict(), "structures": structures_side_by_side(design)}
    document["warnings"] += verdict.warnings
    if verdict.around is not None:
        document["position_loop"] = verdict.around.to_dict()
    else:
        document |= kept_position_loop(design)
    if verdict.span is not None:
        document["load_range"] = study = margins_over_range(design, verdict.span)
        for point in study["points"]:
            point["loops"] = [loop.to_dict() for loop in verdict.at(where_of(point))]
    if verdict.errors is not None:
        document["mismatch"] = study = margins_under_mismatch(design, verdict.errors)
        study["stable_share"] = share = verdict.stable_share
        study["worst_loop"] = verdict.worst_corner.to_dict()
        if share < 1.0:
            document["warnings"].append(f"unstable at {100 * (1 - share):.3g} % of the mismatch corners")
    return document


def kept_position_loop(design: VelocityLoopDesign) -> dict[str, Any]:
    """The loops of ``design`` within the axis file's position loop under that key; empty where it has none."""
    loops = [loop.to_dict() for loop in design.kept_loops]
    return {"kept_position_loop": {"loops": loops}} if loops else {}


def structures_side_by_side(design: VelocityLoopDesign) -> list[dict[str, Any]]:
    """Bandwidth [rad/s], overshoot [%] and margins that the gains of ``design`` have in each structure.

    ``phase_margin_deg`` and ``crossover`` are those of T_vo, continuous; at the plant input all structures are one
    loop. ``sampled`` is the loop as implemented, None where that is unstable.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> for one in structures_side_by_side(design):
    ...     print(one["label"], round(one["bandwidth"], 1), round(one["overshoot_percent"], 1))
    IP 159.9 8.8
    PI 269.3 23.5
    PI with reference filter 159.9 8.8
    """
    found = []
    for structure in STRUCTURES:
        one = replace(design, structure=structure)
        continuous, sampled = step_responses(one)
        found.append(
            {
                "label": structure.label,
                "structure": structure.form,
                "reference_filter": structure.reference_filter,
                "bandwidth": one.bandwidth,
                "overshoot_percent": continuous.overshoot_percent,
                "crossover": one.crossover,
                "phase_margin_deg": one.phase_margin_deg,
                "sampled": {"bandwidth": one.sampled.bandwidth, "overshoot_percent": sampled.overshoot_percent}
                if sampled
                else None,
            }
        )
    return found
