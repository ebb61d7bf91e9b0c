"""Which effects the confirming data withdraw, and how much of each effect a record asks for.

How much of each effect a record asks for, while something may act on it that no effect explains.

Every effect's own evidence: what it changes in the residual, regressed onto that residual beside all others. What the
model leaves is part of the noise, once by its spectrum and once as a smooth function of the state.

Which effects the confirming data withdraw, and which stand on their own evidence beside something unknown.

The best estimate of the parameters where structure is left that no effect explains.

Effects that could stand in the place of a finding as far as the records tell.

When something happened: the instants that a record cannot tell apart, and the middle of them.

A mass put on while the carriage runs at constant speed shows at the next acceleration: any instant of that stretch
leaves as little, and a fit stops at the one where it happened to begin. What is said then is the middle of them, and a
deviation of which two reach to either end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import Judge
from emps_design.discrepancy.calibration import Outcome, set_of
from emps_design.discrepancy.fit import STEP, Fit, admissible, bounds_met, evaluate, fit
from emps_design.discrepancy.gap import adapted
from emps_design.discrepancy.least_squares import Candidate, descend
from emps_design.discrepancy.noise_floor import LEFT, floor_of_residual
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.preparation import HeldOut
from emps_design.discrepancy.problem import Hypothesis, Problem, orthonormal
from emps_design.discrepancy.unknown_force import states_of
from emps_design.effects.two_mass import has_play
from emps_design.errors import SimulationError

Forces = tuple[np.ndarray, ...]  # one array (n,) [N] per record

HUBER = 1.345  # standard deviations beyond which a sample pulls no harder: 95 % efficient where all is Gaussian noise
REWEIGHTED = 3  # times the noise is taken again from what the fit leaves
STEPS = 20

RIVAL_STEPS = 8

RISE = 4.0  # of the whitened cost, of noise 1 a sample: two deviations of a number that the cost is square in
FIRST = 2.0  # samples, the first step to both sides
HALVINGS = 7  # by which the end of a range is found within the last step


@dataclass(frozen=True)
class Share:
    """How much of an effect a record asks for: ``share`` 1 is all of it, 0 none; ``std`` its standard deviation.

    ``repeats`` is the share that the effect asks of itself when the carriage is disturbed by noise: below 1 where play
    bounces, and no two laps are alike. ``exercised`` False: the record does not bring the effect out, and says nothing
    of it. ``weighed`` are the shares where what the model leaves is itself noise, once by its spectrum and once as a
    smooth function of the state, each with its deviation. ``bounces``: the effect is such play itself.
    """

    name: str
    share: float
    std: float
    repeats: float
    exercised: bool
    weighed: tuple[tuple[float, float], ...] = ()
    bounces: bool = False

    @property
    def refuted(self) -> bool:
        """Whether the record clearly wants another amount of it than the effect itself, or all of it."""
        return self.exercised and self._apart(self.share) - rules.SURE * self.std > rules.ASKED_APART

    @property
    def hardly_wanted(self) -> bool:
        """Whether the record wants less than half of it, all weighings taken together: rather none than all."""
        told = self.confirmed
        return told is not None and told["share"] < rules.HALF

    @property
    def wanted(self) -> bool:
        """Whether the record wants about all of it, however what the model leaves is weighed."""
        return self.exercised and self.astray <= rules.ASKED_APART

    @property
    def stands(self) -> bool:
        """Whether the record clearly wants about all of it.

        What stands in for something unknown shares its force with it, and is wanted in another amount as soon as the
        unknown may be a function of the state too. What play makes of another effect by bouncing is luck: no evidence.
        """
        if self.repeats < rules.ASKED_APART:  # of play that hardly ever bounces alike no more can be asked
            return self.wanted and self.bounces
        return self.wanted and max(std for _, std in self._all()) <= rules.SHARE_KNOWN * self.repeats

    @property
    def astray(self) -> float:
        """How far from all of it the record's share is, in the least favourable weighing."""
        return max(self._apart(share) for share, _ in self._all())

    @property
    def confirmed(self) -> dict[str, float] | None:
        """The contract's share, of what the effect asks of itself, and its deviation; None where nothing is told."""
        if not self.exercised or self.repeats < rules.ASKED_APART:
            return None
        shares = np.array(self._all()) / self.repeats
        return {"share": float(shares[:, 0].mean()), "std": float(max(shares[:, 1].max(), np.ptp(shares[:, 0]) / 2))}

    def _all(self) -> list[tuple[float, float]]:
        return [(self.share, self.std), *self.weighed]

    def _apart(self, share: float) -> float:
        return max(self.repeats - share, share - 1.0)


