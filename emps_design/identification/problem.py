"""The regression that an identification solves: a filtered record, the columns of a model, the force.

Least squares, instruments and output error all start from it, each at a cut-off of its own.

What the axis file already gives, the drive's effect on the voltage and known effects, is removed first.
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
from emps_design.messages import Message, warning
from emps_design.observer import acting_voltage, effects_force, left_out, motor_share, sampled_with
from emps_design.records import Record


def known_part(axis: Axis, model: str | Model) -> Axis:
    """The axis without the effects that ``model`` identifies itself.

    >>> from emps_design.machines import machine
    >>> [len(known_part(machine("emps2018-two-quadrant"), model).effects) for model in ("symmetric", "asymmetric")]
    [1, 0]
    """
    own = _parts(model)
    return axis.replace(
        effects=[entry for entry in axis.effects if not own.intersection(entry.effect.estimation.identified_by)]
    )


def identified_effects(model: str | Model, p: Mapping[str, float]) -> list[dict[str, Any]]:
    """The effects that the parameters ``p`` of ``model`` describe, as tables of an axis.

    >>> identified_effects("asymmetric", {"viscous_positive": 5.0, "viscous_negative": 3.0})
    [{'kind': 'asymmetric_viscous_friction', 'viscous_difference': 1.0}]
    """
    own = _parts(model)
    return [
        {"kind": effect.name, **effect.estimation.identified_by[part](p)}
        for effect in known_effects().values()
        for part in effect.estimation.identified_by
        if part in own
    ]


def _parts(model: str | Model) -> set[str]:
    model = Model.of(model)
    return {model.friction, *model.terms}


def acting(record: Record, axis: Axis) -> Record:
    """The record with its voltage replaced by the one that acts on the motor: see :func:`acting_voltage`."""
    voltage, _ = acting_voltage(sampled_with(axis, record.period), record.u)
    return replace(record, u=voltage * motor_share(axis, record))


def filter_record(record: Record, axis: Axis, chain: str, cutoff_hz: float | None = None) -> Filtered:
    """Run ``record`` through ``chain`` and subtract what the drive and the effects of ``axis`` account for.

    The voltage is corrected for delays, lags and maps of the drive, for the supply of a duty cycle, and for samples
    with the motor switched off. The braking force of the back-EMF and the force of effects that have a regressor are
    subtracted from the motor force, computed with the parameters of the axis and, where an effect depends on them,
    its present mechanics. Raises :class:`InputError`, which names the nearest chain.
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
    """Raise :class:`InputError`, which names the nearest chain, where ``chain`` is not one of :data:`CHAINS`."""
    if chain not in CHAINS:
        raise InputError(f"`filter`: found {chain!r}, expected {', '.join(CHAINS)}{nearest_name(chain, list(CHAINS))}")


def notes(axis: Axis, simulated: bool = False) -> list[Message]:
    """Messages on how the identification treats the effects of ``axis``, one line each.

    ``simulated``: the estimator simulates all effects and needs no regressor for them.

    >>> from emps_design.machines import machine
    >>> notes(machine("emps2019"))
    []
    """
    messages = []
    _, rest = acting_voltage(axis, np.zeros(1))
    unused = () if simulated else left_out(rest)["offline"]
    taken = [entry.kind for entry in axis.effects if entry.kind not in unused]
    if taken:
        text = f"taken as known from {axis.name}, and kept in the identified axis: {', '.join(taken)}"
        messages.append(warning("effects-known", text, effects=taken))
    if unused:
        force, mass = axis.units.word("force"), axis.units.word("mass")
        text = (
            f"left out of the regression, for the motion does not give their {force}: {', '.join(unused)}; they "
            f"bias {mass} and friction, output error (oe) simulates them"
        )
        messages.append(warning("effects-left-out", text, effects=unused))
    own = [entry.kind for entry in axis.effects if any(p.per_record for p in entry.effect.parameters)]
    if own:
        text = f"right only if the axis was made from this record, by phase or time: {', '.join(own)}"
        messages.append(warning("effects-of-one-record", text, effects=own))
    return messages


@dataclass(frozen=True)
class Regression:
    """``Y = W X + e`` of one record: ``W`` (n, p), ``Y`` (n,) [N], zero in unused rows.

    ``axis`` gives the drive and the known effects; ``filtered`` is the record after its filter chain, without the
    motion that W was made of. ``model`` is linearised around its point: for a nonlinear parameter the solution X is
    the difference from that point.
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

        A nonlinear ``model`` without a point is linearised around its solution. Raises :class:`RecordError` where the
        filter leaves too few rows.

        >>> from emps_design.machines import machine
        >>> from emps_design.simulation.synthetic import synthetic_record
        >>> axis = machine("emps2019")
        >>> problem = Regression.of(synthetic_record(axis, laps=1), axis, "symmetric", cutoff=40.0)
        >>> problem.names[0], round(problem.solved().value[0])
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
        """Names of the parameters, in the order of the columns."""
        return self.model.names

    @property
    def used(self) -> np.ndarray:
        """Mask (n,) of the rows that count."""
        return self.filtered.used

    def parameters(self, value: np.ndarray) -> np.ndarray:
        """The parameters (p,) for the solution ``value`` (p,) of the linearised regression."""
        return np.array(list(self.model.natural(value).values()))

    def solved(self) -> LeastSquares:
        """The least-squares fit; raises :class:`RankError` for columns that the record cannot tell apart."""
        return least_squares(self.W, self.Y, self.names, self.used, self.axis.units)


def settled(filtered: Filtered, model: Model) -> Model:
    """The ``model`` linearised around its least-squares solution, where it is nonlinear and has no point yet.

    The exponent of the speed is searched; for each exponent all other parameters are linear (variable projection,
    G. Golub, V. Pereyra, 1973).
    """
    if model.point or not model.curved.any():
        return model
    if BENT in model.terms:
        from scipy.optimize import minimize_scalar

        rest, Y = regression(filtered, replace(model, terms=tuple(term for term in model.terms if term != BENT)))
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
