"""Read a record of an axis from the formats of drives, and check it against its controller or its motion.

The law of the axis file is checked against the record: whether it reproduces the recorded command. It is a difference
equation of recorded signals, so it gives the recorded command up to the noise and resolution of that command. Where
it does not, samples were lost, filtered, exchanged or from another source, the controller added something to its law,
or it is another one. The plant plays no part, so friction and elasticity cannot cause a gap.

The law runs on the recorded reference and position. States that the record does not show are left out: the integrator
before the first sample, the phase of a slower loop, samples at the limit in both, samples with the motor switched
off.

A gap is explained by the simplest change that makes it small. Each change that a logger or a person may make to a
record is applied to the command of the law, or undone on the record before the law runs. The first that leaves little
of the gap is named. Nothing is corrected.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.importing.sanity import BEYOND_LIMIT, COARSER, check_against, check_motion, odd_increments
from emps_design.laws import NONE, Law, law_of
from emps_design.messages import wrong
from emps_design.records import MAX_BYTES, MAX_BYTES_TO_CUT, Record, read_record, record_from_bytes
from emps_design.records.check import AT_LIMIT
from emps_design.records.clock import same_period
from emps_design.records.layout import Layout
from emps_design.records.record import quantisation_step
from emps_design.request import typed

START_UP = 0.1  # s, after which the state of the law before the first sample no longer matters
FEWEST_AT_START = 8  # samples
SETTLING = 0.015  # s after the limit, until filters no longer show the integrator
AROUND = 3  # samples beside one with the motor switched off
PHASES, PHASE_LOOK = 16, 6000  # most phases of a slower loop that are tried, on so many samples

EXPLAINS = 0.15  # of the power of the gap, and of the command, that may be left
FEW = 0.05  # of the samples: most that count as few
HALF_A_STEP = 0.5  # largest error by rounding
MOST_LATE = 64  # samples
CORNERS_HZ = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0)
TRIED = 20_000  # samples on which the law is run again
PIECES, SAME_GAIN = 16, 0.02  # of a record, with a gain each; difference above which a gain is another
EVERY = range(2, 9)  # periods of samples that may be another signal's
OTHERS = 0.01  # of the gap's power in such samples, the most in the others
SMOOTH = 0.02  # of the gap, largest change from sample to sample that is no noise
TOGETHER = 0.5  # correlation of the command with that of the law, below which it is another controller's

LOOK, PARTS = 100_000, 5  # samples of a long record that are checked, in so many parts
FEWEST = 100  # samples that count
BLOCK_TIME, FEWEST_IN_BLOCK = 0.02, 4  # s, and samples
STRUCTURE = 2.0  # times the effect of white noise on the means over a block
ROUNDING = 6.0  # times the effect of the record's rounding
VISIBLE = 0.01  # of the command's deviation, below which a gap harms no estimate
ALONE = 12.0  # deviations of the noise, beyond which a sample is an outlier
ALONE_VISIBLE = 0.02  # of the command's deviation, rms over the record
COARSE, OF_A_STEP = 0.1, 0.2  # of the command's deviation: steps that hide what the law gives; rms that they leave
LOUD = 0.2  # of the command's deviation

BLOCK = 500_000  # samples that are checked together, to save memory
MEANS = "results from this record may have larger errors than stated"


@dataclass(frozen=True)
class LawReplay:
    """The command of ``law``, ``wanted`` (n,), for a ``record``, ``used`` (n,) bool marks the compared samples."""

    record: Record
    law: Law
    limit: float
    wanted: np.ndarray
    used: np.ndarray

    @property
    def gap(self) -> np.ndarray:
        """The recorded command less that of the law (n,), 0 at samples that are not compared."""
        return np.where(self.used, self.record.u - self.wanted, 0.0)

    @property
    def swing(self) -> float:
        """Standard deviation of the recorded command over the compared samples."""
        return float(np.std(self.record.u[self.used])) if self.used.any() else 0.0


def can_replay(axis: Axis, record: Record) -> bool:
    """Whether the law of ``axis`` can run on ``record``: with a reference, the axis's period and no excitation."""
    return (
        axis.controller.kind != NONE
        and record.has_reference
        and record.excitation is None
        and record.measured is None
        and same_period(record.period, axis.sampling.period)
        and law_of(axis, record.period, record.extra).follows != "rest position"
    )


