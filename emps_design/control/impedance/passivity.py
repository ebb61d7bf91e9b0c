"""Passivity of what the hand meets, and stability in contact with hands and walls.

Continuous time (current loop ``1/(T_c s + 1)``, both filters first order, velocity and acceleration exact): the
driving-point admittance is a ratio of polynomials N/D. It is positive real where D is Hurwitz and
``Re N(jw) conj(D(jw))``, an even polynomial, is nowhere negative; its sign changes are the real roots of a polynomial
in w^2, found as eigenvalues, so no frequency is missed between grid points.

Sampled: for an external force held over each period, the energy that flows in is exactly force times position step, so
the sampled loop is passive for such forces where ``Re V(e^{jwT})/tau_e >= 0`` up to the Nyquist frequency: swept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import polynomial as poly

from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.sampled import Clock, Environment, numbers, sampled_loop, spectral_radius
from emps_design.control.loop.sampled_loop import MARGINAL
from emps_design.stretches import stretches

Bands = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Passivity:
    """Where the driving-point admittance takes energy from the hand (``Re Y < 0``): bands of frequency [rad/s].

    An upper end of inf is written None; ``passive`` needs a stable loop and no band.
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

        def bands(found: Bands) -> list[list[float | None]]:
            return [[low, high if math.isfinite(high) else None] for low, high in found]

        return {
            "continuous": {"passive": self.continuous, "active_bands": bands(self.continuous_bands)},
            "sampled": {"passive": self.sampled, "active_bands": bands(self.sampled_bands)},
        }


