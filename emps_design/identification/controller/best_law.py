"""The control law that explains a command best, how well it does, and its rivals: search, limit, noise, choice in turn.

The search gives a first candidate. Samples in which the limit acts are found from the record and from the law fitted to
the other samples. Then terms that are zero are dropped, and rivals are fitted.

:func:`too_coarse` tests for a reference that is recorded more coarsely than the drive has it. Its derivatives are part
of the command. Where their rounding noise is as large as the difference between the possible sources of feed-forward,
and as large as the residual, fitted filters and gains compensate noise that the drive does not have. A drive whose own
reference has those steps leaves a far smaller residual.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from emps_design.identification.controller.fit import (
    CommandFilter,
    LawFit,
    compress,
    derivatives,
    estimator_slope,
    filtered,
    fit,
    resolution,
    robust_deviation,
    solve,
    usable_behind,
    whitening_filter,
)
from emps_design.identification.controller.regressors import (
    DELAYS,
    ESTIMATORS,
    EVERY,
    PLACE,
    PROPORTIONAL,
    ControllerSignals,
    LawStructure,
    Timing,
    could_pass_for,
    regressors,
    rivals_of,
    sought,
)
from emps_design.identification.controller.search import search
from emps_design.laws.estimators import KnownEstimator, estimator_in_words

PLATEAU = 3  # successive samples at the largest command that may be the limit
NOISE = 6.0  # deviations of the noise below the largest command that still count as it
AT = 3.0  # deviations of the noise below the limit that a limited sample may be
FEWEST_BEYOND = 5  # samples beyond the limit that prove it

NEARBY = 60.0  # of the criterion, at first order: closer ones are fitted in full
FITTED = 3  # of them at most

HOLDS = 0.05  # of the command's deviation: a law with a larger residual does not explain it
AS_GOOD = 6.0  # of the information criterion, odds of 20 : 1: a closer rival is ambiguous
LIMIT_ROUNDS = 4
FEWEST = 200  # samples without a limit for another search
WORSE_THERE = 1.5  # times the residual elsewhere: a larger one on a plateau means that the limit acts
WORSE = 1.1  # times the cost with the integral free behind each plateau: above it anti-windup is not determined

LOUD = 0.5  # of the difference between the sources
ALIKE = 5.0  # factor within which the residual is of the size of the rounding noise
FED_FORWARD = [PLACE["slip"], PLACE["acceleration"]]


def plateau(command: np.ndarray) -> np.ndarray:
    """Mask (n,) of the samples in which ``command`` may be limited: runs at its largest size, within its noise.

    >>> plateau(np.array([0.0, 1.0, 2.0, 2.0, 2.0, 1.0, -1.0, 0.5])).tolist()
    [False, False, True, True, True, False, False, False]
    """
    size = np.abs(command)
    noise = robust_deviation(np.diff(command, 2)) / 6.0**0.5
    top = float(size.max())
    at = size >= top - min(NOISE * noise, 0.02 * top) - 1e-9 * top
    run = np.convolve(at, np.ones(PLATEAU), "same") >= PLATEAU
    if not run.any():
        return run
    level, spread = np.median(size[run]), robust_deviation(size[run])
    return size >= level - NOISE * spread - 1e-9 * top


def longest_between(limited: np.ndarray) -> slice:
    """The longest run of samples that are not ``limited`` (n,).

    >>> longest_between(np.array([False, True, False, False, True]))
    slice(2, 4, None)
    """
    ends = np.flatnonzero(np.diff(limited, prepend=True, append=True))
    longest = int(np.argmax(ends[1::2] - ends[::2])) if ends.size else 0
    return slice(int(ends[2 * longest]), int(ends[2 * longest + 1])) if ends.size else slice(0, 0)


def limited_samples(command: np.ndarray, wanted: np.ndarray, noise: float) -> tuple[np.ndarray, float | None]:
    """Mask (n,) of the samples in which the limit acts, and the limit; ``wanted`` (n,) is the law's unlimited command.

    >>> limited_samples(np.array([1.0, 2.0] + [3.0] * 9), np.array([1.0, 2.0] + [4.0] * 9), 0.01)[1]
    3.0
    """
    beyond = (np.abs(wanted) > np.abs(command) + NOISE * noise) & (np.abs(command) > 0.9 * np.abs(command).max())
    beyond &= wanted * command > 0.0
    if beyond.sum() < FEWEST_BEYOND:
        return np.zeros(command.size, bool), None
    limit = float(np.median(np.abs(command[beyond])))
    if robust_deviation(np.abs(command[beyond])) > 3.0 * noise + 1e-3 * limit:
        return np.zeros(command.size, bool), None
    return (np.abs(wanted) > limit) & (np.abs(command) > limit - AT * noise), limit


def choose(
    signals: ControllerSignals, start: LawFit, worth: float, limited: np.ndarray | None = None
) -> tuple[LawFit, list[LawFit]]:
    """The fit whose rivals are all worse, and these rivals, the best first.

    A filter must gain ``worth`` of the information criterion, and so must one in the velocity estimator.
    """
    law, known = simplify(signals, fit(signals, start, limited), worth, limited), set()
    while True:
        others = rivals(signals, law, limited)
        if not law.seeks_estimator:
            enough = law.criterion - worth
            others = [rival for rival in others if rival.criterion < enough or not rival.seeks_estimator]
        # Dropping a filter may cost something, so that two laws could alternate.
        if not others or others[0].criterion >= law.criterion - 1e-6 or _shape(law) in known:
            return law, others
        known.add(_shape(law))
        law = simplify(signals, others[0], worth, limited)


def _shape(law: LawFit) -> tuple[object, ...]:
    """The structure of a law, without its numbers."""
    estimator = law.timing.velocity_estimator
    kind = estimator_in_words(estimator) if not sought(estimator) else getattr(estimator, "kind", "")
    timing = replace(law.timing, velocity_estimator=kind)
    return law.structure, timing, tuple(stage.kind for stage in law.filters)


def simplify(signals: ControllerSignals, law: LawFit, worth: float, limited: np.ndarray | None) -> LawFit:
    """Drop terms and filters one at a time, as long as the information criterion does not increase."""
    while True:
        fewer = [(*law.filters[:i], *law.filters[i + 1 :]) for i in range(len(law.filters))]
        trials = [replace(law, structure=structure) for structure in law.structure.simpler]
        trials += [replace(law, filters=filters) for filters in fewer]
        if law.seeks_estimator:
            named = [replace(law.timing, velocity_estimator=estimator) for estimator in ESTIMATORS]
            trials += [replace(law, timing=timing) for timing in named]
        for refit in _refits(signals, trials, limited, law.criterion + NEARBY + worth):
            less = len(refit.filters) < len(law.filters) or law.seeks_estimator > refit.seeks_estimator
            allowed = worth if less else 0.0
            if refit.criterion < law.criterion + allowed:
                law = refit
                break
        else:
            if law.structure.feeds_forward:
                return law
            return replace(law, timing=replace(law.timing, profile=False))


def rivals(signals: ControllerSignals, law: LawFit, limited: np.ndarray | None) -> list[LawFit]:
    """The best alternative fit for each choice (estimator, delay, form), the best first.

    For the position loop's samples, and for estimators where the law's has a number, the best few: more than one may
    explain a record as well.
    """
    timing = law.timing
    loops = [replace(law, timing=loop) for loop in _other_loops(law)]
    kinds: list[Iterable[LawFit]] = [
        [replace(law, timing=replace(timing, delay=delay)) for delay in DELAYS if delay != timing.delay],
        [replace(law, structure=structure) for structure in _other_forms(law.structure)],
    ]  # fmt: skip
    estimated: list[LawFit] = []
    if law.structure.velocity:
        instead = rivals_of(timing.velocity_estimator, signals.period)
        estimated = [replace(law, timing=replace(timing, velocity_estimator=estimator)) for estimator in instead]
        if isinstance(timing.velocity_estimator, str):
            kinds, estimated = [*kinds, estimated], []
    if law.structure.feeds_forward and not signals.velocity_reference:  # a filter may imitate source or estimator
        instead = could_pass_for(timing.velocity_estimator)
        filters = [law.filters, *(law.filters[:i] + law.filters[i + 1 :] for i in range(len(law.filters)))]
        sources = [(some, source) for some in filters for source in _sources(timing, instead)]
        kinds.append([replace(law, filters=some, timing=source) for some, source in sources if source != timing])
    others = [*_refits(signals, loops, limited), *_refits(signals, estimated, limited)]
    best = [next(_refits(signals, kind, limited), None) for kind in kinds]
    others += [rival for rival in best if rival is not None]
    return sorted(others, key=lambda f: f.criterion)


def mirrored(signals: ControllerSignals, law: LawFit, limited: np.ndarray | None) -> LawFit | None:
    """The other minimum of a cascade, with the rates of position loop and integral exchanged; None where there is none.

    With the whole reference velocity and a position loop in every sample it is exactly the same law.
    """
    kp, wi = law.position_rate, law.wi
    if law.structure.form != "pi" or not kp > 0.0:
        return None
    middle = float(np.sqrt(kp * wi))
    within = (middle, 4.0 * max(kp, wi)) if wi < middle else (0.25 * min(kp, wi), middle)
    other = fit(signals, law, limited, within)
    inner = within[0] * 1.02 < other.wi < within[1] / 1.02
    return other if inner and other.stabilising else None


def _refits(
    signals: ControllerSignals, trials: Iterable[LawFit], limited: np.ndarray | None, worst: float = np.inf
) -> Iterator[LawFit]:
    """Fits of the stabilising ``trials``, the most promising first; none whose estimate exceeds ``worst``."""
    estimates = [(_first_order(signals, trial, limited), i, trial) for i, trial in enumerate(trials)]
    for estimate, _, trial in sorted(estimates, key=lambda pair: pair[:2])[:FITTED]:
        if estimate > worst:
            return
        refit = fit(signals, trial, limited)
        if refit.stabilising:
            yield refit


def _first_order(signals: ControllerSignals, trial: LawFit, limited: np.ndarray | None) -> float:
    """Criterion of a fit after one step of its filters, infinite where it does not stabilise."""
    raw = regressors(signals, trial.timing, limited)
    columns = filtered(trial.filters, raw, signals.period)
    wi, linear, _, cost = solve(compress(signals, columns), trial.structure, signals.period)
    now = replace(trial, wi=wi, linear=linear, cost=cost)
    if not now.stabilising:
        return np.inf
    own = estimator_slope(signals, now, limited)
    if trial.filters or own:
        slopes = np.column_stack([derivatives(trial.filters, raw @ now.beta, signals.period), *own])
        near = (wi / 1.5, wi * 1.5) if wi else None
        *_, cost = solve(compress(signals, columns, slopes), trial.structure, signals.period, near)
    return replace(now, cost=cost).criterion


def _other_forms(structure: LawStructure) -> list[LawStructure]:
    if not structure.velocity:
        return []
    if not structure.form:  # an integral of the reference's velocity is its position
        whole = structure.position and structure.share == 0
        return [replace(structure, form="ip", position=False, share=1)] if whole else []
    other = "ip" if structure.form == "pi" else "pi"
    return [replace(structure, form=other, share=share) for share in dict.fromkeys((structure.share, None))]


def _other_loops(law: LawFit) -> list[Timing]:
    """Other rates of the position loop from the first sample on, and other first samples for the present rate."""
    if not law.structure.position:
        return []
    loops = [(every, 0) for every in EVERY] + [(law.timing.every, phase) for phase in range(1, law.timing.every)]
    timings = [replace(law.timing, every=every, phase=phase) for every, phase in loops]
    if law.structure.feeds_forward:  # with a wrong source of feed-forward the rate does not show
        own = law.timing.velocity_estimator
        estimators = dict.fromkeys((*ESTIMATORS, own))
        timings = [source for timing in timings for source in _sources(timing, list(estimators))]
    return [timing for timing in timings if timing != law.timing]


def _sources(timing: Timing, estimators: Sequence[KnownEstimator]) -> list[Timing]:
    """``timing`` with each source of the feed-forward, and each of the ``estimators`` of the velocity."""
    return [replace(timing, profile=profile, velocity_estimator=e) for profile in (False, True) for e in estimators]


@dataclass(frozen=True)
class BestLaw:
    """The law that explains a command best; its residual is ``rms``, a ``share`` of the command's deviation."""

    signals: ControllerSignals  # whitened
    fit: LawFit
    rivals: list[LawFit]
    rms: float
    share: float
    limited: np.ndarray | None
    limit: float | None
    holds: bool | None  # whether the integral stops at the limit; None: not determined

    @property
    def held(self) -> np.ndarray | None:
        """Mask (n,) of the samples in which the integral stops."""
        return self.limited if self.holds else None

    def apart(self, other: LawFit) -> float:
        """Norm of the difference between the commands of the law and of ``other``, in deviations of the noise."""
        own, another = (command_of(self.signals, law, self.held) for law in (self.fit, other))
        noise = np.sqrt(self.fit.cost / self.fit.samples)
        return float(np.linalg.norm(self.signals.counted(own - another)) / noise)


