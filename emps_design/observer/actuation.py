"""From the voltage a record holds to the voltage that acts: maps, delays and the lag of the current loop."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.records import Record


def acting_voltage(axis: Axis, u: np.ndarray) -> tuple[np.ndarray, Axis]:
    """Voltage that acts, (n,) [V], of the recorded ``u``, and the axis without what was used up on the way.

    Static maps of the actuator, delays and lags, that of the current loop too, are known from ``u`` alone, and a
    disturbance of the controller is in ``u`` already: with them taken care of here, every observer, on-line ones too,
    sees the force that reaches the carriage. What a back-EMF brakes joins the viscous friction.

    >>> from emps_design.machines import machine
    >>> dead = machine("emps2019").replace(effects=[{"kind": "actuator_deadzone", "width": 0.5}])
    >>> voltage, rest = acting_voltage(dead, np.array([0.2, 1.0]))
    >>> voltage.tolist(), rest.effects
    ([0.0, 0.5], ())
    """
    b, kept = tuple(float(x) for x in axis.mechanics.array()), []
    late, lags = float(axis.sampling.computation_delay), [axis.drive.current_time_constant]
    for one in axis.effects:
        effect, p = one.effect, tuple(float(x) for x in one.effect.values(one.parameters))
        if effect.actuator is not None:
            u = np.array([effect.actuator(float(voltage), p) for voltage in u])
        elif effect.delay is not None:
            late += effect.delay(0.0, 0.0, 0.0, 0.0, (), p, b) / axis.sampling.period
        elif effect.lag is not None:
            lags.append(effect.lag(0.0, 0.0, 0.0, 0.0, (), p, b))
        elif effect.command is None:
            kept.append(one)
    u = _delayed(u, late)
    for constant in lags:
        u = _lagged(u, constant / axis.sampling.period)
    used_up = {
        "drive": {"current_time_constant": 0.0, **({"back_emf": 0.0} if axis.drive.back_emf else {})},
        "sampling": {"computation_delay": 0},
        "mechanics": {"viscous": axis.damping},
    }
    return u, axis.replace(effects=kept, **used_up)


def sampled_with(axis: Axis, period: float) -> Axis:
    """``axis`` with the ``period`` [s] of a record: itself where it has that already."""
    return axis if axis.sampling.period == period else axis.replace(sampling={"period": period})


def as_driven(axis: Axis, record: Record) -> tuple[Record, Axis]:
    """The record with the voltage that acts, as :func:`acting_voltage` says, and the axis that goes with it.

    The supply of a duty and where the motor was switched off are in that voltage. A winding that is open brakes
    nothing: what the axis then has too much of viscous friction the voltage gives back.

    >>> from emps_design.machines import machine
    >>> from emps_design.machines import machine
    >>> wave = 0.1 * np.sin(np.arange(60) / 9)
    >>> off = Record.from_arrays(1e-2, wave, wave, np.ones(60) + wave, enable=np.arange(60) < 30)
    >>> [int(np.count_nonzero(half)) for half in np.split(as_driven(machine("emps2019"), off)[0].u, 2)]
    [30, 0]
    """
    voltage, driven = acting_voltage(sampled_with(axis, record.period), record.u)
    return replace(record, u=voltage * motor_share(axis, record) + given_back(axis, record)), driven


def motor_share(axis: Axis, record: Record) -> Any:
    """Share (n,) of ``axis.drive.gain`` that acts at each sample of ``record``, or 1.0: its supply, off or on."""
    share: Any = 1.0
    if axis.drive.command == "duty" and record.supply is not None:
        share = axis.drive.force_gain * record.supply / axis.drive.gain
    return share if record.enable is None else share * (record.enable != 0.0)


def given_back(axis: Axis, record: Record) -> np.ndarray:
    """Command (n,) that drives as much as the back-EMF would brake, where the motor of ``record`` is off; else 0."""
    if record.enable is None or not axis.drive.braking:
        return np.zeros(len(record))
    v = np.gradient(record.q, record.period)
    return np.where(record.enable != 0.0, 0.0, axis.drive.braking * v / axis.drive.gain)


def motor_force(axis: Axis, record: Record) -> np.ndarray:
    """Motor force (n,) [N] that the command of ``record`` asks for, before delays, lags and back-EMF."""
    return axis.drive.gain * motor_share(axis, record) * record.u


def _delayed(u: np.ndarray, late: float) -> np.ndarray:
    """Means over each period of the held signal ``u`` that arrives ``late`` periods later."""
    if late == 0.0:
        return u
    whole, share = int(late), late - int(late)
    padded = np.concatenate([np.full(whole + 1, u[0]), u])
    return (1.0 - share) * padded[1 : len(u) + 1] + share * padded[: len(u)]


def _lagged(u: np.ndarray, constant: float) -> np.ndarray:
    """Means over each period of the held ``u`` behind a first-order lag of ``constant`` periods, settled at u[0]."""
    if constant <= 0.0:
        return u
    from scipy.signal import lfilter

    decay = math.exp(-1.0 / constant)
    begin, _ = lfilter([0.0, 1.0 - decay], [1.0, -decay], u, zi=[u[0]])
    return u + (begin - u) * constant * (1.0 - decay)
