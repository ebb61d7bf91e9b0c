"""The motion tab: a motion of one's own, simulated under the cascade of the design."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import PurePath
from typing import Any

import panel as pn

from emps_design.records import Record
from emps_design.report.motion import motion_figure
from emps_design.report.page import inline
from emps_design.report.style import labelled, svg
from emps_design.studio.controls import Field, after_this_event
from emps_design.studio.jobs import Job
from emps_design.studio.motion import Motion, move
from emps_design.studio.panes import html, judgement, message, numbers
from emps_design.studio.state import FEEDFORWARDS, State

MOTIONS = {"There and back": "there and back", "A file of mine": "file", "The record's reference": "record"}
SHAPE = {"stroke": 95, "speed": 95, "acceleration": 150, "pause": 85}
INTRODUCTION = """
<h3>What is simulated</h3>
<p>The axis, nonlinear, with everything its file has, along a motion of your own: in closed loop under the cascade of
the design tab (its gains, structure and filters inside a position loop), and beside it under the controller of the axis
where that follows a position.</p>
<p>A file has the columns <code>t [s], q_ref [m]</code>, and <code>f_ext [N]</code> where a force acts on the axis;
titles may have units. Way points are enough: between its rows the reference goes straight.</p>
"""


class MotionView:
    """Choose a motion, run it, see reference, error and command of the design and of the axis as it is."""

    def __init__(
        self, state: Callable[[], State], turn: Callable[[str, Any], None], record: Callable[[], Record | None]
    ):
        self._state, self._record, now = state, record, state()
        self.found: Motion | None = None
        self._of: State | None = None
        self._along: Record | None = None
        self._file: tuple[str, bytes] | None = None
        self.words = {
            "motion": pn.widgets.Select(label="Motion", options=MOTIONS, value=now.motion, width=190, margin=(2, 6)),
            "feedforward": pn.widgets.Select(
                label="Feed-forward of the design", options=list(FEEDFORWARDS), value=now.feedforward, width=210,
                margin=(2, 6),
            ),
        }  # fmt: skip
        for name, select in self.words.items():
            select.param.watch(lambda event, name=name: turn(name, event.new), "value")
        self.fields = {name: Field(name, getattr(now, name), turn, width) for name, width in SHAPE.items()}
        self.fields["position_kp"] = Field("position_kp", now.position_kp, turn, 150)
        self.file = pn.widgets.FileInput(
            label="Way (.csv, .npz)", accept=".csv,.npz,.txt", multiple=False, margin=(4, 6)
        )
        self.file.param.watch(self._uploaded, "value")
        self.run = pn.widgets.Button(label="Move", color="primary", width=100, margin=(22, 6, 2, 6))
        self.run.on_click(lambda event: after_this_event(self._start))  # a number typed just before comes first
        self.job = Job()
        self.message, self.table, self.picture = html(), html(INTRODUCTION), html()
        shape = [self.fields[name].field for name in SHAPE]
        self.view = pn.Column(
            pn.FlexBox(
                self.words["motion"], *shape, self.file, self.fields["position_kp"].field, self.words["feedforward"],
                self.run,
            ),
            self.job.view, self.message, self.table, self.picture, sizing_mode="stretch_width",
        )  # fmt: skip
        self.show(now)

    def show(self, state: State) -> None:
        """Show the numbers of ``state``, and no result of others."""
        for name, select in self.words.items():
            select.value = getattr(state, name)
        for name, field in self.fields.items():
            field.suit(state)
            field.set(getattr(state, name))
            field.field.visible = name not in SHAPE or state.motion == "there and back"
        self.file.visible = state.motion == "file"
        if self._of is not None and (
            read_by_motion(state) != read_by_motion(self._of)
            or (state.motion == "record" and self._along is not self._record())
        ):
            self.withdraw()

    def withdraw(self) -> None:
        """Show no result: the one before was of other numbers."""
        self.job.stop()
        self.found, self._of = None, None
        self.message.object, self.table.object, self.picture.object = "", INTRODUCTION, ""

    def _uploaded(self, event: Any) -> None:
        if event.new:
            self._file = PurePath((self.file.filename or "way").replace("\\", "/")).name, bytes(event.new)
            self.withdraw()

    def _start(self) -> None:
        state, file, record = self._state(), self._file, self._record()
        self.withdraw()
        self._of, self._along = state, record
        units = state.axis.units

        def failed(text: str) -> None:
            self.message.object = units.text(message(text, "stop"))

        def done(found: Motion) -> None:
            if self._of is state:
                self._done(found)

        self.job.start(lambda progress: move(state, file, record, progress), done, failed)

    def _done(self, found: Motion) -> None:
        self.found, units = found, found.state.axis.units
        drawn = svg(labelled(motion_figure(found.runs), units), "motion")  # before the words that stand over it
        level, text = found.verdict()
        self.message.object = units.text(judgement(text, level, "".join(f"<br>{inline(one)}" for one in found.notes)))
        heads, *rows = ([inline(cell) for cell in row] for row in found.rows())
        self.table.object = units.text(numbers(heads, rows))
        self.picture.object = drawn


def read_by_motion(state: State) -> tuple[Any, ...]:
    """What of ``state`` a motion depends on."""
    shape = (state.motion, *(getattr(state, name) for name in SHAPE), state.position_kp, state.feedforward)
    return state.axis, tuple(state.requested.items()), shape
