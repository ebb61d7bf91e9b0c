"""What counts as a finding: beyond chance, on strokes the fit has not seen, in most of them, and worth having."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.fit import Fit, refitted
from emps_design.discrepancy.model.partition import START_UP
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.noise_floor import Floor, usual_rms
from emps_design.discrepancy.search.null_distribution import Healthy


@dataclass(frozen=True)
class Judge:
    """The rules applied to a noise floor and a healthy reference."""

    floor: Floor
    healthy: Healthy

    def accepts(self, better: Fit, worse: Fit) -> bool:
        """Whether ``better``, with one effect more, is a finding over ``worse``."""
        burst, worth = self._demands(worse)
        before = [_bulk(worse, part, burst) for part in ("fit", "select")]
        gain_fit, gain_select = (
            cost - _bulk(better, part, burst) for cost, part in zip(before, ("fit", "select"), strict=True)
        )
        return (
            worse.cost_fit - better.cost_fit > self.healthy.threshold
            and gain_fit + gain_select > worth * sum(before)
            and _seen_again(better, worse, burst)
            and share_of_strokes(better, worse, burst) >= rules.STROKES
            and self._faint(better.model) is None
        )

    def to_beat(self, worse: Fit) -> float:
        """The gain on the fitting part [whitened cost] beyond which an effect added to ``worse`` is looked at."""
        burst, worth = self._demands(worse)
        return max(self.healthy.threshold, worth * _bulk(worse, "fit", burst))

    def refitted(self, hypothesis: Hypothesis) -> Fit:
        """A model fitted to all that may be used, without the effects whose force is lost in the noise by then."""
        fitted = refitted(hypothesis)
        while (faint := self._faint(fitted.model)) is not None:
            fitted = refitted(fitted.with_model(fitted.model.without(faint)))
        return fitted

    def at_floor(self, fitted: Fit) -> bool:
        """Whether ``fitted`` leaves nothing but noise on both parts."""
        parts = ("fit", "select")
        quiet = (_bulk(fitted, part) <= rules.AT_FLOOR * fitted.problem.samples(part) for part in parts)
        return all(quiet) and not self.leaves_force(fitted)

    def leaves_structure(self, fitted: Fit) -> bool:
        """Whether ``fitted`` leaves more than noise could be."""
        if any(effect.channel == "controller" for effect in fitted.model.effects):
            # The edges of what the controller adds are known to a sample, and a sample missed is a burst.
            return self.leaves_unexplained(fitted)
        return self._more_than_noise(fitted, fitted.cost)

    def leaves_unexplained(self, fitted: Fit) -> bool:
        """Whether ``fitted`` leaves more than noise could be even where bursts count little, as of play."""
        return self._more_than_noise(fitted, _bulk(fitted, "fit") + _bulk(fitted, "select"))

    def _more_than_noise(self, fitted: Fit, cost: float) -> bool:
        return cost > rules.STRUCTURED * fitted.problem.samples("used") or self.leaves_force(fitted)

    def _demands(self, worse: Fit) -> tuple[float, float]:
        """Deviations at which a sample's cost is cut, and the share of the cost that a finding must be worth."""
        if self.at_floor(worse):
            return rules.BURST_AT_FLOOR, rules.WORTH_AT_FLOOR
        return rules.BURST, rules.WORTH

    def _faint(self, model: Candidate) -> int | None:
        """The first effect whose amplitude is a force far below the noise, or a share that is next to none."""
        for index, (effect, values) in enumerate(zip(model.effects, model.values, strict=True)):
            least = {"N": rules.AUDIBLE * self.floor.force, "": rules.LEAST_AMPLITUDE}
            sizes: dict[str, list[float]] = {unit: [] for unit in least}
            for place, parameter in enumerate(effect.parameters):
                if parameter.linear and parameter.unit in sizes:
                    unit = parameter.scale if parameter.unit == "" else 1.0
                    sizes[parameter.unit].append(float(np.abs(values[:, place]).max()) / unit)
            if any(found and max(found) < least[unit] for unit, found in sizes.items()):
                return index
        return None

    def leaves_force(self, fitted: Fit) -> bool:
        """Whether the force left is more than noise, however it looks once it is whitened.

        The noise's own model may hold structure: that of the residual it was made of, or, where a drift makes laps
        differ, the drift's.
        """
        return bool(usual_rms(_force_left(fitted)) ** 2 > rules.STRUCTURED * self.floor.force**2)


