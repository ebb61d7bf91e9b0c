"""Robustness of impedance laws: creep and dead band in closed form, stability maps, and the nearest stable law.

Under a mismatch ``e`` each estimate is within ``(1 +- e)`` times the parameter of the plant. Coulomb friction moves no
pole. Overestimated, it drives the carriage at the constant speed ``v = (c Fh_c - F_c) / (B + F_v - Fh_v)``.
Underestimated, it leaves a dead band ``F_c - c Fh_c`` [N]: a smaller push does not keep the carriage moving.

Margins are those at the plant input, where a wrong force gain, a delay or a slow drive acts. The law cancels friction
and part of the mass by its estimates, so a larger force gain overcompensates: the gain margin is often reached at
frequency 0, where the apparent damping becomes zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw, law_for
from emps_design.control.impedance.passivity import CLOSE, Clock, extended_loop, recursion_poles, sampled_loop
from emps_design.control.margins import bisect
from emps_design.control.sampled import MARGINAL, PLANT_INPUT, WHOLE, NestedLoop, at_plant_input
from emps_design.control.velocity.load_range import corners as corners_of
from emps_design.errors import InputError
from emps_design.laws.estimators import TWO_TAP, AnyEstimator, forgets
from emps_design.laws.law import PARAMETERS
from emps_design.laws.linear import linear_law

STEP = 1.05  # ratio of two apparent masses in a search
MORE_DAMPING = (1.0, 1.5, 2.25)  # factors on the damping of the law, or on the least that the mismatch permits
ALIKE = 0.2  # distance in the logarithms of mass and filter within which laws are excluded with one in a limit cycle
# By rising severity; ``no_motion``: the carriage was at rest at the release, so there is no verdict.
VERDICTS = ("stable", "dead_band", "no_motion", "creeping", "limit_cycle", "unstable")

SPEED = 0.1  # m/s, at which effects are linearised


def check_mismatch(mismatch: float) -> float:
    """Return ``mismatch`` as a float; raise :class:`InputError` outside [0, 1), where an estimate may be negative.

    >>> check_mismatch(0.02)
    0.02
    """
    if not math.isfinite(mismatch) or not 0.0 <= mismatch < 1.0:
        raise InputError(
            f"mismatch: found {mismatch:g}, expected a number in [0, 1): estimates are 1 - mismatch to 1 + mismatch "
            "times the plant's, and may not be negative"
        )
    return float(mismatch)


def corner_errors(mismatch: float, two_quadrant: bool = False) -> list[dict[str, float]]:
    """All corners of the box of estimate errors: 8 of mass, viscous, coulomb; 32 of the five of (5); 1 of no errors.

    >>> len(corner_errors(0.02)), len(corner_errors(0.02, two_quadrant=True)), len(corner_errors(0.0))
    (8, 32, 1)
    """
    names = PARAMETERS if two_quadrant else ("mass", "viscous", "coulomb")
    errors = dict.fromkeys((-mismatch, mismatch))
    return [dict(zip(names, corner, strict=True)) for corner in product(errors, repeat=len(names))]


def exact_and_corners(mismatch: float) -> list[dict[str, float]]:
    """No errors, followed by the corners of :func:`corner_errors` unless ``mismatch`` is 0."""
    return [{}, *(corner_errors(mismatch) if mismatch else ())]


def stacked(corners: Sequence[dict[str, float]]) -> dict[str, np.ndarray]:
    """The errors at several ``corners`` as arrays (m,), as :meth:`.ImpedanceLaw.with_errors` takes them.

    >>> {name: errors.tolist() for name, errors in stacked([{}, {"mass": 0.02}]).items()}
    {'mass': [0.0, 0.02]}
    """
    return {name: np.array([corner.get(name, 0.0) for corner in corners]) for name in corners[-1]}


def drift_speed(law: ImpedanceLaw, plant: FrictionModel, direction: int = 1) -> Any:
    """Final speed [m/s] of free motion in ``direction``: positive if it creeps, negative if friction stops it.

    It is infinite if the apparent damping is not positive and friction does not stop the motion, and never positive
    with a stiffness, which stops every drift. A float, or (m,) for a law whose estimate holds arrays.
    """
    z = law.apparent(plant, direction)
    remaining, damping = np.asarray(z.coulomb_left), np.asarray(z.damping)
    with np.errstate(divide="ignore", invalid="ignore"):
        undamped = np.where((damping < 0.0) | (remaining < 0.0), np.inf, np.where(remaining > 0.0, -np.inf, 0.0))
        speed = np.where(damping > 0.0, -remaining / damping, undamped)
    if law.stiffness > 0.0:
        speed = np.minimum(speed, 0.0)
    return speed if speed.ndim else float(speed)


def creep_speed(law: ImpedanceLaw, plant: FrictionModel) -> float:
    """Creep speed [m/s] of the released carriage in the worse direction; 0 without creep.

    >>> plant = FrictionModel(115.7315, 474.9727, 474.9727, 17.3811, 17.3811)
    >>> over = ImpedanceLaw(50.0, 100.0, plant).with_errors({"mass": 0.02, "viscous": 0.02, "coulomb": 0.02})
    >>> round(1e3 * creep_speed(over, plant), 2)
    3.84
    """
    return max(0.0, *(drift_speed(law, plant, direction) for direction in (1, -1)))


def dead_band(law: ImpedanceLaw, plant: FrictionModel) -> float:
    """Remaining Coulomb friction [N] in the worse direction; 0: none."""
    return max(0.0, *(law.apparent(plant, direction).coulomb_left for direction in (1, -1)))


def break_away(law: ImpedanceLaw, plant: FrictionModel) -> float:
    """Break-away force [N] at the hand.

    Without a force sensor it is F_c, since at rest the law compensates no Coulomb friction. With one the motor assists,
    and it is ``F_c M_a/Mh``.
    """
    return max(plant.coulomb) / (law.ratio if law.force_sensor else 1.0)


def sinking_force(plant: FrictionModel) -> float:
    """Excess of the constant force over dry friction [N], 0 if friction holds the axis; the law compensates neither.

    >>> sinking_force(FrictionModel(95.0, 200.0, 200.0, 72.0, -48.0))
    48.0
    """
    return max(0.0, *(-level for level in plant.coulomb))


def coulomb_factor_without_creep(law: ImpedanceLaw, plant: FrictionModel, mismatch: float) -> float | None:
    """Largest Coulomb factor c with which no law within ``mismatch`` creeps: ``c Fh_c <= F_c``.

    None if a constant force exceeds dry friction, since no factor suits both directions.

    >>> plant = FrictionModel(115.7315, 474.9727, 474.9727, 17.3811, 17.3811)
    >>> round(coulomb_factor_without_creep(ImpedanceLaw(50.0, 100.0, plant), plant, 0.02), 5)
    0.98039
    """
    if sinking_force(plant) > 0.0:
        return None
    pairs = zip(plant.coulomb, law.estimate.coulomb, strict=True)
    factors = [true / ((1.0 + mismatch) * hat) for true, hat in pairs if hat > 0.0]
    return min([1.0, *factors])


def verdict(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, resolution: float = 0.0) -> str:
    """Return the analytical verdict on the released carriage: one of ``VERDICTS``.

    It is unstable if the poles are in either direction, and a limit cycle if the recursion in the law's current is
    unstable, which moves a carriage at rest. Otherwise :func:`drift_speed` and :func:`drift_threshold` decide.
    """
    directions = max(plant.directions, law.estimate.directions, key=len)
    if any(not sampled_loop(law, plant, clock, direction).stable for direction in directions):
        return "unstable"
    if abs(recursion_poles(law, clock)[0]) > 1.0 + MARGINAL:
        return "limit_cycle"
    drifts = [drift_speed(law, plant, direction) for direction in directions]
    threshold = drift_threshold(clock.period, resolution, law.velocity_estimator)
    if max(drifts) > threshold:
        return "creeping"
    return "dead_band" if min(drifts) < -threshold else "stable"


def drift_threshold(period: float, resolution: float, velocity_estimator: AnyEstimator = TWO_TAP) -> float:
    """Lowest sustained creep speed [m/s]: one encoder step within the span of the velocity estimate.

    An estimate over one period (backward) or several (two_tap, a slope) is 0 without an encoder step and then
    compensates no friction. So a creep of less than one step in that time stops; a faster one continues. It is
    0.025 mm/s on ``emps2018`` with two_tap. An estimate that only decays (filtered, tracking) keeps its sign, so no
    creep stops.
    """
    return max(resolution / period / forgets(velocity_estimator), 1e-6)


def worst_radius(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, mismatch: float) -> np.ndarray:
    """Largest pole modulus over the corners of ``mismatch``, in motion and at rest.

    If M_a and filter of ``law`` are arrays, the result has their broadcast shape.
    """
    laws = _exact_and_off(law, mismatch)
    radii = [sampled_loop(laws, plant, clock, direction).radius for direction in plant.directions]
    if not law.force_sensor:
        radii.append(np.abs(recursion_poles(laws, clock)).max(axis=-1))
    return np.max(np.broadcast_arrays(*radii), axis=(0, 1))


def extended_radius(axis: Axis, law: ImpedanceLaw, mismatch: float) -> np.ndarray:
    """:func:`worst_radius` while sliding, with the effects of ``axis`` that the friction model leaves out, linearised.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> coupling = {"kind": "flexible_coupling", "frequency": 80.0, "damping": 0.05, "share": 0.1}
    >>> axis = machine("emps2018").replace(effects=[coupling])
    >>> [float(extended_radius(axis, impedance_law(axis, 30.0, 300.0), e).round(4)) for e in (0.0, 0.2)]
    [0.997, 1.0012]
    """
    off, directions = _exact_and_off(law, mismatch), FrictionModel.of(axis).directions
    return np.max([extended_loop(axis, off, direction * SPEED).radius for direction in directions], axis=(0, 1))


def _exact_and_off(law: ImpedanceLaw, mismatch: float) -> ImpedanceLaw:
    """``law`` with exact estimates and at the corners of ``mismatch``, along a new first axis of its arrays."""
    corners = [{"mass": 0.0, "viscous": 0.0}, *_sliding_corners(mismatch)]
    beside = (1,) * len(np.broadcast_shapes(np.shape(law.mass), np.shape(law.filter)))
    return law.with_errors({name: errors.reshape(-1, *beside) for name, errors in stacked(corners).items()})


def _sliding_corners(mismatch: float) -> list[dict[str, float]]:
    """Corners of the errors that matter in motion, where Coulomb friction is constant."""
    return corners_of({"mass": mismatch, "viscous": mismatch}) if mismatch else []


@dataclass(frozen=True)
class StabilityMap:
    """Stability of the law at every corner of a mismatch: ``radius[mismatch, filter, mass]`` of the worst pole."""

    masses: np.ndarray
    filters: np.ndarray
    mismatches: np.ndarray
    damping: float
    radius: np.ndarray

    @property
    def stable(self) -> np.ndarray:
        """Boolean array of the shape of ``radius``."""
        return self.radius <= 1.0 + MARGINAL

    def to_dict(self) -> dict[str, Any]:
        """Axes in SI, the worst pole modulus, and the smallest stable mass of each row."""
        first = np.where(self.stable.any(axis=2), self.masses[np.argmax(self.stable, axis=2)], np.nan)
        return {
            "masses": self.masses.tolist(),
            "filters": self.filters.tolist(),
            "mismatches": self.mismatches.tolist(),
            "damping": self.damping,
            "radius": self.radius.tolist(),
            "smallest_stable_mass": [[x if math.isfinite(x) else None for x in row] for row in first.tolist()],
        }


def stability_map(
    law: ImpedanceLaw,
    plant: FrictionModel,
    clock: Clock,
    masses: Any = None,
    filters: Any = None,
    mismatches: Sequence[float] = (0.0, 0.02, 0.05),
) -> StabilityMap:
    """Map stability over (M_a, filter, mismatch); ``law`` gives damping, estimator and the rest.

    Default grid: 30 masses from M/100 to 1.5 M, 20 filters from 10 rad/s to just below Nyquist.
    """
    masses = np.geomspace(plant.mass / 100, 1.5 * plant.mass, 30) if masses is None else np.asarray(masses, dtype=float)
    nyquist = math.pi / clock.period
    filters = np.geomspace(nyquist / 300, 0.99 * nyquist, 20) if filters is None else np.asarray(filters, dtype=float)
    grid_mass, grid_filter = np.meshgrid(masses, filters)
    laws = replace(law, mass=grid_mass, filter=grid_filter)
    radius = np.array([worst_radius(laws, plant, clock, check_mismatch(e)) for e in mismatches])
    return StabilityMap(masses, filters, np.asarray(mismatches, dtype=float), law.damping, radius)


def smallest_mass(
    law: ImpedanceLaw,
    plant: FrictionModel,
    clock: Clock,
    mismatch: float,
    calm: Callable[[ImpedanceLaw], bool] | None = None,
) -> float | None:
    """Smallest M_a [kg] such that the law is stable at every corner from there up to M; None if there is none.

    The search covers 200 masses between M/1000 and M and is bisected to 0.1 %. ``calm(law)`` says whether the simulated
    carriage has no limit cycle; with it the mass is one step, at most 5 %, above the smallest without a limit cycle.
    """
    smallest = _smallest_stable(law, plant, clock, mismatch)
    if smallest is None or calm is None:
        return smallest
    masses = np.geomspace(smallest, plant.mass, max(2, int(math.log(plant.mass / smallest) / math.log(STEP)) + 2))
    low, high = -1, len(masses) - 1
    if not calm(replace(law, mass=float(masses[high]))):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if calm(replace(law, mass=float(masses[middle]))) else (middle, high)
    # One step of margin, since near the smallest mass some laws have a limit cycle.
    return float(masses[min(high + 1, len(masses) - 1)])


def _smallest_stable(law: ImpedanceLaw, plant: FrictionModel, clock: Clock, mismatch: float) -> float | None:
    masses = np.geomspace(plant.mass * 1e-3, plant.mass, 200)
    bad = np.flatnonzero(worst_radius(replace(law, mass=masses), plant, clock, mismatch) > 1.0 + MARGINAL)
    if not len(bad):
        return float(masses[0])
    if bad[-1] == len(masses) - 1:
        return None

    def stable(mass: float) -> bool:
        return bool(worst_radius(replace(law, mass=mass), plant, clock, mismatch) <= 1.0 + MARGINAL)

    return float(bisect(stable, masses[bad[-1]], masses[bad[-1] + 1], CLOSE)[1])


def nearest_stable(
    law: ImpedanceLaw,
    plant: FrictionModel,
    clock: Clock,
    mismatch: float,
    accept: Callable[[ImpedanceLaw], np.ndarray] | None = None,
    calm: Callable[[ImpedanceLaw], bool] | None = None,
) -> dict[str, float] | None:
    """Return the law nearest to ``law`` that is stable at every corner of ``mismatch``; None if there is none.

    Mass and filter are varied first, and the damping is increased only if no such law is stable. Acceleration and
    current share the filter. The distance is that of the logarithms of M_a and filter; the grid has steps of a few
    percent. ``accept(laws)`` may exclude laws for other reasons, ``calm(law)`` a law with a limit cycle.
    """
    least = 1.05 * mismatch * max(plant.viscous)
    damping = law.damping if law.damping > mismatch * max(plant.viscous) else least
    for factor in MORE_DAMPING if damping > 0.0 else (1.0,):
        nearest = _nearest_in_mass_and_filter(
            replace(law, damping=factor * damping), plant, clock, mismatch, accept, calm
        )
        if nearest is not None:
            return nearest
    return None


def _nearest_in_mass_and_filter(
    law: ImpedanceLaw,
    plant: FrictionModel,
    clock: Clock,
    mismatch: float,
    accept: Callable[[ImpedanceLaw], np.ndarray] | None,
    calm: Callable[[ImpedanceLaw], bool] | None,
) -> dict[str, float] | None:
    """:func:`nearest_stable` at the damping of ``law``."""
    nyquist = math.pi / clock.period
    first_filter = min(law.filter, 0.99 * nyquist)
    masses = np.unique(np.concatenate([[law.mass], np.geomspace(law.mass, max(plant.mass, 2 * law.mass), 40)]))
    filters = np.unique(np.concatenate([[first_filter], np.geomspace(nyquist / 300, 0.99 * nyquist, 30)]))
    grid_mass, grid_filter = np.meshgrid(masses, filters)
    both = replace(law, current_filter=None)
    laws = replace(both, mass=grid_mass, filter=grid_filter)
    stable = worst_radius(laws, plant, clock, mismatch) <= 1.0 + MARGINAL
    if accept is not None and stable.any():
        stable[stable] = accept(replace(both, mass=grid_mass[stable], filter=grid_filter[stable]))
    if not stable.any():
        return None
    distance = np.where(stable, np.hypot(np.log(grid_mass / law.mass), np.log(grid_filter / first_filter)), np.inf)
    if calm is not None and not calm(replace(both, mass=float(masses[-1]), filter=first_filter)):
        return None  # the heaviest law has a limit cycle too, so mass and filter are not the cause
    while np.isfinite(distance).any():
        place = int(np.argmin(distance))
        candidate = replace(both, mass=float(grid_mass.flat[place]), filter=float(grid_filter.flat[place]))
        # Near the limit some laws have a limit cycle, so the law one step lighter must have none either.
        if calm is None or (calm(candidate) and calm(replace(candidate, mass=candidate.mass / STEP))):
            return {"mass": candidate.mass, "damping": float(law.damping), "filter": candidate.filter}
        around = np.hypot(np.log(grid_mass / candidate.mass), np.log(grid_filter / candidate.filter))
        distance[around <= ALIKE] = np.inf
    return None


def impedance_loops(axis: Axis, law: ImpedanceLaw, mismatch: float = 0.0) -> tuple[NestedLoop, ...]:
    """Return the loop of ``law`` on ``axis`` in every direction, with exact estimates and at corners of ``mismatch``.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> for damping in (100.0, 300.0):
    ...     print(round(impedance_loops(axis, impedance_law(axis, 50.0, damping))[0].margins.gain_margin, 2))
    1.27
    1.77
    """
    plant = FrictionModel.of(axis)
    period, loops = axis.sampling.period, []
    for direction in plant.directions:
        sampled = sample_axis(axis, direction * SPEED)
        for errors in ({}, *_sliding_corners(mismatch)):
            form = linear_law(law_for(axis, law.with_errors(errors), period), period, float(direction))
            loops.append(NestedLoop(WHOLE, PLANT_INPUT, at_plant_input(sampled, form), errors))
    return tuple(loops)
