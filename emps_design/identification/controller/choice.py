"""From the best candidate of a search to one law: terms that are zero left out, rivals fitted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from emps_design.identification.controller.estimators import (
    ESTIMATORS,
    AnyEstimator,
    could_pass_for,
    rivals_of,
    sought,
)
from emps_design.identification.controller.filters import derivatives, filtered
from emps_design.identification.controller.fit import Fit, compress, estimator_slope, fit, solve
from emps_design.identification.controller.regressors import DELAYS, EVERY, Signals, Timing, regressors
from emps_design.identification.controller.structures import Structure
from emps_design.laws.estimators import estimator_in_words

NEARBY = 60.0  # of the criterion, at first order: closer ones are fitted in full
FITTED = 3  # of them at most


def choose(signals: Signals, start: Fit, worth: float, limited: np.ndarray | None = None) -> tuple[Fit, list[Fit]]:
    """The fit whose rivals are all worse, and these rivals, the best first.

    A filter must be ``worth`` so much of the information criterion, and so must one in the velocity estimator.
    """
    found, known = simplify(signals, fit(signals, start, limited), worth, limited), set()
    while True:
        others = rivals(signals, found, limited)
        if not _filters_velocity(found):
            enough = found.criterion - worth
            others = [one for one in others if one.criterion < enough or not _filters_velocity(one)]
        # To leave a filter out may cost something: two laws could take turns.
        if not others or others[0].criterion >= found.criterion - 1e-6 or _shape(found) in known:
            return found, others
        known.add(_shape(found))
        found = simplify(signals, others[0], worth, limited)


def _filters_velocity(found: Fit) -> bool:
    """Whether its velocity estimator has a number that is sought, as a filter has."""
    return found.structure.velocity and sought(found.timing.velocity_estimator)


def _shape(found: Fit) -> tuple[object, ...]:
    """A law without its numbers."""
    estimator = found.timing.velocity_estimator
    kind = estimator_in_words(estimator) if not sought(estimator) else getattr(estimator, "kind", "")
    timing = replace(found.timing, velocity_estimator=kind)
    return found.structure, timing, tuple(one.kind for one in found.filters)


def simplify(signals: Signals, found: Fit, worth: float, limited: np.ndarray | None) -> Fit:
    """Leave out terms and filters one at a time, as long as the information criterion does not mind."""
    while True:
        fewer = [(*found.filters[:i], *found.filters[i + 1 :]) for i in range(len(found.filters))]
        trials = [replace(found, structure=one) for one in found.structure.simpler]
        trials += [replace(found, filters=filters) for filters in fewer]
        if _filters_velocity(found):
            named = [replace(found.timing, velocity_estimator=one) for one in ESTIMATORS]
            trials += [replace(found, timing=timing) for timing in named]
        for refit in _in_full(signals, trials, limited, found.criterion + NEARBY + worth):
            less = len(refit.filters) < len(found.filters) or _filters_velocity(found) > _filters_velocity(refit)
            allowed = worth if less else 0.0
            if refit.criterion < found.criterion + allowed:
                found = refit
                break
        else:
            if found.structure.feeds_forward:
                return found
            return replace(found, timing=replace(found.timing, profile=False))


def rivals(signals: Signals, found: Fit, limited: np.ndarray | None) -> list[Fit]:
    """The best other fit for each thing that could be otherwise (estimator, delay, form), the best first.

    Of the position loop's samples, and of estimators beside one with a number, the best few: more than one may explain
    a record as well.
    """
    timing = found.timing
    loops = [replace(found, timing=loop) for loop in _other_loops(found)]
    kinds: list[Iterable[Fit]] = [
        [replace(found, timing=replace(timing, delay=delay)) for delay in DELAYS if delay != timing.delay],
        [replace(found, structure=structure) for structure in _other_forms(found.structure)],
    ]  # fmt: skip
    estimated: list[Fit] = []
    if found.structure.velocity:
        instead = rivals_of(timing.velocity_estimator, signals.period)
        estimated = [replace(found, timing=replace(timing, velocity_estimator=one)) for one in instead]
        if isinstance(timing.velocity_estimator, str):
            kinds, estimated = [*kinds, estimated], []
    if found.structure.feeds_forward and not signals.velocity_reference:  # a filter may stand in for either
        instead = could_pass_for(timing.velocity_estimator)
        filters = [found.filters, *(found.filters[:i] + found.filters[i + 1 :] for i in range(len(found.filters)))]
        sources = [(some, one) for some in filters for one in _sources(timing, instead)]
        kinds.append([replace(found, filters=some, timing=one) for some, one in sources if one != timing])
    others = [*_in_full(signals, loops, limited), *_in_full(signals, estimated, limited)]
    best = [next(_in_full(signals, kind, limited), None) for kind in kinds]
    others += [one for one in best if one is not None]
    return sorted(others, key=lambda f: f.criterion)


def mirrored(signals: Signals, found: Fit, limited: np.ndarray | None) -> Fit | None:
    """The other minimum of a cascade whose position loop and integral may change places, None where there is none.

    With a reference velocity taken whole and a position loop in every sample it is the very same law.
    """
    kp, wi = found.position_rate, found.wi
    if found.structure.form != "pi" or not kp > 0.0:
        return None
    middle = float(np.sqrt(kp * wi))
    within = (middle, 4.0 * max(kp, wi)) if wi < middle else (0.25 * min(kp, wi), middle)
    other = fit(signals, found, limited, within)
    inner = within[0] * 1.02 < other.wi < within[1] / 1.02
    return other if inner and other.stabilising else None


def _in_full(
    signals: Signals, trials: Iterable[Fit], limited: np.ndarray | None, worst: float = np.inf
) -> Iterator[Fit]:
    """The trials that stabilise, fitted, the most promising first; those with an estimate beyond ``worst`` left out."""
    estimates = [(_first_order(signals, one, limited), i, one) for i, one in enumerate(trials)]
    for estimate, _, one in sorted(estimates, key=lambda pair: pair[:2])[:FITTED]:
        if estimate > worst:
            return
        refit = fit(signals, one, limited)
        if refit.stabilising:
            yield refit


def _first_order(signals: Signals, one: Fit, limited: np.ndarray | None) -> float:
    """Criterion of a fit after one step of its filters, infinite where it would not stabilise."""
    raw = regressors(signals, one.timing, limited)
    columns = filtered(one.filters, raw, signals.period)
    wi, linear, _, cost = solve(compress(signals, columns), one.structure, signals.period)
    now = replace(one, wi=wi, linear=linear, cost=cost)
    if not now.stabilising:
        return np.inf
    own = estimator_slope(signals, now, limited)
    if one.filters or own:
        slopes = np.column_stack([derivatives(one.filters, raw @ now.beta, signals.period), *own])
        near = (wi / 1.5, wi * 1.5) if wi else None
        *_, cost = solve(compress(signals, columns, slopes), one.structure, signals.period, near)
    return replace(now, cost=cost).criterion


def _other_forms(structure: Structure) -> list[Structure]:
    if not structure.velocity:
        return []
    if not structure.form:  # an integral of the reference's velocity is its position
        whole = structure.position and structure.share == 0
        return [replace(structure, form="ip", position=False, share=1)] if whole else []
    other = "ip" if structure.form == "pi" else "pi"
    return [replace(structure, form=other, share=share) for share in dict.fromkeys((structure.share, None))]


def _other_loops(found: Fit) -> list[Timing]:
    """Other rates of the position loop from the first sample on, and other samples for the rate that was found."""
    if not found.structure.position:
        return []
    loops = [(every, 0) for every in EVERY] + [(found.timing.every, phase) for phase in range(1, found.timing.every)]
    timings = [replace(found.timing, every=every, phase=phase) for every, phase in loops]
    if found.structure.feeds_forward:  # a rate is not seen from a source that is not the drive's
        own = found.timing.velocity_estimator
        estimators = dict.fromkeys((*ESTIMATORS, own))
        timings = [source for timing in timings for source in _sources(timing, list(estimators))]
    return [timing for timing in timings if timing != found.timing]


def _sources(timing: Timing, estimators: Sequence[AnyEstimator]) -> list[Timing]:
    """``timing`` with each source of the feed-forward, and each of the ``estimators`` of the velocity."""
    return [replace(timing, profile=profile, velocity_estimator=e) for profile in (False, True) for e in estimators]
