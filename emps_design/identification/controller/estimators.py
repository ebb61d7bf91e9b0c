"""The velocity estimators that are tried, and the number of one that is sought: its logarithm, within bounds."""

from __future__ import annotations

from functools import cache

import numpy as np

from emps_design.laws.estimators import MOST_POINTS, NUMBERS, Estimator, polynomials

ESTIMATORS = ("backward", "two_tap")
POINTS = (4, 5, 6, 8, 11, 16)  # of slopes that are tried first; 2 and 3 are the named ones
SHARES = np.geomspace(0.006, 0.25, 5)  # of the sampling frequency: corners that are tried first
LOOP = 2.0  # times the corner of a filter: a tracking loop that is late by as much
LEAST_LAG = 0.3  # samples: filters that are faster are none
WITHIN = {"filtered": (1e-4, 0.45), "tracking": (6e-4, 3.0)}  # number times the period
STEP = 1e-4  # of a sought number, for its derivative
UNUSUAL = 2.0 * float(np.log(len(POINTS) + 2 * len(SHARES)))  # of the criterion: half of all drives take a named one

AnyEstimator = str | Estimator


@cache
def with_numbers(period: float) -> tuple[Estimator, ...]:
    """Estimators with a number to start from, at a sampling ``period`` [s].

    >>> [one.number for one in with_numbers(1e-3)][:3]
    [4.0, 5.0, 6.0]
    """
    corners = [float(share) / period for share in SHARES]
    found = [Estimator(kind="slope", points=n) for n in POINTS]
    found += [Estimator(kind="filtered", frequency=corner) for corner in corners]
    found += [Estimator(kind="tracking", bandwidth=LOOP * 2.0 * float(np.pi) * corner) for corner in corners]
    return tuple(found)


def lag(estimator: AnyEstimator, period: float) -> float:
    """Samples that a steady change comes late by, beside those of the backward difference.

    >>> lag("two_tap", 1e-3), round(lag(Estimator(kind="slope", points=4), 1e-3), 9)
    (0.5, 1.0)
    """
    late = [float(np.arange(len(one)) @ np.array(one)) / sum(one) for one in polynomials(estimator, period)]
    return late[0] - late[1]


def rivals_of(own: AnyEstimator, period: float) -> list[AnyEstimator]:
    """What could pass for the estimator ``own``: those with a name, and of each other kind what is as late."""
    late = max(lag(own, period), LEAST_LAG)
    points = round(2.0 * late) + 2
    found: list[AnyEstimator] = [*ESTIMATORS]
    found += [Estimator(kind="slope", points=n) for n in range(points - 1, points + 2) if 4 <= n <= MOST_POINTS]
    found.append(Estimator(kind="filtered", frequency=1.0 / (2.0 * float(np.pi) * late * period)))
    found.append(Estimator(kind="tracking", bandwidth=LOOP / (late * period)))
    kind = own.kind if isinstance(own, Estimator) and sought(own) else ""  # whose number is found by the fit
    return [one for one in found if one != own and not (isinstance(one, Estimator) and one.kind == kind)]


def sought(estimator: AnyEstimator) -> bool:
    """Whether an estimator has a number that is sought: a corner or a bandwidth, no count of points."""
    return isinstance(estimator, Estimator) and estimator.kind in WITHIN


def at_step(estimator: AnyEstimator, step: float, period: float) -> AnyEstimator:
    """``estimator`` with the logarithm of its number changed by ``step``, kept within what it can be."""
    assert isinstance(estimator, Estimator)
    low, high = (bound / period for bound in WITHIN[estimator.kind])
    number = float(np.clip(estimator.number * np.exp(step), low, high))
    return Estimator.model_validate({"kind": estimator.kind, NUMBERS[estimator.kind]: number})


def beside(estimator: AnyEstimator, period: float, ratio: float) -> tuple[AnyEstimator, ...]:
    """The estimators next to one with a number: a point more or less, or the number times and over ``ratio``."""
    if not isinstance(estimator, Estimator):
        return ()
    if estimator.kind == "slope":
        counts = (int(estimator.number) + more for more in (-1, 1))
        return tuple(Estimator(kind="slope", points=n) for n in counts if 4 <= n <= MOST_POINTS)
    step = float(np.log(ratio))
    return tuple(at_step(estimator, sign * step, period) for sign in (-1.0, 1.0))


def could_pass_for(own: AnyEstimator) -> list[AnyEstimator]:
    """The named estimators, ``own``, and a slope of a point more or less: for a reference half a period late."""
    more = beside(own, 1.0, 1.0) if not sought(own) else ()
    return list(dict.fromkeys((*ESTIMATORS, own, *more)))


def table_of(estimator: AnyEstimator, number: float | None = None) -> str | dict[str, object]:
    """The estimator as in an axis file, with another ``number`` where one is given."""
    if isinstance(estimator, str):
        return estimator
    table = estimator.model_dump(exclude_none=True)
    return table if number is None else {**table, NUMBERS[estimator.kind]: number}
