"""A program in the languages of drives: C99 and Structured Text of IEC 61131-3.

C99 has one typedef for the numbers and needs ``math.h`` alone. Structured Text has functions in LREAL or REAL that a
function block calls.
"""

from __future__ import annotations

import re

from emps_design.codegen.program import (
    ARRAY,
    INT,
    REAL,
    Assign,
    Call,
    Cell,
    Expression,
    For,
    Function,
    If,
    Name,
    Number,
    Printer,
    Program,
    Statement,
    While,
    names_in,
    names_of,
    parts,
)
from emps_design.errors import InputError

C_KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        """auto break case char const continue default do double else enum extern float for goto if inline int long
        register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
        asm bool class delete false main new template this true typeof con prn aux nul""",  # the last: no file's name
    )
)
TYPES = {REAL: "real", INT: "long long"}
# Functions that C lacks or defines differently: with Python's meaning, to the bit.
HELPERS = {
    "min": "static real min(real a, real b)\n{\n    return b < a ? b : a;\n}",
    "max": "static real max(real a, real b)\n{\n    return b > a ? b : a;\n}",
    "min_int": "static long long min_int(long long a, long long b)\n{\n    return b < a ? b : a;\n}",
    "max_int": "static long long max_int(long long a, long long b)\n{\n    return b > a ? b : a;\n}",
    "modulo": "static long long modulo(long long a, long long b)\n{\n    return ((a % b) + b) % b;\n}",
}

ST_KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        """abs acos action add and any array asin at atan begin bool by byte case char class concat
        configuration constant continue cos d date deg delete delta dint div do dt dword else elsif end
        end_case end_for end_function end_function_block end_if end_program end_repeat end_struct end_type
        end_var end_while eq exit exp expt extends false fbd final find for from function function_block ge
        gt if il implements in initial_step insert int interface internal interval is jmp l ldate le left
        len limit lint ln log lreal lt lword max method mid min mod move mul mux n namespace ne not null of
        on or override p pointer priority private program protected public r r_edge real ref ref_to
        reference repeat replace resource retain return right rol ror rs s sel sfc shl shr sin single sint
        sqrt sr st step string struct sub super tan task then this time to tod ton transition true trunc
        type udint uint ulint until using usint var var_in_out var_input var_output var_temp wchar while
        with word wstring xor""",
    )
)
CALLS = {"sqrt": "SQRT", "sin": "SIN", "cos": "COS", "tan": "TAN", "asin": "ASIN", "acos": "ACOS", "atan": "ATAN",
         "exp": "EXP", "log": "LN", "fabs": "ABS", "pow": "EXPT"}  # fmt: skip
BODIES = {
    "min": ("a, b : {real}", "{real}", "IF b < a THEN\n    {name} := b;\nELSE\n    {name} := a;\nEND_IF;"),
    "max": ("a, b : {real}", "{real}", "IF b > a THEN\n    {name} := b;\nELSE\n    {name} := a;\nEND_IF;"),
    "min_int": ("a, b : LINT", "LINT", "IF b < a THEN\n    {name} := b;\nELSE\n    {name} := a;\nEND_IF;"),
    "max_int": ("a, b : LINT", "LINT", "IF b > a THEN\n    {name} := b;\nELSE\n    {name} := a;\nEND_IF;"),
    "modulo": ("a, b : LINT", "LINT", "{name} := ((a MOD b) + b) MOD b;"),
    "choose": (
        "which : BOOL;\n    a, b : {real}", "{real}", "IF which THEN\n    {name} := a;\nELSE\n    {name} := b;\nEND_IF;"
    ),
}  # fmt: skip


