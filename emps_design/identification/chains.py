"""From a record to equally filtered motion and force: the cut-off, three filter chains, and what the axis accounts for.

:class:`Filtered` is a record after its filter chain, ready for a regression. Each chain is described in its text.

:func:`chosen_cutoff` takes the cut-off from the record. A zero-phase filter smears friction at rest over one and a half
periods of its cut-off, and these rows are left out: a low cut-off costs rows, first those with acceleration beside the
reversals. A high cut-off passes encoder noise, which the second derivative amplifies. So the lowest cut-off that keeps
nearly all of the motion is chosen, or a lower one where the noise would matter. The choice depends on motion and
encoder, not on friction or sampling; on the force only where noise would hide the mass.

:func:`filter_record` also removes what the axis file already gives: the drive's effect on the voltage, and known
effects.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.effects import Motion
from emps_design.errors import InputError, RecordError, nearest_name
from emps_design.identification.filters import (
    DECIMATION,
    HIGHEST,
    REACH,
    SLOW,
    at_rest,
    away_from,
    central_difference,
    decimate,
    decimated_rows,
    encoder_variance,
    held_force,
    known,
    low_pass,
    median_of_three,
    motion,
    share_of_nyquist,
)
from emps_design.identification.model import Model, baseline_columns, with_predicted_force
from emps_design.observer import effects_force, with_acting_command
from emps_design.records import Record
from emps_design.units import LINEAR, Units

FEWEST_STEPS = 100  # away from rest, for statistics that leave rest out

STEP = 2.0**0.25  # ratio of two cut-offs that are tried
FEWEST_PERIODS = 20  # of the lowest cut-off, in the record
# Shares that a cut-off keeps: of the rows that are not slow, and of the acceleration's power.
HARDLY, LEAST, ENOUGH = (0.1, 0.05), (0.75, 0.5), (0.9, 0.8)
NOISE = 2e-4  # of the acceleration's power: encoder noise that may bias the mass
QUIET, NOISY = 0.01, 0.03  # of the mass: bias by noise at the reference cut-off, and at the chosen one
CHANCE = 0.5  # of the mass's deviation, up to which noise does not matter
FEWEST_INDEPENDENT = 80  # rows away from rest, two in a period of the cut-off
LONGEST = 120_000  # samples of a record that the choice looks at
RULE = (  # {mass}: the word of the axis
    f"lowest cut-off with {100 * ENOUGH[0]:.0f} % of the rows that are not slow and {100 * ENOUGH[1]:.0f} % of the "
    f"acceleration's power away from rest, or, where the encoder is noisier than {100 * NOISE:g} % of that power, "
    f"down to {100 * LEAST[0]:.0f} % and {100 * LEAST[1]:.0f} %; lower where noise would take more than "
    f"{100 * NOISY:g} % of the {{mass}} away"
)

REPORT_CUTOFF = 100.0  # Hz, five times the 20 Hz band of interest of the 2019 report
REPORT_DROPPED = 49  # first samples, spoilt by the ends of filter and differences
FEWEST_ROWS = 160  # away from rest, eight in a period of the cut-off, for a regression that leaves rest out
LONG = 1_000_000  # samples: longer records keep as few rows as possible


@dataclass(frozen=True)
class Filtered:
    """A record after its filter chain.

    ``motion`` has one row for each kept sample of the record (none once W is computed); ``reduce`` brings such a column
    to the rate of the regression. At that rate are ``t`` [s], ``force`` [N], ``f_ext`` [N], and the masks ``used``, for
    rows that count, and ``away``, for rows away from rest; ``period`` [s] is the time between two rows. ``cutoff_hz``
    [Hz] is the low-pass of the position (None: the chain has none), ``band_hz`` [Hz] the bandwidth of the regression.
    """

    chain: str
    motion: Motion = field(repr=False)
    t: np.ndarray = field(repr=False)
    force: np.ndarray
    f_ext: np.ndarray | None
    reduce: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    used: np.ndarray = field(repr=False)
    away: np.ndarray = field(repr=False)
    period: float
    cutoff_hz: float | None
    band_hz: float
    text: str

    def without_motion(self) -> Filtered:
        """A copy without the motion, three columns of the whole record, which are not needed once W is computed."""
        none = np.zeros(0)
        return replace(self, motion=Motion(none, none, none, none, none, self.motion.period))

    @property
    def resolved_steps(self) -> int:
        """Rows in half a period of the band's upper end: the least distance of independent rows."""
        return max(1, round(0.5 / (self.band_hz * self.period)))

    @property
    def independent_rows(self) -> tuple[int, np.ndarray]:
        """Distance of independent rows, and the mask (n,) of those that count in the statistics: away from rest."""
        steps, away = self.resolved_steps, self.used & self.away
        return steps, away if int(away[::steps].sum()) >= FEWEST_STEPS else self.used


