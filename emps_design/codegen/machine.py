"""The virtual machine as C: the axis with its effects, translated from the stepper of the simulations.

:class:`StepperReader` reads the stepper. Besides what :mod:`.reader` reads it has ``while``, ``break``, ``continue``,
booleans in variables, several values at once, arrays that begin inside others, and kernels called by their number.
Constants (``fixed``) are substituted while reading, and branches that they exclude are left out.

:class:`StepperPrinter` prints it as C99: several values are a structure, and one call computes one sample of the loop.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from emps_design.axis import Axis
from emps_design.codegen.languages import HELPERS, TYPES, CPrinter
from emps_design.codegen.program import (
    ARRAY,
    INT,
    REAL,
    TRUTH,
    WHOLES,
    Apply,
    Assign,
    Binary,
    Call,
    Cell,
    Do,
    Expression,
    For,
    Function,
    Item,
    Leave,
    Name,
    Number,
    Program,
    Return,
    Several,
    Statement,
    While,
    names_in,
    safe_names,
)
from emps_design.codegen.reader import LARGEST_POWER, FunctionReader, product, read_into, real, source_tree
from emps_design.errors import InputError
from emps_design.simulation import Plant
from emps_design.simulation.kernels import compile as compiled, hold_loop
from emps_design.simulation.kernels.compile import address
from emps_design.simulation.plant import HOOKS, Inputs

MORE: dict[Any, str] = {np.floor: "floor", np.ceil: "ceil", np.sqrt: "sqrt"}  # in C, but perhaps not on a drive
MORE |= {
    getattr(math, name): name
    for name in ("expm1", "log1p", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "atan2", "hypot", "copysign",
                 "fmod", "log10", "log2", "erf", "erfc")
}  # fmt: skip
BY_NUMBER = {  # functions that call kernels by their number: name, type of the result
    compiled.call_kernel: ("call_kernel", REAL),
    compiled.call_actuator: ("call_actuator", REAL),
    compiled.call_rate: ("call_rate", ""),
}
COMPARED: dict[type, Callable[[Any, Any], bool]] = {ast.Gt: operator.gt, ast.NotEq: operator.ne}
EXPONENT = "exponent_of"  # of a number, as ``math.frexp`` has it

KINDS = {**TYPES, ARRAY: "real *", WHOLES: "long long *", TRUTH: "int", "": "void"}
RING = "RING"  # length of the arrays with one number a sample

POINT = (*[REAL] * 4, *[ARRAY] * 3)  # q, v, t, tau, x, p, b
FORMS = {"kernel": POINT, "actuator": (REAL, ARRAY), "rate": (*POINT, REAL, ARRAY)}  # arguments of compiled hooks
INITIAL = (REAL, ARRAY, ARRAY)
LONGEST = 4096  # samples of delay of the command
ARRAYS = ("y", "gains", "memory", "reference", "push", "noise", "motor_rows", "signals", "floors", "scratch", "out",
          "events")  # fmt: skip
STEPPER_TYPES = {**dict.fromkeys(ARRAYS, ARRAY), "arrays": f"({ARRAY},{WHOLES},{WHOLES},{ARRAY},{ARRAY})", "law": INT,
         "slots": WHOLES, "tally": WHOLES}  # fmt: skip
SAMPLED = {"run": {"reference", "push", "encoder", "position", "velocity", "u", "outside"}, "applied": {"u"}}
HELPER = (
    f"static long long {EXPONENT}(real x)\n{{\n    int found;\n\n    (void)frexp(x, &found);\n    return found;\n}}"
)


def read_stepper(stepper: Dispatcher, types: Mapping[str, str], fixed: Mapping[str, float]) -> Program:
    """Return ``stepper`` with the parts it calls; ``types`` are those of its arguments, by name.

    ``fixed`` are numbers that are known beforehand, by what stands for them, as ``{"law": 0, "push.size": 1}``.
    """
    functions: dict[str, Function] = {}
    calls: set[str] = set()
    function = stepper.py_func
    names = function.__code__.co_varnames[: function.__code__.co_argcount]
    reader = StepperReader(function, source_tree(function), tuple(types[name] for name in names), functions, calls, ())
    reader.fixed = dict(fixed)
    reader.read()
    return Program(tuple(functions.values()), frozenset(calls))


def items(kind: str) -> list[str]:
    """Types of what a type such as ``(real,int)`` holds; none of a single one."""
    return kind[1:-1].split(",") if kind.startswith("(") else []


class StepperReader(FunctionReader):
    """Reads one function of the stepper."""

    def __init__(self, *arguments: Any):
        super().__init__(*arguments)
        self.result = ""
        self.fixed: dict[str, float] = {}
        stores = [node.id for node in ast.walk(self.tree) if isinstance(node, ast.Name) and type(node.ctx) is ast.Store]
        self.once = {name for name in stores if stores.count(name) == 1}

    def read(self) -> None:
        """Read the function into ``functions``, without variables that are known beforehand."""
        super().read()
        function = self.functions[self.tree.name]
        used = names_in(function.body)
        variables = {name: kind for name, kind in function.variables.items() if name in used}
        self.functions[self.tree.name] = Function(
            function.name, function.parameters, variables, function.body, function.result
        )

    def known(self, node: ast.expr) -> Any:
        """The number that ``node`` is known to be beforehand, None where it is not."""
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARED:
            left, right = (
                side.value if isinstance(side, ast.Constant) else self.known(side)
                for side in (node.left, node.comparators[0])
            )
            return None if left is None or right is None else COMPARED[type(node.ops[0])](left, right)
        return self.fixed.get(ast.unparse(node))

    # Statements.

    def statement(self, node: ast.stmt) -> list[Statement]:
        """One statement, which may become several or none."""
        if isinstance(node, ast.Return):
            if node.value is None:
                return [Return(None)]
            value = self.number(node.value)
            self.result = self.common(node, self.result, value.type)
            return [Return(self.converted(node, value, self.result))]
        if isinstance(node, ast.If) and (value := self.known(node.test)) is not None:
            return list(self.block(node.body if value else node.orelse))
        if isinstance(node, ast.While) and not node.orelse:
            return [While(self.condition(node.test), self.block(node.body))]
        if isinstance(node, ast.Break | ast.Continue):
            return [Leave(type(node).__name__.lower())]
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            return [Do(self.number(node.value))]
        return super().statement(node)

    def loop(self, node: ast.For) -> list[Statement]:
        """``for`` over ``range``; none where it is known to be empty."""
        last = node.iter.args[-1] if isinstance(node.iter, ast.Call) and len(node.iter.args) == 1 else None
        return [] if last is not None and self.known(last) == 0 else super().loop(node)

    def assignments(self, targets: list[ast.expr], value: ast.expr) -> list[Statement]:
        """``targets = value``, several at once too."""
        if not isinstance(targets[0], ast.Tuple):
            return self.stored(targets[0], value) if len(targets) == 1 else super().assignments(targets, value)
        wanted = targets[0].elts
        if isinstance(value, ast.Tuple):
            for place, target in enumerate(wanted):
                later = [part for element in value.elts[place + 1 :] for part in ast.walk(element)]
                if any(isinstance(part, ast.expr) and ast.unparse(part) == ast.unparse(target) for part in later):
                    return self.refuse(value, f"{ast.unparse(target)} set and used in one assignment")
            return [statement for pair in zip(wanted, value.elts, strict=True) for statement in self.stored(*pair)]
        whole, before = self.number(value), list[Statement]()
        if not isinstance(whole, Name):
            name = f"several_{len(items(whole.type))}_{sum(map(ord, whole.type))}"
            self.variables[name] = whole.type
            before, whole = [Assign(Name(name, whole.type), whole)], Name(name, whole.type)
        each = zip(wanted, items(whole.type), strict=True)
        return before + [
            self.assign(target, Item(whole, place, kind))
            for place, (target, kind) in enumerate(each)
            if not (isinstance(target, ast.Name) and target.id == "_")
        ]

    def stored(self, target: ast.expr, value: ast.expr) -> list[Statement]:
        """One assignment; a number known beforehand and set once is not a variable."""
        if self.fixed and isinstance(target, ast.Name) and target.id in self.once:
            number = value.value if isinstance(value, ast.Constant) else self.known(value)
            if isinstance(number, int | float):
                self.fixed[target.id] = number
                return []
        return [self.assign(target, self.number(value))]

    def assign(self, node: ast.expr, value: Expression) -> Statement:
        """One assignment of a ``value`` of any type."""
        if isinstance(node, ast.Name):
            known = self.parameters.get(node.id) or self.variables.get(node.id) or ""
            kind = self.common(node, known, value.type)
            if kind in (REAL, INT):
                return super().assign(node, value)
            self.variables[node.id] = kind
            return Assign(Name(node.id, kind), self.converted(node, value, kind))
        target = self.number(node)
        if isinstance(target, Cell) and target.type == INT:
            return Assign(target, value)
        return super().assign(node, value)

    def common(self, node: ast.AST, first: str, second: str) -> str:
        """The common type of both: whole numbers become real."""
        if first in ("", second):
            return second
        if {first, second} == {REAL, INT}:
            return REAL
        if len(items(first)) != len(items(second)) or not items(first):
            return self.refuse(node, f"{second} for {first}", "one type")
        each = [self.common(node, *pair) for pair in zip(items(first), items(second), strict=True)]
        return f"({','.join(each)})"

    def converted(self, node: ast.AST, value: Expression, kind: str) -> Expression:
        """``value`` as one of type ``kind``."""
        if value.type == kind:
            return value
        if kind == REAL and value.type == INT:
            return real(value)
        if not isinstance(value, Several):
            return self.refuse(node, value.type, kind)
        pairs = zip(value.items, items(kind), strict=True)
        return Several(tuple(self.converted(node, *pair) for pair in pairs), kind)

    # Expressions.

    def number(self, node: ast.expr) -> Expression:
        """``node`` as an expression of any type."""
        value = node.value if isinstance(node, ast.Constant) else self.known(node)
        if isinstance(value, bool):
            return Number(int(value), TRUTH)
        if value is not None:
            return self.constant(node, value)
        if isinstance(node, ast.Compare | ast.BoolOp) or (
            isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
        ):
            return self.condition(node)
        if isinstance(node, ast.Tuple):
            each = tuple(map(self.number, node.elts))
            return Several(each, f"({','.join(item.type for item in each)})")
        if isinstance(node, ast.Subscript):
            return self.item(node)
        if isinstance(node, ast.IfExp) and (choice := self.known(node.test)) is not None:
            return self.number(node.body if choice else node.orelse)
        return super().number(node)

    def constant(self, node: ast.expr, value: Any) -> Expression:
        """A constant, which may be infinite."""
        return Number(value, REAL) if value in (math.inf, -math.inf) else super().constant(node, value)

    def item(self, node: ast.Subscript) -> Expression:
        """A number of an array, or one of several things."""
        if isinstance(node.value, ast.Call) and self.value_of(node.value.func) is math.frexp:
            self.calls.add(EXPONENT)
            return Call(EXPONENT, (real(self.number(node.value.args[0])),), INT)
        whole, place = self.number(node.value), self.whole(node.slice)
        if items(whole.type) and isinstance(place, Number):
            return Item(whole, int(place.value), items(whole.type)[int(place.value)])
        if whole.type not in (ARRAY, WHOLES) or not isinstance(whole, Name | Item):
            return self.refuse(node, f"an index of {whole.type}")
        return Cell(whole.name if isinstance(whole, Name) else whole, place, REAL if whole.type == ARRAY else INT)

    def condition(self, node: ast.expr) -> Expression:
        """``node`` as a condition; a number is one where it is not 0."""
        value = node.value if isinstance(node, ast.Constant) else self.known(node)
        if value is not None:
            return Number(int(bool(value)), TRUTH)
        if isinstance(node, ast.Name | ast.Attribute | ast.Subscript | ast.Call):
            number = self.number(node)
            return number if number.type == TRUTH else Binary("!=", number, Number(0, INT), TRUTH)
        if isinstance(node, ast.IfExp):
            return Call("choose", tuple(map(self.condition, (node.test, node.body, node.orelse))), TRUTH)
        return super().condition(node)

    def power(self, node: ast.BinOp, base: Expression, exponent: Expression) -> Expression:
        """``base ** exponent``, of any base."""
        if isinstance(exponent, Number) and exponent.type == INT and 1 <= exponent.value <= LARGEST_POWER:
            return product(real(base), int(exponent.value))
        return super().power(node, base, exponent)

    def call(self, node: ast.Call) -> Expression:
        """A call of a function that kernels may use, or of a compiled part of the stepper."""
        function = self.value_of(node.func)
        if isinstance(function, Dispatcher):
            return self.apply(node, function.py_func, list(map(self.number, node.args)))
        if function is compiled.pointer:
            return self.number(node.args[0])
        if function is compiled.shifted:
            return Binary("+", self.number(node.args[0]), self.whole(node.args[1]), ARRAY)
        if function in BY_NUMBER:
            name, kind = BY_NUMBER[function]
            return Apply(name, tuple(map(self.number, node.args)), kind)
        if function in MORE:
            return Call(MORE[function], tuple(real(self.number(argument)) for argument in node.args), REAL)
        return super().call(node)

    def apply(self, node: ast.Call, function: Callable[..., Any], arguments: list[Expression]) -> Expression:
        """A call of a function of the program, with arguments of any type."""
        name = function.__name__
        if name not in self.functions:
            self.read_function(function, tuple(argument.type for argument in arguments))
        wanted = self.functions[name].parameters.values()
        converted = tuple(
            self.converted(node, argument, kind) for argument, kind in zip(arguments, wanted, strict=True)
        )
        return Apply(name, converted, self.functions[name].result)


@dataclass(frozen=True)
class Opened:
    """A run over samples in parts: its variables as ``fields``, what comes ``before``, and a sample up to and after.

    ``result`` is the type of its result.
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
        """Definitions of the structures in use."""
        definitions = []
        for kind, name in self.structures.items():
            inside = " ".join(f"{self.declared(member, f'f{i}')};" for i, member in enumerate(items(kind)))
            definitions.append(f"typedef struct {{ {inside} }} {name};")
        return definitions

    def declared(self, kind: str, name: str, written: bool = True) -> str:
        """A variable, an argument or a function of one ``kind``."""
        if items(kind):
            self.structures.setdefault(kind, f"several_{len(self.structures) + 1}")
        type_name = self.structures.get(kind) or KINDS[kind]
        return f"{type_name}{'' if type_name.endswith('*') else ' '}{name}"

    def literal(self, number: Number) -> str:
        """A constant, which may be infinite."""
        if math.isinf(number.value):
            return "HUGE_VAL" if number.value > 0 else "-HUGE_VAL"
        return str(number.value) if number.type == TRUTH else super().literal(number)

    def expression(self, node: Expression, outside: int = 0, right: bool = False) -> str:
        """``node`` as text."""
        if isinstance(node, Several):
            return f"({self.declared(node.type, '').strip()}){{{', '.join(map(self.expression, node.items))}}}"
        if isinstance(node, Item):
            return f"{self.expression(node.of)}.f{node.place}"
        if isinstance(node, Cell):
            array = self.names[node.array] if isinstance(node.array, str) else self.expression(node.array)
            place = self.index(node.index)
            return f"{array}[({place}) % {RING}]" if node.array in self.ring else f"{array}[{place}]"
        if isinstance(node, Binary) and node.operator in ("==", "!=") and node.left.type == TRUTH:
            return f"(({self.expression(node.left)}) {node.operator} ({self.expression(node.right)}))"
        return super().expression(node, outside, right)

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


