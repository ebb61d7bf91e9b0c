"""The errors of this package, with their exit codes on the command line.

Every error derives from :class:`EmpsError` and from the usual builtin: ``except ValueError`` catches bad numbers, and
``except EmpsError`` catches every error of this package. A message is one line: the place, what was found, what was
expected with its unit, and a remedy.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any


class EmpsError(Exception):
    """Base of all errors of this package; ``exit_code`` is the exit status of the command.

    >>> str(EmpsError("one\\nline, no \\x1b[31mtricks"))
    'one line, no ?[31mtricks'
    """

    exit_code = 1

    def __init__(self, message: str = ""):
        super().__init__(one_line(message))


class InputError(EmpsError, ValueError):
    """An invalid number, name or combination."""

    exit_code = 2


class RecordError(InputError):
    """A record that cannot be read or is not plausible."""


class AxisError(InputError):
    """An axis description that is incomplete, contradictory or physically impossible."""


class RankError(InputError):
    """A rank-deficient regression; ``columns`` are the names of the dependent columns."""

    def __init__(self, message: str, columns: tuple[str, ...] = ()):
        super().__init__(message)
        self.columns = columns


class SpecificationError(EmpsError, ValueError):
    """A specification that no gains can meet; ``nearest`` is the nearest feasible one."""

    exit_code = 3

    def __init__(self, message: str, nearest: dict[str, Any] | None = None):
        super().__init__(message)
        self.nearest = nearest or {}


class UnstableError(EmpsError, RuntimeError):
    """A requested design with an unstable loop; ``nearest`` is the nearest stable one."""

    exit_code = 4

    def __init__(self, message: str, nearest: dict[str, Any] | None = None):
        super().__init__(message)
        self.nearest = nearest or {}


class SimulationError(EmpsError, RuntimeError):
    """A simulation that failed, with its time [s], state and the effect concerned."""

    exit_code = 4

    def __init__(self, message: str, time: float, state: tuple[float, ...] = (), effect: str = ""):
        super().__init__(f"{message} (t = {time:.6g} s{', effect ' + effect if effect else ''})")
        self.time, self.state, self.effect = time, state, effect


def one_line(text: object) -> str:
    """Return ``text`` as one line of printable characters.

    >>> one_line("a name\\twith \\x1b[31mcolours \\udcff")
    'a name with ?[31mcolours ?'
    """
    return printable(" ".join(str(text).split()))


def printable(text: str) -> str:
    """Return ``text`` with ``?`` for unprintable characters: they may be terminal commands, or not encodable."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


def nearest_name(name: str, known: list[str] | tuple[str, ...]) -> str:
    """Return ``", did you mean 'x'?"`` for the known name closest to ``name``, "" for none.

    >>> nearest_name("viscuos", ["mass", "viscous"])
    ", did you mean 'viscous'?"
    """
    close = get_close_matches(name, known, n=1)
    return f", did you mean '{close[0]}'?" if close else ""
