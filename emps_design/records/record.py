"""A measured or simulated run of an axis, and several runs joined to one record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from emps_design.errors import InputError, RecordError
from emps_design.files import write_aside
from emps_design.messages import Message, warning
from emps_design.records.check import PLAIN, check_columns
from emps_design.records.clock import same_period
from emps_design.records.columns import OPTIONAL, RECORD
from emps_design.records.layout import MAPPED, Assignment, Layout
from emps_design.stretches import stretches
from emps_design.view import Line, Table, View, Viewed

MEASURED = "measured."  # prefix, in an archive, of the signals before they were resampled

BRIDGE = 1.0  # s from one record to the next

WHOLE_STEPS = 0.05  # of a step, largest distance of an increment from whole steps
MOST = 0.01  # share of the increments that may be further off
CANDIDATE_STEPS = 24  # distances between increments that are tried as the step
MOST_INCREMENTS = 1 << 16  # increments
MOST_VALUES = 32  # that one multiple of a step has in a file, by single precision or few digits; noise makes more

MOST_DIGITS = 1 << 18  # largest increment that is looked at
FEWEST_STEPS = 6  # over which increments have to spread
FINEST = 2.5  # units of the last digit: finer steps are lost in the rounding
FINER_LINES = 4  # times as many lines as the increments need, so that no peak falls between two
AS_ROUNDED = 0.9  # of the sum over increments that rounding leaves, from which on they are steps
BY_CHANCE = 1e-4  # probability of such a sum over increments without a step


@dataclass(frozen=True)
class Record(Viewed):
    """Equally sampled signals of one run.

    ``t`` [s] starts at 0 with the nominal ``period`` [s]; ``q_ref`` reference and ``q`` encoder position [m, rad of a
    rotary axis], both on the load side; ``u`` command of the drive [V, or the command unit of the axis]. Optional:
    ``f_ext`` measured external force [N or N m]; ``velocity_reference`` and ``velocity``, the drive's own [m/s or
    rad/s]; ``supply`` [V]; ``enable``, 0 where the motor is switched off; ``excitation``, added to the controller's
    output [as u]; ``bridged``, 1 in a gap that a straight line bridges. ``q_ref_recorded`` is False where the reference
    is a substitute; ``held`` is False where the drive is faster than the record, so that ``u`` changes between samples.

    ``measured`` has the signals at their own times if they were resampled; ``assigned`` the columns of the file;
    ``extra`` its other columns, which no analysis reads; ``warnings`` the notes of the checks, and of these
    ``contradictions`` those of the law or the motion. Built by :func:`emps_design.records.read_record` or
    :meth:`from_arrays`.
    """

    t: np.ndarray
    q_ref: np.ndarray
    q: np.ndarray
    u: np.ndarray
    period: float
    f_ext: np.ndarray | None = None
    name: str = "record"
    sha256: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict, repr=False)
    warnings: tuple[Message, ...] = ()
    contradictions: tuple[Message, ...] = ()
    velocity_reference: np.ndarray | None = None
    velocity: np.ndarray | None = None
    supply: np.ndarray | None = None
    enable: np.ndarray | None = None
    excitation: np.ndarray | None = None
    bridged: np.ndarray | None = None
    q_ref_recorded: bool = True
    held: bool = True
    measured: Mapping[str, np.ndarray] | None = field(default=None, repr=False)
    assigned: tuple[Assignment, ...] = field(default=(), repr=False)

    @classmethod
    def from_arrays(
        cls,
        t: Any,
        q_ref: Any,
        q: Any,
        u: Any,
        f_ext: Any = None,
        name: str = "record",
        extra: Mapping[str, Any] | None = None,
        layout: Layout = PLAIN,
        **more: Any,
    ) -> Record:
        """Build a record from arrays, checked like a file; raises :class:`RecordError`.

        ``t`` [s] is the time column, or the sampling period as one number; ``more`` are the other columns by name.

        >>> import numpy as np
        >>> sweep = np.sin(np.arange(100) / 10)
        >>> len(Record.from_arrays(1e-3, 0.1 * sweep, 0.1 * sweep, sweep, name="sweep"))
        100
        """
        period = float(t) if np.ndim(t) == 0 else 0.0
        columns = {"t": np.arange(np.size(q)) * period if period else t, "q_ref": q_ref, "q": q, "u": u}
        unknown = set(more) - set(OPTIONAL)
        if unknown:
            raise InputError(f"{name}: found column {min(unknown)!r}, expected one of {', '.join(OPTIONAL)}")
        optional = {key: values for key, values in {"f_ext": f_ext, **more}.items() if values is not None}
        columns |= {**optional, **(extra or {})}
        return cls(name=name, **check_columns(columns, name, period=period, layout=layout))

    def __len__(self) -> int:
        return self.t.size

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return self.period * len(self)

    @property
    def has_reference(self) -> bool:
        """Whether a reference of position or velocity was recorded."""
        return self.q_ref_recorded or self.velocity_reference is not None

    @cached_property
    def encoder_step(self) -> float | None:
        """Step of the encoder [m or rad] that the position shows; None without one, or without a position of its own.

        >>> sine = np.sin(np.arange(99))
        >>> round(Record.from_arrays(1e-3, np.zeros(99), 2e-6 * np.rint(40.0 * sine), sine).encoder_step, 12)
        2e-06
        """
        if self.assigned and all(assignment.name != "q" for assignment in self.assigned):
            return None
        return step_before_rounding(np.diff(self.q if self.measured is None else self.measured["q"])) or None

    @property
    def in_gap(self) -> np.ndarray:
        """Mask (n,) bool of the samples in a gap."""
        return np.zeros(len(self), bool) if self.bridged is None else self.bridged > 0.0

    @property
    def pieces(self) -> list[tuple[int, int]]:
        """First sample and the one after the last of each piece between gaps: one piece without gaps.

        >>> ramp = np.arange(60.0)
        >>> Record.from_arrays(0.01, ramp / 9, ramp / 9, np.sin(ramp), bridged=(ramp > 9) & (ramp < 20)).pieces
        [(0, 10), (20, 60)]
        """
        return stretches(~self.in_gap)

    @property
    def gaps_in_words(self) -> tuple[Message, ...]:
        """A message on the pieces of a record with gaps; none without gaps."""
        count = len(self.pieces)
        text = f"{self.name}: used as {count} pieces, without the gaps between them"
        return (warning("taken-as-pieces", text, count=count),) if count > 1 else ()

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The signals by their names in a file."""
        reference = {"q_ref": self.q_ref} if self.q_ref_recorded else {}
        table = {"t": self.t, **reference, "q": self.q, "u": self.u}
        return table | {name: column for name, column in self._optional.items() if column is not None}

    @property
    def _optional(self) -> dict[str, np.ndarray | None]:
        return {name: getattr(self, name) for name in OPTIONAL}

    def part(self, start: int, stop: int, name: str | None = None) -> Record:
        """Samples ``start`` to ``stop`` (excluded) as a record with time from 0."""
        cut = slice(start, stop)
        optional: Any = {key: None if column is None else column[cut] for key, column in self._optional.items()}
        own = {key: value for key, value in self.extra.items() if np.size(value) == 1}
        own |= {key: value[cut] for key, value in self.extra.items() if np.shape(value)[:1] == (len(self),)}
        return replace(
            self,
            t=self.t[cut] - self.t[cut][0],
            q_ref=self.q_ref[cut],
            q=self.q[cut],
            u=self.u[cut],
            name=name or f"{self.name}[{start}:{stop}]",
            extra=own,
            measured=None,
            **optional,
        )

    def until(self, stop: int) -> Record:
        """The first ``stop`` samples under the same name; the record itself where it has no more."""
        return self if stop >= len(self) else self.part(0, stop, self.name)

    def save(self, path: str | Path) -> None:
        """Write the record as .npz or .csv, completely or not at all; the same record gives the same bytes."""
        path = Path(path)
        if path.suffix not in (".npz", ".csv"):
            raise InputError(f"{path}: found suffix {path.suffix!r}, expected .npz or .csv")
        with write_aside(path) as aside, aside.open("wb") as file:
            if path.suffix == ".npz":
                np.savez(file, **cast(Any, {**self.columns, **self._archive_members(), RECORD: 1}))
            else:
                columns = self.columns
                # A mapped record is marked, so that its columns are not mapped again.
                if any(assignment.how == MAPPED for assignment in self.assigned):
                    columns[RECORD] = np.ones(len(self))
                # 17 digits reproduce every number exactly; 12 suffice for the time.
                formats = ["%.12g", *["%.17g"] * (len(columns) - 1)]
                table = np.column_stack(list(columns.values()))
                np.savetxt(file, table, fmt=formats, delimiter=",", header=",".join(columns), comments="")

    def _archive_members(self) -> dict[str, np.ndarray]:
        """Further members of an archive: single numbers of the file, and the signals before they were resampled."""
        single = {key: np.asarray(value) for key, value in self.extra.items() if np.size(value) == 1}
        numbers = {key: value for key, value in single.items() if value.dtype.kind in "buif" and key.isidentifier()}
        measured = {f"{MEASURED}{name}": values for name, values in (self.measured or {}).items()}
        return {**numbers, **measured}

    def to_dict(self) -> dict[str, Any]:
        """Plain data that identifies the record, without its samples."""
        return {
            "name": self.name,
            "samples": len(self),
            "period": self.period,
            "duration": self.duration,
            "stroke": float(np.ptp(self.q)),
            "largest_voltage": float(np.max(np.abs(self.u))),
            "columns": list(self.columns),
            "sha256": self.sha256,
            "warnings": list(self.warnings),
        }

    def view(self) -> View:
        """Length, period, stroke, largest command and columns; without its axis a record has no units."""
        rows = (
            ("samples", len(self), ""),
            ("period", self.period, "s"),
            ("duration", self.duration, "s"),
            ("stroke", float(np.ptp(self.q)), "m or rad"),
            ("largest command", float(np.max(np.abs(self.u))), "as the drive counts"),
        )
        return (Table(("", "value", "unit"), rows, self.name), Line(f"columns: {', '.join(self.columns)}"))


