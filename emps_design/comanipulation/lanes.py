"""Many impedance laws side by side, each on a carriage that is the friction plant with the operator's hand on it.

The kernels are those of a run alone (:mod:`~emps_design.simulation.kernels.hold_loop`): law, hand, motion, measures.
All lanes go through a period in one vector loop; one in which the carriage stops or starts within the period is stepped
again alone. Lanes never share anything, so the numbers of a law do not depend on its neighbours.
"""

from __future__ import annotations

import numpy as np

from emps_design.comanipulation.measures import MEASURES, in_hand, let_go, nothing, over, watched
from emps_design.laws.library.impedance import (
    DELAY,
    KEEP_ACCELERATION,
    RATE,
    REFERENCE_VELOCITY,
    TAPS,
    WAITING,
    impedance,
)
from emps_design.simulation.environment import hand_force
from emps_design.simulation.kernels.compile import built_in, cached, inlined, pointer
from emps_design.simulation.kernels.friction_period import advance, response, uneventful
from emps_design.simulation.kernels.lanes import LANES, lane, row
from emps_design.simulation.kernels.motion import GAIN, LIMIT, PERIOD, RESOLUTION, encoded, friction_of

OWN = KEEP_ACCELERATION  # gains before this place are each law's own, those from there on the same for all
ROWS = 14 + OWN + WAITING + MEASURES
_DELAY, _RATE, _TAPS, _REFERENCE = DELAY - OWN, RATE - OWN, TAPS - OWN, REFERENCE_VELOCITY - OWN
_hand_force, _law = built_in(hand_force), built_in(impedance)


@inlined
def _ask(k, reference, q, force, limit, own, at_once, memory):
    """Voltage of one law at sample ``k``."""
    gains = (own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7], *at_once)
    return _law(k, reference, q, force, limit, gains, memory)


@cached()
def run_lanes(
    own, common, baseline, settings, start, reference, push, hand, wish, turns, release, end, scratch, free, found,
    measures,
):  # fmt: skip
    """Run the laws with gains ``own`` (m, OWN) and ``common``, m a multiple of LANES; fill ``measures`` (m, MEASURES).

    What the law commands arrives at once; ``start`` = (q0, v0). ``hand`` (n, 6) are the parameters of the hand's force
    at each sample; the rest as in :func:`~emps_design.comanipulation.measures.measure`. ``scratch`` has ROWS rows,
    ``free`` one for each sample from the release on and one more; ``found`` two zeros: no event is kept. A law whose
    voltage reaches the limit, or whose carriage leaves every bound, gets nan: what then happens, lanes do not look for.
    """
    rows, places, kept = pointer(scratch), pointer(free), pointer(found)
    q, v, tau, q1, v1, tau1 = row(rows, 0), row(rows, 1), row(rows, 2), row(rows, 3), row(rows, 4), row(rows, 5)
    u, command, force, release_v = row(rows, 6), row(rows, 7), row(rows, 8), row(rows, 9)
    stops, lost, encoder, gains = row(rows, 10), row(rows, 11), row(rows, 12), row(rows, 13)
    memory, seen_so_far = row(gains, OWN), row(gains, OWN + WAITING)
    period, limit, resolution, gain = settings[PERIOD], settings[LIMIT], settings[RESOLUTION], settings[GAIN]
    friction = friction_of(pointer(baseline), pointer(settings))
    mass, viscous_p, viscous_n, _, _, lag = friction
    forward, backward = response(period, mass, viscous_p, lag), response(period, mass, viscous_n, lag)
    # A delay known to the compiler, and that the estimator does not filter, whose coefficients it therefore lacks.
    named = 1.0 if common[_TAPS] > 0.0 else 0.0
    at_once = (*common[:_DELAY], 0.0, common[_RATE], named, common[_REFERENCE], 0.0)
    n = push.size
    for block in range(0, own.shape[0], LANES):
        for i in range(LANES):
            q[i], v[i], tau[i], lost[i] = start[0], start[1], 0.0, 0.0
            g, m = lane(gains, i), lane(memory, i)
            for j in range(OWN):
                g[j] = own[block + i, j]
            for j in range(WAITING):
                m[j] = 0.0
            nothing(n, release, lane(seen_so_far, i))
        for k in range(n):
            t, pushed, meant = k * period, push[k], wish[k]
            grip = (hand[k, 0], hand[k, 1], hand[k, 2], hand[k, 3], hand[k, 4], hand[k, 5])
            for i in range(LANES):
                force[i] = pushed - _hand_force(q[i], v[i], t, 0.0, None, grip, None)
                encoder[i] = encoded(q[i], resolution)
            if k == 0:  # apart: a loop that may set memories up again writes every one of them under a mask
                for i in range(LANES):
                    u[i] = _ask(k, reference, encoder[i], force[i], limit, lane(gains, i), at_once, lane(memory, i))
            else:
                for i in range(LANES):
                    u[i] = _ask(k, reference, encoder[i], force[i], limit, lane(gains, i), at_once, lane(memory, i))
            eventful = 0
            for i in range(LANES):
                command[i] = gain * u[i]
                quiet, q1[i], v1[i], tau1[i] = uneventful(
                    q[i], v[i], tau[i], command[i], force[i], period, forward, backward, friction
                )
                stops[i] = 0.0 if quiet or lost[i] > 0.0 else 1.0
                eventful += 0 if quiet or lost[i] > 0.0 else 1
            if eventful > 0:
                for i in range(LANES):
                    if stops[i] > 0.0:
                        q1[i], v1[i], tau1[i] = advance(
                            q[i], v[i], tau[i], command[i], force[i], period, forward, backward, friction, t, rows, kept
                        )
            if k < release:
                turn = (turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3])
                for i in range(LANES):
                    in_hand(q[i], q1[i], v[i], v1[i], u[i], force[i], meant, turn, period, lane(seen_so_far, i))
            else:
                for i in range(LANES):
                    row(places, k - release)[i] = q[i]
                    release_v[i] = v[i] if k == release else release_v[i]
                    let_go(v1[i], u[i], k, n, release, lane(seen_so_far, i))
            if k >= end:
                for i in range(LANES):
                    watched(q[i], q1[i], v[i], v1[i], u[i], lane(seen_so_far, i))
            left = 0
            for i in range(LANES):
                well = lost[i] == 0.0 and abs(u[i]) < limit and abs(q1[i]) < 1e3 and abs(v1[i]) < 1e3
                lost[i] = 0.0 if well else 1.0
                left += 1 if well else 0
                q[i], v[i], tau[i] = q1[i], v1[i], tau1[i]
            if left == 0:
                break
        for i in range(LANES):
            m = lane(seen_so_far, i)
            row(places, n - release)[i] = q[i]
            over(lane(places, i), release_v[i], n, release, end, period, m)
            for j in range(MEASURES):
                measures[block + i, j] = m[j] if lost[i] == 0.0 else np.nan
