"""Scenarios of the command ``simulate``: replay a record, follow a reference, raise a force until the axis moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop.nested import nested_loops
from emps_design.control.loop.worst import loop_in_words, worst_loop
from emps_design.errors import InputError, SimulationError
from emps_design.notebook import table
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.simulation.driven import driven_by
from emps_design.simulation.nearest_controller import unstable
from emps_design.simulation.plant import Plant
from emps_design.simulation.run import EVENTS, Run
from emps_design.simulation.trajectories import force_ramp

ABSOLUTE = ("position", "velocity", "force")  # signals whose mean absolute error is given
DROPPED = 50  # samples left out of the relative errors, as in the report of the data set, and behind each gap
SPAN = 8  # samples over which the velocity behind a gap is taken
NEIGHBOURS = 2  # samples to either side that an acceleration is of


def relative_error_percent(
    measured: np.ndarray, simulated: np.ndarray, part: slice | np.ndarray = slice(DROPPED, None)
) -> float:
    """100 |measured - simulated| / |measured|, Euclidean norms over a ``part``; NaN where undefined.

    Without the first 50 samples by default.

    >>> relative_error_percent(np.full(60, 2.0), np.full(60, 1.9))
    5.000000000000004
    """
    measured, difference = measured[part], (measured - simulated)[part]
    scale = float(np.linalg.norm(measured))
    return 100.0 * float(np.linalg.norm(difference)) / scale if scale > 0 else float("nan")


@dataclass(frozen=True)
class Replay:
    """A record beside the simulation of its axis from the reference alone (or from ``u``, without a controller).

    ``relative_error_percent`` has position, velocity, acceleration (central differences of the positions) and force
    (of the voltage that reaches the drive, so a computation delay shifts the simulated one). ``mean_absolute_error`` is
    over all samples [SI]. What is in a gap of the record does not count, nor the first samples behind it.
    """

    axis: Axis
    record: Record
    run: Run
    closed_loop: bool
    relative_error_percent: dict[str, float]
    rms_error: dict[str, float]
    mean_absolute_error: dict[str, float]
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The contract's keys, and what was simulated."""
        return {
            "scenario": "replay",
            "axis": self.axis.name,
            "record": self.record.name,
            "closed_loop": self.closed_loop,
            "samples": len(self.record),
            "effects": [effect.kind for effect in self.axis.effects],
            "relative_error_percent": self.relative_error_percent,
            "rms_error": self.rms_error,
            "mean_absolute_error": self.mean_absolute_error,
            "units": {
                "relative_error_percent": "%",
                "position": "m",
                "velocity": "m/s",
                "acceleration": "m/s^2",
                "force": "N",
            },
            "run": self.run.to_dict(),
            "warnings": list(self.warnings),
        }

    def _repr_html_(self) -> str:
        rows = [(name, error, "%", self.rms_error.get(name)) for name, error in self.relative_error_percent.items()]
        title = f"{self.record.name}: measured against {self.axis.name} simulated"
        return self.axis.units.text(table(title, rows, ("signal", "relative error", "unit", "rms error [SI]")))


def replay(axis: Axis, record: Record, quantise: bool = True) -> Replay:
    """Simulate ``axis`` along ``record`` and compare.

    With a controller the loop is closed on ``record.q_ref``; without one the recorded voltage drives the plant. The
    carriage starts at rest at the record's first position. Behind a gap of the record a controller brings the carriage
    back; without one it starts anew, at the position and the velocity that were measured there. Raises
    :class:`InputError` when the record is too short or its period is not the axis's, :class:`UnstableError` where the
    closed loop diverges, with the nearest that does not, and :class:`SimulationError` where a simulation in open loop
    cannot go on.
    """
    settled, there = _compared(record)
    if len(record) <= DROPPED + 2 or not settled.any():
        raise InputError(f"{record.name}: found {len(record)} samples, expected more than {DROPPED + 2} to compare")
    warnings = [*record.contradictions, *record.gaps_in_words]
    period = axis.sampling.period
    if abs(record.period / period - 1.0) > 1e-3:
        raise InputError(
            f"{record.name}: sampled every {record.period:g} s, axis {axis.name} every {period:g} s; "
            "expected the same period: change sampling.period or resample the record"
        )
    closed = axis.controller.kind != "none"
    push = record.f_ext
    if push is not None:
        warnings.append("the record's f_ext acts on the simulated carriage")
    axis = axis.supplied_by(record)
    if closed:
        how = {"period": record.period, "quantise": quantise}
        run = _closed_loop(axis, lambda axis: {**driven_by(axis, record), **how})
    else:
        run = _open_loop(axis, record, quantise)
        warnings.append("axis without a controller: simulated in open loop from the recorded voltage")
    pairs = {
        "position": (record.q, run.q),
        "velocity": (np.gradient(record.q, record.period), np.gradient(run.q, record.period)),
        "acceleration": tuple(np.gradient(np.gradient(q, record.period), record.period) for q in (record.q, run.q)),
        "force": (motor_force(axis, record), run.force),
    }
    relative = {name: relative_error_percent(a, b, settled) for name, (a, b) in pairs.items()}
    absolute = {name: float(np.mean(np.abs(pairs[name][0] - pairs[name][1])[there])) for name in ABSOLUTE}
    rms = {name: float(np.sqrt(np.mean((a - b)[settled] ** 2))) for name, (a, b) in pairs.items()}
    return Replay(axis, record, run, closed, relative, rms, absolute, tuple(warnings))


