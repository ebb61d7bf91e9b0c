"""The request of a diagnosis: records, axis, held-out data, and options of the search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from emps_design.axis import Axis
from emps_design.effects import Effect
from emps_design.errors import InputError
from emps_design.inputs import read_axis, read_record
from emps_design.records import Record
from emps_design.request import Request, option

Interval = tuple[float, float]  # start and stop [s]


def interval_from_text(text: str) -> Interval:
    """An interval from its text on the command line.

    >>> interval_from_text("0:4.5")
    (0.0, 4.5)
    """
    try:
        start, stop = (float(part) for part in text.split(":"))
    except ValueError as error:
        raise InputError(f"found {text!r}, expected START:STOP in seconds, such as 0:18.7") from error
    if not start < stop:
        raise InputError(f"found {text!r}, expected a start before the stop")
    return start, stop


INTERVAL: dict[str, Any] = {"parse": interval_from_text, "typed": str | None}


@dataclass(frozen=True)
class DiagnosisRequest(Request):
    """The parameters of :func:`emps_design.diagnose`.

    Available from Python only: ``library``, the effects to try (default: all known ones, scaled to the axis), and
    ``searched``, a callback that receives the model at the end of each search, before it is confirmed.
    """

    records: tuple[Record, ...] = option(
        ...,
        "records of one axis (.mat, .csv, .npz)",
        argument=True,
        metavar="RECORD...",
        typed=list[Path],
        read=read_record,
    )
    axis: Axis = option(..., "axis file or embedded machine", typed=str, read=read_axis)
    holdout: Record | None = option(
        None,
        "a record to confirm on, used once at the end; by default a part of RECORD",
        typed=Path | None,
        read=read_record,
    )
    fit_time: Interval | None = option(None, "fit on this interval only [s]", metavar="A:B", **INTERVAL)
    confirm_time: Interval | None = option(None, "confirm on this interval [s]", metavar="C:D", **INTERVAL)
    seed: int = option(0, "seed of the healthy reference", limits=(0, None))
    searches: int = option(
        0,
        "calibrate on this many simulated healthy records, searched like RECORD (199: minutes)",
        flags=("--healthy-runs",),
        limits=(0, 100_000),
    )
    closest: bool = option(
        False,
        "also look for the model that follows the records most closely",
        flags=("--closest-model",),
    )
    library: Sequence[Effect] | None = field(default=None, kw_only=True)
    searched: Callable[[Axis], None] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        records = (self.records,) if isinstance(self.records, Record) else tuple(self.records)
        object.__setattr__(self, "records", records)
        if self.holdout is not None and self.confirm_time is not None:
            raise InputError("give `holdout` or `confirm_time`, not both")

    def keep(self, axis: Axis) -> None:
        """Pass the model at the end of a search to the callback ``searched``."""
        if self.searched is not None:
            self.searched(axis)
