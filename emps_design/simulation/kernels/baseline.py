"""Run the baseline ``M dv/dt = tau - F_v v - offset - F_c S(v)`` under ``position_pd``.

The period is that of :mod:`friction_period` with an ideal current loop. :func:`run_plain` steps sample by sample;
:func:`run_folded` folds controller and motion into one affine map for as long as the carriage slides and the voltage
is inside its limit.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.compile import cached, part, pointer
from emps_design.simulation.kernels.friction_period import follow, response

MASS, VISCOUS, COULOMB, OFFSET = range(4)
# Places in ``numbers``.
PERIOD, GAIN, LIMIT, RESOLUTION, PROPORTIONAL, DAMPING, TWO_TAP = range(7)
SWINGS = 40.0  # swings of the voltage from limit to limit that make a loop unstable


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


@cached()
def run_plain(b, numbers, delay, start, reference, push, noise, position, encoder, velocity, u, events, found):
    """Close the loop of ``position_pd`` sample by sample; returns the number of good samples, or -1 - k.

    The latter where the loop is unstable: at sample k the voltage has swung between its limits 40 times.

    ``start`` = (q0, v0); ``delay`` whole samples; ``push`` [N] and ``noise`` [V] empty or one value per sample; the
    arrays behind them are filled.
    """
    mass, dry, offset = b[MASS], b[COULOMB], b[OFFSET]
    period, limit, gain = numbers[PERIOD], numbers[LIMIT], numbers[GAIN]
    e, _, m1, g1, _, m2, _ = response(period, mass, b[VISCOUS], 0.0)
    friction = (mass, b[VISCOUS], b[VISCOUS], dry + offset, dry - offset, 0.0)
    events_, found_ = pointer(events), pointer(found)
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
        q, v, _ = follow(q, v, 0.0, net + offset, 0.0, period, friction, k * period, events_, found_)
        if not abs(q) < 1e3:
            return k
    return reference.size


@cached(contract=True)
def run_folded(b, numbers, start, reference, push, position, velocity, u, events, found):
    """The same without delay, quantisation and noise, sliding folded into one affine map per sample."""
    mass, dry, offset = b[MASS], b[COULOMB], b[OFFSET]
    period, limit, gain = numbers[PERIOD], numbers[LIMIT], numbers[GAIN]
    e, _, m1, g1, _, m2, _ = response(period, mass, b[VISCOUS], 0.0)
    friction = (mass, b[VISCOUS], b[VISCOUS], dry + offset, dry - offset, 0.0)
    events_, found_ = pointer(events), pointer(found)
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
        q, v, _ = follow(q, v, 0.0, net + offset, 0.0, period, friction, k * period, events_, found_)
        k += 1
        if not abs(q) < 1e3:
            return k - 1
    return n


def numbers_of(period: float, gain: float, limit: float, resolution: float, gains: np.ndarray) -> np.ndarray:
    """The array ``numbers`` of the runs, from the axis and the gains of ``position_pd``."""
    return np.array([period, gain, limit, resolution, gains[0], gains[1], gains[3]])
