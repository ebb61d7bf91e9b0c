"""Scenarios of the command ``simulate``: replay a record, follow a reference, raise a force until the axis moves.

For a loop that diverges, :func:`unstable` proposes the nearest controller parameter with which it runs.
:func:`scenario_view` shows the numbers of a result, a line each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.sampled import loop_in_words
from emps_design.control.verdict import worst_loop_of
from emps_design.errors import AxisError, InputError, SimulationError, UnstableError
from emps_design.laws import leaves
from emps_design.messages import Message, note, warning
from emps_design.observer import motor_force
from emps_design.records import Record
from emps_design.records.check import LONGEST
from emps_design.records.columns import PLAIN
from emps_design.request import typed
from emps_design.simulation.plant import Plant
from emps_design.simulation.run import EVENTS, Run, driven_by
from emps_design.simulation.synthetic import check_positive
from emps_design.units import Units
from emps_design.view import Cell, Line, Table, View, Viewed

STEP = math.sqrt(2.0)  # factor from one trial value of a controller parameter to the next
STEPS = 12  # in each direction; beyond that a loop runs only because it hardly moves

ERRORS = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N"}  # units of the errors of a replay
ABSOLUTE = ("position", "velocity", "force")  # signals whose mean absolute error is given
DROPPED = 50  # samples excluded from the relative errors, as in the report of the data set, and after each gap
SPAN = 8  # samples over which the velocity after a gap is averaged
NEIGHBOURS = 2  # samples on each side that enter an acceleration

MOVED = 1e-3  # m of travel that count as break-away if friction is an elastic contact, which always moves
COARSE = 0.01  # rise of the push per sample, as a share of the break-away force, above which there is a warning

# Keys of a document without a line: they are in the title, shown elsewhere, or for the JSON only.
NO_LINE = (
    "run",
    "study",
    "law",
    "task",
    "units",
    "warnings",
    "scenario",
    "axis",
    "effort",
    "headline",
    "reason",
    "worst_loop",
)


def unstable(axis: Axis, error: SimulationError, simulate: Callable[[Axis], Any]) -> UnstableError:
    """Return the error for a closed loop of ``axis`` that diverges, with the reason and the nearest stable controller.

    ``simulate(axis)`` runs the same loop on another axis and raises :class:`SimulationError` if it diverges.
    """
    nearest = nearest_controller(axis, simulate)
    if not nearest:
        return UnstableError(f"{error}; changing a single controller parameter does not make it stable")
    name, value = next(iter(nearest.items()))
    present = dict(_numbers(axis))[name]
    return UnstableError(f"{error}; nearest that works: {name} = {value:g} instead of {present:g}", nearest)


def nearest_controller(axis: Axis, simulate: Callable[[Axis], Any]) -> dict[str, float]:
    """Return one controller parameter of ``axis``, as {name: value}, with which ``simulate(axis)`` runs; or {}.

    Each parameter is varied alone, by factors of sqrt(2) up and down. The proposal is the factor nearest to 1 of which
    the next step runs as well.
    """
    candidates: list[tuple[int, str, float]] = []
    for name, present in _numbers(axis):
        for side in (-1, 1):
            before = False
            for count in range(1, STEPS + 1):
                if candidates and count >= min(candidates)[0]:
                    break
                value = float(f"{present * STEP ** (side * count):.3g}")
                runs = _runs(axis, name, value, simulate)
                if runs and before:
                    candidates.append((count, name, value))
                    break
                before = runs
    if not candidates:
        return {}
    _, name, value = min(candidates)
    return {name: value}


def _numbers(axis: Axis) -> list[tuple[str, float]]:
    """The parameters of the controller of ``axis`` by name, such as ``velocity.kp``, without zeros and counts."""
    values = leaves(axis.to_dict()["controller"])
    return [(".".join(path), value) for path, value in values if isinstance(value, float) and value != 0.0]


def _runs(axis: Axis, name: str, value: float, simulate: Callable[[Axis], Any]) -> bool:
    controller = axis.to_dict()["controller"]
    *tables, key = name.split(".")
    inner = controller
    for inside in tables:
        inner = inner[int(inside) if isinstance(inner, list | tuple) else inside]
    inner[key] = value
    try:
        simulate(axis.replace(controller=controller))
    except (SimulationError, AxisError):
        return False
    return True


def relative_error_percent(
    measured: np.ndarray, simulated: np.ndarray, part: slice | np.ndarray = slice(DROPPED, None)
) -> float:
    """100 |measured - simulated| / |measured|, Euclidean norms over a ``part``; NaN if undefined.

    By default the first 50 samples are excluded.

    >>> relative_error_percent(np.full(60, 2.0), np.full(60, 1.9))
    5.000000000000004
    """
    measured, difference = measured[part], (measured - simulated)[part]
    scale = float(np.linalg.norm(measured))
    return 100.0 * float(np.linalg.norm(difference)) / scale if scale > 0 else float("nan")


@dataclass(frozen=True)
class Replay(Viewed):
    """A record and the simulation of its axis from the reference alone (or from ``u``, without a controller).

    ``relative_error_percent`` has position, velocity, acceleration (central differences of the positions) and force (of
    the voltage at the drive, so a computation delay shifts the simulated one). ``mean_absolute_error`` [SI] is over all
    samples. Samples in a gap of the record, and the first ones after it, are excluded.
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
        """Plain data: errors with units, the run, and warnings."""
        unit = self.axis.units.unit
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
            "units": {"relative_error_percent": "%", **{name: unit(base) for name, base in ERRORS.items()}},
            "run": self.run.to_dict(),
            "warnings": list(self.warnings),
        }

    def view(self) -> View:
        """The errors of the simulation in every signal."""
        loop = "closed loop" if self.closed_loop else "open loop"
        effects = ", ".join(effect.kind for effect in self.axis.effects)
        how = f"{loop}, {len(self.record)} samples{f', with {effects}' if effects else ''}"
        headings = ("signal", "relative error [%]", "rms error", "mean absolute error", "unit")
        title = f"{self.record.name}, measured against {self.axis.name} simulated"
        return Line(how), Table(headings, [self._row(name) for name in self.relative_error_percent], title)

    def _row(self, name: str) -> tuple[Cell, ...]:
        """The errors of the signal ``name``, in the unit that suits the rms."""
        relative, rms, absolute = (
            error.get(name) for error in (self.relative_error_percent, self.rms_error, self.mean_absolute_error)
        )
        unit, factor = self.axis.units.display(rms or 0.0, ERRORS[name])
        word = self.axis.units.words(name)
        return word, *(_digits(relative, 1.0), _digits(rms, factor), _digits(absolute, factor)), unit


