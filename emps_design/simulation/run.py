"""A run of a plant: its request (a reference or commands, and conditions) and its result.

The result has signals with names and units, and events; it can be saved and loaded without loss. :func:`driven_by`
takes the inputs of a closed-loop run from a record.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from emps_design.axis import Axis, Drive
from emps_design.errors import InputError, RecordError
from emps_design.figures import BLACK, BLUE, PALE_GREY, RED, Axes, Band, Curve, Grid, draw_on, thin
from emps_design.files import write_aside
from emps_design.laws import NONE, Law, law_of
from emps_design.records import Record
from emps_design.records.columns import PLAIN, RECORD
from emps_design.request import Request, option
from emps_design.simulation.kernels.compile import address, cached, call_law, pointer, shifted
from emps_design.units import Units
from emps_design.view import Table, View, Viewed

# name: (label, unit) of every signal of a run
SIGNALS = {
    "t": ("time", "s"),
    "q_ref": ("position reference", "m"),
    "q": ("encoder position", "m"),
    "position": ("position", "m"),
    "v": ("velocity", "m/s"),
    "u": ("voltage", "V"),
    "force": ("motor force", "N"),
    "f_ext": ("external force", "N"),
}
OPTIONAL = {"excitation": ("excitation", "V")}  # of a run that has them
DESCRIBED = SIGNALS | OPTIONAL
STORED = ("q_ref", "q", "position", "v", "u", "f_ext")
EVENTS = ("reversal", "stick", "break-away", "guard")


@dataclass(frozen=True)
class _Conditions(Request):
    """The inputs of every run, in addition to its reference or commands."""

    baseline: np.ndarray | None = option(None, "[mass, viscous, coulomb, offset] in place of the axis's")
    parameters: Sequence[np.ndarray] | None = option(None, "one array per effect in place of the axis's")
    disturbance: np.ndarray | None = option(None, "force (n,) [N] on the carriage, held over each period")
    v0: float = option(0.0, "initial velocity [m/s]")
    period: float | None = option(None, "sampling period [s], by default the axis's")
    quantise: bool = option(True, "whether the encoder has steps; otherwise it is exact")
    intention: np.ndarray | None = option(
        None, "intended position (n,) [m] of a hand at the carriage, nan after it has released it"
    )
    supply: np.ndarray | None = option(None, "supply (n,) [V] of a duty, by default the axis's")
    enable: np.ndarray | None = option(None, "(n,), 0 where the motor is switched off, its winding open")
    energy: bool = option(False, "whether the run has its energy balance")
    tolerance: float = option(1.0, "factor on the error tolerance of a step")
    method: str = option("auto", "stepping method: auto, general, linear, plain or folded")


@dataclass(frozen=True)
class _Reference(Request):
    q_ref: np.ndarray = option(..., "position reference (n,) [m]", argument=True)


@dataclass(frozen=True)
class _Commands(Request):
    u: np.ndarray = option(..., "voltage (n,) [V], held over each period", argument=True)


@dataclass(frozen=True)
class ClosedLoopRun(_Conditions, _Reference):
    """The inputs of :meth:`Plant.closed_loop`."""

    voltage_noise: np.ndarray | None = option(None, "voltage (n,) [V] added after the controller")
    q0: float | None = option(None, "initial position [m], by default that of the reference")
    law: Law | None = option(None, "law in place of the axis's controller")
    reference: np.ndarray | None = option(
        None,
        "reference (n,) of the law, by default q_ref, or its backward difference for a law that follows a velocity",
    )


@dataclass(frozen=True)
class OpenLoopRun(_Conditions, _Commands):
    """The inputs of :meth:`Plant.open_loop`."""

    q0: float = option(0.0, "initial position [m]")


def driven_by(axis: Axis, record: Record) -> dict[str, Any]:
    """Return the keywords of :meth:`Plant.closed_loop` that simulate ``record`` with its initial state and inputs.

    These are the law of ``axis`` with the gains of the record; its reference, the recorded one if it is a velocity; the
    measured external force, the excitation of the controller's output, the supply of a duty, and the samples with the
    motor switched off. Without a controller there is no law.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> sorted(driven_by(axis, synthetic_record(axis, laps=1)))
    ['disturbance', 'enable', 'law', 'q0', 'q_ref', 'reference', 'supply', 'voltage_noise']
    """
    how = {
        "q_ref": record.q_ref,
        "q0": float(record.q[0]),
        "disturbance": record.f_ext,
        "voltage_noise": record.excitation,
        "supply": record.supply,
        "enable": record.enable,
    }
    if axis.controller.kind == NONE:
        return how
    law = law_of(axis, record.period, record.extra)
    return {**how, "law": law, "reference": law.followed(record)}


def intention_columns(intention: np.ndarray, hand: np.ndarray, held: bool, n: int, period: float) -> np.ndarray:
    """Return the parameters (n, 6) of a ``hand`` with the ``intention`` (n,) [m], nan after the release.

    Between samples the intention is linear; the force of a ``held`` hand is that at the sample.
    """
    grips, speed = ~np.isnan(intention), np.zeros(intention.size)
    if intention.size > 1:
        step = np.diff(intention) / period
        speed = np.gradient(intention, period) if held else np.append(step, 0.0)
        speed[1:] = np.where(np.isnan(speed[1:]), step, speed[1:])
    place = signal(np.where(grips, intention, 0.0), "intention", "m", n)
    return np.column_stack([grips[:, None] * hand[:3], place, np.nan_to_num(speed), np.arange(n) * period])


def motor_rows(drive: Drive, supply: Any, enable: Any, n: int) -> np.ndarray:
    """Gain [N/V] and braking [N/(m/s)] of a motor at each sample, (n, 2), or (0, 2) if they are constant.

    ``supply`` (n,) [V] of a duty, None: that of the ``drive``; ``enable`` (n,) is 0 while it is off, None: always on.
    """
    supply = None if drive.command != "duty" or supply is None else signal(supply, "supply", "V", n)
    if supply is None and enable is None:
        return np.zeros((0, 2))
    on = np.ones(n) if enable is None else (signal(enable, "enable", "", n) != 0.0).astype(float)
    gain = drive.gain if supply is None else drive.force_gain * supply
    return np.column_stack([on * gain, on * drive.braking])


def positive(period: Any) -> float:
    """Return ``period`` [s]; raise :class:`InputError` if it is not positive."""
    if not (np.isfinite(period) and period > 0):
        raise InputError(f"period: found {period:g} s, expected a positive number")
    return float(period)


def signal(values: Any, name: str, unit: str, n: int | None = None) -> np.ndarray:
    """Return ``values`` as an array (n,) of floats; raise :class:`InputError` unless they are ``n`` finite numbers."""
    row = np.ascontiguousarray(values, dtype=float)
    if row.ndim != 1 or row.size == 0 or (n is not None and row.size != n):
        expected = f"{n} numbers" if n else "a row of numbers"
        raise InputError(f"{name}: found shape {row.shape}, expected {expected} [{unit}]")
    # If the sum is finite, all numbers are, in one pass; otherwise find the first that is not (the sum may overflow).
    if not np.isfinite(row.sum()) and not np.isfinite(row).all():
        first = int(np.argmin(np.isfinite(row)))
        raise InputError(f"{name}: sample {first} is {row[first]}, expected finite numbers [{unit}]")
    return row


def commands_of(
    law: Law, reference: np.ndarray, q: np.ndarray, limit: float, f_ext: np.ndarray | None = None
) -> np.ndarray:
    """Return the commands (n,) of ``law`` for its ``reference``, the position ``q`` and the sensed force, from rest.

    All are (n,), SI; the kernel of the law is compiled.

    >>> from emps_design.laws import law_of
    >>> from emps_design.machines import machine
    >>> law, t = law_of(machine("emps2019"), 1e-3), np.arange(0.0, 1.0, 1e-3)
    >>> np.array_equal(commands_of(law, t, 0.9 * t, 10.0), law.commands(t, 0.9 * t, 10.0))
    True
    """
    inputs = [np.ascontiguousarray(signal, dtype=float) for signal in law.inputs(reference, q, f_ext)]
    gains = np.ascontiguousarray(np.atleast_2d(np.asarray(law.gains, dtype=float)))
    out = np.empty(q.size)
    _along(address(law.kernel, "law"), *inputs, float(limit), gains, np.zeros(max(law.memory, 1)), out)
    return out


@cached()
def _along(law, reference, q, sensed, limit, gains, memory, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` (n,) with the commands of the law at address ``law``; ``gains`` have one row, or one a sample."""
    rows, memory_, stride = pointer(gains), pointer(memory), gains.shape[1] * int(gains.shape[0] > 1)
    for k in range(q.size):
        out[k] = call_law(law, k, reference[k], q[k], sensed[k], limit, shifted(rows, k * stride), memory_)


