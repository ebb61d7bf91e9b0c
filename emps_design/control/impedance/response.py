"""What the hand meets at each frequency: the impedance of the sampled loop, its error, and the relay in the law."""

from __future__ import annotations

from typing import Any

import numpy as np

from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.sampled import Clock, Environment, SampledLoop, sampled_loop, sampled_loops
from emps_design.laws.estimators import estimator_response


def impedance_response(n: dict[str, Any], clock: Clock, omega: np.ndarray, **options: Any) -> np.ndarray:
    """Impedance tau_e/velocity of many sampled loops (m,) at ``omega`` (w,) [rad/s] -> (m, w) complex [N/(m/s)].

    ``options`` as for :func:`sampled_loops`; the velocity is the mean over a period.
    """
    return 1.0 / np.atleast_2d(sampled_loops(n, clock, **options).admittance(np.asarray(omega, dtype=float)))


def impedance_error(loops: SampledLoop, n: dict[str, Any], band: float = 20.0, points: int = 40) -> np.ndarray:
    """Relative error of the apparent impedance over (0, ``band``] rad/s of the closed ``loops``, rms, shape (m,).

    Against the target ``M_a s + B + K/s`` of the numbers ``n``, at the middles of ``points`` equal spans; a number, 0.1
    is 10 %.
    """
    omega = (np.arange(points) + 0.5) * band / points
    s = 1j * omega
    mass, damping, stiffness = (
        np.atleast_1d(np.asarray(n[name], dtype=float))[:, None] for name in ("apparent_mass", "damping", "stiffness")
    )
    target = mass * s + damping + stiffness / s
    found = 1.0 / np.atleast_2d(loops.admittance(omega))
    return np.sqrt(np.mean(np.abs(found / target - 1.0) ** 2, axis=1))


def relay_oscillation(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, wall: float = 0.0
) -> tuple[float, float] | None:
    """The one of :func:`relay_oscillations` of a single ``law``."""
    return relay_oscillations(law, plant, clock, wall)[0]


def relay_oscillations(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, wall: float = 0.0
) -> list[tuple[float, float] | None]:
    """Predict the oscillation the Coulomb compensation can keep up: (frequency [rad/s], velocity amplitude [m/s]).

    One of each law where the estimate of ``law`` holds arrays (m,), as :meth:`.ImpedanceLaw.with_errors` makes them.

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
    back = np.exp(-1j * omega * clock.period)
    # Of the velocity the law sees, against the mean over the period that follows.
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
    found = []
    for balance in balances:
        real, imag = balance.real, balance.imag
        for k in np.flatnonzero(imag[:-1] * imag[1:] < 0.0):
            share = imag[k] / (imag[k] - imag[k + 1])
            amplitude = real[k] + share * (real[k + 1] - real[k])
            if amplitude > 0.0:
                found.append((float(amplitude), float(omega[k] + share * (omega[k + 1] - omega[k]))))
    if not found:
        return None
    amplitude, frequency = max(found)
    return frequency, amplitude
