"""Closed forms of the velocity loop: gains from a specification, (7), and what follows from it alone, (9).

Where nothing is refused, arrays (n,) in the place of numbers give as many answers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from emps_design.errors import SpecificationError

MINUS_3_DB = 10.0 ** (-3.0 / 20.0)


def feasible_phase_margin(mass: float, viscous: float, crossover: Any) -> tuple[Any, float]:
    """Return the open interval of phase margins [deg] that (7) can give at ``crossover`` [rad/s].

    Below atan(F_v / (M w)) the gain k_v1 would be negative, at 90 deg infinite. ``mass`` [kg], ``viscous`` [N/(m/s)].

    >>> low, high = feasible_phase_margin(115.7315, 474.9727, 100.0)
    >>> round(float(low), 3), high
    (2.35, 90.0)
    """
    return np.degrees(np.arctan2(viscous, mass * crossover))[()], 90.0


def velocity_gains(
    mass: float, viscous: float, force_gain: float, crossover: float, phase_margin_deg: float
) -> tuple[float, float]:
    """Return k_v1 [V/(m/s)] and t_v [s] that put the crossover and the phase margin of T_vo where asked, (7).

    ``mass`` [kg], ``viscous`` [N/(m/s)], ``force_gain`` [N/V], ``crossover`` [rad/s], ``phase_margin_deg`` [deg]
    inside :func:`feasible_phase_margin`; :class:`SpecificationError` outside.

    >>> k_v1, t_v = velocity_gains(115.7315, 474.9727, 35.15, 100.0, 60.0)
    >>> round(k_v1, 3), round(t_v, 8)
    (556.766, 0.00845505)
    """
    low, high = feasible_phase_margin(mass, viscous, crossover)
    if not low < phase_margin_deg < high:
        raise SpecificationError(
            f"phase margin: found {phase_margin_deg:g} deg at a crossover of {crossover:g} rad/s, expected more than "
            f"{low:.4g} and less than {high:g} deg; {binding_limit(phase_margin_deg)}",
            {"crossover": crossover, "phase_margin_deg": min(max(phase_margin_deg, low + 0.5), 89.5)},
        )
    gain, t_v = plant_input_gain(mass, viscous, crossover, phase_margin_deg)
    return float(gain) / force_gain, float(t_v)


def plant_input_gain(mass: float, viscous: float, crossover: Any, phase_margin_deg: Any) -> tuple[Any, Any]:
    """Return K = k_v1 G_tau [N/(m/s)] and t_v [s] by (7), positive or not.

    >>> [round(float(x), 5) for x in plant_input_gain(2.0, 1.0, 10.0, 45.0)]
    [19.0, 0.06718]
    """
    phase = np.radians(phase_margin_deg)
    gain = mass * crossover * np.tan(phase) - viscous
    return gain, gain * np.cos(phase) / (mass * crossover**2)


def canonical_form(crossover: Any, phase_margin_deg: Any) -> tuple[Any, Any]:
    """Return omega_0v [rad/s] and z_v [-] of (9); they depend on the specification alone, not on the machine.

    >>> w0, z = canonical_form(100.0, 60.0)
    >>> round(float(w0), 2), round(float(z), 5)
    (141.42, 0.61237)
    """
    phase = np.radians(phase_margin_deg)
    root = np.sqrt(np.cos(phase))
    return crossover / root, np.sin(phase) / (2.0 * root)


def second_order_form(mass: Any, viscous: Any, K: Any, t_v: Any) -> tuple[Any, Any]:
    """Return omega_0v [rad/s] and z_v [-] of (9) from the gains, K = k_v1 G_tau [N/(m/s)] and t_v [s].

    >>> [round(float(x), 4) for x in second_order_form(115.7315, 474.9727, 556.766 * 35.15, 8.45505e-3)]
    [141.4214, 0.6124]
    """
    omega_0v = np.sqrt(K / t_v / mass)
    return omega_0v, 0.5 * (t_v + viscous * t_v / K) * omega_0v


def second_order_bandwidth(omega_0v: Any, z_v: Any, zero: Any = 0.0) -> Any:
    """Return the frequency [rad/s] where (9), times 1 + ``zero`` s [s], has fallen to -3 dB, the ratio 10^(-3/20).

    >>> round(float(second_order_bandwidth(*canonical_form(100.0, 60.0))), 2)
    159.9
    """
    # |T_vc| = 10^(-3/20): x^2 - 2 (1 - 2 z^2) x + 1 = 10^(3/10) (1 + (zero w_0v)^2 x) with x = (w/w_0v)^2
    slope = 4.0 * z_v**2 - 2.0 - (zero * omega_0v / MINUS_3_DB) ** 2
    return omega_0v * np.sqrt(positive_root(1.0, slope, 1.0 - MINUS_3_DB**-2))


def positive_root(a: Any, b: Any, c: Any) -> Any:
    """Return the positive root of a x^2 + b x + c = 0 with a > 0 > c, without cancellation.

    >>> float(positive_root(1.0, 1.0, -6.0)), float(positive_root(1.0, -1.0, -6.0))
    (2.0, 3.0)
    """
    root = np.sqrt(b * b - 4.0 * a * c)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(b >= 0.0, -2.0 * c / (b + root), (root - b) / (2.0 * a))[()]


def crossover_of_bandwidth(bandwidth: Any, phase_margin_deg: Any) -> Any:
    """Return the crossover [rad/s] whose closed loop has the -3 dB ``bandwidth`` [rad/s] at that phase margin.

    >>> round(float(crossover_of_bandwidth(159.898, 60.0)), 2)
    100.0
    """
    return bandwidth / second_order_bandwidth(*canonical_form(1.0, phase_margin_deg))


def binding_limit(phase_margin_deg: float) -> str:
    """Say which end of the feasible range a phase margin [deg] outside it violates.

    >>> binding_limit(90.0)
    'the upper limit binds, at 90 deg k_v1 is infinite'
    """
    if phase_margin_deg >= 90.0:
        return "the upper limit binds, at 90 deg k_v1 is infinite"
    return "the lower limit binds, below atan(F_v/(M w)) k_v1 is not positive"
