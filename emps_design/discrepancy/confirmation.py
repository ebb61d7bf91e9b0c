"""Confirmation: the share of each effect that a record confirms, the reliable effects, and their equivalents.

The share of an effect is a regression coefficient: the residual is regressed onto the changes that each effect makes in
it. The residual of the model counts as noise, once by its spectrum and once as a smooth function of the state, so that
an effect can be confirmed although something unknown is present. Effects that the held-out data refute are withdrawn.
If structure remains that no effect explains, the parameters are estimated robustly.

Some instants cannot be determined: a mass put on while the carriage runs at constant speed shows only at the next
acceleration. All instants of that stretch have the same cost, and a fit stops where it started. The result is the
middle of these instants, with a standard deviation of half the distance to either end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import Judge
from emps_design.discrepancy.calibration import Outcome, set_of
from emps_design.discrepancy.fit import Fit, admissible, bounds_met, evaluate, fit
from emps_design.discrepancy.gap import adapt
from emps_design.discrepancy.least_squares import Candidate, descend
from emps_design.discrepancy.noise_floor import RESIDUAL, floor_of_residual
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.preparation import HeldOut
from emps_design.discrepancy.problem import Hypothesis, Problem, orthonormal
from emps_design.discrepancy.unknown_force import states_of
from emps_design.errors import SimulationError

Forces = tuple[np.ndarray, ...]  # one array (n,) [N] per record


@dataclass(frozen=True)
class Share:
    """Share of an effect that a record confirms: 1 is all of it, 0 none; ``std`` is the standard deviation.

    ``repeats`` is the share of the effect in its own simulation disturbed by noise: below 1 if backlash bounces and no
    two laps are alike. ``exercised`` False: the record does not excite the effect. ``weighted`` are (share, std) with
    the residual of the model as noise, by its spectrum and as a smooth function of the state. ``bounces``: the effect
    itself is such backlash.
    """

    name: str
    share: float
    std: float
    repeats: float
    exercised: bool
    weighted: tuple[tuple[float, float], ...] = ()
    bounces: bool = False

    @property
    def refuted(self) -> bool:
        """Whether the share is significantly outside the range from ``repeats`` to 1."""
        return self.exercised and self._distance(self.share) - rules.SURE * self.std > rules.SOME

    @property
    def weakly_confirmed(self) -> bool:
        """Whether the mean share of all weightings is below one half."""
        confirmed = self.confirmed
        return confirmed is not None and confirmed["share"] < rules.HALF

    @property
    def is_about_one(self) -> bool:
        """Whether the share is about 1 in every weighting of the residual."""
        return self.exercised and self.distance_from_one <= rules.SOME

    @property
    def is_reliable(self) -> bool:
        """Whether the share is about 1 and known well enough.

        The share of an effect that imitates something unknown changes if the unknown may be a function of the state. A
        share that bouncing backlash changes randomly is no evidence.
        """
        if self.repeats < rules.SOME:  # backlash that never bounces twice in the same way cannot repeat better
            return self.is_about_one and self.bounces
        return self.is_about_one and max(std for _, std in self._all()) <= rules.MINOR * self.repeats

    @property
    def distance_from_one(self) -> float:
        """Distance of the share from 1 in the least favourable weighting."""
        return max(self._distance(share) for share, _ in self._all())

    @property
    def confirmed(self) -> dict[str, float] | None:
        """The contract's share, relative to ``repeats``, and its deviation; None if it is undetermined."""
        if not self.exercised or self.repeats < rules.SOME:
            return None
        shares = np.array(self._all()) / self.repeats
        return {"share": float(shares[:, 0].mean()), "std": float(max(shares[:, 1].max(), np.ptp(shares[:, 0]) / 2))}

    def _all(self) -> list[tuple[float, float]]:
        return [(self.share, self.std), *self.weighted]

    def _distance(self, share: float) -> float:
        """Distance of ``share`` from the range from ``repeats`` to 1; negative inside."""
        return max(self.repeats - share, share - 1.0)


