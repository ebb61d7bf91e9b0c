"""The experiment to run next: excitations within the limits of the records, and the one that separates rival models.

Every excitation is a reference ``q_ref`` (n,) [m] at the period of the record. It starts and ends at rest at the first
position of the record, lasts ten to thirty seconds on an ordinary axis, and stays within the positions, speeds,
accelerations and jerks of the record. Strokes of every kind are in the fitting and in the selecting part (every third).

The best excitation is the one on which the rival models differ most. Each rival is simulated on each excitation as the
machine, and another is fitted to that simulation, with the covariance from the records as prior of its parameters. The
whitened residual has a length D in standard deviations of the noise: on a real record of that excitation the cost of
the wrong model will exceed that of the right one by D^2 +- 2 D.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.calibration import Outcome
from emps_design.discrepancy.fit import Fit
from emps_design.discrepancy.least_squares import Candidate, Slot, descend
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.words import worded
from emps_design.effects import Effect, get_effect, kind_of
from emps_design.errors import SimulationError
from emps_design.quantities import inside
from emps_design.records import Record
from emps_design.simulation import Run
from emps_design.simulation.synthetic import point_to_point
from emps_design.units import Units

Move = tuple[float, float, float, float]  # target [m], share of the speed, of the acceleration, pause after it [s]

FILE = "experiment.csv"
EXPERIMENTS = {  # the excitation that varies one quantity and little else
    "position": "small_strokes",
    "velocity": "speed_staircase",
    "time": "identical_laps",
    "load": "three_accelerations",
    "frequency": "chirp_on_a_slow_run",
    "time since a reversal": "stop_and_dwell",
}


@dataclass(frozen=True)
class Envelope:
    """Limits of an excitation: positions ``low`` to ``high`` [m], ``speed`` [m/s], ``acceleration`` [m/s^2], ``jerk``
    [m/s^3]; it starts from rest at ``home`` [m] and is sampled every ``period`` [s].

    ``follows`` (n,) -> (n,) is the gain from reference to position at angular frequencies [rad/s]. The limits are those
    of the machine: the reference may exceed them by the inverse of this gain.
    """

    period: float
    home: float
    low: float
    high: float
    speed: float
    acceleration: float
    jerk: float
    follows: Callable[[np.ndarray], np.ndarray] = np.ones_like

    @classmethod
    def of(cls, records: Iterable[Record]) -> Envelope:
        """The envelope of ``records``, with a margin.

        Speed and acceleration are the smaller of those of the reference and those measured below 60 Hz, because a
        machine does not follow a reference with steps.
        """
        from emps_design.identification.filters import motion

        records = tuple(records)
        period = records[0].period
        commanded = [np.diff(r.q_ref) / period for r in records]
        motions = [motion(r, rules.CUTOFF_HZ) for r in records]
        low, high = min(float(r.q.min()) for r in records), max(float(r.q.max()) for r in records)
        return cls(
            period=period,
            home=float(records[0].q_ref[0]),
            low=low + rules.NEGLIGIBLE * (high - low),
            high=high - rules.NEGLIGIBLE * (high - low),
            speed=rules.NEARLY_ALL * min(_top(commanded), _top(m.v for m in motions)),
            acceleration=rules.NEARLY_ALL
            * min(_top(np.diff(v) / period for v in commanded), _top(m.a for m in motions)),
            jerk=rules.NEARLY_ALL * _top(np.diff(v, 2) / period**2 for v in commanded),
        )

    @property
    def travel(self) -> float:
        """Distance [m] between the ends."""
        return self.high - self.low

    @property
    def far(self) -> float:
        """Position [m] of the far end of a stroke from ``low`` that takes about 2.5 s or less."""
        return self.low + min(self.travel, 2.5 * self.speed)

    @property
    def middle(self) -> float:
        """Position [m] half-way to the far end."""
        return 0.5 * (self.low + self.far)

    def at(self, share: float) -> float:
        """Position [m] at this ``share`` of the travel."""
        return self.low + share * self.travel

    def trace(self, cycle: list[Move]) -> np.ndarray:
        """Position (n,) [m] of the moves of ``cycle``, repeated for at least ten seconds, and back to ``home``.

        Steps of acceleration are smoothed to the jerk of the record.
        """
        parts, here, n = [np.full(self.samples(0.2), self.home)], self.home, 0
        while n * self.period < rules.LASTING[0]:
            for target, speed, acceleration, pause in cycle:
                if n * self.period > rules.LASTING[1]:
                    break
                parts += self._move(here, target, speed, acceleration, pause)
                here, n = target, n + parts[-2].size + parts[-1].size
        away = np.concatenate(parts + self._move(here, self.home, 0.5, 0.5, 0.3)) - self.home
        width = max(1, int(np.ceil(2 * self.acceleration / (self.jerk * self.period))))
        return self.home + np.convolve(away, np.full(width, 1 / width))

    def _move(self, here: float, target: float, speed: float, acceleration: float, pause: float) -> list[np.ndarray]:
        rest = np.full(self.samples(pause), target)
        if target == here:
            return [np.empty(0), rest]
        path = point_to_point(self.period, abs(target - here), speed * self.speed, acceleration * self.acceleration)
        return [here + np.sign(target - here) * path, rest]

    def samples(self, seconds: float) -> int:
        """Number of samples in ``seconds``, at least two."""
        return max(2, round(seconds / self.period))


def slow_crawl(e: Envelope) -> np.ndarray:
    """Crawl from rest, in both directions, at 0.5 to 5 % of the top speed."""
    moves: list[Move] = [(e.middle, 0.5, 1.0, 0.3)]
    for share in (0.005, 0.01, 0.02, 0.05):
        there = e.middle + min(1.5 * share * e.speed, e.far - e.middle)
        moves += [(there, share, 1.0, 0.3), (e.middle, share, 1.0, 0.3)]
    return e.trace(moves)


def speed_staircase(e: Envelope) -> np.ndarray:
    """Run in both directions at eight constant speeds, from 5 to 100 % of the top speed."""
    moves: list[Move] = []
    for share in (0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0):
        ramps = (share * e.speed) ** 2 / e.acceleration
        there = e.low + min(0.8 * share * e.speed + ramps, e.travel)
        moves += [(there, share, 1.0, 0.1), (e.low, share, 1.0, 0.1)]
    return e.trace(moves)


def two_speeds(e: Envelope) -> np.ndarray:
    """Run back and forth at two constant speeds, one three times the other."""
    there = e.low + min(e.speed, e.travel)
    fast = min(1.0, e.travel / e.speed)
    return e.trace([(end, share, 1.0, 0.2) for share in (fast / 3, fast) for end in (there, e.low)])


def three_accelerations(e: Envelope) -> np.ndarray:
    """Repeat one stroke at full, half and a quarter of the top acceleration."""
    ends = 3 * (e.far, e.low)
    return e.trace([(end, 1.0, share, 0.2) for end, share in zip(ends, (1.0, 0.25, 0.5, 0.5, 0.25, 1.0), strict=True)])


def fast_strokes(e: Envelope) -> np.ndarray:
    """Run strokes without a pause at the top speed and acceleration, over three distances."""
    shares = (1.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.2, 0.0)
    return e.trace([(e.low + share * (e.far - e.low), 1.0, 1.0, 0.0) for share in shares])


def small_reversals(e: Envelope) -> np.ndarray:
    """Reverse about one place with amplitudes that grow from 0.01 to 3 % of the travel."""
    moves: list[Move] = [(e.middle, 0.5, 1.0, 0.3)]
    for amplitude in e.travel * np.geomspace(1e-4, 0.03, 10):
        share = min(amplitude / 0.25 / e.speed, 1.0)
        moves += 2 * [(e.middle + amplitude, share, 1.0, 0.05), (e.middle, share, 1.0, 0.05)]
    return e.trace(moves)


def small_strokes(e: Envelope) -> np.ndarray:
    """Make three short strokes at each of five places along the travel."""
    moves: list[Move] = []
    for place in (0.0, 0.245, 0.49, 0.735, 0.98):
        moves += [(e.at(place), 0.5, 1.0, 0.1)] + 3 * [(e.at(place + 0.02), 0.1, 1.0, 0.05), (e.at(place), 0.1, 1.0, 0)]
    return e.trace(moves)


def stop_and_dwell(e: Envelope) -> np.ndarray:
    """Stop at three places along the travel, approached from both sides, and rest there for 1.5 s."""
    moves: list[Move] = []
    for place in (0.25, 0.5, 0.75):
        moves += [(e.at(place), 0.5, 1.0, 1.5), (e.at(place + 0.25), 0.5, 1.0, 0.1), (e.at(place), 0.5, 1.0, 1.5)]
    return e.trace([*moves, (e.low, 0.5, 1.0, 0.1)])


def identical_laps(e: Envelope) -> np.ndarray:
    """Repeat one lap many times, out at the top speed and back at half of it."""
    lap = [(e.far, 1.0, 1.0, 0.1), (e.low, 0.5, 1.0, 0.1)]
    return e.trace(lap * max(1, round(rules.LASTING[1] * e.speed / (3.5 * (e.far - e.low)))))


def chirp_on_a_slow_run(e: Envelope) -> np.ndarray:
    """Run slowly back and forth with a small chirp on top, from 2 to 100 Hz and back in every stroke."""
    stroke = e.far - e.low
    # A stroke takes at least 3 s, so that the chirp has time, and not much more than 4 s.
    slow = min(max(0.2, stroke / (4.0 * e.speed)), stroke / (3.0 * e.speed), 0.6)
    base = e.trace(2 * [(e.far, slow, 0.4, 0.1), (e.low, slow, 0.4, 0.1)])
    turning = np.abs(np.gradient(base, e.period)) < 0.99 * slow * e.speed
    width = e.samples(0.2)
    fade = np.convolve(turning, np.ones(3 * width), mode="same") < 0.5
    for _ in range(3):  # fade in and out at constant speed, without a step of jerk
        fade = np.convolve(fade, np.full(width, 1 / width), mode="same")
    first, last = rules.LINES_HZ[0], min(rules.LINES_HZ[1], 0.2 / e.period)
    up_and_down = 0.5 - 0.5 * np.cos(2 * np.pi * (base - e.low) / stroke)
    omega = 2 * np.pi * first * (last / first) ** up_and_down
    # A smooth minimum of the limits by speed (the run must not reverse), acceleration and jerk.
    half = 0.5 * e.acceleration
    acceleration = half / (1 + half / (0.35 * slow * e.speed * omega) + half * omega / e.jerk)
    amplitude = acceleration / omega**2 / np.maximum(e.follows(omega), rules.NEGLIGIBLE)
    return base + fade * amplitude * np.sin(np.cumsum(omega) * e.period)


EXCITATIONS: tuple[Callable[[Envelope], np.ndarray], ...] = (
    slow_crawl, speed_staircase, two_speeds, three_accelerations, fast_strokes,
    small_reversals, small_strokes, stop_and_dwell, identical_laps, chirp_on_a_slow_run,
)  # fmt: skip


def excitations(envelope: Envelope) -> dict[str, np.ndarray]:
    """Every excitation by name: ``q_ref`` (n,) [m] within the limits of ``envelope``.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> envelope = Envelope.of([synthetic_record(machine("emps2019"), laps=1)])
    >>> crawl = excitations(envelope)["slow_crawl"]
    >>> bool(np.abs(np.diff(crawl)).max() <= envelope.speed * envelope.period), crawl.size * envelope.period > 10
    (True, True)
    """
    return {excitation.__name__: excitation(envelope) for excitation in EXCITATIONS}


def instruction(name: str) -> str:
    """The excitation called ``name`` in words, as an instruction.

    >>> instruction("slow_crawl")
    'crawl from rest, in both directions, at 0.5 to 5 % of the top speed'
    """
    text = next(excitation.__doc__ or name for excitation in EXCITATIONS if excitation.__name__ == name)
    return text[0].lower() + text[1:].rstrip(".")


def _top(signals: Iterable[np.ndarray]) -> float:
    return max(float(np.abs(signal).max()) for signal in signals)


@dataclass(frozen=True)
class NextExperiment:
    """What to record next: ``text``; with an ``excitation``, its reference ``q_ref`` (n,) [m] at ``period`` [s].

    ``distance`` [N rms] is the difference between the models with either effect of ``between`` on this reference,
    fitted to one another; ``over_noise`` is the same in standard deviations of the noise, and must be at least
    ``needed`` to separate them. ``compared`` has the first two for every safe excitation, the best first, after one
    step of the fits. ``file`` is the file of the reference.

    >>> NextExperiment("crawl", q_ref=np.zeros(3), period=0.5).written().to_dict(Units())["file"]
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

    def to_dict(self, units: Units) -> dict[str, Any]:
        """The contract's document for an axis with ``units``, without the reference itself."""
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
            "units": {"duration": "s", "distance": units.unit("N"), "over_noise": "standard deviations"},
        }

    @property
    def t(self) -> np.ndarray:
        """Time (n,) [s] of the samples of ``q_ref``."""
        return np.arange(0 if self.q_ref is None else self.q_ref.size) * self.period

    def written(self) -> NextExperiment:
        """The same with ``file`` set, if there is a reference."""
        return self if self.q_ref is None else replace(self, file=FILE)


