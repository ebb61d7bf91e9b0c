"""Slide through a hold period on its exact solution: where all effects are affine in position, velocity, own states.

Between two events such an axis is ``dz/dt = A z`` with z = [q, v, own states ..., what the motor force lacks of its
command, command and push, 1], and its solution one matrix for each direction of motion. A comes from the forces
themselves: the derivative of the state, taken at one unit after the other.
"""

from __future__ import annotations

import numpy as np

from emps_design.simulation.kernels.compile import fused, shifted
from emps_design.simulation.kernels.motion import LAG, STATES, balance, derivative

MORE = 3  # numbers of z besides the state
_TURN = 0.5  # rad, of the fastest motion in one part of a period: the velocity is all but a parabola there
_PARTS = 16  # of a period at most; an axis stiffer than that is stepped
_TERMS = 20  # of Taylor's series, for half a turn at most: the last is below 1e-24


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
def solve(h, s, plant, work, solution, spare):
    """Fill ``solution`` for direction ``s``: matrix over a part of ``h``, acceleration, and how many parts there are.

    None: too many. ``spare`` has room for three matrices.
    """
    settings, rest, moved, stage = plant[4], work[0], work[1], work[5]
    n = int(settings[STATES])
    size, lag = n + MORE, settings[LAG]
    a, other, third = spare, shifted(spare, size * size), shifted(spare, 2 * size * size)
    for i in range(size * size):
        a[i] = 0.0
    for i in range(n):
        stage[i] = 0.0
    derivative(stage, 0.0, 0.0, 0.0, s, plant, rest)
    mobility = balance(stage, 0.0, 0.0, 0.0, 0.0, plant)[2]
    for j in range(n):
        unit = s if j == 1 else 1.0
        stage[j] = unit
        derivative(stage, 0.0, 0.0, 0.0, s, plant, moved)
        stage[j] = 0.0
        for i in range(n):
            a[size * i + j] = (moved[i] - rest[i]) * unit
    # The rate of the fastest motion is at most the 16th root of any norm of the 16th power.
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
    row[size] = parts if parts <= _PARTS else 0.0
    for i in range(n):
        a[size * i + n + 2] = rest[i]
    a[size + n], a[size + n + 1] = mobility, mobility
    if lag > 0.0:
        a[size * n + n] = -1.0 / lag
        rate = max(rate, 1.0 / lag)
    for j in range(size):
        row[j] = a[size + j]
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


@fused
def flow(y, h, force, s, plant, work, solution, new):
    """Slide through ``h`` under ``force`` [N], to ``new``; returns whether it can, the direction ``s`` kept."""
    largest, stage = work[6], work[5]
    n = int(plant[4][STATES])
    size, gap = n + MORE, plant[5][0]
    row = shifted(solution, size * size)
    parts = int(row[size])
    for i in range(n):
        stage[i] = y[i]
    last = acceleration(n, stage, gap, force, row)
    for _ in range(parts):
        for i in range(n):
            value = solution[size * i + n] * gap + solution[size * i + n + 1] * force + solution[size * i + n + 2]
            for j in range(n):
                value += solution[size * i + j] * stage[j]
            new[i] = value
        gap *= solution[size * n + n]
        first, last = last, acceleration(n, new, gap, force, row)
        if not (s * new[1] > 0.0 and abs(new[0]) < 1e3 and abs(new[1]) < 1e3):
            return False
        # A dip between the two: of a parabola it is half of this at most.
        dip = 0.5 * h / parts * min(abs(first), abs(last))
        if s * first < 0.0 and s * last > 0.0 and min(abs(stage[1]), abs(new[1])) < dip:
            return False
        for i in range(n):
            stage[i] = new[i]
    for i in range(n):
        largest[i] = max(largest[i], abs(new[i]))
    plant[5][0] = gap
    return parts > 0


@fused
def acceleration(n, y, gap, force, row):
    """Of the carriage in the state ``y``, by its ``row`` of A."""
    value = row[n] * gap + row[n + 1] * force + row[n + 2]
    for j in range(n):
        value += row[j] * y[j]
    return value
