"""The files tab: save and load the whole state; export report, figures, model and gains."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from typing import Any

import panel as pn

from emps_design.errors import EmpsError
from emps_design.records import Record
from emps_design.report.page import inline
from emps_design.studio import exports
from emps_design.studio.panes import html
from emps_design.studio.state import State


class FilesView:
    """Buttons that hand out files of the state as it is now, and a field that loads a saved state."""

    def __init__(
        self, state: Callable[[], State], record: Callable[[], Record | None], loaded: Callable[[State], None]
    ):
        self._state, self._record, self._loaded = state, record, loaded
        self.message = html()
        made: dict[str, tuple[str, Callable[[], bytes]]] = {
            "Report (HTML)": ("emps-design-report.html", lambda: exports.report_html(state(), record()).encode()),
            "Figures (SVG)": ("emps-design-figures-svg.zip", lambda: exports.figures_zip(state(), "svg")),
            "Figures (PNG)": ("emps-design-figures-png.zip", lambda: exports.figures_zip(state(), "png")),
            "Model (TOML)": ("emps-design-model.toml", lambda: exports.model_toml(state()).encode()),
            "Gains (JSON)": ("emps-design-gains.json", lambda: exports.gains_json(state()).encode()),
            "State (TOML)": ("emps-design-state.toml", lambda: state().to_toml().encode()),
        }
        self.downloads = {
            label: pn.widgets.FileDownload(
                callback=self._guarded(make), filename=filename, label=label, button_type="primary", width=220
            )
            for label, (filename, make) in made.items()
        }
        self.load = pn.widgets.FileInput(label="Load a state", accept=".toml", multiple=False)
        self.load.param.watch(self._load, "value")
        self.view = pn.Column(
            html("<h3>Export what the design tab shows</h3>"),
            pn.FlexBox(*self.downloads.values()),
            html("<h3>Load a state saved before</h3>"),
            self.load,
            self.message,
            sizing_mode="stretch_width",
        )

    def _guarded(self, make: Callable[[], bytes]) -> Callable[[], BytesIO]:
        def callback() -> BytesIO:
            try:
                data = make()
            except EmpsError as error:
                self._say(str(error), "stop")
                raise
            self._say("written", "good")
            return BytesIO(data)

        return callback

    def _load(self, event: Any) -> None:
        if not event.new:
            return
        name = self.load.filename or "state"
        try:
            state = State.from_toml(bytes(event.new).decode("utf-8", errors="strict"), name)
        except UnicodeDecodeError:
            self._say(f"{name}: not UTF-8 text, expected a state saved by the studio", "stop")
            return
        except EmpsError as error:
            self._say(str(error), "stop")
            return
        self._loaded(state)
        self._say(f"{name} is loaded; the design tab shows it", "good")

    def _say(self, text: str, level: str) -> None:
        role = "alert" if level == "stop" else "status"
        self.message.object = f'<div class="said {level}" role="{role}">{inline(text)}</div>'
