"""The law that explains a command best, how well, and what else explains it: search, limit, noise, choice in turn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.identification.controller.choice import choose, mirrored, simplify
from emps_design.identification.controller.filters import Filter, filtered
from emps_design.identification.controller.fit import Fit, fit
from emps_design.identification.controller.limit import acting, longest_between, plateau
from emps_design.identification.controller.noise import robust_deviation, usable_behind, whitening_filter
from emps_design.identification.controller.regressors import Signals, Timing, regressors
from emps_design.identification.controller.search import search
from emps_design.identification.controller.structures import PROPORTIONAL, Structure

HOLDS = 0.05  # of the command's deviation: a law that leaves more is none
AS_GOOD = 6.0  # of the information criterion, odds of 20 : 1: a rival closer than that cannot be told apart
LIMIT_ROUNDS = 4
FEWEST = 200  # samples without a limit that a search begins anew with
WORSE_THERE = 1.5  # times what is left elsewhere, where a command that is flat is limited
WORSE = 1.1  # times what is left with the integral free behind each plateau: what it did there is then not told


@dataclass(frozen=True)
class Found:
    """The law that explains a command best, and how well: ``share`` of the command's deviation is left."""

    signals: Signals  # whitened
    fit: Fit
    rivals: list[Fit]
    rms: float
    share: float
    limited: np.ndarray | None
    limit: float | None
    holds: bool | None  # None: not told

    @property
    def held(self) -> np.ndarray | None:
        """Samples (n,) in which the integral stands still."""
        return self.limited if self.holds else None

    def apart(self, other: Fit) -> float:
        """Standard deviations of the noise between the commands of the law and of ``other``, over all samples."""
        one, another = (command_of(self.signals, law, self.held) for law in (self.fit, other))
        noise = np.sqrt(self.fit.cost / self.fit.samples)
        return float(np.linalg.norm(self.signals.counted(one - another)) / noise)


def best_law(signals: Signals, only: Structure | None = None) -> Found:
    """The law that explains the command best, whatever that is worth; of the structure ``only`` where that is given."""
    flat = plateau(signals.command) & signals.used
    worth, none = 0.0, tuple[Filter, ...]()
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
        start = Fit(replace(structure, offset=True), timing, filters, 0.0, np.zeros(0), 1.0, 1)
        if flat.any() and not signals.velocity_reference:  # a search takes a clipped peak for a filtered one
            free = replace(signals, used=signals.used & ~flat)
            plain = Fit(PROPORTIONAL, Timing(), none, 0.0, np.zeros(0), 1.0, 1)
            start = min((fit(free, one) for one in (start, plain)), key=lambda one: one.criterion)
        free, fitted, limited, limit, holds = _up_to_the_limit(signals, start, flat)
        left = _left(free, fitted, limited if holds else None)
        attempts.append((float(np.std(left[free.used])), worth, free, fitted, limited, limit, holds))
        if only is not None or (limit is None and _as_good_there(signals, left, flat)):
            break
    _, worth, free, fitted, limited, limit, holds = min(attempts, key=lambda attempt: attempt[0])
    held = limited if holds else None
    if free.records and not fitted.structure.form:
        free = replace(free, levels=None, records=False)
        fitted = fit(free, fitted, held)
    white, fitted, rivals = _chosen(free, fitted, only is None, worth, held)
    if limit is not None and holds is None:  # where the integral stands still may be told by the whole law alone
        again = _up_to_the_limit(signals, replace(fitted, structure=replace(fitted.structure, offset=True)), flat)
        if again[-1] is not None:
            free, fitted, limited, limit, holds = again
            held = limited if holds else None
            white, fitted, rivals = _chosen(free, fitted, only is None, worth, held)
    if (other := mirrored(white, fitted, held)) is not None:
        # Alike, the position loop is taken to be the slower of the two, as it is where people set it.
        if other.criterion < fitted.criterion - AS_GOOD or (
            other.criterion < fitted.criterion + AS_GOOD and other.position_rate < other.wi
        ):
            fitted, other = other, fitted
        rivals = [other, *rivals]
    fitted, *rivals = map(_in_order, (fitted, *rivals))
    rms = float(np.sqrt(np.mean(_left(free, fitted, held)[free.used] ** 2)))
    share = rms / float(np.std(signals.command[free.used]))
    return Found(white, fitted, rivals, rms, share, limited, limit, holds)


