"""When an effect is a finding: it gains more than chance, on most of the selecting strokes, and enough to matter.

The healthy reference is the distribution of the gain by chance alone. The whitened residual of a healthy drive is white
noise without the part that a refit of the baseline absorbs. The signatures of all effects at all their starts,
simulated in closed loop, are projected onto resampled noise; the largest gain over all candidates in each resample
gives the distribution of the gain if nothing is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from emps_design.discrepancy import rules
from emps_design.discrepancy.fit import Fit, refit
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import Floor, usual_rms
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.starts import Start

Accept = Callable[[Fit, Fit], bool]  # whether the first fit, with one effect more, is a finding over the second


@dataclass(frozen=True)
class Healthy:
    """Largest gains (n_resamples,) in whitened cost over all candidates, sorted.

    ``searched``: the gains come from simulated healthy records, searched like the measured one.
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
    """The healthy reference of resampled noise, in circular blocks of ``draws`` (m,), and the starts ``screened``."""
    if not screened:  # no candidate, so no gain by chance
        return Healthy(np.zeros(rules.RESAMPLES))
    generator = np.random.default_rng(seed)
    signatures = [start.signature for starts in screened for start in starts]  # orthogonal to the tangent
    halves = [(np.array(signatures[place :: rules.CORES]),) for place in range(min(rules.CORES, len(signatures)))]
    largest, n = np.empty(rules.RESAMPLES), signatures[0].size
    chunk_size = len(signatures)  # the noise then takes no more memory than the signatures
    for start in range(0, rules.RESAMPLES, chunk_size):
        chunk = range(start, min(start + chunk_size, rules.RESAMPLES))
        drawn = [(draws, n, *blocks(draws.size, n, generator)) for _ in chunk]
        noise = np.array(side_by_side(resampled, drawn))
        gains = side_by_side(lambda half, noise=noise: np.max((noise @ half.T) ** 2, axis=1), halves)
        largest[chunk] = np.max(gains, axis=0)
    return Healthy(np.sort(largest))


