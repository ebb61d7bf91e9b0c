"""Impedance control without a force sensor: the law, its target, and what the carriage then feels like.

Section IV of the 2018 paper, after Hogan. Plant ``M qdd = tau + tau_e - F_v qd - F_c sign(qd)``, target
``tau_e = M_a qdd + B qd + K (q - q_0)``. With ``r = Mh/M_a`` and hats for the law's estimates the law is

    tau_eh = Mh a_f + Fh_v v + c Fh_c sign(v) - kappa tau_f                                (29)
    tau    = (r - 1) tau_eh + (Fh_v - r B) v + c Fh_c sign(v) - r K (q - q_0)               (27), (28)

where ``a_f`` and ``tau_f`` are the acceleration and the motor force G_tau_i I_m behind low-pass filters. ``kappa = 1``
is what (28) and (29) give; ``kappa = 2`` is (30) as printed. Hats are ``(1 + error)`` times the plant's numbers, so an
error of +2 % is an over-estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError

DERIVED, PRINTED = 1.0, 2.0  # factor in front of (Mh/M_a - 1) G_tau_i I_m in (30)
PARAMETERS = ("mass", "viscous_positive", "viscous_negative", "coulomb_positive", "coulomb_negative")


@dataclass(frozen=True)
class FrictionModel:
    """The vector X of equation (5): mass [kg], viscous [N/(m/s)] and Coulomb friction [N] for either direction."""

    mass: float
    viscous_positive: float
    viscous_negative: float
    coulomb_positive: float
    coulomb_negative: float

    @classmethod
    def of(cls, axis: Axis) -> FrictionModel:
        """Read X from an axis; effects proportional to speed join the viscous friction, see :func:`left_out`.

        >>> from emps_design.machines import machine
        >>> FrictionModel.of(machine("emps2018-two-quadrant")).viscous_negative
        563.8568
        """
        m = axis.mechanics
        positive, negative = m.viscous, m.viscous
        for entry in axis.effects:
            if entry.effect.slopes is not None:
                slopes = entry.effect.slopes(entry.effect.values(entry.parameters))
                positive, negative = positive + slopes[0], negative + slopes[1]
        return cls(m.mass, round(positive, 12), round(negative, 12), m.coulomb + m.offset, m.coulomb - m.offset)

    @property
    def two_quadrant(self) -> bool:
        """Whether friction differs with the direction."""
        return self.viscous_positive != self.viscous_negative or self.coulomb_positive != self.coulomb_negative

    @property
    def coulomb(self) -> tuple[float, float]:
        """Coulomb friction for motion to + and to - [N]."""
        return self.coulomb_positive, self.coulomb_negative

    @property
    def viscous(self) -> tuple[float, float]:
        """Viscous friction for motion to + and to - [N/(m/s)]."""
        return self.viscous_positive, self.viscous_negative

    def with_errors(self, errors: dict[str, float]) -> FrictionModel:
        """Return estimates ``(1 + error)`` times these numbers; raises :class:`InputError` if one turns negative.

        ``errors`` has keys of ``PARAMETERS``, or ``viscous`` and ``coulomb`` for both directions alike.

        >>> FrictionModel(100.0, 400.0, 400.0, 20.0, 20.0).with_errors({"coulomb": 0.05}).coulomb
        (21.0, 21.0)
        """
        both = {name: error for name, error in errors.items() if name in PARAMETERS}
        for name in ("viscous", "coulomb"):
            if name in errors:
                both |= {f"{name}_positive": errors[name], f"{name}_negative": errors[name]}
        for name, error in both.items():
            if not math.isfinite(error) or error <= -1.0:
                raise InputError(
                    f"mismatch: found {error:g} on {name.replace('_', ' ')}, so the estimate is not positive; "
                    "expected more than -1"
                )
        return replace(self, **{name: getattr(self, name) * (1.0 + error) for name, error in both.items()})

    def array(self) -> np.ndarray:
        """The five numbers in the order of ``PARAMETERS``."""
        return np.array([getattr(self, name) for name in PARAMETERS])

    def to_dict(self) -> dict[str, float]:
        """The five numbers by name, SI."""
        return {name: getattr(self, name) for name in PARAMETERS}


@dataclass(frozen=True)
class ApparentImpedance:
    """What the operator feels in motion: ``tau_e = mass qdd + damping qd + coulomb_left sign(qd)``.

    ``coulomb_left`` below zero drives the carriage instead of holding it back.
    """

    mass: float
    damping: float
    coulomb_left: float

    def to_dict(self) -> dict[str, float]:
        """Keys of the contract: apparent_mass [kg], apparent_damping [N/(m/s)], coulomb_left [N]."""
        return {
            "apparent_mass": self.mass,
            "apparent_damping": self.damping,
            "coulomb_left": self.coulomb_left,
        }


@dataclass(frozen=True)
class ImpedanceLaw:
    """The impedance law with everything that decides how it behaves.

    ``mass`` M_a [kg], ``damping`` B [N/(m/s)], ``estimate`` the law's X, ``stiffness`` K [N/m] about ``rest_position``
    q_0 [m]; ``filter`` [rad/s] low-passes acceleration and current alike (inf: none), ``current_filter`` another one
    for the current alone (None: the same); ``coulomb_factor`` c scales the Coulomb compensation; ``current_factor`` is
    ``DERIVED`` or ``PRINTED``; ``force_sensor`` puts a measured tau_e in the place of (29).
    Raises :class:`InputError` for M_a <= 0, B < 0 and the like.

    >>> plant = FrictionModel(115.7315, 474.9727, 474.9727, 17.3811, 17.3811)
    >>> law = ImpedanceLaw(50.0, 100.0, plant)
    >>> law.apparent(plant).to_dict()
    {'apparent_mass': 50.0, 'apparent_damping': 100.0, 'coulomb_left': 0.0}
    """

    mass: float
    damping: float
    estimate: FrictionModel
    stiffness: float = 0.0
    rest_position: float = 0.0
    filter: float = math.inf
    current_filter: float | None = None
    coulomb_factor: float = 1.0
    current_factor: float = DERIVED
    force_sensor: bool = False
    velocity_estimator: str = "two_tap"

    def __post_init__(self) -> None:
        _finite("mass M_a", self.mass, "kg", 0.0, open_below=True)
        _finite("damping B", self.damping, "N/(m/s)", 0.0)
        _finite("stiffness K", self.stiffness, "N/m", 0.0)
        _finite("rest position q_0", self.rest_position, "m")
        _finite("Coulomb factor", self.coulomb_factor, "", 0.0)
        for name, value in (("filter", self.filter), ("current filter", self.current_filter)):
            if value is not None and (math.isnan(value) or value <= 0.0):
                raise InputError(f"{name}: found {value:g} rad/s, expected more than 0 (inf: unfiltered)")
        if self.current_factor not in (DERIVED, PRINTED):
            raise InputError(f"current factor: found {self.current_factor:g}, expected 1 (derived) or 2 (printed)")
        if self.velocity_estimator not in ("two_tap", "backward"):
            raise InputError(f"velocity estimator: found {self.velocity_estimator!r}, expected two_tap or backward")

    @property
    def ratio(self) -> float:
        """Mh/M_a."""
        return self.estimate.mass / self.mass

    @property
    def filters(self) -> tuple[float, float]:
        """Low-pass of the acceleration and of the current [rad/s]."""
        return self.filter, self.filter if self.current_filter is None else self.current_filter

    @property
    def recursion_gain(self) -> float:
        """Gain of the law's recursion in its own current, kappa (Mh/M_a - 1); 0 with a force sensor."""
        return 0.0 if self.force_sensor else self.current_factor * (self.ratio - 1.0)

    def with_errors(self, errors: dict[str, float]) -> ImpedanceLaw:
        """Return the law with estimates ``(1 + error)`` times its own."""
        return replace(self, estimate=self.estimate.with_errors(errors))

    def check_period(self, period: float) -> None:
        """Refuse filters above the Nyquist frequency pi/period with :class:`InputError`; inf means no filter."""
        for name, value in zip(("filter", "current filter"), self.filters, strict=True):
            if math.isfinite(value) and value >= math.pi / period:
                raise InputError(
                    f"{name}: found {value:g} rad/s, expected less than the Nyquist frequency "
                    f"{math.pi / period:g} rad/s of the {period:g} s sampling; lower it, or give inf for none"
                )

    def motor_force(self, q: float, v: float, a: float, tau: float, tau_e: float | None = None) -> float:
        """Motor force [N] of the continuous law; ``a`` and ``tau`` are what the filters give, ``tau_e`` a sensor's.

        Source: (28) with (29), K and q_0 kept as in (27) derived.
        """
        s = float(np.sign(v))
        e = self.estimate
        f_v = e.viscous_negative if v < 0 else e.viscous_positive
        f_c = self.coulomb_factor * (e.coulomb_negative if v < 0 else e.coulomb_positive)
        if self.force_sensor:
            if tau_e is None:
                raise InputError("tau_e: found none, expected the force sensor's reading [N]")
            observed = tau_e
        else:
            observed = e.mass * a + f_v * v + f_c * s - self.current_factor * tau
        return (
            (self.ratio - 1.0) * observed
            + (f_v - self.ratio * self.damping) * v
            + f_c * s
            - self.ratio * self.stiffness * (q - self.rest_position)
        )

    def apparent(self, plant: FrictionModel, direction: int = 1) -> ApparentImpedance:
        """Apparent impedance on ``plant`` for motion to + or - (``direction`` 1, -1), ideal current loop, no filter.

        With ``D = 1 + kappa (r - 1)``: mass ``M - (r - 1) Mh/D``, damping ``F_v - r (Fh_v - B)/D``, Coulomb left
        ``F_c - r c Fh_c/D``. For kappa = 1, D = r and these are M_a + M - Mh, B + F_v - Fh_v, F_c - c Fh_c.
        """
        r, i = self.ratio, 0 if direction > 0 else 1
        viscous, coulomb = plant.viscous[i], plant.coulomb[i]
        viscous_hat, coulomb_hat = self.estimate.viscous[i], self.coulomb_factor * self.estimate.coulomb[i]
        if self.force_sensor:
            # r tau_e = M qdd + F_v v + F_c s - (Fh_v - r B) v - c Fh_c s
            return ApparentImpedance(
                plant.mass / r, (viscous - viscous_hat) / r + self.damping, (coulomb - coulomb_hat) / r
            )
        d = 1.0 + self.recursion_gain
        if d == 0.0:
            raise InputError("mass M_a: 1 + kappa (Mh/M_a - 1) = 0, the law has no solution with an ideal current loop")
        if self.current_factor == DERIVED:  # D = r, written so that equal numbers cancel exactly
            return ApparentImpedance(
                self.mass + (plant.mass - self.estimate.mass),
                self.damping + (viscous - viscous_hat),
                coulomb - coulomb_hat,
            )
        return ApparentImpedance(
            plant.mass - (r - 1.0) * self.estimate.mass / d,
            viscous - r * (viscous_hat - self.damping) / d,
            coulomb - r * coulomb_hat / d,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; unfiltered is None."""
        acceleration, current = self.filters
        return {
            "mass": self.mass,
            "damping": self.damping,
            "stiffness": self.stiffness,
            "rest_position": self.rest_position,
            "filter": acceleration if math.isfinite(acceleration) else None,
            "current_filter": current if math.isfinite(current) else None,
            "coulomb_factor": self.coulomb_factor,
            "current_factor": self.current_factor,
            "force_sensor": self.force_sensor,
            "velocity_estimator": self.velocity_estimator,
            "estimate": self.estimate.to_dict(),
        }


def default_filter(period: float) -> float:
    """Low-pass for acceleration and current where none is asked for, 0.5/period: 500 rad/s at 1 kHz.

    Slower, the Coulomb compensation hunts (see ``relay_oscillation``); faster, the smallest safe M_a grows.
    """
    return 0.5 / period


def impedance_law(axis: Axis, mass: float, damping: float, filter: float | None = None, **options: Any) -> ImpedanceLaw:
    """Return the law for ``axis`` with the axis's own numbers as estimates.

    ``filter`` [rad/s] None takes the axis's controller's, else :func:`default_filter`. Raises :class:`InputError` for
    impossible numbers and for filters above Nyquist.

    >>> from emps_design.machines import machine
    >>> impedance_law(machine("emps2018"), 50.0, 100.0).filter
    500.0
    """
    if filter is None:
        filter = axis.controller.filter or default_filter(axis.sampling.period)
    options.setdefault("velocity_estimator", axis.controller.velocity_estimator)
    law = ImpedanceLaw(mass, damping, FrictionModel.of(axis), filter=filter, **options)
    law.check_period(axis.sampling.period)
    return law


def left_out(axis: Axis) -> tuple[str, ...]:
    """Kinds of the axis's effects that the friction model X of (5) cannot hold; say so wherever it is used."""
    return tuple(entry.kind for entry in axis.effects if entry.effect.slopes is None)


def _finite(name: str, value: float, unit: str, lower: float = -math.inf, open_below: bool = False) -> None:
    if not math.isfinite(value) or value < lower or (open_below and value == lower):
        if not math.isfinite(value):
            raise InputError(
                f"{name}: found {value:g}, expected a finite number {f'[{unit}]' if unit else ''}".rstrip()
            )
        bound = f"{'more than' if open_below else 'at least'} {lower:g}"
        raise InputError(f"{name}: found {value:g} {unit}".rstrip() + f", expected {bound} {unit}".rstrip())
