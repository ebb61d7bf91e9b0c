"""The impedance law on a sampled drive: the loop as implemented, its poles, and what the operator's hand meets.

At sample k the encoder gives q_k and the drive its motor force tau_k; the law computes (T the period)

    v_k  = (q_k - q_{k-2}) / 2T                   two taps, or (q_k - q_{k-1}) / T
    a_k  = (v_k - v_{k-1}) / T
    af_k = al af_{k-1} + (1 - al) a_k             al = exp(-w T), the same for the current: tf_k from tau_k
    c_k  = (r-1) Mh af_k + r (Fh_v - B) v_k - kappa (r-1) tf_k - r K q_k

and the drive holds c_k over the period behind its first-order current loop. Friction is viscous here (the carriage
slides one way); a Coulomb term does not move the poles. While the carriage *sticks*, acceleration is zero whatever the
motor does, and what is left is the law's recursion in its own current, with gain kappa (r - 1): that loop has poles of
its own. The external force is held over each period too, so that the energy it brings in is exactly
``tau_e (q_{k+1} - q_k)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw

MARGINAL = 1e-9  # a pole this close to the unit circle is on it: rounding decides no verdict


@dataclass(frozen=True)
class Clock:
    """What sampling and drive add: period [s], time constant of the current loop [s], delay [samples]."""

    period: float
    current_time_constant: float = 0.0
    delay: int = 0

    @classmethod
    def of(cls, axis: Axis) -> Clock:
        """Read the clock from an axis."""
        return cls(axis.sampling.period, axis.drive.current_time_constant, axis.sampling.computation_delay)


@dataclass(frozen=True)
class Environment:
    """What the carriage is attached to: added mass [kg], damping [N/(m/s)] and stiffness to ground [N/m].

    A passive hand is ``tau_e = -(mass qdd + damping qd + stiffness q)``; a stiff wall has stiffness alone.
    """

    mass: float | np.ndarray = 0.0
    damping: float | np.ndarray = 0.0
    stiffness: float | np.ndarray = 0.0


FREE = Environment()


@dataclass(frozen=True)
class SampledLoop:
    """The sampled loop of a law on a plant that slides one way.

    ``matrix`` (n, n) and ``column`` (n,) advance the state by a period for a held force; ``row`` (n,) and ``direct``
    give the mean velocity over that period [m/s].
    """

    matrix: np.ndarray
    column: np.ndarray
    row: np.ndarray
    direct: float
    period: float

    @property
    def poles(self) -> np.ndarray:
        """Poles in z, largest first."""
        return _sorted(np.linalg.eigvals(self.matrix))

    @property
    def radius(self) -> float:
        """Largest modulus of the poles."""
        return float(np.abs(self.poles[0]))

    @property
    def stable(self) -> bool:
        """Whether no pole is outside the unit circle (an apparent damping of zero puts one on it)."""
        return self.radius <= 1.0 + MARGINAL

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Mean velocity over held force, at ``omega`` (m,) [rad/s] -> (m,) complex [m/s/N]."""
        z = np.exp(1j * np.asarray(omega, dtype=float) * self.period)
        system = z[:, None, None] * np.eye(len(self.matrix)) - self.matrix
        states = np.linalg.solve(system, np.broadcast_to(self.column[:, None], (len(z), len(self.column), 1)))
        return (self.row @ states)[:, 0] + self.direct


def sampled_loop(
    law: ImpedanceLaw, plant: FrictionModel, clock: Clock, direction: int = 1, environment: Environment = FREE
) -> SampledLoop:
    """Build the sampled loop of ``law`` on ``plant`` for motion to + or - (``direction``), perhaps in contact.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> sampled_loop(law, law.estimate, Clock.of(axis)).stable
    True
    """
    matrix, column, row, direct = loop_matrices(
        numbers(law, plant, direction), clock, law.velocity_estimator, law.force_sensor, environment
    )
    return SampledLoop(matrix[0], column[0], row[0], float(direct[0]), clock.period)


def numbers(law: ImpedanceLaw, plant: FrictionModel, direction: int = 1) -> dict[str, float]:
    """The numbers that decide the loop, by name; arrays of equal shape may stand in for any of them."""
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


