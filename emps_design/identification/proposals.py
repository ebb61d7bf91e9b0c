"""Which terms beside the friction model a record asks for by itself: those without which strokes are not foretold.

A term that is fitted always explains something of the strokes that it was fitted to. So the strokes are held out part
by part, and predicted with what the others say: a term is proposed where the error of held-out strokes is at least
twice as large without it, in one stroke after the other and not by chance, and where it is a part of the force that a
user should know of. One rule for every term; what it asks for is what a machine obviously has.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.effect import VISCOUS
from emps_design.effects.terms import BENT, HIGHEST, LOWEST, TERMS
from emps_design.errors import RecordError
from emps_design.identification.cutoff import chosen_cutoff, first_part
from emps_design.identification.excitation import check_record
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import regression
from emps_design.identification.known import acting, filter_record, known_part
from emps_design.identification.model import Model, powered
from emps_design.identification.request import Request
from emps_design.identification.unexplained import LITTLE
from emps_design.records import Record
from emps_design.stretches import stretches

FOLDS = 5  # parts of the record, of whole strokes one after the other, that are held out in turn
TWICE = 2.0  # times as large the error of held-out strokes is without a term that is proposed, at least
LEVEL = 0.01  # at which a smaller error in the mean stroke is no chance
POWERS = tuple(np.geomspace(LOWEST, HIGHEST, 8).tolist())  # of a bent friction, that are tried
FEWEST_STROKES = 3
RESISTS = ("mass", "viscous", "coulomb")  # parameters that are nothing at least, the first of a model


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
        without = {term: strokes.errors([one for one in terms if one != term]) for term in terms}
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
        self.resists = sum(one.name in RESISTS for one in Model(friction).quantities) if bounded else 0
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
            value, which = known._told(known._forms(terms), np.ones(len(known.Y), bool))
            return self.Y - self._forms(terms)[which] @ value
        forms, error = self._forms(terms, others), np.zeros(len(self.Y))
        for fold in np.unique(self.fold):
            out = self.fold == fold
            value, which = self._told(forms, ~out)
            error[out] = self.Y[out] - forms[which][out] @ value
        return error

    def residual(self, terms: Sequence[str], others: Sequence[np.ndarray] = ()) -> np.ndarray:
        """What a model with ``terms`` and ``others``, fitted to all of them, leaves (rows,) [N]."""
        forms = self._forms(terms, others)
        value, which = self._told(forms, np.ones(len(self.Y), bool))
        return self.Y - forms[which] @ value

    def _forms(self, terms: Sequence[str], others: Sequence[np.ndarray] = ()) -> list[np.ndarray]:
        """The regressor (rows, p) with ``terms`` and ``others``; of a bent friction, one with each power."""
        W = np.column_stack([self.W, *(self.beside[term] for term in terms if term != BENT), *others])
        if BENT not in terms:
            return [W]
        return [np.column_stack([W[:, :VISCOUS], bent, W[:, VISCOUS + 1 :]]) for bent in self.bent.T]

    def _told(self, forms: list[np.ndarray], rows: np.ndarray) -> tuple[np.ndarray, int]:
        """What ``rows`` (rows,) bool say, (p,), of the one of ``forms`` that leaves least of them, and which it is."""
        tried = [solved(form[rows], self.Y[rows], self.resists) for form in forms]
        left = [
            float(np.sum((form[rows] @ value - self.Y[rows]) ** 2)) for form, value in zip(forms, tried, strict=True)
        ]
        which = int(np.argmin(left))
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
