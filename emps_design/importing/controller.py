"""Whether the controller of an axis file made a record: its law, run on the recorded reference and position.

The law is a difference equation of signals that the record has, so it gives the recorded command up to the noise and the
resolution of that command. Where it does not, samples were lost, filtered, exchanged or taken from elsewhere, the
controller did something beside its law, or it is another one. No plant takes part, so friction and elasticity cannot be
mistaken for it.

What the law cannot know does not count: how it stood before the first sample (its integrator, the sample at which a
slower loop runs), samples that both have at the limit, samples with the motor switched off, and what the rounding of
the recorded position does to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.axis import Axis
from emps_design.importing.account import encoder_step
from emps_design.importing.likeness import likeness
from emps_design.importing.motion import MEANS
from emps_design.importing.increments import step_of
from emps_design.laws import NONE, Law, law_of
from emps_design.records import Record

LOOK, PARTS = 100_000, 5  # samples of a long record that are looked at, in so many parts
START_UP = 0.1  # s, after which what the law remembered before the first sample is forgotten
FEWEST_AT_START, FEWEST = 8, 100  # samples
BLOCK_TIME = 0.02  # s
AT_LIMIT, BEYOND_LIMIT = 0.98, 1.02  # of the limit, between which a sample is at it
EITHER, SELDOM = 2.0, 0.02  # times the samples at the recorded limit, and share of all, that the law may be at its own
AROUND = 3  # samples beside one with the motor switched off
SAME_PERIOD = 1e-3  # of the axis's period
PHASES, PHASE_LOOK = 16, 6000  # of a slower loop against the first sample, told by so many samples
STRUCTURE = 2.0  # times what white noise does to the means over a block
ROUNDING = 3.0  # times what the rounding of the record does
VISIBLE = 0.01  # of the command's deviation, below which a gap harms no estimate
ALONE = 12.0  # deviations of the noise, beyond which a sample is none of it
ALONE_VISIBLE = 0.02  # of the command's deviation, rms over the record
COARSE = 0.1  # of the command's deviation: steps that hide what the law gives
LOUD = 0.2  # of the command's deviation


@dataclass(frozen=True)
class Replay:
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


def check_controller(axis: Axis, record: Record) -> str:
    """One line where the law of ``axis`` gives another command than ``record`` has: how much, when, and what it is like.

    "" where it gives the same, or where the law cannot be run on the record (see :func:`can_replay`).

    >>> from dataclasses import replace
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> check_controller(axis, record)
    ''
    >>> check_controller(axis, replace(record, u=2.0 * record.u)).split("; ")[-2]
    'the command is 2 times what the law gives'
    """
    parts = [(start, replay) for start, part in parts_of(record) if FEWEST < (replay := run_law(axis, part)).used.sum()]
    found = [(float(np.mean(replay.gap**2)), start, replay) for start, replay in parts if _contradicts(axis, replay)]
    if not found:
        return ""
    _, start, replay = max(found, key=lambda one: one[0])
    gap, swing, unit = replay.gap, _swing(replay), axis.units.command_unit
    rms = float(np.sqrt(np.mean(gap[replay.used] ** 2)))
    first, last = _when(gap, swing)
    when = f"from {(start + first) * record.period:.4g} to {(start + last) * record.period:.4g} s"
    return (
        f"u: the {axis.controller.kind} law of {axis.name} gives another command for this q_ref and q: "
        f"{rms:.3g} {unit} rms apart, {100 * rms / swing:.2g} % of the command, {when}; {likeness(replay, unit)}; "
        f"{MEANS}: record again, or correct the columns or the controller"
    )


def can_replay(axis: Axis, record: Record) -> bool:
    """Whether the law of ``axis`` can be run on ``record``: a reference, the axis's own clock, nothing added to it."""
    return (
        axis.controller.kind != NONE
        and record.has_reference
        and record.excitation is None
        and record.measured is None
        and abs(record.period / axis.sampling.period - 1.0) < SAME_PERIOD
        and law_of(axis, record.period, record.extra).follows != "rest position"
    )


def parts_of(record: Record) -> list[tuple[int, Record]]:
    """``record``, or parts all over a long one, each with the place of its first sample."""
    n, size = len(record), LOOK // PARTS
    if n <= LOOK:
        return [(0, record)]
    return [(start, record.part(start, start + size)) for start in np.linspace(0, n - size, PARTS).astype(int).tolist()]


def run_law(axis: Axis, record: Record) -> Replay:
    """Run the law of ``axis`` on the reference and the position of ``record``."""
    law, limit = law_of(axis, record.period, record.extra), float(axis.drive.command_limit)
    tells = _tells(record)
    phase = 0
    if 1 < law.cycle <= PHASES:
        first = record.until(PHASE_LOOK)
        here = tells[: len(first)]
        gaps = [np.abs(first.u - commands(law, first, limit, at))[here] for at in range(law.cycle)]
        phase = int(np.argmin([np.median(gap) if gap.size else 0.0 for gap in gaps]))
    wanted = commands(law, record, limit, phase)
    given = np.array([record.u, wanted])
    above, below = (
        (sign * given > AT_LIMIT * limit) & (np.abs(given) < BEYOND_LIMIT * limit) for sign in (1.0, -1.0)
    )
    used = tells & ~(above.all(axis=0) | below.all(axis=0))
    if _integrates(law, record.period):
        # A limit is met a little earlier or later where the integrator stands elsewhere.
        either = (above | below).any(axis=0)
        if np.mean(either) <= max(EITHER * np.mean((above | below)[0]), SELDOM):
            used &= ~either
        wanted = wanted + _levels(record.u - wanted, used)
    return Replay(record, law, limit, wanted, used)


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


