"""Messages: sentences beside a result, each with a code, a severity and the values in it.

A message is made once, where the fact is found, in the units and words of the axis. Its code names the kind of fact; a
code is made in one place of the package, which decides its severity. A message is a string, so a terminal, a page and
JSON show it as any other; whoever judges a result asks for severity and code, never for words.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any


class Severity(IntEnum):
    """What a message means for the result that it stands beside, the least first."""

    NOTE = 0  # the result stands as it is
    WARNING = 1  # the result holds less than it seems; a design may still be safe
    GRAVE = 2  # part of the result is missing, and no design is safe
    WRONG = 3  # nothing of the result may be true


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
        """A message with this ``text``; see :func:`note` and its siblings."""
        message = super().__new__(cls, text)
        message.code, message.severity, message.values = code, severity, values
        return message

    def __getnewargs__(self) -> tuple[Any, ...]:
        """What :mod:`pickle` and :mod:`copy` make the message of."""
        return str(self), self.code, self.severity, self.values

    def of(self, name: str) -> Message:
        """The same message with the ``name`` of what it is about, such as a record, before it.

        >>> note("gap", "a gap of 2 s").of("first.csv").code, str(note("gap", "a gap of 2 s").of("first.csv"))
        ('gap', 'first.csv: a gap of 2 s')
        """
        return Message(f"{name}: {self}", self.code, self.severity, self.values)


def note(code: str, text: str, /, **values: Any) -> Message:
    """Make a message after which the result stands as it is."""
    return Message(text, code, Severity.NOTE, values)


def warning(code: str, text: str, /, **values: Any) -> Message:
    """Make a message after which the result holds less than it seems."""
    return Message(text, code, Severity.WARNING, values)


def grave(code: str, text: str, /, **values: Any) -> Message:
    """Make a message after which part of the result is missing, and no design is safe."""
    return Message(text, code, Severity.GRAVE, values)


def wrong(code: str, text: str, /, **values: Any) -> Message:
    """Make a message after which nothing of the result may be true."""
    return Message(text, code, Severity.WRONG, values)


def severity_of(text: str) -> Severity:
    """Return the severity of a message; any other text, such as of a document read from a file, counts as grave.

    >>> severity_of(note("gap", "a gap of 2 s")).name, severity_of("a gap of 2 s").name
    ('NOTE', 'GRAVE')
    """
    return text.severity if isinstance(text, Message) else Severity.GRAVE
