"""What is exported: a controller with its numbers, run here as the simulation runs it."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.codegen.program import ARRAY, INT, REAL, Program
from emps_design.codegen.reader import read_program
from emps_design.errors import AxisError
from emps_design.laws import Law, LawKind, get_law, law_of

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.codegen.ahead import Ahead

LAW_ARGUMENTS = (INT, REAL, REAL, REAL, REAL, ARRAY, ARRAY)  # of a law's kernel


@dataclass(frozen=True)
class Block:
    """A law with its numbers as a block for a drive: reference, position and force in, command out, every sample."""

    axis: Axis
    kind: LawKind
    law: Law
    program: Program
    ahead: Ahead | None = None

    @classmethod
    def of(cls, axis: Axis, ahead: Ahead | None = None) -> Block:
        """Read the controller of ``axis``; :class:`AxisError` without one, ``InputError`` for no plain arithmetic.

        ``ahead`` is fed forward beside it.

        >>> from emps_design.machines import machine
        >>> Block.of(machine("emps2019")).program.kernel.name
        'position_pd'
        """
        law = law_of(axis, axis.sampling.period)
        gains = np.asarray(law.gains, dtype=float)
        if not np.isfinite(gains).all():
            raise AxisError(f"controller of {axis.name}: found gains that are not finite, expected numbers to export")
        return cls(axis, get_law(axis.controller.kind), law, read_program(law.kernel, LAW_ARGUMENTS), ahead)

    @property
    def limit(self) -> float:
        """The largest command [command units]."""
        return float(self.axis.drive.command_limit)

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
        u, states = self._answers(start, reference, q, f_ext)
        if self.ahead is not None:
            added = self.ahead.command(*motion)
            if self.ahead.takes_off:
                braking, own = self._answers(start, reference, reference, np.zeros(q.size))
                added, states = added - braking, np.hstack([states, own])
            u = u + added
        return np.clip(u, -self.limit, self.limit), states

    def _answers(self, start: np.ndarray, reference: np.ndarray, q: np.ndarray, f_ext: np.ndarray) -> Any:
        """What the law answers (n,), before the drive's limit, and its memory (n, memory)."""
        from emps_design.simulation.kernels.compile import address

        number, numbers = ctypes.c_double, ctypes.POINTER(ctypes.c_double)
        kernel = ctypes.CFUNCTYPE(number, ctypes.c_ssize_t, *[number] * 4, numbers, numbers)(
            address(self.law.kernel, "law")
        )
        gains, memory = np.array(self.law.gains, dtype=float), np.zeros(max(1, self.law.memory))
        gains_at, memory_at = gains.ctypes.data_as(numbers), memory.ctypes.data_as(numbers)
        u, states, k = np.empty(q.size), np.empty((q.size, self.law.memory)), 0
        for i in range(q.size):
            if start[i]:
                k, memory[:] = 0, 0.0
            u[i] = kernel(k, reference[i], q[i], f_ext[i], self.limit, gains_at, memory_at)
            states[i] = memory[: self.law.memory]
            k += 1
        return u, states