def _integrates(law: Law, period: float) -> bool:
    """Whether ``law`` keeps adding up an error that stays."""
    n = int(np.clip(2.0 / period, 50, 8000))
    one = replace(law, gains=law.gains[0] if np.ndim(law.gains) == 2 else law.gains)
    answer = one.commands(np.ones(2 * n), np.zeros(2 * n), np.inf)
    return bool(law.memory) and abs(answer[-1]) > 1.001 * abs(answer[n - 1])


def _levels(gap: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The median (n,) of ``gap`` between one time at the limit and the next: where an integrator stood is not known."""
    stretch = np.cumsum(np.diff(used.astype(int), prepend=0) == 1)
    level = np.zeros(gap.size)
    for number in np.unique(stretch[used]):
        own = stretch == number
        level[own] = np.median(gap[own & used])
    return level


def _contradicts(axis: Axis, replay: Replay) -> bool:
    """Whether the gap of ``replay`` is more than noise, resolution and rounding of the record allow."""
    gap, swing = replay.gap, _swing(replay)
    if not swing > 0.0:
        return False
    noise = _noise(gap, replay.used)
    means, alone, whole = _sizes(replay, gap, noise)
    width = _width(replay.record)
    step = step_of(replay.record.u)
    if step > COARSE * swing and whole > 0.2 * step:
        return True
    if not (
        means > max(VISIBLE * swing, STRUCTURE * noise / np.sqrt(width))
        or alone > ALONE_VISIBLE * swing
        or whole > LOUD * swing
    ):
        return False
    rounded = _rounded(axis, replay)
    if rounded is None:
        return True
    allowed = _sizes(replay, rounded, noise)
    return (
        means > max(VISIBLE * swing, STRUCTURE * noise / np.sqrt(width), ROUNDING * allowed[0])
        or alone > max(ALONE_VISIBLE * swing, ROUNDING * allowed[2])
        or whole > max(LOUD * swing, ROUNDING * allowed[2])
    )


def _sizes(replay: Replay, gap: np.ndarray, noise: float) -> tuple[float, float, float]:
    """Rms of the means of ``gap`` over a block, of the samples far outside the noise, and of all."""
    used, width = replay.used, _width(replay.record)
    rows = gap.size // width * width
    blocks, whole = gap[:rows].reshape(-1, width), used[:rows].reshape(-1, width).all(axis=1)
    means = blocks[whole].mean(axis=1)
    alone = np.where(np.abs(gap) > ALONE * noise, gap, 0.0)[used]
    return _rms(means), _rms(alone), _rms(gap[used])


def _rounded(axis: Axis, replay: Replay) -> np.ndarray | None:
    """What the rounding of the recorded signals does to the law (n,); None where they have the encoder's own steps."""
    record, law = replay.record, replay.law
    own = axis.sampling.encoder_resolution
    q_step = encoder_step(record.q) or 0.0
    if own and q_step < 1.25 * own:
        q_step = 0.0
    followed = law.followed(record)
    r_step = step_of(followed)
    if not (q_step or r_step) or law.follows == "velocity" and not q_step:
        return None
    random = np.random.default_rng(0)
    r, q = (step * random.uniform(-0.5, 0.5, len(record)) for step in (r_step, q_step))
    still = np.flatnonzero(np.diff(record.q, prepend=np.nan) == 0.0)
    for k in still:  # at rest the rounding stays, and an integrator adds it up
        q[k] = q[k - 1]
    moved = replace(record, q_ref=record.q_ref + r, q=record.q + q)
    change = commands(law, moved, replay.limit) - commands(law, record, replay.limit)
    level = _levels(change, replay.used) if _integrates(law, record.period) else 0.0
    return np.where(replay.used, change - level, 0.0)


def _swing(replay: Replay) -> float:
    return float(np.std(replay.record.u[replay.used]))


def _width(record: Record) -> int:
    return max(4, round(BLOCK_TIME / record.period))


def _noise(gap: np.ndarray, used: np.ndarray) -> float:
    """Deviation of white noise in ``gap``, from its first differences."""
    steps = np.diff(gap)[used[1:] & used[:-1]]
    return 1.4826 * float(np.median(np.abs(steps))) / np.sqrt(2.0) if steps.size else 0.0


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _when(gap: np.ndarray, swing: float) -> tuple[int, int]:
    """First and last sample of what is most of the ``gap``."""
    beyond = np.flatnonzero(np.abs(gap) > 0.5 * np.sqrt(np.mean(gap[gap != 0.0] ** 2)))
    return (int(beyond[0]), int(beyond[-1])) if beyond.size else (0, gap.size)
