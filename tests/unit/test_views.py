"""A result that is new: one dataclass with its numbers and its view, and all five views show it; its figure too."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from emps_design.cli.output import Terminal
from emps_design.commands import Reply
from emps_design.figures import Axes, Curve, Grid
from emps_design.machines import machine
from emps_design.report import Page, Section
from emps_design.report.page import Picture
from emps_design.report.style import drawn
from emps_design.units import Units
from emps_design.view import Line, Table, View, Viewed, html


@dataclass(frozen=True)
class Stiffness(Viewed):
    """What a newcomer writes, in one file."""

    value: float
    units: Units

    def to_dict(self) -> dict[str, Any]:
        return {"stiffness": self.value}

    def view(self) -> View:
        rows = (("stiffness", self.value, self.units.unit("N/m")),)
        return Line("stiff enough", "good"), Table(("", "value", "unit"), rows, "Coupling")

    def axes(self) -> Axes:
        bend = np.linspace(0.0, 1e-3, 200)
        return Axes((Curve(bend, self.value * bend, "force"),), "bend [m]", "force [N]", x_range=(0.0, 1e-3))


RESULT = Stiffness(52000.0, machine("emps2018").units)


def test_all_five_views_show_it(capsys):
    reply, terminal = Reply(RESULT.to_dict(), RESULT.view(), RESULT.units), Terminal()
    terminal.print_view(reply.view)
    printed = capsys.readouterr().out
    terminal.print_json(reply.document)
    assert json.loads(capsys.readouterr().out) == {"stiffness": 52000.0}
    page = Page("Coupling", "", (), (Section("Coupling", *RESULT.view()),)).html()
    for shown in (printed, str(RESULT), page, RESULT._repr_html_(), html(RESULT.view())):
        for words in ("stiff enough", "Coupling", "stiffness", "5.2e+04", "N/m"):
            assert words in shown


def test_page_and_studio_draw_its_figure():
    pytest.importorskip("panel", reason="the extra 'studio' is not installed")
    from emps_design.studio.plots import LivePlot

    axes = RESULT.axes()
    figure = drawn(Grid.of(axes))
    (line,) = figure.axes[0].get_lines()
    assert "<svg" in Picture(figure, "how it bends").html(RESULT.units)
    live = LivePlot("Coupling", (0.0, 60.0))
    live.show(axes)
    assert np.array_equal(live.sources["lines"].data["y"][0], line.get_ydata())
    assert (live.plot.xaxis.axis_label, live.plot.yaxis.axis_label) == ("bend [m]", "force [N]")