def effect_shares(hypothesis: Hypothesis) -> list[Share]:
    """Share of each effect of the plant that the records confirm, by one regression.

    The whitened residual is regressed onto the changes that each effect and the four baseline parameters make in it. An
    effect that imitates unknown physics fits one motion, but has another share on another motion. The regression is
    repeated with the residual of the model as noise: whitened by its own spectrum, and as a sum of smooth functions of
    the simulated state with random coefficients of estimated variance (empirical Bayes); with an unknown force by its
    spectrum only. Effects of the controller are included as regressors, but known from the law.
    """
    problem, model = hypothesis.problem, hypothesis.model
    plant = [index for index, effect in enumerate(model.effects) if effect.channel != "controller"]
    if not plant:
        return []
    noise = problem.noise(0)
    rests = [hypothesis.with_model(model.without(index)) for index in range(len(model.effects))]
    models = [hypothesis, *rests]
    runs = [
        *((judged, None) for judged in (*models, *_baseline_steps(hypothesis))),
        *((judged, noise) for judged in models),
    ]
    residuals = side_by_side(_residuals, runs)
    (whole, *changed), (disturbed, *changed_disturbed) = residuals[: -len(models)], residuals[-len(models) :]
    if whole is None:  # the model cannot be simulated
        return [Share(model.names[i], 0.0, 0.0, 1.0, exercised=False) for i in plant]
    columns = [_change(residual, whole) for residual in changed]  # of the effects, then of the baseline parameters
    columns_disturbed = [_change(residual, disturbed) for residual in changed_disturbed]
    spectrum = floor_of_residual(
        problem.pick(problem.without_states(whole), "used"), problem.period, RESIDUAL
    ).whitening
    states = () if problem.states else states_of(hypothesis)
    noises = (problem, problem.with_whitening(spectrum))
    unknown = ((), states) if states else ((),)
    shares: list[list[tuple[float, float]]] = side_by_side(
        _shares_of, [(weighting, whole, columns, other) for weighting in noises for other in unknown]
    )
    by_effect = []
    for i in plant:
        here, there = _whitened_used(problem, columns[i]), _whitened_used(problem, columns_disturbed[i])
        repeats = min(1.0, float(here @ there) / max(float(there @ there), 1e-30))
        exercised = float(np.linalg.norm(here)) > rules.SLIGHT * np.sqrt(here.size)
        by_weighting = tuple(rows[i] for rows in shares[1:])
        by_effect.append(
            Share(model.names[i], *shares[0][i], repeats, exercised, by_weighting, bounces=bool(model.effects[i].play))
        )
    return by_effect


def _shares_of(weighted: Problem, whole: Forces, columns: list[Forces], states: Forces) -> list[tuple[float, float]]:
    """Shares of ``columns`` in the residual ``whole``, which may also contain functions of ``states``."""
    design = np.column_stack([_whitened_used(weighted, column) for column in columns])
    return _shares(
        design, _whitened_used(weighted, whole), orthonormal(_whitened_used(weighted, states)) if states else None
    )


def _shares(design: np.ndarray, residual: np.ndarray, unknown: np.ndarray | None = None) -> list[tuple[float, float]]:
    """Share of each column of ``design`` (n, k) in ``residual`` (n,), and its standard deviation; all whitened.

    The component of the residual along ``unknown`` (n, m), orthonormal, may be structure: noise of its own variance.
    """
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = np.inf  # a column of zeros has no share
    unit = design / size
    noise, structure, basis = max(1.0, float(residual @ residual) / residual.size), 0.0, np.zeros((residual.size, 0))
    if unknown is not None:
        basis = unknown
        both = np.column_stack([unit, basis])
        rest = residual - both @ np.linalg.lstsq(both, residual, rcond=1e-10)[0]
        noise = max(1.0, float(rest @ rest) / (residual.size - both.shape[1]))
        beside = residual - unit @ np.linalg.lstsq(unit, residual, rcond=1e-10)[0]
        structure = max(0.0, float(np.mean((basis.T @ beside) ** 2)) - noise)
    structure_share = structure / (noise + structure)

    def weight(x: np.ndarray) -> np.ndarray:
        return (x - structure_share * basis @ (basis.T @ x)) / noise

    inverse = np.linalg.pinv(unit.T @ weight(unit), hermitian=True)
    shares = 1.0 + inverse @ (unit.T @ weight(residual)) / size
    stds = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
    return [(float(share), float(std)) for share, std in zip(shares, stds, strict=True)]


def _whitened_used(problem: Problem, signals: Forces) -> np.ndarray:
    """Whitened ``signals``, (n,) or (n, k) per record, on the used samples of all records."""
    return problem.gather(problem.whiten(signals), "used")


