"""A stepper as C99: several values are a structure, and the loop over samples is opened, so that one is a call."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from emps_design.codegen.c import TYPES, CPrinter
from emps_design.codegen.printer import safe_names
from emps_design.codegen.program import (
    ARRAY,
    TRUTH,
    WHOLES,
    Assign,
    Binary,
    Cell,
    Do,
    Expression,
    For,
    Function,
    Item,
    Leave,
    Number,
    Return,
    Several,
    Statement,
    While,
)
from emps_design.codegen.stepper import items

KINDS = {**TYPES, ARRAY: "real *", WHOLES: "long long *", TRUTH: "int", "": "void"}
RING = "RING"  # how many samples the arrays with one number a sample hold


@dataclass(frozen=True)
class Opened:
    """A run over samples in parts: its variables as ``fields``, what comes ``before``, and a sample up to and after.

    ``result`` is the type of what the run answers.
    """

    fields: list[str]
    before: list[str]
    upto: list[str]
    after: list[str]
    result: str


class StepperPrinter(CPrinter):
    """C99 of a stepper, in double precision; ``rings`` are arrays with one number a sample, by function."""

    def __init__(self, functions: Iterable[Function], prefix: str, rings: dict[str, set[str]] | None = None):
        super().__init__(functions, prefix)
        self.functions |= {name: name for name in ("call_kernel", "call_actuator", "call_rate")}
        self.rings, self.ring = rings or {}, set[str]()
        self.structures: dict[str, str] = {}

    def function(self, function: Function) -> str:
        """The definition of ``function``."""
        self.ring = self.rings.get(function.name, set())
        return super().function(function)

    def opened(self, function: Function, variable: str, output: str) -> Opened:
        """``function`` in parts: its loop over ``variable`` is cut behind the assignment to a cell of ``output``."""
        self.ring, self.types = self.rings.get(function.name, set()), {}
        own = {**function.parameters, **function.variables, variable: "int"}
        fields = safe_names(own, self.reserved | {name.lower() for name in self.functions.values()})
        place = next(i for i, step in enumerate(function.body) if isinstance(step, For) and step.variable == variable)
        inside = function.body[place]
        assert isinstance(inside, For)
        cut = 1 + next(
            i
            for i, step in enumerate(inside.body)
            if isinstance(step, Assign) and isinstance(step.target, Cell) and step.target.array == output
        )
        known = {name: f"m->{safe}" for name, safe in fields.items()}
        blocks = function.body[:place], inside.body[:cut], (*inside.body[cut:], *function.body[place + 1 :])
        before, upto, after = (self.lines(Function(function.name, {}, {}, block), known) for block in blocks)
        declared = [f"{self.declared(kind, fields[name])};" for name, kind in own.items()]
        return Opened(declared, before, upto, after, self.declared(function.result, ""))

    def definitions(self) -> list[str]:
        """The structures that were used."""
        found = []
        for kind, name in self.structures.items():
            inside = " ".join(f"{self.declared(one, f'f{i}')};" for i, one in enumerate(items(kind)))
            found.append(f"typedef struct {{ {inside} }} {name};")
        return found

    def declared(self, kind: str, name: str, written: bool = True) -> str:
        """A variable, an argument or a function of one ``kind``."""
        if items(kind):
            self.structures.setdefault(kind, f"several_{len(self.structures) + 1}")
        told = self.structures.get(kind) or KINDS[kind]
        return f"{told}{'' if told.endswith('*') else ' '}{name}"

    def literal(self, one: Number) -> str:
        """A constant, which may be infinite."""
        if math.isinf(one.value):
            return "HUGE_VAL" if one.value > 0 else "-HUGE_VAL"
        return str(one.value) if one.type == TRUTH else super().literal(one)

    def expression(self, one: Expression, outside: int = 0, right: bool = False) -> str:
        """``one`` as text."""
        if isinstance(one, Several):
            return f"({self.declared(one.type, '').strip()}){{{', '.join(map(self.expression, one.items))}}}"
        if isinstance(one, Item):
            return f"{self.expression(one.of)}.f{one.place}"
        if isinstance(one, Cell):
            array = self.names[one.array] if isinstance(one.array, str) else self.expression(one.array)
            place = self.index(one.index)
            return f"{array}[({place}) % {RING}]" if one.array in self.ring else f"{array}[{place}]"
        if isinstance(one, Binary) and one.operator in ("==", "!=") and one.left.type == TRUTH:
            return f"(({self.expression(one.left)}) {one.operator} ({self.expression(one.right)}))"
        return super().expression(one, outside, right)

    def statement(self, step: Statement) -> list[str]:
        """One statement."""
        if isinstance(step, Return) and step.value is None:
            return ["return;"]
        if isinstance(step, Leave):
            return [f"{step.how};"]
        if isinstance(step, Do):
            return [f"{self.expression(step.call)};"]
        if isinstance(step, While):
            return [f"while ({self.expression(step.condition)}) {{", *self.block(step.body), "}"]
        return super().statement(step)
