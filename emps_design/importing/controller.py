"""Whether the controller of an axis file made a record: its law gives the recorded command, or it does not.

The law is a difference equation of signals that the record has, so it gives the recorded command up to the noise and
the resolution of that command. Where it does not, samples were lost, filtered, exchanged or taken from elsewhere, the
controller did something beside its law, or it is another one. No plant takes part, so friction and elasticity cannot be
mistaken for it.

The law of an axis file, run on the recorded reference and position: what its controller would have commanded.

What the law cannot know does not count: how it stood before the first sample (its integrator, the sample at which a
slower loop runs), samples that both have at the limit, samples with the motor switched off.

What a gap between the command of a law and the recorded one looks like: the simplest change that makes it small.

Every change that a logger or a person makes to a record is tried on the command of the law, or the law is run on the
record with that change taken back. The first that leaves little of the gap is named. Nothing is mended.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from emps_design.axis import Axis
from emps_design.importing.motion import odd_increments, step_of
from emps_design.laws import NONE, Law, law_of
from emps_design.records import Record
from emps_design.records.clock import same_period

START_UP = 0.1  # s, after which what the law remembered before the first sample is forgotten
FEWEST_AT_START = 8  # samples
AT_LIMIT, BEYOND_LIMIT = 0.98, 1.02  # of the limit, between which a sample is at it
SETTLING = 0.015  # s behind the limit, until filters have forgotten where the integrator had been
AROUND = 3  # samples beside one with the motor switched off
PHASES, PHASE_LOOK = 16, 6000  # of a slower loop against the first sample, found on so many samples

EXPLAINS = 0.15  # of the power of the gap, and of the command, that may be left
FEW = 0.05  # of the samples: a gap that so few hold is theirs alone
HALF_A_STEP = 0.5  # that rounding leaves at most
MOST_LATE = 64  # samples
CORNERS_HZ = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0)
TRIED = 20_000  # samples on which the law is run again
PIECES, SAME_GAIN = 16, 0.02  # of a record, in which the gain may differ; by which it has to
EVERY = range(2, 9)  # samples, of which one in so many may be another's
OTHERS = 0.01  # of the gap's power in such samples, that the others may have
SMOOTH = 0.02  # of the gap, that it changes by from sample to sample: no noise
TOGETHER = 0.5  # correlation of the command with that of the law, from which on it is not of elsewhere

LOOK, PARTS = 100_000, 5  # samples of a long record that are looked at, in so many parts
FEWEST = 100  # samples that count
BLOCK_TIME, FEWEST_IN_BLOCK = 0.02, 4  # s, and samples
STRUCTURE = 2.0  # times what white noise does to the means over a block
ROUNDING = 6.0  # times what the rounding of the record does
VISIBLE = 0.01  # of the command's deviation, below which a gap harms no estimate
ALONE = 12.0  # deviations of the noise, beyond which a sample is none of it
ALONE_VISIBLE = 0.02  # of the command's deviation, rms over the record
COARSE, OF_A_STEP = 0.1, 0.2  # of the command's deviation: steps that hide what the law gives; rms that they leave
LOUD = 0.2  # of the command's deviation
COARSER = 1.25  # times the encoder's step: a position that was rounded once more


@dataclass(frozen=True)
class LawReplay:
    """What the ``law`` gives, ``wanted`` (n,), for a ``record``, and the samples ``used`` (n,) bool that can tell."""

    record: Record
    law: Law
    limit: float
    wanted: np.ndarray
    used: np.ndarray

    @property
    def gap(self) -> np.ndarray:
        """The recorded command less that of the law (n,), 0 where it does not count."""
        return np.where(self.used, self.record.u - self.wanted, 0.0)

    @property
    def swing(self) -> float:
        """Deviation of the recorded command where it counts."""
        return float(np.std(self.record.u[self.used])) if self.used.any() else 0.0


def can_replay(axis: Axis, record: Record) -> bool:
    """Whether the law of ``axis`` can be run on ``record``: a reference, the axis's own clock, nothing added to it."""
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

    One with an integrator runs without its limit: where that stood at first and behind each time at the limit is then a
    constant, which is taken out.
    """
    law, limit = law_of(axis, record.period, record.extra), float(axis.drive.command_limit)
    integrating = integrates(law, record.period)
    free = np.inf if integrating else limit
    tells = _tells(record)
    phase = 0
    if 1 < law.cycle <= PHASES:
        first = record.until(PHASE_LOOK)
        here = tells[: len(first)]
        gaps = [np.abs(_centred((first.u - commands(law, first, free, at))[here])) for at in range(law.cycle)]
        phase = int(np.argmin([np.median(gap) if gap.size else 0.0 for gap in gaps]))
    wanted = commands(law, record, free, phase)
    above, below = ((side > AT_LIMIT) & (side < BEYOND_LIMIT) for side in (record.u / limit, -record.u / limit))
    if integrating:
        settling = max(AROUND, round(SETTLING / record.period))
        used = tells & (np.convolve(above | below, np.ones(settling + 1))[: len(record)] < 0.5)
        wanted = wanted + levels(record.u - wanted, used)
    else:
        used = tells & ~(above & (wanted > AT_LIMIT * limit) | below & (wanted < -AT_LIMIT * limit))
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
    given = replace(law, gains=gains).commands(followed, q, limit, sensed)[phase:]
    return np.clip(np.nan_to_num(given), -limit, limit)


def _tells(record: Record) -> np.ndarray:
    """Samples (n,) bool that tell what the law gave: after the start, with the motor switched on."""
    tells = np.ones(len(record), bool)
    if record.enable is not None:
        tells &= np.convolve(record.enable == 0.0, np.ones(2 * AROUND + 1), "same") < 0.5
    tells[: min(max(FEWEST_AT_START, round(START_UP / record.period)), len(record) // 5)] = False
    return tells


def integrates(law: Law, period: float) -> bool:
    """Whether ``law`` keeps adding up an error that stays."""
    n = int(np.clip(2.0 / period, 50, 8000))
    one = replace(law, gains=law.gains[0] if np.ndim(law.gains) == 2 else law.gains)
    answer = one.commands(np.ones(2 * n), np.zeros(2 * n), np.inf)
    return bool(law.memory) and abs(answer[-1]) > 1.001 * abs(answer[n - 1])


def levels(gap: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The median (n,) of ``gap`` between one time at the limit and the next: where an integrator stood is not known."""
    stretch = np.cumsum(np.diff(used.astype(int), prepend=0) == 1)
    level = np.zeros(gap.size)
    for number in np.unique(stretch[used]):
        own = stretch == number
        level[own] = np.median(gap[own & used])
    return level


