"""Interrupts: SIGINT, SIGTERM and SIGHUP end the process within two seconds, with exit status 130.

Python handles a signal between two of its own instructions; compiled code and linear algebra may take minutes to the
next one. A second thread therefore waits for signals as well, and ends the process if it does not unwind in time.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import NoReturn

from emps_design.errors import one_line
from emps_design.files import discard_unfinished

STATUS = 130
GRACE = 1.5  # s, for the work to unwind by itself
ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

interrupted = threading.Event()  # set by the first signal
_final_actions: list[Callable[[], None]] = []
_end_lock = threading.Lock()


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
def on_interrupt(action: Callable[[], str]) -> Iterator[None]:
    """Run ``action`` once if the block is interrupted, whether the block unwinds or not, and print what it returns."""
    done = threading.Lock()

    def once() -> None:
        if done.acquire(blocking=False):
            _tell(action())

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
    _tell("interrupted")
    end()


def _tell(text: str) -> None:
    """Print ``text``, if any, as one line of this program on standard error."""
    if text:
        print(f"emps-design: {one_line(text)}", file=sys.stderr)
