"""External force from motor force and motion: off-line (19), on-line sample by sample, and by a Kalman filter.

``tau_e = W X - tau_m``, positive towards +q. The drive holds u over a period, so the motor force that belongs to the
second difference of the position around t_k is the mean over the two periods that meet there. At rest friction balances
any force below break-away, which is not observable.

The recorded voltage is converted to the acting one by the actuator's maps, delays and the lag of the current loop. The
on-line observer is a difference equation of plain numbers, as a drive computes it. The Kalman filter estimates
position, velocity and a force that is a random walk from the encoder's position.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import FunctionType
from typing import Any, Protocol

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.effects import Motion
from emps_design.effects.effect import ADDED
from emps_design.errors import InputError
from emps_design.records import Record
from emps_design.units import LINEAR, Units

# Indices of the kernel's gains, and of its memory.
PERIOD, FORCE_GAIN, ALPHA, MASS, VISCOUS, COULOMB, OFFSET, REST = range(8)
Q, V, COMMAND, FORCE = range(4)

DEFAULT_CUTOFF_HZ = 20.0
BLOCK = 50_000  # samples of a record between two reports of progress
REST_VELOCITY = 1e-3  # m/s, default below which the sign of the velocity is taken as 0
SLOWEST = 1e-4  # of the Nyquist frequency, lowest frequency at which the response is evaluated


def acting_voltage(axis: Axis, u: np.ndarray) -> tuple[np.ndarray, Axis]:
    """Acting voltage (n,) [V] for the recorded ``u``, and the axis without the effects that are then accounted for.

    Static maps, delays and lags of the actuator, with that of the current loop, follow from ``u`` alone, and ``u``
    already contains a disturbance of the controller. So every observer, off-line or on-line, gets the force at the
    carriage. Braking by the back-EMF is added to the viscous friction.

    >>> from emps_design.machines import machine
    >>> dead = machine("emps2019").replace(effects=[{"kind": "actuator_deadzone", "width": 0.5}])
    >>> voltage, rest = acting_voltage(dead, np.array([0.2, 1.0]))
    >>> voltage.tolist(), rest.effects
    ([0.0, 0.5], ())
    """
    b, kept = tuple(float(x) for x in axis.mechanics.array()), []
    late, lags = float(axis.sampling.computation_delay), [axis.drive.current_time_constant]
    for entry in axis.effects:
        effect, p = entry.effect, tuple(float(x) for x in entry.effect.values(entry.parameters))
        if effect.actuator is not None:
            u = np.array([effect.actuator(float(voltage), p) for voltage in u])
        elif effect.delay is not None:
            late += effect.delay(0.0, 0.0, 0.0, 0.0, (), p, b) / axis.sampling.period
        elif effect.solver.lag is not None:
            lags.append(effect.solver.lag(0.0, 0.0, 0.0, 0.0, (), p, b))
        elif effect.command is None:
            kept.append(entry)
    u = _delay(u, late)
    for constant in lags:
        u = _lag(u, constant / axis.sampling.period)
    used_up = {
        "drive": {"current_time_constant": 0.0, **({"back_emf": 0.0} if axis.drive.back_emf else {})},
        "sampling": {"computation_delay": 0},
        "mechanics": {"viscous": axis.damping},
    }
    return u, axis.replace(effects=kept, **used_up)


def with_acting_command(axis: Axis, record: Record) -> tuple[Record, Axis]:
    """The record with the voltage of :func:`acting_voltage`, and the axis that belongs to it.

    The voltage includes the supply of a duty and the motor switch.
    """
    voltage, driven = acting_voltage(axis.replace(sampling={"period": record.period}), record.u)
    share = motor_share(axis, record)
    acts_as_recorded = voltage is record.u and isinstance(share, float) and share == 1.0
    return record if acts_as_recorded else replace(record, u=voltage * share), driven


def as_driven(axis: Axis, record: Record) -> tuple[Record, Axis]:
    """:func:`with_acting_command`, for an axis whose viscous friction includes the braking by the back-EMF.

    An open winding does not brake, so where the motor is off the voltage compensates that part.

    >>> from emps_design.machines import machine
    >>> wave = 0.1 * np.sin(np.arange(60) / 9)
    >>> off = Record.from_arrays(1e-2, wave, wave, np.ones(60) + wave, enable=np.arange(60) < 30)
    >>> [int(np.count_nonzero(half)) for half in np.split(as_driven(machine("emps2019"), off)[0].u, 2)]
    [30, 0]
    """
    driven, rest = with_acting_command(axis, record)
    return replace(driven, u=driven.u + back_emf_compensation(axis, record)), rest


def motor_share(axis: Axis, record: Record) -> Any:
    """Share (n,) of ``axis.drive.gain`` at each sample of ``record``, from its supply and motor switch; else 1.0."""
    share: Any = 1.0
    if axis.drive.command == "duty" and record.supply is not None:
        share = axis.drive.force_gain * record.supply / axis.drive.gain
    return share if record.enable is None else share * (record.enable != 0.0)


def back_emf_compensation(axis: Axis, record: Record) -> np.ndarray:
    """Command (n,) that compensates the modelled back-EMF where the motor of ``record`` is off; else 0."""
    if record.enable is None or not axis.drive.braking:
        return np.zeros(len(record))
    v = np.gradient(record.q, record.period)
    return np.where(record.enable != 0.0, 0.0, axis.drive.braking * v / axis.drive.gain)


def motor_force(axis: Axis, record: Record) -> np.ndarray:
    """Motor force (n,) [N] of the command of ``record``, without delays, lags and back-EMF."""
    return axis.drive.gain * motor_share(axis, record) * record.u


def _delay(u: np.ndarray, late: float) -> np.ndarray:
    """Means (n,) over each period of the held signal ``u`` (n,) after a delay of ``late`` periods."""
    if late == 0.0:
        return u
    whole, share = int(late), late - int(late)
    padded = np.concatenate([np.full(whole + 1, u[0]), u])
    return (1.0 - share) * padded[1 : len(u) + 1] + share * padded[: len(u)]


def _lag(u: np.ndarray, constant: float) -> np.ndarray:
    """Means (n,) over each period of the held ``u`` (n,) after a first-order lag of ``constant`` periods, from u[0]."""
    if constant <= 0.0:
        return u
    decay = math.exp(-1.0 / constant)
    begin, _ = scipy.signal.lfilter([0.0, 1.0 - decay], [1.0, -decay], u, zi=[u[0]])
    return u + (begin - u) * constant * (1.0 - decay)


def added_force(q: float, v: float, tau: float) -> float:
    """Force [N] of effects at position, velocity and motor force: 0, unless :func:`with_effects` replaces it."""
    return 0.0


def added_dry(q: float, v: float, tau: float) -> float:
    """Dry friction [N] of effects, as :func:`added_force`."""
    return 0.0


def added_inertia(q: float, v: float, tau: float) -> float:
    """Mass [kg] of effects, as :func:`added_force`."""
    return 0.0


def position_before(k: int, q: float, memory: Any) -> float:
    """Position [m] of the previous sample, at which the two periods meet."""
    return memory[Q] if k > 0 else q


def force_observer(k: int, command: float, q: float, f_ext: float, limit: float, gains: Any, memory: Any) -> float:
    """External force [N], late by the observer's delay; ``command`` is that of the period that ends at sample k."""
    period = gains[PERIOD]
    before = position_before(k, q, memory)
    v = (q - before) / period
    a = (v - memory[V]) / period
    # Velocity and motor force in the middle of the two periods.
    middle = 0.5 * (v + memory[V])
    motor = gains[FORCE_GAIN] * 0.5 * (command + (memory[COMMAND] if k > 1 else command))
    level = max(gains[COULOMB] + added_dry(before, middle, motor), 0.0)
    dry = 0.0
    if middle > gains[REST]:
        dry = level
    elif middle < -gains[REST]:
        dry = -level
    constant = gains[OFFSET] + added_force(before, middle, motor)
    mass = gains[MASS] + added_inertia(before, middle, motor)
    now = gains[VISCOUS] * middle + constant + dry + mass * a - motor
    if k > 0:
        now = memory[FORCE] + gains[ALPHA] * (now - memory[FORCE])
    memory[Q] = q
    memory[V] = v
    memory[COMMAND] = command
    memory[FORCE] = now
    return now


