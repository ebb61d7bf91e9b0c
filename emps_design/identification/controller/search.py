"""Search for the structure that explains a command best: timing and filters in turn, for each delay and form.

The search works on cross spectra of the record in bands, without touching the samples again. A filter multiplies the
regressors' spectra, a delay rotates their phase, and both are nearly constant over a band. So the residual squares of a
candidate are a sum over some hundred bands. Spectra are those of first differences divided by ``1 - z^-1``: a record
need not end where it began, and its mean does not count. The best candidate is the start of :mod:`.fit`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from emps_design.identification.controller.fit import CommandFilter, moved_filters
from emps_design.identification.controller.regressors import (
    COLUMNS,
    DELAYS,
    ESTIMATORS,
    EVERY,
    PROPORTIONAL,
    SAMPLED,
    ControllerSignals,
    LawStructure,
    Timing,
    at_step,
    beside,
    could_pass_for,
    regressors,
    sampled_regressors,
    sought,
    with_numbers,
)
from emps_design.laws.estimators import KnownEstimator, estimator_at

BANDS = 200
RIDGE = 1e-11  # of the scaled normal equations, where gains cannot be told apart
SCAN = 31  # integral rates tried, from a negligible one on

MOST_FILTERS = 3
WORTH = 20.0  # of the information criterion: least gain of a further filter
FILTER_SHOWS = 0.1  # share of the residual's rms that a filter must remove where the noise is on the position
STILL_GAINS = 1e-8  # of the logarithm of the squares: a step that gains less is the last one
FURTHEST = 6.0  # largest change of the logarithm of an integral rate from its scanned value
STEPS, FIRST_STEPS = 40, 12  # of the minimisation over filters, and to choose among starts
TURNS = 8  # of timing and filters, at most
LOWPASSES = np.geomspace(0.003, 0.5, 16)  # of the sampling frequency
NOTCHES = [
    (share, damping, depth)
    for share in np.geomspace(0.004, 0.42, 28)
    for damping in (0.1, 0.4, 1.0)
    for depth in (0.1, 0.6)
]
FOLLOWED, FOLLOWED_ON = 5, 2  # of the best candidates, in the first turn and later
APART = 0.3  # of the logarithm of a frequency
STARTS = 2  # notches, of those, that are followed
RATIOS, MOVES = (1.4, 1.1, 1.02), 4  # by which the number of an estimator moves, and how often


@dataclass(frozen=True)
class BandSpectra:
    """Cross spectra in bands about ``z`` (n_bands,) on the unit circle: ``regressors`` (n_bands, n_columns^2), real,
    ``answer`` (n_bands, n_columns), of the regressors with the command, ``power`` (n_bands,) of the command; ``counts``
    (n_bands,) frequencies in each; ``position`` (n_bands, n_columns) how regressors answer to the position."""

    z: np.ndarray
    regressors: np.ndarray
    answer: np.ndarray
    power: np.ndarray
    counts: np.ndarray
    position: np.ndarray
    samples: int
    period: float

    @cached_property
    def back(self) -> np.ndarray:
        """``z`` to the powers 0, -1 and -2, (3, n_bands)."""
        return np.stack([np.ones_like(self.z), 1.0 / self.z, self.z**-2])


def transform(signals: ControllerSignals, columns: np.ndarray) -> np.ndarray:
    """Spectra (n_frequencies, n_columns) of ``columns`` (n, n_columns), without frequency 0, whitened."""
    columns = columns[int(np.argmax(signals.used)) :]
    n = scipy.fft.next_fast_len(len(columns), real=True)
    steps = np.diff(columns, axis=0, prepend=columns[:1])
    steps[0] += columns[0] * np.all(columns == columns[0], axis=0)
    values = scipy.fft.rfft(steps, n, axis=0)[1:]
    z = np.exp(2j * np.pi * np.arange(1, len(values) + 1) / n)
    weight = np.polyval(signals.whitening[::-1], 1.0 / z) / (1.0 - 1.0 / z) * np.sqrt(2.0 / n)
    return values * weight[:, None]


def bands(n: int) -> np.ndarray:
    """First frequency of each band out of ``n``: as wide as their distance from 0 allows."""
    return np.unique(np.concatenate([[0], np.geomspace(1, n, BANDS), np.linspace(1, n, BANDS)]).astype(int))[:-1]


def cross(
    signals: ControllerSignals, values: np.ndarray, command: np.ndarray, timing: Timing, like: BandSpectra | None = None
) -> BandSpectra:
    """Cross spectra of ``values`` (n_frequencies, n_columns) with each other and with that of the ``command``.

    ``like`` are known spectra that differ only in the samples of the position loop, and so in few columns.
    """
    edges, width = bands(len(values)), len(COLUMNS)
    new = width if like is None else SAMPLED
    products = (values[:, :new, None].conj() * values[:, None, :]).real.reshape(len(values), -1)
    both = np.add.reduceat(products, edges).reshape(-1, new, width)
    answer = np.add.reduceat(values[:, :new].conj() * command[:, None], edges)
    if like is not None:
        whole = like.regressors.reshape(-1, width, width).copy()
        whole[:, :new], whole[:, :, :new] = both, both.transpose(0, 2, 1)
        both, answer = whole, np.column_stack([answer, like.answer[:, new:]])
    middle = 0.5 * (edges + np.append(edges[1:], len(values)) + 1)
    samples = len(signals) - int(np.argmax(signals.used))
    z = np.exp(2j * np.pi * middle / scipy.fft.next_fast_len(samples, real=True))
    power = np.add.reduceat(np.abs(command) ** 2, edges)
    counts = np.diff(np.append(edges, len(values)))
    position = position_response(z, signals.period, timing, signals.velocity_reference)
    return BandSpectra(z, both.reshape(len(edges), -1), answer, power, counts, position, samples, signals.period)


def position_response(z: np.ndarray, period: float, timing: Timing, velocity_reference: bool) -> np.ndarray:
    """Response (n_bands, n_columns) of each regressor to the position at ``z`` (n_bands,); holds are ignored."""
    rate = estimator_at(timing.velocity_estimator, 1.0 / z, period) * (1.0 - 1.0 / z) / period
    total = period / (1.0 - 1.0 / z)
    error = np.zeros_like(z) if velocity_reference else -np.ones_like(z)
    none = np.zeros_like(z)
    return np.stack([error, error * total, -rate, -rate * total, rate, rate * total, none, none, none, none], axis=1)


def response(filters: tuple[CommandFilter, ...], s: BandSpectra, delay: int) -> np.ndarray:
    """Frequency response (n_bands,) of the filters and the delay."""
    total = s.z ** (-float(delay))
    for stage in filters:
        top, bottom = stage.coefficients(s.period)
        powers = s.back[: len(top)]
        total = total * (top @ powers) / (bottom @ powers)
    return total


def normal(s: BandSpectra, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the regressors behind the responses ``h`` (..., n_bands)."""
    width = len(COLUMNS)
    return (np.abs(h) ** 2 @ s.regressors).reshape(*h.shape[:-1], width, width), (h.conj() @ s.answer).real


