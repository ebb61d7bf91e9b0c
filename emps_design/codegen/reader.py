"""Read a kernel's own Python source into a :class:`~emps_design.codegen.program.Program`.

A kernel is plain Python of numbers: arithmetic, comparisons, ``if``, ``for`` over ``range``, local variables, cells of
its arrays, ``math``, ``abs``, ``min``, ``max``, functions of its own file. Anything else raises an error of one line.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import textwrap
from collections.abc import Callable, Iterable
from functools import cached_property
from types import FunctionType
from typing import Any

from emps_design.codegen.program import (
    ARRAY,
    INT,
    REAL,
    TRUTH,
    Apply,
    Assign,
    Binary,
    Call,
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
    Unary,
)
from emps_design.errors import InputError

MATH = {
    getattr(math, name): name
    for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "fabs", "floor", "pow")
}
OPERATORS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%", ast.Pow: "**",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    ast.And: "and", ast.Or: "or",
}  # fmt: skip
LARGEST_POWER = 8  # a whole power is written as products, as the compiler of the simulation does


class ExpressionReader:
    """Reads the expressions of one function, ``tree``; ``functions`` and ``calls`` are filled while reading."""

    def __init__(
        self, function: Any, tree: ast.FunctionDef, types: tuple[str, ...], functions: Any, calls: Any, above: Any
    ):
        self.function, self.tree, self.functions, self.calls, self.above = function, tree, functions, calls, above
        outside = inspect.getclosurevars(function).nonlocals
        self.outside = {**vars(builtins), **function.__globals__, **outside}
        arguments = tree.args
        names = [argument.arg for argument in arguments.args]
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs or arguments.defaults:
            self.refuse(tree, "a default or variadic argument")
        if len(names) != len(types):
            self.refuse(tree, f"{len(names)} arguments", f"{len(types)}")
        self.parameters = dict(zip(names, types, strict=True))
        self.variables: dict[str, str] = {}
        self.loops: list[str] = []  # variables of the loops around the current node
        self.counters: set[str] = set()

    def refuse(self, node: ast.AST, what: str, expected: str = "arithmetic, if, for over range, math") -> Any:
        """Raise :class:`InputError` with the place: ``what`` was found at ``node``."""
        line = getattr(node, "lineno", 1) + self.function.__code__.co_firstlineno - 1
        place = f"{self.function.__code__.co_filename}, line {line}, {self.tree.name}"
        raise InputError(f"{place}: found {what}, which cannot be translated; expected {expected}")

    def read_function(self, function: Any, types: tuple[str, ...]) -> None:
        """Add ``function``, which is called with arguments of these ``types``, to ``functions``."""
        raise NotImplementedError

    # Expressions.

    def number(self, node: ast.expr) -> Expression:
        """``node`` as an expression that has a number, or an array, for a value."""
        if isinstance(node, ast.Constant):
            return self.constant(node, node.value)
        if isinstance(node, ast.Name):
            own = self.parameters.get(node.id) or self.variables.get(node.id)
            if node.id in self.loops:
                return Name(node.id, INT)
            if node.id in self.counters:
                return self.refuse(node, f"{node.id} outside its loop", "another variable")
            if own or node.id in self.assigned:
                return Name(node.id, own or INT)
            return self.constant(node, self.value_of(node))
        if isinstance(node, ast.Attribute):
            return self.constant(node, self.value_of(node))
        if isinstance(node, ast.Subscript):
            array = node.value.id if isinstance(node.value, ast.Name) else ""
            if self.parameters.get(array) != ARRAY or isinstance(node.slice, ast.Slice | ast.Tuple):
                return self.refuse(node, "an index", "a cell of one of the kernel's arrays")
            return Cell(array, self.whole(node.slice))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            operand = self.number(node.operand)
            if isinstance(node.op, ast.UAdd):
                return operand
            if isinstance(operand, Number):
                return Number(-operand.value, operand.type)
            return Unary("-", operand, operand.type)
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            return self.arithmetic(node, OPERATORS[type(node.op)])
        if isinstance(node, ast.Call):
            return self.call(node)
        if isinstance(node, ast.IfExp):
            then, otherwise = self.number(node.body), self.number(node.orelse)
            if REAL in (then.type, otherwise.type):
                then, otherwise = real(then), real(otherwise)
            self.calls.add("choose")
            return Call("choose", (self.condition(node.test), then, otherwise), then.type)
        return self.refuse(node, f"{type(node).__name__.lower()}")

    def constant(self, node: ast.expr, value: Any) -> Expression:
        """A constant: finite, a number."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            return self.refuse(node, f"{value!r:.40}", "a number")
        if isinstance(value, float) and not math.isfinite(value):
            return self.refuse(node, f"{value}", "a finite number")
        return Number(value, INT if isinstance(value, int) else REAL)

    def arithmetic(self, node: ast.BinOp, operator: str) -> Expression:
        """``left operator right``."""
        left, right = self.number(node.left), self.number(node.right)
        if operator == "**":
            return self.power(node, left, right)
        if operator == "%":
            if left.type != INT or right.type != INT:
                return self.refuse(node, "a remainder of real numbers", "whole ones")
            self.calls.add("modulo")
            return Call("modulo", (left, right), INT)
        if operator == "/" or REAL in (left.type, right.type):
            return Binary(operator, real(left), real(right), REAL)
        return Binary(operator, left, right, INT)

    def power(self, node: ast.BinOp, base: Expression, exponent: Expression) -> Expression:
        """``base ** exponent``: a small whole power as products."""
        if isinstance(exponent, Number) and exponent.type == INT:
            if not 1 <= exponent.value <= LARGEST_POWER or not isinstance(base, Name | Cell):
                return self.refuse(
                    node, "a whole power", f"one from 1 to {LARGEST_POWER}, of a variable; or a real exponent"
                )
            return product(real(base), int(exponent.value))
        self.calls.add("pow")
        return Call("pow", (real(base), real(exponent)), REAL)

    def call(self, node: ast.Call) -> Expression:
        """A call of ``math``, ``abs``, ``min``, ``max``, a conversion, or a function of the file."""
        function = self.value_of(node.func)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            return self.refuse(node, "keyword or variadic arguments", "plain ones")
        arguments = [self.number(argument) for argument in node.args]
        if function is float:
            return real(arguments[0])
        if function is int:
            if arguments[0].type == INT:
                return arguments[0]
            self.calls.add("int")
            return Call("int", (arguments[0],), INT)
        if function in (min, max) and len(arguments) >= 2:
            kind = INT if all(argument.type == INT for argument in arguments) else REAL
            name = function.__name__ if kind == REAL else f"{function.__name__}_int"
            self.calls.add(name)
            result = arguments[0] if kind == INT else real(arguments[0])
            for argument in arguments[1:]:
                result = Call(name, (result, argument if kind == INT else real(argument)), kind)
            return result
        if function is abs or function in MATH:
            name = "fabs" if function is abs else MATH[function]
            if function is abs and arguments[0].type == INT:
                return self.refuse(node, "abs of an integer", "abs of a real number")
            self.calls.add(name)
            call = Call(name, tuple(map(real, arguments)), REAL)
            if name != "floor":
                return call
            self.calls.add("int")
            return Call("int", (call,), INT)
        if isinstance(function, FunctionType):
            return self.apply(node, function, arguments)
        return self.refuse(node, f"a call of {ast.unparse(node.func)}", "math, abs, min, max or a function of the file")

    def apply(self, node: ast.Call, function: FunctionType, arguments: list[Expression]) -> Expression:
        """A call of a function of the file, which is read first."""
        types = tuple(ARRAY if argument.type == ARRAY else REAL for argument in arguments)
        if function.__name__ not in self.functions:
            self.read_function(function, types)
        if tuple(self.functions[function.__name__].parameters.values()) != types:
            return self.refuse(node, f"{function.__name__} with other kinds of arguments", "the same in every call")
        return Apply(
            function.__name__, tuple(argument if argument.type == ARRAY else real(argument) for argument in arguments)
        )

    def whole(self, node: ast.expr) -> Expression:
        """``node`` as an integer."""
        number = self.number(node)
        return number if number.type == INT else self.refuse(node, "a real number", "an integer, or int() of it")

    def condition(self, node: ast.expr) -> Expression:
        """``node`` as a condition."""
        if isinstance(node, ast.BoolOp):
            first, *others = [self.condition(value) for value in node.values]
            for other in others:
                first = Binary(OPERATORS[type(node.op)], first, other, TRUTH)
            return first
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return Unary("not", self.condition(node.operand), TRUTH)
        if isinstance(node, ast.Compare) and all(type(op) in OPERATORS for op in node.ops):
            sides = [self.number(side) for side in (node.left, *node.comparators)]
            both = zip(sides, node.ops, sides[1:], strict=False)
            tests: list[Expression] = [self.compared(left, OPERATORS[type(op)], right) for left, op, right in both]
            condition = tests[0]
            for test in tests[1:]:
                condition = Binary("and", condition, test, TRUTH)
            return condition
        return self.refuse(node, "a condition that is not a comparison", "one such as x > 0.0")

    def compared(self, left: Expression, operator: str, right: Expression) -> Expression:
        """A comparison of numbers of one kind."""
        if REAL in (left.type, right.type):
            left, right = real(left), real(right)
        return Binary(operator, left, right, TRUTH)

    # Names.

    @cached_property
    def assigned(self) -> set[str]:
        """Names that the function assigns to."""
        names = [node for node in ast.walk(self.tree) if isinstance(node, ast.Name)]
        return {node.id for node in names if isinstance(node.ctx, ast.Store)}

    def value_of(self, node: ast.expr) -> Any:
        """The object of a name of the file or of a module that it imports."""
        if isinstance(node, ast.Name):
            if node.id not in self.outside:
                return self.refuse(node, f"the unknown name {node.id}")
            return self.outside[node.id]
        if isinstance(node, ast.Attribute):
            return getattr(self.value_of(node.value), node.attr, None)
        return self.refuse(node, type(node).__name__.lower())


