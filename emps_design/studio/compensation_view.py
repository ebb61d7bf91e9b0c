"""The compensation tab: choose what is fed forward, see the tracking error with and without, take the folder home."""

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
        self.found: Compensation | None = None
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
        self.message, self.left, self.table, self.picture = html(), html(), html(INTRODUCTION), html()
        self.view = pn.Column(
            html("<h3>Terms</h3>"), self.terms, self.left, self.controller, pn.Row(self.run, self.download, margin=0),
            self.job.view,
            self.message, self.table, self.picture, sizing_mode="stretch_width",
        )  # fmt: skip
        self._offer()

    def show(self, state: State) -> None:
        """Offer the terms of the axis of ``state`` where that is another than before."""
        if state.axis != self._axis or (self.found is not None and self._controlled(state) != self.found.axis):
            self._axis = state.axis
            self._offer()

    def _controlled(self, state: State) -> Axis | None:
        """The axis that would be compensated; None where its design is refused."""
        try:
            return self._chosen(state)
        except EmpsError:
            return None

    def _chosen(self, state: State) -> Axis:
        """The axis of ``state`` with the controller that is chosen; :class:`EmpsError` where its design is refused."""
        return state.axis if self.controller.value == OWN else designed(state)

    def _offer(self) -> None:
        try:
            own = bool(follows(self._axis))
        except EmpsError:  # gains that only a record has
            own = False
        chosen = self.controller.value if own else DESIGN
        self.controller.param.update(options=[DESIGN, OWN] if own else [DESIGN], value=chosen)
        possible, left = terms_of(self._axis)
        self.terms.options = {name.replace("_", " "): name for name in possible}
        self.terms.value = list(possible)
        self.left.object = "".join(
            message(f"{name.replace('_', ' ')} is not compensated: {why}", "note") for name, why in left.items()
        )
        self._withdraw()

    def _withdraw(self) -> None:
        """Show no result: the one before was of other terms, or of another axis."""
        self.job.stop()
        self.found, self.download.disabled = None, True
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

        def done(found: Compensation) -> None:
            if (self._axis, tuple(self.terms.value)) == (state.axis, terms):
                self._done(found)

        self.job.start(work, done, lambda text: self._say(text, "stop"))

    def _done(self, found: Compensation) -> None:
        self.found, self.download.disabled = found, False
        ratio = found.without / found.achieved if found.achieved > 0.0 else float("inf")
        said_above = tuple(f"{name} is not compensated" for name in found.not_compensated)
        more = [line for line in found.warnings if not line.startswith(said_above)]
        more += [f"{ON_ERROR.capitalize()}."] * bool(found.feedforward.terms)
        advice = advise("compensate", found.to_dict())
        text = (
            f"Tracking error rms {found.without:.3g} {found.unit} without, {found.achieved:.3g} with what is kept "
            f"({ratio:,.0f} times less), {found.worst:.3g} with every parameter wrong; controller: "
            f"{self.controller.value}, {found.axis.controller.kind.replace('_', ' ')}."
        )
        lines = (text, *more, *(one["advice"] for one in found.feedback))
        shown = "".join(f"<br>{inline(line)}" for line in lines)
        self.message.object = self._axis.units.text(judgement(sentence_of(advice.text), LEVELS[advice.level][0], shown))
        heads = ("term", f"alone [{found.unit}]", "all but it", "all, it wrong", "")
        rows = [
            (term.name.replace("_", " "), *map(_written, (term.alone, term.left_out, term.worst)),
             inline(term.note if term.kept else f"left out: {term.note}"))
            for term in found.terms
        ]  # fmt: skip
        self.table.object = numbers(heads, rows)
        self.picture.object = svg(labelled(tracking_figure(found), found.axis.units), "tracking")

    def _folder(self) -> BytesIO:
        try:
            if self.found is None:
                raise EmpsError("nothing was tried yet")
            data = drive_zip(self.found)
        except EmpsError as error:
            self._say(str(error), "stop")
            raise
        return BytesIO(data)

    def _say(self, text: str, level: str, more: str = "") -> None:
        self.message.object = self._axis.units.text(message(text, level, more))


def _written(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
