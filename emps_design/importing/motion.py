"""Check of a record without a law: signals that no drive and no axis can produce.

This shows less than the law: only faults beyond all effects of friction, elasticity and a controller. An inverse model
with acceleration, velocity, direction and a constant stands for the axis. It need not fit well, but its gain must not
change during the record, and it must fit best without a time shift of the command.

Increments of the position show rows written twice, held values and missing samples: a position is the double integral
of a force, so its increment changes little from one sample to the next. An increment of 0 in full motion, or of twice
its neighbours, is a fault of the recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.importing.account import encoder_step
from emps_design.importing.sanity import correlation, motion_columns, unexplained
from emps_design.records import Record

BESIDE = 4  # increments on either side of a median
WIDE = 16  # samples on either side of a mean increment
FEWEST_STEPS = 6.0  # of the encoder in a usual increment, for another of 0 or twice as much to be a fault
FULL = 0.9  # of the mean increment, the least on both sides of one that is 0 in full motion
TWICE = (1.6, 4.5)  # times the usual increment where samples are missing
STEADY = 0.25  # of the usual increment, largest difference of the neighbours
ROUGH, QUIET = 8.0, 0.4  # times this quantile of the changes of the increments, the least usual increment
FEWEST, SOME = 5, 2e-3  # samples, and share of all samples, that stand still or are missing

LONGEST = 200_000  # samples of a long record that are checked
SPIKE = 8.0  # times the command that all but one sample in a thousand stay below
ANSWERED = 0.3  # of a spike, largest response of the motion to a spurious one
UNCHANGED, LIKELY = 0.04, 4.0  # largest share of held samples in motion; least ratio to changes by one step
COARSE = 0.2  # of the command's deviation
ALTERNATES = 0.3  # of the command's deviation
BLOCK = 32  # samples over which what alternates is averaged
FITS = 0.35  # of the command, largest residual of an inverse model that fits
BLOCKS = 12
EXPLAINED = 0.5  # of the residual power of one model, largest residual power of a model for each part
BRAKES = 0.1  # of the power of acceleration and braking, the least of either in a part
GAIN, SAME = 1.35, 1.5  # least factor of a change of the gain; largest between those of mass and friction
SHIFTS = 0.08, 40  # largest shift of the command [s], and steps to either side
LATE, FEWEST_LATE = 0.015, 8  # s, and samples
BETTER = 0.6  # of the residual without a shift, the most with a shift
WELL, LITTLE = 0.5, 0.1  # of the command, the largest residual with a shift and the least without one
EXCHANGED, ALIKE = 0.7, 0.99  # of the position's residual, the most of the reference; least correlation of the two
COARSER = 1.25  # times the encoder's step: a position that was rounded by the logger
SHORT = 16  # samples, up to which a command is held; longer, it is meant to be constant
LEVELS, NEXT = 5, 0.8  # least levels of a signal in steps, and share of its changes that go to the next level


def step_of(values: np.ndarray) -> float:
    """The step of which the increments of ``values`` (n,) are multiples, 0 without one."""
    return encoder_step(values) or 0.0


def held(q: np.ndarray) -> np.ndarray:
    """Samples (n,) bool at which the position ``q`` (n,) stands still in full motion.

    >>> q = np.arange(200.0) ** 2
    >>> q[100] = q[99]
    >>> np.flatnonzero(held(q)).tolist()
    [100]
    """
    d = np.diff(q)
    # Runs of zero increments, and the increments before and after each.
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
    """Samples (n,) bool before which others are missing: the increment is a multiple of its neighbours.

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
    rough = float(np.quantile(changes, QUIET))  # where every fifth sample is missing, half of the changes are large
    big = np.abs(usual) > max(FEWEST_STEPS * _smallest(d), ROUGH * rough)
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.where(big, d / usual, 1.0)
    alike = np.abs(times - 1.0) < STEADY
    beside = np.r_[False, alike[:-1]] & np.r_[alike[1:], False]
    return np.r_[False, (times > TWICE[0]) & (times < TWICE[1]) & beside]