def real(expression: Expression) -> Expression:
    """``expression`` as a real number: constants change their kind, whole variables are converted."""
    if expression.type != INT:
        return expression
    if isinstance(expression, Number):
        return Number(float(expression.value), REAL)
    return Call("real", (expression,), REAL)


def product(base: Expression, exponent: int) -> Expression:
    """``base ** exponent`` by squaring, the products in the order of the simulation's compiler."""
    power, result = base, None
    while exponent:
        if exponent & 1:
            result = power if result is None else Binary("*", result, power, REAL)
        exponent >>= 1
        power = Binary("*", power, power, REAL)
    assert result is not None
    return result


def read_program(kernel: Callable[..., Any], parameters: Iterable[str]) -> Program:
    """Return ``kernel`` with the functions it calls; ``parameters`` are the types of its arguments, in order.

    Raises :class:`InputError` in one line, with the place, for what a drive's language would not take.

    >>> def law(k, reference, gains):
    ...     return gains[0] * reference if k > 0 else 0.0
    >>> read_program(law, (INT, REAL, ARRAY)).kernel.parameters
    {'k': 'int', 'reference': 'real', 'gains': 'array'}
    """
    functions: dict[str, Function] = {}
    calls: set[str] = set()
    read_into(FunctionReader, kernel, tuple(parameters), functions, calls, ())
    return Program(tuple(functions.values()), frozenset(calls))