def with_effects(kernel: Any, added: Mapping[str, Callable[..., Any]]) -> Any:
    """The observer's ``kernel`` with the functions ``added`` (name to function of q, v, tau) for those of effects."""
    return FunctionType(kernel.__code__, {**kernel.__globals__, **added}, kernel.__name__)


def model_force(motion: Motion, axis: Axis, rest_velocity: float = REST_VELOCITY) -> np.ndarray:
    """W X of (19), shape (n,) [N]: the force that the axis and its effects need for ``motion``.

    Effects without a regressor are left out, since the motion does not give their force; :func:`left_out` names them.
    Actuator effects use ``motion.tau`` [N].
    """
    m = axis.mechanics
    sliding = np.where(np.abs(motion.v) > rest_velocity, np.sign(motion.v), 0.0)
    force = m.mass * motion.a + m.viscous * motion.v + m.coulomb * motion.smooth(sliding) + m.offset
    return force + effects_force(motion, axis)


def effects_force(motion: Motion, axis: Axis) -> np.ndarray:
    """Force (n,) [N] of the effects of ``axis`` with a regressor for ``motion``.

    >>> from emps_design.machines import machine
    >>> asymmetric = machine("emps2018-two-quadrant")
    >>> round(float(effects_force(Motion(*(np.ones(3) for _ in range(5)), period=1.0), asymmetric)[0]), 2)
    -44.44
    """
    force = np.zeros_like(motion.v)
    for entry in axis.effects:
        effect = entry.effect
        if effect.regressor is None:
            continue
        shape = {name: entry.parameters[name] for name in effect.shape}
        force += effect.regressor(motion, shape, axis.mechanics.array()) @ effect.coefficients(entry.parameters)
    return force


