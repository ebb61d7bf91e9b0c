"""The operations of one step of a block, and its test vectors.

Operations of one step are counted in the translated code: the maximum over all paths through it.

Test vectors have inputs, the outputs of double precision, and how far single precision may be from them. Both are
measured: the translated program runs operation by operation in numbers of one type (:class:`Runner`), which records
every condition of a branch or a choice; functions of ``math`` are rounded once, from double precision. The inputs are
numbers of single precision, so that both precisions get the same: at rest, in motion well within the limit, in and out
of the limit, and extremes. Random numbers have a fixed seed.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np

from emps_design.codegen.block import COMPARISONS, INPUTS, Ahead, Block
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
    parts,
)
from emps_design.codegen.reader import MATH
from emps_design.effects.effect import ADDED
from emps_design.simulation.kernels.inverse import SETTLED

KINDS = {"+": "add", "-": "add", "*": "multiply", "/": "divide"}
ORDER = ("multiply", "add", "divide", "compare", "call")
Known = Mapping[str, Any]  # arrays by name, whole numbers by name

Run = Callable[[dict[str, Any]], Any]  # of the values of parameters and variables, by name
OPERATORS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, **COMPARISONS}
SIGNS = {"-": operator.neg, "not": operator.not_}
WHOLE = {"int": int, "min": min, "max": max, "min_int": min, "max_int": max, "modulo": operator.mod}
UNDEFINED = (ArithmeticError, ValueError, IndexError)  # of a number that is not finite, in Python

REST, MOTION, LIMITED, EXTREME = 20, 200, 120, 60  # samples of each part
FORCE_PER_METRE = 1e3  # N of external force for each m of motion in the vectors
PLACES = (0.0, 0.25, -0.5, 0.0)  # m, where each part begins
TRAVEL = 2.0**-3  # m, of an observer, which has no limit
SEED = 19
# The measured functions of ``math`` round to half a unit in the last place, those of a drive to a whole one; and what
# is measured is one sequence of roundings, in which some cancel: two times each.
FACTOR = 4.0
UNIT = 2.0**-23  # in the last place, relative


def operations_of(block: Block) -> dict[str, int]:
    """Operations of one step of ``block``: products, sums and differences, quotients, comparisons, calls of ``math``.

    >>> from emps_design.machines import machine
    >>> operations_of(Block.of(machine("emps2019")))
    {'multiply': 4, 'add': 3, 'divide': 0, 'compare': 4, 'call': 0}
    """
    arrays = {5: block.law.gains.tolist()}
    total = counted(block.program, arrays) + Counter(compare=2)  # the limit
    if block.ahead is not None:
        total += _count_ahead(block.ahead) + Counter(add=2)  # the error, the sum
    return {kind: total[kind] for kind in ORDER}


def counted(program: Program, arrays: Mapping[int, Sequence[float]]) -> Counter[str]:
    """Operations of ``program``; ``arrays`` are the numbers that arguments hold, by their place."""
    functions = {function.name: function for function in program.functions}
    names = list(program.kernel.parameters)
    return _Count(functions).function(program.kernel, {names[place]: numbers for place, numbers in arrays.items()})


def _count_ahead(ahead: Ahead) -> Counter[str]:
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
            holds = None if test is None else _is_true(test, known)
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


def _is_true(test: Any, known: Known) -> bool | None:
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


@dataclass(frozen=True)
class Vectors:
    """Inputs (n,) of a block, its command ``u`` (n,) and its memory ``states`` (n, memory) after each sample."""

    block: Block
    start: np.ndarray
    reference: np.ndarray
    q: np.ndarray
    f_ext: np.ndarray
    motion: tuple[np.ndarray, ...] = ()  # position, velocity, acceleration of the reference, for the feed-forward

    @cached_property
    def outputs(self) -> Any:
        """Command (n,) and memory (n, memory) by the simulation's own machine code."""
        return self.block.run(self.start, self.reference, self.q, self.f_ext, self.motion)

    @property
    def u(self) -> np.ndarray:
        """Command (n,) [command units]."""
        return self.outputs[0]

    @property
    def difference(self) -> np.ndarray:
        """Distance (n,) of single precision from ``u``, measured; inf where a number exceeds its range."""
        return self._measured[0]

    @property
    def decided_otherwise(self) -> np.ndarray:
        """Whether (n,) a comparison has the other result in single precision: a sign, a limit, a switch."""
        return self._measured[1]

    @cached_property
    @np.errstate(all="ignore")
    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        difference, otherwise = np.empty(self.q.size), np.zeros(self.q.size, bool)
        samples = np.column_stack([self.reference, self.q, self.f_ext]).tolist()
        motion = np.column_stack(self.motion).tolist() if self.motion else [()] * self.q.size
        for i, (sample, ahead) in enumerate(zip(samples, motion, strict=True)):
            if self.start[i]:
                double, single = Stepper(self.block, np.float64), Stepper(self.block, np.float32)
            double.step(sample, ahead)
            difference[i] = abs(single.step(sample, ahead) - self.u[i])
            otherwise[i] = single.decisions != double.decisions
        return np.where(np.isfinite(difference), difference, np.inf), otherwise

    @property
    def tolerance(self) -> np.ndarray:
        """Largest distance (n,) from ``u`` that single precision is allowed; inf where :attr:`difference` is.

        ``FACTOR`` times the largest difference between one ``start`` and the next, or times a unit in the last place
        of the largest ``u`` there where that is more: a measured difference may be small by chance.
        """
        finite, first = np.isfinite(self.difference), np.flatnonzero(self.start)
        sizes = np.maximum(np.where(finite, self.difference, 0.0), UNIT * np.abs(self.u))
        largest = np.repeat(np.maximum.reduceat(sizes, first), np.diff([*first, self.q.size]))
        return np.where(finite, FACTOR * largest, np.inf)

    def to_csv(self) -> str:
        """A table with units in its titles; numbers to the last bit. ``start`` is 1 where the block restarts.

        ``single`` is the tolerance of single precision.
        """
        u, states = self.outputs
        titles = ["start", *self.titles, "u", "single", *(f"memory[{i}]" for i in range(states.shape[1]))]
        inputs = [self.reference, self.q, self.f_ext, *self.motion]
        columns = [self.start.astype(float), *inputs, u, self.tolerance, *states.T]
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return "\n".join([",".join(titles), *(",".join(map(_shortest, row)) for row in rows)]) + "\n"

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the inputs."""
        return ("reference", "q", "f_ext", *(INPUTS if self.motion else ()))

    def to_dict(self) -> dict[str, Any]:
        """Inputs and outputs by name, as plain numbers; ``single`` is None where the tolerance is not finite."""
        u, states = self.outputs
        single = [allowed if math.isfinite(allowed) else None for allowed in self.tolerance.tolist()]
        signals = (self.reference, self.q, self.f_ext, *self.motion)
        inputs = {name: signal.tolist() for name, signal in zip(self.titles, signals, strict=True)}
        return {"start": self.start.tolist(), **inputs, "u": u.tolist(), "single": single, "memory": states.tolist()}


def _shortest(number: float) -> str:
    whole = number.is_integer() and 0.0 < abs(number) < 1e15
    return str(int(number)) if whole else "0" if number == 0.0 and math.copysign(1.0, number) > 0.0 else repr(number)


def vectors_of(block: Block) -> Vectors:
    """Vectors for ``block``, the same for the same block."""
    random = np.random.default_rng(SEED)
    amplitude = _within_limit(block, *_motion(random, MOTION))
    parts = [tuple(np.zeros((3, REST))), *(_motion(random, n) for n in (MOTION, LIMITED, EXTREME))]
    sizes = [0.0, amplitude, 30.0 * amplitude, 1e3]
    start = np.concatenate([np.arange(part[0].size) == 0 for part in parts])
    # Each part begins at rest somewhere else: a reference that is a position is there too.
    moved = (float(block.law.follows != "velocity"), 1.0, 0.0)
    signals = [
        np.concatenate(
            [_single(moved[i] * at + size * part[i]) for part, size, at in zip(parts, sizes, PLACES, strict=True)]
        )
        for i in range(3)
    ]
    reference, q, f_ext = signals
    return Vectors(block, start, reference, q, f_ext, _ahead(random, start.size) if block.ahead is not None else ())


def _ahead(random: np.random.Generator, n: int) -> tuple[np.ndarray, ...]:
    """Position, velocity, acceleration (n,) each for the feed-forward, with reversals and rests, slow and fast."""
    q, v, a = (_single(signal) for signal in _motion(random, n))
    slow = np.where(np.arange(n) % 7 < 3, 1e-3, 1.0)
    return q, _single(0.3 * slow * v), _single(a / FORCE_PER_METRE)


def _motion(random: np.random.Generator, n: int) -> tuple[np.ndarray, ...]:
    """Reference, position and external force (n,), smooth and independent, with rests in between; of size 1."""
    t = np.arange(n) / n
    waves = []
    for _ in range(3):
        frequencies, phases = random.uniform(1.0, 9.0, 4), random.uniform(0.0, 2.0 * np.pi, 4)
        wave = sum(np.sin(2.0 * np.pi * f * t + p) - np.sin(p) for f, p in zip(frequencies, phases, strict=True)) / 8.0
        wave = np.asarray(wave)
        stop = n // 2
        wave[stop : stop + n // 10] = wave[stop]
        waves.append(wave)
    waves[2] = waves[2] * FORCE_PER_METRE
    return tuple(waves)


def _within_limit(block: Block, *wave: np.ndarray) -> float:
    """The largest amplitude, by powers of two, with which ``block`` stays within its limit along ``wave``."""
    if block.observes:
        return TRAVEL
    start = np.arange(wave[0].size) == 0
    for power in range(6, -60, -1):
        reference, q, f_ext = (_single(2.0**power * signal) for signal in wave)
        u, _ = replace(block, ahead=None).run(start, reference, q, f_ext)
        if np.abs(u).max() < 0.8 * block.limit:
            return 2.0**power
    return 2.0**-20


def _single(signal: np.ndarray) -> np.ndarray:
    return signal.astype(np.float32).astype(float)
