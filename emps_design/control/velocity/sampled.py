"""The velocity loop as implemented: sampled, continuous with all lags, and its step response.

:class:`SampledVelocityLoop` includes hold, delays, current loop, effects and velocity estimator. The closed-loop poles
decide stability; an unstable loop has no margins. For thousands of gains at once the Schur-Cohn test decides stability,
and the margins are arrays.

:func:`step_answer` is the response of a closed loop to a held step, however slow the loop. A held input is a constant
state, so many samples together are one exact matrix product. All of the first samples are returned, then blocks of
consecutive samples with gaps that grow with time.

:class:`LaggedVelocityLoop` is the continuous loop with current loop, computation delay, filters, effects and velocity
filter. The closed forms (6) to (9) assume one rigid mass and an ideal drive; here the same gains act on the whole
linear plant. Compared with the sampled loop, only the hold and the differences of the velocity estimate are missing,
not a filter after them. A delay is exact in every response; for the poles it is a Pade approximant of order 8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, frequencies_around, oscillations
from emps_design.control.linear_plant import POSITION, LinearPlant, linear_plant
from emps_design.control.margins import (
    KEYS,
    LOOP_NAMES,
    LOWEST,
    Margins,
    further_down,
    loop_margins,
    margin_arrays,
    transfer,
)
from emps_design.control.sampled import MARGINAL, OUTPUTS, SampledLoop, close
from emps_design.control.velocity.gains import IP, MINUS_3_DB, PLACES, Structure
from emps_design.laws import TWO_TAP, LawKind, LawTable
from emps_design.laws.estimators import BACKWARD, AnyEstimator, continuous, estimator_in_words
from emps_design.laws.library import cascade, ip_velocity
from emps_design.laws.library.cascade import Filter
from emps_design.laws.linear import LinearLaw, linear_law
from emps_design.messages import Message, grave, note

if TYPE_CHECKING:
    import control


BLOCK = 64  # consecutive samples, at least a cycle
EVERY = 20_000  # number of first samples that are all returned
BLOCKS = 128  # smallest number of blocks, for long cycles

SURE = 1e3  # least distance of the stability test from its limit, in rounding errors

PADE = 8
TURN = 0.2  # rad, largest phase of a delay between two frequencies of the grid
System = tuple[np.ndarray, np.ndarray, np.ndarray, float]  # A (n, n), b (n,), c (n,), d


def step_answer(loop: SampledLoop, by: str, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the response to a unit step of the input ``by`` from rest: samples k (m,), outputs (m, 4), position (m,).

    The position [m] is that at the end of each sample. All ``samples`` up to :data:`EVERY` are returned; later ones
    have gaps. ``loop`` is a single loop.

    >>> A, B, C = np.array([[0.5]]), np.array([[1.0]]), np.ones((4, 1))
    >>> k, outputs, _ = step_answer(SampledLoop(A, B, C, np.zeros((4, 1)), 1e-3, ("reference",)), "reference", 4)
    >>> k.tolist(), outputs[:, 0].tolist()
    ([0, 1, 2, 3], [0.0, 1.0, 1.5, 1.75])
    """
    moves, readout = _step_system(loop, loop.inputs.index(by))
    length = loop.cycle * -(-BLOCK // loop.cycle)
    block, rows = np.eye(moves.shape[-1]), np.empty((length, *readout.shape[1:]))
    for j in range(length):
        rows[j] = readout[j % loop.cycle] @ block
        block = moves[j % loop.cycle] @ block
    starts, states = _blocks(block, -(-samples // length), max(-(-EVERY // length), BLOCKS))
    k = (length * starts[:, None] + np.arange(length)).ravel()
    outputs = np.tensordot(states, rows, axes=(1, 2)).reshape(k.size, -1)
    within = k < samples
    return k[within], outputs[within, :-1], outputs[within, -1]


def _step_system(loop: SampledLoop, place: int) -> tuple[np.ndarray, np.ndarray]:
    """Return by sample of a cycle the state matrix, extended by position and step, and the rows of the outputs."""
    A, B, C, D = loop.samples
    size, mean = A.shape[-1], OUTPUTS.index("mean_velocity")
    readout = np.zeros((loop.cycle, len(OUTPUTS) + 1, size + 2))
    readout[:, :-1, :size], readout[:, :-1, -1] = C, D[..., place]
    readout[:, -1] = loop.period * readout[:, mean]
    readout[:, -1, size] = 1.0
    moves = np.zeros((loop.cycle, size + 2, size + 2))
    moves[:, :size, :size], moves[:, :size, -1], moves[:, -1, -1] = A, B[..., place], 1.0
    moves[:, size] = readout[:, -1]
    return moves, readout


def _blocks(block: np.ndarray, count: int, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the computed blocks of ``count`` (m,), and the states at their beginnings (m, n).

    They are the first ``every`` blocks, then half as many for each doubling of the time.
    """
    state, gap, at, remaining = np.eye(len(block))[-1], 1, 0, every
    starts, states = [], []
    while at < count:
        starts.append(at)
        states.append(state)
        state, at, remaining = block @ state, at + gap, remaining - 1
        if not remaining:
            block, gap, remaining = block @ block, 2 * gap, every // 2
    return np.array(starts), np.array(states)


@dataclass(frozen=True)
class SampledVelocityLoop:
    """The sampled velocity loop with given gains: poles, margins at both places, bandwidth, step response.

    ``k_v1`` [V/(m/s)], ``t_v`` [s]; arrays of them are valid for frequency responses only. The filters are those of
    ``plant``.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> loop = SampledVelocityLoop(plant, 556.766, 8.45505e-3)
    >>> loop.stable, round(loop.margins.gain_margin, 2), round(loop.margins.delay_margin_samples, 2)
    (True, 4.73, 3.39)
    """

    plant: SampledPlant
    k_v1: Any
    t_v: Any
    structure: Structure = IP

    @cached_property
    def loop(self) -> SampledLoop:
        """The closed loop from velocity reference to voltage and velocity."""
        return close(self.plant, velocity_law(self.plant, self.k_v1, self.t_v, self.structure), plant_input=True)

    @property
    def poles(self) -> np.ndarray:
        """Closed-loop poles in the z plane, largest first."""
        return self.loop.poles

    @property
    def stable(self) -> bool:
        """Whether the sampled closed loop is stable, by its poles."""
        return self.loop.stable

    def plant_input_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the plant input at ``w`` [rad/s]."""
        return self.controller_response(w) * self.plant.response(w)

    def delayed_response(self, w: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Open loop at the plant input at ``w`` [rad/s] with an additional ``delay`` [s], arrays of one shape."""
        return self.controller_response(w) * self.plant.delayed_response(w, delay)

    def controller_response(self, w: np.ndarray) -> np.ndarray:
        """From minus the velocity estimate to the voltage at ``w`` [rad/s], before the filters."""
        return self.k_v1 * (1.0 + self.plant.integrator(w) / self.t_v)

    def velocity_error_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the velocity error at ``w`` [rad/s], the sampled T_vo."""
        if self.structure.form == "pi":
            return self.plant_input_response(w)
        inner = self.k_v1 * self.plant.response(w)
        return inner * self.plant.integrator(w) / self.t_v / (1.0 + inner)

    def closed_loop_response(self, w: np.ndarray) -> np.ndarray:
        """From velocity reference to the velocity estimate at ``w`` [rad/s], the sampled T_vc."""
        forward = self.velocity_error_response(w)
        closed = forward / (1.0 + forward)
        if self.structure.reference_filter:
            integral = self.plant.integrator(w) / self.t_v
            closed = closed * integral / (1.0 + integral)
        return closed

    @cached_property
    def margins(self) -> Margins:
        """Margins of the loop broken at the plant input."""
        return loop_margins(
            self.plant_input_response,
            self.plant.frequencies(),
            self.stable,
            self.plant.period,
            self.delayed_response,
        )

    @cached_property
    def velocity_error(self) -> Margins:
        """Margins of the loop broken at the velocity error; for "pi" those at the plant input."""
        if self.structure.form == "pi":
            return self.margins
        return loop_margins(self.velocity_error_response, self.plant.frequencies(), self.stable, self.plant.period)

    def margins_at(self, place: str) -> Margins:
        """Margins of the loop broken at ``place``, "plant-input" or "velocity-error"."""
        return self.margins if place == PLACES[0] else self.velocity_error

    @cached_property
    def bandwidth(self) -> float | None:
        """First frequency [rad/s] at which the velocity estimate has fallen to -3 dB; None if unstable."""
        if not self.stable:
            return None

        grid = self.plant.frequencies()
        if abs(self.closed_loop_response(grid[:1])[0]) < MINUS_3_DB:
            grid = further_down(grid)
        below = np.nonzero(np.abs(self.closed_loop_response(grid)) < MINUS_3_DB)[0]
        if not below.size or below[0] == 0:
            return None
        low, high = float(grid[below[0] - 1]), float(grid[below[0]])
        while high - low > 1e-10 * high:
            middle = 0.5 * (low + high)
            if abs(self.closed_loop_response(np.array(middle))) < MINUS_3_DB:
                high = middle
            else:
                low = middle
        return 0.5 * (low + high)

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Messages on instability, on effects that the linear loop neglects, and on an unbounded gain margin."""
        warnings = []
        if not self.stable:
            text = f"the sampled loop is unstable: largest pole {abs(self.poles[0]):.4g}, outside the unit circle"
            warnings.append(grave("unstable", text, pole=abs(self.poles[0])))
        warnings += self.plant.linear.warnings
        if self.stable and self.margins.gain_margin is None:
            warnings.append(note("gain-margin-unbounded", "the sampled loop's gain margin is unbounded"))
        return tuple(warnings)

    def step_response(self, samples: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time [s], true velocity [m/s] and voltage [V] after a unit step of the reference, without dry friction.

        Samples after the first :data:`~emps_design.control.velocity.sampled.EVERY` have gaps.

        >>> from emps_design.control.discretisation import sample_axis
        >>> from emps_design.machines import machine
        >>> t, v, u = SampledVelocityLoop(sample_axis(machine("emps2018")), 556.766, 8.45505e-3).step_response()
        >>> round(float(v[-1]), 6)
        1.0
        """
        computed = replace(self, structure=self.structure.as_computed) if self.structure.reference_filter else self
        k, outputs, _ = step_answer(computed.loop, "reference", samples)
        return k * self.plant.period, outputs[:, 0], outputs[:, 3]

    def transfer_function(self) -> control.TransferFunction:
        """The open loop at the plant input as a discrete ``control.TransferFunction`` in z."""
        import control

        numerator, denominator = self.plant.polynomials
        T = self.plant.period
        return control.tf(
            self.k_v1 * np.polymul(numerator, [1.0 + T / self.t_v, -1.0]),
            np.polymul(denominator, [1.0, -1.0]),
            T,
            **LOOP_NAMES,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data: margins at the plant input and at the velocity error, bandwidth, and poles."""
        return {
            **self.margins.to_dict(),
            "bandwidth": self.bandwidth,
            "velocity_error": self.velocity_error.to_dict(),
            "poles": [[float(p.real), float(p.imag)] for p in self.poles],
            "period": self.plant.period,
        }


def velocity_law(
    plant: SampledPlant, k_v1: float, t_v: float, structure: Structure = IP, k_e1: float | np.ndarray = 0.0
) -> LinearLaw:
    """Return the linear form of a velocity law with the estimator and the filters of ``plant``.

    ``k_e1`` [(m/s)/N] times the measured force adds to the velocity reference; an array (m,) gives m laws.
    """
    kind, table = velocity_table(k_v1, t_v, structure, plant.filters, plant.estimator)
    law = linear_law(kind.law(table, None, plant.period), plant.period)
    reference, force = law.inputs.index("reference"), law.inputs.index("f_ext")
    A, B, C, D = (np.broadcast_to(x, (*np.shape(k_e1), *x.shape)).copy() for x in (law.A, law.B, law.C, law.D))
    B[..., force] += np.multiply.outer(k_e1, law.B[..., reference])
    D[..., force] += np.multiply.outer(k_e1, law.D[..., reference])
    return replace(law, A=A, B=B, C=C, D=D)


def velocity_table(
    k_v1: float,
    t_v: float,
    structure: Structure = IP,
    filters: tuple[cascade.Filter, ...] = (),
    estimator: AnyEstimator = TWO_TAP,
    in_a_cascade: bool = False,
) -> tuple[LawKind[object], LawTable]:
    """Return the kind of a velocity law and its table: the paper's law for IP without filters, otherwise a cascade.

    ``in_a_cascade`` forces the latter.
    """
    options: dict[str, Any] = {"velocity_estimator": estimator}
    if structure.form == "ip" and not filters and not in_a_cascade:
        return ip_velocity.LAW, ip_velocity.Table(k_v1=k_v1, t_v=t_v, **options)
    loop = cascade.VelocityLoop.model_validate({"kp": k_v1, "ti": t_v, "form": structure.form})
    return cascade.LAW, cascade.Table(velocity=loop, filters=filters, **options)


def sweep_stability(plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray) -> np.ndarray:
    """Return for every pair of gains whether the sampled loop is stable, by the Schur-Cohn test of its polynomial.

    The poles are computed where rounding errors may decide, as in loops much slower than their sampling.
    ``k_v1`` [V/(m/s)], ``t_v`` [s] (n,); returns (n,) of bool, False where the gains are NaN.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> sweep_stability(sample_axis(machine("emps2018")), np.array([556.8, 5568.0]), np.array([8.455e-3, 8.455e-3]))
    array([ True, False])
    """
    numerator, denominator = plant.polynomials
    integrated = plant.period * np.append(numerator, 0.0)  # T z N, over (z - 1) in the law
    proportional, open_loop = np.polymul(numerator, [1.0, -1.0]), np.polymul(denominator, [1.0, -1.0])
    if plant.acting[0] == POSITION and abs(np.sum(numerator)) < 1e-6 * np.sum(np.abs(numerator)):
        # With a force over position the final velocity is zero: the root of N at z = 1 cancels that of the integrator.
        integrated = plant.period * np.append(np.polydiv(numerator, [1.0, -1.0])[0], 0.0)
        proportional, open_loop = numerator, denominator
    k, t = np.asarray(k_v1, dtype=float)[:, None], np.asarray(t_v, dtype=float)[:, None]
    size = open_loop.size
    both = np.zeros((2, size))  # what k_v1 and k_v1/t_v multiply
    both[0, size - proportional.size :] = proportional
    both[1, size - integrated.size :] = integrated
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        a = open_loop + k * both[0] + k / t * both[1]
        stable, doubtful = np.ones(len(a), dtype=bool), np.zeros(len(a), dtype=bool)
        error = np.full(len(a), np.finfo(float).eps)  # each step divides it by the distance from the limit
        for degree in range(size - 1, 0, -1):
            reflection = a[:, degree : degree + 1] / a[:, :1]
            stable &= np.abs(reflection[:, 0]) < 1.0
            apart = np.abs(1.0 - reflection[:, 0] ** 2)
            doubtful |= apart < SURE * error
            error = error / np.minimum(apart, 1.0)
            a = a[:, :degree] - reflection * a[:, degree:0:-1]
            a = a / a[:, :1]
    which = np.flatnonzero(doubtful & np.isfinite(k[:, 0]))
    stable[which] = _stable_by_poles(plant, k[which, 0], t[which, 0])
    return stable


def _stable_by_poles(plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray) -> np.ndarray:
    """Return stability (n,) by eigenvalues, for loops much slower than their sampling.

    The matrix of the loop is affine in k_v1 and k_v1/t_v.
    """
    if not k_v1.size:
        return np.ones(0, dtype=bool)

    def matrix(k: float, integral: float) -> np.ndarray:
        kind, table = velocity_table(k, k / integral, IP, plant.filters, plant.estimator, in_a_cascade=True)
        return close(plant, linear_law(kind.law(table, None, plant.period), plant.period)).A

    k, integral = k_v1[:, None, None], (k_v1 / t_v)[:, None, None]
    k_0, integral_0 = float(k.min()), float(integral.min())
    base = matrix(k_0, integral_0)
    more, more_integral = matrix(2.0 * k_0, integral_0) - base, matrix(k_0, 2.0 * integral_0) - base
    A = base + (k / k_0 - 1.0) * more + (integral / integral_0 - 1.0) * more_integral
    return np.abs(np.linalg.eigvals(A)).max(axis=-1) <= 1.0 + MARGINAL


def sweep_sampled_margins(
    plant: SampledPlant,
    k_v1: np.ndarray,
    t_v: np.ndarray,
    frequencies: int = 100,
    at: str = "plant-input",
    exact_delay: bool = True,
) -> dict[str, np.ndarray]:
    """Return stability and margins of the sampled loop, broken ``at`` that place, for every pair of gains.

    ``k_v1`` [V/(m/s)] and ``t_v`` [s] of one shape. Keys: ``stable`` and those of
    ``emps_design.control.margins.KEYS`` and ``LOWEST``, NaN where the loop is unstable or a margin unbounded.
    ``frequencies`` is the size of the grid that brackets the crossings; ``at`` is "plant-input" or "velocity-error".
    Without ``exact_delay`` the delay margin follows from the phase only: it is exact at whole samples, and so
    sufficient for a comparison with a whole number of samples.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> margins = sweep_sampled_margins(sample_axis(machine("emps2018")), np.array([556.766]), np.array([8.45505e-3]))
    >>> round(float(margins["phase_margin_deg"][0]), 1), bool(margins["stable"][0])
    (39.2, True)
    """
    shape = np.shape(k_v1)
    k, t = np.ravel(np.asarray(k_v1, dtype=float)), np.ravel(np.asarray(t_v, dtype=float))
    stable = sweep_stability(plant, k, t)
    stable_rows = np.flatnonzero(stable)
    grid = plant.frequencies(frequencies)
    margins = {key: np.full(k.size, np.nan) for key in (*KEYS, LOWEST)}
    for start in range(0, stable_rows.size, 2000):  # pieces that fit into the cache
        piece = stable_rows[start : start + 2000]
        for key, values in _margins(plant, k[piece], t[piece], grid, at, exact_delay).items():
            margins[key][piece] = values
    return {"stable": stable.reshape(shape), **{key: values.reshape(shape) for key, values in margins.items()}}


def _margins(
    plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray, grid: np.ndarray, at: str, exact_delay: bool
) -> dict[str, Any]:
    """Margins of stable loops (n,), with an exact delay margin at the plant input if ``exact_delay``."""

    def loops(rows: np.ndarray) -> SampledVelocityLoop:
        return SampledVelocityLoop(plant, k_v1[rows], t_v[rows])

    nyquist = np.pi / plant.period
    if at != "plant-input":
        return margin_arrays(lambda w, rows: loops(rows).velocity_error_response(w), k_v1.size, grid, nyquist)
    return margin_arrays(
        lambda w, rows: loops(rows).plant_input_response(w),
        k_v1.size,
        grid,
        nyquist,
        (lambda w, rows, delay: loops(rows).delayed_response(w, delay)) if exact_delay else None,
    )


@dataclass(frozen=True)
class LaggedVelocityLoop:
    """The continuous velocity loop with all lags: ``k_v1`` [V/(m/s)], ``t_v`` [s], ``delay`` [s] of the command.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> margins = design.with_lags.velocity_error  # 0.5 ms of current loop
    >>> round(margins.phase_margin_deg, 1), round(margins.gain_margin, 1)
    (58.7, 17.4)
    """

    plant: LinearPlant
    k_v1: float
    t_v: float
    structure: Structure
    filters: tuple[Filter, ...] = ()
    delay: float = 0.0
    estimator: AnyEstimator = BACKWARD

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
        """From the command to the derivative of the encoder reading, without a position that nothing depends on."""
        A, B, C = self.plant.A, self.plant.B, self.plant.C
        row, through = C @ A, float(C @ B)
        keep = np.arange(B.size)[POSITION + 1 :] if not np.any(A[:, POSITION]) else np.arange(B.size)
        return A[np.ix_(keep, keep)], B[keep], row[keep], through

    @property
    def _filters(self) -> list[tuple[list[float], list[float]]]:
        """Numerator and denominator in s of the command filters, and of the filter of the velocity estimator."""
        estimator = continuous(self.estimator)
        return [*map(_polynomials, self.filters), *([estimator] if len(estimator[1]) > 1 else [])]

    def plant_response(self, w: np.ndarray) -> np.ndarray:
        """From the command before the filters to the estimated velocity [(m/s)/V] at ``w`` [rad/s]."""
        s = 1j * np.asarray(w, dtype=float)
        response = transfer(*self._velocity, s) * np.exp(-self.delay * s)
        for numerator, denominator in self._filters:
            response = response * np.polyval(numerator, s) / np.polyval(denominator, s)
        return response

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
        """Poles of the closed loop [rad/s], with the Pade approximant of the delay."""
        law: System = (np.zeros((1, 1)), np.ones(1), np.array([self.k_v1 / self.t_v]), self.k_v1)
        chain = self._velocity
        filters = [_companion(*fraction) for fraction in self._filters]
        for system in (*([_pade(self.delay)] if self.delay > 0.0 else []), *filters, law):
            chain = _series(system, chain)
        A, b, c, d = chain
        return np.linalg.eigvals(A - np.outer(b, c) / (1.0 + d))

    @property
    def stable(self) -> bool:
        """Whether no pole lies to the right of the imaginary axis."""
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
        """A frequency grid [rad/s] from far below to far above all poles of the loop, refined at narrow peaks."""
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
    """Return the parts of ``axis`` and ``filters`` that the closed forms of mass and viscous friction neglect.

    >>> from emps_design.machines import machine
    >>> left_out(machine("emps2018")), left_out(machine("emps2019"))
    (('the current loop (0.5 ms)',), ())
    """
    names = []
    if axis.drive.current_time_constant:
        names.append(f"the current loop ({1e3 * axis.drive.current_time_constant:.3g} ms)")
    if axis.sampling.computation_delay:
        late = 1e3 * axis.sampling.computation_delay * axis.sampling.period
        names.append(f"the computation delay ({late:.3g} ms)")
    if filters:
        names.append("the filters of the command")
    if len(continuous(axis.controller.velocity_estimator)[1]) > 1:
        names.append(f"the velocity estimate ({estimator_in_words(axis.controller.velocity_estimator)})")
    if axis.effects:
        names.append("the effects of the axis")
    return tuple(names)


def _polynomials(section: Filter) -> tuple[list[float], list[float]]:
    """Numerator and denominator in s, highest power first, of a filter."""
    w = 2.0 * math.pi * section.frequency
    if section.damping is None or section.depth is None:
        return [w], [1.0, w]
    return [1.0, 2.0 * section.depth * section.damping * w, w * w], [1.0, 2.0 * section.damping * w, w * w]


def _pade(delay: float) -> System:
    """The Pade approximant of a ``delay`` [s]."""
    powers = [1.0]
    for k in range(PADE):
        powers.append(powers[-1] * (PADE - k) / ((2 * PADE - k) * (k + 1)))
    forward = [(-1.0) ** k * value for k, value in enumerate(powers)]
    A, b, c, d = _companion(forward[::-1], powers[::-1])  # in s times the delay
    return A / delay, b / delay, c, d


def _companion(numerator: list[float], denominator: list[float]) -> System:
    """State-space form of a proper rational function, highest power first."""
    a = np.array(denominator) / denominator[0]
    n = a.size - 1
    b = np.concatenate([np.zeros(n + 1 - len(numerator)), np.array(numerator) / denominator[0]])
    A = np.eye(n, k=-1)
    A[0] = -a[1:]
    column = np.zeros(n)
    column[0] = 1.0
    return A, column, b[1:] - b[0] * a[1:], float(b[0])


def _series(first: System, then: System) -> System:
    """The system ``then`` after the system ``first``."""
    A1, b1, c1, d1 = first
    A2, b2, c2, d2 = then
    A = np.block([[A1, np.zeros((b1.size, b2.size))], [np.outer(b2, c1), A2]])
    return A, np.concatenate([b1, b2 * d1]), np.concatenate([d2 * c1, c2]), d1 * d2
