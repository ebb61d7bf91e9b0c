"""The inverse dynamic model as a linear regression: equations (5), (12)-(17) of the paper, with (15) corrected.

``G_tau u = M qdd + F_v qd + F_c sign(qd) + offset`` (symmetric) or with both friction parameters by sign of the
velocity (asymmetric). Columns are built at the record's rate and then brought to the regression's rate one by one.

:class:`Filtered` is a record after its filter chain, ready for a regression.

:func:`chosen_cutoff` takes the cut-off from the record. A zero-phase filter smears friction at rest over one and a half
periods of its cut-off, and these rows are left out: a low cut-off costs rows, first those with acceleration beside the
reversals. A high cut-off passes encoder noise, which the second derivative amplifies. So the lowest cut-off that keeps
nearly all of the motion is chosen, or a lower one where the noise would matter. The choice depends on motion and
encoder, not on friction or sampling; on the force only where noise would hide the mass.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from emps_design.effects import Motion
from emps_design.errors import InputError, RankError
from emps_design.identification.filters import (
    BLOCK,
    HIGHEST,
    at_rest,
    away_from,
    encoder_variance,
    held,
    known,
    low_pass,
    motion,
)
from emps_design.identification.model import Model
from emps_design.records import Record
from emps_design.units import LINEAR, Units

FEWEST_STEPS = 100  # away from rest, for statistics that leave rest out

# Columns of unit length are dependent where their smallest singular value is below this share of the largest.
RANK_TOLERANCE = 1e-7
NO_FORCE = 1e-6  # of the residual: a smaller force is the filter's ringing after the motor was switched off

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


def baseline_columns(motion: Motion) -> np.ndarray:
    """Columns of mass, viscous, coulomb and constant force, shape (n, 4): ``columns @ b`` is the baseline's force.

    >>> still = Motion(*(np.zeros(3) for _ in range(5)), period=1.0)
    >>> baseline_columns(still)[0].tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    return np.column_stack(list(Model().columns(motion)))


def with_predicted_force(motion: Motion, baseline: np.ndarray) -> Motion:
    """Return ``motion`` with ``tau`` as the baseline array ``b`` (mass, viscous, coulomb, offset) predicts it."""
    return replace(motion, tau=baseline_columns(motion) @ np.asarray(baseline, dtype=float))


def regression(filtered: Filtered, model: str | Model) -> tuple[np.ndarray, np.ndarray]:
    """W (n, p) and Y (n,) of (5) at the regression's rate; Y includes a measured external force (21).

    Unused rows (``filtered.used``) are zero, so that the others keep their distance in time.
    """
    model = Model.of(model)
    # Column by column: memory is allocated when a column is written.
    W = np.empty((len(filtered.used), len(model.names)), order="F")
    for i, column in enumerate(model.columns(filtered.motion)):
        np.multiply(filtered.reduce(column), filtered.used, out=W[:, i])
        del column  # before the next one is made
    force = filtered.force if filtered.f_ext is None else filtered.force + filtered.f_ext
    return W, force * filtered.used


@dataclass(frozen=True)
class LeastSquares:
    """Least-squares solution of Y = W X + e, with the statistics of (13)-(16).

    ``value`` and ``std`` (p,), ``covariance`` (p, p) by (15), corrected to ``s^2 (W^T W)^-1``; ``residual`` (n,) [N].
    """

    names: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray = field(repr=False)
    rms_error: float
    relative_error_percent: float
    condition_number: float

    @classmethod
    def of(
        cls, names: tuple[str, ...], value: np.ndarray, spread: np.ndarray, residual: np.ndarray, force: np.ndarray,
        rows: int, condition_number: float,
    ) -> LeastSquares:  # fmt: skip
        """The solution ``value`` (p,) from ``rows`` rows of ``force`` (n,); ``spread`` (p, p) times (14) is (15)."""
        square = float(residual @ residual)
        return cls(
            names, value, square / (rows - len(names)) * spread, residual, float(np.sqrt(square / rows)),
            relative_error(residual, force), condition_number,
        )  # fmt: skip

    @property
    def std(self) -> np.ndarray:
        """One standard deviation by (15), for errors that are independent from sample to sample."""
        return np.sqrt(np.diag(self.covariance))


