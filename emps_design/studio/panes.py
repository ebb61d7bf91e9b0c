"""Parts of the studio's pages: panes for text and tables, a field for an axis file, and jobs in a thread.

Each pane has the studio's style sheet, since styles of the page do not reach its shadow root. A job shows its progress
and can be cancelled.
"""

from __future__ import annotations

import asyncio
import ctypes
import threading
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import PurePath
from typing import Any

import panel as pn

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.machines import machine_names
from emps_design.report.page import LEVELS, html as markup, inline
from emps_design.view import Html

STYLE = """
.message { padding: 5px 10px; border-left: 5px solid #56b4e9; background: #eef7fd; font-size: 13px; margin: 2px 0 4px; }
.message.bad { border-color: #b3261e; background: #fdecea; }
.message.good { border-color: #009e73; background: #e9f7f2; }
.message.warning { border-color: #e69f00; background: #fff8e6; }
table { border-collapse: collapse; font-size: 12.5px; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 2px 9px 2px 4px; border-bottom: 1px solid #e5e7eb; vertical-align: bottom; }
th { font-weight: 400; }
thead + tbody td, thead + tbody th { white-space: nowrap; }
thead th { color: #4b5563; font-size: 11px; line-height: 1.15; }
table.about { font-size: 13px; max-width: 900px; }
table.about th { white-space: nowrap; vertical-align: top; padding-right: 18px; }
p { font-size: 13px; max-width: 900px; }
table + p { margin: 4px 4px 0; font-size: 12.5px; }
p.caption { color: #374151; margin: 2px 4px 10px; font-size: 12.5px; }
b.yes { color: #00664b; }
b.no { color: #b3261e; }
div.record { max-width: 880px; }
svg { width: 100%; height: auto; max-width: 980px; }
h3 { margin: 6px 0; font-size: 15px; }
"""

POLL = 150  # ms
CANCELLED = "Cancelled; nothing was changed."


def html(text: str = "", **options: Any) -> pn.pane.HTML:
    """Return a pane of HTML that takes the available width."""
    return pn.pane.HTML(text, stylesheets=[STYLE], **{"sizing_mode": "stretch_width", "margin": (0, 5), **options})


def message(text: str, level: str, more: str = "") -> str:
    """Return ``text``, followed by the HTML ``more``, as a message; screen readers read level ``bad`` at once."""
    role = "alert" if level == "bad" else "status"
    return f'<div class="message {level}" role="{role}">{inline(text)}{more}</div>'


def judgement(text: str, level: str, more: str = "") -> str:
    """Return a verdict as the HTML of a message: the advice of its level, then the reason ``text``.

    >>> judgement("The loop is unstable.", "bad")
    '<div class="message bad" role="alert"><b>Do not run this.</b> The loop is unstable.</div>'
    """
    title = dict(LEVELS.values())[level]
    return message("", level, f"<b>{title}</b> {inline(text)}{more}")


def bold(text: str, kind: str = "") -> Html:
    """Return ``text`` as bold HTML; ``kind`` is its class: yes, no, or margin.

    >>> bold("a < b"), bold("fails", "no")
    ('<b>a &lt; b</b>', '<b class="no">fails</b>')
    """
    return markup('<b class="{}">{}</b>', kind, text) if kind else markup("<b>{}</b>", text)


@cache
def _page_style() -> str:
    """Return the style of the report's pages, for blocks of a page inside a pane."""
    css = (files("emps_design.report") / "templates" / "page.css").read_text(encoding="utf-8")
    return css.replace(":root", ":host")


def blocks() -> pn.pane.HTML:
    """Return a pane for blocks of a report's page, in their style."""
    return pn.pane.HTML("", stylesheets=[_page_style()], sizing_mode="stretch_width", margin=(0, 5))


class AxisFile:
    """A field for an axis file; calls ``take(axis)``, or ``refuse(text)`` with the reason.

    If an embedded machine has the same name, the name of the file is added, so that both can be selected.
    """

    def __init__(self, take: Callable[[Axis], None], refuse: Callable[[str], None], width: int = 230):
        self._take, self._refuse = take, refuse
        self.field = pn.widgets.FileInput(
            label="Open an axis file (.toml)", accept=".toml", multiple=False, width=width, margin=(2, 6)
        )
        self.field.param.watch(self._opened, "value")

    def _opened(self, event: Any) -> None:
        if not event.new:
            return
        name, content = PurePath((self.field.filename or "axis.toml").replace("\\", "/")).name, bytes(event.new)
        self.field.value = None  # here and in the browser: so the same file can be opened again after an edit
        self.field.clear()
        try:
            axis = Axis.from_toml(content.decode("utf-8"), name)
        except UnicodeDecodeError:
            self._refuse(f"{name}: not UTF-8 text, expected an axis file")
        except EmpsError as error:
            self._refuse(str(error))
        else:
            self._take(axis.replace(name=f"{axis.name} of {name}") if axis.name in machine_names() else axis)


