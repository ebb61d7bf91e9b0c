"""The first stage: check the records and the controller's law, and split the records.

The law needs only ``q_ref`` and ``q``, and both are recorded. So the difference between the recorded voltage and the
law of the axis file does not depend on the plant, and is explained here only.

The error on fitted samples proves little. Without a held-out record, a part of the record is held out: the first lap if
the reference repeats and two further laps give the noise (it starts from rest, unlike the others), otherwise the last
third of the strokes. If too few samples would remain, nothing is held out, and the result says so.
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
    "the motion has one speed and one direction, and the controller is unknown: {mass} and friction stay as in the "
    "axis file, and only {forces} at a position or a time are looked for. Any other effect, such as friction that "
    "varies along the travel, would be taken for one of these: record strokes at several speeds to separate them"
)
DRIVE = {"gtau", "kp", "kv"}  # numbers of the drive that a record may carry


Interval = tuple[float, float]


@dataclass(frozen=True)
class LawCheck:
    """The difference between the command and the law.

    ``gap`` (n,) [V] is u minus the law, ``noise`` [V] the standard deviation of its white part. ``structured``: it is
    more than noise. ``addition`` is the effect that explains it, with its parameters (n_parameters,).
    """

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
    """Check the law of ``axis`` on ``record``; explain a difference by one of the controller effects of ``library``.

    Raises :class:`InputError` if no sample follows the law: then the drive has another controller than the axis file.
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
    """``record`` with the unexplained gap of its ``law`` as a known excitation, so that the recorded command acts."""
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
    attempts = []
    for table in effect.search.propose(motion, gap, np.zeros(4), np.ones(len(record), bool)):
        values = np.array([min(max(table[p.name], p.lower), p.upper) for p in effect.parameters])
        attempts.append((float(np.var(gap - command_of(effect, values, record))), values))
    return min(attempts, key=lambda pair: pair[0])[1] if attempts else None


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
    """The error message, with parameters of the law of ``axis`` that fit the record, or another law that fits."""
    units = axis.units
    text = (
        f"{record.name}: the {units.word('voltage')} does not follow the axis file's {axis.controller.kind} law "
        f"(it differs by {units.quantity(miss, 'V', '.3g')} rms of {units.quantity(swing, 'V', '.3g')})"
    )
    kind = get_law(axis.controller.kind)
    if kind.propose is not None:
        target = np.where(np.arange(len(record)) < rules.START_UP, np.nan, record.u)
        followed = law_of(axis, record.period, record.extra).followed(record)
        proposed = kind.propose(followed, record.q, target, axis.controller, record.period)
        if proposed is not None:
            free = axis.replace(controller=proposed, drive={"command_limit": NO_LIMIT})
            miss_of_fit = float(np.std((record.u - law_voltage(record, free))[rules.START_UP :]))
            if miss_of_fit < rules.SLIGHT * swing:
                fields = kind.table.model_fields
                fitting = " and ".join(
                    f"{name} = {v:.5g} {units.unit(unit_of(fields[name]))}" for name, v in proposed.items()
                )
                return f"{text}; it fits {fitting}: correct the axis file"
    from emps_design.identification.controller import TOLD, identify_law

    identified = identify_law(record, axis.units)
    if identified.verdict == TOLD:
        residual = f"{identified.residual_rms:.3g}"
        return f"{text}; it follows {identified.in_words} with a residual of {residual}: correct the axis file"
    return f'{text}; give the controller that made this record, or kind = "none"'


