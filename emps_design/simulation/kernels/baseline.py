"""Run the baseline ``M dv/dt = tau - F_v v - offset - F_c S(v)`` under ``position_pd``.

The period is that of :mod:`friction_period` with an ideal current loop. :func:`run_plain` steps sample by sample;
:func:`run_folded` combines controller and motion into one affine map while the carriage slides and the voltage is
within its limit. :func:`run_lanes` computes metrics of many plants in parallel (:mod:`.lanes`).
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.axis import Axis
from emps_design.simulation.kernels.compile import cached, part, pointer
from emps_design.simulation.kernels.friction_period import follow, response
from emps_design.simulation.kernels.lanes import LANES, row, step, step_again

MASS, VISCOUS, COULOMB, OFFSET = range(4)
# Places in ``numbers``.
PERIOD, GAIN, LIMIT, RESOLUTION, PROPORTIONAL, DAMPING, TWO_TAP, FARTHEST = range(8)
SWINGS = 40.0  # swings of the voltage from limit to limit that make a loop unstable

ROWS = 23


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
        if not abs(q) < numbers[FARTHEST]:
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
        if not abs(q) < numbers[FARTHEST]:
            return k - 1
    return n


def numbers_of(axis: Axis, period: float, resolution: float, gains: np.ndarray) -> np.ndarray:
    """The array ``numbers`` of the runs, from the axis and the gains of ``position_pd``."""
    drive, farthest = axis.drive, axis.units.farthest
    return np.array([period, drive.gain, drive.command_limit, resolution, gains[0], gains[1], gains[3], farthest])


@cached()
def run_lanes(baselines, numbers, start, reference, push, measured_q, measured_u, first, scratch, tally, result):
    """Simulate ``baselines`` (m, 4), m a multiple of LANES, and fill ``result`` (m, 5).

    Columns: sums of squares over the samples from ``first`` on of reference minus position, measured minus encoder
    position and measured minus simulated voltage (0 where nothing was measured), then the largest voltage and the
    number of samples at rest. A plant whose voltage reaches the limit, or whose carriage leaves every bound, gets nan:
    lanes do not simulate what follows. ``scratch`` has ROWS rows, ``tally`` two zeros: no event is recorded.
    """
    rows, nothing = pointer(scratch), pointer(tally)
    q, v, q1, v1, command, stops = row(rows, 0), row(rows, 1), row(rows, 2), row(rows, 3), row(rows, 4), row(rows, 5)
    lost, older, last, measured = row(rows, 6), row(rows, 7), row(rows, 8), row(rows, 9)
    e, m1, g1, m2 = row(rows, 10), row(rows, 11), row(rows, 12), row(rows, 13)
    mass, viscous, coulomb_p, coulomb_n = row(rows, 14), row(rows, 15), row(rows, 16), row(rows, 17)
    tracked, missed, voltage, peak, rest = row(rows, 18), row(rows, 19), row(rows, 20), row(rows, 21), row(rows, 22)
    period, limit, gain, resolution = numbers[PERIOD], numbers[LIMIT], numbers[GAIN], numbers[RESOLUTION]
    proportional, two_tap, farthest = numbers[PROPORTIONAL], numbers[TWO_TAP], numbers[FARTHEST]
    damping = numbers[DAMPING] / period * (0.5 if two_tap > 0.0 else 1.0)
    pushed, compared = push.size > 0, measured_q.size > 0
    now, after = (q, v, command), (q1, v1, command)  # an ideal current loop: the command is the motor force
    factors, friction = (e, 0.0, m1, g1, 0.0, m2, 0.0), (mass, viscous, viscous, coulomb_p, coulomb_n, 0.0)
    for block in range(0, baselines.shape[0], LANES):
        for i in range(LANES):
            b = baselines[block + i]
            mass[i], viscous[i] = b[MASS], b[VISCOUS]
            coulomb_p[i], coulomb_n[i] = b[COULOMB] + b[OFFSET], b[COULOMB] - b[OFFSET]
            e[i], _, m1[i], g1[i], _, m2[i], _ = response(period, mass[i], viscous[i], 0.0)
            q[i], v[i] = start
            last[i] = math.floor(start[0] / resolution + 0.5) * resolution if resolution > 0.0 else start[0]
            older[i] = last[i]
            tracked[i], missed[i], voltage[i], peak[i], rest[i] = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(reference.size):
            setpoint, pushes, events = reference[k], push[k] if pushed else 0.0, 0
            counts = 1.0 if k >= first else 0.0
            real_q = measured_q[k] if compared else 0.0
            real_u = measured_u[k] if compared else 0.0
            if resolution > 0.0:
                for i in range(LANES):
                    measured[i] = math.floor(q[i] / resolution + 0.5) * resolution
            else:
                for i in range(LANES):
                    measured[i] = q[i]
            for i in range(LANES):
                before = two_tap * older[i] + (1.0 - two_tap) * last[i]
                volts = proportional * (setpoint - measured[i]) - damping * (measured[i] - before)
                older[i] = last[i]
                last[i] = measured[i]
                tracked[i] += counts * (setpoint - q[i]) * (setpoint - q[i])
                missed[i] += counts * (real_q - measured[i]) * (real_q - measured[i])
                voltage[i] += counts * (real_u - volts) * (real_u - volts)
                peak[i] = max(peak[i], abs(volts))
                rest[i] += counts if v[i] == 0.0 else 0.0
                command[i] = gain * volts
                events += step(i, now, after, command, pushes, period, factors, factors, friction, stops)
            if events > 0:
                for i in range(LANES):
                    lost[i] = 0.0 if peak[i] < limit and abs(q[i]) < farthest else 1.0
                t = k * period
                step_again(now, after, command, pushes, period, factors, factors, friction, t, stops, lost, nothing)
            for i in range(LANES):
                q[i], v[i] = q1[i], v1[i]
        for i in range(LANES):
            result[block + i, 0] = tracked[i]
            result[block + i, 1] = missed[i] if compared else 0.0
            result[block + i, 2] = voltage[i] if compared else 0.0
            result[block + i, 3] = peak[i] if peak[i] < limit and abs(q[i]) < farthest else np.nan
            result[block + i, 4] = rest[i]
