"""The law of an axis file, run on the recorded reference and position: what its controller would have commanded.

What the law cannot know does not count: how it stood before the first sample (its integrator, the sample at which a
slower loop runs), samples that both have at the limit, samples with the motor switched off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.axis import Axis
from emps_design.laws import NONE, Law, law_of
from emps_design.records import Record
from emps_design.records.clock import same_period

START_UP = 0.1  # s, after which what the law remembered before the first sample is forgotten
FEWEST_AT_START = 8  # samples
AT_LIMIT, BEYOND_LIMIT = 0.98, 1.02  # of the limit, between which a sample is at it
SETTLING = 0.015  # s behind the limit, until filters have forgotten where the integrator had been
AROUND = 3  # samples beside one with the motor switched off
PHASES, PHASE_LOOK = 16, 6000  # of a slower loop against the first sample, found on so many samples


@dataclass(frozen=True)
class Replay:
    """What the ``law`` gives, ``wanted`` (n,), for a ``record``, and the samples ``used`` (n,) bool that can tell."""

    record: Record
    law: Law
    limit: float
    wanted: np.ndarray
    used: np.ndarray

    @property
    def gap(self) -> np.ndarray:
        """The recorded command less that of the law (n,), 0 where it does not count."""
        return np.where(self.used, self.record.u - self.wanted, 0.0)

    @property
    def swing(self) -> float:
        """Deviation of the recorded command where it counts."""
        return float(np.std(self.record.u[self.used])) if self.used.any() else 0.0


def can_replay(axis: Axis, record: Record) -> bool:
    """Whether the law of ``axis`` can be run on ``record``: a reference, the axis's own clock, nothing added to it."""
    return (
        axis.controller.kind != NONE
        and record.has_reference
        and record.excitation is None
        and record.measured is None
        and same_period(record.period, axis.sampling.period)
        and law_of(axis, record.period, record.extra).follows != "rest position"
    )


def run_law(axis: Axis, record: Record) -> Replay:
    """Run the law of ``axis`` on the reference and the position of ``record``.

    One with an integrator runs without its limit: where that stood at first and behind each time at the limit is then a
    constant, which is taken out.
    """
    law, limit = law_of(axis, record.period, record.extra), float(axis.drive.command_limit)
    integrating = integrates(law, record.period)
    free = np.inf if integrating else limit
    tells = _tells(record)
    phase = 0
    if 1 < law.cycle <= PHASES:
        first = record.until(PHASE_LOOK)
        here = tells[: len(first)]
        gaps = [np.abs(_centred((first.u - commands(law, first, free, at))[here])) for at in range(law.cycle)]
        phase = int(np.argmin([np.median(gap) if gap.size else 0.0 for gap in gaps]))
    wanted = commands(law, record, free, phase)
    above, below = ((side > AT_LIMIT) & (side < BEYOND_LIMIT) for side in (record.u / limit, -record.u / limit))
    if integrating:
        settling = max(AROUND, round(SETTLING / record.period))
        used = tells & (np.convolve(above | below, np.ones(settling + 1))[: len(record)] < 0.5)
        wanted = wanted + levels(record.u - wanted, used)
    else:
        used = tells & ~(above & (wanted > AT_LIMIT * limit) | below & (wanted < -AT_LIMIT * limit))
    return Replay(record, law, free, wanted, used)


def _centred(values: np.ndarray) -> np.ndarray:
    return values - np.median(values) if values.size else values


def commands(law: Law, record: Record, limit: float, phase: int = 0) -> np.ndarray:
    """The command (n,) of ``law`` along ``record``, whose first sample is the ``phase``-th of the law's cycle."""
    followed, q, sensed, gains = law.followed(record), record.q, record.f_ext, law.gains
    if phase:
        followed, q = (np.concatenate([np.full(phase, x[0]), x]) for x in (followed, q))
        sensed = None if sensed is None else np.concatenate([np.zeros(phase), sensed])
        gains = gains if np.ndim(gains) == 1 else np.concatenate([np.repeat(gains[:1], phase, axis=0), gains])
    given = replace(law, gains=gains).commands(followed, q, limit, sensed)[phase:]
    return np.clip(np.nan_to_num(given), -limit, limit)


def _tells(record: Record) -> np.ndarray:
    """Samples (n,) bool that tell what the law gave: after the start, with the motor switched on."""
    tells = np.ones(len(record), bool)
    if record.enable is not None:
        tells &= np.convolve(record.enable == 0.0, np.ones(2 * AROUND + 1), "same") < 0.5
    tells[: min(max(FEWEST_AT_START, round(START_UP / record.period)), len(record) // 5)] = False
    return tells


def integrates(law: Law, period: float) -> bool:
    """Whether ``law`` keeps adding up an error that stays."""
    n = int(np.clip(2.0 / period, 50, 8000))
    one = replace(law, gains=law.gains[0] if np.ndim(law.gains) == 2 else law.gains)
    answer = one.commands(np.ones(2 * n), np.zeros(2 * n), np.inf)
    return bool(law.memory) and abs(answer[-1]) > 1.001 * abs(answer[n - 1])


def levels(gap: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The median (n,) of ``gap`` between one time at the limit and the next: where an integrator stood is not known."""
    stretch = np.cumsum(np.diff(used.astype(int), prepend=0) == 1)
    level = np.zeros(gap.size)
    for number in np.unique(stretch[used]):
        own = stretch == number
        level[own] = np.median(gap[own & used])
    return level
