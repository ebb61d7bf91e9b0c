"""The regression that an identification solves: a record filtered in one way, the columns of a model, the force.

Least squares, instruments and output error start from the same one, at one cut-off or at another.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.terms import BENT, HIGHEST, LOWEST, POWER
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import LeastSquares, least_squares, regression
from emps_design.identification.known import filter_record
from emps_design.identification.model import Model, powered
from emps_design.records import Record


@dataclass(frozen=True)
class Problem:
    """``Y = W X + e`` of one record: ``W`` (n, p), ``Y`` (n,) [N], zero in the rows that take no part.

    ``axis`` gives the drive and what is known already; ``filtered`` is the record after its chain of filters, without
    its motion, of which W is made. ``model`` is linear around its point: there the solution X is what the parameters
    differ by where they are not linear.
    """

    record: Record
    axis: Axis
    model: Model
    filtered: Filtered
    W: np.ndarray = field(repr=False)
    Y: np.ndarray = field(repr=False)

    @classmethod
    def of(
        cls, record: Record, axis: Axis, model: str | Model, chain: str = "hold", cutoff: float | None = None
    ) -> Problem:
        """The regression of ``record`` after a ``chain`` of filters with ``cutoff`` [Hz] (None: the chain's own).

        A ``model`` without the point that it needs is taken around its solution. Raises :class:`RecordError` where the
        filter leaves too little.

        >>> from emps_design.machines import machine
        >>> from emps_design.simulation.synthetic import synthetic_record
        >>> axis = machine("emps2019")
        >>> one = Problem.of(synthetic_record(axis, laps=1), axis, "symmetric", cutoff=40.0)
        >>> one.names[0], round(one.solved().value[0])
        ('mass', 95)
        """
        filtered = filter_record(record, axis, chain, cutoff)
        model = settled(filtered, Model.of(model))
        W, Y = regression(filtered, model)
        return cls(record, axis, model, filtered.without_motion(), W, Y)

    def alike(self, record: Record) -> Problem:
        """The regression of another ``record`` of the same axis, filtered in the same way."""
        return self.of(record, self.axis, self.model, self.filtered.chain, self.filtered.cutoff_hz)

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters, in the order of the columns."""
        return self.model.names

    @property
    def used(self) -> np.ndarray:
        """Which rows (n,) take part."""
        return self.filtered.used

    def told(self, value: np.ndarray) -> np.ndarray:
        """The parameters (p,) that belong to the solution ``value`` (p,)."""
        return np.array(list(self.model.natural(value).values()))

    def solved(self) -> LeastSquares:
        """Least squares; raises :class:`RankError` for columns that the record cannot tell apart."""
        return least_squares(self.W, self.Y, self.names, self.used)


def settled(filtered: Filtered, model: Model) -> Model:
    """The ``model`` around its least-squares solution, where it is not linear and has no point yet.

    The power of the speed is searched for, everything else being linear beside it (G. Golub, V. Pereyra, 1973).
    """
    if model.point or not model.curved.any():
        return model
    if BENT in model.terms:
        from scipy.optimize import minimize_scalar

        rest, Y = regression(filtered, replace(model, terms=tuple(one for one in model.terms if one != BENT)))
        rest = np.delete(rest, model.names.index("viscous"), axis=1)
        basis = np.linalg.qr(rest / np.maximum(np.linalg.norm(rest, axis=0), 1e-300))[0]

        def explained(power: float) -> float:
            column = filtered.reduce(powered(filtered.motion.v, power)) * filtered.used
            column = column - basis @ (basis.T @ column)
            return float(column @ Y) ** 2 / max(float(column @ column), 1e-300)

        best = minimize_scalar(lambda power: -explained(power), bounds=(LOWEST, HIGHEST), method="bounded")
        model = replace(model, point={POWER.name: float(best.x)})
    W, Y = regression(filtered, model)
    return model.around(np.linalg.lstsq(W, Y, rcond=None)[0])
