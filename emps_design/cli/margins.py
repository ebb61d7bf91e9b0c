"""What the controller in the axis file achieves: crossover, margins, bandwidth and damping of each loop and of all."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from emps_design.cli.options import (
    AsJson,
    AxisArgument,
    ComplianceRange,
    DelayRange,
    InertiaRange,
    Velocity,
    load_range_from_options,
    within,
)
from emps_design.cli.output import add_advice, load_axis, new_console, new_table, print_json, say_advice, tell


def command(
    axis: AxisArgument = "emps2019",
    mismatch: Annotated[
        float | None, typer.Option(callback=within(""), help="relative error of the parameters to hold under too")
    ] = None,
    inertia_range: InertiaRange = None,
    compliance_range: ComplianceRange = None,
    delay_range: DelayRange = None,
    velocity: Velocity = 0.1,
    as_json: AsJson = False,
) -> int:
    from emps_design.control.controller import controller_margins

    span = load_range_from_options(inertia_range, compliance_range, delay_range)
    margins = controller_margins(load_axis(axis), mismatch, span, velocity)
    document = add_advice(margins.to_dict(), axis)
    if as_json:
        print_json(document)
    else:
        _print(document)
    if not margins.stable:
        tell(margins.reason)
    if not as_json:
        say_advice(document)
    return 0 if margins.stable else 4


def _print(document: dict[str, Any]) -> None:
    from emps_design.cli.tables import number, worst_in_words
    from emps_design.control.nested_loops import where_in_words

    console = new_console()
    verdict = "stable" if document["stable"] else "UNSTABLE"
    console.print(f"{document['axis']}: the loops of its {document['controller']} controller are {verdict}")
    console.print(worst_in_words(document["worst_loop"]), highlight=False, soft_wrap=True)
    loops = {name: loop for name, loop in document["loops"].items() if loop is not None}
    for title, of in (
        ("Sampled, as the drive runs it", lambda loop: loop),
        ("Continuous, with every lag of the axis", lambda loop: loop["continuous"]),
    ):
        columns = {name: of(loop) for name, loop in loops.items()}
        table = new_table(title, "", *(f"{name} loop" for name in columns), "unit", words=("unit",))
        table.add_row("broken at the", *(loop["broken"] for loop in columns.values()), "")
        for label, key, unit, scale in ROWS:
            cells = [
                (
                    "undefined"
                    if not loop["stable"]
                    else number(None if loop[key] is None else scale * loop[key], 4, "-")
                )
                for loop in columns.values()
            ]
            table.add_row(label, *cells, unit)
        console.print(table)
    points = document.get("range", ())
    if points:
        table = new_table("On every machine asked about: phase margin, gain margin", "", *(f"{n} loop" for n in loops))
        for point in points:
            cells = [
                f"{number(loop['phase_margin_deg'], 3)} deg, {number(loop['gain_margin'], 3)}"
                if loop["stable"]
                else "unstable"
                for loop in point["loops"].values()
                if loop is not None
            ]
            table.add_row(where_in_words(point["where"]), *cells)
        console.print(table)
    for warning in document["warnings"]:
        console.print(f"- {warning}", highlight=False)


ROWS = (
    ("crossover", "crossover", "rad/s", 1.0),
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("gain margin", "gain_margin", "ratio", 1.0),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("disk margin", "disk_margin", "", 1.0),
    ("bandwidth, -3 dB", "bandwidth", "rad/s", 1.0),
    ("natural frequency", "natural_frequency", "rad/s", 1.0),
    ("damping", "damping", "", 1.0),
)
