"""The motion tab and the compensation tab.

The motion tab simulates a motion of the user's choice with the designed cascade and with the axis's own controller. In
the compensation tab the user chooses feed-forward terms, compares tracking errors, and downloads the files for a drive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
import panel as pn

from emps_design import view
from emps_design.advice import SAFE, advise
from emps_design.axis import Axis
from emps_design.compensation import Compensation, compensate
from emps_design.compensation.feedforward import terms_of
from emps_design.errors import EmpsError, InputError
from emps_design.progress import Progress
from emps_design.records import Record
from emps_design.report.page import LEVELS, inline, quantity, sentence_of
from emps_design.report.record import motion_figure, tracking_figure
from emps_design.report.style import labelled, svg
from emps_design.studio.controls import Field, after_this_event
from emps_design.studio.files_view import BUTTON, designed, drive_zip, follows, velocity_design
from emps_design.studio.panes import Job, html, judgement, message
from emps_design.studio.state import FEEDFORWARDS, State
from emps_design.view import Table, View, Viewed

if TYPE_CHECKING:
    from emps_design.control.position import PositionLoopDesign
    from emps_design.simulation.scenarios import Followed

DESIGN, OWN = "this design", "the axis's own controller"

MOTIONS = {"There and back": "there and back", "A file of mine": "file", "The record's reference": "record"}
SHAPE = {"stroke": 95, "speed": 95, "acceleration": 150, "pause": 85}
INTRODUCTION = """
<h3>What is simulated</h3>
<p>The nonlinear axis with all its effects, along a motion of your choice, in closed loop: with the cascade of the
design tab (its gains, structure and filters inside a position loop), and with the controller of the axis file if that
follows a position.</p>
<p>A file has the columns <code>t [s], q_ref [m]</code>, and <code>f_ext [N]</code> if a force acts on the axis; titles
may have units. Way points are enough: the reference is interpolated linearly between the rows.</p>
"""

FOLDER = "emps-design-drive.zip"
COMPENSATION_DESIGN, COMPENSATION_OWN = "the design's", "the axis's own"  # controllers to test
COMPENSATION_INTRODUCTION = """
<h3>What is fed forward</h3>
<p>The command that the reference needs according to the model, from the chosen terms. It is added to the output of the
controller: that of the design tab, or the axis's own if it follows a reference. Each term is tested in closed loop on
the nonlinear axis, alone and with its parameters 2 % and its phase 10 degrees wrong; a term that then increases the
error is left out.</p>
<p>The folder contains the axis with the tested controller, the compensation, and both as C99 code with test vectors:
<code>make check</code> in <code>code</code> runs them.</p>
"""


@dataclass(frozen=True)
class MotionRuns(Viewed):
    """Runs along one reference, by the names of their controllers; ``notes`` say why a run is missing."""

    state: State
    about: str
    loop: PositionLoopDesign
    runs: dict[str, Followed]
    notes: tuple[str, ...]

    def verdict(self) -> tuple[str, str]:
        """Return the level of the verdict, such as "bad", and its sentence."""
        document, own, units = self.runs[DESIGN].to_dict(), self.runs.get(OWN), self.state.axis.units
        error, rate = document["tracking_error"], f"{self.loop.every}. " if self.loop.every > 1 else ""
        text = (
            f"{self.about}, kp {self.loop.kp:g} 1/s, every {rate}sample: tracking error "
            f"{self._length(error['rms'])} rms, {self._length(error['largest'])} at most"
        )
        clipped = document["saturated_share"]
        text = f"{text}; at the limit of the command {100.0 * clipped:.3g} %."
        if not self.loop.stable:
            return "bad", f"The cascade of this design is unstable. {text}"
        own_error = {} if own is None else own.to_dict()["tracking_error"]
        worse = any(error[name] > own_error[name] for name in ("rms", "largest") if own_error)
        if worse:
            text += (
                f" The axis's own controller follows more closely: {self._length(own_error['rms'])} rms, "
                f"{self._length(own_error['largest'])} at most."
            )
        advice = advise("simulate", document, units=units)
        if advice.level != SAFE:
            text = f"{sentence_of(advice.text)} {text}"
        return ("warning" if worse and advice.level == SAFE else LEVELS[advice.level][0]), text

    def _length(self, value: float) -> str:
        return quantity(value, "m", units=self.state.axis.units)

    def view(self) -> View:
        """Tracking error, largest velocity and command, and share of the time at the limit, one row per run."""
        units, rows = self.state.axis.units, []
        for name, followed in self.runs.items():
            document = followed.to_dict()
            error, most = document["tracking_error"], document["largest"]
            numbers = (error["rms"], "m"), (error["largest"], "m"), (most["velocity"], "m/s"), (most["voltage"], "V")
            share = f"{100.0 * document['saturated_share']:.3g} %"
            rows.append((name, *(quantity(value, unit, units=units) for value, unit in numbers), share))
        headings = ("", "error, rms", "error, largest", "velocity, largest", "command, largest", "at its limit")
        return (Table(headings, rows),)


def design_loop(state: State) -> PositionLoopDesign:
    """Return the cascade of the design of ``state``, with the position loop at the rate of the axis."""
    from emps_design.control.position import PositionLoopDesign

    design = velocity_design(state)
    every = (state.axis.controller.position or {}).get("every", 1)
    computed = replace(design, structure=design.structure.as_computed)
    return PositionLoopDesign(computed, state.position_kp, every, {})


def design_axis(state: State, loop: PositionLoopDesign) -> Axis:
    """Return the axis of ``state`` with the cascade ``loop`` and the chosen feed-forward."""
    tables = {"of the axis": state.axis.controller.feedforward or {}, **loop.feedforwards}
    return loop.axis(**tables[state.feedforward])


def reference_of(
    state: State, file: tuple[str, bytes] | None, record: Record | None
) -> tuple[str, np.ndarray, np.ndarray | None]:
    """Return the motion of ``state`` in words, its positions (n,) [m], and a force (n,) [N] on the axis or None.

    ``file`` is the name and the content of a file with the columns t, q_ref, and f_ext if a force acts.
    """
    from emps_design.simulation.synthetic import reference_from_bytes, there_and_back

    period = state.axis.sampling.period
    if state.motion == "file":
        if file is None:
            raise InputError("motion: found no file, expected one with the columns t and q_ref")
        q_ref, f_ext, _ = reference_from_bytes(file[1], file[0], period, state.axis.units)
        return f"{file[0]}, interpolated linearly", q_ref, f_ext
    if state.motion == "record":
        if record is None or not record.q_ref_recorded:
            raise InputError("motion: found no record with a reference, expected one in the data tab")
        recorded = record.t - record.t[0]
        t = np.arange(int(recorded[-1] / period * (1.0 + 1e-12)) + 1) * period
        return f"the reference of {record.name}", np.interp(t, recorded, record.q_ref), None
    way = there_and_back(period, state.stroke, state.speed, state.acceleration, state.pause)
    return "there and back", np.concatenate([np.zeros(round(state.pause / period)), way]), None


def move(state: State, file: tuple[str, bytes] | None, record: Record | None, progress: Progress) -> MotionRuns:
    """Simulate the motion of ``state`` with the design, and with the axis's own controller if it follows positions."""
    from emps_design.simulation.scenarios import follow

    about, q_ref, f_ext = reference_of(state, file, record)
    loop = design_loop(state)
    progress("the design", 0.1)
    runs, notes = {DESIGN: follow(design_axis(state, loop), q_ref, f_ext)}, []
    progress(OWN, 0.5)
    axis = state.axis
    try:
        if follows(axis) != "position":
            raise InputError(f"the axis's {axis.controller.kind} controller does not follow a position")
        runs[OWN] = follow(axis, q_ref, f_ext)
    except EmpsError as error:
        notes.append(f"No second run: {error}.")
    progress("drawing", 0.9)
    return MotionRuns(state, about, loop, runs, tuple(notes))


