"""One sampling period of the friction plant with a first-order current loop, in closed form and event by event.

``M qdd = tau + tau_e - F_v qd - L S(qd)``, ``T_c dtau/dt = c - tau`` with command c and external force tau_e held. A
period of sliding is linear; one in which the velocity reaches zero is cut there, at the zero of the closed form. At
rest S takes any value in [-1, 1]; the carriage leaves at the instant the force leaves [-F_c-, F_c+]. Two-quadrant
friction is the vector X of (5). After an edit here, touch :mod:`impedance_kernel`: the compiler's cache looks only at
the file a function stands in.
"""

from __future__ import annotations

import math

from numba import njit

# Places in the plant's array.
MASS, VISCOUS_P, VISCOUS_N, COULOMB_P, COULOMB_N, LAG, GAIN, LIMIT, RESOLUTION, PERIOD = range(10)

_EVENTS = 32  # zero crossings followed within one period


@njit(cache=True, nogil=True)
def response(s, mass, viscous, lag, out):
    """Fill ``out`` with the factors of v0, d, f in v(s) and in q(s) - q0; c = command, d = tau0 - c, f = c + dry."""
    a = viscous / mass
    x = a * s
    ea = math.exp(-x)
    p1 = -math.expm1(-x) / x if x > 1e-12 else 1.0 - 0.5 * x
    if x > 1e-2:
        p2 = (1.0 - p1) / x
    else:
        p2 = 0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0)))
    out[0] = ea
    out[2] = s * p1 / mass
    out[3] = s * p1
    out[5] = s * s * p2 / mass
    if lag == 0.0:
        out[1] = 0.0
        out[4] = 0.0
        return
    b = 1.0 / lag
    y = b * s
    eb = math.exp(-y)
    if abs(y - x) > 1e-3:
        out[1] = (ea - eb) / (b - a) / mass
        out[4] = (s * p1 + math.expm1(-y) / b) / (b - a) / mass
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
        out[1] = s * ez * (1.0 + h2) / mass
        out[4] = s * s * (first + h2 * third) / mass


@njit(cache=True, nogil=True)
def _velocity(s, v0, d, f, mass, viscous, lag, out):
    response(s, mass, viscous, lag, out)
    return out[0] * v0 + out[1] * d + out[2] * f


@njit(cache=True, nogil=True)
def _acceleration(s, v, d, f, mass, viscous, lag):
    force = f + (d * math.exp(-s / lag) if lag > 0.0 else 0.0)
    return (force - viscous * v) / mass


@njit(cache=True, nogil=True)
def _zero(lo, hi, side, v0, d, f, mass, viscous, lag, out):
    """Time in (lo, hi] at which side * v falls through zero; side * v(lo) > 0 >= side * v(hi). Newton in a bracket."""
    tiny = 4e-16 * hi
    s = 0.5 * (lo + hi)
    for _ in range(100):
        v = _velocity(s, v0, d, f, mass, viscous, lag, out)
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


@njit(cache=True, nogil=True)
def _extremum(rest, v0, d, f, mass, viscous, lag, out):
    """Time in (0, rest) at which the acceleration changes its sign; it does so once."""
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
        v = _velocity(middle, v0, d, f, mass, viscous, lag, out)
        if start * _acceleration(middle, v, d, f, mass, viscous, lag) > 0.0:
            lo = middle
        else:
            hi = middle
    return 0.5 * (lo + hi)


@njit(cache=True, nogil=True)
def _first_zero(rest, side, v0, d, f, mass, viscous, lag, out):
    """Time in (0, rest] at which sliding towards ``side`` ends, or -1. The velocity has at most one extremum."""
    v1 = _velocity(rest, v0, d, f, mass, viscous, lag, out)
    start = side * _acceleration(0.0, v0, d, f, mass, viscous, lag)
    end = side * _acceleration(rest, v1, d, f, mass, viscous, lag)
    top = 0.0
    if start * end < 0.0 and lag > 0.0:
        top = _extremum(rest, v0, d, f, mass, viscous, lag, out)
        if start < 0.0:  # down, then up
            if side * _velocity(top, v0, d, f, mass, viscous, lag, out) <= 0.0:
                return _zero(0.0, top, side, v0, d, f, mass, viscous, lag, out)
            top = 0.0
    if side * v1 <= 0.0:
        return _zero(top, rest, side, v0, d, f, mass, viscous, lag, out)
    return -1.0


@njit(cache=True, nogil=True)
def step_with_events(state, c, external, plant, out):
    """Advance ``state`` [q, v, tau] by one period for a held command and external force, following every stop."""
    rest, lag, mass = plant[PERIOD], plant[LAG], plant[MASS]
    if lag == 0.0:
        state[2] = c
    side = 0.0
    for _ in range(_EVENTS):
        v = state[1]
        breaks_away = False
        if v != 0.0:
            side = 1.0 if v > 0.0 else -1.0
        elif side == 0.0:
            force = state[2] + external
            if force > plant[COULOMB_P]:
                side = 1.0
            elif force < -plant[COULOMB_N]:
                side = -1.0
            else:  # sticks, perhaps until the force leaves the friction's reach
                bound = plant[COULOMB_P] - external if c > state[2] else -plant[COULOMB_N] - external
                leaves = c > bound if c > state[2] else c < bound
                if lag == 0.0 or not leaves:
                    wait = rest
                else:
                    wait = lag * math.log((c - state[2]) / (c - bound))
                if wait >= rest:
                    if lag > 0.0:
                        state[2] = c + (state[2] - c) * math.exp(-rest / lag)
                    return
                side = 1.0 if c > state[2] else -1.0
                state[2] = bound
                rest -= wait
                breaks_away = True
        viscous = plant[VISCOUS_P] if side > 0.0 else plant[VISCOUS_N]
        dry = plant[COULOMB_P] if side > 0.0 else -plant[COULOMB_N]
        d = state[2] - c if lag > 0.0 else 0.0
        f = c + external - dry
        # From rest, with a force that grows from the friction's bound on: the velocity has no zero left.
        s = -1.0 if breaks_away else _first_zero(rest, side, v, d, f, mass, viscous, lag, out)
        stops = s >= 0.0
        if not stops:
            s = rest
        response(s, mass, viscous, lag, out)
        state[0] += out[3] * v + out[4] * d + out[5] * f
        state[1] = 0.0 if stops else out[0] * v + out[1] * d + out[2] * f
        if lag > 0.0:
            state[2] = c + d * math.exp(-s / lag)
        rest -= s
        if not stops or rest <= 0.0:
            return
        side = 0.0
    # More stops than _EVENTS in one period: the carriage rests for what is left of it.
    if lag > 0.0:
        state[2] = c + (state[2] - c) * math.exp(-rest / lag)
