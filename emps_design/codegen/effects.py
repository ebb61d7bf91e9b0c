"""The kernels of an axis's effects as functions of position, velocity and motor force, their numbers in place."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from emps_design.codegen.printer import names_in
from emps_design.codegen.program import (
    ARRAY,
    INT,
    REAL,
    TRUTH,
    Apply,
    Binary,
    Cell,
    Function,
    If,
    Name,
    Number,
    Program,
    Return,
    rewritten,
)
from emps_design.codegen.reader import read_program
from emps_design.codegen.rounded_kernel import on_rounded
from emps_design.codegen.rounding import Roundings
from emps_design.effects import Effect
from emps_design.effects.effect import ADDED
from emps_design.errors import InputError

COMPARED: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
KERNEL = (REAL, REAL, REAL, REAL, ARRAY, ARRAY, ARRAY)  # arguments of an effect's kernel


@dataclass(frozen=True)
class Part:
    """One kernel of one effect: its term, its hook, the program with its numbers in place."""

    term: str
    hook: str
    program: Program
    kernel: Any
    numbers: np.ndarray
    baseline: np.ndarray

    @property
    def reads_the_force(self) -> bool:
        """Whether the kernel's answer depends on the motor force."""
        return list(self.program.kernel.parameters)[2] in names_in(self.program.kernel.body)


def parts_of(effects: Iterable[tuple[str, Effect, np.ndarray]], b: np.ndarray) -> tuple[Part, ...]:
    """Every kernel of ``effects``, each a term, an effect and its parameters; ``b`` is the baseline (4,)."""
    return tuple(
        Part(term, hook, _with_numbers(read_program(kernel, KERNEL), values, b), kernel, values, b)
        for term, effect, values in effects
        for hook in ADDED
        for kernel in [getattr(effect, hook)]
        if kernel is not None
    )


def rounded_sums(parts: Iterable[Part], now: Roundings) -> dict[str, Callable[[Any, Any, Any], Any]]:
    """For each hook the sum of the kernels of ``parts``, of position, velocity and motor force as rounded numbers."""
    known: dict[str, list[Callable[[Any, Any, Any], Any]]] = {hook: [] for hook in ADDED}
    for part in parts:
        known[part.hook].append(_on_rounded(part, now))

    def total(hook: str, q: Any, v: Any, tau: Any) -> Any:
        return sum((kernel(q, v, tau) for kernel in known[hook]), now.exact(0.0))

    return {hook: partial(total, hook) for hook in ADDED}


def _on_rounded(part: Part, now: Roundings) -> Callable[[Any, Any, Any], Any]:
    kernel, time = on_rounded(part.kernel), now.exact(0.0)
    p, b = ([now.constant(float(x)) for x in row] for row in (part.numbers, part.baseline))
    return lambda q, v, tau: kernel(q, v, time, tau, [], p, b)


def _with_numbers(program: Program, p: np.ndarray, b: np.ndarray) -> Program:
    """A kernel of an effect as a function of q, v and tau: its numbers stand in it, and time is 0."""
    if len(program.functions) > 1:
        raise InputError(f"{program.kernel.name}: found a kernel that calls functions, expected math alone")
    kernel = program.kernel
    q, v, t, tau, x, own, baseline = kernel.parameters
    if x in names_in(kernel.body):
        raise InputError(f"{kernel.name}: found a state, which a block for a drive does not have")
    arrays = {own: p.tolist(), baseline: b.tolist()}
    tables: dict[str, Function] = {}

    def put(one: Any) -> Any:
        if isinstance(one, Name) and one.name == t:
            return Number(0.0, REAL)
        if isinstance(one, Binary) and one.type == INT and isinstance(one.left, Number) and one.operator == "+":
            return Number(one.left.value + one.right.value, INT) if isinstance(one.right, Number) else one
        if isinstance(one, If):
            return _taken(one)
        if not isinstance(one, Cell) or one.array not in arrays:
            return one
        numbers = arrays[str(one.array)]
        if isinstance(one.index, Number):
            return Number(numbers[int(one.index.value)], REAL)
        table = tables.setdefault(str(one.array), _table(f"{one.array}_at", numbers))
        return Apply(table.name, (one.index,))

    body = rewritten(kernel.body, put)
    function = Function(kernel.name, {name: REAL for name in (q, v, tau)}, kernel.variables, body)
    return replace(program, functions=(*tables.values(), function))


def _taken(branch: If) -> Any:
    """The way that is taken where two numbers are compared, ``branch`` itself elsewhere."""
    test = branch.condition
    if isinstance(test, Binary) and isinstance(test.left, Number) and isinstance(test.right, Number):
        return branch.then if COMPARED[test.operator](test.left.value, test.right.value) else branch.otherwise
    return branch


def _table(name: str, numbers: list[float]) -> Function:
    """The number at a place that is computed, the last beyond them."""
    place, rest = Name("place", INT), Return(Number(numbers[-1], REAL))
    cases = [
        If(Binary("==", place, Number(i, INT), TRUTH), (Return(Number(number, REAL)),), ())
        for i, number in enumerate(numbers[:-1])
    ]
    return Function(name, {place.name: INT}, {}, (*cases, rest))
