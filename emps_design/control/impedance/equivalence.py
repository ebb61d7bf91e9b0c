"""Which cascaded force loop (k_e1, k_v1, t_v) feels like which impedance (M_a, B), and how well.

The cascade of Fig. 4 answers a hand with ``qd = k_e1 T_vc(s) tau_e``, so its impedance is, exactly,

    Z(s) = (1 + (2 z_v/w_0v) s + s^2/w_0v^2) / k_e1        against the target  M_a s + B.

- *low-frequency* match: ``B = 1/k_e1``, ``M_a = 2 z_v/(w_0v k_e1) = B sin(phi_v)/w_v``;
- *least squares* of Z over 0 to 20 rad/s, uniform in frequency: the same M_a per k_e1, and B where the mean of the
  real part ``(1 - w^2/w_0v^2)/k_e1`` lies.

The term s^2 has no counterpart, so no match exists at high frequency. From the paper's own 100 rad/s, 60 deg and
B = 100 N/(m/s) follows M_a = 0.87 kg: the 50 kg of its experiments are not the equivalent of its section II-C.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance.law import FrictionModel, default_filter
from emps_design.control.loop.sampled_loop import MARGINAL, close
from emps_design.control.plant.discretisation import sample_axis
from emps_design.control.velocity.gains import canonical_form, velocity_gains
from emps_design.control.velocity.sampled import velocity_law
from emps_design.errors import InputError, SpecificationError

LOW_FREQUENCY, LEAST_SQUARES = "low_frequency", "least_squares"
CRITERIA = (LOW_FREQUENCY, LEAST_SQUARES)
BAND = 20.0  # rad/s, the operator's range in section II-C


@dataclass(frozen=True)
class EquivalentLoop:
    """A cascaded loop and the impedance it stands for, by one criterion.

    ``error(omega)`` is the relative error of its impedance; ``warnings`` say when the equivalent is not safe.
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
    warnings: tuple[str, ...] = ()

    @property
    def stable(self) -> bool:
        """Whether there are such gains and the sampled velocity loop with them is stable, with nobody at the hand."""
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
        """Gains (None where no positive ones exist), criterion, and the error at a few frequencies."""
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
    """Return the impedance that a cascade of given k_e1 [(m/s)/N], w_v [rad/s] and phi_v [deg] stands for.

    >>> from emps_design.machines import machine
    >>> found = equivalent_impedance(machine("emps2018"), 0.01, 100.0, 60.0)
    >>> round(found.mass, 2), found.damping
    (0.87, 100.0)
    """
    if not math.isfinite(k_e1) or k_e1 <= 0.0:
        raise InputError(f"k_e1: found {k_e1:g} (m/s)/N, expected more than 0")
    w0, z = map(float, canonical_form(crossover, phase_margin_deg))
    damping = 1.0 / k_e1 if _known(criterion) == LOW_FREQUENCY else (1.0 - BAND**2 / (3.0 * w0**2)) / k_e1
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

    Two numbers leave one of three gains free: it is set by ``input_crossover`` ``k_v1 G_tau/M`` [rad/s], how fast the
    loop at the plant input may be (default 0.5/period); the faster, the smaller the error. B = 0 has no equivalent:
    :class:`SpecificationError`.

    >>> from emps_design.machines import machine
    >>> loop = equivalent_loop(machine("emps2018"), 50.0, 100.0)
    >>> loop.k_e1, round(float(loop.error([20.0])[0]), 2)
    (0.01, 0.04)
    """
    if not mass > 0.0 or not math.isfinite(mass) or damping < 0.0 or not math.isfinite(damping):
        raise InputError(f"mass, damping: found {mass:g} kg, {damping:g} N/(m/s), expected M_a > 0 and B >= 0")
    if damping == 0.0:
        raise SpecificationError("damping B: found 0 N/(m/s); a cascade has 1/k_e1 = B, expected more than 0")
    plant = FrictionModel.of(axis)
    speed = default_filter(axis.sampling.period) if input_crossover is None else input_crossover
    rate = speed + plant.viscous_positive / plant.mass  # 2 z_v w_0v
    k_e1 = 1.0 / damping
    w0 = math.sqrt(rate / (mass * k_e1))
    if _known(criterion) == LEAST_SQUARES:
        # k_e1 = (1 - BAND^2/(3 w0^2))/B with w0^2 = rate/(M_a k_e1): linear in k_e1.
        k_e1 = 1.0 / (damping + BAND**2 * mass / (3.0 * rate))
        w0 = math.sqrt(rate / (mass * k_e1))
    return _loop(axis, mass, damping, k_e1, w0, criterion, mismatch)


def safety_words(axis: Axis, mass: float, damping: float, mismatch: float) -> tuple[str, ...]:
    """Say when an impedance is inside the error of the model: necessary are M_a > e M and B > e F_v.

    >>> from emps_design.machines import machine
    >>> safety_words(machine("emps2018"), 50.0, 100.0, 0.02)
    ()
    >>> safety_words(machine("emps2018"), 50.0, 1.0, 0.02)[0].partition(",")[0]
    'not safe: B = 1 N/(m/s) is within the 2 % error of F_v'
    """
    plant = FrictionModel.of(axis)
    words = []
    if mass <= mismatch * plant.mass:
        words.append(
            f"not safe: M_a = {mass:.3g} kg is within the {100 * mismatch:g} % error of M, "
            f"{mismatch * plant.mass:.3g} kg; at the bad corner the apparent mass is negative"
        )
    if damping <= mismatch * max(plant.viscous):
        words.append(
            f"not safe: B = {damping:.3g} N/(m/s) is within the {100 * mismatch:g} % error of F_v, "
            f"{mismatch * max(plant.viscous):.3g} N/(m/s); at the bad corner the apparent damping is negative"
        )
    return tuple(words)


def _loop(
    axis: Axis, mass: float, damping: float, k_e1: float, w0: float, criterion: str, mismatch: float
) -> EquivalentLoop:
    # 2 z/w0 = sin(phi)/w_v and w0^2 = w_v^2/cos(phi) give (1 - c^2)/c = x for c = cos(phi), x = (w0 M_a k_e1)^2.
    lag = mass * k_e1
    x = (w0 * lag) ** 2
    cosine = 2.0 / (x + math.sqrt(x * x + 4.0))
    phase, crossover = math.degrees(math.acos(cosine)), w0 * math.sqrt(cosine)
    plant = FrictionModel.of(axis)
    words = list(safety_words(axis, mass, damping, mismatch))
    gains: tuple[float | None, float | None]
    try:
        gains = velocity_gains(plant.mass, plant.viscous_positive, axis.drive.gain, crossover, phase)
    except SpecificationError as error:
        gains = None, None
        words.append(f"no such loop: {error}")
    pole = None
    if gains[0] is not None and gains[1] is not None:
        sampled = sample_axis(axis)
        pole = close(sampled, velocity_law(sampled, gains[0], gains[1])).radius
        if pole > 1.0 + MARGINAL:
            at_input = gains[0] * axis.drive.gain / plant.mass
            words.append(
                f"not for this drive: its sampled velocity loop would be unstable, largest pole {pole:.4g}; "
                f"give an input crossover below its {at_input:.4g} rad/s"
            )
    if w0 < BAND:
        words.append(f"the cascade's own resonance, {w0:.3g} rad/s, lies inside the operator's {BAND:g} rad/s")
    return EquivalentLoop(
        mass, damping, k_e1, gains[0], gains[1], w0, 0.5 * lag * w0, crossover, phase, criterion, pole, tuple(words)
    )


def _known(criterion: str) -> str:
    if criterion not in CRITERIA:
        raise InputError(f"criterion: found {criterion!r}, expected one of {', '.join(CRITERIA)}")
    return criterion