def likeness(replay: LawReplay, unit: str) -> str:
    """Say what the gap of ``replay`` looks like; ``unit`` is that of the command.

    >>> from emps_design.importing.controller import run_law
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> likeness(run_law(axis, replace(record, q=record.q_ref, q_ref=record.q)), "V")
    'q and q_ref are exchanged'
    """
    for words in _looks(replay, unit):
        if words:
            return words
    used, gap = replay.used, replay.gap[replay.used]
    if np.median(np.abs(np.diff(gap))) < SMOOTH * np.sqrt(np.mean(gap**2)):
        most = f"{np.max(np.abs(gap)):.3g} {unit}".rstrip()
        return f"up to {most} is added to what the law gives, or the command is another controller's or another axis's"
    if not np.corrcoef(replay.record.u[used], replay.wanted[used])[0, 1] > TOGETHER:
        return "the command follows this law nowhere: it is another controller's or another axis's"
    return "the record is damaged, or the command is another controller's (emps-design law says whose)"


def _looks(replay: LawReplay, unit: str) -> Iterator[str]:
    """What is found, simplest first; "" for what is not."""
    record, used, gap = replay.record, replay.used, replay.gap
    yield odd_increments(record)
    step, left = step_of(record.u), float(np.sqrt(np.mean(gap[used] ** 2)))
    if left < HALF_A_STEP * step:
        yield f"the command is recorded in steps of {step:.4g} {unit}".rstrip()
    u, wanted = record.u[used], replay.wanted[used]
    gain = float(u @ wanted) / float(wanted @ wanted) if np.any(wanted) else 1.0
    if _left(replay, gain * replay.wanted) < EXPLAINS:
        yield f"the command is {gain:.3g} times what the law gives"
    if replay.law.follows == "position" and record.q_ref_recorded:
        exchanged = replace(record, q=record.q_ref, q_ref=record.q)
        left_by = _left(replay, commands(replay.law, exchanged, replay.limit))
        yield "q and q_ref are exchanged" if left_by < EXPLAINS else ""
    yield _late(replay)
    yield _command_low_passed(replay)
    yield _few(replay, unit)
    yield _gain_from(replay)
    for every in EVERY:
        least, *_, most = sorted(float(np.sum(gap[phase::every] ** 2)) for phase in range(every))
        if least < OTHERS * most:
            yield f"it is another signal's in some of every {every} samples"
    yield _position_low_passed(replay)