class MotionView:
    """Choice and simulation of a motion, with plots of reference, error and command for both controllers."""

    def __init__(
        self, state: Callable[[], State], turn: Callable[[str, Any], None], record: Callable[[], Record | None]
    ):
        self._state, self._record, now = state, record, state()
        self.motion_runs: MotionRuns | None = None
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
            label="Motion file (.csv, .npz)", accept=".csv,.npz,.txt", multiple=False, margin=(4, 6)
        )
        self.file.param.watch(self._uploaded, "value")
        self.run = pn.widgets.Button(label="Move", color="primary", width=100, margin=(22, 6, 2, 6))
        self.run.on_click(lambda event: after_this_event(self._start))  # a number entered just before counts
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
        """Show the numbers of ``state``, and remove an outdated result."""
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
        """Remove an outdated result."""
        self.job.stop()
        self.motion_runs, self._of = None, None
        self.message.object, self.table.object, self.picture.object = "", INTRODUCTION, ""

    def _uploaded(self, event: Any) -> None:
        if event.new:
            self._file = PurePath((self.file.filename or "motion").replace("\\", "/")).name, bytes(event.new)
            self.withdraw()

    def _start(self) -> None:
        state, file, record = self._state(), self._file, self._record()
        self.withdraw()
        self._of, self._along = state, record

        def failed(text: str) -> None:
            self.message.object = message(text, "bad")

        def done(motion_runs: MotionRuns) -> None:
            if self._of is state:
                self._done(motion_runs)

        self.job.start(lambda progress: move(state, file, record, progress), done, failed)

    def _done(self, motion_runs: MotionRuns) -> None:
        self.motion_runs, units = motion_runs, motion_runs.state.axis.units
        drawn = svg(
            labelled(motion_figure(motion_runs.runs), units), "motion"
        )  # before the text, as drawing takes long
        level, text = motion_runs.verdict()
        notes = "".join(f"<br>{inline(note)}" for note in motion_runs.notes)
        self.message.object = judgement(text, level, notes)
        self.table.object = view.html(motion_runs.view())
        self.picture.object = drawn


