"""The section on the force loop: stable or not, margins, and how large its gain may be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.report.display import angle, delay, number, quantity, ratio, symbol
from emps_design.report.force_figures import force_limit_figure, force_loop_figure
from emps_design.report.page import Callout, Html, Picture, Section, Table, Text

if TYPE_CHECKING:
    from emps_design.control.force.design import ForceLoopDesign


def force_section(force: ForceLoopDesign) -> Section:
    """Return the section on the force loop ``force``: stability first, then margins and limits."""
    operator = []
    if force.hand:
        operator.append(f"a viscous hand of {quantity(force.hand, 'N/(m/s)')}")
    if force.environment:
        operator.append(f"a wall of {number(force.environment / 1e3)} N/mm")
    margins, stable = force.margins, force.worst.margins.stable

    def limit(value: float | None) -> str:
        return "unbounded" if value is None else f"{number(value)} (m/s)/N"

    def margin(shown: str) -> str:
        return shown if force.stable else "unstable"

    reading = str(force.paper_reading["text"])
    warnings = [warning for warning in force.warnings if "unstable" not in warning]
    rows = [
        [Html(symbol("k_e1")), f"{number(force.k_e1)} (m/s)/N", "velocity per newton"],
        [Html(symbol("k_c")), quantity(force.k_c, "N/(m/s)"), "what the hand feels at low frequency, 1/k_e1"],
        ["apparent mass", quantity(force.apparent_mass, "kg"), "low-frequency match of k_e1 T_vc with 1/(M_a s + B)"],
        ["largest gain, continuous", limit(force.k_e1_max_continuous), "closed form (Routh)"],
        ["largest gain, sampled", limit(force.k_e1_max_sampled), "by the poles of the loop as implemented"],
        [
            "phase margin, sampled",
            margin(angle(margins.phase_margin_deg) if margins.phase_margin_deg else "unbounded"),
            "",
        ],
        ["gain margin, sampled", margin(ratio(margins.gain_margin)), ""],
        ["delay margin, sampled", margin(delay(margins.delay_margin, margins.period)), ""],
    ]
    return Section(
        "Force loop",
        Text(
            f"Operator: {' and '.join(operator) or 'none'}, tau_e = −(k_h q̇ + K_env q), positive towards +q. The force "
            f"acts on the sensor{' and on the carriage' if force.on_carriage else ' only'}."
        ),
        Callout("good", "stable.") if stable else Callout("stop", f"the {force.worst.name} is unstable."),
        Table(
            ["quantity", "value", "meaning"], rows, "Force loop of Fig. 4, (10) and (11), with an explicit operator."
        ),
        Callout("note", "The paper's own reading of (10), (11)", f"{reading}."),
        Picture(
            force_limit_figure(force),
            "Shaded, above the dashed line, the loop as implemented is unstable: the “too high gain” of the paper. "
            "Where all is shaded no gain is stable, where nothing is any. The stiffer the wall, the smaller the gain.",
            "How large the force gain may be",
        ),
        Picture(
            force_loop_figure(force),
            "Left: the loop must leave −1 on its left. Right: the closed-loop poles, velocity loop and operator "
            "included.",
            "Force loop in contact",
        ),
        Callout("warning", "To read with the numbers", items=tuple(warnings)) if warnings else None,
    )