def blocks(m: int, n: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """First sample of each block for ``n`` samples out of ``m``, and a random sign of each, (n_blocks,) both."""
    count = -(-n // rules.PIECE)
    return generator.integers(0, m, count), generator.choice((-1.0, 1.0), count)


def resampled(draws: np.ndarray, n: int, begins: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """``n`` innovations: the circular blocks of ``draws`` (m,) chosen by :func:`blocks`."""
    windows = sliding_window_view(np.resize(draws, draws.size + rules.PIECE), rules.PIECE)
    return (windows[begins] * signs[:, None]).ravel()[:n]


@dataclass(frozen=True)
class Judge:
    """The acceptance rules with a noise floor and a healthy reference."""

    floor: Floor
    healthy: Healthy

    def accepts(self, better: Fit, worse: Fit) -> bool:
        """Whether ``better``, with one effect more, is a finding over ``worse``."""
        burst, least_gain = self._requirements(worse)
        gain = float(worse.problem.gather(_changes(better, worse, burst), "used").sum())
        return (
            worse.cost_fit - better.cost_fit > self.healthy.threshold
            and gain > least_gain * _cost(worse, "used", burst)
            and _gain_repeats(better, worse, burst)
            and share_of_strokes(better, worse, burst) >= rules.MOST
            and self._negligible(better.model) is None
        )

    def to_beat(self, worse: Fit) -> float:
        """Gain on the fitting part [whitened cost] that an effect added to ``worse`` must exceed."""
        burst, least_gain = self._requirements(worse)
        return max(self.healthy.threshold, least_gain * _cost(worse, "fit", burst))

    def refit(self, hypothesis: Hypothesis) -> Fit:
        """``hypothesis`` fitted to all used samples, without effects whose force is then below the noise."""
        fitted = refit(hypothesis)
        while (index := self._negligible(fitted.model)) is not None:
            fitted = refit(fitted.with_model(fitted.model.without(index)))
        return fitted

    def at_floor(self, fitted: Fit) -> bool:
        """Whether the residual of ``fitted`` is only noise on both parts."""
        parts = ("fit", "select")
        at_floor = (_cost(fitted, part) <= rules.AT_FLOOR * fitted.problem.samples(part) for part in parts)
        return all(at_floor) and not self.leaves_force(fitted)

    def leaves_structure(self, fitted: Fit) -> bool:
        """Whether the residual of ``fitted`` is more than noise."""
        if any(effect.channel == "controller" for effect in fitted.model.effects):
            # Edges of the controller's command are known to one sample, and an error of one sample makes a burst.
            return self.leaves_unexplained(fitted)
        return self._more_than_noise(fitted, np.inf)

    def leaves_unexplained(self, fitted: Fit) -> bool:
        """Whether the residual of ``fitted`` is more than noise if bursts, as those of backlash, have little weight."""
        return self._more_than_noise(fitted, rules.BURST)

    def _more_than_noise(self, fitted: Fit, burst: float) -> bool:
        cost = _cost(fitted, "used", burst)
        return cost > rules.STRUCTURED * fitted.problem.samples("used") or self.leaves_force(fitted)

    def _requirements(self, worse: Fit) -> tuple[float, float]:
        """Deviations at which a sample's cost is capped, and the share of the cost that a finding must gain."""
        if self.at_floor(worse):
            return rules.UNUSUAL, rules.WORTH_AT_FLOOR
        return rules.BURST, rules.WORTH

    def _negligible(self, model: Candidate) -> int | None:
        """Index of the first effect with a force far below the noise, or a negligible dimensionless amplitude."""
        for index, (effect, values) in enumerate(zip(model.effects, model.values, strict=True)):
            least = {"N": rules.SOME * self.floor.force, "": rules.SLIGHT}
            sizes: dict[str, list[float]] = {unit: [] for unit in least}
            for place, parameter in enumerate(effect.parameters):
                if parameter.linear and parameter.unit in sizes:
                    unit = parameter.scale if parameter.unit == "" else 1.0
                    sizes[parameter.unit].append(float(np.abs(values[:, place]).max()) / unit)
            if any(amplitudes and max(amplitudes) < least[unit] for unit, amplitudes in sizes.items()):
                return index
        return None

    def leaves_force(self, fitted: Fit) -> bool:
        """Whether the remaining force exceeds the noise, even if it is white.

        The noise model may itself contain structure: that of the residual it was estimated from, or a drift between
        laps.
        """
        return bool(usual_rms(_remaining_force(fitted)) ** 2 > rules.STRUCTURED * self.floor.force**2)


def share_of_strokes(better: Fit, worse: Fit, burst: float) -> float:
    """Share of the gains in all gains and losses of the selecting strokes, 0 to 1.

    Weighted by size, because a record may have only two selecting strokes; a loss that may be chance is not counted.
    Each sample counts at most ``burst`` standard deviations.
    """
    gains, losses = 0.0, 0.0
    for change, split in zip(_changes(better, worse, burst), better.problem.splits, strict=True):
        for start, stop in split.strokes:
            selected = split.select[start:stop]
            if selected.sum() > rules.START_UP:
                gain = float(change[start:stop][selected].sum())
                gains += max(gain, 0.0)
                losses += max(-gain - rules.CHANCE * np.sqrt(2.0 * selected.sum()), 0.0)
    return gains / (gains + losses) if gains > 0 else 0.0


def force_rms(fitted: Fit) -> float:
    """Rms [N] of measured minus simulated force on the used samples, mean removed as for the floor."""
    return float(np.std(np.concatenate(_remaining_force(fitted))))


def explained(before: float, after: float, floor: float) -> float:
    """Share of the force gap over the floor that is closed: 1 - (after^2 - floor^2)/(before^2 - floor^2).

    >>> explained(5.0, 3.0, 3.0)
    1.0
    """
    excess = before**2 - floor**2
    return 1 - (after**2 - floor**2) / excess if excess > 0 else 0.0


def _capped_squares(fitted: Fit, model: Fit, burst: float) -> tuple[np.ndarray, ...]:
    """Squared innovations (n,) per record, divided by the noise gain of ``model``, at most ``burst``^2.

    Backlash that bounces, an instant that is wrong by one sample, or noise amplified by a saturated loop makes bursts.
    Any effect may reduce these by chance.
    """
    pairs = zip(fitted.innovations, model.noise_gain, strict=True)
    return tuple(np.minimum((innovations / gain) ** 2, burst**2) for innovations, gain in pairs)


def _cost(fitted: Fit, part: str, burst: float = rules.BURST) -> float:
    """Cost of ``fitted`` on ``part``, bursts capped and innovations divided by the noise gain."""
    return float(fitted.problem.gather(_capped_squares(fitted, fitted, burst), part).sum())


def _changes(better: Fit, worse: Fit, burst: float) -> tuple[np.ndarray, ...]:
    """Cost reduction by ``better`` in every sample, (n,) per record."""
    both = zip(_capped_squares(worse, worse, burst), _capped_squares(better, worse, burst), strict=True)
    return tuple(before - after for before, after in both)


def _gain_repeats(better: Fit, worse: Fit, burst: float) -> bool:
    """Whether the gain on the selecting part is as large as that on the fitting part of each record predicts.

    Or as large as the change by ``better`` on the selecting part, which is the gain of a true effect: an effect that
    fades acts less on later strokes.
    """
    gain = expected = change_size = 0.0
    n = better.problem.samples("select")
    changes = _changes(better, worse, burst)
    overall = better.problem.gather(changes, "fit")
    for split, change, after, before, noise_gain in zip(
        better.problem.splits, changes, better.innovations, worse.innovations, worse.noise_gain, strict=True
    ):
        gain += float(change[split.select].sum())
        change_size += float(np.sum(np.minimum(((after - before) / noise_gain)[split.select] ** 2, burst**2)))
        fitted = change[split.fit] if split.fit.any() else overall
        expected += float(fitted.mean()) * int(split.select.sum())
    beyond_chance = gain > rules.CHANCE * np.sqrt(2.0 * n)
    return gain > rules.SOME * (min(expected, change_size) if beyond_chance else expected)


def _remaining_force(fitted: Fit) -> list[np.ndarray]:
    """Measured minus simulated force [N] on the used samples, (n_used,) per record, without simulating again."""
    problem = fitted.problem
    return problem.pick(tuple(map(problem.whitening.undo, fitted.innovations)), "used")