def _open_loop(axis: Axis, record: Record, quantise: bool) -> Run:
    """The pieces of ``record``, each up to the next, in open loop."""
    plant, n = Plant.of(axis), len(record)
    starts = [start for start, _ in record.pieces]
    starts[0] = 0
    runs = []
    for start, stop in pairwise([*starts, n]):
        part = record.part(start, stop)
        v0 = float(part.q[SPAN] - part.q[0]) / (SPAN * part.period) if start and len(part) > SPAN else 0.0
        how: dict[str, Any] = {"supply": part.supply, "enable": part.enable, "quantise": quantise}
        runs.append(plant.open_loop(part.u, part.f_ext, float(part.q[0]), v0, period=part.period, **how))
    return Run.joined(runs)


def _compared(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Samples (n,) of bool that count in relative errors, settled and with neighbours, and all that were recorded."""
    settled, n = np.zeros(len(record), bool), len(record)
    for start, stop in record.pieces:
        settled[start + DROPPED : stop if stop == n else max(start, stop - NEIGHBOURS)] = True
    return settled, ~record.in_gap


@dataclass(frozen=True)
class Breakaway:
    """Forces at which a carriage at rest leaves, by a force raised slowly; [N], None where it held to the peak.

    ``forward`` and ``backward`` are what the push had to reach; friction at rest is half their difference, the constant
    force half their sum (with its sign on the left-hand side of the axis's equation).
    """

    axis: Axis
    rate: float
    peak: float
    forward: float | None
    backward: float | None
    run: Run = field(repr=False)
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Break-away forces with units."""
        friction = constant = None
        if self.forward is not None and self.backward is not None:
            friction, constant = 0.5 * (self.forward - self.backward), 0.5 * (self.forward + self.backward)
        forces = ("peak", "forward", "backward", "static_friction", "constant_force")
        return {
            "scenario": "breakaway",
            "axis": self.axis.name,
            "rate": self.rate,
            "peak": self.peak,
            "forward": self.forward,
            "backward": self.backward,
            "static_friction": friction,
            "constant_force": constant,
            "units": {"rate": "N/s", **dict.fromkeys(forces, "N")},
            "run": self.run.to_dict(),
            "warnings": list(self.warnings),
        }


MOVED = 1e-3  # m of travel that count as motion where friction is a bending contact, which moves from the start
COARSE = 0.01  # share of a break-away force by which the push may rise from sample to sample before that is said


def breakaway(axis: Axis, rate: float = 1.0, peak: float | None = None, q0: float = 0.0) -> Breakaway:
    """Raise an external force slowly, forward and backward, until the carriage leaves; the motor is off.

    ``rate`` [N/s]; ``peak`` [N], by default three times what the baseline's friction and constant force can hold, plus
    20 N. With set-valued friction the carriage leaves at the instant of the break-away after which it does not stop
    again; where friction is a bending contact, the force is that at which it has moved 1 mm. Where it has not when the
    push ends, a warning says how far it came.

    >>> from emps_design.machines import machine
    >>> found = breakaway(machine("emps2018"), rate=20.0).to_dict()
    >>> round(found["static_friction"], 1)
    17.4
    """
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"rate: found {rate:g} N/s, expected a positive number")
    mechanics = axis.mechanics
    peak = 3.0 * (mechanics.coulomb + abs(mechanics.offset)) + 20.0 if peak is None else float(peak)
    plant = Plant.of(axis)
    limits: list[float | None] = []
    runs, warnings = [], []
    for side in (1.0, -1.0):
        push = force_ramp(axis.sampling.period, rate, side * peak)
        run = plant.open_loop(np.zeros(push.size), disturbance=push, q0=q0, quantise=False)
        moved = side * (run.position - q0)
        at = _leaves(run, moved)
        limits.append(None if at is None else float(push[min(at, push.size - 1)]))
        if at is None:
            warnings.append(_held(float(moved.max()), side * peak))
        runs.append(run)
    step = rate * axis.sampling.period
    if any(limit is not None and abs(limit) <= step for limit in limits):
        alone = "the carriage leaves without a push: what acts on it at rest is more than its friction holds"
        return Breakaway(axis, rate, peak, None, None, runs[0], (alone,))
    if any(limit is not None and step > COARSE * abs(limit) for limit in limits):
        warnings.append(f"the push rises by {step:.3g} N from sample to sample, the force is as coarse; lower `rate`")
    return Breakaway(axis, rate, peak, limits[0], limits[1], runs[0], tuple(warnings))


def _leaves(run: Run, moved: np.ndarray) -> int | None:
    """The sample at which a carriage that ``moved`` (n,) [m] along the push left for good; None where it held."""
    away = np.flatnonzero(moved > MOVED)
    until = run.t[away[0]] if away.size else np.inf
    seen = [(time, EVENTS[int(kind)]) for time, kind, _ in run.events if time <= until]
    seen = [one for one in seen if one[1] in ("reversal", "stick", "break-away")]
    left = [time for time, kind in seen if kind == "break-away"]
    if left and (away.size or seen[-1][1] == "break-away"):  # still on its way where the push ended before 1 mm
        return round(left[-1] / run.period)
    return int(away[0]) if away.size else None


def _held(most: float, peak: float) -> str:
    """In words that the carriage has not left at ``peak`` [N], ``most`` [m] from where it was."""
    if most <= 0.0:
        return f"the carriage held to {peak:g} N; raise `peak`"
    return (
        f"the carriage moved {1e3 * most:.3g} mm until {peak:g} N, and leaves with {1e3 * MOVED:g} mm; "
        "raise `peak` or lower `rate`"
    )


HELD = "is unstable; only limits hold it"


@dataclass(frozen=True)
class Followed:
    """A reference of one's own, followed in closed loop."""

    axis: Axis
    run: Run
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Tracking error, largest numbers, events; a ``reason`` where a loop is unstable that the limit holds."""
        run, limit = self.run, self.axis.drive.command_limit
        worst = worst_loop(nested_loops(self.axis))
        error = run.q_ref - run.position
        return {
            "scenario": "reference",
            "axis": self.axis.name,
            "effects": [effect.kind for effect in self.axis.effects],
            "tracking_error": {"rms": float(np.sqrt(np.mean(error**2))), "largest": float(np.abs(error).max())},
            "largest": {
                "velocity": float(np.abs(run.v).max()),
                "voltage": float(np.abs(run.u).max()),
                "force": float(np.abs(run.force).max()),
            },
            "saturated_share": float(np.mean(np.abs(run.u) >= limit)),
            "worst_loop": worst.to_dict(),
            "units": {"tracking_error": "m", "velocity": "m/s", "voltage": "V", "force": "N"},
            "run": run.to_dict(),
            "warnings": list(self.warnings),
            **({} if worst.margins.stable else {"reason": f"the {loop_in_words(worst)} {HELD}"}),
        }


def follow(
    axis: Axis, q_ref: np.ndarray, f_ext: np.ndarray | None = None, excitation: np.ndarray | None = None
) -> Followed:
    """Simulate ``axis`` in closed loop along ``q_ref`` (n,) [m], with ``f_ext`` (n,) [N] on the carriage.

    ``excitation`` (n,) [V] is added to the controller's output.

    Raises :class:`UnstableError` where the loop diverges, with the nearest that does not.
    """
    how = {"q_ref": q_ref, "disturbance": f_ext, "voltage_noise": excitation}
    run = replace(_closed_loop(axis, lambda axis: how), excitation=excitation)
    clipped = float(np.mean(np.abs(run.u) >= axis.drive.command_limit))
    warnings = (f"the voltage is at its limit {100 * clipped:.1f} % of the time",) if clipped > 0 else ()
    return Followed(axis, run, warnings)


def _closed_loop(axis: Axis, driven: Callable[[Axis], dict[str, Any]]) -> Run:
    """The closed loop of ``axis``, ``driven`` as that says for an axis; :class:`UnstableError` where it diverges."""

    def simulate(axis: Axis) -> Run:
        return Plant.of(axis).closed_loop(**driven(axis))

    try:
        return simulate(axis)
    except SimulationError as error:
        raise unstable(axis, error, simulate) from error
