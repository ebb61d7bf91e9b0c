"""Plausibility of a record for its axis, and signals that no drive and no axis can produce.

Units, scales and exchanged columns are checked; nothing is guessed or corrected. The impossible is refused in one
line, unless ``[record]`` accepts it by name; the odd is noted. Only files with mapped or recognised columns are
checked, not those with the column names of a record.

Without a law, signals that no drive and no axis can produce are looked for. This shows less than the law: only faults
beyond all effects of friction, elasticity and a controller. An inverse model with acceleration, velocity, direction
and a constant stands for the axis. It need not fit well, but its gain must not change during the record, and it must
fit best without a time shift of the command.

Increments of the position show rows written twice, held values and missing samples: a position is the double integral
of a force, so its increment changes little from one sample to the next. An increment of 0 in full motion, or of twice
its neighbours, is a fault of the recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import RecordError
from emps_design.messages import Message, warning
from emps_design.records import Record
from emps_design.records.clock import same_period
from emps_design.records.layout import NAMED, Doubt
from emps_design.records.record import quantisation_step
from emps_design.stretches import stretches

WEAK_LOOP = 20.0  # largest ratio of position to reference under any controller, or of reference to position
STIFF = 0.999  # least correlation of position and reference of a loop that follows
FOLLOWS = (0.5, 2.0)  # ratio of position to reference of such a loop
ROUGHER = 3.0  # largest roughness of a position over that of the command
BENDS = 0.1  # of its deviation, least second difference of the command over the span of the comparison
OPPOSED = -0.8  # correlation of the motor's force with what the motion needs
IMPOSSIBLE_FORCE = 300.0  # ratio to the force that the motion needs, or its inverse: a scale is wrong by 1000
INERTIAL = 0.1  # of the command, least inertial part that determines the mass
ONE_VELOCITY = 1e-3  # of the largest velocity, deviation below which it is constant
ODD_FORCE = 10.0
ON_GRID, OFF_GRID = 0.03, 0.08  # of an encoder step, mean distance of increments from it; 0.25 without a grid
EXPLAINS = 1.05  # ratio of the residuals of position and reference above which the reference explains better
EXACTLY, SELDOM = 1e-6, 1e-3  # on the grid exactly; off it seldom, at speeds of whole steps a sample
BEST = 0.35  # share of the command that the better one may leave
BEYOND_LIMIT, FAR_BEYOND_LIMIT = 1.02, 10.0
WINDOW = 0.01  # s, over which a motion is smoothed
NAMES = {
    1e3: "mm for m, or ms for s",
    1e6: "um for m",
    57.2958: "deg for rad",
    6.28319: "rev for rad",
    360.0: "deg for rev",
}


Doubts = Iterator[tuple[Doubt, str] | Message]  # doubts with their texts, and mere remarks

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


def check_against(axis: Axis, record: Record, source: str) -> Record:
    """Return ``record`` with notes on its oddities; raise :class:`RecordError` where it cannot be of this ``axis``.

    Doubts that the ``[record]`` table accepts are noted too.
    """
    if all(assignment.how == NAMED for assignment in record.assigned):
        return record
    notes = []
    for check in (_same_unit, _rough, _exchanged, _clock, _limit, _force):
        for found in check(axis, record):
            if isinstance(found, Message):
                notes.append(found)
                continue
            doubt, text = found
            if doubt not in axis.record.accept:
                raise RecordError(f'{source}: {text}; or if it is right: accept = ["{doubt}"] in [record]')
            notes.append(warning("accepted-doubt", f"{text} (accepted as [record] says)", doubt=doubt))
    return replace(record, warnings=(*record.warnings, *notes))


def _clock(axis: Axis, record: Record) -> Doubts:
    ratio = record.period / axis.sampling.period
    if same_period(record.period, axis.sampling.period):
        return
    period = f"found a sampling period of {1e3 * record.period:.6g} ms"
    expected = f"the axis's {1e3 * axis.sampling.period:.6g} ms"
    if abs(ratio) > 30 and _confusion(ratio):
        yield "sampling-period", f"column t: {period}, expected {expected}; {_confusion(ratio)}?"
    else:
        yield warning("other-period", f"t: {period}, not {expected}", column="t", period=record.period)


def _same_unit(axis: Axis, record: Record) -> Doubts:
    """Position and reference must move in the same direction and by the same amount."""
    if not record.q_ref_recorded or not (np.ptp(record.q_ref) and np.ptp(record.q)):
        return
    together = correlation(record.q, record.q_ref)
    if together < -STIFF:
        yield (
            "opposed-reference",
            "columns q and q_ref: found motion opposite to the reference, expected the same direction; one of them "
            "needs sign = -1 in [record]",
        )
    slope = float(np.std(record.q) / np.std(record.q_ref))
    low, high = FOLLOWS if together > STIFF else (1.0 / WEAK_LOOP, WEAK_LOOP)
    if together > 0.9 and not low < slope < high:
        known = f" ({_confusion(slope)}?)" if _confusion(slope) else ""
        yield (
            "reference-scale",
            f"columns q and q_ref: found a position that is {slope:.4g} times the reference{known}, expected both in "
            "their units; correct unit or scale in [record]",
        )


def _rough(axis: Axis, record: Record) -> Doubts:
    """A position, the double integral of the command, is never rougher than that, up to encoder steps and noise.

    So both are compared over a span in which the second difference of the command is far above these.
    """
    span, roughness = 1, _roughness(record.u, 1)
    while roughness < BENDS and 8 * span < len(record):
        span *= 2
        roughness = _roughness(record.u, span)
    if _roughness(record.q, span) > ROUGHER * roughness:
        yield "rough-position", _exchange("q and u", "a position that is rougher than the command")


def _exchanged(axis: Axis, record: Record) -> Doubts:
    if not record.q_ref_recorded:
        return
    q, q_ref, u = record.q, record.q_ref, record.u
    if np.ptp(q_ref) and abs(correlation(q, u)) > STIFF > 0.9 > abs(correlation(q, q_ref)):
        observation = "a command that the position follows, and a reference that it does not"
        yield "exchanged-command", _exchange("q_ref and u", observation)
    step = axis.sampling.encoder_resolution
    off, reference_off = _off_grid(q, step), _off_grid(q_ref, step)
    if off is not None and reference_off is not None:
        if reference_off < ON_GRID and off > (OFF_GRID if reference_off > EXACTLY else SELDOM):
            observation = "a reference in steps of the encoder, and a position that is not"
            yield "exchanged-reference", _exchange("q and q_ref", observation)
            return
        if off < ON_GRID:
            return
    if correlation(q, q_ref) > STIFF:
        explained, other = unexplained(record, q), unexplained(record, q_ref)
        if other < BEST and explained > EXPLAINS * other:
            observation = "a reference that explains the command better than the position"
            yield "exchanged-reference", _exchange("q and q_ref", observation)


def _exchange(columns: str, observation: str) -> str:
    return f"columns {columns}: found {observation}; are they exchanged in [record]?"


def _limit(axis: Axis, record: Record) -> Doubts:
    limit, largest = axis.drive.command_limit, float(np.max(np.abs(record.u)))
    comparison = f"found up to {largest:.4g}, expected at most the limit of {limit:.4g} in the axis file"
    if largest > FAR_BEYOND_LIMIT * limit:
        yield "command-limit", f"column u: {comparison}; correct unit or scale of command in [record]"
    elif largest > BEYOND_LIMIT * limit:
        yield warning("beyond-limit", f"u: {comparison}", column="u", largest=largest, limit=limit)


def _force(axis: Axis, record: Record) -> Doubts:
    """The motor's force against the force that mass and friction of the axis need for this motion."""
    if axis.drive.command == "duty":  # of a supply, against a back-EMF
        if record.supply is None:
            return
        record = replace(record, u=record.u * record.supply)
    a, v, u = _motion(record, record.q)
    m, drive = axis.mechanics, axis.supplied_by(record).drive
    if drive.command == "duty" and drive.supply is None:
        return
    needed = m.mass * a + (m.viscous + drive.braking) * v + m.coulomb * np.sign(v) + m.offset
    force = drive.gain * u
    if not (np.std(force) and np.std(needed)):
        return
    if correlation(force, needed) < OPPOSED:
        yield (
            "opposed-command",
            "column u: found a command opposite to the motion it causes, expected the same sign; command, or position "
            "and reference, needs sign = -1 in [record]",
        )
    ratio = float(np.sqrt(np.mean(force**2) / np.mean(needed**2)))
    mass = axis.units.word("mass")
    words = f"found force_gain x command {ratio:.3g} times what {mass} and friction need for the motion"
    if not 1.0 / IMPOSSIBLE_FORCE < ratio < IMPOSSIBLE_FORCE:
        yield "force-scale", f"columns u and q: {words}, expected about as much; correct unit or scale in [record]"
    # Friction may hide a wrong scale in the sum.
    inertial, expected = float(np.std(drive.gain * motion_parts(record, record.q)[0][:, 0])), m.mass * float(np.std(a))
    if np.std(v) > ONE_VELOCITY * np.max(np.abs(v)) and inertial > max(
        INERTIAL * float(np.std(force)), IMPOSSIBLE_FORCE * expected
    ):
        yield (
            "inertia-scale",
            f"columns q and q_ref: found a motion that {inertial / expected:.3g} times the {mass} of the axis would "
            f"make under this command, expected about that {mass}; correct unit or scale of both in [record]",
        )
    known = f" ({_confusion(ratio)}?)" if _confusion(ratio) else ""
    if not 1.0 / ODD_FORCE < ratio < ODD_FORCE:
        yield warning("odd-force", f"u and q: {words}{known}; check their units", ratio=ratio)


