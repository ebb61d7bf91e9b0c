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

    ``surface_checked``: the response surfaces of :func:`refit_play` found no lower cost in its neighbourhood.
    """

    slots: tuple[Slot, ...]
    covariance: np.ndarray
    innovations: tuple[np.ndarray, ...]
    cost_fit: float
    cost_select: float
    surface_checked: bool = False

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
    def noise_gain(self) -> tuple[np.ndarray, ...]:
        """Gain from noise to innovations, at least 1; (n,) per record.

        At the limit of a motor, or with backlash, a loop may amplify noise into bursts that do not repeat. The gain is
        computed from simulations with noise on the carriage.
        """
        from scipy.ndimage import uniform_filter1d

        undisturbed = self.whitened()
        disturbed = side_by_side(self._innovations_with_noise, [(seed,) for seed in range(rules.NOISES)])
        squares = [
            np.mean([(draw - other) ** 2 for draw in draws], axis=0)
            for *draws, other in zip(*disturbed, undisturbed, strict=True)
        ]
        return tuple(
            np.sqrt(np.maximum(uniform_filter1d(square, min(rules.PIECE, square.size)), 1.0)) for square in squares
        )

    def _innovations_with_noise(self, seed: int) -> tuple[np.ndarray, ...]:
        """The innovations with noise on the carriage; without noise if that cannot be simulated."""
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
    """Fit ``start`` to the closed-loop force on the samples of ``part``; ``slots`` (default: all) are free."""
    slots = start.model.slots() if slots is None else slots

    def residual(model: Candidate) -> np.ndarray:
        return (start if model is start.model else start.with_model(model)).residual(
            part
        )  # a fit has its own residual already

    descent = descend(start.model, slots, residual, steps)
    return evaluate(start.with_model(descent.model), slots, descent.covariance)


def evaluate(hypothesis: Hypothesis, slots: tuple[Slot, ...] = (), covariance: np.ndarray | None = None) -> Fit:
    """A model without fitting it, with its cost on the fitting and on the selecting samples."""
    problem, model = hypothesis.problem, hypothesis.model
    covariance = np.zeros((len(slots),) * 2) if covariance is None else covariance
    try:
        innovations = hypothesis.whitened()
    except SimulationError:
        return Fit(problem, model, slots, np.zeros((len(slots),) * 2), (), rules.WORST, rules.WORST)
    fitting, selecting = (sum(float(w @ w) for w in problem.pick(innovations, part)) for part in ("fit", "select"))
    return Fit(problem, model, slots, covariance, innovations, fitting, selecting)


def with_noise_weights(fitted: Fit) -> Fit | None:
    """``fitted`` with its innovations divided by the noise gain; None if the model does not amplify noise.

    Any change of a parameter changes the bursts of a saturated loop, which misleads a fit. A model with backlash is not
    weighted: backlash bounces at every reversal, and too little weight would remain to determine it.
    """
    bounces = any(effect.play for effect in fitted.model.effects)
    if bounces or max(float(gain.max()) for gain in fitted.noise_gain) < rules.TWICE:
        return None
    problem = replace(fitted.problem, noise_gain=fitted.noise_gain)
    return evaluate(Hypothesis(problem, fitted.model), fitted.slots, fitted.covariance)


def refit_play(fitted: Fit) -> Fit:
    """``fitted`` at the minimum of response surfaces, if it has backlash that bounces and its residual has structure.

    Backlash found while something else was missing is in a local minimum, with impacts at other instants. With smooth
    functions of the state it is not refitted, because these hide most of what else is missing; nor is a model with more
    than ``rules.CREDIBLE`` effects, which imitates something unknown.
    """
    at_floor = fitted.cost <= rules.AT_FLOOR * fitted.problem.samples("used")
    done = at_floor or fitted.surface_checked or len(fitted.model.effects) > rules.CREDIBLE
    return fitted if done or not _bounces(fitted) else _fit_by_surfaces(fitted, "fit")


def _bounces(fitted: Fit) -> bool:
    bounces = any(effect.play for effect in fitted.model.effects)
    return bounces and bool(fitted.innovations) and not fitted.problem.states


def _fit_by_surfaces(fitted: Fit, part: str) -> Fit:
    """``fitted`` refitted to ``part`` by response surfaces if that lowers its cost, with the covariance of these."""
    slots = fitted.slots or fitted.model.slots()

    def residual(model: Candidate) -> np.ndarray:
        return bounded(fitted.with_model(model).residual(part))

    descent = descend_rough(fitted.model, slots, residual)
    if not descent.covariance.any():  # no neighbourhood can be simulated
        return fitted
    reached = evaluate(fitted.with_model(descent.model), slots, descent.covariance)
    stayed = replace(fitted, slots=slots, covariance=descent.covariance, surface_checked=True)
    return min((stayed, reached), key=bounded_cost)


def bounded_cost(fitted: Fit) -> float:
    """Cost on the used samples with Cauchy's loss, in which bursts count little."""
    return float(np.sum(bounded(fitted.residual("used")) ** 2)) if fitted.innovations else rules.WORST


def sensitivities(fitted: Fit, slots: tuple[Slot, ...], part: str) -> np.ndarray:
    """Change (n, k) of the whitened residual on ``part`` by ``rules.STEP`` magnitudes of each parameter in ``slots``.

    A column is 0 if the model cannot be simulated with that step.
    """
    model, base = fitted.model, fitted.residual(part)

    def changed(hypothesis: Hypothesis) -> np.ndarray:
        try:
            return hypothesis.residual(part) - base
        except SimulationError:
            return np.zeros_like(base)

    x, moves = model.vector(slots), []
    for k, slot in enumerate(slots):
        shifted, step = x.copy(), rules.STEP * slot.magnitude
        shifted[k] += step * (1 if x[k] + step <= slot.quantity.upper else -1)
        moves.append((fitted.with_model(model.with_vector(slots, shifted)),))
    return np.column_stack(side_by_side(changed, moves))


def admissible(fitted: Fit) -> bool:
    """Whether ``fitted`` can be simulated, is within bounds and plausible, with distinct lines and gaps above zero."""
    possible = bool(fitted.innovations) and not on_bound(fitted) and plausible(fitted)
    return possible and _lines_apart(fitted) and not _gap_vanishes(fitted)


def _gap_vanishes(fitted: Fit) -> bool:
    """Whether a gap of backlash is within its standard deviation of 0: it is then an elastic coupling."""
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
        same_kind = [i for i, other in enumerate(model.effects) if kind_of(other.name) == kind_of(effect.name)]
        times = [travel / model.values[i][0, repeat] for i in same_kind if i != index]
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
        close = rules.NOTHING * slot.magnitude
        if slot.effect >= 0 and (value <= slot.quantity.lower + close or value >= slot.quantity.upper - close):
            met.append(slot)
    return met


def refit(hypothesis: Hypothesis) -> Fit:
    """``hypothesis`` fitted to all used samples; with its own parameters if the fit is inadmissible."""
    fitted = fit(hypothesis, part="used")
    if _bounces(fitted):
        fitted = _fit_by_surfaces(fitted, "used")
    return fitted if admissible(fitted) else evaluate(hypothesis, fitted.slots, fitted.covariance)


def _motion(record: Record) -> Motion:
    v = np.gradient(record.q, record.period)
    return Motion(record.t, record.q, v, np.gradient(v, record.period), v, record.period, record.u)
