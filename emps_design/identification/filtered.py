"""A record after one of the chains of filters, ready for a regression."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from emps_design.effects import Motion

FEWEST_STEPS = 100  # away from rest, for statistics that leave rest out


@dataclass(frozen=True)
class Filtered:
    """A record after its chain of filters.

    ``motion`` has one row for each sample of the record that was kept (none once W is made of it), and ``reduce``
    brings such a column to the rate of the regression. At that rate are ``t`` [s], ``force`` [N] and ``f_ext`` [N],
    which rows are ``used``, and which lie ``away`` from rest; ``period`` [s] is the time between two rows.
    ``cutoff_hz`` [Hz] is the low-pass of the position (None: the chain has none), ``band_hz`` [Hz] what the regression
    sees.
    """

    chain: str
    motion: Motion = field(repr=False)
    t: np.ndarray = field(repr=False)
    force: np.ndarray
    f_ext: np.ndarray | None
    reduce: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    used: np.ndarray = field(repr=False)
    away: np.ndarray = field(repr=False)
    period: float
    cutoff_hz: float | None
    band_hz: float
    decimation: int
    text: str

    def without_motion(self) -> Filtered:
        """The same with no row of motion: three columns of the whole record, which nothing needs once W is made."""
        none = np.zeros(0)
        return replace(self, motion=Motion(none, none, none, none, none, self.motion.period))

    @property
    def resolved_steps(self) -> int:
        """Rows between two that the filter's band lets differ: half a period of its upper end."""
        return max(1, round(0.5 / (self.band_hz * self.period)))

    @property
    def independent_rows(self) -> tuple[int, np.ndarray]:
        """Rows between two that the band resolves, and which (n,) take part in the statistics: those away from rest."""
        steps, away = self.resolved_steps, self.used & self.away
        return steps, away if int(away[::steps].sum()) >= FEWEST_STEPS else self.used
