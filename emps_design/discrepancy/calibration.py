"""The second stage: the fitted baseline, its noise level, and the gain that chance alone reaches.

If no reference repeats, the noise is the part of a stroke that a regression on the other strokes does not predict. The
regressors are the changes in force by the baseline parameters and, if they help, by the starts of each effect and by
smooth functions of the simulated state and its past. The regression is fitted without one stroke and evaluated on that
stroke, for each stroke in turn, so that it cannot fit noise. The remainder is noise and structure outside the span of
the regressors, far less than the residual of the baseline alone.

For the healthy reference, :mod:`~emps_design.discrepancy.acceptance` projects resampled noise onto signatures. That is
fast, but ignores that proposals adapt to the noise as well. :func:`healthy_runs` simulates the fitted baseline with
resampled noise on its voltage instead, and searches each of these records like the measured one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.acceptance import Healthy, Judge, blocks, healthy_reference, resampled
from emps_design.discrepancy.extension import extensions
from emps_design.discrepancy.fit import Fit, fit
from emps_design.discrepancy.noise_floor import STROKES, Floor, floor_of_laps, floor_of_residual
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.preparation import Preparation
from emps_design.discrepancy.problem import Hypothesis, of_unit_length
from emps_design.discrepancy.starts import Start, by_signature, screen, suspects_text, tangent
from emps_design.discrepancy.unknown_force import Kind, states_of
from emps_design.effects import Effect
from emps_design.errors import SimulationError
from emps_design.messages import Message, warning
from emps_design.progress import Progress
from emps_design.simulation import Plant

FitsBySet = dict[frozenset[str], Fit]


def unpredicted_force(fitted: Fit, library: tuple[Effect, ...]) -> tuple[np.ndarray, ...]:
    """Force [N] of the used samples that the other strokes do not predict, (n_used,) per record.

    ``fitted`` is the baseline without whitening: its innovations are forces.
    """
    problem = fitted.problem
    rows = _thinned(problem.strokes("used"))
    samples = np.concatenate([np.arange(stroke.start, stroke.stop) for stroke in rows])
    adjusted = tangent(fitted, "used")
    base = adjusted.whole[samples]

    def changes(starts: list[Start]) -> np.ndarray:
        columns = [np.empty((base.size, 0))]
        for start in starts:
            with suppress(SimulationError):
                columns.append(of_unit_length((start.hypothesis.residual("used")[samples] - base)[:, None]))
        return np.column_stack(columns)

    def smooth() -> np.ndarray:
        return of_unit_length(problem.gather(states_of(fitted), "used")[samples])

    screened = screen(fitted, library, tangent(fitted))
    groups = side_by_side(lambda group: group(), [(smooth,), *((partial(changes, starts),) for starts in screened)])
    edges = np.cumsum([0, *(stroke.stop - stroke.start for stroke in rows)])
    strokes = [slice(start, stop) for start, stop in pairwise(edges)]
    residual = _unpredicted_by_others(of_unit_length(adjusted.basis[samples]), groups, base, strokes)
    records = np.cumsum([split.used.sum() for split in problem.splits])
    return tuple(part for part in np.split(residual, np.searchsorted(samples, records[:-1])) if part.size)


def _thinned(strokes: list[slice]) -> list[slice]:
    """Every n-th of ``strokes``, with at most ``rules.MOST_REGRESSED`` samples in all."""
    samples = sum(stroke.stop - stroke.start for stroke in strokes)
    return strokes[:: max(1, -(-samples // rules.MOST_REGRESSED))]


def _unpredicted_by_others(
    known: np.ndarray, groups: list[np.ndarray], force: np.ndarray, strokes: list[slice]
) -> np.ndarray:
    """``force`` (n,) [N] minus the prediction of each stroke from all others.

    Forward selection: the columns (n, k) are ``known`` and, one after the other, the group of ``groups`` with the
    smallest residual, as long as that is clearly smaller.
    """
    regression = _Regression([known, *groups], force, strokes)
    edges = np.cumsum([0, known.shape[1], *(group.shape[1] for group in groups)])
    first, *others = (np.arange(start, stop) for start, stop in pairwise(edges))
    best = regression.best(first)
    while others:
        trials = side_by_side(regression.best, [(np.concatenate([best.columns, other]),) for other in others])
        place = int(np.argmin([trial.squares for trial in trials]))
        if trials[place].squares > rules.FINER**2 * best.squares:
            break
        best = trials[place]
        del others[place]
    return regression.residual(best)


class _Predictor(NamedTuple):
    """Indices of ``columns``, and the ``ridge`` with the smallest sum of ``squares`` on held-out strokes."""

    columns: np.ndarray
    ridge: float
    squares: float


class _Regression:
    """Leave-one-stroke-out regression of a force (n,) on ``groups`` of columns (n, k), from sums of products."""

    def __init__(self, groups: list[np.ndarray], force: np.ndarray, strokes: list[slice]) -> None:
        self.groups, self.force, self.strokes = groups, force, strokes
        sums = side_by_side(self._sums, [(stroke,) for stroke in strokes])
        self.squares, self.products = (np.array(part) for part in zip(*sums, strict=True))
        self.power = float(force @ force)

    def best(self, columns: np.ndarray) -> _Predictor:
        """The predictor with ``columns`` and the best of ``rules.RIDGES``."""
        squares, products = self.squares[:, columns[:, None], columns], self.products[:, columns]
        costs = []
        for ridge in rules.RIDGES:
            x = self._coefficients(squares, products, ridge)
            costs.append(self.power + float(np.einsum("si,sij,sj", x, squares, x) - 2.0 * np.sum(x * products)))
        least = int(np.argmin(costs))
        return _Predictor(columns, rules.RIDGES[least], costs[least])

    def residual(self, predictor: _Predictor) -> np.ndarray:
        """Force (n,) [N] that ``predictor`` does not predict."""
        columns = predictor.columns
        squares, products = self.squares[:, columns[:, None], columns], self.products[:, columns]
        coefficients = self._coefficients(squares, products, predictor.ridge)

        def residual_of(stroke: slice, x: np.ndarray) -> np.ndarray:
            return self.force[stroke] - self._columns(stroke)[:, columns] @ x

        return np.concatenate(side_by_side(residual_of, zip(self.strokes, coefficients, strict=True)))

    def _columns(self, stroke: slice) -> np.ndarray:
        """All columns along one stroke."""
        return np.column_stack([group[stroke] for group in self.groups])

    def _sums(self, stroke: slice) -> tuple[np.ndarray, np.ndarray]:
        """Gram matrix (k, k) of the columns along one stroke, and their products (k,) with the force."""
        columns = self._columns(stroke)
        return columns.T @ columns, columns.T @ self.force[stroke]

    @staticmethod
    def _coefficients(squares: np.ndarray, products: np.ndarray, ridge: float) -> np.ndarray:
        """Coefficients (strokes, k) fitted to all strokes but one."""
        total = squares.sum(axis=0)
        penalty = ridge * np.trace(total) / len(total) * np.eye(len(total))
        return np.linalg.solve(total - squares + penalty, (products.sum(axis=0) - products)[:, :, None])[:, :, 0]


def healthy_runs(
    baseline: Fit,
    library: tuple[Effect, ...],
    floor: Floor,
    runs: int,
    seed: int,
    progress: Callable[[float], None],
) -> Healthy:
    """Return the largest gain [whitened cost] of any effect of ``library`` on each of ``runs`` healthy records."""
    generator, largest = np.random.default_rng(seed), np.empty(runs)
    for i in range(runs):
        alone = fit(_healthy_records(baseline, floor, generator))
        absorbed = tangent(alone)
        fits, gains = extensions(alone, screen(alone, library, absorbed), absorbed)
        largest[i] = max([0.0, *gains.values(), *(alone.cost_fit - f.cost_fit for f in fits)])
        progress(0.1 * (i + 1) / runs)
    return Healthy(np.sort(largest), searched=True)


def _healthy_records(baseline: Fit, floor: Floor, generator: np.random.Generator) -> Hypothesis:
    """The baseline on records simulated with it, with resampled noise on the voltage."""
    gain, records = baseline.problem.axis.drive.gain, []
    for record, run in zip(baseline.problem.records, baseline.runs(), strict=True):
        noise = floor.whitening.undo(
            resampled(floor.draws, len(record), *blocks(floor.draws.size, len(record), generator))
        )
        records.append(replace(record, q=run.q, u=run.u + noise / gain))
    return Hypothesis(replace(baseline.problem, records=tuple(records)), baseline.model)


def set_of(fitted: Fit) -> frozenset[str]:
    """The names of the effects of ``fitted``, regardless of their order."""
    return frozenset(fitted.model.names)


def best_of_each_set(by_set: FitsBySet, fits: Iterable[Fit]) -> FitsBySet:
    """The best fit of each set of effects in ``by_set`` and ``fits``."""
    best = dict(by_set)
    for fitted in fits:
        key = set_of(fitted)
        if key not in best or fitted.cost < best[key].cost:
            best[key] = fitted
    return best


@dataclass(frozen=True)
class Outcome:
    """The state of a search for effects, which is the input of all later stages.

    Findings are judged by the noise of ``floor`` and by the gains of ``healthy`` records; ``screened`` are the starts
    that extend the baseline. ``path`` are the successive best models, the baseline first; ``tried`` are the best
    admissible fits by their sets of effects; ``gains`` [whitened cost] are those of each effect alone in the first
    round. At most ``most`` effects are added; ``beam`` are the sets to extend, ``closed`` the moves that failed from
    the best model, and ``detours`` the number of detours made. ``interrupted``: the user ended the search;
    ``warnings`` are those of this search and of the searches it replaced; ``unknown_force`` is an unknown force that
    explains the residual of a few effects, or None.
    """

    preparation: Preparation
    floor: Floor
    healthy: Healthy
    screened: list[list[Start]] = field(repr=False)
    path: tuple[Fit, ...]
    tried: FitsBySet = field(repr=False)
    gains: dict[str, float] = field(default_factory=dict, repr=False)
    most: int = 0
    beam: tuple[Fit, ...] = ()
    closed: frozenset[str] = frozenset()
    detours: int = 0
    interrupted: bool = False
    warnings: tuple[Message, ...] = ()
    unknown_force: UnknownForce | None = None

    @property
    def baseline(self) -> Fit:
        """The model from which the search started."""
        return self.path[0]

    @property
    def best(self) -> Fit:
        """The model accepted last."""
        return self.path[-1]

    @property
    def judge(self) -> Judge:
        """The acceptance rules with this noise floor and healthy reference."""
        return Judge(self.floor, self.healthy)

    def accepts(self, better: Fit) -> bool:
        """Whether ``better``, with one effect more, is a finding over the best model."""
        return self.judge.accepts(better, self.best)

    def count_of(self, fitted: Fit) -> int:
        """Number of effects of ``fitted``, not counting those known from the controller's law."""
        return len(fitted.model.effects) - len(self.baseline.model.effects)

    @property
    def count(self) -> int:
        """Number of effects found."""
        return self.count_of(self.best)

    @property
    def alone(self) -> dict[str, float]:
        """The gain of each effect alone [whitened cost]; to first order if no round started from the baseline."""
        return self.gains or {starts[0].model.names[-1]: starts[0].gain for starts in self.screened}

    def with_fits(self, fits: Iterable[Fit], gains: dict[str, float] | None = None) -> Outcome:
        """The same search with ``fits`` among those tried, and the ``gains`` of its first round."""
        return replace(self, tried=best_of_each_set(self.tried, fits), gains=self.gains or gains or {})

    def advanced(self, beam: Sequence[Fit], detour: bool = False, closed: frozenset[str] = frozenset()) -> Outcome:
        """The search with the first of ``beam`` as best model; the moves ``closed`` cannot succeed from there."""
        path, detours = (*self.path, beam[0]), self.detours + detour
        return replace(self, path=path, beam=tuple(beam), closed=closed, detours=detours)

    @property
    def ended_early(self) -> bool:
        """Whether the search ended at an unknown force that explains the residual of a few effects."""
        return self.unknown_force is not None and self.unknown_force.is_sufficient

    @property
    def stopped(self) -> bool:
        """Whether the search stopped at an unknown force and is to be finished."""
        return self.unknown_force is not None and not self.unknown_force.is_sufficient