@dataclass(frozen=True)
class Machine:
    """An axis as C.

    ``structures``, ``functions`` and the ``opened`` run; for each form of a hook the names of its ``kernels`` by
    number; ``initial`` function, its type, first state, first parameter and number of states of each effect with
    states; ``numbers`` the initial arrays; ``ring`` the number of samples that are kept.
    """

    structures: list[str]
    functions: list[str]
    stepping: list[str]
    opened: Opened
    kernels: dict[str, list[tuple[int, str]]]
    initial: list[tuple[str, str, int, int, int]]
    numbers: dict[str, list[str]]
    ring: int


def machine_of(axis: Axis, name: str) -> Machine:
    """Translate ``axis`` with its effects; raises :class:`InputError` for a kernel that cannot be translated.

    >>> from emps_design.machines import machine
    >>> machine_of(machine("emps2019"), "emps2019").ring
    3
    """
    plant = Plant.of(axis)
    ready = plant.prepared(Inputs(*plant.numbers(), 1, axis.sampling.period, axis.sampling.encoder_resolution))
    ring = _longest_delay(axis, plant) + 3
    sizes = {"y.size": ready.y.size, "reference.size": ring, "push.size": ring, "noise.size": 0, "slots.size": 0}
    fixed = {"law": 0, **sizes, "motor_rows.shape[0]": 0, "gains.shape[0]": 1}  # command and force drive it, no law
    stepper = read_stepper(hold_loop.run, STEPPER_TYPES, fixed)
    printer = StepperPrinter(stepper.functions, name, SAMPLED)
    stepping, opened = (
        list(map(printer.function, stepper.functions[:-1])),
        printer.opened(stepper.kernel, "k", "encoder"),
    )
    functions, kernels, places, initial, calls = _kernels(plant, name, printer.structures)
    calls |= stepper.calls
    helpers = [HELPERS[helper] for helper in HELPERS if helper in calls] + [HELPER]
    hooks = ready.hooks.tolist()
    hooks[: 3 * int(ready.starts[-1]) : 3] = [places[kernel] for kernel in hooks[: 3 * int(ready.starts[-1]) : 3]]
    numbers = {"baseline": ready.baseline, "parameters": ready.parameters, "settings": ready.settings, "y": ready.y,
               "floors": ready.floors, "hooks": hooks, "starts": ready.starts}  # fmt: skip
    texts = {key: [repr(number) for number in np.asarray(values).tolist()] or ["0"] for key, values in numbers.items()}
    return Machine(
        printer.definitions(), [*helpers, *functions], stepping, opened, kernels, initial,
        {**texts, "scratch": [str(ready.scratch.size)]}, ring,
    )  # fmt: skip