def asked_for(hypothesis: Hypothesis) -> tuple[Share, ...]:
    """How much of each effect of a model its records ask for, all of them at once.

    What every effect changes in the whitened residual, and what the four baseline numbers do, are regressed onto that
    residual. A stand-in for unknown physics fits one motion; on another one it is wanted in another amount. The
    regression is done again with what the model leaves as noise: whitened by its own spectrum, and as a sum of smooth
    functions of the simulated state, with random coefficients of a size read from it (empirical Bayes); where these
    explain nothing to begin with, by its spectrum only.
    """
    problem, model = hypothesis.problem, hypothesis.model
    if not model.effects:
        return ()
    noise = problem.noise(0)
    rests = [hypothesis.with_model(model.without(index)) for index in range(len(model.effects))]
    models = [hypothesis, *rests]
    runs = [*((one, None) for one in (*models, *_beside_baseline(hypothesis))), *((one, noise) for one in models)]
    left = side_by_side(_left, runs)
    (whole, *lefts), (disturbed, *lefts_disturbed) = left[: -len(models)], left[-len(models) :]
    if whole is None:  # what cannot run tells nothing
        return tuple(Share(name, 0.0, 0.0, 1.0, exercised=False) for name in model.names)
    columns = [_change(one, whole) for one in lefts]  # of the effects, then of the baseline's numbers
    again = [_change(one, disturbed) for one in lefts_disturbed]
    spectrum = floor_of_residual(problem.pick(problem.unfollowed(whole), "used"), problem.period, LEFT).whitening
    states = () if problem.states else states_of(hypothesis)
    noises = (problem, problem.with_whitening(spectrum))
    unknown = ((), states) if states else ((),)
    shares: list[list[tuple[float, float]]] = side_by_side(
        _shares_of, [(one, whole, columns, other) for one in noises for other in unknown]
    )
    found = []
    for i, (change, other) in enumerate(zip(columns[: len(again)], again, strict=True)):
        here, there = _gathered(problem, change), _gathered(problem, other)
        repeats = min(1.0, float(here @ there) / max(float(there @ there), 1e-30))
        exercised = float(np.linalg.norm(here)) > rules.EXERCISED * np.sqrt(here.size)
        weighed = tuple(rows[i] for rows in shares[1:])
        found.append(
            Share(model.names[i], *shares[0][i], repeats, exercised, weighed, bounces=has_play(model.effects[i]))
        )
    return tuple(found)


def _shares_of(weighed: Problem, whole: Forces, columns: list[Forces], states: Forces) -> list[tuple[float, float]]:
    """Shares of the changes ``columns`` that ``whole`` asks for, where it may be a function of ``states`` as well."""
    design = np.column_stack([_gathered(weighed, column) for column in columns])
    return _shares(design, _gathered(weighed, whole), orthonormal(_gathered(weighed, states)) if states else None)


def _shares(design: np.ndarray, left: np.ndarray, unknown: np.ndarray | None = None) -> list[tuple[float, float]]:
    """Share of each column of ``design`` (n, k) that ``left`` (n,) asks for, and its deviation, in whitened numbers.

    Along ``unknown`` (n, m), orthonormal, what is left may be structure and counts as noise of its own variance.
    """
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = np.inf  # what changes nothing is not asked for
    unit = design / size
    noise, structure, basis = max(1.0, float(left @ left) / left.size), 0.0, np.zeros((left.size, 0))
    if unknown is not None:
        basis = unknown
        both = np.column_stack([unit, basis])
        rest = left - both @ np.linalg.lstsq(both, left, rcond=1e-10)[0]
        noise = max(1.0, float(rest @ rest) / (left.size - both.shape[1]))
        beside = left - unit @ np.linalg.lstsq(unit, left, rcond=1e-10)[0]
        structure = max(0.0, float(np.mean((basis.T @ beside) ** 2)) - noise)
    quietened = structure / (noise + structure)

    def weighed(x: np.ndarray) -> np.ndarray:
        return (x - quietened * basis @ (basis.T @ x)) / noise

    inverse = np.linalg.pinv(unit.T @ weighed(unit), hermitian=True)
    shares = 1.0 + inverse @ (unit.T @ weighed(left)) / size
    stds = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
    return [(float(share), float(std)) for share, std in zip(shares, stds, strict=True)]