def _chosen(
    free: Signals, start: Fit, rivalled: bool, worth: float, held: np.ndarray | None
) -> tuple[Signals, Fit, list[Fit]]:
    """The signals behind a filter that makes what ``start`` leaves white, the law there, and its rivals if wanted."""
    fitted = simplify(free, start, worth, held)
    whitening = whitening_filter(_left(free, fitted, held), free.used) if free.times is None else free.whitening
    white = replace(free, whitening=whitening, used=usable_behind(free.used, whitening))
    if rivalled:
        return white, *choose(white, fitted, worth, held)
    return white, simplify(white, fit(white, fitted, held), worth, held), []


def _in_order(found: Fit) -> Fit:
    """``found`` with its filters by kind and frequency: which of two was found first is a matter of the last digit."""
    return replace(found, filters=tuple(sorted(found.filters, key=lambda one: (one.kind, one.frequency))))


def command_of(signals: Signals, found: Fit, held: np.ndarray | None) -> np.ndarray:
    """Command (n,) of a fit without its limit."""
    return filtered(found.filters, regressors(signals, found.timing, held) @ found.beta, signals.period)


def _left(signals: Signals, found: Fit, held: np.ndarray | None) -> np.ndarray:
    """What a fit leaves (n,) of the command in the samples that count, 0 in others."""
    left = np.zeros(len(signals))
    left[signals.used] = signals.counted(signals.command - command_of(signals, found, held))
    return left


def _as_good_there(signals: Signals, left: np.ndarray, flat: np.ndarray) -> bool:
    """Whether a law without a limit explains what is ``flat`` (n,) as well as the rest: then none acts there."""
    there, rest = flat & signals.used, ~flat & signals.used
    if not there.any():
        return True
    at_all = HOLDS * float(np.std(signals.command[signals.used]))
    of_rest = float(np.sqrt(np.mean(left[rest] ** 2)))
    return of_rest <= at_all and float(np.sqrt(np.mean(left[there] ** 2))) <= WORSE_THERE * of_rest


def _wanted(signals: Signals, found: Fit, held: np.ndarray | None) -> np.ndarray:
    """Command (n,) of a fit without its limit, with the constant of each level."""
    command = command_of(signals, found, held)
    if signals.levels is None:
        return command
    known, left, count = signals.levels[signals.used], (signals.command - command)[signals.used], signals.levels[-1] + 1
    means = np.bincount(known, left, count) / np.maximum(np.bincount(known, None, count), 1)
    return command + means[signals.levels]


def _up_to_the_limit(
    signals: Signals, start: Fit, flat: np.ndarray
) -> tuple[Signals, Fit, np.ndarray | None, float | None, bool | None]:
    """Fit the samples in which no limit acts; where it does, by the law that is found itself.

    Returns the signals that count, the fit, where the limit acts, the limit, and whether the integral holds there.
    """
    if not flat.any():
        return signals, fit(signals, start), None, None, True
    # At first nobody knows where the integral stood still: it may have any value behind each plateau.
    levels = np.cumsum(np.diff(flat.astype(int), prepend=0) == -1) + (0 if signals.levels is None else signals.levels)
    apart = replace(signals, used=signals.used & ~flat, levels=levels, records=False)
    loose = fit(apart, start)
    wanted = _wanted(apart, loose, None)
    noise = robust_deviation((signals.command - wanted)[apart.used])
    limited, limit = acting(signals.command, np.where(signals.used, wanted, 0.0), noise)
    if limit is None:
        return signals, fit(signals, start), None, None, True
    best: tuple[Signals, Fit, np.ndarray, float, bool] | None = None
    for _ in range(LIMIT_ROUNDS):
        free = replace(signals, used=signals.used & ~limited)
        tried = [(fit(free, loose, limited), True)]
        if start.structure.form:
            tried.append((fit(free, loose), False))
        fitted, holds = min(tried, key=lambda pair: pair[0].cost)
        if best is None or fitted.cost / fitted.samples < best[1].cost / best[1].samples:
            best = free, fitted, limited, limit, holds
        wanted = _wanted(free, fitted, limited if holds else None)
        noise = robust_deviation((signals.command - wanted)[free.used])
        now, level = acting(signals.command, np.where(signals.used, wanted, 0.0), noise)
        if level is None or np.array_equal(now, limited):
            break
        limited, limit = now, level
    assert best is not None
    if best[1].cost / best[1].samples > WORSE * loose.cost / loose.samples:
        return apart, loose, flat, limit, None
    return best