def run_law(axis: Axis, record: Record) -> LawReplay:
    """Run the law of ``axis`` on the reference and the position of ``record``.

    A law with an integrator runs without its limit: the state of the integrator at first, and after each time at the
    limit, is then a constant, which is subtracted.
    """
    law, limit = law_of(axis, record.period, record.extra), float(axis.drive.command_limit)
    integrating = integrates(law, record.period)
    free = np.inf if integrating else limit
    comparable = _comparable(record)
    phase = 0
    if 1 < law.cycle <= PHASES:
        first = record.until(PHASE_LOOK)
        here = comparable[: len(first)]
        gaps = [np.abs(_centred((first.u - commands(law, first, free, at))[here])) for at in range(law.cycle)]
        phase = int(np.argmin([np.median(gap) if gap.size else 0.0 for gap in gaps]))
    wanted = commands(law, record, free, phase)
    above, below = ((side > AT_LIMIT) & (side < BEYOND_LIMIT) for side in (record.u / limit, -record.u / limit))
    if integrating:
        settling = max(AROUND, round(SETTLING / record.period))
        used = comparable & (np.convolve(above | below, np.ones(settling + 1))[: len(record)] < 0.5)
        wanted = wanted + levels(record.u - wanted, used)
    else:
        used = comparable & ~(above & (wanted > AT_LIMIT * limit) | below & (wanted < -AT_LIMIT * limit))
    return LawReplay(record, law, free, wanted, used)


def _centred(values: np.ndarray) -> np.ndarray:
    return values - np.median(values) if values.size else values


def commands(law: Law, record: Record, limit: float, phase: int = 0) -> np.ndarray:
    """The command (n,) of ``law`` along ``record``, whose first sample is the ``phase``-th of the law's cycle."""
    followed, q, sensed, gains = law.followed(record), record.q, record.f_ext, law.gains
    if phase:
        followed, q = (np.concatenate([np.full(phase, x[0]), x]) for x in (followed, q))
        sensed = None if sensed is None else np.concatenate([np.zeros(phase), sensed])
        gains = gains if np.ndim(gains) == 1 else np.concatenate([np.repeat(gains[:1], phase, axis=0), gains])
    command = replace(law, gains=gains).commands(followed, q, limit, sensed)[phase:]
    return np.clip(np.nan_to_num(command), -limit, limit)