def check_records(records: tuple[Record, ...], axis: Axis, along_motion: bool = False) -> list[Message]:
    """Raise on records that cannot be judged; return messages about what the records do not excite.

    With ``along_motion`` nothing is simulated, so any period is accepted and no reference is needed.
    """
    samples = sum(map(len, records))
    if samples > rules.MOST_SAMPLES:
        raise RecordError(
            f"{', '.join(record.name for record in records)}: found {samples} samples, expected at most "
            f"{rules.MOST_SAMPLES} in all: a diagnosis takes 1.7 kB of memory for each; "
            "cut the records to their most informative part"
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
                f"{axis.units.word('forces')} are compared up to {rules.CUTOFF_HZ:g} Hz"
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
                'with kind = "none" the record is judged by its command'
            )
        limited = float(np.mean(np.abs(record.u) >= rules.AT_LIMIT * axis.drive.command_limit))
        if limited > rules.HALF:
            raise RecordError(
                f"{record.name}: {100 * limited:.0f} % of the samples are at the {axis.units.word('voltage')} limit, "
                f"expected less than {100 * rules.HALF:.0f} %; lower speed or acceleration"
            )
        messages = (*record.contradictions, *_excitation_messages(record, axis.units))
        gaps += [message.of(record.name) for message in messages]
    return gaps


def dropped_effects_message(effects: Sequence[str]) -> Message:
    """The message that the ``effects`` of the axis file are not treated as known."""
    text = f"the effects of the axis file are removed and looked for again: {', '.join(effects)}"
    return warning("looked-for-again", text, effects=effects)


def check_same_drive(record: Record, other: Record, axis: Axis) -> None:
    """Raise :class:`RecordError` if ``other`` has another sampling period than ``record``, or names another drive.

    Gains that the controller of ``axis`` takes from each record may differ.
    """
    if not same_period(record.period, other.period):
        raise RecordError(
            f"{other.name}: found a sampling period of {1e3 * other.period:g} ms, expected "
            f"{1e3 * record.period:g} ms of {record.name}; all records must come from one drive"
        )
    with_gains = {source["record"] for source in recorded_gains(axis).values()}
    for name in sorted((DRIVE - with_gains) & record.extra.keys() & other.extra.keys()):
        actual, expected = (float(np.ravel(r.extra[name])[0]) for r in (other, record))
        if not np.isclose(actual, expected, rtol=1e-6):
            raise RecordError(
                f"{other.name}: found {name} = {actual:g}, expected {expected:g} of {record.name}; all records must "
                "come from one drive"
            )


def same_run(record: Record, other: Record) -> bool:
    """Whether two records hold the same measurement, regardless of their names."""
    return len(record) == len(other) and np.array_equal(record.q, other.q) and np.array_equal(record.u, other.u)


def has_one_speed(record: Record, used: np.ndarray) -> bool:
    """Whether the motion in the samples ``used`` (n,) has one direction and about one speed."""
    v = np.gradient(record.q, record.period)[used]
    return bool(np.std(v) < rules.QUARTER * abs(np.mean(v)))


def identifiable_at_one_speed(effect: Effect) -> bool:
    """Whether one speed identifies ``effect``: a force that depends on position or time, and no friction."""
    force = effect.channel == "plant" and effect.inertia is None and effect.dry is None
    return force and effect.over in ("q", "t")


def _excitation_messages(record: Record, units: Units) -> list[Message]:
    """Messages about effects that the speeds of ``record`` do not excite."""
    v = np.gradient(record.q_ref, record.period)
    fastest, size = float(np.abs(v).max()), speed_size(v)
    steady = np.abs(v)[(np.abs(np.gradient(v, record.period)) < 0.01 * size) & (np.abs(v) > 0.02 * fastest)]
    gaps = []
    if steady.size and np.ptp(steady) < 0.1 * fastest:
        text = "one speed only, so viscous friction and its curvature cannot be separated from Coulomb friction"
        gaps.append(grave("one-speed", text))
    moving, slow = np.abs(v) > 0, rules.SLOW * size
    if moving.any() and float(np.mean(np.abs(v[moving]) < slow)) < 0.005:
        speed = units.quantity(slow, "mm/s", ".2g")
        text = f"hardly any motion below {speed}, so Stribeck friction shows at reversals only"
        gaps.append(warning("no-slow-motion", text, speed=slow))
    return gaps