def read_by_motion(state: State) -> tuple[Any, ...]:
    """Return the part of ``state`` that a motion depends on."""
    shape = (state.motion, *(getattr(state, name) for name in SHAPE), state.position_kp, state.feedforward)
    return state.axis, tuple(state.requested.items()), shape


class CompensationView:
    """Choice and test of feed-forward terms, and the download of axis, compensation and code."""

    def __init__(self, state: Callable[[], State]):
        self._state, self._axis = state, state().axis
        self.compensation: Compensation | None = None
        self.terms = pn.widgets.CheckBoxGroup(label="Terms", inline=True, margin=(8, 6))
        self.terms.param.watch(lambda event: self._withdraw(), "value")
        self.controller = pn.widgets.Select(label="Controller", options=[COMPENSATION_DESIGN], width=200, margin=(4, 6))
        self.controller.param.watch(lambda event: self._withdraw(), "value")
        self.run = pn.widgets.Button(label="Test them", color="primary", width=110, margin=(4, 6))
        self.run.on_click(lambda event: self._start())
        self.download = pn.widgets.FileDownload(
            callback=self._folder, filename=FOLDER, label="Download the folder", color="primary", width=200,
            margin=(4, 6), disabled=True, stylesheets=[BUTTON],
        )  # fmt: skip
        self.job = Job()
        self.message, self.not_compensated = html(), html()
        self.table, self.picture = html(COMPENSATION_INTRODUCTION), html()
        self.view = pn.Column(
            html("<h3>Terms</h3>"), self.terms, self.not_compensated, self.controller,
            pn.Row(self.run, self.download, margin=0), self.job.view,
            self.message, self.table, self.picture, sizing_mode="stretch_width",
        )  # fmt: skip
        self._offer()

    def show(self, state: State) -> None:
        """Offer the terms of the axis of ``state`` if the axis or its controller has changed."""
        shown = self.compensation
        if state.axis != self._axis or (shown is not None and self._controlled(state) != shown.axis):
            self._axis = state.axis
            self._offer()

    def _controlled(self, state: State) -> Axis | None:
        """The axis to compensate, None if its design is refused."""
        try:
            return self._chosen(state)
        except EmpsError:
            return None

    def _chosen(self, state: State) -> Axis:
        """The axis of ``state`` with the chosen controller; raises :class:`EmpsError` if its design is refused."""
        return state.axis if self.controller.value == COMPENSATION_OWN else designed(state)

    def _offer(self) -> None:
        try:
            has_reference = bool(follows(self._axis))
        except EmpsError:  # gains that only a record has
            has_reference = False
        chosen = self.controller.value if has_reference else COMPENSATION_DESIGN
        self.controller.param.update(
            options=[COMPENSATION_DESIGN, COMPENSATION_OWN] if has_reference else [COMPENSATION_DESIGN], value=chosen
        )
        possible, excluded = terms_of(self._axis)
        self.terms.options = {name.replace("_", " "): name for name in possible}
        self.terms.value = list(possible)
        self.not_compensated.object = "".join(
            message(f"{name.replace('_', ' ')} is not compensated: {why}", "note") for name, why in excluded.items()
        )
        self._withdraw()

    def _withdraw(self) -> None:
        """Remove a result of other terms or of another axis."""
        self.job.stop()
        self.compensation, self.download.disabled = None, True
        self.message.object, self.table.object, self.picture.object = "", COMPENSATION_INTRODUCTION, ""

    def _start(self) -> None:
        state, terms = self._state(), tuple(self.terms.value)
        self._withdraw()
        try:
            axis = self._chosen(state)
        except EmpsError as error:
            self._say(str(error), "bad")
            return

        def work(progress: Progress) -> Compensation:
            progress("each term in closed loop", 0.2)
            return compensate(axis, terms=terms)

        def done(compensation: Compensation) -> None:
            if (self._axis, tuple(self.terms.value)) == (state.axis, terms):
                self._done(compensation)

        self.job.start(work, done, lambda text: self._say(text, "bad"))

    def _done(self, compensation: Compensation) -> None:
        self.compensation, self.download.disabled = compensation, False
        units = compensation.axis.units
        warnings = [message for message in compensation.warnings if message.code != "not-compensated"]
        advice = advise("compensate", compensation.to_dict(), units=units)
        controller = f"Controller: {self.controller.value}, {compensation.axis.controller.kind.replace('_', ' ')}."
        shown = "".join(f"<br>{inline(line)}" for line in (controller, *warnings))
        self.message.object = judgement(sentence_of(advice.text), LEVELS[advice.level][0], shown)
        self.table.object = view.html(compensation.view())
        self.picture.object = svg(labelled(tracking_figure(compensation), units), "tracking")

    def _folder(self) -> BytesIO:
        try:
            if self.compensation is None:
                raise EmpsError("no compensation was tested yet")
            data = drive_zip(self.compensation)
        except EmpsError as error:
            self._say(str(error), "bad")
            raise
        return BytesIO(data)

    def _say(self, text: str, level: str, more: str = "") -> None:
        self.message.object = message(text, level, more)
