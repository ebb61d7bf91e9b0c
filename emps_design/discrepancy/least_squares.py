"""Least squares over the free parameters of a candidate model, within their bounds, and their covariance.

A candidate model is the baseline and a set of effects with their parameters; the free ones form one vector.

:func:`descend` is Levenberg-Marquardt. Backlash that bounces makes the cost rough: every impact that moves in time
changes it a little, and a gradient descent ends in the first local minimum. Two methods span many local minima:
:func:`simplex`, the method of Nelder and Mead over the logarithms of some parameters, and :func:`descend_rough`,
Gauss-Newton on linear response surfaces through a neighbourhood, over which the mean is smooth. A few samples at
impacts would still dominate a sum of squares, so large innovations have Cauchy's loss there.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from emps_design.axis import BASELINE, Axis, Mechanics
from emps_design.discrepancy import rules
from emps_design.discrepancy.parallel import side_by_side
from emps_design.effects import Effect, Parameter, kind_of
from emps_design.effects.effect import COULOMB, OFFSET
from emps_design.effects.sizes import sized_parameter
from emps_design.errors import SimulationError
from emps_design.quantities import Quantity


@dataclass(frozen=True)
class Slot:
    """Place of one free parameter: ``effect`` -1 is the baseline; ``record`` None means shared by all records.

    ``magnitude`` is the scale of its steps in a fit.
    """

    effect: int
    place: int
    record: int | None
    quantity: Quantity
    magnitude: float


@dataclass(frozen=True)
class Candidate:
    """Baseline (4,) and one array (n_records, n_parameters) per effect; rows differ in per-record parameters only.

    ``sizes`` are the bounds and scales of the baseline parameters; those at the indices ``held`` are never free.
    """

    baseline: np.ndarray
    effects: tuple[Effect, ...] = ()
    values: tuple[np.ndarray, ...] = ()
    sizes: tuple[Parameter, ...] = BASELINE
    held: tuple[int, ...] = ()

    @classmethod
    def of(cls, axis: Axis, factors: Mapping[str, float], held: tuple[int, ...] = ()) -> Candidate:
        """The baseline of ``axis``, sized by its ``factors`` of :func:`~emps_design.effects.sizes.sizes`."""
        _, *rest = (sized_parameter(parameter, factors) for parameter in BASELINE)
        least = rules.LEAST_MASS * axis.mechanics.mass
        return cls(axis.mechanics.array(), sizes=(replace(BASELINE[0], lower=least, scale=least), *rest), held=held)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    def with_effect(self, effect: Effect, values: np.ndarray) -> Candidate:
        """Add ``effect`` with parameters ``values`` (n_records, n_parameters)."""
        return replace(self, effects=(*self.effects, effect), values=(*self.values, np.atleast_2d(values)))

    def without(self, index: int) -> Candidate:
        """Drop effect number ``index``."""
        keep = [i for i in range(len(self.effects)) if i != index]
        return replace(self, effects=tuple(self.effects[i] for i in keep), values=tuple(self.values[i] for i in keep))

    def without_named(self, names: Iterable[str]) -> Candidate:
        """Drop the effects called ``names``."""
        model = self
        for name in names:
            model = model.without(model.names.index(name))
        return model

    def slots(self, frozen: bool = False) -> tuple[Slot, ...]:
        """The slots of the free parameters; with ``frozen`` only per-record ones.

        An effect of the controller is known from the controller's law and never free.
        """
        slots = []
        if not frozen:
            # A constant force may need steps of the size of the friction before a spring fits.
            magnitudes = np.maximum(np.abs(self.baseline), [parameter.scale for parameter in self.sizes])
            magnitudes[OFFSET] = max(magnitudes[OFFSET], self.baseline[COULOMB])
            numbers = enumerate(zip(self.sizes, magnitudes, strict=True))
            slots += [Slot(-1, i, None, q, s) for i, (q, s) in numbers if i not in self.held]
        for index, (effect, values) in enumerate(zip(self.effects, self.values, strict=True)):
            for place, parameter in enumerate(effect.parameters):
                held = parameter.held_at(values[:, place]) or (frozen and not parameter.per_record)
                if held or effect.channel == "controller":
                    continue
                rows = range(len(values)) if parameter.per_record else (None,)
                for row in rows:
                    value = abs(values[row or 0, place])
                    typical = parameter.scale or max((abs(s) for s in parameter.starts), default=0.0)
                    slots.append(Slot(index, place, row, parameter, max(value, 0.1 * typical, 1e-12)))
        return tuple(slots)

    def with_row(self, index: int, row: np.ndarray) -> Candidate:
        """The same model with parameters ``row`` (n_parameters,) of effect number ``index`` on one record."""
        values = [*self.values[:index], np.atleast_2d(row), *self.values[index + 1 :]]
        return replace(self, values=tuple(values))

    def only(self, record: int) -> Candidate:
        """The same model with the parameters of one record."""
        return replace(self, values=tuple(row[None] for row in self.parameters(record)))

    def vector(self, slots: tuple[Slot, ...]) -> np.ndarray:
        """The values (k,) of ``slots``."""
        return np.array(
            [self.baseline[s.place] if s.effect < 0 else self.values[s.effect][s.record or 0, s.place] for s in slots]
        )

    def with_vector(self, slots: tuple[Slot, ...], vector: np.ndarray) -> Candidate:
        """The same model with the values ``vector`` (k,) of ``slots``, each clipped to its bounds."""
        baseline, values = self.baseline.copy(), [v.copy() for v in self.values]
        for slot, number in zip(slots, vector, strict=True):
            clipped = min(max(float(number), slot.quantity.lower), slot.quantity.upper)
            if slot.effect < 0:
                baseline[slot.place] = clipped
            elif slot.record is None:
                values[slot.effect][:, slot.place] = clipped
            else:
                values[slot.effect][slot.record, slot.place] = clipped
        return replace(self, baseline=baseline, values=tuple(values))

    def parameters(self, record: int) -> tuple[np.ndarray, ...]:
        """Kernel parameters of ``record``, one array per effect."""
        return tuple(v[min(record, len(v) - 1)] for v in self.values)

    def to_axis(self, axis: Axis, record: int = 0) -> Axis:
        """``axis`` with this baseline and these effects, per-record parameters from number ``record``."""
        effects = [
            {"kind": kind_of(e.name), **{p.name: float(x) for p, x in zip(e.parameters, row, strict=True)}}
            for e, row in zip(self.effects, self.parameters(record), strict=True)
        ]
        return axis.replace(mechanics=Mechanics.table(self.baseline), effects=effects)


@dataclass(frozen=True)
class Descent:
    """Result of a descent: the model, its sum of squares, and the covariance of the free parameters."""

    model: Candidate
    cost: float
    covariance: np.ndarray


@dataclass(frozen=True)
class Scaled:
    """The free parameters ``slots`` of ``start`` in units of their magnitudes, and the ``residual`` of a model."""

    start: Candidate
    slots: tuple[Slot, ...]
    residual: Callable[[Candidate], np.ndarray]

    @cached_property
    def magnitude(self) -> np.ndarray:
        """The magnitude (k,) of every parameter."""
        return np.array([s.magnitude for s in self.slots])

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The lower and the upper bounds, (k,) each, scaled."""
        lower, upper = np.array([(s.quantity.lower, s.quantity.upper) for s in self.slots]).reshape(-1, 2).T
        return lower / self.magnitude, upper / self.magnitude

    @property
    def begin(self) -> np.ndarray:
        """The scaled parameters (k,) of ``start``."""
        return self.start.vector(self.slots) / self.magnitude

    def at(self, x: np.ndarray) -> Candidate:
        """The model with the scaled parameters ``x`` (k,)."""
        return self.start.with_vector(self.slots, x * self.magnitude)

    def attempt(self, x: np.ndarray) -> np.ndarray | None:
        """The residual with the scaled parameters ``x`` (k,), None where the model cannot be simulated."""
        try:
            return self.residual(self.at(x))
        except SimulationError:
            return None

    def unscaled(self, covariance: np.ndarray) -> np.ndarray:
        """``covariance`` (k, k) in the units of the parameters."""
        return covariance * np.outer(self.magnitude, self.magnitude)


