"""The feed-forward of a block: the effects' own kernels with their numbers in place, and what adds them up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.codegen.printer import names_in
from emps_design.codegen.program import (
    ARRAY,
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
    Statement,
    Unary,
)
from emps_design.codegen.reader import read_program
from emps_design.codegen.rounding import Rounded, Roundings, largest, on_rounded, smallest
from emps_design.compensation.feedforward import FeedForward
from emps_design.errors import InputError
from emps_design.simulation.kernels.inverse import HOOKS, PASSES

KERNEL = (REAL, REAL, REAL, REAL, ARRAY, ARRAY, ARRAY)  # arguments of an effect's kernel
INPUTS = ("ahead_q", "ahead_v", "ahead_a")


@dataclass(frozen=True)
class Part:
    """One kernel of one effect: its term, its hook, the program with its numbers in place."""

    term: str
    hook: str
    program: Program
    kernel: Any
    numbers: np.ndarray


@dataclass(frozen=True)
class Ahead:
    """What is fed forward: the ``parts``, and the numbers of the baseline that count."""

    feedforward: FeedForward
    parts: tuple[Part, ...]
    own: tuple[float, ...]
    reversal: float
    takes_off: bool

    @classmethod
    def of(cls, feedforward: FeedForward, takes_off: bool) -> Ahead:
        """Read the kernels of ``feedforward``; ``takes_off`` says that the law's answer on the reference goes off."""
        chosen, b = [], feedforward.baseline
        for name, one, values in feedforward.effects():
            for hook in HOOKS:
                kernel = getattr(one, hook)
                if kernel is not None:
                    program = _with_numbers(read_program(kernel, KERNEL), values, b)
                    chosen.append(Part(name, hook, program, kernel, values))
        return cls(feedforward, tuple(chosen), tuple(feedforward.own().tolist()), feedforward.reversal, takes_off)

    @property
    def repeats(self) -> bool:
        """Whether a kernel reads the motor force, so that the sum depends on itself."""
        return any(list(part.program.kernel.parameters)[2] in names_in(part.program.kernel.body) for part in self.parts)

    @property
    def passes(self) -> int:
        """How often the sum is computed at most."""
        return PASSES if self.repeats else 1

    def command(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Command (n,) by the machine code of the simulation, for the reference's motion (n,) each."""
        return self.feedforward.command(q, v, a)

    def rounded(self, motion: Sequence[Rounded], now: Roundings) -> Rounded:
        """The same on rounded numbers: position, velocity and acceleration."""
        q, v, a = motion
        b = [now.constant(float(x)) for x in self.feedforward.baseline]
        mass, viscous, coulomb, offset = (now.constant(x) for x in self.own)
        direction: Any = now.exact(0.0)
        if self.reversal > 0.0:
            direction = largest(smallest(v / self.reversal, 1.0), -1.0)
        tau: Any = now.exact(0.0)
        for _ in range(self.passes):
            sums = {hook: now.exact(0.0) for hook in HOOKS}
            for part in self.parts:
                p = [now.constant(float(x)) for x in part.numbers]
                sums[part.hook] = sums[part.hook] + on_rounded(part.kernel)(q, v, now.exact(0.0), tau, [], p, b)
            level = largest(now.exact(0.0), coulomb + sums["dry"])
            total = viscous * v + offset + sums["force"] + ((mass + sums["inertia"]) * a + level * direction)
            settled = abs(total.value - tau.value) < 1e-10 * max(1.0, abs(total.value))
            tau = total
            if settled:
                break
        if self.repeats:
            now.open = True  # single precision settles elsewhere
        if self.feedforward.back_emf:
            tau = tau + now.constant(self.feedforward.back_emf) * v
        return tau / self.feedforward.axis.drive.gain


def _with_numbers(program: Program, p: np.ndarray, b: np.ndarray) -> Program:
    """A kernel of an effect as a function of q, v and tau: its numbers stand in it, and time is 0."""
    if len(program.functions) > 1:
        raise InputError(f"{program.kernel.name}: found a kernel that calls functions, expected math alone")
    kernel = program.kernel
    q, v, t, tau, x, own, baseline = kernel.parameters
    if x in names_in(kernel.body):
        raise InputError(f"{kernel.name}: found a state, which a feed-forward does not have")
    body = tuple(_put(step, {own: p, baseline: b}, t) for step in kernel.body)
    function = Function(kernel.name, {name: REAL for name in (q, v, tau)}, kernel.variables, body)
    return replace(program, functions=(function,))


def _put(one: Any, arrays: Mapping[str, np.ndarray], time: str) -> Any:
    """``one`` with the cells of ``arrays`` as numbers, and ``time`` as 0."""
    if isinstance(one, Cell) and isinstance(one.array, str) and one.array in arrays:
        if not isinstance(one.index, Number):
            raise InputError(f"found {one.array} at a place that is computed, expected a constant one")
        return Number(float(arrays[one.array][int(one.index.value)]), REAL)
    if isinstance(one, Name) and one.name == time:
        return Number(0.0, REAL)
    if isinstance(one, Call | Apply):
        return replace(one, arguments=tuple(_put(each, arrays, time) for each in one.arguments))
    if isinstance(one, Unary):
        return replace(one, operand=_put(one.operand, arrays, time))
    if isinstance(one, Binary):
        return replace(one, left=_put(one.left, arrays, time), right=_put(one.right, arrays, time))
    if isinstance(one, Assign | Return):
        return replace(one, value=_put(one.value, arrays, time))
    if isinstance(one, If):
        return If(
            _put(one.condition, arrays, time), *(_all(block, arrays, time) for block in (one.then, one.otherwise))
        )
    if isinstance(one, For):
        return replace(one, body=_all(one.body, arrays, time))
    return one


def _all(steps: tuple[Statement, ...], arrays: Mapping[str, np.ndarray], time: str) -> tuple[Statement, ...]:
    return tuple(_put(step, arrays, time) for step in steps)