def _motion(record: Record, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Acceleration and velocity of ``q`` over a window, and the command with the weights of the acceleration."""
    n = min(max(2, round(WINDOW / record.period)), (q.size - 1) // 4)
    width = n * record.period
    a = (q[2 * n :] - 2 * q[n:-n] + q[: -2 * n]) / width**2
    v = (q[2 * n :] - q[: -2 * n]) / (2 * width)
    weights = np.concatenate([np.arange(1, n + 1), np.arange(n - 1, 0, -1)]) / n**2
    return a, v, np.convolve(record.u, weights, "valid")[1:-1]


def unexplained(record: Record, q: np.ndarray) -> float:
    """Share of the command that acceleration, velocity and direction of ``q`` leave unexplained."""
    parts, u = motion_parts(record, q)
    return float(np.std(u - parts.sum(axis=1)) / np.std(u)) if np.std(u) else 1.0


def motion_parts(record: Record, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts (n, 4) of the command: of acceleration, velocity and direction of ``q``, a constant; and that command."""
    columns, u = motion_columns(record, q)
    return columns * np.linalg.lstsq(columns, u, rcond=None)[0], u


def motion_columns(record: Record, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration, velocity and direction of ``q``, and a constant (n, 4), each up to 1; and the command (n,)."""
    a, v, u = _motion(record, q)
    columns = np.column_stack([a, v, np.tanh(v / (0.01 * np.max(np.abs(v)) or 1.0)), np.ones_like(a)])
    scale = np.max(np.abs(columns), axis=0)
    return columns / np.where(scale > 0, scale, 1.0), u


def _off_grid(values: np.ndarray, step: float) -> float | None:
    """Mean distance of the increments of ``values`` from whole steps, in encoder steps; None for too few increments."""
    increments = np.diff(values)
    increments = increments[np.abs(increments) > 0.4 * step] if step > 0.0 else increments[:0]
    if increments.size < 50:
        return None
    steps = increments / step
    return float(np.mean(np.abs(steps - np.round(steps))))


def _roughness(values: np.ndarray, span: int) -> float:
    """Deviation of the second differences of ``values`` (n,) over ``span`` samples, over their own; 0 if constant."""
    bends = values[2 * span :] - 2.0 * values[span:-span] + values[: -2 * span]
    return float(np.std(bends) / np.std(values)) if np.ptp(values) else 0.0


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation of ``a`` and ``b`` (n,), 0 where one of them is constant."""
    spread = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0.0 else 0.0


def _confusion(ratio: float) -> str:
    """The confusion of units that gives this ratio or its inverse; "" for none that is known."""
    size = max(ratio, 1.0 / ratio) if ratio > 0.0 else 0.0
    return next((words for factor, words in NAMES.items() if abs(size / factor - 1.0) < 0.03), "")


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

    None of a resampled record either: its times are known, and their jitter makes its increments odd.

    >>> t, sweep = 1e-3, np.arange(2000.0) ** 2 / 1e7
    >>> odd_increments(Record.from_arrays(t, sweep, sweep, np.sin(1e3 * sweep)))
    ''
    >>> less = np.delete(sweep, slice(9, None, 10))
    >>> odd_increments(Record.from_arrays(t, less, less, np.sin(1e3 * less)))
    'q jumps ahead at 11 % of the samples: samples are missing there, and time was renumbered'
    """
    if record.measured is not None:
        return ""
    q, reference = record.q, record.q_ref
    stands, leaps = {"q": held(q)}, {"q": lost(q)}
    if record.q_ref_recorded and np.ptp(reference):
        # A reference may be updated less often than it is recorded; the other signals then change.
        again = (np.diff(q, prepend=np.nan) == 0.0) & (np.diff(record.u, prepend=np.nan) == 0.0)
        stands["q_ref"], leaps["q_ref"] = held(reference) & again, lost(reference)
    for masks, words in (
        (stands, "{0} does not change at {1} in full motion: values are held, or rows repeated"),
        (leaps, "{0} jumps ahead at {1}: samples are missing there, and time was renumbered"),
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
    step = quantisation_step(np.diff(u))
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
        yield "u: every second sample is from another signal"
    yield from _exchanged_in_motion(axis, record)
    yield from _gain(axis, record)
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
            f"u: {u[k]:.4g} {axis.units.command_unit} at {record.t[k]:.4g} s is {abs(u[k]) / usual:.3g} times the 99.9 "
            "% quantile of the others, and the axis does not respond to it"
        )


def _held_share(record: Record, step: float) -> float:
    """Share of the samples in motion at which the command is held briefly; 0 where its resolution explains that."""
    u = record.u
    same = np.diff(u) == 0.0
    for start, stop in stretches(same):
        if stop - start > SHORT:
            same[start:stop] = False
    same &= np.abs(u[1:]) < 0.98 * np.max(np.abs(u))
    moving = np.diff(record.q) != 0.0
    by_one_step = np.count_nonzero((np.abs(np.diff(u)) < 1.5 * step) & (np.diff(u) != 0.0)) if step else 0
    if not moving.any() or np.count_nonzero(same) < LIKELY * by_one_step:
        return 0.0
    return float(np.mean(same[moving]))


def _exchanged_in_motion(axis: Axis, record: Record) -> Iterator[str]:
    if not (record.q_ref_recorded and np.ptp(record.q_ref)):
        return
    rounded, encoder = quantisation_step(np.diff(record.q)), axis.sampling.encoder_resolution
    if rounded > COARSER * encoder:  # the residual of the position is then its rounding
        return
    if correlation(record.q, record.q_ref) < ALIKE:
        return
    own, other = unexplained(record, record.q), unexplained(record, record.q_ref)
    if other < FITS and other < EXCHANGED * own:
        yield "q and q_ref: the reference explains the command better than the position; they may be exchanged"


def _gain(axis: Axis, record: Record) -> Iterator[str]:
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
        f"u: from about {record.t[cut]:.3g} s on the same motion takes {times:.3g} times the command, "
        f"{axis.units.word('mass')} and friction alike: its gain or its unit changes there"
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
