"""Exact solution of one hold period of the friction plant: two-quadrant friction, first-order or ideal current loop.

``M qdd = tau + push - F_v qd - L S(qd)``, ``T_c dtau/dt = c - tau`` with command c and push held. A period of sliding
is linear and has a closed form; one in which the velocity reaches zero is cut there, at the zero of that form. At rest
S takes any value in [-1, 1]; the carriage leaves at the instant the force leaves [-F_c-, F_c+]. Two-quadrant friction
is the vector X of (5); the baseline of an axis is the case ``F_c+- = F_c +- offset``.

``friction`` is everywhere the tuple (mass, viscous to + and to -, Coulomb to + and to -, time constant of the loop).
"""

from __future__ import annotations

import math

from emps_design.simulation.kernels.compile import inlined, part

REVERSAL, STICK, BREAKAWAY, GUARDED = range(4)  # kinds of events that are recorded
_STOPS = 32  # most stops within one period


@part
def note(events, tally, time, kind, place):
    """Count an event in ``tally`` = (events so far, room for them) and record it if there is room."""
    i = tally[0]
    if i < tally[1]:
        events[3 * i] = time
        events[3 * i + 1] = kind
        events[3 * i + 2] = place
    tally[0] = i + 1


@part
def response(s, mass, viscous, lag):
    """Factors of v0, d and f in v(s) and in q(s) - q0, with d = tau0 - c, f = c + push - L; last, the decay of d."""
    a = viscous / mass
    x = a * s
    ea = math.exp(-x)
    p1 = -math.expm1(-x) / x if abs(x) > 1e-12 else 1.0 - 0.5 * x
    if abs(x) > 1e-2:
        p2 = (1.0 - p1) / x
    else:
        p2 = 0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0)))
    if lag == 0.0:
        return ea, 0.0, s * p1 / mass, s * p1, 0.0, s * s * p2 / mass, 0.0
    b = 1.0 / lag
    y = b * s
    eb = math.exp(-y)
    if abs(y - x) > 1e-3:
        v_d = (ea - eb) / (b - a) / mass
        q_d = (s * p1 + math.expm1(-y) / b) / (b - a) / mass
    else:  # nearly equal time constants: exp(-z) sinh(h)/h about their mean, to the order of h^2
        z, h2 = 0.5 * (x + y), (0.5 * (y - x)) ** 2 / 6.0
        ez = math.exp(-z)
        if z < 0.1:
            first = 0.5 - z * (
                1 / 3 - z * (1 / 8 - z * (1 / 30 - z * (1 / 144 - z * (1 / 840 - z * (1 / 5760 - z / 45360)))))
            )
            third = 1 / 4 - z * (1 / 5 - z * (1 / 12 - z * (1 / 42 - z / 192)))
        else:
            first = (1.0 - ez * (1.0 + z)) / (z * z)
            third = (6.0 - ez * (6.0 + z * (6.0 + z * (3.0 + z)))) / z**4
        v_d = s * ez * (1.0 + h2) / mass
        q_d = s * s * (first + h2 * third) / mass
    return ea, v_d, s * p1 / mass, s * p1, q_d, s * s * p2 / mass, eb


@part
def _velocity(s, v0, d, f, mass, viscous, lag):
    v_v, v_d, v_f, _, _, _, _ = response(s, mass, viscous, lag)
    return v_v * v0 + v_d * d + v_f * f


@part
def _acceleration(s, v, d, f, mass, viscous, lag):
    force = f + (d * math.exp(-s / lag) if lag > 0.0 else 0.0)
    return (force - viscous * v) / mass


