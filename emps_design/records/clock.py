"""One clock for a record: the nominal period of its time column, or samples that are put on a uniform clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.errors import RecordError
from emps_design.messages import Message, note, warning

LARGEST_JITTER = 0.2  # of a period, up to which time is quantised and sampling regular
NOTED_JITTER = 0.01
ON_THE_CLOCK = 1e-3  # of a period, up to which two periods are equal: time stamps jitter
SHORTEST_PERIOD, LONGEST_PERIOD = 1e-6, 0.1  # s
GAP = 10.5  # periods without a sample: more than a lost telegram or two
MOST_BRIDGED = 0.5  # of a record, largest share of its gaps
STEPWISE = ("enable", "bridged")  # on or off, never interpolated
MISSING = 2.5  # periods without a sample: some are missing


@dataclass(frozen=True)
class Resampled:
    """``signals`` on a uniform clock of ``period`` [s], notes, and the ``measured`` signals at their own times."""

    signals: dict[str, np.ndarray]
    period: float
    notes: tuple[Message, ...]
    measured: dict[str, np.ndarray]


def steps_of(t: np.ndarray, source: str, first_row: int) -> tuple[float, np.ndarray]:
    """Median step [s] of the time column ``t`` (n,) [s], and the difference (n - 1,) of each step to it.

    Raises :class:`RecordError` where time does not increase, or for a period outside the allowed range.
    """
    step = np.diff(t)
    if float(np.min(step)) <= 0:
        i = int(np.argmax(step <= 0))
        what = "the same time twice" if step[i] == 0 else "time going backwards"
        raise RecordError(
            f"{source}: column t, row {first_row + i + 1}: found {what} ({t[i]:.9g} s, then {t[i + 1]:.9g} s), "
            "expected increasing time; delete a row that is written twice, and take one run at a time with `window`"
        )
    typical = float(np.median(step, overwrite_input=True))
    if not SHORTEST_PERIOD <= typical <= LONGEST_PERIOD:
        raise RecordError(
            f"{source}: column t: found a sampling period of {typical:.6g} s, expected {SHORTEST_PERIOD:g} to "
            f"{LONGEST_PERIOD:g} s; if time is in ms or a sample count, convert it or title it 't [ms]'"
        )
    np.subtract(t[1:], t[:-1], out=step)
    step -= typical
    return typical, step


def on_one_clock(
    signals: dict[str, np.ndarray], wanted: float | None, source: str, first_row: int, resample: bool = True
) -> tuple[float, tuple[Message, ...], Resampled | None]:
    """The period [s] of ``signals`` by name, notes, and the signals resampled where their time is irregular.

    They get the ``wanted`` period [s], or their own; without ``resample`` irregular time raises :class:`RecordError`.
    In the gaps of a record the signals are interpolated linearly, and ``bridged`` is 1.
    """
    t = signals["t"]
    typical, away = steps_of(t, source, first_row)
    jitter = float(np.sqrt(np.mean(np.square(away, out=away)))) / typical
    period = nominal(float(t[-1] - t[0]) / away.size)
    quantised = np.max(away) <= (LARGEST_JITTER * typical) ** 2
    on_the_clock = jitter <= NOTED_JITTER or wanted is None or same_period(period, wanted)
    if quantised and on_the_clock:
        if not jitter > NOTED_JITTER:
            return period, (), None
        text = f"t: sampling jitter of {100 * jitter:.2g} % rms of the period"
        return period, (warning("sampling-jitter", text, column="t", jitter=jitter),), None
    digit = _rounded_to(t, period)
    if digit:
        text = f"t: time stamps rounded to {digit:g} s, interpreted as a sample every {period:.6g} s"
        return period, (note("rounded-time", text, column="t", digit=digit, period=period),), None
    i = int(np.argmax(away > (LARGEST_JITTER * typical) ** 2))
    if not resample:
        raise RecordError(
            f"{source}: column t, row {first_row + i + 1}: found a step of {t[i + 1] - t[i]:.6g} s, expected "
            f"{typical:.6g} s as elsewhere; sampling must be uniform unless it is resampled"
        )
    del away
    bridges = _bridges(t, typical, source, first_row)
    resampled = _resampled(signals, wanted, typical, bridges)
    return resampled.period, resampled.notes, resampled


def _rounded_to(t: np.ndarray, period: float) -> float:
    """The decimal [s] to which the time stamps ``t`` (n,) of a clock of ``period`` [s] were rounded; 0 for none.

    It is at most half a period: a coarser one would hide missing samples.

    >>> _rounded_to(np.round(0.00025 * np.arange(9), 4), 0.00025), _rounded_to(np.array([0.0, 0.1, 0.3]), 0.15)
    (0.0001, 0.0)
    """
    for digit in 10.0 ** -np.arange(9):
        if np.all(np.abs(t / digit - np.rint(t / digit)) < 1e-4):
            apart = np.ptp(t - period * np.arange(t.size))
            return float(digit) if digit <= 0.5 * period and apart <= digit * (1.0 + 1e-6) else 0.0
    return 0.0


def same_period(period: float, other: float) -> bool:
    """Whether two sampling periods [s] agree within a thousandth, the accuracy of time stamps.

    >>> same_period(0.0033338, 1.0 / 300.0), same_period(1e-3, 1.002e-3)
    (True, False)
    """
    return abs(period / other - 1.0) < ON_THE_CLOCK


def nominal(period: float) -> float:
    """The period [s] rounded to three digits, of itself or of its rate, if within 1e-4; else ``period``.

    >>> nominal(0.00100000802), nominal(0.0003333333), nominal(0.0012365)
    (0.001, 0.0003333333333333333, 0.0012365)
    """
    for value in (float(f"{period:.3g}"), 1.0 / float(f"{1.0 / period:.3g}")):
        if abs(period / value - 1.0) < 1e-4:
            return value
    return period


def no_gap(t: np.ndarray, typical: float, source: str, first_row: int) -> None:
    """Raise :class:`RecordError` for a time column ``t`` [s] of ``typical`` steps [s] that has a gap."""
    gaps = np.flatnonzero(np.diff(t) > GAP * typical)
    if gaps.size:
        raise _with_gaps(t, gaps, typical, source, first_row)


def _bridges(t: np.ndarray, typical: float, source: str, first_row: int) -> np.ndarray:
    """The rows before the gaps of ``t`` [s]; raises :class:`RecordError` where the gaps are more than half of it."""
    step = np.diff(t)
    gaps = np.flatnonzero(step > GAP * typical)
    if float(step[gaps].sum()) > MOST_BRIDGED * float(t[-1] - t[0]):
        raise _with_gaps(t, gaps, typical, source, first_row)
    return gaps


def _with_gaps(t: np.ndarray, gaps: np.ndarray, typical: float, source: str, first_row: int) -> RecordError:
    i = int(gaps[0])
    more = f" ({gaps.size} such gaps)" if gaps.size > 1 else ""
    return RecordError(
        f"{source}: column t, row {first_row + i + 1}: nothing from {t[i]:.6g} s to {t[i + 1]:.6g} s{more}, "
        f"expected a sample every {typical:.4g} s; emps-design import --time A:B takes a part without it"
    )


def _resampled(signals: dict[str, np.ndarray], wanted: float | None, typical: float, bridges: np.ndarray) -> Resampled:
    """``signals`` on a uniform clock by linear interpolation: ``wanted`` [s], or their own period if far from it."""
    t = signals["t"]
    step = np.diff(t)
    mean = (float(t[-1] - t[0]) - float(step[bridges].sum())) / (step.size - bridges.size)
    period = wanted if wanted and 0.5 <= wanted / mean <= 1.5 else _own_period(step, typical, mean)
    grid = np.arange(int(np.floor((t[-1] - t[0]) / period * (1 + 1e-12))) + 1) * period
    at = grid + t[0]
    new = {name: grid if name == "t" else between_samples(name, t, values, at) for name, values in signals.items()}
    costs = ", ".join(
        f"{name} {interpolation_error(t, signals[name])[0]:.2g}" for name in ("q", "q_ref", "u") if name in signals
    )
    missing = int(np.count_nonzero(step > MISSING * typical))
    bridged = f"; {missing} of them bridge missing samples" if missing else ""
    text = (
        f"t: irregular, steps of {1e3 * step.min():.4g} to {1e3 * step.max():.4g} ms (median {1e3 * typical:.4g})"
        f"{bridged}; resampled at {1e3 * period:.4g} ms by linear interpolation, off by at most (rms) {costs}"
    )
    notes = [warning("irregular-time", text, column="t", period=period)]
    if bridges.size:
        inside = np.zeros(grid.size)
        for i in bridges:  # from the last sample before a gap to the first after it
            inside[np.searchsorted(at, t[i], side="right") : np.searchsorted(at, t[i + 1])] = 1.0
        new["bridged"] = np.maximum(inside, new.get("bridged", inside))
        i = int(bridges[np.argmax(step[bridges])])
        lost = f"{float(step[bridges].sum()):.3g} s in all"
        text = (
            f"t: nothing from {t[i]:.6g} s to {t[i + 1]:.6g} s"
            f"{f' and in {bridges.size - 1} more gaps, {lost}' if bridges.size > 1 else ''}; used as "
            f"{bridges.size + 1} pieces, without the gaps between them"
        )
        notes.append(warning("time-gap", text, column="t", count=int(bridges.size)))
    return Resampled(new, period, tuple(notes), {name: values.copy() for name, values in signals.items()})


def _own_period(step: np.ndarray, typical: float, mean: float) -> float:
    """The period [s] of a clock that lost samples, whose steps (n,) [s] are multiples of it; else that of the ``mean``.

    >>> step = np.repeat([1e-3, 2e-3], [95, 5])
    >>> _own_period(step, 1e-3, float(step.mean())), _own_period(step + 4e-4 * np.sin(np.arange(100)), 1e-3, 1.051e-3)
    (0.001, 0.00105)
    """
    count = np.rint(step / typical)
    if np.max(np.abs(step - count * typical)) <= LARGEST_JITTER * typical:
        return nominal(float(step.sum()) / float(count.sum()))
    return nominal(float(f"{mean:.3g}"))


def between_samples(name: str, t: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """``values`` (n,) at times ``t`` [s], interpolated linearly at ``at`` (m,); held if ``name`` is a switch."""
    return held(t, values, at) if name in STEPWISE else np.interp(at, t, values)


def held(t: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """``values`` (n,) at the times ``t`` [s], each held until the next, at the times ``at`` (m,)."""
    return values[np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 1)]


def interpolation_error(t: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Bound on the error of linear interpolation between the samples of ``values`` at ``t`` [s]: rms and largest.

    Each sample is predicted from its neighbours. They are twice as far apart as in the interpolation, so the error is
    four times as large where the signal is smooth; noise counts in full. Over a step the error is a parabola, with an
    rms of sqrt(8/15) of its peak.

    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> rms, largest = interpolation_error(t, t**2)
    >>> round(1e6 * largest, 2), round(1e6 * rms, 2)
    (25.0, 18.26)
    """
    h = np.diff(t)
    before, after = h[:-1], h[1:]
    share = before / (before + after)
    away = np.abs(values[1:-1] - (values[:-2] * (1.0 - share) + values[2:] * share)) / 4.0
    return float(np.sqrt(8 / 15 * np.mean(np.square(away)))), float(np.max(away))
