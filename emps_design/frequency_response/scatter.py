"""How much neighbouring lines of a response differ: what noise does not explain of it is an error all the same.

A response is smooth in frequency, so four lines around each predict it: the cubic through 1/G, which is a straight line
for a mass with viscous friction, or through j w G, which is smooth at an antiresonance; whichever is closer. What
noise of the variances would make of the difference is known. Where the usual difference of many lines is clearly more,
as where dry friction answers with every line at each other one, the excess is taken for noise in the motion: it counts
for more on the lines that move least.
"""

from __future__ import annotations

import numpy as np

AROUND = 20  # lines on either side, whose usual difference counts
CLEARLY = 2.0  # times the variance that noise explains
FEWEST = 12  # lines that tell what is usual
NEIGHBOURS = np.array([-2, -1, 1, 2])


def excess_variance(
    frequency: np.ndarray, response: np.ndarray, variance: np.ndarray, power: np.ndarray, apart: int = 1
) -> np.ndarray:
    """Return the relative variance (n,) of ``response`` (n,) by how its lines differ; 0 where ``variance`` explains it.

    ``frequency`` (n,) ascending, ``variance`` (n,) relative, ``power`` (n,) of the motion in it over that of the same
    disturbance. Lines nearer than ``apart`` share their noise.

    >>> f, random = np.arange(1.0, 101.0), np.random.default_rng(0)
    >>> mass, noise = 1.0 / (3j * f + 5.0), random.standard_normal((2, 100)) / np.sqrt(2.0)
    >>> rough = mass * (1.0 + 0.1 * (noise[0] + 1j * noise[1]))
    >>> found = [excess_variance(f, rough, np.full(100, v), np.ones(100)) for v in (1e-2, 1e-6)]
    >>> float(np.max(found[0])), round(float(np.sqrt(np.median(found[1]))), 2)
    (0.0, 0.08)
    """
    n, offsets = frequency.size, apart * NEIGHBOURS
    if n < FEWEST + 4 * apart:
        return np.zeros(n)
    centre = np.arange(2 * apart, n - 2 * apart)
    near = centre[:, None] + offsets
    place = frequency[near] - frequency[centre, None]
    weight = np.ones(place.shape)
    for j in range(NEIGHBOURS.size):  # of Lagrange's polynomial at the line itself
        for k in range(NEIGHBOURS.size):
            if k != j:
                weight[:, j] *= place[:, k] / (place[:, k] - place[:, j])
    difference = np.full(centre.size, np.inf)
    expected = by_motion = difference
    for even in (1.0 / response, frequency * response):
        shares = weight * even[near] / even[centre, None]
        size = np.abs(np.sum(shares, axis=1) - 1.0) ** 2
        closer = size < difference
        expected, by_motion = (
            np.where(closer, one[centre] + np.sum(np.abs(shares) ** 2 * one[near], axis=1), other)
            for one, other in ((variance, expected), (1.0 / power, by_motion))
        )
        difference = np.where(closer, size, difference)
    usual = _usual(difference / np.maximum(expected, 1e-300))
    excess = np.where(usual > CLEARLY, _usual(difference / by_motion), 0.0)
    return np.interp(np.arange(n), centre, excess) / power


def _usual(ratio: np.ndarray) -> np.ndarray:
    """The mean that the median of the ``ratio`` (m,) of the lines around each belongs to, were it noise."""
    from scipy.ndimage import median_filter

    size = min(2 * AROUND + 1, ratio.size)
    return np.asarray(median_filter(ratio, size, mode="nearest")) / np.log(2.0)
