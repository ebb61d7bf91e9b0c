"""A measured or simulated run of the axis, checked once at the door."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Record:
    """Equally sampled signals of one run.

    ``t`` [s] starts at 0 with the nominal ``period`` [s]; ``q_ref`` [m] reference and ``q`` [m] encoder position, both
    on the load side; ``u`` [V] voltage that the drive was given; ``f_ext`` [N] measured external force, where there is
    one. ``extra`` keeps other columns of the file, unread by the analysis; ``warnings`` what the check at the door
    noticed. Built by :func:`emps_design.records.read_record`.
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

    def __len__(self) -> int:
        return self.t.size

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return self.period * len(self)

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
