"""The velocity loop as implemented: hold, delays, current loop, effects and velocity estimator.

With period T the controller computes at sample k, from the velocity estimate v of :mod:`.discretisation`,

    i[k] = i[k-1] + (T / t_v) (r[k] - v[k])
    u[k] = k_v1 (i[k] - v[k])

Stability is read from the closed-loop poles first; an unstable loop has no margins.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.control.loop.margins import Margins, loop_margins
from emps_design.control.plant.discretisation import SampledPlant
from emps_design.control.plant.linear_plant import POSITION, VELOCITY

if TYPE_CHECKING:
    import control


ROUNDING = 1e-12


@dataclass(frozen=True)
class ClosedLoop:
    """s[k+1] = S s[k] + R r[k] with u[k] = U s[k] + D r[k].

    ``velocity`` is the row of the true carriage velocity, ``force`` the row of the force that the law reads.
    """

    S: np.ndarray
    R: np.ndarray
    U: np.ndarray
    D: float
    velocity: np.ndarray
    force: np.ndarray

    @cached_property
    def poles(self) -> np.ndarray:
        """Closed-loop poles in the z plane, largest first."""
        poles = np.linalg.eigvals(self.S)
        return poles[np.lexsort((poles.imag, -np.abs(poles)))]

    @property
    def stable(self) -> bool:
        """Whether no pole lies outside the unit circle, rounding left aside.

        A force that depends on position puts a pole on z = 1 that the velocity does not show; an eigenvalue routine
        returns it a few 1e-16 on either side.
        """
        return bool(np.max(np.abs(self.poles)) < 1.0 + ROUNDING)


def closed_loop(
    plant: SampledPlant,
    k_v1: float,
    t_v: float,
    k_e1: float = 0.0,
    force: tuple[float, float] = (0.0, 0.0),
    sensor_delay: int = 0,
    extra_delay: int = 0,
) -> ClosedLoop:
    """Return the loop of the module's equations around ``plant``, optionally inside the force loop of Fig. 4.

    With ``k_e1`` [(m/s)/N] the reference is k_e1 (r + f) with f = -(K q + k_h v), ``force`` = (K [N/m], k_h [N/(m/s)]),
    read ``sensor_delay`` samples late; else it is r. ``extra_delay``: more samples between law and voltage.

    >>> from emps_design.control.plant.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> [closed_loop(plant, 556.766, 8.45505e-3, extra_delay=n).stable for n in (3, 4)]
    [True, False]
    """
    keep = np.arange(plant.C.size) if force[0] else plant.kept
    row, d0, d1 = plant.increment
    n, delay = keep.size, plant.delay + extra_delay
    history = delay + (1 if np.any(plant.G1) else 0)
    # s = [x, q[k]-q[k-1], q[k-1]-q[k-2], i[k-1], u[k-1] ... u[k-history], f[k-1] ... f[k-sensor_delay]]
    size = n + 3 + history + sensor_delay
    unit = np.eye(size)
    X, newer, older, integral = unit[:n], unit[n], unit[n + 1], unit[n + 2]
    past_u, past_f = unit[n + 3 : n + 3 + history], unit[n + 3 + history :]

    estimate = (plant.weights[0] * newer + plant.weights[1] * older) / plant.period
    state = np.zeros(plant.C.size)
    state[POSITION], state[VELOCITY] = -force[0], -force[1]
    f = state[keep] @ X
    read = past_f[-1] if sensor_delay else f
    reference, into = (k_e1 * read, k_e1) if k_e1 else (np.zeros(size), 1.0)
    i = integral + plant.period / t_v * (reference - estimate)
    U = k_v1 * (i - estimate)
    i_in, D = plant.period / t_v * into, k_v1 * plant.period / t_v * into

    lines = [U, *past_u]  # u[k], u[k-1], ...
    acting, acting_in = lines[delay], D if delay == 0 else 0.0
    earlier = lines[delay + 1] if np.any(plant.G1) else np.zeros(size)
    G0, G1 = plant.G0[keep], plant.G1[keep]
    S, R = np.zeros((size, size)), np.zeros(size)
    S[:n] = plant.Phi[np.ix_(keep, keep)] @ X + np.outer(G0, acting) + np.outer(G1, earlier)
    R[:n] = G0 * acting_in
    S[n] = row[keep] @ X + d0 * acting + d1 * earlier
    R[n] = d0 * acting_in
    S[n + 1] = newer
    S[n + 2], R[n + 2] = i, i_in
    if history:
        S[n + 3 : n + 3 + history] = lines[:history]
        R[n + 3] = D
    if sensor_delay:
        S[n + 3 + history :] = [f, *past_f][:sensor_delay]
    place = int(np.nonzero(keep == VELOCITY)[0][0])
    return ClosedLoop(S, R, U, D, unit[place], read)


@dataclass(frozen=True)
class SampledVelocityLoop:
    """Given gains in the loop as implemented: poles first, then margins at both places, then what they cost.

    ``k_v1`` [V/(m/s)], ``t_v`` [s].

    >>> from emps_design.control.plant.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> loop = SampledVelocityLoop(plant, 556.766, 8.45505e-3)
    >>> loop.stable, round(loop.margins.gain_margin, 2), round(loop.margins.delay_margin_samples, 2)
    (True, 4.73, 3.39)
    """

    plant: SampledPlant
    k_v1: float
    t_v: float

    @cached_property
    def loop(self) -> ClosedLoop:
        """The closed loop from velocity reference to voltage and velocity."""
        return closed_loop(self.plant, self.k_v1, self.t_v)

    @property
    def poles(self) -> np.ndarray:
        """Closed-loop poles in the z plane, largest first."""
        return self.loop.poles

    @property
    def stable(self) -> bool:
        """Whether the sampled closed loop is stable, by its poles."""
        return self.loop.stable

    def integrator(self, w: np.ndarray) -> np.ndarray:
        """T z / (z - 1) at ``w`` [rad/s], the sampled 1/s of the law [s]."""
        return self.plant.period / (1.0 - np.exp(-1j * np.asarray(w) * self.plant.period))

    def plant_input_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the plant input at ``w`` [rad/s]."""
        return self.k_v1 * (1.0 + self.integrator(w) / self.t_v) * self.plant.response(w)

    def velocity_error_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the velocity error at ``w`` [rad/s], the sampled T_vo."""
        inner = self.k_v1 * self.plant.response(w)
        return inner * self.integrator(w) / self.t_v / (1.0 + inner)

    def closed_loop_response(self, w: np.ndarray) -> np.ndarray:
        """From velocity reference to the velocity estimate at ``w`` [rad/s], the sampled T_vc."""
        forward = self.velocity_error_response(w)
        return forward / (1.0 + forward)

    @cached_property
    def margins(self) -> Margins:
        """Margins of the loop broken at the plant input."""
        return loop_margins(self.plant_input_response, self.plant.frequencies(), self.stable, self.plant.period)

    @cached_property
    def velocity_error(self) -> Margins:
        """Margins of the loop broken at the velocity error; undefined while the inner proportional path is unstable."""
        return loop_margins(self.velocity_error_response, self.plant.frequencies(), self.stable, self.plant.period)

    @cached_property
    def bandwidth(self) -> float | None:
        """First frequency where the velocity estimate has fallen to -3 dB [rad/s]; None if unstable."""
        if not self.stable:
            return None
        from emps_design.control.velocity.gains import MINUS_3_DB

        grid = self.plant.frequencies()
        below = np.nonzero(np.abs(self.closed_loop_response(grid)) < MINUS_3_DB)[0]
        if not below.size or below[0] == 0:
            return None
        low, high = float(grid[below[0] - 1]), float(grid[below[0]])
        while high - low > 1e-10 * high:
            middle = 0.5 * (low + high)
            if abs(self.closed_loop_response(np.array(middle))) < MINUS_3_DB:
                high = middle
            else:
                low = middle
        return 0.5 * (low + high)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Instability first, then what the linear loop leaves out and what is unbounded."""
        said = (
            []
            if self.stable
            else [f"the sampled loop is unstable: largest pole {abs(self.poles[0]):.4g}, outside the unit circle"]
        )
        said += self.plant.linear.warnings
        if self.stable and self.margins.gain_margin is None:
            said.append("the sampled loop's gain margin is unbounded")
        return tuple(said)

    def step_response(self, samples: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time [s], true velocity [m/s] and voltage [V] after a unit step of the reference, dry friction left out.

        >>> from emps_design.control.plant.discretisation import sample_axis
        >>> from emps_design.machines import machine
        >>> t, v, u = SampledVelocityLoop(sample_axis(machine("emps2018")), 556.766, 8.45505e-3).step_response()
        >>> round(float(v[-1]), 6)
        1.0
        """
        loop = self.loop
        s = np.zeros(len(loop.S))
        v, u = np.empty(samples), np.empty(samples)
        for k in range(samples):
            v[k] = loop.velocity @ s
            u[k] = loop.U @ s + loop.D
            s = loop.S @ s + loop.R
        return np.arange(samples) * self.plant.period, v, u

    def transfer_function(self) -> control.TransferFunction:
        """The open loop at the plant input as a discrete ``control.TransferFunction`` in z."""
        import control

        numerator, denominator = self.plant.polynomials
        T = self.plant.period
        return control.tf(
            self.k_v1 * np.polymul(numerator, [1.0 + T / self.t_v, -1.0]), np.polymul(denominator, [1.0, -1.0]), T
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data: margins at the plant input, those at the velocity error beside them, and the poles."""
        return {
            **self.margins.to_dict(),
            "bandwidth": self.bandwidth,
            "velocity_error": self.velocity_error.to_dict(),
            "poles": [[float(p.real), float(p.imag)] for p in self.poles],
            "period": self.plant.period,
        }
