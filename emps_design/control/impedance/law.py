"""Impedance control without a force sensor: the law with all its options, and the apparent impedance of the carriage.

Section IV of the 2018 paper, after Hogan; the equations are in :mod:`emps_design.laws.library.impedance`. Plant
``M qdd = tau + tau_e - F_v qd - F_c sign(qd)``. ``kappa = 1`` follows from (28) and (29); ``kappa = 2`` is (30) as
printed. Hats are ``(1 + error)`` times the parameters of the plant, so an error of +2 % is an overestimate.

:class:`EquivalentLoop` is the cascaded force loop (k_e1, k_v1, t_v) that is equivalent to an impedance (M_a, B). The
cascade of Fig. 4 responds to a hand with ``qd = k_e1 T_vc(s) tau_e``, so its impedance is, exactly,

    Z(s) = (1 + (2 z_v/w_0v) s + s^2/w_0v^2) / k_e1        against the target  M_a s + B.

- *low-frequency* match: ``B = 1/k_e1``, ``M_a = 2 z_v/(w_0v k_e1) = B sin(phi_v)/w_v``;
- *least squares* of Z over 0 to 20 rad/s, uniform in frequency: the same M_a per k_e1, and B the mean of the real part
  ``(1 - w^2/w_0v^2)/k_e1``.

The term s^2 has no counterpart, so there is no match at high frequency. From the paper's 100 rad/s, 60 deg and
B = 100 N/(m/s) follows M_a = 0.87 kg: the 50 kg of its experiments are not equivalent to its section II-C.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis
from emps_design.control.sampled import MARGINAL, close
from emps_design.control.velocity.gains import canonical_form, velocity_gains
from emps_design.control.velocity.sampled import velocity_law
from emps_design.errors import InputError, SpecificationError
from emps_design.laws import TWO_TAP, Law
from emps_design.laws.estimators import AnyEstimator, estimator_of
from emps_design.laws.law import FrictionModel
from emps_design.laws.library.impedance import (
    check_filters,
    default_filter,
    demanded_force,
    gains_of,
    law_with,
    observed_force,
)
from emps_design.messages import Message, grave, warning
from emps_design.request import typed

DERIVED, PRINTED = 1.0, 2.0  # factor in front of (Mh/M_a - 1) G_tau_i I_m in (30)
SINGULAR = 1e-9  # 1 + kappa (Mh/M_a - 1), below which the law has no solution with an ideal current loop

LOW_FREQUENCY, LEAST_SQUARES = "low_frequency", "least_squares"
CRITERIA = (LOW_FREQUENCY, LEAST_SQUARES)
BAND = 20.0  # rad/s, the operator's range in section II-C


@dataclass(frozen=True)
class ApparentImpedance:
    """Impedance at the operator's hand in motion: ``tau_e = mass qdd + damping qd + coulomb_left sign(qd)``.

    A negative ``coulomb_left`` drives the carriage instead of resisting.
    """

    mass: float
    damping: float
    coulomb_left: float

    def to_dict(self) -> dict[str, float]:
        """Plain data: apparent_mass [kg], apparent_damping [N/(m/s)], coulomb_left [N]."""
        return {"apparent_mass": self.mass, "apparent_damping": self.damping, "coulomb_left": self.coulomb_left}


@dataclass(frozen=True)
class ImpedanceLaw:
    """The impedance law with all its options; arrays of one shape in place of numbers and estimates give many laws.

    - ``mass`` M_a [kg], ``damping`` B [N/(m/s)], ``stiffness`` K [N/m] about ``rest_position`` q_0 [m];
    - ``estimate``: the parameters that the law uses;
    - ``filter`` [rad/s]: low-pass of acceleration and current (inf: none); ``current_filter``: another one for the
      current (None: the same);
    - ``coulomb_factor`` c: scales the Coulomb compensation; ``current_factor``: ``DERIVED`` or ``PRINTED``;
    - ``reference_velocity`` qd_0 [m/s] of (25), the velocity of q_0;
    - ``force_sensor``: use a measured tau_e instead of (29).

    Raises :class:`InputError` for parameters out of range, such as M_a <= 0 or B < 0.

    >>> plant = FrictionModel(115.7315, 474.9727, 474.9727, 17.3811, 17.3811)
    >>> law = ImpedanceLaw(50.0, 100.0, plant)
    >>> law.apparent(plant).to_dict()
    {'apparent_mass': 50.0, 'apparent_damping': 100.0, 'coulomb_left': 0.0}
    """

    mass: Any
    damping: Any
    estimate: FrictionModel
    stiffness: Any = 0.0
    rest_position: float = 0.0
    filter: Any = math.inf
    current_filter: Any = None
    coulomb_factor: float = 1.0
    current_factor: float = DERIVED
    force_sensor: bool = False
    velocity_estimator: AnyEstimator = TWO_TAP
    reference_velocity: float = 0.0

    def __post_init__(self) -> None:
        _finite("M_a", self.mass, 0.0, open_below=True)
        _finite("damping B", self.damping, 0.0)
        _finite("stiffness K", self.stiffness, 0.0)
        _finite("rest position q_0", self.rest_position)
        _finite("reference velocity qd_0", self.reference_velocity)
        _finite("Coulomb factor", self.coulomb_factor, 0.0)
        for name, value in (("filter", self.filter), ("current filter", self.current_filter)):
            if value is not None and not (good := np.greater(value, 0.0)).all():
                found = np.extract(~good, value)[0]
                raise InputError(f"{name}: found {found:g} rad/s, expected more than 0 (inf: unfiltered)")
        if self.current_factor not in (DERIVED, PRINTED):
            raise InputError(f"current factor: found {self.current_factor:g}, expected 1 (derived) or 2 (printed)")
        estimator_of(self.velocity_estimator)

    @property
    def ratio(self) -> Any:
        """Mh/M_a."""
        return self.estimate.mass / self.mass

    @property
    def filters(self) -> tuple[Any, Any]:
        """Low-pass of the acceleration and of the current [rad/s]."""
        return self.filter, self.filter if self.current_filter is None else self.current_filter

    @property
    def recursion_gain(self) -> Any:
        """Gain of the recursion in the law's current, kappa (Mh/M_a - 1); 0 with a force sensor."""
        return 0.0 if self.force_sensor else self.current_factor * (self.ratio - 1.0)

    def at_singularity(self, current_factor: float) -> bool:
        """Whether (30) with that ``current_factor`` has no solution because the current of the law cancels.

        As printed this is the case for M_a = 2 Mh, as derived never.
        """
        return not self.force_sensor and bool(np.any(np.abs(1.0 + current_factor * (self.ratio - 1.0)) < SINGULAR))

    def with_errors(self, errors: dict[str, Any]) -> ImpedanceLaw:
        """Return the law with ``(1 + error)`` times its estimates; errors (m,) give m laws."""
        return replace(self, estimate=self.estimate.with_errors(errors))

    def check_period(self, period: float) -> None:
        """Raise :class:`InputError` for a filter above the Nyquist frequency pi/period; inf means no filter."""
        check_filters(period, *self.filters)

    def motor_force(self, q: float, v: float, a: float, tau: float, tau_e: float | None = None) -> float:
        """Motor force [N] of the continuous law by (27) with (29), q_0 at its initial position.

        ``a`` [m/s^2] and ``tau`` [N] are filtered; ``tau_e`` [N] is the reading of a force sensor.
        """
        i, s = int(v < 0), float(np.sign(v))
        e, coulomb = self.estimate, s * self.coulomb_factor * self.estimate.coulomb[i]
        if self.force_sensor:
            if tau_e is None:
                raise InputError("tau_e: found none, expected the reading of the force sensor")
        else:
            tau_e = observed_force(e.mass, e.viscous[i], coulomb, self.current_factor, a, v, tau)
        away = q - self.rest_position
        return demanded_force(
            self.ratio, self.damping, self.stiffness, e.viscous[i], coulomb, v, away, tau_e,
            self.reference_velocity, self.current_factor - 1.0,
        )  # fmt: skip

    def apparent(self, plant: FrictionModel, direction: int = 1) -> ApparentImpedance:
        """Apparent impedance on ``plant`` for motion to + or - (``direction`` 1, -1), ideal current loop, no filter.

        With ``D = 1 + kappa (r - 1)``: mass ``M - (r - 1) Mh/D``, damping ``F_v - r (Fh_v - B)/D``, remaining Coulomb
        friction ``F_c - r c Fh_c/D``. For kappa = 1, D = r and these are M_a + M - Mh, B + F_v - Fh_v, F_c - c Fh_c.
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
            raise InputError("M_a: 1 + kappa (Mh/M_a - 1) = 0, the law has no solution with an ideal current loop")
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


@typed
def impedance_law(axis: Axis, mass: float, damping: float, filter: float | None = None, **options: Any) -> ImpedanceLaw:
    """Return the law for ``axis`` with the parameters of the axis as estimates.

    ``filter`` [rad/s] defaults to that of the axis's controller, else to :func:`default_filter`. Raises
    :class:`InputError` for numbers out of range and for filters above Nyquist.

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
    """Return ``law`` as a controller of ``axis`` at a sampling ``period`` [s], for ``Plant.closed_loop(law=...)``.

    Many laws have one row of gains each.

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
    gains = gains_of(law, period, axis.drive.gain, axis.drive.current_time_constant, delay)
    return law_with(np.stack(np.broadcast_arrays(*gains), axis=-1).astype(float), delay)


def _finite(name: str, values: Any, lower: float = -math.inf, open_below: bool = False) -> None:
    good = np.isfinite(values) & (np.greater(values, lower) if open_below else np.greater_equal(values, lower))
    for value in () if good.all() else np.extract(~good, values):
        if not math.isfinite(value):
            raise InputError(f"{name}: found {value:g}, expected a finite number")
        bound = f"{'more than' if open_below else 'at least'} {lower:g}"
        raise InputError(f"{name}: found {value:g}, expected {bound}")


@dataclass(frozen=True)
class EquivalentLoop:
    """A cascaded loop and its equivalent impedance, by one criterion.

    ``error(omega)`` is the relative error of its impedance; ``warnings`` say why the equivalent may be unsafe.
    """

    mass: float
    damping: float
    k_e1: float
    k_v1: float | None
    t_v: float | None
    omega_0v: float
    z_v: float
    crossover: float
    phase_margin_deg: float
    criterion: str
    largest_pole: float | None = None
    warnings: tuple[Message, ...] = ()

    @property
    def stable(self) -> bool:
        """Whether there are such gains and the sampled velocity loop with them is stable without an operator."""
        return self.largest_pole is not None and self.largest_pole <= 1.0 + MARGINAL

    def impedance(self, omega: np.ndarray) -> np.ndarray:
        """Impedance of the cascade at ``omega`` [rad/s], complex [N/(m/s)]."""
        s = 1j * np.asarray(omega, dtype=float)
        return (1.0 + 2.0 * self.z_v / self.omega_0v * s + (s / self.omega_0v) ** 2) / self.k_e1

    def error(self, omega: np.ndarray) -> np.ndarray:
        """Relative error of the cascade's impedance against ``M_a s + B`` at ``omega`` [rad/s]."""
        target = 1j * np.asarray(omega, dtype=float) * self.mass + self.damping
        return np.abs(self.impedance(omega) / target - 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Gains (None if there are no positive ones), criterion, and the error at a few frequencies."""
        omega = np.array([1.0, 2.0, 5.0, 10.0, BAND])
        return {
            "k_e1": self.k_e1,
            "criterion": self.criterion,
            "k_v1": self.k_v1,
            "t_v": self.t_v,
            "crossover": self.crossover,
            "phase_margin_deg": self.phase_margin_deg,
            "omega_0v": self.omega_0v,
            "z_v": self.z_v,
            "apparent_mass": self.mass,
            "apparent_damping": self.damping,
            "sampled": {"stable": self.stable, "largest_pole": self.largest_pole},
            "error": {"omega": omega.tolist(), "relative": self.error(omega).tolist()},
            "warnings": list(self.warnings),
        }


def equivalent_impedance(
    axis: Axis,
    k_e1: float,
    crossover: float,
    phase_margin_deg: float,
    criterion: str = LOW_FREQUENCY,
    mismatch: float = 0.02,
) -> EquivalentLoop:
    """Return the impedance equivalent to a cascade with k_e1 [(m/s)/N], w_v [rad/s] and phi_v [deg].

    >>> from emps_design.machines import machine
    >>> loop = equivalent_impedance(machine("emps2018"), 0.01, 100.0, 60.0)
    >>> round(loop.mass, 2), loop.damping
    (0.87, 100.0)
    """
    if not math.isfinite(k_e1) or k_e1 <= 0.0:
        raise InputError(f"k_e1: found {axis.units.quantity(k_e1, '(m/s)/N', 'g')}, expected more than 0")
    w0, z = map(float, canonical_form(crossover, phase_margin_deg))
    damping = 1.0 / k_e1 if _checked_criterion(criterion) == LOW_FREQUENCY else (1.0 - BAND**2 / (3.0 * w0**2)) / k_e1
    return _loop(axis, 2.0 * z / (w0 * k_e1), damping, k_e1, w0, criterion, mismatch)


def equivalent_loop(
    axis: Axis,
    mass: float,
    damping: float,
    criterion: str = LOW_FREQUENCY,
    input_crossover: float | None = None,
    mismatch: float = 0.02,
) -> EquivalentLoop:
    """Return the cascade equivalent to M_a [kg] and B [N/(m/s)].

    Two numbers do not determine three gains. ``input_crossover``, ``k_v1 G_tau/M`` [rad/s] of the loop at the plant
    input, sets the third (default 0.5/period); the faster, the smaller the error. Raises :class:`SpecificationError`
    for B = 0, which has no equivalent.

    >>> from emps_design.machines import machine
    >>> loop = equivalent_loop(machine("emps2018"), 50.0, 100.0)
    >>> loop.k_e1, round(float(loop.error([20.0])[0]), 2)
    (0.01, 0.04)
    """
    if not mass > 0.0 or not math.isfinite(mass) or damping < 0.0 or not math.isfinite(damping):
        found = f"{axis.units.quantity(mass, 'kg', 'g')}, {axis.units.quantity(damping, 'N/(m/s)', 'g')}"
        raise InputError(f"M_a, B: found {found}, expected M_a > 0 and B >= 0")
    if damping == 0.0:
        raise SpecificationError("damping B: found 0; a cascade has 1/k_e1 = B, expected more than 0")
    plant = FrictionModel.of(axis)
    speed = default_filter(axis.sampling.period) if input_crossover is None else input_crossover
    rate = speed + plant.viscous_positive / plant.mass  # 2 z_v w_0v
    k_e1 = 1.0 / damping
    w0 = math.sqrt(rate / (mass * k_e1))
    if _checked_criterion(criterion) == LEAST_SQUARES:
        # k_e1 = (1 - BAND^2/(3 w0^2))/B with w0^2 = rate/(M_a k_e1): linear in k_e1.
        k_e1 = 1.0 / (damping + BAND**2 * mass / (3.0 * rate))
        w0 = math.sqrt(rate / (mass * k_e1))
    return _loop(axis, mass, damping, k_e1, w0, criterion, mismatch)


def safety_words(axis: Axis, mass: float, damping: float, mismatch: float) -> tuple[Message, ...]:
    """Return messages if an impedance is within the error of the model: necessary are M_a > e M and B > e F_v.

    >>> from emps_design.machines import machine
    >>> safety_words(machine("emps2018"), 50.0, 100.0, 0.02)
    ()
    >>> safety_words(machine("emps2018"), 50.0, 1.0, 0.02)[0].partition(",")[0]
    'not safe: B = 1 N/(m/s) is within the 2 % error of F_v'
    """
    plant, shown = FrictionModel.of(axis), axis.units.quantity
    messages = []
    if mass <= mismatch * plant.mass:
        text = (
            f"not safe: M_a = {shown(mass, 'kg', '.3g')} is within the {100 * mismatch:g} % error of M, "
            f"{shown(mismatch * plant.mass, 'kg', '.3g')}; at the worst corner the apparent {axis.units.word('mass')} "
            "is negative"
        )
        messages.append(warning("mass-within-error", text, mass=mass, mismatch=mismatch))
    if damping <= mismatch * max(plant.viscous):
        text = (
            f"not safe: B = {shown(damping, 'N/(m/s)', '.3g')} is within the {100 * mismatch:g} % error of F_v, "
            f"{shown(mismatch * max(plant.viscous), 'N/(m/s)', '.3g')}; at the worst corner the apparent damping is "
            "negative"
        )
        messages.append(warning("damping-within-error", text, damping=damping, mismatch=mismatch))
    return tuple(messages)


def _loop(
    axis: Axis, mass: float, damping: float, k_e1: float, w0: float, criterion: str, mismatch: float
) -> EquivalentLoop:
    # 2 z/w0 = sin(phi)/w_v and w0^2 = w_v^2/cos(phi) give (1 - c^2)/c = x for c = cos(phi), x = (w0 M_a k_e1)^2.
    lag = mass * k_e1
    x = (w0 * lag) ** 2
    cosine = 2.0 / (x + math.sqrt(x * x + 4.0))
    phase, crossover = math.degrees(math.acos(cosine)), w0 * math.sqrt(cosine)
    plant = FrictionModel.of(axis)
    messages = list(safety_words(axis, mass, damping, mismatch))
    gains: tuple[float | None, float | None]
    try:
        gains = velocity_gains(plant.mass, plant.viscous_positive, axis.drive.gain, crossover, phase)
    except SpecificationError as error:
        gains = None, None
        messages.append(grave("no-such-loop", f"no such loop: {error}"))
    pole = None
    if gains[0] is not None and gains[1] is not None:
        sampled = sample_axis(axis)
        pole = close(sampled, velocity_law(sampled, gains[0], gains[1])).radius
        if pole > 1.0 + MARGINAL:
            at_input = gains[0] * axis.drive.gain / plant.mass
            text = (
                f"not for this drive: the sampled velocity loop would be unstable, largest pole {pole:.4g}; use a "
                f"crossover at the plant input below {at_input:.4g} rad/s"
            )
            messages.append(grave("not-for-this-drive", text, pole=pole))
    if w0 < BAND:
        text = f"the resonance of the cascade, {w0:.3g} rad/s, is within the operator's band of {BAND:g} rad/s"
        messages.append(warning("resonance-in-band", text, resonance=w0))
    return EquivalentLoop(
        mass, damping, k_e1, gains[0], gains[1], w0, 0.5 * lag * w0, crossover, phase, criterion, pole, tuple(messages)
    )


def _checked_criterion(criterion: str) -> str:
    if criterion not in CRITERIA:
        raise InputError(f"criterion: found {criterion!r}, expected one of {', '.join(CRITERIA)}")
    return criterion
