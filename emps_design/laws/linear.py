"""The linear form of a law while the carriage slides in one direction, from its kernel evaluated with linear numbers.

A linear number has a value, which decides comparisons and branches, and its dependence on the inputs and the memory of
the law: a constant and one slope for each. The slopes are exact, not finite differences, and may be from any ring:
floats, arrays (m,) of m laws, SymPy expressions.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.errors import AxisError
from emps_design.laws.law import Law

if TYPE_CHECKING:
    import control

INPUTS = ("reference", "q", "f_ext")
SPEED = 0.1  # m/s, of the slide in which the branches are taken


class Linear:
    """``constant + sum(slopes[name] * name)``, with its ``value`` at the point where branches are decided.

    >>> x = Linear(2.0, 0.0, {"x": 1.0})
    >>> y = 3.0 * x - 1.0
    >>> y.value, y.constant, y.slopes, max(y, 0.0) is y
    (5.0, -1.0, {'x': 3.0}, True)
    """

    __array_ufunc__ = None  # arrays use the arithmetic of this class
    __slots__ = ("constant", "slopes", "value")

    def __init__(self, value: float, constant: Any, slopes: dict[Any, Any] | None = None):
        self.value, self.constant, self.slopes = value, constant, slopes or {}

    def __add__(self, other: Any) -> Linear:
        if not isinstance(other, Linear):
            return Linear(self.value + _value(other), self.constant + other, self.slopes)
        slopes = dict(self.slopes)
        for name, slope in other.slopes.items():
            slopes[name] = slopes[name] + slope if name in slopes else slope
        return Linear(self.value + other.value, self.constant + other.constant, slopes)

    def __mul__(self, other: Any) -> Linear:
        if isinstance(other, Linear):
            if not other.slopes:
                return self._scaled(other.value, other.constant)
            if not self.slopes:
                return other._scaled(self.value, self.constant)
            raise AxisError("law: found a product of two signals, expected a law linear while the axis slides")
        return self._scaled(_value(other), other)

    def __truediv__(self, other: Any) -> Linear:
        if isinstance(other, Linear):
            if other.slopes:
                raise AxisError("law: found a division by a signal, expected a law linear while the axis slides")
            return self._scaled(1.0 / other.value, 1.0 / other.constant)
        return self._scaled(1.0 / _value(other), 1.0 / other)

    def _scaled(self, value: float, factor: Any) -> Linear:
        slopes = {name: slope * factor for name, slope in self.slopes.items()}
        return Linear(self.value * value, self.constant * factor, slopes)

    def __neg__(self) -> Linear:
        return self._scaled(-1.0, -1.0)

    def __sub__(self, other: Any) -> Linear:
        return self + (-other)

    def __rsub__(self, other: Any) -> Linear:
        return -self + other

    def __rtruediv__(self, other: Any) -> Linear:
        return Linear(_value(other), other) / self

    def __abs__(self) -> Linear:
        return -self if self.value < 0.0 else self

    def __int__(self) -> int:
        return int(self.value)

    def __lt__(self, other: Any) -> bool:
        return self.value < _value(other)

    def __le__(self, other: Any) -> bool:
        return self.value <= _value(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > _value(other)

    def __ge__(self, other: Any) -> bool:
        return self.value >= _value(other)

    __radd__, __rmul__ = __add__, __mul__


def _value(number: Any) -> float:
    if type(number) is float:
        return number
    return number.value if isinstance(number, Linear) else float(np.ravel(number)[0])


@dataclass(frozen=True)
class LinearLaw:
    """``u = C m + D w``, ``m[k+1] = A m + B w`` with the memory ``m`` and the inputs ``w``, deviations from the slide.

    ``inputs`` names them: reference, q, f_ext, and any gains taken as signals. Shapes (..., n, n), (..., n, i),
    (..., n), (..., i); leading axes are those of arrays among the gains, before them that of the samples of a ``cycle``
    if loops have different rates. ``moved`` (..., n) is the change of the memory at rest per metre of position.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    moved: np.ndarray
    inputs: tuple[str, ...] = INPUTS
    cycle: int = 1

    def to_ss(self, period: float) -> control.StateSpace:
        """The law as a discrete ``control.StateSpace`` from its inputs to the voltage.

        Raises :class:`AxisError` for a law with different rates, which is not time-invariant at that ``period``.
        """
        import control

        if self.cycle > 1:
            raise AxisError(
                f"law: found loops of different rates with a period of {self.cycle} samples, expected one rate; "
                "use to_ss() of the closed loop, which is lifted over them"
            )
        names = {"inputs": list(self.inputs), "outputs": ["voltage"], "name": "law"}
        return control.ss(self.A, self.B, self.C[None], self.D[None], period, **names)

    def used(self, moved: bool = False) -> np.ndarray:
        """The cells (n,) bool of the memory that are in a loop: an input drives them, and they drive the output.

        A cell without an input keeps its number and would add a pole to every loop. ``moved``: the cells are relative
        to the position of the carriage, which then also drives those that store an initial position.
        """
        links = _any_nonzero(self.A, 2)
        driven, observable = _any_nonzero(self.B, 2).any(axis=1), _any_nonzero(self.C, 1)
        if moved:
            driven = driven | _any_nonzero(self.moved, 1)
        for _ in observable:
            driven, observable = driven | (links @ driven), observable | (observable @ links)
        return driven & observable

    @property
    def keeps_to_changes(self) -> bool:
        """Whether the law depends on changes of position only: a shift of all positions does not change the voltage."""
        A, B, s = self.A, self.B[..., 1], self.moved
        change = (A @ s[..., None])[..., 0] + B - s, np.sum(self.C * s, axis=-1) + self.D[..., 1]
        size = np.abs(A) @ np.abs(s)[..., None], np.sum(np.abs(self.C * s), axis=-1) + np.abs(self.D[..., 1])
        small = (1e-14 * (size[0][..., 0] + np.abs(B) + np.abs(s)), 1e-14 * size[1])
        return all(bool(np.all(np.abs(rest) <= bound)) for rest, bound in zip(change, small, strict=True))


