"""The cut-off of the filter, chosen from the record: as low as its strokes allow.

A zero-phase filter spreads friction at rest over a period and a half of its cut-off, and what it spreads over is left
out: a low cut-off costs rows, and the acceleration beside the reversals first. A high one lets in the noise of the
encoder, which the second derivative multiplies. So the lowest that keeps nearly all of the motion is chosen, or a
lower one where that noise would be felt. It depends on motion and encoder, not on friction or clock; on the force only
where noise would hide the mass.
"""

from __future__ import annotations

from bisect import bisect_left
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from emps_design.identification.filters import held, low_pass, motion
from emps_design.identification.inverse_model import baseline_columns
from emps_design.identification.model import Model
from emps_design.identification.rests import HIGHEST, at_rest, away_from, encoder_variance, known
from emps_design.records import Record

STEP = 2.0**0.25  # between two cut-offs that are tried
FEWEST_PERIODS = 20  # of the lowest that is tried, in the record
# Shares that a cut-off keeps: of the rows that are not slow, and of the acceleration's power.
HARDLY, LEAST, ENOUGH = (0.1, 0.05), (0.75, 0.5), (0.9, 0.8)
NOISE = 2e-4  # of the acceleration's power, by which the encoder's noise may pull the mass down
QUIET, NOISY = 0.01, 0.03  # of the mass, that noise may take away at the cut-off that judges, and at the one chosen
CHANCE = 0.5  # of the mass's deviation, up to which noise does not matter
FEWEST_INDEPENDENT = 80  # rows away from rest, two in a period of the cut-off
LONGEST = 120_000  # samples that are looked at
RULE = (
    f"lowest cut-off with {100 * ENOUGH[0]:.0f} % of the rows that are not slow and {100 * ENOUGH[1]:.0f} % of the "
    f"acceleration's power away from rest, or, where the encoder is noisier than {100 * NOISE:g} % of that power, "
    f"down to {100 * LEAST[0]:.0f} % and {100 * LEAST[1]:.0f} %; lower where noise would take more than "
    f"{100 * NOISY:g} % of the mass away"
)


def chosen_cutoff(record: Record) -> float:
    """The lowest cut-off [Hz] that keeps :data:`ENOUGH` of the motion; lower where the encoder's noise asks for it.

    No lower than keeps :data:`LEAST` of it, unless noise would take more than :data:`NOISY` of the mass away. At most a
    fifth of the sampling frequency.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> 50.0 < chosen_cutoff(synthetic_record(machine("emps2019"), laps=1)) < 150.0
    True
    """
    part, lowest, top = _looked_at(record)
    tried = np.geomspace(lowest, top, 1 + int(np.log(top / lowest) / np.log(STEP)))

    rest = at_rest(part)

    @cache  # the halvings for the two shares meet at the same cut-offs
    def kept(index: int) -> tuple[float, float, float]:
        """Shares of rows that are not slow and of the acceleration's power, away from rest; periods in these rows."""
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

    # Both shares grow with the cut-off: the first that is enough, by halving.
    least, enough = (
        float(tried[bisect_left(range(len(tried) - 1), True, key=partial(keeps, shares=shares))])
        for shares in (LEAST, ENOUGH)
    )
    power = float(np.mean(motion(part, least).a ** 2))
    chosen = float(np.clip(_quiet(part, power), least, enough))

    # What noise hides is no loss: lower, until noise does less than chance, or as low as both together do least.
    seen = [_mass_at(part, rest, chosen)]
    index = bisect_left(tried, chosen, hi=len(tried) - 1)
    while seen[-1].noise > max(QUIET, CHANCE * seen[-1].chance) and index > 0 and keeps(index - 1, HARDLY):
        index -= 1
        seen.append(_mass_at(part, rest, float(tried[index])))
    surest = min(seen, key=lambda one: float(np.hypot(one.noise, one.chance)))
    taken = next(one for one in seen if min(one.noise, abs(one.mass / surest.mass - 1.0)) <= NOISY)
    return float(f"{taken.cutoff:.3g}")


class _Mass(NamedTuple):
    """The ``mass`` by least squares at a ``cutoff`` [Hz], what share of it noise takes away, and ``chance`` may."""

    cutoff: float
    mass: float
    noise: float
    chance: float


