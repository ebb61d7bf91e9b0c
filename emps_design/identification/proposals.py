"""Which terms beside the friction model a record asks for by itself: those without which strokes are not foretold.

A term that is fitted always explains something of the strokes that it was fitted to. So the strokes are held out part
by part, and predicted with what the others say: a term is proposed where the error of held-out strokes is at least
twice as large without it, in one stroke after the other and not by chance, and where it is a part of the force that a
user should know of. One rule for every term; what it asks for is what a machine obviously has.

What a fit leaves of the force, and how much of that comes again wherever the motion does: no noise, but structure.

Noise of one moment says nothing of another. So the residual at a moment is compared with its mean at the moments of
other strokes at which position, velocity and acceleration were nearest: their product is on the average the square of
what repeats (a nearest-neighbour estimate of the residual variance: E. Liitiainen et al., 2008). Structure that repeats
with every stroke tells no more in ten strokes than in one, and the intervals are widened by that.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.effect import VISCOUS
from emps_design.effects.terms import BENT, HIGHEST, LOWEST, TERMS
from emps_design.errors import RecordError
from emps_design.identification.chains import LONG
from emps_design.identification.excitation import check_record, follows
from emps_design.identification.filters import motion
from emps_design.identification.inverse_model import Filtered, chosen_cutoff, first_part, regression
from emps_design.identification.model import Model, powered
from emps_design.identification.problem import Regression, acting, filter_record, known_part
from emps_design.identification.result import Request
from emps_design.identification.statistics import LongRun
from emps_design.records import Record
from emps_design.stretches import stretches

STATES = ((0, 1, 2), (1,), (0,))  # of position, velocity, acceleration: all, or one by which the others are passed over
NEIGHBOURS, WITHIN = 6, 64  # moments whose residuals are averaged, among so many that are nearest
SLOWER = 0.25  # of the cut-off, below which a motion without a reference is what was meant
ALIKE = 1e-3  # of the deviation of a state, within which two are the same
MOST_STATES = 0.5  # of them have such neighbours, at least
APART = 4.0  # correlation times between two moments that are compared, at least
MOST, SAMPLED, FEWEST_ROWS = 8000, 300, 120  # rows that are looked at, or counted, and at least
FEWEST_BLOCKS = 12  # of independent moments, to tell structure from chance
CERTAIN = 4.0  # deviations of the mean product from zero
LITTLE = 0.02  # of the force: structure below it goes without a word, though the intervals hold it
MUCH = 0.2  # of the force: more left is said, whether it repeats or not

FOLDS = 5  # parts of the record, of whole strokes one after the other, that are held out in turn
TWICE = 2.0  # times as large the error of held-out strokes is without a term that is proposed, at least
LEVEL = 0.01  # at which a smaller error in the mean stroke is no chance
POWERS = tuple(np.geomspace(LOWEST, HIGHEST, 8).tolist())  # of a bent friction, that are tried
FEWEST_STROKES = 3
RESISTS = ("mass", "viscous", "coulomb")  # parameters that are nothing at least, the first of a model


@dataclass(frozen=True)
class Unexplained:
    """What a fit leaves of the force: ``share`` of its rms, of which ``structure`` repeats with the motion.

    ``passes`` is how often the record comes by the same state; ``widening`` the factor of the deviations.
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
        """Whether the model lacks something that a user should know of."""
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

    def warnings(self) -> list[str]:
        """What a user should know, and the next step."""
        if not self.matters:
            return []
        message = f"the model leaves {100.0 * self.share:.2g} % of the force unexplained"
        if self.structure > LITTLE:
            message += (
                f", and {100.0 * self.structure:.2g} % comes again with the same motion, so it is no noise (noise: "
                f"{100.0 * self.noise:.2g} %); the intervals are {self.widening:.2g} times as wide for it"
            )
        return [f"{message}: the machine has something that the model lacks; next: diagnose, which names it"]


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
    state += ALIKE * np.random.default_rng(0).standard_normal(state.shape)  # of what is equal, any may be nearest
    t, power = problem.filtered.t[rows], float(np.mean(residuals**2))
    # Structure is correlated along a stroke, too: no longer than leaves enough blocks to tell it from chance.
    longest = (t[-1] - t[0]) / (2 * FEWEST_BLOCKS)
    apart = min(APART * max(spread.correlation_time, problem.filtered.period * every), longest)
    best, states = max((_repeated(state[:, columns], residuals, t, apart), columns) for columns in STATES)
    if not best > 0.0:
        return none
    part, passes = min(best / power, 1.0), _passes(state[:, states], t, spread.correlation_time, apart)
    return Unexplained(share, share * part**0.5, passes, float(np.sqrt(1.0 - part + part * passes)))


