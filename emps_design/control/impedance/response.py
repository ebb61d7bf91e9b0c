"""What the hand meets at each frequency: the impedance of the sampled loop, its error, and the relay in the law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.sampled import Clock, numbers, plant_step


@dataclass(frozen=True)
class Transfers:
    """Answers of m loops at w frequencies, (m, w) complex: position to a held force and to a force added to the law's.

    ``mean`` turns position into the mean velocity over a period, ``estimate`` into the velocity the law sees.
    """

    position_per_force: np.ndarray
    position_per_command: np.ndarray
    mean: np.ndarray
    estimate: np.ndarray


def transfers(
    n: dict[str, Any],
    clock: Clock,
    omega: np.ndarray,
    velocity_estimator: str = "two_tap",
    force_sensor: bool = False,
    wall: float = 0.0,
) -> Transfers:
    """Solve the recursions of the sampled law in z for many loops (m,) at ``omega`` (w,) [rad/s].

    ``wall`` [N/m] is the stiffness of an undamped wall at the carriage.
    """
    values = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, dtype=float)) for x in n.values()))
    flat = dict(zip(n, values, strict=True))
    p = {name: value[:, None] for name, value in flat.items()}
    period, lag = clock.period, clock.current_time_constant
    step = plant_step(flat["mass"], flat["viscous"], np.full_like(flat["mass"], wall), lag, period)[:, :, :, None]
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
        of_q = (p["viscous_hat"] - r * p["damping"]) * taps - r * p["stiffness"] - (r - 1.0) * wall
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
    # c = late (of_q q + of_c c + of_e tau_e + added)
    held = 1.0 - late * of_c
    closed = 1.0 - from_c * late * of_q / held
    return Transfers(
        position_per_force=(from_e + from_c * late * of_e / held) / closed,
        position_per_command=from_c * late / held / closed,
        mean=(z - 1.0) / period,
        estimate=taps,
    )


def impedance_response(n: dict[str, Any], clock: Clock, omega: np.ndarray, **options: Any) -> np.ndarray:
    """Impedance tau_e/velocity of many sampled loops (m,) at ``omega`` (w,) [rad/s] -> (m, w) complex [N/(m/s)].

    The same numbers as ``1/SampledLoop.admittance``; ``options`` as for :func:`transfers`.
    """
    t = transfers(n, clock, omega, **options)
    return 1.0 / (t.mean * t.position_per_force)


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


def relay_oscillation(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, wall: float = 0.0
) -> tuple[float, float] | None:
    """Predict the oscillation the Coulomb compensation can keep up: (frequency [rad/s], velocity amplitude [m/s]).

    The law pushes with ``r c Fh_c sign(v_k)`` at once, but takes back what its current already does only through the
    filter: after a reversal it over-compensates for a while. Describing function of the two relays, plant and law:
    a sinusoid of amplitude ``A`` keeps itself up where

        (4/pi) (-F_c Y_e(jw) + r c Fh_c Y_c(jw) e^{j angle(v_k/v)}) = A > 0

    with Y_e, Y_c the mean velocity per force at the hand and per force added to the law's, both against a ``wall``
    [N/m] where one is given. Looked for between 0.5 rad/s and a quarter of the Nyquist frequency (half of it against a
    wall); the largest is returned, None if there is none. An approximation: simulated speeds are up to twice as large
    and, since the carriage lingers near rest, frequencies two to six times lower; sticking may end the oscillation
    before it settles. It explains a limit cycle and does not promise one.
    """
    omega = np.geomspace(0.5, (0.5 if wall else 0.25) * np.pi / clock.period, 600)
    options = {"velocity_estimator": law.velocity_estimator, "force_sensor": law.force_sensor, "wall": wall}
    compensation = law.coulomb_factor * (1.0 if law.force_sensor else law.ratio)
    found = []
    for direction in (1, -1) if plant.two_quadrant else (1,):
        i = 0 if direction > 0 else 1
        t = transfers(numbers(law, plant, direction), clock, omega, **options)
        turn = t.estimate / t.mean
        balance = (
            (4.0 / np.pi)
            * t.mean
            * (
                compensation * law.estimate.coulomb[i] * t.position_per_command * turn / np.abs(turn)
                - plant.coulomb[i] * t.position_per_force
            )
        )
        real, imag = balance[0].real, balance[0].imag
        for k in np.flatnonzero(imag[:-1] * imag[1:] < 0.0):
            share = imag[k] / (imag[k] - imag[k + 1])
            amplitude = real[k] + share * (real[k + 1] - real[k])
            if amplitude > 0.0:
                found.append((float(amplitude), float(omega[k] + share * (omega[k + 1] - omega[k]))))
    if not found:
        return None
    amplitude, frequency = max(found)
    return frequency, amplitude