def joined(records: Sequence[Record], rotary: bool = False) -> Record:
    """Join ``records`` of one axis, with a bridge between each two; a ``rotary`` one continues in the same turn.

    Position and reference cross the bridge smoothly, with the slope of either end. Columns that one record lacks are
    left out. Raises :class:`RecordError` for records of different sampling periods.

    >>> ramp = np.arange(100.0) / 100
    >>> both = joined([Record.from_arrays(0.01, q, q, np.sin(ramp), name="a") for q in (ramp, -ramp)])
    >>> len(both), int(both.bridged.sum()), both.name
    (300, 100, 'a + a')
    """
    first, *others = records
    for record in others:
        if not same_period(record.period, first.period):
            raise RecordError(
                f"{record.name}: found a sampling period of {1e3 * record.period:g} ms, expected "
                f"{1e3 * first.period:g} ms of {first.name}; join records of one drive"
            )
    names = [
        name for name in OPTIONAL if name != "bridged" and all(getattr(record, name) is not None for record in records)
    ]
    bridge = max(2, round(BRIDGE / first.period))
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("q_ref", "q", "u", "bridged", *names)}
    last = 0.0
    for index, record in enumerate(records):
        turn = 2.0 * math.pi * round((last - record.q[0]) / (2.0 * math.pi)) if rotary and index else 0.0
        own = {name: getattr(record, name) for name in names}
        own |= {"q_ref": record.q_ref + turn, "q": record.q + turn, "u": record.u}
        own["bridged"] = np.zeros(len(record)) if record.bridged is None else record.bridged
        for name, values in own.items():
            if index:
                between = np.ones(bridge) if name == "bridged" else _between(columns[name][-1], values, bridge)
                columns[name].append(between)
            columns[name].append(values)
        last = float(own["q"][-1])
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    absent = dict.fromkeys(set(OPTIONAL) - set(whole), None)
    return replace(
        first,
        t=np.arange(whole["q"].size) * first.period,
        name=" + ".join(record.name for record in records),
        sha256="",
        extra={key: value for key, value in first.extra.items() if np.size(value) == 1},
        warnings=tuple(message.of(record.name) for record in records for message in record.warnings),
        contradictions=tuple(message.of(record.name) for record in records for message in record.contradictions),
        q_ref_recorded=all(record.q_ref_recorded for record in records),
        measured=None,
        **{**whole, **absent},  # type: ignore[arg-type]
    )


