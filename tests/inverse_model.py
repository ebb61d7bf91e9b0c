"""The inverse model of an axis in plain Python, states included: force for a motion, friction at steady speed.

All forces come from the kernels of the effects. Sign:
``tau = M qdd + F_v qd + F_c sign(qd) + offset + sum of the effects``, equation (2) of the paper without external force.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.effects import Effect, Motion
from emps_design.effects.effect import COULOMB, MASS, OFFSET, VISCOUS, Kernel
from emps_design.errors import InputError

Resolved = Sequence[tuple[Effect, np.ndarray]]  # effects with the arrays of their parameters

_SETTLED = 1e-9  # N, between two passes of a force that depends on itself
_PASSES = 200
_GRID = 20001  # points of the table that inverts a static actuator map


def _resolve(axis: Axis, channel: str) -> Resolved:
    own = [(effect.effect, effect.effect.values(effect.parameters)) for effect in axis.effects]
    return [(effect, p) for effect, p in own if effect.channel == channel]


def plant_force(axis: Axis, q: np.ndarray, v: np.ndarray, a: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Force [N] (n,) that must act on the carriage for the motion ``q`` [m], ``v`` [m/s], ``a`` [m/s^2] at ``t`` [s].

    ``q`` is the true position, without encoder errors. States of effects (a load behind a coupling, a bristle) start at
    rest and follow the motion. At rest the friction is taken as zero. A force that depends on the motor force
    (load-dependent friction) is solved by iteration.
    Raises :class:`InputError` for arrays of different length.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018").replace(effects=[{"kind": "elastic_force", "stiffness": 100, "rest_position": 0}])
    >>> plant_force(axis, *np.array([[0.1], [0.0], [2.0], [0.0]])).round(3).tolist()
    [241.463]
    """
    q, v, a, t = (np.atleast_1d(np.asarray(x, dtype=float)) for x in (q, v, a, t))
    if not q.shape == v.shape == a.shape == t.shape or q.ndim != 1:
        raise InputError(f"motion: found shapes {q.shape}, {v.shape}, {a.shape}, {t.shape}, expected four alike (n,)")
    b, effects = axis.mechanics.array(), _resolve(axis, "plant")
    states = [states_along(effect, p, b, effects, q, v, t) for effect, p in effects]
    free = any(effect.takes_dry for effect, _ in effects)
    force = np.empty(q.size)
    for k in range(q.size):
        tau = b[OFFSET]
        for _ in range(_PASSES):
            total, mass, level = b[VISCOUS] * v[k] + b[OFFSET], b[MASS], b[COULOMB]
            for (effect, p), x in zip(effects, states, strict=True):
                point = (q[k], v[k], t[k], tau, x[k], p, b)
                total += effect.force(*point) if effect.force is not None else 0.0
                mass += effect.inertia(*point) if effect.inertia is not None else 0.0
                level += effect.dry(*point) if effect.dry is not None else 0.0
            total += mass * a[k] + (0.0 if free else max(0.0, level) * np.sign(v[k]))
            settled = abs(total - tau) < _SETTLED
            tau = total
            if settled:
                break
        force[k] = tau
    return force