@dataclass(frozen=True)
class UnknownForce:
    """An unknown force of one ``kind`` of ``unknown_force.KINDS``.

    ``search`` is a search with this force, and ``fitted`` its best model, possibly without effects, fitted to all used
    samples with the force in the loop. Together they explain nearly all of the residual of the model ``start``.
    """

    kind: Kind
    start: Fit
    search: Outcome
    fitted: Fit

    @property
    def is_sufficient(self) -> bool:
        """Whether it explains so much, with few effects, that further effects would only imitate it.

        With many effects the force may itself imitate effects.
        """
        few = self.search.count_of(self.fitted) <= rules.FEW
        return few and self.start.excess() >= rules.PLAIN * self.start.problem.samples("used")


def first_noise(preparation: Preparation) -> tuple[Hypothesis, Floor]:
    """The baseline fitted by ordinary least squares, and its noise floor, from laps or from predictions of strokes."""
    # Kernels are compiled here: simulations run in parallel from now on, and must not compile the same one twice.
    effects = [(effect, np.zeros(len(effect.parameters))) for effect in preparation.library]
    Plant(preparation.start.problem.axis, effects)
    rough = fit(preparation.start)
    floor = floor_of_laps(rough.residuals(), rough.problem.splits, rough.problem.period)
    if floor is None:
        residuals = unpredicted_force(rough, preparation.library)
        floor = floor_of_residual(residuals, rough.problem.period, STROKES)
    return rough, floor


