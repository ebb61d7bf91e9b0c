"""The files tab: save and load the whole state; export report, figures, model and gains."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from io import BytesIO
from typing import Any

import panel as pn

from emps_design.errors import EmpsError
from emps_design.progress import Progress
from emps_design.report.page import inline
from emps_design.studio import exports
from emps_design.studio.jobs import Job
from emps_design.studio.panes import html, message
from emps_design.studio.state import State

Work = Callable[[Progress], bytes]
# A download is a link in a button's dress, which the button's type does not colour.
BUTTON = ":host { --surface-color: #0072b2; --surface-text-color: #fff; }"
REPORT = "the whole design as one page to read, print and hand on, with the record where one is loaded"
VECTORS, PIXELS = "every figure of the design as vectors, for a paper", "the same as pixels, for slides"
MODEL = "the axis with the controller of the design: every emps-design command takes it"
GAINS = "gains and margins, as emps-design gains --json prints them"
STATE = "everything the controls of all tabs hold, and the pinned design: to go on another day"


class FilesView:
    """Buttons that hand out files of the state as it is now, and a field that loads a saved state."""

    def __init__(
        self, state: Callable[[], State], measured: Callable[[], dict[str, Any]], loaded: Callable[[State], None]
    ):
        self._state, self._loaded = state, loaded
        self.message, self.job = html(), Job()

        def report() -> Work:
            now, of_record = state(), measured()  # as they are when the button is pressed
            return lambda progress: exports.report_html(now, of_record, progress).encode()

        def pictures(kind: str) -> Callable[[], Work]:
            def begun() -> Work:
                now = state()
                return lambda progress: exports.figures_zip(now, kind, progress)

            return begun

        long: tuple[tuple[str, str, str, Callable[[], Work]], ...] = (
            ("Report (HTML)", "report.html", REPORT, report),
            ("Figures (SVG)", "figures-svg.zip", VECTORS, pictures("svg")),
            ("Figures (PNG)", "figures-png.zip", PIXELS, pictures("png")),
        )
        short: tuple[tuple[str, str, str, Callable[[], str]], ...] = (
            ("Model (TOML)", "model.toml", MODEL, lambda: exports.model_toml(state())),
            ("Gains (JSON)", "gains.json", GAINS, lambda: exports.gains_json(state())),
            ("State (TOML)", "state.toml", STATE, lambda: state().to_toml()),
        )
        made: list[tuple[str, str, str, Callable[[], Any]]] = [
            (label, name, what, self._worked_out(name, begin)) for label, name, what, begin in long
        ]
        made += [(label, name, what, self._at_once(name, make)) for label, name, what, make in short]
        rows = [
            pn.Row(
                pn.widgets.FileDownload(
                    callback=callback,
                    filename=f"emps-design-{name}",
                    label=label,
                    color="primary",
                    width=200,
                    margin=(4, 6),
                    stylesheets=[BUTTON],
                ),
                pn.pane.HTML(inline(what), margin=(10, 6), stylesheets=["div { font-size: 13px; }"]),
                margin=0,
            )
            for label, name, what, callback in made
        ]
        self.load = pn.widgets.FileInput(label="State to load (.toml)", accept=".toml", multiple=False, margin=(4, 6))
        self.load.param.watch(self._load, "value")
        self.view = pn.Column(
            self.job.view,
            self.message,
            html("<h3>Save what the design tab shows</h3>", margin=(6, 6, 0, 6)),
            *rows,
            html("<h3>Go on with a state saved before</h3>", margin=(14, 6, 0, 6)),
            self.load,
            sizing_mode="stretch_width",
        )

    def _at_once(self, name: str, make: Callable[[], str]) -> Callable[[], BytesIO]:
        def callback() -> BytesIO:
            try:
                data = make().encode()
            except EmpsError as error:
                self._refuse(str(error))
                raise
            return self._handed(name, data)

        return callback

    def _worked_out(self, name: str, begin: Callable[[], Work]) -> Callable[[], Awaitable[BytesIO]]:
        """A download whose work runs beside the page, of what ``begin()`` finds when the button is pressed."""

        async def callback() -> BytesIO:
            self._say(f"emps-design-{name} is at work", "note")
            return self._handed(name, await self.job.awaited(begin(), self._refuse))

        return callback

    def _handed(self, name: str, data: bytes) -> BytesIO:
        self._say(f"emps-design-{name} is handed to the browser's downloads", "good")
        return BytesIO(data)

    def _refuse(self, text: str) -> None:
        self._say(text, "stop")

    def _load(self, event: Any) -> None:
        if not event.new:
            return
        name, content = self.load.filename or "state", bytes(event.new)
        self.load.value = None  # here and in the browser, so that the same file is heard again
        self.load.clear()
        try:
            self._loaded(State.from_toml(content.decode("utf-8", errors="strict"), name))
        except UnicodeDecodeError:
            self._refuse(f"{name}: not UTF-8 text, expected a state saved by the studio")
            return
        except EmpsError as error:
            self._refuse(str(error))
            return
        self._say(f"{name} is loaded; the design tab shows it", "good")

    def _say(self, text: str, level: str) -> None:
        self.message.object = self._state().axis.units.text(message(text, level))
