"""Compiled co-manipulation: the friction plant under three laws, with an operator's hand.

One plant is one call, nothing is shared between plants: the numbers are the same for any number of workers.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from emps_design.comanipulation.period import (
    COULOMB_N,
    COULOMB_P,
    GAIN,
    LAG,
    LIMIT,
    MASS,
    PERIOD,
    RESOLUTION,
    VISCOUS_N,
    VISCOUS_P,
    response,
    step_with_events,
)

# Places in the law's array. For the cascade, L_MASS to L_STIFFNESS hold k_e1, k_v1, t_v, none.
(L_KIND, L_MASS, L_DAMPING, L_STIFFNESS, L_REST, L_MASS_HAT, L_VISCOUS_P, L_VISCOUS_N, L_COULOMB_P, L_COULOMB_N,
 L_KEEP_A, L_KEEP_TAU, L_CURRENT, L_BACKWARD, L_DELAY) = range(15)  # fmt: skip
SENSORLESS, SENSOR, CASCADE = 0.0, 1.0, 2.0
# Columns of the trace, one row a sample.
T_POSITION, T_VELOCITY, T_FORCE, T_EXTERNAL, T_VOLTAGE, T_ENCODER = range(6)
# Places in the measures of a run.
(P_PEAK_U, P_CLIPPED, P_CLIPPED_END, P_FLIPS, P_PEAK_FORCE, P_FORCE2, P_IMPULSE, P_WORK, P_PATH, P_MISS2, P_HELD,
 P_N, P_AA, P_AV, P_VV, P_AF, P_VF, P_FF, P_END_MIN_V, P_END_MAX_V, P_END_TURNS, P_END_MIN_U, P_END_MAX_U,
 P_DRIFT, P_RATIO, P_MOVING, P_END_SPEED, P_DIVERGED) = range(28)  # fmt: skip
MEASURES = 28

SWING = 50  # samples within which a voltage that was at one limit must be at the other to count as a flip


@njit(cache=True, nogil=True)
def run_plant(plant, law, reference, hand, release, end, trace, measures):
    """Run one plant under one law through a task; fill ``measures`` (MEASURES,) and, if it has rows, ``trace``.

    ``reference`` (n, 3): force added by the operator [N], where the hand wants to be [m], how fast [m/s]; ``hand``:
    its stiffness [N/m] and damping [N/(m/s)]; from sample ``release`` on the carriage is let go, and the samples from
    ``end`` on are those a verdict looks at.
    """
    n = len(reference)
    # Copies in registers: arrays that are written in the loop would be read back at every use.
    period, lag, limit, gain = plant[PERIOD], plant[LAG], plant[LIMIT], plant[GAIN]
    mass, resolution = plant[MASS], plant[RESOLUTION]
    per_step = 1.0 / resolution if resolution > 0.0 else 0.0
    force_limit = gain * limit
    fp, fn, cp, cn = plant[VISCOUS_P], plant[VISCOUS_N], plant[COULOMB_P], plant[COULOMB_N]
    pos, neg, out = np.empty(6), np.empty(6), np.empty(6)
    response(period, mass, fp, lag, pos)
    response(period, mass, fn, lag, neg)
    p0, p1, p2, p3, p4, p5 = pos[0], pos[1], pos[2], pos[3], pos[4], pos[5]
    n0, n1, n2, n3, n4, n5 = neg[0], neg[1], neg[2], neg[3], neg[4], neg[5]
    keep = math.exp(-period / lag) if lag > 0.0 else 0.0
    kind, delay, backward = law[L_KIND], int(law[L_DELAY]), law[L_BACKWARD] > 0.0
    mass_hat, ratio = law[L_MASS_HAT], law[L_MASS_HAT] / law[L_MASS]
    vhp, vhn, chp, chn = law[L_VISCOUS_P], law[L_VISCOUS_N], law[L_COULOMB_P], law[L_COULOMB_N]
    keep_a, keep_tau, current = law[L_KEEP_A], law[L_KEEP_TAU], law[L_CURRENT]
    pull, rest, damping = ratio * law[L_STIFFNESS], law[L_REST], ratio * law[L_DAMPING]
    hand_k, hand_b = hand[0], hand[1]
    per_speed, per_slope = 1.0 / period, 1.0 / (period * period)
    waiting = np.zeros(delay + 1)
    state = np.zeros(3)
    q = v = tau = 0.0
    free = np.empty(n - release + 1)  # positions after the release
    y1 = y2 = y3 = 0.0
    slow_a = slow_tau = integral = last_clip = 0.0
    peak_u = peak_force = force2 = impulse = work = path = miss2 = 0.0
    clipped = clipped_end = flips = turns_end = moving = clipped_at = 0
    aa = av = vv = af = vf = ff = end_speed = 0.0
    min_v = min_u = np.inf
    max_v = max_u = -np.inf
    stopped, finite = n, True
    for k in range(n):
        if not abs(v) < 1e6:
            finite = False
            break
        y = math.floor(q * per_step + 0.5) * resolution if resolution > 0.0 else q
        external = 0.0
        if k < release:
            external = reference[k, 0] + hand_k * (reference[k, 1] - q) + hand_b * (reference[k, 2] - v)
        if backward:
            speed = (y - y1) * per_speed
            slope = (y - 2.0 * y1 + y2) * per_slope
        else:
            speed = 0.5 * (y - y2) * per_speed
            slope = 0.5 * (y - y1 - y2 + y3) * per_slope
        y3, y2, y1 = y2, y1, y
        if kind == CASCADE:
            # L_MASS, L_DAMPING, L_STIFFNESS hold k_e1, k_v1, t_v; the integral stops where the voltage does.
            back = law[L_DAMPING] * speed
            integral += (law[L_MASS] * external - speed) * period * law[L_DAMPING] / law[L_STIFFNESS]
            integral = min(max(integral, back - limit), back + limit)
            command = gain * (integral - back)
        else:
            viscous = coulomb = 0.0
            if speed > 0.0:
                viscous, coulomb = vhp, chp
            elif speed < 0.0:
                viscous, coulomb = vhn, -chn
            if kind == SENSOR:
                observed = external
            else:
                slow_a = keep_a * slow_a + (1.0 - keep_a) * slope
                slow_tau = keep_tau * slow_tau + (1.0 - keep_tau) * tau
                observed = mass_hat * slow_a + viscous * speed + coulomb - current * slow_tau
            command = (ratio - 1.0) * observed + (viscous - damping) * speed + coulomb - pull * (y - rest)
        clip = 0.0
        if command > force_limit:
            command, clip = force_limit, 1.0
        elif command < -force_limit:
            command, clip = -force_limit, -1.0
        u = command / gain
        if delay:
            for i in range(delay, 0, -1):
                waiting[i] = waiting[i - 1]
            waiting[0] = command
            command = waiting[delay]

        if len(trace):
            trace[k, T_POSITION], trace[k, T_VELOCITY], trace[k, T_FORCE] = q, v, tau
            trace[k, T_EXTERNAL], trace[k, T_VOLTAGE], trace[k, T_ENCODER] = external, u, y

        # One period. The closed form holds where the velocity keeps its sign all the way: it ends with it, and the
        # smallest force on the way cannot take it to zero and back. Every other period is followed event by event.
        slides = False
        q0, v0 = q, v
        d = (tau if lag > 0.0 else command) - command
        if v0 > 0.0:
            f = command + external - cp
            v = p0 * v0 + p1 * d + p2 * f
            if v > 0.0 and mass * v0 + period * (f + min(d, d * keep) - fp * max(v0, v)) > 0.0:
                slides = True
                q = q0 + p3 * v0 + p4 * d + p5 * f
                tau = command + d * keep
        elif v0 < 0.0:
            f = command + external + cn
            v = n0 * v0 + n1 * d + n2 * f
            if v < 0.0 and mass * v0 + period * (f + max(d, d * keep) - fn * min(v0, v)) < 0.0:
                slides = True
                q = q0 + n3 * v0 + n4 * d + n5 * f
                tau = command + d * keep
        if not slides:
            state[0], state[1], state[2] = q0, v0, tau
            step_with_events(state, command, external, plant, out)
            q, v, tau = state[0], state[1], state[2]

        moved = q - q0
        peak_u = max(peak_u, abs(u))
        if clip != 0.0:
            clipped += 1
            clipped_end += k >= end
            flips += clip * last_clip < 0.0 and k - clipped_at <= SWING
            last_clip, clipped_at = clip, k
        if k < release:
            peak_force = max(peak_force, abs(external))
            force2 += external * external
            impulse += abs(external) * period
            work += external * moved
            path += abs(moved)
            miss2 += (reference[k, 1] - q0) ** 2
            if v0 * v > 0.0:  # in motion; means over the period for which the force is held
                a, w = (v - v0) * per_speed, moved * per_speed
                moving += 1
                aa += a * a
                av += a * w
                vv += w * w
                af += a * external
                vf += w * external
                ff += external * external
        else:
            free[k - release] = q0
            if v == 0.0 and stopped == n:
                stopped = k + 1
        if k >= end:
            min_v, max_v = min(min_v, v), max(max_v, v)
            min_u, max_u = min(min_u, u), max(max_u, u)
            turns_end += v0 * v < 0.0 or (v0 != 0.0 and v == 0.0)
            end_speed += moved

    measures[P_PEAK_U], measures[P_PEAK_FORCE] = peak_u, peak_force
    measures[P_CLIPPED], measures[P_CLIPPED_END], measures[P_FLIPS] = clipped, clipped_end, flips
    measures[P_FORCE2], measures[P_IMPULSE], measures[P_WORK] = force2, impulse, work
    measures[P_PATH], measures[P_MISS2], measures[P_HELD], measures[P_N] = path, miss2, release, moving
    measures[P_AA], measures[P_AV], measures[P_VV] = aa, av, vv
    measures[P_AF], measures[P_VF], measures[P_FF] = af, vf, ff
    measures[P_END_MIN_V], measures[P_END_MAX_V], measures[P_END_TURNS] = min_v, max_v, turns_end
    measures[P_END_MIN_U], measures[P_END_MAX_U] = min_u, max_u
    measures[P_DRIFT] = measures[P_RATIO] = measures[P_MOVING] = 0.0
    measures[P_END_SPEED] = end_speed / (period * max(n - end, 1))
    measures[P_DIVERGED] = 0.0 if finite else 1.0
    if finite:
        free[n - release] = q
        drift(free, min(stopped, n) - release, period, measures)


@njit(cache=True, nogil=True)
def drift(free, moving, period, measures):
    """Speed that the free motion tends to, from its steps over three equal spans (Aitken: exact for one decay).

    The first tenth is left out (filters settle). A negative product with the direction of motion means that dry
    friction stops the carriage in finite time.
    """
    measures[P_MOVING] = moving
    skip = moving // 10
    span = (moving - skip) // 3
    if span < 1:
        measures[P_RATIO] = np.nan
        measures[P_DRIFT] = 0.0
        return
    v1 = (free[skip + span] - free[skip]) / (span * period)
    v2 = (free[skip + 2 * span] - free[skip + span]) / (span * period)
    v3 = (free[skip + 3 * span] - free[skip + 2 * span]) / (span * period)
    side = 1.0 if v1 >= 0.0 else -1.0
    first, second = v2 - v1, v3 - v2
    bend = second - first
    measures[P_RATIO] = second / first if first != 0.0 else 0.0
    if abs(bend) > 1e-12 * (abs(v1) + abs(v3)):
        measures[P_DRIFT] = side * (v3 - second * second / bend)
    else:
        measures[P_DRIFT] = side * v3


@njit(cache=True, nogil=True)
def run_block(plants, laws, reference, hand, release, end, measures):
    """Run plants (m, 10) under laws (m, 15) through one task; fill ``measures`` (m, MEASURES)."""
    none = np.empty((0, 6))
    for i in range(len(plants)):
        run_plant(plants[i], laws[i], reference, hand, release, end, none, measures[i])
