"""Kalman filter for the external force: position, velocity and a random-walk force, from the encoder position."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError
from emps_design.observer.external_force import DEFAULT_CUTOFF_HZ, REST_VELOCITY, Resistance, left_out

SLOWEST = 1e-4  # of the Nyquist frequency, lowest frequency at which the response is evaluated


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
    return {
        "bandwidth_hz": np.array([observer.bandwidth_hz for observer in observers]),
        "force_rate": np.array([observer.force_rate for observer in observers]),
        "delay": np.array([observer.delay for observer in observers]),
        "noise_std": np.array([observer.noise_std for observer in observers]),
    }


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
        from scipy.linalg import expm, solve_discrete_are

        m, T = axis.mechanics, axis.sampling.period
        continuous = np.zeros((4, 4))
        continuous[0, 1] = 1.0
        continuous[1, 1:] = -m.viscous / m.mass, 1.0 / m.mass, 1.0 / m.mass
        step = expm(continuous * T)
        a, push = step[:3, :3], step[:3, 3].copy()
        scale = np.array([noise, noise / T, m.mass * noise / T**2])
        scaled = a * scale / scale[:, None]
        walk = np.diag([0.0, 0.0, force_rate**2 * T / scale[2] ** 2])
        output = np.array([[1.0], [0.0], [0.0]])
        p = solve_discrete_are(scaled.T, output, walk, np.eye(1))
        gain = p[:, 0] / (p[0, 0] + 1.0)
        return cls(a, push, gain * scale / noise, noise, T, scale)

    @property
    def _closed(self) -> np.ndarray:
        return (np.eye(3) - np.outer(self.gain, [1.0, 0.0, 0.0])) @ self.transition

    @property
    def noise_std(self) -> float:
        from scipy.linalg import solve_discrete_lyapunov

        closed = self._closed * self.scale / self.scale[:, None]
        gain = self.gain * self.noise / self.scale
        return float(math.sqrt(solve_discrete_lyapunov(closed, np.outer(gain, gain))[2, 2]) * self.scale[2])

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
    from scipy.optimize import brentq

    w, T = 2.0 * math.pi * bandwidth_hz, axis.sampling.period
    if not 0.5 * SLOWEST / T < bandwidth_hz < 0.2 / T:
        raise InputError(
            f"bandwidth: found {bandwidth_hz:g} Hz, expected between {0.5 * SLOWEST / T:g} and {0.2 / T:g} Hz"
        )
    # Continuous filter of a triple integrator: its bandwidth is near (rate / (mass noise sqrt(T)))^(1/3).
    guess = math.log(axis.mechanics.mass * noise * math.sqrt(T) * w**3)

    def excess(log_rate: float) -> float:
        return math.log(_SteadyKalman.of(axis, math.exp(log_rate), noise).bandwidth / w)

    return math.exp(brentq(excess, guess - 6.0, guess + 6.0, xtol=1e-6))
