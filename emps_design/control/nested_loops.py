"""The nested loops of an axis's controller, each with the point where it is broken and its margins there.

The velocity loop is broken at the plant input with the position loop open; the position loop at the position error with
the velocity loop closed, at its own rate, so that it is one sampled loop whatever the rate inside. The last is the
whole loop at the plant input, where a delay or a current loop acts; with different rates it is periodic. Each is one
:class:`NestedLoop`. A design is as good as the worst of them, over a range of loads and a mismatch of the model.

:class:`ContinuousLoop` is a loop in the limit of ever faster sampling: the law without hold or estimator, the plant
with all its lags. The law's own kernel is set up for periods far below the axis's and extrapolated to zero
(Richardson), so every law has this limit, a user's too, without a second formula. What remains are the lags of the
axis: current loop, computation delay, lags and delays among its effects. With ``u = F(s) r + H(s) q`` for the law and
``q = P(s) u`` for the plant the loop is

    -H P                          broken at the plant input
    F P / (1 - (F + H) P)         broken at the position error
    F s P / (1 - (F s + H) P)     broken at the velocity error, where the reference is a velocity

and its poles are the roots of ``1 - H P``, delays included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.advice.advice import (
    SAFE_GAIN_MARGIN as SAFE_GAIN_MARGIN,
    SAFE_PHASE_MARGIN_DEG as SAFE_PHASE_MARGIN_DEG,
    where_in_words as where_in_words,
)
from emps_design.axis import Axis
from emps_design.control import sampled
from emps_design.control.discretisation import (
    SampledPlant,
    frequencies_around,
    law_peaks,
    oscillations,
    peaks_of_roots,
    sample_axis,
    sample_plant,
)
from emps_design.control.linear_plant import LinearPlant
from emps_design.control.margins import Margins, loop_margins
from emps_design.control.sampled import SampledLoop, close, transfer
from emps_design.laws import get_law, law_of, table_of
from emps_design.laws.linear import LinearLaw, linear_law
from emps_design.units import LINEAR, Units

PLANT_INPUT, POSITION_ERROR = "plant input", "position error"
VELOCITY_LOOP, WHOLE = "velocity loop", "whole loop"
_REFERENCE, _POSITION = 0, 1  # places among the inputs of a law

SHORTER = (1e-3, 5e-4, 2.5e-4)  # of the period, at which the law is set up
WEIGHTS = (1.0 / 3.0, -2.0, 8.0 / 3.0)  # of these three in their limit: errors of h and h^2 cancel
HIGHEST = 30.0  # upper end of the frequency grid, in Nyquist frequencies
STARTS, MOST_DELAY = 16, 100  # samples per period and largest delay in samples of the loop that gives initial poles
SLOWEST = 8  # poles that are refined

LawAt = Callable[[float], LinearLaw]  # the linear form of a law at a period [s]


@dataclass(frozen=True)
class NestedLoop:
    """One loop of a controller: its ``name``, where it is ``broken``, and its margins there.

    ``where`` holds the differences of its machine from the axis, see :func:`where_in_words`.
    """

    name: str
    broken: str
    margins: Margins
    where: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: name, place, margins, and the machine if it differs from the axis."""
        where = {"where": dict(self.where)} if self.where else {}
        return {"name": self.name, "broken": self.broken, **where, **self.margins.to_dict()}


