"""The exported blocks: a controller or an observer with its parameters, computed here as in the simulation.

The kernels of an axis's effects enter a block as functions of position, velocity and motor force, with their
parameters: in the on-line force observer as terms of its equation, in a controller as its feed-forward.
"""

from __future__ import annotations

import ctypes
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.codegen.program import (
    ARRAY,
    INT,
    LAW_ARGUMENTS,
    REAL,
    TRUTH,
    Apply,
    Binary,
    Cell,
    Expression,
    Function,
    If,
    Name,
    Number,
    Program,
    Return,
    names_in,
    rewritten,
)
from emps_design.codegen.reader import read_program
from emps_design.compensation.feedforward import FeedForward, named_effects, why_not
from emps_design.effects import Effect
from emps_design.effects.effect import ADDED
from emps_design.errors import AxisError, InputError
from emps_design.laws import Law, LawKind, LawTable, Positive, get_law, law_of, parameter
from emps_design.observer import ForceObserver, force_observer
from emps_design.simulation.kernels.compile import address
from emps_design.simulation.kernels.inverse import PASSES

COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
KERNEL = (REAL, REAL, REAL, REAL, ARRAY, ARRAY, ARRAY)  # arguments of an effect's kernel

COMMAND = "command"  # what the observer takes in place of a reference

INPUTS = ("ahead_q", "ahead_v", "ahead_a")

NO_LIMIT = 1e30  # N, which single precision holds


@dataclass(frozen=True)
class Part:
    """One kernel of one effect: its term, its hook, the program with its numbers in place."""

    term: str
    hook: str
    program: Program

    @property
    def reads_the_force(self) -> bool:
        """Whether the kernel depends on the motor force."""
        return list(self.program.kernel.parameters)[2] in names_in(self.program.kernel.body)


def parts_of(effects: Iterable[tuple[str, Effect, np.ndarray]], b: np.ndarray) -> tuple[Part, ...]:
    """Every kernel of ``effects``, each a term, an effect and its parameters; ``b`` is the baseline (4,)."""
    return tuple(
        Part(term, hook, _with_numbers(read_program(kernel, KERNEL), values, b))
        for term, effect, values in effects
        for hook in ADDED
        for kernel in [getattr(effect, hook)]
        if kernel is not None
    )


def _with_numbers(program: Program, p: np.ndarray, b: np.ndarray) -> Program:
    """A kernel of an effect as a function of q, v and tau: its numbers stand in it, and time is 0."""
    if len(program.functions) > 1:
        raise InputError(f"{program.kernel.name}: found a kernel that calls functions, expected math alone")
    kernel = program.kernel
    q, v, t, tau, x, own, baseline = kernel.parameters
    if x in names_in(kernel.body):
        raise InputError(f"{kernel.name}: found a state, expected none: an exported block has no states of effects")
    arrays = {own: p.tolist(), baseline: b.tolist()}
    tables: dict[str, Function] = {}

    def put(node: Any) -> Any:
        if isinstance(node, Name) and node.name == t:
            return Number(0.0, REAL)
        if isinstance(node, Binary) and node.type == INT and isinstance(node.left, Number) and node.operator == "+":
            return Number(node.left.value + node.right.value, INT) if isinstance(node.right, Number) else node
        if isinstance(node, If):
            return _folded_branch(node)
        if not isinstance(node, Cell) or node.array not in arrays:
            return node
        numbers = arrays[str(node.array)]
        if isinstance(node.index, Number):
            return Number(numbers[int(node.index.value)], REAL)
        table = tables.setdefault(str(node.array), _table(f"{node.array}_at", numbers))
        return Apply(table.name, (node.index,))

    body = rewritten(kernel.body, put)
    function = Function(kernel.name, {name: REAL for name in (q, v, tau)}, kernel.variables, body)
    return replace(program, functions=(*tables.values(), function))


