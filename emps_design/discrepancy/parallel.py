"""Simulations in parallel: they release the interpreter lock, so that threads suffice."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from emps_design.discrepancy import rules

_idle_cores = threading.Semaphore(rules.CORES - 1)  # idle cores
_thread = threading.local()  # its ``ended()`` returns whether the caller of this thread was interrupted


class _CallerInterrupted(BaseException):
    """Raised in a helper thread whose caller was interrupted."""


def side_by_side(function: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Return ``function(*row)`` of each row of ``arguments``, in order; raise the exception of the first failing row.

    The calling thread computes the rows, and an idle core helps, also in nested calls: with a pool per call a core
    would be idle while the last row of the outer call is computed.

    >>> side_by_side(pow, [(2, 3), (3, 2)])
    [8, 9]
    """
    rows, results, errors = list(arguments), {}, {}
    remaining, stopped = iter(range(len(rows))), threading.Event()
    ended_above: Callable[[], bool] = getattr(_thread, "ended", lambda: False)

    def ended() -> bool:
        return stopped.is_set() or ended_above()

    def take(row: int) -> None:
        if ended():
            raise _CallerInterrupted
        try:
            results[row] = function(*rows[row])
        except Exception as error:
            errors[row] = error

    def help_out() -> None:
        _thread.ended = ended
        try:
            with suppress(_CallerInterrupted):
                for row in remaining:
                    take(row)
        finally:
            _idle_cores.release()

    helpers: list[threading.Thread] = []
    try:
        for row in remaining:
            if row + 1 < len(rows) and _idle_cores.acquire(blocking=False):
                helpers.append(threading.Thread(target=help_out, daemon=True))
                helpers[-1].start()
            take(row)
        _wait(helpers)
    except BaseException:
        stopped.set()
        raise
    for row in sorted(errors):
        raise errors[row]
    return [results[row] for row in range(len(rows))]


def _wait(helpers: list[threading.Thread]) -> None:
    """Wait for ``helpers``; meanwhile their own calls may use this core."""
    if not any(helper.is_alive() for helper in helpers):
        return
    _idle_cores.release()
    try:
        for helper in helpers:
            while helper.is_alive():
                helper.join(rules.PATIENCE)
    finally:
        _idle_cores.acquire()
