"""What is exported: a controller with its numbers, run here as the simulation runs it."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.codegen.effects import Part, rounded_sums
from emps_design.codegen.observer import OBSERVER, observed_parts, observer_of, observer_program
from emps_design.codegen.program import LAW_ARGUMENTS, Program
from emps_design.codegen.reader import read_program
from emps_design.codegen.rounded_kernel import on_rounded
from emps_design.codegen.rounding import Roundings
from emps_design.errors import AxisError
from emps_design.laws import Law, LawKind, get_law, law_of
from emps_design.observer.block import with_effects

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.codegen.ahead import Ahead

NO_LIMIT = 1e30  # N, which single precision holds


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
