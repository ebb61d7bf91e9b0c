"""Signals that end the work: heard whatever it is at, over within two seconds, exit status 130.

Python acts on a signal between two of its own instructions; compiled code and linear algebra may be minutes away from
the next one. So a thread listens too, and ends the process where it does not unwind in time.

What an interrupted ``diagnose`` leaves: nothing in the folder that was asked for, what it knew by then beside it.
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

heard = threading.Event()  # set by the first of them
_last_deeds: list[Callable[[], None]] = []
_only_one = threading.Lock()

SCHEMA = "emps-design/partial-diagnosis/1"


def listen() -> None:
    """Let the signals in ``ENDING`` that are not ignored end this process, from now on."""
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup, and jobs in the background of a shell
            signal.signal(number, _interrupt)
    sys.excepthook, sys.unraisablehook = _excepted, _unraisable
    reads, tells = os.pipe()
    os.set_blocking(tells, False)
    signal.set_wakeup_fd(tells, warn_on_full_buffer=False)
    threading.Thread(target=_wait, args=(reads,), daemon=True).start()


@contextmanager
def before_the_end(deed: Callable[[], None]) -> Iterator[None]:
    """Do ``deed`` where the block is interrupted, once, whether it unwinds or not."""
    done = threading.Lock()

    def once() -> None:
        if done.acquire(blocking=False):
            deed()

    _last_deeds.append(once)
    try:
        yield
    except KeyboardInterrupt:
        once()
        raise
    finally:
        _last_deeds.remove(once)


def end() -> NoReturn:
    """End this process here and now, with nothing half-written left; threads at work do not hold it up."""
    if not _only_one.acquire(blocking=False):
        threading.Event().wait()  # the other thread is ending the process
    try:
        for deed in tuple(_last_deeds):
            deed()
        discard_unfinished()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(STATUS)


def _interrupt(number: int, frame: object) -> None:
    heard.set()
    for ending in ENDING:  # one is enough: what removes files is not to be interrupted
        signal.signal(ending, signal.SIG_IGN)
    raise KeyboardInterrupt


def _excepted(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Say nothing of what an interrupt leads to in compiled code: numpy's imports print it and raise another error."""
    if not heard.is_set():
        sys.__excepthook__(kind, error, trace)


def _unraisable(told: sys.UnraisableHookArgs) -> None:
    """Say nothing of an interrupt that met a callback or left an object half made: `_wait` acts where nothing does."""
    if not heard.is_set():
        sys.__unraisablehook__(told)


def _wait(reads: int) -> None:
    while not set(ENDING) & set(os.read(reads, 64)):
        continue
    time.sleep(GRACE)
    tell("interrupted")
    end()


class PartialDiagnosis:
    """Remembers how far a diagnosis for the folder ``out`` is; ``write`` puts that into ``out`` with ``.partial``."""

    def __init__(self, out: Path | None):
        named = out is None or out.name not in ("", "..")
        self.folder = None if out is None else Path(f"{out if named else os.path.abspath(out)}.partial")
        self.stage, self.share = "reading", 0.0
        self.axis: Axis | None = None

    def hears(self, bar: Progress) -> Progress:
        """``bar`` that ends the work where an interrupt was heard: the search would conclude from what it has."""

        def progress(stage: str, share: float) -> None:
            self.stage, self.share = stage, share
            bar(stage, share)
            self._stop()

        return progress

    def knows(self, axis: Axis) -> None:
        """Keep the model with which the search ended."""
        self.axis = axis
        self._stop()

    def write(self) -> None:
        """Write what is known, and say where."""
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
        if heard.is_set():
            raise KeyboardInterrupt
