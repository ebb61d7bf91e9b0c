"""What chance alone does to the search: the healthy reference that a finding must beat.

In the whitened residual a healthy drive is white noise less what refitting the baseline absorbs. The signatures of all
effects at all their starts, simulated in closed loop with their states, are laid over resampled noise: the largest
gain over all candidates, in each of many resamples, is what "nothing is missing" looks like.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.parallel import CORES, side_by_side
from emps_design.discrepancy.search.starts import Start

RESAMPLES = 199
TOGETHER = 50  # of them, laid over the signatures at a time: these are many megabytes to read
BLOCK = 250  # samples of noise kept together, so that what correlation the whitening left stays in


@dataclass(frozen=True)
class Healthy:
    """Largest gains (n_resamples,) in whitened cost over all candidates, sorted.

    ``searched``: each is that of a whole simulated record, searched like the real one.
    """

    largest: np.ndarray
    searched: bool = False

    @property
    def threshold(self) -> float:
        """The gain that a share ``rules.LEVEL`` of healthy records reaches [whitened cost]."""
        rank = int(np.ceil((1 - rules.LEVEL) * (self.largest.size + 1)))
        return float(self.largest[min(rank, self.largest.size) - 1])

    def p_value(self, gain: float) -> float:
        """Share of healthy records, this one included, whose largest gain is at least ``gain``.

        >>> healthy = Healthy(np.array([1.0, 2.0, 3.0]))
        >>> healthy.p_value(2.0), healthy.p_value(5.0)
        (0.75, 0.25)
        """
        return float((1 + np.sum(self.largest >= gain)) / (1 + self.largest.size))


def healthy_reference(screened: list[list[Start]], draws: np.ndarray, seed: int) -> Healthy:
    """Lay the signatures of ``screened`` over resampled noise ``draws`` (m,), circular blocks of it."""
    if not screened:  # nothing was tried, so nothing can be gained by chance
        return Healthy(np.zeros(RESAMPLES))
    generator = np.random.default_rng(seed)
    signatures = [start.signature for found in screened for start in found]  # free of what is absorbed
    halves = [(np.array(signatures[place::CORES]),) for place in range(min(CORES, len(signatures)))]
    largest, n = np.empty(RESAMPLES), signatures[0].size
    for start in range(0, RESAMPLES, TOGETHER):
        some = range(start, min(start + TOGETHER, RESAMPLES))
        drawn = [(draws, n, *blocks(draws.size, n, generator)) for _ in some]
        noise = np.array(side_by_side(resampled, drawn))
        gains = side_by_side(lambda half, noise=noise: np.max((noise @ half.T) ** 2, axis=1), halves)
        largest[some] = np.max(gains, axis=0)
    return Healthy(np.sort(largest))


def blocks(m: int, n: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Where the blocks of ``n`` samples out of ``m`` begin, and a random sign of each."""
    count = -(-n // BLOCK)
    return generator.integers(0, m, count), generator.choice((-1.0, 1.0), count)


def resampled(draws: np.ndarray, n: int, begins: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """``n`` innovations in circular blocks of ``draws`` (m,), as :func:`blocks` drew them."""
    rings = sliding_window_view(np.concatenate((draws, draws[:BLOCK])), BLOCK)
    return (rings[begins] * signs[:, None]).ravel()[:n]
