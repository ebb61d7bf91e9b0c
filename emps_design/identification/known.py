"""What an axis file knows besides the parameters that are sought: what its drive does to the voltage, its effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects import known_effects
from emps_design.errors import InputError, nearest_name
from emps_design.identification.chains import CHAINS
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import with_predicted_force
from emps_design.identification.model import Model
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