def nested_loops(
    axis: Axis, velocity: float = 0.1, delay: float = 0.0, delay_margins: bool = True
) -> tuple[NestedLoop, ...]:
    """Return the loops of the controller of ``axis``, innermost first and the whole last.

    The axis is linearised at ``velocity`` [m/s]; ``delay`` [s] adds to that of the command. A controller with a
    velocity loop alone has one loop. ``delay_margins`` False omits those of loops of different rates, which take
    longest. Raises :class:`~emps_design.errors.AxisError` if the axis has no controller.

    >>> from emps_design.machines import machine
    >>> cascade = {"kind": "cascade", "position": {"kp": 30.0, "every": 2}, "velocity": {"kp": 300.0, "ti": 0.05}}
    >>> for loop in nested_loops(machine("emps2019").replace(controller=cascade)):
    ...     print(loop.name, "broken at the", loop.broken, round(loop.margins.phase_margin_deg))
    velocity loop broken at the plant input 71
    position loop broken at the position error 77
    whole loop broken at the plant input 57
    """
    period, direction = axis.sampling.period, float(np.sign(velocity))
    plant = sample_axis(axis, velocity)
    plant = plant.delayed(delay) if delay else plant
    whole = law_of(axis, period)
    kind = get_law(axis.controller.kind)
    loops = []
    for name, table in kind.loops(table_of(axis)) if kind.loops else ():
        law = kind.law(table, axis, period)
        form = linear_law(law, period, direction)
        if law.follows == "velocity":
            loops.append(NestedLoop(name, PLANT_INPUT, at_plant_input(plant, form)))
        else:
            loops.append(NestedLoop(name, POSITION_ERROR, at_position_error(plant, form)))
    if len(loops) != 1:
        name = VELOCITY_LOOP if not loops and whole.follows == "velocity" else WHOLE
        margins = at_plant_input(plant, linear_law(whole, period, direction), delay_margins)
        loops.append(NestedLoop(name, PLANT_INPUT, margins))
    return tuple(loops)


def at_plant_input(plant: SampledPlant, form: LinearLaw, delay_margins: bool = True) -> Margins:
    """Margins of the loop of ``form`` around ``plant``, broken at the plant input with all inner loops closed.

    ``delay_margins`` False omits the delay margin of a loop of different rates.
    """
    loop = close(plant, form, plant_input=True)
    if form.cycle > 1:
        delayed = (lambda delay: _radius_with(plant.delayed(delay), form)) if delay_margins else None
        return sampled.margins(*loop.opened, plant.period, delayed)

    return loop_margins(
        loop.loop_gain,
        plant.frequencies(peaks=law_peaks(form, plant.period)),
        loop.stable,
        plant.period,
        lambda w, delay: loop.loop_gain(w) * plant.delayed_response(w, delay) / plant.response(w),
    )


def _radius_with(plant: SampledPlant, form: LinearLaw) -> float:
    return float(np.abs(close(plant, form, plant_input=True).poles).max())


def at_position_error(plant: SampledPlant, form: LinearLaw) -> Margins:
    """Margins of the position loop broken at the position error, at its own rate.

    ``form`` must read position and reference only through their difference, except for its velocity estimates.
    """
    A, b, c = position_loop(plant, form)
    period, stable = form.cycle * plant.period, close(plant, form).stable
    inner = [*peaks_of_roots(np.linalg.eigvals(A), period), *law_peaks(form, plant.period)]
    grid = replace(plant, period=period, filters=()).frequencies(peaks=inner)
    return loop_margins(lambda w: transfer(A, b, c, 0.0, np.exp(1j * np.asarray(w) * period)), grid, stable, period)


