"""Run a law through a task on an axis with all its effects: one with its whole trace, or many with their measures.

Every plant is one call of the general stepper; nothing is shared between plants, so the numbers are the same for any
number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design import laws as control_laws
from emps_design.axis import Axis
from emps_design.comanipulation.measures import MEASURES, Measures, broken_off, measure
from emps_design.comanipulation.task import Task
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw, law_for
from emps_design.control.impedance.robustness import VERDICTS, drift_speed, drift_threshold
from emps_design.errors import InputError
from emps_design.laws.library import ip_velocity
from emps_design.simulation.environment import Hand
from emps_design.simulation.kernels.compile import address, cached
from emps_design.simulation.kernels.hold_loop import DONE
from emps_design.simulation.kernels.hold_loop import run as run_samples
from emps_design.simulation.plant import Plant

BLOCK = 256  # plants a worker takes at a time; no number depends on it


# The cascaded loop of Fig. 4 with a force sensor, by its parameters, beside the impedance law.
Law = ImpedanceLaw | ip_velocity.Table


@dataclass(frozen=True)
class TaskRun:
    """One simulated task: ``t`` [s], ``q`` [m], ``v`` [m/s], ``tau_e`` [N], ``u`` [V], ``encoder`` [m], each (n,).

    Where the simulation found the loop unstable and gave up, the signals end there.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    tau_e: np.ndarray
    u: np.ndarray
    encoder: np.ndarray
    measures: Measures

    @property
    def verdict(self) -> str:
        """One of ``VERDICTS``."""
        return VERDICTS[int(self.measures.verdict[0])]


def run_task(axis: Axis, law: Law, task: Task) -> TaskRun:
    """Simulate ``law`` on ``axis`` with all its effects through ``task``, and keep the whole trace.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.comanipulation.task import pushed_task
    >>> axis = machine("emps2018")
    >>> run_task(axis, impedance_law(axis, 50.0, 100.0), pushed_task(axis.sampling.period)).verdict
    'stable'
    """
    raw, out, good = _blocks(axis, [law], task)
    rows = dict(zip(("encoder", "q", "v", "u", "tau_e"), out[:, : min(good, len(task.push))], strict=True))
    return TaskRun(t=task.time[: len(rows["q"])], measures=_measures(axis, [law], raw), **rows)


def run_many(
    axis: Axis, laws: Sequence[Law], task: Task, workers: int = 1, progress: Any = None, machine: Axis | None = None
) -> Measures:
    """Simulate every one of ``laws`` on ``axis`` with all its effects through ``task``; what was measured, law by law.

    ``machine`` is the axis as it really is, where it is not the one that the laws were set up for.
    ``workers`` threads; the numbers do not depend on it. ``progress(stage, fraction)`` is called as blocks finish.
    """
    m = len(laws)
    parts = [laws[start : start + BLOCK] for start in range(0, m, BLOCK)]

    def block(part: Sequence[Law]) -> np.ndarray:
        return _blocks(axis, part, task, machine)[0]

    if workers == 1 or len(parts) == 1:
        finished = map(block, parts)
    else:
        from joblib import Parallel, delayed

        finished = Parallel(n_jobs=workers, prefer="threads", return_as="generator")(delayed(block)(p) for p in parts)
    raw = np.empty((m, MEASURES))
    done = 0
    for rows in finished:
        raw[done : done + len(rows)] = rows
        done += len(rows)
        if progress is not None:
            progress("plants", done / m)
    return _measures(axis, laws, raw)


def _blocks(
    axis: Axis, laws: Sequence[Law], task: Task, machine: Axis | None = None
) -> tuple[np.ndarray, np.ndarray, int]:
    """Measures (m, MEASURES) of ``laws``, the signals of the last one, and how many samples of them are good."""
    if task.period != axis.sampling.period:
        raise InputError(
            f"task: found a period of {task.period:g} s, expected the axis's {axis.sampling.period:g} s; "
            "make the task with the axis's period"
        )
    compiled = [_compiled(axis, law) for law in laws]
    first = compiled[0]
    stiffness, damping = task.hand
    machine = machine or axis
    plant = Plant.of(machine)
    wish = None
    if stiffness or damping:
        plant, wish = plant.touched_by(Hand(0.0, damping, stiffness, held=True)), np.append(task.wish, np.nan)
    n = len(task.push) + 1  # one sample more: the state in which the last period ends
    sampling = machine.sampling
    b, p = plant.numbers()
    ready = plant.prepared(b, p, 0.0, 0.0, n, sampling.period, sampling.encoder_resolution, wish)
    raw, out = np.empty((len(laws), MEASURES)), np.empty((5, n))
    reference = np.full(n, getattr(laws[0], "rest_position", 0.0))
    good = run_block(
        np.tile(ready.parameters, (len(laws), 1)), ready.baseline, ready.settings, ready.y, ready.hooks, ready.starts,
        ready.columns, ready.slots, ready.floors, ready.scratch, address(first.kernel, "law"),
        np.array([law.gains for law in compiled]), np.zeros(first.memory), reference, np.append(task.push, 0.0),
        np.nan_to_num(task.wish), machine.drive.command_limit, task.release, task.end, out, raw,
    )  # fmt: skip
    return raw, out, good


@cached()
def run_block(
    parameters, baseline, settings, y0, hooks, starts, columns, slots, floors, scratch, law, gains, memory, reference,
    push, wish, limit, release, end, out, measures,
):  # fmt: skip
    """Run one plant for each row of ``parameters`` and ``gains``; returns the number of good samples of the last."""
    y, none, noted, found = y0.copy(), np.zeros(0), np.zeros((0, 3)), np.zeros(2, np.int64)
    good, steady = 0, np.zeros((0, 2))
    for i in range(gains.shape[0]):
        y[:] = y0
        memory[:] = 0.0
        found[0] = 0
        status, good, _ = run_samples(
            (baseline, hooks, starts, parameters[i], settings), y, law, gains[i : i + 1], memory, reference, push, none,
            steady, columns, slots, floors, scratch, out, noted, found,
        )  # fmt: skip
        if status == DONE:
            measure(out[1], out[2], out[3], out[4], wish, limit, settings[0], release, end, measures[i])
        else:
            broken_off(limit, measures[i])
    return good


def _compiled(axis: Axis, law: Law) -> control_laws.Law:
    """``law`` as the stepper takes it."""
    period = axis.sampling.period
    return law_for(axis, law, period) if isinstance(law, ImpedanceLaw) else ip_velocity.LAW.law(law, axis, period)


def _measures(axis: Axis, laws: Sequence[Law], raw: np.ndarray) -> Measures:
    period, resolution, plant = axis.sampling.period, axis.sampling.encoder_resolution, FrictionModel.of(axis)
    integrates = np.array([not isinstance(law, ImpedanceLaw) for law in laws])
    expected = [
        max(drift_speed(law, plant, 1), drift_speed(law, plant, -1)) if isinstance(law, ImpedanceLaw) else 0.0
        for law in laws
    ]
    threshold = [drift_threshold(period, resolution, law.velocity_estimator) for law in laws]
    return Measures(raw, max(resolution / period, 1e-6), np.array(threshold), np.array(expected), integrates)
