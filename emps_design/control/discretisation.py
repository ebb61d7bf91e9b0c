"""The sampled plant: discretised exactly under a held voltage, with delays and velocity estimator.

The voltage computed at sample k is held over [t_k + delay, t_k+1 + delay), where the delay is ``computation_delay``
samples plus the delays of the axis's effects, fractions of a sample included. The velocity is estimated from the
increments of the encoder's position q by the law's :mod:`~emps_design.laws.estimators`.

A frequency grid must resolve resonances of the plant and notches of the law: a grid that misses a narrow peak gives
wrong margins. A peak is a frequency [rad/s] and a damping ratio, half its relative width. In the z plane it belongs to
a root ``z = exp((-damping w + j w) T)`` close to the unit circle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.linear_plant import POSITION, VELOCITY, LinearPlant, linear_plant
from emps_design.errors import InputError
from emps_design.laws.estimators import TWO_TAP, AnyEstimator, estimator_of, estimator_response, polynomials
from emps_design.laws.library.cascade import Filter, filter_polynomials
from emps_design.laws.linear import LinearLaw

if TYPE_CHECKING:
    import control

Peaks = Sequence[tuple[float, float]]
BROAD = 0.5  # damping ratio above which the grid is not refined
NARROWEST = 1e-6  # damping ratio for the narrowest refinement
BESIDE_CENTRE = 1e-9  # relative distance of a grid point from the centre, where an undamped peak is infinite


def oscillations(A: np.ndarray) -> Peaks:
    """Frequency [rad/s] and damping ratio of the oscillating eigenvalues of ``A`` (n, n), damping below 0.5.

    >>> [(round(w, 6), round(z, 6)) for w, z in oscillations(np.array([[0.0, 1.0], [-25.0, -1.0]]))]
    [(5.0, 0.1)]
    """
    poles = np.linalg.eigvals(A) if A.size else np.zeros(0)
    sizes = [(float(abs(pole)), float(-pole.real / abs(pole))) for pole in poles if pole.imag > 0.0]
    return sorted((w, damping) for w, damping in sizes if damping < BROAD)


def peaks_of_roots(roots: np.ndarray, period: float) -> Peaks:
    """The peaks of poles or zeros (n,) in the z plane, at a ``period`` [s].

    >>> [(round(w, 6), round(z, 6)) for w, z in peaks_of_roots(np.exp(np.array([-0.01 + 0.2j, -0.01 - 0.2j])), 1e-3)]
    [(200.0, 0.05)]
    """
    upper = [complex(z) for z in np.ravel(roots) if z.imag > 0.0]
    sizes = [(float(np.angle(z)), float(abs(np.log(abs(z))))) for z in upper]
    return sorted((angle / period, decay / angle) for angle, decay in sizes if decay < BROAD * angle)


def filter_peaks(filters: Iterable[Filter], period: float) -> Peaks:
    """Peaks of sampled ``filters``, from poles and zeros; the zeros of a notch are narrower by its depth.

    >>> notch = Filter(kind="notch", frequency=50.0, damping=0.1, depth=0.1)
    >>> [(round(w, 1), round(z, 3)) for w, z in filter_peaks([notch], 1e-3)]  # 2/T atan(pi f T) = 311.6 rad/s
    [(310.1, 0.099), (311.6, 0.01)]
    """
    return sorted(
        peak
        for section in filters
        for side in filter_polynomials(section, period)
        for peak in peaks_of_roots(np.roots(side), period)
    )


def law_peaks(law: LinearLaw, period: float) -> Peaks:
    """Peaks of any law from position to command, including its notches; with several rates at the fastest one."""
    A, B, C, D = (x if law.cycle == 1 else x[-1] for x in (law.A, law.B[..., 1], law.C, law.D[..., 1]))
    peaks = [*peaks_of_roots(np.linalg.eigvals(A), period)]
    if D != 0.0:
        peaks += peaks_of_roots(np.linalg.eigvals(A - np.outer(B, C) / D), period)
    return sorted(peaks)


def frequencies_around(peaks: Peaks) -> np.ndarray:
    """Return frequencies [rad/s] at and around the centres of ``peaks``, spaced by the width of each.

    >>> frequencies_around([(10.0, 0.1)]).size
    65
    """
    grid = []
    for w, damping in peaks:
        beside = max(damping, NARROWEST) * w * np.geomspace(0.1, 100.0, 32)
        grid += [w - beside, [w * (1.0 + BESIDE_CENTRE)], w + beside]
    return np.concatenate([np.zeros(0), *grid])


@dataclass(frozen=True)
class SampledPlant:
    """x[k+1] = Phi x[k] + G0 u[k-d] + G1 u[k-d-1] + H f[k]; encoder C x; period T [s]; the velocity ``estimator``.

    ``delay`` is d, whole samples; G1 carries the fraction of a sample; ``f`` is a force on the carriage, held like u.
    ``linear`` is the continuous plant it came from. Arrays may have leading axes, for many plants at once.

    ``filters`` are those at the law's output, see :mod:`emps_design.laws.library.cascade`. Responses and polynomials
    include them, so that gains can be designed for plant and filters; the states do not, since a closed loop takes them
    from the law.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2019"))
    >>> round(abs(complex(plant.response(np.array(1e-3)))) * 203.5034 / 35.15065188, 4)  # slow motion: G_tau / F_v
    1.0
    """

    Phi: np.ndarray
    G0: np.ndarray
    G1: np.ndarray
    H: np.ndarray
    C: np.ndarray
    delay: int
    period: float
    estimator: AnyEstimator
    linear: LinearPlant
    filters: tuple[Filter, ...] = ()

    @cached_property
    def increment(self) -> tuple[np.ndarray, float, float]:
        """Row and feedthroughs of q[k+1] - q[k] = row x[k] + d0 u[k-d] + d1 u[k-d-1]; of a single plant."""
        row = self.C @ (self.Phi - np.eye(self.C.size))
        return row, float(self.C @ self.G0), float(self.C @ self.G1)

    @cached_property
    def integrates(self) -> np.ndarray:
        """Whether nothing depends on the position of the carriage, shape (...)."""
        return np.all(self.Phi[..., :, POSITION] == np.eye(self.Phi.shape[-1])[POSITION], axis=-1)

    @cached_property
    def acting(self) -> np.ndarray:
        """Indices of the states that act on the increments: all, or all but a purely integrating position."""
        return np.arange(1 if self.integrates else 0, self.C.size)

    @cached_property
    def polynomials(self) -> tuple[np.ndarray, np.ndarray]:
        """Numerator and denominator in z, highest power first, of u -> velocity estimate, all delays included."""
        numerator, denominator = self._plant_polynomials
        for section in self.filters:
            b, a = filter_polynomials(section, self.period)
            numerator, denominator = np.polymul(numerator, b), np.polymul(denominator, a)
        return numerator, denominator

    @cached_property
    def _plant_polynomials(self) -> tuple[np.ndarray, np.ndarray]:
        """The :attr:`polynomials` without the filters."""
        row, d0, d1 = self.increment
        Phi = self.Phi[np.ix_(self.acting, self.acting)]
        row, G0, G1 = row[self.acting], self.G0[self.acting], self.G1[self.acting]
        size = self.acting.size
        # Faddeev-LeVerrier: the adjugate of (z I - Phi) without differences of nearly equal polynomials.
        adjugate, powers, newer, older = np.eye(size), [1.0], [d0], [d1]
        for power in range(1, size + 1):
            newer.append(float(row @ adjugate @ G0))
            older.append(float(row @ adjugate @ G1))
            product = Phi @ adjugate
            powers.append(-float(np.trace(product)) / power)
            adjugate = product + powers[-1] * np.eye(size)
        denominator = np.array(powers)
        n0 = np.array(newer) + d0 * np.append(0.0, denominator[1:])
        n1 = np.array(older) + d1 * np.append(0.0, denominator[1:])
        # increment/u = (N0 z + N1) / (D z^(d+2)), and the estimate is (b0 + b1/z + ...) / (1 + a1/z + ...) / T of it.
        increments = np.polyadd(np.append(n0, 0.0), n1)
        b, a = polynomials(self.estimator, self.period)
        numerator = np.trim_zeros(np.polymul(increments, np.array(b) / self.period), "f")
        poles = np.trim_zeros(a, "b")
        late = self.delay + 2 + len(a) - len(poles)
        while late and numerator[-1] == 0.0:
            numerator, late = numerator[:-1], late - 1
        return numerator, np.append(np.polymul(denominator, poles), np.zeros(late))

    def integrator(self, w: np.ndarray) -> np.ndarray:
        """T z / (z - 1) at ``w`` [rad/s], the sampled 1/s of a law [s]."""
        return self.period / (1.0 - np.exp(-1j * np.asarray(w) * self.period))

    def response(self, w: np.ndarray) -> np.ndarray:
        """Frequency response from voltage to velocity estimate [(m/s)/V] at ``w`` [rad/s], below Nyquist."""
        z = np.exp(1j * np.asarray(w) * self.period)
        numerator, denominator = self._plant_polynomials
        return self.filter_response(w) * np.polyval(numerator, z) / np.polyval(denominator, z)

    def filter_response(self, w: np.ndarray) -> np.ndarray:
        """Frequency response of the ``filters`` at ``w`` [rad/s]."""
        return filter_response(self.filters, w, self.period)

    def to_ss(self) -> control.StateSpace:
        """The plant as a discrete ``control.StateSpace`` from voltage and held force to encoder and velocity.

        Delays are included as states of past voltages.
        """
        import control

        n, count = self.C.size, self.delay + int(np.any(self.G1))
        A, B, C = np.zeros((n + count, n + count)), np.zeros((n + count, 2)), np.zeros((2, n + count))
        A[:n, :n], B[:n, 1], C[0, :n], C[1, VELOCITY] = self.Phi, self.H, self.C, 1.0
        for late, column in ((self.delay, self.G0), (self.delay + 1, self.G1)):
            if late == 0:
                B[:n, 0] = column
            elif late <= count:
                A[:n, n + late - 1] = column
        if count:
            B[n, 0] = 1.0
            A[n + 1 :, n:-1] = np.eye(count - 1)
        names = {"inputs": ["voltage", "force"], "outputs": ["encoder", "velocity"], "name": "plant"}
        return control.ss(A, B, C, np.zeros((2, 2)), self.period, **names)

    def to_tf(self) -> control.TransferFunction:
        """The transfer function in z from voltage to the velocity estimate, all delays included."""
        import control

        names = {"inputs": ["voltage"], "outputs": ["velocity_estimate"], "name": "plant"}
        return control.tf(*self._plant_polynomials, self.period, **names)

    def delayed(self, delay: float) -> SampledPlant:
        """Return the plant with an additional ``delay`` [s] of the voltage, not necessarily whole samples."""
        return self.sampling(replace(self.linear, delay=self.linear.delay + delay))

    def sampling(self, linear: LinearPlant) -> SampledPlant:
        """Return the sampled plant of ``linear`` with this one's period, delay, estimator and filters."""
        plant = sample_plant(linear, self.period, self._program_delay, self.estimator)
        return replace(plant, filters=self.filters)

    @property
    def _program_delay(self) -> int:
        """Whole samples of delay in addition to the delay of the continuous plant."""
        return self.delay - int(_whole_and_fraction(self.linear.delay, self.period)[0])

    def delayed_response(self, w: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """:meth:`response` with an additional ``delay`` [s], exact between whole samples: (m,), (m,) -> (m,).

        A delay of whole samples changes the phase only. A fraction of a sample changes the magnitude too, since the
        held voltage then changes between the samples (modified z-transform).
        """
        whole, fraction = _whole_and_fraction(self.linear.delay + np.asarray(delay), self.period)
        newer, older = _inputs_within_period(self.linear, fraction, self.period)
        z = np.exp(1j * np.asarray(w) * self.period)
        row, _, _ = self.increment
        matrices = z[..., None, None] * np.eye(self.acting.size) - self.Phi[np.ix_(self.acting, self.acting)]
        states = np.linalg.solve(matrices, (newer + older / z[..., None])[..., self.acting, None])[..., 0]
        increments = states @ row[self.acting] + newer @ self.C + (older @ self.C) / z
        estimate = estimator_response(self.estimator, w, self.period) / self.period
        return self.filter_response(w) * increments * estimate / z ** (self._program_delay + whole + 1.0)

    def state_response(self, w: np.ndarray) -> np.ndarray:
        """Frequency response from voltage to every state of ``linear`` at ``w`` [rad/s], shape (*w.shape, n_states)."""
        z = np.exp(1j * np.asarray(w) * self.period)[..., None]
        inputs = (self.G0 + self.G1 / z) * z**-self.delay
        matrices = z[..., None] * np.eye(self.C.size) - self.Phi
        return np.linalg.solve(matrices, inputs[..., None])[..., 0]

    def frequencies(self, count: int = 400, peaks: Peaks = ()) -> np.ndarray:
        """Return a frequency grid [rad/s] from 1e-5 of the Nyquist frequency to just below it.

        It is refined at resonances of the plant and of its inner states, at filters, and at additional ``peaks``, such
        as those of a law.
        """
        nyquist = math.pi / self.period
        low = np.geomspace(1e-5 * nyquist, 0.05 * nyquist, count // 2, endpoint=False)
        grid = np.concatenate([low, np.geomspace(0.05 * nyquist, nyquist * (1.0 - 1e-9), count - low.size)])
        inner = self.linear.A[2:, 2:] if self.linear.A.ndim == 2 else np.zeros((0, 0))
        peaks = [*self.resonances, *oscillations(inner), *filter_peaks(self.filters, self.period), *peaks]
        grid = np.concatenate([grid, frequencies_around(peaks)])
        return np.unique(grid[(grid >= 1e-5 * nyquist) & (grid < nyquist)]) if peaks else grid

    @cached_property
    def resonances(self) -> Peaks:
        """Frequency [rad/s] and damping ratio of each lightly damped mode of ``linear``, for a single plant."""
        return oscillations(self.linear.A) if self.linear.A.ndim == 2 else []

    def resonance_beside(self, w: float) -> float | None:
        """Frequency [rad/s] of the resonance nearest to ``w`` [rad/s], None if it is not within :data:`BESIDE`."""
        ratios = [(max(w / resonance, resonance / w), resonance) for resonance, _ in self.resonances]
        ratio, nearest = min(ratios, default=(math.inf, None))
        return nearest if ratio < BESIDE else None


def sample_plant(
    linear: LinearPlant, period: float, delay_samples: int = 0, velocity_estimator: AnyEstimator = TWO_TAP
) -> SampledPlant:
    """Return the exact discretisation of ``linear`` under a held voltage, with ``period`` [s] and ``delay_samples``.

    The delay of ``linear`` adds to that. Raises :class:`InputError` for an unstable plant that grows by more than e^50
    within one period.

    >>> from emps_design.control.linear_plant import linear_plant
    >>> from emps_design.machines import machine
    >>> plant = sample_plant(linear_plant(machine("emps2019")), 1e-3)
    >>> round(float(plant.Phi[1, 1]), 6)  # exp(-F_v T / M)
    0.997863
    """
    growth = float(np.max(np.linalg.eigvals(linear.A).real)) * period if linear.A.ndim == 2 else 0.0
    if growth > 50.0:
        raise InputError(
            f"period: found {period:g} s, in which the unstable plant grows by a factor of e^{growth:.3g}; expected a "
            "shorter period"
        )
    whole, fraction = _whole_and_fraction(linear.delay, period)
    Phi, (now, H) = _zero_order_hold(linear.A, (linear.B, linear.E), period)
    G0, G1 = _inputs_within_period(linear, fraction, period) if fraction else (now, np.zeros_like(now))
    return SampledPlant(
        Phi,
        G0,
        G1,
        H,
        linear.C,
        delay_samples + int(whole),
        period,
        estimator_of(velocity_estimator),
        linear,
    )


def sample_axis(
    axis: Axis, velocity: float = 0.1, filters: tuple[Filter, ...] = (), delay: float = 0.0
) -> SampledPlant:
    """Return the sampled plant of ``axis`` with ``filters`` before it, its effects linearised at ``velocity`` [m/s].

    ``delay`` [s] adds to that of the command.

    >>> from emps_design.machines import machine
    >>> sample_axis(machine("emps2018")).linear.state
    ('position', 'velocity', 'motor_force')
    """
    sampling, linear = axis.sampling, linear_plant(axis, velocity)
    linear = replace(linear, delay=linear.delay + delay)
    estimator = axis.controller.velocity_estimator
    return replace(sample_plant(linear, sampling.period, sampling.computation_delay, estimator), filters=filters)


BESIDE = 1.5  # ratio of frequencies up to which a frequency belongs to a resonance


def filter_response(filters: Iterable[Filter], w: np.ndarray, period: float) -> np.ndarray:
    """Frequency response of sampled ``filters`` in series at ``w`` [rad/s].

    >>> notch = Filter(kind="notch", frequency=50.0, damping=0.5, depth=0.1)
    >>> round(float(abs(filter_response([notch], np.array([314.16]), 1e-4)[0])), 3)
    0.1
    """
    response = np.ones(np.shape(w), dtype=complex)
    if not filters:
        return response
    z = np.exp(1j * np.asarray(w) * period)
    for section in filters:
        b, a = filter_polynomials(section, period)
        response = response * np.polyval(b, z) / np.polyval(a, z)
    return response


def expm(matrices: np.ndarray) -> np.ndarray:
    """Exponential of small square matrices (..., n, n) by a Taylor series, scaled and squared, without importing scipy.

    >>> expm(np.array([[0.0, 2.0], [0.0, 0.0]])).tolist()
    [[1.0, 2.0], [0.0, 1.0]]
    """
    norm = float(np.abs(matrices).sum(axis=-1).max())
    squarings = max(0, math.ceil(math.log2(norm / 0.1))) if norm > 0.0 else 0
    scaled = matrices / 2.0**squarings
    identity = np.eye(matrices.shape[-1])
    total = identity + scaled / 12.0
    for order in range(11, 0, -1):  # Horner
        total = identity + scaled @ total / order
    for _ in range(squarings):
        total = total @ total
    return total


def _whole_and_fraction(delay: Any, period: float) -> tuple[Any, Any]:
    """Whole samples of a ``delay`` [s], and the remainder [s]; rounding errors do not count as a remainder."""
    samples = np.asarray(delay) / period
    whole = np.floor(samples + 1e-9)
    rest = np.where(samples - whole < 1e-9, 0.0, samples - whole) * period
    return whole, rest


def _inputs_within_period(linear: LinearPlant, fraction: Any, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Input vectors of the newer and the older voltage if the newer arrives ``fraction`` [s] into the period."""
    late, (newer,) = _zero_order_hold(linear.A, (linear.B,), period - np.asarray(fraction))
    _, (older,) = _zero_order_hold(linear.A, (linear.B,), fraction)
    return newer, (late @ older[..., None])[..., 0]


def _zero_order_hold(A: np.ndarray, inputs: tuple[np.ndarray, ...], time: Any) -> tuple[np.ndarray, list[np.ndarray]]:
    """exp(A t), and the integral of exp(A s) b over [0, t] for each b of ``inputs``."""
    size, time = A.shape[-1], np.asarray(time)
    shape = np.broadcast_shapes(A.shape[:-2], time.shape)
    augmented = np.zeros((*shape, size + len(inputs), size + len(inputs)))
    augmented[..., :size, :size] = A * time[..., None, None]
    largest = float(np.abs(A).max())
    scales = [float(np.abs(b).max()) / largest or 1.0 for b in inputs]  # a large b would cost more squarings
    for i, (b, scale) in enumerate(zip(inputs, scales, strict=True)):
        augmented[..., :size, size + i] = b / scale * time[..., None]
    exponential = expm(augmented)
    return exponential[..., :size, :size], [exponential[..., :size, size + i] * s for i, s in enumerate(scales)]