def _between(before: np.ndarray, after: np.ndarray, count: int) -> np.ndarray:
    """A cubic (count,) from the end of ``before`` to the start of ``after``, with the slopes of both."""
    x = np.arange(1, count + 1) / (count + 1)
    start, stop = float(before[-1]), float(after[0])
    first, last = (count + 1) * float(before[-1] - before[-2]), (count + 1) * float(after[1] - after[0])
    rise = x * x * (3.0 - 2.0 * x)
    return start + (stop - start) * rise + first * x * (1.0 - x) ** 2 - last * x * x * (1.0 - x)


def quantisation_step(increments: np.ndarray) -> float:
    """The step of which all ``increments`` (n,) of a signal are multiples, in its unit; 0 for none.

    The distances between increments are tried: of a motion at many steps a sample no increment is the step itself.
    Few multiples show a step only where each has few values, for two or three levels with noise are evenly spaced too.

    >>> steps = np.random.default_rng(0).integers(-40, 40, 200)
    >>> round(quantisation_step(2.5e-6 * steps + 1e-12) * 1e6, 6), quantisation_step(np.sin(np.arange(99.0)))
    (2.5, 0.0)
    """
    some = increments[:: -(-increments.size // MOST_INCREMENTS)]
    away = some - np.quantile(some, 0.5, method="nearest")
    gaps = np.diff(np.unique(away))
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(away), initial=0.0)]
    if not gaps.size:
        return 0.0
    values = gaps.size + 1
    tried = np.unique(np.quantile(np.unique(gaps), np.linspace(0.0, 1.0, CANDIDATE_STEPS), method="nearest"))[::-1]
    for step in map(float, tried):
        for most in (2.0, 8.0, 32.0, 128.0, np.inf):  # small multiples first refine an inexact step
            near = away[np.abs(away) < most * step]
            whole = np.rint(near / step)
            if np.any(whole):
                step = float(whole @ near / (whole @ whole))
        whole = np.rint(away / step)
        if np.mean(whole != 0.0) > MOST > np.mean(np.abs(away / step - whole) > WHOLE_STEPS):
            multiples = np.unique(whole).size
            if multiples > FEWEST_STEPS or values <= MOST_VALUES * multiples:
                return abs(step)
    return 0.0


