"""Slide through a hold period with the exact solution of forces that are affine in position, velocity and own states.

Between two events such an axis is ``dz/dt = A z`` with z = [q, v, own states ..., gap of the motor force to its
command, force, 1, slope and curve of the force], and its solution is one matrix for each direction of motion and each
piece: within a range of one own state, above it, and below it. A is computed from the forces by differences.

Other forces on the carriage that are smooth, and depend on motion and time alone, are extrapolated: a parabola of time
predicts them to the end of a period, and their value there corrects it (an Adams multistep method in Nordsieck's form,
for the forces only).
"""

from __future__ import annotations

import numpy as np

from emps_design.simulation.kernels.compile import call_rate, fused, shifted
from emps_design.simulation.kernels.motion import (
    BRAKING,
    FARTHEST,
    LAG,
    LEVEL,
    LINEAR,
    LOWER,
    MOBILITY,
    RATE,
    SOLVED,
    STATES,
    TOLERANCE,
    TWIST,
    UNSOLVED,
    UPPER,
    dry,
    total,
)

MORE = 5  # numbers of z besides the state
WITHIN, ABOVE, BELOW = range(3)  # pieces
PIECES = 3
OTHERS = 4  # numbers of the other forces: how many values are known, the force, its slope and its curve
_KNOWN = 2.0  # values needed to extrapolate
_TURN = 0.5  # rad, phase of the fastest mode in one part of a period: the velocity is almost a parabola there
_PARTS = 16  # parts of a period at most; a stiffer axis is stepped
_TERMS = 20  # of the Taylor series, for half a radian at most: the last is below 1e-24
# m/s, largest velocity error of the extrapolation before its correction, which leaves 1/24 of it.
_MISSED = 1e-8


@fused
def multiply(n, left, right, result):
    """Fill ``result`` with the product of two matrices (n, n), each row by row."""
    for i in range(n):
        for j in range(n):
            value = 0.0
            for k in range(n):
                value += left[n * i + k] * right[n * k + j]
            result[n * i + j] = value


@fused
def affine(y, s, plant, dy):
    """Time derivative of the state ``y`` sliding in direction ``s``, of the affine forces without motor and push."""
    b, hooks, starts, p, settings, _ = plant
    net = -(b[1] + settings[BRAKING]) * y[1] - b[3] - total(SOLVED, y, 0.0, 0.0, plant) - s * max(0.0, settings[LEVEL])
    dy[0], dy[1] = y[1], net * settings[MOBILITY]
    for i in range(starts[RATE], starts[RATE + 1]):
        x_at, p_at = hooks[3 * i + 1], hooks[3 * i + 2]
        call_rate(hooks[3 * i], y[0], y[1], 0.0, 0.0, y, x_at, p, p_at, b, settings[LEVEL], dy)


@fused
def others_at(y, t, tau, s, plant):
    """Forces [N] that are not :func:`affine`, in the state ``y`` sliding in direction ``s`` at motor force ``tau``."""
    acting, level = tau - plant[4][BRAKING] * y[1], max(0.0, plant[4][LEVEL])
    return s * (level - dry(y, t, acting, plant)) - total(UNSOLVED, y, t, acting, plant)


@fused
def learn(more, h, others):
    """Update the extrapolation ``others`` with the force ``more`` [N] measured ``h`` later."""
    error = more - (others[1] + h * (others[2] + 0.5 * h * others[3]))
    if others[0] < _KNOWN:
        others[0], others[2] = others[0] + 1.0, error / h
    else:
        others[3] += error / (h * h)
        others[2] += 0.5 * error / h + h * others[3]
    others[1] = more


@fused
def solve_all(h, plant, work, solutions, spare):
    """Fill ``solutions`` for both directions and all pieces."""
    length = room_of_one(int(plant[4][STATES]))
    for piece in range(PIECES):
        if piece == WITHIN or plant[4][TWIST] > 0.0:
            solve(h, 1.0, piece, plant, work, shifted(solutions, piece * length), spare)
            solve(h, -1.0, piece, plant, work, shifted(solutions, (PIECES + piece) * length), spare)


