"""The data tab: drop a record, identify, observe, diagnose, and take the better model over into the design.

The columns of a dropped file: what each was taken for, to be chosen anew and read again.

What the data tab does with a record, each a job: identify, find the law, observe, respond, diagnose.
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
from emps_design.report.display import quantity, sentence_of
from emps_design.report.page import LEVELS, inline
from emps_design.studio.panes import AxisFile, Job, blocks, html, judgement, message
from emps_design.studio.state import FRICTIONS, State
from emps_design.units import Units

Options = dict[str, Any]  # what the tab chose: friction and filter of Identify, model of Diagnose, record held out
NAMED_MODEL, CLOSEST_MODEL = "named", "closest"

NONE, AS_TITLED = "none", "as titled"
CHOSEN = ("t", "q", "q_ref", "u")  # the columns that a record is made of
UNITS = ("s", "ms", "us", "m", "mm", "um", "rad", "deg", "rev", "V", "mV", "A", "mA", "N m", "N", "%")

LIMIT_MB = 100
SUFFIXES = (".mat", ".csv", ".txt", ".tsv", ".npz")
# The dropper is content with every file that arrived whole; one that is refused must not wear its green tick.
REFUSED = """
[data-filepond-item-state="processing-complete"] .filepond--item-panel { background-color: #9b1c1c !important; }
.filepond--processing-complete-indicator, .filepond--file-status { display: none !important; }
"""
INTRODUCTION = """
<h3>What a record tells</h3>
<table class="about">
<tr><th><b>Identify</b></th><td>mass and friction of the axis with their standard deviations: seconds</td></tr>
<tr><th><b>Law</b></th><td>the controller that made the record, its structure and gains with their deviations, from
reference, position and command alone: seconds</td></tr>
<tr><th><b>Observe</b></th><td>the external force on the carriage, and the smallest that shows: seconds</td></tr>
<tr><th><b>Response</b></th><td>the frequency response from force to velocity with its band, beside the model, and the
masses and the coupling that fit it, where the record was excited: seconds</td></tr>
<tr><th><b>Diagnose</b></th><td>where simulation and record disagree, which effect explains it, and how much of the gap
is gone with it: seconds to minutes, with a bar and a button to cancel</td></tr>
<tr><th><b>Design on this model</b></th><td>take what was identified or diagnosed over into the design tab</td></tr>
</table>
<p>A record has the columns t [s], q_ref [m], q [m], u [V], and f_ext [N] where a force was measured; a .mat may use the
names of the EMPS data set. The export of a drive shows its columns: choose what is what. A file stays on this machine.
To practise, <code>emps-design init start</code> writes three.</p>
"""


def _blocks(units: Units, *blocks: Any) -> str:
    """Blocks of a report page as HTML in the ``units`` of an axis, without the page around them."""
    from emps_design.report import Page, Section

    text = Page("", "", (), (Section("Result", *blocks),), units=units).html()
    start = text.index("</h2>", text.index('<section id="result">')) + len("</h2>")
    return text[start : text.index("</section>", start)]


def _advice(name: str, document: dict[str, Any], record: Record, axis: Axis) -> Advice:
    """What to do with what the command ``name`` finds in ``record``, by its ``document``."""
    return advise(name, document, axis=axis.name, records=[record.name])


def identify_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Identify ``record`` and return the section of the report about it, and the axis it gives."""
    from emps_design.identification import identify
    from emps_design.report.record import identification_blocks

    progress("identifying", 0.2)
    found = identify(record, axis, model=options["friction"], filter=options["chain"], holdout=options.get("held_out"))
    progress("drawing", 0.7)
    values = ", ".join(
        f"{name.replace('_', ' ')} {quantity(e.value, e.quantity.unit)}" for name, e in found.parameters.items()
    )
    judged = found.extra["held_out"]
    judged_on = f", {quantity(judged['rms_error'], 'N')} on {judged['on']}" if options.get("held_out") else ""
    complete = all(estimate.determined for estimate in found.parameters.values())
    return {
        "text": f"Identified: {values}; force error {quantity(found.rms_error, 'N')} rms{judged_on}.",
        "html": _blocks(axis.units, *identification_blocks(found, axis)),
        "model": found.to_axis(name=f"{axis.name.split(' from ')[0]} from {record.name}") if complete else None,
        "advice": _advice("identify", found.to_dict(), record, axis),
    }


def observe_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Observe the external force of ``record`` with the parameters of ``axis``."""
    from emps_design.identification.observation import observe
    from emps_design.report.record import observation_blocks

    progress("observing", 0.2)
    found = observe(record, axis)
    progress("drawing", 0.7)
    least = min(found.methods.values(), key=lambda method: method.smallest.value).smallest.value
    return {
        "text": f"Observed with {axis.name}: forces below {quantity(least, 'N', 3)} cannot be told from errors.",
        "html": _blocks(axis.units, *observation_blocks(found)),
        "advice": _advice("observe", found.to_dict(), record, axis),
    }


def law_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Tell which controller made ``record``; return its table, and ``axis`` with it where it is told."""
    from emps_design.identification.controller import identify_law
    from emps_design.report.record import law_blocks

    progress("trying structures", 0.2)
    found = identify_law(record, axis.drive.command_unit)
    progress("drawing", 0.9)
    table, name = found.controller, f"{axis.name.split(' with the law')[0]} with the law of {record.name}"
    return {
        "text": f"Law {found.verdict}: {found.in_words or found.reason}.",
        "html": _blocks(axis.units, *law_blocks(found)),
        "model": None if table is None else Axis.from_dict({**axis.to_dict(), "controller": table, "name": name}, name),
        "advice": _advice("law", found.to_dict(), record, axis),
    }


def response_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Estimate the frequency response of ``record``; return it beside the model, and the axis that fits it."""
    from emps_design.frequency_response import estimate_response
    from emps_design.report.frequency_response import response_blocks

    found = estimate_response(record, axis, progress=of_part(progress, 0.0, 0.5))
    progress("fitting", 0.6)
    compared = found.comparison
    chain = compared.chain
    progress("drawing", 0.8)
    return {
        "text": f"Response at {len(found.response)} lines by the {found.instrument}: {compared.agreement.sentence}.",
        "html": _blocks(axis.units, *response_blocks(compared, found.spectral_ratio)),
        "model": chain.on(axis).replace(name=f"{axis.name} with the response of {record.name}"),
        "advice": _advice("frf", found.to_dict(), record, axis),
    }


def diagnose_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Find where ``record`` and ``axis`` disagree; return the page's summary and the model that was sought."""
    from emps_design.discrepancy import diagnose
    from emps_design.report.diagnosis import diagnosis_page, typeset

    found = diagnose(
        record,
        axis,
        holdout=options.get("held_out"),
        progress=progress,
        closest=options["sought"] == CLOSEST_MODEL,
    )
    model = found.axis if found.closest is None or found.closest.axis is None else found.closest.axis
    progress("drawing", 0.98)
    page = diagnosis_page(found)
    shown = [*page.summary, *(block for section in page.sections for block in section.blocks)]
    document = found.to_dict()
    return {
        "text": typeset(document.get("sentence", document["verdict"])),
        "html": _blocks(axis.units, *shown),
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
    """Two fields for each column of a record, and a button that hands them to ``read`` as a ``[record]`` table."""

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
        self.about = html("Columns of the file, and what each is. Choose anew where a wrong one was taken.")
        pairs = [pn.Column(self.titles[name], self.units[name], margin=0) for name in CHOSEN]
        self.view = pn.Column(self.about, pn.FlexBox(*pairs, self.button, align_items="flex-start"), visible=False)

    @property
    def table(self) -> ColumnMap:
        """What is chosen, as the ``[record]`` table of an axis file."""
        chosen = {
            KEYS[name]: Column(column=self.titles[name].value, unit=None if unit == AS_TITLED else unit)
            for name in CHOSEN
            if self.titles[name].value != NONE and (unit := self.units[name].value)
        }
        return ColumnMap.model_validate(chosen)

    def show(self, titles: Sequence[str], assigned: Sequence[Assignment], units: Units) -> None:
        """Offer the ``titles`` of a file: what they were ``assigned`` to is chosen, or what they seem to say."""
        taken = {one.name: one.title for one in assigned}
        for name, found in meanings(titles, units).items():
            if len(found) == 1:
                taken.setdefault(name, found[0])
        for name in CHOSEN:
            known = [unit for unit in UNITS if factor_of(unit, name, units) is not None]
            title = taken.get(name, NONE)
            self.titles[name].param.update(options=[NONE, *titles], value=title if title in titles else NONE)
            stated = title_unit(title)[1] in known
            given = next((one.unit for one in assigned if one.name == name and one.unit in known), AS_TITLED)
            self.units[name].param.update(options=[AS_TITLED, *known], value=AS_TITLED if stated else given)
        self.view.visible = True

    def hide(self) -> None:
        """Show nothing: the columns of the file have the names of a record."""
        self.view.visible = False


def read_upload(name: str, content: bytes | str, axis: Axis) -> Record:
    """Read an uploaded record of ``axis`` as any other file is read: checked, never executed or unpickled.

    Raises :class:`RecordError` for another kind of file, or one above the size limit.
    """
    from emps_design.importing import import_bytes

    plain, data = _upload(name, content)
    suffix = PurePath(plain).suffix.lower()
    if suffix not in SUFFIXES:
        raise RecordError(f"{plain}: found a {suffix or 'nameless'} file, expected one of {', '.join(SUFFIXES)}")
    if len(data) > LIMIT_MB * 10**6:
        raise RecordError(f"{plain}: found {len(data) / 1e6:.0f} MB, expected at most {LIMIT_MB} MB")
    return import_bytes(data, plain, axis)


def upload_titles(name: str, content: bytes | str) -> list[str]:
    """The titles of the columns of an upload; none where they cannot be told."""
    from emps_design.records.readers import titles_from_bytes

    plain, data = _upload(name, content)
    try:
        return titles_from_bytes(data, plain)
    except RecordError:
        return []


def _upload(name: str, content: bytes | str) -> tuple[str, bytes]:
    """The name of an upload without a path, and its bytes."""
    plain = PurePath(name.replace("\\", "/")).name
    return plain, content.encode() if isinstance(content, str) else bytes(content)


def _dropper(label: str) -> pn.widgets.FileDropper:
    """A field that one record is dropped on."""
    return pn.widgets.FileDropper(
        label=label, max_file_size=f"{LIMIT_MB}MB", multiple=False, height=76, width=430, layout="compact",
        margin=(4, 6),
    )  # fmt: skip


class DataView:
    """The record, what can be done with it, and what came out.

    ``take(axis)`` hands a model to the design tab; ``another()`` hears of every record that is read, or taken away.
    """

    def __init__(
        self,
        machines: Callable[[], dict[str, Axis]],
        axis_name: str,
        state: Callable[[], State],
        turn: Callable[[str, Any], None],
        take: Callable[[Axis], None],
        record: Record | None = None,
        another: Callable[[], None] = lambda: None,
    ):
        self._machines, self._take, self._another = machines, take, another
        self.record: Record | None = None
        self.held_out: Record | None = None
        self.model: Axis | None = None
        self._dropped_last: tuple[str, bytes | str] | None = None
        self._second_last: tuple[str, bytes | str] | None = None
        self._work = ""  # whose result is shown, or at work
        self._table: ColumnMap | None = None
        self.columns = ColumnsView(self._read_columns)
        self.drop = _dropper(f"Record: drop or choose one; {', '.join(SUFFIXES)}, at most {LIMIT_MB} MB")
        self.drop.param.watch(self._dropped, "value")
        self.second = _dropper("Second record, held out: Identify and Diagnose are tried on it")
        self.second.param.watch(self._second_dropped, "value")
        self.file = AxisFile(self._axis_opened, lambda text: self._say(text, "stop"))
        self.machine = pn.widgets.Select(
            label="Axis of the record", options=list(machines()), value=axis_name, width=230, margin=(4, 6)
        )
        self.machine.param.watch(self._of_another, "value")
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
            choice.param.watch(self._of_others, "value")
        self.buttons = {name: self._button(name) for name in WORK}
        self.take = pn.widgets.Button(
            label="Design on this model", disabled=True, width=180, color="success", margin=(24, 6, 4, 6)
        )
        self.take.on_click(self._taken)
        self.job = Job()
        self.message, self.about, self.result = html(), html(INTRODUCTION), blocks()
        # The result stands beside the record where the window is wide, below it elsewhere.
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
        name, content = list(event.new.items())[-1]  # an earlier file stays in the value; the last is the one dropped
        if (name, content) == self._dropped_last:  # taking an earlier file away tells of this one again
            return
        self._dropped_last, self._table = (name, content), None
        self._read_columns(None)

    def _second_dropped(self, event: Any) -> None:
        """Hold the record out that was dropped, or none where it was taken away; no result of another stays."""
        dropped = list(event.new.items())[-1] if event.new else None
        if dropped == self._second_last:
            return
        self._second_last = dropped
        refused = self._read_second()
        if self.record is not None:
            self._show(self.record)
        if refused:
            self._say(refused, "stop")

    def _read_second(self) -> str:
        """Read the record that is held out like the first one; why it is refused, empty where it is not."""
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
        """Design on an axis from a file, and take the record for one of it."""
        self._take(axis)
        self.of(axis)

    def of(self, axis: Axis) -> None:
        """Take the record for one of ``axis``."""
        self.machine.options = list(self._machines())
        if self.machine.value == axis.name:  # the same file, edited
            self.machine.param.trigger("value")
        self.machine.value = axis.name

    def _read_columns(self, table: ColumnMap | None) -> None:
        """Read what was dropped last, by ``table`` where columns were chosen; offer the columns of an export."""
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
                self._say(refused, "stop")
        except EmpsError as error:
            self._withdraw()
            self._say(str(error), "stop")
        plain = bool(assigned) and all(one.how == NAMED for one in assigned)
        titles = [] if plain else upload_titles(name, content)
        if not titles:
            self.columns.hide()
        elif table is None:
            self.columns.show(titles, assigned, axis.units)

    def _of_another(self, event: Any) -> None:
        """Read the record anew for another axis: what was found, and the columns, were those of the one before."""
        self._table = None
        if self._dropped_last is not None:
            self._read_columns(None)
        else:
            self._of_others(event)

    def _of_others(self, event: Any) -> None:
        """Show no result of other choices than those that stand above it."""
        reader = "Diagnose" if event.obj is self.sought else "Identify"
        if self.record is not None and (self._work == reader or event.obj is self.machine):
            self._show(self.record)

    @property
    def _axis(self) -> Axis:
        """The axis that is chosen, with the columns that were chosen for the record."""
        axis = self._machines()[self.machine.value]
        return axis if self._table is None else axis.replace(record=self._table)

    @property
    def measured(self) -> dict[str, Any]:
        """The record, its axis and the filter that were chosen, for a report; empty without a record."""
        if self.record is None:
            return {}
        return {"record": self.record, "record_axis": self._axis, "chain": self.filter.value}

    def _withdraw(self) -> None:
        """Show no record and no result: after a refused upload the ones before would stand under its name."""
        self.job.stop()
        self.record, self.model = None, None
        self.take.disabled = True
        for button in self.buttons.values():
            button.disabled = True
        self.drop.stylesheets = [REFUSED]
        self.about.object, self.result.object = INTRODUCTION, ""
        self._another()

    def _show(self, record: Record) -> None:
        from emps_design.report import style
        from emps_design.report.record import record_figure

        self.job.stop()
        self.record, self.model = record, None
        self.take.disabled = True
        self.drop.stylesheets = []
        for button in self.buttons.values():
            button.disabled = False
        both = [record, *([] if self.held_out is None else [self.held_out])]
        notes = "".join(f"<br>{inline(warning)}" for one in both for warning in one.warnings)
        said = "; held out ".join(
            f"{one.name}: {len(one)} samples of {quantity(one.period, 's')}, {quantity(one.duration, 's', 3)} in all"
            for one in both
        )
        self._say(said, "warning" if notes else "good", notes)
        self.about.object = f'<div class="record">{style.svg(record_figure(record, self._axis.units), "record")}</div>'
        self.result.object = ""
        self._another()

    def _say(self, text: str, level: str, more: str = "") -> None:
        self.message.object = message("", level, self._own(inline(text) + more))

    def _own(self, text: str) -> str:
        """``text`` in the units and words of the axis of the record."""
        return self._axis.units.text(text)

    def _button(self, name: str) -> pn.widgets.Button:
        """A button that starts the work ``name``."""
        button = pn.widgets.Button(label=name, disabled=True, width=110, color="primary", margin=(24, 6, 4, 6))
        button.on_click(lambda event: self._start(name))
        return button

    def _start(self, name: str) -> None:
        if self.record is None:
            return
        work = WORK[name]
        record, axis = self.record, self._axis
        if name == "Law" and self.model is not None:  # a controller goes on what was found of the same record
            axis = self.model
        options = {
            "friction": self.friction.value,
            "chain": self.filter.value,
            "sought": self.sought.value,
            "held_out": self.held_out,
        }

        def of_this_record(show: Callable[[Any], None]) -> Callable[[Any], None]:
            return lambda outcome: show(outcome) if self.record is record else None

        outcome = of_this_record(self._done), of_this_record(self._failed)
        if not self.job.occupied:
            self._work = name
            self._say(f"{name} is at work on {record.name}", "note")
            self.job.start(lambda progress: work(record, axis, options, progress), *outcome)

    def _failed(self, message: str) -> None:
        self._say(message, "stop")

    def _done(self, found: dict[str, Any]) -> None:
        advice, summary = found["advice"], inline(found["text"])
        level = LEVELS[advice.level][0]
        self.message.object = self._own(judgement(sentence_of(advice.text), level, f"<br>{summary}"))
        self.result.object = found["html"]
        self.model = found.get("model")
        self.take.disabled = self.model is None

    def _taken(self, event: Any) -> None:
        if self.model is not None:
            self._take(self.model)
            self.machine.options = list(self._machines())
            self._say(f"The design tab now works on {self.model.name}.", "good")