@dataclass(frozen=True)
class HoldOut:
    """The choice of the held-out data: ``what`` in words, and ``time`` [s] of a part of a record.

    ``chosen`` is "given" by the user, "kept" by this program, "in turn" for leave-one-out over strokes, or "none"; then
    ``what`` says why nothing was held out.
    """

    what: str
    chosen: str
    time: Interval | None = None

    @property
    def opened(self) -> HoldOut:
        """The choice after the held-out part was found to differ from the rest: all samples are fitted."""
        return HoldOut(f"{self.what}, held out at first, shows something that the rest does not", "none")

    @property
    def sentence(self) -> str:
        """The data that errors and shares refer to, as a sentence; empty if the user chose them."""
        if self.chosen == "kept":
            return f"Held out for confirmation: {self.what}."
        if self.chosen == "in turn":
            return f"Each of {self.what} was predicted from the others: errors and shares refer to held-out data."
        if self.chosen == "none":
            return (
                f"Nothing was held out ({self.what}): errors and shares refer to the fitted data; give another record "
                "as `holdout`."
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


def user_choice(record: Record, time: Interval | None = None) -> HoldOut:
    """``record``, or its interval ``time`` [s], as held-out data chosen by the user."""
    part = "" if time is None else f"{time[0]:.4g} to {time[1]:.4g} s of "
    return HoldOut(f"{part}{record.name}", "given", time)


def choose_held_out(records: tuple[Record, ...], fit_time: Interval | None = None) -> HoldOut:
    """Choose the part of ``records`` to hold out within ``fit_time`` [s]; none of several records.

    >>> wave = np.abs(np.arange(6000) % 1000 - 500.0) * 1e-3
    >>> choose_held_out((Record.from_arrays(1e-3, wave, wave, wave, name="run"),)).sentence
    'Held out for confirmation: the first lap of run, 0 to 1 s.'
    >>> choose_held_out((Record.from_arrays(1e-3, wave[:1200], wave[:1200], wave[:1200], name="run"),)).sentence
    'Nothing was held out (run has 3 strokes and fewer than three laps): errors and shares refer to the fitted data; \
give another record as `holdout`.'
    """
    record = records[0]
    if len(records) > 1:
        return HoldOut(f"{len(records)} records are fitted together", "none")
    begin, end = 0, len(record)
    if fit_time is not None:
        begin, end = (int(i) for i in np.searchsorted(record.t, fit_time))
    lap, strokes = find_lap(record.q_ref), find_strokes(record.q_ref, record.period)
    inside = [(start, stop) for start, stop in strokes if start >= begin and stop <= end]
    if lap and end - begin >= rules.LAPS * lap - rules.START_UP:
        start, stop, what = begin, begin + lap, "the first lap"
    elif lap or len(inside) < 2 * FEWEST_STROKES:
        return HoldOut(f"{record.name} has {_strokes(len(inside))} and fewer than three laps", "none")
    else:
        count = int(rules.THIRD * len(inside))
        start, stop, what = inside[-count][0], end, f"the last {count} of {_strokes(len(inside))}"
    remaining = end - begin - (stop - start)
    if stop - start < rules.START_UP + rules.FEWEST or remaining < rules.FEWEST + rules.FEWEST_TO_SELECT:
        return HoldOut(f"{record.name} has {end - begin} samples to fit", "none")
    time = float(record.t[start]), float(record.t[stop - 1]) + 0.5 * record.period
    shown = f"{time[0]:.4g} to {time[0] + (stop - start) * record.period:.4g} s"
    return HoldOut(f"{what} of {record.name}, {shown}", "kept", time)


def _strokes(number: int) -> str:
    return f"{number} stroke{'' if number == 1 else 's'}"


@dataclass(frozen=True)
class HeldOut:
    """The held-out data as a problem; ``window`` (start, stop) [s] if they are part of a record.

    ``law`` is None if the controller is unknown or the data are part of the training record.
    """

    problem: Problem
    window: Interval | None
    law: LawCheck | None

    @property
    def added(self) -> str:
        """Name of the effect that the controller adds here, or ""."""
        return "" if self.law is None else self.law.added

    def with_whitening(self, whitening: Whitening) -> HeldOut:
        """The same data judged with another noise model."""
        return replace(self, problem=self.problem.with_whitening(whitening))


@dataclass(frozen=True)
class Preparation:
    """Input of a diagnosis after the checks.

    ``start`` is the model of the axis file with the disturbance that the controller adds to its law; ``library`` are
    the candidate effects; ``laws`` are the checks of the controller's law, one per record if the controller is known.
    ``hold_out`` describes ``held_out``, or why it is None. ``direction`` is 1 or -1 if all motion has one direction:
    then only the sum of Coulomb friction and constant force is determined, and the constant force stays as in the axis
    file.
    """

    records: tuple[Record, ...]
    start: Hypothesis
    library: tuple[Effect, ...]
    laws: tuple[LawCheck, ...]
    held_out: HeldOut | None
    hold_out: HoldOut
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
    opened: HoldOut | None = None,
) -> Preparation:
    """Check the records and the controller's law, scale the library to the axis, and split the training samples.

    The held-out data are ``holdout``, or ``confirm_time`` [s] of the first record, or the part that
    :func:`choose_held_out` selects; none with ``opened``.
    """
    hold_out = opened or _confirming(records, holdout, fit_time, confirm_time)
    confirm_time = hold_out.time
    dropped, first = [entry.effect.name for entry in axis.effects], records[0]
    axis = axis.replace(effects=[]).supplied_by(*records, *(() if holdout is None else (holdout,)))
    factors = sizes(first.q, first.u, first.period, axis.drive.gain)
    lines = (line for effect in library if effect.acts_on(axis.motion) for line in effect.several())
    library = tuple(worded(sized(line, factors), axis.units) for line in lines)
    warnings = check_records(records, axis)
    if dropped:
        warnings.append(dropped_effects_message(dropped))
    for other in (*records[1:], *(() if holdout is None else (holdout,))):
        check_same_drive(first, other, axis)
    for earlier, other in combinations(records, 2):
        if same_run(earlier, other):
            raise InputError(f"{other.name}: same measurement as {earlier.name}; give each record once")
    known, law = axis.controller.kind != "none", None
    if holdout is not None:
        if any(same_run(holdout, record) for record in records):
            raise InputError(f"{holdout.name}: also a training record; confirm on a record that is not fitted")
        warnings += check_records((holdout,), axis)
        # A record of another controller is refused before the search. The law does not depend on the plant.
        law = check_law(holdout, axis, library) if known else None
    laws = tuple(check_law(record, axis, library) for record in records if known)
    judged = tuple(map(with_law_gap, records, laws)) if known else records
    splits = _splits(records, fit_time, confirm_time)
    # Records are cut at the last fitted sample, so that no filter sees held-out samples.
    ends = [int(np.flatnonzero(part.used)[-1]) + 1 if part.used.any() else len(part.fit) for part in splits]
    searched, splits = tuple(map(Record.until, judged, ends)), tuple(map(Split.until, splits, ends))
    problem = Problem(axis, searched, splits, Whitening.none())
    held_out = None
    if holdout is not None or confirm_time is not None:
        record, window = judged[0] if holdout is None else with_law_gap(holdout, law), None
        inside = np.ones(len(record), bool)
        if confirm_time is not None:
            inside = samples_within(record, confirm_time, "`confirm_time`")
        if not inside.all():
            window = float(record.t[inside][0]), float(record.t[inside][-1])
        held_out = HeldOut(Problem(axis, (record,), (split(record, inside),), Whitening.none()), window, law)
    held: tuple[int, ...] = ()
    # In stick-slip the friction has both signs, even if the net motion has one direction.
    stutters = any(backward_time(record) > rules.SLIGHT for record in searched)
    direction = 0 if stutters else one_direction(searched)
    if problem.follows and all(map(has_one_speed, searched, problem.masks("used"))):
        held = MASS, VISCOUS, COULOMB
        library = tuple(filter(identifiable_at_one_speed, library))
        warnings.append(warning("one-speed-one-way", filled(ONE_SPEED, axis.units)))
        direction = 0
    elif direction:
        held = (OFFSET,)
        warnings.append(lumped(axis.units))
    start = Hypothesis(problem, _candidate_of_axis(Candidate.of(axis, factors, held), laws))
    plant = tuple(effect for effect in library if effect.channel != "controller")
    return Preparation(records, start, plant, laws, held_out, hold_out, tuple(warnings), direction)


