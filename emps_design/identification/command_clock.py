"""By how much the command of a record was logged beside its motion.

A drive's own record holds a command over the period that follows it. A log that is slower than the drive's loop has
instants of both, and the mean over a period about such an instant is nearer to it by half a sample; and either of them
may come a sample later than the other. So the command is moved to where the forces along the motion leave least, away
from rests and reversals. Less than two samples tell a drive that is late from none of the log's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.terms import BENT, TERMS
from emps_design.identification.known import filter_record
from emps_design.identification.proposals import FEWEST_STROKES, LEVEL, Strokes
from emps_design.records import Record

FARTHEST = 2  # samples
STEP = 0.1  # samples


def logged_beside(record: Record, axis: Axis, friction: str, cutoff: float) -> float:
    """By how many samples the command of ``record`` comes after what its motion answers to; negative: before.

    Judged by what mass, ``friction`` and the terms that ``axis`` can have leave below ``cutoff`` [Hz]. 0 where the best
    lies :data:`FARTHEST` samples off, or is better by chance only from one stroke to the next.

    >>> t = np.arange(4000) * 0.01
    >>> q = np.sin(t) + 0.3 * np.sin(2.7 * t)
    >>> u = 3.0 * np.gradient(np.gradient(q, t), t) + 4.0 * np.gradient(q, t) + 2.0 * np.sign(np.gradient(q, t))
    >>> late = Record(t=t, q_ref=q, q=q, u=np.roll(u, 1), period=0.01)
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(drive={"force_gain": 1.0}, sampling={"period": 0.01})
    >>> logged_beside(late, axis, "symmetric", 5.0)
    1.5
    """
    terms = [term for term in TERMS if axis.units.motion in TERMS[term].motions and term != BENT]
    whole = np.arange(-FARTHEST, FARTHEST + 1)
    strokes = [Strokes(filter_record(moved(record, float(shift)), axis, "hold", cutoff), friction) for shift in whole]
    if strokes[0].count < FEWEST_STROKES:
        return 0.0
    # Filter and regression are linear, so what is left at a shift between two is straight between theirs.
    left = np.array([one.left(terms, known=one) for one in strokes])
    shifts = np.round(STEP * np.arange(-round(FARTHEST / STEP), round(FARTHEST / STEP) + 1), 6)
    places = np.clip(np.floor(shifts).astype(int) + FARTHEST, 0, len(whole) - 2)
    share = (shifts - whole[places])[:, None]
    errors = ((1.0 - share) * left[places] + share * left[places + 1]) ** 2
    best = int(np.argmin(errors.sum(axis=1)))
    here, there = (strokes[0].by_stroke(errors[place]) for place in (best, len(shifts) // 2))
    if best in (0, len(shifts) - 1) or strokes[0].chance(here, there) >= LEVEL:
        return 0.0
    return float(shifts[best])


def moved(record: Record, samples: float) -> Record:
    """``record`` with its command ``samples`` earlier, straight between two.

    >>> ramp = np.arange(4.0)
    >>> moved(Record(t=ramp, q_ref=ramp, q=ramp, u=ramp, period=1.0), 0.5).u.tolist()
    [0.5, 1.5, 2.5, 3.0]
    """
    if samples == 0.0:
        return record
    places = np.arange(len(record), dtype=float)
    return replace(record, u=np.interp(places + samples, places, record.u))
