"""The first stage: check the records and the controller's law, and split the records.

The law needs only ``q_ref`` and ``q``, both recorded: does the recorded voltage follow the law of the axis file? A gap
is visible without any plant, and is explained here and nowhere else.

The fit on the fitted samples says little, so a part of the record is held out where no other record confirms: the first
lap, where the reference repeats and two further laps give the noise (the first starts from rest, unlike the others), or
the last third of the strokes. Where too little would remain, nothing is held out, and the answer says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from emps_design.axis import NO_LIMIT, Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.records import Split, find_lap, find_strokes, split
from emps_design.discrepancy.words import filled, worded
from emps_design.effects import Effect, Motion
from emps_design.effects.effect import COULOMB, MASS, OFFSET, VISCOUS
from emps_design.effects.sizes import sized, sizes, speed_size
from emps_design.errors import InputError, RecordError
from emps_design.identification.excitation import SMALLEST_STROKE, backward_time, one_direction
from emps_design.identification.model import lumped
from emps_design.identification.proposals import FEWEST_STROKES
from emps_design.laws import get_law, law_of, recorded_gains, unit_of
from emps_design.messages import Message, grave, warning
from emps_design.records import Record
from emps_design.records.clock import same_period
from emps_design.units import Units

ONE_SPEED = (
    "one speed, one way, and a controller that is not known: {mass} and friction stay as the axis file says, and of "
    "the effects only {forces} with a place or a time are looked for. All others would pass for these, such as "
    "friction that changes along the travel: record strokes at several speeds to tell them apart"
)
DRIVE = {"gtau", "kp", "kv"}  # numbers of the drive that a record may carry


Interval = tuple[float, float]


@dataclass(frozen=True)
class LawCheck:
    """``gap`` (n,) [V] is u minus the law; ``noise`` [V] the standard deviation of its white part; ``structured`` says
    whether it is more than noise; ``addition`` explains it: an effect, and its parameters (n_parameters,)."""

    gap: np.ndarray
    noise: float
    structured: bool
    addition: tuple[Effect, np.ndarray] | None = None

    @property
    def added(self) -> str:
        """Name of the effect that the controller adds, or ""."""
        return "" if self.addition is None else self.addition[0].name

    @property
    def unexplained(self) -> bool:
        """Whether the controller does something that no effect explains."""
        return self.structured and self.addition is None


def check_law(record: Record, axis: Axis, library: tuple[Effect, ...]) -> LawCheck:
    """Check the law of ``axis`` on ``record`` and name a gap with one of the ``library``'s controller effects.

    Raises :class:`InputError` where the law holds nowhere: the axis file then has another controller than the drive.
    """
    limit = axis.drive.command_limit
    gap = record.u - law_voltage(record, axis)
    gap[: rules.START_UP] = 0.0
    free = np.abs(record.u) < rules.AT_LIMIT * limit
    centre = np.median(np.abs(gap[free]))
    swing = float(np.std(record.u))
    low = float(np.quantile(np.abs(gap[free] - np.median(gap[free])), 0.25))
    if min(centre, low) > rules.SLIGHT * swing:
        raise InputError(_wrong_law(record, axis, swing, float(np.std(gap))))
    noise = _noise(gap)
    width = max(2, round(rules.BLOCK_TIME / record.period))
    blocks = gap[: gap.size // width * width].reshape(-1, width).mean(axis=1)
    varying = float(np.var(blocks)) * width > rules.PLAIN * noise**2
    if not (varying and float(np.std(blocks)) > rules.BARELY * swing):
        return LawCheck(gap, noise, False)
    proposed = [(effect, propose_command(effect, record, gap)) for effect in library if effect.channel == "controller"]
    additions = [(effect, values) for effect, values in proposed if values is not None]
    remaining = [float(np.var(gap - command_of(*addition, record))) for addition in additions]
    if not remaining or min(remaining) > (1 - rules.NEARLY_ALL) * float(np.var(gap)):
        return LawCheck(gap, noise, True)
    return LawCheck(gap, noise, True, additions[remaining.index(min(remaining))])


def with_law_gap(record: Record, law: LawCheck | None) -> Record:
    """``record`` with the unexplained gap of its ``law`` as a known excitation.

    The plant is then judged under the recorded command.
    """
    if law is None or not law.unexplained:
        return record
    return replace(record, excitation=law.gap + (0.0 if record.excitation is None else record.excitation))


def law_voltage(record: Record, axis: Axis) -> np.ndarray:
    """Command (n,) [V] of the law of ``axis`` for the recorded reference and position, limited; 0 while off."""
    law = law_of(axis, record.period, record.extra)
    limit = axis.drive.command_limit
    voltage = law.commands(law.followed(record), record.q, limit, record.f_ext)
    added = 0.0 if record.excitation is None else record.excitation
    on = 1.0 if record.enable is None else record.enable != 0.0
    return np.clip(voltage + added, -limit, limit) * on


def propose_command(effect: Effect, record: Record, gap: np.ndarray) -> np.ndarray | None:
    """Parameters of a controller effect that explain ``gap`` (n,) [V] best, or None."""
    if effect.search.propose is None:
        return None
    nothing = np.zeros(len(record))
    motion = Motion(record.t, record.q, nothing, nothing, nothing, record.period, record.u)
    tried = []
    for table in effect.search.propose(motion, gap, np.zeros(4), np.ones(len(record), bool)):
        values = np.array([min(max(table[p.name], p.lower), p.upper) for p in effect.parameters])
        tried.append((float(np.var(gap - command_of(effect, values, record))), values))
    return min(tried, key=lambda pair: pair[0])[1] if tried else None


def command_of(effect: Effect, values: np.ndarray, record: Record) -> np.ndarray:
    """Voltage (n,) [V] that a controller effect adds over ``record``."""
    command, none = effect.command, np.zeros(0)
    if command is None:
        return np.zeros(len(record))
    return np.array(
        [command(q, 0.0, t, 0.0, none, values, np.zeros(4)) for t, q in zip(record.t, record.q, strict=True)]
    )


def _noise(gap: np.ndarray) -> float:
    """Standard deviation [V] of white noise in ``gap``, from first differences, robust to steps."""
    return 1.4826 * float(np.median(np.abs(np.diff(gap)))) / np.sqrt(2) + 1e-9


def _wrong_law(record: Record, axis: Axis, swing: float, miss: float) -> str:
    """The error message, with parameters of the law of ``axis`` that fit the record, or another law that does."""
    units = axis.units
    text = (
        f"{record.name}: the {units.word('voltage')} follows the axis file's {axis.controller.kind} law nowhere "
        f"(misses it by {units.quantity(miss, 'V', '.3g')} rms of {units.quantity(swing, 'V', '.3g')})"
    )
    kind = get_law(axis.controller.kind)
    if kind.propose is not None:
        wanted = np.where(np.arange(len(record)) < rules.START_UP, np.nan, record.u)
        followed = law_of(axis, record.period, record.extra).followed(record)
        proposed = kind.propose(followed, record.q, wanted, axis.controller, record.period)
        if proposed is not None:
            free = axis.replace(controller=proposed, drive={"command_limit": NO_LIMIT})
            miss_of_fit = float(np.std((record.u - law_voltage(record, free))[rules.START_UP :]))
            if miss_of_fit < rules.SLIGHT * swing:
                fields = kind.table.model_fields
                fitting = " and ".join(
                    f"{name} = {v:.5g} {units.unit(unit_of(fields[name]))}" for name, v in proposed.items()
                )
                return f"{text}; {fitting} fit it, correct the axis file"
    from emps_design.identification.controller import TOLD, identify_law

    identified = identify_law(record, axis.units)
    if identified.verdict == TOLD:
        return f"{text}; {identified.in_words} does and leaves {identified.residual_rms:.3g}, correct the axis file"
    return f'{text}; give the controller that made this record, or kind = "none"'


def check_records(records: tuple[Record, ...], axis: Axis, along_motion: bool = False) -> list[Message]:
    """Refuse what cannot be judged; return messages on what the records cannot tell.

    ``along_motion``: nothing is simulated, so that any period will do, and no reference is needed.
    """
    samples = sum(map(len, records))
    if samples > rules.MOST_SAMPLES:
        raise RecordError(
            f"{', '.join(record.name for record in records)}: found {samples} samples, expected at most "
            f"{rules.MOST_SAMPLES} in all: a diagnosis takes 1.7 kB of memory for each; "
            "cut the records to what tells most"
        )
    gaps: list[Message] = []
    for record in records:
        period = axis.sampling.period
        if not same_period(record.period, period):
            raise RecordError(
                f"{record.name}: found a sampling period of {1e3 * record.period:g} ms, expected the axis's "
                f"{1e3 * period:g} ms; records and axis must come from one drive"
            )
        if record.period > rules.SLOWEST_PERIOD and not along_motion:
            raise RecordError(
                f"{record.name}: found a sampling period of {1e3 * record.period:g} ms, expected at most "
                f"{1e3 * rules.SLOWEST_PERIOD:g} ms: "
                f"{axis.units.word('forces')} are looked at up to {rules.CUTOFF_HZ:g} Hz"
            )
        if record.duration < rules.SHORTEST:
            raise RecordError(
                f"{record.name}: found {record.duration:.3g} s, expected at least {rules.SHORTEST:g} s; record whole "
                "strokes"
            )
        least = rules.FEWEST_STEPS * axis.sampling.encoder_resolution or SMALLEST_STROKE
        if np.ptp(record.q) < least:
            raise RecordError(f"{record.name}: the axis does not move; record strokes in both directions")
        if np.ptp(record.q_ref) < least and not along_motion:
            raise RecordError(
                f"{record.name}: q_ref is constant, so the controller of the axis file did not make this motion; "
                'without one (kind = "none") it is compared by its command'
            )
        limited = float(np.mean(np.abs(record.u) >= rules.AT_LIMIT * axis.drive.command_limit))
        if limited > rules.HALF:
            raise RecordError(
                f"{record.name}: {100 * limited:.0f} % of the samples are at the {axis.units.word('voltage')} limit, "
                f"expected less than {100 * rules.HALF:.0f} %; lower speed or acceleration"
            )
        own = (*record.contradictions, *_not_excited(record, axis.units))
        gaps += [message.of(record.name) for message in own]
    return gaps


def looked_for_again(effects: Sequence[str]) -> Message:
    """The message that the ``effects`` of the axis file are not taken as known."""
    text = f"the axis's own effects are left out and looked for again: {', '.join(effects)}"
    return warning("looked-for-again", text, effects=effects)


def check_same_drive(record: Record, other: Record, axis: Axis) -> None:
    """Refuse an ``other`` record that was not sampled like ``record``, or whose file names another drive.

    Gains that the controller of ``axis`` takes from each record may differ.
    """
    if not same_period(record.period, other.period):
        raise RecordError(
            f"{other.name}: found a sampling period of {1e3 * other.period:g} ms, expected "
            f"{1e3 * record.period:g} ms of {record.name}; all records must come from one drive"
        )
    own = {source["record"] for source in recorded_gains(axis).values()}
    for name in sorted((DRIVE - own) & record.extra.keys() & other.extra.keys()):
        actual, expected = (float(np.ravel(r.extra[name])[0]) for r in (other, record))
        if not np.isclose(actual, expected, rtol=1e-6):
            raise RecordError(
                f"{other.name}: found {name} = {actual:g}, expected {expected:g} of {record.name}; all records must "
                "come from one drive"
            )


def same_run(record: Record, other: Record) -> bool:
    """Whether two records hold the same measurement, whatever their names."""
    return len(record) == len(other) and np.array_equal(record.q, other.q) and np.array_equal(record.u, other.u)


def keeps_one_speed(record: Record, used: np.ndarray) -> bool:
    """Whether ``record`` goes one way at about one speed in all the samples ``used`` (n,)."""
    v = np.gradient(record.q, record.period)[used]
    return bool(np.std(v) < rules.QUARTER * abs(np.mean(v)))


def identifiable_at_one_speed(effect: Effect) -> bool:
    """Whether one speed identifies ``effect``: a force at a place on the travel, or at a time, and no friction."""
    force = effect.channel == "plant" and effect.inertia is None and effect.dry is None
    return force and effect.over in ("q", "t")


def _not_excited(record: Record, units: Units) -> list[Message]:
    """Messages on what the speeds of ``record`` do not excite."""
    v = np.gradient(record.q_ref, record.period)
    fastest, size = float(np.abs(v).max()), speed_size(v)
    steady = np.abs(v)[(np.abs(np.gradient(v, record.period)) < 0.01 * size) & (np.abs(v) > 0.02 * fastest)]
    gaps = []
    if steady.size and np.ptp(steady) < 0.1 * fastest:
        text = "one speed only, so viscous friction and its curvature cannot be told from Coulomb friction"
        gaps.append(grave("one-speed", text))
    moving, slow = np.abs(v) > 0, rules.SLOW * size
    if moving.any() and float(np.mean(np.abs(v[moving]) < slow)) < 0.005:
        speed = units.quantity(slow, "mm/s", ".2g")
        text = f"hardly any motion below {speed}, so Stribeck friction is seen at reversals only"
        gaps.append(warning("no-slow-motion", text, speed=slow))
    return gaps


@dataclass(frozen=True)
class Confirming:
    """Which data confirm: ``what`` in words, ``chosen`` "given", "kept", "in turn" or "none", ``time`` [s] of a part.

    ``what`` says for "none" why nothing was held out.
    """

    what: str
    chosen: str
    time: Interval | None = None

    @property
    def opened(self) -> Confirming:
        """The same where the part held out differs from the rest: then all is fitted."""
        return Confirming(f"{self.what}, kept closed at first, has something that the rest lacks", "none")

    @property
    def sentence(self) -> str:
        """What data the errors and shares refer to; empty where the user gave the data."""
        if self.chosen == "kept":
            return f"Nothing was fitted to {self.what}, kept closed to confirm."
        if self.chosen == "in turn":
            return f"Each of {self.what} was predicted from the others: errors and shares are of what was not fitted."
        if self.chosen == "none":
            return (
                f"Nothing was held out ({self.what}): errors and shares are of what was fitted; give another record as "
                "`holdout`."
            )
        return ""

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "what": self.what,
            "chosen": self.chosen,
            "time": None if self.time is None else list(self.time),
            "text": self.sentence,
        }


def user_choice(record: Record, time: Interval | None = None) -> Confirming:
    """``record``, or the interval ``time`` [s] of it, as the user's data to confirm."""
    part = "" if time is None else f"{time[0]:.4g} to {time[1]:.4g} s of "
    return Confirming(f"{part}{record.name}", "given", time)


