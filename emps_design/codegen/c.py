"""A program as C99: one typedef for the numbers, nothing but ``math.h``."""

from __future__ import annotations

import re

from emps_design.codegen.printer import Printer, names_in, names_of, parts
from emps_design.codegen.program import (
    ARRAY,
    INT,
    REAL,
    Assign,
    Call,
    Cell,
    For,
    Function,
    If,
    Name,
    Number,
    Program,
    Statement,
    While,
)

KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        """auto break case char const continue default do double else enum extern float for goto if inline int long
        register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
        asm bool class delete false main new template this true typeof con prn aux nul""",  # the last: no file's name
    )
)
TYPES = {REAL: "real", INT: "long long"}
# Functions of the language that C does not have under that meaning: Python's own, to the bit.
HELPERS = {
    "min": "static real min(real a, real b)\n{\n    return b < a ? b : a;\n}",
    "max": "static real max(real a, real b)\n{\n    return b > a ? b : a;\n}",
    "min_int": "static long long min_int(long long a, long long b)\n{\n    return b < a ? b : a;\n}",
    "max_int": "static long long max_int(long long a, long long b)\n{\n    return b > a ? b : a;\n}",
    "modulo": "static long long modulo(long long a, long long b)\n{\n    return ((a % b) + b) % b;\n}",
}


class CPrinter(Printer):
    """C99, with ``real`` for the numbers, ``R()`` for constants and ``FN()`` for functions of ``math.h``."""

    reserved = KEYWORDS | frozenset(HELPERS) | frozenset({"r", "fn", "real"})
    operators = {  # noqa: RUF012
        **{one: one for one in ("==", "!=", "<", "<=", ">", ">=", "+", "-", "*", "/")},
        "and": "&&", "or": "||", "not": "!",
    }  # fmt: skip
    constants: dict[str, dict[str, str]] = {}  # noqa: RUF012
    types: dict[str, str]  # of the variables that are not declared yet

    def function(self, function: Function) -> str:
        """The definition of ``function``."""
        self.types = function.variables
        known = self.constants.get(function.name, {})
        body = self.lines(function, known)
        used = names_in(function.body) | known.keys()
        unused = [
            f"{self.indent}(void){self.names[name]};" for name in function.parameters if name not in used | known.keys()
        ]
        written = _written(function.body)
        arguments = ", ".join(
            self.declared(kind, self.names[name], name in written)
            for name, kind in function.parameters.items()
            if name not in known
        )
        head = f"static {self.declared(function.result, self.functions[function.name])}({arguments})"
        return "\n".join([head, "{", *unused, *body, "}"])

    def declared(self, kind: str, name: str, written: bool = True) -> str:
        """A variable, an argument or a function of one ``kind``."""
        if kind == ARRAY:
            return f"{'' if written else 'const '}real *{name}"
        return f"{TYPES[kind]} {name}"

    def block(self, steps: tuple[Statement, ...]) -> list[str]:
        """Statements with the declarations of what no other block uses, each at the first value where it can be."""
        here = [name for name in self.types if _belongs(name, steps)]
        outer, self.types = self.types, {name: kind for name, kind in self.types.items() if name not in here}
        late = {name: next(step for step in steps if name in names_of(step)) for name in here}
        first = {
            id(step): name
            for name, step in late.items()
            if isinstance(step, Assign) and step.target == Name(name, outer[name])
        }
        lines = [
            f"{self.indent}{self.declared(outer[name], self.names[name])};"
            for name in here
            if name not in first.values()
        ]
        for step in steps:
            printed = self.statement(step)
            if id(step) in first:
                name = first[id(step)]
                printed[0] = self.declared(outer[name], "") + printed[0]
            lines += [self.indent + line for line in printed]
        self.types = outer
        return lines

    def literal(self, one: Number) -> str:
        """A constant; ``R()`` gives it the type of the build."""
        if one.type == INT:
            return str(one.value)
        return f"R({float(one.value)!r})"

    def call(self, one: Call, arguments: list[str]) -> str:
        """A function of ``math.h`` by the type of the build, a helper, a conversion or a choice."""
        inside = ", ".join(arguments)
        if one.function == "choose":
            condition, then, otherwise = arguments
            return f"(({condition}) ? {then} : {otherwise})"
        if one.function == "real":
            return f"R({inside})"
        if one.function == "int":
            return f"(long long)({inside})"
        return f"{one.function}({inside})" if one.function in HELPERS else f"FN({one.function})({inside})"

    def assigned(self, target: str, value: str) -> str:
        """An assignment."""
        return f"{target} = {value};"

    def returned(self, value: str) -> list[str]:
        """A return."""
        return [f"return {value};"]

    def loop(self, step: For) -> list[str]:
        """A loop with a counter of its own."""
        name, up = self.names[step.variable], step.step > 0
        change = f"{name}{'++' if up else '--'}" if abs(step.step) == 1 else f"{name} += {step.step}"
        stop = self.expression(step.stop)
        head = (
            f"for (long long {name} = {self.expression(step.start)}; {name} {'<' if up else '>'} {stop}; {change}) {{"
        )
        return [head, *self.block(step.body), "}"]

    def branch(self, step: If) -> list[str]:
        """A branch; ``else`` with one ``if`` in it is ``else if``."""
        blocks, tests = parts(step)
        heads = [f"if ({self.expression(test)}) {{" for test in tests] + ["{"] * (len(blocks) - len(tests))
        lines = [heads[0], *self.block(blocks[0])]
        for head, block in zip(heads[1:], blocks[1:], strict=True):
            lines += [f"}} else {head}", *self.block(block)]
        return [*lines, "}"]


def functions_in_c(program: Program, prefix: str, constants: dict[str, str]) -> tuple[list[str], str]:
    """Definitions of the functions of ``program``, helpers first, and the name that its kernel has there.

    ``constants`` are parameters of the kernel that are constants of the file: their names there.
    """
    printer = CPrinter(program.functions, prefix)
    printer.constants = {program.kernel.name: constants}
    helpers = [HELPERS[name] for name in HELPERS if name in program.calls]
    return [*helpers, *map(printer.function, program.functions)], printer.functions[program.kernel.name]


def _belongs(name: str, steps: tuple[Statement, ...]) -> bool:
    """Whether ``name`` is used in ``steps``, and not in one block of one of them alone."""
    users = [step for step in steps if name in names_of(step)]
    if len(users) != 1 or not isinstance(users[0], If | For | While):
        return bool(users)
    blocks, tests = parts(users[0])
    return any(name in names_of(test) for test in tests) or sum(name in names_in(block) for block in blocks) > 1


def _written(steps: tuple[Statement, ...]) -> set[str]:
    """Arrays that ``steps`` write to; one that is handed on counts."""
    found: set[str] = set()
    for step in steps:
        if isinstance(step, Assign):
            found |= {str(step.target.array)} if isinstance(step.target, Cell) else set()
        if isinstance(step, If | For | While):
            found = found.union(*map(_written, parts(step)[0]))
    return found
