"""The regression that an identification solves: a record filtered in one way, the columns of a model, the force.

Least squares, instruments and output error start from the same one, at one cut-off or at another.

What an axis file knows besides the parameters that are sought: what its drive does to the voltage, its effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects import known_effects
from emps_design.effects.terms import BENT, HIGHEST, LOWEST, POWER
from emps_design.errors import InputError, nearest_name
from emps_design.identification.chains import CHAINS
from emps_design.identification.inverse_model import (
    Filtered,
    LeastSquares,
    least_squares,
    regression,
    with_predicted_force,
)
from emps_design.identification.model import Model, powered
from emps_design.observer import acting_voltage, effects_force, left_out, motor_share, sampled_with
from emps_design.records import Record


def known_part(axis: Axis, model: str | Model) -> Axis:
    """The axis without the effects that ``model`` identifies itself.

    >>> from emps_design.machines import machine
    >>> [len(known_part(machine("emps2018-two-quadrant"), model).effects) for model in ("symmetric", "asymmetric")]
    [1, 0]
    """
    own = _parts(model)
    return axis.replace(effects=[one for one in axis.effects if not own.intersection(one.effect.identified_by)])


def identified_effects(model: str | Model, p: Mapping[str, float]) -> list[dict[str, Any]]:
    """The effects that the parameters ``p`` of ``model`` describe, as tables of an axis.

    >>> identified_effects("asymmetric", {"viscous_positive": 5.0, "viscous_negative": 3.0})
    [{'kind': 'asymmetric_viscous_friction', 'viscous_difference': 1.0}]
    """
    own = _parts(model)
    return [
        {"kind": effect.name, **effect.identified_by[part](p)}
        for effect in known_effects().values()
        for part in effect.identified_by
        if part in own
    ]


def _parts(model: str | Model) -> set[str]:
    model = Model.of(model)
    return {model.friction, *model.terms}


def acting(record: Record, axis: Axis) -> Record:
    """The record with the voltage that acts in place of the recorded one: see :func:`acting_voltage`."""
    voltage, _ = acting_voltage(sampled_with(axis, record.period), record.u)
    return replace(record, u=voltage * motor_share(axis, record))


def filter_record(record: Record, axis: Axis, chain: str, cutoff_hz: float | None = None) -> Filtered:
    """Run ``record`` through ``chain``, less what the axis' drive and effects account for.

    Delays, lags and maps of the drive go into the voltage, and so do the supply of a duty and where the motor was
    switched off; what a back-EMF brakes, and the force of effects that have a regressor is taken out of
    the motor force, with the parameters of the axis and its present mechanics where an effect depends on them.
    Raises :class:`InputError`, which names the nearest chain.
    """
    check_chain(chain)
    voltage, rest = acting_voltage(sampled_with(axis, record.period), record.u)
    share = motor_share(axis, record)
    filtered = CHAINS[chain](replace(record, u=voltage * share), axis.drive.gain, cutoff_hz)
    if axis.drive.braking:
        on = np.ones(len(record)) if record.enable is None else (record.enable != 0.0).astype(float)
        braked = axis.drive.braking * filtered.motion.v * on[len(record) - len(filtered.motion.v) :]
        filtered = replace(filtered, force=filtered.force - filtered.reduce(braked))
    if not rest.effects:
        return filtered
    moved = with_predicted_force(filtered.motion, axis.mechanics.array())
    return replace(filtered, force=filtered.force - filtered.reduce(effects_force(moved, rest)))


def check_chain(chain: str) -> None:
    """Raise :class:`InputError`, which names the nearest, for a ``chain`` of filters that is none."""
    if chain not in CHAINS:
        raise InputError(f"`filter`: found {chain!r}, expected {', '.join(CHAINS)}{nearest_name(chain, list(CHAINS))}")


def notes(axis: Axis, simulated: bool = False) -> list[str]:
    """One line for each thing about the effects of ``axis`` that whoever identifies with it should know.

    ``simulated``: the estimator simulates them all, and needs no regressor.

    >>> from emps_design.machines import machine
    >>> notes(machine("emps2019"))
    []
    """
    found = []
    _, rest = acting_voltage(axis, np.zeros(1))
    unused = () if simulated else left_out(rest)["offline"]
    taken = [one.kind for one in axis.effects if one.kind not in unused]
    if taken:
        found.append(f"taken as known from {axis.name}, and kept in the identified axis: {', '.join(taken)}")
    if unused:
        found.append(
            f"left out of the regression, for the motion does not give their force: {', '.join(unused)}; they pull at "
            "mass and friction, output error (oe) has them in its simulation"
        )
    own = [one.kind for one in axis.effects if any(p.per_record for p in one.effect.parameters)]
    if own:
        found.append(f"right only if the axis was made from this record, by phase or time: {', '.join(own)}")
    return found


@dataclass(frozen=True)
class Regression:
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
    ) -> Regression:
        """The regression of ``record`` after a ``chain`` of filters with ``cutoff`` [Hz] (None: the chain's own).

        A ``model`` without the point that it needs is taken around its solution. Raises :class:`RecordError` where the
        filter leaves too little.

        >>> from emps_design.machines import machine
        >>> from emps_design.simulation.synthetic import synthetic_record
        >>> axis = machine("emps2019")
        >>> one = Regression.of(synthetic_record(axis, laps=1), axis, "symmetric", cutoff=40.0)
        >>> one.names[0], round(one.solved().value[0])
        ('mass', 95)
        """
        filtered = filter_record(record, axis, chain, cutoff)
        model = settled(filtered, Model.of(model))
        W, Y = regression(filtered, model)
        return cls(record, axis, model, filtered.without_motion(), W, Y)

    def alike(self, record: Record) -> Regression:
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