def chosen_cutoff(record: Record) -> float:
    """The lowest cut-off [Hz] that keeps :data:`ENOUGH` of the motion; lower where encoder noise requires it.

    It keeps at least :data:`LEAST` of the motion, unless noise would bias the mass by more than :data:`NOISY`. At most
    a fifth of the sampling frequency.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> 50.0 < chosen_cutoff(synthetic_record(machine("emps2019"), laps=1)) < 150.0
    True
    """
    part, lowest, top = _cutoff_range(record)
    tried = np.geomspace(lowest, top, 1 + int(np.log(top / lowest) / np.log(STEP)))

    rest = at_rest(part)

    @cache  # the halvings for the two shares meet at the same cut-offs
    def kept(index: int) -> tuple[float, float, float]:
        """Away from rest: share of the rows that are not slow, share of the acceleration's power, number of periods."""
        power = motion(part, float(tried[index])).a
        there = known(part, power, tried[index])
        np.square(power, out=power)
        away = away_from(rest, tried[index], part.period) & there
        edge = int(1.0 / (tried[index] * part.period))
        periods = float(away[edge : len(away) - edge].sum() * part.period * tried[index])
        rows = float(away.sum()) / max(int((there & ~rest).sum()), 1)
        return rows, float(power[away].sum()) / max(float(power[there].sum()), 1e-300), periods

    def keeps(index: int, shares: tuple[float, float]) -> bool:
        rows, inside, periods = kept(index)
        return periods >= FEWEST_PERIODS and rows >= shares[0] and inside >= shares[1]

    # Both shares grow with the cut-off, so the first sufficient one is found by bisection.
    least, enough = (
        float(tried[bisect_left(range(len(tried) - 1), True, key=partial(keeps, shares=shares))])
        for shares in (LEAST, ENOUGH)
    )
    power = float(np.mean(motion(part, least).a ** 2))
    # Where encoder noise, which grows with the fifth power of the cut-off, reaches its share of the acceleration.
    quiet = float((NOISE * power / max(acceleration_noise(part, 1.0), 1e-300)) ** 0.2)
    chosen = float(np.clip(quiet, least, enough))

    # Motion hidden by noise is no loss: lower, until noise matters less than chance, or to where both matter least.
    masses = [_mass_at(part, rest, chosen)]
    index = bisect_left(tried, chosen, hi=len(tried) - 1)
    while masses[-1].noise > max(QUIET, CHANCE * masses[-1].chance) and index > 0 and keeps(index - 1, HARDLY):
        index -= 1
        masses.append(_mass_at(part, rest, float(tried[index])))
    surest = min(masses, key=lambda estimate: float(np.hypot(estimate.noise, estimate.chance)))
    taken = next(
        estimate for estimate in masses if min(estimate.noise, abs(estimate.mass / surest.mass - 1.0)) <= NOISY
    )
    return float(f"{taken.cutoff:.3g}")


class _Mass(NamedTuple):
    """The ``mass`` by least squares at a ``cutoff`` [Hz]; its relative bias by ``noise`` and relative deviation."""

    cutoff: float
    mass: float
    noise: float
    chance: float


