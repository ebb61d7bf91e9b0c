"""Plausibility of a record for its axis: units, scales, exchanged columns. Nothing is guessed or corrected.

The impossible is refused in one line, unless ``[record]`` accepts it by name; the odd is noted. Only files with mapped
or recognised columns are checked, not those with the column names of a record.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import RecordError
from emps_design.records import Record
from emps_design.records.layout import NAMED, Doubt

ON_THE_CLOCK = 1e-3  # of the axis's period
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


Doubts = Iterator[tuple[Doubt | None, str]]  # the doubt, None for a mere note, and its text


def check_against(axis: Axis, record: Record, source: str) -> Record:
    """Return ``record`` with notes on its oddities; raise :class:`RecordError` where it cannot be of this ``axis``.

    Doubts that the ``[record]`` table accepts are noted too.
    """
    if all(assignment.how == NAMED for assignment in record.assigned):
        return record
    notes = []
    for check in (_same_unit, _rough, _exchanged, _clock, _limit, _force):
        for doubt, text in check(axis, record):
            if doubt is not None and doubt not in axis.record.accept:
                raise RecordError(f'{source}: {text}; or if it is right: accept = ["{doubt}"] in [record]')
            notes.append(text if doubt is None else f"{text} (accepted as [record] says)")
    return replace(record, warnings=(*record.warnings, *notes))


def _clock(axis: Axis, record: Record) -> Doubts:
    ratio = record.period / axis.sampling.period
    if abs(ratio - 1.0) < ON_THE_CLOCK:
        return
    period = f"found a sampling period of {1e3 * record.period:.6g} ms"
    expected = f"the axis's {1e3 * axis.sampling.period:.6g} ms"
    if abs(ratio) > 30 and _confusion(ratio):
        yield "sampling-period", f"column t: {period}, expected {expected}; {_confusion(ratio)}?"
    else:
        yield None, f"t: {period}, not {expected}"


def _same_unit(axis: Axis, record: Record) -> Doubts:
    """Position and reference must move in the same direction and by the same amount."""
    if not record.q_ref_recorded or not (np.ptp(record.q_ref) and np.ptp(record.q)):
        return
    together = correlation(record.q, record.q_ref)
    if together < -STIFF:
        yield (
            "opposed-reference",
            "columns q and q_ref: found motion against the reference, expected along it; one of them needs sign = -1 "
            "in [record]",
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
        yield None, f"u: {comparison}"


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
            "column u: found a command against the motion it makes, expected one along it; command, or position and "
            "reference, needs sign = -1 in [record]",
        )
    ratio = float(np.sqrt(np.mean(force**2) / np.mean(needed**2)))
    words = f"found force_gain x command {ratio:.3g} times what mass and friction need for the motion"
    if not 1.0 / IMPOSSIBLE_FORCE < ratio < IMPOSSIBLE_FORCE:
        yield "force-scale", f"columns u and q: {words}, expected about as much; correct unit or scale in [record]"
    # Friction may hide a wrong scale in the sum.
    inertial, expected = float(np.std(drive.gain * motion_parts(record, record.q)[0][:, 0])), m.mass * float(np.std(a))
    if np.std(v) > ONE_VELOCITY * np.max(np.abs(v)) and inertial > max(
        INERTIAL * float(np.std(force)), IMPOSSIBLE_FORCE * expected
    ):
        yield (
            "inertia-scale",
            f"columns q and q_ref: found a motion that {inertial / expected:.3g} times the mass of the axis would make "
            "under this command, expected about that mass; correct unit or scale of both in [record]",
        )
    known = f" ({_confusion(ratio)}?)" if _confusion(ratio) else ""
    if not 1.0 / ODD_FORCE < ratio < ODD_FORCE:
        yield None, f"u and q: {words}{known}; check their units"


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
