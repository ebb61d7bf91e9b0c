"""Step an axis with any effects through a run: hold periods, Runge-Kutta steps inside them, events between them.

State ``y = [q, v, own states of the effects ..., (work of motor, push, friction, effects)]``, the work where the energy
balance is asked for. Under a current loop that is not ideal the motor force decays towards its command, a known
function of time within a hold period. Within a hold
period the classical Runge-Kutta rule of order 4 with Zonneveld's embedded rule of order 3 (Hairer, Norsett, Wanner,
Solving Ordinary Differential Equations I, table II.4.2) chooses its steps. Friction stays set-valued: motion has a
direction ``s`` of +1 or -1 and at rest ``s = 0``; velocity zeros, break-away, guards and jumps in time end a step,
found by repeating the step with other lengths (Illinois method), so no step ever crosses a kink. Everything compiled
for the general path is in this file.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation import core
from emps_design.simulation.compile import (
    cached,
    call_actuator,
    call_kernel,
    call_law,
    call_rate,
    part,
    pointer,
    shifted,
)

# Rows of ``hooks``: one list of (address, first own state in y, first parameter) for each.
FORCE, DRY, INERTIA, COMMAND, ACTUATOR, DELAY, SENSOR, RATE, GUARD, JUMP, TOUCH, TOUCH_MASS = range(12)
# What a run can end with.
DONE, DIVERGED, NO_STEP, CHATTER, RUNAWAY, MASSLESS = range(6)
# Kinds of events that are recorded.
REVERSAL, STICK, BREAKAWAY, GUARDED = range(4)
# Places in ``settings``.
PERIOD, GAIN, LIMIT, RESOLUTION, DELAYED, LAG, FREE, STATES, TOLERANCE, GLIDES, EXACT, ENERGY, SERIES = range(13)

# What one step may be wrong by in position [m], velocity [m/s], and relative to the largest value of an own state.
_POSITION, _VELOCITY, _OWN = 2e-11, 2e-9, 2e-8
# The same for a glide: second difference of the acceleration times step squared [m], velocity missed [m/s].
_BEND, _MISSED = 6e-9, 3e-10
_SPEEDS = 20  # octaves of speed, up to 5 m/s
_INSTANT = 1e-15  # s, shortest rest of a period worth a step
_APART = 5e-10  # s, how far from a jump in time its two sides are evaluated; above SNAP of the effects
_CROSSING = 1e-13  # s, a step across a guard at which a force jumps
ORDER, GLIDE_ORDER = 4, 3  # of convergence, measured in the tests
_SHORTEST = 1e-12  # s, a step that must be shorter than this does not converge


@part
def motor(t, tau, plant):
    """Motor force at ``t`` under the command ``tau``: behind a lag, what is left of the gap there was."""
    lag, drive = plant[4][LAG], plant[5]
    if lag == 0.0:
        return tau
    return tau + drive[0] * math.exp(-(t - drive[1]) / lag)


@part
def told(t, tau, plant):
    """Motor force that kernels are told: the command, but what is behind the current loop for a second lag."""
    return motor(t, tau, plant) if plant[4][SERIES] > 0.0 else tau


@part
def total(row, y, t, tau, plant):
    """Sum of the kernels of one hook."""
    b, hooks, starts, p, _, _ = plant
    value = 0.0
    for i in range(starts[row], starts[row + 1]):
        value += call_kernel(hooks[3 * i], y[0], y[1], t, tau, y, hooks[3 * i + 1], p, hooks[3 * i + 2], b)
    return value


@part
def balance(y, t, tau, push, plant):
    """Force without dry friction [N], level of dry friction [N], and mass [kg]."""
    b, acting = plant[0], motor(t, tau, plant)
    tau = told(t, tau, plant)
    net = acting + push - b[1] * y[1] - b[3] - total(FORCE, y, t, tau, plant)
    level = max(0.0, b[2] + total(DRY, y, t, tau, plant))
    return net, level, b[0] + total(INERTIA, y, t, tau, plant)


@part
def held(y, t, tau, push, plant):
    """Direction in which a carriage at rest leaves, 0: dry friction holds it."""
    net, level, _ = balance(y, t, tau, push, plant)
    if abs(net) <= level * (1.0 + 1e-14) + 1e-12:
        return 0.0
    return 1.0 if net > 0.0 else -1.0


@part
def derivative(y, t, tau, push, s, plant, dy):
    """Time derivative of the whole state in motion with direction ``s``, or at rest."""
    b, hooks, starts, p, settings, _ = plant
    net, level, mass = balance(y, t, tau, push, plant)
    if settings[FREE] > 0.0:
        dy[0] = y[1]
        dy[1] = net / mass
    elif s == 0.0:
        dy[0] = 0.0
        dy[1] = 0.0
    else:
        dy[0] = y[1]
        dy[1] = (net - s * level) / mass
    if settings[STATES] == 2.0:
        return
    seen = told(t, tau, plant)
    for i in range(starts[RATE], starts[RATE + 1]):
        x_at, p_at = hooks[3 * i + 1], hooks[3 * i + 2]
        call_rate(hooks[3 * i], y[0], y[1], t, seen, y, x_at, p, p_at, b, level, dy)
    if settings[ENERGY] > 0.0:
        e, v, acting = int(settings[ENERGY]), dy[0], motor(t, tau, plant)
        dy[e] = acting * v
        dy[e + 1] = push * v
        dy[e + 2] = (b[1] * v + (0.0 if settings[FREE] > 0.0 else s * level)) * v
        dy[e + 3] = (acting + push - b[1] * y[1] - b[3] - net) * v


@part
def clipped(t, bounds):
    """Stage time kept on this side of the jumps that bound the segment."""
    return min(max(t, bounds[0]), bounds[1])


@part
def step(y, t, h, tau, push, s, plant, bounds, work, new):
    """One Runge-Kutta step from ``y`` (its derivative in ``work[0]``) to ``new``; returns the scaled error."""
    k1, k2, k3, k4, k5, stage, largest = work
    settings = plant[4]
    n = int(settings[STATES])
    middle, last = clipped(t + 0.5 * h, bounds), clipped(t + h, bounds)
    for i in range(n):
        stage[i] = y[i] + 0.5 * h * k1[i]
    derivative(stage, middle, tau, push, s, plant, k2)
    for i in range(n):
        stage[i] = y[i] + 0.5 * h * k2[i]
    derivative(stage, middle, tau, push, s, plant, k3)
    for i in range(n):
        stage[i] = y[i] + h * k3[i]
    derivative(stage, last, tau, push, s, plant, k4)
    for i in range(n):
        stage[i] = y[i] + h / 32.0 * (5.0 * k1[i] + 7.0 * k2[i] + 13.0 * k3[i] - k4[i])
    derivative(stage, clipped(t + 0.75 * h, bounds), tau, push, s, plant, k5)
    error = 0.0
    judged = n if settings[ENERGY] == 0.0 else int(settings[ENERGY])
    for i in range(n):
        new[i] = y[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        if i >= judged:
            continue
        wrong = abs(h * (2.0 / 3.0 * k1[i] - 2.0 * (k2[i] + k3[i] + k4[i]) + 16.0 / 3.0 * k5[i]))
        if i == 0:
            scale = _POSITION
        elif i == 1:
            scale = _VELOCITY
        else:
            scale = _OWN * max(largest[i], abs(new[i])) + 1e-300
        error = max(error, wrong / scale) if wrong == wrong else np.inf
    return error / settings[TOLERANCE]


@part
def margin(event, sign, y, t, tau, push, plant):
    """A number that is positive before the event and negative after it."""
    b, hooks, _, p, _, _ = plant
    if event == 0:
        return sign * y[1]
    if event == 1:
        net, level, _ = balance(y, t, tau, push, plant)
        return level * (1.0 + 1e-14) + 1e-12 - abs(net)
    i = event - 2  # entry of the table of hooks
    tau = told(t, tau, plant)
    return sign * call_kernel(hooks[3 * i], y[0], y[1], t, tau, y, hooks[3 * i + 1], p, hooks[3 * i + 2], b)


@part
def locate(event, sign, y, t, h, tau, push, s, plant, bounds, work, new):
    """Shorten the step ``h`` until it ends just behind the event; leaves the state there in ``new``."""
    low, high = 0.0, h
    at_low = margin(event, sign, y, clipped(t, bounds), tau, push, plant)
    at_high = margin(event, sign, new, clipped(t + h, bounds), tau, push, plant)
    while at_low <= 0.0 and high > _CROSSING:  # it began on the event: look for a point before it happens again
        x = 0.5 * high
        step(y, t, x, tau, push, s, plant, bounds, work, new)
        value = margin(event, sign, new, clipped(t + x, bounds), tau, push, plant)
        if value > 0.0:
            low, at_low = x, value
        else:
            high, at_high = x, value
    if at_low <= 0.0:  # there is none: leave the event behind
        high = _CROSSING
        while True:
            step(y, t, high, tau, push, s, plant, bounds, work, new)
            if high >= h or margin(event, sign, new, clipped(t + high, bounds), tau, push, plant) < 0.0:
                return high
            high = min(4.0 * high, h)
    side = 0
    for _ in range(100):
        if high - low <= _INSTANT or at_high == 0.0:
            break
        x = high - at_high * (high - low) / (at_high - at_low)
        if not low < x < high:
            x = 0.5 * (low + high)
        step(y, t, x, tau, push, s, plant, bounds, work, new)
        value = margin(event, sign, new, clipped(t + x, bounds), tau, push, plant)
        if value > 0.0:
            low, at_low = x, value
            if side == 1:
                at_high *= 0.5
            side = 1
        else:
            high, at_high = x, value
            if side == -1:
                at_low *= 0.5
            side = -1
    step(y, t, high, tau, push, s, plant, bounds, work, new)
    return high


@part
def glide(y, t, h, tau, push, s, feel, plant, work, new):
    """Slide through ``h`` on two evaluations or few more; returns whether the step is good.

    Simpson's rule over the acceleration at both ends and in the middle (Lobatto IIIA), for axes without own states,
    guards and jumps. ``work[0][1]`` is the acceleration at the start, known from the end of the last step;
    ``work[0][0]`` the slope it had there without viscous decay, ``work[1][1]`` the mass. ``feel`` holds the derivative
    of the acceleration by velocity (see :func:`feeling`): velocities that were off are answered by it, and the sweep is
    repeated until what that leaves is below the tolerance. Where the second difference of the acceleration is large,
    one step is too long and the general method takes over.
    """
    stage, tolerance = work[5], plant[4][TOLERANCE]
    decay = plant[0][1] / work[1][1]
    # What the gap of the motor force does on its way to zero is known: to acceleration, velocity and position.
    gap, lag = plant[5][0] / work[1][1], plant[4][LAG]
    half_a, half_v, half_q = fading(gap, lag, decay, 0.5 * h)
    full_a, full_v, full_q = fading(gap, lag, decay, h)
    a0 = work[0][1] - gap
    slope = work[0][0] - decay * a0
    stage[0] = y[0] + half_q + 0.5 * h * (y[1] + 0.25 * h * (a0 + h / 6.0 * slope))
    stage[1] = y[1] + half_v + 0.5 * h * (a0 + 0.25 * h * slope)
    end = 0.0
    for sweep in range(4):
        if s * stage[1] <= 0.0:
            return False
        net, level, mass = balance(stage, t + 0.5 * h, tau, push, plant)
        middle = (net - s * level) / mass - half_a
        if sweep == 0:
            end = 2.0 * middle - a0
        new[0] = y[0] + full_q + h * (y[1] + h / 6.0 * (a0 + 2.0 * middle))
        new[1] = y[1] + full_v + h / 6.0 * (a0 + 4.0 * middle + end)
        if s * new[1] <= 0.0:
            return False
        used = end
        net, level, mass = balance(new, t + h, tau, push, plant)
        end = (net - s * level) / mass - full_a
        if abs(a0 - 2.0 * middle + end) * h * h > _BEND * tolerance:
            return False
        moved = h / 6.0 * (end - used)
        new[1] += moved
        missed = y[1] + half_v + h / 24.0 * (5.0 * a0 + 8.0 * middle - end) - stage[1]
        i = 2 * min(max(math.frexp(1e5 * y[1])[1], 0), _SPEEDS - 1) + (2 * _SPEEDS if s > 0.0 else 0)
        if h * feel[i + 1] * (4.0 * abs(missed) + abs(moved)) <= 6.0 * _MISSED * tolerance:
            new[1] += h / 6.0 * feel[i] * (4.0 * missed + moved)
            work[0][0] = 2.0 * (end - middle) / h + 0.5 * decay * (middle + end)
            work[0][1] = end + full_a
            return s * new[1] > 0.0
        stage[0] = y[0] + half_q + h * (0.5 * y[1] + h / 96.0 * (7.0 * a0 + 6.0 * middle - end))
        stage[1] += missed
    return False


@part
def fading(gap, lag, decay, h):
    """What a force that fades with ``lag`` adds after ``h``, under viscous ``decay``: acceleration, velocity, position.

    ``gap`` [m/s^2] is what it adds to the acceleration at first.
    """
    if gap == 0.0:
        return 0.0, 0.0, 0.0
    gone = -math.expm1(-h / lag)
    v = gap * lag * gone
    q = lag * (gap * h - v)
    return gap * (1.0 - gone) - decay * v, v - decay * q, q - decay * lag * (0.5 * gap * h * h - q)


@part
def feeling(y, plant, work, feel):
    """Fill ``feel``, per direction and octave of speed from 10 um/s, with two numbers [1/s].

    The derivative of the acceleration by velocity (at the first position and time), and a bound of what it does not
    explain: a quarter of the largest one in this and the neighbouring octaves.
    """
    stage = work[5]
    stage[0] = y[0]
    for side in range(2):
        sign = 2.0 * side - 1.0
        row = shifted(feel, 2 * _SPEEDS * side)
        stage[1] = sign * 0.5e-5
        net, level, mass = balance(stage, 0.0, 0.0, 0.0, plant)
        last, speed = (net - sign * level) / mass, stage[1]
        for i in range(_SPEEDS):
            stage[1] = sign * 1e-5 * 2.0**i
            net, level, mass = balance(stage, 0.0, 0.0, 0.0, plant)
            value = (net - sign * level) / mass
            row[2 * i] = (value - last) / (stage[1] - speed)
            last, speed = value, stage[1]
        for i in range(_SPEEDS):
            before, after = row[2 * max(i - 1, 0)], row[2 * min(i + 1, _SPEEDS - 1)]
            row[2 * i + 1] = 0.25 * max(abs(row[2 * i]), max(abs(before), abs(after)))


@part
def note(events, found, time, kind, place):
    i = found[0]
    if i < found[1]:
        events[3 * i] = time
        events[3 * i + 1] = kind
        events[3 * i + 2] = place
    found[0] = i + 1


@part
def segment(y, t, span, tau, push, s, hint, plant, bounds, work, new, before, events, found):
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
    while span - done > _INSTANT:
        now = t + done
        rest = span - done
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
                if h > _CROSSING:
                    if walked == 0.0:
                        walked = h
                    hint = max(h * max(crossed, 0.001), 0.5 * _CROSSING)
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
                if h > _CROSSING:
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
                direction = 1.0 if balance(y, clipped(t + done, bounds), tau, push, plant)[0] > 0.0 else -1.0
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


@cached("stepper.py", "core.py")
def run(
    plant, y, law, gains, memory, reference, push, noise, signals, slots, floors, scratch, out, events, found
):  # fmt: skip
    """Run the loop over ``reference.size`` samples; returns the status, the sample, and the time within its period [s].

    ``plant`` = arrays (baseline, table of hooks, start of each row of the table, parameters, settings); ``law`` is the
    address of the controller, 0: the reference is the voltage. ``push`` [N] and ``noise`` [V] are empty or one value a
    sample; column i of ``signals`` is written to ``p[slots[i]]`` at every sample. ``floors`` are the sizes below which
    own states need not be known relatively. ``out`` has a row each for encoder, position, velocity, voltage and
    external force, ``events`` three columns; both are filled, and ``found`` [0] counts the events. ``scratch`` has room
    for :func:`room` numbers.
    """
    # Pointers from here on: arrays in tuples would be counted, at ten times the cost of the arithmetic.
    drive = pointer(scratch)  # gap between motor force and command, and since when
    plant = (pointer(plant[0]), pointer(plant[1]), pointer(plant[2]), pointer(plant[3]), pointer(plant[4]), drive)
    _, hooks, starts, p, settings, _ = plant
    n, size = reference.size, y.size
    y_, gains_, memory_, events_, found_ = pointer(y), pointer(gains), pointer(memory), pointer(events), pointer(found)
    bounds, free_row = shifted(drive, 2), shifted(drive, 2)
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
    period, limit, resolution = settings[PERIOD], settings[LIMIT], settings[RESOLUTION]
    jumps, late = starts[JUMP + 1] > starts[JUMP], starts[DELAY + 1] > starts[DELAY]
    touched, weighs = starts[TOUCH + 1] > starts[TOUCH], starts[TOUCH_MASS + 1] > starts[TOUCH_MASS]
    weighed = starts[INERTIA + 1] > starts[INERTIA]
    bounds[0], bounds[1] = -np.inf, np.inf
    glides, steady = settings[GLIDES] > 0.0, settings[GLIDES] > 1.0
    exact, lagged = settings[EXACT] > 0.0, settings[LAG] > 0.0
    feel = shifted(before, starts[GUARD + 1] - starts[GUARD])
    if glides:
        feeling(y_, plant, work, feel)
    fresh, before_force, before_mass = False, 0.0, 1.0
    tau, reached, s, hint = 0.0, 0.0, 0.0, period
    drive[0], drive[1] = 0.0, 0.0
    swings = (0.0, 0.0, 0.0)
    if y[1] != 0.0:
        s = 1.0 if y[1] > 0.0 else -1.0
    for k in range(n):
        t = k * period
        for i in range(slots.size):
            p[slots[i]] = signals[k, i]
        force = push[k] if push.size else 0.0
        position[k], velocity[k] = y[0], y[1]
        seen = y[0] + total(SENSOR, y_, t, tau, plant)
        if resolution > 0.0:
            seen = np.floor(seen / resolution + 0.5) * resolution
        encoder[k] = seen
        if weighed and not balance(y_, t, tau, force, plant)[2] > 0.0:
            return MASSLESS, k, 0.0
        felt = force
        if touched:
            felt -= total(TOUCH, y_, t, tau, plant)
            if weighs:
                derivative(y_, t, tau, force, s, plant, k1)
                felt -= k1[1] * total(TOUCH_MASS, y_, t, tau, plant)
        outside[k] = felt
        if law != 0:
            volts = call_law(law, k, reference[k], seen, felt, limit, gains_, memory_)
        else:
            volts = reference[k]
        volts += total(COMMAND, y_, t, tau, plant)
        if noise.size:
            volts += noise[k]
        if not abs(volts) < np.inf:
            return DIVERGED, k, 0.0
        if abs(volts) >= limit:
            volts = limit if volts > 0.0 else -limit
            if law != 0:
                swings = core.swing(volts, k, period, swings)
                if swings[1] >= core.SWINGS:
                    return RUNAWAY, k, 0.0
        u[k] = volts

        whole, first = int(settings[DELAYED]), 0.0
        if late:
            wait = whole * period + max(0.0, total(DELAY, y_, t, tau, plant))
            whole = int(np.floor(wait / period + 1e-9))
            first = wait - whole * period
            if first < 1e-12:
                first = 0.0
        start = 0.0
        while period - start > _INSTANT:
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
            if lagged:
                drive[0], drive[1] = reached - tau, t + start
                reached = motor(t + end, tau, plant)
            else:
                reached = tau
            if exact:
                speed = y[1]
                y[0], y[1], at = core.step_exactly(plant[0], y[0], speed, tau + force - plant[0][3], h)
                if at >= 0.0:
                    if speed != 0.0:
                        note(events_, found_, t + start + at, STICK if y[1] == 0.0 else REVERSAL, y[0])
                    elif y[1] != 0.0:
                        note(events_, found_, t + start, BREAKAWAY, y[0])
                if not (abs(y[0]) < 1e3 and abs(y[1]) < 1e3):
                    return DIVERGED, k, start
                start = end
                continue
            if glides and s * y[1] > 0.0:
                if fresh and steady:
                    k1[1] += (tau + drive[0] + force - before_force) / before_mass
                else:
                    net, level, before_mass = balance(y_, t + start, tau, force, plant)
                    k1[0], k1[1], k2[1] = 0.0, (net - s * level) / before_mass, before_mass
                before_force = reached + force
                fresh = glide(y_, t + start, h, tau, force, s, feel, plant, work, new)
                if fresh:
                    y[0], y[1] = new[0], new[1]
                    start = end
                    continue
            fresh = False
            s, hint, status, done = segment(
                y_, t + start, end - start, tau, force, s, hint, plant, bounds, work, new, before, events_, found_
            )
            if status != DONE:
                return status, k, start + done
            start = end
    return DONE, n, 0.0


def room(states: int, guards: int) -> int:
    """Length of ``scratch`` for an axis with so many states and guards."""
    return 4 + 8 * states + guards + 4 * _SPEEDS
