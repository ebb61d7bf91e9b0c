"""Carry the axis over a span of one command, from event to event.

Friction stays set-valued: motion has a direction ``s`` of +1 or -1 and at rest ``s = 0``. Velocity zeros, break-away
and guards end a step, so that no step crosses a kink; at a guard where a force jumps the steps shorten until one of
1e-13 s crosses it.
"""

from __future__ import annotations

import numpy as np

from emps_design.simulation.kernels.compile import fused
from emps_design.simulation.kernels.friction_period import BREAKAWAY, GUARDED, REVERSAL, STICK, note
from emps_design.simulation.kernels.motion import (
    CROSSING,
    FREE,
    GUARD,
    INSTANT,
    STATES,
    balance,
    clipped,
    derivative,
    held,
    locate,
    margin,
    step,
    turning,
)

DONE, DIVERGED, NO_STEP, CHATTER = range(4)  # what :func:`carry` can end with
_SHORTEST = 1e-12  # s, a step that must be shorter than this does not converge


@fused
def carry(y, t, span, tau, push, s, hint, plant, bounds, work, new, before, events, found):
    """Carry ``y`` over ``span`` seconds of one command; returns direction, next step, status, time done."""
    starts, settings = plant[2], plant[4]
    k1, k4, largest = work[0], work[3], work[6]
    n, free, guards, first = (
        int(settings[STATES]),
        settings[FREE] > 0.0,
        starts[GUARD + 1] - starts[GUARD],
        starts[GUARD],
    )
    done, happened, walked = 0.0, 0, 0.0
    if not free and y[1] == 0.0:  # the command has changed: at rest still?
        direction = held(y, clipped(t, bounds), tau, push, plant)
        if direction != s:
            note(events, found, t, STICK if direction == 0.0 else BREAKAWAY, y[0])
        s = direction
    while span - done > INSTANT:
        now = t + done
        rest = span - done
        if s == 0.0 and not free:  # whether friction holds is asked where a step ends: the force must not turn within
            rest = min(rest, turning(now, plant))
        at = clipped(now, bounds)
        h = rest
        start = y[1]
        for i in range(guards):
            before[i] = margin(2 + first + i, 1.0, y, at, tau, push, plant)
        if n == 2 and s == 0.0 and not free:
            new[0], new[1] = y[0], 0.0
            error = 0.0
            k1[0], k1[1] = 0.0, 0.0
        else:
            if hint < rest:
                h = rest / np.ceil(rest / hint)
            derivative(y, at, tau, push, s, plant, k1)
            error = step(y, now, h, tau, push, s, plant, bounds, work, new)
            if not error <= 1.0:
                crossed = 1.0
                for i in range(guards):  # a force may jump at a guard: walk up to it, and cross in the shortest step
                    after = margin(2 + first + i, 1.0, new, clipped(now + h, bounds), tau, push, plant)
                    if (after > 0.0) != (before[i] > 0.0):
                        crossed = min(crossed, 0.99 * abs(before[i]) / (abs(before[i]) + abs(after)))
                if crossed == 1.0:
                    hint = h * max(0.1, 0.9 / np.sqrt(np.sqrt(error)))
                    if not hint > _SHORTEST:
                        return s, hint, NO_STEP, done
                    continue
                if h > CROSSING:
                    if walked == 0.0:
                        walked = h
                    hint = max(h * max(crossed, 0.001), 0.5 * CROSSING)
                    continue
            # A dip through zero and back inside one step: acceleration turns while velocity is small.
            forward = s if not free else (1.0 if start > 0.0 else -1.0)
            if forward * k1[1] < 0.0 and forward * k4[1] > 0.0 and forward * new[1] > 0.0 and h > 1e-7:
                lowest = min(abs(start), abs(new[1]))
                if lowest < 0.25 * h * min(abs(k1[1]), abs(k4[1])):
                    hint = 0.5 * h
                    continue
        event = -1
        if s == 0.0 and not free:
            if margin(1, 1.0, new, clipped(now + h, bounds), tau, push, plant) < 0.0:
                event = 1
                h = locate(1, 1.0, y, now, h, tau, push, s, plant, bounds, work, new)
        else:
            sign = s if not free else (1.0 if start > 0.0 else (-1.0 if start < 0.0 else 0.0))
            if sign * new[1] < 0.0:
                event = 0
                h = locate(0, sign, y, now, h, tau, push, s, plant, bounds, work, new)
        for i in range(guards):
            sign = 1.0 if before[i] > 0.0 else -1.0
            if (margin(2 + first + i, 1.0, new, clipped(now + h, bounds), tau, push, plant) > 0.0) != (before[i] > 0.0):
                event = 2 + first + i
                if walked > 0.0:
                    hint, walked = walked, 0.0
                if h > CROSSING:
                    h = locate(event, sign, y, now, h, tau, push, s, plant, bounds, work, new)
        for i in range(n):
            y[i] = new[i]
            largest[i] = max(largest[i], abs(new[i]))
        done += h
        if event >= 0:
            happened += 1
            if happened > 2000:
                return s, hint, CHATTER, done
        if event == 0:
            y[1] = 0.0
            if free:
                note(events, found, t + done, REVERSAL, y[0])
        if (event == 0 or event == 1) and not free:
            direction = held(y, clipped(t + done, bounds), tau, push, plant)
            if event == 1 and direction == 0.0:  # rounding: the force has reached the limit all the same
                direction = 1.0 if balance(y, clipped(t + done, bounds), tau, push, 0.0, plant)[0] > 0.0 else -1.0
            kind = BREAKAWAY if event == 1 else (STICK if direction == 0.0 else REVERSAL)
            note(events, found, t + done, kind, y[0])
            s = direction
        elif event >= 2:
            note(events, found, t + done, GUARDED, y[0])
        elif error < 0.01:
            hint = max(hint, 2.0 * h)
        elif error < 0.5:
            hint = max(hint, h * 0.9 / np.sqrt(np.sqrt(error)))
        if not (abs(y[0]) < 1e3 and abs(y[1]) < 1e3):
            return s, hint, DIVERGED, done
    return s, hint, DONE, done