def observe_offline(
    motion: Motion, motor_force: np.ndarray, axis: Axis, rest_velocity: float = REST_VELOCITY
) -> np.ndarray:
    """External force (n,) [N] by (19), without delay; ``motion`` and ``motor_force`` (n,) [N] have the same filter.

    Below ``rest_velocity`` [m/s] the sign of the velocity is 0.

    >>> from emps_design.machines import machine
    >>> still = Motion(*(np.zeros(3) for _ in range(5)), period=1e-3)
    >>> observe_offline(still, np.zeros(3), machine("emps2018")).tolist()
    [0.0, 0.0, 0.0]
    """
    driven = replace(motion, tau=motor_force, force_gain=axis.drive.gain)
    return model_force(driven, axis, rest_velocity) - motor_force


def left_out(axis: Axis) -> dict[str, tuple[str, ...]]:
    """Effects of ``axis`` that the observers cannot use, by method: ``offline``, ``online``, ``kalman``.

    >>> from emps_design.machines import machine
    >>> flexible = {"kind": "flexible_coupling", "frequency": 40.0, "damping": 0.05, "share": 0.4}
    >>> left_out(machine("emps2019").replace(effects=[flexible]))["online"]
    ('flexible_coupling',)
    """
    effects = [(entry.kind, entry.effect) for entry in axis.effects]
    instant = {kind for kind, effect in effects if effect.rate is None}
    forces = {kind for kind, effect in effects if kind in instant and (effect.force or effect.dry)}
    masses = {kind for kind, effect in effects if kind in instant and effect.inertia}
    return {
        "offline": tuple(kind for kind, effect in effects if effect.regressor is None),
        "online": tuple(kind for kind, _ in effects if kind not in forces | masses),
        "kalman": tuple(kind for kind, _ in effects if kind not in forces - masses),
    }