def linear_law(law: Law, period: float, direction: float = 1.0, signals: dict[int, str] | None = None) -> LinearLaw:
    """The linear form of ``law`` at a sampling ``period`` [s] while the carriage slides to + or - (0: sticks).

    Arrays (m,) in the gains are m laws; ``signals`` names gains, by place, as inputs.
    Raises :class:`AxisError` for a law that multiplies signals.

    >>> from emps_design.laws import law_of
    >>> from emps_design.machines import machine
    >>> linear = linear_law(law_of(machine("emps2019"), 1e-3), 1e-3)
    >>> linear.D.round(1).tolist(), linear.C.round(1).tolist(), linear.keeps_to_changes
    ([38995.8, -160720.8, 0.0], [0.0, 121725.0], False)
    """
    memory = law.memory
    start: list[Any] = [0.0] * memory
    law.kernel(0, 0.0, Linear(0.0, 0.0, {"q": 1.0}), 0.0, np.inf, _gain_list(law.gains), start)
    inputs = (*INPUTS, *(signals or {}).values())
    names = (*range(memory), *inputs)
    by_position = _dense([_linear(cell) for cell in start], ("q",))[..., 0]
    pasts = itertools.islice(_slide(law, period, direction), law.cycle)
    runs = [_run(law, period, direction, k, past, signals) for k, past in pasts]
    tables = [_dense([*cells, u], names) for u, cells in runs]
    rows = tables[0] if law.cycle == 1 else np.stack(np.broadcast_arrays(*tables))
    A, B = rows[..., :-1, :memory], rows[..., :-1, memory:]
    return LinearLaw(A, B, rows[..., -1, :memory], rows[..., -1, memory:], by_position, inputs, law.cycle)