def kept_closed(records: tuple[Record, ...], fit_time: Interval | None = None) -> Confirming:
    """Choose the part of ``records`` to hold out within ``fit_time`` [s]; nothing of several records.

    >>> wave = np.abs(np.arange(6000) % 1000 - 500.0) * 1e-3
    >>> kept_closed((Record.from_arrays(1e-3, wave, wave, wave, name="run"),)).sentence
    'Nothing was fitted to the first lap of run, 0 to 1 s, kept closed to confirm.'
    >>> kept_closed((Record.from_arrays(1e-3, wave[:1200], wave[:1200], wave[:1200], name="run"),)).sentence
    'Nothing was held out (run has 3 strokes and does not repeat three times): errors and shares are of what was \
fitted; give another record as `holdout`.'
    """
    record = records[0]
    if len(records) > 1:
        return Confirming(f"{len(records)} records are fitted together", "none")
    begin, end = 0, len(record)
    if fit_time is not None:
        begin, end = (int(i) for i in np.searchsorted(record.t, fit_time))
    lap, strokes = find_lap(record.q_ref), find_strokes(record.q_ref, record.period)
    inside = [(start, stop) for start, stop in strokes if start >= begin and stop <= end]
    if lap and end - begin >= rules.LAPS * lap - rules.START_UP:
        start, stop, what = begin, begin + lap, "the first lap"
    elif lap or len(inside) < 2 * FEWEST_STROKES:
        return Confirming(f"{record.name} has {_strokes(len(inside))} and does not repeat three times", "none")
    else:
        count = int(rules.THIRD * len(inside))
        start, stop, what = inside[-count][0], end, f"the last {count} of {_strokes(len(inside))}"
    remaining = end - begin - (stop - start)
    if stop - start < rules.START_UP + rules.FEWEST or remaining < rules.FEWEST + rules.FEWEST_TO_SELECT:
        return Confirming(f"{record.name} has {end - begin} samples to fit", "none")
    time = float(record.t[start]), float(record.t[stop - 1]) + 0.5 * record.period
    shown = f"{time[0]:.4g} to {time[0] + (stop - start) * record.period:.4g} s"
    return Confirming(f"{what} of {record.name}, {shown}", "kept", time)


