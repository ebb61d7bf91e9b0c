"""The experiment that would tell apart what the records could not: the excitation on which the rivals differ most.

Each rival is simulated on each excitation, as if it were the machine, and another is fitted to what it does, its
numbers held by what the records already know of them. What is left of the difference, whitened like any residual,
has a length D in standard deviations of the noise: with a real record of that excitation the wrong model will cost D^2
more than the right one, give or take 2 D.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.experiment.excitation import Envelope, excitations, instruction
from emps_design.discrepancy.model.candidate import Candidate, Slot
from emps_design.discrepancy.model.fit import Fit
from emps_design.discrepancy.model.least_squares import descend
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.partition import START_UP
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.outcome import Outcome
from emps_design.effects import Effect, get_effect, kind_of
from emps_design.errors import SimulationError
from emps_design.quantities import inside
from emps_design.simulation import Run

FILE = "experiment.csv"
EXPERIMENTS = {  # the excitation that varies one quantity and little else
    "position": "small_strokes",
    "velocity": "speed_staircase",
    "time": "identical_laps",
    "load": "three_accelerations",
    "frequency": "chirp_on_a_slow_run",
    "time since a reversal": "stop_and_dwell",
}
PULSE = 1e-6  # m, small enough for no voltage limit
REFITTED = 2  # excitations at most that are looked at with the rivals fitted to convergence
STEPS = 3


@dataclass(frozen=True)
class Experiment:
    """What to record next: ``text``; with an ``excitation``, its reference ``q_ref`` (n,) [m] at ``period`` [s].

    ``distance`` [N rms] is how far apart the models with one and the other of ``between`` are on it, fitted to one
    another; ``over_noise`` the same in standard deviations of the noise, of which ``needed`` decide. ``compared`` has
    the first two for every excitation that is safe, the best first, after one step of the fits only. ``file`` is where
    the reference was written.

    >>> Experiment("crawl", q_ref=np.zeros(3), period=0.5).written().to_dict()["file"]
    'experiment.csv'
    """

    text: str
    excitation: str | None = None
    between: tuple[str, str] | None = None
    distance: float | None = None
    over_noise: float | None = None
    needed: float | None = None
    compared: tuple[dict[str, Any], ...] = ()
    q_ref: np.ndarray | None = None
    period: float = 0.0
    file: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Everything but the reference itself."""
        return {
            "program": self.excitation,
            "text": self.text,
            "duration": None if self.q_ref is None else self.q_ref.size * self.period,
            "distance": self.distance,
            "over_noise": self.over_noise,
            "needed": self.needed,
            "between": self.between,
            "file": self.file,
            "menu": self.compared,
            "units": {"duration": "s", "distance": "N", "over_noise": "standard deviations"},
        }

    @property
    def t(self) -> np.ndarray:
        """Time (n,) [s] of the samples of ``q_ref``."""
        return np.arange(0 if self.q_ref is None else self.q_ref.size) * self.period

    def written(self) -> Experiment:
        """The same, saying where the reference was written, if there is one."""
        return self if self.q_ref is None else replace(self, file=FILE)


def experiment(outcome: Outcome, named: tuple[str, ...], equivalents: dict[str, list[str]]) -> Experiment | None:
    """What to record next: an excitation where findings have ``equivalents``, else what the first finding's file says.

    ``named`` are the findings; too many equivalents leave a finding without a name and with the same question. None
    where nothing is asked.
    """
    best = outcome.best
    sets = [
        frozenset((*best.model.names, other)) - {name}
        for name, others in equivalents.items()
        for other in others
        if name in named or len(others) > rules.MOST_EQUIVALENTS
    ]
    rivals = [outcome.tried[key] for key in sets if key in outcome.tried]
    if rivals and not best.problem.follows:
        left = best.cost / best.problem.samples("used")  # structure that nothing explains blurs like noise
        threshold = outcome.calibration.healthy.threshold
        chosen = choose((best, *rivals[: rules.MOST_EQUIVALENTS]), threshold, np.sqrt(max(1.0, left)))
        if chosen is not None:
            return chosen
    return Experiment(get_effect(kind_of(named[0])).experiment) if named else None


