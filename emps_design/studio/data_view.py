"""The data tab: load a record, choose its columns, and run a job on it; the design tab can use the resulting model.

The jobs identify parameters, identify the control law, observe the external force, estimate the frequency response, or
diagnose what the model lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import PurePath
from typing import Any

import panel as pn

from emps_design.advice import Advice, advise
from emps_design.axis import Axis
from emps_design.errors import EmpsError, RecordError
from emps_design.identification.chains import CHAINS, DEFAULT_CHAIN
from emps_design.progress import of_part
from emps_design.records import Record
from emps_design.records.columns import factor_of, meanings, title_unit
from emps_design.records.layout import KEYS, NAMED, Assignment, Column, ColumnMap
from emps_design.report.page import LEVELS, Line, Numbered, inline, quantity, sentence_of
from emps_design.studio.panes import AxisFile, Job, blocks, html, judgement, message
from emps_design.studio.state import FRICTIONS, State
from emps_design.units import Units
from emps_design.view import typeset

Options = dict[str, Any]  # choices of the tab: friction and filter of Identify, model of Diagnose, held-out record
NAMED_MODEL, CLOSEST_MODEL = "named", "closest"

NONE, AS_TITLED = "none", "as titled"
CHOSEN = ("t", "q", "q_ref", "u")  # the columns of a record that the tab offers
UNITS = ("s", "ms", "us", "m", "mm", "um", "rad", "deg", "rev", "V", "mV", "A", "mA", "N m", "N", "%")

LIMIT_MB = 100
SUFFIXES = (".mat", ".csv", ".txt", ".tsv", ".npz")
# The file dropper marks every uploaded file as accepted; a refused one must not keep the green tick.
REFUSED = """
[data-filepond-item-state="processing-complete"] .filepond--item-panel { background-color: #9b1c1c !important; }
.filepond--processing-complete-indicator, .filepond--file-status { display: none !important; }
"""
INTRODUCTION = """
<h3>What you can do with a record</h3>
<table class="about">
<tr><th><b>Identify</b></th><td>mass and friction of the axis with their standard deviations (takes seconds)</td></tr>
<tr><th><b>Law</b></th><td>the controller that made the record: structure and gains with standard deviations, from
reference, position and command only (takes seconds)</td></tr>
<tr><th><b>Observe</b></th><td>the external force on the axis, and the smallest observable one (takes seconds)</td></tr>
<tr><th><b>Response</b></th><td>the frequency response from force to velocity with its confidence band and that of the
model, and the masses and the coupling that fit it, if the record has an excitation (takes seconds)</td></tr>
<tr><th><b>Diagnose</b></th><td>where simulation and record disagree, which effect explains it, and how much smaller the
gap is with that effect (takes seconds to minutes; can be cancelled)</td></tr>
<tr><th><b>Design on this model</b></th><td>use the identified or diagnosed model in the design tab</td></tr>
</table>
<p>A record has the columns t [s], q_ref [m], q [m], u [V], and f_ext [N] if a force was measured; a .mat may use the
names of the EMPS data set. For the export of a drive, choose what each column stands for. Files stay on this machine.
<code>emps-design init start</code> writes three records to practise with.</p>
"""


def _advice(name: str, document: dict[str, Any], record: Record, axis: Axis) -> Advice:
    """Return the advice on the ``document`` of the command ``name`` for ``record``."""
    return advise(name, document, axis=axis.name, records=[record.name], units=axis.units)


def identify_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Identify ``record``; return the section of the report on it and the identified axis."""
    from emps_design.identification import identify
    from emps_design.report.record import identification_blocks

    progress("identifying", 0.2)
    choices = {"model": options["friction"], "filter": options["chain"], "holdout": options.get("held_out")}
    identification = identify(record, axis, **choices)
    progress("drawing", 0.7)
    estimates, units = identification.parameters, axis.units
    values = ", ".join(
        f"{units.words(name.replace('_', ' '))} {quantity(e.value, e.quantity.unit, units=units)}"
        for name, e in estimates.items()
    )
    error, judged_on = quantity(identification.rms_error, "N", units=units), ""
    if options.get("held_out"):
        judged = identification.extra["held_out"]
        judged_on = f", {quantity(judged['rms_error'], 'N', units=units)} on {judged['on']}"
    complete = all(estimate.determined for estimate in estimates.values())
    name = f"{axis.name.split(' from ')[0]} from {record.name}"
    return {
        "text": f"Identified: {values}; {units.word('force')} error {error} rms{judged_on}.",
        "html": Numbered(axis.units).html(identification_blocks(identification, axis)),
        "model": identification.to_axis(name=name) if complete else None,
        "advice": _advice("identify", identification.to_dict(), record, axis),
    }


def observe_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Observe the external force of ``record`` with the parameters of ``axis``."""
    from emps_design.identification.observation import observe
    from emps_design.report.record import observation_blocks

    progress("observing", 0.2)
    observation = observe(record, axis)
    progress("drawing", 0.7)
    units = axis.units
    least = min(observation.methods.values(), key=lambda method: method.smallest.value).smallest.value
    return {
        "text": f"Observed with {axis.name}: {units.word('forces')} below {quantity(least, 'N', 3, units)} cannot be "
        "distinguished from errors.",
        "html": Numbered(units).html(observation_blocks(observation)),
        "advice": _advice("observe", observation.to_dict(), record, axis),
    }


def law_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Identify the controller that made ``record``; return the section on it, and ``axis`` with it if identified."""
    from emps_design.identification.controller import identify_law

    progress("trying structures", 0.2)
    law = identify_law(record, axis.units)
    progress("drawing", 0.9)
    table, name = law.controller, f"{axis.name.split(' with the law')[0]} with the law of {record.name}"
    return {
        "text": f"Law {law.verdict}: {law.in_words or law.reason}.",
        "html": Numbered(axis.units).html(law.view()),
        "model": None if table is None else Axis.from_dict({**axis.to_dict(), "controller": table, "name": name}, name),
        "advice": _advice("law", law.to_dict(), record, axis),
    }


def response_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Estimate the frequency response of ``record``; return it with the model's, and the axis that fits it."""
    from emps_design.frequency_response import estimate_response
    from emps_design.report.loop_figures import response_picture

    estimate = estimate_response(record, axis, progress=of_part(progress, 0.0, 0.5))
    progress("fitting", 0.6)
    comparison = estimate.comparison
    chain = comparison.chain
    lines, sentence = len(estimate.response), comparison.agreement.sentence
    progress("drawing", 0.8)
    warnings = [Line(warning, "note") for warning in estimate.all_warnings]
    shown = (response_picture(comparison, estimate.spectral_ratio), *estimate.view(), *warnings)
    return {
        "text": f"Response at {lines} lines, excited by the {estimate.instrument}: {sentence}.",
        "html": Numbered(axis.units).html(shown),
        "model": chain.on(axis).replace(name=f"{axis.name} with the response of {record.name}"),
        "advice": _advice("frf", estimate.to_dict(), record, axis),
    }


def diagnose_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Diagnose ``record`` on ``axis``; return the blocks of the page, and the named or the closest model."""
    from emps_design.discrepancy import diagnose
    from emps_design.report.diagnosis import diagnosis_page

    diagnosis = diagnose(
        record,
        axis,
        holdout=options.get("held_out"),
        progress=progress,
        closest=options["sought"] == CLOSEST_MODEL,
    )
    model = diagnosis.axis if diagnosis.closest is None or diagnosis.closest.axis is None else diagnosis.closest.axis
    progress("drawing", 0.98)
    page = diagnosis_page(diagnosis)
    shown = [*page.summary, *(block for section in page.sections for block in section.blocks)]
    document = diagnosis.to_dict()
    return {
        "text": typeset(document.get("sentence", document["verdict"])),
        "html": Numbered(axis.units).html(shown),
        "model": model.replace(name=f"{axis.name} diagnosed on {record.name}"),
        "advice": _advice("diagnose", document, record, axis),
    }


WORK = {
    "Identify": identify_work,
    "Law": law_work,
    "Observe": observe_work,
    "Response": response_work,
    "Diagnose": diagnose_work,
}


class ColumnsView:
    """Fields for title and unit of each column of a record; the button calls ``read`` with the ``[record]`` table."""

    def __init__(self, read: Callable[[ColumnMap], None]):
        self._read = read
        self.titles = {
            name: pn.widgets.Select(label=KEYS[name].capitalize(), options=[NONE], width=190, margin=(4, 6))
            for name in CHOSEN
        }
        self.units = {
            name: pn.widgets.Select(label=f"Unit of {KEYS[name]}", options=[AS_TITLED], width=110, margin=(4, 6))
            for name in CHOSEN
        }
        self.button = pn.widgets.Button(label="Read these columns", color="primary", width=160, margin=(24, 6, 4, 6))
        self.button.on_click(lambda event: self._read(self.table))
        self.about = html("Columns of the file and their meaning. Correct the choice where it is wrong.")
        pairs = [pn.Column(self.titles[name], self.units[name], margin=0) for name in CHOSEN]
        self.view = pn.Column(self.about, pn.FlexBox(*pairs, self.button, align_items="flex-start"), visible=False)

    @property
    def table(self) -> ColumnMap:
        """The choice as the ``[record]`` table of an axis file."""
        chosen = {
            KEYS[name]: Column(column=self.titles[name].value, unit=None if unit == AS_TITLED else unit)
            for name in CHOSEN
            if self.titles[name].value != NONE and (unit := self.units[name].value)
        }
        return ColumnMap.model_validate(chosen)

    def show(self, titles: Sequence[str], assigned: Sequence[Assignment], units: Units) -> None:
        """Offer the ``titles`` of a file; preselect the ``assigned`` columns, or those that the titles suggest."""
        chosen = {assignment.name: assignment.title for assignment in assigned}
        for name, candidates in meanings(titles, units).items():
            if len(candidates) == 1:
                chosen.setdefault(name, candidates[0])
        for name in CHOSEN:
            known = [unit for unit in UNITS if factor_of(unit, name, units) is not None]
            title = chosen.get(name, NONE)
            self.titles[name].param.update(options=[NONE, *titles], value=title if title in titles else NONE)
            stated = title_unit(title)[1] in known
            units_read = (assignment.unit for assignment in assigned if assignment.name == name)
            unit_option = next((unit for unit in units_read if unit in known), AS_TITLED)
            self.units[name].param.update(options=[AS_TITLED, *known], value=AS_TITLED if stated else unit_option)
        self.view.visible = True

    def hide(self) -> None:
        """Hide the fields: the columns of the file have the names of a record."""
        self.view.visible = False


def read_upload(name: str, content: bytes | str, axis: Axis) -> Record:
    """Read an uploaded record of ``axis`` with the checks of any other file; it is never executed or unpickled.

    Raises :class:`RecordError` for another kind of file, or one above :data:`LIMIT_MB`.
    """
    from emps_design.importing import import_bytes

    file, data = _upload(name, content)
    suffix = PurePath(file).suffix.lower()
    if suffix not in SUFFIXES:
        raise RecordError(f"{file}: found suffix {suffix or 'none'}, expected one of {', '.join(SUFFIXES)}")
    if len(data) > LIMIT_MB * 10**6:
        raise RecordError(f"{file}: found {len(data) / 1e6:.0f} MB, expected at most {LIMIT_MB} MB")
    return import_bytes(data, file, axis)


def upload_titles(name: str, content: bytes | str) -> list[str]:
    """Return the column titles of an upload, [] if they cannot be read."""
    from emps_design.records.readers import titles_from_bytes

    file, data = _upload(name, content)
    try:
        return titles_from_bytes(data, file)
    except RecordError:
        return []


def _upload(name: str, content: bytes | str) -> tuple[str, bytes]:
    """The file name of an upload without its folder, and its bytes."""
    file = PurePath(name.replace("\\", "/")).name
    return file, content.encode() if isinstance(content, str) else bytes(content)


def _dropper(label: str) -> pn.widgets.FileDropper:
    """Return a field that takes one record by drag and drop."""
    return pn.widgets.FileDropper(
        label=label, max_file_size=f"{LIMIT_MB}MB", multiple=False, height=76, width=430, layout="compact",
        margin=(4, 6),
    )  # fmt: skip


class DataView:
    """The record, the jobs on it, and the result of the last one.

    ``take(axis)`` passes a model to the design tab; ``record_changed()`` is called when a record is read or removed.
    """

    def __init__(
        self,
        machines: Callable[[], dict[str, Axis]],
        axis_name: str,
        state: Callable[[], State],
        turn: Callable[[str, Any], None],
        take: Callable[[Axis], None],
        record: Record | None = None,
        record_changed: Callable[[], None] = lambda: None,
    ):
        self._machines, self._take, self._record_changed = machines, take, record_changed
        self.record: Record | None = None
        self.held_out: Record | None = None
        self.model: Axis | None = None
        self._dropped_last: tuple[str, bytes | str] | None = None
        self._second_last: tuple[str, bytes | str] | None = None
        self._work = ""  # name of the job that runs or whose result is shown
        self._table: ColumnMap | None = None
        self.columns = ColumnsView(self._read_columns)
        self.drop = _dropper(f"Record: drop or choose one; {', '.join(SUFFIXES)}, at most {LIMIT_MB} MB")
        self.drop.param.watch(self._dropped, "value")
        self.second = _dropper("Second record, held out: to judge Identify and Diagnose")
        self.second.param.watch(self._second_dropped, "value")
        self.file = AxisFile(self._axis_opened, lambda text: self._say(text, "bad"))
        self.machine = pn.widgets.Select(
            label="Axis of the record", options=list(machines()), value=axis_name, width=230, margin=(4, 6)
        )
        self.machine.param.watch(self._axis_chosen, "value")
        self.friction = pn.widgets.RadioButtonGroup(
            label="Friction", options=list(FRICTIONS), value=state().friction, margin=(22, 6, 4, 6)
        )
        self.friction.param.watch(lambda event: turn("friction", event.new), "value")
        self.filter = pn.widgets.Select(
            label="Filter of Identify", options=list(CHAINS), value=DEFAULT_CHAIN, width=110, margin=(4, 6)
        )
        self.sought = pn.widgets.Select(
            label="Model of Diagnose", options=[NAMED_MODEL, CLOSEST_MODEL], width=100, margin=(4, 6)
        )
        for choice in (self.friction, self.filter, self.sought):
            choice.param.watch(self._choice_changed, "value")
        self.buttons = {name: self._button(name) for name in WORK}
        self.take = pn.widgets.Button(
            label="Design on this model", disabled=True, width=180, color="success", margin=(24, 6, 4, 6)
        )
        self.take.on_click(self._taken)
        self.job = Job()
        self.message, self.about, self.result = html(), html(INTRODUCTION), blocks()
        # In a wide window the result stands beside the record, otherwise below it.
        self.about.styles = {"flex": "1 1 560px", "max-width": "900px"}
        self.result.styles = {"flex": "1 1 700px"}
        self.view = pn.Column(
            pn.FlexBox(
                pn.Column(self.drop, self.second, margin=0),
                pn.Column(
                    pn.Row(self.machine, self.file.field, margin=0),
                    pn.Row(
                        pn.pane.HTML("Friction model", margin=(29, 0, 0, 6)),
                        self.friction,
                        self.filter,
                        self.sought,
                        margin=0,
                    ),
                    pn.Row(*self.buttons.values(), self.take, margin=(-14, 0, 0, 0)),
                    margin=0,
                ),
                align_items="flex-start",
            ),
            self.job.view,
            self.message,
            self.columns.view,
            pn.FlexBox(self.about, self.result, align_items="flex-start", sizing_mode="stretch_width"),
            sizing_mode="stretch_width",
        )
        if record is not None:
            self._show(record)

    def show(self, state: State) -> None:
        """Show the friction model of ``state``."""
        self.friction.value = state.friction
        self.machine.options = list(self._machines())

    def _dropped(self, event: Any) -> None:
        if not event.new:
            return
        name, content = list(event.new.items())[-1]  # earlier files stay in the value; the last one is new
        if (name, content) == self._dropped_last:  # removing an earlier file sends the last one again
            return
        self._dropped_last, self._table = (name, content), None
        self._read_columns(None)

    def _second_dropped(self, event: Any) -> None:
        """Read the new held-out record, or none after a removal, and clear the previous result."""
        dropped = list(event.new.items())[-1] if event.new else None
        if dropped == self._second_last:
            return
        self._second_last = dropped
        refused = self._read_second()
        if self.record is not None:
            self._show(self.record)
        if refused:
            self._say(refused, "bad")

    def _read_second(self) -> str:
        """Read the held-out record; return why it is refused, or ""."""
        self.held_out, self.second.stylesheets = None, []
        if self._second_last is None:
            return ""
        try:
            self.held_out = read_upload(*self._second_last, self._axis)
        except EmpsError as error:
            self.second.stylesheets = [REFUSED]
            return f"second record: {error}"
        return ""

    def _axis_opened(self, axis: Axis) -> None:
        """Design on an axis from a file, and read the record with it."""
        self._take(axis)
        self.of(axis)

    def of(self, axis: Axis) -> None:
        """Read the record with ``axis``."""
        self.machine.options = list(self._machines())
        if self.machine.value == axis.name:  # the same file, edited
            self.machine.param.trigger("value")
        self.machine.value = axis.name

    def _read_columns(self, table: ColumnMap | None) -> None:
        """Read the last file, with the columns of ``table`` if given, and offer the columns of an export."""
        if self._dropped_last is None:
            return
        (name, content), axis = self._dropped_last, self._axis
        axis = axis if table is None else axis.replace(record=table)
        assigned: tuple[Assignment, ...] = ()
        try:
            record = read_upload(name, content, axis)
            assigned, self._table = record.assigned, table
            refused = self._read_second()
            self._show(record)
            if refused:
                self._say(refused, "bad")
        except EmpsError as error:
            self._withdraw()
            self._say(str(error), "bad")
        has_record_names = bool(assigned) and all(assignment.how == NAMED for assignment in assigned)
        titles = [] if has_record_names else upload_titles(name, content)
        if not titles:
            self.columns.hide()
        elif table is None:
            self.columns.show(titles, assigned, axis.units)

    def _axis_chosen(self, event: Any) -> None:
        """Read the record again for another axis, since result and columns depend on the axis."""
        self._table = None
        if self._dropped_last is not None:
            self._read_columns(None)
        else:
            self._choice_changed(event)

    def _choice_changed(self, event: Any) -> None:
        """Clear a result that was made with other choices than the present ones."""
        reader = "Diagnose" if event.obj is self.sought else "Identify"
        if self.record is not None and (self._work == reader or event.obj is self.machine):
            self._show(self.record)

    @property
    def _axis(self) -> Axis:
        """The chosen axis, with the columns that were chosen for the record."""
        axis = self._machines()[self.machine.value]
        return axis if self._table is None else axis.replace(record=self._table)

    @property
    def measured(self) -> dict[str, Any]:
        """Record, axis and filter as arguments of a report; empty without a record."""
        if self.record is None:
            return {}
        return {"record": self.record, "record_axis": self._axis, "record_filter": self.filter.value}

    def _withdraw(self) -> None:
        """Clear record and result, so that they do not stand under the name of a refused upload."""
        self.job.stop()
        self.record, self.model = None, None
        self.take.disabled = True
        for button in self.buttons.values():
            button.disabled = True
        self.drop.stylesheets = [REFUSED]
        self.about.object, self.result.object = INTRODUCTION, ""
        self._record_changed()

    def _show(self, record: Record) -> None:
        from emps_design.report import style
        from emps_design.report.record import in_words, record_figure

        self.job.stop()
        self.record, self.model = record, None
        self.take.disabled = True
        self.drop.stylesheets = []
        for button in self.buttons.values():
            button.disabled = False
        records = [record, *([] if self.held_out is None else [self.held_out])]
        notes = "".join(f"<br>{inline(warning)}" for shown in records for warning in shown.warnings)
        summary = "; held out ".join(f"{shown.name}: {in_words(shown)}" for shown in records)
        self._say(summary, "warning" if notes else "good", notes)
        self.about.object = f'<div class="record">{style.svg(record_figure(record, self._axis.units), "record")}</div>'
        self.result.object = ""
        self._record_changed()

    def _say(self, text: str, level: str, more: str = "") -> None:
        self.message.object = message(text, level, more)

    def _button(self, name: str) -> pn.widgets.Button:
        """Return the button that starts the job ``name``."""
        button = pn.widgets.Button(label=name, disabled=True, width=110, color="primary", margin=(24, 6, 4, 6))
        button.on_click(lambda event: self._start(name))
        return button

    def _start(self, name: str) -> None:
        if self.record is None:
            return
        work = WORK[name]
        record, axis = self.record, self._axis
        if name == "Law" and self.model is not None:  # add the controller to the model of the same record
            axis = self.model
        options = {
            "friction": self.friction.value,
            "chain": self.filter.value,
            "sought": self.sought.value,
            "held_out": self.held_out,
        }

        def if_current(show: Callable[[Any], None]) -> Callable[[Any], None]:
            return lambda outcome: show(outcome) if self.record is record else None

        callbacks = if_current(self._done), if_current(self._failed)
        if not self.job.occupied:
            self._work = name
            self._say(f"{name} is running on {record.name}", "note")
            self.job.start(lambda progress: work(record, axis, options, progress), *callbacks)

    def _failed(self, message: str) -> None:
        self._say(message, "bad")

    def _done(self, outcome: dict[str, Any]) -> None:
        advice, summary = outcome["advice"], inline(outcome["text"])
        level = LEVELS[advice.level][0]
        self.message.object = judgement(sentence_of(advice.text), level, f"<br>{summary}")
        self.result.object = outcome["html"]
        self.model = outcome.get("model")
        self.take.disabled = self.model is None

    def _taken(self, event: Any) -> None:
        if self.model is not None:
            self._take(self.model)
            self.machine.options = list(self._machines())
            self._say(f"The design tab now uses {self.model.name}.", "good")