def best_law(signals: ControllerSignals, only: LawStructure | None = None) -> BestLaw:
    """The law that explains the command best, however well; of the structure ``only`` where that is given."""
    flat = plateau(signals.command) & signals.used
    worth, none = 0.0, tuple[CommandFilter, ...]()
    attempts = []
    first = signals.first_level if signals.records else signals
    whole, flat_there = slice(0, len(first)), flat[: len(first)]
    for part, stands_still in ((whole, None), (whole, flat_there), (longest_between(flat_there | ~first.used), None)):
        if only is None:
            if part.stop - part.start < FEWEST:
                break
            best = search(first.part(part), stands_still)[0]
            structure, timing, filters, worth = best.structure, best.timing, best.filters, best.filter_worth
            timing = replace(timing, phase=(part.start + timing.phase) % timing.every)
        else:
            structure, timing, filters = only, Timing(), none
        start = LawFit(replace(structure, offset=True), timing, filters, 0.0, np.zeros(0), 1.0, 1)
        if flat.any() and not signals.velocity_reference:  # a search mistakes a clipped peak for a filtered one
            free = replace(signals, used=signals.used & ~flat)
            plain = LawFit(PROPORTIONAL, Timing(), none, 0.0, np.zeros(0), 1.0, 1)
            start = min((fit(free, trial) for trial in (start, plain)), key=lambda trial: trial.criterion)
        free, fitted, limited, limit, holds = _fit_below_limit(signals, start, flat)
        residual = _residual(free, fitted, limited if holds else None)
        attempts.append((float(np.std(residual[free.used])), worth, free, fitted, limited, limit, holds))
        if only is not None or (limit is None and _explains_plateau(signals, residual, flat)):
            break
    _, worth, free, fitted, limited, limit, holds = min(attempts, key=lambda attempt: attempt[0])
    held = limited if holds else None
    if free.records and not fitted.structure.form:
        free = replace(free, levels=None, records=False)
        fitted = fit(free, fitted, held)
    white, fitted, rivals = _final_fit(free, fitted, only is None, worth, held)
    if limit is not None and holds is None:  # the final law may determine whether the integral stops
        again = _fit_below_limit(signals, replace(fitted, structure=replace(fitted.structure, offset=True)), flat)
        if again[-1] is not None:
            free, fitted, limited, limit, holds = again
            held = limited if holds else None
            white, fitted, rivals = _final_fit(free, fitted, only is None, worth, held)
    if (other := mirrored(white, fitted, held)) is not None:
        # Where both are equal, the position loop is taken as the slower one, as it is usually tuned.
        if other.criterion < fitted.criterion - AS_GOOD or (
            other.criterion < fitted.criterion + AS_GOOD and other.position_rate < other.wi
        ):
            fitted, other = other, fitted
        rivals = [other, *rivals]
    fitted, *rivals = map(_with_sorted_filters, (fitted, *rivals))
    rms = float(np.sqrt(np.mean(_residual(free, fitted, held)[free.used] ** 2)))
    share = rms / float(np.std(signals.command[free.used]))
    return BestLaw(white, fitted, rivals, rms, share, limited, limit, holds)


