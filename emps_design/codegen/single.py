"""A block in single precision: how far its answer may be from that of double precision, sample by sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from emps_design.codegen.block import Block
from emps_design.codegen.rounded_kernel import largest, smallest
from emps_design.codegen.rounding import HALF_UNIT, Rounded, Roundings, every_way


class SinglePrecision:
    """``block`` on rounded numbers, begun anew."""

    def __init__(self, block: Block):
        self.block, self.now, self.k = block, Roundings(), 0
        self.gains = [self.now.constant(float(gain)) for gain in block.law.gains]
        self.limit, self.kernel = self.now.constant(block.limit), block.rounded_kernel(self.now)
        self.memory = [self.now.exact(0.0)] * block.law.memory

    def step(self, given: Sequence[float], motion: Sequence[float]) -> tuple[float, bool]:
        """Bound for one sample, inf where there is none, and whether rounding decides a comparison.

        ``given`` is reference, position and force, ``motion`` what is fed forward: position, velocity, acceleration.
        """
        added, several = self.now.exact(0.0), False
        if self.block.ahead is not None:
            added, several = self.block.ahead.rounded(motion, self.now)
        inputs = [self.now.exact(x) for x in given]
        if self.block.law.error_alone:
            inputs[0], inputs[1] = self.now.exact(0.0), inputs[1] - inputs[0]
        (u, *self.memory), more = every_way(partial(self._answer, inputs, added), self.now)
        self.k += 1
        apart = 2.0 * self.block.limit * (1.0 + HALF_UNIT)  # at most, within the limit
        return (math.inf if self.now.open else min(u.bound, apart)), several or more

    def _answer(self, given: Sequence[Rounded], added: Rounded) -> list[Any]:
        """The command and the memory after it."""
        memory = list(self.memory)
        waits = self.block.waits
        before = list(self.memory)
        u = self.kernel(self.k, *given, self.limit, self.gains, memory) + added
        if waits is not None and (u > self.limit or u < -self.limit):
            memory[waits] = before[waits]
        return [largest(smallest(u, self.limit), -self.limit), *memory]
