"""A loop in the limit of ever faster sampling: the law without hold or estimator, the plant with every lag it has.

The law is its own kernel, set up for periods far below the axis's and extrapolated to none (Richardson's rule), so any
law has such a limit, a user's own too, and no second formula has to agree with the first. What is left around it are
the lags of the axis: current loop, computation delay, lags and delays among its effects. With ``u = F(s) r + H(s) q``
for the law and ``q = P(s) u`` for the plant the loop is

    -H P                          broken at the plant input
    F P / (1 - (F + H) P)         broken at the position error
    F s P / (1 - (F s + H) P)     broken at the velocity error, where the reference is a velocity

and its poles are the roots of ``1 - H P``, delays included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop import periodic
from emps_design.control.loop.sampled_loop import close
from emps_design.control.loop.transfer import transfer
from emps_design.control.plant.discretisation import SampledPlant, sample_plant
from emps_design.control.plant.linear_plant import LinearPlant
from emps_design.control.plant.peaks import frequencies_around, oscillations
from emps_design.laws.linear import LinearLaw

SHORTER = (1e-3, 5e-4, 2.5e-4)  # of the period, at which the law is set up
WEIGHTS = (1.0 / 3.0, -2.0, 8.0 / 3.0)  # of these three in their limit: errors of h and h^2 cancel
HIGHEST = 30.0  # Nyquist frequencies up to which a response is looked at
STARTS, MOST_DELAY = 16, 100  # samples a period, and samples of delay at most, where poles are first looked for
SLOWEST = 8  # poles that are refined

LawAt = Callable[[float], LinearLaw]  # the linear form of a law at a period [s]


@dataclass(frozen=True)
class ContinuousLoop:
    """The loop of a law, given by its form ``law`` at any period [s], around ``plant`` with a ``delay`` [s] more.

    ``period`` [s] is the axis's own, by which what is fast and slow is judged.
    """

    law: LawAt
    plant: LinearPlant
    delay: float
    period: float

    @classmethod
    def of(cls, law: LawAt, axis: Axis, sampled: SampledPlant) -> ContinuousLoop:
        """The loop of ``law`` on the plant of ``axis``, of which ``sampled`` is the sampled one."""
        sampling = axis.sampling
        late = sampled.linear.delay + sampling.computation_delay * sampling.period
        return cls(law, sampled.linear, late, sampling.period)

    @cached_property
    def _forms(self) -> list[tuple[float, float, LinearLaw]]:
        periods = [share * self.period for share in SHORTER]
        return [(weight, h, self.law(h)) for weight, h in zip(WEIGHTS, periods, strict=True)]

    def by_reference(self, s: np.ndarray) -> np.ndarray:
        """F: command over reference at ``s`` [1/s] of any shape."""
        return self._limit(s, 0)

    def by_position(self, s: np.ndarray) -> np.ndarray:
        """H: command over position at ``s`` [1/s]."""
        return self._limit(s, 1)

    def _limit(self, s: np.ndarray, place: int) -> np.ndarray:
        return np.asarray(sum(weight * _response(form, h, s, place) for weight, h, form in self._forms))

    def position(self, s: np.ndarray) -> np.ndarray:
        """P: encoder's position over command at ``s`` [1/s], delays included."""
        s = np.asarray(s, dtype=complex)
        return transfer(self.plant.A, self.plant.B, self.plant.C, 0.0, s) * np.exp(-s * self.delay)

    def at_plant_input(self, s: np.ndarray) -> np.ndarray:
        """The loop broken at the plant input at ``s`` [1/s]."""
        return -self.by_position(s) * self.position(s)

    def at_position_error(self, s: np.ndarray) -> np.ndarray:
        """The loop broken at the position error at ``s`` [1/s]."""
        ahead, plant = self.by_reference(s), self.position(s)
        return ahead * plant / (1.0 - (ahead + self.by_position(s)) * plant)

    def at_velocity_error(self, s: np.ndarray) -> np.ndarray:
        """The loop of a law that follows a velocity, broken at the velocity error, at ``s`` [1/s]."""
        ahead, plant = self.by_reference(s) * s, self.position(s)
        return ahead * plant / (1.0 - (ahead + self.by_position(s)) * plant)

    def followed(self, s: np.ndarray) -> np.ndarray:
        """Position over reference in the closed loop at ``s`` [1/s]."""
        return self.by_reference(s) * self.position(s) / (1.0 + self.at_plant_input(s))

    def frequencies(self, sampled: SampledPlant) -> np.ndarray:
        """A grid [rad/s] that goes on where that of the plant ``sampled`` ends, as fine where the plant resonates."""
        nyquist = np.pi / self.period
        beyond = np.geomspace(nyquist, HIGHEST * nyquist, 150)
        grid = np.concatenate([sampled.frequencies(), beyond, frequencies_around(oscillations(self.plant.A))])
        return np.unique(grid[(grid > 0.0) & (grid <= HIGHEST * nyquist)])

    @cached_property
    def poles(self) -> np.ndarray:
        """The slowest poles [1/s], slowest first, one of each pair; as exact as the response is."""
        h = max(self.period / STARTS, self.delay / MOST_DELAY)
        plant = sample_plant(replace(self.plant, delay=self.delay), h)
        loop = close(plant, self.law(h))
        found = loop.poles[np.abs(loop.poles) > 1e-6]
        s = np.log(found) / (loop.cycle * h)
        s = s[s.imag >= 0.0]
        slow = [self._refined(one) for one in s[np.argsort(-s.real)][:SLOWEST]]
        return np.array(sorted((one for one in slow if one is not None), key=lambda one: -one.real), dtype=complex)

    def _refined(self, pole: complex) -> complex | None:
        """The root of 1 - H P beside ``pole`` by Newton's rule; None where there is none, as of an estimator's pole."""
        s = complex(pole)
        for _ in range(30):
            step = 1e-6 * max(abs(s), 1e-9 / self.period)
            try:
                here, beside = 1.0 + self.at_plant_input(np.array([s, s + step]))
            except np.linalg.LinAlgError:  # a pole of law or plant alone, which the loop does not have
                return None
            change = here * step / (here - beside) if here != beside else 0.0
            s += change
            if not np.isfinite(s) or abs(s - pole) > 0.5 * abs(pole):
                return None
            if abs(change) <= 1e-8 * abs(s):
                return s
        return None


def _response(form: LinearLaw, period: float, s: np.ndarray, place: int) -> np.ndarray:
    """Command over the input at ``place`` of a law at ``s`` [1/s]; of several rates the mean over a cycle."""
    s = np.asarray(s, dtype=complex)
    one = form.A, form.B[..., place], form.C, form.D[..., place]
    if form.cycle == 1:
        return transfer(*one, np.exp(s * period))
    return periodic.response(*one, -1j * s.ravel() * period).reshape(s.shape)