@dataclass(frozen=True, eq=False)
class Run(Viewed):
    """One simulated run, one row per sample.

    ``q`` [m] is the output of the encoder (with its errors), ``position`` [m] and ``v`` [m/s] the true motion on the
    encoder's side, ``u`` [V] the recorded voltage, ``force`` = G_tau u [N] (``force_gain`` (n,) if the supply changes
    or the motor is switched off), ``f_ext`` [N] the external force measured by a sensor on the carriage. ``events`` has
    a row (time [s], kind, position [m]) for every velocity zero, stick, break-away and guard; ``lost_events`` counts
    those that did not fit. ``energy`` [J] is the balance if requested, ``excitation`` [V] the signal added to the
    controller's output, if any. ``units`` are those of the axis.
    """

    q_ref: np.ndarray
    q: np.ndarray
    position: np.ndarray
    v: np.ndarray
    u: np.ndarray
    f_ext: np.ndarray
    events: np.ndarray = field(repr=False)
    force_gain: float | np.ndarray
    period: float
    lost_events: int = 0
    energy: dict[str, float] | None = None
    name: str = "simulation"
    excitation: np.ndarray | None = None
    units: Units = PLAIN

    @classmethod
    def joined(cls, runs: Sequence[Run]) -> Run:
        """Return consecutive ``runs`` of one axis as one run, without the energy balance."""
        first, *others = runs
        if not others:
            return first
        signals: dict[str, Any] = {name: np.concatenate([getattr(run, name) for run in runs]) for name in STORED}
        gain = np.concatenate([np.broadcast_to(run.force_gain, len(run)) for run in runs])
        events, lost_events = np.concatenate([run.events for run in runs]), sum(run.lost_events for run in runs)
        starts = first.period * np.cumsum([0, *map(len, runs)][:-1])
        events[:, 0] += np.repeat(starts, [len(run.events) for run in runs])
        return replace(first, **signals, events=events, force_gain=gain, lost_events=lost_events, energy=None)

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """The signals of this run by name."""
        return {name: values for name in DESCRIBED if (values := getattr(self, name)) is not None}

    @cached_property
    def t(self) -> np.ndarray:
        """Time of the samples [s]."""
        return np.arange(len(self)) * self.period

    @cached_property
    def force(self) -> np.ndarray:
        """Motor force G_tau u of the recorded voltage [N]."""
        return self.force_gain * self.u

    def __len__(self) -> int:
        return self.q.size

    @cached_property
    def crossings(self) -> np.ndarray:
        """Times at which the velocity reached zero [s]."""
        return self.events[self.events[:, 1] <= 1, 0]

    @cached_property
    def stick_intervals(self) -> np.ndarray:
        """Start and end of every interval of rest [s], shape (n, 2); the last may end with the run."""
        begin, intervals = (0.0 if self.v[0] == 0.0 else None), []
        for time, kind, _ in self.events:
            if EVENTS[int(kind)] == "stick" and begin is None:
                begin = time
            elif EVENTS[int(kind)] in ("break-away", "reversal") and begin is not None:
                intervals.append((begin, time))
                begin = None
        if begin is not None:
            intervals.append((begin, self.period * len(self)))
        return np.array([i for i in intervals if i[1] > i[0]], dtype=float).reshape(-1, 2)

    def record(self, name: str | None = None) -> Record:
        """The run as a record of the machine."""
        touched = bool(np.any(self.f_ext))
        return Record(
            t=self.t,
            q_ref=self.q_ref,
            q=self.q,
            u=self.u,
            f_ext=self.f_ext if touched else None,
            period=self.period,
            name=name or self.name,
            excitation=self.excitation,
        )

    def save(self, path: str | Path) -> None:
        """Write every signal to ``path`` (.npz, no pickles); :meth:`load` returns the same bits."""
        description = {
            "period": self.period,
            "lost_events": self.lost_events,
            "energy": self.energy,
            "name": self.name,
            "units": asdict(self.units),
        }
        with write_aside(path) as aside, open(aside, "wb") as file:
            np.savez(
                file,
                allow_pickle=False,
                **{name: values for name, values in self.signals.items() if name in (*STORED, *OPTIONAL)},
                t=self.t,
                **{RECORD: np.asarray(1)},  # also a record, whose columns an axis file must not map
                events=self.events,
                force_gain=np.asarray(self.force_gain),
                run=np.frombuffer(json.dumps(description).encode(), dtype=np.uint8),
            )

    def to_csv(self, path: str | Path, *, mapped: bool = False) -> None:
        """Write every signal to ``path`` as a table with units in the titles and 17 digits, so nothing is lost.

        ``mapped``: the axis file maps other titles, so a column marks these as plain.
        """
        titles = ",".join(f"{name} [{self.units.unit(DESCRIBED[name][1])}]" for name in self.signals)
        columns = np.column_stack(list(self.signals.values()))
        if mapped:
            titles, columns = f"{titles},{RECORD}", np.column_stack([columns, np.ones(len(columns))])
        with write_aside(path) as aside:
            np.savetxt(aside, columns, fmt="%.17g", delimiter=",", header=titles, comments="")

    @classmethod
    def load(cls, path: str | Path) -> Run:
        """Read a run written by :meth:`save`; raises :class:`RecordError` for any other file."""
        import zipfile

        try:
            with np.load(path, allow_pickle=False) as archive:
                optional = [name for name in OPTIONAL if name in archive]
                signals = {name: archive[name] for name in (*STORED, "events", "force_gain", *optional)}
                description = json.loads(archive["run"].tobytes())
                units = Units(**description.pop("units", {}))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, TypeError) as error:
            reason = " ".join(str(error).split())
            raise RecordError(f"{path}: not a simulated run ({reason}); expected an .npz of Run.save") from error
        gain = signals.pop("force_gain")
        return cls(**signals, **description, units=units, force_gain=gain if gain.ndim else float(gain))

    def to_dict(self) -> dict[str, Any]:
        """Length, events and energy as plain data; signals are written by :meth:`save` only."""
        words, unit = self.units.words, self.units.unit
        described = {name: DESCRIBED[name] for name in self.signals}
        return {
            "name": self.name,
            "samples": len(self),
            "period": self.period,
            "crossings": self.crossings.tolist(),
            "stick_intervals": self.stick_intervals.tolist(),
            "energy": self.energy,
            "signals": {name: {"label": words(label), "unit": unit(base)} for name, (label, base) in described.items()},
        }

    def view(self) -> View:
        """Length, time at rest and the largest signals."""
        unit, word = self.units.unit, self.units.word
        at_rest = float(sum(end - begin for begin, end in self.stick_intervals))
        rows = (
            ("samples", len(self), ""),
            ("period", self.period, "s"),
            ("at rest", at_rest, "s"),
            ("largest speed", float(np.max(np.abs(self.v))), unit("m/s")),
            (f"largest motor {word('force')}", float(np.max(np.abs(self.force))), unit("N")),
            (f"largest {word('voltage')}", float(np.max(np.abs(self.u))), unit("V")),
        )
        return (Table(("", "value", "unit"), rows, self.name),)

    def figure(self) -> Grid:
        """Position, velocity and motor force over time as data; intervals at rest are grey."""
        rest = tuple(Band("x", begin, end, PALE_GREY) for begin, end in self.stick_intervals)
        forces = [Curve(*thin(self.t, self.force), "motor force", BLUE, width=1.0)]
        if np.any(self.f_ext):
            forces.append(Curve(*thin(self.t, self.f_ext), "external force", RED, width=1.0))
        positions = (
            Curve(*thin(self.t, 1e3 * self.q_ref), "reference", BLACK, "--", 1.0),
            Curve(*thin(self.t, 1e3 * self.q), "encoder", BLUE, width=1.0),
        )
        velocity = (Curve(*thin(self.t, 1e3 * self.v), "velocity", BLUE, width=1.0),)
        return Grid.of(
            Axes((*rest, *positions), "", "position [mm]", f"{self.name} (grey: at rest)", legend="upper right"),
            Axes((*rest, *velocity), "", "velocity [mm/s]", legend="upper right"),
            Axes((*rest, *forces), "time [s]", "force [N]", legend="upper right"),
            height=7.0,
        )

    def plot(self, axes: Any = None) -> Any:
        """Draw position, velocity and motor force over time, labelled with units; returns the matplotlib axes."""
        if axes is None:
            from matplotlib.figure import Figure

            axes = Figure(figsize=(9, 7), layout="constrained").subplots(3, 1, sharex=True)
        for place, drawn in zip(axes, self.figure().axes, strict=True):
            draw_on(place, drawn)
        return axes
