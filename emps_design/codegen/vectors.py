"""Test vectors of a block: inputs, the outputs of double precision, and how far single precision may be from them.

The inputs are numbers of single precision, so that both precisions get the same: at rest, in motion well within the
limit, in and out of the limit, and extremes. Random numbers have a fixed seed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from emps_design.codegen.block import INPUTS, Block
from emps_design.codegen.rounding import HALF_UNIT, Rounded, Roundings, every_way, largest, smallest

REST, MOTION, LIMITED, EXTREME = 20, 200, 120, 60  # samples of each part
FORCE_PER_METRE = 1e3  # N of external force for each m of motion in the vectors
PLACES = (0.0, 0.25, -0.5, 0.0)  # m, where each part begins
TRAVEL = 2.0**-3  # m, of an observer, which has no limit
SEED = 19


class SinglePrecision:
    """A fresh run of ``block`` on rounded numbers."""

    def __init__(self, block: Block):
        self.block, self.now, self.k = block, Roundings(), 0
        self.gains = [self.now.constant(float(gain)) for gain in block.law.gains]
        self.limit, self.kernel = self.now.constant(block.limit), block.rounded_kernel(self.now)
        self.memory = [self.now.exact(0.0)] * block.law.memory

    def step(self, sample: Sequence[float], motion: Sequence[float]) -> tuple[float, bool]:
        """Bound for one sample, inf where there is none, and whether rounding decides a comparison.

        ``sample`` is reference, position and force, ``motion`` position, velocity, acceleration for the feed-forward.
        """
        added, several = self.now.exact(0.0), False
        if self.block.ahead is not None:
            added, several = self.block.ahead.rounded(motion, self.now)
        inputs = [self.now.exact(x) for x in sample]
        if self.block.law.error_alone:
            inputs[0], inputs[1] = self.now.exact(0.0), inputs[1] - inputs[0]
        (u, *self.memory), more = every_way(partial(self._command_and_memory, inputs, added), self.now)
        self.k += 1
        apart = 2.0 * self.block.limit * (1.0 + HALF_UNIT)  # at most, within the limit
        return (math.inf if self.now.open else min(u.bound, apart)), several or more

    def _command_and_memory(self, inputs: Sequence[Rounded], added: Rounded) -> list[Any]:
        """The command and the memory after it."""
        memory = list(self.memory)
        waits = self.block.waits
        before = list(self.memory)
        u = self.kernel(self.k, *inputs, self.limit, self.gains, memory) + added
        if waits is not None and (u > self.limit or u < -self.limit):
            memory[waits] = before[waits]
        return [largest(smallest(u, self.limit), -self.limit), *memory]


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
    def bound(self) -> np.ndarray:
        """Bound (n,) of the distance of single precision from ``u``; inf where nothing bounds it."""
        return self._single[0]

    @property
    def undecided(self) -> np.ndarray:
        """Whether (n,) rounding decides a comparison: ``bound`` holds whichever way it falls."""
        return self._single[1]

    @cached_property
    def _single(self) -> tuple[np.ndarray, np.ndarray]:
        bound, undecided = np.empty(self.q.size), np.zeros(self.q.size, bool)
        inputs = zip(self.reference.tolist(), self.q.tolist(), self.f_ext.tolist(), strict=True)
        motion = zip(*(signal.tolist() for signal in self.motion), strict=True) if self.motion else itertools.repeat(())
        for i, (sample, ahead) in enumerate(zip(inputs, motion, strict=False)):
            if self.start[i]:
                single = SinglePrecision(self.block)
            bound[i], undecided[i] = single.step(sample, ahead)
        return bound, undecided

    def to_csv(self) -> str:
        """A table with units in its titles; numbers to the last bit. ``start`` is 1 where the block restarts.

        ``single`` is the bound of single precision, inf where there is none.
        """
        u, states = self.outputs
        titles = ["start", *self.titles, "u", "single", *(f"memory[{i}]" for i in range(states.shape[1]))]
        inputs = [self.reference, self.q, self.f_ext, *self.motion]
        columns = [self.start.astype(float), *inputs, u, self.bound, *states.T]
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return "\n".join([",".join(titles), *(",".join(map(_shortest, row)) for row in rows)]) + "\n"

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the inputs."""
        return ("reference", "q", "f_ext", *(INPUTS if self.motion else ()))

    def to_dict(self) -> dict[str, Any]:
        """Inputs and outputs by name, as plain numbers; ``single`` is None where nothing bounds it."""
        u, states = self.outputs
        bounds = [bound if math.isfinite(bound) else None for bound in self.bound.tolist()]
        signals = (self.reference, self.q, self.f_ext, *self.motion)
        inputs = {name: signal.tolist() for name, signal in zip(self.titles, signals, strict=True)}
        return {"start": self.start.tolist(), **inputs, "u": u.tolist(), "single": bounds, "memory": states.tolist()}


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
