"""The regression that an identification solves: a record filtered in one way, the columns of a model, the force.

Least squares, instruments and output error start from the same one, at one cut-off or at another.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from emps_design.axis import Axis
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import LeastSquares, least_squares, parameters_of, regression
from emps_design.identification.known import filter_record
from emps_design.records import Record


@dataclass(frozen=True)
class Problem:
    """``Y = W X + e`` of one record: ``W`` (n, p), ``Y`` (n,) [N], zero in the rows that take no part.

    ``axis`` gives the drive and what is known already; ``filtered`` is the record after its chain of filters, without
    its motion, of which W is made.
    """

    record: Record
    axis: Axis
    model: str
    filtered: Filtered
    W: np.ndarray = field(repr=False)
    Y: np.ndarray = field(repr=False)

    @classmethod
    def of(cls, record: Record, axis: Axis, model: str, chain: str = "hold", cutoff: float | None = None) -> Problem:
        """The regression of ``record`` after a ``chain`` of filters with ``cutoff`` [Hz] (None: the chain's own).

        Raises :class:`RecordError` where the filter leaves too little.

        >>> from emps_design.machines import machine
        >>> from emps_design.simulation.synthetic import synthetic_record
        >>> axis = machine("emps2019")
        >>> one = Problem.of(synthetic_record(axis, laps=1), axis, "symmetric", cutoff=40.0)
        >>> one.names[0], round(one.solved().value[0])
        ('mass', 95)
        """
        filtered = filter_record(record, axis, chain, cutoff)
        W, Y = regression(filtered, model)
        return cls(record, axis, model, filtered.without_motion(), W, Y)

    def alike(self, record: Record) -> Problem:
        """The regression of another ``record`` of the same axis, filtered in the same way."""
        return self.of(record, self.axis, self.model, self.filtered.chain, self.filtered.cutoff_hz)

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters, in the order of the columns."""
        return tuple(quantity.name for quantity in parameters_of(self.model))

    @property
    def used(self) -> np.ndarray:
        """Which rows (n,) take part."""
        return self.filtered.used

    def solved(self) -> LeastSquares:
        """Least squares; raises :class:`RankError` for columns that the record cannot tell apart."""
        return least_squares(self.W, self.Y, self.names, self.used)
