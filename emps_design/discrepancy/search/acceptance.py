"""What counts as a finding: beyond chance, on strokes the fit has not seen, in most of them, and worth having."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.partition import START_UP
from emps_design.discrepancy.model.problem import Fit, Problem, gather
from emps_design.discrepancy.search.beam_search import Search, refitted
from emps_design.discrepancy.search.noise_floor import Floor, usual_rms
from emps_design.discrepancy.search.null_distribution import Healthy
from emps_design.discrepancy.search.starts import LEAST_AMPLITUDE

WORTH = 0.01  # of the whitened cost: what lowers the residual force by less than half a percent is no finding
WORTH_AT_FLOOR = 0.03  # the same where only noise is left to explain
AUDIBLE = 0.3  # of the floor: amplitudes of force below it are not findings
STROKES = 0.8  # of what the selecting strokes change must be improvement
BURST = 5.0  # standard deviations
BURST_AT_FLOOR = 2.5  # the same where only noise is left to explain: an effect then shows in all samples a little
CHANCE = 2.0  # standard deviations of a stroke's cost
SEEN_AGAIN = 0.3  # of the gain per sample on the fitting part must be there on the selecting part
STRUCTURED = 1.5  # whitened cost per sample beyond which a model leaves structure
AT_FLOOR = 1.2  # whitened cost per sample up to which a model leaves nothing but noise
EXPLAINED = 0.8  # of the excess over the floor, in force, a model must explain to stand where it does not reach it
MOST_EQUIVALENTS = 3


@dataclass(frozen=True)
class Judge:
    """The rules, with the healthy reference and the noise floor they stand on."""

    problem: Problem
    healthy: Healthy
    floor: Floor

    def accepts(self, better: Fit, worse: Fit) -> bool:
        """Whether ``better``, with one effect more, is a finding over ``worse``."""
        burst, worth = self._demands(worse)
        before = [self._bulk(worse, part, burst) for part in ("fit", "select")]
        gain_fit, gain_select = (
            cost - self._bulk(better, part, burst) for cost, part in zip(before, ("fit", "select"), strict=True)
        )
        return (
            worse.cost_fit - better.cost_fit > self.healthy.threshold
            and gain_fit + gain_select > worth * sum(before)
            and self._seen_again(better, worse, burst)
            and self.share_of_strokes(better, worse) >= STROKES
            and self._faint(better.model) is None
        )

    def to_beat(self, worse: Fit) -> float:
        """The gain on the fitting part [whitened cost] beyond which an effect added to ``worse`` is looked at."""
        burst, worth = self._demands(worse)
        return max(self.healthy.threshold, worth * self._bulk(worse, "fit", burst))

    def _demands(self, worse: Fit) -> tuple[float, float]:
        """Deviations at which a sample's cost is cut, and the share of the cost that a finding must be worth."""
        return (BURST_AT_FLOOR, WORTH_AT_FLOOR) if self.at_floor(worse) else (BURST, WORTH)

    def _seen_again(self, better: Fit, worse: Fit, burst: float) -> bool:
        """Whether the selecting part gains what the fitting part of each record leads to expect."""
        gained = expected = 0.0
        for split, better_w, worse_w in zip(self.problem.splits, better.innovations, worse.innovations, strict=True):
            change = np.minimum(worse_w**2, burst**2) - np.minimum(better_w**2, burst**2)
            gained += float(change[split.select].sum())
            expected += float(change[split.fit].mean()) * int(split.select.sum())
        return gained > SEEN_AGAIN * expected

    def refitted(self, model: Candidate) -> Fit:
        """``model`` fitted to all that may be used, without the effects whose force is lost in the noise by then."""
        fitted = refitted(self.problem, model)
        while (faint := self._faint(fitted.model)) is not None:
            fitted = refitted(self.problem, fitted.model.without(faint))
        return fitted

    def _faint(self, model: Candidate) -> int | None:
        """The first effect whose amplitude is a force far below the noise, or a share that is next to none."""
        for index, (effect, values) in enumerate(zip(model.effects, model.values, strict=True)):
            for place, parameter in enumerate(effect.parameters):
                shares = {"N": AUDIBLE * self.floor.force, "": LEAST_AMPLITUDE * parameter.scale}
                if parameter.linear and np.abs(values[:, place]).max() < shares.get(parameter.unit, 0.0):
                    return index
        return None

    def _bulk(self, fitted: Fit, part: str, burst: float = BURST) -> float:
        """Whitened cost on ``part`` in which no sample counts more than ``burst`` deviations.

        Play that bounces, or an instant missed by a sample, leaves bursts that any effect can rearrange by luck; so
        does noise where a saturated loop lets it grow.
        """
        return float(np.sum(np.minimum(gather(self.problem, fitted.innovations, part) ** 2, burst**2)))

    def share_of_strokes(self, better: Fit, worse: Fit) -> float:
        """Share of improvement in what the selecting strokes change: gains over gains and losses, stroke by stroke.

        Weighted, because a record may have two selecting strokes only; a loss within chance is none.
        """
        gains, losses = 0.0, 0.0
        for i, split in enumerate(self.problem.splits):
            change = worse.innovations[i] ** 2 - better.innovations[i] ** 2
            for start, stop in split.strokes:
                seen = split.select[start:stop]
                if seen.sum() > START_UP:
                    gain = float(change[start:stop][seen].sum())
                    gains += max(gain, 0.0)
                    losses += max(-gain - CHANCE * np.sqrt(2.0 * seen.sum()), 0.0)
        return gains / (gains + losses) if gains > 0 else 0.0

    def at_floor(self, fitted: Fit) -> bool:
        """Whether ``fitted`` leaves nothing but noise on both parts."""
        quiet = (self._bulk(fitted, part) <= AT_FLOOR * self.problem.samples(part) for part in ("fit", "select"))
        return all(quiet) and not self._whitened_away(fitted)

    def leaves_structure(self, fitted: Fit) -> bool:
        """Whether ``fitted`` leaves more than noise could be."""
        cost = fitted.cost
        if any(effect.channel == "controller" for effect in fitted.model.effects):
            # The edges of what the controller adds are known to a sample, and a sample missed is a burst.
            cost = self._bulk(fitted, "fit") + self._bulk(fitted, "select")
        return cost > STRUCTURED * self.problem.samples("used") or self._whitened_away(fitted)

    def _whitened_away(self, fitted: Fit) -> bool:
        """Whether the force left shows structure to which the noise's own model may be blind.

        A noise model made of a residual, and not of laps, holds what structure that residual had.
        """
        if self.floor.from_laps:
            return False
        return usual_rms(_left(self.problem, fitted)) ** 2 > STRUCTURED * self.floor.force**2

    def verdict(self, best: Fit, known: Fit, equivalents: dict[str, list[str]], share: float) -> str:
        """The verdict on ``best``, which explains ``share`` of the force gap; ``known`` is what the search began with.

        Where the model leaves structure, what was found stands only if it explains most of the gap.
        """
        if best.model.names == known.model.names:
            if self.leaves_structure(best):
                return "unnamed"
            if not best.model.names:
                return "parameters-only" if self._numbers_off(best) else "nothing-missing"
        elif not self.at_floor(best) and share < EXPLAINED:
            return "unnamed"
        if any(len(names) > MOST_EQUIVALENTS for names in equivalents.values()):
            return "unnamed"
        return "ambiguous" if any(equivalents.values()) else "named"

    def _numbers_off(self, best: Fit) -> bool:
        """Whether the axis file's numbers are off by more than three standard deviations and half a percent."""
        told = self.problem.axis.mechanics.array()
        for place, slot in enumerate(best.slots[:4]):
            off = abs(float(best.model.baseline[place] - told[place]))
            if off > 3 * best.std(-1, slot.place) and off > 0.005 * slot.scale:
                return True
        return False

    def equivalents(self, search: Search) -> dict[str, list[str]]:
        """For each accepted effect, those that could stand in its place as far as these records tell."""
        best = search.best
        found: dict[str, list[str]] = {}
        for name in best.model.names:
            others = frozenset(best.model.names) - {name}
            without = [f.cost for key, f in search.tried.items() if key == others]
            gain = (min(without) if without else search.path[0].cost) - best.cost
            # At the floor chance is the only excuse; above it, what is missing may favour either by a few percent.
            margin = self.healthy.threshold if self.at_floor(best) else max(self.healthy.threshold, 0.03 * gain)
            rivals = [
                (f.cost, next(iter(key - others)))
                for key, f in search.tried.items()
                if len(key) == len(others) + 1 and others < key and name not in key and f.cost <= best.cost + margin
            ]
            found[name] = [rival for _, rival in sorted(rivals)]
        return found


def force_rms(problem: Problem, fitted: Fit) -> float:
    """Rms [N] of measured minus simulated force on the used samples, its mean removed as the floor's is."""
    return float(np.std(np.concatenate(_left(problem, fitted))))


def _left(problem: Problem, fitted: Fit) -> list[np.ndarray]:
    """Measured minus simulated force [N] on the used samples, one array (n_used,) a record, without simulating."""
    forces = map(problem.whitening.undo, fitted.innovations)
    return [force[mask] for force, mask in zip(forces, problem.masks("used"), strict=True)]


def explained(before: float, after: float, floor: float) -> float:
    """Share of the force gap over the floor that is closed: 1 - (after^2 - floor^2)/(before^2 - floor^2).

    >>> explained(5.0, 3.0, 3.0)
    1.0
    """
    excess = before**2 - floor**2
    return 1 - (after**2 - floor**2) / excess if excess > 0 else 0.0
