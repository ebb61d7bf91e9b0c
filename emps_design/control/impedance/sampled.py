"""The impedance law on a sampled drive: its loop with a plant, free, in contact, with effects, or many at once.

The law is the kernel that runs in the drive, in its linear form; friction is viscous here (the carriage slides in one
direction), since a Coulomb term does not move the poles. While the carriage *sticks*, its acceleration is zero, and the
law's recursion in its own current remains, with gain kappa (r - 1): that loop has poles of its own.

Impedance and its error are those of the sampled loop at the hand; the relay of the Coulomb compensation is analysed by
its describing function.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis, sample_plant
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw, law_for
from emps_design.control.linear_plant import FREE, Environment, attached, felt, rigid_plant
from emps_design.control.sampled import SampledLoop, close, sorted_poles
from emps_design.laws import TWO_TAP, Law
from emps_design.laws.estimators import estimator_response
from emps_design.laws.library.impedance import COULOMB_POSITIVE, gains_of, law_with
from emps_design.laws.linear import linear_law, own_poles


@dataclass(frozen=True)
class Clock:
    """Sampling and drive: period [s], time constant of the current loop [s], delay [samples]."""

    period: float
    current_time_constant: float = 0.0
    delay: int = 0

    @classmethod
    def of(cls, axis: Axis) -> Clock:
        """The clock of an axis."""
        return cls(axis.sampling.period, axis.drive.current_time_constant, axis.sampling.computation_delay)


def sampled_loop(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, direction: int = 1, environment: Environment = FREE
) -> SampledLoop:
    """Close the sampled loop of ``law`` on ``plant`` for motion to + or - (``direction``), free or in contact.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> sampled_loop(law, law.estimate, Clock.of(axis)).stable
    True
    """
    return sampled_loops(numbers(law, plant, direction), clock, law.velocity_estimator, law.force_sensor, environment)


def numbers(law: ImpedanceLaw, plant: FrictionModel, direction: int = 1) -> dict[str, Any]:
    """Return the parameters of the loop by name; any of them may be replaced by an array, all of one shape."""
    i = 0 if direction > 0 else 1
    acceleration, current = law.filters
    return {
        "mass": plant.mass,
        "viscous": plant.viscous[i],
        "mass_hat": law.estimate.mass,
        "viscous_hat": law.estimate.viscous[i],
        "apparent_mass": law.mass,
        "damping": law.damping,
        "stiffness": law.stiffness,
        "filter": acceleration,
        "current_filter": current,
        "current_factor": law.current_factor,
    }


def sampled_loops(
    n: dict[str, Any],
    clock: Clock,
    velocity_estimator: Any = TWO_TAP,
    force_sensor: bool = False,
    environment: Environment = FREE,
) -> SampledLoop:
    """Close many loops at once: ``n`` as from :func:`numbers`, ``environment``, with arrays (m,) in any of them.

    Voltages are forces: G_tau is 1. The input ``coulomb`` is the level of the Coulomb compensation [N].
    """
    rigid = attached(rigid_plant(n["mass"], n["viscous"], 1.0, clock.current_time_constant), environment)
    form = linear_law(
        _law(n, clock, velocity_estimator, force_sensor), clock.period, signals={COULOMB_POSITIVE: "coulomb"}
    )
    sensor = felt(rigid, environment) if force_sensor else None
    return close(sample_plant(rigid, clock.period, clock.delay, velocity_estimator), form, sensor)


def extended_loop(axis: Axis, law: ImpedanceLaw, velocity: float = 0.1) -> SampledLoop:
    """Close the sampled loop of ``law`` on ``axis``, its effects linearised in steady motion at ``velocity`` [m/s].

    The law's model of its current ignores the effects: lag, delay or gain of an actuator appear in the poles.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> coupling = {"kind": "flexible_coupling", "frequency": 50.0, "damping": 0.05, "share": 0.2}
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> extended_loop(axis, law).stable, extended_loop(axis.replace(effects=[coupling]), law).stable
    (True, False)
    """
    period = axis.sampling.period
    return close(sample_axis(axis, velocity), linear_law(law_for(axis, law, period), period, float(np.sign(velocity))))


def extended_radius(
    axis: Axis, law: ImpedanceLaw, masses: np.ndarray, filters: np.ndarray, velocity: float = 0.1
) -> np.ndarray:
    """Largest modulus of the poles of :func:`extended_loop` for many M_a [kg] and filters [rad/s] at once, shape (m,).

    Acceleration and current share the filter; ``law`` gives the rest.
    """
    clock, direction = Clock.of(axis), 1 if velocity > 0.0 else -1
    n = numbers(law, FrictionModel.of(axis), direction)
    n |= {"apparent_mass": masses, "filter": filters, "current_filter": filters}
    laws = _law(n, clock, law.velocity_estimator, law.force_sensor, axis.drive.gain)
    return radius_of(close(sample_axis(axis, velocity), linear_law(laws, clock.period, float(direction))))


def spectral_radius(n: dict[str, Any], clock: Clock, **options: Any) -> np.ndarray:
    """Largest modulus of the poles for many loops at once, shape (m,); arguments of :func:`sampled_loops`."""
    return radius_of(sampled_loops(n, clock, **options))


def radius_of(loops: SampledLoop) -> np.ndarray:
    """Largest modulus of the poles of closed ``loops``, shape (m,)."""
    return np.atleast_1d(np.abs(np.linalg.eigvals(loops.A)).max(axis=-1))


def recursion_poles(law: ImpedanceLaw, clock: Clock) -> np.ndarray:
    """Poles of the law's recursion in its own current while the carriage sticks, largest first; 0: no recursion."""
    poles = own_poles(_law(numbers(law, law.estimate), clock, law.velocity_estimator, law.force_sensor), clock.period)
    return sorted_poles(poles) if poles.size else np.zeros(1, dtype=complex)


