"""By how much the command of a record was logged beside its motion.

A drive's own record holds a command over the period that follows it. A log that is slower than the drive's loop has
instants of both, and the mean over a period about such an instant is nearer to it by half a sample; and either of them
may come a sample later than the other. So the command is moved to where the forces along the motion leave least, away
from rests and reversals. Less than two samples tell a drive that is late from none of the log's.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.terms import BENT, TERMS
from emps_design.identification.problem import filter_record
from emps_design.identification.proposals import FEWEST_STROKES, POWERS, Strokes
from emps_design.records import Record

FARTHEST = 2  # samples
STEP = 0.1  # samples
NEAR = 2  # steps to either side, between which what is left is a parabola
NOT_TOLD = 0.5  # samples, by which instants and means differ
BEND = int(np.argmin(np.abs(np.subtract(POWERS, 0.5))))  # of the powers, that stands for all friction that bends
SURE = 3.0  # standard deviations of a shift, by which it differs from none


class CommandLag(NamedTuple):
    """By how many ``samples`` a command comes after what the motion answers to (negative: before), and its deviation.

    ``samples`` is 0 where the record does not tell it from that; the deviation is then what it leaves open.
    """

    samples: float
    std: float


def logged_beside(record: Record, axis: Axis, friction: str, cutoff: float) -> CommandLag:
    """By how many samples the command of ``record`` was logged beside its motion.

    Judged by what mass, ``friction``, the terms that ``axis`` can have and a bend of the friction leave below
    ``cutoff`` [Hz]. Not told where the best lies :data:`FARTHEST` samples off, or leaves less by chance only.

    >>> t = np.arange(4000) * 0.01
    >>> q = np.sin(t) + 0.3 * np.sin(2.7 * t)
    >>> u = 3.0 * np.gradient(np.gradient(q, t), t) + 4.0 * np.gradient(q, t) + 2.0 * np.sign(np.gradient(q, t))
    >>> late = Record(t=t, q_ref=q, q=q, u=np.roll(u, 1), period=0.01)
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(drive={"force_gain": 1.0}, sampling={"period": 0.01})
    >>> logged_beside(late, axis, "symmetric", 5.0).samples
    1.5
    """
    terms = [term for term in TERMS if axis.units.motion in TERMS[term].motions and term != BENT]
    whole = range(-FARTHEST - 1, FARTHEST + 2)
    strokes = [Strokes(filter_record(moved(record, shift), axis, "hold", cutoff), friction) for shift in whole]
    if strokes[0].count < FEWEST_STROKES:
        return CommandLag(0.0, NOT_TOLD)
    # Filter and regression are linear, so what is left at a shift between two is made of theirs as the command is.
    left = np.array([one.residual(terms, [one.bent[:, BEND]]) for one in strokes])
    shifts = np.round(STEP * np.arange(-round(FARTHEST / STEP), round(FARTHEST / STEP) + 1), 6)
    places = np.minimum(np.floor(shifts).astype(int), FARTHEST - 1)
    parts = [left[place + FARTHEST : place + FARTHEST + 4] for place in places]
    errors = np.array([between(shift - n) @ part for shift, n, part in zip(shifts, places, parts, strict=True)]) ** 2
    total, best = errors.sum(axis=1), int(np.argmin(errors.sum(axis=1)))
    noise = float(total[best]) / errors.shape[1]  # the rows are as far apart as the filter lets them differ
    around = [best - NEAR, best, best + NEAR]
    if around[0] < 0 or around[2] >= len(shifts):
        return CommandLag(0.0, NOT_TOLD)
    curvature = float(np.array([1.0, -2.0, 1.0]) @ total[around]) / (2.0 * (NEAR * STEP) ** 2)
    std = float(np.clip(np.sqrt(noise / max(curvature, 1e-300)), 0.5 * STEP, NOT_TOLD))
    told = total[len(shifts) // 2] - total[best] > SURE**2 * noise
    return CommandLag(float(shifts[best]) if told else 0.0, std if told else NOT_TOLD)


def moved(record: Record, samples: float) -> Record:
    """``record`` with its command ``samples`` earlier, by a cubic through four of them.

    >>> ramp = np.arange(6.0)
    >>> moved(Record(t=ramp, q_ref=ramp, q=ramp, u=ramp, period=1.0), 0.5).u[1:4].tolist()
    [1.5, 2.5, 3.5]
    """
    if samples == 0.0:
        return record
    whole, places = math.floor(samples), np.arange(len(record))
    taken = [record.u[np.clip(places + whole + one, 0, len(record) - 1)] for one in (-1, 0, 1, 2)]
    return replace(record, u=between(samples - whole) @ np.array(taken))


def between(share: float) -> np.ndarray:
    """Weights (4,) of the samples at -1, 0, 1 and 2 of the cubic through them, at ``share`` of a sample (Lagrange).

    A straight line would take a tenth of what is fast, and so of an inertia.

    >>> between(0.5).tolist()
    [-0.0625, 0.5625, 0.5625, -0.0625]
    """
    x = share
    return np.array(
        [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ]
    )
