"""Run an axis with any effects: sample, control, hold, and step it through every hold period.

A period is cut where a delayed voltage arrives and where a kernel jumps in time. Each piece is solved by the first
method that applies: exactly if no effect changes the friction plant (:mod:`friction_period`); exactly if the effects
are affine in the motion, by pieces, perhaps with additional smooth forces (:mod:`linear_period`); in one slide if they
have no own states but memories of the path and nothing jumps (:mod:`smooth_period`); or from event to event
(:func:`carry`).

Friction is set-valued: motion has a direction ``s`` of +1 or -1, and at rest ``s = 0``. Velocity zeros, break-away and
guards end a step, so that no step crosses a kink; at a guard where a force jumps the steps get shorter until one of
1e-13 s crosses it.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.baseline import SWINGS, swing
from emps_design.simulation.kernels.compile import (
    cached,
    call_actuator,
    call_kernel,
    call_law,
    fused,
    part,
    pointer,
    shifted,
)
from emps_design.simulation.kernels.friction_period import (
    BREAKAWAY,
    GUARDED,
    REVERSAL,
    STICK,
    advance,
    follow,
    note,
    response,
)
from emps_design.simulation.kernels.linear_period import (
    MORE,
    OTHERS,
    PIECES,
    flow,
    learn,
    others_at,
    room_of_one,
    solve_all,
)
from emps_design.simulation.kernels.motion import (
    ACTUATOR,
    BEHIND,
    BRAKING,
    COMMAND,
    CROSSING,
    DELAY,
    DELAYED,
    DRIVE,
    ERROR_ALONE,
    EXACT,
    FARTHEST,
    FREE,
    GAIN,
    GUARD,
    HELD,
    INERTIA,
    INSTANT,
    JUMP,
    LAG,
    LIMIT,
    LINEAR,
    MEMORY,
    MOBILITY,
    PERIOD,
    RESOLUTION,
    SENSOR,
    SLIDES,
    STATES,
    TOUCH,
    TOUCH_MASS,
    WAITS,
    balance,
    clipped,
    derivative,
    encoded,
    friction_of,
    held,
    locate,
    margin,
    motor,
    step,
    total,
    turning,
)
from emps_design.simulation.kernels.smooth_period import SPEEDS, begin, feeling, settle, slide
from emps_design.units import Units

DONE, DIVERGED, NO_STEP, CHATTER = range(4)  # status of :func:`carry`
_SHORTEST = 1e-12  # s, a step that must be shorter than this does not converge

RUNAWAY, MASSLESS = 4, 5  # further status of a run
_APART = 5e-10  # s, how far from a jump in time its two sides are evaluated; above SNAP of the effects


def reason_of(status: int, units: Units) -> str:
    """The reason why a run ended with ``status``, in the units of its axis."""
    place, speed = (units.quantity(units.farthest, unit) for unit in ("m", "m/s"))
    return {
        DIVERGED: f"the motion is unbounded (beyond {place} or {speed}, or not a number)",
        NO_STEP: "no step is short enough for the tolerance",
        CHATTER: "more than 2000 events in one sampling period",
        MASSLESS: f"the effects leave no {units.word('mass')} on the encoder's side",
        RUNAWAY: f"the loop is unstable: the {units.word('voltage')} has swung from limit to limit 40 times, each "
        "within 0.2 s",
    }[status]


@fused
def carry(y, t, span, tau, push, s, hint, plant, bounds, work, new, before, events, tally):
    """Carry ``y`` over ``span`` seconds of one command; returns direction, next step, status, time done."""
    starts, settings = plant[2], plant[4]
    k1, k4, largest = work[0], work[3], work[6]
    n, free, guards, first = (
        int(settings[STATES]),
        settings[FREE] > 0.0,
        starts[GUARD + 1] - starts[GUARD],
        starts[GUARD],
    )
    done, happened, walked, remembers = 0.0, 0, 0.0, starts[MEMORY + 1] > starts[MEMORY]
    if not free and y[1] == 0.0:  # the command has changed: at rest still?
        direction = held(y, clipped(t, bounds), tau, push, plant)
        if direction != s:
            note(events, tally, t, STICK if direction == 0.0 else BREAKAWAY, y[0])
        s = direction
    while span - done > INSTANT:
        now = t + done
        rest = span - done
        if s == 0.0 and not free:  # friction is checked at the end of a step: the force must not turn within it
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
        if remembers and y[1] != 0.0:
            settle(y, clipped(t + done, bounds), tau, plant, work)
        if event >= 0:
            happened += 1
            if happened > 2000:
                return s, hint, CHATTER, done
        if event == 0:
            y[1] = 0.0
            if free:
                note(events, tally, t + done, REVERSAL, y[0])
        if (event == 0 or event == 1) and not free:
            direction = held(y, clipped(t + done, bounds), tau, push, plant)
            if event == 1 and direction == 0.0:  # rounding: the force has reached the limit all the same
                direction = 1.0 if balance(y, clipped(t + done, bounds), tau, push, 0.0, plant)[0] > 0.0 else -1.0
            kind = BREAKAWAY if event == 1 else (STICK if direction == 0.0 else REVERSAL)
            note(events, tally, t + done, kind, y[0])
            s = direction
        elif event >= 2:
            note(events, tally, t + done, GUARDED, y[0])
        elif error < 0.01:
            hint = max(hint, 2.0 * h)
        elif error < 0.5:
            hint = max(hint, h * 0.9 / np.sqrt(np.sqrt(error)))
        if not (abs(y[0]) < settings[FARTHEST] and abs(y[1]) < settings[FARTHEST]):
            return s, hint, DIVERGED, done
    return s, hint, DONE, done


@part
def applied(j, u, plant):
    """Motor force commanded by the voltage of sample ``j``, through the actuator's static maps; 0 before the first."""
    _, hooks, starts, p, settings, _ = plant
    if j < 0:
        return 0.0
    volts = u[j]
    for i in range(starts[ACTUATOR], starts[ACTUATOR + 1]):
        volts = call_actuator(hooks[3 * i], volts, p, hooks[3 * i + 2])
    return settings[GAIN] * volts


