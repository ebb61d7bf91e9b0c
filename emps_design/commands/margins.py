"""What the controller in the axis file achieves: crossover, margins, bandwidth and damping of each loop and of all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.options import LoadRangeRequest, axis_argument
from emps_design.control.view import Row, number, worst_in_words
from emps_design.request import option
from emps_design.units import Units
from emps_design.view import Line, Table

ROWS: tuple[Row, ...] = (
    ("crossover", "crossover", "rad/s", 1.0),
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("gain margin", "gain_margin", "ratio", 1.0),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("disk margin", "disk_margin", "", 1.0),
    ("bandwidth, -3 dB", "bandwidth", "rad/s", 1.0),
    ("natural frequency", "natural_frequency", "rad/s", 1.0),
    ("damping", "damping", "", 1.0),
)


@dataclass(frozen=True)
class MarginsRequest(LoadRangeRequest):
    """What ``margins`` takes: the axis with its controller, and the machines to hold on."""

    axis: Axis = axis_argument("emps2019")
    mismatch: float | None = option(None, "relative error of the parameters to hold under too", unit="")
    velocity: float = option(0.1, "where the effects of the axis are linearised [m/s]", unit="m/s")


def answer(request: MarginsRequest) -> Reply:
    """The margins of every loop of the controller, and the worst of them on every machine."""
    from emps_design.control.controller import controller_margins

    margins = controller_margins(request.axis, request.mismatch, request.load_range, request.velocity)
    document, units = margins.to_dict(), request.axis.units
    return Reply(document, tuple(_view(document, units)), units, "" if margins.stable else margins.reason)


def _view(document: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    from emps_design.control.nested_loops import where_in_words

    verdict, style = ("stable", "good") if document["stable"] else ("UNSTABLE", "bad")
    yield Line(f"{document['axis']}: the loops of its {document['controller']} controller are {verdict}", style)
    yield Line(worst_in_words(document["worst_loop"], units))
    loops = {name: loop for name, loop in document["loops"].items() if loop is not None}
    headings = [f"{name} loop" for name in loops]
    continuous = {name: loop["continuous"] for name, loop in loops.items()}
    for title, columns in (
        ("Sampled, as the drive runs it", loops),
        ("Continuous, with every lag of the axis", continuous),
    ):
        rows = [("broken at the", *(loop["broken"] for loop in columns.values()), "")]
        for label, key, unit, scale in ROWS:
            cells = [
                number(None if loop[key] is None else scale * loop[key], 4, "-") if loop["stable"] else "undefined"
                for loop in columns.values()
            ]
            rows.append((label, *cells, unit))
        yield Table(("", *headings, "unit"), rows, title)
    if document.get("range"):
        rows = [
            (
                where_in_words(point["where"], units),
                *(
                    f"{number(loop['phase_margin_deg'], 3)} deg, {number(loop['gain_margin'], 3)}"
                    if loop["stable"]
                    else "unstable"
                    for loop in point["loops"].values()
                    if loop is not None
                ),
            )
            for point in document["range"]
        ]
        yield Table(("", *headings), rows, "On every machine asked about: phase margin, gain margin")
    for warning in document["warnings"]:
        yield Line(f"- {units.text(warning)}")