def own_poles(law: Law, period: float) -> np.ndarray:
    """Poles (..., count) of the internal loop of a law, from its voltage back to it, while the carriage sticks.

    The loop has the memory cells that depend on the voltage and on which the voltage depends. The former are found by a
    run with the voltage at its limit. Filters of the position are not part of it.
    """
    u, cells = run_linear(law, period, 0.0)
    _, limited = run_linear(law, period, 0.0, limit=-1.0)
    memory = law.memory
    A, A_limited = _dense(cells, range(memory)), _dense(limited, range(memory))
    C = _dense([u], range(memory))[..., 0, :]
    links = _any_nonzero(A_limited, 2)
    driven, observable = _any_nonzero(A - A_limited, 2).any(axis=1), _any_nonzero(C, 1)
    for _ in range(memory):
        driven, observable = driven | (links @ driven), observable | (observable @ links)
    inside = np.flatnonzero(driven & observable)
    return np.linalg.eigvals(A[..., inside, :][..., inside])


def run_linear(law: Law, period: float, direction: float = 1.0, limit: float = np.inf) -> tuple[Linear, list[Linear]]:
    """Output and next memory of ``law`` as linear numbers of its memory, by place, and of its inputs, by name.

    Gains may be linear numbers, too: a value that decides branches, and a symbol as constant. With a ``limit`` below
    zero the voltage is always at its limit. The result is for the first sample of a cycle.
    """
    k, past = next(_slide(law, period, direction))
    return _run(law, period, direction, k, past, limit=limit)


def _slide(law: Law, period: float, direction: float) -> Iterator[tuple[int, list[Any]]]:
    """Sample numbers k of a slide, from the first cycle after the start-up of the law, and the memory before each."""
    values, past = [_value(gain) for gain in _gain_list(law.gains)], [0.0] * law.memory
    first = -(-(law.memory + 4) // law.cycle) * law.cycle
    for k in itertools.count():
        if k >= first:
            yield k, list(past)
        reference, position = _slide_point(law, period, direction, k)
        law.kernel(k, reference, position, 0.0, np.inf, values, past)


def _slide_point(law: Law, period: float, direction: float, k: int) -> tuple[float, float]:
    """Reference and position [m] at sample ``k`` of the slide."""
    position = k * direction * SPEED * period
    return (direction * SPEED if law.follows == "velocity" else position), position


def _run(
    law: Law,
    period: float,
    direction: float,
    k: int,
    past: list[Any],
    signals: dict[int, str] | None = None,
    limit: float = np.inf,
) -> tuple[Linear, list[Linear]]:
    """Output and next memory at sample ``k`` of the slide, with the memory ``past`` before it."""
    numbers = _gain_list(law.gains)
    reference, at = _slide_point(law, period, direction, k)
    for place, name in (signals or {}).items():
        numbers[place] = Linear(_value(numbers[place]), 0.0, {name: 1.0})
    cells: list[Any] = [Linear(value, 0.0, {place: 1.0}) for place, value in enumerate(past)]
    followed, position = Linear(reference, 0.0, {"reference": 1.0}), Linear(at, 0.0, {"q": 1.0})
    u = law.kernel(k, followed, position, Linear(0.0, 0.0, {"f_ext": 1.0}), limit, numbers, cells)
    return _linear(u), [_linear(cell) for cell in cells]


def _gain_list(gains: Any) -> list[Any]:
    """A new list of the ``gains``; those of an array as Python floats."""
    return gains.tolist() if isinstance(gains, np.ndarray) else list(gains)


def _any_nonzero(matrix: np.ndarray, axes: int) -> np.ndarray:
    """The entries of a ``matrix`` with that many ``axes`` that are nonzero in any law of the leading axes."""
    return np.any(matrix != 0.0, axis=tuple(range(matrix.ndim - axes)))


def _linear(number: Any) -> Linear:
    return number if isinstance(number, Linear) else Linear(_value(number), number)


def _dense(rows: list[Linear], names: Sequence[Any]) -> np.ndarray:
    """Slopes of the ``rows`` by the ``names``, shape (..., rows, names)."""
    shape = np.broadcast_shapes(*(np.shape(slope) for row in rows for slope in row.slopes.values()), ())
    matrix = np.zeros((*shape, len(rows), len(names)))
    places = {name: place for place, name in enumerate(names)}
    for i, row in enumerate(rows):
        for name, slope in row.slopes.items():
            if name in places:
                matrix[..., i, places[name]] = slope
    return matrix