class Cancelled(BaseException):
    """Raised in a cancelled job; a BaseException, so that no step of the job handles it."""


class Job:
    """Runs ``work(progress)`` in a thread, one job at a time; ``view`` has the progress bar and the cancel button.

    ``progress(stage, fraction)`` updates the bar. After a cancel, :class:`Cancelled` is raised in the thread at its
    next Python instruction; compiled steps in between are short.
    """

    def __init__(self) -> None:
        self.bar = pn.indicators.Progress(label="Progress", value=0, max=100, width=300, margin=(14, 8))
        self.stage = pn.pane.HTML("", margin=(8, 4))
        self.cancel = pn.widgets.Button(label="Cancel work", width=110, margin=(4, 6))
        self.cancel.on_click(lambda event: self.stop())
        self.view = pn.Row(self.cancel, self.bar, self.stage, margin=0, visible=False)
        self._stop = threading.Event()
        self._now: tuple[str, float] = ("", 0.0)
        self._outcome: tuple[str, Any] | None = None
        self._poll: Any = None
        self._next: tuple[Any, ...] | None = None  # a job started while another was stopping

    @property
    def running(self) -> bool:
        """Whether a job runs."""
        return self._poll is not None

    @property
    def occupied(self) -> bool:
        """Whether a job runs and is not being cancelled, so that no other can start."""
        return self.running and not self._stop.is_set()

    def stop(self) -> None:
        """Cancel the running job and the one that waits for its end, if any."""
        self._next = None
        self._stop.set()

    def awaited(self, work: Callable[[Callable], Any], failed: Callable[[str], None]) -> asyncio.Future[Any]:
        """Start ``work`` from a coroutine and return a future of its result.

        If the work fails or a job is already running, ``failed(message)`` is called and the future is cancelled.
        """
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def give_up(text: str) -> None:
            failed(text)
            future.cancel()

        if self.running or not self.start(work, future.set_result, give_up):
            give_up("Another job is running: cancel it, or wait for its end.")
        return future

    def start(
        self, work: Callable[[Callable], Any], done: Callable[[Any], None], failed: Callable[[str], None]
    ) -> bool:
        """Start ``work`` and later call ``done(result)`` or ``failed(message)``; return False if a job is running.

        If that job is being cancelled, ``work`` starts after its end.
        """
        if self.occupied:
            return False
        if self.running:
            self._next = (work, done, failed)
            return True
        self._stop.clear()
        self._outcome, self._now = None, ("starting", 0.0)
        self.bar.value, self.view.visible = 0, True

        def progress(stage: str, fraction: float) -> None:
            if self._stop.is_set():
                raise Cancelled
            self._now = (stage, fraction)

        def run() -> None:
            try:
                self._outcome = ("done", work(progress))
            except Cancelled:
                self._outcome = ("failed", CANCELLED)
            except EmpsError as error:
                self._outcome = ("failed", str(error))
            except Exception as error:  # a defect is shown on the page, and the session continues
                self._outcome = ("failed", f"{type(error).__name__}: {error}")

        thread = threading.Thread(target=run, daemon=True)
        thread.start()

        def poll() -> None:
            stage, fraction = self._now
            self.bar.value = int(100 * min(max(fraction, 0.0), 1.0))
            self.stage.object = inline("stopping" if self._stop.is_set() else stage.replace("_", " "))
            if self._outcome is None and thread.is_alive():
                if self._stop.is_set():
                    _raise_in(thread, Cancelled)
                return
            self._poll.stop()
            self._poll = None
            self.view.visible, self.stage.object = False, ""
            if self._next is not None:
                begin, self._next = self._next, None
                self.start(*begin)
                return
            kind, value = self._outcome or ("failed", CANCELLED)
            (done if kind == "done" else failed)(value)

        self._poll = pn.state.add_periodic_callback(poll, period=POLL)
        return True


def _raise_in(thread: threading.Thread, exception: type[BaseException]) -> None:
    """Raise ``exception`` in ``thread``: https://docs.python.org/3/c-api/init.html, PyThreadState_SetAsyncExc."""
    if thread.ident is not None and thread.is_alive():
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(exception))
