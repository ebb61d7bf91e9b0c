"""What of a record confirms where no other one was given: its first lap or its last strokes, closed during the search.

A share of the gap that is closed on the samples that were fitted says little. So one lap is kept, where the reference
repeats and two laps are left to tell the noise: the first, which starts from rest unlike the others and tells none of
it. Otherwise it is the last third of the strokes. Where that would leave too little to find anything by, nothing is
kept, and the answer says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.partition import START_UP, find_lap, find_strokes
from emps_design.records import Record

LAPS = 3  # from which on one of them is kept
STROKES = 6  # that a record without laps must have
KEPT = 1 / 3  # of them

Interval = tuple[float, float]


@dataclass(frozen=True)
class Confirming:
    """Which data confirm, in words: ``what`` they are, ``chosen`` "given", "kept", "in turn" or "none", ``time`` [s] of
    a part.

    ``what`` says for "none" why nothing was kept.
    """

    what: str
    chosen: str
    time: Interval | None = None

    @property
    def opened(self) -> Confirming:
        """The same where what was kept has something that the rest lacks: then all is fitted."""
        return Confirming(f"{self.what}, kept closed at first, has something that the rest lacks", "none")

    @property
    def sentence(self) -> str:
        """What the errors and shares are of, for who reads the answer; nothing where a record was given for it."""
        if self.chosen == "kept":
            return f"Nothing was fitted to {self.what}, kept closed to confirm."
        if self.chosen == "in turn":
            return f"Each of {self.what} was predicted from the others: errors and shares are of what was not fitted."
        if self.chosen == "none":
            return (
                f"Nothing was held out ({self.what}): errors and shares are of what was fitted; give another record as "
                "`holdout`."
            )
        return ""

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "what": self.what,
            "chosen": self.chosen,
            "time": None if self.time is None else list(self.time),
            "text": self.sentence,
        }


def given(record: Record, time: Interval | None = None) -> Confirming:
    """Say that ``record``, or the interval ``time`` [s] of it, was given to confirm."""
    part = "" if time is None else f"{time[0]:.4g} to {time[1]:.4g} s of "
    return Confirming(f"{part}{record.name}", "given", time)


def kept_closed(records: tuple[Record, ...], fit_time: Interval | None = None) -> Confirming:
    """Choose what of ``records`` to keep closed within ``fit_time`` [s]: of several, which are fitted whole, nothing.

    >>> wave = np.abs(np.arange(6000) % 1000 - 500.0) * 1e-3
    >>> kept_closed((Record.from_arrays(1e-3, wave, wave, wave, name="run"),)).sentence
    'Nothing was fitted to the first lap of run, 0 to 1 s, kept closed to confirm.'
    >>> kept_closed((Record.from_arrays(1e-3, wave[:1200], wave[:1200], wave[:1200], name="run"),)).sentence
    'Nothing was held out (run has 3 strokes and does not repeat three times): errors and shares are of what was \
fitted; give another record as `holdout`.'
    """
    record = records[0]
    if len(records) > 1:
        return Confirming(f"{len(records)} records are fitted together", "none")
    begin, end = 0, len(record)
    if fit_time is not None:
        begin, end = (int(i) for i in np.searchsorted(record.t, fit_time))
    lap, strokes = find_lap(record.q_ref), find_strokes(record.q_ref, record.period)
    inside = [(start, stop) for start, stop in strokes if start >= begin and stop <= end]
    if lap and end - begin >= LAPS * lap - START_UP:
        start, stop, what = begin, begin + lap, "the first lap"
    elif lap or len(inside) < STROKES:
        return Confirming(f"{record.name} has {_strokes(len(inside))} and does not repeat three times", "none")
    else:
        count = int(KEPT * len(inside))
        start, stop, what = inside[-count][0], end, f"the last {count} of {_strokes(len(inside))}"
    left = end - begin - (stop - start)
    if stop - start < START_UP + rules.FEWEST_TO_CONFIRM or left < rules.FEWEST_TO_FIT + rules.FEWEST_TO_SELECT:
        return Confirming(f"{record.name} has {end - begin} samples to fit", "none")
    time = float(record.t[start]), float(record.t[stop - 1]) + 0.5 * record.period
    shown = f"{time[0]:.4g} to {time[0] + (stop - start) * record.period:.4g} s"
    return Confirming(f"{what} of {record.name}, {shown}", "kept", time)


def _strokes(number: int) -> str:
    return f"{number} stroke{'' if number == 1 else 's'}"
