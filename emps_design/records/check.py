"""The check of every record: an invalid one is refused with a message of one line, and nothing is repaired.

A position that jumps is refused: it wraps, was reset, or has a bad or missing sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from emps_design.errors import RecordError
from emps_design.messages import Message, note, warning
from emps_design.records.clock import GAP, Resampled, between_samples, held, no_gap, on_one_clock, steps_of
from emps_design.records.columns import OPTIONAL
from emps_design.records.layout import KEYS, LONGEST, NAMED, RECOGNISED, Assignment, Layout, assign
from emps_design.stretches import stretches

BESIDE = np.array([-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6])  # neighbours of an increment; a jump back is left out
BACK = 0.1  # of a jump, within which another reverses it
FASTER = 5.0  # times the neighbours, the least jump: an impact is smaller, a missing sample doubles an increment
ROUGHER = 100.0  # times the usual change from increment to increment
OF_STROKE = 1e-3
PART, STRETCHES = 50_000, 10  # samples in a block, so that no long record is copied; blocks for a typical figure
LOST = 1.5  # least increment over its neighbours where samples are missing: one missing sample doubles it
DUST = 1e-9  # of the stroke
LEAP = 100.0  # times the 99.9 % quantile of the changes of the increments

PLAIN = Layout()  # of a record without an axis: metres and volts, by the names of the contract
SHORTEST = 50  # samples; fewer do not describe an axis
CUT = "take a part of it with import and its `window`, or split it"
NOTED_SATURATION = 0.005  # share of samples
AT_LIMIT = 0.98  # of the limit
IN_STEPS = 0.9  # share of unchanged samples above which a command is set in steps rather than saturated
LARGEST = 1e15  # of any column; the checks would overflow beyond it
# Beyond these a unit is wrong: no single axis is longer, faster or stronger.
LONGEST_STROKE = {"linear": 20.0, "rotary": 1e5}  # m, rad
HIGHEST_SPEED = {"linear": 20.0, "rotary": 2e4}  # m/s, rad/s
HIGHEST_VOLTAGE = 1000.0  # V
HIGHEST = 1e6  # N, N m, and commands other than a voltage
SAME_TIME = 1e-3  # of a period, within which two times are equal
SMALLEST_STROKE = 1e-5  # m, rad
SMALLEST_VOLTAGE = 1e-3  # V


def unwrap(named: dict[str, np.ndarray], assigned: Iterable[Assignment]) -> None:
    """Unwrap, in place, a position and a reference that are ``assigned`` with a modulo, and keep them in the same turn.

    >>> from emps_design.records.layout import Column
    >>> angle = Assignment("q", "angle", "deg", 1.0, "mapped", Column(column="angle", modulo=360.0))
    >>> named = {"q": np.array([358.0, 359.0, 0.0, 1.0])}
    >>> unwrap(named, [angle])
    >>> named["q"].tolist()
    [358.0, 359.0, 360.0, 361.0]
    """
    spans = {
        assignment.name: assignment.entry.modulo * abs(assignment.factor)
        for assignment in assigned
        if assignment.entry is not None and assignment.entry.modulo is not None
    }
    for name, span in spans.items():
        named[name][:] = np.unwrap(named[name], period=span)
    for name, span in spans.items():
        beside = named.get("q" if name == "q_ref" else "q_ref", named[name])
        named[name] += span * np.round((beside[0] - named[name][0]) / span)


def no_jump(q: np.ndarray, t: np.ndarray, unit: str, source: str) -> None:
    """Raise :class:`RecordError` where the position ``q`` (n,) [``unit``] jumps between two samples; ``t`` (n,) [s]."""
    turns = np.concatenate([np.abs(np.diff(part, 2)) for part in _samples_of(q)])
    turns = turns[turns > 0.0]
    floor = max(ROUGHER * float(np.median(turns)) if turns.size else 0.0, OF_STROKE * float(np.ptp(q)))
    for start in range(0, q.size, PART):
        increments = np.abs(np.diff(q[start : start + PART + 1]))
        fast = start + np.flatnonzero(increments > floor)
        own = q[fast + 1] - q[fast]
        places = fast[:, None] + BESIDE
        inside = (places >= 0) & (places < q.size - 1)
        places = np.where(inside, places, 0)
        others = q[places + 1] - q[places]
        beside = inside & (np.abs(others + own[:, None]) > BACK * np.abs(own[:, None]))
        most = np.where(beside, np.abs(others), 0.0).max(axis=1)
        jumps = beside.any(axis=1) & (np.abs(own) > FASTER * most)
        if jumps.any():
            first = int(np.argmax(jumps))
            raise RecordError(
                f"{source}: column q, at {t[fast[first]]:.6g} s: found a jump by {own[first]:.4g} {unit} in one "
                "sample, expected motion; a position that wraps needs its modulo in [record], cut off a bad sample or "
                "a reset of the position"
            )


def nothing_lost(q: np.ndarray, q_ref: np.ndarray, t: np.ndarray, unit: str, source: str) -> None:
    """Raise :class:`RecordError` where position and reference [``unit``] leap ahead at one time: samples are lost."""
    place, size = _leap(q)
    other_place, other = _leap(q_ref)
    if min(size, other) > LEAP and abs(place - other_place) <= 1:
        raise RecordError(
            f"{source}: columns q and q_ref, at {t[place]:.6g} s: found both jump, q by {q[place + 1] - q[place]:.4g} "
            f"{unit}, expected motion; samples are missing there"
        )


def _leap(values: np.ndarray) -> tuple[int, float]:
    """Index of the largest leap ahead, and its size over the 99.9 % quantile of the changes of the increments."""
    away = np.concatenate([_away(np.diff(part)) for part in _samples_of(values)])
    more = away[away > DUST * np.ptp(values)]  # of an axis that mostly rests the quantile would be rounding
    usual = max(float(np.quantile(away, 0.999)), float(np.median(more)) if more.size else 0.0)
    best, place = 0.0, 0
    for start in range(0, values.size, PART):
        increments = np.diff(values[start : start + PART + 3])
        if increments.size < 3:
            break
        before, now, after = increments[:-2], increments[1:-1], increments[2:]
        away = _away(increments)
        # A wrap goes against the motion; a start or stop at speed exceeds one neighbour alone.
        away[(now * (before + after) < 0.0) | (np.abs(now) < LOST * np.maximum(np.abs(before), np.abs(after)))] = 0.0
        k = int(np.argmax(away))
        if away[k] > best:
            best, place = float(away[k]), start + k + 1
    return place, best / usual if usual > 0.0 else 0.0


def _away(increments: np.ndarray) -> np.ndarray:
    """Difference (n - 2,) of each of the inner increments (n,) to the mean of its neighbours."""
    return np.abs(increments[1:-1] - 0.5 * (increments[:-2] + increments[2:]))


def _samples_of(values: np.ndarray) -> list[np.ndarray]:
    """Blocks spread over a long column, for typical figures without a copy of it."""
    step = max(PART, values.size // STRETCHES)
    return [values[start : start + PART] for start in range(0, values.size - 3, step)]


def check_columns(
    columns: dict[str, Any],
    source: str,
    first_row: int = 0,
    period: float = 0.0,
    layout: Layout = PLAIN,
    assigned: Sequence[Assignment] | None = None,
) -> dict[str, Any]:
    """Return the signals of a record from ``columns`` (title to values), or raise :class:`RecordError`.

    ``source`` names the file and ``first_row`` the row of the first sample in messages. ``period`` [s] overrides that
    of the time column. ``assigned`` says which column is which, by default as in ``layout``. ``columns`` is emptied, so
    that no signal of a long record is in memory twice.
    """
    assigned = assign(list(columns), layout, source) if assigned is None else assigned
    n = next(np.size(columns[assignment.title]) for assignment in assigned if assignment.name == "t")
    _fits(n, source, layout.longest)
    # One block for all signals, so that the memory of the columns can be returned to the system.
    signals = iter(np.empty((len(assigned), n)))
    named: dict[str, np.ndarray] = {}
    notes: list[Message] = []
    for assignment in assigned:
        with np.errstate(over="ignore"):  # an overflow is infinite, and refused later
            named[assignment.name] = np.multiply(
                _vector(columns.pop(assignment.title), assignment, n, source), assignment.factor, out=next(signals)
            )
        if assignment.how == NAMED and assignment.factor != 1.0:
            text = f"{assignment.name}: converted from {assignment.unit} to {layout.unit(assignment.name)}"
            notes.append(note("converted-column", text, column=assignment.name, factor=assignment.factor))
        elif assignment.how == RECOGNISED:
            text = f"{assignment.name}: taken from column {assignment.title!r} [{assignment.unit}]"
            notes.append(note("recognised-column", text, column=assignment.name))
    part = slice(0, n) if layout.window is None else _part(named["t"], layout.window, source)
    for column, values in named.items():
        _finite(values[part], column, layout.unit(column), source, first_row + part.start)
    whole = _rows_without_gaps(named, part)
    if whole != slice(0, n):
        columns = {title: values[whole] if np.size(values) == n else values for title, values in columns.items()}
        named = {name: values[whole] for name, values in named.items()}
        first_row, n = first_row + whole.start, whole.stop - whole.start
        part = slice(part.start - whole.start, part.stop - whole.start)
    unwrap(named, assigned)
    late = {assignment.name: assignment.delay for assignment in assigned if assignment.delay}
    _fits(part.stop - part.start, source, LONGEST)
    if late:
        part, delay_notes = _shift(named, late, part, source, first_row + part.start)
        notes += delay_notes
    if layout.window is not None or part != slice(0, n):
        columns = {title: values[part] if np.size(values) == n else values for title, values in columns.items()}
        named = {name: values[part] for name, values in named.items()}
        if layout.window is not None:  # copies, so that the block can be freed
            named = {name: values.copy() for name, values in named.items()}
        first_row, n = first_row + part.start, named["t"].size
    clock_period, clock_notes, resampled = on_one_clock(named, layout.period, source, first_row, layout.resample)
    notes += clock_notes
    if resampled is not None:
        columns = {title: _held(values, named["t"], resampled) for title, values in columns.items()}
        named = resampled.signals
        n = named["t"].size
        _fits(n, source, LONGEST)
    elif (count := len(stretches(named.get("bridged", named["t"]) <= 0.0))) > 1:
        notes.append(warning("pieces", f"t: {count} pieces, without the gaps between them", count=count))
    period = period or clock_period
    recorded, stood_in = _stand_ins(named, period, layout)
    notes += stood_in
    if resampled is not None and "q" not in resampled.measured:
        own = resampled.measured["t"]
        resampled.measured["q"] = np.interp(own - own[0], named["t"], named["q"])
    _moving(named, layout, source)
    if recorded and resampled is None:
        nothing_lost(named["q"], named["q_ref"], named["t"], layout.unit("q"), source)
    no_jump(named["q"], named["t"], layout.unit("q"), source)
    _plausible(named, period, layout, assigned, source)
    named["t"][:] = np.arange(n)
    named["t"] *= period
    return {
        "t": named["t"],
        "q_ref": named["q_ref"],
        "q": named["q"],
        "u": named["u"],
        **{name: named.get(name) for name in OPTIONAL},
        "period": period,
        "extra": columns,
        "warnings": tuple(notes + _notes(named, layout, recorded)),
        "q_ref_recorded": recorded,
        "measured": None if resampled is None else resampled.measured,
    }


def _stand_ins(named: dict[str, np.ndarray], period: float, layout: Layout) -> tuple[bool, list[Message]]:
    """Add substitutes for a missing position or reference to ``named``; return if the reference is recorded, and notes.

    Where no controller needs a reference, a constant one counts as missing.
    """
    notes, why = list[Message](), "not recorded"
    if "q" not in named:
        named["q"] = _integral(named["velocity"], period)
        text = "q: not recorded; replaced by the integral of velocity from 0"
        notes.append(warning("position-from-velocity", text, column="q"))
    if "q_ref" in named and not layout.reference_needed and np.ptp(named["q_ref"]) == 0.0:
        why = f"constant at {named.pop('q_ref')[0]:g} {layout.unit('q')}, no reference of this motion"
    if "q_ref" in named:
        return True, notes
    if "velocity_reference" in named:
        steps = named["velocity_reference"] * period
        steps[0] = named["q"][0]
        named["q_ref"] = np.cumsum(steps)
        text = f"q_ref: {why}; replaced by the integral of velocity_reference from the first position"
        return False, [*notes, note("reference-from-velocity", text, column="q_ref")]
    named["q_ref"] = named["q"].copy()
    return False, [*notes, note("no-reference", f"q_ref: {why}; replaced by q", column="q_ref")]


def _integral(velocity: np.ndarray, period: float) -> np.ndarray:
    """The integral (n,) of ``velocity`` (n,) from 0 on, by the trapezoidal rule.

    >>> _integral(np.array([0.0, 2.0, 2.0]), 0.5).tolist()
    [0.0, 0.5, 1.5]
    """
    q = np.zeros(velocity.size)
    np.cumsum(velocity[1:] + velocity[:-1], out=q[1:])
    q *= 0.5 * period
    return q


def _part(t: np.ndarray, window: tuple[float, float], source: str) -> slice:
    """The samples with a time in ``window`` [s]."""
    inside = np.flatnonzero((t >= window[0]) & (t <= window[1]))
    if not inside.size:
        raise RecordError(
            f"{source}: column t: found {t[0]:.6g} to {t[-1]:.6g} s, expected some of it between {window[0]:g} and "
            f"{window[1]:g} s"
        )
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _rows_without_gaps(named: Mapping[str, np.ndarray], part: slice) -> slice:
    """The rows around ``part`` without a gap in any signal."""
    n = named["t"].size
    start, stop = 0, n
    for values in named.values() if part != slice(0, n) else ():
        lacking = np.flatnonzero(~np.isfinite(values))
        place = int(np.searchsorted(lacking, part.start))
        start = max(start, int(lacking[place - 1]) + 1) if place else start
        stop = min(stop, int(lacking[place])) if place < lacking.size else stop
    return slice(start, stop)


def _shift(
    named: Mapping[str, np.ndarray], late: Mapping[str, float], part: slice, source: str, first_row: int
) -> tuple[slice, list[Message]]:
    """Advance the ``late`` signals (name to delay [s]) within ``part``; return the samples that have them all, notes.

    Values are interpolated from all rows that join the part without a gap, never extrapolated. Raises
    :class:`RecordError` where time has a gap or goes back within the part, or where too few samples remain.
    """
    t = named["t"]
    inside = t[part]
    typical, _ = steps_of(inside, source, first_row)
    no_gap(inside, typical, source, first_row)
    whole = _joined(t, part, typical)
    known = t[whole]
    slack = SAME_TIME * typical
    has_all = np.ones(inside.size, dtype=bool)
    for delay in late.values():
        has_all &= (inside + delay >= known[0] - slack) & (inside + delay <= known[-1] + slack)
    rows = np.flatnonzero(has_all)
    if rows.size < SHORTEST:
        raise RecordError(
            f"{source}: found {rows.size} sample{'' if rows.size == 1 else 's'} left by the delay of "
            f"{' and '.join(late)}, expected at least {SHORTEST}; correct the delay or use a longer part"
        )
    lost = (int(rows[0]), inside.size - 1 - int(rows[-1]))
    part = slice(part.start + lost[0], part.stop - lost[1])
    for name, delay in late.items():  # in place, so that no long signal is in memory twice
        named[name][part] = between_samples(name, known, named[name][whole], t[part] + delay)
    notes = []
    for name, delay in late.items():
        text = f"{name}: read {1e3 * abs(delay):g} ms {'earlier' if delay > 0 else 'later'} than it was recorded"
        notes.append(note("delayed-column", text, column=name, delay=delay))
    for end, count in zip(("first", "last"), lost, strict=True):
        if count:
            many = f"the {end} {count} sample{'' if count == 1 else 's'}"
            text = f"{' and '.join(late)}: not recorded for {many}, left out"
            notes.append(note("ends-left-out", text, column=" and ".join(late), count=count))
    return part, notes


def _joined(t: np.ndarray, part: slice, typical: float) -> slice:
    """The rows around ``part`` as far as time ``t`` [s], with steps ``typical`` [s], has no gap nor goes back."""
    step = np.diff(t)
    ends = (step <= 0.0) | (step > GAP * typical)
    before, after = np.flatnonzero(ends[: part.start]), np.flatnonzero(ends[part.stop - 1 :])
    start = int(before[-1]) + 1 if before.size else 0
    return slice(start, part.stop + int(after[0]) if after.size else t.size)


def _held(values: Any, t: np.ndarray, resampled: Resampled) -> Any:
    """A further column of the file on the new clock, each value held until the next; other objects unchanged."""
    if np.size(values) != t.size or np.asarray(values).dtype.kind not in "buif":
        return values
    return held(t, np.ravel(values), resampled.signals["t"] + t[0])


def _fits(n: int, source: str, most: int) -> None:
    if n > most:
        raise RecordError(f"{source}: found {n} samples, expected at most {most}; {CUT}")
    if n < SHORTEST:
        raise RecordError(f"{source}: found {n} sample{'' if n == 1 else 's'}, expected at least {SHORTEST}")


def _vector(values: Any, assignment: Assignment, n: int, source: str) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype.kind not in "buif":
        raise RecordError(f"{source}: column {assignment.title!r}: found {array.dtype} values, expected real numbers")
    if array.ndim > 1 and array.size != max(array.shape):
        raise RecordError(
            f"{source}: column {assignment.title!r}: found shape {array.shape}, expected one value per sample"
        )
    if array.size != n:
        raise RecordError(
            f"{source}: column {assignment.name}: found {array.size} samples, expected {n} as in column t"
        )
    return array.ravel()


def _finite(values: np.ndarray, column: str, unit: str, source: str, first_row: int) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        advice = "cut the gap out with import and its `window`, or record again"
        if bad[0] == values.size - 1:
            advice = "it is the last row: delete it if the file was cut off there"
        raise RecordError(
            f"{source}: column {column}, row {first_row + bad[0]}: found {values[bad[0]]}, expected a finite number"
            f"{f' ({bad.size} such samples)' if bad.size > 1 else ''}; {advice}"
        )
    for row in (int(np.argmax(values)), int(np.argmin(values))):
        if abs(values[row]) > LARGEST:
            raise RecordError(
                f"{source}: column {column}, row {first_row + row}: found {values[row]:.6g} {unit}, expected "
                f"a magnitude below {LARGEST:g}"
            )


def _moving(named: Mapping[str, np.ndarray], layout: Layout, source: str) -> None:
    for column, what in (("q", "the axis must move"), ("u", "the drive must work")):
        if np.ptp(named[column]) == 0.0:
            raise RecordError(
                f"{source}: column {column}: found {named[column][0]:g} {layout.unit(column)} in every row; {what}"
            )


def _plausible(
    named: Mapping[str, np.ndarray], period: float, layout: Layout, assigned: Sequence[Assignment], source: str
) -> None:
    unit, usual = layout.unit("q"), "mm" if not layout.units.rotary else "deg"
    where = "metres on the load side" if not layout.units.rotary else "radians on the load side"
    hint = {"mm": "in mm: divide it by 1000, or title the column '{0} [mm]'", "deg": "in deg: title it '{0} [deg]'"}
    longest, fastest = LONGEST_STROKE[layout.units.motion], HIGHEST_SPEED[layout.units.motion]
    positions = [column for column in ("q", "q_ref") if column in named]
    mapped = {assignment.name for assignment in assigned if assignment.entry is not None}
    for column in positions:
        stroke = float(np.ptp(named[column]))
        step = np.diff(named[column])
        speed = float(np.quantile(np.abs(step, out=step), 0.99, overwrite_input=True)) / period
        if stroke > longest or speed > fastest:
            excess = f"a stroke of {stroke:.4g} {unit}" if stroke > longest else f"a speed of {speed:.4g} {unit}/s"
            most = f"{longest:g} {unit}" if stroke > longest else f"{fastest:g} {unit}/s"
            why = f"it is probably {hint[usual].format(column)}"
            if np.array_equal(named[column], np.rint(named[column])):
                why = "it is probably in counts: map it in [record], with unit 'counts' and the scale of a count"
            if column in mapped:
                what = KEYS[column] if stroke > longest else f"{KEYS[column]}, or of time,"
                why = f"correct unit or scale of {what} in [record]"
            raise RecordError(f"{source}: column {column}: found {excess}, expected {where} (at most {most}); {why}")
    if len(positions) == 2:
        ratio = float(np.ptp(named["q_ref"]) / np.ptp(named["q"]))
        if ratio > 100.0:
            raise RecordError(
                f"{source}: columns q_ref and q: found ranges of {np.ptp(named['q_ref']):.4g} and "
                f"{np.ptp(named['q']):.4g} {unit}, expected the same unit in both; one is probably "
                f"{hint[usual].format('q_ref')}"
            )
    for column, highest in (("u", HIGHEST_VOLTAGE if layout.unit("u") == "V" else HIGHEST), ("f_ext", HIGHEST)):
        largest = float(np.max(np.abs(named[column]))) if column in named else 0.0
        if largest > highest:
            unit = layout.unit(column)
            milli = f"if it is in m{unit}, title the column '{column} [m{unit}]'"
            hinted = milli if unit in ("V", "A", "N", "N m") else "check its unit and scale"
            raise RecordError(
                f"{source}: column {column}: found {largest:.4g} {unit}, expected at most {highest:g} {unit}; {hinted}"
            )


def _notes(named: Mapping[str, np.ndarray], layout: Layout, recorded: bool) -> list[Message]:
    """Notes on signals that are odd but may be intended."""
    notes = [
        warning("constant-column", f"{column}: constant at {named[column][0]:g} {layout.unit(column)}", column=column)
        for column in (("q_ref", "f_ext") if recorded else ("f_ext",))
        if column in named and np.ptp(named[column]) == 0.0
    ]
    if np.ptp(named["q"]) < SMALLEST_STROKE:
        unit, long = layout.unit("q"), "metres" if not layout.units.rotary else "radians"
        text = f"q: a stroke of only {np.ptp(named['q']):.3g} {unit}; check that it is in {long}"
        notes.append(warning("short-stroke", text, column="q"))
    u = np.abs(named["u"])
    largest = float(np.max(u))
    if largest < SMALLEST_VOLTAGE and layout.unit("u") == "V":
        text = f"u: at most {largest:.3g} V; check that it is in volts"
        notes.append(warning("small-command", text, column="u", largest=largest))
    saturated = int(np.count_nonzero(u >= largest * (1 - 1e-6)))
    cut = np.mean(np.diff(named["u"]) == 0.0) < IN_STEPS or (layout.limit and largest >= AT_LIMIT * layout.limit)
    if cut and saturated > max(NOTED_SATURATION * u.size, 5):
        unit = layout.unit("u")
        extreme = f"{largest:.4g} {unit}".rstrip()
        text = f"u: {100 * saturated / u.size:.3g} % of the samples sit at the extreme of {extreme}: saturated"
        notes.append(warning("saturated-command", text, column="u", share=saturated / u.size, largest=largest))
    return notes
