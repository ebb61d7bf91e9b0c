"""The co-manipulation task on an axis with effects: the general simulator runs it, the same measures judge it.

Only pushes of a given force: the hand of :func:`guided_task` is part of the compiled friction plant.
"""

from __future__ import annotations

import numpy as np

from emps_design.axis import Axis
from emps_design.comanipulation import kernel as kernel
from emps_design.comanipulation.run import Measures, Run, measures_of
from emps_design.comanipulation.task import Task
from emps_design.control.impedance.law import ImpedanceLaw, law_for
from emps_design.errors import InputError, SimulationError
from emps_design.simulation.plant import Plant


def run_extended(axis: Axis, law: ImpedanceLaw, task: Task) -> Run | None:
    """Simulate ``law`` on ``axis`` with all its effects through a pushed ``task``; None where it diverges.

    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.machines import machine
    >>> from emps_design.comanipulation.task import pushed_task
    >>> axis = machine("emps2018")
    >>> run_extended(axis, impedance_law(axis, 50.0, 100.0), pushed_task(1e-3)).verdict
    'stable'
    """
    if task.hand != (0.0, 0.0):
        raise InputError(f"task: found {task.name!r} with a hand, expected a pushed task for an axis with effects")
    push = np.append(task.reference[:, 0], 0.0)  # one sample more: the state in which the last period ends
    try:
        found = Plant.of(axis).closed_loop(np.zeros(len(push)), disturbance=push, law=law_for(axis, law, task.period))
    except SimulationError:
        return None
    n = len(task.reference)
    limit = axis.drive.voltage_limit
    raw = measure(task, found.position, found.v, found.u[:n], limit)
    return Run(
        t=task.time,
        q=found.position[:n],
        v=found.v[:n],
        tau=axis.drive.force_gain * found.u[:n],
        tau_e=task.reference[:, 0],
        u=found.u[:n],
        encoder=found.q[:n],
        measures=measures_of(axis, raw[None], np.array([False])),
    )


def diverged(axis: Axis) -> Measures:
    """Measures of a run that could not be finished: unstable, and nothing else known."""
    raw = np.full((1, kernel.MEASURES), np.nan)
    raw[0, [kernel.P_DIVERGED, kernel.P_PEAK_U]] = 1.0, axis.drive.voltage_limit
    return measures_of(axis, raw, np.array([False]))


def measure(task: Task, q: np.ndarray, v: np.ndarray, u: np.ndarray, limit: float) -> np.ndarray:
    """Measures of a run from its samples, as the compiled kernel takes them: q, v (n + 1,), u (n,) -> (MEASURES,)."""
    n, release, end, period = len(u), task.release, task.end, task.period
    raw = np.zeros(kernel.MEASURES)
    force, moved = task.reference[:, 0], np.diff(q)
    clip = np.where(u >= limit, 1.0, np.where(u <= -limit, -1.0, 0.0))
    at = np.flatnonzero(clip)
    flipped = (clip[at[1:]] * clip[at[:-1]] < 0.0) & (np.diff(at) <= kernel.SWING)
    held, moving = slice(0, release), v[:release] * v[1 : release + 1] > 0.0
    a, w = np.diff(v)[held][moving] / period, moved[held][moving] / period
    f = force[held][moving]
    still = np.flatnonzero(v[release + 1 :] == 0.0)
    stopped = release + still[0] + 1 if len(still) else n
    turned = (v[end:-1] * v[end + 1 :] < 0.0) | ((v[end:-1] != 0.0) & (v[end + 1 :] == 0.0))
    for place, value in {
        kernel.P_PEAK_U: np.abs(u).max(),
        kernel.P_CLIPPED: np.count_nonzero(clip),
        kernel.P_CLIPPED_END: np.count_nonzero(clip[end:]),
        kernel.P_FLIPS: np.count_nonzero(flipped),
        kernel.P_PEAK_FORCE: np.abs(force[held]).max(),
        kernel.P_FORCE2: np.sum(force[held] ** 2),
        kernel.P_IMPULSE: np.sum(np.abs(force[held])) * period,
        kernel.P_WORK: np.sum(force[held] * moved[held]),
        kernel.P_PATH: np.sum(np.abs(moved[held])),
        kernel.P_MISS2: np.sum((task.reference[held, 1] - q[held]) ** 2),
        kernel.P_HELD: release,
        kernel.P_N: np.count_nonzero(moving),
        kernel.P_AA: a @ a,
        kernel.P_AV: a @ w,
        kernel.P_VV: w @ w,
        kernel.P_AF: a @ f,
        kernel.P_VF: w @ f,
        kernel.P_FF: f @ f,
        kernel.P_END_MIN_V: v[end + 1 :].min(),
        kernel.P_END_MAX_V: v[end + 1 :].max(),
        kernel.P_END_TURNS: np.count_nonzero(turned),
        kernel.P_END_MIN_U: u[end:].min(),
        kernel.P_END_MAX_U: u[end:].max(),
        kernel.P_END_SPEED: np.sum(moved[end:]) / (period * max(n - end, 1)),
    }.items():
        raw[place] = value
    kernel.drift(np.ascontiguousarray(q[release:]), stopped - release, period, raw)
    return raw