def _mass_at(record: Record, rest: np.ndarray, cutoff_hz: float) -> _Mass:
    """The mass at this cut-off, in units of the command; with infinite ``chance`` where too few rows are left.

    Noise in a column lowers its parameter by its share in the part of the column that the others do not explain.
    """
    rows = away_from(rest, cutoff_hz, record.period)
    independent = 2.0 * cutoff_hz * record.period * int(rows.sum())
    if independent < FEWEST_INDEPENDENT:
        return _Mass(cutoff_hz, 1.0, 0.0, np.inf)
    W = baseline_columns(motion(record, cutoff_hz))[rows]
    force = held_force(record, 1.0, cutoff_hz)[rows]
    (mass, *_), squares, rank, _ = np.linalg.lstsq(W, force, rcond=None)
    if rank < W.shape[1] or not mass * squares.sum():
        return _Mass(cutoff_hz, 1.0, 0.0, np.inf)
    own = 1.0 / float(np.linalg.inv(W.T @ W)[0, 0]) / len(W)
    chance = float(np.sqrt(squares.sum() / len(W) / (independent * own))) / abs(float(mass))
    return _Mass(cutoff_hz, float(mass), acceleration_noise(record, cutoff_hz) / own, chance)


def acceleration_noise(record: Record, cutoff_hz: float) -> float:
    """Power of encoder noise in the acceleration below ``cutoff_hz`` [Hz], [m^2/s^4].

    White noise of variance s^2 has the power 2 s^2 T (2 pi)^4 f^5 / 5 in the second derivative below f.
    """
    return 2.0 * encoder_variance(record) * record.period * (2.0 * np.pi) ** 4 * cutoff_hz**5 / 5.0


def explained_by_frequency(record: Record, cutoff_hz: float, model: Model, units: Units = LINEAR) -> dict[str, Any]:
    """Share of the force's power that the inverse ``model`` explains, in bands of a third of an octave.

    The parameters are those at ``cutoff_hz`` [Hz]; the dictionary also holds this cut-off and the rule that chose it.
    """
    part, lowest, top = _cutoff_range(record)

    def balance(frequency: float) -> tuple[np.ndarray, np.ndarray]:
        W = np.column_stack(list(model.columns(motion(part, frequency))))
        return W, held_force(part, 1.0, frequency)

    W, force = balance(cutoff_hz)
    rows = away_from(at_rest(part), cutoff_hz, part.period)
    value = np.linalg.lstsq(W[rows], force[rows], rcond=None)[0] if rows.any() else np.zeros(W.shape[1])
    W, force = balance(top)
    length = min(len(force), int(FEWEST_PERIODS / 2 / lowest / part.period))
    frequency, residual_power = scipy.signal.welch(force - W @ value, 1.0 / part.period, nperseg=length)
    _, whole = scipy.signal.welch(force, 1.0 / part.period, nperseg=length)
    centre = np.geomspace(lowest, top, 1 + int(6 * np.log2(top / lowest)))
    bands = [np.abs(np.log2(np.maximum(frequency, 1e-12) / middle)) <= 1 / 6 for middle in centre]
    explained = [1.0 - float(residual_power[b].sum()) / max(float(whole[b].sum()), 1e-300) for b in bands]
    return {
        "cutoff_hz": cutoff_hz,
        "rule": RULE.format(mass=units.word("mass")),
        "frequency_hz": centre.round(3).tolist(),
        "explained": np.round(explained, 4).tolist(),
    }


def _cutoff_range(record: Record) -> tuple[Record, float, float]:
    """The part of ``record`` that is used for the choice, and the lowest and highest cut-off [Hz] to try."""
    part = first_part(record)
    top = HIGHEST / part.period
    return part, min(FEWEST_PERIODS / part.duration, 0.5 * top), top


def first_part(record: Record) -> Record:
    """``record``, or the first :data:`LONGEST` samples of a longer one."""
    return record.part(0, LONGEST, record.name) if len(record) > LONGEST else record