def read_into(
    reader: type[FunctionReader],
    function: Callable[..., Any],
    types: tuple[str, ...],
    functions: dict[str, Function],
    calls: set[str],
    above: Any,
) -> None:
    """Add ``function`` to ``functions``, behind what it calls."""
    if function in above:
        name = getattr(function, "__name__", repr(function))
        raise InputError(f"{name}: found a recursive function, which cannot be translated")
    reader(function, source_tree(function), types, functions, calls, (*above, function)).read()


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
        """Add ``function`` to ``functions``, with arguments of these ``types``."""
        read_into(type(self), function, types, self.functions, self.calls, self.above)

    def read(self) -> None:
        """Read the function into ``functions``."""
        steps = [step for step in self.tree.body if not _is_text(step)]
        # A variable is real as soon as one value of it is; types settle because they only move from whole to real.
        before = None
        while before != (self.variables, self.result):
            before = (dict(self.variables), self.result)
            body = self.block(steps)
        self.variables = {name: kind for name, kind in sorted(self.variables.items()) if name not in self.parameters}
        if self.result and not _returns(body):
            self.refuse(self.tree, "a path through the function without a return", "a number on every path")
        self.functions[self.tree.name] = Function(self.tree.name, self.parameters, self.variables, body, self.result)

    # Statements.

    def block(self, steps: list[ast.stmt]) -> tuple[Statement, ...]:
        """Statements in order."""
        return tuple(statement for step in steps for statement in self.statement(step))

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
            value = ast.copy_location(ast.BinOp(_as_value(node.target), node.op, node.value), node)
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
        again = [self.assign(target, self.number(_as_value(targets[0]))) for target in targets[1:]]
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
            return self.refuse(node, f"an assignment to the loop variable {node.id}", "another name")
        if known == ARRAY or value.type not in (REAL, INT):
            return self.refuse(node, f"an assignment of a condition or an array to {node.id}", "numbers")
        kind = REAL if REAL in (known, value.type) else INT
        if node.id in self.parameters and kind != self.parameters[node.id]:
            return self.refuse(node, f"a real number for the integer argument {node.id}", "another variable")
        self.variables[node.id] = kind
        return Assign(Name(node.id, kind), real(value) if kind == REAL else value)

    def loop(self, node: ast.For) -> list[Statement]:
        """``for`` over ``range``."""
        call = node.iter
        if not (isinstance(call, ast.Call) and self.value_of(call.func) is range and isinstance(node.target, ast.Name)):
            return self.refuse(node, "a loop", "for over range")
        if node.orelse:
            return self.refuse(node, "else of a loop")
        bounds = [self.whole(argument) for argument in call.args]
        step = bounds[2] if len(bounds) == 3 else Number(1, INT)
        if not isinstance(step, Number) or step.value == 0:
            return self.refuse(node, "a step that is not a constant", "an integer other than 0")
        start, stop = (Number(0, INT), bounds[0]) if len(bounds) == 1 else bounds[:2]
        if node.target.id in self.variables or node.target.id in self.parameters:
            return self.refuse(node, f"{node.target.id} for two things", "another name for the loop variable")
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


def _as_value(target: ast.expr) -> ast.expr:
    """The variable or cell ``target`` as a value."""
    return ast.parse(ast.unparse(target), mode="eval").body


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _returns(body: tuple[Statement, ...]) -> bool:
    """Whether every path through ``body`` ends in a return."""
    last = body[-1] if body else None
    if isinstance(last, If):
        return _returns(last.then) and _returns(last.otherwise)
    return isinstance(last, Return)
