"""Checks that a record excites what an identification needs; each error says what to record instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import RecordError
from emps_design.messages import warning
from emps_design.records import Record

REFUSE, KNOWN = "refuse", "known"  # treatment of a record with a measured external force
SMALLEST_STEPS = 200  # of the encoder, in a stroke
SMALLEST_STROKE = 1e-5  # m or rad, where the encoder is not known
LARGEST_SATURATED_SHARE = 0.2
REVERSAL = 0.02  # of the stroke: least motion against the other direction, and of a piece that counts
SENSOR_NOISE = 0.01  # of the motor force: a smaller measured force may be sensor noise
SURE_OF_MOTION = 4.0  # standard deviations of a central difference, beyond which a velocity has a sign
WEAK_RELIABILITY = 0.5  # share of a column explained by the reference, below which its parameter is not determined


def check_record(record: Record, axis: Axis, external_force: str = REFUSE, one_way: bool = False) -> Record:
    """The record to identify from: without a measured force that is only sensor noise.

    Raises :class:`RecordError` for a record that cannot identify ``axis``: without motion, without reversal (unless
    ``one_way``), saturated, or with a measured external force. With ``external_force`` "known" that force takes part,
    as in (21).
    """
    stroke = float(np.ptp(record.q))
    step, units = axis.sampling.encoder_resolution, axis.units
    least = SMALLEST_STEPS * step or SMALLEST_STROKE
    if stroke < least:
        size = units.quantity(stroke, "m", ".3g")
        steps = f", {stroke / step:.3g} steps of the encoder, expected at least {SMALLEST_STEPS}" if step else ""
        found = f"found a stroke of {size}{steps}" if stroke else f"no motion, the stroke is {size}"
        raise RecordError(
            f"{record.name}: {found}; record a trajectory that accelerates, runs at several constant speeds and "
            "reverses"
        )
    saturated = float(np.mean(np.abs(record.u) >= 0.999 * axis.drive.command_limit))
    if saturated > LARGEST_SATURATED_SHARE:
        raise RecordError(
            f"{record.name}: u is at the limit of {units.quantity(axis.drive.command_limit, 'V', 'g')} for "
            f"{100 * saturated:.0f} % of the time, expected at most {100 * LARGEST_SATURATED_SHARE:.0f} %; record "
            "slower motion with less acceleration"
        )
    if not one_way and goes_one_way(record):
        raise RecordError(
            f"{record.name}: no reversal, the {units.word('carriage')} moves in one direction only, so Coulomb "
            f"friction and a constant {units.word('force')} cannot be separated; record motion in both directions"
        )
    return force_free(record, axis, external_force)


def force_free(record: Record, axis: Axis, external_force: str = REFUSE) -> Record:
    """The record without a measured force that is only sensor noise; :class:`RecordError` where it is larger.

    With ``external_force`` "known" the force takes part, and the record is returned unchanged.
    """
    if record.f_ext is None or external_force == KNOWN:
        return record
    units = axis.units
    rms, motor = (float(np.sqrt(np.mean(x**2))) for x in (record.f_ext, axis.drive.gain * record.u))
    if rms > SENSOR_NOISE * motor:
        raise RecordError(
            f"{record.name}: an external {units.word('force')} of {units.quantity(rms, 'N', '.3g')} rms acts, but (12) "
            f"assumes none; record without touching the {units.word('carriage')}, or include the measured "
            f"{units.word('force')} with `external_force='known'`"
        )
    if rms == 0.0:
        return replace(record, f_ext=None)
    size = units.quantity(rms, "N", ".2g")
    text = f"f_ext: its {size} rms are treated as sensor noise and ignored (`external_force='known'` uses it)"
    return replace(record, f_ext=None, warnings=(*record.warnings, warning("force-is-noise", text, rms=rms)))


def follows(record: Record) -> bool:
    """Whether the motion of ``record`` follows its reference within 10 % (standard deviations)."""
    return float(np.std(record.q - record.q_ref)) <= 0.1 * float(np.std(record.q))


def reverses(q: np.ndarray) -> bool:
    """Whether the position goes both up and down by at least :data:`REVERSAL` of its stroke.

    >>> reverses(np.array([0.0, 1.0, 2.0])), reverses(np.array([0.0, 1.0, 0.5]))
    (False, True)
    """
    stroke = float(np.ptp(q))
    rise = float(np.max(q - np.minimum.accumulate(q)))
    fall = float(np.max(np.maximum.accumulate(q) - q))
    return min(rise, fall) >= REVERSAL * stroke


def goes_one_way(record: Record) -> bool:
    """Whether all of ``record`` moves in one direction; Coulomb friction and constant force are one force then."""
    pieces = [record.q[start:stop] for start, stop in record.pieces if stop - start > 1]
    pieces = [q for q in pieces if np.ptp(q) >= REVERSAL * max(np.ptp(piece) for piece in pieces)]
    return not any(map(reverses, pieces)) and len({bool(q[-1] > q[0]) for q in pieces}) < 2


def one_direction(records: Sequence[Record]) -> int:
    """1 or -1 where all ``records`` move in the same single direction, 0 otherwise.

    >>> up = Record(t=np.arange(3.0), q_ref=np.arange(3.0), q=np.arange(3.0), u=np.ones(3), period=1.0)
    >>> one_direction([up, up]), one_direction([up, replace(up, q=-up.q)])
    (1, 0)
    """
    ways = {int(np.sign(record.q[-1] - record.q[0])) for record in records}
    return ways.pop() if len(ways) == 1 and all(map(goes_one_way, records)) else 0


def backward_time(record: Record) -> float:
    """Share of the moving time that ``record`` moves against its main direction, faster than its noise could show.

    The noise of the position is read from its sixth difference, whose gain is sqrt(924) for white noise and next to
    nothing for motion below a tenth of the sampling frequency.

    >>> t = np.arange(0.0, 1.0, 1e-3)
    >>> forth = Record(t=t, q_ref=t, q=t + 0.01 * np.sin(60.0 * t), u=t, period=1e-3)  # never slower than 0.4
    >>> stutters = replace(forth, q=t + 0.02 * np.sin(60.0 * t))  # backward for 19 % of the time
    >>> backward_time(forth), round(backward_time(stutters), 2)
    (0.0, 0.19)
    """
    velocity = np.gradient(record.q, record.period)
    noise = float(np.sqrt(np.mean(np.diff(record.q, 6) ** 2) / 924.0))
    clear = SURE_OF_MOTION * noise / (np.sqrt(2.0) * record.period)
    forward, backward = (float(np.mean(sign * velocity > clear)) for sign in (1.0, -1.0))
    return min(forward, backward) / max(forward + backward, 1e-300)


def reliability(W: np.ndarray, Z: np.ndarray, lags: tuple[int, ...] = (0,)) -> np.ndarray:
    """Share (p,) of each column of ``W`` that the columns ``Z`` of the reference explain, given the other columns.

    This is the partial R^2 of the first stage of instrumental variables. Each column of the reference is taken at the
    delays ``lags`` [rows], for a loop lags its reference. Noise in a column attenuates its parameter by about this
    factor: near 1 the column is motion; near 0 it is noise and the parameter is not determined, however small its
    deviation by (15).

    >>> W = np.column_stack([np.ones(100), np.arange(100) - 49.5])
    >>> reliability(W, W).round(3).tolist()
    [1.0, 1.0]
    """
    shares = []
    for index in range(W.shape[1]):
        own, others = _own(W, index)
        lead = np.column_stack([np.roll(Z[:, index], lag) for lag in lags])
        lead = lead - others @ (others.T @ lead)
        basis, _, _ = np.linalg.svd(lead / max(float(np.linalg.norm(lead)), 1e-300), full_matrices=False)
        size = float(own @ own)
        shares.append(float(np.sum((basis.T @ own) ** 2)) / size if size > 0 else 0.0)
    return np.array(shares)


def share_near_gaps(W: np.ndarray, used: np.ndarray, reach: int) -> np.ndarray:
    """Share (p,) of each column of ``W``, less what the others explain, that lies within ``reach`` rows of a gap.

    A gap is a run of rows that are not ``used`` (n,).

    >>> share_near_gaps(np.arange(5.0)[:, None], np.array([True, True, True, True, False]), 1).round(2).tolist()
    [0.64]
    """
    near = used & (np.convolve(~used, np.ones(2 * reach + 1), "same") > 0.5)
    own = [_own(W, index)[0] ** 2 for index in range(W.shape[1])]
    return np.array([float(part[near].sum()) / max(float(part[used].sum()), 1e-300) for part in own])


def _own(W: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
    """The part of column ``index`` orthogonal to the others, and an orthonormal basis of the others."""
    others = np.linalg.qr(np.delete(W, index, axis=1))[0] if W.shape[1] > 1 else np.zeros((len(W), 1))
    return W[:, index] - others @ (others.T @ W[:, index]), others