def odd_increments(record: Record) -> str:
    """Return a sentence on held or missing samples of position or reference of ``record``; "" for none.

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
        # A reference may be updated less often than it is recorded; the other signals then change.
        again = (np.diff(q, prepend=np.nan) == 0.0) & (np.diff(record.u, prepend=np.nan) == 0.0)
        stands["q_ref"], leaps["q_ref"] = held(reference) & again, lost(reference)
    for masks, words in (
        (stands, "{0} stands still at {1} in full motion: values are held, or rows repeated"),
        (leaps, "{0} leaps ahead at {1}: others are missing there, and time was numbered anew"),
    ):
        for name, mask in masks.items():
            if np.count_nonzero(mask) > max(FEWEST, SOME * q.size):
                return words.format(name, f"{100 * np.mean(mask):.2g} % of the samples")
    return ""


def _mean(q: np.ndarray) -> np.ndarray:
    """Mean increment (n - 1,) over :data:`WIDE` samples on either side."""
    n = q.size - 1
    low, high = np.clip(np.arange(n) - WIDE, 0, n), np.clip(np.arange(n) + WIDE + 1, 0, n)
    return (q[high] - q[low]) / np.maximum(high - low, 1)


def _smallest(d: np.ndarray) -> float:
    """The smallest of the increments ``d``, by a low quantile."""
    sizes = np.abs(d[d != 0.0])
    return float(np.quantile(sizes, 0.001)) if sizes.size else 0.0


def check_motion(axis: Axis, record: Record) -> list[str]:
    """Return a sentence for each fault of ``record`` that no drive of ``axis`` can cause; none for a healthy record.

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
    return list(_faults(axis, record.until(LONGEST)))


def _faults(axis: Axis, record: Record) -> Iterator[str]:
    u, n = record.u, len(record)
    swing = float(np.std(u))
    if message := odd_increments(record):
        yield message
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
    """A sentence where the largest command is a spike to which the axis does not respond."""
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
    """Share of the samples in motion at which the command is held briefly; 0 where its resolution explains that."""
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
    if rounded > COARSER * encoder:  # the residual of the position is then its rounding
        return
    if correlation(record.q, record.q_ref) < ALIKE:
        return
    own, other = unexplained(record, record.q), unexplained(record, record.q_ref)
    if other < FITS and other < EXCHANGED * own:
        yield "q and q_ref: the reference explains the command better than the position; they may be exchanged"


def _gain(record: Record) -> Iterator[str]:
    """A sentence where the same motion takes another command from some time on, for mass and friction alike.

    Both parts must accelerate and brake: otherwise friction that depends on torque or direction looks like a gain.
    """
    columns, u = motion_columns(record, record.q)
    whole = _fit(columns, u)[1]
    candidates = [(np.inf, 0, np.zeros(2), np.zeros(2))]
    for cut in np.linspace(0, u.size, BLOCKS + 1).astype(int)[2:-2].tolist():
        if not (_accelerates_and_brakes(columns[:cut]) and _accelerates_and_brakes(columns[cut:])):
            continue
        (before, before_power), (after, after_power) = _fit(columns[:cut], u[:cut]), _fit(columns[cut:], u[cut:])
        candidates.append((before_power + after_power, cut, before, after))
    power, cut, before, after = min(candidates, key=lambda candidate: candidate[0])
    if power > EXPLAINED * whole or power > (FITS * np.std(u)) ** 2 * u.size or not np.all(before > 0.0):
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


def _accelerates_and_brakes(columns: np.ndarray) -> bool:
    power = columns[:, 0] * columns[:, 1]
    faster, slower = float(np.sum(power[power > 0.0])), -float(np.sum(power[power < 0.0]))
    return min(faster, slower) > BRAKES * (faster + slower)


def _fit(columns: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float]:
    """Inertial and friction part (2,) of the command for full motion, and the residual power."""
    beta = np.linalg.lstsq(columns, u, rcond=None)[0]
    return np.array([beta[0], beta[1] + beta[2]]), float(np.sum((u - columns @ beta) ** 2))


def _late(record: Record) -> Iterator[str]:
    """A sentence where the command fits the motion much better with a time shift."""
    reach, count = SHIFTS
    columns, u = motion_columns(record, record.q)
    most = min(round(reach / record.period), u.size // 4)
    swing = float(np.std(u))
    if not swing or most < FEWEST_LATE:
        return
    basis = np.linalg.qr(columns)[0]

    def residual(shift: int) -> float:
        moved = np.roll(u, shift)
        return float(np.std(moved - basis @ (basis.T @ moved))) / swing

    own = residual(0)
    if own < LITTLE:
        return
    best, shift = min((residual(shift), shift) for shift in {round(s) for s in np.linspace(-most, most, 2 * count + 1)})
    if abs(shift) < max(LATE / record.period, FEWEST_LATE) or abs(shift) == most:
        return
    if best < min(BETTER * own, WELL):
        way = "later" if shift > 0 else "earlier"
        yield (
            f"u and q: the command fits the motion best {1e3 * abs(shift) * record.period:.2g} ms {way} than it was "
            "recorded: one of them is delayed, or recorded behind a filter"
        )
