"""Simulate a task under a law on an axis with all its effects: one run with its signals, or many with their measures.

Impedance laws that differ in their estimates run in parallel lanes (:mod:`~emps_design.simulation.kernels.lanes`) if
the plant is the friction model with the operator's hand. One vector loop steps all lanes by a period; a lane whose
carriage stops or starts within the period is then stepped separately. Every other law, and one that the lanes cannot
simulate, runs in the general stepper (:mod:`~emps_design.simulation.kernels.hold_loop`) with the same kernels of law,
hand, motion and measures. Plants are independent, so the results depend neither on neighbouring lanes nor on the number
of workers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.comanipulation.task import (
    MEASURES,
    Measures,
    Task,
    finish,
    mark_unstable,
    measure,
    measure_end,
    measure_free,
    measure_guided,
    reset,
)
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw, law_for
from emps_design.control.impedance.robustness import VERDICTS, drift_speed, drift_threshold
from emps_design.errors import InputError
from emps_design.laws import Law
from emps_design.laws.library import ip_velocity
from emps_design.laws.library.impedance import (
    DELAY,
    KEEP_ACCELERATION,
    RATE,
    REFERENCE_VELOCITY,
    TAPS,
    WAITING,
    impedance,
)
from emps_design.progress import Progress, no_progress
from emps_design.simulation.environment import HAND, Hand, hand_force
from emps_design.simulation.kernels import motion
from emps_design.simulation.kernels.compile import address, built_in, cached, inlined, pointer
from emps_design.simulation.kernels.friction_period import response
from emps_design.simulation.kernels.hold_loop import DONE, run as run_samples
from emps_design.simulation.kernels.lanes import LANES, lane, room, row, step, step_again
from emps_design.simulation.kernels.motion import GAIN, LIMIT, PERIOD, RESOLUTION, encoded, friction_of
from emps_design.simulation.plant import Inputs, Plant, Prepared

OWN = KEEP_ACCELERATION  # number of gains that differ between laws; the gains after them are common to all
ROWS = 14 + OWN + WAITING + MEASURES
_DELAY, _RATE, _TAPS, _REFERENCE = DELAY - OWN, RATE - OWN, TAPS - OWN, REFERENCE_VELOCITY - OWN
_hand_force, _law = built_in(hand_force), built_in(impedance)

# Rows of the table of hooks that change the force on the motion or its measurement.
AROUND = (motion.COMMAND, motion.ACTUATOR, motion.DELAY, motion.SENSOR, motion.TOUCH)
BLOCK = 256  # plants per task of a worker; no influence on the results


# The impedance law, or the parameters of the cascaded loop of Fig. 4 with a force sensor.
TaskLaw = ImpedanceLaw | ip_velocity.Table


@inlined
def _voltage(k, reference, q, force, limit, own, at_once, memory):
    """Voltage [V] of one law at sample ``k``."""
    gains = (own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7], *at_once)
    return _law(k, reference, q, force, limit, gains, memory)


@cached()
def run_lanes(
    own, common, baseline, settings, start, reference, push, hand, wish, turns, release, end, scratch, free, tally,
    measures,
):  # fmt: skip
    """Run the laws with gains ``own`` (m, OWN) and ``common``, m a multiple of LANES; fill ``measures`` (m, MEASURES).

    Commands act without delay; ``start`` = (q0, v0). ``hand`` (n, 6) are the parameters of the hand's force at each
    sample; the other arguments are those of :func:`~emps_design.comanipulation.task.measure`. ``scratch`` has ROWS
    rows, ``free`` has one row for each sample from the release on and one more, and ``tally`` is two zeros, so that no
    event is recorded. A law whose voltage reaches the limit, or whose carriage diverges, gets nan: the lanes do not
    simulate further.
    """
    rows, places, kept = pointer(scratch), pointer(free), pointer(tally)
    q, v, tau, q1, v1, tau1 = row(rows, 0), row(rows, 1), row(rows, 2), row(rows, 3), row(rows, 4), row(rows, 5)
    u, command, force, release_v = row(rows, 6), row(rows, 7), row(rows, 8), row(rows, 9)
    stops, lost, encoder, gains = row(rows, 10), row(rows, 11), row(rows, 12), row(rows, 13)
    now, after, memory, sums = (q, v, tau), (q1, v1, tau1), row(gains, OWN), row(gains, OWN + WAITING)
    period, limit, resolution, gain = settings[PERIOD], settings[LIMIT], settings[RESOLUTION], settings[GAIN]
    friction = friction_of(pointer(baseline), pointer(settings))
    mass, viscous_p, viscous_n, _, _, lag = friction
    forward, backward = response(period, mass, viscous_p, lag), response(period, mass, viscous_n, lag)
    # Constants for the compiler: no delay, and an estimator without a filter and its coefficients.
    named = 1.0 if common[_TAPS] > 0.0 else 0.0
    at_once = (*common[:_DELAY], 0.0, common[_RATE], named, common[_REFERENCE], 0.0)
    n = push.size
    for block in range(0, own.shape[0], LANES):
        for i in range(LANES):
            q[i], v[i], tau[i], lost[i] = start[0], start[1], 0.0, 0.0
            g, m = lane(gains, i), lane(memory, i)
            for j in range(OWN):
                g[j] = own[block + i, j]
            for j in range(WAITING):
                m[j] = 0.0
            reset(n, release, lane(sums, i))
        for k in range(n):
            t, pushed, meant = k * period, push[k], wish[k]
            grip = (hand[k, 0], hand[k, 1], hand[k, 2], hand[k, 3], hand[k, 4], hand[k, 5])
            for i in range(LANES):
                force[i] = pushed - _hand_force(q[i], v[i], t, 0.0, None, grip, None)
                encoder[i] = encoded(q[i], resolution)
            if k == 0:  # separate, since a loop that may initialise memories would write all of them under a mask
                for i in range(LANES):
                    u[i] = _voltage(k, reference, encoder[i], force[i], limit, lane(gains, i), at_once, lane(memory, i))
            else:
                for i in range(LANES):
                    u[i] = _voltage(k, reference, encoder[i], force[i], limit, lane(gains, i), at_once, lane(memory, i))
            events = 0
            for i in range(LANES):
                command[i] = gain * u[i]
                events += step(i, now, after, command, force, period, forward, backward, friction, stops)
            if events > 0:
                step_again(now, after, command, force, period, forward, backward, friction, t, stops, lost, kept)
            if k < release:
                turn = (turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3])
                for i in range(LANES):
                    measure_guided(q[i], q1[i], v[i], v1[i], u[i], force[i], meant, turn, period, lane(sums, i))
            else:
                for i in range(LANES):
                    row(places, k - release)[i] = q[i]
                    release_v[i] = v[i] if k == release else release_v[i]
                    measure_free(v1[i], u[i], k, n, release, lane(sums, i))
            if k >= end:
                for i in range(LANES):
                    measure_end(q[i], q1[i], v[i], v1[i], u[i], lane(sums, i))
            running = 0
            for i in range(LANES):
                well = lost[i] == 0.0 and abs(u[i]) < limit and abs(q1[i]) < 1e3 and abs(v1[i]) < 1e3
                lost[i] = 0.0 if well else 1.0
                running += 1 if well else 0
                q[i], v[i], tau[i] = q1[i], v1[i], tau1[i]
            if running == 0:
                break
        for i in range(LANES):
            m = lane(sums, i)
            row(places, n - release)[i] = q[i]
            finish(lane(places, i), release_v[i], n, release, end, period, m)
            for j in range(MEASURES):
                measures[block + i, j] = m[j] if lost[i] == 0.0 else np.nan


@dataclass(frozen=True)
class TaskRun:
    """One simulated task: ``t`` [s], ``q`` [m], ``v`` [m/s], ``tau_e`` [N], ``u`` [V], ``encoder`` [m], each (n,).

    The signals are shorter if the simulation stopped because the loop is unstable.
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