def _state(problem: Regression) -> np.ndarray:
    """Position, velocity and acceleration (n, 3) that were meant: what noise does to the motion tells of the noise.

    Those of the reference where the motion follows it, late or not, else of the motion well below the cut-off.
    """
    record, band = problem.record, problem.filtered.band_hz
    late = late_reference(record) if record.q_ref_recorded else record
    if record.q_ref_recorded and follows(late):
        nominal = motion(replace(record, q=late.q_ref), band)
    else:
        nominal = motion(record, SLOWER * band)
    return np.column_stack([problem.filtered.reduce(signal) for signal in (nominal.q, nominal.v, nominal.a)])


def late_reference(record: Record) -> Record:
    """The ``record`` with its reference as late as the motion is behind it on the average.

    >>> t = np.arange(1000) * 1e-3
    >>> record = Record(t=t, q_ref=np.sin(9.0 * t), q=np.sin(9.0 * (t - 0.03)), u=t, period=1e-3)
    >>> follows(record), follows(late_reference(record))
    (False, True)
    """
    speed = np.gradient(record.q_ref, record.period)
    lag = float(speed @ (record.q_ref - record.q)) / max(float(speed @ speed), 1e-300)
    return replace(record, q_ref=np.interp(record.t - max(lag, 0.0), record.t, record.q_ref))


def _repeated(state: np.ndarray, residual: np.ndarray, t: np.ndarray, apart: float) -> float:
    """Power of what repeats in ``left`` (n,) with the ``state`` (n, k), 0 where chance does as much."""
    from scipy.spatial import cKDTree

    near = cKDTree(state).query(state, min(len(state), WITHIN))[1]
    other = np.abs(t[near] - t[:, None]) > apart
    other &= np.cumsum(other, axis=1) <= NEIGHBOURS
    count = other.sum(axis=1)
    known = count > 0
    if np.mean(known) < MOST_STATES:
        return 0.0
    mean = np.where(other, residual[near], 0.0).sum(axis=1)[known] / count[known]
    product = residual[known] * mean
    # The product of noise is independent from one block of time to the next.
    block = np.floor((t[known] - t[0]) / apart).astype(int)
    power = float(product.mean())
    deviation = float(np.sqrt(np.sum(np.bincount(block, product - power) ** 2))) / product.size
    enough = np.unique(block).size >= FEWEST_BLOCKS
    return power if enough and power > CERTAIN * deviation else 0.0


