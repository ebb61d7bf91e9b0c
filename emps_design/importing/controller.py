"""Whether the controller of an axis file made a record: its law gives the recorded command, or it does not.

The law is a difference equation of signals that the record has, so it gives the recorded command up to the noise and
the resolution of that command. Where it does not, samples were lost, filtered, exchanged or taken from elsewhere, the
controller did something beside its law, or it is another one. No plant takes part, so friction and elasticity cannot be
mistaken for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.importing.increments import step_of
from emps_design.importing.likeness import likeness
from emps_design.importing.replay import Replay, commands, integrates, levels, run_law
from emps_design.records import Record

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


def check_controller(axis: Axis, record: Record) -> str | None:
    """Say where the law of ``axis`` gives another command than ``record`` has: how much, when, and what it looks like.

    "" where it gives the same, None where the rounding of the record hides what it gives. Only for a law that
    :func:`~emps_design.importing.replay.can_replay` takes.

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


def _contradicts(axis: Axis, replay: Replay) -> bool | None:
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


def _sizes(replay: Replay, gap: np.ndarray, noise: float) -> np.ndarray:
    """Rms of the means of ``gap`` over a block, of the samples far outside the noise, and of all (3,)."""
    used, width = replay.used, _width(replay.record)
    rows = gap.size // width * width
    blocks, whole = gap[:rows].reshape(-1, width), used[:rows].reshape(-1, width).all(axis=1)
    means = blocks[whole].mean(axis=1)
    alone = np.where(np.abs(gap) > ALONE * noise, gap, 0.0)[used]
    return np.array((_rms(means), _rms(alone), _rms(gap[used])))


def _rounded(axis: Axis, replay: Replay) -> np.ndarray | None:
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