def _residuals(hypothesis: Hypothesis, disturbance: Forces | None = None) -> Forces | None:
    """Measured minus simulated force with ``disturbance`` on the carriage; None where the simulation fails."""
    try:
        return hypothesis.residuals(disturbance)
    except SimulationError:
        return None


def _change(changed: Forces | None, whole: Forces | None) -> Forces:
    """``changed`` minus ``whole``; zero where a simulation failed."""
    if changed is None or whole is None:
        return tuple(np.zeros_like(force) for force in changed or whole or ())
    return tuple(force - other for force, other in zip(changed, whole, strict=True))


def _baseline_steps(hypothesis: Hypothesis) -> list[Hypothesis]:
    """The models with a small step of one free baseline parameter each."""
    model = hypothesis.model
    slots = tuple(slot for slot in model.slots() if slot.effect < 0)
    steps = np.diag([rules.STEP * slot.magnitude for slot in slots])
    return [hypothesis.with_model(model.with_vector(slots, vector)) for vector in model.vector(slots) + steps]


def robust(fitted: Fit) -> Fit:
    """Refit ``fitted`` to all used samples so that remaining structure biases its parameters less.

    Least squares with the noise of the laps would explain slow structure by the parameters. Here the residual itself is
    the noise model (feasible generalised least squares), which gives little weight to frequencies with structure, and
    Huber's loss bounds the influence of bursts. The result is evaluated with the noise of ``fitted`` again; its
    residual is larger than that of least squares.
    """
    model, covariance, slots = fitted.model, fitted.covariance, fitted.model.slots()
    numbers = []
    for _ in range(rules.IN_TURN):
        noise = floor_of_residual(fitted.with_model(model).remaining_force(), fitted.problem.period, RESIDUAL)
        weighted = fitted.problem.with_whitening(noise.whitening)
        descent = descend(model, slots, partial(_huber_residuals, weighted), rules.ROBUST_STEPS)
        model, covariance = descent.model, descent.covariance
        numbers.append(model.vector(slots))
    return evaluate(fitted.with_model(model), slots, widened(covariance, numbers))


def widened(covariance: np.ndarray, numbers: list[np.ndarray]) -> np.ndarray:
    """``covariance`` (k, k) with every standard deviation at least the range of ``numbers``, each (k,).

    The uncertainty of a parameter is at least its difference between estimation methods.
    """
    wider = np.maximum(1.0, np.ptp(numbers, axis=0) / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))
    return covariance * np.outer(wider, wider)


def _huber_residuals(problem: Problem, model: Candidate) -> np.ndarray:
    """Residuals (n,) whose sum of squares is Huber's loss of the innovations (n,) of ``model``."""
    innovations = Hypothesis(problem, model).residual("used")
    size = np.abs(innovations)
    huber_scale = np.sqrt(np.maximum(2 * rules.HUBER * size - rules.HUBER**2, 0.0))
    return np.where(size <= rules.HUBER, innovations, np.sign(innovations) * huber_scale)


def equivalents(outcome: Outcome) -> dict[str, list[str]]:
    """For each accepted effect, the effects that explain the records as well in its place, best first."""
    best, judge = outcome.best, outcome.judge
    threshold, by_effect = judge.healthy.threshold, {}
    for name in best.model.names:
        others = set_of(best) - {name}
        without = outcome.tried.get(others, outcome.path[0]).cost
        # At the noise floor only chance counts; above it, missing physics may favour either effect by a few percent.
        margin = threshold
        if not judge.at_floor(best):
            margin = max(threshold, rules.EQUIVALENT * (without - best.cost))
        rivals = [
            (rival.cost, next(iter(key - others)))
            for key, rival in outcome.tried.items()
            if len(key) == len(others) + 1 and others < key and name not in key and rival.cost <= best.cost + margin
        ]
        by_effect[name] = [rival for _, rival in sorted(rivals)]
    return by_effect