@part
def _zero(lo, hi, side, v0, d, f, mass, viscous, lag):
    """Time in (lo, hi] at which side * v crosses zero; side * v(lo) > 0 >= side * v(hi). Newton with a bracket."""
    tiny = 4e-16 * hi
    s = 0.5 * (lo + hi)
    for _ in range(100):
        v = _velocity(s, v0, d, f, mass, viscous, lag)
        if side * v > 0.0:
            lo = s
        else:
            hi = s
        slope = _acceleration(s, v, d, f, mass, viscous, lag)
        following = s - v / slope if slope != 0.0 else lo
        if not lo < following < hi:
            following = 0.5 * (lo + hi)
        if abs(following - s) <= tiny or hi - lo <= tiny:
            break
        s = following
    return s


@part
def _extremum(rest, v0, d, f, mass, viscous, lag):
    """Time in (0, rest) at which the acceleration changes its sign; it does so exactly once."""
    a, b = viscous / mass, 1.0 / lag
    if abs(b - a) * rest > 1e-3:  # M dv/dt = P exp(-a s) + Q exp(-b s)
        q = d * b / (b - a)
        p = f + d - viscous * v0 - q
        if p * q < 0.0:
            s = math.log(-q / p) / (b - a)
            if 0.0 < s < rest:
                return s
    lo, hi = 0.0, rest
    start = _acceleration(0.0, v0, d, f, mass, viscous, lag)
    for _ in range(60):
        middle = 0.5 * (lo + hi)
        v = _velocity(middle, v0, d, f, mass, viscous, lag)
        if start * _acceleration(middle, v, d, f, mass, viscous, lag) > 0.0:
            lo = middle
        else:
            hi = middle
    return 0.5 * (lo + hi)


@part
def _first_zero(rest, side, v0, d, f, mass, viscous, lag):
    """Time in (0, rest] at which sliding in direction ``side`` ends, or -1. The velocity has at most one extremum."""
    v1 = _velocity(rest, v0, d, f, mass, viscous, lag)
    if lag == 0.0:  # monotone
        if side * v1 > 0.0:
            return -1.0
        a = viscous / mass
        at = math.log1p(-viscous * v0 / f) / a if a != 0.0 else -mass * v0 / f
        return min(max(at, 0.0), rest)
    start = side * _acceleration(0.0, v0, d, f, mass, viscous, lag)
    end = side * _acceleration(rest, v1, d, f, mass, viscous, lag)
    top = 0.0
    if start * end < 0.0:
        top = _extremum(rest, v0, d, f, mass, viscous, lag)
        if start < 0.0:  # down, then up
            if side * _velocity(top, v0, d, f, mass, viscous, lag) <= 0.0:
                return _zero(0.0, top, side, v0, d, f, mass, viscous, lag)
            top = 0.0
    if side * v1 <= 0.0:
        return _zero(top, rest, side, v0, d, f, mass, viscous, lag)
    return -1.0


@part
def follow(q, v, tau, command, push, span, friction, t, events, tally):
    """Position, velocity and motor force after ``span`` seconds from ``t``, through every stop, which is recorded."""
    mass, viscous_p, viscous_n, coulomb_p, coulomb_n, lag = friction
    rest, side, came = span, 0.0, 0.0
    if lag == 0.0:
        tau = command
    for _ in range(_STOPS):
        leaves = False
        if v != 0.0:
            side = 1.0 if v > 0.0 else -1.0
        else:
            force = tau + push
            side = 1.0 if force > coulomb_p else -1.0 if force < -coulomb_n else 0.0
            if came != 0.0:
                note(events, tally, t + span - rest, STICK if side == 0.0 else REVERSAL, q)
            elif side != 0.0:
                note(events, tally, t, BREAKAWAY, q)
            if side == 0.0:  # sticks, at most until the force exceeds friction
                bound = coulomb_p - push if command > tau else -coulomb_n - push
                wait = rest
                if lag > 0.0 and (command > bound if command > tau else command < bound):
                    wait = lag * math.log((command - tau) / (command - bound))
                if wait >= rest:
                    return q, 0.0, command + (tau - command) * math.exp(-rest / lag) if lag > 0.0 else command
                side = 1.0 if command > tau else -1.0
                tau = bound
                rest -= wait
                leaves = True
                note(events, tally, t + span - rest, BREAKAWAY, q)
        viscous = viscous_p if side > 0.0 else viscous_n
        d = tau - command
        f = command + push - (coulomb_p if side > 0.0 else -coulomb_n)
        # From rest, with a force that grows beyond friction: the velocity has no further zero.
        s = -1.0 if leaves else _first_zero(rest, side, v, d, f, mass, viscous, lag)
        stops = s >= 0.0
        if not stops:
            s = rest
        v_v, v_d, v_f, q_v, q_d, q_f, kept = response(s, mass, viscous, lag)
        q += q_v * v + q_d * d + q_f * f
        v = 0.0 if stops else v_v * v + v_d * d + v_f * f
        tau = command + d * kept
        rest -= s
        if not stops:
            return q, v, tau
        came = side
        if rest <= 0.0:
            note(events, tally, t + span, STICK, q)
            return q, v, tau
    # More stops in one period: the carriage rests for the remaining time.
    return q, 0.0, command + (tau - command) * math.exp(-rest / lag) if lag > 0.0 else command