def report_chain(record: Record, force_gain: float, cutoff_hz: float | None = None) -> Filtered:
    """The chain of the 2019 report, which its tables were computed with.

    Position low-passed at 100 Hz (4th order, forwards and backwards), central differences twice, first 49 samples
    dropped, columns and raw force decimated by 10. The hold is not modelled: it acts as half a sample of delay.
    """
    if cutoff_hz is None:
        if 0.5 / record.period <= REPORT_CUTOFF:
            raise InputError(
                f"{record.name}: sampled at {1 / record.period:g} Hz, the report's low-pass of {REPORT_CUTOFF:g} Hz "
                f"needs more than {2 * REPORT_CUTOFF:g} Hz; use `filter='hold'`, or give `cutoff`"
            )
        cutoff_hz = REPORT_CUTOFF
    q, v, a = np.empty((3, len(record)))  # one block, as in motion()
    q[:] = low_pass(record.q, cutoff_hz, record.period)
    v[:] = central_difference(q, record.period)
    a[:] = central_difference(v, record.period)
    return _decimating(
        "report",
        record,
        (q, v, a),
        force_gain,
        cutoff_hz,
        f"position: Butterworth order 4 at {cutoff_hz:g} Hz, forwards and backwards; central differences; "
        f"first {REPORT_DROPPED} samples dropped; all columns decimated by {DECIMATION}",
    )


def paper_chain(record: Record, force_gain: float, cutoff_hz: float | None = None) -> Filtered:
    """The chain of the 2018 paper, section III-A: medfilt1, decimate, backward and central differences.

    Velocity is the backward difference of the measured position, acceleration the central difference of the filtered
    velocity; a median of three, then decimation by 10 (the paper does not give its factor). ``cutoff_hz`` is refused:
    the chain's low-pass is the decimation's.
    """
    if cutoff_hz is not None:
        raise InputError("cut-off: the paper's chain has none, its low-pass is the decimation's; use `filter='hold'`")
    v = median_of_three(np.diff(record.q, prepend=record.q[0]) / record.period)
    a = median_of_three(central_difference(v, record.period))
    return _decimating(
        "paper",
        record,
        (median_of_three(record.q), v, a),
        force_gain,
        None,
        f"backward difference, median of 3, central difference of that velocity, decimated by {DECIMATION}",
        median_of_three,
    )


def _decimating(
    chain: str,
    record: Record,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    force_gain: float,
    cutoff_hz: float | None,
    text: str,
    smooth: Callable[[np.ndarray], np.ndarray] = lambda signal: signal,
) -> Filtered:
    """The chains that drop the first samples and decimate every column; of the forces after they are ``smooth``."""
    kept = slice(REPORT_DROPPED, None)
    q, v, a = (signal[kept] for signal in motion)
    kept_motion = Motion(record.t[kept], q, v, a, np.zeros(len(q)), record.period, force_gain=force_gain)
    rows = decimated_rows(len(q))
    force = force_gain * decimate(smooth(record.u)[kept])
    band = 0.8 * 0.5 / (DECIMATION * record.period)
    band = band if cutoff_hz is None else min(cutoff_hz, band)
    return Filtered(
        chain=chain,
        motion=kept_motion,
        t=kept_motion.t[rows],
        force=force,
        f_ext=None if record.f_ext is None else decimate(smooth(record.f_ext)[kept]),
        reduce=decimate,
        used=np.ones(len(force), dtype=bool),
        away=away_from(at_rest(record), band, record.period)[kept][rows],
        period=DECIMATION * record.period,
        cutoff_hz=cutoff_hz,
        band_hz=band,
        text=text,
    )


