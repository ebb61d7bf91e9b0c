"""The forces of a record along its measured motion: what acts, what a model makes of it, and what that leaves.

Nothing is simulated, so that no loop has to be known and none can be unstable; what is compared is the inverse dynamic
model (5) of ``identify``, at its cut-off, away from rests. A model is one of its models: mass and friction, and terms
beside them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy.model.missing_force import MissingForce
from emps_design.effects import Effect
from emps_design.effects.terms import TERMS
from emps_design.identification.by_least_squares import identify_by_least_squares
from emps_design.identification.command_clock import Beside, logged_beside, moved
from emps_design.identification.cutoff import chosen_cutoff
from emps_design.identification.excitation import goes_one_way
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import regression
from emps_design.identification.known import acting, filter_record
from emps_design.identification.model import ONE_WAY, Model
from emps_design.identification.proposals import RESISTS, Strokes, solved
from emps_design.identification.request import BY_LEAST_SQUARES, NO_TERMS, Request
from emps_design.identification.result import Identification
from emps_design.records import Record

SYMMETRIC = "symmetric"
NORMAL = 1.96  # deviations to either side that are an interval of 95 %


@dataclass(frozen=True)
class Fitted:
    """A model fitted to a balance: ``model`` around its solution ``value`` (p,), none of what resists below nothing.

    ``found`` is the identification, with the deviations; ``parameters`` the numbers by name, ``held`` the names of
    those that would have been below nothing; ``moves`` what the deviation of the command's clock does to each.
    """

    found: Identification
    model: Model
    value: np.ndarray
    held: tuple[str, ...]
    moves: Mapping[str, float]

    @classmethod
    def of(cls, found: Identification, beside: Sequence[Filtered]) -> Fitted:
        """The model of an identification, solved again within bounds where a number is below nothing.

        ``beside`` are the two rows of forces at the ends of what the command's clock leaves open.
        """
        W, Y, model = found.series["columns"], found.series["measured"], found.fitted
        if model.friction != ONE_WAY and len(model.names) != W.shape[1]:
            model = replace(model, friction=ONE_WAY)
        free, resists = solved(W, Y), sum(name in RESISTS for name in model.names)
        held = tuple(name for name, value in zip(model.names[:resists], free, strict=False) if value < 0.0)
        value = solved(W, Y, resists)
        ends = [model.natural(solved(*regression(one, model), resists)) for one in beside]
        moves = {name: 0.5 * abs(ends[1][name] - ends[0][name]) for name in model.names}
        return cls(found, model, value, held, moves)

    @property
    def parameters(self) -> dict[str, float]:
        """The numbers of the fit by name."""
        return self.model.natural(self.value)

    @property
    def determined(self) -> dict[str, float]:
        """Those of them that the record determines."""
        return {name: x for name, x in self.parameters.items() if self.found.parameters[name].determined}

    def tells(self, term: str) -> bool:
        """Whether the record determines every number of ``term``."""
        return all(self.found.parameters[quantity.name].determined for quantity in TERMS[term].quantities)

    def deviation(self, name: str) -> float:
        """Standard deviation of the number ``name``: twice as much to either side is its 95 % interval, clock and all.

        Of one that is held at nothing, what its interval has above nothing; 0 where it has none.
        """
        ends = self.found.parameters[name].interval_95
        if ends is None:
            return 0.0
        half = max(ends[1], 0.0) if name in self.held else 0.5 * (ends[1] - ends[0])
        return float(np.hypot(half / NORMAL, self.moves[name]))


@dataclass(frozen=True)
class Balance:
    """A ``record`` of an ``axis`` along its motion, its command moved as its ``clock`` says, below ``cutoff`` [Hz].

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> balance = Balance.of(synthetic_record(axis, laps=1), axis)
    >>> fitted = balance.fitted()
    >>> round(fitted.parameters["mass"]), round(float(np.std(balance.left(fitted)[balance.filtered.used])), 1)
    (95, 0.3)
    """

    record: Record
    axis: Axis
    friction: str
    clock: Beside
    cutoff: float

    @classmethod
    def of(cls, record: Record, axis: Axis, alike: Balance | None = None) -> Balance:
        """The balance of ``record``, filtered and moved as one ``alike``, or as it asks for itself."""
        axis = axis.supplied_by(record)
        if alike is None:
            friction = ONE_WAY if goes_one_way(record) else SYMMETRIC
            cutoff = chosen_cutoff(acting(record, axis))
            clock = logged_beside(record, axis, friction, cutoff)
        else:
            friction, cutoff, clock = alike.friction, alike.cutoff, alike.clock
        return cls(record, axis, friction, clock, cutoff)

    @cached_property
    def moved(self) -> Record:
        """The record with its command where the motion answers to it."""
        return moved(self.record, self.clock.samples)

    @cached_property
    def filtered(self) -> Filtered:
        """That record behind the filters of ``identify``."""
        return filter_record(self.moved, self.axis, "hold", self.cutoff)

    @cached_property
    def strokes(self) -> Strokes:
        """The strokes of the record, each to be predicted from others."""
        return Strokes(self.filtered, self.friction, bounded=True)

    def fitted(self, terms: Sequence[str] = ()) -> Fitted:
        """The model with ``terms`` that leaves least; raises as :func:`~emps_design.identification.identify` does."""
        asked = Request(SYMMETRIC, BY_LEAST_SQUARES, cutoff=self.cutoff, with_=tuple(terms) or NO_TERMS)
        return Fitted.of(identify_by_least_squares(self.moved, self.axis, asked), self._beside)

    @cached_property
    def _beside(self) -> list[Filtered]:
        """The same forces with the command a deviation of its clock to either side."""
        ends = [self.clock.samples + side * self.clock.std for side in (-1.0, 1.0)]
        return [filter_record(moved(self.record, end), self.axis, "hold", self.cutoff) for end in ends]

    def force(self, fitted: Fitted) -> np.ndarray:
        """The force (rows,) [N] that a model asks for along the motion."""
        return regression(self.filtered, fitted.model)[0] @ fitted.value

    def left(self, fitted: Fitted) -> np.ndarray:
        """What a model leaves (rows,) [N] of the force that acts, 0 in rows that take no part."""
        return regression(self.filtered, fitted.model)[1] - self.force(fitted)

    def along(self, rows: np.ndarray) -> np.ndarray:
        """A signal (rows,) at the samples (n,) of the record: straight between the rows, which resolve it."""
        return np.interp(self.record.t, self.filtered.t, rows)

    @cached_property
    def used(self) -> np.ndarray:
        """The samples (n,) bool that take part."""
        inside = (self.record.t >= self.filtered.t[0]) & (self.record.t <= self.filtered.t[-1])
        return inside & (self.along(self.filtered.used.astype(float)) > 0.999)

    def missing(self, fitted: Fitted) -> MissingForce:
        """What a model misses at the samples of the record."""
        moving = replace(self.filtered.motion, tau=self.along(self.force(fitted)), voltage=self.record.u)
        return MissingForce(moving, self.along(self.left(fitted)), self.used)


def terms_of(axis: Axis, effects: Mapping[str, Effect]) -> dict[str, str]:
    """The terms that may be named on ``axis``, and the one of ``effects`` by name that each is.

    >>> from emps_design.effects import known_effects
    >>> from emps_design.machines import machine
    >>> terms_of(machine("emps2019"), known_effects())["bent-viscous"]
    'nonlinear_viscous_friction'
    """
    return {
        term: name
        for term, described in TERMS.items()
        for name, effect in effects.items()
        if axis.units.motion in described.motions and term in effect.identified_by
    }