def run_task(axis: Axis, law: TaskLaw, task: Task) -> TaskRun:
    """Simulate ``task`` under ``law`` on ``axis`` with all its effects; return signals and measures.

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
    axis: Axis,
    laws: Sequence[TaskLaw],
    task: Task,
    workers: int = 1,
    progress: Progress = no_progress,
    machine: Axis | None = None,
) -> Measures:
    """Simulate ``task`` under each of ``laws`` on ``axis`` with all its effects; return the measures, one row per law.

    The laws are of one kind; an impedance law whose estimate holds arrays (m,) counts as m laws. ``machine`` is the
    real axis if it differs from the one that the laws were designed for. ``workers`` is the number of threads; it has
    no influence on the results. ``progress(stage, fraction)`` is called after each block.
    """
    setup = Setup.of(axis, laws, task, machine)
    gains, m = setup.law.gains, len(setup.law.gains)
    parts = [gains[start : start + BLOCK] for start in range(0, m, BLOCK)]
    raw = np.empty((m, MEASURES))
    done = 0
    for rows in in_threads(setup.measured, parts, workers):
        raw[done : done + len(rows)] = rows
        done += len(rows)
        progress("plants", done / m)
    return _measures(axis, laws, raw)


def in_threads(work: Callable[[Any], Any], parts: Sequence[Any], workers: int) -> Iterator[Any]:
    """Yield ``work(part)`` for each of the ``parts`` in order, computed by ``workers`` threads."""
    if workers == 1 or len(parts) == 1:
        return map(work, parts)
    from joblib import Parallel, delayed

    return Parallel(n_jobs=workers, prefer="threads", return_as="generator")(delayed(work)(part) for part in parts)


@dataclass(frozen=True)
class Setup:
    """The common data of the runs of a task: ``law`` with one row of gains per run, ``rest`` position [m], plant."""

    law: Law
    rest: float
    task: Task
    ready: Prepared

    @classmethod
    def of(cls, axis: Axis, laws: Sequence[TaskLaw], task: Task, machine: Axis | None = None) -> Setup:
        """Prepare ``laws`` of ``axis`` on ``machine``; raises :class:`InputError` if the task has another period."""
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
        n = len(task.push) + 1  # with the state at the end of the last period
        inputs = Inputs(*plant.numbers(), n, sampling.period, sampling.encoder_resolution, intention=wish)
        ready = plant.prepared(inputs)
        law = replace(compiled[0], gains=np.vstack([law.gains for law in compiled]))
        return cls(law, getattr(laws[0], "rest_position", 0.0), task, ready)

    @cached_property
    def in_lanes(self) -> bool:
        """Whether lanes can run it: a friction plant with a hand, no delay, enough laws, equal but for OWN gains."""
        common, ready = self.law.gains[:, OWN:], self.ready
        friction_plant = ready.settings[motion.EXACT] > 0.0 and not np.diff(ready.starts)[list(AROUND)].any()
        no_delay = ready.settings[motion.DELAYED] == 0.0 and common[0, DELAY - OWN] == 0.0
        alike = self.law.kernel is impedance and len(common) >= LANES and np.all(common == common[0])
        alike = alike and common[0, TAPS - OWN] >= 0.0  # no filter in the velocity estimate
        return bool(friction_plant and no_delay and alike)

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
        """Measures (m, MEASURES) from the lanes, nan for laws that they cannot simulate."""
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
        """Measures (m, MEASURES), the signals (5, n) of the last run, and the number of their valid samples."""
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
    """Run one plant per row of ``parameters`` and ``gains``; return the number of valid samples of the last run."""
    y, none, noted, tally = y0.copy(), np.zeros(0), np.zeros((0, 3)), np.zeros(2, np.int64)
    good, steady, period, limit = 0, np.zeros((0, 2)), settings[motion.PERIOD], settings[motion.LIMIT]
    for i in range(gains.shape[0]):
        y[:] = y0
        memory[:] = 0.0
        tally[0] = 0
        status, good, _ = run_samples(
            (baseline, hooks, starts, parameters[i], settings), y, law, gains[i : i + 1], memory, reference, push, none,
            steady, columns, slots, floors, scratch, out, noted, tally,
        )  # fmt: skip
        if status == DONE:
            measure(out[1], out[2], out[3], out[4], wish, turns, limit, period, release, end, measures[i])
        else:
            mark_unstable(limit, measures[i])
    return good


def _measures(axis: Axis, laws: Sequence[TaskLaw], raw: np.ndarray) -> Measures:
    """``raw`` with the expected final speed and the drift threshold of each law, see :class:`Measures`."""
    period, resolution, plant = axis.sampling.period, axis.sampling.encoder_resolution, FrictionModel.of(axis)
    rows = []
    for law in laws:
        drift, integrates = 0.0, True
        if isinstance(law, ImpedanceLaw):
            drift, integrates = np.maximum(drift_speed(law, plant, 1), drift_speed(law, plant, -1)), False
        threshold = drift_threshold(period, resolution, law.velocity_estimator)
        rows.append(np.stack(np.broadcast_arrays(threshold, drift, integrates), axis=-1))
    threshold, expected, integrates = np.vstack(rows).T
    return Measures(raw, max(resolution / period, 1e-6), threshold, expected, integrates > 0.0)
