"""Motion of an axis with any effects between two events: balance of forces, Runge-Kutta step, location of an event.

State ``y = [q, v, own states of the effects ..., (work of motor, push, friction, effects)]``, the work only for an
energy balance. With a current loop the motor force decays towards its command, a known function of time within a hold
period, and with a second lag the sum of two. The step is the classical Runge-Kutta rule of order 4 with Zonneveld's
embedded rule of order 3 (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table II.4.2).

``plant`` is everywhere (baseline, table of hooks, start of each row of the table, parameters, settings, drive): bare
pointers, as arrays in tuples would be counted at ten times the cost of the arithmetic.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.compile import call_kernel, call_rate, fused, fused_inlined, inlined, part

# Rows of the table of hooks: one list of (address, first own state in y, first parameter) for each.
(FORCE, DRY, INERTIA, COMMAND, ACTUATOR, DELAY, SENSOR, RATE, GUARD, JUMP, TOUCH, TOUCH_MASS, HELD, MEMORY, SOLVED,
 UNSOLVED) = range(16)  # fmt: skip
# Places in ``settings``.
(PERIOD, GAIN, LIMIT, RESOLUTION, DELAYED, LAG, FREE, STATES, TOLERANCE, SLIDES, EXACT, ENERGY,
 VISCOUS_P, VISCOUS_N, BRAKING, LEVEL, MASS, MOBILITY, LINEAR, BEHIND, TWIST, LOWER, UPPER,
 ERROR_ALONE, WAITS, FARTHEST) = range(26)  # fmt: skip
SETTINGS = 26
DRIVE = 7  # numbers of ``drive``

ORDER = 4  # of convergence, measured in the tests
# Error tolerance of one step in position [m], velocity [m/s], and relative to the largest value of an own state.
_POSITION, _VELOCITY, OWN = 2e-11, 2e-9, 2e-8
_ROUGH = 0.5  # of the tolerance, below which a rough error estimate is enough
INSTANT = 1e-15  # s, shortest remainder of a period that is stepped
NUDGE = 1e-300  # m/s, a velocity that gives a direction and nothing else
CROSSING = 1e-13  # s, a step across a guard at which a force jumps


@inlined
def encoded(q, resolution):
    """Reading [m] of an encoder with that ``resolution`` [m] at position ``q`` [m]; 0: exact."""
    return np.floor(q / resolution + 0.5) * resolution if resolution > 0.0 else q


@part
def friction_of(b, settings):
    """The ``friction`` of :mod:`friction_period`, from the baseline and the settings of a run."""
    return b[0], settings[VISCOUS_P], settings[VISCOUS_N], b[2] + b[3], b[2] - b[3], settings[LAG]


@fused
def motor(t, tau, plant):
    """Motor force [N] at ``t`` under the command ``tau`` [N], with the remaining gaps of the lags."""
    settings, drive = plant[4], plant[5]
    lag, behind = settings[LAG], settings[BEHIND]
    if lag == 0.0:
        return tau
    force = tau + drive[0] * math.exp(-(t - drive[1]) / lag)
    if behind > 0.0:
        force += drive[5] * math.exp(-(t - drive[1]) / behind)
    return force


@fused
def turning(t, plant):
    """Time [s] after ``t`` at which the motor force has its extremum; infinite with one lag, where it is monotonic."""
    settings, drive = plant[4], plant[5]
    lag, behind = settings[LAG], settings[BEHIND]
    if behind == 0.0 or not drive[0] * drive[5] < 0.0:
        return np.inf
    after = drive[1] + math.log(-drive[5] * lag / (drive[0] * behind)) * lag * behind / (lag - behind) - t
    return after if after > CROSSING else np.inf


@fused_inlined
def total(row, y, t, tau, plant):
    """Sum of the kernels of one hook."""
    b, hooks, starts, p, _, _ = plant
    value = 0.0
    for i in range(starts[row], starts[row + 1]):
        value += call_kernel(hooks[3 * i], y[0], y[1], t, tau, y, hooks[3 * i + 1], p, hooks[3 * i + 2], b)
    return value


@fused_inlined
def dry(y, t, acting, plant):
    """Level of the dry friction [N] in motion, for the motor force behind the back-EMF."""
    return max(0.0, plant[4][LEVEL] + total(DRY, y, t, acting, plant))


@fused_inlined
def pull(y, t, acting, push, plant):
    """Force without dry friction [N] and mobility [1/kg], for the motor force behind the back-EMF."""
    b, settings, starts = plant[0], plant[4], plant[2]
    net = acting + push - b[1] * y[1] - b[3] - total(FORCE, y, t, acting, plant)
    if starts[INERTIA + 1] == starts[INERTIA]:
        return net, settings[MOBILITY]
    return net, 1.0 / (settings[MASS] + total(INERTIA, y, t, acting, plant))


@fused_inlined
def weigh(y, t, acting, push, s, plant):
    """:func:`balance` for a motor force ``acting`` without the back-EMF; kernels read the force with it."""
    v = y[1]
    acting -= plant[4][BRAKING] * v
    net, mobility = pull(y, t, acting, push, plant)
    # Dry friction is that of the direction of motion, also if a stage of a step is beyond its end; at rest it is that
    # of the direction in which the other forces push.
    if s * v < 0.0 or v == 0.0:
        y[1] = math.copysign(NUDGE, s if s != 0.0 else net)
    level = dry(y, t, acting, plant)
    y[1] = v
    return net, level, mobility


@fused
def balance(y, t, tau, push, s, plant):
    """Force without dry friction [N], level of it [N] towards ``s`` or at rest, and mobility [1/kg]."""
    return weigh(y, t, motor(t, tau, plant), push, s, plant)


@fused
def held(y, t, tau, push, plant):
    """Direction in which a carriage at rest breaks away, 0: dry friction holds it."""
    net, level, _ = balance(y, t, tau, push, 0.0, plant)
    if abs(net) <= level * (1.0 + 1e-14) + 1e-12:
        return 0.0
    return 1.0 if net > 0.0 else -1.0


@fused
def derivative(y, t, tau, push, s, plant, dy):
    """Time derivative of the whole state in motion with direction ``s``, or at rest."""
    b, hooks, starts, p, settings, _ = plant
    net, level, mobility = balance(y, t, tau, push, s, plant)
    if settings[FREE] > 0.0:
        dy[0] = y[1]
        dy[1] = net * mobility
    elif s == 0.0:
        dy[0] = 0.0
        dy[1] = 0.0
    else:
        dy[0] = y[1]
        dy[1] = (net - s * level) * mobility
    if settings[STATES] == 2.0:
        return
    acting = motor(t, tau, plant) - settings[BRAKING] * y[1]
    for i in range(starts[RATE], starts[RATE + 1]):
        x_at, p_at = hooks[3 * i + 1], hooks[3 * i + 2]
        call_rate(hooks[3 * i], y[0], y[1], t, acting, y, x_at, p, p_at, b, level, dy)
    if settings[ENERGY] > 0.0:
        e, v = int(settings[ENERGY]), dy[0]
        dy[e] = acting * v
        dy[e + 1] = push * v
        dy[e + 2] = (b[1] * v + (0.0 if settings[FREE] > 0.0 else s * level)) * v
        dy[e + 3] = (acting + push - b[1] * y[1] - b[3] - net) * v


@fused
def clipped(t, bounds):
    """Stage time limited to the segment between two jumps."""
    return min(max(t, bounds[0]), bounds[1])


@fused_inlined
def worse(error, wrong, i, new, largest):
    """The larger of ``error`` and the error ``wrong`` of state ``i``, in units of its tolerance."""
    if i == 0:
        scale = _POSITION
    elif i == 1:
        scale = _VELOCITY
    else:
        scale = OWN * max(largest[i], abs(new[i])) + 1e-300
    return max(error, wrong / scale) if wrong == wrong else np.inf


@fused
def step(y, t, h, tau, push, s, plant, bounds, work, new):
    """One Runge-Kutta step from ``y`` (its derivative in ``work[0]``) to ``new``; returns the scaled error.

    The embedded rule takes one more evaluation. A step is accepted without it if the differences of the other four,
    which are of lower order, are already within the tolerance.
    """
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
    rough, error = 0.0, 0.0
    judged = n if settings[ENERGY] == 0.0 else int(settings[ENERGY])
    for i in range(n):
        new[i] = y[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        if i < judged:
            wrong = h * (abs(k2[i] - k3[i]) + abs(k1[i] - k2[i] - k3[i] + k4[i]))
            rough = worse(rough, wrong, i, new, largest)
    if rough <= _ROUGH * settings[TOLERANCE]:
        return rough / settings[TOLERANCE]
    for i in range(n):
        stage[i] = y[i] + h / 32.0 * (5.0 * k1[i] + 7.0 * k2[i] + 13.0 * k3[i] - k4[i])
    derivative(stage, clipped(t + 0.75 * h, bounds), tau, push, s, plant, k5)
    for i in range(judged):
        wrong = abs(h * (2.0 / 3.0 * k1[i] - 2.0 * (k2[i] + k3[i] + k4[i]) + 16.0 / 3.0 * k5[i]))
        error = worse(error, wrong, i, new, largest)
    return error / settings[TOLERANCE]


@fused
def margin(event, sign, y, t, tau, push, plant):
    """A number that is positive before the event and negative after it."""
    b, hooks, _, p, _, _ = plant
    if event == 0:
        return sign * y[1]
    if event == 1:
        net, level, _ = balance(y, t, tau, push, 0.0, plant)
        return level * (1.0 + 1e-14) + 1e-12 - abs(net)
    i = event - 2  # entry of the table of hooks
    acting = motor(t, tau, plant) - plant[4][BRAKING] * y[1]
    return sign * call_kernel(hooks[3 * i], y[0], y[1], t, acting, y, hooks[3 * i + 1], p, hooks[3 * i + 2], b)


@fused
def locate(event, sign, y, t, h, tau, push, s, plant, bounds, work, new):
    """Shorten the step ``h`` so that it ends just after the event; ``new`` is the state there. Returns the step."""
    low, high = 0.0, h
    at_low = margin(event, sign, y, clipped(t, bounds), tau, push, plant)
    at_high = margin(event, sign, new, clipped(t + h, bounds), tau, push, plant)
    while at_low <= 0.0 and high > CROSSING:  # the step starts on the event: find a point before it happens again
        x = 0.5 * high
        step(y, t, x, tau, push, s, plant, bounds, work, new)
        value = margin(event, sign, new, clipped(t + x, bounds), tau, push, plant)
        if value > 0.0:
            low, at_low = x, value
        else:
            high, at_high = x, value
    if at_low <= 0.0:  # there is none: pass the event
        high = CROSSING
        while True:
            step(y, t, high, tau, push, s, plant, bounds, work, new)
            if high >= h or margin(event, sign, new, clipped(t + high, bounds), tau, push, plant) < 0.0:
                return high
            high = min(4.0 * high, h)
    side = 0
    for _ in range(100):
        if high - low <= INSTANT or at_high == 0.0:
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