def _digits(value: float | None, factor: float) -> str | None:
    """``value`` times ``factor`` with six digits; None if it is undefined."""
    return None if value is None or not math.isfinite(value) else f"{factor * value:.6g}"


@typed
def replay(axis: Axis, record: Record, quantise: bool = True) -> Replay:
    """Simulate ``axis`` along ``record`` and compare.

    With a controller the loop is closed on ``record.q_ref``; without one the recorded voltage drives the plant. The
    carriage starts at rest at the first position of the record. After a gap of the record a controller brings the
    carriage back; without one the simulation restarts at the measured position and velocity. Raises
    :class:`InputError` if the record is too short or its period differs from the axis, :class:`UnstableError` if the
    closed loop diverges, with the nearest stable controller, and :class:`SimulationError` if a simulation in open loop
    cannot continue.
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
        text = f"the record's f_ext acts on the simulated {axis.units.word('carriage')}"
        warnings.append(note("recorded-force-acts", text))
    axis = axis.supplied_by(record)
    if closed:
        how = {"period": record.period, "quantise": quantise}
        run = _closed_loop(axis, lambda axis: {**driven_by(axis, record), **how})
    else:
        run = _open_loop(axis, record, quantise)
        voltage = axis.units.word("voltage")
        text = f"axis without a controller: simulated in open loop from the recorded {voltage}"
        warnings.append(note("open-loop", text))
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
    """Simulate ``record`` in open loop, piece by piece between its gaps."""
    plant, n = Plant.of(axis), len(record)
    starts = [start for start, _ in record.pieces]
    starts[0] = 0
    runs = []
    for start, stop in pairwise([*starts, n]):
        part = record.part(start, stop)
        v0 = float(part.q[SPAN] - part.q[0]) / (SPAN * part.period) if start and len(part) > SPAN else 0.0
        run = plant.open_loop(
            part.u,
            disturbance=part.f_ext,
            q0=float(part.q[0]),
            v0=v0,
            period=part.period,
            supply=part.supply,
            enable=part.enable,
            quantise=quantise,
        )
        runs.append(run)
    return Run.joined(runs)


def _compared(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Masks (n,) of the samples in relative errors, and of all recorded samples."""
    settled, n = np.zeros(len(record), bool), len(record)
    for start, stop in record.pieces:
        settled[start + DROPPED : stop if stop == n else max(start, stop - NEIGHBOURS)] = True
    return settled, ~record.in_gap


