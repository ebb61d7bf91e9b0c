"""A hypothesis fitted to its records in closed loop, its sensitivities, and checks that its parameters are physical."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.least_squares import Candidate, Slot, bounded, descend, descend_rough
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.effects import Motion, kind_of
from emps_design.errors import SimulationError
from emps_design.records import Record


@dataclass(frozen=True)
class Fit(Hypothesis):
    """A fitted model: its whitened residuals, and the covariance (k, k) of the parameters in ``slots``.

    ``surveyed``: the response surfaces of :func:`play_anew` found nothing better in its neighbourhood.
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
        """The cost plus a penalty for its parameters (Bayesian information criterion, known noise)."""
        return self.cost + len(self.model.slots()) * float(np.log(self.problem.samples("used")))

    def whitened(self) -> tuple[np.ndarray, ...]:
        """The innovations, one array (n,) per record."""
        return self.innovations or super().whitened()  # raises with the reason where the model cannot be simulated

    @cached_property
    def loudness(self) -> tuple[np.ndarray, ...]:
        """Gain from noise to innovations, at least 1; (n,) per record.

        At a motor's limit, or in play, a loop may amplify noise into bursts that never repeat. Simulations with noise
        on the carriage show when.
        """
        from scipy.ndimage import uniform_filter1d

        quiet = self.whitened()
        disturbed = side_by_side(self._disturbed, [(seed,) for seed in range(rules.NOISES)])
        grown = [
            np.mean([(draw - other) ** 2 for draw in draws], axis=0)
            for *draws, other in zip(*disturbed, quiet, strict=True)
        ]
        return tuple(
            np.sqrt(np.maximum(uniform_filter1d(square, min(rules.PIECE, square.size)), 1.0)) for square in grown
        )

    def _disturbed(self, seed: int) -> tuple[np.ndarray, ...]:
        """The innovations with noise on the carriage; where that cannot be simulated, those without."""
        try:
            return self.problem.whiten(self.residuals(self.problem.noise(seed)))
        except SimulationError:
            return self.whitened()

    def std(self, effect: int, place: int, record: int = 0) -> float:
        """Standard deviation of a parameter; 0 where it was not free."""
        for i, slot in enumerate(self.slots):
            if slot.effect == effect and slot.place == place and slot.record in (None, record):
                return float(np.sqrt(max(self.covariance[i, i], 0.0)))
        return 0.0


def fit(start: Hypothesis, part: str = "fit", slots: tuple[Slot, ...] | None = None, steps: int = 12) -> Fit:
    """Fit ``start`` to the closed-loop force on the samples of ``part``; ``slots`` (default: all) says what is free."""
    slots = start.model.slots() if slots is None else slots

    def residual(model: Candidate) -> np.ndarray:
        return (start if model is start.model else start.with_model(model)).residual(
            part
        )  # a fit has its own residual already

    descent = descend(start.model, slots, residual, steps)
    return evaluate(start.with_model(descent.model), slots, descent.covariance)


def evaluate(hypothesis: Hypothesis, slots: tuple[Slot, ...] = (), covariance: np.ndarray | None = None) -> Fit:
    """The cost of a model, without fitting it, on the fitting and on the selecting samples."""
    problem, model = hypothesis.problem, hypothesis.model
    covariance = np.zeros((len(slots),) * 2) if covariance is None else covariance
    try:
        innovations = hypothesis.whitened()
    except SimulationError:
        return Fit(problem, model, slots, np.zeros((len(slots),) * 2), (), rules.WORST, rules.WORST)
    fitting, selecting = (sum(float(w @ w) for w in problem.pick(innovations, part)) for part in ("fit", "select"))
    return Fit(problem, model, slots, covariance, innovations, fitting, selecting)


def weighed(fitted: Fit) -> Fit | None:
    """``fitted`` with its innovations weighted down where its model amplifies noise; None where it does not.

    A burst of a saturated loop changes as soon as any parameter moves, and misleads a fit. A model with play is not
    weighted: play bounces at every reversal, and little would be left to determine it.
    """
    bounces = any(effect.play for effect in fitted.model.effects)
    if bounces or max(float(loud.max()) for loud in fitted.loudness) < rules.TWICE:
        return None
    problem = replace(fitted.problem, loudness=fitted.loudness)
    return evaluate(Hypothesis(problem, fitted.model), fitted.slots, fitted.covariance)


def play_anew(fitted: Fit) -> Fit:
    """``fitted`` moved to the minimum of response surfaces, if it has play that bounces and leaves structure.

    Play found while something else was missing bounces elsewhere, in a local minimum. Beside smooth functions of the
    state it stays where its short fit found it: they hide most of what else is missing. A model with more effects than
    credible imitates something unknown, and is not worth the time.
    """
    quiet = fitted.cost <= rules.AT_FLOOR * fitted.problem.samples("used")
    done = quiet or fitted.surveyed or len(fitted.model.effects) > rules.CREDIBLE
    return fitted if done or not _bounces(fitted) else _over_surfaces(fitted, "fit")


def _bounces(fitted: Fit) -> bool:
    bounces = any(effect.play for effect in fitted.model.effects)
    return bounces and bool(fitted.innovations) and not fitted.problem.states