def _folded_branch(branch: If) -> Any:
    """The block that runs where ``branch`` compares two numbers; ``branch`` itself elsewhere."""
    test = branch.condition
    if isinstance(test, Binary) and isinstance(test.left, Number) and isinstance(test.right, Number):
        return branch.then if COMPARISONS[test.operator](test.left.value, test.right.value) else branch.otherwise
    return branch


def _table(name: str, numbers: list[float]) -> Function:
    """A function that returns the number at ``place`` of ``numbers``, the last one beyond them."""
    place, rest = Name("place", INT), Return(Number(numbers[-1], REAL))
    cases = [
        If(Binary("==", place, Number(i, INT), TRUTH), (Return(Number(number, REAL)),), ())
        for i, number in enumerate(numbers[:-1])
    ]
    return Function(name, {place.name: INT}, {}, (*cases, rest))


class ObserverTable(LawTable):
    """The observer's only parameter."""

    cutoff: Positive = parameter("corner of the first-order low-pass", "Hz")


def observer_of(axis: Axis, cutoff_hz: float) -> ForceObserver:
    """The observer of ``axis``, with the braking of the back-EMF in the viscous friction."""
    return ForceObserver(axis.replace(mechanics={"viscous": axis.damping}, drive={"back_emf": 0.0}), cutoff_hz)


def observed_parts(axis: Axis) -> tuple[Part, ...]:
    """The kernels of the effects of ``axis``.

    Raises :class:`InputError` for effects whose force is no function of position and velocity."""
    named = named_effects(axis)
    reasons = [f"{name}, {reason}" for name, entry in named if (reason := why_not(entry.effect, axis.units))]
    if reasons:
        raise InputError(
            f"observer of {axis.name}: found {'; '.join(reasons)}; "
            "remove these effects from the axis file, or use observe on a record"
        )
    effects = ((name, entry.effect, entry.effect.values(entry.parameters)) for name, entry in named)
    return parts_of(effects, axis.mechanics.array())


def observer_program(parts: Iterable[Part]) -> Program:
    """The observer's equation with the kernels of ``parts`` in it."""
    plain = read_program(force_observer, LAW_ARGUMENTS)
    functions: list[Function] = []
    calls: dict[str, list[str]] = {f"added_{hook}": [] for hook in ADDED}
    for part in parts:
        own = _with_prefix(part.program, f"{part.term}_{part.hook}")
        functions += own.functions
        plain = Program(plain.functions, plain.calls | own.calls)
        calls[f"added_{part.hook}"].append(own.kernel.name)
    for function in plain.functions:
        added = calls.get(function.name)
        if added:
            arguments = tuple(Name(name, REAL) for name in function.parameters)
            total: Expression = Apply(added[0], arguments)
            for name in added[1:]:
                total = Binary("+", total, Apply(name, arguments), REAL)
            function = Function(function.name, function.parameters, {}, (Return(total),))
        functions.append(function)
    empty_hooks = {name for name, added in calls.items() if not added}

    def drop(node: Any) -> Any:
        """The left term of a sum whose right term is a hook without kernels."""
        drops = isinstance(node, Binary) and isinstance(node.right, Apply) and node.right.function in empty_hooks
        return node.left if drops else node

    kept = tuple(rewritten(function, drop) for function in functions if function.name not in empty_hooks)
    return Program(kept, plain.calls)


def _with_prefix(program: Program, prefix: str) -> Program:
    """``program`` with ``prefix`` before the names of its functions."""

    def rename(node: Any) -> Any:
        if isinstance(node, Apply):
            return replace(node, function=f"{prefix}_{node.function}")
        return replace(node, name=f"{prefix}_{node.name}") if isinstance(node, Function) else node

    return rewritten(program, rename)


def _gains(p: ObserverTable, axis: Axis, period: float) -> list[float]:
    return observer_of(axis, p.cutoff).gains