def admittance_polynomials(
    law: ImpedanceLaw, plant: FrictionModel, current_time_constant: float, direction: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of velocity over external force, continuous law, ascending powers of s."""
    i = 0 if direction > 0 else 1
    r, f_hat = law.ratio, law.estimate.viscous[i]
    lag = np.array([1.0, current_time_constant])
    mechanics = np.array([plant.viscous[i], plant.mass])
    pull = r * law.stiffness
    if law.force_sensor:  # lag tau = (r-1) tau_e + (Fh - r B) v - r K v/s
        command = poly.polysub([0.0, f_hat - r * law.damping], [pull])
        numerator = poly.polymul([0.0, 1.0], poly.polyadd(lag, [r - 1.0]))
        denominator = poly.polysub(poly.polymul(poly.polymul([0.0, 1.0], mechanics), lag), command)
    else:
        low_a, low_t = (np.array([1.0, 1.0 / w]) if math.isfinite(w) else np.array([1.0]) for w in law.filters)
        # lag low_a low_t tau = v [(r-1) Mh s low_t + (r (Fh - B) - r K/s) low_a low_t] - kappa (r-1) low_a tau
        inertia = poly.polymul([0.0, (r - 1.0) * law.estimate.mass], low_t)
        both = poly.polymul(low_a, low_t)
        friction = poly.polymul([r * (f_hat - law.damping)], both)
        drive = poly.polyadd(poly.polymul(lag, both), law.recursion_gain * low_a)
        command = poly.polysub(poly.polymul([0.0, 1.0], poly.polyadd(inertia, friction)), poly.polymul([pull], both))
        numerator = poly.polymul([0.0, 1.0], drive)
        denominator = poly.polysub(poly.polymul(numerator, mechanics), command)
    if law.stiffness == 0.0:
        numerator, denominator = numerator[1:], denominator[1:]
    return poly.polytrim(numerator), poly.polytrim(denominator)


def passivity(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, points: int = 4000) -> Passivity:
    """Say where the law is passive: exact polynomial roots in continuous time, a sweep of ``points`` when sampled.

    In the direction of motion in which it is less so.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> passivity(law, law.estimate, Clock.of(axis)).sampled
    False
    """
    found = [_one_way(law, plant, clock, direction, points) for direction in plant.directions]
    return min(found, key=lambda one: (one.sampled, one.continuous, [low for low, _ in one.sampled_bands]))


def _one_way(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, direction: int, points: int) -> Passivity:
    numerator, denominator = admittance_polynomials(law, plant, clock.current_time_constant, direction)
    stable = bool(np.all(poly.polyroots(denominator).real <= MARGINAL))
    loop = sampled_loop(law, plant, clock, direction)
    omega = np.geomspace(1e-5, 1.0, points) * (math.pi / clock.period) * (1.0 - 1e-9)
    active = loop.admittance(omega).real < 0.0
    where = tuple((float(omega[start]), float(omega[stop - 1])) for start, stop in stretches(active))
    return Passivity(stable, _negative_bands(numerator, denominator), loop.stable, where)


def _negative_bands(numerator: np.ndarray, denominator: np.ndarray) -> Bands:
    """Bands of w > 0 in which Re N(jw) conj(D(jw)) is below zero."""
    flipped = denominator * (-1.0) ** np.arange(len(denominator))  # conj(D(jw)) = D(-jw)
    product = poly.polymul(numerator, flipped)[::2]  # even powers of s: real on the axis
    real_part = product * (-1.0) ** np.arange(len(product))  # in x = w^2
    scale = np.abs(real_part).max()
    real_part = poly.polytrim(real_part, 1e-14 * scale) if scale > 0.0 else real_part
    roots = poly.polyroots(real_part) if len(real_part) > 1 else np.array([])
    positive = np.sort(roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)])
    ends = np.concatenate([[0.0], positive, [np.inf]])
    bands = []
    for low, high in pairwise(ends):
        middle = 2.0 * low + 1.0 if math.isinf(high) else 0.5 * (low + high)
        if poly.polyval(middle, real_part) < 0.0:
            bands.append((math.sqrt(low), math.sqrt(high)))
    return _joined(bands)


def _joined(bands: list[tuple[float, float]]) -> Bands:
    joined: list[tuple[float, float]] = []
    for low, high in bands:
        if joined and joined[-1][1] == low:
            joined[-1] = (joined[-1][0], high)
        else:
            joined.append((low, high))
    return tuple(joined)


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

    Default: 0 and 30 stiffnesses from 10 N/m to 10 MN/m (a finger to a steel wall), 0 and 20 dampings to 10 kN/(m/s),
    for a carriage of 100 kg at 1 kHz, and with another one in proportion to its mass and rate, in powers of ten.
    A passive wall or hand can only destabilise a law that is not passive. Of two directions of motion the worse counts.
    """
    k, c = (10.0 ** round(math.log10(plant.mass / clock.period**order / 10.0 ** (2 + 3 * order))) for order in (2, 1))
    stiffness = np.concatenate([[0.0], k * np.geomspace(10.0, 1e7, 30)]) if stiffness is None else np.asarray(stiffness)
    damping = np.concatenate([[0.0], c * np.geomspace(1.0, 1e4, 20)]) if damping is None else np.asarray(damping)
    grid_k, grid_b = np.meshgrid(stiffness, damping)
    hand = Environment(mass, grid_b.ravel(), grid_k.ravel())
    radius = _radius(law, plant, clock, hand).reshape(grid_k.shape)
    if not np.any(law.stiffness) and np.any(stiffness == 0.0):  # position is free there: its pole at 1 says nothing
        radius[:, stiffness == 0.0] = _radius(law, plant, clock, Environment(mass, damping, 0.0))[:, None]
    return ContactMap(stiffness, damping, mass, radius)


def _radius(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, touched: Environment) -> np.ndarray:
    options = {"velocity_estimator": law.velocity_estimator, "force_sensor": law.force_sensor, "environment": touched}
    each = [spectral_radius(numbers(law, plant, direction), clock, **options) for direction in plant.directions]
    return np.max(each, axis=0)


def largest_wall(law: ImpedanceLaw, plant: FrictionModel, clock: Clock) -> float | None:
    """Largest stiffness [N/m] of an undamped wall up to which every softer one is stable too; None: all up to 1 GN/m.

    From stiffnesses 11 % apart, bisected to 0.1 %; 0 where the softest wall is already unstable: of 1 N/m, or of an
    axis so light that this is none, of 1e-8 M_a/T^2.
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
    low, high = stiffness[bad[0] - 1], stiffness[bad[0]]
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        if unstable(np.array([middle]))[0]:
            high = middle
        else:
            low = middle
    return float(low)