def _gathered(problem: Problem, signals: Forces) -> np.ndarray:
    """Whitened ``signals``, (n,) or (n, k) per record, on the used samples of all records."""
    return problem.gather(problem.whiten(signals), "used")


def _left(hypothesis: Hypothesis, disturbance: Forces | None = None) -> Forces | None:
    """Measured minus simulated force with ``disturbance`` on the carriage; None where the model cannot run."""
    try:
        return hypothesis.residuals(disturbance)
    except SimulationError:
        return None


def _change(left: Forces | None, whole: Forces | None) -> Forces:
    """What ``left`` has more than ``whole``; a model that cannot run tells nothing."""
    if left is None or whole is None:
        return tuple(np.zeros_like(force) for force in left or whole or ())
    return tuple(one - other for one, other in zip(left, whole, strict=True))


def _beside_baseline(hypothesis: Hypothesis) -> list[Hypothesis]:
    """The model with a small step of each baseline number."""
    model = hypothesis.model
    slots = tuple(slot for slot in model.slots() if slot.effect < 0)
    steps = np.diag([STEP * slot.magnitude for slot in slots])
    return [hypothesis.with_model(model.with_vector(slots, moved)) for moved in model.vector(slots) + steps]


def robust(fitted: Fit) -> Fit:
    """Refit the least squares of ``fitted`` to all that may be used: what structure is left pulls less at its numbers.

    Least squares under the noise of the laps takes slow structure for what a parameter does. Here what is left is
    itself the noise (feasible generalised least squares): it weighs least where the structure is, and bursts pull no
    harder than their neighbours (Huber's loss). The result is judged under the noise of ``fitted`` again, of whose
    residual it leaves more.
    """
    model, covariance, slots = fitted.model, fitted.covariance, fitted.model.slots()
    numbers = []
    for _ in range(REWEIGHTED):
        noise = floor_of_residual(fitted.with_model(model).left(), fitted.problem.period, LEFT)
        weighed = fitted.problem.with_whitening(noise.whitening)
        found = descend(model, slots, partial(_loss, weighed), STEPS)
        model, covariance = found.model, found.covariance
        numbers.append(model.vector(slots))
    return evaluate(fitted.with_model(model), slots, widened(covariance, numbers))


def widened(covariance: np.ndarray, numbers: list[np.ndarray]) -> np.ndarray:
    """``covariance`` (k, k) with no deviation smaller than how far ``numbers``, each (k,), lie apart.

    A number that depends on how it is taken from the records is not known better than it moved.
    """
    wider = np.maximum(1.0, np.ptp(numbers, axis=0) / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))
    return covariance * np.outer(wider, wider)


def _loss(problem: Problem, model: Candidate) -> np.ndarray:
    """Numbers (n,) whose sum of squares is Huber's loss of the innovations (n,) that ``model`` leaves."""
    innovations = Hypothesis(problem, model).residual("used")
    size = np.abs(innovations)
    far = np.sqrt(np.maximum(2 * HUBER * size - HUBER**2, 0.0))
    return np.where(size <= HUBER, innovations, np.sign(innovations) * far)


def equivalents(outcome: Outcome) -> dict[str, list[str]]:
    """For each accepted effect, those that could stand in its place as far as these records tell."""
    best, judge = outcome.best, outcome.calibration.judge
    threshold, found = judge.healthy.threshold, {}
    for name in best.model.names:
        others = set_of(best) - {name}
        without = outcome.tried.get(others, outcome.path[0]).cost
        # At the floor chance is the only excuse; above it, what is missing may favour either by a few percent.
        margin = threshold
        if not judge.at_floor(best):
            margin = max(threshold, rules.EQUIVALENT * (without - best.cost))
        rivals = [
            (rival.cost, next(iter(key - others)))
            for key, rival in outcome.tried.items()
            if len(key) == len(others) + 1 and others < key and name not in key and rival.cost <= best.cost + margin
        ]
        found[name] = [rival for _, rival in sorted(rivals)]
    return found