def descend(
    start: Candidate, slots: tuple[Slot, ...], residual: Callable[[Candidate], np.ndarray], steps: int
) -> Descent:
    """Minimise the sum of squares of ``residual`` over ``slots`` by Levenberg-Marquardt; bounds hold at every step.

    A step to a model that cannot be simulated is rejected. While steps gain much, the Jacobian is updated by Broyden's
    rank-one formula; the last one is computed. The number of simulations is at most that of ``steps`` steps with
    computed Jacobians.
    """
    free = Scaled(start, slots, residual)
    (lower, upper), attempt, x = free.bounds, free.attempt, free.begin
    try:
        current = residual(start)
    except SimulationError:
        return Descent(start, rules.WORST, np.zeros((len(slots),) * 2))
    if not slots:
        return Descent(start, float(current @ current), np.zeros((0, 0)))
    model, damping, nudge, jacobian = start, rules.DAMPING, rules.NUDGE, np.zeros((current.size, len(slots)))
    simulations = steps * (len(slots) + 1)
    while simulations > 0:
        nudges = np.where(x + nudge <= upper, nudge, -nudge)
        shifted = side_by_side(attempt, [(point,) for point in x + np.diag(nudges)])
        for k, (reached, step) in enumerate(zip(shifted, nudges, strict=True)):
            jacobian[:, k] = 0.0 if reached is None else (reached - current) / step
        simulations -= len(slots)
        first, secant, most = float(current @ current), jacobian.copy(), rules.TRIALS
        while most and simulations > 0:
            cost, trials, most = float(current @ current), most, 0
            for trial, tried in itertools.islice(_trial_points(secant, current, x, lower, upper, damping), trials):
                reached, simulations = attempt(trial), simulations - 1
                if reached is None or float(reached @ reached) >= cost:
                    damping = tried * 10
                    continue
                delta, change = trial - x, reached - current
                model, x, current = free.at(trial), trial, reached
                damping = max(tried / 10, rules.NOTHING)
                if float(current @ current) < (1 - rules.MINOR) * cost:
                    secant += np.outer(change - secant @ delta, delta / (delta @ delta))
                    most = 1
                break
        gain = first - float(current @ current)
        if gain == 0.0 and nudge == rules.NUDGE and first > rules.STRUCTURED * current.size:
            damping, nudge = rules.DAMPING, rules.COARSE_NUDGE
        elif gain < rules.CONVERGED[0] * first + rules.CONVERGED[1]:
            break
    return Descent(model, float(current @ current), free.unscaled(covariance_of(jacobian, current)))