def hold_chain(
    record: Record, force_gain: float, cutoff_hz: float | None = None, fewest_rows: int = FEWEST_ROWS
) -> Filtered:
    """This package's chain: the hold modelled, the same zero-phase low-pass on motion and force, then decimation.

    Rows near rest are left out, for friction at rest is any force up to the break-away force. So are the ends of a
    record that accelerate there, for the filters of motion and force extrapolate differently.
    ``cutoff_hz`` [Hz] defaults to :func:`chosen_cutoff` of the record.
    Raises :class:`RecordError` where fewer than ``fewest_rows`` are left.
    """
    if cutoff_hz is None:
        cutoff_hz = chosen_cutoff(record)
    # Two samples per period of four times the cut-off, above which under 2e-5 of the amplitude is left. Of three times
    # the cut-off in long records, to save memory: under 2e-4.
    often = 4.0 if len(record) <= LONG else 3.0
    factor = max(1, int(1.0 / (often * share_of_nyquist(cutoff_hz, record.period))))
    edge = int(1.0 / (cutoff_hz * record.period))
    rows = slice(edge, len(record) - edge, factor)

    def reduce(column: np.ndarray) -> np.ndarray:
        return column[rows]

    away = away_from(at_rest(record), cutoff_hz, record.period)  # before the motion is made, to save memory
    force = reduce(held_force(record, force_gain, cutoff_hz)).copy()
    f_ext = None if record.f_ext is None else reduce(low_pass(record.f_ext, cutoff_hz, record.period)).copy()
    filtered_motion = replace(motion(record, cutoff_hz), force_gain=force_gain)
    used = reduce(away & known(record, filtered_motion.a, cutoff_hz))
    if int(used.sum()) < fewest_rows:
        raise RecordError(
            f"{record.name}: {int(used.sum())} rows away from rest at a cut-off of {cutoff_hz:g} Hz, expected at least "
            f"{fewest_rows}; record longer strokes"
        )
    return Filtered(
        chain="hold",
        motion=filtered_motion,
        t=reduce(record.t),
        force=force,
        f_ext=f_ext,
        reduce=reduce,
        used=used,
        away=used,
        period=factor * record.period,
        cutoff_hz=cutoff_hz,
        band_hz=cutoff_hz,
        text=f"Butterworth order 4 at {cutoff_hz:g} Hz, forwards and backwards, on motion and held force alike; second "
        f"difference; one sample in {factor}; left out: slower than {100 * SLOW:g} % of the largest velocity, or "
        f"{1e3 * REACH / cutoff_hz:.0f} ms from such a moment",
    )


DEFAULT_CHAIN = "hold"
CHAINS: dict[str, Callable[..., Filtered]] = {"hold": hold_chain, "report": report_chain, "paper": paper_chain}


def filter_record(record: Record, axis: Axis, chain: str, cutoff_hz: float | None = None) -> Filtered:
    """Run ``record`` through ``chain`` and subtract what the drive and the effects of ``axis`` account for.

    The voltage is corrected for delays, lags and maps of the drive, for the supply of a duty cycle, and for samples
    with the motor switched off. The braking force of the back-EMF and the force of effects that have a regressor are
    subtracted from the motor force, computed with the parameters of the axis and, where an effect depends on them,
    its present mechanics. Raises :class:`InputError`, which names the nearest chain.
    """
    if chain not in CHAINS:
        raise InputError(f"`filter`: found {chain!r}, expected {', '.join(CHAINS)}{nearest_name(chain, list(CHAINS))}")
    driven, rest = with_acting_command(axis, record)
    filtered = CHAINS[chain](driven, axis.drive.gain, cutoff_hz)
    if axis.drive.braking:
        on = np.ones(len(record)) if record.enable is None else (record.enable != 0.0).astype(float)
        braked = axis.drive.braking * filtered.motion.v * on[len(record) - len(filtered.motion.v) :]
        filtered = replace(filtered, force=filtered.force - filtered.reduce(braked))
    if not rest.effects:
        return filtered
    moved = with_predicted_force(filtered.motion, axis.mechanics.array())
    return replace(filtered, force=filtered.force - filtered.reduce(effects_force(moved, rest)))