def alike_in_company(outcome: Outcome, stands: Fit) -> dict[str, list[str]]:
    """The same for what ``stands`` beside something unknown, with what it leaves as the noise.

    Tried in the place of each finding are the effects it is known to be confused with, from their own best fit.
    """
    noise = floor_of_residual(stands.left(), stands.problem.period, LEFT).whitening
    weighed, found = stands.problem.with_whitening(noise), {}
    own = evaluate(Hypothesis(weighed, stands.model))
    for index, effect in enumerate(stands.model.effects):
        rest = stands.model.without(index)
        others = [
            (other, values)
            for key, alone in outcome.tried.items()
            for other, values in zip(alone.model.effects, alone.model.values, strict=True)
            if len(key) == len(outcome.path[0].model.names) + 1 and other.name not in stands.model.names
            if effect.confusable(other)
        ]
        begins = [rest, *(rest.with_effect(other, values) for other, values in others)]
        without, *rivals = side_by_side(
            fit, [(Hypothesis(weighed, model), "used", None, RIVAL_STEPS) for model in begins]
        )
        margin = max(outcome.calibration.healthy.threshold, rules.EQUIVALENT * (without.cost - own.cost))
        alike = [rival for rival in rivals if admissible(rival) and rival.cost <= own.cost + margin]
        found[effect.name] = [rival.model.names[-1] for rival in sorted(alike, key=lambda rival: rival.cost)]
    return found


def confirm(judge: Judge, held_out: HeldOut, extended: Fit) -> tuple[Fit, list[Share], tuple[Share, ...]]:
    """Withdraw from ``extended`` what the confirming data refute, or hardly want, one by one, and refit the rest.

    Also returns how much of the rest they ask for, and what was withdrawn. An effect of the controller has its evidence
    in the law, and is not asked for.
    """
    refuted: list[Share] = []
    asked = claims_on(held_out, extended)
    while doubtful := [a for a in asked if a.refuted or a.hardly_wanted]:
        worst = max(doubtful, key=lambda a: abs(a.share - 1) / a.std)
        refuted.append(worst)
        extended = judge.refitted(extended.with_model(extended.model.without_named([worst.name])))
        asked = claims_on(held_out, extended)
    return extended, asked, tuple(refuted)


def standing(held_out: HeldOut | None, extended: Fit) -> tuple[Fit, tuple[Share, ...]]:
    """The robust fit of those effects of ``extended`` that stand on their own evidence, and what was withdrawn.

    An effect that the confirming data do not exercise must stand on the training records. What the model leaves counts
    as noise here, so that an effect may stand beside something unknown. A refit after each withdrawal would bend the
    rest to the unknown: all numbers stay until what is left is wanted. An effect whose share is not known well takes
    the unknown's part till then, lest the others take it; then those that stand are fitted robustly without it, and
    asked for again. A size that now depends on how the rest is weighed was lent by the rest, however alike two records
    are in that; so was a number that now ends where its physics does. A curve through knots, or one element of a
    hysteresis, has no shape of its own to be recognised by: beside something unknown it is part of that.
    """
    extended = _less(extended, [effect.name for effect in extended.model.effects if effect.general or effect.element])
    withdrawn: list[Share] = []
    refitted = False
    while _plant(extended):
        judged = _judged(held_out, extended)
        on_bound = {extended.model.names[slot.effect] for slot in bounds_met(extended)}
        doubtful = [a for a in judged if not a.wanted or a.name in on_bound]
        if refitted and not doubtful:
            doubtful = [a for a in judged if not _size_known(extended, a.name)]
            if not doubtful:
                break
        gone = [max(doubtful, key=lambda a: a.astray)] if doubtful else [a for a in judged if not a.stands]
        withdrawn += gone
        extended = _less(extended, [one.name for one in gone])
        refitted = refitted or not doubtful
        if refitted and _plant(extended):
            extended = robust(fit(extended, part="used"))  # the numbers were those of a model with more effects
    return extended, tuple(withdrawn)


def _size_known(fitted: Fit, name: str) -> bool:
    """Whether a size of the effect is known as well as the share of it has to be; a shape alone has none."""
    index = fitted.model.names.index(name)
    effect, values = fitted.model.effects[index], fitted.model.values[index]
    known = [
        fitted.std(index, place) / max(abs(float(values[0, place])), 1e-30)
        for place, parameter in enumerate(effect.parameters)
        if parameter.linear and parameter.unit != "rad"
    ]
    return not known or min(known) <= rules.SHARE_KNOWN