def _over_surfaces(fitted: Fit, part: str) -> Fit:
    """``fitted`` refitted to ``part`` by response surfaces where that leaves less, with the covariance of these."""
    slots = fitted.slots or fitted.model.slots()

    def residual(model: Candidate) -> np.ndarray:
        return bounded(fitted.with_model(model).residual(part))

    descent = descend_rough(fitted.model, slots, residual)
    if not descent.covariance.any():  # no neighbourhood can be simulated
        return fitted
    moved = evaluate(fitted.with_model(descent.model), slots, descent.covariance)
    stayed = replace(fitted, slots=slots, covariance=descent.covariance, surveyed=True)
    return min((stayed, moved), key=bounded_cost)


def bounded_cost(fitted: Fit) -> float:
    """Cost on the used samples with Cauchy's loss, in which bursts count little."""
    return float(np.sum(bounded(fitted.residual("used")) ** 2)) if fitted.innovations else rules.WORST


def sensitivities(fitted: Fit, slots: tuple[Slot, ...], part: str) -> np.ndarray:
    """Change (n, k) of the whitened residual on ``part`` by ``rules.STEP`` magnitudes of each parameter in ``slots``.

    The column of a step at which the model cannot be simulated is 0.
    """
    model, base = fitted.model, fitted.residual(part)

    def changed(moved: Hypothesis) -> np.ndarray:
        try:
            return moved.residual(part) - base
        except SimulationError:
            return np.zeros_like(base)

    x, moves = model.vector(slots), []
    for k, slot in enumerate(slots):
        moved, step = x.copy(), rules.STEP * slot.magnitude
        moved[k] += step * (1 if x[k] + step <= slot.quantity.upper else -1)
        moves.append((fitted.with_model(model.with_vector(slots, moved)),))
    return np.column_stack(side_by_side(changed, moves))


def admissible(fitted: Fit) -> bool:
    """Whether ``fitted`` can be simulated, is within bounds and plausible, and its lines and gaps are distinct."""
    sound = bool(fitted.innovations) and not on_bound(fitted) and plausible(fitted)
    return sound and _lines_apart(fitted) and not _closed(fitted)


def _closed(fitted: Fit) -> bool:
    """Whether a gap of play is within its standard deviation of 0: it is then an elastic coupling."""
    model = fitted.model
    gaps = [(index, effect.place(effect.play)) for index, effect in enumerate(model.effects) if effect.play]
    return any(model.values[index][0, place] < fitted.std(index, place) for index, place in gaps)


def _lines_apart(fitted: Fit) -> bool:
    """Whether further lines of an effect are significant, and differ from others by a period or more on the travel.

    Two lines that differ by less are one line whose size or phase changes along the travel.
    """
    model = fitted.model
    travel = max(float(np.ptp(record.q)) for record in fitted.problem.records)
    for index, effect in enumerate(model.effects):
        if not (effect.search.after and effect.repeats):
            continue
        amplitude, repeat = effect.place(effect.linear[0]), effect.place(effect.repeats)
        if model.values[index][0, amplitude] < rules.SURE * fitted.std(index, amplitude):
            return False
        alike = [i for i, other in enumerate(model.effects) if kind_of(other.name) == kind_of(effect.name)]
        times = [travel / model.values[i][0, repeat] for i in alike if i != index]
        if any(abs(travel / model.values[index][0, repeat] - other) < 1.0 for other in times):
            return False
    return True


def plausible(hypothesis: Hypothesis) -> bool:
    """Whether the parameters of every effect are plausible on the motion of some record."""
    model, motions = hypothesis.model, [_motion(record) for record in hypothesis.problem.records]
    for index, effect in enumerate(model.effects):
        if effect.search.plausible is None:
            continue
        rows = [model.parameters(i)[index] for i in range(len(motions))]
        tables = [{p.name: float(x) for p, x in zip(effect.parameters, row, strict=True)} for row in rows]
        if not any(effect.search.plausible(table, motion) for table, motion in zip(tables, motions, strict=True)):
            return False
    return True


def on_bound(fitted: Fit) -> bool:
    """Whether a free parameter of an effect ended on its bound, where its physics ends."""
    return bool(bounds_met(fitted))


def bounds_met(fitted: Fit) -> list[Slot]:
    """The free parameters of the effects that ended on a bound."""
    met = []
    for slot, value in zip(fitted.slots, fitted.model.vector(fitted.slots), strict=True):
        near = rules.NOTHING * slot.magnitude
        if slot.effect >= 0 and (value <= slot.quantity.lower + near or value >= slot.quantity.upper - near):
            met.append(slot)
    return met


def refitted(hypothesis: Hypothesis) -> Fit:
    """``hypothesis`` fitted to all used samples; with its own parameters where the fit is inadmissible."""
    fitted = fit(hypothesis, part="used")
    if _bounces(fitted):
        fitted = _over_surfaces(fitted, "used")
    return fitted if admissible(fitted) else evaluate(hypothesis, fitted.slots, fitted.covariance)


def _motion(record: Record) -> Motion:
    v = np.gradient(record.q, record.period)
    return Motion(record.t, record.q, v, np.gradient(v, record.period), v, record.period, record.u)