def _strokes(number: int) -> str:
    return f"{number} stroke{'' if number == 1 else 's'}"


@dataclass(frozen=True)
class HeldOut:
    """The data that confirm, as a problem; ``window`` (start, stop) [s] where they are part of a record.

    ``law`` is None where the controller is unknown, or the data are part of the training record.
    """

    problem: Problem
    window: Interval | None
    law: LawCheck | None

    @property
    def added(self) -> str:
        """Name of the effect that the controller adds here, or ""."""
        return "" if self.law is None else self.law.added

    def with_whitening(self, whitening: Whitening) -> HeldOut:
        """The same data judged with other noise."""
        return replace(self, problem=self.problem.with_whitening(whitening))


@dataclass(frozen=True)
class Preparation:
    """What a diagnosis starts from.

    ``records`` are the user's; ``start`` is the axis file's model of them, with the controller's addition to its law;
    ``library`` are the candidate effects, ``laws`` the checks of the controller's law, one per record where the
    controller is known. ``confirming`` describes ``held_out``, or why it is None. ``direction`` is 1 or -1 where all
    motion is one way: then only the sum of Coulomb friction and constant force is determined, and the latter stays as
    in the axis file.
    """

    records: tuple[Record, ...]
    start: Hypothesis
    library: tuple[Effect, ...]
    laws: tuple[LawCheck, ...]
    held_out: HeldOut | None
    confirming: Confirming
    warnings: tuple[Message, ...]
    direction: int = 0

    @property
    def unexplained_law(self) -> bool:
        """Whether the controller does something on the training records that no effect explains."""
        return any(law.unexplained for law in self.laws)