def recursion_radius(n: dict[str, Any], clock: Clock, velocity_estimator: Any = TWO_TAP) -> np.ndarray:
    """Largest modulus of :func:`recursion_poles` for many laws at once, shape (m,); ``n`` as from :func:`numbers`."""
    poles = own_poles(_law(n, clock, velocity_estimator, False), clock.period)
    return np.abs(poles).max(axis=-1, initial=0.0)


def _law(n: dict[str, Any], clock: Clock, velocity_estimator: Any, force_sensor: bool, force_gain: float = 1.0) -> Law:
    friction = SimpleNamespace(mass=n["mass_hat"], viscous=(n["viscous_hat"],) * 2, coulomb=(0.0, 0.0))
    gains = gains_of(
        friction, n["apparent_mass"], n["damping"], (n["filter"], n["current_filter"]), clock.period,
        velocity_estimator, stiffness=n["stiffness"], current_factor=n["current_factor"],
        force_sensor=force_sensor, force_gain=force_gain, current_time_constant=clock.current_time_constant,
        delay=clock.delay,
    )  # fmt: skip
    return law_with(gains, clock.delay)


def impedance_response(n: dict[str, Any], clock: Clock, omega: np.ndarray, **options: Any) -> np.ndarray:
    """Impedance tau_e/velocity of many sampled loops (m,) at ``omega`` (w,) [rad/s] -> (m, w) complex [N/(m/s)].

    ``options`` as for :func:`sampled_loops`; the velocity is the mean over a period.
    """
    return 1.0 / np.atleast_2d(sampled_loops(n, clock, **options).admittance(np.asarray(omega, dtype=float)))


def impedance_error(loops: SampledLoop, n: dict[str, Any], band: float = 20.0, points: int = 40) -> np.ndarray:
    """Rms relative error of the apparent impedance of the closed ``loops`` over (0, ``band``] rad/s, shape (m,).

    The target is ``M_a s + B + K/s`` of the numbers ``n``, at the middles of ``points`` equal spans; 0.1 means 10 %.
    """
    omega = (np.arange(points) + 0.5) * band / points
    s = 1j * omega
    mass, damping, stiffness = (
        np.atleast_1d(np.asarray(n[name], dtype=float))[:, None] for name in ("apparent_mass", "damping", "stiffness")
    )
    target = mass * s + damping + stiffness / s
    achieved = 1.0 / np.atleast_2d(loops.admittance(omega))
    return np.sqrt(np.mean(np.abs(achieved / target - 1.0) ** 2, axis=1))


def relay_oscillation(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, wall: float = 0.0
) -> tuple[float, float] | None:
    """The oscillation of :func:`relay_oscillations` for a single ``law``."""
    return relay_oscillations(law, plant, clock, wall)[0]


def relay_oscillations(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, wall: float = 0.0
) -> list[tuple[float, float] | None]:
    """Predict the oscillation that the Coulomb compensation can sustain: (frequency [rad/s], speed amplitude [m/s]).

    One per law if the estimate of ``law`` holds arrays (m,), as :meth:`.ImpedanceLaw.with_errors` returns them.

    The law applies ``r c Fh_c sign(v_k)`` at once, but subtracts the effect of its own current only through the
    filter: after a reversal it over-compensates for a while. Describing function of the two relays, plant and law:
    a sinusoid of amplitude ``A`` sustains itself if

        (4/pi) (-F_c Y_e(jw) + r c Fh_c Y_c(jw) e^{j angle(v_k/v)}) = A > 0

    with Y_e, Y_c the mean velocity per force at the hand and per force added to the law's, both against a ``wall``
    [N/m] if it is not 0. Searched between 0.5 rad/s and a quarter of the Nyquist frequency (half of it against a
    wall); the largest is returned, None if there is none. An approximation: simulated speeds are up to twice as large
    and, since the carriage stays near rest for a while, frequencies two to six times lower; sticking may end the
    oscillation before it settles. It is necessary for a limit cycle of this kind, not sufficient.
    """
    omega = np.geomspace(0.5, (0.5 if wall else 0.25) * np.pi / clock.period, 600)
    back = np.exp(-1j * omega * clock.period)
    # Phase of the velocity that the law estimates, against the mean over the following period.
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
    oscillations = []
    for balance in balances:
        real, imag = balance.real, balance.imag
        for k in np.flatnonzero(imag[:-1] * imag[1:] < 0.0):
            share = imag[k] / (imag[k] - imag[k + 1])
            amplitude = real[k] + share * (real[k + 1] - real[k])
            if amplitude > 0.0:
                oscillations.append((float(amplitude), float(omega[k] + share * (omega[k + 1] - omega[k]))))
    if not oscillations:
        return None
    amplitude, frequency = max(oscillations)
    return frequency, amplitude