def what_to_record(hypothesis: Hypothesis, over: list[str]) -> Experiment:
    """The excitation that shows most of what a model leaves: the one that varies ``over``, what that depends on."""
    name, text = varies(over)
    if hypothesis.problem.follows:
        return Experiment(text)
    envelope = Envelope.of(hypothesis.problem.records)
    reference = excitations(envelope)[name]
    if not _safe(hypothesis, reference, _extremes(*hypothesis.runs())):
        return Experiment(text)
    return Experiment(text, excitation=name, q_ref=reference, period=envelope.period)


def varies(over: list[str]) -> tuple[str, str]:
    """The excitation that varies what the rest depends ``over``, and what to do, in words.

    >>> varies(["time"])[0]
    'identical_laps'
    """
    name = EXPERIMENTS[over[0]] if over else "speed_staircase"
    why = f"because what is left depends on {' and '.join(over[:2])}" if over else "to see what the rest depends on"
    return name, f"{instruction(name)}, {why}; diagnose the new record together with the old"


def choose(rivals: tuple[Fit, ...], threshold: float, noise: float = 1.0) -> Experiment | None:
    """The excitation on which the two of ``rivals`` that are nearest to one another are farthest apart.

    ``threshold`` is the gain in whitened cost that counts; ``noise`` [standard deviations of the whitening] is what
    the best of them leaves. None where no excitation is safe.
    """
    records = rivals[0].problem.records
    seen = [_extremes(*rival.runs()) for rival in rivals]
    envelope = replace(Envelope.of(records), follows=_following(rivals[0]))
    references = excitations(envelope)
    looked_at = side_by_side(_nearest, [(rivals, seen, q_ref, noise) for q_ref in references.values()])
    first = {name: found for name, found in zip(references, looked_at, strict=True) if found is not None}
    if not first:
        return None

    def converged(name: str) -> _Apart:
        pair = first[name].pair
        both_ways = side_by_side(_apart, [(*way, references[name], noise, STEPS) for way in _directions(pair)])
        return replace(min(both_ways, key=lambda apart: apart.over_noise), pair=pair)

    ranked = sorted(first, key=lambda name: -first[name].over_noise)
    chosen, best = ranked[0], converged(ranked[0])
    for name in ranked[1:REFITTED]:
        # Fitting on can only bring the rivals closer: what is farther now than they could be, stays so.
        if best.over_noise >= first[name].over_noise:
            break
        found = converged(name)
        if found.over_noise > best.over_noise:
            chosen, best = name, found
    needed = rules.LUCK + float(np.sqrt(rules.LUCK**2 + threshold))  # D^2 - 2 LUCK D = threshold
    decides, (one, other) = best.over_noise >= needed, best.effects
    return Experiment(
        text=_text(chosen, best, needed, references[chosen].size * envelope.period),
        excitation=chosen if decides else None,
        between=(one.name, other.name),
        distance=best.distance,
        over_noise=best.over_noise,
        needed=needed,
        compared=tuple(
            {"program": n, "text": instruction(n), "distance": first[n].distance, "over_noise": first[n].over_noise}
            for n in ranked
        ),
        q_ref=references[chosen] if decides else None,
        period=envelope.period,
    )


@dataclass(frozen=True)
class _Apart:
    """How far two models are apart on an excitation, [N rms] and in standard deviations of the noise."""

    pair: tuple[Fit, Fit]
    distance: float
    over_noise: float

    @property
    def effects(self) -> tuple[Effect, Effect]:
        """The effects in which the two differ."""
        one, other = ({effect.name: effect for effect in fitted.model.effects} for fitted in self.pair)
        return next(one[name] for name in one if name not in other), next(other[n] for n in other if n not in one)


def _nearest(rivals: tuple[Fit, ...], seen: list[np.ndarray], q_ref: np.ndarray, noise: float) -> _Apart | None:
    """The two rivals nearest to one another on ``q_ref``; None where one of them makes it unsafe."""
    if not all(_safe(rival, q_ref, limits) for rival, limits in zip(rivals, seen, strict=True)):
        return None
    pairs = [pair for pair in combinations(rivals, 2) if len(set(pair[0].model.names) ^ set(pair[1].model.names)) == 2]
    found = [replace(_apart(*_directions(pair)[0], q_ref, noise, 1), pair=pair) for pair in pairs]
    return min(found, key=lambda apart: apart.over_noise)


def _directions(pair: tuple[Fit, Fit]) -> list[tuple[Fit, Fit]]:
    """Pairs (machine, rival fitted to it): both ways, but bristles, a hundred times slower, only as the machine."""
    both = [pair, pair[::-1]]
    return [way for way in both if not any(effect.takes_dry for effect in way[1].model.effects)] or both


