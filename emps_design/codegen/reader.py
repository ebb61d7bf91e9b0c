"""Read a kernel's own Python source into a :class:`~emps_design.codegen.program.Program`.

A kernel is plain Python of numbers: arithmetic, comparisons, ``if``, ``for`` over ``range``, local variables, cells of
its arrays, ``math``, ``abs``, ``min``, ``max``, functions of its own file. Anything else is refused in one line.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterable
from typing import Any

from emps_design.codegen.expressions import ExpressionReader, real
from emps_design.codegen.program import (
    ARRAY,
    INT,
    REAL,
    Assign,
    Cell,
    Expression,
    For,
    Function,
    If,
    Name,
    Number,
    Program,
    Return,
    Statement,
)
from emps_design.errors import InputError


def read_program(kernel: Callable[..., Any], parameters: Iterable[str]) -> Program:
    """Return ``kernel`` with the functions it calls; ``parameters`` are the types of its arguments, in order.

    Raises :class:`InputError` in one line, with the place, for what a drive's language would not take.

    >>> def law(k, reference, gains):
    ...     return gains[0] * reference if k > 0 else 0.0
    >>> read_program(law, (INT, REAL, ARRAY)).kernel.parameters
    {'k': 'int', 'reference': 'real', 'gains': 'array'}
    """
    found: dict[str, Function] = {}
    calls: set[str] = set()
    read_into(FunctionReader, kernel, tuple(parameters), found, calls, ())
    return Program(tuple(found.values()), frozenset(calls))


def read_into(
    reader: type[FunctionReader],
    function: Callable[..., Any],
    types: tuple[str, ...],
    found: dict[str, Function],
    calls: set[str],
    above: Any,
) -> None:
    """Add ``function`` to ``found``, behind what it calls."""
    if function in above:
        name = getattr(function, "__name__", repr(function))
        raise InputError(f"{name}: found a function that calls itself, expected none: a drive has no room for it")
    reader(function, source_tree(function), types, found, calls, (*above, function)).read()


def source_tree(function: Callable[..., Any]) -> ast.FunctionDef:
    """The definition of ``function`` as its file has it."""
    name = getattr(function, "__name__", repr(function))
    try:
        source = textwrap.dedent(inspect.getsource(function))
        tree = ast.parse(source).body[0]
    except (OSError, TypeError, SyntaxError, IndexError) as error:
        raise InputError(f"{name}: its source cannot be read ({error}); put the function into a file") from error
    if not isinstance(tree, ast.FunctionDef):
        raise InputError(f"{name}: found {type(tree).__name__}, expected a function made with def")
    return tree


class FunctionReader(ExpressionReader):
    """Reads one function."""

    result = REAL

    def read_function(self, function: Any, types: tuple[str, ...]) -> None:
        """Add ``function`` to ``found``, with arguments of these ``types``."""
        read_into(type(self), function, types, self.found, self.calls, self.above)

    def read(self) -> None:
        """Read the function into ``found``."""
        steps = [step for step in self.tree.body if not _is_text(step)]
        # A variable is real as soon as one value of it is; types settle because they only move from whole to real.
        before = None
        while before != (self.variables, self.result):
            before = (dict(self.variables), self.result)
            body = self.block(steps)
        self.variables = {name: kind for name, kind in sorted(self.variables.items()) if name not in self.parameters}
        if self.result and not _returns(body):
            self.refuse(self.tree, "a way through the function without a return", "a number on every way")
        self.found[self.tree.name] = Function(self.tree.name, self.parameters, self.variables, body, self.result)

    # Statements.

    def block(self, steps: list[ast.stmt]) -> tuple[Statement, ...]:
        """Statements in order."""
        return tuple(one for step in steps for one in self.statement(step))

    def statement(self, node: ast.stmt) -> list[Statement]:
        """One statement, which may become several."""
        if isinstance(node, ast.Pass) or _is_text(node):
            return []
        if isinstance(node, ast.Return):
            value = node.value or self.refuse(node, "a return without a number")
            return [Return(real(self.number(value)))]
        if isinstance(node, ast.Assign):
            return self.assignments(node.targets, node.value)
        if isinstance(node, ast.AnnAssign) and node.value is not None:
            return self.assignments([node.target], node.value)
        if isinstance(node, ast.AugAssign):
            value = ast.copy_location(ast.BinOp(_loaded(node.target), node.op, node.value), node)
            return self.assignments([node.target], value)
        if isinstance(node, ast.If):
            return [If(self.condition(node.test), self.block(node.body), self.block(node.orelse))]
        if isinstance(node, ast.For):
            return self.loop(node)
        return self.refuse(node, f"{type(node).__name__.lower()}")

    def assignments(self, targets: list[ast.expr], value: ast.expr) -> list[Statement]:
        """``targets = value``."""
        if any(isinstance(target, ast.Tuple) for target in targets):
            return self.refuse(value, "several variables in one assignment", "one at a time")
        first = self.assign(targets[0], self.number(value))
        again = [self.assign(target, self.number(_loaded(targets[0]))) for target in targets[1:]]
        return [first, *again]

    def assign(self, node: ast.expr, value: Expression) -> Statement:
        """One assignment of a ``value`` that has been read."""
        if isinstance(node, ast.Subscript):
            target = self.number(node)
            assert isinstance(target, Cell)
            return Assign(target, real(value))
        if not isinstance(node, ast.Name):
            return self.refuse(node, f"an assignment to {type(node).__name__.lower()}")
        known = self.parameters.get(node.id) or self.variables.get(node.id)
        if node.id in self.counters:
            return self.refuse(node, f"an assignment to the loop's own {node.id}", "a name of its own")
        if known == ARRAY or value.type not in (REAL, INT):
            return self.refuse(node, f"an assignment of a condition or an array to {node.id}", "numbers")
        kind = REAL if REAL in (known, value.type) else INT
        if node.id in self.parameters and kind != self.parameters[node.id]:
            return self.refuse(node, f"a real number for the whole argument {node.id}", "a variable of its own")
        self.variables[node.id] = kind
        return Assign(Name(node.id, kind), real(value) if kind == REAL else value)

    def loop(self, node: ast.For) -> list[Statement]:
        """``for`` over ``range``."""
        call = node.iter
        if not (isinstance(call, ast.Call) and self.value_of(call.func) is range and isinstance(node.target, ast.Name)):
            return self.refuse(node, "a loop", "for over range")
        if node.orelse:
            return self.refuse(node, "else of a loop")
        bounds = [self.whole(one) for one in call.args]
        step = bounds[2] if len(bounds) == 3 else Number(1, INT)
        if not isinstance(step, Number) or step.value == 0:
            return self.refuse(node, "a step that is not a constant", "a whole number other than 0")
        start, stop = (Number(0, INT), bounds[0]) if len(bounds) == 1 else bounds[:2]
        if node.target.id in self.variables or node.target.id in self.parameters:
            return self.refuse(node, f"{node.target.id} for two things", "a name of its own for the loop's variable")
        name = node.target.id
        before: list[Statement] = []
        if not isinstance(stop, Number):  # the end of a range is computed once, whatever the loop does
            end = Name(f"{name}_end", INT)
            if self.variables.setdefault(end.name, INT) != INT or end.name in self.assigned | set(self.parameters):
                return self.refuse(node, f"a variable called {end.name}", "another name: the translation needs it")
            before, stop = [Assign(end, stop)], end
        self.counters.add(name)
        self.loops.append(name)
        body = self.block(node.body)
        self.loops.pop()
        return [*before, For(name, start, stop, int(step.value), body)]


def _loaded(target: ast.expr) -> ast.expr:
    """The variable or cell ``target`` as a value."""
    return ast.parse(ast.unparse(target), mode="eval").body


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _returns(body: tuple[Statement, ...]) -> bool:
    """Whether every way through ``body`` ends in a return."""
    last = body[-1] if body else None
    if isinstance(last, If):
        return _returns(last.then) and _returns(last.otherwise)
    return isinstance(last, Return)