@cached()
def run(
    arrays, y, law, gains, memory, reference, push, noise, motor_rows, signals, slots, floors, scratch, out, events,
    tally,
):  # fmt: skip
    """Run the loop over ``reference.size`` samples; returns the status, the sample, and the time within its period [s].

    ``arrays`` = (baseline, table of hooks, start of each row of the table, parameters, settings); ``law`` is the
    address of the controller, 0: the reference is the voltage; ``gains`` have one row, or one a sample. ``push`` [N]
    and ``noise`` [V] are empty or one value a sample, ``motor_rows`` empty or a row a sample of the motor's gain and
    the braking of its back-EMF; column i of ``signals`` is written to ``p[slots[i]]`` at every sample. ``floors`` are
    the absolute tolerances of the own states. ``out`` has a row each for encoder, position, velocity,
    voltage and external force, ``events`` three columns; both are filled. ``tally`` = (events so far, room for them).
    ``scratch`` has room for :func:`room` numbers.
    """
    # Pointers from here on: arrays in tuples would be counted, at ten times the cost of the arithmetic.
    drive = pointer(scratch)  # gap of motor force and command, its time, factors of a slide; the same of a second lag
    plant = (
        pointer(arrays[0]), pointer(arrays[1]), pointer(arrays[2]), pointer(arrays[3]), pointer(arrays[4]), drive
    )  # fmt: skip
    _, hooks, starts, p, settings, _ = plant
    n, size = reference.size, y.size
    y_, gains_, memory_, events_, tally_ = pointer(y), pointer(gains), pointer(memory), pointer(events), pointer(tally)
    bounds, free_row = shifted(drive, DRIVE), shifted(drive, DRIVE)
    k1, k2, k3 = shifted(free_row, 2), shifted(free_row, 2 + size), shifted(free_row, 2 + 2 * size)
    k4, k5, stage = shifted(k3, size), shifted(k3, 2 * size), shifted(k3, 3 * size)
    largest, new, before = shifted(stage, size), shifted(stage, 2 * size), shifted(stage, 3 * size)
    work = (k1, k2, k3, k4, k5, stage, largest)
    for i in range(size):
        largest[i] = max(abs(y[i]), floors[i])
    encoder = pointer(out)
    position, velocity, u, outside = (
        shifted(encoder, n), shifted(encoder, 2 * n), shifted(encoder, 3 * n), shifted(encoder, 4 * n),
    )  # fmt: skip
    varies = motor_rows.shape[0] > 0
    stride = gains.shape[1] if gains.shape[0] > 1 else 0
    period, limit, resolution = settings[PERIOD], settings[LIMIT], settings[RESOLUTION]
    jumps, late = starts[JUMP + 1] > starts[JUMP], starts[DELAY + 1] > starts[DELAY]
    touched, weighs = starts[TOUCH + 1] > starts[TOUCH], starts[TOUCH_MASS + 1] > starts[TOUCH_MASS]
    holds, senses = starts[HELD + 1] > starts[HELD], starts[SENSOR + 1] > starts[SENSOR]
    commands, waits = starts[COMMAND + 1] > starts[COMMAND], int(settings[DELAYED])
    variable_mass = starts[INERTIA + 1] > starts[INERTIA]
    bounds[0], bounds[1] = -np.inf, np.inf
    error_alone = settings[ERROR_ALONE] > 0.0
    slides, steady = settings[SLIDES] > 0.0, settings[SLIDES] > 1.0
    exact, lagged = settings[EXACT] > 0.0, settings[LAG] > 0.0
    # Two lags in series are a weighted sum of both: the partial fractions of 1/((1 + T s)(1 + T' s)).
    twice, share = settings[BEHIND] > 0.0, 1.0
    if twice:
        share = settings[LAG] / (settings[LAG] - settings[BEHIND])
    feel = shifted(before, starts[GUARD + 1] - starts[GUARD])
    if slides:
        feeling(y_, plant, work, feel)
    friction = friction_of(plant[0], settings)
    forward = response(period, friction[0], friction[1], friction[5])
    backward = response(period, friction[0], friction[2], friction[5])
    others = shifted(feel, 4 * SPEEDS)
    solutions = shifted(others, OTHERS)
    linear, forced = settings[LINEAR] > 0.0, settings[LINEAR] > 1.0
    others[0] = 0.0
    spare = shifted(solutions, 2 * PIECES * room_of_one(size))
    if linear:
        solve_all(period, plant, work, solutions, spare)
    fresh, before_force = False, 0.0
    tau, reached, other, s, hint = 0.0, 0.0, 0.0, 0.0, period
    for i in range(DRIVE):
        drive[i] = 0.0
    swings = (0.0, 0.0, 0.0)
    free = settings[FREE] > 0.0
    if y[1] != 0.0 and not free:  # without stick there is no direction to keep
        s = 1.0 if y[1] > 0.0 else -1.0
    for k in range(n):
        t = k * period
        for i in range(slots.size):
            p[slots[i]] = signals[k, i]
        if varies:
            settings[GAIN], settings[BRAKING] = motor_rows[k, 0], motor_rows[k, 1]
        position[k], velocity[k] = y[0], y[1]
        measured = y[0] + total(SENSOR, y_, t, tau, plant) if senses else y[0]
        if resolution > 0.0:
            if not abs(measured) < np.inf:  # a separate return, so that an exact encoder needs no division
                return DIVERGED, k, 0.0
            measured = encoded(measured, resolution)
        encoder[k] = measured
        force = push[k] if push.size else 0.0
        if holds:
            force -= total(HELD, y_, t, tau, plant)
        if variable_mass or k == 0:
            mobility = balance(y_, t, tau, force, s, plant)[2]
            if not 0.0 < mobility < np.inf:
                return MASSLESS, k, 0.0
            if linear and mobility != settings[MOBILITY]:
                settings[MOBILITY] = mobility
                solve_all(period, plant, work, solutions, spare)
        felt = force
        if touched:
            felt -= total(TOUCH, y_, t, tau, plant)
            if weighs:
                derivative(y_, t, tau, force, s, plant, k1)
                felt -= k1[1] * total(TOUCH_MASS, y_, t, tau, plant)
        outside[k] = felt
        if law != 0:
            feedback, setpoint = measured, reference[k]
            if error_alone:
                feedback, setpoint = measured - setpoint, 0.0
            waiting, integral = int(settings[WAITS]), 0.0
            if waiting > 0:
                integral = memory_[waiting - 1]
            volts = call_law(law, k, setpoint, feedback, felt, limit, shifted(gains_, k * stride), memory_)
        else:
            volts = reference[k]
        if commands:
            volts += total(COMMAND, y_, t, tau, plant)
        if noise.size:
            volts += noise[k]
        if not abs(volts) < np.inf:
            return DIVERGED, k, 0.0
        if abs(volts) >= limit:
            beyond = abs(volts) > limit
            volts = limit if volts > 0.0 else -limit
            if law != 0:
                if waiting > 0 and beyond:  # the limit acts on law and feed-forward together
                    memory_[waiting - 1] = integral
                swings = swing(volts, k, period, swings)
                if swings[1] >= SWINGS:
                    return RUNAWAY, k, 0.0
        u[k] = volts

        whole, first = waits, 0.0
        if late:
            wait = whole * period + max(0.0, total(DELAY, y_, t, tau, plant))
            whole = int(np.floor(wait / period + 1e-9))
            first = wait - whole * period
            if first < 1e-12:
                first = 0.0
        start = 0.0
        while period - start > INSTANT:
            end = period
            if start < first:
                end = first
                tau = applied(k - whole - 1, u, plant)
            else:
                tau = applied(k - whole, u, plant)
            if jumps:
                bounds[0], bounds[1] = t + start + _APART, np.inf
                for i in range(starts[JUMP], starts[JUMP + 1]):
                    x_at, p_at = hooks[3 * i + 1], hooks[3 * i + 2]
                    after = call_kernel(hooks[3 * i], y[0], y[1], bounds[0], tau, y_, x_at, p, p_at, plant[0]) - t
                    if after <= end:
                        end = max(after, start + 2.0 * _APART)
                        bounds[1] = t + end - _APART
            h = end - start
            if exact:
                if h == period:
                    y[0], y[1], reached = advance(
                        y[0], y[1], reached, tau, force, h, forward, backward, friction, t, events_, tally_
                    )
                else:
                    y[0], y[1], reached = follow(
                        y[0], y[1], reached, tau, force, h, friction, t + start, events_, tally_
                    )
                if not (abs(y[0]) < settings[FARTHEST] and abs(y[1]) < settings[FARTHEST]):
                    return DIVERGED, k, start
                start = end
                continue
            if lagged:
                drive[0], drive[1] = reached - share * tau, t + start
            if twice:
                drive[5] = other - (1.0 - share) * tau
            whole_period = h == period and bounds[1] == np.inf
            if (
                linear
                and whole_period
                and s * y[1] > 0.0
                and flow(y_, t, h, tau, force, s, plant, work, solutions, others, new)
            ):
                for i in range(size):
                    y[i] = new[i]
                reached, fresh, start = tau + drive[0], False, end
                continue
            direction = s if not free else 1.0 if y[1] > 0.0 else -1.0
            if slides and direction * y[1] > 0.0 and bounds[1] == np.inf:
                if fresh and steady:
                    k1[1] += (tau + (drive[0] + drive[5]) + (force - before_force)) * k2[1]
                else:
                    fresh = begin(y_, t + start, tau, force, direction, steady, plant, work)
                fresh = fresh and slide(y_, t + start, h, tau, force, direction, feel, plant, work, new)
                if fresh:
                    y[0], y[1] = new[0], new[1]
                    for i in range(2, size):
                        y[i] = new[i]
                        largest[i] = max(largest[i], abs(new[i]))
                    reached = share * tau + drive[0] * (1.0 - drive[4])
                    if twice:
                        other = (1.0 - share) * tau + drive[5] * (1.0 - drive[6])
                    before_force = reached + other + force
                    start = end
                    continue
            fresh, came = False, s
            reached = motor(t + end, tau, plant)
            if twice:
                other = (1.0 - share) * tau + drive[5] * math.exp(-h / settings[BEHIND])
                reached -= other
            s, hint, status, done = carry(
                y_, t + start, end - start, tau, force, s, hint, plant, bounds, work, new, before, events_, tally_
            )
            if status != DONE:
                return status, k, start + done
            if forced and s != 0.0:
                more = others_at(y_, t + end, tau, s, plant)
                if whole_period and came == s and others[0] > 0.0:
                    learn(more, h, others)
                else:  # after a change of direction or a jump the extrapolation starts anew
                    others[0], others[1], others[2], others[3] = 1.0, more, 0.0, 0.0
            else:
                others[0] = 0.0
            start = end
    return DONE, n, 0.0


def room(states: int, guards: int) -> int:
    """Length of ``scratch`` for an axis with so many states and guards."""
    solved = OTHERS + 2 * PIECES * room_of_one.py_func(states) + 3 * (states + MORE) ** 2
    return DRIVE + 4 + 8 * states + guards + 4 * SPEEDS + solved
