"""Control laws as they run in the drive: difference equations at sample k, in the form every stepper calls.

``law(sample, reference, q, f_ext, limit, gains, memory) -> volts``: ``sample`` counts from 0; ``reference`` is what the
law follows (a position [m], or a velocity [m/s] for ``ip_velocity``); ``q`` [m] is what the encoder reports, ``f_ext``
[N] what a force sensor on the carriage reports; ``limit`` [V] bounds the voltage; ``memory`` is the law's own, zero at
first. Before the first sample the carriage stood still at ``q[0]``. A law of one's own goes in the same way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import AxisError


def position_pd(k, reference, q, f_ext, limit, gains, memory):
    """``u = kp kv (q_ref - q) - kv v``; gains: kp kv, kv, 1/T, two-tap. Controller of the 2019 data set."""
    if k == 0:
        memory[0] = q
        memory[1] = q
    if gains[3] > 0.0:
        v = 0.5 * (q - memory[1]) * gains[2]
    else:
        v = (q - memory[0]) * gains[2]
    memory[1] = memory[0]
    memory[0] = q
    return gains[0] * (reference - q) - gains[1] * v


def ip_velocity(k, reference, q, f_ext, limit, gains, memory):
    """Integral of the velocity error, proportional on the measured velocity, section II-C of the paper.

    ``u = I - k_v1 v``, ``I += (k_v1 T / t_v) (reference + k_e1 f_ext - v)``; where the voltage limit cuts ``u``, ``I``
    is set back to the value that just reaches the limit. Gains: k_v1, k_v1 T / t_v, k_e1, 1/T, two-tap.
    """
    if k == 0:
        memory[0] = q
        memory[1] = q
        memory[2] = 0.0
    if gains[4] > 0.0:
        v = 0.5 * (q - memory[1]) * gains[3]
    else:
        v = (q - memory[0]) * gains[3]
    memory[1] = memory[0]
    memory[0] = q
    memory[2] += gains[1] * (reference + gains[2] * f_ext - v)
    u = memory[2] - gains[0] * v
    if u > limit:
        memory[2] = limit + gains[0] * v
        u = limit
    elif u < -limit:
        memory[2] = -limit + gains[0] * v
        u = -limit
    return u


@dataclass(frozen=True)
class Law:
    """A control law with its numbers: the kernel, its ``gains``, the length of its ``memory``, what it follows."""

    kernel: Callable[..., float]
    gains: np.ndarray
    memory: int
    follows: str = "position"  # or "velocity"


def law_of(axis: Axis, period: float) -> Law:
    """The law an axis file asks for, at a sampling ``period`` [s].

    Raises :class:`AxisError` where the controller is ``none``, which has no law to close a loop with.
    """
    controller = axis.controller
    two_tap = float(controller.velocity_estimator == "two_tap")
    if controller.kind == "position_pd":
        return Law(position_pd, np.array([controller.kp * controller.kv, controller.kv, 1.0 / period, two_tap]), 2)
    if controller.kind == "ip_velocity":
        integral = controller.k_v1 * period / controller.t_v
        gains = np.array([controller.k_v1, integral, controller.k_e1 or 0.0, 1.0 / period, two_tap])
        return Law(ip_velocity, gains, 3, follows="velocity")
    if controller.kind == "impedance":
        from emps_design.simulation.impedance_law import impedance_law

        return impedance_law(axis, period)
    raise AxisError(
        f"controller.kind: found {controller.kind!r}, expected position_pd, ip_velocity or impedance to close a loop; "
        "give closed_loop(law=...) or simulate open_loop"
    )
