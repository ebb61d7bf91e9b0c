"""Run impedance laws on friction plants: one with its whole trace, or many with what a verdict needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.comanipulation import kernel as kernel
from emps_design.comanipulation.task import Task
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.robustness import VERDICTS, drift_threshold
from emps_design.errors import InputError

BLOCK = 256  # plants a worker takes at a time; no number depends on it


@dataclass(frozen=True)
class CascadeLaw:
    """The cascaded loop of Fig. 4 with a force sensor: velocity reference ``k_e1 tau_e``, IP velocity loop.

    ``k_e1`` [(m/s)/N], ``k_v1`` [V/(m/s)], ``t_v`` [s].
    """

    k_e1: float
    k_v1: float
    t_v: float
    velocity_estimator: str = "two_tap"


Law = ImpedanceLaw | CascadeLaw


@dataclass(frozen=True)
class Measures:
    """What was measured on m simulated plants; every attribute is an array (m,)."""

    raw: np.ndarray
    period: float
    threshold: float
    cascade: np.ndarray

    def __getattr__(self, name: str) -> np.ndarray:
        place = getattr(kernel, f"P_{name.upper()}", None)
        if place is None:
            raise AttributeError(name)
        return self.raw[:, place]

    @property
    def verdict(self) -> np.ndarray:
        """Places in ``VERDICTS``.

        Unstable: it diverged, ended against the voltage limit after the release, swung from limit to limit ten times
        or more, or its free motion grows. Limit cycle: in the last tenth of the task the velocity still takes both
        signs, by two thresholds, or comes to zero ten times. Then by the speed that free motion tends to, which a
        cascaded loop, whose integral rules dry friction out, is not asked for.
        """
        low, high = -2.0 * self.threshold, 2.0 * self.threshold
        peak = np.maximum(self.end_max_v, -self.end_min_v)
        with np.errstate(invalid="ignore"):
            grows = (self.ratio > 1.0) & (np.abs(self.end_speed) > 10.0 * high)
            unstable = (self.diverged > 0) | (self.clipped_end > 0) | (self.flips >= 10)
            cycle = ((self.end_min_v < low) & (self.end_max_v > high)) | (
                (self.end_turns >= 10) & (peak > self.threshold)
            )
            unstable |= grows & ~cycle
        at_rest = (self.end_max_v == 0.0) & (self.end_min_v == 0.0)
        creeping = ~at_rest & (self.drift > self.threshold) & ~self.cascade
        dead = (self.drift < -self.threshold) & ~self.cascade
        return np.select([unstable, cycle, creeping, dead], [4, 3, 2, 1], 0)

    @property
    def fit(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apparent mass [kg], damping [N/(m/s)] and R^2 from force regressed on acceleration and velocity, in motion.

        Means over each period, no constant column, R^2 about zero.
        """
        determinant = self.aa * self.vv - self.av**2
        with np.errstate(divide="ignore", invalid="ignore"):
            mass = (self.vv * self.af - self.av * self.vf) / determinant
            damping = (self.aa * self.vf - self.av * self.af) / determinant
            r2 = 1.0 - (self.ff - mass * self.af - damping * self.vf) / self.ff
        return mass, damping, r2

    @property
    def effort(self) -> dict[str, np.ndarray]:
        """The operator's effort: rms, peak force [N], impulse [N s], work [J], N per (m/s), tracking error [m]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return {
                "rms_force": np.sqrt(self.force2 / self.held),
                "peak_force": self.peak_force,
                "impulse": self.impulse,
                "work": self.work,
                "force_per_speed": np.where(self.path > 0, self.impulse / self.path, np.nan),
                "tracking_error": np.sqrt(self.miss2 / self.held),
            }


@dataclass(frozen=True)
class Run:
    """One simulated task: ``t`` [s], ``q`` [m], ``v`` [m/s], ``tau`` [N], ``tau_e`` [N], ``u`` [V], ``encoder`` [m]."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    tau_e: np.ndarray
    u: np.ndarray
    encoder: np.ndarray
    measures: Measures

    @property
    def verdict(self) -> str:
        """One of ``VERDICTS``."""
        return VERDICTS[int(self.measures.verdict[0])]


