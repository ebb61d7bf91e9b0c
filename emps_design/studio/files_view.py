"""The files tab: save and load the whole state; export report, figures, model and gains.

The same state gives files with the same bytes.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Awaitable, Callable, Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Any

import panel as pn

from emps_design.errors import EmpsError
from emps_design.progress import Progress, no_progress, of_part
from emps_design.report.page import inline
from emps_design.studio.panes import Job, html, message
from emps_design.studio.state import LABELS, State

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.axis import Axis
    from emps_design.compensation import Compensation
    from emps_design.control.velocity.design import VelocityLoopDesign

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date of the zip format, instead of the time of writing

Work = Callable[[Progress], bytes]
# A download is a link styled as a button; the color of the button does not apply to it.
BUTTON = ":host { --surface-color: #0072b2; --surface-text-color: #fff; }"
REPORT = "the whole design as one page, with the record if one is loaded"
VECTORS, PIXELS = "all figures of the design as vector graphics, for a paper", "the same as bitmaps, for slides"
MODEL = "the axis with the controller of the design, for every emps-design command"
GAINS = "gains and margins, as emps-design gains --json prints them"
STATE = "the values of all controls and the pinned design, to continue later"


def velocity_design(state: State) -> VelocityLoopDesign:
    """The velocity loop for the specification of ``state``."""
    from emps_design.control.velocity.design import design_velocity_loop

    return design_velocity_loop(state.axis, **state.requested)


def report_html(state: State, measured: Mapping[str, Any] | None = None, progress: Progress = no_progress) -> str:
    """Return the page of ``report`` for ``state``, with a section on the record ``measured`` if one is loaded.

    ``measured`` has ``record``, ``record_axis`` and ``record_filter`` of
    :func:`~emps_design.report.assemble.assemble_report`.
    """
    from emps_design.report.assemble import assemble_report

    of_record = {"design_on": "axis", "model": state.friction, **measured} if measured else {}
    report = assemble_report(
        state.axis,
        **of_record,
        **{state.specification: state.frequency},
        phase_margin_deg=state.phase_margin_deg,
        structure=LABELS[state.structure],
        filters=state.filters,
        k_e1=state.k_e1,
        hand=state.hand,
        environment=state.wall * 1e3,
        mass=state.mass,
        damping=state.damping,
        filter=state.filter,
        mismatch=state.mismatch_percent / 100.0,
        progress=progress,
    )
    return report.page.html()


def figures(state: State, progress: Progress = no_progress) -> dict[str, Figure]:
    """Return the figures of ``state``, by name."""
    from emps_design.control.force import design_force_loop
    from emps_design.report.diagrams import velocity_and_force_loop_diagram
    from emps_design.report.loop_figures import velocity_loop_figures
    from emps_design.report.velocity import force_limit_figure, force_loop_figure
    from emps_design.studio.simulation_view import simulate

    design = velocity_design(state)
    force = design_force_loop(design, state.k_e1, hand=state.hand, environment=state.wall * 1e3)
    return {
        "block_diagram": velocity_and_force_loop_diagram(design.structure, bool(design.filters)),
        **velocity_loop_figures(design),
        "force_limit": force_limit_figure(force),
        "force_loop": force_loop_figure(force),
        **{f"simulation_{name}": figure for name, figure in simulate(state, progress).figures().items()},
    }


def figures_zip(state: State, kind: str, progress: Progress = no_progress) -> bytes:
    """Return all figures in one zip archive; ``kind`` is "svg" or "png"."""
    from emps_design.report import style

    drawn, archive = figures(state, of_part(progress, 0.0, 0.5)), {}
    for place, (name, figure) in enumerate(drawn.items()):
        progress(name, 0.5 + 0.5 * place / len(drawn))
        archive[f"{name}.{kind}"] = style.svg(figure, name).encode() if kind == "svg" else style.png(figure)
    return _zip(archive)


def _zip(files: dict[str, bytes]) -> bytes:
    """Return ``files`` by name in one zip archive; the same files give the same bytes."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), data)
    return out.getvalue()


def follows(axis: Axis) -> str:
    """Return the reference that the controller of ``axis`` follows: "position", "velocity", or "" for none."""
    from emps_design.laws import law_of

    kind = "rest position" if axis.controller.kind == "none" else law_of(axis, axis.sampling.period).follows
    return "" if kind == "rest position" else kind