def least(
    s: BandSpectra, equations: tuple[np.ndarray, np.ndarray], structure: LawStructure, wi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residual squares (m,) and linear coefficients (m, n_linear) at the integral rates ``wi`` (m,).

    There is one set of normal ``equations`` for all rates, or one for each.
    """
    gram, answer = equations
    combine = structure.combination(wi)
    turned = combine.transpose(0, 2, 1)
    g = turned @ gram @ combine
    a = (turned @ answer[..., None])[..., 0]
    scale = np.sqrt(np.maximum(np.einsum("mii->mi", g), 1e-300))
    g = g / scale[:, :, None] / scale[:, None, :] + RIDGE * np.eye(g.shape[1])
    a = a / scale
    coefficients = np.linalg.solve(g, a[..., None])[..., 0]
    squares = np.maximum(s.power.sum() - np.einsum("mi,mi->m", coefficients, a), 1e-14 * s.power.sum())
    return squares, coefficients / scale


def squares_and_slopes(
    s: BandSpectra, filters: tuple[CommandFilter, ...], delay: int, structure: LawStructure, wi: float
) -> tuple[float, np.ndarray]:
    """Residual squares and their derivatives (1 + n_numbers,): by the logarithm of ``wi`` and the filters' numbers.

    The linear coefficients are optimal, so to first order their change does not matter.
    """
    h = response(filters, s, delay)
    gram, answer = normal(s, h)
    squares, linear = least(s, (gram, answer), structure, np.array([wi]))
    beta = structure.combination(wi) @ linear[0]
    by_rate = (beta - structure.combination(0.0) @ linear[0]) @ (gram @ beta - answer)
    by_response = np.abs(h) ** 2 * _explained(s, beta) - h * (s.answer @ beta).conj()
    slopes = [by_rate]
    for stage in filters:
        top, bottom = stage.coefficients(s.period)
        powers = s.back[: len(top)]
        over_top, over_bottom = by_response / (top @ powers), by_response / (bottom @ powers)
        slopes += [float((t @ powers @ over_top - b @ powers @ over_bottom).real) for t, b in stage.slopes(s.period)]
    return float(squares[0]), 2.0 * np.array(slopes)


def coloured(s: BandSpectra, h: np.ndarray, beta: np.ndarray) -> float:
    """Residual squares, weighted for noise that is white on the recorded position instead of on the command.

    A position that is recorded with a coarser resolution than the controller's leaves such a residual, which the law
    itself colours.
    """
    residual = s.power - 2.0 * (h.conj() * (s.answer @ beta)).real + np.abs(h) ** 2 * _explained(s, beta)
    shape = np.maximum(np.abs(h * (s.position @ beta)) ** 2, 1e-300)
    shape = shape / np.exp(np.average(np.log(shape), weights=s.counts))
    return float(max(np.sum(np.maximum(residual, 0.0) / shape), 1e-14 * s.power.sum()))


def _explained(s: BandSpectra, beta: np.ndarray) -> np.ndarray:
    """Power (n_bands,) of the regressors' combination ``beta`` (n_columns,), before any filter."""
    return s.regressors @ np.outer(beta, beta).ravel()


def rates(s: BandSpectra) -> np.ndarray:
    """Integral rates to try [1/s]."""
    return np.geomspace(1e-3 / (s.samples * s.period), 0.3 / s.period, SCAN)


@dataclass(frozen=True)
class LawCandidate:
    """A structure with its timing and filters, the integral rate ``wi`` [1/s], and its residual squares."""

    structure: LawStructure
    timing: Timing
    filters: tuple[CommandFilter, ...]
    wi: float
    cost: float
    coloured: float
    samples: int

    @property
    def position_noise(self) -> bool:
        """Whether the residual looks like noise on the recorded position rather than on the command."""
        return self.coloured < self.cost

    @property
    def criterion(self) -> float:
        """Bayesian information criterion, with noise on command or position, whichever fits better."""
        n, size = self.samples, self.structure.size + sum(len(f.numbers) for f in self.filters)
        squares = min(self.cost, self.coloured)
        return n * float(np.log(squares / n)) + size * float(np.log(n)) + self.timing.surprise

    @property
    def filter_worth(self) -> float:
        """Least gain in the criterion of a further filter.

        Loud noise on the position weakens the command's response as a filter would; gains that are small beside the
        residual are then no evidence of a filter.
        """
        return -2.0 * self.samples * float(np.log(1.0 - FILTER_SHOWS)) if self.position_noise else WORTH


class Spectrum:
    """The spectra of one record at every timing, each computed when first asked for."""

    def __init__(self, signals: ControllerSignals, limited: np.ndarray | None = None) -> None:
        self.signals, self.limited = signals, limited
        self.command = transform(signals, signals.command[:, None])[:, 0]
        self.fixed: dict[Timing, np.ndarray] = {}
        self.known: dict[Timing, BandSpectra] = {}

    def at(self, timing: Timing) -> BandSpectra:
        """The spectra of a timing; its delay does not matter."""
        timing = replace(timing, delay=0)
        if timing in self.known:
            return self.known[timing]
        often = replace(timing, every=1, phase=0)
        if often not in self.known:
            self.fixed[often] = transform(self.signals, regressors(self.signals, often, self.limited))
            self.known[often] = cross(self.signals, self.fixed[often], self.command, often)
        if timing != often:
            values = self.fixed[often].copy()
            values[:, :SAMPLED] = transform(self.signals, sampled_regressors(self.signals, timing, self.limited))
            self.known[timing] = cross(self.signals, values, self.command, timing, self.known[often])
        return self.known[timing]

    @cached_property
    def starts(self) -> tuple[tuple[list[CommandFilter], np.ndarray], ...]:
        """Initial low-passes and notches with their responses (n, n_bands), the same for any timing."""
        rate, s = 1.0 / self.signals.period, self.at(Timing())
        lowpasses = [CommandFilter.lowpass(share * rate) for share in LOWPASSES]
        notches = [CommandFilter.notch(share * rate, *rest) for share, *rest in NOTCHES]
        return tuple((some, np.stack([response((stage,), s, 0) for stage in some])) for some in (lowpasses, notches))


def search(signals: ControllerSignals, limited: np.ndarray | None = None) -> list[LawCandidate]:
    """The best candidate for each form, delay and estimator, the best first."""
    spectrum = Spectrum(signals, limited)
    follows: dict[str, Any] = {"position": False, "share": 1} if signals.velocity_reference else {}
    structures = [LawStructure(form=form, force=signals.force is not None, **follows) for form in ("pi", "ip")]
    if not signals.velocity_reference:
        structures += [replace(structures[1], position=False, share=1), PROPORTIONAL]
    timings = [Timing(1, 0, delay, name) for name in ESTIMATORS for delay in DELAYS]
    plain = [evaluate(spectrum, structure, timing, ()) for structure in structures for timing in timings]
    plain += _with_estimator_numbers(spectrum, structures)
    started = [one_more_filter(spectrum, trial) or trial for trial in plain]
    started.sort(key=lambda c: c.criterion)
    beam, done = started[:FOLLOWED], []
    for turn in range(TURNS):
        after = [improve(spectrum, trial) for trial in beam]
        done += [old for old, new in zip(beam, after, strict=True) if new is old]
        beam = sorted((new for old, new in zip(beam, after, strict=True) if new is not old), key=lambda c: c.criterion)
        beam = beam[: FOLLOWED if turn == 0 else FOLLOWED_ON]
        if not beam:
            break
    best, *others = sorted(done + beam, key=lambda c: c.criterion)
    return [_with_best_phase(spectrum, best), *others]


def _with_estimator_numbers(spectrum: Spectrum, structures: Sequence[LawStructure]) -> list[LawCandidate]:
    """The best candidates without filters, one of each kind of estimator that has a number."""
    period, best = spectrum.signals.period, dict[str, LawCandidate]()
    pairs = [(structure, delay) for structure in structures if structure.velocity for delay in DELAYS]
    for estimator in with_numbers(period):
        for structure, delay in pairs:
            trial = evaluate(spectrum, structure, Timing(1, 0, delay, estimator), ())
            if estimator.kind not in best or trial.criterion < best[estimator.kind].criterion:
                best[estimator.kind] = trial
    return [_refined(spectrum, trial) for trial in best.values()]


def _refined(spectrum: Spectrum, now: LawCandidate) -> LawCandidate:
    """The candidate with the best number of its estimator; the last step is parabolic interpolation."""
    period = spectrum.signals.period

    def with_(estimator: KnownEstimator) -> LawCandidate:
        timing = replace(now.timing, velocity_estimator=estimator)
        return candidate(spectrum.at(timing), now.structure, timing, now.filters, now.wi)

    for ratio in RATIOS:
        for _ in range(MOVES):
            near = [with_(estimator) for estimator in beside(now.timing.velocity_estimator, period, ratio)]
            better = min((now, *near), key=lambda c: c.criterion)
            if better is now:
                break
            now = better
        if len(near) == 2 and sought(now.timing.velocity_estimator):
            low, middle, high = (neighbour.criterion for neighbour in (near[0], now, near[1]))
            bend = low - 2.0 * middle + high
            step = 0.5 * (low - high) / bend * float(np.log(ratio)) if bend > 0.0 else 0.0
            now = min(now, with_(at_step(now.timing.velocity_estimator, step, period)), key=lambda c: c.criterion)
    return now


def _with_best_phase(spectrum: Spectrum, now: LawCandidate) -> LawCandidate:
    """The candidate whose position loop starts in another sample of the record, where that is better."""
    if not now.structure.position:
        return now
    loops = [replace(now.timing, every=every, phase=phase) for every in EVERY for phase in range(every)]
    timed = min((evaluate(spectrum, now.structure, loop, now.filters) for loop in loops), key=lambda c: c.criterion)
    return min(now, polish(spectrum, timed), key=lambda c: c.criterion)


def improve(spectrum: Spectrum, now: LawCandidate) -> LawCandidate:
    """Choose the position loop's samples, then add or exchange a filter; the same candidate where nothing is better."""
    best = now
    if now.structure.position:
        loops = [replace(now.timing, every=every) for every in EVERY]
        timed = min((evaluate(spectrum, now.structure, loop, now.filters) for loop in loops), key=lambda c: c.criterion)
        if timed.timing != now.timing:
            best = min(best, polish(spectrum, timed), key=lambda c: c.criterion)
    if best.structure.feeds_forward and not spectrum.signals.velocity_reference:
        profile, estimators = not best.timing.profile, could_pass_for(best.timing.velocity_estimator)
        sources = [replace(best.timing, profile=profile, velocity_estimator=e) for e in estimators]
        taken = [evaluate(spectrum, best.structure, other, best.filters) for other in sources]
        best = min((best, *(polish(spectrum, trial) for trial in taken)), key=lambda c: c.criterion)
    if best.structure.velocity and not isinstance(best.timing.velocity_estimator, str):
        best = polish(spectrum, _refined(spectrum, best))
    fewer = [replace(best, filters=(*best.filters[:i], *best.filters[i + 1 :])) for i in range(len(best.filters))]
    more = [better for trial in (best, *fewer) if (better := one_more_filter(spectrum, trial)) is not None]
    best = min((best, *more), key=lambda c: c.criterion)
    return best if best.criterion < now.criterion - 1.0 else now


def evaluate(
    spectrum: Spectrum, structure: LawStructure, timing: Timing, filters: tuple[CommandFilter, ...]
) -> LawCandidate:
    """The candidate with these filters unchanged, at its best integral rate."""
    s = spectrum.at(timing)
    tried = rates(s) if structure.form else np.zeros(1)
    cost, linear = least(s, normal(s, response(filters, s, timing.delay)), structure, tried)
    cost = np.where(structure.stabilising(linear), cost, s.power.sum())
    return candidate(s, structure, timing, filters, float(tried[int(np.argmin(cost))]))


def candidate(
    s: BandSpectra, structure: LawStructure, timing: Timing, filters: tuple[CommandFilter, ...], wi: float
) -> LawCandidate:
    """The candidate with these filters and this integral rate; one with the wrong sign explains nothing."""
    h = response(filters, s, timing.delay)
    cost, linear = least(s, normal(s, h), structure, np.array([wi]))
    power = float(s.power.sum())
    if not structure.stabilising(linear[0]):
        return LawCandidate(structure, timing, filters, wi, power, power, s.samples)
    spread = coloured(s, h, structure.combination(wi) @ linear[0])
    return LawCandidate(structure, timing, filters, wi, float(cost[0]), spread, s.samples)


def polish(spectrum: Spectrum, start: LawCandidate, steps: int = STEPS) -> LawCandidate:
    """Improve integral rate and filters of a candidate together."""
    s = spectrum.at(start.timing)
    furthest = FURTHEST if start.structure.form else 0.0
    bounds = [(-furthest, furthest)]
    bounds += [(low - x, high - x) for f in start.filters for x, low, high in f.within(s.period)]
    if not np.any(bounds):
        return start

    def numbers(x: np.ndarray) -> tuple[float, tuple[CommandFilter, ...]]:
        return start.wi * float(np.exp(x[0])), moved_filters(start.filters, x[1:], s.period)

    def squares(x: np.ndarray) -> tuple[float, np.ndarray]:
        """Logarithm of the residual squares, and its derivatives."""
        wi, filters = numbers(x)
        total, slopes = squares_and_slopes(s, filters, start.timing.delay, start.structure, wi)
        return float(np.log(total)), slopes / total

    # Stop where a step gains next to nothing: smaller differences of the squares are rounding.
    options = {"ftol": STILL_GAINS, "gtol": 1e-6, "maxiter": steps}
    minimum = scipy.optimize.minimize(
        squares, np.zeros(len(bounds)), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    wi, filters = numbers(minimum.x)
    return candidate(s, start.structure, start.timing, filters, wi)


def one_more_filter(spectrum: Spectrum, now: LawCandidate) -> LawCandidate | None:
    """The candidate with the further filter that gains most, or None where none is worth its parameters."""
    if len(now.filters) == MOST_FILTERS:
        return None
    lowpasses, notches = spectrum.starts
    starts = [*best_starts(spectrum, now, *lowpasses, 1), *best_starts(spectrum, now, *notches, STARTS)]
    best = min((polish(spectrum, start, FIRST_STEPS) for start in starts), key=lambda c: c.criterion)
    best = polish(spectrum, best)
    return best if best.criterion < now.criterion - now.filter_worth else None


def best_starts(
    spectrum: Spectrum, now: LawCandidate, more: list[CommandFilter], responses: np.ndarray, most: int
) -> list[LawCandidate]:
    """The candidate with one filter of ``more`` added: up to ``most``, best first, with distinct frequencies."""
    s = spectrum.at(now.timing)
    h = response(now.filters, s, now.timing.delay)
    costs, _ = least(s, normal(s, h * responses), now.structure, np.full(len(more), now.wi))
    starts: list[LawCandidate] = []
    for i in np.argsort(costs, kind="stable"):
        if all(abs(more[i].numbers[0] - f.filters[-1].numbers[0]) > APART for f in starts):
            starts.append(replace(now, filters=(*now.filters, more[i]), cost=float(costs[i])))
        if len(starts) == most:
            break
    return starts