class Resistance:
    """Resistance of the axis and its effects without states to motion, one sample at a time."""

    def __init__(self, axis: Axis, skipped: tuple[str, ...]):
        self._b = tuple(float(x) for x in axis.mechanics.array())
        self._kernels = {
            hook: [
                (getattr(entry.effect, hook), tuple(float(x) for x in entry.effect.values(entry.parameters)))
                for entry in axis.effects
                if entry.kind not in skipped and getattr(entry.effect, hook)
            ]
            for hook in ADDED
        }

    def force(self, q: float, v: float, t: float, tau: float, rest_velocity: float) -> float:
        """Viscous and dry friction, offset and effects [N]; ``tau`` [N] is the present motor force."""
        _, viscous, level, offset = self._b
        sign = 0.0 if abs(v) <= rest_velocity else math.copysign(1.0, v)
        force, dry = (self.added(hook, q, v, t, tau) for hook in ("force", "dry"))
        return viscous * v + offset + force + max(level + dry, 0.0) * sign

    @property
    def hooks(self) -> tuple[str, ...]:
        """The quantities to which effects contribute: ``force`` [N], ``dry`` friction [N], ``inertia`` [kg]."""
        return tuple(hook for hook, kernels in self._kernels.items() if kernels)

    def added(self, hook: str, q: float, v: float, t: float, tau: float) -> float:
        """Contribution of the effects to one of :attr:`hooks`."""
        total = 0.0
        for kernel, p in self._kernels[hook]:
            total += kernel(q, v, t, tau, (), p, self._b)
        return total


class ForceObserver:
    """On-line observer of the paper: (19) with a first-order low-pass, one sample at a time, inside a control loop.

    ``cutoff_hz`` [Hz] of the low-pass, which acts on velocity, current and friction alike: ``y += alpha (x - y)`` with
    ``alpha = 1 - exp(-2 pi cutoff T)``. ``delay`` [s] is that of a slow force: one period, since the second difference
    is centred there, plus ``(1 - alpha)/alpha`` periods of the filter.

    >>> from emps_design.machines import machine
    >>> observer = ForceObserver(machine("emps2018"), cutoff_hz=20.0)
    >>> for _ in range(200):
    ...     force = observer.step(q=0.1, u=0.1)  # at rest, 3.5 N of motor force within dry friction
    >>> round(force, 3), round(1e3 * observer.delay, 2)
    (-3.515, 8.47)
    """

    def __init__(self, axis: Axis, cutoff_hz: float = DEFAULT_CUTOFF_HZ, rest_velocity: float = REST_VELOCITY):
        period = axis.sampling.period
        if not 0 < cutoff_hz < 0.5 / period:
            raise InputError(f"cut-off: found {cutoff_hz:g} Hz, expected between 0 and {0.5 / period:g} Hz")
        self.axis, self.cutoff_hz, self.rest_velocity = axis, cutoff_hz, rest_velocity
        self._period = period
        resistance = Resistance(axis, left_out(axis)["online"])
        added = {f"added_{hook}": partial(self._added, resistance, hook) for hook in resistance.hooks}
        self.kernel = with_effects(force_observer, added)
        self._alpha = 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * period)
        # The gains of the difference equation without effects.
        self.gains = [period, axis.drive.gain, self._alpha, *axis.mechanics.array().tolist(), rest_velocity]
        self.reset()

    @property
    def delay(self) -> float:
        """Delay [s] of the estimate of a slow force."""
        return self._period * (1.0 + (1.0 - self._alpha) / self._alpha)

    @property
    def rise_time(self) -> float:
        """Rise time [s] from 10 to 90 % of a step of force."""
        return -math.log(9.0) * self._period / math.log(1.0 - self._alpha)

    def reset(self) -> None:
        """Reset the state: the next sample starts from rest."""
        self._samples, self._memory = 0, [0.0] * 4

    def step(self, q: float, u: float) -> float:
        """Return the external force [N], late by ``delay``.

        ``q`` [m] is the position at this sample, ``u`` [V] the voltage of the period that ends with it.
        """
        self._samples += 1
        return self.kernel(self._samples - 1, u, q, 0.0, 0.0, self.gains, self._memory)

    def _added(self, resistance: Resistance, hook: str, q: float, v: float, tau: float) -> float:
        """Contribution of the effects at the previous sample."""
        return resistance.added(hook, q, v, max(self._samples - 2, 0) * self._period, tau)