def _left(replay: LawReplay, command: np.ndarray, where: np.ndarray | None = None) -> float:
    """What ``command`` (n,) leaves of the recorded one, as a share of what that of the law leaves, or of all of it."""
    here = replay.used if where is None else replay.used & where
    u = replay.record.u[here]
    own = min(float(np.sum(replay.gap[here] ** 2)), float(np.sum(u**2)))
    return float(np.sum((u - command[here]) ** 2)) / own if own else 1.0


def _few(replay: LawReplay, unit: str) -> str:
    """Whether a few samples hold the gap."""
    record, power = replay.record, replay.gap**2
    order = np.argsort(-power)[: max(1, int(FEW * replay.used.sum()))]
    share = np.cumsum(power[order]) / float(power.sum())
    if share[-1] < 1.0 - EXPLAINS:
        return ""
    count, k = 1 + int(np.searchsorted(share, 1.0 - EXPLAINS)), int(order[0])
    if count > 1:
        return f"{count} samples are far from what the law gives"
    value = f"{record.u[k]:.4g} {unit}".rstrip()
    return f"one sample, {value} at {record.t[k]:.4g} s, is far from what the law gives"


def _late(replay: LawReplay) -> str:
    """Whether the recorded command is that of the law some samples later, or earlier."""
    used = replay.used
    u, wanted = (np.where(used, x - x[used].mean(), 0.0) for x in (replay.record.u, replay.wanted))
    late = max(range(-MOST_LATE, MOST_LATE + 1), key=lambda shift: float(u @ np.roll(wanted, shift)))
    if not late or _left(replay, np.roll(replay.wanted, late)) > EXPLAINS:
        return ""
    way, many = "later" if late > 0 else "earlier", "s" if abs(late) > 1 else ""
    return f"the command is recorded {abs(late)} sample{many} {way} than reference and position"


def _gain_from(replay: LawReplay) -> str:
    """Whether the command is a multiple of that of the law in a part of the record."""
    record, used, wanted = replay.record, replay.used, replay.wanted
    edges = np.linspace(0, len(record), PIECES + 1).astype(int)
    gains, left = np.ones(PIECES), np.zeros(PIECES)
    for i, (start, stop) in enumerate(pairwise(edges.tolist())):
        own = used[start:stop]
        u, w = record.u[start:stop][own], wanted[start:stop][own]
        gains[i] = float(u @ w) / float(w @ w) if np.any(w) else 1.0
        left[i] = float(np.sum((u - gains[i] * w) ** 2))
    left[int(np.argmax(left))] = 0.0  # the piece in which the gain changes
    off = np.flatnonzero(np.abs(gains - 1.0) > SAME_GAIN)
    power = min(float(np.sum(replay.gap**2)), float(np.sum(record.u[used] ** 2)))
    if not off.size or off.size == PIECES or left.sum() > EXPLAINS * power:
        return ""
    since = record.t[edges[off[0]]]
    return f"from about {since:.3g} s on the command is {np.median(gains[off]):.3g} times what the law gives"


def _command_low_passed(replay: LawReplay) -> str:
    """Whether the command is recorded behind a low-pass of first order."""
    from scipy.signal import lfilter

    left = {}
    for corner in CORNERS_HZ:
        keep = _kept(corner, replay.record.period)
        left[corner] = _left(replay, lfilter([1.0 - keep], [1.0, -keep], replay.wanted))
    corner = min(left, key=lambda one: left[one])
    return f"the command is recorded behind a low-pass of about {corner:g} Hz" if left[corner] < EXPLAINS else ""


def _position_low_passed(replay: LawReplay) -> str:
    """Whether the position is recorded behind a low-pass of first order."""
    from scipy.signal import lfilter

    short = replay.record.until(TRIED)
    inside, tried = np.arange(len(replay.record)) < len(short), np.zeros(len(replay.record))
    left = {}
    for corner in CORNERS_HZ:
        keep = _kept(corner, short.period)
        before, _ = lfilter([1.0, -keep], [1.0 - keep], short.q, zi=[-keep / (1.0 - keep) * short.q[0]])
        tried[: len(short)] = commands(replay.law, replace(short, q=before), replay.limit)
        left[corner] = _left(replay, tried, inside)
    corner = min(left, key=lambda one: left[one])
    return f"the position is recorded behind a low-pass of about {corner:g} Hz" if left[corner] < EXPLAINS else ""


