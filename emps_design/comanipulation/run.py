"""Run a law through a task on an axis with all its effects: one with its whole trace, or many with their measures.

Impedance laws that differ in their estimates run side by side (:mod:`.lanes`) on an axis that is the friction plant;
every other one, and one that lanes give up, is a run of the general stepper. Nothing is shared between plants, so the
numbers are the same for any number of workers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design import laws as control_laws
from emps_design.axis import Axis
from emps_design.comanipulation.lanes import OWN, ROWS, run_lanes
from emps_design.comanipulation.measures import MEASURES, Measures, broken_off, measure
from emps_design.comanipulation.task import Task
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw, law_for
from emps_design.control.impedance.robustness import VERDICTS, drift_speed, drift_threshold
from emps_design.errors import InputError
from emps_design.laws.library import ip_velocity
from emps_design.laws.library.impedance import DELAY, TAPS, impedance
from emps_design.simulation.environment import HAND, Hand
from emps_design.simulation.kernels import motion
from emps_design.simulation.kernels.compile import address, cached
from emps_design.simulation.kernels.hold_loop import DONE
from emps_design.simulation.kernels.hold_loop import run as run_samples
from emps_design.simulation.kernels.lanes import LANES, room
from emps_design.simulation.plant import Plant
from emps_design.simulation.prepared import Prepared

# Rows of the table of hooks that change what comes to the motion and what is seen of it.
AROUND = (motion.COMMAND, motion.ACTUATOR, motion.DELAY, motion.SENSOR, motion.TOUCH)
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
    setup = Setup.of(axis, [law], task)
    raw, out, good = setup.alone(setup.law.gains)
    rows = dict(zip(("encoder", "q", "v", "u", "tau_e"), out[:, : min(good, len(task.push))], strict=True))
    return TaskRun(t=task.time[: len(rows["q"])], measures=_measures(axis, [law], raw), **rows)


def run_many(
    axis: Axis, laws: Sequence[Law], task: Task, workers: int = 1, progress: Any = None, machine: Axis | None = None
) -> Measures:
    """Simulate every one of ``laws`` on ``axis`` with all its effects through ``task``; what was measured, law by law.

    They are of one kind; an impedance law whose estimate holds arrays (m,) is m laws. ``machine`` is the axis as it
    really is, where it is not the one that the laws were set up for.
    ``workers`` threads; the numbers do not depend on it. ``progress(stage, fraction)`` is called as blocks finish.
    """
    setup = Setup.of(axis, laws, task, machine)
    gains, m = setup.law.gains, len(setup.law.gains)
    parts = [gains[start : start + BLOCK] for start in range(0, m, BLOCK)]
    raw = np.empty((m, MEASURES))
    done = 0
    for rows in in_threads(setup.measured, parts, workers):
        raw[done : done + len(rows)] = rows
        done += len(rows)
        if progress is not None:
            progress("plants", done / m)
    return _measures(axis, laws, raw)


def in_threads(work: Callable[[Any], Any], parts: Sequence[Any], workers: int) -> Iterator[Any]:
    """What ``work`` makes of each of the ``parts``, in their order, by ``workers`` threads."""
    if workers == 1 or len(parts) == 1:
        return map(work, parts)
    from joblib import Parallel, delayed

    return Parallel(n_jobs=workers, prefer="threads", return_as="generator")(delayed(work)(part) for part in parts)


@dataclass(frozen=True)
class Setup:
    """What the runs of a task share: ``law`` with a row of gains for each, the ``rest`` it follows [m], the plant."""

    law: control_laws.Law
    rest: float
    task: Task
    ready: Prepared

    @classmethod
    def of(cls, axis: Axis, laws: Sequence[Law], task: Task, machine: Axis | None = None) -> Setup:
        """Set ``laws`` up for ``axis``, and the operator at the ``machine``; :class:`InputError` for another period."""
        period = axis.sampling.period
        if task.period != period:
            raise InputError(
                f"task: found a period of {task.period:g} s, expected the axis's {period:g} s; "
                "make the task with the axis's period"
            )
        compiled = [
            law_for(axis, law, period) if isinstance(law, ImpedanceLaw) else ip_velocity.LAW.law(law, axis, period)
            for law in laws
        ]
        machine = machine or axis
        stiffness, damping = task.hand
        plant, wish, sampling = Plant.of(machine), None, machine.sampling
        if stiffness or damping:
            plant, wish = plant.touched_by(Hand(0.0, damping, stiffness, held=True)), np.append(task.wish, np.nan)
        n = len(task.push) + 1  # one sample more: the state in which the last period ends
        b, p = plant.numbers()
        ready = plant.prepared(b, p, 0.0, 0.0, n, sampling.period, sampling.encoder_resolution, wish)
        law = replace(compiled[0], gains=np.vstack([one.gains for one in compiled]))
        return cls(law, getattr(laws[0], "rest_position", 0.0), task, ready)

    @cached_property
    def in_lanes(self) -> bool:
        """Whether lanes can run it: a held hand on the friction plant, no delay, laws enough and alike but in OWN."""
        common, ready = self.law.gains[:, OWN:], self.ready
        plain = ready.settings[motion.EXACT] > 0.0 and not np.diff(ready.starts)[list(AROUND)].any()
        at_once = ready.settings[motion.DELAYED] == 0.0 and common[0, DELAY - OWN] == 0.0
        alike = self.law.kernel is impedance and len(common) >= LANES and np.all(common == common[0])
        alike = alike and common[0, TAPS - OWN] >= 0.0  # no filter in the velocity estimate
        return bool(plain and at_once and alike)

    def measured(self, gains: np.ndarray) -> np.ndarray:
        """Measures (m, MEASURES) of the laws with ``gains`` (m, g)."""
        if not self.in_lanes:
            return self.alone(gains)[0]
        raw = self.side_by_side(gains)
        lost = np.isnan(raw).all(axis=1)
        if lost.any():
            raw[lost] = self.alone(gains[lost])[0]
        return raw

    def side_by_side(self, gains: np.ndarray) -> np.ndarray:
        """The same with nan for the laws that lanes give up."""
        ready, task, m = self.ready, self.task, len(gains)
        own = np.concatenate([gains[:, :OWN], np.repeat(gains[:1, :OWN], -m % LANES, axis=0)])
        hand = ready.columns if ready.columns.size else np.zeros((len(task.push), len(HAND.parameters)))
        raw = np.empty((len(own), MEASURES))
        run_lanes(
            own, tuple(gains[0, OWN:].tolist()), ready.baseline, ready.settings, tuple(ready.y.tolist()), self.rest,
            task.push, hand, np.nan_to_num(task.wish), task.turns, task.release, task.end, room(ROWS),
            room(len(task.push) - task.release + 1), np.zeros(2, np.int64), raw,
        )  # fmt: skip
        return raw[:m]

    def alone(self, gains: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """Measures, the signals of the last run, and how many samples of them are good."""
        ready, task = self.ready, self.task
        n = len(task.push) + 1
        raw, out = np.empty((len(gains), MEASURES)), np.empty((5, n))
        good = run_block(
            np.tile(ready.parameters, (len(gains), 1)), ready.baseline, ready.settings, ready.y, ready.hooks,
            ready.starts, ready.columns, ready.slots, ready.floors, ready.scratch.copy(),
            address(self.law.kernel, "law"), gains, np.zeros(self.law.memory), np.full(n, self.rest),
            np.append(task.push, 0.0), np.nan_to_num(task.wish), task.turns, task.release, task.end, out, raw,
        )  # fmt: skip
        return raw, out, good


@cached()
def run_block(
    parameters, baseline, settings, y0, hooks, starts, columns, slots, floors, scratch, law, gains, memory, reference,
    push, wish, turns, release, end, out, measures,
):  # fmt: skip
    """Run one plant for each row of ``parameters`` and ``gains``; returns the number of good samples of the last."""
    y, none, noted, found = y0.copy(), np.zeros(0), np.zeros((0, 3)), np.zeros(2, np.int64)
    good, steady, period, limit = 0, np.zeros((0, 2)), settings[motion.PERIOD], settings[motion.LIMIT]
    for i in range(gains.shape[0]):
        y[:] = y0
        memory[:] = 0.0
        found[0] = 0
        status, good, _ = run_samples(
            (baseline, hooks, starts, parameters[i], settings), y, law, gains[i : i + 1], memory, reference, push, none,
            steady, columns, slots, floors, scratch, out, noted, found,
        )  # fmt: skip
        if status == DONE:
            measure(out[1], out[2], out[3], out[4], wish, turns, limit, period, release, end, measures[i])
        else:
            broken_off(limit, measures[i])
    return good


def _measures(axis: Axis, laws: Sequence[Law], raw: np.ndarray) -> Measures:
    """``raw`` with what is expected of each law: how fast friction drives it, and what of that is too slow to show."""
    period, resolution, plant = axis.sampling.period, axis.sampling.encoder_resolution, FrictionModel.of(axis)
    known = []
    for law in laws:
        drift, integrates = 0.0, True
        if isinstance(law, ImpedanceLaw):
            drift, integrates = np.maximum(drift_speed(law, plant, 1), drift_speed(law, plant, -1)), False
        threshold = drift_threshold(period, resolution, law.velocity_estimator)
        known.append(np.stack(np.broadcast_arrays(threshold, drift, integrates), axis=-1))
    threshold, expected, integrates = np.vstack(known).T
    return Measures(raw, max(resolution / period, 1e-6), threshold, expected, integrates > 0.0)
