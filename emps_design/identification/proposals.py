"""Terms beside the friction model that a record calls for, and structure in the residual of a fit.

A fitted term always explains part of the strokes that it was fitted to. So strokes are held out in folds and predicted
from the others. A term is proposed where the error of held-out strokes is at least twice as large without it,
significantly over the strokes, and where it is a relevant part of the force. The same rule holds for every term.

The residual of a fit is noise or structure, and structure repeats with the motion. Noise at one moment is independent
of noise at another. So the residual at a moment is multiplied with its mean at those moments of other strokes at which
position, velocity and acceleration were nearest: on average the product is the square of what repeats (a
nearest-neighbour estimate of the residual variance: E. Liitiainen et al., 2008). Structure that repeats with every
stroke holds no more information in ten strokes than in one, and the intervals are widened accordingly.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.effects.effect import VISCOUS
from emps_design.effects.terms import BENT, HIGHEST, LOWEST, TERMS
from emps_design.errors import RecordError
from emps_design.identification.chains import LONG, Filtered, chosen_cutoff, filter_record, first_part
from emps_design.identification.excitation import check_record, follows
from emps_design.identification.filters import motion
from emps_design.identification.inverse_model import Regression, regression
from emps_design.identification.model import Model, known_part, powered
from emps_design.identification.result import IdentificationRequest
from emps_design.identification.statistics import LongRun
from emps_design.messages import Message, wrong
from emps_design.observer import with_acting_command
from emps_design.records import Record
from emps_design.stretches import stretches
from emps_design.units import LINEAR, Units

STATES = ((0, 1, 2), (1,), (0,))  # columns of position, velocity, acceleration that are compared: all, or one of them
NEIGHBOURS, WITHIN = 6, 64  # moments whose residuals are averaged, out of so many nearest ones
SLOWER = 0.25  # of the cut-off: low-pass for the intended motion where there is no reference
ALIKE = 1e-3  # of the deviation of a state: random tie-break between equal states
MOST_STATES = 0.5  # least share of states with such neighbours
APART = 4.0  # least distance of two compared moments, in correlation times
MOST, SAMPLED, FEWEST_ROWS = 8000, 300, 120  # most rows compared, rows for counting passes, fewest rows
FEWEST_BLOCKS = 12  # independent blocks, to tell structure from chance
CERTAIN = 4.0  # deviations of the mean product from zero
LITTLE = 0.02  # of the force: smaller structure widens the intervals but causes no warning
MUCH = 0.2  # of the force: a larger residual causes a warning, whether it repeats or not

FOLDS = 5  # parts of the record, of successive whole strokes, that are held out in turn
TWICE = 2.0  # least ratio of the errors of held-out strokes without and with a proposed term
LEVEL = 0.01  # significance level of the test over strokes
POWERS = tuple(np.geomspace(LOWEST, HIGHEST, 8).tolist())  # exponents of a bent friction that are tried
FEWEST_STROKES = 3
RESISTS = ("mass", "viscous", "coulomb")  # parameters that cannot be negative, the first of a model


@dataclass(frozen=True)
class Unexplained:
    """The residual of a fit: its rms is ``share`` of the force's rms, and ``structure`` is the part that repeats.

    ``passes`` is how often the record passes the same state; ``widening`` the factor on the deviations.
    """

    share: float
    structure: float
    passes: float
    widening: float

    @property
    def noise(self) -> float:
        """Share of the force's rms that does not repeat."""
        return float(np.sqrt(max(self.share**2 - self.structure**2, 0.0)))

    @property
    def matters(self) -> bool:
        """Whether the residual is large enough for a warning."""
        return self.structure > LITTLE or self.share > MUCH

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "share": self.share,
            "structure": self.structure,
            "noise": self.noise,
            "passes": self.passes,
            "widening": self.widening,
        }

    def warnings(self, units: Units = LINEAR) -> list[Message]:
        """A message with the next step on an axis with ``units``, or [] where the residual is small."""
        if not self.matters:
            return []
        text = f"the model does not explain {100.0 * self.share:.2g} % of the {units.word('force')}"
        if self.structure > LITTLE:
            text += (
                f"; {100.0 * self.structure:.2g} % repeats with the motion, so it is not noise (noise: "
                f"{100.0 * self.noise:.2g} %); the intervals are {self.widening:.2g} times as wide because of it"
            )
        text += "; the model lacks an effect of the machine; next: diagnose, which names it"
        return [wrong("unexplained-force", text, share=self.share, structure=self.structure)]


