"""Memories of the path: own states that change with travel alone, along a stretch of it in one step.

Between two places a memory x obeys ``dx/d|q| = (end - x)/travel``, where both follow the level of the dry friction: a
contact that bends before it slides (Dahl) tends to the bend that carries the whole friction. However short the travel,
the solution is known.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.compile import call_kernel, call_rate, fused
from emps_design.simulation.kernels.motion import BRAKING, DRY, MEMORY, RATE, dry, total

_EVENLY = 1e-6  # relative change of a level or a travel that is next to none
_STEEPEST = -0.3  # of what the travel of a memory changes along the path


@fused
def remember(before, y, t, acting, level, curve, s, plant, work):
    """Fill the memories of ``y`` with what those of ``before`` become on the way there; returns the level there [N].

    ``level`` is that of the dry friction ``before``. Between the two it goes along a parabola of the travel, ``curve``
    its half second derivative, and so do what a memory tends to and the travel over which it does (:func:`tends`; where
    the level never changes ``work[2]`` and ``work[4]`` hold them). Were that travel a line the equation would have a
    parabola for a solution, and any other would come closer to it by ``exp(-integral d|q|/travel)``; what its bow
    changes of both is added to first order. ``work[3]`` gets two numbers: what Simpson's rule over twice as much misses
    of the force [N], and what the force, as long as it remembers, owes to the curve [N per N/m^2].
    """
    _, hooks, starts, p, settings, _ = plant
    moved, missed, owed, after, varies = abs(y[0] - before[0]), 0.0, 0.0, level, starts[DRY + 1] > starts[DRY]
    if varies:
        after = dry(y, t, acting - settings[BRAKING] * y[1], plant)
    for i in range(starts[RATE], starts[RATE + 1]):
        at, k = hooks[3 * i + 1], starts[MEMORY] + i - starts[RATE]
        x = before[at]
        y[at] = 1.0
        stiff = call_kernel(hooks[3 * k], y[0], y[1], t, acting, y, at, p, hooks[3 * k + 2], plant[0])
        end, travel, slope, bow, added, bowed = work[2][at], work[4][at], 0.0, 0.0, 0.0, 0.0
        steps = moved / travel
        if varies:
            end, travel = tends(i, y, t, acting, level, s, plant, work[3])
            steps = moved / travel
            if moved > 0.0 and level > 0.0:
                more = after - level if abs(after - level) > _EVENLY * level else _EVENLY * level
                later, longer = tends(i, y, t, acting, level + more, s, plant, work[3])
                of_end, of_travel, climb = (later - end) / more, (longer - travel) / more, (after - level) / moved
                grows = of_travel * climb
                if grows < _STEEPEST:
                    missed = np.inf
                bow = of_end * curve / (1.0 + 2.0 * grows)
                slope = (of_end * (climb - curve * moved) - 2.0 * bow * travel) / (1.0 + grows)
                if abs(grows * steps) > _EVENLY:
                    steps = math.log1p(grows * steps) / grows
                bowed = of_travel * curve * moved**3 / (6.0 * travel * (travel + grows * moved))
                over = (moved / steps) ** 2 * lens(steps)
                added = (slope + bow * moved) * of_travel * curve * over
                owed += abs(stiff * of_end) * over / min(1.0, steps)
        ends = end - slope * travel
        missed += abs(stiff * (x - ends)) * min(1.0 / 6.0, steps**4 / 180.0)
        y[at] = ends + moved * (slope + moved * bow) + (x - ends) * math.exp(-steps - bowed) + added
    work[3][0], work[3][1] = missed, owed
    return after


@fused
def tends(i, y, t, acting, level, s, plant, rate):
    """What memory ``i`` tends to under ``level``, and over which travel: ``dx/d|q| = (end - x)/travel``.

    Read off its rate at one metre per second, at two places. Leaves ``y`` with another memory.
    """
    _, hooks, _, p, _, _ = plant
    hook, x_at, p_at = hooks[3 * i], hooks[3 * i + 1], hooks[3 * i + 2]
    y[x_at] = 0.0
    call_rate(hook, y[0], s, t, acting, y, x_at, p, p_at, plant[0], level, rate)
    first = rate[x_at]
    y[x_at] = -s
    call_rate(hook, y[0], s, t, acting, y, x_at, p, p_at, plant[0], level, rate)
    per = s * (rate[x_at] - first)
    return first / per, 1.0 / per


@fused
def stiffness(y, t, acting, level, s, plant, rate):
    """How much more the memories of ``y`` resist further on [N/m]: the force of their rates along the path.

    Leaves ``y`` with these.
    """
    _, hooks, starts, p, _, _ = plant
    for i in range(starts[RATE], starts[RATE + 1]):
        at = hooks[3 * i + 1]
        call_rate(hooks[3 * i], y[0], s, t, acting, y, at, p, hooks[3 * i + 2], plant[0], level, rate)
        y[at] = rate[at]
    return s * total(MEMORY, y, t, acting, plant)


@fused
def bent(first, second, third, level0, level1, level2):
    """Half the second derivative by travel [N/m^2] of a level that is known at three places of the path."""
    to, on = abs(second[0] - first[0]), abs(third[0] - second[0])
    if to == 0.0 or on == 0.0:
        return 0.0
    return ((level2 - level1) / on - (level1 - level0) / to) / (to + on)


@fused
def lens(steps):
    """Integral of x (steps - x) exp(-x) from 0 to ``steps``."""
    if steps < 0.1:
        return steps**3 * (1.0 / 6.0 - steps * (1.0 / 12.0 - steps * (1.0 / 40.0 - steps / 180.0)))
    return steps - 2.0 + math.exp(-steps) * (steps + 2.0)