def _apart(machine: Fit, rival: Fit, q_ref: np.ndarray, noise: float, steps: int) -> _Apart:
    """Fit ``rival`` to what ``machine`` does on ``q_ref``, its numbers held by what the records know of them."""
    force = machine.simulate(0, q_ref=q_ref).force
    start, slots, known = _one_record(rival)

    def missed(model: Candidate) -> np.ndarray:
        return force[START_UP:] - rival.with_model(model).simulate(0, q_ref=q_ref).force[START_UP:]

    def residual(model: Candidate) -> np.ndarray:
        innovations = rival.problem.whitening.apply(missed(model))
        return np.concatenate((innovations, known @ (model.vector(slots) - at) / noise))

    at = start.vector(slots)
    found = descend(start, slots, residual, steps)
    return _Apart((machine, rival), float(np.std(missed(found.model))), float(np.sqrt(found.cost)) / noise)


def _one_record(fitted: Fit) -> tuple[Candidate, tuple[Slot, ...], np.ndarray]:
    """The model of ``fitted`` with one record's numbers, its free numbers (k,), and the root (m, k) of what is known.

    What belongs to a record, such as the phase of a ripple, is not known for the next.
    """
    model = replace(fitted.model, values=tuple(v[:1] for v in fitted.model.values))
    slots = tuple(slot for slot in fitted.slots if slot.record in (None, 0))
    shared = [k for k, slot in enumerate(fitted.slots) if slot.record is None]
    unit = np.array([fitted.slots[k].magnitude for k in shared])
    information = np.linalg.pinv(fitted.covariance[np.ix_(shared, shared)] / np.outer(unit, unit), hermitian=True)
    size, directions = np.linalg.eigh(information)
    known = np.zeros((len(shared), len(slots)))
    columns = [k for k, slot in enumerate(slots) if slot.record is None]
    known[:, columns] = np.sqrt(np.maximum(size, 0.0))[:, None] * directions.T / unit
    return model, slots, known


def _following(hypothesis: Hypothesis) -> Callable[[np.ndarray], np.ndarray]:
    """Gain (n,) from reference to position over angular frequencies (n,) [rad/s], dry friction and effects aside."""
    pulse = np.zeros(8192)
    pulse[1] = PULSE
    mass, viscous, *_ = hypothesis.model.baseline
    smooth = hypothesis.with_model(Candidate(np.array([mass, viscous, 0.0, 0.0])))
    answer = smooth.simulate(0, q_ref=pulse).position
    omega = 2 * np.pi * np.fft.rfftfreq(pulse.size, hypothesis.problem.period)
    gain = np.abs(np.fft.rfft(answer)) / PULSE
    return lambda wanted: np.interp(wanted, omega, gain)


def _extremes(*runs: Run) -> np.ndarray:
    """Highest and lowest position [m], the latter negative, largest speed [m/s], acceleration [m/s^2], voltage [V]."""
    return np.max(
        [
            (run.position.max(), -run.position.min(), *(np.abs(x).max() for x in (run.v, np.diff(run.v), run.u)))
            for run in runs
        ],
        axis=0,
    )


def _safe(hypothesis: Hypothesis, q_ref: np.ndarray, seen: np.ndarray) -> bool:
    """Whether a model goes on ``q_ref`` no farther, faster or harder than ``seen``, what it does on the records."""
    try:
        asked = _extremes(hypothesis.simulate(0, q_ref=q_ref))
    except SimulationError:
        return False
    room = rules.SLACK * np.array([seen[0] + seen[1], seen[0] + seen[1], *seen[2:]])
    return bool(np.all(asked <= seen + room))


def _text(excitation: str, apart: _Apart, needed: float, duration: float) -> str:
    one, other = apart.effects
    names = f"{inside(one.label)} from {inside(other.label)}"
    far = f"{apart.distance:.2g} N rms and {apart.over_noise:.1f} standard deviations of the noise"
    if apart.over_noise < needed:
        return (
            f"no motion within what the records show tells {names}: at best ({instruction(excitation)}) they are {far} "
            f"apart, where {needed:.1f} decide; beyond it, {one.experiment}"
        )
    return (
        f"{instruction(excitation)}, {duration:.0f} s, to tell {names}: fitted to one another they are still {far} "
        f"apart, where {needed:.1f} decide; diagnose the new record together with the old"
    )
