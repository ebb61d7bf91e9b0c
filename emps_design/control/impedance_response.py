"""What the hand meets at each frequency: the impedance of the sampled loop, and its error against the target."""

from __future__ import annotations

from typing import Any

import numpy as np

from emps_design.control.impedance_sampled import FREE, Clock, Environment, plant_step


def impedance_response(
    n: dict[str, Any],
    clock: Clock,
    omega: np.ndarray,
    velocity_estimator: str = "two_tap",
    force_sensor: bool = False,
    environment: Environment = FREE,
) -> np.ndarray:
    """Impedance tau_e/velocity of many sampled loops (m,) at ``omega`` (w,) [rad/s] -> (m, w) complex [N/(m/s)].

    The z-transform of the recursions above, solved by hand; the same numbers as ``1/SampledLoop.admittance``.
    """
    keys = list(n)
    hand = (environment.mass, environment.damping, environment.stiffness)
    values = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, dtype=float)) for x in (*n.values(), *hand)))
    flat = dict(zip(keys, values, strict=False))
    p = {name: value[:, None] for name, value in flat.items()}
    mass_e, damping_e, stiffness_e = values[len(keys) :]
    period, lag = clock.period, clock.current_time_constant
    step = plant_step(flat["mass"] + mass_e, flat["viscous"] + damping_e, stiffness_e, lag, period)[:, :, :, None]
    z = np.exp(1j * np.asarray(omega, dtype=float) * period)[None, :]
    # q and v from command and held force, through tau = g c: (z - A) [q, v] = b_c c + b_e tau_e.
    g = step[:, 2, 3] / (z - step[:, 2, 2])
    a11, a12, a21, a22 = z - step[:, 0, 0], -step[:, 0, 1], -step[:, 1, 0], z - step[:, 1, 1]
    determinant = a11 * a22 - a12 * a21
    q_c, v_c = step[:, 0, 3] + step[:, 0, 2] * g, step[:, 1, 3] + step[:, 1, 2] * g
    q_e, v_e = step[:, 0, 4], step[:, 1, 4]
    from_c = (a22 * q_c - a12 * v_c) / determinant
    from_e = (a22 * q_e - a12 * v_e) / determinant

    r = p["mass_hat"] / p["apparent_mass"]
    taps = (1.0 - z**-2) / (2.0 * period) if velocity_estimator == "two_tap" else (1.0 - 1.0 / z) / period
    late = z ** -float(clock.delay)
    if force_sensor:
        of_q = (p["viscous_hat"] - r * p["damping"]) * taps - r * p["stiffness"]
        of_c, of_e = 0.0, r - 1.0
    else:
        slow_a, slow_tau = (
            (1.0 - al) / (1.0 - al / z) for al in (np.exp(-p["filter"] * period), np.exp(-p["current_filter"] * period))
        )
        slope = taps * (1.0 - 1.0 / z) / period
        of_q = (
            (r - 1.0) * p["mass_hat"] * slow_a * slope
            + r * (p["viscous_hat"] - p["damping"]) * taps
            - r * p["stiffness"]
        )
        of_c, of_e = -p["current_factor"] * (r - 1.0) * slow_tau * g, 0.0
    # c = late (of_q q + of_c c + of_e tau_e)
    held = 1.0 - late * of_c
    position = (from_e + from_c * late * of_e / held) / (1.0 - from_c * late * of_q / held)
    return period / ((z - 1.0) * position)


def impedance_error(
    n: dict[str, Any], clock: Clock, band: float = 20.0, points: int = 40, **options: Any
) -> np.ndarray:
    """Relative error of the apparent impedance over (0, ``band``] rad/s for many loops, rms, shape (m,).

    Against the target ``M_a s + B + K/s``, at the middles of ``points`` equal spans; a number, 0.1 is 10 %.
    """
    omega = (np.arange(points) + 0.5) * band / points
    found = impedance_response(n, clock, omega, **options)
    s = 1j * omega[None, :]
    mass, damping, stiffness = (
        np.atleast_1d(np.asarray(n[name], dtype=float))[:, None] for name in ("apparent_mass", "damping", "stiffness")
    )
    target = mass * s + damping + stiffness / s
    return np.sqrt(np.mean(np.abs(found / target - 1.0) ** 2, axis=1))
