"""Step the baseline ``M dv/dt = tau - F_v v - offset - F_c S(v)`` exactly: under a held force it is piecewise linear.

With ``a = F_v/M`` and ``n`` the net force over mass, motion over ``h`` is ``v' = v e + n g1``, ``q' = q + v g1 + n g2``
with ``e = exp(-a h)``, ``g1 = (1 - e)/a``, ``g2 = (h - g1)/a``. Velocity is zero at ``log(1 - a v/n)/a``; there the
carriage stays where dry friction holds the force, or turns. :func:`run_plain` does this sample by sample;
:func:`run_folded` folds controller and motion into one affine map for as long as the carriage slides and the voltage
is inside its limit.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.compile import cached, part

MASS, VISCOUS, COULOMB, OFFSET = range(4)
# Places in ``numbers``.
PERIOD, GAIN, LIMIT, RESOLUTION, PROPORTIONAL, DAMPING, TWO_TAP = range(7)
REVERSAL, STICK, BREAKAWAY = range(3)
SWINGS = 40.0  # swings of the voltage from limit to limit that make a loop unstable


@part
def factors(a, h):
    """``e``, ``g1`` [s] and ``g2`` [s^2] of a step of ``h`` seconds; series where ``a h`` is small."""
    x = a * h
    if x < 1e-3:
        g2 = 0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0)))
        return math.exp(-x), h * (1.0 - x * g2), h * h * g2
    g1 = -math.expm1(-x) / a
    return math.exp(-x), g1, (h - g1) / a


@part
def turn(q, v, net, dry, mass, a, h):
    """Motion over ``h`` when velocity reaches zero, or is zero at the start: position, velocity, time of rest or turn.

    ``net`` [N] without dry friction, ``dry`` its level [N].
    """
    at = 0.0
    if v != 0.0:
        n = (net - dry if v > 0.0 else net + dry) / mass
        at = math.log1p(-a * v / n) / a if a > 0.0 else -v / n
        at = min(max(at, 0.0), h)
        _, g1, g2 = factors(a, at)
        q += v * g1 + n * g2
    if abs(net) <= dry:
        return q, 0.0, at
    n = (net - dry if net > 0.0 else net + dry) / mass
    _, g1, g2 = factors(a, h - at)
    return q + n * g2, n * g1, at


@part
def swing(volts, k, period, swings):
    """Count how often in a row the voltage swings from one limit to the other within 0.2 s; 40 times: unstable.

    ``swings`` = (last side, count, sample of the last swing).
    """
    side = 1.0 if volts > 0.0 else -1.0
    last, count, at = swings
    if side * last < 0.0:
        count = count + 1.0 if (k - at) * period < 0.2 else 1.0
        at = float(k)
    return side, count, at


@part
def note(events, found, time, kind, place):
    """Record an event where there is room; count it in any case."""
    if found[0] < events.shape[0]:
        events[found[0], 0] = time
        events[found[0], 1] = kind
        events[found[0], 2] = place
    found[0] += 1


@part
def note_turn(events, found, t, at, before, after, where):
    """Record what :func:`turn` did."""
    if before != 0.0:
        note(events, found, t + at, STICK if after == 0.0 else REVERSAL, where)
    elif after != 0.0:
        note(events, found, t + at, BREAKAWAY, where)


@cached()
def run_plain(b, numbers, delay, start, reference, push, noise, position, encoder, velocity, u, events, found):
    """Close the loop of ``position_pd`` sample by sample; returns the number of good samples, or -1 - k.

    The latter where the loop is unstable: at sample k the voltage has swung between its limits 40 times.

    ``start`` = (q0, v0); ``delay`` whole samples; ``push`` [N] and ``noise`` [V] empty or one value a sample; the
    arrays behind them are filled.
    """
    mass, dry, offset = b[MASS], b[COULOMB], b[OFFSET]
    a, period, limit, gain = b[VISCOUS] / mass, numbers[PERIOD], numbers[LIMIT], numbers[GAIN]
    e, g1, g2 = factors(a, period)
    m1, m2 = g1 / mass, g2 / mass
    proportional, resolution, two_tap = numbers[PROPORTIONAL], numbers[RESOLUTION], numbers[TWO_TAP] > 0.0
    damping = numbers[DAMPING] / period * (0.5 if two_tap else 1.0)
    q, v = start
    seen = math.floor(q / resolution + 0.5) * resolution if resolution > 0.0 else q
    last, older = seen, seen
    swings = (0.0, 0.0, 0.0)
    for k in range(reference.size):
        seen = math.floor(q / resolution + 0.5) * resolution if resolution > 0.0 else q
        volts = proportional * (reference[k] - seen) - damping * (seen - (older if two_tap else last))
        older, last = last, seen
        if noise.size:
            volts += noise[k]
        if abs(volts) >= limit:
            volts = limit if volts > 0.0 else -limit
            swings = swing(volts, k, period, swings)
            if swings[1] >= SWINGS:
                position[k], velocity[k] = q, v
                return -k - 1
        position[k], encoder[k], velocity[k], u[k] = q, seen, v, volts
        if delay:
            volts = u[k - delay] if k >= delay else 0.0
        net = gain * volts - offset
        if push.size:
            net += push[k]
        if v > 0.0:
            n = net - dry
            new = v * e + n * m1
            if new > 0.0:
                q += v * g1 + n * m2
                v = new
                continue
        elif v < 0.0:
            n = net + dry
            new = v * e + n * m1
            if new < 0.0:
                q += v * g1 + n * m2
                v = new
                continue
        elif abs(net) <= dry:
            continue
        before = v
        q, v, at = turn(q, v, net, dry, mass, a, period)
        note_turn(events, found, k * period, at, before, v, q)
        if not abs(q) < 1e3:
            return k
    return reference.size


@cached(contract=True)
def run_folded(b, numbers, start, reference, push, position, velocity, u, events, found):
    """The same without delay, quantisation and noise, sliding folded into one affine map a sample."""
    mass, dry, offset = b[MASS], b[COULOMB], b[OFFSET]
    a, period, limit, gain = b[VISCOUS] / mass, numbers[PERIOD], numbers[LIMIT], numbers[GAIN]
    e, g1, g2 = factors(a, period)
    m1, m2 = g1 / mass, g2 / mass
    proportional, two_tap = numbers[PROPORTIONAL], numbers[TWO_TAP] > 0.0
    damping = numbers[DAMPING] / period * (0.5 if two_tap else 1.0)
    both = proportional + damping
    q_q, v_q = 1.0 - gain * m2 * both, -gain * m1 * both
    q_u, v_u = gain * m2, gain * m1
    q, v = start
    last, older = q, q
    n, k = reference.size, 0
    swings = (0.0, 0.0, 0.0)
    while k < n:
        if v != 0.0:
            s = 1.0 if v > 0.0 else -1.0
            constant = offset + s * dry
            while True:
                drive = proportional * reference[k] + damping * (older if two_tap else last)
                volts = drive - both * q
                other = constant - push[k] if push.size else constant
                # The next state is one product and one sum behind this one; the rest does not wait for it.
                new = v * e + (v_q * q + (v_u * drive - m1 * other))
                if not (s * new > 0.0 and abs(volts) <= limit):
                    break
                position[k], velocity[k], u[k] = q, v, volts
                older, last = last, q
                q = q_q * q + (v * g1 + (q_u * drive - m2 * other))
                v = new
                k += 1
                if k == n:
                    return n
        volts = proportional * (reference[k] - q) - damping * (q - (older if two_tap else last))
        if abs(volts) >= limit:
            volts = limit if volts > 0.0 else -limit
            swings = swing(volts, k, period, swings)
            if swings[1] >= SWINGS:
                position[k], velocity[k] = q, v
                return -k - 1
        position[k], velocity[k], u[k] = q, v, volts
        older, last = last, q
        net = gain * volts - offset
        if push.size:
            net += push[k]
        if v != 0.0:
            force = net - dry if v > 0.0 else net + dry
            new = v * e + force * m1
            if new * v > 0.0:
                q += v * g1 + force * m2
                v = new
                k += 1
                continue
        elif abs(net) <= dry:
            k += 1
            continue
        before = v
        q, v, at = turn(q, v, net, dry, mass, a, period)
        note_turn(events, found, k * period, at, before, v, q)
        k += 1
        if not abs(q) < 1e3:
            return k - 1
    return n


@cached()
def run_open(b, numbers, start, voltage, push, position, velocity, u, events, found):
    """Drive the baseline with ``voltage`` (n,) [V]; returns the number of good samples."""
    mass, dry, offset = b[MASS], b[COULOMB], b[OFFSET]
    a, period, limit, gain = b[VISCOUS] / mass, numbers[PERIOD], numbers[LIMIT], numbers[GAIN]
    e, g1, g2 = factors(a, period)
    m1, m2 = g1 / mass, g2 / mass
    q, v = start
    for k in range(voltage.size):
        volts = min(max(voltage[k], -limit), limit)
        position[k], velocity[k], u[k] = q, v, volts
        net = gain * volts - offset
        if push.size:
            net += push[k]
        if v == 0.0 and abs(net) <= dry:
            continue
        if v != 0.0:
            force = net - dry if v > 0.0 else net + dry
            new = v * e + force * m1
            if new * v > 0.0:
                q += v * g1 + force * m2
                v = new
                continue
        before = v
        q, v, at = turn(q, v, net, dry, mass, a, period)
        note_turn(events, found, k * period, at, before, v, q)
        if not abs(q) < 1e3:
            return k
    return voltage.size


@part
def step_exactly(b, q, v, net, h):
    """One exact step of ``h`` seconds under the force ``net`` [N]: position, velocity, time of rest or turn (or -1)."""
    mass, dry = b[MASS], b[COULOMB]
    a = b[VISCOUS] / mass
    if v != 0.0:
        n = (net - dry if v > 0.0 else net + dry) / mass
        e, g1, g2 = factors(a, h)
        new = v * e + n * g1
        if new * v > 0.0:
            return q + v * g1 + n * g2, new, -1.0
    elif abs(net) <= dry:
        return q, 0.0, -1.0
    return turn(q, v, net, dry, mass, a, h)


def numbers_of(period: float, gain: float, limit: float, resolution: float, gains: np.ndarray) -> np.ndarray:
    """The array ``numbers`` of the runs, from the axis and the gains of ``position_pd``."""
    return np.array([period, gain, limit, resolution, gains[0], gains[1], gains[3]])
