"""A block run in numbers of one precision, as its exported code runs: what single precision does, measured.

The translated program runs operation by operation, with every real number of the type ``real`` and every condition of
a branch or a choice noted. So the same step runs in double and in single precision. Functions of ``math`` are rounded
once, from double precision.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from emps_design.codegen.block import COMPARISONS, Block
from emps_design.codegen.program import (
    REAL,
    Apply,
    Assign,
    Binary,
    Call,
    Cell,
    For,
    Function,
    If,
    Name,
    Number,
    Program,
    Return,
    Unary,
)
from emps_design.codegen.reader import MATH
from emps_design.effects.effect import ADDED
from emps_design.simulation.kernels.inverse import SETTLED

Run = Callable[[dict[str, Any]], Any]  # of the values of parameters and variables, by name
OPERATORS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, **COMPARISONS}
SIGNS = {"-": operator.neg, "not": operator.not_}
WHOLE = {"int": int, "min": min, "max": max, "min_int": min, "max_int": max, "modulo": operator.mod}
UNDEFINED = (ArithmeticError, ValueError, IndexError)  # of a number that is not finite, in Python


class Runner:
    """Runs ``program`` in numbers of the type ``real``; ``decide`` is called with each condition and returns it.

    >>> import numpy as np
    >>> root = Function("root", {"x": REAL}, {}, (Return(Call("sqrt", (Name("x", REAL),), REAL)),))
    >>> float(Runner(Program((root,), frozenset({"sqrt"})), np.float32, bool)(np.float32(2.0)))
    1.4142135381698608
    """

    def __init__(self, program: Program, real: type, decide: Callable[[Any], bool]):
        def rounded(name: str) -> Callable[..., Any]:
            return lambda *numbers: real(getattr(math, name)(*map(float, numbers)))

        self.real, self.decide, self.functions = real, decide, dict[str, Callable[..., Any]]()
        self.calls: dict[str, Any] = {**{name: rounded(name) for name in MATH.values()}, **WHOLE, "real": real}
        for function in program.functions:
            self.functions[function.name] = self._function(function)
        self.kernel = self.functions[program.kernel.name]

    def __call__(self, *arguments: Any) -> Any:
        """The answer of the kernel."""
        return self.kernel(*arguments)

    def _function(self, function: Function) -> Callable[..., Any]:
        body, parameters = self._block(function.body), list(function.parameters)
        return lambda *arguments: body(dict(zip(parameters, arguments, strict=True)))

    def _block(self, statements: Iterable[Any]) -> Run:
        """Statements one after the other: what the first that returns something returns, or None."""
        runs = list(map(self._statement, statements))
        return lambda names: next((answer for run in runs if (answer := run(names)) is not None), None)

    def _statement(self, node: Any) -> Run:
        match node:
            case Return(value):
                return self._value(value)
            case Assign(Name(name), value):
                new = self._value(value)
                return lambda names: names.update({name: new(names)})
            case Assign(Cell(array, index), value):
                new, place = self._value(value), self._value(index)
                return lambda names: operator.setitem(names[str(array)], place(names), new(names))
            case If(condition, then, otherwise):
                test, first, second = self._value(condition), self._block(then), self._block(otherwise)
                return lambda names: (first if self.decide(test(names)) else second)(names)
        assert isinstance(node, For)
        start, stop, body = self._value(node.start), self._value(node.stop), self._block(node.body)

        def loop(names: dict[str, Any]) -> Any:
            for place in range(start(names), stop(names), node.step):
                names[node.variable] = place
                if (answer := body(names)) is not None:
                    return answer
            return None

        return loop

    def _value(self, node: Any) -> Run:
        match node:
            case Number(value, kind):
                constant = self.real(value) if kind == REAL else value
                return lambda names: constant
            case Name(name):
                return operator.itemgetter(name)
            case Cell(array, index):
                place = self._value(index)
                return lambda names: names[str(array)][place(names)]
            case Binary("and" | "or" as sign, left, right):
                first, second, ends = self._value(left), self._value(right), sign == "or"
                return lambda names: ends if first(names) == ends else second(names)
            case Call("choose", arguments):
                test, then, otherwise = map(self._value, arguments)
                return lambda names: (then if self.decide(test(names)) else otherwise)(names)
            case Unary(sign, operand):
                return self._applied(SIGNS[sign], operand)
            case Binary(sign, left, right):
                return self._applied(OPERATORS[sign], left, right)
            case Call(name, arguments):
                return self._applied(self.calls[name], *arguments)
        assert isinstance(node, Apply)
        return self._applied(self.functions[node.function], *node.arguments)

    def _applied(self, function: Callable[..., Any], *arguments: Any) -> Run:
        values = list(map(self._value, arguments))
        return lambda names: function(*(value(names) for value in values))


class Stepper:
    """A fresh ``block`` in numbers of the type ``real``; ``decisions`` are those of the last step, in order.

    Decisions are the conditions of the program and the limit. Minima and maxima are none: there a difference of
    rounding makes no jump.
    """

    def __init__(self, block: Block, real: type):
        self.block, self.real, self.k, self.decisions = block, real, 0, list[bool]()
        self.kernel = Runner(block.program, real, self.decide)
        self.gains, self.memory = list(map(real, block.law.gains)), [real(0.0)] * block.law.memory
        self.added: dict[str, list[Callable[..., Any]]] = {hook: [] for hook in ADDED}
        for part in block.ahead.parts if block.ahead is not None else ():
            self.added[part.hook].append(Runner(part.program, real, self.decide))

    def decide(self, condition: Any) -> bool:
        """Note the ``condition`` and return it."""
        self.decisions.append(bool(condition))
        return self.decisions[-1]

    def step(self, sample: Iterable[float], motion: Sequence[float]) -> float:
        """Return the command for one sample; NaN once a number is not finite or not defined.

        ``sample`` is reference, position and force, ``motion`` position, velocity, acceleration for the feed-forward.
        """
        self.decisions = []
        try:
            return float(self._limited(list(map(self.real, sample)), list(map(self.real, motion))))
        except UNDEFINED:
            self.memory = [self.real(math.nan)] * len(self.memory)
            return math.nan

    def _limited(self, sample: list[Any], motion: list[Any]) -> Any:
        reference, q, f_ext = sample
        limit, waits = self.real(self.block.limit), self.block.waits
        integral = None if waits is None else self.memory[waits]
        added = self._feedforward(*motion) if self.block.ahead is not None else None
        if self.block.law.error_alone:
            reference, q = self.real(0.0), q - reference
        u = self.kernel(self.k, reference, q, f_ext, limit, self.gains, self.memory)
        u = u if added is None else u + added
        self.k += 1
        beyond = self.decide(u > limit) or self.decide(u < -limit)
        if beyond and waits is not None:
            self.memory[waits] = integral
        return max(min(u, limit), -limit) if beyond else u

    def _feedforward(self, q: Any, v: Any, a: Any) -> Any:
        """The feed-forward; only the decisions of its last pass count."""
        real, ahead = self.real, self.block.ahead
        assert ahead is not None
        mass, viscous, coulomb, offset = map(real, ahead.own)
        direction = max(min(v / real(ahead.reversal), real(1.0)), real(-1.0)) if ahead.reversal > 0.0 else real(0.0)
        tau = real(0.0)
        for _ in range(ahead.passes):
            self.decisions, before = [], tau
            force, dry, inertia = (sum((add(q, v, tau) for add in self.added[hook]), real(0.0)) for hook in ADDED)
            level = max(coulomb + dry, real(0.0))
            tau = viscous * v + offset + force + ((mass + inertia) * a + level * direction)
            if abs(tau - before) < real(SETTLED):
                break
        tau = tau + real(ahead.feedforward.back_emf) * v if ahead.feedforward.back_emf else tau
        return tau / real(ahead.feedforward.axis.drive.gain)