def run_task(axis: Axis, law: Law, task: Task, plant: FrictionModel | None = None) -> Run:
    """Simulate ``law`` on ``plant`` (the axis's own by default) through ``task``, and keep the whole trace.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> from emps_design.comanipulation.task import pushed_task
    >>> axis = machine("emps2018")
    >>> run_task(axis, impedance_law(axis, 50.0, 100.0), pushed_task(axis.sampling.period)).verdict
    'stable'
    """
    plant = FrictionModel.of(axis) if plant is None else plant
    _same_clock(axis, task)
    trace = np.zeros((len(task.reference), 6))
    raw = np.empty((1, kernel.MEASURES))
    numbers = law_array(axis, law)
    kernel.run_plant(
        plant_array(axis, plant),
        numbers,
        task.reference,
        np.array(task.hand),
        task.release,
        task.end,
        trace,
        raw[0],
    )
    columns = {name: trace[:, place] for place, name in enumerate(("q", "v", "tau", "tau_e", "u", "encoder"))}
    return Run(t=task.time, measures=measures_of(axis, raw, numbers[None, kernel.L_KIND] == kernel.CASCADE), **columns)


def run_many(
    axis: Axis,
    laws: Law | np.ndarray,
    task: Task,
    plants: FrictionModel | np.ndarray | None = None,
    workers: int = 1,
    progress: Any = None,
) -> Measures:
    """Simulate many laws and plants: one object for all, or arrays of :func:`law_array` and :func:`plant_array`.

    ``workers`` threads; the numbers do not depend on it. ``progress(stage, fraction)`` is called as blocks finish.
    """
    _same_clock(axis, task)
    own = FrictionModel.of(axis) if plants is None else plants
    plant_rows = plant_array(axis, own)[None] if isinstance(own, FrictionModel) else np.atleast_2d(own)
    law_rows = np.atleast_2d(laws) if isinstance(laws, np.ndarray) else law_array(axis, laws)[None]
    m = max(len(plant_rows), len(law_rows))
    plant_rows = np.ascontiguousarray(np.broadcast_to(plant_rows, (m, plant_rows.shape[1])))
    law_rows = np.ascontiguousarray(np.broadcast_to(law_rows, (m, law_rows.shape[1])))
    raw = np.empty((m, kernel.MEASURES))
    hand = np.array(task.hand)

    def block(start: int) -> int:
        rows = slice(start, min(start + BLOCK, m))
        kernel.run_block(plant_rows[rows], law_rows[rows], task.reference, hand, task.release, task.end, raw[rows])
        return start

    starts = range(0, m, BLOCK)
    if workers == 1 or m <= BLOCK:
        finished = map(block, starts)
    else:
        from joblib import Parallel, delayed

        finished = Parallel(n_jobs=workers, prefer="threads", return_as="generator")(delayed(block)(s) for s in starts)
    for start in finished:
        if progress is not None:
            progress("plants", min(1.0, (start + BLOCK) / m))
    return measures_of(axis, raw, law_rows[:, kernel.L_KIND] == kernel.CASCADE)


def plant_array(axis: Axis, plant: FrictionModel) -> np.ndarray:
    """The plant's numbers in the kernel's order, shape (10,)."""
    drive, sampling = axis.drive, axis.sampling
    return np.array(
        [
            *plant.array(),
            drive.current_time_constant,
            drive.force_gain,
            drive.voltage_limit,
            sampling.encoder_resolution,
            sampling.period,
        ]
    )


def law_array(axis: Axis, law: Law) -> np.ndarray:
    """The law's numbers in the kernel's order, shape (15,)."""
    period, delay = axis.sampling.period, float(axis.sampling.computation_delay)
    backward = float(law.velocity_estimator == "backward")
    if isinstance(law, CascadeLaw):
        numbers = [kernel.CASCADE, law.k_e1, law.k_v1, law.t_v, 0.0, *(1.0,) * 5, 0.0, 0.0, 0.0, backward, delay]
        return np.array(numbers)
    law.check_period(period)
    e, c = law.estimate, law.coulomb_factor
    return np.array(
        [
            kernel.SENSOR if law.force_sensor else kernel.SENSORLESS,
            law.mass,
            law.damping,
            law.stiffness,
            law.rest_position,
            e.mass,
            *e.viscous,
            c * e.coulomb_positive,
            c * e.coulomb_negative,
            *np.exp(-np.array(law.filters) * period),
            law.current_factor,
            backward,
            delay,
        ]
    )


def measures_of(axis: Axis, raw: np.ndarray, cascade: np.ndarray) -> Measures:
    """Join the kernel's rows ``raw`` (m, MEASURES) with what a verdict needs to know of the axis."""
    threshold = drift_threshold(axis.sampling.period, axis.sampling.encoder_resolution)
    return Measures(raw, axis.sampling.period, threshold, cascade)


def _same_clock(axis: Axis, task: Task) -> None:
    if task.period != axis.sampling.period:
        raise InputError(
            f"task: found a period of {task.period:g} s, expected the axis's {axis.sampling.period:g} s; "
            "make the task with the axis's period"
        )
