"""A measured or simulated run of the axis, checked once, on reading.

Several records as one, with a bridge between each two that takes no part: for what only all together tell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from emps_design.errors import InputError, RecordError
from emps_design.files import write_aside
from emps_design.notebook import table
from emps_design.records.check import PLAIN, checked
from emps_design.records.clock import same_period
from emps_design.records.columns import OPTIONAL, RECORD
from emps_design.records.layout import MAPPED, Assignment, Layout
from emps_design.stretches import stretches

MEASURED = "measured."  # before the names, in an archive, of what was resampled, at its own times

BRIDGE = 1.0  # s from one record to the next


@dataclass(frozen=True)
class Record:
    """Equally sampled signals of one run.

    ``t`` [s] starts at 0 with the nominal ``period`` [s]; ``q_ref`` reference and ``q`` encoder position [m, or rad of
    an axis that turns], both on the load side; ``u`` what the drive was given [V, or the command unit of the axis].
    Where there are such columns: ``f_ext`` measured external force [N or N m]; ``velocity_reference`` and ``velocity``,
    the drive's own [m/s or rad/s]; ``supply`` [V]; ``enable``, 0 where the motor was switched off; ``excitation``, what
    was added to the controller's output [as u]; ``bridged``, 1 where nothing was recorded and a straight line joins two
    pieces. ``q_ref_recorded`` is False where something stands for the reference.

    ``measured`` has the signals at their own times where they were resampled; ``assigned`` says which column of the
    file each was. ``extra`` keeps other columns of the
    file, unread by the analysis; ``warnings`` what the checks noticed, and of these ``contradictions`` what its own
    controller or motion contradicts. Built by
    :func:`emps_design.records.read_record` or :meth:`from_arrays`.
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
    warnings: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    velocity_reference: np.ndarray | None = None
    velocity: np.ndarray | None = None
    supply: np.ndarray | None = None
    enable: np.ndarray | None = None
    excitation: np.ndarray | None = None
    bridged: np.ndarray | None = None
    q_ref_recorded: bool = True
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
        """Build a record from arrays, by the same check as a file; raises :class:`RecordError`.

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
        given = {key: values for key, values in {"f_ext": f_ext, **more}.items() if values is not None}
        return cls(name=name, **checked({**columns, **given, **(extra or {})}, name, period=period, layout=layout))

    def __len__(self) -> int:
        return self.t.size

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return self.period * len(self)

    @property
    def has_reference(self) -> bool:
        """Whether what the controller followed was recorded."""
        return self.q_ref_recorded or self.velocity_reference is not None

    @property
    def in_gap(self) -> np.ndarray:
        """Where nothing was recorded, (n,) of bool."""
        return np.zeros(len(self), bool) if self.bridged is None else self.bridged > 0.0

    @property
    def pieces(self) -> list[tuple[int, int]]:
        """First sample and the one after the last of each piece that was recorded: one of a record without gaps.

        >>> ramp = np.arange(60.0)
        >>> Record.from_arrays(0.01, ramp / 9, ramp / 9, np.sin(ramp), bridged=(ramp > 9) & (ramp < 20)).pieces
        [(0, 10), (20, 60)]
        """
        return stretches(~self.in_gap)

    @property
    def gaps_in_words(self) -> tuple[str, ...]:
        """That the record is taken as its pieces, where it has gaps: what every command says of it that uses them."""
        count = len(self.pieces)
        return (f"{self.name}: taken as {count} pieces, what lies between takes no part",) if count > 1 else ()

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
        """Samples ``start`` to ``stop`` as a record whose time starts at 0 again."""
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
        """Write the record as .npz or .csv, whole or not at all; the same record gives the same bytes."""
        path = Path(path)
        if path.suffix not in (".npz", ".csv"):
            raise InputError(f"{path}: found suffix {path.suffix!r}, expected .npz or .csv")
        with write_aside(path) as aside, aside.open("wb") as file:
            if path.suffix == ".npz":
                np.savez(file, **cast(Any, {**self.columns, **self._kept(), RECORD: 1}))
            else:
                columns = self.columns
                if any(one.how == MAPPED for one in self.assigned):  # not to be mapped once more, whatever the names
                    columns[RECORD] = np.ones(len(self))
                # 17 digits bring every number back as it was, 12 are the time's and do for reading.
                formats = ["%.12g", *["%.17g"] * (len(columns) - 1)]
                table = np.column_stack(list(columns.values()))
                np.savetxt(file, table, fmt=formats, delimiter=",", header=",".join(columns), comments="")

    def _kept(self) -> dict[str, np.ndarray]:
        """What an archive keeps beside the columns: single numbers of the file, and what was resampled."""
        single = {key: np.asarray(value) for key, value in self.extra.items() if np.size(value) == 1}
        numbers = {key: value for key, value in single.items() if value.dtype.kind in "buif" and key.isidentifier()}
        measured = {f"{MEASURED}{name}": values for name, values in (self.measured or {}).items()}
        return {**numbers, **measured}

    def to_dict(self) -> dict[str, Any]:
        """What identifies the record, without its samples."""
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

    def _repr_html_(self) -> str:
        rows = (
            ("samples", len(self), ""),
            ("period", self.period, "s"),
            ("duration", self.duration, "s"),
            ("stroke", float(np.ptp(self.q)), "m or rad"),
            ("largest command", float(np.max(np.abs(self.u))), "as the drive counts"),
            ("columns", ", ".join(self.columns), ""),
        )
        return table(self.name, rows)


def joined(records: Sequence[Record], rotary: bool = False) -> Record:
    """Join ``records`` of one axis; a ``rotary`` one goes on in the turn in which the record before ended.

    Position and reference cross a bridge smoothly, at the speed of either end. Columns that one record lacks are left
    out. Raises :class:`RecordError` for records of different sampling periods.

    >>> ramp = np.arange(100.0) / 100
    >>> both = joined([Record.from_arrays(0.01, q, q, np.sin(ramp), name="a") for q in (ramp, -ramp)])
    >>> len(both), int(both.bridged.sum()), both.name
    (300, 100, 'a + a')
    """
    first, *others = records
    for one in others:
        if not same_period(one.period, first.period):
            raise RecordError(
                f"{one.name}: found a sampling period of {1e3 * one.period:g} ms, expected {1e3 * first.period:g} ms "
                f"of {first.name}; join records of one drive"
            )
    names = [name for name in OPTIONAL if name != "bridged" and all(getattr(one, name) is not None for one in records)]
    bridge = max(2, round(BRIDGE / first.period))
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("q_ref", "q", "u", "bridged", *names)}
    last = 0.0
    for index, one in enumerate(records):
        turn = 2.0 * math.pi * round((last - one.q[0]) / (2.0 * math.pi)) if rotary and index else 0.0
        own = {name: getattr(one, name) for name in names} | {"q_ref": one.q_ref + turn, "q": one.q + turn, "u": one.u}
        own["bridged"] = np.zeros(len(one)) if one.bridged is None else one.bridged
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
        name=" + ".join(one.name for one in records),
        sha256="",
        extra={key: value for key, value in first.extra.items() if np.size(value) == 1},
        warnings=tuple(f"{one.name}: {text}" for one in records for text in one.warnings),
        contradictions=tuple(f"{one.name}: {text}" for one in records for text in one.contradictions),
        q_ref_recorded=all(one.q_ref_recorded for one in records),
        measured=None,
        **{**whole, **absent},  # type: ignore[arg-type]
    )


def _between(before: np.ndarray, after: np.ndarray, count: int) -> np.ndarray:
    """A cubic over ``count`` samples from the end of ``before`` to the start of ``after``, at the slope of either."""
    x = np.arange(1, count + 1) / (count + 1)
    start, stop = float(before[-1]), float(after[0])
    first, last = (count + 1) * float(before[-1] - before[-2]), (count + 1) * float(after[1] - after[0])
    rise = x * x * (3.0 - 2.0 * x)
    return start + (stop - start) * rise + first * x * (1.0 - x) ** 2 - last * x * x * (1.0 - x)
