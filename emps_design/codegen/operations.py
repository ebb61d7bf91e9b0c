"""Operations of one step, counted in the translated code: the most that any path through it takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

from emps_design.codegen.block import COMPARISONS, Ahead, Block
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
    Unary,
    parts,
)

KINDS = {"+": "add", "-": "add", "*": "multiply", "/": "divide"}
ORDER = ("multiply", "add", "divide", "compare", "call")
Known = Mapping[str, Any]  # arrays by name, whole numbers by name


def operations_of(block: Block) -> dict[str, int]:
    """Operations of one step of ``block``: products, sums and differences, quotients, comparisons, calls of ``math``.

    >>> from emps_design.machines import machine
    >>> operations_of(Block.of(machine("emps2019")))
    {'multiply': 4, 'add': 3, 'divide': 0, 'compare': 4, 'call': 0}
    """
    arrays = {5: block.law.gains.tolist()}
    total = counted(block.program, arrays) + Counter(compare=2)  # the limit
    if block.ahead is not None:
        total += _ahead(block.ahead) + Counter(add=2)  # the error, the sum
    return {kind: total[kind] for kind in ORDER}


def counted(program: Program, arrays: Mapping[int, Sequence[float]]) -> Counter[str]:
    """Operations of ``program``; ``arrays`` are the numbers that arguments hold, by their place."""
    functions = {function.name: function for function in program.functions}
    names = list(program.kernel.parameters)
    return _Count(functions).function(program.kernel, {names[place]: numbers for place, numbers in arrays.items()})


def _ahead(ahead: Ahead) -> Counter[str]:
    """Operations of a feed-forward, in all its passes."""
    once = sum((counted(part.program, {}) + Counter(add=1) for part in ahead.parts), Counter[str]())
    once += Counter(multiply=3, add=6, compare=1)
    once += Counter(add=1, compare=1, call=1) if ahead.repeats else Counter()
    after = Counter(divide=2, compare=2) + (Counter(multiply=1, add=1) if ahead.feedforward.back_emf else Counter())
    return Counter({kind: ahead.passes * n for kind, n in once.items()}) + after


class _Count:
    """Counts the operations of functions by name."""

    def __init__(self, functions: Mapping[str, Function]):
        self.functions = functions

    def function(self, function: Function, known: Known) -> Counter[str]:
        return self.block(function.body, dict(known))

    def block(self, steps: tuple[Any, ...], known: dict[str, Any]) -> Counter[str]:
        total: Counter[str] = Counter()
        for step in steps:
            total += self.statement(step, known)
        return total

    def statement(self, step: Any, known: dict[str, Any]) -> Counter[str]:
        if isinstance(step, Assign):
            value = _value(step.value, known)
            if isinstance(step.target, Name) and value is not None:
                known[step.target.name] = value
            return self.expression(step.value, known)
        if isinstance(step, For):
            start, stop = _value(step.start, known), _value(step.stop, known)
            turns = max(0, -(-(stop - start) // step.step)) if start is not None and stop is not None else 1
            body = self.block(step.body, dict(known))
            return Counter({kind: int(turns) * n for kind, n in body.items()})
        if isinstance(step, If):
            return self.ways(step, known)
        return self.expression(step.value, known)

    def ways(self, step: If, known: dict[str, Any]) -> Counter[str]:
        """Operations of the longest branch that the ``known`` numbers leave possible, with the tests before it."""
        blocks, tests = parts(step)
        total, possible = Counter[str](), []
        for block, test in zip_longest(blocks, tests):
            holds = None if test is None else _holds(test, known)
            total += Counter() if test is None else self.expression(test, known)
            if block is not None and holds is not False:
                possible.append(self.block(block, dict(known)))
            if holds:
                break
        return total + max(possible, key=lambda branch: sum(branch.values()), default=Counter())

    def expression(self, node: Any, known: Known) -> Counter[str]:
        if isinstance(node, Unary):
            return self.expression(node.operand, known)
        if isinstance(node, Binary):
            own = KINDS.get(node.operator, "" if node.operator in ("and", "or") else "compare")
            whole = node.type != REAL and own != "compare"
            inside = self.expression(node.left, known) + self.expression(node.right, known)
            return inside + (Counter() if whole or not own else Counter({own: 1}))
        if isinstance(node, Call | Apply):
            inside = sum((self.expression(argument, known) for argument in node.arguments), Counter[str]())
            if isinstance(node, Call):
                own = "compare" if node.function.startswith(("min", "max")) or node.function == "choose" else "call"
                return inside + (Counter() if node.function in ("real", "int", "modulo") else Counter({own: 1}))
            function = self.functions[node.function]
            passed = {
                name: known[argument.name]
                for name, argument in zip(function.parameters, node.arguments, strict=True)
                if isinstance(argument, Name) and argument.name in known
            }
            return inside + self.function(function, passed)
        return Counter()


def _holds(test: Any, known: Known) -> bool | None:
    """Whether ``test``, a comparison of two known numbers, holds; None where they are not known."""
    if not (isinstance(test, Binary) and test.operator in COMPARISONS):
        return None
    left, right = _value(test.left, known), _value(test.right, known)
    return None if left is None or right is None else bool(COMPARISONS[test.operator](left, right))


def _value(node: Any, known: Known) -> Any:
    """The number of ``node`` for any input; None where it depends on the input."""
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return known.get(node.name) if not isinstance(known.get(node.name), list) else None
    if isinstance(node, Cell) and isinstance(node.index, Number) and node.array in known:
        return known[str(node.array)][int(node.index.value)]
    if isinstance(node, Call) and node.function in ("int", "real"):
        inside = _value(node.arguments[0], known)
        return None if inside is None else int(inside) if node.function == "int" else float(inside)
    return None