def _judged(held_out: HeldOut | None, extended: Fit) -> list[Share]:
    """How much of each effect is asked for by the confirming data, by the training records where they tell nothing."""
    asked = [] if held_out is None else claims_on(held_out, extended)
    if asked and all(one.exercised for one in asked):
        return asked
    trained = {one.name: one for one in _claims(asked_for(extended), extended)}
    return [one if one.exercised else trained[one.name] for one in asked or trained.values()]


def claims_on(held_out: HeldOut, extended: Fit) -> list[Share]:
    """How much of each effect of the plant the confirming data ask for."""
    model = extended.model
    return _claims(asked_for(Hypothesis(held_out.problem, adapted(held_out, model, model))), extended)


def _claims(asked: tuple[Share, ...], fitted: Fit) -> list[Share]:
    """Those of ``asked`` that act on the plant: what the controller does is known from its law."""
    return [one for one in asked if one.name in _plant(fitted)]


def _plant(fitted: Fit) -> list[str]:
    return [effect.name for effect in fitted.model.effects if effect.channel != "controller"]


def _less(fitted: Fit, names: list[str]) -> Fit:
    """``fitted`` without the effects called ``names``, all other numbers as they are."""
    return evaluate(fitted.with_model(fitted.model.without_named(names))) if names else fitted


def centred(fitted: Fit) -> Fit:
    """``fitted`` with every instant in the middle of those that leave as little."""
    model = fitted.model
    for index, place, record in _instants(fitted):
        low, high = indistinct(fitted.with_model(model), index, place, record)
        if high > low:
            model = _moved(model, index, place, record, 0.5 * (low + high))
    if model is fitted.model:
        return fitted
    moved = evaluate(fitted.with_model(model), fitted.slots, fitted.covariance)
    return moved if moved.cost < fitted.cost + RISE * _unit(fitted) else fitted


def deviation_in_time(fitted: Fit, index: int, place: int, record: int) -> float:
    """Standard deviation [s] of an instant of effect ``index``: two reach from the middle to either end; else 0."""
    if (index, place, record) not in _instants(fitted):
        return 0.0
    low, high = indistinct(fitted, index, place, record)
    return 0.25 * (high - low)


def indistinct(fitted: Hypothesis, index: int, place: int, record: int) -> tuple[float, float]:
    """The range of instants [s] around that of effect ``index`` on ``record``, all else equal, that leave as little.

    Empty where two samples to either side leave more.
    """
    problem, now = fitted.problem, float(fitted.model.values[index][record, place])
    residual = fitted.residual("used")
    limit = float(residual @ residual) + RISE * _unit(fitted)

    def leaves_as_little(instant: float) -> bool:
        try:
            left = fitted.with_model(_moved(fitted.model, index, place, record, instant)).residual("used")
        except SimulationError:
            return False
        return float(left @ left) < limit

    def end(way: float, bound: float) -> float:
        reached, step = now, FIRST * problem.period
        while reached != bound:
            further = min(reached + step, bound) if way > 0.0 else max(reached - step, bound)
            if not leaves_as_little(further):
                break
            reached, step = further, 2.0 * step
        else:
            return bound
        if reached == now:
            return now
        for _ in range(HALVINGS):
            middle = 0.5 * (reached + further)
            reached, further = (middle, further) if leaves_as_little(middle) else (reached, middle)
        return reached

    duration = len(problem.records[record]) * problem.period
    low, high = side_by_side(end, [(-1.0, 0.0), (1.0, max(duration, now))])
    return low, high


def _unit(fitted: Hypothesis) -> float:
    """Whitened cost of a sample, at least that of noise."""
    residual = fitted.residual("used")
    return max(1.0, float(residual @ residual) / residual.size)


def _instants(fitted: Fit) -> list[tuple[int, int, int]]:
    """Effect, place and record of every free number that is an instant; at its lower bound, 0, it is switched off."""
    values = fitted.model.values
    return [
        (slot.effect, slot.place, slot.record)
        for slot in fitted.model.slots()
        if slot.effect >= 0
        and slot.record is not None
        and slot.quantity.unit == "s"
        and values[slot.effect][slot.record, slot.place] > slot.quantity.lower
    ]


def _moved(model: Candidate, index: int, place: int, record: int, instant: float) -> Candidate:
    """``model`` with another instant of effect ``index`` on ``record``."""
    values = list(model.values)
    values[index] = values[index].copy()
    values[index][record, place] = instant
    return replace(model, values=tuple(values))
