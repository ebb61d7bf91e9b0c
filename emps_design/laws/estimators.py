"""Velocity estimators of a law: a linear filter ``E(z)`` of the backward difference of the encoder position.

    v = E(z) (q[k] - q[k-1]) / T,    E(z) = (b0 + b1 z^-1 + ...) / (1 + a1 z^-1 + ...),    E(1) = 1

    "backward"                          1
    "two_tap"                           (1 + z^-1) / 2
    slope, ``points`` n                 b_i = 6 (i + 1) (n - 1 - i) / (n (n^2 - 1)), i from 0 to n - 2
    filtered, ``frequency``             w0 / (s + w0), w0 = 2 pi frequency, by the bilinear transform without prewarping
    tracking, ``bandwidth`` w           ((1 - p) / (1 - p z^-1))^2, p = exp(-w T)

The slope is that of the least-squares line through the last n positions: 2 points are the backward difference, 3 are
two_tap. The tracking loop is a phase-locked loop: it predicts ``x + T v`` and, with the prediction error e, adds
``(1 - p^2) e`` to the position x and ``(1 - p)^2 e / T`` to the velocity v. Both poles are then at the bandwidth; for
small w T the gains are 2 w T and w^2 T. A kernel stores the states of the filter after its own memory, in transposed
direct form; at rest they are 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, ValidationError, model_validator

from emps_design.errors import InputError
from emps_design.tables import AxisTable, Positive, parameter

TWO_TAP: Final = "two_tap"
BACKWARD: Final = "backward"
NAMED: dict[str, tuple[float, ...]] = {TWO_TAP: (0.5, 0.5), BACKWARD: (1.0,)}  # b; no poles
MOST_POINTS = 64
NUMBERS = {"slope": "points", "filtered": "frequency", "tracking": "bandwidth"}  # the one number of each kind
EXPECTED = (
    'two_tap, backward, { kind = "slope", points = n }, { kind = "filtered", frequency = Hz } or '
    '{ kind = "tracking", bandwidth = rad/s }'
)
NAME, TABLE = "a name", "a table of its own"  # tags of the union; blanks separate them from table keys


class Estimator(AxisTable):
    """An estimator with a number: the slope of some points, a filtered difference, or a tracking loop."""

    kind: Literal["slope", "filtered", "tracking"] = parameter(
        "slope: of the last points by least squares; filtered: backward difference, then a low-pass; tracking: a "
        "phase-locked loop",
        "",
    )
    points: Annotated[int, Field(ge=2, le=MOST_POINTS, strict=True)] | None = parameter(
        "number of positions for the slope", "samples", None
    )
    frequency: Positive | None = parameter("corner of the low-pass after the difference", "Hz", None)
    bandwidth: Positive | None = parameter("both poles of the tracking loop", "rad/s", None)

    @model_validator(mode="after")
    def _complete(self) -> Estimator:
        for kind, name in NUMBERS.items():
            if (getattr(self, name) is None) == (self.kind == kind):
                expected = f"a number: {kind} has {name}" if self.kind == kind else f"no {name} of {self.kind}"
                raise ValueError(f"{name}: found {getattr(self, name)}, expected {expected}")
        return self

    @property
    def number(self) -> float:
        """The points, the frequency [Hz] or the bandwidth [rad/s]."""
        return float(getattr(self, NUMBERS[self.kind]))


def _check_name(name: Any) -> Any:
    if not (isinstance(name, str) and name in NAMED):
        raise ValueError(f"found {name!r:.60}, expected {EXPECTED}")
    return name


VelocityEstimator = Annotated[
    Annotated[Literal["two_tap", "backward"], BeforeValidator(_check_name), Tag(NAME)]
    | Annotated[Estimator, Tag(TABLE)],
    Discriminator(lambda estimator: TABLE if isinstance(estimator, dict | Estimator) else NAME),
]
WORDS = "velocity from the position: two-tap average and backward difference, backward difference alone, or a table"

KnownEstimator = str | Estimator
AnyEstimator = KnownEstimator | Mapping[str, Any]  # or as plain data


def estimator_of(estimator: AnyEstimator) -> KnownEstimator:
    """The estimator with this name or table (plain data); an :class:`Estimator` is returned unchanged.

    Raises :class:`InputError` for any other value.

    >>> estimator_of({"kind": "slope", "points": 4}).number, estimator_of("backward")
    (4.0, 'backward')
    """
    if isinstance(estimator, Estimator) or (isinstance(estimator, str) and estimator in NAMED):
        return estimator
    try:
        if isinstance(estimator, Mapping):
            return Estimator.model_validate(dict(estimator))
        _check_name(estimator)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        place = ".".join(["velocity_estimator", *map(str, problem["loc"])])
        raise InputError(f"{place}: {problem['msg'].removeprefix('Value error, ')}; expected {EXPECTED}") from error
    except ValueError as error:
        raise InputError(f"velocity estimator: {error}") from error
    raise AssertionError(estimator)


def polynomials(estimator: AnyEstimator, period: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """``b`` and ``a`` of E(z) in powers of 1/z, of equal length, at a sampling ``period`` [s].

    >>> polynomials({"kind": "slope", "points": 4}, 1e-3)
    ((0.3, 0.4, 0.3), (1.0, 0.0, 0.0))
    """
    estimator = estimator_of(estimator)
    if isinstance(estimator, str):
        return NAMED[estimator], (1.0,) + (0.0,) * (len(NAMED[estimator]) - 1)
    if estimator.kind == "slope":
        n = int(estimator.number)
        b = tuple(6.0 * (i + 1) * (n - 1 - i) / (n * (n * n - 1)) for i in range(n - 1))
        return b, (1.0,) + (0.0,) * (n - 2)
    if estimator.kind == "filtered":
        c = math.pi * estimator.number * period  # w0 T / 2
        return (c / (1.0 + c), c / (1.0 + c)), (1.0, (c - 1.0) / (1.0 + c))
    p = math.exp(-estimator.number * period)
    return (math.expm1(-estimator.number * period) ** 2, 0.0, 0.0), (1.0, -2.0 * p, p * p)


def estimator_response(estimator: AnyEstimator, w: np.ndarray, period: float) -> np.ndarray:
    """Frequency response E(z) at ``w`` [rad/s], in the shape of ``w``.

    >>> w = np.array([100.0])
    >>> abs(estimator_response("two_tap", w, 1e-3)).round(6).tolist()
    [0.99875]
    """
    return estimator_at(estimator, np.exp(-1j * np.asarray(w) * period), period)


def estimator_at(estimator: AnyEstimator, back: np.ndarray, period: float) -> np.ndarray:
    """E(z) at 1/z = ``back``, in the shape of ``back``.

    >>> estimator_at("two_tap", np.array([1.0, -1.0]), 1e-3).tolist()
    [1.0, 0.0]
    """
    b, a = polynomials(estimator, period)
    return np.polyval(b[::-1], back) / np.polyval(a[::-1], back)


def continuous(estimator: AnyEstimator) -> tuple[list[float], list[float]]:
    """Numerator and denominator in s [1/s], highest power first, of the limit of E(z) for infinitely fast sampling.

    >>> continuous({"kind": "tracking", "bandwidth": 100.0})
    ([10000.0], [1.0, 200.0, 10000.0])
    """
    estimator = estimator_of(estimator)
    if isinstance(estimator, str) or estimator.kind == "slope":
        return [1.0], [1.0]
    w = 2.0 * math.pi * estimator.number if estimator.kind == "filtered" else estimator.number
    return ([w], [1.0, w]) if estimator.kind == "filtered" else ([w * w], [1.0, 2.0 * w, w * w])


def taps(estimator: AnyEstimator) -> float:
    """Code of the estimator in a kernel's gains: 1 two_tap, 0 backward, minus the order of any other."""
    estimator = estimator_of(estimator)
    if isinstance(estimator, str):
        return float(estimator == TWO_TAP)
    return float(1 - len(polynomials(estimator, 1.0)[0]))


