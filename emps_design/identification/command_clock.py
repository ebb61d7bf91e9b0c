"""Time shift between the logged command of a record and its motion.

A drive's own record holds a command over the period that follows it. A log that is slower than the drive's loop holds
samples of both, so that the mean over a period is half a sample nearer; and either signal may be logged a sample late.
The shift is the one at which a model of the forces along the motion leaves the smallest residual, away from rests and
reversals. A shift below two samples cannot be told from a delay of the drive.
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
NEAR = 2  # steps to either side, between which the squares of the residual follow a parabola
UNKNOWN = 0.5  # samples, by which sampled values and means differ: deviation of a shift that is not determined
BEND = int(np.argmin(np.abs(np.subtract(POWERS, 0.5))))  # index of the exponent that stands for all bent friction
SURE = 3.0  # standard deviations from zero of a significant shift


class CommandLag(NamedTuple):
    """Delay of the logged command against the motion in ``samples`` (negative: early), and its standard deviation.

    ``samples`` is 0 where the delay is not significant; ``std`` then is the remaining uncertainty.
    """

    samples: float
    std: float


def logged_beside(record: Record, axis: Axis, friction: str, cutoff: float) -> CommandLag:
    """Delay of the command of ``record`` against its motion.

    The delay minimises the residual below ``cutoff`` [Hz] of a model of mass, ``friction``, the terms possible on
    ``axis`` and a bent friction. It is 0 where the minimum lies :data:`FARTHEST` samples off or is not significant.

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
        return CommandLag(0.0, UNKNOWN)
    # Filter and regression are linear, so residuals between two shifts are interpolated as the command is.
    residuals = np.array([shifted.residual(terms, [shifted.bent[:, BEND]]) for shifted in strokes])
    shifts = np.round(STEP * np.arange(-round(FARTHEST / STEP), round(FARTHEST / STEP) + 1), 6)
    places = np.minimum(np.floor(shifts).astype(int), FARTHEST - 1)
    parts = [residuals[place + FARTHEST : place + FARTHEST + 4] for place in places]
    errors = np.array([between(shift - n) @ part for shift, n, part in zip(shifts, places, parts, strict=True)]) ** 2
    total, best = errors.sum(axis=1), int(np.argmin(errors.sum(axis=1)))
    noise = float(total[best]) / errors.shape[1]  # the rows are as far apart as the filter resolves
    around = [best - NEAR, best, best + NEAR]
    if around[0] < 0 or around[2] >= len(shifts):
        return CommandLag(0.0, UNKNOWN)
    curvature = float(np.array([1.0, -2.0, 1.0]) @ total[around]) / (2.0 * (NEAR * STEP) ** 2)
    std = float(np.clip(np.sqrt(noise / max(curvature, 1e-300)), 0.5 * STEP, UNKNOWN))
    significant = total[len(shifts) // 2] - total[best] > SURE**2 * noise
    return CommandLag(float(shifts[best]) if significant else 0.0, std if significant else UNKNOWN)


def moved(record: Record, samples: float) -> Record:
    """``record`` with its command ``samples`` earlier, by cubic interpolation.

    >>> ramp = np.arange(6.0)
    >>> moved(Record(t=ramp, q_ref=ramp, q=ramp, u=ramp, period=1.0), 0.5).u[1:4].tolist()
    [1.5, 2.5, 3.5]
    """
    if samples == 0.0:
        return record
    whole, places = math.floor(samples), np.arange(len(record))
    taken = [record.u[np.clip(places + whole + offset, 0, len(record) - 1)] for offset in (-1, 0, 1, 2)]
    return replace(record, u=between(samples - whole) @ np.array(taken))


def between(share: float) -> np.ndarray:
    """Weights (4,) of the samples at -1, 0, 1 and 2 for cubic (Lagrange) interpolation at ``share`` of a sample.

    Linear interpolation would attenuate fast motion, and so the inertia, by a tenth.

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