@fused
def room_of_one(n):
    """Length of the solution of one piece in one direction, for ``n`` states."""
    return (n + MORE) * (n + MORE + 2) + n + 1


@fused
def solve(h, s, piece, plant, work, solution, spare):
    """Fill ``solution`` for direction ``s`` and a ``piece``.

    It holds the matrix over a part of ``h``, the rows of the acceleration and of the rate of the state with pieces, the
    change of the state per newton of correction of the other forces at the end of ``h``, and the number of parts, 0 for
    too many. ``spare`` has room for three matrices.
    """
    settings, rest, moved, stage = plant[4], work[0], work[1], work[5]
    n, twist = int(settings[STATES]), int(settings[TWIST])
    size, lag, mobility = n + MORE, settings[LAG], settings[MOBILITY]
    a, other, third = spare, shifted(spare, size * size), shifted(spare, 2 * size * size)
    for i in range(size * size):
        a[i] = 0.0
    for i in range(n):
        stage[i] = 0.0
    step, begin = 1.0, 0.0
    if twist > 0:  # by steps that stay in the piece
        wide = settings[UPPER] - settings[LOWER] if settings[UPPER] > settings[LOWER] else 1.0
        if piece == WITHIN:
            step, begin = 0.25 * wide, 0.5 * (settings[LOWER] + settings[UPPER])
        elif piece == ABOVE:
            step, begin = wide, settings[UPPER] + wide
        else:
            step, begin = -wide, settings[LOWER] - wide
        stage[twist] = begin
    affine(stage, s, plant, rest)
    for j in range(n):
        unit, now = s if j == 1 else step if twist > 0 and j == twist else 1.0, stage[j]
        stage[j] = now + unit
        affine(stage, s, plant, moved)
        stage[j] = now
        for i in range(n):
            a[size * i + j] = (moved[i] - rest[i]) / unit
    # The largest rate of A is at most the 16th root of any norm of its 16th power.
    for i in range(n):
        for j in range(n):
            other[n * i + j] = a[size * i + j]
    for _ in range(2):
        multiply(n, other, other, third)
        multiply(n, third, third, other)
    rate = 0.0
    for i in range(n):
        norm = 0.0
        for j in range(n):
            norm += abs(other[n * i + j])
        rate = max(rate, np.sqrt(np.sqrt(np.sqrt(np.sqrt(norm)))))
    parts = max(1.0, np.ceil(rate * h / _TURN))
    row = shifted(solution, size * size)
    twists, answer = shifted(row, size), shifted(row, 2 * size)
    answer[n] = parts if parts <= _PARTS else 0.0
    for i in range(n):
        a[size * i + n + 2] = rest[i] - (a[size * i + twist] * begin if twist > 0 else 0.0)
    a[size + n], a[size + n + 1] = mobility, mobility
    a[size * (n + 1) + n + 3], a[size * (n + 3) + n + 4] = 1.0, 1.0
    if lag > 0.0:
        a[size * n + n] = -1.0 / lag
        rate = max(rate, 1.0 / lag)
    for j in range(size):
        row[j] = a[size + j]
        twists[j] = a[size * twist + j]
    span, halvings = h / parts, 0
    while rate * span > _TURN:
        span *= 0.5
        halvings += 1
    for i in range(size):
        for j in range(size):
            solution[size * i + j] = 1.0 if i == j else 0.0
    for term in range(_TERMS, 0, -1):  # Horner
        multiply(size, a, solution, other)
        for i in range(size):
            for j in range(size):
                solution[size * i + j] = other[size * i + j] * span / term + (1.0 if i == j else 0.0)
    for _ in range(halvings):
        multiply(size, solution, solution, other)
        for i in range(size * size):
            solution[i] = other[i]
    # A parabola of time through 0 a period ago, 0 now and 1 at the end of this one: x (x + 1) / 2.
    for i in range(n):
        stage[i] = 0.0
    force, slope, curve = 0.0, 0.5 / h, 1.0 / (h * h)
    for _ in range(int(answer[n])):
        for i in range(n):
            value = solution[size * i + n + 1] * force + solution[size * i + n + 3] * slope
            value += solution[size * i + n + 4] * curve
            for j in range(n):
                value += solution[size * i + j] * stage[j]
            moved[i] = value
        force += h / parts * (slope + 0.5 * h / parts * curve)
        slope += h / parts * curve
        for i in range(n):
            stage[i] = moved[i]
    for i in range(n):
        answer[i] = stage[i]