def step_before_rounding(increments: np.ndarray) -> float:
    """The step of a signal with ``increments`` (n,), in its unit, before a file rounded it to few digits; 0 for none.

    An increment of k steps s is recorded as one of the two multiples n of the last digit d that are next to k s/d.
    Where k takes many values, n - k s/d is spread evenly over -1 to 1, so the mean of exp(2 pi i n d/s) over the
    different n has the modulus sinc(2 d/s). Without such a step they are all whole numbers, and it is near 0.

    >>> steps = np.random.default_rng(0).integers(-40, 40, 200)
    >>> round(step_before_rounding(np.diff(np.round(8.8e-5 * np.cumsum(steps), 5))) * 1e5, 1)
    8.8
    """
    from scipy.fft import next_fast_len, rfft

    digit = quantisation_step(increments)
    if not digit:
        return 0.0
    n = np.unique(np.rint(increments / digit))
    n = n[(n != 0.0) & (np.abs(n) < MOST_DIGITS)].astype(int)
    if n.size <= FEWEST_STEPS:
        return digit
    span = int(n[-1] - n[0])
    size = next_fast_len(FINER_LINES * (span + 1), real=True)
    mean = np.abs(rfft(np.bincount(n - n[0], minlength=size).astype(float))) / n.size
    line = np.arange(mean.size) / size  # d/s
    steps = (line > FEWEST_STEPS / span) & (line < 1.0 / FINEST) & (mean > AS_ROUNDED * np.sinc(2.0 * line))
    steps &= n.size * mean**2 > np.log(mean.size / BY_CHANCE)
    if not np.any(steps):
        return digit
    at = int(np.argmax(steps))
    while mean[at + 1] > mean[at]:
        at += 1
    before, peak, after = np.log(mean[at - 1 : at + 2])
    step = size / (at + 0.5 * (before - after) / (before - 2.0 * peak + after))
    for _ in range(2):
        whole = np.rint(n / step)
        step = float(whole @ n / (whole @ whole))
    beside = np.mean(np.abs(n - whole * step) > 1.0 + WHOLE_STEPS)
    return digit * step if beside < 1.0 - AS_ROUNDED and np.unique(whole).size > FEWEST_STEPS else digit
