"""The compensation tab: choose the feed-forward terms, compare the tracking errors, download the files for a drive."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO

import panel as pn

from emps_design.advice import advise
from emps_design.axis import Axis
from emps_design.compensation import Compensation, compensate
from emps_design.compensation.feedforward import terms_of
from emps_design.compensation.study import ON_ERROR
from emps_design.errors import EmpsError
from emps_design.progress import Progress
from emps_design.report.display import sentence_of
from emps_design.report.motion import tracking_figure
from emps_design.report.page import LEVELS, inline
from emps_design.report.style import labelled, svg
from emps_design.studio.files_view import BUTTON, designed, drive_zip, follows
from emps_design.studio.panes import Job, html, judgement, message, numbers
from emps_design.studio.state import State

FOLDER = "emps-design-drive.zip"
DESIGN, OWN = "the design's", "the axis's own"  # controllers to be tried
INTRODUCTION = """
<h3>What is fed forward</h3>
<p>The command that the model says the reference needs, by the terms that are chosen, beside what the controller
answers: that of the design tab, or the axis's own where it follows a reference. Each term is tried in closed loop on
the nonlinear axis, alone and with its parameters 2 % and its phase 10 degrees wrong; one that does harm then is left
out.</p>
<p>The folder has the axis with the controller that was tried, the compensation, and both in C99 with the vectors that
prove it: <code>make check</code> in <code>code</code> runs them.</p>
"""


class CompensationView:
    """Choose terms, try them, and download axis, compensation and code."""

    def __init__(self, state: Callable[[], State]):
        self._state, self._axis = state, state().axis
        self.compensation: Compensation | None = None
        self.terms = pn.widgets.CheckBoxGroup(label="Terms", inline=True, margin=(8, 6))
        self.terms.param.watch(lambda event: self._withdraw(), "value")
        self.controller = pn.widgets.Select(label="Controller", options=[DESIGN], width=200, margin=(4, 6))
        self.controller.param.watch(lambda event: self._withdraw(), "value")
        self.run = pn.widgets.Button(label="Try them", color="primary", width=110, margin=(4, 6))
        self.run.on_click(lambda event: self._start())
        self.download = pn.widgets.FileDownload(
            callback=self._folder, filename=FOLDER, label="Download the folder", color="primary", width=200,
            margin=(4, 6), disabled=True, stylesheets=[BUTTON],
        )  # fmt: skip
        self.job = Job()
        self.message, self.not_compensated = html(), html()
        self.table, self.picture = html(INTRODUCTION), html()
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
        """The axis that would be compensated, or None if its design is refused."""
        try:
            return self._chosen(state)
        except EmpsError:
            return None

    def _chosen(self, state: State) -> Axis:
        """The axis of ``state`` with the chosen controller; :class:`EmpsError` if its design is refused."""
        return state.axis if self.controller.value == OWN else designed(state)

    def _offer(self) -> None:
        try:
            own = bool(follows(self._axis))
        except EmpsError:  # gains that only a record has
            own = False
        chosen = self.controller.value if own else DESIGN
        self.controller.param.update(options=[DESIGN, OWN] if own else [DESIGN], value=chosen)
        possible, excluded = terms_of(self._axis)
        self.terms.options = {name.replace("_", " "): name for name in possible}
        self.terms.value = list(possible)
        self.not_compensated.object = "".join(
            message(f"{name.replace('_', ' ')} is not compensated: {why}", "note") for name, why in excluded.items()
        )
        self._withdraw()

    def _withdraw(self) -> None:
        """Remove the result: it was of other terms or of another axis."""
        self.job.stop()
        self.compensation, self.download.disabled = None, True
        self.message.object, self.table.object, self.picture.object = "", INTRODUCTION, ""

    def _start(self) -> None:
        state, terms = self._state(), tuple(self.terms.value)
        self._withdraw()
        try:
            axis = self._chosen(state)
        except EmpsError as error:
            self._say(str(error), "stop")
            return

        def work(progress: Progress) -> Compensation:
            progress("each term in closed loop", 0.2)
            return compensate(axis, terms=terms)

        def done(compensation: Compensation) -> None:
            if (self._axis, tuple(self.terms.value)) == (state.axis, terms):
                self._done(compensation)

        self.job.start(work, done, lambda text: self._say(text, "stop"))

    def _done(self, compensation: Compensation) -> None:
        self.compensation, self.download.disabled = compensation, False
        ratio = compensation.without / compensation.achieved if compensation.achieved > 0.0 else float("inf")
        shown_above = tuple(f"{name} is not compensated" for name in compensation.not_compensated)
        more = [line for line in compensation.warnings if not line.startswith(shown_above)]
        more += [f"{ON_ERROR.capitalize()}."] * bool(compensation.feedforward.terms)
        advice = advise("compensate", compensation.to_dict())
        text = (
            f"Tracking error rms {compensation.without:.3g} {compensation.unit} without, {compensation.achieved:.3g} "
            f"with what is kept ({ratio:,.0f} times less), {compensation.worst:.3g} with every parameter wrong; "
            f"controller: {self.controller.value}, {compensation.axis.controller.kind.replace('_', ' ')}."
        )
        lines = (text, *more, *(remedy["advice"] for remedy in compensation.feedback))
        shown = "".join(f"<br>{inline(line)}" for line in lines)
        self.message.object = self._axis.units.text(judgement(sentence_of(advice.text), LEVELS[advice.level][0], shown))
        heads = ("term", f"alone [{compensation.unit}]", "all but it", "all, it wrong", "")
        rows = [
            (term.name.replace("_", " "), *map(_written, (term.alone, term.left_out, term.worst)),
             inline(term.note if term.kept else f"left out: {term.note}"))
            for term in compensation.terms
        ]  # fmt: skip
        self.table.object = numbers(heads, rows)
        self.picture.object = svg(labelled(tracking_figure(compensation), compensation.axis.units), "tracking")

    def _folder(self) -> BytesIO:
        try:
            if self.compensation is None:
                raise EmpsError("nothing was tried yet")
            data = drive_zip(self.compensation)
        except EmpsError as error:
            self._say(str(error), "stop")
            raise
        return BytesIO(data)

    def _say(self, text: str, level: str, more: str = "") -> None:
        self.message.object = self._axis.units.text(message(text, level, more))


def _written(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