@fused
def flow(y, t, h, tau, push, s, plant, work, solutions, others, new):
    """Slide through ``h`` under motor force ``tau`` and ``push`` [N] to the state ``new``; returns whether it succeeds.

    It fails if the direction ``s`` or the piece changes on the way, or if the other forces change too fast.
    """
    settings, largest, stage = plant[4], work[6], work[5]
    n, twist, forced = int(settings[STATES]), int(settings[TWIST]), settings[LINEAR] > 1.0
    size, gap = n + MORE, plant[5][0]
    piece, lower, upper = WITHIN, -np.inf, np.inf
    if twist > 0:
        low, high = settings[LOWER], settings[UPPER]
        if y[twist] > high:
            piece, lower = ABOVE, high
        elif y[twist] < low:
            piece, upper = BELOW, low
        else:
            lower, upper = low, high
    solution = shifted(solutions, ((PIECES if s < 0.0 else 0) + piece) * room_of_one(n))
    row = shifted(solution, size * size)
    twists, answer = shifted(row, size), shifted(row, 2 * size)
    parts = int(answer[n])
    if parts == 0 or (forced and others[0] < _KNOWN):
        return False
    force, slope, curve, span = tau + push, 0.0, 0.0, h / parts
    if forced:
        if settings[LINEAR] > 2.0:  # they have changed with the motor force
            others[1] = others_at(y, t, tau, s, plant)
        force, slope, curve = force + others[1], others[2], others[3]
    for i in range(n):
        stage[i] = y[i]
    last, goes = of_row(n, stage, gap, force, row), of_row(n, stage, gap, force, twists)
    for _ in range(parts):
        for i in range(n):
            value = solution[size * i + n] * gap + solution[size * i + n + 1] * force + solution[size * i + n + 2]
            value += solution[size * i + n + 3] * slope + solution[size * i + n + 4] * curve
            for j in range(n):
                value += solution[size * i + j] * stage[j]
            new[i] = value
        gap *= solution[size * n + n]
        force += span * (slope + 0.5 * span * curve)
        slope += span * curve
        first, last = last, of_row(n, new, gap, force, row)
        if not (s * new[1] > 0.0 and abs(new[0]) < settings[FARTHEST] and abs(new[1]) < settings[FARTHEST]):
            return False
        # A dip of the velocity between the two: for a parabola it is half of this at most.
        dip = 0.5 * span * min(abs(first), abs(last))
        if s * first < 0.0 and s * last > 0.0 and min(abs(stage[1]), abs(new[1])) < dip:
            return False
        if twist > 0:
            went, goes = goes, of_row(n, new, gap, force, twists)
            dip = 0.5 * span * min(abs(went), abs(goes)) if went * goes < 0.0 else 0.0
            least, most = min(stage[twist], new[twist]), max(stage[twist], new[twist])
            if least - (dip if went < 0.0 else 0.0) < lower or most + (dip if went > 0.0 else 0.0) > upper:
                return False
        for i in range(n):
            stage[i] = new[i]
    if forced:
        more = others_at(new, t + h, tau, s, plant)
        error = more - (force - tau - push)
        if abs(error) * settings[MOBILITY] * h > _MISSED * settings[TOLERANCE]:
            return False
        for i in range(n):
            new[i] += error * answer[i]
        if not s * new[1] > 0.0 or (twist > 0 and not lower <= new[twist] <= upper):
            return False
        learn(more, h, others)
    for i in range(n):
        largest[i] = max(largest[i], abs(new[i]))
    plant[5][0] = gap
    return True


@fused
def of_row(n, y, gap, force, row):
    """Rate of the state with this ``row`` of A, in the state ``y``."""
    value = row[n] * gap + row[n + 1] * force + row[n + 2]
    for j in range(n):
        value += row[j] * y[j]
    return value
