"""The impedance law on a sampled drive, the passivity at the hand, and stability in contact with hands and walls.

Continuous time (current loop ``1/(T_c s + 1)``, both filters first order, velocity and acceleration exact): the
driving-point admittance is a ratio of polynomials N/D. It is positive real if D is Hurwitz and
``Re N(jw) conj(D(jw))``, an even polynomial, is never negative. Its sign changes are the real roots of a polynomial in
w^2, computed as eigenvalues, so no frequency is missed between grid points. The coefficients span twenty powers of ten
and are small differences of large products, so they are rational numbers until the frequency is scaled.

Sampled: for an external force held over each period, the supplied energy is exactly force times position step. So the
sampled loop is passive for such forces if ``Re V(e^{jwT})/tau_e >= 0`` up to the Nyquist frequency, which a sweep
checks.

The law is the linear form of the kernel that runs in the drive. Friction is viscous here (motion in one direction),
since Coulomb friction does not move the poles. While the carriage *sticks*, its acceleration is zero, and the recursion
in the law's current remains, with gain kappa (r - 1); it has its own poles.

Impedance and its error are those of the sampled loop at the hand. The relay of the Coulomb compensation is analysed by
its describing function.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.polynomial import polynomial as poly

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis, sample_plant
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.linear_plant import FREE, Environment, attached, felt, rigid_plant
from emps_design.control.margins import bisect
from emps_design.control.sampled import MARGINAL, SampledLoop, close, sorted_poles
from emps_design.laws import Law
from emps_design.laws.estimators import estimator_response
from emps_design.laws.library.impedance import COULOMB_POSITIVE, gains_of, law_with
from emps_design.laws.linear import linear_law, own_poles
from emps_design.stretches import stretches

Bands = tuple[tuple[float, float], ...]

CLOSE = 1.001  # ratio of two walls, or of two apparent masses, at which a search ends


@dataclass(frozen=True)
class Clock:
    """Sampling and drive: period [s], time constant of the current loop [s], delay [samples]."""

    period: float
    current_time_constant: float = 0.0
    delay: int = 0

    @classmethod
    def of(cls, axis: Axis) -> Clock:
        """Sampling and drive of ``axis``."""
        return cls(axis.sampling.period, axis.drive.current_time_constant, axis.sampling.computation_delay)


def sampled_loop(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, direction: int = 1, environment: Environment = FREE
) -> SampledLoop:
    """Close the sampled loop of ``law`` on ``plant`` for motion to + or - (``direction``), free or in contact.

    Arrays of one shape in ``law`` or ``environment`` give many loops. Voltages are forces: G_tau is 1. The input
    ``coulomb`` is the level of the Coulomb compensation [N].

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> sampled_loop(law, law.estimate, Clock.of(axis)).stable
    True
    >>> sampled_loop(replace(law, mass=np.array([1.0, 50.0])), law.estimate, Clock.of(axis)).stable.tolist()
    [False, True]
    """
    viscous = plant.viscous[0 if direction > 0 else 1]
    rigid = attached(rigid_plant(plant.mass, viscous, 1.0, clock.current_time_constant), environment)
    form = linear_law(_smooth(law, clock, direction), clock.period, signals={COULOMB_POSITIVE: "coulomb"})
    sensor = felt(rigid, environment) if law.force_sensor else None
    return close(sample_plant(rigid, clock.period, clock.delay, law.velocity_estimator), form, sensor)


def extended_loop(axis: Axis, law: ImpedanceLaw, velocity: float = 0.1) -> SampledLoop:
    """Close the sampled loop of ``law`` on ``axis``, its effects linearised in steady motion at ``velocity`` [m/s].

    The current model of the law neglects the effects, so lag, delay or gain of an actuator change the poles. Arrays in
    ``law`` give many loops.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> coupling = {"kind": "flexible_coupling", "frequency": 50.0, "damping": 0.05, "share": 0.2}
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> extended_loop(axis, law).stable, extended_loop(axis.replace(effects=[coupling]), law).stable
    (True, False)
    """
    clock, direction = Clock.of(axis), 1 if velocity > 0.0 else -1
    form = linear_law(_smooth(law, clock, direction, axis.drive.gain), clock.period, float(direction))
    return close(sample_axis(axis, velocity), form)


def recursion_poles(law: ImpedanceLaw, clock: Clock) -> np.ndarray:
    """Poles of the recursion in the law's current while the carriage sticks, largest first; 0: no recursion."""
    poles = own_poles(_smooth(law, clock), clock.period)
    return sorted_poles(poles) if poles.size else np.zeros(1, dtype=complex)


