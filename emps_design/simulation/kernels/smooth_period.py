"""Slide through a whole hold period with one or two evaluations of the forces.

The effects may have no own states other than memories of the path, which change with travel alone. A memory x obeys
``dx/d|q| = (end - x)/travel``, where both depend on the level of the dry friction: a contact that deflects before it
slides (Dahl) tends to the deflection that carries the whole friction. The solution is exact, however short the travel.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.compile import call_kernel, call_rate, fused, fused_inlined, shifted
from emps_design.simulation.kernels.motion import (
    BEHIND,
    BRAKING,
    DRY,
    FREE,
    LAG,
    MEMORY,
    OWN,
    RATE,
    STATES,
    TOLERANCE,
    balance,
    dry,
    motor,
    pull,
    total,
    weigh,
)

_EVENLY = 1e-6  # relative change of a level or a travel that counts as zero
_STEEPEST = -0.3  # least slope of the travel of a memory along the path

ORDER = 3  # of convergence, measured in the tests
# Tolerances of a step: second difference of the acceleration times step squared [m], and velocity error [m/s].
_BEND, _MISSED = 6e-9, 3e-10
_UNSTOPPED = 0.3  # of these tolerances for a motion without stops, where errors accumulate
_EVEN = 1e-9  # m/s^2, error of the predicted acceleration in mid-step below which one evaluation is enough
# A parabola of time goes through the accelerations in the middle of three steps. Its prediction for the end of the
# third is corrected, per m/s^2 of error in mid-step, by these amounts of position, velocity, acceleration and slope, in
# units of the step (Nordsieck's form of a multistep method).
_TO_PLACE, _TO_SPEED, _TO_END, _TO_SLOPE = 19.0 / 48.0, 25.0 / 24.0, 15.0 / 8.0, 2.0
_AGAIN = 10.0  # weight of an error that repeats in every step, against one that occurs once
_CUBIC = 15.0  # ratio of the change of the curve from step to step to the error of a parabola
SPEEDS = 20  # octaves of speed, up to 5 m/s


@fused
def remember(before, y, t, acting, level, curve, s, plant, work):
    """Advance the memories from the state ``before`` to the place of ``y``; returns the friction level there [N].

    ``level`` is the dry friction ``before``. In between it is a parabola of the travel with half second derivative
    ``curve``, and so are the end value and the travel constant of a memory (:func:`tends`; if the level never changes
    ``work[2]`` and ``work[4]`` hold them). For a linear travel constant one solution is a parabola, and any other
    approaches it by ``exp(-integral d|q|/travel)``; the curvature of the constant is added to first order. ``work[3]``
    gets two numbers: the error of the force by Simpson's rule over twice the step [N], and the sensitivity of the
    remembered force to ``curve`` [N per N/m^2].
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
    """Return end value and travel constant of memory ``i`` under ``level``: ``dx/d|q| = (end - x)/travel``.

    They follow from its rate at 1 m/s for two values of the memory. Changes the memory in ``y``.
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
def settle(y, t, tau, plant, work):
    """Set every memory to its end value if it is within a tenth of the tolerance of a step of it.

    It then stays there under a constant level. Close to it, stability would limit an explicit step to a few travel
    constants, which at high speed is a thousandth of a period.
    """
    hooks, starts, settings, rate, s = plant[1], plant[2], plant[4], work[3], math.copysign(1.0, y[1])
    acting = motor(t, tau, plant) - settings[BRAKING] * y[1]
    level = dry(y, t, acting, plant)
    for k in range(starts[MEMORY], starts[MEMORY + 1]):
        for i in range(starts[RATE], starts[RATE + 1]):
            at = hooks[3 * i + 1]
            if at == hooks[3 * k + 1]:
                x = y[at]
                end = tends(i, y, t, acting, level, s, plant, rate)[0]
                y[at] = end if abs(end - x) <= 0.1 * OWN * settings[TOLERANCE] * abs(end) else x


@fused
def stiffness(y, t, acting, level, s, plant, rate):
    """Stiffness of the memories along the path [N/m]: the force of their rates. Replaces the memories in ``y``."""
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


@fused
def begin(y, t, tau, push, s, steady, plant, work):
    """Evaluate the forces at the start of a first slide into ``work``; returns whether a slide is possible.

    Not ``steady``: friction may depend on the motor force, and so on the remaining gap of a lag. A slide is possible if
    the acceleration is linear in that gap.
    """
    drive, settings, starts = plant[5], plant[4], plant[2]
    rub = 0.0 if settings[FREE] > 0.0 else s
    net, level, mobility = weigh(y, t, tau + (drive[0] + drive[5]), push, s, plant)
    whole = (net - rub * level) * mobility
    work[0][0], work[0][1], work[1][0], work[1][1] = 0.0, whole, mobility, mobility
    work[2][0], work[2][1], work[4][0] = level, 0.0, 0.0
    for i in range(starts[RATE], starts[RATE + 1]):
        at = plant[1][3 * i + 1]
        work[2][at], work[4][at] = tends(i, work[5], t, tau, level, s, plant, work[3])
    if steady or drive[0] == 0.0:
        return True
    net, level, mobility = weigh(y, t, tau + 0.5 * drive[0], push, s, plant)
    half = (net - rub * level) * mobility
    net, level, mobility = weigh(y, t, tau, push, s, plant)
    none = (net - rub * level) * mobility
    work[1][0] = (whole - none) / drive[0]
    return settings[LAG] * abs(whole - 2.0 * half + none) <= _MISSED * settings[TOLERANCE]


@fused_inlined
def slide(y, t, h, tau, push, s, feel, plant, work, new):
    """Slide through ``h`` with one evaluation, two or a few more; returns whether the step is accepted.

    Simpson's rule over the acceleration at both ends and in the middle (Lobatto IIIA), for axes without guards, without
    own states other than memories of the path, and without kernels that jump in time. ``work[0][1]`` is the
    acceleration at the start, known from the end of the last step; ``work[0][0]`` its slope there without viscous decay
    (0: not known) and ``work[4][0]`` the slope of that; ``work[1]`` the acceleration per newton of the gap of a lag,
    and the mobility (see :func:`begin`); ``work[2]`` the level of the dry friction and its curve along the path (see
    :func:`remember`). ``feel`` holds the derivative of the acceleration by velocity (see :func:`feeling`). Errors of
    the velocity are corrected by it, errors of the position by the stiffness of the memories; the sweep is repeated
    until the remaining error is below the tolerance. If the acceleration in mid-step is that predicted from the last
    steps, within the tolerance, that one evaluation is enough. If its second difference is large, the step is too long
    and the general method takes over.
    """
    stage, settings, half = work[5], plant[4], t + 0.5 * h
    tolerance, bend_most, rub = settings[TOLERANCE], _BEND, s
    if settings[FREE] > 0.0:  # without stops errors accumulate
        tolerance, bend_most, rub = _UNSTOPPED * tolerance, _UNSTOPPED * _BEND, 0.0
    remembers, level0, curve, off, rough = settings[STATES] > 2.0, work[2][0], work[2][1], 0.0, 0.0
    decay = plant[0][1] * work[1][1]
    # The decaying gap of the motor force adds known amounts to acceleration, velocity and position.
    drive, lag = plant[5], settings[LAG]
    gap = drive[0] * work[1][0]
    if lag > 0.0 and drive[2] != h:  # the same for every period of one length
        drive[2], drive[3], drive[4] = h, -math.expm1(-0.5 * h / lag), -math.expm1(-h / lag)
    half_a, half_v, half_q = fading(gap, lag, decay, 0.5 * h, drive[3])
    full_a, full_v, full_q = fading(gap, lag, decay, h, drive[4])
    inside, last = tau + drive[0] * (1.0 - drive[3]), tau + drive[0] * (1.0 - drive[4])
    a0 = work[0][1] - gap
    behind = settings[BEHIND]
    if behind > 0.0:
        gap, gone = drive[5] * work[1][0], -math.expm1(-0.5 * h / behind)
        drive[6] = -math.expm1(-h / behind)
        more_a, more_v, more_q = fading(gap, behind, decay, 0.5 * h, gone)
        half_a, half_v, half_q = half_a + more_a, half_v + more_v, half_q + more_q
        more_a, more_v, more_q = fading(gap, behind, decay, h, drive[6])
        full_a, full_v, full_q = full_a + more_a, full_v + more_v, full_q + more_q
        inside, last, a0 = inside + drive[5] * (1.0 - gone), last + drive[5] * (1.0 - drive[6]), a0 - gap
    slope = work[0][0] - decay * a0
    bow = work[4][0] - decay * slope
    per, fades = 1.0 / h, h * decay
    stage[0] = y[0] + half_q + 0.5 * h * (y[1] + 0.25 * h * (a0 + h / 6.0 * slope))
    # The same with the second slope, and a0 last: it depends on the command, and everything after depends on it.
    known = y[1] + half_v + 0.125 * h * h * (work[0][0] + h / 6.0 * (work[4][0] - decay * work[0][0]))
    stage[1] = known + 0.5 * h * (1.0 - 0.25 * fades * (1.0 - fades / 6.0)) * a0
    end, level1, level2 = 0.0, level0, level0
    for sweep in range(4):
        if s * stage[1] <= 0.0:
            return False
        if remembers:
            level = level1 = remember(y, stage, half, inside, level0, curve, s, plant, work)
            if h * work[3][0] * work[1][1] > _MISSED * settings[TOLERANCE]:
                return False
            net, mobility = pull(stage, half, inside - settings[BRAKING] * stage[1], push, plant)
        else:
            net, level, mobility = weigh(stage, half, inside, push, s, plant)
        middle = (net - rub * level) * mobility - half_a
        if sweep == 0:
            more = middle - (a0 + 0.5 * h * (slope + 0.25 * h * bow))
            if work[0][0] != 0.0 and abs(more) <= _EVEN * tolerance:
                place = y[0] + full_q + h * (y[1] + 0.5 * h * (a0 + h / 3.0 * (slope + 0.25 * h * bow)))
                speed = y[1] + full_v + h * (a0 + 0.5 * h * (slope + h / 3.0 * bow))
                new[0] = place + _TO_PLACE * h * h * more
                new[1] = speed + _TO_SPEED * h * more
                end = a0 + h * (slope + 0.5 * h * bow) + _TO_END * more
                slope += h * bow + _TO_SLOPE * per * more
                bow += per * per * more
                work[4][0] = bow + decay * slope
                work[0][0] = slope + decay * end
                work[0][1] = end + full_a
                if remembers:
                    level2 = remember(stage, new, t + h, last, level1, curve, s, plant, work)
                    work[2][0], work[2][1] = level2, bent(y, stage, new, level0, level1, level2)
                return s * new[1] > 0.0
            end = 2.0 * middle - a0
        new[0] = y[0] + full_q + h * (y[1] + h / 6.0 * (a0 + 2.0 * middle))
        new[1] = y[1] + full_v + h / 6.0 * (a0 + 4.0 * middle + end)
        if s * new[1] <= 0.0:
            return False
        used = end
        if remembers:
            level = level2 = remember(stage, new, t + h, last, level1, curve, s, plant, work)
            net, mobility = pull(new, t + h, last - settings[BRAKING] * new[1], push, plant)
        else:
            net, level, mobility = weigh(new, t + h, last, push, s, plant)
        end = (net - rub * level) * mobility - full_a
        if abs(a0 - 2.0 * middle + end) * h * h > bend_most * tolerance:
            return False
        moved = h / 6.0 * (end - used)
        new[1] += moved
        missed = y[1] + half_v + h / 24.0 * (5.0 * a0 + 8.0 * middle - end) - stage[1]
        place = y[0] + half_q + h * (0.5 * y[1] + h / 96.0 * (7.0 * a0 + 6.0 * middle - end))
        if remembers:
            stiff = stiffness(stage, half, inside, level1, s, plant, work[3]) * mobility
            off = -4.0 * stiff * (place - stage[0])
            # The motion due to the gap of a lag is no polynomial of time, nor is the force that it causes.
            late = stiff * half_q * min(0.25, (h / lag) ** 4 / 2880.0) if lag > 0.0 else 0.0
            swings = h * h * stiff
            rough = swings * abs(off) + _AGAIN * (4.0 * abs(late) + swings * swings / 480.0 * max(abs(a0), abs(middle)))
            if rub == 0.0:
                curved = bent(y, stage, new, level0, level1, level2)
                weight = work[3][1] * mobility
                if h * abs(curved - work[2][1]) * weight > _CUBIC * _MISSED * tolerance:
                    return False
                rough += _AGAIN * abs(curved - curve) * weight
                curve = curved
        i = 2 * min(max(math.frexp(1e5 * y[1])[1], 0), SPEEDS - 1) + (2 * SPEEDS if s > 0.0 else 0)
        if h * (feel[i + 1] * (4.0 * abs(missed) + abs(moved)) + abs(rough)) <= 6.0 * _MISSED * tolerance:
            new[1] += h / 6.0 * (feel[i] * (4.0 * missed + moved) + off)
            slope = per * (a0 - 4.0 * middle + 3.0 * end)
            work[4][0] = 4.0 * per * per * (a0 - 2.0 * middle + end) + decay * slope
            work[0][0] = slope + decay * end
            work[0][1] = end + full_a
            work[2][0], work[2][1] = level2, curve
            return s * new[1] > 0.0
        stage[0] = place
        stage[1] += missed
    return False


@fused
def fading(gap, lag, decay, h, gone):
    """Acceleration, velocity and position after ``h`` due to a force that decays with ``lag``, under viscous ``decay``.

    ``gap`` [m/s^2] is its initial acceleration, ``gone`` = 1 - exp(-h/lag).
    """
    if gap == 0.0:
        return 0.0, 0.0, 0.0
    v = gap * lag * gone
    q = lag * (gap * h - v)
    return gap * (1.0 - gone) - decay * v, v - decay * q, q - decay * lag * (0.5 * gap * h * h - q)


@fused
def feeling(y, plant, work, feel):
    """Fill ``feel``, per direction and octave of speed from 10 um/s, with two numbers [1/s].

    They are the derivative of the acceleration by velocity (at the first position and time), and a bound of its error:
    a quarter of the largest derivative in this and the neighbouring octaves; all of it if a contact has to deflect
    before friction follows the velocity.
    """
    stage, settings = work[5], plant[4]
    unexplained = 1.0 if settings[FREE] > 0.0 else 0.25
    stage[0] = y[0]
    for i in range(2, int(settings[STATES])):
        stage[i] = 0.0
    for side in range(2):
        sign = 2.0 * side - 1.0
        row = shifted(feel, 2 * SPEEDS * side)
        stage[1] = sign * 0.5e-5
        net, level, mobility = balance(stage, 0.0, 0.0, 0.0, sign, plant)
        last, speed = (net - sign * level) * mobility, stage[1]
        for i in range(SPEEDS):
            stage[1] = sign * 1e-5 * 2.0**i
            net, level, mobility = balance(stage, 0.0, 0.0, 0.0, sign, plant)
            value = (net - sign * level) * mobility
            row[2 * i] = (value - last) / (stage[1] - speed)
            last, speed = value, stage[1]
        for i in range(SPEEDS):
            before, after = row[2 * max(i - 1, 0)], row[2 * min(i + 1, SPEEDS - 1)]
            row[2 * i + 1] = unexplained * max(abs(row[2 * i]), max(abs(before), abs(after)))
