"""Messages: sentences about a result, each with a code, a severity and the values in it.

The function that finds a fact makes the message, in the units and words of the axis. The code names the kind of fact;
each code occurs in one place of the package, which fixes its severity. A message is a string, so terminals, pages and
JSON show it as such. Code that judges a result reads severity and code, never the text.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any


class Severity(IntEnum):
    """What a message means for its result, in rising order."""

    NOTE = 0  # the result is valid as it is
    WARNING = 1  # the result is valid with a restriction; a design may still be safe
    GRAVE = 2  # part of the result is missing, and no design is safe
    WRONG = 3  # the whole result may be wrong


class Message(str):
    """A sentence with its ``code``, its ``severity``, and the ``values`` in it by name, numbers in SI.

    >>> slow = grave("creep", "the released carriage creeps at 3 mm/s", speed=0.003)
    >>> slow, slow.code, slow.severity.name, slow.values["speed"]
    ('the released carriage creeps at 3 mm/s', 'creep', 'GRAVE', 0.003)
    """

    code: str
    severity: Severity
    values: Mapping[str, Any]

    def __new__(cls, text: str, code: str, severity: Severity, values: Mapping[str, Any]) -> Message:
        """Make a message; use :func:`note`, :func:`warning`, :func:`grave` or :func:`wrong`."""
        message = super().__new__(cls, text)
        message.code, message.severity, message.values = code, severity, values
        return message

    def __getnewargs__(self) -> tuple[Any, ...]:
        """The arguments of ``__new__`` for :mod:`pickle` and :mod:`copy`."""
        return str(self), self.code, self.severity, self.values

    def of(self, name: str) -> Message:
        """The same message with the ``name`` of its subject, such as a record, in front.

        >>> note("gap", "a gap of 2 s").of("first.csv").code, str(note("gap", "a gap of 2 s").of("first.csv"))
        ('gap', 'first.csv: a gap of 2 s')
        """
        return Message(f"{name}: {self}", self.code, self.severity, self.values)


def note(code: str, text: str, /, **values: Any) -> Message:
    """Make a message of severity ``NOTE``: the result is valid as it is."""
    return Message(text, code, Severity.NOTE, values)


def warning(code: str, text: str, /, **values: Any) -> Message:
    """Make a message of severity ``WARNING``: the result is valid with a restriction."""
    return Message(text, code, Severity.WARNING, values)


def grave(code: str, text: str, /, **values: Any) -> Message:
    """Make a message of severity ``GRAVE``: part of the result is missing, and no design is safe."""
    return Message(text, code, Severity.GRAVE, values)


def wrong(code: str, text: str, /, **values: Any) -> Message:
    """Make a message of severity ``WRONG``: the whole result may be wrong."""
    return Message(text, code, Severity.WRONG, values)


def severity_of(text: str) -> Severity:
    """Return the severity of a message; plain text, such as in a document read from a file, counts as grave.

    >>> severity_of(note("gap", "a gap of 2 s")).name, severity_of("a gap of 2 s").name
    ('NOTE', 'GRAVE')
    """
    return text.severity if isinstance(text, Message) else Severity.GRAVE