class OnlineObserver(Protocol):
    """An observer in a loop: ``reset`` once, then ``step`` at every sample; its estimate is late by ``delay``."""

    @property
    def delay(self) -> float:
        """Delay [s] of the estimate of a slow force."""

    def reset(self) -> None:
        """Reset the state."""

    def step(self, q: float, u: float) -> float:
        """External force [N] from position ``q`` [m] and the voltage ``u`` [V] of the period that ends with it."""


def observe_online(
    observer: OnlineObserver, q: np.ndarray, u: np.ndarray, progress: Callable[[float], None] | None = None
) -> np.ndarray:
    """Run ``observer`` over ``q`` (n,) [m] and ``u`` (n,) [V] of a record; returns the estimates (n,) [N] as in a loop.

    ``u[k]`` is held from sample k on, so sample k uses ``u[k-1]``. ``progress`` is called with the share that is done.

    >>> from emps_design.machines import machine
    >>> observer = ForceObserver(machine("emps2018"))
    >>> observe_online(observer, np.zeros(3), np.full(3, 0.1)).round(3).tolist()
    [-3.515, -3.515, -3.515]
    """
    observer.reset()
    step, before, force = observer.step, float(u[0]), np.empty(len(q))
    for start in range(0, len(q), BLOCK):
        stop = min(start + BLOCK, len(q))
        voltages = [before, *u[start : stop - 1].tolist()]
        force[start:stop] = [step(x, voltage) for x, voltage in zip(q[start:stop].tolist(), voltages, strict=True)]
        before = float(u[stop - 1])
        if progress is not None:
            progress(stop / len(q))
    return force


class KalmanForceObserver:
    """Kalman filter with the states position, velocity and external force; the force is a random walk.

    Give either ``bandwidth_hz`` [Hz], at which the estimate has half the power of the force, or ``force_rate``
    [N/sqrt(s)], the expected rate of change of the force: a larger one is faster and noisier. ``position_noise`` [m]
    defaults to that of the encoder's quantisation. The gain is the steady-state one.

    >>> from emps_design.machines import machine
    >>> observer = KalmanForceObserver(machine("emps2018"), bandwidth_hz=20.0)
    >>> round(observer.bandwidth_hz, 2), observer.noise_std < 0.1
    (20.0, True)
    """

    def __init__(
        self,
        axis: Axis,
        bandwidth_hz: float | None = None,
        force_rate: float | None = None,
        position_noise: float | None = None,
        rest_velocity: float = REST_VELOCITY,
    ):
        if bandwidth_hz is not None and force_rate is not None:
            raise InputError("Kalman observer: give bandwidth_hz or force_rate, not both")
        quantisation = axis.sampling.encoder_resolution / math.sqrt(12.0)
        noise = quantisation if position_noise is None else position_noise
        if not noise > 0:
            raise InputError(
                f"{axis.name}: position noise {axis.units.quantity(noise, 'm', 'g')}; "
                "give encoder_resolution in the axis, or position_noise > 0"
            )
        self.axis, self.rest_velocity, self.position_noise = axis, rest_velocity, noise
        self._resistance, self._gain = Resistance(axis, left_out(axis)["kalman"]), axis.drive.gain
        self._period, self._viscous = axis.sampling.period, axis.mechanics.viscous
        if force_rate is None:
            bandwidth_hz = DEFAULT_CUTOFF_HZ if bandwidth_hz is None else bandwidth_hz
            force_rate = _force_rate_for(axis, bandwidth_hz, noise)
        if not force_rate > 0:
            rate = axis.units.quantity(force_rate, "N/sqrt(s)", "g")
            raise InputError(f"{axis.units.word('force')} rate: found {rate}, expected > 0")
        self.force_rate = force_rate
        self._design = _SteadyKalman.of(axis, force_rate, noise)
        self._rows = [tuple(row) for row in self._design.transition.tolist()]
        self._push = tuple(self._design.push.tolist())
        self._correct = tuple(self._design.gain.tolist())
        self.reset()

    @property
    def bandwidth_hz(self) -> float:
        """Frequency [Hz] at which the estimate has half the power of the force."""
        return self._design.bandwidth / (2.0 * math.pi)

    @property
    def delay(self) -> float:
        """Delay [s] of the estimate of a slow force: the slope of the phase from force to estimate at low frequency.

        ``response`` is that to a force held from t_k on, which lags by half a period.
        """
        w = 1e-2 * self._design.bandwidth
        return -float(np.angle(self.response(np.array([w]))[0])) / w - 0.5 * self._period

    @property
    def noise_std(self) -> float:
        """Standard deviation [N] of the estimate by the encoder's noise."""
        return self._design.noise_std

    def response(self, w: np.ndarray) -> np.ndarray:
        """Response (n,) from external force, held over each period, to its estimate at ``w`` (n,) [rad/s]."""
        return self._design.response(np.asarray(w, dtype=float))

    def reset(self) -> None:
        """Reset the state: the next sample starts from rest."""
        self._state, self._samples = (0.0, 0.0, 0.0), 0

    def step(self, q: float, u: float) -> float:
        """Return the external force [N], late by ``delay``.

        ``q`` [m] is the position at this sample, ``u`` [V] the voltage of the period that ends with it.
        """
        if self._samples == 0:
            self._state = (q, 0.0, 0.0)
        else:
            x, v, d = self._state
            t = (self._samples - 1) * self._period
            # Viscous friction is in the transition matrix already.
            motor = self._gain * u
            drive = motor - self._resistance.force(x, v, t, motor, self.rest_velocity) + self._viscous * v
            ahead = [
                row[0] * x + row[1] * v + row[2] * d + push * drive
                for row, push in zip(self._rows, self._push, strict=True)
            ]
            error = q - ahead[0]
            self._state = tuple(value + gain * error for value, gain in zip(ahead, self._correct, strict=True))
        self._samples += 1
        return self._state[2]


