"""Long work beside the page: one thread, its progress shown, and a cancel that the work hears at its next step."""

from __future__ import annotations

import asyncio
import ctypes
import threading
from collections.abc import Callable
from typing import Any

import panel as pn

from emps_design.errors import EmpsError
from emps_design.report.page import inline

POLL = 150  # ms
CANCELLED = "Cancelled; nothing was changed."


class Cancelled(BaseException):
    """The person at the page asked to stop; no step of the work may take it for a failure of its own."""


class Job:
    """Runs ``work(progress)`` in a thread; ``view`` has the bar and the cancel button; one job at a time.

    ``progress(stage, fraction)`` shows where the work is. Once cancel was pressed :class:`Cancelled` is raised in the
    thread, wherever the work is, at the next instruction of Python's: compiled steps between them take moments.
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
        self._next: tuple[Any, ...] | None = None  # what was started while work was stopping

    @property
    def running(self) -> bool:
        """Whether work is going on."""
        return self._poll is not None

    @property
    def occupied(self) -> bool:
        """Whether work is going on that nobody asked to stop: no other can be started."""
        return self.running and not self._stop.is_set()

    def stop(self) -> None:
        """Ask the work that is going on, if any, to stop; nothing waits for its end any more."""
        self._next = None
        self._stop.set()

    def awaited(self, work: Callable[[Callable], Any], failed: Callable[[str], None]) -> asyncio.Future[Any]:
        """Start ``work`` from a coroutine; what it makes, once it is done.

        Cancelled, after ``failed(message)``, where the work fails, or a job runs already.
        """
        made: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def give_up(text: str) -> None:
            failed(text)
            made.cancel()

        if self.running or not self.start(work, made.set_result, give_up):
            give_up("Other work is going on: cancel it, or wait for its end.")
        return made

    def start(
        self, work: Callable[[Callable], Any], done: Callable[[Any], None], failed: Callable[[str], None]
    ) -> bool:
        """Start ``work``; later call ``done(result)`` or ``failed(message)``. False where a job runs already.

        One that was asked to stop ends first, with no word of it.
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
            except Exception as error:  # a defect: say so on the page, the session goes on
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