def _smooth(law: ImpedanceLaw, clock: Clock, direction: int = 1, force_gain: float = 1.0) -> Law:
    """``law`` as a controller with the viscous friction of one ``direction`` in both, and no Coulomb friction."""
    viscous = law.estimate.viscous[0 if direction > 0 else 1]
    smooth = replace(law, estimate=FrictionModel(law.estimate.mass, viscous, viscous, 0.0, 0.0))
    return law_with(gains_of(smooth, clock.period, force_gain, clock.current_time_constant, clock.delay), clock.delay)


def impedance_error(loops: SampledLoop, law: ImpedanceLaw, band: float = 20.0, points: int = 40) -> np.ndarray:
    """Rms relative error of the apparent impedance of the closed ``loops`` over (0, ``band``] rad/s, shape (m,).

    The target is ``M_a s + B + K/s`` of their ``law``, at the middles of ``points`` equal spans; 0.1 means 10 %.
    """
    omega = (np.arange(points) + 0.5) * band / points
    s = 1j * omega
    mass, damping, stiffness = (
        np.atleast_1d(np.asarray(value, dtype=float))[:, None] for value in (law.mass, law.damping, law.stiffness)
    )
    target = mass * s + damping + stiffness / s
    achieved = 1.0 / np.atleast_2d(loops.admittance(omega))
    return np.sqrt(np.mean(np.abs(achieved / target - 1.0) ** 2, axis=1))


def relay_oscillations(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, wall: float = 0.0
) -> list[tuple[float, float] | None]:
    """Predict the oscillation that the Coulomb compensation can sustain: (frequency [rad/s], speed amplitude [m/s]).

    The list has one entry per law: ``law`` may hold arrays (m,), as returned by :meth:`.ImpedanceLaw.with_errors`.

    The law applies ``r c Fh_c sign(v_k)`` at once, but subtracts the effect of its current through the filter: after a
    reversal it overcompensates for a while. By the describing function of the two relays, in plant and law, a sinusoid
    of amplitude ``A`` sustains itself if

        (4/pi) (-F_c Y_e(jw) + r c Fh_c Y_c(jw) e^{j angle(v_k/v)}) = A > 0

    with Y_e, Y_c the mean velocity per force at the hand and per force added to that of the law, both against a
    ``wall`` [N/m] if it is not 0. The search covers 0.5 rad/s to a quarter of the Nyquist frequency (half of it against
    a wall); the largest oscillation is returned, None if there is none. This is an approximation: simulated speeds are
    up to twice as large, and frequencies two to six times lower, since the carriage stays near rest for a while;
    sticking may end the oscillation. The condition is necessary for a limit cycle of this kind, not sufficient.
    """
    omega = np.geomspace(0.5, (0.5 if wall else 0.25) * np.pi / clock.period, 600)
    back = np.exp(-1j * omega * clock.period)
    # Phase of the estimated velocity relative to the mean over the following period.
    turn = estimator_response(law.velocity_estimator, omega, clock.period) * back
    balances = []
    for direction in plant.directions:
        i = 0 if direction > 0 else 1
        loops = sampled_loop(law, plant, clock, direction, Environment(stiffness=wall))
        level = np.asarray(law.coulomb_factor * law.estimate.coulomb[i])[..., None]
        helping = level * loops.response(omega, by="coulomb")
        balance = (4.0 / np.pi) * (helping * turn / np.abs(turn) - plant.coulomb[i] * loops.response(omega))
        balances.append(np.atleast_2d(balance))
    return [_largest_oscillation(lane, omega) for lane in np.stack(balances, axis=1)]


def _largest_oscillation(balances: np.ndarray, omega: np.ndarray) -> tuple[float, float] | None:
    """Frequency [rad/s] and amplitude [m/s] where one of the ``balances`` (d, w) is real and largest, above zero."""
    oscillations = []
    for balance in balances:
        real, imag = balance.real, balance.imag
        for k in np.flatnonzero(imag[:-1] * imag[1:] < 0.0):
            share = imag[k] / (imag[k] - imag[k + 1])
            amplitude = real[k] + share * (real[k + 1] - real[k])
            if amplitude > 0.0:
                oscillations.append((float(amplitude), float(omega[k] + share * (omega[k + 1] - omega[k]))))
    if not oscillations:
        return None
    amplitude, frequency = max(oscillations)
    return frequency, amplitude


@dataclass(frozen=True)
class Passivity:
    """Frequency bands [rad/s] in which the axis supplies energy to the hand (``Re Y < 0``), continuous and sampled.

    ``passive`` means a stable loop and no such band; in :meth:`to_dict` an unbounded upper end is None.
    """

    continuous_stable: bool
    continuous_bands: Bands
    sampled_stable: bool
    sampled_bands: Bands

    @property
    def continuous(self) -> bool:
        """Whether the continuous law is passive."""
        return self.continuous_stable and not self.continuous_bands

    @property
    def sampled(self) -> bool:
        """Whether the sampled law is passive for forces held over a period."""
        return self.sampled_stable and not self.sampled_bands

    def to_dict(self) -> dict[str, Any]:
        """Verdicts and active bands [rad/s]."""

        def bands(intervals: Bands) -> list[list[float | None]]:
            return [[low, high if math.isfinite(high) else None] for low, high in intervals]

        return {
            "continuous": {"passive": self.continuous, "active_bands": bands(self.continuous_bands)},
            "sampled": {"passive": self.sampled, "active_bands": bands(self.sampled_bands)},
        }