def _equations(p: ObserverTable, axis: Axis, period: float) -> tuple[str, ...]:
    period, gain, alpha, mass, viscous, coulomb, offset, rest = _gains(p, axis, period)
    terms = {hook: [part.term for part in observed_parts(axis) if part.hook == hook] for hook in ADDED}
    names = dict(zip(ADDED, ("e[k]", "c[k]", "m[k]"), strict=True))
    with_own = {
        hook: (f"({number:.10g} + {names[hook]})" if terms[hook] else f"{number:.10g}")
        for hook, number in zip(ADDED, (offset, coulomb, mass), strict=True)
    }
    level = f"max{with_own['dry'][:-1]}, 0)" if terms["dry"] else with_own["dry"]
    return (
        f"v[k] = (q[k] - q[k-1]) / {period:.10g},  a[k] = (v[k] - v[k-1]) / {period:.10g}",
        f"w[k] = (v[k] + v[k-1]) / 2,  tau[k] = {gain:.10g} * (u[k-1] + u[k-2]) / 2",
        f"s[k] = sign(w[k]), 0 where |w[k]| <= {rest:.10g}",
        *(
            f"{names[hook]} = {what} of {', '.join(terms[hook])} at q[k-1], w[k], tau[k]"
            for hook, what in zip(ADDED, ("force", "dry friction", "mass"), strict=True)
            if terms[hook]
        ),
        f"x[k] = {with_own['inertia']} * a[k] + {viscous:.10g} * w[k] + {level} * s[k] + {with_own['force']} - tau[k]",
        f"f[k] = f[k-1] + {alpha:.10g} * (x[k] - f[k-1])",
    )


OBSERVER: LawKind[Axis] = LawKind(
    name="force_observer",
    label="on-line observer of the external force",
    source="paper, (19)",
    table=ObserverTable,
    kernel=force_observer,
    gains=_gains,
    memory=4,
    equations=_equations,
    follows=lambda p: COMMAND,
)