def _confirming(
    records: tuple[Record, ...], holdout: Record | None, fit_time: Interval | None, confirm_time: Interval | None
) -> HoldOut:
    if holdout is not None:
        return user_choice(holdout)
    return choose_held_out(records, fit_time) if confirm_time is None else user_choice(records[0], confirm_time)


def _splits(records: tuple[Record, ...], fit_time: Interval | None, confirm_time: Interval | None) -> tuple[Split, ...]:
    """The fitting and selecting samples of each record; raises :class:`InputError` if they are too few."""
    allowed = [
        np.ones(len(r), bool) if fit_time is None else samples_within(r, fit_time, "`fit_time`") for r in records
    ]
    if confirm_time is not None:
        held_out = samples_within(records[0], confirm_time, "`confirm_time`")
        if held_out.sum() < rules.FEWEST:
            raise InputError(
                f"`confirm_time`: found {held_out.sum()} samples of {records[0].name}, expected at least {rules.FEWEST}"
            )
        allowed[0] &= ~held_out
    has_samples = [
        mask[start:stop].any()
        for record, mask in zip(records, allowed, strict=True)
        for start, stop in find_strokes(record.q_ref, record.period)
    ]
    few = sum(has_samples) < FEWEST_STROKES
    splits: list[Split] = []
    for record, mask in zip(records, allowed, strict=True):
        splits.append(split(record, mask, sum(len(earlier.strokes) for earlier in splits), rules.PARTS if few else 1))
    fits, selects, used = (int(sum(getattr(s, part).sum() for s in splits)) for part in ("fit", "select", "used"))
    if fits < rules.FEWEST or selects < rules.FEWEST_TO_SELECT:
        raise InputError(
            f"{', '.join(record.name for record in records)}: found {used} samples to fit, in "
            f"{sum(len(each.strokes) for each in splits)} strokes; expected at least {rules.FEWEST} to fit and "
            f"{rules.FEWEST_TO_SELECT} others to select from: make a longer record (identify needs less)"
        )
    return tuple(splits)


def _candidate_of_axis(start: Candidate, laws: tuple[LawCheck, ...]) -> Candidate:
    """``start`` with the effect that explains what the controller adds to its law, if any."""
    additions = [law.addition for law in laws]
    first = next((addition for addition in additions if addition is not None), None)
    if first is None:
        return start
    effect, values = first
    # On a record without the disturbance its amplitude is zero.
    idle = np.where([p.unit == "V" for p in effect.parameters], 0.0, values)
    rows = [idle if addition is None or addition[0] is not effect else addition[1] for addition in additions]
    return start.with_effect(effect, np.array(rows))


def samples_within(record: Record, window: Interval, option: str) -> np.ndarray:
    """Samples (n,) bool of ``record`` inside ``window`` (start, stop) [s]; raises :class:`InputError` if empty."""
    inside = (record.t >= window[0]) & (record.t < window[1])
    if not inside.any():
        raise InputError(
            f"{option}: found {window[0]:g}:{window[1]:g} s, expected a part of {record.name}, which lasts "
            f"{record.duration:.3g} s"
        )
    return inside
