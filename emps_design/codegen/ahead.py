"""The feed-forward of a block: the effects' own kernels with their numbers in place, and what adds them up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.codegen.effects import Part, parts_of, rounded_sums
from emps_design.codegen.rounded_kernel import largest, smallest
from emps_design.codegen.rounding import Rounded, Roundings, every_way
from emps_design.compensation.feedforward import FeedForward
from emps_design.effects.effect import ADDED
from emps_design.simulation.kernels.inverse import PASSES, SETTLED

WIDENINGS = 20  # of the bound of a force that depends on itself
INPUTS = ("ahead_q", "ahead_v", "ahead_a")


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
