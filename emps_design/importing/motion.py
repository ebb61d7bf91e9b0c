"""Whether the signals of a record belong together, without a law: what no drive and no axis does.

Less can be told than with the law: only what stands out of anything that friction, elasticity and a controller do.
The inverse model, acceleration, velocity, direction and a constant, stands for the axis; it need not fit well, but its
gain must not change half-way, and it must fit best at the samples at which the record says.

Increments of a position that no motion has: rows written twice, a value that is held, samples that are missing.

A position is two integrals of a force, so from one sample to the next its increment changes little. One that is 0 in
full motion, or twice those beside it, was made by what wrote the record.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.importing.account import encoder_step
from emps_design.importing.sanity import correlation, motion_columns, unexplained
from emps_design.records import Record

BESIDE = 4  # increments on either side that say what is usual
WIDE = 16  # samples on either side over which an axis moves, whatever was held meanwhile
FEWEST_STEPS = 6.0  # of the encoder in an increment, for one that is 0 or twice as large to say something
FULL = 0.9  # of the mean increment: next to one that is 0, the motion is full
TWICE = (1.6, 4.5)  # times those beside it
STEADY = 0.25  # of the usual increment, within which those beside it are alike
ROUGH, QUIET = 8.0, 0.4  # times what this share of the increments changes less by
FEWEST, SOME = 5, 2e-3  # samples, and of all samples, that stand still or are missing

LONGEST = 200_000  # samples of a long record that are looked at
SPIKE = 8.0  # times the command that all but one sample in a thousand stay below
ANSWERED = 0.3  # of a spike, that the motion asks for
UNCHANGED, LIKELY = 0.04, 4.0  # of the samples in motion; times as often as it changes by one step
COARSE = 0.2  # of the command's deviation
ALTERNATES = 0.3  # of the command's deviation
BLOCK = 32  # samples over which what alternates is averaged
FITS = 0.35  # of the command, that the inverse model may leave where it is to say something
BLOCKS = 12
EXPLAINED = 0.5  # of what one model of the whole record leaves, that a model for either part of it leaves
BRAKES = 0.1  # of the power that speeds up and slows down, that either has where both are seen
GAIN, SAME = 1.35, 1.5  # times, by which the command changes at once; within which mass and friction change alike
SHIFTS = 0.08, 40  # s to either side, and in so many steps, by which the command is moved
LATE, FEWEST_LATE = 0.015, 8  # s, and samples
BETTER, WELL, LITTLE = (
    0.6,
    0.5,
    0.1,
)  # of what is left where nothing is moved; of the command, that is left then and now
EXCHANGED, ALIKE = 0.7, 0.99  # of what the position leaves; correlation of position and reference
COARSER = 1.25  # times the encoder's step: a position that was rounded by the logger
SHORT = 16  # samples, up to which a command is held; longer, somebody commands a constant
LEVELS, NEXT = 5, 0.8  # levels that a signal in steps has, and share of its changes that go to the next one


def step_of(values: np.ndarray) -> float:
    """The step that ``values`` (n,) move in, 0 where there is none."""
    return encoder_step(values) or 0.0


def held(q: np.ndarray) -> np.ndarray:
    """Samples (n,) bool at which the position ``q`` (n,) stands still although the axis runs.

    >>> q = np.arange(200.0) ** 2
    >>> q[100] = q[99]
    >>> np.flatnonzero(held(q)).tolist()
    [100]
    """
    d = np.diff(q)
    # Runs of increments of 0, and the increments before and behind each.
    ends = np.flatnonzero(np.diff(d == 0.0, prepend=False, append=False))
    first, behind = ends[::2], ends[1::2]
    inner = (first > 0) & (behind < d.size) & (behind - first <= WIDE)
    first, behind = first[inner], behind[inner]
    mean = _mean(q)[(first + behind - 1) // 2]
    beside = np.minimum(d[first - 1] * np.sign(mean), d[behind] * np.sign(mean))
    size = np.abs(mean)
    odd = (size > FEWEST_STEPS * _smallest(d)) & (beside > FULL * size)
    change = np.zeros(q.size + 1)
    np.add.at(change, first[odd] + 1, 1.0)
    np.add.at(change, behind[odd] + 1, -1.0)
    return np.cumsum(change)[:-1] > 0.5


def lost(q: np.ndarray) -> np.ndarray:
    """Samples (n,) bool before which some are missing: the increment is a multiple of those beside it.

    >>> q = np.delete(np.arange(200.0) ** 2 + 1e4, 100)
    >>> np.flatnonzero(lost(q)).tolist()
    [100]
    """
    d = np.diff(q)
    if d.size <= 2 * BESIDE:
        return np.zeros(q.size, bool)
    padded = np.pad(d, BESIDE, mode="edge")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1), axis=1)
    changes = np.abs(np.diff(d))
    rough = float(np.quantile(changes, QUIET))  # where every fifth is missing, half of them are large
    big = np.abs(usual) > max(FEWEST_STEPS * _smallest(d), ROUGH * rough)
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.where(big, d / usual, 1.0)
    alike = np.abs(times - 1.0) < STEADY
    beside = np.r_[False, alike[:-1]] & np.r_[alike[1:], False]
    return np.r_[False, (times > TWICE[0]) & (times < TWICE[1]) & beside]


def odd_increments(record: Record) -> str:
    """What is odd about the increments of position and reference of ``record``, in words; "" where nothing is.

    >>> t, sweep = 1e-3, np.arange(2000.0) ** 2 / 1e7
    >>> odd_increments(Record.from_arrays(t, sweep, sweep, np.sin(1e3 * sweep)))
    ''
    >>> less = np.delete(sweep, slice(9, None, 10))
    >>> odd_increments(Record.from_arrays(t, less, less, np.sin(1e3 * less)))
    'q leaps ahead at 11 % of the samples: others are missing there, and time was numbered anew'
    """
    q, reference = record.q, record.q_ref
    stands, leaps = {"q": held(q)}, {"q": lost(q)}
    if record.q_ref_recorded and np.ptp(reference):
        # A reference may well be given in fewer steps than it is recorded; all else then goes on.
        again = (np.diff(q, prepend=np.nan) == 0.0) & (np.diff(record.u, prepend=np.nan) == 0.0)
        stands["q_ref"], leaps["q_ref"] = held(reference) & again, lost(reference)
    for found_in, words in (
        (stands, "{0} stands still at {1} in full motion: values are held, or rows repeated"),
        (leaps, "{0} leaps ahead at {1}: others are missing there, and time was numbered anew"),
    ):
        for name, found in found_in.items():
            if np.count_nonzero(found) > max(FEWEST, SOME * q.size):
                return words.format(name, f"{100 * np.mean(found):.2g} % of the samples")
    return ""


def _mean(q: np.ndarray) -> np.ndarray:
    """The mean increment (n - 1,) over a wide part around each."""
    n = q.size - 1
    low, high = np.clip(np.arange(n) - WIDE, 0, n), np.clip(np.arange(n) + WIDE + 1, 0, n)
    return (q[high] - q[low]) / np.maximum(high - low, 1)


def _smallest(d: np.ndarray) -> float:
    """About the smallest step of the increments ``d``."""
    sizes = np.abs(d[d != 0.0])
    return float(np.quantile(sizes, 0.001)) if sizes.size else 0.0


def check_motion(axis: Axis, record: Record) -> list[str]:
    """One line for each thing in ``record`` that no drive of ``axis`` does; nothing for a healthy record.

    >>> from dataclasses import replace
    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> record = synthetic_record(axis, laps=1)
    >>> check_motion(axis, record)
    []
    >>> check_motion(axis, replace(record, u=np.where(record.t < 9.0, 1.0, 2.0) * record.u))[0].split(" s on")[0]
    'u: from about 9.09'
    """
    return list(_found(axis, record.until(LONGEST)))


def _found(axis: Axis, record: Record) -> Iterator[str]:
    u, n = record.u, len(record)
    swing = float(np.std(u))
    if said := odd_increments(record):
        yield said
    yield from _spike(axis, record)
    step = step_of(u)
    changes = np.abs(np.diff(u)) / step if step else np.zeros(0)
    changes = changes[changes > 0.5]
    smooth = changes.size > 0 and np.mean(changes < 1.5) > NEXT and np.ptp(u) > (LEVELS - 0.5) * step
    if step > COARSE * swing and smooth:
        yield f"u: recorded in steps of {step:.4g}, {100 * step / swing:.2g} % of its deviation"
    if (share := _held_share(record, step)) > UNCHANGED:
        yield f"u: does not change in {100 * share:.2g} % of the samples in motion: values are held, or rows repeated"
    sign = np.where(np.arange(n - 2) % 2, -1.0, 1.0)
    alternate = 0.5 * sign * (u[1:-1] - 0.5 * (u[:-2] + u[2:]))
    means = alternate[: alternate.size // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    if means.size and float(np.sqrt(np.mean(means**2))) > ALTERNATES * swing:
        yield "u: every second sample is another signal's"
    yield from _exchanged(axis, record)
    yield from _gain(record)
    yield from _late(record)


def _spike(axis: Axis, record: Record) -> Iterator[str]:
    """Whether the largest command is one that the axis never answered."""
    u = record.u
    k, usual = int(np.argmax(np.abs(u))), float(np.quantile(np.abs(u), 0.999))
    beside = np.delete(np.abs(u[max(k - BLOCK, 0) : k + BLOCK + 1]), min(k, BLOCK))
    if not abs(u[k]) > SPIKE * usual > 0.0 or np.max(beside) > usual:
        return
    usual_there = u.copy()
    usual_there[k] = np.median(u[max(k - 2, 0) : k + 3])
    columns, without = motion_columns(replace(record, u=usual_there), record.q)
    _, with_it = motion_columns(record, record.q)
    spike = with_it - without
    at = int(np.argmax(np.abs(spike)))
    answer = columns[at] @ np.linalg.lstsq(columns, without, rcond=None)[0] - without[at]
    if abs(answer) < ANSWERED * abs(spike[at]):
        yield (
            f"u: {u[k]:.4g} {axis.units.command_unit} at {record.t[k]:.4g} s is {abs(u[k]) / usual:.3g} times what all "
            "but one sample in a thousand stay below, and the axis does not answer it"
        )


def _held_share(record: Record, step: float) -> float:
    """Share of the samples in motion in which the command stays for a few samples, if that is more than by its step."""
    u = record.u
    same = np.diff(u) == 0.0
    ends = np.flatnonzero(np.diff(same, prepend=False, append=False))
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        if stop - start > SHORT:
            same[start:stop] = False
    same &= np.abs(u[1:]) < 0.98 * np.max(np.abs(u))
    moving = np.diff(record.q) != 0.0
    by_one_step = np.count_nonzero((np.abs(np.diff(u)) < 1.5 * step) & (np.diff(u) != 0.0)) if step else 0
    if not moving.any() or np.count_nonzero(same) < LIKELY * by_one_step:
        return 0.0
    return float(np.mean(same[moving]))


def _exchanged(axis: Axis, record: Record) -> Iterator[str]:
    if not (record.q_ref_recorded and np.ptp(record.q_ref)):
        return
    rounded, encoder = step_of(record.q), axis.sampling.encoder_resolution
    if rounded > COARSER * encoder:  # what is left of the position is then its rounding
        return
    if correlation(record.q, record.q_ref) < ALIKE:
        return
    own, other = unexplained(record, record.q), unexplained(record, record.q_ref)
    if other < FITS and other < EXCHANGED * own:
        yield "q and q_ref: the reference explains the command better than the position; they may be exchanged"


def _gain(record: Record) -> Iterator[str]:
    """Whether the command that the same motion takes changes half-way, mass and friction alike.

    Both parts have to speed up and to slow down: else they have no motion in common, and friction that depends on the
    torque, or is another in the other direction, looks like a gain.
    """
    columns, u = motion_columns(record, record.q)
    whole = _fit(columns, u)[1]
    found = [(np.inf, 0, np.zeros(2), np.zeros(2))]
    for cut in np.linspace(0, u.size, BLOCKS + 1).astype(int)[2:-2].tolist():
        if not (_speeds_up_and_slows_down(columns[:cut]) and _speeds_up_and_slows_down(columns[cut:])):
            continue
        (before, one), (after, other) = _fit(columns[:cut], u[:cut]), _fit(columns[cut:], u[cut:])
        found.append((one + other, cut, before, after))
    left, cut, before, after = min(found, key=lambda one: one[0])
    if left > EXPLAINED * whole or left > (FITS * np.std(u)) ** 2 * u.size or not np.all(before > 0.0):
        return
    inertial, dissipative = (after / before).tolist()
    if not 1.0 / SAME < inertial / (dissipative or np.inf) < SAME:
        return
    times = float(np.copysign(np.sqrt(inertial * dissipative), dissipative))
    if 1.0 / GAIN < times < GAIN:
        return
    yield (
        f"u: from about {record.t[cut]:.3g} s on the same motion takes {times:.3g} times the command, mass and "
        "friction alike: its gain or its unit changes there"
    )


def _speeds_up_and_slows_down(columns: np.ndarray) -> bool:
    power = columns[:, 0] * columns[:, 1]
    faster, slower = float(np.sum(power[power > 0.0])), -float(np.sum(power[power < 0.0]))
    return min(faster, slower) > BRAKES * (faster + slower)


def _fit(columns: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float]:
    """Inertial and friction part of the command (2,) that full motion takes, and the power that is left."""
    beta = np.linalg.lstsq(columns, u, rcond=None)[0]
    return np.array([beta[0], beta[1] + beta[2]]), float(np.sum((u - columns @ beta) ** 2))


def _late(record: Record) -> Iterator[str]:
    """Whether the command fits the motion much better somewhat earlier or later."""
    reach, count = SHIFTS
    columns, u = motion_columns(record, record.q)
    most = min(round(reach / record.period), u.size // 4)
    swing = float(np.std(u))
    if not swing or most < FEWEST_LATE:
        return
    basis = np.linalg.qr(columns)[0]

    def left(shift: int) -> float:
        moved = np.roll(u, shift)
        return float(np.std(moved - basis @ (basis.T @ moved))) / swing

    own = left(0)
    if own < LITTLE:
        return
    best, shift = min((left(shift), shift) for shift in {round(s) for s in np.linspace(-most, most, 2 * count + 1)})
    if abs(shift) < max(LATE / record.period, FEWEST_LATE) or abs(shift) == most:
        return
    if best < min(BETTER * own, WELL):
        way = "later" if shift > 0 else "earlier"
        yield (
            f"u and q: the command fits the motion best {1e3 * abs(shift) * record.period:.2g} ms {way} than it was "
            "recorded: one of them is delayed, or recorded behind a filter"
        )
