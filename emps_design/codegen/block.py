"""What is exported: a controller with its numbers, run here as the simulation runs it.

The kernels of an axis's effects as functions of position, velocity and motor force, their numbers in place.

The on-line force observer, with what the effects of the axis add, as one more equation that is exported.

The feed-forward of a block: the effects' own kernels with their numbers in place, and what adds them up.
"""

from __future__ import annotations

import ctypes
import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

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
from emps_design.codegen.rounding import Rounded, Roundings, every_way, largest, on_rounded, smallest
from emps_design.compensation.feedforward import FeedForward, names_of_effects, why_not
from emps_design.effects import Effect
from emps_design.effects.effect import ADDED
from emps_design.errors import AxisError, InputError
from emps_design.laws import Law, get_law, law_of
from emps_design.laws.law import LawKind, LawTable, Positive, parameter
from emps_design.observer import external_force
from emps_design.observer.external_force import ForceObserver, with_effects
from emps_design.simulation.kernels.inverse import PASSES, SETTLED

if TYPE_CHECKING:
    from emps_design.axis import Axis

COMPARED: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
KERNEL = (REAL, REAL, REAL, REAL, ARRAY, ARRAY, ARRAY)  # arguments of an effect's kernel

COMMAND = "command"  # what the observer is given in place of a reference

WIDENINGS = 20  # of the bound of a force that depends on itself
INPUTS = ("ahead_q", "ahead_v", "ahead_a")

NO_LIMIT = 1e30  # N, which single precision holds


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


class ObserverTable(LawTable):
    """The observer's only parameter."""

    cutoff: Positive = parameter("corner of the first-order low-pass", "Hz")


def observer_of(axis: Axis, cutoff_hz: float) -> ForceObserver:
    """The observer of ``axis``: what a back-EMF brakes joins the viscous friction."""
    return ForceObserver(axis.replace(mechanics={"viscous": axis.damping}, drive={"back_emf": 0.0}), cutoff_hz)


def observed_parts(axis: Axis) -> tuple[Part, ...]:
    """The kernels of the effects of ``axis``; :class:`InputError` for those that no position and velocity give."""
    named = list(zip(names_of_effects(axis), axis.effects, strict=True))
    reasons = [f"{name}, {reason}" for name, one in named if (reason := why_not(one.effect))]
    if reasons:
        raise InputError(
            f"observer of {axis.name}: found {'; '.join(reasons)}; "
            "take such effects out of the axis file, or observe on the record"
        )
    effects = ((name, one.effect, one.effect.values(one.parameters)) for name, one in named)
    return parts_of(effects, axis.mechanics.array())


def observer_program(parts: Iterable[Part]) -> Program:
    """The observer's equation with the kernels of ``parts`` in it."""
    plain = read_program(external_force.force_observer, LAW_ARGUMENTS)
    functions: list[Function] = []
    calls: dict[str, list[str]] = {f"added_{hook}": [] for hook in ADDED}
    for part in parts:
        own = _renamed(part.program, f"{part.term}_{part.hook}")
        functions += own.functions
        plain = Program(plain.functions, plain.calls | own.calls)
        calls[f"added_{part.hook}"].append(own.kernel.name)
    for function in plain.functions:
        added = calls.get(function.name)
        if added:
            given = tuple(Name(name, REAL) for name in function.parameters)
            total: Expression = Apply(added[0], given)
            for name in added[1:]:
                total = Binary("+", total, Apply(name, given), REAL)
            function = Function(function.name, function.parameters, {}, (Return(total),))
        functions.append(function)
    nothing = {name for name, added in calls.items() if not added}

    def drop(one: Any) -> Any:
        """What is left of a sum with nothing."""
        empty = isinstance(one, Binary) and isinstance(one.right, Apply) and one.right.function in nothing
        return one.left if empty else one

    kept = tuple(rewritten(function, drop) for function in functions if function.name not in nothing)
    return Program(kept, plain.calls)