def prepare(
    records: tuple[Record, ...],
    axis: Axis,
    library: tuple[Effect, ...],
    holdout: Record | None,
    fit_time: Interval | None,
    confirm_time: Interval | None,
    opened: Confirming | None = None,
) -> Preparation:
    """Check the records and the controller's law, scale the library to the axis, and split the training samples.

    Held out is ``holdout``, or ``confirm_time`` [s] of the first record, or else the part of :func:`kept_closed`;
    nothing with ``opened``.
    """
    confirming = opened or _confirming(records, holdout, fit_time, confirm_time)
    confirm_time = confirming.time
    dropped, first = [entry.effect.name for entry in axis.effects], records[0]
    axis = axis.replace(effects=[]).supplied_by(*records, *(() if holdout is None else (holdout,)))
    factors = sizes(first.q, first.u, first.period, axis.drive.gain)
    lines = (line for effect in library if effect.acts_on(axis.motion) for line in effect.several())
    library = tuple(worded(sized(line, factors), axis.units) for line in lines)
    warnings = check_records(records, axis)
    if dropped:
        warnings.append(looked_for_again(dropped))
    for other in (*records[1:], *(() if holdout is None else (holdout,))):
        check_same_drive(first, other, axis)
    for earlier, other in combinations(records, 2):
        if same_run(earlier, other):
            raise InputError(f"{other.name}: is the record {earlier.name} again; give each record once")
    known, law = axis.controller.kind != "none", None
    if holdout is not None:
        if any(same_run(holdout, record) for record in records):
            raise InputError(f"{holdout.name}: is a training record too; confirm on one that nothing was fitted to")
        warnings += check_records((holdout,), axis)
        # Another controller is refused before the search; the law says nothing about the plant.
        law = check_law(holdout, axis, library) if known else None
    laws = tuple(check_law(record, axis, library) for record in records if known)
    judged = tuple(map(with_law_gap, records, laws)) if known else records
    splits = _splits(records, fit_time, confirm_time)
    # A record ends at the last fitted sample, so that no filter uses held-out samples.
    ends = [int(np.flatnonzero(part.used)[-1]) + 1 if part.used.any() else len(part.fit) for part in splits]
    searched, splits = tuple(map(Record.until, judged, ends)), tuple(map(Split.until, splits, ends))
    problem = Problem(axis, searched, splits, Whitening.none())
    held_out = None
    if holdout is not None or confirm_time is not None:
        record, window = judged[0] if holdout is None else with_law_gap(holdout, law), None
        inside = np.ones(len(record), bool)
        if confirm_time is not None:
            inside = between(record, confirm_time, "`confirm_time`")
        if not inside.all():
            window = float(record.t[inside][0]), float(record.t[inside][-1])
        held_out = HeldOut(Problem(axis, (record,), (split(record, inside),), Whitening.none()), window, law)
    held: tuple[int, ...] = ()
    # A motor that stutters forward has two signs of friction, however far it gets in one direction.
    stutters = any(backward_time(record) > rules.SLIGHT for record in searched)
    direction = 0 if stutters else one_direction(searched)
    if problem.follows and all(map(keeps_one_speed, searched, problem.masks("used"))):
        held = MASS, VISCOUS, COULOMB
        library = tuple(filter(identifiable_at_one_speed, library))
        warnings.append(warning("one-speed-one-way", filled(ONE_SPEED, axis.units)))
        direction = 0
    elif direction:
        held = (OFFSET,)
        warnings.append(lumped(axis.units))
    start = Hypothesis(problem, _as_the_axis_says(Candidate.of(axis, factors, held), laws))
    plant = tuple(effect for effect in library if effect.channel != "controller")
    return Preparation(records, start, plant, laws, held_out, confirming, tuple(warnings), direction)