def least_squares(
    W: np.ndarray, Y: np.ndarray, names: tuple[str, ...], used: np.ndarray | None = None, units: Units = LINEAR
) -> LeastSquares:
    """Solve (17) by least squares; :class:`RankError` names linearly dependent columns, in the words of ``units``.

    ``used`` (n,) marks the rows that count; the others are zero.

    >>> fit = least_squares(np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]), np.array([1.0, 3.0, 5.0]), ("a", "b"))
    >>> fit.value.round(6).tolist()
    [1.0, 2.0]
    """
    n, p = (len(W) if used is None else int(used.sum())), W.shape[1]
    if n <= p:
        raise InputError(f"regression: found {n} rows for {p} parameters, expected more; record longer")
    r = _triangle(W, Y)
    r, target = r[:p, :p], r[:p, p]
    check_rank(r, names, units)
    value = np.linalg.solve(r, target)
    inverse = np.linalg.inv(r)
    return LeastSquares.of(names, value, inverse @ inverse.T, Y - W @ value, Y, n, float(np.linalg.cond(r)))


def _triangle(W: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Triangular factor of ``[W Y]``, block by block of rows, so that Q is never in memory."""
    r = np.zeros((0, W.shape[1] + 1))
    for start in range(0, len(W), BLOCK):
        block = slice(start, start + BLOCK)
        # An array in this mode; numpy's annotation covers the other modes too.
        r = np.asarray(np.linalg.qr(np.vstack([r, np.column_stack([W[block], Y[block]])]), mode="r"))
    return r


def relative_error(residual: np.ndarray, force: np.ndarray) -> float:
    """100 ||residual|| / ||force|| [%]; NaN where the force is negligible beside the residual (motor off).

    >>> relative_error(np.ones(4), np.full(4, 2.0)), relative_error(np.ones(4), np.full(4, 1e-60))
    (50.0, nan)
    """
    error, norm = float(np.linalg.norm(residual)), float(np.linalg.norm(force))
    return 100.0 * error / norm if norm > NO_FORCE * error else float("nan")


def check_rank(W: np.ndarray, names: tuple[str, ...], units: Units = LINEAR) -> None:
    """Raise :class:`RankError`, which names the linearly dependent columns of ``W`` or of its triangular factor.

    >>> W = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, 1.0]])
    >>> check_rank(W, ("coulomb", "constant_force"))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    emps_design.errors.RankError: the record cannot tell apart: coulomb, constant_force; record motion that ...
    """
    length = np.linalg.norm(W, axis=0)
    empty = tuple(name for name, size in zip(names, length, strict=True) if size == 0)
    if empty:
        raise RankError(
            f"the record does not excite: {', '.join(map(units.word, empty))}; record motion in both directions, with "
            "acceleration",
            empty,
        )
    _, singular, right = np.linalg.svd(np.linalg.qr(W / length, mode="r"))
    if singular[-1] < RANK_TOLERANCE * singular[0]:
        tied = tuple(name for name, weight in zip(names, np.abs(right[-1]), strict=True) if weight > 0.05)
        raise RankError(
            f"the record cannot tell apart: {', '.join(map(units.word, tied))}; record motion that reverses, at "
            "several speeds, with acceleration, or leave one of them out",
            tied,
        )


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
    force = low_pass(held(record.u), cutoff_hz, record.period)[rows]
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
    from scipy.signal import welch

    part, lowest, top = _cutoff_range(record)

    def balance(frequency: float) -> tuple[np.ndarray, np.ndarray]:
        W = np.column_stack(list(model.columns(motion(part, frequency))))
        return W, low_pass(held(part.u), frequency, part.period)

    W, force = balance(cutoff_hz)
    rows = away_from(at_rest(part), cutoff_hz, part.period)
    value = np.linalg.lstsq(W[rows], force[rows], rcond=None)[0] if rows.any() else np.zeros(W.shape[1])
    W, force = balance(top)
    length = min(len(force), int(FEWEST_PERIODS / 2 / lowest / part.period))
    frequency, residual_power = welch(force - W @ value, 1.0 / part.period, nperseg=length)
    _, whole = welch(force, 1.0 / part.period, nperseg=length)
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
