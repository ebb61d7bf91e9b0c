"""Interrupts: SIGINT, SIGTERM and SIGHUP end the process within two seconds, with exit status 130.

Python handles a signal between two bytecode instructions, and compiled code may delay the next one by minutes. A second
thread therefore waits for signals as well, and ends the process if it does not unwind in time.
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
GRACE = 1.5  # s, for the stack to unwind
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

interrupted = threading.Event()  # set by the first signal
_final_actions: list[Callable[[], None]] = []
_end_lock = threading.Lock()


def install_handlers() -> None:
    """Let :data:`SIGNALS` end this process, except those that are already ignored."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # ignored under nohup and in background jobs of a shell
            signal.signal(number, _on_signal)
    sys.excepthook, sys.unraisablehook = _on_exception, _on_unraisable
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    threading.Thread(target=_wait, args=(read_end,), daemon=True).start()


@contextmanager
def on_interrupt(action: Callable[[], str]) -> Iterator[None]:
    """If the block is interrupted, run ``action`` once and print the text that it returns.

    That holds even if the block never unwinds.
    """
    done = threading.Lock()

    def once() -> None:
        if done.acquire(blocking=False):
            _print(action())

    _final_actions.append(once)
    try:
        yield
    except KeyboardInterrupt:
        once()
        raise
    finally:
        _final_actions.remove(once)


def end() -> NoReturn:
    """End this process now, without waiting for other threads: run the final actions and remove unfinished files."""
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
    for other in SIGNALS:  # the removal of unfinished files must not be interrupted
        signal.signal(other, signal.SIG_IGN)
    raise KeyboardInterrupt


def _on_exception(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print no traceback after an interrupt: numpy's imports would print it and raise another error."""
    if not interrupted.is_set():
        sys.__excepthook__(kind, error, trace)


def _on_unraisable(arguments: sys.UnraisableHookArgs) -> None:
    """Print nothing about an interrupt inside a callback or a constructor; :func:`_wait` then ends the process."""
    if not interrupted.is_set():
        sys.__unraisablehook__(arguments)


def _wait(read_end: int) -> None:
    while not set(SIGNALS) & set(os.read(read_end, 64)):
        continue
    time.sleep(GRACE)
    _print("interrupted")
    end()


def _print(text: str) -> None:
    """Print ``text``, unless empty, as one line on standard error."""
    if text:
        print(f"emps-design: {one_line(text)}", file=sys.stderr)
