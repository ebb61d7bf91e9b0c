"""The inverse dynamic model, compiled: the force that a motion needs, from the kernels of the effects.

``tau = (M + inertia) a + F_v v + offset + force + max(0, F_c + dry) s``, s the direction; solved by iteration if a
kernel reads the motor force.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from emps_design.effects import Effect
from emps_design.effects.effect import ADDED
from emps_design.simulation.kernels.compile import address, cached, call_kernel, part, pointer

FORCE, DRY, INERTIA = range(3)  # rows of the table: the hooks ADDED
_call: Any = call_kernel
_place: Any = pointer
PASSES, SETTLED = 100, 1e-10  # iterations of a force that depends on itself, and convergence [N]


@part
def summed(row, q, v, tau, nothing, b, hooks, starts, p):
    """Sum of the kernels of one hook."""
    value = 0.0
    for i in range(starts[row], starts[row + 1]):
        value += _call(hooks[2 * i], q, v, 0.0, tau, nothing, 0, p, hooks[2 * i + 1], b)
    return value


@cached()
def force_along(q, v, a, direction, baseline, b, hooks, starts, p, nothing, force):
    """Fill ``force`` (n,) [N] for the motion ``q``, ``v``, ``a`` and ``direction`` (n,), -1 to 1.

    ``baseline`` is that of the force, ``b`` the one that the kernels read.
    """
    b_, hooks_, starts_, p_, nothing_ = _place(b), _place(hooks), _place(starts), _place(p), _place(nothing)
    for k in range(q.size):
        tau = 0.0
        for _ in range(PASSES):
            mass = baseline[0] + summed(INERTIA, q[k], v[k], tau, nothing_, b_, hooks_, starts_, p_)
            level = max(0.0, baseline[2] + summed(DRY, q[k], v[k], tau, nothing_, b_, hooks_, starts_, p_))
            total = baseline[1] * v[k] + baseline[3] + summed(FORCE, q[k], v[k], tau, nothing_, b_, hooks_, starts_, p_)
            total += mass * a[k] + level * direction[k]
            settled = abs(total - tau) < SETTLED
            tau = total
            if settled:
                break
        force[k] = tau


def table(effects: Sequence[Effect]) -> tuple[np.ndarray, np.ndarray]:
    """Return the addresses of the hooks with the places of their parameters, and the start of each kind of hook."""
    places = np.cumsum([0, *(len(effect.parameters) for effect in effects)])
    rows = []
    for hook in ADDED:
        kernels = [(getattr(effect, hook), int(at)) for effect, at in zip(effects, places, strict=False)]
        rows.append([(address(kernel), at) for kernel, at in kernels if kernel is not None])
    hooks = np.array([number for row in rows for entry in row for number in entry] or [0], np.int64)
    return hooks, np.cumsum([0, *map(len, rows)])
