"""What a record must have to be judged, and what it cannot tell: checked before anything is computed."""

from __future__ import annotations

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.model.recorded import CUTOFF_HZ
from emps_design.effects import Effect
from emps_design.errors import RecordError
from emps_design.laws import recorded_gains
from emps_design.records import Record
from emps_design.records.clock import same_period

SLOWEST_PERIOD = 0.8 * 0.5 / CUTOFF_HZ  # s, for the filters of the missing force
MEMORY = 1700  # bytes for each sample, measured on an hour at 1 kHz
MOST_SAMPLES = 1_000_000  # 1.7 GB
ONE_SPEED = (
    "one speed, one way, and a controller that is not known: mass and friction stay as the axis file says, and of the "
    "effects only forces with a place or a time are looked for. All others would pass for these, such as "
    "friction that changes along the travel: record strokes at several speeds to tell them apart"
)
DRIVE = {"gtau", "kp", "kv"}  # numbers of the drive that a record may carry


def check_records(records: tuple[Record, ...], axis: Axis, along_motion: bool = False) -> list[str]:
    """Refuse what cannot be judged; return what the records cannot tell, one sentence each.

    ``along_motion``: nothing is simulated, so that any period will do, and no reference is needed.
    """
    samples = sum(map(len, records))
    if samples > MOST_SAMPLES:
        raise RecordError(
            f"{', '.join(record.name for record in records)}: found {samples} samples, expected at most {MOST_SAMPLES} "
            f"in all: a diagnosis takes {MEMORY / 1e3:g} kB of memory for each; cut the records to what tells most"
        )
    gaps: list[str] = []
    for record in records:
        period = axis.sampling.period
        if not same_period(record.period, period):
            raise RecordError(
                f"{record.name}: found a sampling period of {1e3 * record.period:g} ms, expected the axis's "
                f"{1e3 * period:g} ms; records and axis must come from one drive"
            )
        if record.period > SLOWEST_PERIOD and not along_motion:
            raise RecordError(
                f"{record.name}: found a sampling period of {1e3 * record.period:g} ms, expected at most "
                f"{1e3 * SLOWEST_PERIOD:g} ms: forces are looked at up to {CUTOFF_HZ:g} Hz"
            )
        if record.duration < rules.SHORTEST:
            raise RecordError(
                f"{record.name}: found {record.duration:.3g} s, expected at least {rules.SHORTEST:g} s; record whole "
                "strokes"
            )
        if np.ptp(record.q) < rules.STILL:
            raise RecordError(f"{record.name}: the axis does not move; record strokes in both directions")
        if np.ptp(record.q_ref) < rules.STILL and not along_motion:
            raise RecordError(
                f"{record.name}: q_ref is constant, so the controller of the axis file did not make this motion; "
                'without one (kind = "none") it is compared by its command'
            )
        limited = float(np.mean(np.abs(record.u) >= rules.AT_LIMIT * axis.drive.command_limit))
        if limited > rules.SATURATED:
            raise RecordError(
                f"{record.name}: {100 * limited:.0f} % of the samples are at the voltage limit, expected less than "
                f"{100 * rules.SATURATED:.0f} %; lower speed or acceleration"
            )
        gaps += [f"{record.name}: {text}" for text in (*record.contradictions, *_not_excited(record))]
    return gaps


def check_same_drive(record: Record, other: Record, axis: Axis) -> None:
    """Refuse an ``other`` record that was not sampled like ``record``, or whose file names another drive.

    Gains that the controller of ``axis`` takes from each record may differ.
    """
    if not same_period(record.period, other.period):
        raise RecordError(
            f"{other.name}: found a sampling period of {1e3 * other.period:g} ms, expected "
            f"{1e3 * record.period:g} ms of {record.name}; all records must come from one drive"
        )
    own = {source["record"] for source in recorded_gains(axis).values()}
    for name in sorted((DRIVE - own) & record.extra.keys() & other.extra.keys()):
        found, expected = (float(np.ravel(r.extra[name])[0]) for r in (other, record))
        if not np.isclose(found, expected, rtol=1e-6):
            raise RecordError(
                f"{other.name}: found {name} = {found:g}, expected {expected:g} of {record.name}; all records must "
                "come from one drive"
            )


def same_run(one: Record, other: Record) -> bool:
    """Whether two records hold the same measurement, whatever their names."""
    return len(one) == len(other) and np.array_equal(one.q, other.q) and np.array_equal(one.u, other.u)


def keeps_one_speed(record: Record, used: np.ndarray) -> bool:
    """Whether ``record`` goes one way at about one speed in all the samples ``used`` (n,)."""
    v = np.gradient(record.q, record.period)[used]
    return bool(np.std(v) < rules.ONE_SPEED * abs(np.mean(v)))


def told_by_one_speed(effect: Effect) -> bool:
    """Whether one speed tells ``effect``: a force with a place on the travel, or with a time, and no friction."""
    force = effect.channel == "plant" and effect.inertia is None and effect.dry is None
    return force and effect.over in ("q", "t")


def _not_excited(record: Record) -> list[str]:
    """What the speeds of ``record`` leave open."""
    v = np.gradient(record.q_ref, record.period)
    fastest = float(np.abs(v).max())
    steady = np.abs(v)[(np.abs(np.gradient(v, record.period)) < 0.01) & (np.abs(v) > 0.02 * fastest)]
    gaps = []
    if steady.size and np.ptp(steady) < 0.1 * fastest:
        gaps.append("one speed only, so viscous friction and its curvature cannot be told from Coulomb friction")
    moving = np.abs(v) > 0
    if moving.any() and float(np.mean(np.abs(v[moving]) < 0.02)) < 0.005:
        gaps.append("hardly any motion below 20 mm/s, so Stribeck friction is seen at reversals only")
    return gaps