def equivalents_beside_unknown(outcome: Outcome, reliable: Fit) -> dict[str, list[str]]:
    """:func:`equivalents` of the model ``reliable`` if something unknown is present, with its residual as the noise.

    Each finding is replaced by the effects it is confusable with, starting from their own best fits.
    """
    if not reliable.model.effects:
        return {}
    noise = floor_of_residual(reliable.remaining_force(), reliable.problem.period, RESIDUAL).whitening
    reweighted, by_effect = reliable.problem.with_whitening(noise), {}
    reference = evaluate(Hypothesis(reweighted, reliable.model))
    for index, effect in enumerate(reliable.model.effects):
        rest = reliable.model.without(index)
        others = [
            (other, values)
            for key, alone in outcome.tried.items()
            for other, values in zip(alone.model.effects, alone.model.values, strict=True)
            if len(key) == len(outcome.path[0].model.names) + 1 and other.name not in reliable.model.names
            if effect.confusable(other)
        ]
        begins = [rest, *(rest.with_effect(other, values) for other, values in others)]
        without, *rivals = side_by_side(
            fit, [(Hypothesis(reweighted, model), "used", None, 2 * rules.SHORT_STEPS) for model in begins]
        )
        margin = max(outcome.healthy.threshold, rules.EQUIVALENT * (without.cost - reference.cost))
        equivalents = [rival for rival in rivals if admissible(rival) and rival.cost <= reference.cost + margin]
        by_effect[effect.name] = [rival.model.names[-1] for rival in sorted(equivalents, key=lambda rival: rival.cost)]
    return by_effect


def confirm(judge: Judge, held_out: HeldOut, extended: Fit) -> tuple[Fit, list[Share], tuple[Share, ...]]:
    """Withdraw effects of ``extended`` that the held-out data refute or hardly confirm, one by one, and refit the rest.

    Also returns the shares of the remaining effects, and those withdrawn. Effects of the controller have no share: the
    law is their evidence.
    """
    refuted: list[Share] = []
    shares = shares_on(held_out, extended)
    while doubtful := [a for a in shares if a.refuted or a.weakly_confirmed]:
        worst = max(doubtful, key=lambda a: abs(a.share - 1) / a.std)
        refuted.append(worst)
        extended = judge.refit(extended.with_model(extended.model.without_named([worst.name])))
        shares = shares_on(held_out, extended)
    return extended, shares, tuple(refuted)


def reliable_effects(held_out: HeldOut | None, extended: Fit) -> tuple[Fit, tuple[Share, ...]]:
    """The robust fit of the effects of ``extended`` that have their own evidence, and the shares withdrawn.

    The evidence for an effect that the held-out data do not excite is in the training records. The residual counts as
    noise, because something unknown may be present. A refit after each withdrawal would bias the other effects towards
    the unknown, so all parameters are held until every remaining effect is confirmed. An effect with a poorly known
    share stays until then, so that the others do not absorb the unknown. Then the reliable effects are fitted robustly
    without it, and their shares computed again. An effect is also withdrawn if its size is now poorly known or a
    parameter ends on a bound: then the unknown had determined it. A curve through knots, or one element of a
    hysteresis, has no characteristic shape and is never named if something unknown is present.
    """
    extended = _without(
        extended, [effect.name for effect in extended.model.effects if effect.search.general or effect.search.element]
    )
    withdrawn: list[Share] = []
    refitted = False
    while _plant_effects(extended):
        judged = _judged(held_out, extended)
        on_bound = {extended.model.names[slot.effect] for slot in bounds_met(extended)}
        doubtful = [a for a in judged if not a.is_about_one or a.name in on_bound]
        if refitted and not doubtful:
            doubtful = [a for a in judged if not _size_known(extended, a.name)]
            if not doubtful:
                break
        removed = (
            [max(doubtful, key=lambda a: a.distance_from_one)] if doubtful else [a for a in judged if not a.is_reliable]
        )
        withdrawn += removed
        extended = _without(extended, [share.name for share in removed])
        refitted = refitted or not doubtful
        if refitted and _plant_effects(extended):
            extended = robust(fit(extended, part="used"))  # its parameters came from a model with more effects
    return extended, tuple(withdrawn)


def _size_known(fitted: Fit, name: str) -> bool:
    """Whether a linear parameter of the effect ``name`` has a relative deviation of ``rules.MINOR``, or it has none."""
    index = fitted.model.names.index(name)
    effect, values = fitted.model.effects[index], fitted.model.values[index]
    known = [
        fitted.std(index, place) / max(abs(float(values[0, place])), 1e-30)
        for place, parameter in enumerate(effect.parameters)
        if parameter.linear and parameter.unit != "rad"
    ]
    return not known or min(known) <= rules.MINOR