def _longest_delay(axis: Axis, plant: Plant) -> int:
    """Largest delay of the command, in samples."""
    wait = axis.sampling.computation_delay * axis.sampling.period
    for effect, p in zip(plant.effects, plant.parameters, strict=True):
        if effect.delay is not None:
            wait += max(0.0, effect.delay(0.0, 0.0, 0.0, 0.0, np.zeros(0), p, plant.baseline))
    samples = int(wait / axis.sampling.period)
    if samples > LONGEST:
        raise InputError(f"axis {axis.name}: found a dead time of {samples} samples, expected at most {LONGEST}")
    return samples


def _kernels(plant: Plant, name: str, structures: dict[str, str]) -> Any:
    """Functions of the effects' kernels, the kernels by form and number, numbers by address, states at first, calls."""
    functions, forms, places = dict[str, None](), {form: list[tuple[int, str]]() for form in FORMS}, dict[int, int]()
    initial, calls = list[tuple[str, str, int, int, int]](), set[str]()
    for i, effect in enumerate(plant.effects):
        effect_functions: dict[str, Function] = {}
        kernels = [(effect.hook(hook), hook if hook in FORMS else "kernel") for hook in HOOKS]
        hooks = [(kernel, form) for kernel, form in kernels if kernel is not None]
        for kernel, form in hooks:
            read_into(StepperReader, kernel, FORMS[form], effect_functions, calls, ())
        if effect.initial is not None:
            read_into(StepperReader, effect.initial, INITIAL, effect_functions, calls, ())
        printer = StepperPrinter(effect_functions.values(), f"{name}_{effect.name}")
        printer.structures = structures
        functions |= dict.fromkeys(map(printer.function, effect_functions.values()))
        for kernel, form in hooks:
            place = address(kernel, form)
            if place not in places:
                places[place] = len(places) + 1
                forms[form].append((places[place], printer.functions[kernel.__name__]))
        if effect.initial is not None and i not in plant.lagging:
            start = effect.initial.__name__
            kind = effect_functions[start].result
            places_ = plant.states_at[i], plant.parameters_at[i]
            initial.append((printer.functions[start], printer.declared(kind, "").strip(), *places_, len(items(kind))))
    return list(functions), forms, places, initial, calls