def _renamed(program: Program, prefix: str) -> Program:
    """``program`` with ``prefix`` before the names of its functions."""

    def rename(one: Any) -> Any:
        if isinstance(one, Apply):
            return replace(one, function=f"{prefix}_{one.function}")
        return replace(one, name=f"{prefix}_{one.name}") if isinstance(one, Function) else one

    return rewritten(program, rename)


def _gains(p: Any, axis: Axis, period: float) -> list[float]:
    return observer_of(axis, p.cutoff).gains


def _equations(p: Any, axis: Axis, period: float) -> tuple[str, ...]:
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


OBSERVER = LawKind(
    name="force_observer",
    label="on-line observer of the external force",
    source="paper, (19)",
    table=ObserverTable,
    kernel=external_force.force_observer,
    gains=_gains,
    memory=4,
    equations=_equations,
    follows=lambda p: COMMAND,
)


@dataclass(frozen=True)
class Ahead:
    """What is fed forward: the ``parts``, and the numbers of the baseline that count."""

    feedforward: FeedForward
    parts: tuple[Part, ...]
    own: tuple[float, ...]
    reversal: float

    @classmethod
    def of(cls, feedforward: FeedForward) -> Ahead:
        """Read the kernels of ``feedforward``."""
        parts = parts_of(feedforward.effects(), feedforward.baseline)
        return cls(feedforward, parts, tuple(feedforward.own().tolist()), feedforward.reversal)

    @property
    def repeats(self) -> bool:
        """Whether a kernel reads the motor force, so that the sum depends on itself."""
        return any(part.reads_the_force for part in self.parts)

    @property
    def passes(self) -> int:
        """How often the sum is computed at most."""
        return PASSES if self.repeats else 1

    def command(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Command (n,) by the machine code of the simulation, for the reference's motion (n,) each."""
        return self.feedforward.command(q, v, a)

    def rounded(self, motion: Sequence[float], now: Roundings) -> tuple[Rounded, bool]:
        """The same in single precision for one sample of the motion, and whether rounding decides a comparison.

        A sum that depends on itself may settle after fewer or more passes there: the bound holds for all of them.
        """
        tau, within, several, stops, settled = 0.0, 0.0, False, list[tuple[float, float]](), False
        for _ in range(self.passes):
            before, just = tau, within
            tau, within, more = self._pass(motion, before, just, now)
            several |= more
            settled = abs(tau - before) < SETTLED
            if settled or abs(tau - before) <= 1.001 * SETTLED + within + just:
                stops.append((tau, within))
            if settled:
                break
        stops.append((tau, within))
        stops += self._later(motion, tau, within, now) if self.repeats and settled else []
        force = now.within(tau, max(abs(one - tau) + bound for one, bound in stops))
        if self.feedforward.back_emf:
            force = force + now.constant(self.feedforward.back_emf) * motion[1]
        return force / self.feedforward.axis.drive.gain, several

    def _later(self, motion: Sequence[float], tau: float, within: float, now: Roundings) -> list[tuple[float, float]]:
        """Where passes after the last of double precision may lead: no further than what a pass leads back into."""
        for _ in range(WIDENINGS):
            within *= 2.0
            then, bound, _ = self._pass(motion, tau, within, now)
            if abs(then - tau) + bound <= within:
                return [(tau, within)]
        now.open = True
        return []

    def _pass(self, motion: Sequence[float], tau: float, within: float, now: Roundings) -> tuple[float, float, bool]:
        """One sum, from a motor force that single precision has ``within`` so much of ``tau``; its value and bound."""
        own = Roundings()
        before, added = own.within(tau, within), rounded_sums(self.parts, own)

        def run() -> list[Rounded]:
            q, v, a = (own.exact(x) for x in motion)
            mass, viscous, coulomb, offset = (own.constant(x) for x in self.own)
            direction: Any = own.exact(0.0)
            if self.reversal > 0.0:
                direction = largest(smallest(v / self.reversal, 1.0), -1.0)
            force, dry, inertia = (added[hook](q, v, before) for hook in ADDED)
            level = largest(own.exact(0.0), coulomb + dry)
            return [viscous * v + offset + force + ((mass + inertia) * a + level * direction)]

        (total,), several = every_way(run, own)
        now.open |= own.open
        return total.value, total.bound, several


@dataclass(frozen=True)
class Block:
    """A law with its numbers as a block for a drive: reference, position and force in, command out, every sample."""

    axis: Axis
    kind: LawKind
    law: Law
    program: Program
    parameters: dict[str, Any]
    ahead: Ahead | None = None
    origin: str = ""  # of the axis
    parts: tuple[Part, ...] = ()  # of an observer: what the effects add

    @classmethod
    def of(cls, axis: Axis, ahead: Ahead | None = None) -> Block:
        """Read the controller of ``axis``; :class:`AxisError` without one, ``InputError`` for no plain arithmetic.

        ``ahead`` is fed forward beside it, and the law is then given its error alone.

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
        kernel, parts = observer_of(axis, cutoff_hz).kernel, observed_parts(axis)
        kind, own = OBSERVER, {"cutoff": cutoff_hz}
        law = replace(kind.law(kind.table(**own), axis, axis.sampling.period), kernel=kernel)
        return cls(axis, kind, law, observer_program(parts), own, parts=parts)

    @property
    def observes(self) -> bool:
        """Whether it is an observer: the command goes in, a force comes out, without a limit."""
        return self.kind is OBSERVER

    @property
    def waits(self) -> int | None:
        """Place in the memory of what waits while the limit acts on the sum of law and feed-forward; None: nothing."""
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

        ``start`` (n,) is True where the block begins anew; ``reference`` (n,) [m or m/s], ``q`` (n,) [m], ``f_ext``
        (n,) [N]; ``motion`` is position, velocity and acceleration (n,) of the reference that is fed forward.
        """
        if self.law.error_alone:
            reference, q = np.zeros(q.size), q - reference
        added = np.zeros(q.size) if self.ahead is None else self.ahead.command(*motion)
        u, states = self._answers(start, reference, q, f_ext, added)
        return np.clip(u, -self.limit, self.limit), states

    def rounded_kernel(self, now: Roundings) -> Any:
        """The kernel on rounded numbers."""
        kernel = on_rounded(self.kind.kernel)
        if not self.parts:
            return kernel
        return with_effects(kernel, {f"added_{hook}": one for hook, one in rounded_sums(self.parts, now).items()})

    def _answers(
        self, start: np.ndarray, reference: np.ndarray, q: np.ndarray, f_ext: np.ndarray, added: np.ndarray
    ) -> Any:
        """What the law answers with what is ``added`` (n,), before the drive's limit, and its memory (n, memory)."""
        kernel, gains, memory = self._python() if self.observes else self._compiled()
        u, states, k, limit = np.empty(q.size), np.empty((q.size, self.law.memory)), 0, self.limit
        signals = zip(start.tolist(), reference.tolist(), q.tolist(), f_ext.tolist(), strict=True)
        for i, (anew, *given) in enumerate(signals):
            if anew:
                k = 0
                for j in range(self.law.memory):
                    memory[j] = 0.0
            integral = None if self.waits is None else memory[self.waits]
            u[i] = kernel(k, *given, limit, gains, memory) + added[i]
            if integral is not None and abs(u[i]) > limit:
                memory[self.waits] = integral
            states[i] = memory[: self.law.memory]
            k += 1
        return u, states

    def _python(self) -> Any:
        """The kernel as it is, its gains and its memory."""
        return self.law.kernel, self.law.gains.tolist(), [0.0] * self.law.memory

    def _compiled(self) -> Any:
        """The kernel in the machine code of the simulation, and where its gains and its memory are."""
        from emps_design.simulation.kernels.compile import address

        number, numbers = ctypes.c_double, ctypes.POINTER(ctypes.c_double)
        kernel = ctypes.CFUNCTYPE(number, ctypes.c_ssize_t, *[number] * 4, numbers, numbers)(
            address(self.law.kernel, "law")
        )
        arrays = (number * max(1, len(self.law.gains)))(*self.law.gains), (number * max(1, self.law.memory))()
        return kernel, *arrays