def experiment(outcome: Outcome, named: tuple[str, ...], equivalents: dict[str, list[str]]) -> NextExperiment | None:
    """What to record next: an excitation if findings have ``equivalents``, else the experiment of the first finding.

    ``named`` are the findings; the rivals of a finding with too many equivalents are separated too. None without
    findings and rivals.
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
        cost = best.cost / best.problem.samples("used")  # unexplained structure masks a difference like noise
        threshold = outcome.healthy.threshold
        chosen = choose((best, *rivals[: rules.MOST_EQUIVALENTS]), threshold, np.sqrt(max(1.0, cost)))
        if chosen is not None:
            return chosen
    units = best.problem.axis.units
    return NextExperiment(worded(get_effect(kind_of(named[0])), units).words.experiment) if named else None


def what_to_record(hypothesis: Hypothesis, over: list[str]) -> NextExperiment:
    """The excitation that varies ``over``, the quantities on which the residual of a model depends."""
    name, text = varies(over)
    if hypothesis.problem.follows:
        return NextExperiment(text)
    envelope = Envelope.of(hypothesis.problem.records)
    reference = excitations(envelope)[name]
    if not _safe(hypothesis, reference, _extremes(*hypothesis.runs())):
        return NextExperiment(text)
    return NextExperiment(text, excitation=name, q_ref=reference, period=envelope.period)


def varies(over: list[str]) -> tuple[str, str]:
    """Name of the excitation that varies the first of ``over``, on which the residual depends, and the instruction.

    >>> varies(["time"])[0]
    'identical_laps'
    """
    name = EXPERIMENTS[over[0]] if over else "speed_staircase"
    why = f"because the residual depends on {' and '.join(over[:2])}" if over else "to see what the residual depends on"
    return name, f"{instruction(name)}, {why}; diagnose the new record together with the old one"


def choose(rivals: tuple[Fit, ...], threshold: float, noise: float = 1.0) -> NextExperiment | None:
    """The excitation that maximises the distance between the two nearest of ``rivals``.

    ``threshold`` is the whitened cost that a finding must gain; ``noise`` [standard deviations of the whitening] is the
    residual of the best rival. None if no excitation is safe.
    """
    records = rivals[0].problem.records
    extremes = [_extremes(*rival.runs()) for rival in rivals]
    envelope = replace(Envelope.of(records), follows=_following(rivals[0]))
    references = excitations(envelope)
    distances = side_by_side(_nearest, [(rivals, extremes, q_ref, noise) for q_ref in references.values()])
    first = {name: apart for name, apart in zip(references, distances, strict=True) if apart is not None}
    if not first:
        return None

    def converged(name: str) -> _Apart:
        pair = first[name].pair
        both_ways = side_by_side(
            _apart, [(*direction, references[name], noise, rules.FEW_STEPS) for direction in _directions(pair)]
        )
        return replace(min(both_ways, key=lambda apart: apart.over_noise), pair=pair)

    ranked = sorted(first, key=lambda name: -first[name].over_noise)
    chosen, best = ranked[0], converged(ranked[0])
    # Further steps only reduce a distance: the best stays best if it exceeds the other distances after one step.
    if len(ranked) > 1 and best.over_noise < first[ranked[1]].over_noise:
        further = converged(ranked[1])
        if further.over_noise > best.over_noise:
            chosen, best = ranked[1], further
    needed = rules.CHANCE + float(np.sqrt(rules.CHANCE**2 + threshold))  # D^2 - 2 CHANCE D = threshold
    decides, (effect, other) = best.over_noise >= needed, best.effects
    return NextExperiment(
        text=_text(chosen, best, needed, references[chosen].size * envelope.period),
        excitation=chosen if decides else None,
        between=(effect.name, other.name),
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
    """Distance between two models on an excitation, [N rms] and in standard deviations of the noise."""

    pair: tuple[Fit, Fit]
    distance: float
    over_noise: float

    @property
    def effects(self) -> tuple[Effect, Effect]:
        """The effects in which the two differ."""
        first, second = ({effect.name: effect for effect in fitted.model.effects} for fitted in self.pair)
        return next(first[n] for n in first if n not in second), next(second[n] for n in second if n not in first)


def _nearest(rivals: tuple[Fit, ...], extremes: list[np.ndarray], q_ref: np.ndarray, noise: float) -> _Apart | None:
    """The two rivals nearest to one another on ``q_ref``; None if one of them exceeds its ``extremes``."""
    if not all(_safe(rival, q_ref, limits) for rival, limits in zip(rivals, extremes, strict=True)):
        return None
    pairs = [pair for pair in combinations(rivals, 2) if len(set(pair[0].model.names) ^ set(pair[1].model.names)) == 2]
    distances = [replace(_apart(*_directions(pair)[0], q_ref, noise, 1), pair=pair) for pair in pairs]
    return min(distances, key=lambda apart: apart.over_noise)


def _directions(pair: tuple[Fit, Fit]) -> list[tuple[Fit, Fit]]:
    """Pairs (machine, rival fitted to it) in both orders; bristle models, slow to simulate, only as the machine."""
    both = [pair, pair[::-1]]
    return [order for order in both if not any(effect.takes_dry for effect in order[1].model.effects)] or both


def _apart(machine: Fit, rival: Fit, q_ref: np.ndarray, noise: float, steps: int) -> _Apart:
    """Fit ``rival`` to the simulation of ``machine`` on ``q_ref``, with its covariance as prior of its parameters."""
    force = machine.simulate(0, q_ref=q_ref).force
    start, slots, root = _one_record(rival)

    def difference(model: Candidate) -> np.ndarray:
        return force[rules.START_UP :] - rival.with_model(model).simulate(0, q_ref=q_ref).force[rules.START_UP :]

    def residual(model: Candidate) -> np.ndarray:
        innovations = rival.problem.whitening.apply(difference(model))
        return np.concatenate((innovations, root @ (model.vector(slots) - prior) / noise))

    prior = start.vector(slots)
    descent = descend(start, slots, residual, steps)
    return _Apart((machine, rival), float(np.std(difference(descent.model))), float(np.sqrt(descent.cost)) / noise)


def _one_record(fitted: Fit) -> tuple[Candidate, tuple[Slot, ...], np.ndarray]:
    """The model of ``fitted`` on one record, its free slots (k,), and a square root (m, k) of their information.

    Parameters of one record, such as the phase of a ripple, are unknown on the next.
    """
    model = replace(fitted.model, values=tuple(v[:1] for v in fitted.model.values))
    slots = tuple(slot for slot in fitted.slots if slot.record in (None, 0))
    shared = [k for k, slot in enumerate(fitted.slots) if slot.record is None]
    unit = np.array([fitted.slots[k].magnitude for k in shared])
    information = np.linalg.pinv(fitted.covariance[np.ix_(shared, shared)] / np.outer(unit, unit), hermitian=True)
    size, directions = np.linalg.eigh(information)
    root = np.zeros((len(shared), len(slots)))
    columns = [k for k, slot in enumerate(slots) if slot.record is None]
    root[:, columns] = np.sqrt(np.maximum(size, 0.0))[:, None] * directions.T / unit
    return model, slots, root


def _following(hypothesis: Hypothesis) -> Callable[[np.ndarray], np.ndarray]:
    """Gain (n,) from reference to position over angular frequencies (n,) [rad/s], without dry friction and effects."""
    pulse = np.zeros(8192)
    pulse[1] = 1e-6  # m, too small to reach the voltage limit
    mass, viscous, *_ = hypothesis.model.baseline
    smooth = hypothesis.with_model(Candidate(np.array([mass, viscous, 0.0, 0.0])))
    response = smooth.simulate(0, q_ref=pulse).position
    frequencies = 2 * np.pi * np.fft.rfftfreq(pulse.size, hypothesis.problem.period)
    gain = np.abs(np.fft.rfft(response)) / pulse[1]
    return lambda omega: np.interp(omega, frequencies, gain)


def _extremes(*runs: Run) -> np.ndarray:
    """Largest q and -q [m], |v| [m/s], step of v per sample [m/s] and |u| [V] of ``runs``, (5,)."""
    return np.max(
        [
            (run.position.max(), -run.position.min(), *(np.abs(x).max() for x in (run.v, np.diff(run.v), run.u)))
            for run in runs
        ],
        axis=0,
    )


def _safe(hypothesis: Hypothesis, q_ref: np.ndarray, limits: np.ndarray) -> bool:
    """Whether a model on ``q_ref`` stays within ``limits``, its :func:`_extremes` on the records, with a tolerance."""
    try:
        reached = _extremes(hypothesis.simulate(0, q_ref=q_ref))
    except SimulationError:
        return False
    tolerance = rules.SLIGHT * np.array([limits[0] + limits[1], limits[0] + limits[1], *limits[2:]])
    return bool(np.all(reached <= limits + tolerance))


def _text(excitation: str, apart: _Apart, needed: float, duration: float) -> str:
    effect, other = apart.effects
    names = f"{inside(effect.label)} from {inside(other.label)}"
    distance = apart.pair[0].problem.axis.units.quantity(apart.distance, "N", ".2g")
    difference = f"{distance} rms, {apart.over_noise:.1f} standard deviations of the noise"
    if apart.over_noise < needed:
        return (
            f"no motion within the range of the records separates {names}: in the best one ({instruction(excitation)}) "
            f"they differ by {difference}, where {needed:.1f} are needed; outside this range, {effect.words.experiment}"
        )
    return (
        f"{instruction(excitation)}, {duration:.0f} s, to separate {names}: fitted to one another they still differ by "
        f"{difference}, where {needed:.1f} are needed; diagnose the new record together with the old one"
    )
