"""What the translator takes of Python, and what it refuses in one line with the place."""

import math

import pytest

from emps_design.codegen.languages import functions_in_c
from emps_design.codegen.program import ARRAY, INT, REAL
from emps_design.codegen.reader import read_program
from emps_design.errors import InputError

ARGUMENTS = (INT, REAL, ARRAY)
PLACE = 2


def in_c(kernel):
    definitions, _ = functions_in_c(read_program(kernel, ARGUMENTS), "x", {})
    return "\n".join(definitions)


def twice(x):
    return 2 * x


def arithmetic(k, x, memory):
    """Text is left out."""
    total, = 0.0,  # fmt: skip
    return total


def whole_and_real(k, x, memory):
    n = 3
    n = n + 1
    y = n * x - k / 2 + (-x) ** 2.0
    y -= memory[PLACE] * (1 - (x - y))
    return y


def branches(k, x, memory):
    if not x > 0.0 and (k == 0 or x < -1):
        return -1.0
    elif 0 <= x < 1:
        y = abs(x) if k > 2 else max(x, 0.5, memory[0])
    else:
        y = math.sqrt(twice(x)) + x**3
    return y


def loops(k, x, memory):
    y = 0.0
    for i in range(k - 1, -1, -1):
        memory[i % 3] = memory[i]
    for i in range(int(x)):
        y += memory[i] * math.floor(x)
    return y


def test_what_is_taken_reads_like_the_original():
    assert "real y = R(n) * x - R(k) / R(2.0) + FN(pow)(-x, R(2.0));" in in_c(whole_and_real)
    assert "y = y - memory[2] * (R(1.0) - (x - y));" in in_c(whole_and_real)
    text = in_c(branches)
    assert "if (!(x > R(0.0)) && (k == 0 || x < R(-1.0))) {" in text
    assert "} else if (R(0.0) <= x && x < R(1.0)) {" in text
    assert "y = ((k > 2) ? FN(fabs)(x) : max(max(x, R(0.5)), memory[0]));" in text
    assert "y = FN(sqrt)(x_twice(x)) + x * (x * x);" in text
    text = in_c(loops)
    assert "for (long long i = k - 1; i > -1; i--) {" in text
    assert "memory[modulo(i, 3)] = memory[i];" in text
    assert "long long i_end = (long long)(x);" in text


def forever(k, x, memory):
    while x > 0.0:
        x -= 1.0
    return x


def listed(k, x, memory):
    found = [x, x]
    return found[0]


def half_way(k, x, memory):
    if x > 0.0:
        return 1.0


def over_cells(k, x, memory):
    for cell in memory:
        x += cell
    return x


def after_the_loop(k, x, memory):
    for i in range(3):
        x += memory[i]
    return x + i


def itself(k, x, memory):
    return itself(k, x, memory)


def at_a_real_place(k, x, memory):
    return memory[x]


def truth(k, x, memory):
    return 1.0 if x else 0.0


def endless(k, x, memory):
    return min(x, math.inf)


def unknown(k, x, memory):
    return missing(x)  # noqa: F821


def by_name(k, x, memory):
    return max(x, 0.0, key=abs)


def with_a_default(k, x, memory=None):
    return x


def remainder(k, x, memory):
    return x % 1.0


def of_numpy(k, x, memory):
    import numpy as np

    return np.sign(x)


@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        (arithmetic, "several variables in one assignment"),
        (forever, "found while"),
        (listed, "found list"),
        (half_way, "a path through the function without a return"),
        (over_cells, "found a loop, which cannot be translated; expected for over range"),
        (after_the_loop, "i outside its loop"),
        (itself, "itself: found a recursive function"),
        (at_a_real_place, "a real number, .* expected an integer"),
        (truth, "a condition that is not a comparison"),
        (endless, "found inf, .* expected a finite number"),
        (unknown, "the unknown name missing"),
        (by_name, "keyword or variadic arguments"),
        (with_a_default, "a default or variadic argument"),
        (remainder, "a remainder of real numbers"),
        (of_numpy, "found import"),
        (lambda k, x, memory: x, "expected a function made with def|its source cannot be read"),
        (max, "max: its source cannot be read"),
    ],
)
def test_the_rest_is_refused_in_one_line(kernel, message):
    with pytest.raises(InputError, match=message) as caught:
        read_program(kernel, ARGUMENTS)
    assert "\n" not in str(caught.value)
    if kernel.__name__ not in ("<lambda>", "max", "itself"):
        assert "test_reader.py, line " in str(caught.value)