def _comparable(record: Record) -> np.ndarray:
    """Samples (n,) bool to compare: after the start, with the motor switched on."""
    comparable = np.ones(len(record), bool)
    if record.enable is not None:
        comparable &= np.convolve(record.enable == 0.0, np.ones(2 * AROUND + 1), "same") < 0.5
    comparable[: min(max(FEWEST_AT_START, round(START_UP / record.period)), len(record) // 5)] = False
    return comparable


def integrates(law: Law, period: float) -> bool:
    """Whether ``law`` integrates a constant error."""
    n = int(np.clip(2.0 / period, 50, 8000))
    initial = replace(law, gains=law.gains[0] if np.ndim(law.gains) == 2 else law.gains)
    response = initial.commands(np.ones(2 * n), np.zeros(2 * n), np.inf)
    return bool(law.memory) and abs(response[-1]) > 1.001 * abs(response[n - 1])


def levels(gap: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The median (n,) of ``gap`` between one time at the limit and the next, where the integrator is unknown."""
    stretch = np.cumsum(np.diff(used.astype(int), prepend=0) == 1)
    level = np.zeros(gap.size)
    for number in np.unique(stretch[used]):
        own = stretch == number
        level[own] = np.median(gap[own & used])
    return level


def explain_gap(replay: LawReplay, unit: str) -> str:
    """Return the simplest explanation of the gap of ``replay`` in words; ``unit`` is that of the command.

    >>> from emps_design.importing.read import run_law
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> explain_gap(run_law(axis, replace(record, q=record.q_ref, q_ref=record.q)), "V")
    'q and q_ref are exchanged'
    """
    for words in _explanations(replay, unit):
        if words:
            return words
    used, gap = replay.used, replay.gap[replay.used]
    if np.median(np.abs(np.diff(gap))) < SMOOTH * np.sqrt(np.mean(gap**2)):
        most = f"{np.max(np.abs(gap)):.3g} {unit}".rstrip()
        return f"the command differs from the law by up to {most}, or it is from another controller or axis"
    if not np.corrcoef(replay.record.u[used], replay.wanted[used])[0, 1] > TOGETHER:
        return "the command does not follow this law anywhere: it is from another controller or axis"
    return "the record is damaged, or the command is from another controller (emps-design law identifies it)"


def _explanations(replay: LawReplay, unit: str) -> Iterator[str]:
    """Explanations that fit, simplest first, and "" for those that do not."""
    record, used, gap = replay.record, replay.used, replay.gap
    yield odd_increments(record)
    step, rms = quantisation_step(np.diff(record.u)), float(np.sqrt(np.mean(gap[used] ** 2)))
    if rms < HALF_A_STEP * step:
        yield f"the command is recorded in steps of {step:.4g} {unit}".rstrip()
    u, wanted = record.u[used], replay.wanted[used]
    gain = float(u @ wanted) / float(wanted @ wanted) if np.any(wanted) else 1.0
    if _remaining_share(replay, gain * replay.wanted) < EXPLAINS:
        yield f"the command is {gain:.3g} times that of the law"
    if replay.law.follows == "position" and record.q_ref_recorded:
        exchanged = replace(record, q=record.q_ref, q_ref=record.q)
        remaining = _remaining_share(replay, commands(replay.law, exchanged, replay.limit))
        yield "q and q_ref are exchanged" if remaining < EXPLAINS else ""
    yield _late(replay)
    yield _command_low_passed(replay)
    yield _few(replay, unit)
    yield _gain_changed(replay)
    for every in EVERY:
        least, *_, most = sorted(float(np.sum(gap[phase::every] ** 2)) for phase in range(every))
        if least < OTHERS * most:
            yield f"some of every {every} samples are from another signal"
    yield _position_low_passed(replay)


def _remaining_share(replay: LawReplay, command: np.ndarray, where: np.ndarray | None = None) -> float:
    """Power of the recorded command less ``command`` (n,), over that of the gap or of the command itself, if less."""
    here = replay.used if where is None else replay.used & where
    u = replay.record.u[here]
    own = min(float(np.sum(replay.gap[here] ** 2)), float(np.sum(u**2)))
    return float(np.sum((u - command[here]) ** 2)) / own if own else 1.0


def _few(replay: LawReplay, unit: str) -> str:
    """Explanation by a few outliers, "" where they hold less than most of the gap."""
    record, power = replay.record, replay.gap**2
    order = np.argsort(-power)[: max(1, int(FEW * replay.used.sum()))]
    share = np.cumsum(power[order]) / float(power.sum())
    if share[-1] < 1.0 - EXPLAINS:
        return ""
    count, k = 1 + int(np.searchsorted(share, 1.0 - EXPLAINS)), int(order[0])
    if count > 1:
        return f"{count} samples are far from the command of the law"
    value = f"{record.u[k]:.4g} {unit}".rstrip()
    return f"one sample, {value} at {record.t[k]:.4g} s, is far from the command of the law"


def _late(replay: LawReplay) -> str:
    """Explanation by a command of the law that is some samples late or early, "" where it does not fit."""
    used = replay.used
    u, wanted = (np.where(used, x - x[used].mean(), 0.0) for x in (replay.record.u, replay.wanted))
    late = max(range(-MOST_LATE, MOST_LATE + 1), key=lambda shift: float(u @ np.roll(wanted, shift)))
    if not late or _remaining_share(replay, np.roll(replay.wanted, late)) > EXPLAINS:
        return ""
    way, many = "later" if late > 0 else "earlier", "s" if abs(late) > 1 else ""
    return f"the command is recorded {abs(late)} sample{many} {way} than reference and position"


def _gain_changed(replay: LawReplay) -> str:
    """Explanation by another gain in a part of the record, "" where it does not fit."""
    record, used, wanted = replay.record, replay.used, replay.wanted
    edges = np.linspace(0, len(record), PIECES + 1).astype(int)
    gains, residual_power = np.ones(PIECES), np.zeros(PIECES)
    for i, (start, stop) in enumerate(pairwise(edges.tolist())):
        own = used[start:stop]
        u, w = record.u[start:stop][own], wanted[start:stop][own]
        gains[i] = float(u @ w) / float(w @ w) if np.any(w) else 1.0
        residual_power[i] = float(np.sum((u - gains[i] * w) ** 2))
    residual_power[int(np.argmax(residual_power))] = 0.0  # the piece in which the gain changes
    off = np.flatnonzero(np.abs(gains - 1.0) > SAME_GAIN)
    power = min(float(np.sum(replay.gap**2)), float(np.sum(record.u[used] ** 2)))
    if not off.size or off.size == PIECES or residual_power.sum() > EXPLAINS * power:
        return ""
    since = record.t[edges[off[0]]]
    return f"from about {since:.3g} s on the command is {np.median(gains[off]):.3g} times that of the law"


def _command_low_passed(replay: LawReplay) -> str:
    """Explanation by a first-order low-pass of the recorded command, "" where it does not fit."""
    remaining = {}
    for corner in CORNERS_HZ:
        keep = _pole(corner, replay.record.period)
        remaining[corner] = _remaining_share(replay, scipy.signal.lfilter([1.0 - keep], [1.0, -keep], replay.wanted))
    corner = min(remaining, key=lambda corner: remaining[corner])
    return f"the command is recorded behind a low-pass of about {corner:g} Hz" if remaining[corner] < EXPLAINS else ""


def _position_low_passed(replay: LawReplay) -> str:
    """Explanation by a first-order low-pass of the recorded position, "" where it does not fit."""
    short = replay.record.until(TRIED)
    inside, tried = np.arange(len(replay.record)) < len(short), np.zeros(len(replay.record))
    remaining = {}
    for corner in CORNERS_HZ:
        keep = _pole(corner, short.period)
        before, _ = scipy.signal.lfilter([1.0, -keep], [1.0 - keep], short.q, zi=[-keep / (1.0 - keep) * short.q[0]])
        tried[: len(short)] = commands(replay.law, replace(short, q=before), replay.limit)
        remaining[corner] = _remaining_share(replay, tried, inside)
    corner = min(remaining, key=lambda corner: remaining[corner])
    return f"the position is recorded behind a low-pass of about {corner:g} Hz" if remaining[corner] < EXPLAINS else ""


def _pole(corner: float, period: float) -> float:
    """Pole of a sampled first-order low-pass with a ``corner`` [Hz] at a ``period`` [s]."""
    return float(np.exp(-2.0 * np.pi * corner * period))


def check_controller(axis: Axis, record: Record) -> str | None:
    """Return in words how far, when and probably why the law of ``axis`` contradicts the command of ``record``.

    "" where it does not, None where the rounding of the record hides it. Requires
    :func:`~emps_design.importing.read.can_replay`.

    >>> from dataclasses import replace
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> check_controller(axis, record)
    ''
    >>> check_controller(axis, replace(record, u=2.0 * record.u)).split("; ")[-1]
    'the command is 2 times that of the law'
    """
    parts = [
        (start, replay) for start, part in _parts_of(record) if (replay := run_law(axis, part)).used.sum() > FEWEST
    ]
    verdicts = [_contradicts(axis, replay) for _, replay in parts]
    if not any(verdicts):
        return None if None in verdicts or not parts else ""
    deviating = [part for part, verdict in zip(parts, verdicts, strict=True) if verdict]
    start, replay = max(deviating, key=lambda part: float(np.mean(part[1].gap ** 2)))
    gap, swing, unit = replay.gap, replay.swing, axis.units.command_unit
    rms = float(np.sqrt(np.mean(gap[replay.used] ** 2)))
    first, last = _when(gap)
    when = f"from {(start + first) * record.period:.4g} to {(start + last) * record.period:.4g} s"
    return (
        f"u: the {axis.controller.kind} law of {axis.name} gives another command for this q_ref and q: "
        f"{rms:.3g} {unit} rms apart, {100 * rms / swing:.2g} % of the command, {when}; {explain_gap(replay, unit)}"
    )


def _parts_of(record: Record) -> list[tuple[int, Record]]:
    """``record``, or parts spread over a long one, each with the index of its first sample."""
    n, size = len(record), LOOK // PARTS
    if n <= LOOK:
        return [(0, record)]
    return [(start, record.part(start, start + size)) for start in np.linspace(0, n - size, PARTS).astype(int).tolist()]


def _contradicts(axis: Axis, replay: LawReplay) -> bool | None:
    """Whether the gap of ``replay`` exceeds noise, resolution and rounding; None where rounding hides it."""
    gap, swing = replay.gap, replay.swing
    if not swing > 0.0:
        return False
    noise = _noise(gap, replay.used)
    step = quantisation_step(np.diff(replay.record.u))
    sizes = _sizes(replay, gap, noise)
    if step > COARSE * swing and sizes[2] > OF_A_STEP * step:
        return True
    white = STRUCTURE * noise / np.sqrt(_width(replay.record))
    harmless = np.array((max(VISIBLE * swing, white), ALONE_VISIBLE * swing, LOUD * swing))
    if np.all(sizes <= harmless):
        return False
    rounded = _rounded(axis, replay)
    if rounded is None:
        return True
    means, _, whole = _sizes(replay, rounded, noise)
    if whole > LOUD * swing:
        return None
    return bool(np.any(sizes > np.maximum(harmless, ROUNDING * np.array((means, whole, whole)))))


def _sizes(replay: LawReplay, gap: np.ndarray, noise: float) -> np.ndarray:
    """Rms (3,) of the means of ``gap`` over a block, of its outliers, and of all its samples."""
    used, width = replay.used, _width(replay.record)
    rows = gap.size // width * width
    blocks, whole = gap[:rows].reshape(-1, width), used[:rows].reshape(-1, width).all(axis=1)
    means = blocks[whole].mean(axis=1)
    alone = np.where(np.abs(gap) > ALONE * noise, gap, 0.0)[used]
    return np.array((_rms(means), _rms(alone), _rms(gap[used])))


def _rounded(axis: Axis, replay: LawReplay) -> np.ndarray | None:
    """Effect of the rounding of reference and position on the law (n,); None at the encoder's own resolution."""
    record, law = replay.record, replay.law
    own = axis.sampling.encoder_resolution
    q_step = quantisation_step(np.diff(record.q))
    if own and q_step < COARSER * own:
        q_step = 0.0
    if np.array_equal(record.q, record.q.astype(np.float32)):
        q_step = max(q_step, _single(record.q))
    if not q_step:
        return None
    r_step = max(quantisation_step(np.diff(record.q_ref)), _single(record.q_ref))  # both were rounded alike
    random = np.random.default_rng(0)
    r, q = (step * random.uniform(-0.5, 0.5, len(record)) for step in (r_step, q_step))
    still = np.flatnonzero(np.diff(record.q, prepend=np.nan) == 0.0)
    for k in still:  # at rest the rounding error is constant, and an integrator adds it up
        q[k] = q[k - 1]
    moved = replace(record, q_ref=record.q_ref + r, q=record.q + q)
    change = commands(law, moved, replay.limit) - commands(law, record, replay.limit)
    level = levels(change, replay.used) if integrates(law, record.period) else 0.0
    return np.where(replay.used, change - level, 0.0)


def _single(values: np.ndarray) -> float:
    """The step of the largest of ``values`` in single precision."""
    return float(np.spacing(np.float32(np.max(np.abs(values)))))


def _width(record: Record) -> int:
    return max(FEWEST_IN_BLOCK, round(BLOCK_TIME / record.period))


def _noise(gap: np.ndarray, used: np.ndarray) -> float:
    """Deviation of white noise in ``gap``, from its first differences."""
    steps = np.diff(gap)[used[1:] & used[:-1]]
    return 1.4826 * float(np.median(np.abs(steps))) / np.sqrt(2.0) if steps.size else 0.0


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _when(gap: np.ndarray) -> tuple[int, int]:
    """First and last sample at which ``gap`` exceeds half of its rms."""
    most = np.flatnonzero(np.abs(gap) > 0.5 * _rms(gap[gap != 0.0]))
    return (int(most[0]), int(most[-1])) if most.size else (0, gap.size - 1)


def with_contradictions(axis: Axis, record: Record) -> Record:
    """Return ``record`` with its contradictions in ``contradictions`` and among its ``warnings``.

    Where the law of the controller can run on the record, the law decides alone; otherwise its motion does
    (:mod:`.motion`). A record with an excitation is not checked.
    """
    if record.excitation is not None:
        return record
    blocks = -(-len(record) // BLOCK)
    edges = [len(record) * i // blocks for i in range(blocks + 1)]
    messages: list[str] = []
    for start, stop in pairwise(edges):
        part = record if blocks == 1 else record.part(start, stop, record.name)
        message = check_controller(axis, part) if can_replay(axis, part) else None
        if message is None:
            messages = check_motion(axis, part)
        else:
            messages = [text for text in (message or odd_increments(part),) if text]
        if messages:
            break
    if not messages:
        return record
    if blocks > 1:  # times of a part begin with it
        messages = [f"in the part from {record.t[start]:.6g} s on, {text}" for text in messages]
    contradictions = tuple(wrong("contradiction", f"{text}; {MEANS}") for text in messages)
    return replace(record, warnings=(*record.warnings, *contradictions), contradictions=contradictions)


@typed
def import_record(
    path: str | Path, axis: Axis, resample: bool = True, window: tuple[float, float] | None = None
) -> Record:
    """Read the record at ``path`` by the ``[record]`` table of ``axis``, in SI units and the command unit of the axis.

    Without a table, columns are recognised by their names or titles. Irregular time is resampled to the period of the
    axis, or refused without ``resample``. The ``warnings`` of the record say what was changed,
    ``assigned`` which column is which. ``window`` [s] reads a part of the file's time. Raises :class:`RecordError`, a
    message of one line, where a column is uncertain or the numbers cannot be of this axis.
    """
    layout = replace(layout_of(axis), resample=resample, window=window)
    max_bytes = MAX_BYTES if window is None else MAX_BYTES_TO_CUT
    return with_contradictions(axis, check_against(axis, read_record(path, max_bytes, layout), str(path)))


def import_bytes(content: bytes, name: str, axis: Axis) -> Record:
    """Read the ``content`` of a file called ``name`` as :func:`import_record` does.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019").replace(record={"position": {"column": "Lageistwert", "unit": "mm"}})
    >>> rows = "\\n".join(f"{k / 1000:.3f};{k};{k / 1000:.3f};1,{k:02d}".replace(".", ",") for k in range(60))
    >>> record = import_bytes(f"t;Lageistwert [mm];q_ref;u\\n{rows}".encode(), "trace.csv", axis)
    >>> round(float(record.q[-1]), 6), record.assigned[2].title
    (0.059, 'Lageistwert [mm]')
    """
    read = record_from_bytes(content, name, layout=layout_of(axis))
    return with_contradictions(axis, check_against(axis, read, name))


def layout_of(axis: Axis) -> Layout:
    """The layout of a record of ``axis``."""
    return Layout(
        units=axis.units,
        columns=axis.record,
        period=axis.sampling.period,
        reference_needed=axis.controller.kind != NONE,
        limit=float(axis.drive.command_limit),
    )