def loop_matrices(
    n: dict[str, Any],
    clock: Clock,
    velocity_estimator: str = "two_tap",
    force_sensor: bool = False,
    environment: Environment = FREE,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of :class:`SampledLoop` for many loops at once, ``n`` as from :func:`numbers` with arrays (m,).

    Returns (m, s, s), (m, s), (m, s), (m,). States: v, tau, the last three position steps, the two filters, commands
    on their way, and q itself only where something pulls towards a position.
    """
    keys = list(n)
    hand = (environment.mass, environment.damping, environment.stiffness)
    values = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, dtype=float)) for x in (*n.values(), *hand)))
    p = dict(zip(keys, values, strict=False))
    mass_e, damping_e, stiffness_e = values[len(keys) :]
    period, delay, m = clock.period, clock.delay, len(values[0])
    step = plant_step(
        p["mass"] + mass_e, p["viscous"] + damping_e, stiffness_e, clock.current_time_constant, period
    )  # rows q, v, tau; columns q, v, tau, c, tau_e

    v, tau, d1, d2, d3, af, tf, wait = 0, 1, 2, 3, 4, 5, 6, 7
    q, size = wait + delay, wait + delay + 1
    r = p["mass_hat"] / p["apparent_mass"]
    al_a, al_t = np.exp(-p["filter"] * period), np.exp(-p["current_filter"] * period)

    rows = np.zeros((m, size, size))
    force = np.zeros((m, size))
    taps = np.zeros((m, size))  # v_k
    taps[:, [d1, d2] if velocity_estimator == "two_tap" else [d1]] = 0.5 / period
    if velocity_estimator == "backward":
        taps *= 2.0
    slope = taps.copy()  # v_k - v_{k-1}
    slope[:, d2 : d3 + 1] -= taps[:, d1 : d2 + 1]
    rows[:, af] = (1.0 - al_a)[:, None] * slope / period
    rows[:, af, af] += al_a
    rows[:, tf, tau] = 1.0 - al_t
    rows[:, tf, tf] = al_t

    command = np.zeros((m, size))
    feed = np.zeros(m)
    if force_sensor:
        command += (p["viscous_hat"] - r * p["damping"])[:, None] * taps
        # The sensor sits between carriage and environment and reads all of its force, inertia included.
        share = mass_e / (p["mass"] + mass_e)
        viscous = p["viscous"] + damping_e
        command[:, q] += (r - 1.0) * (share - 1.0) * stiffness_e
        command[:, v] += (r - 1.0) * (share * viscous - damping_e)
        command[:, tau] -= (r - 1.0) * share
        feed = (r - 1.0) * (1.0 - share)
    else:
        command += (r * (p["viscous_hat"] - p["damping"]))[:, None] * taps
        command += ((r - 1.0) * p["mass_hat"])[:, None] * rows[:, af]
        command -= (p["current_factor"] * (r - 1.0))[:, None] * rows[:, tf]
    command[:, q] -= r * p["stiffness"]

    if delay:
        rows[:, wait] = command
        force[:, wait] = feed
        for i in range(1, delay):
            rows[:, wait + i, wait + i - 1] = 1.0
        applied, applied_feed = np.zeros((m, size)), np.zeros(m)
        applied[:, wait + delay - 1] = 1.0
    else:
        applied, applied_feed = command, feed

    for place, line in ((d1, 0), (v, 1), (tau, 2)):
        rows[:, place] = step[:, line, 3, None] * applied
        rows[:, place, q] += step[:, line, 0]
        rows[:, place, v] += step[:, line, 1]
        rows[:, place, tau] += step[:, line, 2]
        force[:, place] = step[:, line, 3] * applied_feed + step[:, line, 4]
    rows[:, d1, q] -= 1.0  # the step of position, not the position
    rows[:, q] = rows[:, d1]
    rows[:, q, q] += 1.0
    force[:, q] = force[:, d1]
    rows[:, d2, d1] = rows[:, d3, d2] = 1.0

    out, direct = rows[:, d1] / period, force[:, d1] / period
    if not np.any(p["stiffness"]) and not np.any(stiffness_e):
        keep = np.arange(size) != q  # nothing depends on where the carriage is
        rows, force, out = rows[:, keep][:, :, keep], force[:, keep], out[:, keep]
    return rows, force, out, direct


def spectral_radius(n: dict[str, Any], clock: Clock, **options: Any) -> np.ndarray:
    """Largest modulus of the poles for many loops at once, shape (m,); arguments of :func:`loop_matrices`."""
    return np.abs(np.linalg.eigvals(loop_matrices(n, clock, **options)[0])).max(axis=1)


def recursion_poles(law: ImpedanceLaw, clock: Clock) -> np.ndarray:
    """Poles of the law's recursion in its own current while the carriage sticks, largest first."""
    return _sorted(np.linalg.eigvals(_recursion_matrix(law.recursion_gain, law.filters[1], clock)))


def recursion_radius(gain: np.ndarray, current_filter: np.ndarray, clock: Clock) -> np.ndarray:
    """Largest modulus of :func:`recursion_poles` for arrays (m,) of gain kappa (r - 1) and filter [rad/s]."""
    gain, current_filter = np.broadcast_arrays(np.atleast_1d(gain), np.atleast_1d(current_filter))
    matrices = np.array([_recursion_matrix(g, w, clock) for g, w in zip(gain, current_filter, strict=True)])
    return np.abs(np.linalg.eigvals(matrices)).max(axis=1)


def _recursion_matrix(gain: float, current_filter: float, clock: Clock) -> np.ndarray:
    tau, tf, wait, delay = 0, 1, 2, clock.delay
    al = np.exp(-current_filter * clock.period)
    e = np.exp(-clock.period / clock.current_time_constant) if clock.current_time_constant else 0.0
    matrix = np.zeros((wait + delay, wait + delay))
    matrix[tf, [tau, tf]] = 1.0 - al, al
    command = -gain * matrix[tf]
    matrix[tau, tau] = e
    if delay:
        matrix[wait] = command
        for i in range(1, delay):
            matrix[wait + i, wait + i - 1] = 1.0
        matrix[tau, wait + delay - 1] = 1.0 - e
    else:
        matrix[tau] += (1.0 - e) * command
    return matrix


def plant_step(mass, viscous, stiffness, lag: float, period: float) -> np.ndarray:
    """Exact step of (q, v, tau) under a held command c and force tau_e, shape (m, 3, 5)."""
    m = len(mass)
    generator = np.zeros((m, 5, 5))
    generator[:, 0, 1] = 1.0
    generator[:, 1, 0] = -stiffness / mass
    generator[:, 1, 1] = -viscous / mass
    generator[:, 1, 4] = 1.0 / mass
    if lag:
        generator[:, 1, 2] = 1.0 / mass
        generator[:, 2, 2], generator[:, 2, 3] = -1.0 / lag, 1.0 / lag
    else:  # ideal current loop: the command acts at once and is what is measured a period later
        generator[:, 1, 3] = 1.0 / mass
    step = exponential(generator * period)[:, :3]
    if not lag:
        step[:, 2] = (0.0, 0.0, 0.0, 1.0, 0.0)
    return step


def exponential(matrices: np.ndarray) -> np.ndarray:
    """Exponential of each of (m, n, n) matrices: Taylor series of degree 12 of a scaled matrix, squared back."""
    norm = np.abs(matrices).sum(axis=-1).max()
    squarings = max(0, int(np.ceil(np.log2(norm / 0.1)))) if norm > 0.0 else 0
    scaled = matrices / 2.0**squarings
    identity = np.eye(matrices.shape[-1])
    result = identity + scaled / 12.0
    for k in range(11, 0, -1):  # Horner
        result = identity + scaled @ result / k
    for _ in range(squarings):
        result = result @ result
    return result


def _sorted(poles: np.ndarray) -> np.ndarray:
    """Poles by falling modulus, then by imaginary part, so that the same loop prints the same list."""
    poles = np.asarray(poles, dtype=complex)
    return poles[np.lexsort((-poles.imag, -np.round(np.abs(poles), 12)))]
