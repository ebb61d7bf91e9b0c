"""Simulations in parallel: they release the interpreter lock, so that threads suffice."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from emps_design.discrepancy import rules

_idle = threading.Semaphore(rules.CORES - 1)  # idle cores
_here = threading.local()  # ``ended``: whether the caller of this thread was interrupted


class _Ended(BaseException):
    """Raised in a helper thread whose caller was interrupted."""


def side_by_side(function: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Return ``function(*row)`` of each row of ``arguments``, in their order; raise what the first failing row raised.

    The caller computes the rows itself, and an idle core helps, at any depth of nested calls: a pool per call would
    leave a core idle whenever the last row of the outer call takes long.

    >>> side_by_side(pow, [(2, 3), (3, 2)])
    [8, 9]
    """
    rows, results, errors = list(arguments), {}, {}
    remaining, stopped = iter(range(len(rows))), threading.Event()
    ended_above: Callable[[], bool] = getattr(_here, "ended", lambda: False)

    def ended() -> bool:
        return stopped.is_set() or ended_above()

    def take(row: int) -> None:
        if ended():
            raise _Ended
        try:
            results[row] = function(*rows[row])
        except Exception as error:
            errors[row] = error

    def help_out() -> None:
        _here.ended = ended
        try:
            with suppress(_Ended):
                for row in remaining:
                    take(row)
        finally:
            _idle.release()

    helpers: list[threading.Thread] = []
    try:
        for row in remaining:
            if row + 1 < len(rows) and _idle.acquire(blocking=False):
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
    """Wait for ``helpers``, whose own calls may use this core meanwhile."""
    if not any(helper.is_alive() for helper in helpers):
        return
    _idle.release()
    try:
        for helper in helpers:
            while helper.is_alive():
                helper.join(rules.PATIENCE)
    finally:
        _idle.acquire()