@dataclass(frozen=True)
class Ahead:
    """A feed-forward: the ``parts`` of its effects, and the numbers of the baseline that it uses."""

    feedforward: FeedForward
    parts: tuple[Part, ...]
    own: tuple[float, ...]
    reversal: float

    @classmethod
    def of(cls, feedforward: FeedForward) -> Ahead:
        """Read the kernels of ``feedforward``."""
        parts = parts_of(feedforward.effects(), feedforward.baseline)
        return cls(feedforward, parts, tuple(feedforward.own_baseline().tolist()), feedforward.reversal)

    @property
    def repeats(self) -> bool:
        """Whether a kernel depends on the motor force, so that the sum depends on itself."""
        return any(part.reads_the_force for part in self.parts)

    @property
    def passes(self) -> int:
        """How often the sum is computed at most."""
        return PASSES if self.repeats else 1

    def command(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Command (n,) by the machine code of the simulation, for the reference's motion (n,) each."""
        return self.feedforward.command(q, v, a)


@dataclass(frozen=True)
class Block:
    """A law with its numbers as a block for a drive: reference, position and force in, command out, every sample."""

    axis: Axis
    kind: LawKind[Axis]
    law: Law
    program: Program
    parameters: dict[str, Any]
    ahead: Ahead | None = None
    origin: str = ""  # of the axis

    @classmethod
    def of(cls, axis: Axis, ahead: Ahead | None = None) -> Block:
        """Read the controller of ``axis``; :class:`AxisError` without one, ``InputError`` for no plain arithmetic.

        ``ahead`` is its feed-forward; the law then runs on its error alone.

        >>> from emps_design.machines import machine
        >>> Block.of(machine("emps2019")).program.kernel.name
        'position_pd'
        """
        law = law_of(axis, axis.sampling.period)
        law = law if ahead is None else law.on_error()
        gains = np.asarray(law.gains, dtype=float)
        if not np.isfinite(gains).all():
            raise AxisError(f"controller of {axis.name}: found gains that are not finite, expected numbers to export")
        kind, table = get_law(axis.controller.kind), axis.controller.parameters
        own = {key: table[key] for key in kind.table.model_fields if key in table}
        return cls(axis, kind, law, read_program(law.kernel, LAW_ARGUMENTS), own, ahead)

    @classmethod
    def observer(cls, axis: Axis, cutoff_hz: float) -> Block:
        """The on-line force observer of ``axis`` with its effects; :class:`InputError` for one it cannot have."""
        kernel, kind, own = observer_of(axis, cutoff_hz).kernel, OBSERVER, {"cutoff": cutoff_hz}
        law = replace(kind.law(kind.table(**own), axis, axis.sampling.period), kernel=kernel)
        return cls(axis, kind, law, observer_program(observed_parts(axis)), own)

    @property
    def observes(self) -> bool:
        """Whether it is an observer: command in, force out, no limit."""
        return self.kind is OBSERVER

    @property
    def output_unit(self) -> str:
        """Unit of the output on the axis: of a command, or of the observed force."""
        return self.axis.units.unit("N" if self.observes else "V")

    @property
    def waits(self) -> int | None:
        """Place in the memory of the integral that is held while the limit acts on law plus feed-forward, or None."""
        return None if self.ahead is None else self.law.integral

    @property
    def limit(self) -> float:
        """The largest output [command units, or N]."""
        return NO_LIMIT if self.observes else float(self.axis.drive.command_limit)

    def run(
        self,
        start: np.ndarray,
        reference: np.ndarray,
        q: np.ndarray,
        f_ext: np.ndarray,
        motion: tuple[np.ndarray, ...] = (),
    ) -> Any:
        """Command (n,) and memory (n, memory) after each sample, by the machine code that simulations run.

        ``start`` (n,) is True where the block restarts; ``reference`` (n,) [m or m/s], ``q`` (n,) [m], ``f_ext``
        (n,) [N]; ``motion`` is position, velocity and acceleration (n,) of the reference that is fed forward.
        """
        if self.law.error_alone:
            reference, q = np.zeros(q.size), q - reference
        added = np.zeros(q.size) if self.ahead is None else self.ahead.command(*motion)
        u, states = self._run_law(start, reference, q, f_ext, added)
        return np.clip(u, -self.limit, self.limit), states

    def _run_law(
        self, start: np.ndarray, reference: np.ndarray, q: np.ndarray, f_ext: np.ndarray, added: np.ndarray
    ) -> Any:
        """Command (n,) of the law plus ``added`` (n,), before the drive's limit, and its memory (n, memory)."""
        if self.observes:
            kernel, gains, memory = self.law.kernel, self.law.gains.tolist(), [0.0] * self.law.memory
        else:
            kernel, gains, memory = self._compiled()
        u, states, k, limit = np.empty(q.size), np.empty((q.size, self.law.memory)), 0, self.limit
        signals = zip(start.tolist(), reference.tolist(), q.tolist(), f_ext.tolist(), strict=True)
        for i, (restart, *inputs) in enumerate(signals):
            if restart:
                k = 0
                for j in range(self.law.memory):
                    memory[j] = 0.0
            waiting = self.waits
            integral = 0.0 if waiting is None else memory[waiting]
            u[i] = kernel(k, *inputs, limit, gains, memory) + added[i]
            if waiting is not None and abs(u[i]) > limit:
                memory[waiting] = integral
            states[i] = memory[: self.law.memory]
            k += 1
        return u, states

    def _compiled(self) -> Any:
        """The kernel in the machine code of the simulation, and C arrays of its gains and its memory."""

        number, numbers = ctypes.c_double, ctypes.POINTER(ctypes.c_double)
        kernel = ctypes.CFUNCTYPE(number, ctypes.c_ssize_t, *[number] * 4, numbers, numbers)(
            address(self.law.kernel, "law")
        )
        arrays = (number * max(1, len(self.law.gains)))(*self.law.gains), (number * max(1, self.law.memory))()
        return kernel, *arrays