def admittance_polynomials(
    law: ImpedanceLaw, plant: FrictionModel, current_time_constant: float, direction: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of velocity over external force, continuous law, ascending powers of s.

    They are rational numbers, so that terms that cancel algebraically are exactly zero.
    """
    i = 0 if direction > 0 else 1
    mass_hat, damping, unity = Fraction(law.estimate.mass), Fraction(law.damping), Fraction(1)
    r, f_hat = mass_hat / Fraction(law.mass), Fraction(law.estimate.viscous[i])
    lag = np.array([unity, Fraction(current_time_constant)])
    mechanics = np.array([Fraction(plant.viscous[i]), Fraction(plant.mass)])
    pull, s = r * Fraction(law.stiffness), np.array([Fraction(0), unity])
    if law.force_sensor:  # lag tau = (r-1) tau_e + (Fh - r B) v - r K v/s
        command = poly.polysub(s * (f_hat - r * damping), [pull])
        numerator = poly.polymul(s, poly.polyadd(lag, [r - 1]))
        denominator = poly.polysub(poly.polymul(poly.polymul(s, mechanics), lag), command)
    else:
        low_a, low_t = (np.array([unity, 1 / Fraction(w)] if math.isfinite(w) else [unity]) for w in law.filters)
        # lag low_a low_t tau = v [(r-1) Mh s low_t + (r (Fh - B) - r K/s) low_a low_t] - kappa (r-1) low_a tau
        both = poly.polymul(low_a, low_t)
        inertia = poly.polymul(s * ((r - 1) * mass_hat), low_t)
        drive = poly.polyadd(poly.polymul(lag, both), Fraction(law.current_factor) * (r - 1) * low_a)
        force = poly.polyadd(inertia, r * (f_hat - damping) * both)
        command = poly.polysub(poly.polymul(s, force), pull * both)
        numerator = poly.polymul(s, drive)
        denominator = poly.polysub(poly.polymul(numerator, mechanics), command)
    if law.stiffness == 0.0:
        numerator, denominator = numerator[1:], denominator[1:]
    return poly.polytrim(numerator), poly.polytrim(denominator)


def passivity(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, points: int = 4000) -> Passivity:
    """Return the passivity of the law: by exact polynomial roots in continuous time, by a sweep of ``points`` sampled.

    The result is that of the less passive direction of motion.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> passivity(law, law.estimate, Clock.of(axis)).sampled
    False
    """
    verdicts = [_one_way(law, plant, clock, direction, points) for direction in plant.directions]
    return min(
        verdicts, key=lambda verdict: (verdict.sampled, verdict.continuous, [low for low, _ in verdict.sampled_bands])
    )


def _one_way(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, direction: int, points: int) -> Passivity:
    numerator, denominator = admittance_polynomials(law, plant, clock.current_time_constant, direction)
    roots, _ = _scaled_roots(denominator)
    stable = bool(np.all(roots.real <= MARGINAL))
    loop = sampled_loop(law, plant, clock, direction)
    omega = np.geomspace(1e-5, 1.0, points) * (math.pi / clock.period) * (1.0 - 1e-9)
    active = loop.admittance(omega).real < 0.0
    where = tuple((float(omega[start]), float(omega[stop - 1])) for start, stop in stretches(active))
    return Passivity(stable, _negative_bands(numerator, denominator), loop.stable, where)


def _scaled_roots(coefficients: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the roots of a polynomial with rational coefficients, divided by a scale, and that scale.

    The scale is the geometric mean of the nonzero roots: first and last coefficient become equally large.
    """
    powers = np.flatnonzero(coefficients)
    if powers.size < 2:
        return np.zeros(powers[0] if powers.size else 0), 1.0
    (low, high), zeros = (abs(coefficients[k]) for k in (powers[0], powers[-1])), int(powers[0])
    degree = int(powers[-1]) - zeros
    scale = math.exp((math.log(low) - math.log(high)) / degree)
    scaled = [float(c / low) * scale**k for k, c in enumerate(coefficients[zeros : powers[-1] + 1])]
    return np.concatenate([np.zeros(zeros), poly.polyroots(scaled)]), scale


def _negative_bands(numerator: np.ndarray, denominator: np.ndarray) -> Bands:
    """Bands of w > 0 in which Re N(jw) conj(D(jw)) is below zero, for polynomials with rational coefficients."""
    flipped = denominator * (-1) ** np.arange(len(denominator))  # conj(D(jw)) = D(-jw)
    product = poly.polymul(numerator, flipped)[::2]  # even powers of s: real on the axis
    real_part = poly.polytrim(product * (-1) ** np.arange(len(product)))  # in x = w^2
    roots, scale = _scaled_roots(real_part)
    edges = np.unique(scale * roots.real[roots.real > 0.0])  # complex ones too: the signs in between decide
    inside = [edges[0] / 2, *np.sqrt(edges[:-1] * edges[1:]), 2 * edges[-1]] if edges.size else [1.0]
    signs = np.array([poly.polyval(Fraction(float(x)), real_part) < 0 for x in inside])
    ends = np.sqrt([0.0, *edges, np.inf])
    return tuple((float(ends[start]), float(ends[stop])) for start, stop in stretches(signs))


@dataclass(frozen=True)
class ContactMap:
    """Largest pole modulus of the sampled loop in contact: ``radius[damping, stiffness]``, for a hand of one mass."""

    stiffness: np.ndarray
    damping: np.ndarray
    mass: float
    radius: np.ndarray

    @property
    def stable(self) -> np.ndarray:
        """Boolean array of the shape of ``radius``."""
        return self.radius <= 1.0 + MARGINAL

    def to_dict(self) -> dict[str, Any]:
        """Axes in SI (N/m, N/(m/s), kg) and the pole moduli."""
        return {
            "stiffness": self.stiffness.tolist(),
            "damping": self.damping.tolist(),
            "mass": self.mass,
            "radius": self.radius.tolist(),
            "stable_share": float(self.stable.mean()),
        }


def contact_map(
    law: ImpedanceLaw,
    plant: FrictionModel,
    clock: Clock,
    stiffness: np.ndarray | None = None,
    damping: np.ndarray | None = None,
    mass: float = 0.0,
) -> ContactMap:
    """Map coupled stability over hand and wall: ``stiffness`` [N/m] to ground and ``damping`` [N/(m/s)], ``mass`` [kg].

    The default is 0 and 30 stiffnesses from 10 N/m to 10 MN/m (a finger to a steel wall), 0 and 20 dampings up to
    10 kN/(m/s), for a carriage of 100 kg at 1 kHz; for others they scale with mass and sampling rate in powers of ten.
    A passive wall or hand can destabilise only a law that is not passive. The worse direction of motion counts.
    """
    k, c = (10.0 ** round(math.log10(plant.mass / clock.period**order / 10.0 ** (2 + 3 * order))) for order in (2, 1))
    stiffness = np.concatenate([[0.0], k * np.geomspace(10.0, 1e7, 30)]) if stiffness is None else np.asarray(stiffness)
    damping = np.concatenate([[0.0], c * np.geomspace(1.0, 1e4, 20)]) if damping is None else np.asarray(damping)
    grid_k, grid_b = np.meshgrid(stiffness, damping)
    hand = Environment(mass, grid_b.ravel(), grid_k.ravel())
    radius = _radius(law, plant, clock, hand).reshape(grid_k.shape)
    if not np.any(law.stiffness) and np.any(stiffness == 0.0):  # without the pole at 1 of a free position
        radius[:, stiffness == 0.0] = _radius(law, plant, clock, Environment(mass, damping, 0.0))[:, None]
    return ContactMap(stiffness, damping, mass, radius)


def _radius(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, touched: Environment) -> np.ndarray:
    return np.max(
        [sampled_loop(law, plant, clock, direction, touched).radius for direction in plant.directions], axis=0
    )


def largest_wall(law: ImpedanceLaw, plant: FrictionModel, clock: Clock) -> float | None:
    """Largest stiffness [N/m] below which every undamped wall is stable; None: all up to 1 GN/m.

    The search has steps of 11 % and is bisected to 0.1 %. It is 0 if the softest wall is already unstable: that of
    1 N/m, or of 1e-8 M_a/T^2 for a light axis.
    """
    stiffness = np.geomspace(1.0, 1e9, 200)
    softest, apart = 1e-8 * law.mass / clock.period**2, stiffness[1] / stiffness[0]
    if 0.0 < softest < 1.0:
        stiffness = np.concatenate([apart ** np.arange(math.floor(math.log(softest, apart)), 0), stiffness])

    def unstable(values: np.ndarray) -> np.ndarray:
        return contact_map(law, plant, clock, values, np.array([0.0])).radius[0] > 1.0 + MARGINAL

    bad = np.flatnonzero(unstable(stiffness))
    if not len(bad):
        return None
    if bad[0] == 0:
        return 0.0
    ends = stiffness[bad[0] - 1], stiffness[bad[0]]
    return float(bisect(lambda wall: unstable(np.array([wall]))[0], *ends, CLOSE)[0])