def kalman_trade_off(axis: Axis, bandwidths_hz: np.ndarray) -> dict[str, np.ndarray]:
    """Delay [s] and noise [N] of the Kalman observer for each of ``bandwidths_hz`` [Hz]: faster is noisier.

    >>> from emps_design.machines import machine
    >>> table = kalman_trade_off(machine("emps2018"), np.array([10.0, 40.0]))
    >>> bool(table["delay"][1] < table["delay"][0]), bool(table["noise_std"][1] > table["noise_std"][0])
    (True, True)
    """
    observers = [KalmanForceObserver(axis, bandwidth_hz=float(bandwidth)) for bandwidth in bandwidths_hz]
    names = ("bandwidth_hz", "force_rate", "delay", "noise_std")
    return {name: np.array([getattr(observer, name) for observer in observers]) for name in names}


@dataclass(frozen=True)
class _SteadyKalman:
    """Steady-state Kalman gain for [q, v, d] over a period, computed in units in which all three are near 1."""

    transition: np.ndarray
    push: np.ndarray
    gain: np.ndarray
    noise: float
    period: float
    scale: np.ndarray

    @classmethod
    def of(cls, axis: Axis, force_rate: float, noise: float) -> _SteadyKalman:
        m, T = axis.mechanics, axis.sampling.period
        continuous = np.zeros((4, 4))
        continuous[0, 1] = 1.0
        continuous[1, 1:] = -m.viscous / m.mass, 1.0 / m.mass, 1.0 / m.mass
        step = scipy.linalg.expm(continuous * T)
        a, push = step[:3, :3], step[:3, 3].copy()
        scale = np.array([noise, noise / T, m.mass * noise / T**2])
        scaled = a * scale / scale[:, None]
        walk = np.diag([0.0, 0.0, force_rate**2 * T / scale[2] ** 2])
        output = np.array([[1.0], [0.0], [0.0]])
        p = scipy.linalg.solve_discrete_are(scaled.T, output, walk, np.eye(1))
        gain = p[:, 0] / (p[0, 0] + 1.0)
        return cls(a, push, gain * scale / noise, noise, T, scale)

    @property
    def _closed(self) -> np.ndarray:
        return (np.eye(3) - np.outer(self.gain, [1.0, 0.0, 0.0])) @ self.transition

    @property
    def noise_std(self) -> float:
        closed = self._closed * self.scale / self.scale[:, None]
        gain = self.gain * self.noise / self.scale
        return float(
            math.sqrt(scipy.linalg.solve_discrete_lyapunov(closed, np.outer(gain, gain))[2, 2]) * self.scale[2]
        )

    def response(self, w: np.ndarray) -> np.ndarray:
        z = np.exp(1j * w * self.period)[:, None, None]
        motion = np.linalg.solve(z * np.eye(2) - self.transition[:2, :2], self.push[:2, None])[:, 0, 0]
        # The estimator has q alone: x[k+1] = (I - K C) A x[k] + K q[k+1].
        correction = self.gain[None, :, None] * z * motion[:, None, None]
        return np.linalg.solve(z * np.eye(3) - self._closed, correction)[:, 2, 0]

    @property
    def bandwidth(self) -> float:
        w = np.geomspace(SLOWEST, 1.0, 600) * math.pi / self.period
        size = np.abs(self.response(w))
        below = np.flatnonzero(size < math.sqrt(0.5))
        if not below.size:
            return float(w[-1])
        if below[0] == 0:
            return float(w[0])
        i = int(below[0])
        share = (size[i - 1] - math.sqrt(0.5)) / (size[i - 1] - size[i])
        return float(w[i - 1] + share * (w[i] - w[i - 1]))