def coefficients(estimator: AnyEstimator, period: float) -> tuple[float, ...]:
    """Coefficients in a kernel's gains, b0 to bn, then a1 to an; none if :func:`taps` is not negative."""
    if not taps(estimator) < 0.0:
        return ()
    b, a = polynomials(estimator, period)
    return (*b, *a[1:])


def states(order: float) -> int:
    """Cells of a kernel's memory for an estimator of that ``order``, as :func:`taps` codes it."""
    return 1 - int(order) if order < 0.0 else 0


def forgets(estimator: AnyEstimator) -> float:
    """Periods after which the estimate is 0 once the carriage is at rest; inf if it only decays."""
    b, a = polynomials(estimator, 1.0)
    return math.inf if any(a[1:]) else float(len(b))


def in_words(estimator: AnyEstimator, period: float) -> str:
    """The estimate as a line to paste.

    >>> in_words({"kind": "slope", "points": 4}, 1e-3)
    'v[k] = (0.3 * q[k] + 0.1 * q[k-1] - 0.1 * q[k-2] - 0.3 * q[k-3]) / 0.001'
    >>> in_words({"kind": "filtered", "frequency": 50.0}, 1e-3)
    'v[k] = (0.1357552482 * q[k] - 0.1357552482 * q[k-2]) / 0.001 + 0.7284895037 * v[k-1]'
    """
    estimator = estimator_of(estimator)
    if isinstance(estimator, str):
        two_tap = estimator == TWO_TAP
        return f"v[k] = (q[k] - q[{'k-2' if two_tap else 'k-1'}]) / {2.0 * period if two_tap else period:.10g}"
    b, a = polynomials(estimator, period)
    by_position, before = np.convolve(b, [1.0, -1.0]), -np.array(a[1:])
    sum_of_q = _sum(by_position, "q", 0)
    past = _sum(before, "v", 1)
    return f"v[k] = ({sum_of_q}) / {period:.10g}" + (f" + {past}" if past else "").replace("+ -", "- ")


def estimator_in_words(estimator: AnyEstimator) -> str:
    """The estimator in a few words.

    >>> estimator_in_words({"kind": "filtered", "frequency": 50.0}), estimator_in_words("two_tap")
    ('difference filtered at 50 Hz', 'two-tap')
    """
    estimator = estimator_of(estimator)
    if isinstance(estimator, str):
        return estimator.replace("_", "-")
    texts = {"slope": "slope of {:.0f} points", "filtered": "difference filtered at {:.4g} Hz"}
    return texts.get(estimator.kind, "tracking loop of {:.4g} rad/s").format(estimator.number)


def _sum(factors: np.ndarray, name: str, first: int) -> str:
    terms = []
    for i, factor in enumerate(factors, first):
        if abs(factor) > 1e-15:
            terms.append(f"{factor:.10g} * {name}[{f'k-{i}' if i else 'k'}]")
    return " + ".join(terms).replace("+ -", "- ")
