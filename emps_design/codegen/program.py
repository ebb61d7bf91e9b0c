"""A kernel as a small typed program: what every target language has, and nothing else.

Numbers are ``REAL`` or whole (``INT``); arrays of real numbers (``ARRAY``) belong to whoever calls. A whole number that
meets a real one has been converted where it does, so that a language without such a rule means the same.

What the printers of all languages share: precedence, and names that the language can hold.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any

REAL, INT, ARRAY = "real", "int", "array"
LAW_ARGUMENTS = (INT, REAL, REAL, REAL, REAL, ARRAY, ARRAY)  # of a control law's kernel
TRUTH, WHOLES = "truth", "wholes"  # of a condition; of an array of whole numbers

PRECEDENCE = {"or": 1, "and": 2, "==": 4, "!=": 4, "<": 5, "<=": 5, ">": 5, ">=": 5, "+": 6, "-": 6, "*": 7, "/": 7}
SIGN, ALONE = 8, 9


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


def safe_names(names: Iterable[str], reserved: frozenset[str]) -> dict[str, str]:
    """A name for each of ``names`` with ASCII letters, digits and single underscores, none reserved, none twice.

    Capital and small letters count as the same.

    >>> safe_names(["at", "T", "t", "_x__y", "λ"], frozenset({"at"}))
    {'at': 'at_2', 'T': 'T', 't': 't_2', '_x__y': 'x_y', 'λ': 'u3bb'}
    """
    found: dict[str, str] = {}
    taken = set(reserved)
    for name in names:
        plain = "".join(c if c.isascii() else f"u{ord(c):x}" for c in name)
        plain = re.sub("_+", "_", plain).strip("_") or "x"
        plain = f"x{plain}" if plain[0].isdigit() else plain
        number, chosen = 1, plain
        while chosen.lower() in taken:
            number += 1
            chosen = f"{plain}_{number}"
        taken.add(chosen.lower())
        found[name] = chosen
    return found


class Printer:
    """Prints functions of a program; a language says how its parts look."""

    reserved: frozenset[str] = frozenset()
    operators: dict[str, str] = {}  # noqa: RUF012
    indent = "    "

    def __init__(self, functions: Iterable[Function], prefix: str):
        self.functions = safe_names((function.name for function in functions), frozenset())
        self.functions = {name: f"{prefix}_{safe}" for name, safe in self.functions.items()}
        self.names: dict[str, str] = {}

    def lines(self, function: Function, known: Mapping[str, str]) -> list[str]:
        """The body of ``function``, one line each; ``known`` names have theirs already."""
        taken = {name.lower() for name in (*self.functions.values(), *known.values())}
        own = (*function.parameters, *function.variables, *_counters(function.body))
        self.names = {**known, **safe_names((name for name in own if name not in known), self.reserved | taken)}
        return self.block(function.body)

    def block(self, steps: tuple[Statement, ...]) -> list[str]:
        """Statements, one or more lines each, indented."""
        return [self.indent + line for step in steps for line in self.statement(step)]

    def statement(self, step: Statement) -> list[str]:
        """One statement, its first line not indented."""
        if isinstance(step, Assign):
            return [self.assigned(self.expression(step.target), self.expression(step.value))]
        if isinstance(step, Return):
            assert step.value is not None
            return self.returned(self.expression(step.value))
        if isinstance(step, For):
            return self.loop(step)
        assert isinstance(step, If)
        return self.branch(step)

    def expression(self, one: Expression, outside: int = 0, right: bool = False) -> str:
        """``one`` as text, in parentheses where what stands ``outside`` binds more tightly."""
        if isinstance(one, Number):
            text = self.literal(one)
            return f"({text})" if text.startswith("-") and outside else text
        if isinstance(one, Name):
            return self.names[one.name]
        if isinstance(one, Cell):
            return f"{self.names[str(one.array)]}[{self.index(one.index)}]"
        if isinstance(one, Call):
            return self.call(one, [self.expression(argument) for argument in one.arguments])
        if isinstance(one, Apply):
            arguments = ", ".join(self.expression(argument) for argument in one.arguments)
            return f"{self.functions[one.function]}({arguments})"
        if isinstance(one, Unary):
            text = f"{self.operators[one.operator]}{self.expression(one.operand, SIGN)}"
            return f"({text})" if outside > (2 if one.operator == "not" else 0) else text
        assert isinstance(one, Binary)
        own = PRECEDENCE[one.operator]
        left = self.expression(one.left, own)
        text = f"{left} {self.operators[one.operator]} {self.expression(one.right, own, right=True)}"
        mixed = outside <= 2 and own <= 2 and own != outside and outside  # and inside or: said with parentheses
        return f"({text})" if own < outside or (own == outside and right) or mixed else text

    # What a language says.

    def literal(self, one: Number) -> str:
        """A constant."""
        raise NotImplementedError

    def index(self, one: Expression) -> str:
        """A place in an array."""
        return self.expression(one)

    def call(self, one: Call, arguments: list[str]) -> str:
        """A function of the language."""
        raise NotImplementedError

    def assigned(self, target: str, value: str) -> str:
        """An assignment."""
        raise NotImplementedError

    def returned(self, value: str) -> list[str]:
        """A return."""
        raise NotImplementedError

    def loop(self, step: For) -> list[str]:
        """A loop."""
        raise NotImplementedError

    def branch(self, step: If) -> list[str]:
        """A branch with its others."""
        raise NotImplementedError


def parts(step: Statement) -> tuple[list[tuple[Statement, ...]], list[Expression]]:
    """Blocks of a branch or a loop, and what is computed before them: ``else`` with one ``if`` in it is ``else if``."""
    if isinstance(step, For):
        return [step.body], [step.start, step.stop]
    if isinstance(step, While):
        return [step.body], [step.condition]
    assert isinstance(step, If)
    blocks, tests, rest = [step.then], [step.condition], step.otherwise
    while len(rest) == 1 and isinstance(rest[0], If):
        blocks, tests, rest = [*blocks, rest[0].then], [*tests, rest[0].condition], rest[0].otherwise
    return [*blocks, *([rest] if rest else [])], tests


@cache
def names_of(one: Any) -> frozenset[str]:
    """Every variable, parameter and array that ``one``, a statement or an expression, names."""
    if isinstance(one, str) or not (isinstance(one, tuple) or is_dataclass(one)):
        return frozenset()
    if isinstance(one, tuple):
        return names_in(one)
    own = {Name: "name", Cell: "array", For: "variable"}.get(type(one), "")
    named = getattr(one, own) if own else ""
    found = frozenset({named} if isinstance(named, str) and named else ())
    return found.union(*(names_of(getattr(one, part.name)) for part in fields(one)))


def names_in(steps: Iterable[Any]) -> frozenset[str]:
    """Every variable, parameter and array that ``steps`` name."""
    return frozenset().union(*map(names_of, steps))


def _counters(steps: tuple[Statement, ...]) -> list[str]:
    """Variables of the loops, in order, each once."""
    found: dict[str, None] = {}
    for step in steps:
        if isinstance(step, If | For | While):
            own = [step.variable] if isinstance(step, For) else []
            found |= dict.fromkeys([*own, *(name for block in parts(step)[0] for name in _counters(block))])
    return list(found)