def _trial_points(
    jacobian: np.ndarray, residual: np.ndarray, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, damping: float
) -> Iterator[tuple[np.ndarray, float]]:
    """Trial points from ``x`` (k,) within its bounds, each with ten times the damping of the one before.

    No parameter changes by more than half its magnitude, so that a period does not jump over its neighbours.
    """
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    while True:
        free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)))
        lhs = normal[np.ix_(free, free)] + damping * np.diag(np.diag(normal)[free] + 1e-9)
        move = np.zeros_like(x)
        move[free] = -np.linalg.lstsq(lhs, gradient[free], rcond=None)[0]
        yield np.clip(x + np.clip(move, -rules.HALF, rules.HALF), lower, upper), damping
        damping *= 10


def covariance_of(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Covariance (k, k) of a least-squares fit with ``residual`` (n,), in standard deviations of the noise.

    Structure in the residual makes parameters less certain than noise alone: by its size and, because structure is
    correlated, by the scatter of the gradient between pieces of the record (sandwich estimator of Huber and White,
    pieces as clusters). The larger of the two variances is used for each parameter.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    covariance = inverse * max(1.0, float(residual @ residual) / residual.size)
    starts = np.arange(0, residual.size, rules.PIECE)
    gradients = np.add.reduceat(jacobian * residual[:, None], starts, axis=0)
    gradients -= gradients.mean(axis=0)
    spread = inverse @ (gradients.T @ gradients) @ inverse
    wider = np.sqrt(np.maximum(1.0, np.diag(spread) / np.maximum(np.diag(covariance), 1e-300)))
    return covariance * np.outer(wider, wider)


def simplex(
    start: Candidate, slots: tuple[Slot, ...], residual: Callable[[Candidate], np.ndarray], simulations: int
) -> Candidate:
    """``start`` with the positive parameters in ``slots`` minimising the sum of squares of ``residual``.

    At most ``simulations`` simulations; a model that cannot be simulated costs ``rules.WORST``.
    """
    from scipy.optimize import minimize

    def moved(logarithms: np.ndarray) -> Candidate:
        return start.with_vector(slots, np.exp(logarithms))

    def cost(logarithms: np.ndarray) -> float:
        try:
            r = residual(moved(logarithms))
        except SimulationError:
            return rules.WORST
        return float(r @ r)

    first = np.log(np.maximum(start.vector(slots), [1e-3 * slot.magnitude for slot in slots]))
    corners = np.vstack([first, first + rules.SPAN * np.eye(first.size)])
    options = {"initial_simplex": corners, "maxfev": simulations, "xatol": 0.0, "fatol": 0.0}
    return moved(minimize(cost, first, method="Nelder-Mead", options=options).x)


def bounded(innovations: np.ndarray) -> np.ndarray:
    """Residuals whose sum of squares is Cauchy's loss of ``innovations``: logarithmic beyond ``rules.BURST``.

    >>> bounded(np.array([0.0, 0.5, -100.0])).round(3).tolist()
    [0.0, 0.499, -12.241]
    """
    size = rules.BURST
    return np.asarray(np.sign(innovations) * size * np.sqrt(np.log1p((innovations / size) ** 2)))


def descend_rough(start: Candidate, slots: tuple[Slot, ...], residual: Callable[[Candidate], np.ndarray]) -> Descent:
    """Minimise the sum of squares of ``residual`` over ``slots`` by linear response surfaces; returns the best point.

    A surface is fitted to two points on each of k random orthogonal directions, along which all k parameters change.
    Its slopes give the next point. If a simulation fails, the neighbourhood shrinks. The covariance is that of the last
    surface plus that of all points whose cost exceeds the least by no more than the scatter of the last neighbourhood.
    The random directions are the same in every call.
    """
    random, free = np.random.default_rng(0), Scaled(start, slots, residual)
    visited: list[tuple[float, np.ndarray]] = []

    def visit(places: np.ndarray) -> list[np.ndarray] | None:
        met = side_by_side(free.attempt, [(place,) for place in places])
        visited.extend((float(m @ m), place) for m, place in zip(met, places, strict=True) if m is not None)
        return None if any(m is None for m in met) else met

    def least() -> tuple[float, np.ndarray]:
        return min(visited, key=lambda pair: pair[0])

    x = free.begin
    first = visit(x[None])
    covariance, rough = np.zeros((x.size, x.size)), 0.0
    if first is None or not slots:
        return Descent(start, visited[0][0] if visited else rules.WORST, covariance)
    reach, failures = _initial_reach(free.attempt, x, first[0]), 0
    for number in range(rules.SURFACES):
        directions = np.linalg.qr(random.standard_normal((x.size, x.size)))[0] * np.sqrt(x.size) * reach
        met = visit(np.clip(np.concatenate([x + directions, x - directions]), *free.bounds))
        if met is None:
            reach = reach * rules.CLOSER
            continue
        ahead, behind = np.split(np.array(met), 2)
        jacobian = (ahead - behind).T @ directions / (2 * x.size * reach**2)
        middle = np.mean(met, axis=0)
        covariance, rough = covariance_of(jacobian, middle), float(np.std([m @ m for m in met]))
        normal = jacobian.T @ jacobian
        move = -np.linalg.lstsq(normal + rules.DAMPING * np.diag(np.diag(normal)), jacobian.T @ middle, rcond=None)[0]
        target = np.clip(x + np.clip(move, -rules.FARTHEST * reach, rules.FARTHEST * reach), *free.bounds)
        before, reached = least()[0], visit(target[None])
        astray = reached is None or visited[-1][0] > rules.IN_REACH * least()[0]
        x = least()[1] if astray else target
        failures = 0 if least()[0] < (1 - rules.BARELY) * before else failures + (not astray)
        if failures == rules.IN_VAIN:
            break
        if astray:
            reach = reach * rules.CLOSER**2
        elif np.all(np.abs(move) < reach) or number % rules.OFTEN == rules.OFTEN - 1:
            reach = reach * rules.CLOSER
    cost, best = least()
    equal = np.array([place for other_cost, place in visited if other_cost <= cost + rules.ALIKE * rough])
    covariance = covariance + np.cov(equal.T, bias=True).reshape(covariance.shape)
    return Descent(free.at(best), cost, free.unscaled(covariance))


def _initial_reach(attempt: Callable[[np.ndarray], np.ndarray | None], x: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Change (k,) of each of ``x`` (k,) alone that changes the residual ``first`` by ``rules.TWICE`` times its cost."""
    reach, target = np.full(x.size, 1e-3), rules.TWICE * float(first @ first)
    for _ in range(rules.OFTEN):
        met = side_by_side(attempt, [(point,) for point in x + np.diag(reach)])
        changed = [np.inf if residual is None else float(np.sum((residual - first) ** 2)) for residual in met]
        reach = reach * np.clip(np.sqrt(target / np.maximum(changed, 1e-300)), 0.1, 10.0)
    return reach