def position_loop(plant: SampledPlant, form: LinearLaw) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The position loop broken at the position error: ``x[i+1] = A x + b e``, ``q = c x``, one step per law cycle.

    With ``reference + q`` as the reference, the reference is the position error; the law reads it once per cycle.
    """
    B, D = form.B.copy(), form.D.copy()
    B[..., _POSITION] += B[..., _REFERENCE]
    D[..., _POSITION] += D[..., _REFERENCE]
    loop: SampledLoop = close(plant, replace(form, B=B, D=D), keep_position=True)
    row = np.zeros(loop.A.shape[-1])
    row[: plant.C.size] = plant.C
    place = loop.inputs.index("reference")
    if form.cycle == 1:
        return loop.A, loop.B[:, place], row
    A, b, _, _ = sampled.lifted(loop.A, loop.B[..., [place]], loop.C, loop.D[..., [place]])
    return A, b[:, 0], row


def safety(margins: Margins) -> float:
    """Return the lesser of phase margin over 30 deg and gain margin in octaves: from 1 on a loop is safe.

    An unstable loop has minus infinity, one whose margins are both unbounded plus infinity.

    >>> from emps_design.control.margins import Margins
    >>> safety(Margins(stable=True, phase_margin_deg=60.0, gain_margin=2.0)), safety(Margins(stable=False))
    (1.0, -inf)
    """
    if not margins.stable:
        return -math.inf
    phase, gain = margins.phase_margin_deg, margins.gain_margin
    return min(
        math.inf if phase is None else phase / SAFE_PHASE_MARGIN_DEG,
        math.inf if gain is None else math.log(gain) / math.log(SAFE_GAIN_MARGIN),
    )


def worst_loop(loops: Iterable[NestedLoop]) -> NestedLoop:
    """Return the loop with the least :func:`safety` of ``loops``, at least one; of equals the first.

    So an unstable loop comes before any stable one, and of several unstable ones the innermost.

    >>> from emps_design.control.margins import Margins
    >>> from emps_design.control.nested_loops import NestedLoop
    >>> inner = NestedLoop("velocity loop", "plant input", Margins(stable=True, phase_margin_deg=60.0))
    >>> outer = NestedLoop("position loop", "position error", Margins(stable=True, phase_margin_deg=6.4))
    >>> worst_loop([inner, outer]).name
    'position loop'
    """
    return min(loops, key=lambda loop: safety(loop.margins))


def margins_in_words(margins: Margins) -> str:
    """Phase and gain margin of a stable loop.

    >>> from emps_design.control.margins import Margins
    >>> margins_in_words(Margins(stable=True, phase_margin_deg=6.41, gain_margin=1.234))
    '6.4 deg of phase margin and a gain margin of 1.23'
    """
    phase = "unbounded" if margins.phase_margin_deg is None else f"{margins.phase_margin_deg:.1f} deg of"
    gain = "an unbounded gain margin" if margins.gain_margin is None else f"a gain margin of {margins.gain_margin:.3g}"
    return f"{phase} phase margin and {gain}"


def loop_in_words(loop: NestedLoop, units: Units = LINEAR) -> str:
    """Name a loop and its machine, in the units of its axis.

    >>> from emps_design.control.margins import Margins
    >>> from emps_design.control.nested_loops import NestedLoop
    >>> loop_in_words(NestedLoop("whole loop", "plant input", Margins(stable=False), {"inertia": 3.0}))
    'whole loop with 3 times the inertia'
    """
    return " ".join(filter(None, (units.words(loop.name), where_in_words(loop.where, units))))


@dataclass(frozen=True)
class ContinuousLoop:
    """The loop of a law, given as ``law`` at any period [s], around ``plant`` with an additional ``delay`` [s].

    ``period`` [s] is the axis's own and scales the frequency grid.
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
        """Return a frequency grid [rad/s]: that of the plant ``sampled``, extended upwards, fine at resonances."""
        nyquist = np.pi / self.period
        beyond = np.geomspace(nyquist, HIGHEST * nyquist, 150)
        grid = np.concatenate([sampled.frequencies(), beyond, frequencies_around(oscillations(self.plant.A))])
        return np.unique(grid[(grid > 0.0) & (grid <= HIGHEST * nyquist)])

    @cached_property
    def poles(self) -> np.ndarray:
        """The slowest poles [1/s], slowest first, one of each conjugate pair, refined on the response."""
        h = max(self.period / STARTS, self.delay / MOST_DELAY)
        plant = sample_plant(replace(self.plant, delay=self.delay), h)
        loop = close(plant, self.law(h))
        z = loop.poles[np.abs(loop.poles) > 1e-6]
        s = np.log(z) / (loop.cycle * h)
        s = s[s.imag >= 0.0]
        slow = [self._refined(pole) for pole in s[np.argsort(-s.real)][:SLOWEST]]
        return np.array(sorted((pole for pole in slow if pole is not None), key=lambda pole: -pole.real), dtype=complex)

    def _refined(self, pole: complex) -> complex | None:
        """The root of 1 - H P near ``pole`` by Newton's method; None if there is none, as for an estimator's pole."""
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
    """Command over the input at ``place`` of a law at ``s`` [1/s]; with several rates the mean over a cycle."""
    s = np.asarray(s, dtype=complex)
    matrices = form.A, form.B[..., place], form.C, form.D[..., place]
    if form.cycle == 1:
        return transfer(*matrices, np.exp(s * period))
    return sampled.response(*matrices, -1j * s.ravel() * period).reshape(s.shape)