@inlined
def slid(s, q, v, d, command, push, span, factors, mass, viscous, level, lag):
    """Return whether the carriage slides in direction ``s`` through all of ``span``, and position and velocity if so.

    ``level`` is the dry friction with the sign of ``s``. The velocity must keep its sign at the end, and the smallest
    force on the way must not bring it to zero.
    """
    v_v, v_d, v_f, q_v, q_d, q_f, kept = factors
    f = command + push - level
    new = v_v * v + v_d * d + v_f * f
    weakest = s * f + min(s * d, s * d * kept) - max(s * viscous * v, s * viscous * new)
    all_the_way = s * new > 0.0 and (lag == 0.0 or s * mass * v + span * weakest > 0.0)
    return all_the_way, q + (q_v * v + q_d * d + q_f * f), new


@inlined
def sticks(d, command, push, coulomb_p, coulomb_n):
    """Whether a carriage at rest stays there while the motor force goes from ``command + d`` to ``command``."""
    return -coulomb_n <= command + push <= coulomb_p and -coulomb_n <= command + d + push <= coulomb_p


@inlined
def advance(q, v, tau, command, push, span, forward, backward, friction, t, events, tally):
    """:func:`follow` with the :func:`response` to ``span`` in either direction, so a slide needs no exponential."""
    mass, viscous_p, viscous_n, coulomb_p, coulomb_n, lag = friction
    d = tau - command if lag > 0.0 else 0.0
    if v > 0.0:
        slides, place, new = slid(1.0, q, v, d, command, push, span, forward, mass, viscous_p, coulomb_p, lag)
        if slides:
            return place, new, command + d * forward[6]
    elif v < 0.0:
        slides, place, new = slid(-1.0, q, v, d, command, push, span, backward, mass, viscous_n, -coulomb_n, lag)
        if slides:
            return place, new, command + d * backward[6]
    elif sticks(d, command, push, coulomb_p, coulomb_n):
        return q, 0.0, command + d * forward[6]
    return follow(q, v, tau, command, push, span, friction, t, events, tally)


@inlined
def uneventful(q, v, tau, command, push, span, forward, backward, friction):
    """:func:`advance` without branches, valid without an event; returns whether there is none, then the same."""
    mass, viscous_p, viscous_n, coulomb_p, coulomb_n, lag = friction
    d = tau - command if lag > 0.0 else 0.0
    s, factors, viscous, level = (
        (1.0, forward, viscous_p, coulomb_p) if v > 0.0 else (-1.0, backward, viscous_n, -coulomb_n)
    )
    slides, place, new = slid(s, q, v, d, command, push, span, factors, mass, viscous, level, lag)
    rests = v == 0.0
    if rests:
        place, new = q, 0.0
    fine = sticks(d, command, push, coulomb_p, coulomb_n) if rests else slides
    return fine, place, new, command + d * factors[6]