@dataclass(frozen=True)
class Breakaway(Viewed):
    """Break-away forces of a carriage at rest under a slowly rising force [N]; None if it did not move up to the peak.

    Friction at rest is half the difference of ``forward`` and ``backward``, the constant force half their sum (with the
    sign of the left-hand side of the axis equation).
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
        unit = self.axis.units.unit
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
            "units": {"rate": unit("N/s"), **dict.fromkeys(forces, unit("N"))},
            "run": self.run.to_dict(),
            "warnings": list(self.warnings),
        }

    def view(self) -> View:
        """The break-away forces."""
        return scenario_view(self.to_dict(), self.axis.units)


def force_ramp(period: float, rate: float, peak: float, units: Units = PLAIN) -> np.ndarray:
    """Force [N] that rises at ``rate`` [N/s] from 0 to ``peak`` [N] (a negative peak falls) on an axis of ``units``.

    >>> force_ramp(0.1, 10.0, 2.0)
    array([0., 1., 2.])
    """
    check_positive(period=period, rate=rate, peak=abs(peak))
    n = round(abs(peak) / (rate * period)) + 1
    if n > LONGEST:
        raise InputError(
            f"rate: found {units.quantity(rate, 'N/s', 'g')}, so that a rise to {units.quantity(abs(peak), 'N', 'g')} "
            f"takes {n * period:.4g} s; expected at most {LONGEST * period:.4g} s ({LONGEST} samples): "
            "use a higher rate or a lower peak"
        )
    return np.sign(peak) * np.minimum(np.arange(n) * rate * period, abs(peak))


def breakaway(axis: Axis, rate: float = 1.0, peak: float | None = None, q0: float = 0.0) -> Breakaway:
    """Raise an external force slowly, forward and backward, until the carriage breaks away; the motor is off.

    ``rate`` [N/s]; ``peak`` [N], by default three times friction plus constant force of the baseline, plus 20 N. With
    set-valued friction, break-away is the last start of motion after which the carriage does not stop again; with an
    elastic contact it is the force at which the carriage has moved 1 mm. If it has not at the end of the push, a
    warning gives its travel.

    >>> from emps_design.machines import machine
    >>> forces = breakaway(machine("emps2018"), rate=20.0).to_dict()
    >>> round(forces["static_friction"], 1)
    17.4
    """
    units = axis.units
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"rate: found {units.quantity(rate, 'N/s', 'g')}, expected a positive number")
    mechanics = axis.mechanics
    peak = 3.0 * (mechanics.coulomb + abs(mechanics.offset)) + 20.0 if peak is None else float(peak)
    plant = Plant.of(axis)
    limits: list[float | None] = []
    runs, warnings = [], []
    for side in (1.0, -1.0):
        push = force_ramp(axis.sampling.period, rate, side * peak, units)
        run = plant.open_loop(np.zeros(push.size), disturbance=push, q0=q0, quantise=False)
        displacement = side * (run.position - q0)
        at = _break_away_sample(run, displacement)
        limits.append(None if at is None else float(push[min(at, push.size - 1)]))
        if at is None:
            warnings.append(_no_break_away(float(displacement.max()), side * peak, units))
        runs.append(run)
    step = rate * axis.sampling.period
    if any(limit is not None and abs(limit) <= step for limit in limits):
        text = (
            f"the {units.word('carriage')} moves without a push: the {units.word('force')} on it at rest exceeds its "
            "friction"
        )
        return Breakaway(axis, rate, peak, None, None, runs[0], (warning("leaves-without-push", text),))
    if any(limit is not None and step > COARSE * abs(limit) for limit in limits):
        text = (
            f"the push rises by {units.quantity(step, 'N', '.3g')} per sample, the resolution of the break-away "
            f"{units.word('force')}; lower `rate`"
        )
        warnings.append(warning("coarse-push", text, step=step))
    return Breakaway(axis, rate, peak, limits[0], limits[1], runs[0], tuple(warnings))


def _break_away_sample(run: Run, displacement: np.ndarray) -> int | None:
    """Return the sample of break-away from the ``displacement`` (n,) [m] along the push; None if there is none."""
    away = np.flatnonzero(displacement > MOVED)
    until = run.t[away[0]] if away.size else np.inf
    events = [(time, EVENTS[int(kind)]) for time, kind, _ in run.events if time <= until]
    events = [event for event in events if event[1] in ("reversal", "stick", "break-away")]
    starts = [time for time, kind in events if kind == "break-away"]
    if starts and (away.size or events[-1][1] == "break-away"):  # or still moving at the end of the push, below 1 mm
        return round(starts[-1] / run.period)
    return int(away[0]) if away.size else None


def _no_break_away(most: float, peak: float, units: Units) -> Message:
    """Return a message that the carriage did not break away up to ``peak`` [N] and moved ``most`` [m] at most."""
    carriage, until = units.word("carriage"), units.quantity(peak, "N", "g")
    if most <= 0.0:
        return warning("held", f"the {carriage} did not move up to {until}; raise `peak`", peak=peak)
    text = (
        f"the {carriage} moved {units.quantity(most, 'mm', '.3g')} up to {until}, and break-away needs "
        f"{units.quantity(MOVED, 'mm', '.2g')}; raise `peak` or lower `rate`"
    )
    return warning("hardly-moved", text, peak=peak, most=most)


LIMITED = "is unstable; only limits bound it"
FOLLOWED = {"tracking_error": "m", "velocity": "m/s", "voltage": "V", "force": "N"}  # units in a document


@dataclass(frozen=True)
class Followed(Viewed):
    """A closed-loop run along a reference of the user."""

    axis: Axis
    run: Run
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Tracking error, largest signals, events; a ``reason`` if a loop is unstable and only limits bound it."""
        run, limit = self.run, self.axis.drive.command_limit
        worst = worst_loop_of(self.axis)
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
            "units": {name: self.axis.units.unit(base) for name, base in FOLLOWED.items()},
            "run": run.to_dict(),
            "warnings": list(self.warnings),
            **({} if worst.margins.stable else {"reason": f"the {loop_in_words(worst, self.axis.units)} {LIMITED}"}),
        }

    def view(self) -> View:
        """Tracking error and largest signals."""
        return scenario_view(self.to_dict(), self.axis.units)


