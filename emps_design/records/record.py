"""A measured or simulated run of the axis, checked once, on reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from emps_design.errors import InputError
from emps_design.files import write_aside
from emps_design.notebook import table
from emps_design.records.check import checked


@dataclass(frozen=True)
class Record:
    """Equally sampled signals of one run.

    ``t`` [s] starts at 0 with the nominal ``period`` [s]; ``q_ref`` [m] reference and ``q`` [m] encoder position, both
    on the load side; ``u`` [V] voltage that the drive was given; ``f_ext`` [N] measured external force, where there is
    one. ``extra`` keeps other columns of the file, unread by the analysis; ``warnings`` what the check
    noticed. Built by :func:`emps_design.records.read_record` or :meth:`from_arrays`.
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
    ) -> Record:
        """Build a record from arrays, by the same check as a file; raises :class:`RecordError`.

        ``t`` [s] is the time column, or the sampling period as one number.

        >>> import numpy as np
        >>> sweep = np.sin(np.arange(100) / 10)
        >>> len(Record.from_arrays(1e-3, 0.1 * sweep, 0.1 * sweep, sweep, name="sweep"))
        100
        """
        period = float(t) if np.ndim(t) == 0 else 0.0
        columns = {"t": np.arange(np.size(q)) * period if period else t, "q_ref": q_ref, "q": q, "u": u}
        if f_ext is not None:
            columns["f_ext"] = f_ext
        return cls(name=name, **checked({**columns, **(extra or {})}, name, period=period))

    def __len__(self) -> int:
        return self.t.size

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return self.period * len(self)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The signals by their names in a file."""
        table = {"t": self.t, "q_ref": self.q_ref, "q": self.q, "u": self.u}
        return table if self.f_ext is None else {**table, "f_ext": self.f_ext}

    def part(self, start: int, stop: int, name: str | None = None) -> Record:
        """Samples ``start`` to ``stop`` as a record whose time starts at 0 again."""
        cut = slice(start, stop)
        return replace(
            self,
            t=self.t[cut] - self.t[cut][0],
            q_ref=self.q_ref[cut],
            q=self.q[cut],
            u=self.u[cut],
            f_ext=None if self.f_ext is None else self.f_ext[cut],
            name=name or f"{self.name}[{start}:{stop}]",
            extra={},
        )

    def save(self, path: str | Path) -> None:
        """Write the record as .npz or .csv, whole or not at all; the same record gives the same bytes."""
        path = Path(path)
        if path.suffix not in (".npz", ".csv"):
            raise InputError(f"{path}: found suffix {path.suffix!r}, expected .npz or .csv")
        with write_aside(path) as aside, aside.open("wb") as file:
            if path.suffix == ".npz":
                np.savez(file, **cast(Any, self.columns))
            else:
                # 17 digits bring every number back as it was, 12 are the time's and do for reading.
                formats = ["%.12g", *["%.17g"] * (len(self.columns) - 1)]
                header = ",".join(self.columns)
                table = np.column_stack(list(self.columns.values()))
                np.savetxt(file, table, fmt=formats, delimiter=",", header=header, comments="")

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
            ("stroke", float(np.ptp(self.q)), "m"),
            ("largest voltage", float(np.max(np.abs(self.u))), "V"),
            ("columns", ", ".join(self.columns), ""),
        )
        return table(self.name, rows)
