"""Interrupts: SIGINT, SIGTERM and SIGHUP end the process within two seconds, with exit status 130.

Python handles a signal between two of its own instructions; compiled code and linear algebra may take minutes to the
next one. A second thread therefore waits for signals as well, and ends the process if it does not unwind in time.

An interrupted ``diagnose`` leaves the folder of ``--out`` as it was and writes what it knew beside it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NoReturn

from emps_design.cli.output import json_text, tell
from emps_design.errors import EmpsError
from emps_design.files import discard_unfinished, write_text, write_together
from emps_design.progress import Progress

if TYPE_CHECKING:
    from emps_design.axis import Axis

STATUS = 130
GRACE = 1.5  # s, for the work to unwind by itself
ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

interrupted = threading.Event()  # set by the first signal
_final_actions: list[Callable[[], None]] = []
_end_lock = threading.Lock()

SCHEMA = "emps-design/partial-diagnosis/1"


def install_handlers() -> None:
    """Let the signals in ``ENDING`` end this process, except those that are ignored already."""
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # ignored under nohup and in background jobs of a shell
            signal.signal(number, _on_signal)
    sys.excepthook, sys.unraisablehook = _on_exception, _on_unraisable
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    threading.Thread(target=_wait, args=(read_end,), daemon=True).start()


@contextmanager
def on_interrupt(action: Callable[[], None]) -> Iterator[None]:
    """Run ``action`` once if the block is interrupted, whether the block unwinds or not."""
    done = threading.Lock()

    def once() -> None:
        if done.acquire(blocking=False):
            action()

    _final_actions.append(once)
    try:
        yield
    except KeyboardInterrupt:
        once()
        raise
    finally:
        _final_actions.remove(once)


def end() -> NoReturn:
    """End this process now: run the final actions, remove unfinished files and do not wait for other threads."""
    if not _end_lock.acquire(blocking=False):
        threading.Event().wait()  # the other thread is ending the process
    try:
        for action in tuple(_final_actions):
            action()
        discard_unfinished()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(STATUS)


def _on_signal(number: int, frame: object) -> None:
    interrupted.set()
    for ending in ENDING:  # the removal of unfinished files must not be interrupted
        signal.signal(ending, signal.SIG_IGN)
    raise KeyboardInterrupt


def _on_exception(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print no traceback after an interrupt: numpy's imports print it and raise another error."""
    if not interrupted.is_set():
        sys.__excepthook__(kind, error, trace)


def _on_unraisable(arguments: sys.UnraisableHookArgs) -> None:
    """Print nothing about an interrupt inside a callback or a constructor; :func:`_wait` then ends the process."""
    if not interrupted.is_set():
        sys.__unraisablehook__(arguments)


def _wait(read_end: int) -> None:
    while not set(ENDING) & set(os.read(read_end, 64)):
        continue
    time.sleep(GRACE)
    tell("interrupted")
    end()


class PartialDiagnosis:
    """State of a running diagnosis for the folder ``out``; :meth:`write` saves it in the folder ``out.partial``."""

    def __init__(self, out: Path | None):
        named = out is None or out.name not in ("", "..")
        self.folder = None if out is None else Path(f"{out if named else os.path.abspath(out)}.partial")
        self.stage, self.share = "reading", 0.0
        self.axis: Axis | None = None

    def track(self, bar: Progress) -> Progress:
        """Return a progress callback that updates ``bar`` and this state, and raises after an interrupt.

        Without the raise the search would swallow the interrupt and conclude from what it has.
        """

        def progress(stage: str, share: float) -> None:
            self.stage, self.share = stage, share
            bar(stage, share)
            self._stop()

        return progress

    def keep_model(self, axis: Axis) -> None:
        """Keep the model that the search ended with."""
        self.axis = axis
        self._stop()

    def write(self) -> None:
        """Write the state and print the folder."""
        if self.folder is None:
            return
        document = {
            "schema": SCHEMA,
            "interrupted": True,
            "stage": self.stage,
            "share": self.share,
            "effects": [] if self.axis is None else [effect.kind for effect in self.axis.effects],
            "model_file": None if self.axis is None else "model.toml",
            "text": "The diagnosis was interrupted here; nothing of this was confirmed, and more may be missing.",
        }
        try:
            self.folder.mkdir(exist_ok=True)
            with write_together(self.folder) as aside:
                write_text(aside / "partial.json", f"{json_text(document)}\n")
                if self.axis is not None:
                    head = f"# from a diagnosis that was interrupted: {self.stage}\n"
                    write_text(aside / "model.toml", head + self.axis.to_toml())
        except (EmpsError, OSError) as error:
            tell(f"what was known by then could not be written: {error}")
        else:
            tell(f"what was known by then is in {self.folder}")

    def _stop(self) -> None:
        if interrupted.is_set():
            raise KeyboardInterrupt
