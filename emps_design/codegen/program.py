"""A kernel as a small typed program: what every target language has, and nothing else.

Numbers are ``REAL`` or whole (``INT``); arrays of real numbers (``ARRAY``) belong to whoever calls. A whole number that
meets a real one has been converted where it does, so that a language without such a rule means the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

REAL, INT, ARRAY = "real", "int", "array"
LAW_ARGUMENTS = (INT, REAL, REAL, REAL, REAL, ARRAY, ARRAY)  # of a control law's kernel
TRUTH, WHOLES = "truth", "wholes"  # of a condition; of an array of whole numbers


@dataclass(frozen=True)
class Number:
    """A constant."""

    value: float | int
    type: str


@dataclass(frozen=True)
class Name:
    """A parameter or a local variable."""

    name: str
    type: str


@dataclass(frozen=True)
class Cell:
    """One number of an array, which has a name or is an item."""

    array: str | Item
    index: Expression
    type: str = REAL


@dataclass(frozen=True)
class Unary:
    """``-operand``, or ``not operand`` of a condition."""

    operator: str
    operand: Expression
    type: str


@dataclass(frozen=True)
class Binary:
    """``left operator right``: arithmetic, a comparison, or ``and`` and ``or`` of conditions."""

    operator: str
    left: Expression
    right: Expression
    type: str


@dataclass(frozen=True)
class Call:
    """A function of the language (``sqrt``, ``min``, ``real`` of a whole number, ``int`` of a real one ...)."""

    function: str
    arguments: tuple[Expression, ...]
    type: str


@dataclass(frozen=True)
class Apply:
    """A function of the program itself; arrays are passed by name."""

    function: str
    arguments: tuple[Expression, ...]
    type: str = REAL


@dataclass(frozen=True)
class Several:
    """Numbers or arrays together; its type is theirs, ``(real,int)``."""

    items: tuple[Expression, ...]
    type: str


@dataclass(frozen=True)
class Item:
    """One of several."""

    of: Expression
    place: int
    type: str


Expression = Number | Name | Cell | Unary | Binary | Call | Apply | Several | Item


@dataclass(frozen=True)
class Assign:
    """``target = value``."""

    target: Name | Cell
    value: Expression


@dataclass(frozen=True)
class If:
    """``if condition: then else: otherwise``."""

    condition: Expression
    then: tuple[Statement, ...]
    otherwise: tuple[Statement, ...]


@dataclass(frozen=True)
class For:
    """``for variable in range(start, stop, step)`` with a constant step."""

    variable: str
    start: Expression
    stop: Expression
    step: int
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class Return:
    """``return value``; None where nothing is returned."""

    value: Expression | None


@dataclass(frozen=True)
class While:
    """``while condition: body``."""

    condition: Expression
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class Do:
    """A call of a function that returns nothing."""

    call: Expression


@dataclass(frozen=True)
class Leave:
    """``break`` or ``continue``."""

    how: str


Statement = Assign | If | For | Return | While | Do | Leave


@dataclass(frozen=True)
class Function:
    """One function: ``parameters`` and ``variables`` by name with their types, and its steps; ``result`` is a type."""

    name: str
    parameters: dict[str, str]
    variables: dict[str, str]
    body: tuple[Statement, ...]
    result: str = REAL


@dataclass(frozen=True)
class Program:
    """Functions, each after those it calls; the last is the kernel. ``calls`` are functions of the language in use."""

    functions: tuple[Function, ...]
    calls: frozenset[str]

    @property
    def kernel(self) -> Function:
        """The function that was translated, behind its helpers."""
        return self.functions[-1]


def rewritten(one: Any, change: Callable[[Any], Any]) -> Any:
    """``one``, an expression, a statement or several, with every part of it replaced by its ``change``, inside first.

    A statement may become several.

    >>> rewritten((Name("x", REAL),), lambda part: Number(2.0, REAL) if part == Name("x", REAL) else part)
    (Number(value=2.0, type='real'),)
    """
    if isinstance(one, tuple):
        changed = (rewritten(each, change) for each in one)
        return tuple(part for each in changed for part in (each if isinstance(each, tuple) else (each,)))
    if not is_dataclass(one) or isinstance(one, type):
        return one
    inside = {part.name: rewritten(getattr(one, part.name), change) for part in fields(one)}
    return change(replace(one, **inside))