def _force_rate_for(axis: Axis, bandwidth_hz: float, noise: float) -> float:
    """Random walk of the force [N/sqrt(s)] whose Kalman filter has the bandwidth [Hz]."""
    w, T = 2.0 * math.pi * bandwidth_hz, axis.sampling.period
    if not 0.5 * SLOWEST / T < bandwidth_hz < 0.2 / T:
        raise InputError(
            f"bandwidth: found {bandwidth_hz:g} Hz, expected between {0.5 * SLOWEST / T:g} and {0.2 / T:g} Hz"
        )
    # Continuous filter of a triple integrator: its bandwidth is near (rate / (mass noise sqrt(T)))^(1/3).
    guess = math.log(axis.mechanics.mass * noise * math.sqrt(T) * w**3)

    def excess(log_rate: float) -> float:
        return math.log(_SteadyKalman.of(axis, math.exp(log_rate), noise).bandwidth / w)

    return math.exp(scipy.optimize.brentq(excess, guess - 6.0, guess + 6.0, xtol=1e-6))


@dataclass(frozen=True)
class SmallestForce:
    """The smallest observable force ``value`` [N], the name of the ``bound`` that sets it, and all ``bounds`` [N]."""

    value: float
    bound: str
    bounds: dict[str, float]
    units: Units = LINEAR

    def to_dict(self) -> dict[str, Any]:
        """Plain data, with the reason for each bound."""
        force = self.units.word("force")
        reasons = {
            "break_away": "at rest friction balances anything smaller",
            "noise": f"95 % of the fast changes of the observed {force}, which a slow {force} does not cause",
            "parameter": f"95 % of the {force} by parameter errors on this motion, 2 % of each by default",
        }
        return {"value": self.value, "bound": self.bound, "bounds": self.bounds, "reasons": reasons}


def smallest_observable_force(axis: Axis, noise: float, parameter: float) -> SmallestForce:
    """The largest of three bounds: break-away of a carriage at rest, ``noise`` and ``parameter`` errors [N].

    Break-away is the Coulomb friction plus the dry friction of effects at rest.

    >>> from emps_design.machines import machine
    >>> smallest_observable_force(machine("emps2018"), noise=3.0, parameter=4.0).to_dict()["bound"]
    'break_away'
    """
    b = tuple(float(x) for x in axis.mechanics.array())
    dry = 0.0
    for entry in axis.effects:
        if entry.effect.dry is not None and entry.effect.rate is None:
            dry += entry.effect.dry(0.0, 0.0, 0.0, 0.0, (), tuple(entry.effect.values(entry.parameters)), b)
    bounds = {"break_away": float(b[2] + dry), "noise": float(noise), "parameter": float(parameter)}
    bound = max(bounds, key=lambda name: bounds[name])
    return SmallestForce(bounds[bound], bound, bounds, axis.units)