class CPrinter(Printer):
    """C99, with ``real`` for the numbers, ``R()`` for constants and ``FN()`` for functions of ``math.h``."""

    reserved = C_KEYWORDS | frozenset(HELPERS) | frozenset({"r", "fn", "real"})
    operators = {  # noqa: RUF012
        **{operator: operator for operator in ("==", "!=", "<", "<=", ">", ">=", "+", "-", "*", "/")},
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
        """Statements with the declarations of this block's own variables, at the first assignment where possible."""
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

    def literal(self, number: Number) -> str:
        """A constant; ``R()`` gives it the type of the build."""
        if number.type == INT:
            return str(number.value)
        return f"R({float(number.value)!r})"

    def call(self, call: Call, arguments: list[str]) -> str:
        """A function of ``math.h`` by the type of the build, a helper, a conversion or a choice."""
        inside = ", ".join(arguments)
        if call.function == "choose":
            condition, then, otherwise = arguments
            return f"(({condition}) ? {then} : {otherwise})"
        if call.function == "real":
            return f"R({inside})"
        if call.function == "int":
            return f"(long long)({inside})"
        return f"{call.function}({inside})" if call.function in HELPERS else f"FN({call.function})({inside})"

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
    arrays: set[str] = set()
    for step in steps:
        if isinstance(step, Assign):
            arrays |= {str(step.target.array)} if isinstance(step.target, Cell) else set()
        if isinstance(step, If | For | While):
            arrays = arrays.union(*map(_written, parts(step)[0]))
    return arrays


class StPrinter(Printer):
    """Structured Text; ``real`` is LREAL or REAL."""

    reserved = ST_KEYWORDS
    operators = {  # noqa: RUF012
        **{operator: operator for operator in ("<", "<=", ">", ">=", "+", "-", "*", "/")},
        "==": "=", "!=": "<>", "and": "AND", "or": "OR", "not": "NOT ",
    }  # fmt: skip
    sizes: dict[str, int]  # of the kernel's arrays

    def __init__(self, functions: tuple[Function, ...], prefix: str, real: str, sizes: dict[str, int]):
        super().__init__(functions, prefix)
        self.prefix, self.real, self.sizes = prefix, real, sizes

    def function(self, function: Function) -> str:
        """The declaration of ``function`` with its body."""
        self.own = self.functions[function.name]
        body = self.lines(function, {})
        taken = set(function.parameters) | set(function.variables)
        counters = [name for name in self.names if name not in taken]
        types = {REAL: self.real, INT: "LINT"}
        arrays = [name for name, kind in function.parameters.items() if kind == ARRAY]
        inputs = [name for name in function.parameters if name not in arrays]
        sizes = [f"ARRAY[0..{max(1, self.sizes.get(name, 1)) - 1}] OF {self.real}" for name in arrays]
        sections = [
            ("VAR_INPUT", [f"{self.names[name]} : {types[function.parameters[name]]};" for name in inputs]),
            ("VAR_IN_OUT", [f"{self.names[name]} : {size};" for name, size in zip(arrays, sizes, strict=True)]),
            (
                "VAR",
                [f"{self.names[name]} : {types[kind]};" for name, kind in function.variables.items()]
                + [f"{self.names[name]} : LINT;" for name in counters],
            ),
        ]
        lines = [f"FUNCTION {self.own} : {self.real}"]
        for title, declared in sections:
            lines += (
                [title, *(f"{self.indent}{declaration}" for declaration in declared), "END_VAR"] if declared else []
            )
        return "\n".join([*lines, *(line.removeprefix(self.indent) for line in body), "END_FUNCTION"])

    def helper(self, name: str) -> str:
        """The declaration of one of ``BODIES``."""
        inputs, kind, body = BODIES[name]
        words = {"real": self.real, "name": f"{self.prefix}_{name}"}
        head = f"FUNCTION {words['name']} : {kind.format(**words)}\nVAR_INPUT\n    {inputs.format(**words)};\nEND_VAR"
        return f"{head}\n{body.format(**words)}\nEND_FUNCTION"

    def literal(self, number: Number) -> str:
        """A constant: a real one always has a point."""
        if number.type == INT:
            return str(number.value)
        return st_number(number.value)

    def index(self, place: Expression) -> str:
        """A place in an array: whole numbers are LINT, places need not be more than DINT."""
        return str(place.value) if isinstance(place, Number) else f"LINT_TO_DINT({self.expression(place)})"

    def call(self, call: Call, arguments: list[str]) -> str:
        """A standard function, a helper or a conversion."""
        inside = ", ".join(arguments)
        if call.function == "real":
            return f"LINT_TO_{self.real}({inside})"
        if call.function == "int":
            return f"DINT_TO_LINT(TRUNC({inside}))"
        if call.function in BODIES:
            if call.function == "choose" and call.type == INT:
                raise InputError("found a choice between integers, which cannot be translated; expected an if")
            return f"{self.prefix}_{call.function}({inside})"
        if call.function not in CALLS:
            raise InputError(f"found {call.function}, which Structured Text does not have; expected {', '.join(CALLS)}")
        return f"{CALLS[call.function]}({inside})"

    def assigned(self, target: str, value: str) -> str:
        """An assignment."""
        return f"{target} := {value};"

    def returned(self, value: str) -> list[str]:
        """The function's name takes the value."""
        return [f"{self.own} := {value};", "RETURN;"]

    def loop(self, step: For) -> list[str]:
        """A loop; its end is the last value, not the one behind it."""
        up = 1 if step.step > 0 else -1
        stop = step.stop
        last = (
            str(int(stop.value) - up)
            if isinstance(stop, Number)
            else f"{self.expression(stop)} {'-' if up > 0 else '+'} 1"
        )
        by = f" BY {step.step}" if step.step != 1 else ""
        head = f"FOR {self.names[step.variable]} := {self.expression(step.start)} TO {last}{by} DO"
        return [head, *self.block(step.body), "END_FOR;"]

    def branch(self, step: If) -> list[str]:
        """A branch with its alternatives."""
        lines = [f"IF {self.expression(step.condition)} THEN", *self.block(step.then)]
        rest: tuple[Statement, ...] = step.otherwise
        while len(rest) == 1 and isinstance(rest[0], If):
            lines += [f"ELSIF {self.expression(rest[0].condition)} THEN", *self.block(rest[0].then)]
            rest = rest[0].otherwise
        return [*lines, *(["ELSE", *self.block(rest)] if rest else []), "END_IF;"]


def st_number(value: float) -> str:
    """A real constant: digits, a point, digits, and an exponent where it is shorter.

    >>> st_number(0.5), st_number(1e-07), st_number(-3.0), st_number(1e22)
    ('0.5', '1.0E-07', '-3.0', '1.0E+22')
    """
    digits, mark, exponent = repr(float(value)).partition("e")
    return (digits if "." in digits else f"{digits}.0") + (f"E{exponent}" if mark else "")


def functions_in_st(program: Program, prefix: str, real: str, sizes: dict[str, int]) -> tuple[list[str], str]:
    """Declarations of the functions of ``program``, helpers first, and the name that its kernel has there."""
    printer = StPrinter(program.functions, prefix, real, sizes)
    helpers = [printer.helper(name) for name in BODIES if name in program.calls]
    return [*helpers, *map(printer.function, program.functions)], printer.functions[program.kernel.name]