def follow(
    axis: Axis, q_ref: np.ndarray, f_ext: np.ndarray | None = None, excitation: np.ndarray | None = None
) -> Followed:
    """Simulate ``axis`` in closed loop along ``q_ref`` (n,) [m], with ``f_ext`` (n,) [N] on the carriage.

    ``excitation`` (n,) [V] is added to the controller's output.

    Raises :class:`UnstableError` if the loop diverges, with the nearest stable controller.
    """
    how = {"q_ref": q_ref, "disturbance": f_ext, "voltage_noise": excitation}
    run = replace(_closed_loop(axis, lambda axis: how), excitation=excitation)
    clipped = float(np.mean(np.abs(run.u) >= axis.drive.command_limit))
    text = f"the {axis.units.word('voltage')} is at its limit {100 * clipped:.1f} % of the time"
    return Followed(axis, run, (warning("limit-in-run", text, share=clipped),) if clipped > 0 else ())


def _closed_loop(axis: Axis, driven: Callable[[Axis], dict[str, Any]]) -> Run:
    """Run the closed loop of ``axis`` with the inputs ``driven(axis)``; :class:`UnstableError` if it diverges."""

    def simulate(axis: Axis) -> Run:
        return Plant.of(axis).closed_loop(**driven(axis))

    try:
        return simulate(axis)
    except SimulationError as error:
        raise unstable(axis, error, simulate) from error


def scenario_view(document: dict[str, Any], units: Units) -> View:
    """The headline of the ``document`` of a scenario, if it has one, and a table of its numbers.

    >>> breakaway = {"scenario": "breakaway", "axis": "joint", "forward": 0.0123, "units": {"forward": "N m"}}
    >>> scenario_view(breakaway, Units("rotary"))[0].rows
    [('forward', '0.0123', 'N m')]
    """
    headline = [Line(document["headline"])] if "headline" in document else []
    rows = list(_rows(document, document.get("units", {}), units))
    title = f"{document['scenario']}, axis {document['axis']}"
    return (*headline, Table(("quantity", "value", "unit"), rows, title))


def _rows(
    document: dict[str, Any], unit_of: dict[str, str], units: Units, inside: tuple[str, ...] = ()
) -> Iterator[tuple[str, Cell, str]]:
    """Name, value and unit of each number; ``unit_of`` has a unit by the name of a quantity, or of a group of them."""
    for key, value in document.items():
        path = (*inside, key)
        if key in NO_LINE:
            continue
        if isinstance(value, dict):
            yield from _rows(value, unit_of, units, path)
        elif value != []:
            base = next((unit_of[name] for name in path if name in unit_of), "")
            yield units.words(" ".join(path).replace("_", " ")), *_shown(value, base, units)


def _shown(value: Any, base: str, units: Units) -> tuple[Cell, str]:
    """``value`` [``base``] as a cell, and its unit."""
    if isinstance(value, float) and math.isfinite(value):
        unit, factor = units.display(value, base)
        return f"{factor * value:.6g}", unit
    if value is None or isinstance(value, float):
        return None, ""
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value), ""
