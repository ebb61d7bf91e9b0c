"""A hypothesis fitted to its records in closed loop, what its numbers do, and whether they still mean what they say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.least_squares import WORST, Candidate, Slot, bounded, descend, descend_rough
from emps_design.discrepancy.noise_floor import PIECE
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.effects import Motion, kind_of
from emps_design.effects.two_mass import GAP, has_play
from emps_design.errors import SimulationError
from emps_design.records import Record

NOISES = 3  # that are put on the simulated carriage
STEP = 1e-3  # finite difference of a sensitivity, in magnitudes of the number


@dataclass(frozen=True)
class Fit(Hypothesis):
    """A fitted model: its whitened residuals, and the covariance (k, k) of the numbers in ``slots``.

    ``surveyed`` says that surfaces through its neighbourhood, as :func:`play_anew` lays them, lead nowhere better.
    """

    slots: tuple[Slot, ...]
    covariance: np.ndarray
    innovations: tuple[np.ndarray, ...]
    cost_fit: float
    cost_select: float
    surveyed: bool = False

    @property
    def cost(self) -> float:
        """Sum of squared innovations over fitting and selecting samples."""
        return self.cost_fit + self.cost_select

    @property
    def criterion(self) -> float:
        """The cost and what its numbers gain by chance (Bayesian information criterion, known noise)."""
        return self.cost + len(self.model.slots()) * float(np.log(self.problem.samples("used")))

    def whitened(self) -> tuple[np.ndarray, ...]:
        """The innovations, one array (n,) per record."""
        return self.innovations or super().whitened()  # which says why the model cannot be simulated

    @cached_property
    def loudness(self) -> tuple[np.ndarray, ...]:
        """How large the noise gets in the innovations, where that is more than its own size, else 1; (n,) per record.

        At a motor's limit, or in play, a loop may let noise grow into bursts of which every one is another. Noise on
        the simulated carriage tells when.
        """
        from scipy.ndimage import uniform_filter1d

        quiet = self.whitened()
        disturbed = side_by_side(self._disturbed, [(seed,) for seed in range(NOISES)])
        grown = [
            np.mean([(one - other) ** 2 for one in ones], axis=0)
            for *ones, other in zip(*disturbed, quiet, strict=True)
        ]
        return tuple(np.sqrt(np.maximum(uniform_filter1d(square, min(PIECE, square.size)), 1.0)) for square in grown)

    def _disturbed(self, seed: int) -> tuple[np.ndarray, ...]:
        """The innovations with more noise on the carriage; where the model cannot run with it, those without."""
        try:
            return self.problem.whiten(self.residuals(self.problem.noise(seed)))
        except SimulationError:
            return self.whitened()

    def std(self, effect: int, place: int, record: int = 0) -> float:
        """Standard deviation of one number; 0 where it was not free."""
        for i, slot in enumerate(self.slots):
            if slot.effect == effect and slot.place == place and slot.record in (None, record):
                return float(np.sqrt(max(self.covariance[i, i], 0.0)))
        return 0.0


def fit(start: Hypothesis, part: str = "fit", slots: tuple[Slot, ...] | None = None, steps: int = 12) -> Fit:
    """Fit ``start`` to the closed-loop force on the samples of ``part``; ``slots`` (default: all) says what is free."""
    slots = start.model.slots() if slots is None else slots

    def residual(model: Candidate) -> np.ndarray:
        return (start if model is start.model else start.with_model(model)).residual(part)  # a fit knows its own

    found = descend(start.model, slots, residual, steps)
    return evaluate(start.with_model(found.model), slots, found.covariance)


def evaluate(hypothesis: Hypothesis, slots: tuple[Slot, ...] = (), covariance: np.ndarray | None = None) -> Fit:
    """Judge a model as it is on the fitting and on the selecting samples."""
    problem, model = hypothesis.problem, hypothesis.model
    covariance = np.zeros((len(slots),) * 2) if covariance is None else covariance
    try:
        innovations = hypothesis.whitened()
    except SimulationError:
        return Fit(problem, model, slots, np.zeros((len(slots),) * 2), (), WORST, WORST)
    fitting, selecting = (sum(float(w @ w) for w in problem.pick(innovations, part)) for part in ("fit", "select"))
    return Fit(problem, model, slots, covariance, innovations, fitting, selecting)


def weighed(fitted: Fit) -> Fit | None:
    """``fitted`` judged by innovations that count for less where its model lets noise grow; None where it lets none.

    A burst of a saturated loop is another one as soon as any number moves, and a fit that follows each loses its way.
    Play bounces at every reversal: weighed, little would be left to tell its numbers by, and others took its part.
    """
    bounces = any(map(has_play, fitted.model.effects))
    if bounces or max(float(loud.max()) for loud in fitted.loudness) < rules.LOUD:
        return None
    problem = replace(fitted.problem, loudness=fitted.loudness)
    return evaluate(Hypothesis(problem, fitted.model), fitted.slots, fitted.covariance)


def play_anew(fitted: Fit) -> Fit:
    """``fitted`` where surfaces through its neighbourhood lead, if it has play that bounces and leaves structure.

    Play found while something else was missing bounces at another place, from which no slope leads away. Beside smooth
    functions of the state it stays where its short fit found it: they hide most of what else is missing. A model with
    more effects than are credible stands in for something unknown, and is not worth the time.
    """
    quiet = fitted.cost <= rules.AT_FLOOR * fitted.problem.samples("used")
    done = quiet or fitted.surveyed or len(fitted.model.effects) > rules.CREDIBLE
    return fitted if done or not _bounces(fitted) else _over_surfaces(fitted, "fit")


def _bounces(fitted: Fit) -> bool:
    return any(map(has_play, fitted.model.effects)) and bool(fitted.innovations) and not fitted.problem.states


def _over_surfaces(fitted: Fit, part: str) -> Fit:
    """``fitted`` to ``part`` anew, where that leaves less; how sure its numbers are no slope in a dent tells."""
    slots = fitted.slots or fitted.model.slots()

    def residual(model: Candidate) -> np.ndarray:
        return bounded(fitted.with_model(model).residual(part))

    found = descend_rough(fitted.model, slots, residual)
    if not found.covariance.any():  # no neighbourhood of it runs
        return fitted
    moved = evaluate(fitted.with_model(found.model), slots, found.covariance)
    stayed = replace(fitted, slots=slots, covariance=found.covariance, surveyed=True)
    return min((stayed, moved), key=bounded_cost)


def bounded_cost(fitted: Fit) -> float:
    """Cost in which a burst counts as the logarithm does."""
    return float(np.sum(bounded(fitted.residual("used")) ** 2)) if fitted.innovations else WORST


def sensitivities(fitted: Fit, slots: tuple[Slot, ...], part: str) -> np.ndarray:
    """What ``STEP`` magnitudes of each number in ``slots`` change in the whitened residual on ``part``, (n, k).

    A step beyond which the model cannot be simulated tells nothing: its column is 0.
    """
    model, base = fitted.model, fitted.residual(part)

    def changed(moved: Hypothesis) -> np.ndarray:
        try:
            return moved.residual(part) - base
        except SimulationError:
            return np.zeros_like(base)

    x, moves = model.vector(slots), []
    for k, slot in enumerate(slots):
        moved, step = x.copy(), STEP * slot.magnitude
        moved[k] += step * (1 if x[k] + step <= slot.quantity.upper else -1)
        moves.append((fitted.with_model(model.with_vector(slots, moved)),))
    return np.column_stack(side_by_side(changed, moves))


def admissible(fitted: Fit) -> bool:
    """Whether ``fitted`` runs, its numbers are inside their bounds and mean their effects, and its lines are apart."""
    sound = bool(fitted.innovations) and not on_bound(fitted) and plausible(fitted)
    return sound and _lines_apart(fitted) and not _closed(fitted)


def _closed(fitted: Fit) -> bool:
    """Whether a gap of play is no more than its deviation: a coupling without one, which is named itself."""
    effects = enumerate(zip(fitted.model.effects, fitted.model.values, strict=True))
    return any(has_play(effect) and values[0, GAP] < fitted.std(index, GAP) for index, (effect, values) in effects)


def _lines_apart(fitted: Fit) -> bool:
    """Whether further lines of an effect are there for sure, and repeat once more or less than others on the travel.

    Two lines that differ by less are one whose size or phase changes along the travel.
    """
    model = fitted.model
    travel = max(float(np.ptp(record.q)) for record in fitted.problem.records)
    for index, effect in enumerate(model.effects):
        if not (effect.after and effect.repeats):
            continue
        names = [parameter.name for parameter in effect.parameters]
        amplitude, repeat = names.index(effect.linear[0]), names.index(effect.repeats)
        if model.values[index][0, amplitude] < rules.SURE * fitted.std(index, amplitude):
            return False
        alike = [i for i, other in enumerate(model.effects) if kind_of(other.name) == kind_of(effect.name)]
        times = [travel / model.values[i][0, repeat] for i in alike if i != index]
        if any(abs(travel / model.values[index][0, repeat] - other) < 1.0 for other in times):
            return False
    return True


def plausible(hypothesis: Hypothesis) -> bool:
    """Whether the numbers of every effect still mean that effect on the motion of some record."""
    model, motions = hypothesis.model, [_motion(record) for record in hypothesis.problem.records]
    for index, effect in enumerate(model.effects):
        if effect.plausible is None:
            continue
        rows = [model.parameters(i)[index] for i in range(len(motions))]
        tables = [{p.name: float(x) for p, x in zip(effect.parameters, row, strict=True)} for row in rows]
        if not any(effect.plausible(table, motion) for table, motion in zip(tables, motions, strict=True)):
            return False
    return True


def on_bound(fitted: Fit) -> bool:
    """Whether a free parameter of an effect ended on its bound, where the physics it stands for ends."""
    return bool(bounds_met(fitted))


def bounds_met(fitted: Fit) -> list[Slot]:
    """The free parameters of the effects that ended on a bound."""
    met = []
    for slot, value in zip(fitted.slots, fitted.model.vector(fitted.slots), strict=True):
        near = rules.ON_BOUND * slot.magnitude
        if slot.effect >= 0 and (value <= slot.quantity.lower + near or value >= slot.quantity.upper - near):
            met.append(slot)
    return met


def refitted(hypothesis: Hypothesis) -> Fit:
    """A model fitted to all that may be used; with its own numbers where that leaves its physics."""
    found = fit(hypothesis, part="used")
    if _bounces(found):
        found = _over_surfaces(found, "used")
    return found if admissible(found) else evaluate(hypothesis, found.slots, found.covariance)


def _motion(record: Record) -> Motion:
    v = np.gradient(record.q, record.period)
    return Motion(record.t, record.q, v, np.gradient(v, record.period), v, record.period, record.u)