def share_of_strokes(better: Fit, worse: Fit, burst: float) -> float:
    """Share of improvement in what the selecting strokes change: gains over gains and losses, stroke by stroke.

    Weighted, because a record may have two selecting strokes only; a loss within chance is none. No sample counts more
    than ``burst`` deviations.
    """
    gains, losses = 0.0, 0.0
    for i, split in enumerate(better.problem.splits):
        change = np.minimum(worse.innovations[i] ** 2, burst**2) - np.minimum(better.innovations[i] ** 2, burst**2)
        for start, stop in split.strokes:
            seen = split.select[start:stop]
            if seen.sum() > START_UP:
                gain = float(change[start:stop][seen].sum())
                gains += max(gain, 0.0)
                losses += max(-gain - rules.CHANCE * np.sqrt(2.0 * seen.sum()), 0.0)
    return gains / (gains + losses) if gains > 0 else 0.0


def force_rms(fitted: Fit) -> float:
    """Rms [N] of measured minus simulated force on the used samples, its mean removed as the floor's is."""
    return float(np.std(np.concatenate(_force_left(fitted))))


def explained(before: float, after: float, floor: float) -> float:
    """Share of the force gap over the floor that is closed: 1 - (after^2 - floor^2)/(before^2 - floor^2).

    >>> explained(5.0, 3.0, 3.0)
    1.0
    """
    excess = before**2 - floor**2
    return 1 - (after**2 - floor**2) / excess if excess > 0 else 0.0


def _bulk(fitted: Fit, part: str, burst: float = rules.BURST) -> float:
    """Whitened cost on ``part`` in which no sample counts more than ``burst`` deviations.

    Play that bounces, or an instant missed by a sample, leaves bursts that any effect can rearrange by luck; so
    does noise where a saturated loop lets it grow.
    """
    return float(np.sum(np.minimum(fitted.residual(part) ** 2, burst**2)))


def _seen_again(better: Fit, worse: Fit, burst: float) -> bool:
    """Whether the selecting part gains what the fitting part of each record, or of all, leads to expect.

    Or what ``better`` changes there, which is what a true effect gains: one that fades acts less on later strokes.
    """
    gained = expected = moved = 0.0
    n = better.problem.samples("select")
    pairs = zip(better.innovations, worse.innovations, strict=True)
    changes = tuple(np.minimum(worse**2, burst**2) - np.minimum(better**2, burst**2) for better, worse in pairs)
    overall = better.problem.gather(changes, "fit")
    for split, change, after, before in zip(
        better.problem.splits, changes, better.innovations, worse.innovations, strict=True
    ):
        gained += float(change[split.select].sum())
        moved += float(np.sum(np.minimum((after - before)[split.select] ** 2, burst**2)))
        fitted = change[split.fit] if split.fit.any() else overall
        expected += float(fitted.mean()) * int(split.select.sum())
    beyond_chance = gained > rules.CHANCE * np.sqrt(2.0 * n)
    return gained > rules.SEEN_AGAIN * (min(expected, moved) if beyond_chance else expected)


def _force_left(fitted: Fit) -> list[np.ndarray]:
    """Measured minus simulated force [N] on the used samples, (n_used,) per record, without simulating again."""
    problem = fitted.problem
    return problem.pick(tuple(map(problem.whitening.undo, fitted.innovations)), "used")
