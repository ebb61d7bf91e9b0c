"""The continuous velocity loop with every lag: current loop, computation delay, filters, effects, velocity filter.

The closed forms (6) to (9) take one rigid mass behind an ideal drive. Here the same gains act on the whole linear
plant, still in continuous time: of the loop as implemented only the hold and the differences that estimate the
velocity are missing, not a filter behind them. A delay is exact in every response; where the poles say whether the loop
is stable it is its approximant of Pade, order 8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.control.loop.margins import Margins, loop_margins
from emps_design.control.loop.transfer import transfer
from emps_design.control.plant.linear_plant import POSITION, LinearPlant, linear_plant
from emps_design.control.plant.peaks import frequencies_around, oscillations
from emps_design.control.velocity.structure import Structure
from emps_design.laws.estimators import BACKWARD, continuous, estimator_in_words
from emps_design.laws.library.cascade import Filter

if TYPE_CHECKING:
    from emps_design.axis import Axis

PADE = 8
MARGINAL = 1e-9  # share of the largest pole by which one may lie right of the imaginary axis: rounding
TURN = 0.2  # rad, by which a delay may turn the response between two frequencies that are looked at
System = tuple[np.ndarray, np.ndarray, np.ndarray, float]  # A (n, n), b (n,), c (n,), d


@dataclass(frozen=True)
class LaggedVelocityLoop:
    """Given gains in the continuous loop with all lags: ``k_v1`` [V/(m/s)], ``t_v`` [s], ``delay`` [s] of the command.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> found = design.with_lags.velocity_error  # 0.5 ms of current loop
    >>> round(found.phase_margin_deg, 1), round(found.gain_margin, 1)
    (58.7, 17.4)
    """

    plant: LinearPlant
    k_v1: float
    t_v: float
    structure: Structure
    filters: tuple[Filter, ...] = ()
    delay: float = 0.0
    estimator: Any = BACKWARD

    @classmethod
    def of(
        cls, axis: Axis, velocity: float, k_v1: float, t_v: float, structure: Structure, filters: tuple[Filter, ...]
    ) -> LaggedVelocityLoop:
        """The loop on ``axis``, its effects linearised at ``velocity`` [m/s]."""
        plant = linear_plant(axis, velocity)
        late = axis.sampling.computation_delay * axis.sampling.period
        return cls(plant, k_v1, t_v, structure, filters, plant.delay + late, axis.controller.velocity_estimator)

    @property
    def _velocity(self) -> System:
        """From the command to the velocity of the encoder's reading; where the carriage is left out, if it may be."""
        A, B, C = self.plant.A, self.plant.B, self.plant.C
        row, through = C @ A, float(C @ B)
        keep = np.arange(B.size)[POSITION + 1 :] if not np.any(A[:, POSITION]) else np.arange(B.size)
        return A[np.ix_(keep, keep)], B[keep], row[keep], through

    @property
    def _filters(self) -> list[tuple[list[float], list[float]]]:
        """Numerator and denominator in s of the command's filters and of the velocity estimator's."""
        own = continuous(self.estimator)
        return [*map(_polynomials, self.filters), *([own] if len(own[1]) > 1 else [])]

    def plant_response(self, w: np.ndarray) -> np.ndarray:
        """From the command before the filters to the velocity as estimated [(m/s)/V] at ``w`` [rad/s]."""
        s = 1j * np.asarray(w, dtype=float)
        found = transfer(*self._velocity, s) * np.exp(-self.delay * s)
        for numerator, denominator in self._filters:
            found = found * np.polyval(numerator, s) / np.polyval(denominator, s)
        return found

    def plant_input_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the plant input at ``w`` [rad/s]."""
        return self.k_v1 * (1.0 + 1.0 / (1j * np.asarray(w) * self.t_v)) * self.plant_response(w)

    def velocity_error_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the velocity error at ``w`` [rad/s]: T_vo with all lags."""
        if self.structure.form == "pi":
            return self.plant_input_response(w)
        inner = self.k_v1 * self.plant_response(w)
        return inner / (1j * np.asarray(w) * self.t_v) / (1.0 + inner)

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles of the closed loop [rad/s], those of a delay approximated."""
        law: System = (np.zeros((1, 1)), np.ones(1), np.array([self.k_v1 / self.t_v]), self.k_v1)
        chain = self._velocity
        filters = [_companion(*one) for one in self._filters]
        for one in (*([_pade(self.delay)] if self.delay > 0.0 else []), *filters, law):
            chain = _series(one, chain)
        A, b, c, d = chain
        return np.linalg.eigvals(A - np.outer(b, c) / (1.0 + d))

    @property
    def stable(self) -> bool:
        """Whether no pole lies right of the imaginary axis."""
        poles = self.poles
        return bool(poles.real.max() <= MARGINAL * np.abs(poles).max())

    @property
    def velocity_error(self) -> Margins:
        """Margins of the loop broken at the velocity error."""
        return loop_margins(self.velocity_error_response, self._frequencies, self.stable)

    @property
    def plant_input(self) -> Margins:
        """Margins of the loop broken at the plant input."""
        return loop_margins(self.plant_input_response, self._frequencies, self.stable)

    @property
    def _frequencies(self) -> np.ndarray:
        """A grid [rad/s] from far below every motion of the loop to far above, finest where the plant is narrow."""
        A = self._velocity[0]
        sizes = np.abs(self.poles)
        low, high = 1e-3 * sizes[sizes > MARGINAL * sizes.max()].min(), 1e3 * sizes.max()
        peaks = [*oscillations(A), *((2.0 * math.pi * f.frequency, f.damping) for f in self.filters if f.damping)]
        late = np.zeros(0)
        if self.delay > 0.0:
            late = np.arange(TURN / self.delay, 200.0 * TURN / self.delay, TURN / self.delay)
        grid = np.unique(np.concatenate([np.geomspace(low, high, 600), frequencies_around(peaks), late]))
        return grid[(grid >= low) & (grid <= high)]


def left_out(axis: Axis, filters: tuple[Filter, ...] = ()) -> tuple[str, ...]:
    """Name what ``axis`` and the ``filters`` have that the closed forms of mass and viscous friction leave out.

    >>> from emps_design.machines import machine
    >>> left_out(machine("emps2018")), left_out(machine("emps2019"))
    (('the current loop (0.5 ms)',), ())
    """
    found = []
    if axis.drive.current_time_constant:
        found.append(f"the current loop ({1e3 * axis.drive.current_time_constant:.3g} ms)")
    if axis.sampling.computation_delay:
        late = 1e3 * axis.sampling.computation_delay * axis.sampling.period
        found.append(f"the computation delay ({late:.3g} ms)")
    if filters:
        found.append("the filters of the command")
    if len(continuous(axis.controller.velocity_estimator)[1]) > 1:
        found.append(f"the velocity estimate ({estimator_in_words(axis.controller.velocity_estimator)})")
    if axis.effects:
        found.append("the effects of the axis")
    return tuple(found)


def _polynomials(one: Filter) -> tuple[list[float], list[float]]:
    """Numerator and denominator in s, highest power first, of a filter."""
    w = 2.0 * math.pi * one.frequency
    if one.damping is None or one.depth is None:
        return [w], [1.0, w]
    return [1.0, 2.0 * one.depth * one.damping * w, w * w], [1.0, 2.0 * one.damping * w, w * w]


def _pade(delay: float) -> System:
    """The approximant of Pade of a ``delay`` [s]."""
    powers = [1.0]
    for k in range(PADE):
        powers.append(powers[-1] * (PADE - k) / ((2 * PADE - k) * (k + 1)))
    forward = [(-1.0) ** k * value for k, value in enumerate(powers)]
    A, b, c, d = _companion(forward[::-1], powers[::-1])  # in s times the delay
    return A / delay, b / delay, c, d


def _companion(numerator: list[float], denominator: list[float]) -> System:
    """A state space of a proper fraction, highest power first."""
    a = np.array(denominator) / denominator[0]
    n = a.size - 1
    b = np.concatenate([np.zeros(n + 1 - len(numerator)), np.array(numerator) / denominator[0]])
    A = np.eye(n, k=-1)
    A[0] = -a[1:]
    column = np.zeros(n)
    column[0] = 1.0
    return A, column, b[1:] - b[0] * a[1:], float(b[0])


def _series(first: System, then: System) -> System:
    """The system ``then`` behind the system ``first``."""
    A1, b1, c1, d1 = first
    A2, b2, c2, d2 = then
    A = np.block([[A1, np.zeros((b1.size, b2.size))], [np.outer(b2, c1), A2]])
    return A, np.concatenate([b1, b2 * d1]), np.concatenate([d2 * c1, c2]), d1 * d2