def unexplained(problem: Regression, residual: np.ndarray, spread: LongRun) -> Unexplained:
    """Compare the ``residual`` (n,) [N] of ``problem`` with itself where the same motion comes again."""
    steps, away = problem.filtered.independent_rows
    every = steps * max(1, -(-len(residual) // steps // MOST))
    rows = np.flatnonzero(away[::every]) * every
    residuals, force = residual[rows], problem.Y[rows]
    share = float(np.linalg.norm(residuals) / max(float(np.linalg.norm(force)), 1e-300))
    none = Unexplained(share, 0.0, 1.0, 1.0)
    if problem.filtered.chain != "hold" or rows.size < FEWEST_ROWS or len(problem.record) > LONG:
        return none
    state = _state(problem)[rows]
    state /= np.maximum(np.std(state, axis=0), 1e-300)
    state += ALIKE * np.random.default_rng(0).standard_normal(state.shape)  # random choice among equal states
    t, power = problem.filtered.t[rows], float(np.mean(residuals**2))
    # Structure is correlated along a stroke too; the distance is limited so that enough blocks remain.
    longest = (t[-1] - t[0]) / (2 * FEWEST_BLOCKS)
    apart = min(APART * max(spread.correlation_time, problem.filtered.period * every), longest)
    best, states = max((_repeated(state[:, columns], residuals, t, apart), columns) for columns in STATES)
    if not best > 0.0:
        return none
    part, passes = min(best / power, 1.0), _passes(state[:, states], t, spread.correlation_time, apart)
    return Unexplained(share, share * part**0.5, passes, float(np.sqrt(1.0 - part + part * passes)))


def _state(problem: Regression) -> np.ndarray:
    """Intended position, velocity and acceleration (n, 3), free of noise that would be correlated with the residual.

    From the reference where the motion follows it, late or not; else from the motion well below the cut-off.
    """
    record, band = problem.record, problem.filtered.band_hz
    late = late_reference(record) if record.q_ref_recorded else record
    if record.q_ref_recorded and follows(late):
        nominal = motion(replace(record, q=late.q_ref), band)
    else:
        nominal = motion(record, SLOWER * band)
    return np.column_stack([problem.filtered.reduce(signal) for signal in (nominal.q, nominal.v, nominal.a)])


def late_reference(record: Record) -> Record:
    """The ``record`` with its reference delayed by the mean lag of the motion.

    >>> t = np.arange(1000) * 1e-3
    >>> record = Record(t=t, q_ref=np.sin(9.0 * t), q=np.sin(9.0 * (t - 0.03)), u=t, period=1e-3)
    >>> follows(record), follows(late_reference(record))
    (False, True)
    """
    speed = np.gradient(record.q_ref, record.period)
    lag = float(speed @ (record.q_ref - record.q)) / max(float(speed @ speed), 1e-300)
    return replace(record, q_ref=np.interp(record.t - max(lag, 0.0), record.t, record.q_ref))


def _repeated(state: np.ndarray, residual: np.ndarray, t: np.ndarray, apart: float) -> float:
    """Power of the part of ``residual`` (n,) that repeats with ``state`` (n, k); 0 where it is not significant."""
    near = scipy.spatial.cKDTree(state).query(state, min(len(state), WITHIN))[1]
    other = np.abs(t[near] - t[:, None]) > apart
    other &= np.cumsum(other, axis=1) <= NEIGHBOURS
    count = other.sum(axis=1)
    known = count > 0
    if np.mean(known) < MOST_STATES:
        return 0.0
    mean = np.where(other, residual[near], 0.0).sum(axis=1)[known] / count[known]
    product = residual[known] * mean
    # Products of noise are independent from one block of time to the next.
    block = np.floor((t[known] - t[0]) / apart).astype(int)
    power = float(product.mean())
    deviation = float(np.sqrt(np.sum(np.bincount(block, product - power) ** 2))) / product.size
    enough = np.unique(block).size >= FEWEST_BLOCKS
    return power if enough and power > CERTAIN * deviation else 0.0


def _passes(state: np.ndarray, t: np.ndarray, time: float, apart: float) -> float:
    """Mean number of passes of the same ``state`` (n, k), within the distance moved in a correlation ``time`` [s]."""
    step = max(1, round(time / float(np.median(np.diff(t)))))
    radius = float(np.median(np.linalg.norm(state[step:] - state[:-step], axis=1)))
    queries = np.arange(0, len(t), max(1, len(t) // SAMPLED))
    times = [np.sort(t[near]) for near in scipy.spatial.cKDTree(state).query_ball_point(state[queries], radius)]
    return float(np.mean([1 + np.sum(np.diff(visits) > apart) for visits in times]))


def proposed_for(record: Record, axis: Axis, request: IdentificationRequest) -> tuple[str, ...]:
    """The terms that ``record`` calls for, at the cut-off of ``request`` or the one chosen from the record."""
    axis = known_part(axis.supplied_by(record), request.model)
    record = check_record(record, axis, request.external_force)
    cutoff = request.cutoff
    if cutoff is None:
        cutoff = chosen_cutoff(with_acting_command(axis, record)[0])
    return proposed_terms(record, axis, request.model, cutoff)


def proposed_terms(record: Record, axis: Axis, friction: str, cutoff: float) -> tuple[str, ...]:
    """The terms that ``record`` calls for beside ``friction``, after the ``hold`` chain with ``cutoff`` [Hz].

    Effects of ``axis`` are not proposed again. All terms are tried together, and dropped one by one while held-out
    strokes are predicted about as well without them.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> proposed_terms(synthetic_record(axis, laps=1), axis, "symmetric", 60.0)
    ()
    """
    allowed = [name for name, term in TERMS.items() if friction != "asymmetric" or not term.symmetric]
    terms = [
        name
        for name in allowed
        if axis.units.motion in TERMS[name].motions and known_part(axis, Model(friction, (name,))) == axis
    ]
    try:
        filtered = filter_record(first_part(record), axis, "hold", cutoff)
    except RecordError:
        return ()  # too little is away from rest: the identification reports it
    strokes = Strokes(filtered, friction)
    if strokes.count < FEWEST_STROKES:
        return ()
    while terms:
        whole = strokes.errors(terms)
        without = {term: strokes.errors([other for other in terms if other != term]) for term in terms}
        idle = [term for term in terms if not strokes.ask_for(whole, without[term])]
        if not idle:
            break
        terms.remove(min(idle, key=lambda term: float(without[term].sum())))
    return tuple(terms)


class Strokes:
    """The strokes of a ``filtered`` record, between its rests, each to be predicted from the others.

    ``bounded``: with non-negative mass and friction.
    """

    def __init__(self, filtered: Filtered, friction: str, bounded: bool = False) -> None:
        self.resists = sum(quantity.name in RESISTS for quantity in Model(friction).quantities) if bounded else 0
        every = filtered.resolved_steps
        bounds = stretches(filtered.used[::every])
        part = np.concatenate([np.arange(start, stop) for start, stop in bounds] or [np.zeros(0, int)])
        self.count = len(bounds)
        self.stroke = np.repeat(np.arange(self.count), [stop - start for start, stop in bounds])
        middle = np.array([0.5 * (start + stop) for start, stop in bounds])
        before = np.searchsorted(part, middle[self.stroke]) / max(len(part), 1)  # share of the rows before its middle
        self.fold = np.minimum((FOLDS * before).astype(int), FOLDS - 1)
        W, Y = regression(filtered, Model(friction))
        self.W, self.Y = W[::every][part], Y[::every][part]

        def rows(columns: Iterable[np.ndarray]) -> np.ndarray:
            return np.column_stack([filtered.reduce(column)[::every][part] for column in columns])

        own, moved = W.shape[1], filtered.motion
        self.beside = {
            term: rows(islice(Model(friction, (term,)).columns(moved), own, None)) for term in TERMS if term != BENT
        }
        self.bent = rows(powered(moved.v, power) for power in POWERS)
        self.rows = rows

    def errors(self, terms: Sequence[str]) -> np.ndarray:
        """Sum of squares (strokes,) [N^2] of the prediction error of each held-out stroke by a model with ``terms``."""
        return self.by_stroke(self.left(terms) ** 2)

    def by_stroke(self, values: np.ndarray) -> np.ndarray:
        """The sum (strokes,) of ``values`` (rows,) over each stroke."""
        return np.bincount(self.stroke, values, self.count)

    def left(self, terms: Sequence[str], others: Sequence[np.ndarray] = (), known: Strokes | None = None) -> np.ndarray:
        """Prediction error (rows,) [N] of held-out rows by a model with ``terms``, fitted to the other folds.

        ``others`` are columns (rows, k) of further forces beside them. With the strokes ``known`` of another record the
        model is fitted to all of those instead.
        """
        if known is not None:
            value, which = known._best_form(known._forms(terms), np.ones(len(known.Y), bool))
            return self.Y - self._forms(terms)[which] @ value
        forms, error = self._forms(terms, others), np.zeros(len(self.Y))
        for fold in np.unique(self.fold):
            out = self.fold == fold
            value, which = self._best_form(forms, ~out)
            error[out] = self.Y[out] - forms[which][out] @ value
        return error

    def residual(self, terms: Sequence[str], others: Sequence[np.ndarray] = ()) -> np.ndarray:
        """Residual (rows,) [N] of a model with ``terms`` and ``others``, fitted to all rows."""
        forms = self._forms(terms, others)
        value, which = self._best_form(forms, np.ones(len(self.Y), bool))
        return self.Y - forms[which] @ value

    def _forms(self, terms: Sequence[str], others: Sequence[np.ndarray] = ()) -> list[np.ndarray]:
        """The regressor (rows, p) with ``terms`` and ``others``; of a bent friction, one with each power."""
        W = np.column_stack([self.W, *(self.beside[term] for term in terms if term != BENT), *others])
        if BENT not in terms:
            return [W]
        return [np.column_stack([W[:, :VISCOUS], bent, W[:, VISCOUS + 1 :]]) for bent in self.bent.T]

    def _best_form(self, forms: list[np.ndarray], rows: np.ndarray) -> tuple[np.ndarray, int]:
        """Solution (p,) of the one of ``forms`` that fits the mask ``rows`` (rows,) best, and its index."""
        tried = [solved(form[rows], self.Y[rows], self.resists) for form in forms]
        squares = [
            float(np.sum((form[rows] @ value - self.Y[rows]) ** 2)) for form, value in zip(forms, tried, strict=True)
        ]
        which = int(np.argmin(squares))
        return tried[which], which

    def ask_for(self, whole: np.ndarray, without: np.ndarray) -> bool:
        """Whether a term is needed: the errors (strokes,) are ``whole`` with it and ``without`` without it."""
        more, power = float(without.sum() - whole.sum()), float(self.Y @ self.Y)
        if without.sum() < TWICE**2 * whole.sum() or more < LITTLE**2 * power:
            return False
        return self.chance(whole, without) < LEVEL

    def chance(self, whole: np.ndarray, without: np.ndarray) -> float:
        """p-value of the mean log ratio of the errors ``without`` and ``whole`` over the strokes (Student's t)."""
        gain = np.log(np.maximum(without, 1e-300)) - np.log(np.maximum(whole, 1e-300))
        deviation = max(float(np.std(gain, ddof=1)) / np.sqrt(self.count), 1e-300)
        return float(scipy.stats.t.sf(float(np.mean(gain)) / deviation, self.count - 1))


def solved(W: np.ndarray, Y: np.ndarray, resists: int = 0) -> np.ndarray:
    """Least-squares solution (p,) of ``W X = Y`` whose first ``resists`` numbers are not negative.

    >>> solved(np.eye(2), np.array([-1.0, -2.0]), 1).tolist()
    [0.0, -2.0]
    """
    value = np.linalg.lstsq(W, Y, rcond=None)[0]
    if not np.any(value[:resists] < 0.0):
        return np.asarray(value)
    lower = np.where(np.arange(W.shape[1]) < resists, 0.0, -np.inf)
    size = np.maximum(np.linalg.norm(W, axis=0), 1e-300)  # scaled: else small numbers are lost in the tolerance
    return np.asarray(scipy.optimize.lsq_linear(W / size, Y, (lower, np.inf), method="bvls").x / size)
