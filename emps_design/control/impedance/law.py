"""Impedance control without a force sensor: the law with all its options, and what the carriage then feels like.

Section IV of the 2018 paper, after Hogan; the equations stand in :mod:`emps_design.laws.library.impedance`. Plant
``M qdd = tau + tau_e - F_v qd - F_c sign(qd)``. ``kappa = 1`` is what (28) and (29) give; ``kappa = 2`` is (30) as
printed. Hats are ``(1 + error)`` times the plant's numbers, so an error of +2 % is an over-estimate.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError
from emps_design.laws import TWO_TAP, Law
from emps_design.laws.estimators import estimator_of
from emps_design.laws.friction_model import FrictionModel
from emps_design.laws.library.impedance import (
    check_filters,
    default_filter,
    demanded_force,
    gains_of,
    law_with,
    observed_force,
)

DERIVED, PRINTED = 1.0, 2.0  # factor in front of (Mh/M_a - 1) G_tau_i I_m in (30)
SINGULAR = 1e-9  # 1 + kappa (Mh/M_a - 1), below which the law has no solution with an ideal current loop


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
        return {"apparent_mass": self.mass, "apparent_damping": self.damping, "coulomb_left": self.coulomb_left}


@dataclass(frozen=True)
class ImpedanceLaw:
    """The impedance law with everything that decides how it behaves, or many that differ in their estimates.

    ``mass`` M_a [kg], ``damping`` B [N/(m/s)], ``estimate`` the law's X, ``stiffness`` K [N/m] about
    ``rest_position`` q_0 [m]; ``filter`` [rad/s] low-passes acceleration and current alike (inf: none),
    ``current_filter`` another one for the current alone (None: the same); ``coulomb_factor`` c scales the Coulomb
    compensation; ``current_factor`` is ``DERIVED`` or ``PRINTED``; ``reference_velocity`` qd_0 [m/s] of (25), with
    which q_0 moves; ``force_sensor`` puts a measured tau_e in the place of (29).
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
    velocity_estimator: Any = TWO_TAP
    reference_velocity: float = 0.0

    def __post_init__(self) -> None:
        _finite("mass M_a", self.mass, "kg", 0.0, open_below=True)
        _finite("damping B", self.damping, "N/(m/s)", 0.0)
        _finite("stiffness K", self.stiffness, "N/m", 0.0)
        _finite("rest position q_0", self.rest_position, "m")
        _finite("reference velocity qd_0", self.reference_velocity, "m/s")
        _finite("Coulomb factor", self.coulomb_factor, "", 0.0)
        for name, value in (("filter", self.filter), ("current filter", self.current_filter)):
            if value is not None and (math.isnan(value) or value <= 0.0):
                raise InputError(f"{name}: found {value:g} rad/s, expected more than 0 (inf: unfiltered)")
        if self.current_factor not in (DERIVED, PRINTED):
            raise InputError(f"current factor: found {self.current_factor:g}, expected 1 (derived) or 2 (printed)")
        estimator_of(self.velocity_estimator)

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

    def at_singularity(self, current_factor: float) -> bool:
        """Whether (30) with that ``current_factor`` has no solution: the law's current cancels itself.

        As printed that is so at M_a = 2 Mh; as derived never.
        """
        return not self.force_sensor and bool(np.any(np.abs(1.0 + current_factor * (self.ratio - 1.0)) < SINGULAR))

    def with_errors(self, errors: dict[str, Any]) -> ImpedanceLaw:
        """Return the law with estimates ``(1 + error)`` times its own; errors (m,) make it m laws."""
        return replace(self, estimate=self.estimate.with_errors(errors))

    def check_period(self, period: float) -> None:
        """Refuse filters above the Nyquist frequency pi/period with :class:`InputError`; inf means no filter."""
        check_filters(period, *self.filters)

    def motor_force(self, q: float, v: float, a: float, tau: float, tau_e: float | None = None) -> float:
        """Motor force [N] of the continuous law; ``a`` and ``tau`` are what the filters give, ``tau_e`` a sensor's.

        Source: (27) with (29), q_0 where it is at the start.
        """
        i, s = int(v < 0), float(np.sign(v))
        e, coulomb = self.estimate, s * self.coulomb_factor * self.estimate.coulomb[i]
        if self.force_sensor:
            if tau_e is None:
                raise InputError("tau_e: found none, expected the force sensor's reading [N]")
        else:
            tau_e = observed_force(e.mass, e.viscous[i], coulomb, self.current_factor, a, v, tau)
        away = q - self.rest_position
        return demanded_force(
            self.ratio, self.damping, self.stiffness, e.viscous[i], coulomb, v, away, tau_e,
            self.reference_velocity, self.current_factor - 1.0,
        )  # fmt: skip

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
        if self.at_singularity(self.current_factor):
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
            **asdict(self),
            "filter": acceleration if math.isfinite(acceleration) else None,
            "current_filter": current if math.isfinite(current) else None,
        }


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


def law_for(axis: Axis, law: ImpedanceLaw, period: float) -> Law:
    """``law`` as a controller of ``axis`` at a sampling ``period`` [s], for ``Plant.closed_loop(law=...)``.

    Many laws have a row of gains each.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.plant import Plant
    >>> axis = machine("emps2018")
    >>> law = law_for(axis, impedance_law(axis, 50.0, 100.0), 1e-3)
    >>> run = Plant.of(axis).closed_loop(np.zeros(500), disturbance=np.full(500, 40.0), law=law)
    >>> 0.2 < float(run.v[-1]) < 0.3
    True
    """
    law.check_period(period)
    delay = axis.sampling.computation_delay
    gains = gains_of(
        law.estimate, law.mass, law.damping, law.filters, period, law.velocity_estimator, stiffness=law.stiffness,
        coulomb_factor=law.coulomb_factor, current_factor=law.current_factor, force_sensor=law.force_sensor,
        force_gain=axis.drive.gain, current_time_constant=axis.drive.current_time_constant, delay=delay,
        reference_velocity=law.reference_velocity,
    )  # fmt: skip
    return law_with(np.stack(np.broadcast_arrays(*gains), axis=-1).astype(float), delay)


def _finite(name: str, value: float, unit: str, lower: float = -math.inf, open_below: bool = False) -> None:
    if not math.isfinite(value) or value < lower or (open_below and value == lower):
        if not math.isfinite(value):
            raise InputError(
                f"{name}: found {value:g}, expected a finite number {f'[{unit}]' if unit else ''}".rstrip()
            )
        bound = f"{'more than' if open_below else 'at least'} {lower:g}"
        raise InputError(f"{name}: found {value:g} {unit}".rstrip() + f", expected {bound} {unit}".rstrip())