def _judged(held_out: HeldOut | None, extended: Fit) -> list[Share]:
    """Shares on the held-out data; on the training records for effects that the held-out data do not excite."""
    shares = [] if held_out is None else shares_on(held_out, extended)
    if shares and all(share.exercised for share in shares):
        return shares
    trained = {share.name: share for share in effect_shares(extended)}
    return [share if share.exercised else trained[share.name] for share in shares or trained.values()]


def shares_on(held_out: HeldOut, extended: Fit) -> list[Share]:
    """Share of each effect of the plant that the held-out data confirm."""
    model = extended.model
    return effect_shares(Hypothesis(held_out.problem, adapt(held_out, model, model)))


def _plant_effects(fitted: Fit) -> list[str]:
    return [effect.name for effect in fitted.model.effects if effect.channel != "controller"]


def _without(fitted: Fit, names: list[str]) -> Fit:
    """``fitted`` without the effects ``names``, all other parameters unchanged."""
    return evaluate(fitted.with_model(fitted.model.without_named(names))) if names else fitted


def with_central_instants(fitted: Fit) -> Fit:
    """``fitted`` with every instant in the middle of its range of equal cost."""
    model = fitted.model
    for index, place, record in _instants(fitted):
        low, high = equal_cost_range(fitted.with_model(model), index, place, record)
        if high > low:
            model = _with_instant(model, index, place, record, 0.5 * (low + high))
    if model is fitted.model:
        return fitted
    candidate = evaluate(fitted.with_model(model), fitted.slots, fitted.covariance)
    return candidate if candidate.cost < fitted.cost + rules.CHANCE**2 * _cost_per_sample(fitted) else fitted


def deviation_in_time(fitted: Fit, index: int, place: int, record: int) -> float:
    """Standard deviation [s] of an instant of effect ``index``: a quarter of its range; 0 for other parameters."""
    if (index, place, record) not in _instants(fitted):
        return 0.0
    low, high = equal_cost_range(fitted, index, place, record)
    return 0.25 * (high - low)


def equal_cost_range(fitted: Hypothesis, index: int, place: int, record: int) -> tuple[float, float]:
    """Range of instants [s] around that of effect ``index`` on ``record`` with equal cost, all else unchanged.

    The cost may increase as for a parameter that is off by ``rules.CHANCE`` standard deviations. The range has length
    zero if the cost is higher two samples to either side.
    """
    problem, now = fitted.problem, float(fitted.model.values[index][record, place])
    residual = fitted.residual("used")
    limit = float(residual @ residual) + rules.CHANCE**2 * _cost_per_sample(fitted)

    def is_as_good(instant: float) -> bool:
        try:
            changed = fitted.with_model(_with_instant(fitted.model, index, place, record, instant)).residual("used")
        except SimulationError:
            return False
        return float(changed @ changed) < limit

    def end(direction: float, bound: float) -> float:
        reached, step = now, 2.0 * problem.period
        while reached != bound:
            further = min(reached + step, bound) if direction > 0.0 else max(reached - step, bound)
            if not is_as_good(further):
                break
            reached, step = further, 2.0 * step
        else:
            return bound
        if reached == now:
            return now
        for _ in range(rules.HALVINGS):
            middle = 0.5 * (reached + further)
            reached, further = (middle, further) if is_as_good(middle) else (reached, middle)
        return reached

    duration = len(problem.records[record]) * problem.period
    low, high = side_by_side(end, [(-1.0, 0.0), (1.0, max(duration, now))])
    return low, high


def _cost_per_sample(fitted: Hypothesis) -> float:
    """Whitened cost per sample, at least 1, that of noise."""
    residual = fitted.residual("used")
    return max(1.0, float(residual @ residual) / residual.size)


def _instants(fitted: Fit) -> list[tuple[int, int, int]]:
    """Effect, place and record of every free instant; an instant at its lower bound, 0, is switched off."""
    values = fitted.model.values
    return [
        (slot.effect, slot.place, slot.record)
        for slot in fitted.model.slots()
        if slot.effect >= 0
        and slot.record is not None
        and slot.quantity.unit == "s"
        and values[slot.effect][slot.record, slot.place] > slot.quantity.lower
    ]


def _with_instant(model: Candidate, index: int, place: int, record: int, instant: float) -> Candidate:
    """``model`` with another instant of effect ``index`` on ``record``."""
    values = list(model.values)
    values[index] = values[index].copy()
    values[index][record, place] = instant
    return replace(model, values=tuple(values))
