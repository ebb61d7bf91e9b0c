"""Many baseline plants side by side under ``position_pd``: 32 lanes per step, metrics only.

The arithmetic is that of :func:`~emps_design.simulation.kernels.baseline.run_plain`. All lanes slide in one vector
loop; a lane whose velocity reaches zero in this period, or is at rest, is stepped again alone. Lanes never share
anything, so the numbers of a plant do not depend on its neighbours.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.simulation.kernels.baseline import (
    COULOMB,
    DAMPING,
    GAIN,
    LIMIT,
    MASS,
    OFFSET,
    PERIOD,
    PROPORTIONAL,
    RESOLUTION,
    TWO_TAP,
    VISCOUS,
)
from emps_design.simulation.kernels.compile import cached, pointer, shifted
from emps_design.simulation.kernels.friction_period import follow, response

LANES = 32
ROWS = 20
METRICS = 5  # columns of the result


@cached()
def run_lanes(baselines, numbers, start, reference, push, measured_q, measured_u, first, scratch, found, result):
    """Simulate ``baselines`` (m, 4), m a multiple of 32, and fill ``result`` (m, 5).

    Columns: sums of squares over the samples from ``first`` on of reference minus position, measured minus encoder
    position and measured minus simulated voltage (0 where nothing was measured), then the largest voltage and the
    number of samples at rest. ``scratch`` has 20 rows of 32; ``found`` two zeros: no event is kept.
    """
    room, nothing = pointer(scratch), pointer(found)
    q, v, older, last = room, shifted(room, 32), shifted(room, 64), shifted(room, 96)
    e, g1, m1, m2 = shifted(room, 128), shifted(room, 160), shifted(room, 192), shifted(room, 224)
    dry, offset, mass, viscous = shifted(room, 256), shifted(room, 288), shifted(room, 320), shifted(room, 352)
    seen, net, ahead, place = shifted(room, 384), shifted(room, 416), shifted(room, 448), shifted(room, 480)
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
            begun = math.floor(start[0] / resolution + 0.5) * resolution if resolution > 0.0 else start[0]
            older[i], last[i] = begun, begun
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
                    seen[i] = math.floor(q[i] / resolution + 0.5) * resolution
            else:
                for i in range(32):
                    seen[i] = q[i]
            for i in range(32):
                before = two_tap * older[i] + (1.0 - two_tap) * last[i]
                volts = proportional * (wanted - seen[i]) - damping * (seen[i] - before)
                volts = limit if volts > limit else volts
                volts = -limit if volts < -limit else volts
                older[i] = last[i]
                last[i] = seen[i]
                tracked[i] += counts * (wanted - q[i]) * (wanted - q[i])
                missed[i] += counts * (real_q - seen[i]) * (real_q - seen[i])
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