def _mass_at(record: Record, rest: np.ndarray, cutoff_hz: float) -> _Mass:
    """The mass at this cut-off, in the units of the command; without noise where too little of the record is left.

    Noise in a column takes its parameter down by the share of it in what the other columns leave of that one.
    """
    rows = away_from(rest, cutoff_hz, record.period)
    independent = 2.0 * cutoff_hz * record.period * int(rows.sum())
    if independent < FEWEST_INDEPENDENT:
        return _Mass(cutoff_hz, 1.0, 0.0, np.inf)
    W = baseline_columns(motion(record, cutoff_hz))[rows]
    force = low_pass(held(record.u), cutoff_hz, record.period)[rows]
    (mass, *_), left, rank, _ = np.linalg.lstsq(W, force, rcond=None)
    if rank < W.shape[1] or not mass * left.sum():
        return _Mass(cutoff_hz, 1.0, 0.0, np.inf)
    own = 1.0 / float(np.linalg.inv(W.T @ W)[0, 0]) / len(W)
    chance = float(np.sqrt(left.sum() / len(W) / (independent * own))) / abs(float(mass))
    return _Mass(cutoff_hz, float(mass), acceleration_noise(record, cutoff_hz) / own, chance)


def _quiet(record: Record, power: float) -> float:
    """The cut-off [Hz] up to which the encoder's noise is :data:`NOISE` of the acceleration's ``power`` [m^2/s^4]."""
    return float((NOISE * power / max(acceleration_noise(record, 1.0), 1e-300)) ** 0.2)


def acceleration_noise(record: Record, cutoff_hz: float) -> float:
    """Power of the encoder's noise in the acceleration below ``cutoff_hz`` [Hz], [m^2/s^4].

    White noise of variance s^2 has the power 2 s^2 T (2 pi)^4 f^5 / 5 in the second derivative below f.
    """
    return 2.0 * encoder_variance(record) * record.period * (2.0 * np.pi) ** 4 * cutoff_hz**5 / 5.0


def explained_by_frequency(record: Record, cutoff_hz: float, model: Model) -> dict[str, Any]:
    """What share of the force's power the inverse ``model`` explains, in bands of a third of an octave; for reading.

    With the parameters that ``cutoff_hz`` [Hz] gives; the choice and its rule stand beside the curve.
    """
    from scipy.signal import welch

    part, lowest, top = _looked_at(record)

    def balance(frequency: float) -> tuple[np.ndarray, np.ndarray]:
        W = np.column_stack(list(model.columns(motion(part, frequency))))
        return W, low_pass(held(part.u), frequency, part.period)

    W, force = balance(cutoff_hz)
    rows = away_from(at_rest(part), cutoff_hz, part.period)
    value = np.linalg.lstsq(W[rows], force[rows], rcond=None)[0] if rows.any() else np.zeros(W.shape[1])
    W, force = balance(top)
    length = min(len(force), int(FEWEST_PERIODS / 2 / lowest / part.period))
    frequency, left = welch(force - W @ value, 1.0 / part.period, nperseg=length)
    _, whole = welch(force, 1.0 / part.period, nperseg=length)
    centre = np.geomspace(lowest, top, 1 + int(6 * np.log2(top / lowest)))
    bands = [np.abs(np.log2(np.maximum(frequency, 1e-12) / middle)) <= 1 / 6 for middle in centre]
    explained = [1.0 - float(left[b].sum()) / max(float(whole[b].sum()), 1e-300) for b in bands]
    return {
        "cutoff_hz": cutoff_hz,
        "rule": RULE,
        "frequency_hz": centre.round(3).tolist(),
        "explained": np.round(explained, 4).tolist(),
    }


def _looked_at(record: Record) -> tuple[Record, float, float]:
    """The part of ``record`` that is looked at, and the lowest and highest cut-off [Hz] that are tried."""
    part = first_part(record)
    top = HIGHEST / part.period
    return part, min(FEWEST_PERIODS / part.duration, 0.5 * top), top


def first_part(record: Record) -> Record:
    """``record``, or so much of a long one as is looked at."""
    return record.part(0, LONGEST, record.name) if len(record) > LONGEST else record
