"""The simulation tab: an operator guides the carriage under the impedance law, with the estimates a little wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import panel as pn

from emps_design.report.page import inline
from emps_design.report.style import labelled, svg
from emps_design.studio.controls import Field, after_this_event
from emps_design.studio.jobs import Job
from emps_design.studio.panes import html, judgement, message
from emps_design.studio.simulated import Simulated, simulate
from emps_design.studio.state import State

TASKS = {"Hand guides the axis": "guided", "Pushes to and fro (Fig. 12)": "pushed"}
WIDTHS = {
    "push": 80,
    "hand_stiffness": 155,
    "hand_damping": 175,
    "wall": 110,
    "mismatch_percent": 90,
    "plants": 105,
    "seed": 70,
}
PICTURES = ("task", "wall", "plants")
INTRODUCTION = """
<h3>What is simulated</h3>
<p>The impedance law of the design tab (M_a, B, filter, sampling, current loop) on its axis, with friction that sticks:
once with exact estimates, once with the worst estimates within the mismatch; then every corner of the mismatch and as
many random plants as asked for; then a push into the wall.</p>
<p>Fig. 12 of the paper is the task <i>Pushes to and fro</i>.</p>
"""


class SimulationView:
    """Choose the task, the wall and the mismatch, run them, see force, velocity and position and the verdict."""

    def __init__(self, state: Callable[[], State], turn: Callable[[str, Any], None]):
        self._state, now = state, state()
        self.task = pn.widgets.Select(label="Task", options=TASKS, value=now.task, width=215, margin=(2, 6))
        self.task.param.watch(lambda event: turn("task", event.new), "value")
        self.fields = {name: Field(name, getattr(now, name), turn, width) for name, width in WIDTHS.items()}
        self.run = pn.widgets.Button(label="Simulate", color="primary", width=100, margin=(22, 6, 2, 6))
        self.run.on_click(lambda event: after_this_event(self._start))  # a number typed just before comes first
        self._of: State | None = None  # what the result shown, or at work, is of
        self.job = Job()
        self.message, self.table = html(), html(INTRODUCTION)
        self.pictures = {name: html() for name in PICTURES}
        self.view = pn.Column(
            pn.FlexBox(self.task, *(field.field for field in self.fields.values()), self.run),
            self.job.view,
            self.message,
            pn.Row(
                pn.Column(self.pictures["task"], self.pictures["wall"], sizing_mode="stretch_width", margin=0),
                pn.Column(self.table, self.pictures["plants"], sizing_mode="stretch_width", margin=0),
                sizing_mode="stretch_width",
                margin=0,
            ),
            sizing_mode="stretch_width",
        )
        self.show(now)

    def show(self, state: State) -> None:
        """Show the numbers of ``state``."""
        self.task.value = state.task
        for name, field in self.fields.items():
            field.suit(state)
            field.set(getattr(state, name))
        if self._of is not None and _read(state) != _read(self._of):
            self._withdraw()

    def _withdraw(self) -> None:
        """Show no result: the one before was of other numbers."""
        self.job.stop()
        self._of = None
        self.message.object, self.table.object = "", INTRODUCTION
        for picture in self.pictures.values():
            picture.object = ""

    def _start(self) -> None:
        state = self._state()
        self._withdraw()
        self._of = state
        self.job.start(lambda progress: simulate(state, progress), self._done, self._failed)

    def _failed(self, text: str) -> None:
        self.message.object = self._state().axis.units.text(message(text, "stop"))

    def _done(self, found: Simulated) -> None:
        if found.state is not self._of:
            return
        level, text = found.verdict()
        units = found.state.axis.units
        self.message.object = units.text(judgement(text, level))
        rows = "".join(
            f"<tr><th>{inline(name)}</th><td><b>{inline(value)}</b></td></tr>" for name, value in found.rows()
        )
        self.table.object = units.text(f"<table>{rows}</table>")
        captions = found.captions()
        for name, figure in found.figures().items():
            caption = units.text(inline(captions[name]))
            self.pictures[name].object = f'{svg(labelled(figure, units), name)}<p class="caption">{caption}</p>'


def _read(state: State) -> tuple[Any, ...]:
    """What of ``state`` a simulation depends on."""
    return state.axis, state.task, state.mass, state.damping, state.filter, *(getattr(state, name) for name in WIDTHS)
