"""What can go wrong, each with the exit status the command line gives it.

Every error derives from :class:`EmpsError` and from the builtin a Python programmer would catch, so
``except ValueError`` works for bad numbers and ``except EmpsError`` for everything this package refuses.
A message is one line: what, found, expected with its unit, what to do.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any


class EmpsError(Exception):
    """Anything this package refuses; ``exit_code`` is the command's exit status.

    >>> str(EmpsError("one\\nline, no \\x1b[31mtricks"))
    'one line, no ?[31mtricks'
    """

    exit_code = 1

    def __init__(self, message: str = ""):
        super().__init__(one_line(message))


class InputError(EmpsError, ValueError):
    """A number, name or combination that cannot be meant."""

    exit_code = 2


class RecordError(InputError):
    """A record that cannot be read, or cannot be trusted."""


class AxisError(InputError):
    """An axis description that is incomplete, contradictory or physically impossible."""


class RankError(InputError):
    """A regression whose columns the data cannot tell apart; ``columns`` names them."""

    def __init__(self, message: str, columns: tuple[str, ...] = ()):
        super().__init__(message)
        self.columns = columns


class SpecificationError(EmpsError, ValueError):
    """A specification that no gains can meet; ``nearest`` holds the closest one that works."""

    exit_code = 3

    def __init__(self, message: str, nearest: dict[str, Any] | None = None):
        super().__init__(message)
        self.nearest = nearest or {}


class UnstableError(EmpsError, RuntimeError):
    """A requested design whose loop is unstable; ``nearest`` holds the closest stable one."""

    exit_code = 4

    def __init__(self, message: str, nearest: dict[str, Any] | None = None):
        super().__init__(message)
        self.nearest = nearest or {}


class SimulationError(EmpsError, RuntimeError):
    """A simulation that could not go on: when, in which state, and which effect was at work."""

    exit_code = 4

    def __init__(self, message: str, time: float, state: tuple[float, ...] = (), effect: str = ""):
        super().__init__(f"{message} (t = {time:.6g} s{', effect ' + effect if effect else ''})")
        self.time, self.state, self.effect = time, state, effect


def one_line(text: object) -> str:
    """Return ``text`` as one line of printable characters: names come from files, which may hold anything.

    >>> one_line("a name\\twith \\x1b[31mcolours \\udcff")
    'a name with ?[31mcolours ?'
    """
    return printable(" ".join(str(text).split()))


def printable(text: str) -> str:
    """Return ``text`` with ``?`` for what is not seen: terminals obey it, and some of it no file can hold."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


def nearest_name(found: str, known: list[str] | tuple[str, ...]) -> str:
    """Return ``", did you mean 'x'?"`` for the closest known name, or an empty string.

    >>> nearest_name("viscuos", ["mass", "viscous"])
    ", did you mean 'viscous'?"
    """
    close = get_close_matches(found, known, n=1)
    return f", did you mean '{close[0]}'?" if close else ""