def _passes(state: np.ndarray, t: np.ndarray, time: float, apart: float) -> float:
    """How often the record comes by the same ``state`` (n, k): as near as it moves in its correlation ``time`` [s]."""
    from scipy.spatial import cKDTree

    step = max(1, round(time / float(np.median(np.diff(t)))))
    radius = float(np.median(np.linalg.norm(state[step:] - state[:-step], axis=1)))
    queries = np.arange(0, len(t), max(1, len(t) // SAMPLED))
    times = [np.sort(t[near]) for near in cKDTree(state).query_ball_point(state[queries], radius)]
    return float(np.mean([1 + np.sum(np.diff(visits) > apart) for visits in times]))


def proposed_for(record: Record, axis: Axis, request: Request) -> tuple[str, ...]:
    """The terms that ``record`` asks for where ``request`` leaves them to it, at the cut-off that would be chosen."""
    axis = known_part(axis.supplied_by(record), request.model)
    record = check_record(record, axis, request.external_force)
    cutoff = chosen_cutoff(acting(record, axis)) if request.cutoff is None else request.cutoff
    return proposed_terms(record, axis, request.model, cutoff)


def proposed_terms(record: Record, axis: Axis, friction: str, cutoff: float) -> tuple[str, ...]:
    """The terms that ``record`` asks for beside ``friction``, after the ``hold`` chain with ``cutoff`` [Hz].

    None that ``axis`` has among its effects. All are tried together, and left out one by one while the strokes that
    take no part are predicted as well, or nearly, without.

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
        return ()  # too little is away from rest, which whoever identifies will say
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
    """The strokes of a ``filtered`` record, by the rests between them, each to be predicted from others.

    ``bounded``: by no model in which mass or friction is less than nothing.
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
        """Sum of squares (strokes,) of the error with which each is predicted by a model with ``terms``, [N^2]."""
        return self.by_stroke(self.left(terms) ** 2)

    def by_stroke(self, values: np.ndarray) -> np.ndarray:
        """The sum (strokes,) of ``values`` (rows,) over each stroke."""
        return np.bincount(self.stroke, values, self.count)

    def left(self, terms: Sequence[str], others: Sequence[np.ndarray] = (), known: Strokes | None = None) -> np.ndarray:
        """Error (rows,) [N] with which each row is predicted by what the other parts say of a model with ``terms``.

        ``others`` are columns (rows, k) of further forces beside them. With the strokes ``known`` of another record
        what those say, all together, predicts.
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
        """What a model with ``terms`` and ``others``, fitted to all of them, leaves (rows,) [N]."""
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
        """What ``rows`` (rows,) bool say, (p,), of the one of ``forms`` that leaves least of them, and which it is."""
        tried = [solved(form[rows], self.Y[rows], self.resists) for form in forms]
        squares = [
            float(np.sum((form[rows] @ value - self.Y[rows]) ** 2)) for form, value in zip(forms, tried, strict=True)
        ]
        which = int(np.argmin(squares))
        return tried[which], which

    def ask_for(self, whole: np.ndarray, without: np.ndarray) -> bool:
        """Whether a term without which the errors (strokes,) are ``without`` in place of ``whole`` is asked for."""
        more, power = float(without.sum() - whole.sum()), float(self.Y @ self.Y)
        if without.sum() < TWICE**2 * whole.sum() or more < LITTLE**2 * power:
            return False
        return self.chance(whole, without) < LEVEL

    def chance(self, whole: np.ndarray, without: np.ndarray) -> float:
        """Probability that strokes alike differ by as much in the mean as the errors ``whole`` and ``without``."""
        from scipy.stats import t as student

        gain = np.log(np.maximum(without, 1e-300)) - np.log(np.maximum(whole, 1e-300))
        deviation = max(float(np.std(gain, ddof=1)) / np.sqrt(self.count), 1e-300)
        return float(student.sf(float(np.mean(gain)) / deviation, self.count - 1))


def solved(W: np.ndarray, Y: np.ndarray, resists: int = 0) -> np.ndarray:
    """The solution (p,) of ``W X = Y`` by least squares, its first numbers that ``resists`` are nothing at least.

    >>> solved(np.eye(2), np.array([-1.0, -2.0]), 1).tolist()
    [0.0, -2.0]
    """
    value = np.linalg.lstsq(W, Y, rcond=None)[0]
    if not np.any(value[:resists] < 0.0):
        return np.asarray(value)
    from scipy.optimize import lsq_linear

    lower = np.where(np.arange(W.shape[1]) < resists, 0.0, -np.inf)
    size = np.maximum(np.linalg.norm(W, axis=0), 1e-300)  # else the smallest numbers are those of the tolerance
    return np.asarray(lsq_linear(W / size, Y, (lower, np.inf), method="bvls").x / size)