def _kept(corner: float, period: float) -> float:
    """What a low-pass with a ``corner`` [Hz] keeps over a ``period`` [s]."""
    return float(np.exp(-2.0 * np.pi * corner * period))


def check_controller(axis: Axis, record: Record) -> str | None:
    """Say where the law of ``axis`` gives another command than ``record`` has: how much, when, and what it looks like.

    "" where it gives the same, None where the rounding of the record hides what it gives. Only for a law that
    :func:`~emps_design.importing.controller.can_replay` takes.

    >>> from dataclasses import replace
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> check_controller(axis, record)
    ''
    >>> check_controller(axis, replace(record, u=2.0 * record.u)).split("; ")[-1]
    'the command is 2 times what the law gives'
    """
    parts = [
        (start, replay) for start, part in _parts_of(record) if (replay := run_law(axis, part)).used.sum() > FEWEST
    ]
    verdicts = [_contradicts(axis, replay) for _, replay in parts]
    if not any(verdicts):
        return None if None in verdicts or not parts else ""
    found = [part for part, verdict in zip(parts, verdicts, strict=True) if verdict]
    start, replay = max(found, key=lambda part: float(np.mean(part[1].gap ** 2)))
    gap, swing, unit = replay.gap, replay.swing, axis.units.command_unit
    rms = float(np.sqrt(np.mean(gap[replay.used] ** 2)))
    first, last = _when(gap)
    when = f"from {(start + first) * record.period:.4g} to {(start + last) * record.period:.4g} s"
    return (
        f"u: the {axis.controller.kind} law of {axis.name} gives another command for this q_ref and q: "
        f"{rms:.3g} {unit} rms apart, {100 * rms / swing:.2g} % of the command, {when}; {likeness(replay, unit)}"
    )


def _parts_of(record: Record) -> list[tuple[int, Record]]:
    """``record``, or parts all over a long one, each with the place of its first sample."""
    n, size = len(record), LOOK // PARTS
    if n <= LOOK:
        return [(0, record)]
    return [(start, record.part(start, start + size)) for start in np.linspace(0, n - size, PARTS).astype(int).tolist()]


def _contradicts(axis: Axis, replay: LawReplay) -> bool | None:
    """Whether the gap of ``replay`` is more than noise, resolution and rounding allow; None where rounding hides it."""
    gap, swing = replay.gap, replay.swing
    if not swing > 0.0:
        return False
    noise = _noise(gap, replay.used)
    step = step_of(replay.record.u)
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
    """Rms of the means of ``gap`` over a block, of the samples far outside the noise, and of all (3,)."""
    used, width = replay.used, _width(replay.record)
    rows = gap.size // width * width
    blocks, whole = gap[:rows].reshape(-1, width), used[:rows].reshape(-1, width).all(axis=1)
    means = blocks[whole].mean(axis=1)
    alone = np.where(np.abs(gap) > ALONE * noise, gap, 0.0)[used]
    return np.array((_rms(means), _rms(alone), _rms(gap[used])))


def _rounded(axis: Axis, replay: LawReplay) -> np.ndarray | None:
    """What the rounding of the recorded signals does to the law (n,); None where they have the encoder's own steps."""
    record, law = replay.record, replay.law
    own = axis.sampling.encoder_resolution
    q_step = step_of(record.q)
    if own and q_step < COARSER * own:
        q_step = 0.0
    if np.array_equal(record.q, record.q.astype(np.float32)):
        q_step = max(q_step, _single(record.q))
    if not q_step:
        return None
    r_step = max(step_of(record.q_ref), _single(record.q_ref))  # whatever rounded one rounded the other
    random = np.random.default_rng(0)
    r, q = (step * random.uniform(-0.5, 0.5, len(record)) for step in (r_step, q_step))
    still = np.flatnonzero(np.diff(record.q, prepend=np.nan) == 0.0)
    for k in still:  # at rest the rounding stays, and an integrator adds it up
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
    """First and last sample of what is most of the ``gap``."""
    most = np.flatnonzero(np.abs(gap) > 0.5 * _rms(gap[gap != 0.0]))
    return (int(most[0]), int(most[-1])) if most.size else (0, gap.size - 1)