def calibrate(
    preparation: Preparation, start: Hypothesis, floor: Floor, seed: int, runs: int, progress: Progress
) -> Outcome:
    """The start of a search: a baseline fitted from ``start`` with the noise of ``floor``, and its healthy reference.

    The healthy reference is simulated on ``runs`` records, or with 0 computed from resampled noise on signatures.
    """
    progress("healthy reference", 0.0)
    reweighted = Hypothesis(start.problem.with_whitening(floor.whitening), start.model)
    baseline = fit(reweighted)
    warnings: tuple[Message, ...] = ()
    absorbed = tangent(baseline)
    screened = screen(baseline, preparation.library, absorbed)
    progress(f"healthy reference{suspects_text(by_signature(screened, absorbed))}", 0.05)
    healthy = healthy_reference(screened, floor.draws, seed)
    if runs:
        try:
            report = partial(progress, "searching simulated healthy records")
            healthy = healthy_runs(baseline, preparation.library, floor, runs, seed, report)
        except KeyboardInterrupt:
            text = "interrupted: calibrated on resampled noise instead of simulated healthy records"
            warnings = (warning("calibration-interrupted", text),)
    by_set = best_of_each_set({}, [baseline])
    return Outcome(preparation, floor, healthy, screened, (baseline,), by_set, warnings=warnings)