def _confirming(
    records: tuple[Record, ...], holdout: Record | None, fit_time: Interval | None, confirm_time: Interval | None
) -> Confirming:
    if holdout is not None:
        return user_choice(holdout)
    return kept_closed(records, fit_time) if confirm_time is None else user_choice(records[0], confirm_time)


def _splits(records: tuple[Record, ...], fit_time: Interval | None, confirm_time: Interval | None) -> tuple[Split, ...]:
    """The fitting and selecting samples of each record; raises :class:`InputError` where they are too few."""
    allowed = [np.ones(len(r), bool) if fit_time is None else between(r, fit_time, "`fit_time`") for r in records]
    if confirm_time is not None:
        kept = between(records[0], confirm_time, "`confirm_time`")
        if kept.sum() < rules.FEWEST:
            raise InputError(
                f"`confirm_time`: found {kept.sum()} samples of {records[0].name}, expected at least {rules.FEWEST}"
            )
        allowed[0] &= ~kept
    there = [
        mask[start:stop].any()
        for record, mask in zip(records, allowed, strict=True)
        for start, stop in find_strokes(record.q_ref, record.period)
    ]
    few = sum(there) < FEWEST_STROKES
    splits: list[Split] = []
    for record, mask in zip(records, allowed, strict=True):
        splits.append(split(record, mask, sum(len(made.strokes) for made in splits), rules.PARTS if few else 1))
    fits, selects, used = (int(sum(getattr(s, part).sum() for s in splits)) for part in ("fit", "select", "used"))
    if fits < rules.FEWEST or selects < rules.FEWEST_TO_SELECT:
        raise InputError(
            f"{', '.join(record.name for record in records)}: found {used} samples to fit, in "
            f"{sum(len(made.strokes) for made in splits)} strokes; expected at least {rules.FEWEST} to fit and "
            f"{rules.FEWEST_TO_SELECT} others to select from: record longer (identify needs less)"
        )
    return tuple(splits)


def _as_the_axis_says(start: Candidate, laws: tuple[LawCheck, ...]) -> Candidate:
    """The axis file's numbers, with the effect that explains what the controller adds to its law."""
    additions = [law.addition for law in laws]
    first = next((addition for addition in additions if addition is not None), None)
    if first is None:
        return start
    effect, values = first
    # On a record without the disturbance its amplitude is zero.
    idle = np.where([p.unit == "V" for p in effect.parameters], 0.0, values)
    rows = [idle if addition is None or addition[0] is not effect else addition[1] for addition in additions]
    return start.with_effect(effect, np.array(rows))


def between(record: Record, window: Interval, option: str) -> np.ndarray:
    """Samples (n,) bool of ``record`` inside ``window`` (start, stop) [s]; refuses an empty one."""
    inside = (record.t >= window[0]) & (record.t < window[1])
    if not inside.any():
        raise InputError(
            f"{option}: found {window[0]:g}:{window[1]:g} s, expected a part of {record.name}, which lasts "
            f"{record.duration:.3g} s"
        )
    return inside