def _final_fit(
    free: ControllerSignals, start: LawFit, rivalled: bool, worth: float, held: np.ndarray | None
) -> tuple[ControllerSignals, LawFit, list[LawFit]]:
    """The signals behind a filter that whitens the residual of ``start``, the law fitted to them, and its rivals."""
    fitted = simplify(free, start, worth, held)
    whitening = whitening_filter(_residual(free, fitted, held), free.used) if free.times is None else free.whitening
    white = replace(free, whitening=whitening, used=usable_behind(free.used, whitening))
    if rivalled:
        return white, *choose(white, fitted, worth, held)
    return white, simplify(white, fit(white, fitted, held), worth, held), []


def _with_sorted_filters(law: LawFit) -> LawFit:
    """``law`` with its filters sorted by kind and frequency, for the order of fitting depends on rounding."""
    return replace(law, filters=tuple(sorted(law.filters, key=lambda stage: (stage.kind, stage.frequency))))


def command_of(signals: ControllerSignals, law: LawFit, held: np.ndarray | None) -> np.ndarray:
    """Command (n,) of a fit without its limit."""
    return filtered(law.filters, regressors(signals, law.timing, held) @ law.beta, signals.period)


def _residual(signals: ControllerSignals, law: LawFit, held: np.ndarray | None) -> np.ndarray:
    """Residual (n,) of a fit in the samples that count, 0 in others."""
    residual = np.zeros(len(signals))
    residual[signals.used] = signals.counted(signals.command - command_of(signals, law, held))
    return residual


