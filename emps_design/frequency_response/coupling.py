"""One, two or three masses behind one another, fitted to a measured response, with intervals.

Without damping Z_1 of :mod:`.mass_chain` is M s times a product of (1 + s^2/p^2)/(1 + s^2/z^2), antiresonances z and
resonances p in turn, and a continued fraction leads from these back to masses and springs (W. Cauer, 1926): they are
where a fit starts, at what :mod:`.resonances` finds and at some places besides; the delay starts at what the phase
turns by. The logarithm of model over measurement is weighed by the deviations of the data. Another mass is taken where
the information criterion of Schwarz (1978) asks for it clearly, its resonance lies among the lines, and the deviations
leave no doubt about its spring and its mass. The deviations are raised where the residuals are larger than those of
the data explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from emps_design.errors import InputError
from emps_design.frequency_response.mass_chain import MassChain as MassChain
from emps_design.frequency_response.mass_chain import chain_response, natural, split
from emps_design.frequency_response.phase import turning_delay
from emps_design.frequency_response.resonances import resonances
from emps_design.frequency_response.response import FrequencyResponse

MOST = 3  # masses
SYSTEMATIC = 1e-3  # relative, what a model may differ from a response by
CLEARLY = 10.0  # by which the criterion has to fall for one more mass
CERTAIN = 0.25  # relative deviation of the spring and the mass from which on they are not known
INSIDE = 0.95  # share of the highest line below which a resonance has to lie
UNKNOWN = 100.0  # deviation of the logarithm of what has no part in the response
STARTS = 6  # places besides the resonances found
MANY = 400  # lines that a fit takes, evenly among more
NEAR = 4  # lines on either side, whose deviations tell what a line's own one should be
ALIKE = 2.0  # factor within which they do
FIRST_STEPS, MOST_STEPS = 30, 200  # of a fit: from every start, and of the best among them
SMALL = np.finfo(float).eps ** 0.5  # step of a parameter for its slope
APART = 1.15  # of a resonance to its antiresonance, where a fit starts without knowing


def fit_chain(response: FrequencyResponse, most: int = MOST) -> MassChain:
    """Return the chain of one up to ``most`` masses that ``response`` asks for.

    Raises :class:`InputError` for fewer lines than parameters.

    >>> f = np.arange(3.0, 120.0)
    >>> two = MassChain(np.array([60.0, 40.0]), np.array([4e6]), np.array([500.0]), 200.0, 0.0, np.eye(6), 0.0)
    >>> found = fit_chain(FrequencyResponse.of(f, two.response(2.0 * np.pi * f), np.full(f.size, 0.01)))
    >>> {name: round(value, 3) for name, (value, _, _) in found.parameters.items() if name != "delay"}
    {'mass': 100.0, 'viscous': 200.0, 'frequency': 64.975, 'damping': 0.026, 'share': 0.4}
    """
    response = response.every(-(-len(response) // MANY))
    mass = np.array([1.0 / np.median(response.w * response.magnitude)])
    tried = _fitted(response, [(mass, (), ())], turning_delay(response))
    if tried is None:
        raise InputError(f"{response.name}: found {len(response)} lines, expected more than a mass has parameters")
    best, criterion = tried, [_criterion(tried, len(response))]
    lowest = criterion[0]
    for _ in range(1, most):  # a second mass may show only together with a third: each number is tried
        tried = _fitted(response, _starts(tried, response), tried.delay)
        if tried is None:
            break
        criterion.append(_criterion(tried, len(response)))
        if criterion[-1] < lowest - CLEARLY and _certain(tried, response):
            best, lowest = tried, criterion[-1]
    return replace(best, criterion=tuple(criterion))


def _starts(chain: MassChain, response: FrequencyResponse) -> list[tuple[np.ndarray, Any, Any]]:
    """Chains of one mass more: with the pairs of ``chain``, and one more where the response may have it."""
    n = chain.masses.size
    own = list(zip(natural(chain.theta, n, 1), natural(chain.theta, n, 0), strict=True)) if n > 1 else []
    roots = resonances(response)
    pairs = [
        (low.frequency, high.frequency)
        for low, high in pairwise(roots)
        if (low.kind, high.kind) == ("antiresonance", "resonance")
    ]
    places = np.geomspace(response.frequency[0], response.frequency[-1], STARTS + 2)[1:-1]
    pairs += [(float(f), APART * float(f)) for f in places]
    several = [[*own, pair] for pair in pairs]
    several.append(pairs[: len(pairs) - STARTS])  # all that were found, where they are as many
    return [
        _cauer(float(np.sum(chain.masses)), in_turn)
        for in_turn in map(sorted, several)
        if len(in_turn) == n and all(low[1] < high[0] for low, high in pairwise(in_turn))
    ]


def _cauer(total: float, pairs: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, springs and light dampers of the chain with these antiresonances and resonances [Hz].

    >>> masses, springs, _ = _cauer(100.0, [(30.0, 50.0)])
    >>> masses.round(6).tolist(), round(float(springs[0] / masses[1]) ** 0.5 / (2.0 * np.pi), 6)
    ([36.0, 64.0], 30.0)
    """
    z, p = ((2.0 * np.pi * np.array(side)) ** 2 for side in zip(*pairs, strict=True))
    above, below = total * np.prod(z / p) * np.poly(-p), np.poly(-z)
    masses, springs = [], []
    while below.size > 1:
        masses.append(above[0] / below[0])
        rest = (above - masses[-1] * below)[1:]
        springs.append(rest[0] / below[0])
        above, below = rest, (below - np.append(rest, 0.0) / springs[-1])[1:]
    masses.append(above[0] / below[0])
    dampers = 0.05 * np.array(springs) / np.sqrt(p)
    return np.array(masses), np.array(springs), dampers


