"""A kernel as a small typed program, with only those constructs that every target language has.

Numbers are ``REAL`` or integers (``INT``); arrays of real numbers (``ARRAY``) belong to the caller. Where an integer is
combined with a real number, the program converts it, for languages that have no such rule. :class:`Printer` has what
the printers of all languages share: precedence, and names that the language allows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from itertools import chain
from typing import Any

REAL, INT, ARRAY = "real", "int", "array"
LAW_ARGUMENTS = (INT, REAL, REAL, REAL, REAL, ARRAY, ARRAY)  # of a control law's kernel
TRUTH, WHOLES = "truth", "wholes"  # of a condition; of an array of integers

PRECEDENCE = {"or": 1, "and": 2, "==": 4, "!=": 4, "<": 5, "<=": 5, ">": 5, ">=": 5, "+": 6, "-": 6, "*": 7, "/": 7}
SIGN = 8


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
    """A function of the language (``sqrt``, ``min``, ``real`` of an integer, ``int`` of a real number ...)."""

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
    """The item at ``place`` of several."""

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
        """The translated function; its helpers stand before it."""
        return self.functions[-1]


def rewritten(node: Any, change: Callable[[Any], Any]) -> Any:
    """``node``, an expression, a statement or several, with ``change`` applied to every part of it, inner parts first.

    ``change`` may return several statements for one.

    >>> rewritten((Name("x", REAL),), lambda part: Number(2.0, REAL) if part == Name("x", REAL) else part)
    (Number(value=2.0, type='real'),)
    """
    if isinstance(node, tuple):
        changed = (rewritten(part, change) for part in node)
        return tuple(chain.from_iterable(part if isinstance(part, tuple) else (part,) for part in changed))
    if not is_dataclass(node) or isinstance(node, type):
        return node
    inside = {part.name: rewritten(getattr(node, part.name), change) for part in fields(node)}
    return change(replace(node, **inside))


def safe_names(names: Iterable[str], reserved: frozenset[str]) -> dict[str, str]:
    """A name for each of ``names`` with ASCII letters, digits and single underscores, none reserved, none twice.

    Capital and small letters count as the same.

    >>> safe_names(["at", "T", "t", "_x__y", "λ"], frozenset({"at"}))
    {'at': 'at_2', 'T': 'T', 't': 't_2', '_x__y': 'x_y', 'λ': 'u3bb'}
    """
    safe: dict[str, str] = {}
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
        safe[name] = chosen
    return safe


class Printer:
    """Prints functions of a program; a subclass for each language prints the parts."""

    reserved: frozenset[str] = frozenset()
    operators: dict[str, str] = {}  # noqa: RUF012
    indent = "    "

    def __init__(self, functions: Iterable[Function], prefix: str):
        self.functions = safe_names((function.name for function in functions), frozenset())
        self.functions = {name: f"{prefix}_{safe}" for name, safe in self.functions.items()}
        self.names: dict[str, str] = {}

    def lines(self, function: Function, known: Mapping[str, str]) -> list[str]:
        """The body of ``function``, one line each; ``known`` has the printed names that are fixed."""
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

    def expression(self, node: Expression, outside: int = 0, right: bool = False) -> str:
        """``node`` as text, in parentheses where the operator ``outside`` binds more tightly."""
        if isinstance(node, Number):
            text = self.literal(node)
            return f"({text})" if text.startswith("-") and outside else text
        if isinstance(node, Name):
            return self.names[node.name]
        if isinstance(node, Cell):
            return f"{self.names[str(node.array)]}[{self.index(node.index)}]"
        if isinstance(node, Call):
            return self.call(node, [self.expression(argument) for argument in node.arguments])
        if isinstance(node, Apply):
            arguments = ", ".join(self.expression(argument) for argument in node.arguments)
            return f"{self.functions[node.function]}({arguments})"
        if isinstance(node, Unary):
            text = f"{self.operators[node.operator]}{self.expression(node.operand, SIGN)}"
            return f"({text})" if outside > (2 if node.operator == "not" else 0) else text
        assert isinstance(node, Binary)
        own = PRECEDENCE[node.operator]
        left = self.expression(node.left, own)
        text = f"{left} {self.operators[node.operator]} {self.expression(node.right, own, right=True)}"
        mixed = outside <= 2 and own <= 2 and own != outside and outside  # and inside or: parentheses for clarity
        return f"({text})" if own < outside or (own == outside and right) or mixed else text

    # To be printed by each language.

    def literal(self, number: Number) -> str:
        """A constant."""
        raise NotImplementedError

    def index(self, place: Expression) -> str:
        """A place in an array."""
        return self.expression(place)

    def call(self, call: Call, arguments: list[str]) -> str:
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
        """A branch with its alternatives."""
        raise NotImplementedError


def parts(step: Statement) -> tuple[list[tuple[Statement, ...]], list[Expression]]:
    """Blocks of a branch or a loop, and the expressions of its head; ``else`` with one ``if`` in it is ``else if``."""
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
def names_of(node: Any) -> frozenset[str]:
    """Every variable, parameter and array that ``node``, a statement or an expression, names."""
    if isinstance(node, str) or not (isinstance(node, tuple) or is_dataclass(node)):
        return frozenset()
    if isinstance(node, tuple):
        return names_in(node)
    own = {Name: "name", Cell: "array", For: "variable"}.get(type(node), "")
    named = getattr(node, own) if own else ""
    names = frozenset({named} if isinstance(named, str) and named else ())
    return names.union(*(names_of(getattr(node, part.name)) for part in fields(node)))


def names_in(steps: Iterable[Any]) -> frozenset[str]:
    """Every variable, parameter and array that ``steps`` name."""
    return frozenset().union(*map(names_of, steps))


def _counters(steps: tuple[Statement, ...]) -> list[str]:
    """Variables of the loops, in order, each once."""
    counters: dict[str, None] = {}
    for step in steps:
        if isinstance(step, If | For | While):
            own = [step.variable] if isinstance(step, For) else []
            counters |= dict.fromkeys([*own, *(name for block in parts(step)[0] for name in _counters(block))])
    return list(counters)
