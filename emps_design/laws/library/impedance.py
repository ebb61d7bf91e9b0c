"""Impedance law without a force sensor: the target behaviour is ``M_a qdd + B qd + K (q - q_0) = tau_e``.

With ``r = Mh/M_a`` and hats for the estimates of mass and friction, the force tau_e of the hand is observed by (29) and
fed back by (28), with K and q_0 as in (27) derived:

    tau_eh = Mh a_f + Fh_v v + c Fh_c sign(v) - kappa tau_f
    tau    = (r - 1) tau_eh + Fh_v v - r B (v - v_0) + c Fh_c sign(v) - r K (q - q_0)

``a_f`` and ``tau_f`` are acceleration and motor force after first-order low-passes; ``kappa`` is 1 for (30) derived, 2
as printed, which with a reference velocity v_0 also has Fh_v (v - v_0) of (27) as printed. q_0 moves with v_0. The
motor force is not measured: the law uses a model of the current loop,
``tau[k+1] = e tau[k] + (1 - e) G_tau u[k]`` with ``e = exp(-T/T_c)``, exact while the drive applies the command. The
reference of the axis is q_0, which matters only with a stiffness. Source: section IV of the paper, (24) to (30), after
Hogan.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.errors import InputError
from emps_design.laws.estimators import BACKWARD, TWO_TAP, AnyEstimator, coefficients, states, taps
from emps_design.laws.law import FrictionModel, Law, LawKind, LawTable, PlantTables, velocity_in_words
from emps_design.tables import NonNegative, Positive, parameter

REST = "rest position"  # reference of the law
# Places in the kernel's gains.
RATIO, MASS, DAMPING, STIFFNESS, VISCOUS_POSITIVE, VISCOUS_NEGATIVE, COULOMB_POSITIVE, COULOMB_NEGATIVE = range(8)
KEEP_ACCELERATION, KEEP_CURRENT, CURRENT_FACTOR, FORCE_SENSOR, FORCE_GAIN, KEEP_MOTOR, DELAY, RATE, TAPS = range(8, 17)
REFERENCE_VELOCITY = 17
COEFFICIENTS = 18  # from here on: those of a velocity estimator with a filter
# Places in its memory, after three encoder readings: states of the filters and of the model; delayed voltages and the
# states of the estimator follow.
SLOW_ACCELERATION, SLOW_MOTOR, MOTOR, WAITING = 3, 4, 5, 6


def observed_force(mass, viscous, coulomb, factor, a, v, tau):
    """The force of the hand by (29); ``coulomb`` has the sign of the motion."""
    return mass * a + viscous * v + coulomb - factor * tau


def demanded_force(ratio, damping, stiffness, viscous, coulomb, v, away, tau_e, v_0, relative):
    """The motor force by (27), ``away`` from q_0; ``relative`` 1: friction of v - v_0 as printed, 0: as derived."""
    force = (ratio - 1.0) * tau_e + (viscous - ratio * damping) * v + coulomb - ratio * stiffness * away
    return force + (ratio * damping - relative * viscous) * v_0


def impedance(k, reference, q, f_ext, limit, gains, memory):
    """Voltage of the law at sample k."""
    if k == 0:
        memory[0] = memory[1] = memory[2] = q
        memory[SLOW_ACCELERATION] = memory[SLOW_MOTOR] = memory[MOTOR] = 0.0
    rate = gains[RATE]
    if gains[TAPS] > 0.0:
        v = 0.5 * (q - memory[1]) * rate
        a = 0.5 * (q - memory[0] - memory[1] + memory[2]) * rate * rate
    elif gains[TAPS] < 0.0:
        order = int(-gains[TAPS])
        state = WAITING + int(gains[DELAY])
        step = (q - memory[0]) * rate
        v = gains[COEFFICIENTS] * step + memory[state]
        for j in range(order):
            at = COEFFICIENTS + 1 + j
            memory[state + j] = gains[at] * step - gains[at + order] * v + memory[state + j + 1]
        a = (v - memory[state + order + 1]) * rate
        memory[state + order + 1] = v
    else:
        v = (q - memory[0]) * rate
        a = (q - 2.0 * memory[0] + memory[1]) * rate * rate
    memory[2] = memory[1]
    memory[1] = memory[0]
    memory[0] = q
    viscous = 0.0
    coulomb = 0.0
    if v > 0.0:
        viscous = gains[VISCOUS_POSITIVE]
        coulomb = gains[COULOMB_POSITIVE]
    elif v < 0.0:
        viscous = gains[VISCOUS_NEGATIVE]
        coulomb = -gains[COULOMB_NEGATIVE]
    if gains[FORCE_SENSOR] > 0.0:
        tau_e = f_ext
    else:
        factor = gains[KEEP_ACCELERATION]
        memory[SLOW_ACCELERATION] = factor * memory[SLOW_ACCELERATION] + (1.0 - factor) * a
        factor = gains[KEEP_CURRENT]
        memory[SLOW_MOTOR] = factor * memory[SLOW_MOTOR] + (1.0 - factor) * memory[MOTOR]
        tau_e = observed_force(
            gains[MASS], viscous, coulomb, gains[CURRENT_FACTOR], memory[SLOW_ACCELERATION], v, memory[SLOW_MOTOR]
        )
    v_0 = gains[REFERENCE_VELOCITY]
    away = q - reference - v_0 * k / rate
    tau = demanded_force(
        gains[RATIO], gains[DAMPING], gains[STIFFNESS], viscous, coulomb, v, away, tau_e, v_0,
        gains[CURRENT_FACTOR] - 1.0,
    )  # fmt: skip
    u = min(max(tau / gains[FORCE_GAIN], -limit), limit)
    # The input of the current-loop model is this voltage, or the delayed one.
    arriving = u
    delay = int(gains[DELAY])
    if delay > 0:
        arriving = memory[WAITING + delay - 1]
        for i in range(delay - 1, 0, -1):
            memory[WAITING + i] = memory[WAITING + i - 1]
        memory[WAITING] = u
    memory[MOTOR] = gains[KEEP_MOTOR] * memory[MOTOR] + (1.0 - gains[KEEP_MOTOR]) * gains[FORCE_GAIN] * arriving
    return u


@dataclass(frozen=True)
class Parameters:
    """M_a, B, the estimate, both low-passes [rad/s] and the options of the law; for units see the module.

    A number may be an array (m,) for as many laws, but for what is yes or no.
    """

    mass: Any
    damping: Any
    estimate: FrictionModel
    filters: Any
    velocity_estimator: AnyEstimator = TWO_TAP
    stiffness: Any = 0.0
    coulomb_factor: Any = 1.0
    current_factor: Any = 1.0
    force_sensor: bool = False
    reference_velocity: float = 0.0


def gains_of(law, period, force_gain=1.0, current_time_constant=0.0, delay=0):
    """Gains of the kernel for the :class:`Parameters` ``law`` and a drive; ``delay`` [samples]."""
    keep_acceleration, keep_current = (np.exp(-w * period) for w in law.filters)
    keep_motor = np.exp(-period / current_time_constant) if current_time_constant else 0.0
    estimate, estimator = law.estimate, law.velocity_estimator
    coulomb = [law.coulomb_factor * level for level in estimate.coulomb]
    return [
        estimate.mass / law.mass, estimate.mass, law.damping, law.stiffness, *estimate.viscous, *coulomb,
        keep_acceleration, keep_current, law.current_factor, float(law.force_sensor), force_gain, keep_motor, delay,
        1.0 / period, taps(estimator), law.reference_velocity, *coefficients(estimator, period),
    ]  # fmt: skip


def law_with(gains, delay):
    """The law with the numbers of :func:`gains_of`, ``delay`` [samples] among them."""
    order = np.ravel(gains[..., TAPS] if isinstance(gains, np.ndarray) else gains[TAPS])[0]
    return Law(impedance, gains, _memory(order, delay), REST)


def _memory(order, delay):
    """Cells of the memory; an estimator that filters also keeps the velocity before, for the acceleration."""
    return WAITING + delay + (states(order) + 1 if order < 0.0 else 0)


def default_filter(period: float) -> float:
    """Low-pass for acceleration and current where none is asked for, 0.5/period: 500 rad/s at 1 kHz.

    Slower, the Coulomb compensation hunts (see ``relay_oscillations``); faster, the smallest safe M_a grows.
    """
    return 0.5 / period


def check_filters(period: float, acceleration: float, current: float) -> None:
    """Refuse filters above the Nyquist frequency pi/period with :class:`InputError`; inf means no filter."""
    for name, value in (("filter", acceleration), ("current filter", current)):
        if math.isfinite(value) and value >= math.pi / period:
            raise InputError(
                f"{name}: found {value:g} rad/s, expected less than the Nyquist frequency "
                f"{math.pi / period:g} rad/s of the {period:g} s sampling; lower it, or give inf for none"
            )


class Table(LawTable):
    mass: Positive = parameter("apparent mass M_a", "kg")
    damping: NonNegative = parameter("apparent damping B", "N/(m/s)")
    filter: Positive | None = parameter("low-pass of acceleration and current in the law", "rad/s", None)


def gains(p, axis, period):
    cutoff = p.filter or default_filter(axis.sampling.period)
    check_filters(period, cutoff, cutoff)
    law = Parameters(p.mass, p.damping, FrictionModel.of(axis), (cutoff, cutoff), p.velocity_estimator)
    drive = axis.drive
    return gains_of(law, period, drive.gain, drive.current_time_constant, axis.sampling.computation_delay)


def equations(p, axis, period):
    g = gains(p, axis, period)
    delay, keep = axis.sampling.computation_delay, g[KEEP_MOTOR]
    limit, kind = f"{axis.drive.command_limit:.10g}", p.velocity_estimator
    changes = {TWO_TAP: "q[k] - q[k-1] - q[k-2] + q[k-3]", BACKWARD: "q[k] - 2 * q[k-1] + q[k-2]"}
    change = f"({changes[kind]}) / {(2.0 if kind == TWO_TAP else 1.0) * period**2:.10g}" if kind in changes else ""
    lines = (
        velocity_in_words(p, period),
        f"a[k] = {change or f'(v[k] - v[k-1]) / {period:.10g}'}",
        f"af[k] = {g[KEEP_ACCELERATION]:.10g} * af[k-1] + {1.0 - g[KEEP_ACCELERATION]:.10g} * a[k]",
        f"tf[k] = {g[KEEP_CURRENT]:.10g} * tf[k-1] + {1.0 - g[KEEP_CURRENT]:.10g} * tau[k]",
        f"fr[k] = {g[VISCOUS_POSITIVE]:.10g} * v[k] + {g[COULOMB_POSITIVE]:.10g}   (v[k] > 0)",
        f"fr[k] = {g[VISCOUS_NEGATIVE]:.10g} * v[k] - {g[COULOMB_NEGATIVE]:.10g}   (v[k] < 0; 0 at rest)",
        f"hand[k] = {g[MASS]:.10g} * af[k] + fr[k] - {g[CURRENT_FACTOR]:.10g} * tf[k]",
        f"c[k] = {g[RATIO] - 1.0:.10g} * hand[k] + fr[k] - {g[RATIO] * g[DAMPING]:.10g} * v[k]",
        f"u[k] = c[k] / {g[FORCE_GAIN]:.10g}",
        f"if u[k] >  {limit}: u[k] =  {limit}",
        f"if u[k] < -{limit}: u[k] = -{limit}",
    )
    late = f"u[k-{delay}]" if delay else "u[k]"
    return (*lines, f"tau[k+1] = {keep:.10g} * tau[k] + {(1.0 - keep) * g[FORCE_GAIN]:.10g} * {late}")


LAW: LawKind[PlantTables] = LawKind(
    name="impedance",
    label="impedance law without a force sensor",
    source="paper, section IV, (24) to (30)",
    table=Table,
    kernel=impedance,
    gains=gains,
    memory=lambda p, axis: _memory(taps(p.velocity_estimator), axis.sampling.computation_delay),
    equations=equations,
    follows=REST,
    apparent=True,
)