def _fitted(response: FrequencyResponse, starts: Sequence[tuple[Any, Any, Any]], delay: float) -> MassChain | None:
    """The best fit from several starts, ``delay`` [s] late; None where no start is one, or the lines are too few."""
    from scipy.optimize import least_squares

    s = 1j * response.w
    weight = np.sqrt(2.0) / np.hypot(_expected(response.std), SYSTEMATIC)
    best: Any = None
    for masses, springs, dampers in starts:
        n = len(masses)
        values = np.concatenate([masses, springs, dampers])
        if 2 * len(response) <= values.size + 2 or np.any(values <= 0.0):
            continue
        scale = np.concatenate([np.ones(values.size), [float(np.sum(masses)) * response.w[0], 1.0 / response.w[-1]]])

        def residual(x: np.ndarray, n: int = n, scale: np.ndarray = scale) -> np.ndarray:
            gap = np.log(chain_response(x * scale, n, s) / response.response) * weight
            return np.concatenate([gap.real, gap.imag], axis=-1)

        def slopes(x: np.ndarray, residual: Callable[..., np.ndarray] = residual) -> np.ndarray:
            step = SMALL * np.maximum(np.abs(x), 1.0)  # of all parameters at once
            return (residual(x + np.diag(step)) - residual(x)).T / step

        start = np.concatenate([np.log(values), [0.0, delay / scale[-1]]])
        found = least_squares(residual, start, slopes, x_scale="jac", max_nfev=FIRST_STEPS)
        if best is None or found.cost < best[0].cost:
            best = found, residual, slopes, scale, n
    if best is None:
        return None
    found, residual, slopes, scale, n = best
    if found.status == 0:  # not at an end yet
        found = least_squares(residual, found.x, slopes, x_scale="jac", max_nfev=MOST_STEPS)
    theta, count = found.x * scale, 2 * len(response)
    misfit = float(np.sqrt(2.0 * found.cost / (count - theta.size)))
    jacobian = found.jac / scale
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    seen = size > 1e-9 * weight.min()  # a damper that went to nothing is not
    inverse = np.linalg.pinv(jacobian[:, seen] / size[seen]) / size[seen, None]
    covariance = np.diag(np.where(seen, 0.0, UNKNOWN**2))
    covariance[np.ix_(seen, seen)] = max(1.0, misfit) ** 2 * (inverse @ inverse.T)
    hardly = np.diag(covariance) > UNKNOWN**2
    hardly[-2:] = False  # which are no logarithms
    covariance[hardly] = covariance[:, hardly] = 0.0
    covariance[hardly, hardly] = UNKNOWN**2
    return MassChain(*split(theta, n), float(theta[-2]), float(theta[-1]), covariance, misfit)


def _expected(std: np.ndarray) -> np.ndarray:
    """Deviations (n,) that know less of each line's own noise: the median of those beside it, where they are alike.

    A line that is too large by chance has too small a deviation relative to it, and with that weight it would make the
    masses too small.
    """
    near = np.clip(np.arange(std.size)[:, None] + np.arange(-NEAR, NEAR + 1), 0, std.size - 1)
    return np.clip(np.median(std[near], axis=1), std / ALIKE, std * ALIKE)


def _criterion(chain: MassChain, lines: int) -> float:
    """The information criterion of Schwarz, the scale of the deviations unknown."""
    count, parameters = 2 * lines, chain.theta.size
    return count * math.log(max(chain.misfit, 1e-3) ** 2 * (count - parameters) / count) + parameters * math.log(count)


def _certain(chain: MassChain, response: FrequencyResponse) -> bool:
    """Whether all masses and springs are known, and all resonances lie among the lines."""
    n = chain.masses.size
    known = np.sqrt(np.diag(chain.covariance))[: 2 * n - 1]
    places = natural(chain.theta, n, 0)
    low, high = response.frequency[0], INSIDE * response.frequency[-1]
    return bool(np.all(known < CERTAIN) and np.all(places > low) and np.all(places < high))
