"""The one check for all: what is not a trustworthy record is refused here, in one line, and nothing is repaired."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from emps_design.errors import RecordError
from emps_design.records.columns import UNITS, Title, read_titles

SHORTEST = 50  # samples; less than this says nothing about an axis
LONGEST = 5_000_000  # samples; keeps what works on a record well under 1 GiB
LARGEST_JITTER = 0.2  # of a period
NOTED_JITTER = 0.01
NOTED_SATURATION = 0.005  # share of samples
SHORTEST_PERIOD, LONGEST_PERIOD = 1e-6, 0.1  # s
LARGEST = 1e15  # of any column; beyond it the checks themselves would overflow
# Beyond these a unit was mistaken: no single axis is longer, faster or stronger.
LONGEST_STROKE = 20.0  # m
HIGHEST_SPEED = 20.0  # m/s
HIGHEST_VOLTAGE = 1000.0  # V
HIGHEST_FORCE = 1e6  # N
SMALLEST_STROKE = 1e-5  # m
SMALLEST_VOLTAGE = 1e-3  # V


def checked(columns: dict[str, Any], source: str, first_row: int = 0, period: float = 0.0) -> dict[str, Any]:
    """Return the signals of a record from ``columns`` (title to values), or raise :class:`RecordError`.

    ``source`` names the file and ``first_row`` the row of the first sample in messages. ``period`` [s] overrules the
    one found in the time column. ``columns`` is emptied on the way: no signal of a long record is in memory twice.
    """
    titles = dict(zip(list(columns), read_titles(list(columns), source), strict=True))
    n = next(np.size(columns[key]) for key, title in titles.items() if title.name == "t")
    _fits(n, source)
    # One block for all signals: memory that is freed beside it goes back, however long the record.
    signals = iter(np.empty((sum(1 for title in titles.values() if title.name), n)))
    named: dict[str, np.ndarray] = {}
    extra: dict[str, Any] = {}
    notes: list[str] = []
    for key, title in titles.items():
        values = columns.pop(key)
        if not title.name:
            extra[title.text] = values
            continue
        with np.errstate(over="ignore"):  # an overflow is infinite, and refused for that
            named[title.name] = np.multiply(_vector(values, title, n, source), title.factor, out=next(signals))
        if title.factor != 1.0:
            notes.append(f"{title.name}: converted from {title.unit} to {UNITS[title.name]}")
    for column, values in named.items():
        _finite(values, column, source, first_row)
    found, jitter_notes = _period(named["t"], source, first_row)
    notes += jitter_notes
    period = period or found
    _moving(named, source)
    _plausible(named, period, source)
    named["t"][:] = np.arange(n)
    named["t"] *= period
    return {
        "t": named["t"],
        "q_ref": named["q_ref"],
        "q": named["q"],
        "u": named["u"],
        "f_ext": named.get("f_ext"),
        "period": period,
        "extra": extra,
        "warnings": tuple(notes + _notes(named)),
    }


def _fits(n: int, source: str) -> None:
    if n > LONGEST:
        raise RecordError(f"{source}: found {n} samples, expected at most {LONGEST}; cut it")
    if n < SHORTEST:
        raise RecordError(f"{source}: found {n} sample{'' if n == 1 else 's'}, expected at least {SHORTEST}")


def _vector(values: Any, title: Title, n: int, source: str) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype.kind not in "buif":
        raise RecordError(f"{source}: column {title.text!r}: found {array.dtype} values, expected real numbers")
    if array.ndim > 1 and array.size != max(array.shape):
        raise RecordError(f"{source}: column {title.text!r}: found shape {array.shape}, expected one value per sample")
    if array.size != n:
        raise RecordError(f"{source}: column {title.name}: found {array.size} samples, expected {n} as in column t")
    return array.ravel()


def _finite(values: np.ndarray, column: str, source: str, first_row: int) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise RecordError(
            f"{source}: column {column}, row {first_row + bad[0]}: found {values[bad[0]]}, expected a finite number"
            f"{f' ({bad.size} such samples)' if bad.size > 1 else ''}; cut the gap out or record again"
        )
    for row in (int(np.argmax(values)), int(np.argmin(values))):
        if abs(values[row]) > LARGEST:
            raise RecordError(
                f"{source}: column {column}, row {first_row + row}: found {values[row]:.6g} {UNITS[column]}, expected "
                f"a magnitude below {LARGEST:g}"
            )


def _period(t: np.ndarray, source: str, first_row: int) -> tuple[float, list[str]]:
    """The nominal period [s] of the time column, which may be quantised: steps of a 1 kHz clock need not be equal."""
    # One array of steps at a time: a record of an hour has 29 MB of them.
    step = np.diff(t)
    if float(np.min(step)) <= 0:
        i = int(np.argmax(step <= 0))
        what = "the same time twice" if step[i] == 0 else "time going backwards"
        raise RecordError(
            f"{source}: column t, row {first_row + i + 1}: found {what} ({t[i]:.9g} s, then {t[i + 1]:.9g} s), "
            "expected increasing time"
        )
    typical = float(np.median(step, overwrite_input=True))
    np.subtract(t[1:], t[:-1], out=step)
    step -= typical
    jitter = float(np.sqrt(np.mean(np.square(step, out=step)))) / typical
    if np.max(step) > (LARGEST_JITTER * typical) ** 2:
        i = int(np.argmax(step > (LARGEST_JITTER * typical) ** 2))
        raise RecordError(
            f"{source}: column t, row {first_row + i + 1}: found a step of {t[i + 1] - t[i]:.6g} s, expected "
            f"{typical:.6g} s as elsewhere; sampling must be uniform: resample, or cut the record there"
        )
    if not SHORTEST_PERIOD <= typical <= LONGEST_PERIOD:
        raise RecordError(
            f"{source}: column t: found a sampling period of {typical:.6g} s, expected {SHORTEST_PERIOD:g} to "
            f"{LONGEST_PERIOD:g} s; if time is in ms or a sample count, convert it or title it 't [ms]'"
        )
    notes = [f"t: sampling jitter of {100 * jitter:.2g} % rms of the period"] if jitter > NOTED_JITTER else []
    return _nominal(float(t[-1] - t[0]) / step.size), notes


def _nominal(period: float) -> float:
    """The round period or round rate that ``period`` is within 1e-4 of, or ``period`` itself.

    >>> _nominal(0.00100000802), _nominal(0.0003333333), _nominal(0.0012365)
    (0.001, 0.0003333333333333333, 0.0012365)
    """
    for nominal in (float(f"{period:.3g}"), 1.0 / float(f"{1.0 / period:.3g}")):
        if abs(period / nominal - 1.0) < 1e-4:
            return nominal
    return period


def _moving(named: Mapping[str, np.ndarray], source: str) -> None:
    for column, what in (("q", "the axis must move"), ("u", "the drive must work")):
        if np.ptp(named[column]) == 0.0:
            raise RecordError(
                f"{source}: column {column}: found {named[column][0]:g} {UNITS[column]} in every row; {what}"
            )


def _plausible(named: Mapping[str, np.ndarray], period: float, source: str) -> None:
    hint = "in mm: divide it by 1000, or title the column '{0} [mm]'"
    for column in ("q", "q_ref"):
        stroke = float(np.ptp(named[column]))
        step = np.diff(named[column])
        speed = float(np.quantile(np.abs(step, out=step), 0.99, overwrite_input=True)) / period
        if stroke > LONGEST_STROKE or speed > HIGHEST_SPEED:
            found = f"a stroke of {stroke:.4g} m" if stroke > LONGEST_STROKE else f"a speed of {speed:.4g} m/s"
            most = f"{LONGEST_STROKE:g} m" if stroke > LONGEST_STROKE else f"{HIGHEST_SPEED:g} m/s"
            raise RecordError(
                f"{source}: column {column}: found {found}, expected metres on the load side (at most {most}); "
                f"it is probably {hint.format(column)}"
            )
    ratio = float(np.ptp(named["q_ref"]) / np.ptp(named["q"]))
    if ratio > 100.0:
        raise RecordError(
            f"{source}: columns q_ref and q: found ranges of {np.ptp(named['q_ref']):.4g} and "
            f"{np.ptp(named['q']):.4g} m, expected the same unit in both; one is probably {hint.format('q_ref')}"
        )
    for column, highest, less in (("u", HIGHEST_VOLTAGE, "mV"), ("f_ext", HIGHEST_FORCE, "mN")):
        largest = float(np.max(np.abs(named[column]))) if column in named else 0.0
        if largest > highest:
            raise RecordError(
                f"{source}: column {column}: found {largest:.4g} {UNITS[column]}, expected at most {highest:g} "
                f"{UNITS[column]}; if it is in {less}, title the column '{column} [{less}]'"
            )


def _notes(named: Mapping[str, np.ndarray]) -> list[str]:
    """What is odd but may be meant."""
    notes = [
        f"{column}: constant at {named[column][0]:g} {UNITS[column]}"
        for column in ("q_ref", "f_ext")
        if column in named and np.ptp(named[column]) == 0.0
    ]
    if np.ptp(named["q"]) < SMALLEST_STROKE:
        notes.append(f"q: a stroke of only {np.ptp(named['q']):.3g} m; check that it is in metres")
    u = np.abs(named["u"])
    largest = float(np.max(u))
    if largest < SMALLEST_VOLTAGE:
        notes.append(f"u: at most {largest:.3g} V; check that it is in volts")
    saturated = int(np.count_nonzero(u >= largest * (1 - 1e-6)))
    if saturated > max(NOTED_SATURATION * u.size, 5):
        notes.append(
            f"u: {100 * saturated / u.size:.2g} % of the samples sit at the extreme of {largest:.4g} V: saturated"
        )
    return notes
