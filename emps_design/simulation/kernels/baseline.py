"""Run the baseline ``M dv/dt = tau - F_v v - offset - F_c S(v)`` under ``position_pd``.

The period is that of :mod:`friction_period` with an ideal current loop. :func:`run_plain` steps sample by sample;
:func:`run_folded` combines controller and motion into one affine map while the carriage slides and the voltage is
within its limit. :func:`run_lanes` computes metrics of many plants, 32 lanes per step, with the arithmetic of
:func:`run_plain`: all lanes slide in one vector loop; a lane whose velocity reaches zero in the period, or is at rest,
is stepped again alone. Lanes share nothing, so the numbers of a plant do not depend on its neighbours.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.compile import cached, part, pointer, shifted
from emps_design.simulation.kernels.friction_period import follow, response

MASS, VISCOUS, COULOMB, OFFSET = range(4)
# Places in ``numbers``.
PERIOD, GAIN, LIMIT, RESOLUTION, PROPORTIONAL, DAMPING, TWO_TAP = range(7)
SWINGS = 40.0  # swings of the voltage from limit to limit that make a loop unstable

LANES = 32
ROWS = 20


@part
def swing(volts, k, period, swings):
    """Count consecutive swings of the voltage from one limit to the other within 0.2 s; 40 mean unstable.

    ``swings`` = (last side, count, sample of the last swing).
    """
    side = 1.0 if volts > 0.0 else -1.0
    last, count, at = swings
    if side * last < 0.0:
        count = count + 1.0 if (k - at) * period < 0.2 else 1.0
        at = float(k)
    return side, count, at


@cached()
def run_plain(b, numbers, delay, start, reference, push, noise, position, encoder, velocity, u, events, tally):
    """Close the loop of ``position_pd`` sample by sample; returns the number of valid samples, or -1 - k.

    The latter means an unstable loop: at sample k the voltage has swung between its limits 40 times.

    ``start`` = (q0, v0); ``delay`` whole samples; ``push`` [N] and ``noise`` [V] empty or one value per sample; the
    arrays behind them are filled.
    """
    mass, dry, offset = b[MASS], b[COULOMB], b[OFFSET]
    period, limit, gain = numbers[PERIOD], numbers[LIMIT], numbers[GAIN]
    e, _, m1, g1, _, m2, _ = response(period, mass, b[VISCOUS], 0.0)
    friction = (mass, b[VISCOUS], b[VISCOUS], dry + offset, dry - offset, 0.0)
    events_, tally_ = pointer(events), pointer(tally)
    proportional, resolution, two_tap = numbers[PROPORTIONAL], numbers[RESOLUTION], numbers[TWO_TAP] > 0.0
    damping = numbers[DAMPING] / period * (0.5 if two_tap else 1.0)
    q, v = start
    measured = math.floor(q / resolution + 0.5) * resolution if resolution > 0.0 else q
    last, older = measured, measured
    swings = (0.0, 0.0, 0.0)
    for k in range(reference.size):
        measured = math.floor(q / resolution + 0.5) * resolution if resolution > 0.0 else q
        volts = proportional * (reference[k] - measured) - damping * (measured - (older if two_tap else last))
        older, last = last, measured
        if noise.size:
            volts += noise[k]
        if abs(volts) >= limit:
            volts = limit if volts > 0.0 else -limit
            swings = swing(volts, k, period, swings)
            if swings[1] >= SWINGS:
                position[k], velocity[k] = q, v
                return -k - 1
        position[k], encoder[k], velocity[k], u[k] = q, measured, v, volts
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
        q, v, _ = follow(q, v, 0.0, net + offset, 0.0, period, friction, k * period, events_, tally_)
        if not abs(q) < 1e3:
            return k
    return reference.size


@cached(contract=True)
def run_folded(b, numbers, start, reference, push, position, velocity, u, events, tally):
    """The same without delay, quantisation and noise, sliding folded into one affine map per sample."""
    mass, dry, offset = b[MASS], b[COULOMB], b[OFFSET]
    period, limit, gain = numbers[PERIOD], numbers[LIMIT], numbers[GAIN]
    e, _, m1, g1, _, m2, _ = response(period, mass, b[VISCOUS], 0.0)
    friction = (mass, b[VISCOUS], b[VISCOUS], dry + offset, dry - offset, 0.0)
    events_, tally_ = pointer(events), pointer(tally)
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
                # The next state needs one product and one sum of this one; the rest does not depend on it.
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
        q, v, _ = follow(q, v, 0.0, net + offset, 0.0, period, friction, k * period, events_, tally_)
        k += 1
        if not abs(q) < 1e3:
            return k - 1
    return n


def numbers_of(period: float, gain: float, limit: float, resolution: float, gains: np.ndarray) -> np.ndarray:
    """The array ``numbers`` of the runs, from the axis and the gains of ``position_pd``."""
    return np.array([period, gain, limit, resolution, gains[0], gains[1], gains[3]])


@cached()
def run_lanes(baselines, numbers, start, reference, push, measured_q, measured_u, first, scratch, tally, result):
    """Simulate ``baselines`` (m, 4), m a multiple of 32, and fill ``result`` (m, 5).

    Columns: sums of squares over the samples from ``first`` on of reference minus position, measured minus encoder
    position and measured minus simulated voltage (0 where nothing was measured), then the largest voltage and the
    number of samples at rest. ``scratch`` has 20 rows of 32; ``tally`` two zeros: no event is recorded.
    """
    room, nothing = pointer(scratch), pointer(tally)
    q, v, older, last = room, shifted(room, 32), shifted(room, 64), shifted(room, 96)
    e, g1, m1, m2 = shifted(room, 128), shifted(room, 160), shifted(room, 192), shifted(room, 224)
    dry, offset, mass, viscous = shifted(room, 256), shifted(room, 288), shifted(room, 320), shifted(room, 352)
    measured, net, ahead, place = shifted(room, 384), shifted(room, 416), shifted(room, 448), shifted(room, 480)
    tracked, missed, voltage, peak = shifted(room, 512), shifted(room, 544), shifted(room, 576), shifted(room, 608)
    period, limit, gain, resolution = numbers[PERIOD], numbers[LIMIT], numbers[GAIN], numbers[RESOLUTION]
    proportional, two_tap = numbers[PROPORTIONAL], numbers[TWO_TAP]
    damping = numbers[DAMPING] / period * (0.5 if two_tap > 0.0 else 1.0)
    pushed, compared = push.size > 0, measured_q.size > 0
    for block in range(0, baselines.shape[0], 32):
        for i in range(32):
            b = baselines[block + i]
            mass[i], dry[i], offset[i], viscous[i] = b[MASS], b[COULOMB], b[OFFSET], b[VISCOUS]
            e[i], _, m1[i], g1[i], _, m2[i], _ = response(period, mass[i], viscous[i], 0.0)
            q[i], v[i] = start
            first_reading = math.floor(start[0] / resolution + 0.5) * resolution if resolution > 0.0 else start[0]
            older[i], last[i] = first_reading, first_reading
            tracked[i], missed[i], voltage[i], peak[i] = 0.0, 0.0, 0.0, 0.0
            result[block + i, 4] = 0.0
        for k in range(reference.size):
            wanted = reference[k]
            force = push[k] if pushed else 0.0
            counts = 1.0 if k >= first else 0.0
            real_q = measured_q[k] if compared else 0.0
            real_u = measured_u[k] if compared else 0.0
            if resolution > 0.0:
                for i in range(32):
                    measured[i] = math.floor(q[i] / resolution + 0.5) * resolution
            else:
                for i in range(32):
                    measured[i] = q[i]
            for i in range(32):
                before = two_tap * older[i] + (1.0 - two_tap) * last[i]
                volts = proportional * (wanted - measured[i]) - damping * (measured[i] - before)
                volts = limit if volts > limit else volts
                volts = -limit if volts < -limit else volts
                older[i] = last[i]
                last[i] = measured[i]
                tracked[i] += counts * (wanted - q[i]) * (wanted - q[i])
                missed[i] += counts * (real_q - measured[i]) * (real_q - measured[i])
                voltage[i] += counts * (real_u - volts) * (real_u - volts)
                size = abs(volts)
                peak[i] = size if size > peak[i] else peak[i]
                net[i] = gain * volts - offset[i] + force
                n = net[i] - math.copysign(dry[i], v[i])
                ahead[i] = v[i] * e[i] + n * m1[i]
                place[i] = q[i] + (v[i] * g1[i] + n * m2[i])
            turned = 0
            for i in range(32):
                turned += 1 if ahead[i] * v[i] <= 0.0 else 0
            if turned > 0:
                for i in range(32):
                    if ahead[i] * v[i] <= 0.0:
                        if v[i] == 0.0:
                            result[block + i, 4] += counts
                        if v[i] == 0.0 and abs(net[i]) <= dry[i]:
                            place[i], ahead[i] = q[i], 0.0
                        else:
                            friction = (mass[i], viscous[i], viscous[i], dry[i], dry[i], 0.0)
                            place[i], ahead[i], _ = follow(
                                q[i], v[i], 0.0, net[i], 0.0, period, friction, 0.0, room, nothing
                            )
            for i in range(32):
                q[i] = place[i]
                v[i] = ahead[i]
        for i in range(32):
            result[block + i, 0] = tracked[i]
            result[block + i, 1] = missed[i] if compared else 0.0
            result[block + i, 2] = voltage[i] if compared else 0.0
            result[block + i, 3] = peak[i] if abs(q[i]) < 1e3 else np.nan