def _explains_plateau(signals: ControllerSignals, residual: np.ndarray, flat: np.ndarray) -> bool:
    """Whether a law without a limit explains the samples ``flat`` (n,) as well as the rest: none acts then."""
    there, rest = flat & signals.used, ~flat & signals.used
    if not there.any():
        return True
    at_all = HOLDS * float(np.std(signals.command[signals.used]))
    of_rest = float(np.sqrt(np.mean(residual[rest] ** 2)))
    return of_rest <= at_all and float(np.sqrt(np.mean(residual[there] ** 2))) <= WORSE_THERE * of_rest


def _unlimited_command(signals: ControllerSignals, law: LawFit, held: np.ndarray | None) -> np.ndarray:
    """Command (n,) of a fit without its limit, with the constant of each level."""
    command = command_of(signals, law, held)
    if signals.levels is None:
        return command
    known, residual = signals.levels[signals.used], (signals.command - command)[signals.used]
    count = signals.levels[-1] + 1
    means = np.bincount(known, residual, count) / np.maximum(np.bincount(known, None, count), 1)
    return command + means[signals.levels]


def _fit_below_limit(
    signals: ControllerSignals, start: LawFit, flat: np.ndarray
) -> tuple[ControllerSignals, LawFit, np.ndarray | None, float | None, bool | None]:
    """Fit the samples in which no limit acts, alternating between the law and the samples that it shows to be limited.

    Returns the signals that count, the fit, where the limit acts, the limit, and whether the integral stops there.
    """
    if not flat.any():
        return signals, fit(signals, start), None, None, True
    # At first it is unknown where the integral stopped: it may have any value behind each plateau.
    levels = np.cumsum(np.diff(flat.astype(int), prepend=0) == -1) + (0 if signals.levels is None else signals.levels)
    apart = replace(signals, used=signals.used & ~flat, levels=levels, records=False)
    loose = fit(apart, start)
    wanted = _unlimited_command(apart, loose, None)
    noise = robust_deviation((signals.command - wanted)[apart.used])
    limited, limit = limited_samples(signals.command, np.where(signals.used, wanted, 0.0), noise)
    if limit is None:
        return signals, fit(signals, start), None, None, True
    best: tuple[ControllerSignals, LawFit, np.ndarray, float, bool] | None = None
    for _ in range(LIMIT_ROUNDS):
        free = replace(signals, used=signals.used & ~limited)
        tried = [(fit(free, loose, limited), True)]
        if start.structure.form:
            tried.append((fit(free, loose), False))
        fitted, holds = min(tried, key=lambda pair: pair[0].cost)
        if best is None or fitted.cost / fitted.samples < best[1].cost / best[1].samples:
            best = free, fitted, limited, limit, holds
        wanted = _unlimited_command(free, fitted, limited if holds else None)
        noise = robust_deviation((signals.command - wanted)[free.used])
        now, level = limited_samples(signals.command, np.where(signals.used, wanted, 0.0), noise)
        if level is None or np.array_equal(now, limited):
            break
        limited, limit = now, level
    assert best is not None
    if best[1].cost / best[1].samples > WORSE * loose.cost / loose.samples:
        return apart, loose, flat, limit, None
    return best


def too_coarse(best: BestLaw) -> float:
    """The resolution of the reference where it hides the feed-forward, 0 where it does not."""
    signals, law = best.signals, best.fit
    step = 0.0 if signals.velocity_reference or not law.structure.feeds_forward else resolution(signals.reference)
    if not step:
        return 0.0
    difference, profile = (replace(law.timing, profile=source) for source in (False, True))
    rounding = step * np.random.default_rng(0).uniform(-0.5, 0.5, len(signals))
    steps = replace(signals, reference=rounding, position=np.zeros(len(signals)))
    gains = law.beta[FED_FORWARD]

    def rms(table: np.ndarray) -> float:
        return float(np.sqrt(np.mean((table[:, FED_FORWARD] @ gains)[signals.used] ** 2)))

    noise, law_noise = (rms(regressors(steps, timing)) for timing in (difference, law.timing))
    apart = rms(regressors(signals, profile) - regressors(signals, difference))
    own = max(apart**2 - noise**2, 0.0) ** 0.5
    return step if noise > LOUD * own and law_noise / ALIKE < best.rms < ALIKE * law_noise else 0.0
