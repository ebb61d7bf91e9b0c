"""Whether a law is told: what it leaves of the command against what the record allows, and the same numbers in parts.

What a law leaves is the record's own if nothing that the controller saw explains it: noise and rounding know nothing of
the motion, while a wrong structure leaves a function of reference and position. So what is left is regressed, behind
the filter that makes it white, on what the controller saw now and a few samples before; what remains after that is what
the record allows. A law that leaves several times as much is near the true one at best. And a law is the same in every
part of its record: fitted to one part alone, its numbers agree within their deviations with those of another part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from emps_design.identification.controller.best_law import Found, command_of
from emps_design.identification.controller.deviations import covariance, with_deviations
from emps_design.identification.controller.fit import fit
from emps_design.identification.controller.regressors import Signals, regressors

TIMES = 2.0  # as much left as the record allows: beyond, the law is not the record's
PAST = 8  # increments of the position that what is left may be a function of
PAST_REFERENCE = 3  # of the reference: more would explain the rounding of the reference itself
APART = 6.0  # deviations between the numbers of two parts
FEWEST = 200  # samples of a part
ROUNDING = 1e-12  # of the command, or of a number: what terms added in another order may change

Numbers = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Disagreement:
    """A number that two parts of the records tell otherwise: its name, and value and deviation in each."""

    name: str
    one: tuple[float, float]
    other: tuple[float, float]
    parts: tuple[int, int]

    @property
    def apart(self) -> float:
        """Deviations between the two."""
        spread = float(np.hypot(self.one[1], self.other[1]))
        return abs(self.one[0] - self.other[0]) / max(spread, 1e3 * ROUNDING * abs(self.one[0]), 1e-300)


def times_allowed(found: Found) -> float:
    """What the law leaves over what the record allows, rms over rms, at least 1 but for chance."""
    signals, law = found.signals, found.fit
    if signals.times is not None:
        return 1.0
    left = signals.counted(signals.command - command_of(signals, law, found.held))
    columns = signals.counted(_seen(found))
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0.0] / norms[norms > 0.0]
    if left.size < 2 * columns.shape[1]:
        return 1.0
    gains, _, rank, _ = np.linalg.lstsq(columns, left, rcond=1e-10)
    rest = left - columns @ gains
    allowed = float(rest @ rest) / max(left.size - int(rank), 1)
    mean = float(left @ left) / max(left.size - law.size, 1)
    allowed = max(allowed, (ROUNDING * float(np.abs(signals.command).max())) ** 2)
    return float(np.sqrt(mean / allowed)) if allowed > 0.0 else 1.0


def _seen(found: Found) -> np.ndarray:
    """What the controller saw (n, ...): the terms of a law with either source, increments of position and reference."""
    signals, timing = found.signals, found.fit.timing
    columns = [regressors(signals, replace(timing, profile=profile), found.held) for profile in (False, True)]
    if signals.velocity_reference:
        columns = columns[:1]
    for x, count in ((signals.position, PAST), (signals.reference, PAST_REFERENCE)):
        steps = np.diff(x, prepend=x[:1])
        columns += [np.concatenate([np.zeros(late), steps[: steps.size - late]])[:, None] for late in range(count)]
    return np.column_stack(columns)


def disagreement(
    found: Found, parts: Sequence[np.ndarray], numbers: Callable[..., dict[str, float]]
) -> Disagreement | None:
    """The number that two of the ``parts`` (n,) of the samples tell most unlike; None where all agree."""
    told: list[tuple[int, Numbers]] = []
    for place, part in enumerate(parts):
        used = found.signals.used & part
        if used.sum() >= FEWEST:
            told.append((place, _numbers(replace(found.signals, used=used), found, numbers)))
    worst: Disagreement | None = None
    for i, (place, one) in enumerate(told):
        for other_place, other in told[i + 1 :]:
            for name in one.keys() & other.keys():
                pair = Disagreement(name, one[name], other[name], (place, other_place))
                if pair.apart > (APART if worst is None else worst.apart):
                    worst = pair
    return worst


def halves(signals: Signals) -> list[np.ndarray]:
    """The first and the second half (n,) of the samples that count."""
    count = np.cumsum(signals.used)
    first = count <= count[-1] // 2
    return [first, ~first]


def _numbers(part: Signals, found: Found, numbers: Callable[..., dict[str, float]]) -> Numbers:
    """The numbers of the law fitted to a part alone, with their deviations."""
    one = fit(part, found.fit, found.held)
    return with_deviations(one, covariance(part, one, found.held), numbers)