def designed(state: State) -> Axis:
    """Return the axis of ``state`` with the designed controller; raises :class:`EmpsError` if that is unstable."""
    design = velocity_design(state)
    if design.refused:
        raise EmpsError(f"no controller is written: {design.refused}")
    return state.axis.replace(controller=design.controller_table())


def drive_zip(compensation: Compensation) -> bytes:
    """Return the folder for the drive as an archive: axis, compensation, and controller in C99 with its vectors."""
    from emps_design.codegen import export_controller
    from emps_design.codegen.targets import origin_of

    axis = compensation.axis.to_toml(comments=True)
    exported = export_controller(compensation.axis, "c", compensation.to_dict(), origin_of("axis.toml", axis.encode()))
    files = {
        "axis.toml": axis,
        "compensation.json": _json_text(compensation.to_dict()),
        **{f"code/{name}": content for name, content in exported.files.items()},
    }
    return _zip({name: text.encode() if isinstance(text, str) else text for name, text in files.items()})


def gains_json(state: State) -> str:
    """Return the keys and numbers that ``gains --json`` prints for ``state``."""
    from emps_design.control.verdict import gains_document

    document = gains_document(velocity_design(state))
    return _json_text(document)


def _json_text(document: Any) -> str:
    """Return ``document`` as JSON; infinite numbers, such as the error of an unstable loop, are null."""
    document = json.loads(json.dumps(document, default=float), parse_constant=lambda name: None)
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False, default=float) + "\n"


def model_toml(state: State) -> str:
    """Return the axis with the controller of the design as TOML."""
    return designed(state).to_toml()


class FilesView:
    """Buttons that download files of the current state, and a field that loads a saved state."""

    def __init__(
        self, state: Callable[[], State], measured: Callable[[], dict[str, Any]], loaded: Callable[[State], None]
    ):
        self._state, self._loaded = state, loaded
        self.message, self.job = html(), Job()

        def report() -> Work:
            now, of_record = state(), measured()  # at the time of the click
            return lambda progress: report_html(now, of_record, progress).encode()

        def pictures(kind: str) -> Callable[[], Work]:
            def begin() -> Work:
                now = state()
                return lambda progress: figures_zip(now, kind, progress)

            return begin

        long: tuple[tuple[str, str, str, Callable[[], Work]], ...] = (
            ("Report (HTML)", "report.html", REPORT, report),
            ("Figures (SVG)", "figures-svg.zip", VECTORS, pictures("svg")),
            ("Figures (PNG)", "figures-png.zip", PIXELS, pictures("png")),
        )
        short: tuple[tuple[str, str, str, Callable[[], str]], ...] = (
            ("Model (TOML)", "model.toml", MODEL, lambda: model_toml(state())),
            ("Gains (JSON)", "gains.json", GAINS, lambda: gains_json(state())),
            ("State (TOML)", "state.toml", STATE, lambda: state().to_toml()),
        )
        downloads: list[tuple[str, str, str, Callable[[], Any]]] = [
            (label, name, what, self._in_background(name, begin)) for label, name, what, begin in long
        ]
        downloads += [(label, name, what, self._at_once(name, make)) for label, name, what, make in short]
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
            for label, name, what, callback in downloads
        ]
        self.load = pn.widgets.FileInput(label="State to load (.toml)", accept=".toml", multiple=False, margin=(4, 6))
        self.load.param.watch(self._load, "value")
        self.view = pn.Column(
            self.job.view,
            self.message,
            html("<h3>Save the present design</h3>", margin=(6, 6, 0, 6)),
            *rows,
            html("<h3>Continue with a saved state</h3>", margin=(14, 6, 0, 6)),
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
            return self._deliver(name, data)

        return callback

    def _in_background(self, name: str, begin: Callable[[], Work]) -> Callable[[], Awaitable[BytesIO]]:
        """Return a download callback that calls ``begin()`` at the click and runs the work that it returns."""

        async def callback() -> BytesIO:
            self._say(f"emps-design-{name} is being made", "note")
            return self._deliver(name, await self.job.awaited(begin(), self._refuse))

        return callback

    def _deliver(self, name: str, data: bytes) -> BytesIO:
        self._say(f"emps-design-{name} is in the browser's downloads", "good")
        return BytesIO(data)

    def _refuse(self, text: str) -> None:
        self._say(text, "bad")

    def _load(self, event: Any) -> None:
        if not event.new:
            return
        name, content = self.load.filename or "state", bytes(event.new)
        self.load.value = None  # here and in the browser, so that the same file can be loaded again
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
        self.message.object = message(text, level)