def inverse_force(axis: Axis, q: np.ndarray, v: np.ndarray, a: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Motor force G_tau u [N] (n,) for the motion: :func:`plant_force` with the inverse of the actuator's effects.

    A lag is inverted with the rate of the force, a delay by a time shift, a static map by its smallest voltage; a force
    that no voltage reaches (beyond a saturation) gives the nearest voltage that acts.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(effects=[{"kind": "actuator_deadzone", "width": 0.2}])
    >>> lost = inverse_force(axis, *np.array([[0.0], [0.1], [0.0], [0.0]])) - 0.2 * axis.drive.gain
    >>> lost.round(3).tolist()
    [37.579]
    """
    force = plant_force(axis, q, v, a, t)
    q, v, a, t = (np.atleast_1d(np.asarray(x, dtype=float)) for x in (q, v, a, t))
    b, gain = axis.mechanics.array(), axis.drive.gain
    force = force + axis.drive.braking * v
    if axis.drive.current_time_constant > 0 and t.size > 1:
        force = force + axis.drive.current_time_constant * np.gradient(force, t)
    for effect, p in reversed(_resolve(axis, "actuator")):
        if effect.actuator is not None:
            force = gain * _undo(effect.actuator, p, force / gain)
        elif effect.delay is not None and t.size > 1:
            force = np.interp(t + effect.delay(0.0, 0.0, 0.0, 0.0, (), p, b), t, force)
        elif effect.regressor is not None and t.size > 1:
            parameters = dict(zip([parameter.name for parameter in effect.parameters], map(float, p), strict=True))
            motion = Motion(t, q, v, a, force, float(t[1] - t[0]), force_gain=gain)
            shape = {name: parameters[name] for name in effect.shape}
            force = force + effect.regressor(motion, shape, b) @ effect.coefficients(parameters)
    return force


def _undo(actuator: Kernel, p: np.ndarray, acting: np.ndarray) -> np.ndarray:
    """The smallest voltages (n,) [V] that a static actuator map converts to ``acting`` (n,) [V]."""
    reach = 2.0 * float(np.abs(acting).max(initial=0.0)) + 2.0 * float(np.abs(p).max(initial=0.0)) + 1.0
    voltages = np.linspace(-reach, reach, _GRID)
    outputs = np.array([actuator(u, p) for u in voltages])
    order = np.lexsort((np.abs(voltages), outputs))
    first = np.concatenate(([True], np.diff(outputs[order]) > 0))
    return np.interp(acting, outputs[order][first], voltages[order][first])


def states_along(
    effect: Effect, p: np.ndarray, b: np.ndarray, effects: Resolved, q: np.ndarray, v: np.ndarray, t: np.ndarray
) -> np.ndarray:
    """States (n, n_states) of ``effect`` while the carriage follows ``q`` [m], ``v`` [m/s] over ``t`` [s].

    They start at rest; the dry friction of ``effects`` adds to the present Coulomb level.
    """
    change = effect.rate
    if change is None:
        return np.zeros((q.size, 0))
    start = effect.at_rest(q[0], p, b)
    if q.size < 2:
        return start[None, :]
    path = scipy.interpolate.CubicHermiteSpline(t, q, v)
    times, places, speeds = t.tolist(), path.c.T.tolist(), path.derivative().c.T.tolist()

    def rate(now: float, x: np.ndarray) -> np.ndarray:
        # The spline at one time in plain numbers, much faster than a call of the spline.
        k = min(max(bisect_right(times, now) - 1, 0), len(times) - 2)
        s, dx = now - times[k], np.zeros(start.size)
        cubic, square, slope, place = places[k]
        here = place + slope * s + square * (s * s) + cubic * (s * s * s)
        square, slope, speed = speeds[k]
        there = speed + slope * s + square * (s * s)
        dry = [other.dry(here, there, now, 0.0, (), values, b) for other, values in effects if other.dry is not None]
        change(here, there, now, 0.0, x, p, b, max(0.0, b[COULOMB] + sum(dry)), dx)
        return dx

    longest = float(np.diff(t).max())
    return scipy.integrate.solve_ivp(
        rate, (t[0], t[-1]), start, "LSODA", t_eval=t, rtol=1e-7, atol=1e-10, max_step=longest
    ).y.T  # fmt: skip


def steady_friction(axis: Axis, v: np.ndarray, q: float = 0.0, t: float = 0.0) -> np.ndarray:
    """Force [N] (n,) for the steady speeds ``v`` (n,) [m/s] at ``q`` [m] and ``t`` [s]: the friction curve of Fig. 3.

    It includes the effects of the axis. Those with states are settled: a bristle has the Coulomb level, a coupling no
    force.

    >>> from emps_design.machines import machine
    >>> steady_friction(machine("emps2018"), np.array([-0.1, 0.1])).round(4).tolist()
    [-64.8784, 64.8784]
    """
    v = np.atleast_1d(np.asarray(v, dtype=float))
    settled = axis.replace(effects=[entry for entry in axis.effects if entry.effect.rate is None])
    still = np.zeros(v.size)
    return plant_force(settled, still + q, v, still, still + t)
